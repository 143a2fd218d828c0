"""Behavior of the estimator under loads and pressures outside the domain of its model.

    python acceptance/load_domain.py [--json] [--samples N] [--rigs NAME ...]

Arms of the virtual lab, with effects that the model does not know, are calibrated from narrow
recordings: pressures up to 40 kPa, forces up to 0.16 N. Then come readings of loads that are up to
20 times the size of the calibrated ones beyond them, and of pressures up to 20 times the range
beyond it. Each must be refused or flagged; where it is flagged, the tip must be within 3 sigma of
where the lab, which shares no solver with the model, has it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
import math
from pathlib import Path
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import Outcome, ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.files.json_text import json_text
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.chain import equilibrium_shape
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.protocols import ForceSweeps, Protocol, RandomMix, SlowRamp, Staircase
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import apply_effects, chain_of, read_sensors, simulate
from pneunet_ros.model.arm import Arm
from rich.console import Console
from rich.table import Table

# What the tests share reads recordings of the virtual lab as runs.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from support.lab_run import run_of

TOP = 40e3  # Pa, of the recordings that the model is calibrated from
FURTHEST = 20.0  # sizes of the hull, ranges of pressure
NEAR = 0.5  # share of the samples that are near enough to be flagged
PATH = np.linspace(0.0, 1.0, 6)[1:]  # on which the lab's arm is led to its load
RIGS: dict[str, tuple[int, dict[str, dict[str, float]]]] = {
    'plain': (11, {}),
    'stiffening': (12, {'stiffening': {'coefficient': 2e-4}}),
    'extensibility': (13, {'extensibility': {'axial_stiffness': 30.0}}),
    'load offset': (14, {'load_offset': {'offset': 0.004}}),
    'soft clamp': (15, {'clamp_compliance': {'compliance': 8.0}}),
    'weak chamber': (16, {'weak_chamber': {'rigidity_loss': 0.5, 'place': 0.4}}),
    'misaligned sensor': (17, {'force_misalignment': {'angle': 0.06}}),
    'gravity': (18, {'gravity': {'weight_x': 0.0, 'weight_y': -0.4}}),
}
UNLOADED: tuple[Protocol, ...] = (SlowRamp(top=TOP), Staircase(pressures=(10e3, 20e3, 30e3, TOP)))
LOADED: tuple[Protocol, ...] = (
    ForceSweeps(pressures=(10e3, 30e3), angles=(0.2, 0.9), largest=0.16),
    RandomMix(top=TOP, force_x=(0.05, 0.14), force_y=(0.0, 0.1)),
)


def rig(name: str) -> Scenario:
    """Return a scenario of a rig: another arm each, with its effects, two frames a second."""
    seed, effects = RIGS[name]
    scenario = load_scenario(share_path('scenarios/force_sweeps.yaml'))
    arm = vary_arm(scenario.arm, seed)
    scenario = replace(scenario, arm=arm, seed=seed, rates=Rates(frames=2.0))
    return scenario.with_effects(effects)


def calibrated(scenario: Scenario) -> Arm:
    """Return the model that narrow recordings of a rig give, without its effects."""
    frame = load_model(share_path('config/paper_arm.yaml'))
    frame = replace(frame, target_arclength=scenario.arm.targets, sensors=frame.sensors)
    runs = [
        [
            run_of(simulate(replace(scenario, name=protocol.kind, protocol=protocol, seed=seed)))
            for seed, protocol in enumerate(protocols, start=first)
        ]
        for first, protocols in ((100, UNLOADED), (200, LOADED))
    ]
    return calibrate(runs[0], runs[1], frame, compare=False).arm


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A pressure (Pa) and a force (2,) N, and how far outside the domain it is, of its size."""

    pressure: float
    force: tuple[float, float]
    beyond: float


def draw_samples(arm: Arm, count: int, random: np.random.Generator) -> list[Sample]:
    """Return loads, and a fifth as many pressures, outside the domain of a model.

    The nearest are beyond what noise of the readings explains, twice.
    """
    hull = arm.load_hull
    assert hull is not None
    low, high = arm.pressure_range
    samples = []
    for index in range(count):
        near, pressure = random.uniform() < NEAR, random.uniform(max(low, 0.0), high)
        angle = random.uniform(-math.pi, math.pi)
        toward = np.array([math.cos(angle), math.sin(angle), 0.0, 0.0])
        if index % 6 == 5:  # a pressure, of the unloaded arm
            share, below = random.uniform(), not near and random.uniform() < 0.5
            out = random.uniform(0.021, 0.05) if near else 0.05 * (FURTHEST / 0.05) ** share
            at_rest = low - out * (high - low) if below else high + out * (high - low)
            samples.append(Sample(pressure=at_rest, force=(0.0, 0.0), beyond=out))
            continue
        wanted = random.uniform(0.06, 0.5) if near else 0.5 * (FURTHEST / 0.5) ** random.uniform()
        at = np.array([0.0, 0.0, 0.0, pressure])
        smallest, largest = 0.0, 100.0 * FURTHEST * hull.size
        for _ in range(60):
            middle = 0.5 * (smallest + largest)
            beyond = hull.share(hull.distance(at + middle * toward, np.zeros(4)))
            smallest, largest = (middle, largest) if beyond < wanted else (smallest, middle)
        force = smallest * toward
        samples.append(Sample(pressure=pressure, force=(force[0], force[1]), beyond=wanted))
    return samples


def truth(scenario: Scenario, sample: Sample) -> tuple[Array, tuple[float, float, float]]:
    """Return where the tip of a rig is (2,) m at a true pressure and force, and what is read.

    The arm is inflated first and loaded then, in steps.
    """
    times = np.arange(PATH.size, dtype=np.float64)
    pressure, force = np.full(PATH.size, sample.pressure), PATH[:, None] * np.array(sample.force)
    course, _ = apply_effects(scenario, times, pressure, {})
    shape = equilibrium_shape(chain_of(scenario, course, times, force))
    read_pressure, read_force = read_sensors(scenario, pressure[-1:], force[-1:])
    return np.array([shape.x[-1, -1], shape.y[-1, -1]]), (float(read_pressure[0]), *read_force[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What the estimator said of a sample: refused by a reason, flagged, or neither.

    error, std: of the tip's x and y, m; None where it was refused.
    """

    rig: str
    beyond: float
    reason: str
    flagged: bool
    error: tuple[float, float] | None = None
    std: tuple[float, float] | None = None

    @property
    def covered(self) -> bool:
        """Whether both coordinates of the tip are within 3 sigma."""
        assert self.error is not None and self.std is not None
        return all(abs(e) < 3.0 * s for e, s in zip(self.error, self.std, strict=True))


def ask(
    estimator: Estimator, readings: tuple[float, float, float], random: np.random.Generator
) -> Outcome:
    """Return what comes of noisy readings of pressure and force, led there in steps."""
    pressure, force_x, force_y = readings
    sensors = estimator.arm.sensors
    pressure += sensors.pressure_std * random.standard_normal()
    noise = sensors.force_std * random.standard_normal(2)
    state, outcome = EstimatorState(), None
    for step, share in enumerate(PATH, start=1):
        stamp_ns = 100_000_000 * step
        wrench = WrenchReading(
            stamp_ns=stamp_ns,
            force_x=share * force_x + noise[0],
            force_y=share * force_y + noise[1],
            moment=0.0,
            frame_id=estimator.settings.frame_id,
        )
        state, _ = estimator.step(state, wrench)
        reading = PressureReading(stamp_ns=stamp_ns, pressure=pressure)
        state, outcome = estimator.step(state, reading)
    return outcome


def answers(name: str, count: int) -> list[Answer]:
    """Return what the estimator says of samples on a rig."""
    scenario = rig(name)
    estimator, random = Estimator(arm=calibrated(scenario)), np.random.default_rng(RIGS[name][0])
    found = []
    for sample in draw_samples(estimator.arm, count, random):
        low, high = scenario.arm.pressure_range
        near = sample.beyond <= 0.5 and low <= sample.pressure <= high
        if near:
            tip, readings = truth(scenario, sample)
        else:
            readings = sample.pressure, *sample.force
        outcome = ask(estimator, readings, random)
        if isinstance(outcome, Refusal):
            found.append(
                Answer(rig=name, beyond=sample.beyond, reason=outcome.reason, flagged=False)
            )
            continue
        assert isinstance(outcome, ShapeEstimate)
        if not near:  # answered, where it should not have been
            tip = np.full(2, math.inf)
        error = np.array(outcome.shape.tip[:2]) - tip
        std = np.sqrt(np.diag(outcome.tip_covariance)[:2])
        found.append(
            Answer(
                rig=name,
                beyond=sample.beyond,
                reason='',
                flagged=bool(outcome.warnings),
                error=(float(error[0]), float(error[1])),
                std=(float(std[0]), float(std[1])),
            )
        )
    return found


def summary(found: list[Answer]) -> dict[str, float]:
    """Return what answers come to; lengths in mm."""
    flagged = [answer for answer in found if not answer.reason and answer.flagged]
    errors = [1000.0 * math.hypot(*answer.error) for answer in flagged if answer.error]
    stds = [1000.0 * math.hypot(*answer.std) for answer in flagged if answer.std]
    return {
        'samples': len(found),
        'refused': sum(bool(answer.reason) for answer in found),
        'flagged': len(flagged),
        'neither': sum(not answer.reason and not answer.flagged for answer in found),
        'covered': float(np.mean([answer.covered for answer in flagged])),
        'median_error_mm': float(np.median(errors)),
        'p95_error_mm': float(np.percentile(errors, 95.0)),
        'median_std_mm': float(np.median(stds)),
    }


def main() -> None:
    """Print a table of the rigs."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument(
        '--samples', type=int, default=1000, help='samples of all rigs (default: 1000)'
    )
    parser.add_argument('--rigs', nargs='+', choices=RIGS, default=list(RIGS), metavar='NAME')
    parser.add_argument('--json', action='store_true')
    arguments = parser.parse_args()
    each = math.ceil(arguments.samples / len(arguments.rigs))
    found = {name: answers(name, each) for name in arguments.rigs}
    rows = {name: summary(ones) for name, ones in found.items()}
    rows['all'] = summary([answer for ones in found.values() for answer in ones])
    if arguments.json:
        sys.stdout.write(json_text(rows))
        return
    table = Table(title='Outside the domain')
    for name in ('rig', *rows['all']):
        table.add_column(name, justify='left' if name == 'rig' else 'right')
    for name, row in rows.items():
        table.add_row(name, *(f'{value:.4g}' for value in row.values()))
    Console(width=120).print(table)


if __name__ == '__main__':
    main()
