"""Generic fields: smooth curvature, stretch and turn over arclength, times what the arm feels.

They stand for all that no effect of the table says. Three uses: how large a departure is harmless,
whether anything is left (omnibus test), and where.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import itertools

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from scipy.signal import lfilter

CURVATURE_MODES, STRETCH_MODES = 4, 3  # Legendre polynomials along the arm
MEMORIES = (0.3, 3.0, 30.0)  # s, how long what was before is felt
WINDOWS = 10  # of a run, in time
WINDOW_MODES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regressors:
    """What the arm feels in every frame of all runs, scaled to about one: names and numbers.

    functions: per run (frames, n).
    """

    arclength: Array
    knots: Array
    names: tuple[str, ...]
    functions: tuple[Array, ...]
    progress: tuple[Array, ...]

    @classmethod
    def of(
        cls, arm: Arm, runs: Sequence[RecordingData], all_inputs: Sequence[Inputs]
    ) -> Regressors:
        """Collect it, runs in the order of their stamps."""
        low, high = arm.pressure_range
        largest = (
            max((float(np.abs(inputs.loads).max()) for inputs in all_inputs), default=0.0) or 1.0
        )
        span = high - low
        order = sorted(range(len(runs)), key=lambda which: int(runs[which].reading_stamp_ns[0]))
        top, out, progress = -np.inf, {}, {}
        names: list[str] = []
        for which in order:
            run, inputs = runs[which], all_inputs[which]
            time = (run.stamp_ns - run.stamp_ns[0]) / max(int(np.ptp(run.stamp_ns)), 1)
            pressure = (inputs.pressure - low) / span
            f1, f2 = inputs.loads[:, 0] / largest, inputs.loads[:, 1] / largest
            past = [behind(run, memory) / span for memory in MEMORIES]
            reached = np.maximum(np.maximum.accumulate(run.pressure), top)
            top = float(reached[-1])
            softer = ((reached - run.pressure)[run.reading] > 0.02 * span).astype(np.float64)
            table = {
                '1': np.ones_like(time),
                'p': pressure,
                'p^2': pressure**2,
                't': 2.0 * time - 1.0,
                **{f'past {m:g} s': values for m, values in zip(MEMORIES, past, strict=True)},
                'F1': f1,
                'F2': f2,
                'p F1': pressure * f1,
                'p F2': pressure * f2,
                'F1^2': f1 * f1,
                'F2^2': f2 * f2,
                'F1 F2': f1 * f2,
                'F1 after more': softer * f1,
                'F2 after more': softer * f2,
            }
            names = list(table)
            out[which] = np.column_stack(list(table.values()))
            progress[which] = time
        return cls(
            arclength=arm.target_arclength / arm.length,
            knots=arm.intrinsic_curvature.arclength,
            names=tuple(names),
            functions=tuple(out[which] for which in range(len(runs))),
            progress=tuple(progress[which] for which in range(len(runs))),
        )

    def columns(self, which: int, names: Sequence[str]) -> Array:
        """Return some of the functions in a run, (frames, n)."""
        return self.functions[which][:, [self.names.index(name) for name in names]]


def behind(run: RecordingData, memory: float) -> Array:
    """Return by how much (Pa) the pressure is before its own past, at the frames."""
    seconds = (run.reading_stamp_ns - run.reading_stamp_ns[0]) / NANOSECONDS_PER_SECOND
    step = max(float(np.median(np.diff(seconds))), 1e-3) if seconds.size > 1 else 1.0
    grid = np.arange(0.0, seconds[-1] + step, step)
    pressure = np.interp(grid, seconds, run.pressure)
    decay = np.exp(-step / memory)
    followed, _ = lfilter([1.0 - decay], [1.0, -decay], pressure, zi=[decay * pressure[0]])
    felt: Array = np.interp(seconds, grid, pressure - followed)[run.reading]
    return felt


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fields:
    """How points of a run answer to unit fields, (frames, 2 targets, n) m.

    generic: over what the arm feels, shared by all runs, with names. shapes: curvature modes and a
    move of the whole picture; hats (frames, windows): windows of time; felt (frames, k): what
    single targets are tested with.
    """

    names: tuple[str, ...]
    generic: Array
    shapes: Array
    hats: Array
    felt: Array

    def windows(self) -> Array:
        """Shapes in windows of time of this run."""
        frames, points = self.shapes.shape[:2]
        both = self.shapes[:, :, :, None] * self.hats[:, None, None, :]
        return both.reshape(frames, points, -1)

    def single(self) -> Array:
        """Every target for itself, with what the arm feels."""
        frames, points = self.shapes.shape[:2]
        both = np.eye(points)[None, :, :, None] * self.felt[:, None, None, :]
        return both.reshape(frames, points, -1)


STRETCH_FUNCTIONS = ('1', 'p', 'p^2', 't', 'past 3 s', 'F1', 'F2')
TURN_FUNCTIONS = ('1', 'p', 't', 'past 3 s', 'F1', 'F2')
SINGLE_FUNCTIONS = ('p', 'F1', 'F2')


def fields_of(around: Regressors, which: int, knots: Array, theta: Array) -> Fields:
    """Return the fields of a run.

    knots (frames, 2 targets, knots): how points answer to a curvature of 1/m at each knot; theta
    (frames, targets) rad.
    """
    frames, targets = theta.shape
    modes = knots @ legendre.legvander(2.0 * around.knots - 1.0, CURVATURE_MODES - 1)
    stretched = stretches(around.arclength, theta)
    turned = stretched[:, :, :1]  # the way from the clamp, turned by a right angle
    turned = np.concatenate([-turned[:, targets:], turned[:, :targets]], axis=1)
    names, parts = [], []
    for label, shapes, functions in (
        ('curvature', modes, around.names[1:]),
        ('stretch', stretched, STRETCH_FUNCTIONS),
        ('turn', turned, TURN_FUNCTIONS),
    ):
        felt = around.columns(which, functions)
        both = shapes[:, :, :, None] * felt[:, None, None, :]
        parts.append(both.reshape(frames, 2 * targets, -1))
        pairs = itertools.product(range(shapes.shape[2]), functions)
        names += [f'{label} {mode} x {function}' for mode, function in pairs]
    moved = np.zeros((frames, 2 * targets, 2))
    moved[:, :targets, 0] = moved[:, targets:, 1] = 1.0
    hats = np.maximum(
        0.0, 1.0 - np.abs((WINDOWS - 1) * around.progress[which][:, None] - np.arange(WINDOWS))
    )
    return Fields(
        names=tuple(names),
        generic=np.concatenate(parts, axis=2),
        shapes=np.concatenate([modes[:, :, :WINDOW_MODES], moved], axis=2),
        hats=hats,
        felt=around.columns(which, SINGLE_FUNCTIONS),
    )


def stretches(share: Array, theta: Array) -> Array:
    """How points answer to stretch modes, (frames, 2 targets, modes) in units of the length.

    share (targets,) s / l; theta (frames, targets) rad: the way along the tangent, integrated by
    trapezoids from target to target.
    """
    modes = legendre.legvander(2.0 * share - 1.0, STRETCH_MODES - 1)
    out = []
    for tangent in (np.cos(theta), np.sin(theta)):
        density = tangent[:, :, None] * modes
        steps = 0.5 * (density[:, 1:] + density[:, :-1]) * np.diff(share)[:, None]
        whole = np.zeros_like(density)
        whole[:, 1:] = np.cumsum(steps, axis=1)
        out.append(whole)
    return np.concatenate(out, axis=1)
