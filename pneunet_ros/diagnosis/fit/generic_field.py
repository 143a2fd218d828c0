"""Generic fields: smooth curvature, stretch and rotation over arclength, times regressors.

Generic fields represent all model errors that no effect of the library describes. They are used
for the size of negligible departures, for lack-of-fit tests, and for localization.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import itertools

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import Inputs, runs_in_order
from pneunet_ros.model.arm import Arm

PAST = 'past'  # represents the one over the second time constant
STRETCH_REGRESSORS = ('1', 'p', 'p^2', 't', PAST, 'F1', 'F2')
ROTATION_REGRESSORS = ('1', 'p', 't', PAST, 'F1', 'F2')
SINGLE_REGRESSORS = ('p', 'F1', 'F2')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regressors:
    """Inputs of the arm in every frame of all runs, scaled to about one: names and numbers.

    arclength (targets,) and knots (k,) s / l; clamp_angle rad; values: per run (frames, n);
    progress: per run (frames,) from 0 at its start to 1 at its end. Static frames have no time and
    no past.
    """

    arclength: Array
    knots: Array
    clamp_angle: float
    names: tuple[str, ...]
    values: tuple[Array, ...]
    progress: tuple[Array, ...]

    @classmethod
    def of(
        cls, arm: Arm, runs: Sequence[RecordingData], all_inputs: Sequence[Inputs]
    ) -> Regressors:
        """Collect the frames; the maximum pressure carries over between runs as histories do."""
        low, high = arm.table_range
        span = high - low
        load = max((float(np.abs(item.loads).max()) for item in all_inputs), default=0.0) or 1.0
        reached_by, highest = [run.pressure for run in runs], -np.inf
        for which, goes_on in runs_in_order(runs):
            before = highest if goes_on else -np.inf
            reached_by[which] = np.maximum(np.maximum.accumulate(runs[which].pressure), before)
            highest = float(reached_by[which][-1])
        tables, progress = {}, {}
        for which, (run, inputs) in enumerate(zip(runs, all_inputs, strict=True)):
            reached = reached_by[which]
            below = (reached - run.pressure)[run.reading] > LINEARIZATION.unloading * span
            time = run.progress
            progress[which] = time
            pressure = (inputs.pressure - low) / span
            f1, f2 = inputs.loads[:, 0] / load, inputs.loads[:, 1] / load
            tables[which] = {
                '1': np.ones_like(time),
                'p': pressure,
                'p^2': pressure**2,
                't': np.zeros_like(time) if run.static else 2.0 * time - 1.0,
                **{past_name(m): high_pass(run, m) / span for m in LINEARIZATION.time_constants},
                'F1': f1,
                'F2': f2,
                'p F1': pressure * f1,
                'p F2': pressure * f2,
                'F1^2': f1 * f1,
                'F2^2': f2 * f2,
                'F1 F2': f1 * f2,
                'F1 below highest p': below * f1,
                'F2 below highest p': below * f2,
            }
        in_order = [tables[which] for which in range(len(runs))]
        return cls(
            arclength=arm.target_arclength / arm.length,
            knots=arm.intrinsic_curvature.arclength,
            clamp_angle=arm.clamp_angle,
            names=tuple(in_order[0]) if in_order else (),
            values=tuple(np.column_stack(list(table.values())) for table in in_order),
            progress=tuple(progress[which] for which in range(len(runs))),
        )

    def columns(self, which: int, names: Sequence[str]) -> Array:
        """Return the regressors of these names in a run, (frames, n)."""
        return self.values[which][:, [self.names.index(name) for name in names]]


def past_name(time_constant: float) -> str:
    """Return the name of the regressor for the past over a time (s)."""
    return f'past {time_constant:g} s'


def high_pass(run: RecordingData, time_constant: float) -> Array:
    """Return pressure (Pa) minus its first-order low-pass at the frames; zero if static.

    Exact for piecewise linear pressure.
    """
    if run.static:
        return np.zeros(len(run.stamp_ns))
    steps = np.diff(run.reading_stamp_ns) / NANOSECONDS_PER_SECOND
    decay = np.exp(-steps / time_constant)
    change, left = np.diff(run.pressure), np.ones_like(steps)  # of a step, at once
    np.divide(time_constant * (1.0 - decay), steps, out=left, where=steps > 0.0)
    gain = change * left
    pairs = zip(decay.tolist(), gain.tolist(), strict=True)
    beside = itertools.accumulate(pairs, lambda left, pair: pair[0] * left + pair[1], initial=0.0)
    return np.fromiter(beside, np.float64, steps.size + 1)[run.reading]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fields:
    """Response of the points of a run to unit fields, (frames, 2 targets, n) m.

    generic: shapes over the arm times regressors, common to all runs, with names. shapes:
    curvature modes and a shift of the image; weights (frames, windows): of time windows;
    regressors (frames, k): for tests of single targets.
    """

    names: tuple[str, ...]
    generic: Array
    shapes: Array
    weights: Array
    regressors: Array

    def windows(self) -> Array:
        """Shapes in time windows of this run."""
        return products(self.shapes, self.weights)

    def single(self) -> Array:
        """Fields of single targets, times pressure and load."""
        return products(np.eye(self.shapes.shape[1])[None], self.regressors)


def products(shapes: Array, factors: Array) -> Array:
    """Return every shape (frames, points, m) times every factor (frames, n), (.., points, m n)."""
    both = shapes[:, :, :, None] * factors[:, None, None, :]
    return both.reshape(*both.shape[:2], -1)


def fields_of(regressors: Regressors, which: int, knots: Array, theta: Array) -> Fields:
    """Return the fields of a run.

    knots (frames, 2 targets, knots): response of points to a curvature of 1/m at each knot; theta
    (frames, targets) rad.
    """
    frames, targets = theta.shape
    curvature = knots @ legendre.legvander(2.0 * regressors.knots - 1.0, LINEARIZATION.modes)
    stretch = stretch_fields(
        regressors.arclength, theta, regressors.clamp_angle, LINEARIZATION.modes
    )
    # Rotation about the clamp: the position relative to it, turned by a right angle.
    rotation = np.concatenate([-stretch[:, targets:, :1], stretch[:, :targets, :1]], axis=1)
    names, parts, past = [], [], past_name(LINEARIZATION.time_constants[1])
    for label, shapes, regressor_names in (
        ('curvature', curvature, regressors.names[1:]),
        ('stretch', stretch, STRETCH_REGRESSORS),
        ('rotation', rotation, ROTATION_REGRESSORS),
    ):
        functions = [past if name == PAST else name for name in regressor_names]
        parts.append(products(shapes, regressors.columns(which, functions)))
        pairs = itertools.product(range(shapes.shape[2]), functions)
        names += [f'{label} {mode} x {function}' for mode, function in pairs]
    shift = np.zeros((frames, 2 * targets, 2))
    shift[:, :targets, 0] = shift[:, targets:, 1] = 1.0
    last = LINEARIZATION.windows - 1
    position = last * regressors.progress[which][:, None]
    return Fields(
        names=tuple(names),
        generic=np.concatenate(parts, axis=2),
        shapes=np.concatenate([curvature[:, :, : LINEARIZATION.modes], shift], axis=2),
        weights=np.maximum(0.0, 1.0 - np.abs(position - np.arange(LINEARIZATION.windows))),
        regressors=regressors.columns(which, SINGLE_REGRESSORS),
    )


def stretch_fields(arclength: Array, theta: Array, clamp_angle: float, count: int) -> Array:
    """Return the response of points to stretch modes, (frames, 2 targets, count), over length.

    arclength (targets,) s / l; theta (frames, targets) rad: the displacement along the tangent is
    integrated by the trapezoidal rule from the clamp, at clamp_angle (rad), to the first target,
    and from target to target.
    """
    arclength = np.concatenate([[0.0], arclength])
    theta = np.insert(theta, 0, clamp_angle, axis=1)
    modes = legendre.legvander(2.0 * arclength - 1.0, count - 1)
    parts = []
    for tangent in (np.cos(theta), np.sin(theta)):
        density = tangent[:, :, None] * modes
        steps = 0.5 * (density[:, 1:] + density[:, :-1]) * np.diff(arclength)[:, None]
        parts.append(np.cumsum(steps, axis=1))
    return np.concatenate(parts, axis=1)
