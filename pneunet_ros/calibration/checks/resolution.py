"""Resolution of targets and pressures: how many parameters the data can determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.calibration.checks.preconditions import has_one_pressure, same_pressure
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.settings import EXPERIMENTS, NOISE_ESTIMATE, RESOLUTION
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import kilopascals
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.moment_law import LinearLaw, PiecewiseLinearLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """Resolution of an arm by recordings.

    shapes: numbers of kappa_p0 along the arm, at most one per knot. pressures: number of distinct
    pressures, loaded or not. constant_pressure: whether there is only one, so that the model is
    not valid at others. law: the kind of moment law that the loaded frames determine. notes: these
    results as sentences; law_notes: sentences on the law, if none was requested.
    """

    shapes: int
    knots: int
    pressures: int
    constant_pressure: bool
    law: str
    notes: tuple[Note, ...]
    law_notes: tuple[Note, ...]

    @property
    def free_shapes(self) -> int | None:
        """Number of curvature shapes if smaller than that of the knots, else None."""
        return self.shapes if self.shapes < self.knots else None


def resolve(
    arm: Arm, unloaded: Sequence[RecordingData], loaded: Sequence[RecordingData]
) -> Resolution:
    """Return the resolution that these recordings of an arm allow."""
    runs = [*unloaded, *loaded]
    seen = np.any([run.seen.any(axis=0) for run in runs], axis=0)
    targets = arm.target_arclength[seen].tolist()
    shapes = count_separated([0.0, *targets], RESOLUTION.resolved_gap * arm.length) - 1
    with_heading = any(run.heading is not None for run in runs)
    shapes = min(max(shapes + with_heading, 1), RESOLUTION.knots)
    pressure = np.sort(np.concatenate([run.frame_pressure for run in runs]))
    pressures = count_separated(pressure.tolist(), same_pressure(arm))
    constant = has_one_pressure(runs, arm)
    notes = describe_shapes(shapes, targets, with_heading)
    notes += describe_pressures(float(np.median(pressure)), pressures, constant)
    frames = sum(len(run.stamp_ns) for run in loaded)
    law, law_notes = PiecewiseLinearLaw.kind, []
    unknowns = len(MOMENT_LAW_PARAMETERS[law].columns)
    if loaded and (frames < NOISE_ESTIMATE.fewest or shapes < unknowns or constant):
        law = LinearLaw.kind
        other = '' if constant else f' (if it does not fit: --law {PiecewiseLinearLaw.kind})'
        law_notes.append(
            Note(
                'the moment law is a single stiffness EI, because there are only data of '
                f'{count_of(range(frames), "loaded frame")} of {count_of(targets, "target")} at '
                f'{count_of(range(pressures), "pressure")}{other}',
                reason='one_stiffness',
            )
        )
    return Resolution(
        shapes=shapes,
        knots=RESOLUTION.knots,
        pressures=pressures,
        constant_pressure=constant,
        law=law,
        notes=tuple(notes),
        law_notes=tuple(law_notes),
    )


def describe_shapes(shapes: int, targets: Sequence[float], with_heading: bool) -> list[Note]:
    """Describe a limited number of curvature values, given targets (m); empty if not limited."""
    seen = count_of(targets, 'target')
    if shapes == 1:
        shown = f'{seen}, {places(targets)}' if targets else 'one heading'
        return [
            Note(
                f'assuming constant curvature along the arm, because the frames show only {shown}',
                reason='constant_curvature',
            )
        ]
    if shapes >= RESOLUTION.knots:
        return []
    heading = ' and a heading of the tip' if with_heading else ''
    return [
        Note(
            f'the curvature along the arm is described by {shapes} numbers, the number of '
            f'well-separated targets beyond the clamp{heading} ({seen} seen)',
            reason='few_shapes',
        )
    ]


def describe_pressures(pressure: float, pressures: int, constant: bool) -> list[Note]:
    """Describe a small number of pressures; empty if enough. pressure (Pa): the median."""
    if constant:
        return [
            Note(
                f'the pressure is {kilopascals(pressure):.3g} kPa throughout: the model has one '
                'row of curvature and is not valid at other pressures',
                reason='one_pressure',
            )
        ]
    if pressures >= EXPERIMENTS.rows:
        return []
    return [
        Note(
            f'only {pressures} pressures were recorded: between them, the curvature is smoothly '
            'interpolated',
            reason='few_pressures',
        )
    ]


def count_separated(values: Sequence[float], distance: float) -> int:
    """Return the number of increasing values that are more than a distance apart."""
    last, count = values[0], 1
    for value in values:
        if value - last > distance:
            last, count = value, count + 1
    return count


def count_of(items: Sequence[object], name: str) -> str:
    """Return a count with its noun in singular or plural."""
    return f'{len(items)} {name}{"" if len(items) == 1 else "s"}'


def places(targets: Sequence[float]) -> str:
    """Return target positions (m) as text for messages."""
    return 'at s = ' + ', '.join(f'{1000.0 * target:.4g}' for target in targets) + ' mm'
