"""Accuracy of the estimated delay between film and table, on rendered and tracked films.

    python acceptance/film_delay.py [--films 20] [--seed 1] [--json]

Each film is of the virtual lab's arm: irregular quick steps, half of the arms with hysteresis and
creep, other frame rates, loggers from 20 Hz to 1 kHz, cameras started up to 2 s before or after
the logger. It is written as mp4, tracked as `pneunet track` does it, and the delay estimated from
what the tracker saw. The truth is when the lab took its first frame and its first reading.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
import json
from pathlib import Path
import sys
import tempfile
from typing import Any, ClassVar

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()
    sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.clock_delay import ClockDelay
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.json_text import plain
from pneunet_ros.files.scenario_file import load_lab
from pneunet_ros.lab.protocols import Protocol
from pneunet_ros.lab.scenario import lab_effect, Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.lab.timeline import Leg, Timeline, timeline
from pneunet_ros.model.starting_arm import starting_arm
from pneunet_ros.offline.film import delay_of
from pneunet_ros.offline.track import look_ahead, track_steps
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.tables.table_reader import ImportRequest, read_table
from pneunet_ros.vision.tracker import Tracker, Tracking
from support.finger_film import Bench, write_film, write_table

TARGETS = np.arange(12) * 0.01  # m
LARGEST = 60e3  # Pa
SECONDS = 20.0
FRAME_RATES, READING_RATES = (12.0, 15.0, 25.0), (20.0, 50.0, 100.0, 1000.0)  # Hz


@dataclass(frozen=True, slots=True, kw_only=True)
class IrregularSteps(Protocol):
    """Steps to pressures (Pa) at times (s) that no rule gives."""

    kind: ClassVar[str] = 'irregular_steps'
    levels: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    holds: tuple[float, ...] = ()

    def timeline(self) -> Timeline:
        """Return the steps, after a rest and before another."""
        legs = [Leg(1.5, 0.0)]
        for level, step, hold in zip(self.levels, self.steps, self.holds, strict=True):
            legs += [Leg(step, level), Leg(hold, level)]
        return timeline(legs, loaded=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A film with what was hidden and what was found; times in s."""

    seed: int
    frame_rate: float
    reading_rate: float
    effects: tuple[str, ...]
    true: float
    found: float
    std: float
    trouble: str

    @property
    def deviation(self) -> float:
        """Error in standard errors."""
        return (self.found - self.true) / self.std

    @property
    def share(self) -> float:
        """Standard error in frames."""
        return self.std * self.frame_rate


def scenario_of(seed: int) -> tuple[Scenario, Bench]:
    """Draw an arm, what is done to it, and how it is filmed."""
    random = np.random.default_rng(seed)
    holds = random.uniform(0.6, 2.0, 12)
    steps = random.uniform(0.1, 0.5, 12)
    holds *= (SECONDS - 1.5 - steps.sum()) / holds.sum()
    effects = ()
    if seed % 2:
        effects = (
            lab_effect('hysteresis', {'width': random.uniform(500.0, 4000.0), 'richness': 1.0}),
            lab_effect('creep', {'amplitude': random.uniform(0.02, 0.12), 'time_constant': 8.0}),
        )
    lab = replace(load_lab(share_path('scenarios/lab_arm.yaml')).arm, targets=TARGETS)
    scenario = Scenario(
        name=f'film {seed}',
        seed=seed,
        arm=lab,
        effects=effects,
        protocol=IrregularSteps(
            levels=(*(random.uniform(0.05, 1.0, 11) * LARGEST).tolist(), 0.0),
            steps=tuple(steps.tolist()),
            holds=tuple(holds.tolist()),
        ),
        rates=Rates(
            frames=float(random.choice(FRAME_RATES)), pressure=float(random.choice(READING_RATES))
        ),
    )
    return scenario, Bench(camera_first=random.uniform(-1.0, 2.0), seed=seed)


def try_film(seed: int, folder: Path) -> Trial:
    """Make a film and its table, and estimate the delay between them."""
    scenario, bench = scenario_of(seed)
    recording = simulate(scenario)
    film, table = folder / 'film.mp4', folder / 'table.csv'
    true = write_film(recording, film, bench)
    write_table(recording, table, bench, forces=False)
    found = estimate(film, table)
    return Trial(
        seed=seed,
        frame_rate=scenario.rates.frames,
        reading_rate=scenario.rates.pressure,
        effects=tuple(effect.name for effect in scenario.effects),
        true=true,
        found=found.delay,
        std=found.std,
        trouble=found.trouble,
    )


def estimate(film: Path, table: Path) -> ClockDelay:
    """Track a film and estimate its delay, as the verb does."""
    arm = starting_arm('finger', 0.112, 0.17, TARGETS, LARGEST)
    tracker = Tracker(arm, load_camera(share_path('config/camera.yaml')))
    stream = open_images(film, SourceRequest(camera_info='none'))
    start, _ = look_ahead(stream, tracker, lambda: None)
    steps = track_steps(stream, tracker, start=start)
    trackings = [step.outcome for step in steps if isinstance(step.outcome, Tracking)]
    return delay_of(trackings, read_table(table, ImportRequest())[0])


def summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return how often the truth lies within two standard errors, and how small they are."""
    known = [trial for trial in trials if not trial.trouble]
    shares = np.array([trial.share for trial in known])
    errors = np.array([trial.found - trial.true for trial in known])
    return {
        'films': len(trials),
        'refused': len(trials) - len(known),
        'within_two_sigma': sum(abs(trial.deviation) <= 2.0 for trial in known),
        'largest_deviation': max((abs(trial.deviation) for trial in known), default=None),
        'sigma_frames_median': float(np.median(shares)) if known else None,
        'sigma_frames_largest': float(np.max(shares)) if known else None,
        'within_a_fifth_of_a_frame': int(np.count_nonzero(shares <= 0.2)),
        'rms_error_s': float(np.sqrt(np.mean(errors**2))) if known else None,
    }


def main() -> None:
    """Run the trials and print what they came to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--films', type=int, default=20)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--json', action='store_true')
    arguments = parser.parse_args()
    trials = []
    for seed in range(arguments.seed, arguments.seed + arguments.films):
        with tempfile.TemporaryDirectory() as folder:
            trials.append(try_film(seed, Path(folder)))
        if not arguments.json:
            print(line_of(trials[-1]), flush=True)
    found = summary(trials)
    if arguments.json:
        print(json.dumps(plain({'summary': found, 'films': [asdict(one) for one in trials]})))
        return
    for name, value in found.items():
        print(f'{name}: {value:.3g}' if isinstance(value, float) else f'{name}: {value}')


def line_of(trial: Trial) -> str:
    """Say what came of a film."""
    head = (
        f'film {trial.seed}: {trial.frame_rate:g} frames/s, {trial.reading_rate:g} readings/s, '
        f'{" and ".join(trial.effects) or "no effect"}: '
    )
    if trial.trouble:
        return f'{head}{trial.trouble}'
    return (
        f'{head}{1e3 * (trial.found - trial.true):+.1f} ms, {trial.deviation:+.2f} sigma, sigma '
        f'{trial.share:.3f} of a frame'
    )


if __name__ == '__main__':
    main()
