"""An arm of the virtual lab for successive experiments that are recorded to files."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import quantities
from pneunet_ros.exploration.experiment_design import Experiment
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_recording import LabMemory
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import LabNoise
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.moment_law import LinearLaw, PiecewiseLinearLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.recordings.lab_files import write_lab

PAUSE = 2.0  # s, from one simulated recording to the next
PLACES, DEGREE = 201, 12  # stations of the curvature of a model, and degree of the polynomials


@dataclass(slots=True, kw_only=True)
class SimulatedArm:
    """The simulated arm of a scenario, with its history; the protocol is not used."""

    scenario: Scenario
    memory: LabMemory | None = None

    def record(self, experiment: Experiment, safe: SafeSet, path: Path) -> None:
        """Write the recording of an experiment, and its truth."""
        start = self.scenario.start
        if self.memory is not None:
            start = self.memory.time + PAUSE
        scenario = replace(
            self.scenario, name=path.stem, start=start, protocol=corners_of(experiment, safe)
        )
        recording = simulate(scenario, self.memory)
        self.memory = recording.memory
        write_lab(recording, path, overwrite=False, on_progress=lambda: None)


def corners_of(experiment: Experiment, safe: SafeSet) -> Corners:
    """Return an experiment, within the safe set, as a protocol of the lab."""
    corners = safe.corners(experiment)
    corners[:, 0] /= experiment.seconds
    share, pressure, x, y = (tuple(column) for column in corners.T.tolist())
    return Corners(
        duration=experiment.seconds, share=share, pressure=pressure, force_x=x, force_y=y
    )


def scenario_of_model(arm: Arm) -> Scenario:
    """Return a model as an arm of the virtual lab, whose solver is independent.

    The curvature along the arm is expanded in Legendre polynomials. RequestError if the lab cannot
    simulate the arm: a moment law other than `piecewise_linear` without a moment offset or
    `linear`, or an effect the lab does not have.
    """
    law = arm.moment_law
    low, high = arm.pressure_range
    if isinstance(law, PiecewiseLinearLaw):
        if law.moment_offset.any():
            raise RequestError(
                f'{arm.name}: the virtual lab cannot simulate moment_law.moment_offset, because '
                'its intrinsic curvature has no jump',
                reason='not_supported',
            )
        law_pressure, law_split, rigidity = law.pressure, law.split, law.rigidity
    elif isinstance(law, LinearLaw):
        law_pressure, law_split = np.array([low, high]), np.full(2, 0.5)
        alpha = law.bending_stiffness / (arm.weight * arm.length**2)
        rigidity = np.full((2, 2), alpha)
    else:
        raise RequestError(
            f'{arm.name}: the virtual lab cannot simulate the moment law {law.kind}',
            reason='unknown_kind',
        )
    table = arm.intrinsic_curvature
    arclength = np.linspace(0.0, 1.0, PLACES)
    curves = np.array([table.at(float(pressure), arclength) for pressure in table.pressure])
    degree = min(DEGREE, 2 * table.arclength.size)
    modes = legendre.legfit(2.0 * arclength - 1.0, curves.T, degree).T
    lab_arm = LabArm(
        name=arm.name,
        length=arm.length,
        weight=arm.weight,
        tip_cap=arm.tip_cap,
        clamp_angle=arm.clamp_angle,
        targets=arm.target_arclength,
        curvature_pressure=table.pressure,
        modes=modes,
        law_pressure=law_pressure,
        split=law_split,
        rigidity=rigidity,
    )
    stds = asdict(arm.sensors)
    noise = LabNoise(**{one.name: stds[one.name] for one in fields(LabNoise) if one.name in stds})
    scenario = Scenario(
        name=arm.name, arm=lab_arm, protocol=Corners(), noise=noise, motion=motion_of_model(arm)
    )
    effects = {
        item.name: {number.name: getattr(item, number.name) for number in quantities(item)}
        for item in arm.effects
    }
    return scenario.with_effects(effects)


def motion_of_model(arm: Arm) -> LabMotion | None:
    """Return weight and inertia of a model for the lab; None if it has neither."""
    gravity, inertia = arm.gravity, arm.inertia
    if inertia is None and not (gravity.x or gravity.y):
        return None
    moving = inertia or Motion()
    return LabMotion(
        gravity_x=gravity.x,
        gravity_y=gravity.y,
        tip_mass=moving.tip_mass,
        damping_time=moving.damping_time,
        inertia=float(inertia is not None),
    )
