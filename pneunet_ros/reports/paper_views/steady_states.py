"""Steady states of a run: means over intervals of nearly constant pressure and load.

A hold of a staircase is one long state, a slow ramp many short ones. Mean targets correspond to
the mean load, because linear changes cancel. The fitted displacements of camera and target
placement are subtracted, so that the position of the arm remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import TargetSightings, unseen_targets
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.linearization import FittedRun
from pneunet_ros.measurement.steady_states import steady_segments
from pneunet_ros.model.arm import Arm

# Display only. No figure of acceptance/sweep.py moves when one of these is halved or doubled.
SHARE_OF_SPAN = 0.01  # of the largest reading: largest range of a steady state
NOISE_SPAN = 8.0  # sigma: largest range of readings of one value
HOLD_SHARE = 0.3  # least duration of a hold, relative to the longest state
FEWEST_HOLDS = 4  # fewest holds for using them alone
COVERED = 0.8  # share of the pressure range that the holds must span


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteadyState:
    """Average of successive frames of a run under nearly the same load.

    pressure (Pa), force (2,) N and moment (N m) are means of the readings; inputs: the true
    inputs, as for one frame. x, y (targets,) m are means over the frames in which a target was
    seen, minus the fitted disturbances; `count` (targets,): number of these frames; NaN for a
    target never seen.
    """

    run: str
    frames: int
    pressure: float
    force: Array
    moment: float
    inputs: Inputs
    x: Array
    y: Array
    count: Array

    def sightings(self, target_std: float) -> TargetSightings:
        """Return the mean targets as sightings of a tracker, with the std of the mean."""
        unseen = unseen_targets(0, self.x.size)
        std = np.where(self.count > 0, target_std / np.sqrt(np.maximum(self.count, 1)), np.nan)
        rest = {name: getattr(unseen, name) for name in ('u', 'v', 'area', 'major', 'minor')}
        return TargetSightings(stamp_ns=0, x=self.x, y=self.y, std=std, angle=unseen.angle, **rest)


def find_steady_states(fitted: FittedRun, arm: Arm) -> tuple[SteadyState, ...]:
    """Return all steady states of a run of a fit, in order of time; arm: the fitted arm."""
    noise, points = arm.sensors, arm_points(fitted, arm)
    run = fitted.run
    readings = np.column_stack([run.frame_pressure, run.force])
    stds = np.array([noise.pressure_std, noise.force_std, noise.force_std])
    largest = np.max(np.abs(readings), axis=0)
    largest[1:] = largest[1:].max()
    allowed = np.maximum(NOISE_SPAN * stds, SHARE_OF_SPAN * largest)
    return tuple(
        average(fitted, points, start, stop) for start, stop in steady_segments(readings, allowed)
    )


def arm_points(fitted: FittedRun, arm: Arm) -> Array:
    """Return the best known positions of the targets, (frames, 2, targets) m; NaN: unknown."""
    measured = fitted.run.points - fitted.disturbance
    return np.stack(arm.true_points(measured[:, 0], measured[:, 1]), axis=1)


def average(fitted: FittedRun, points: Array, start: int, stop: int) -> SteadyState:
    """Return frames start to stop - 1 as one; points (frames, 2, targets) m."""
    run, frames = fitted.run, slice(start, stop)
    seen = np.isfinite(points[frames]).all(axis=1)
    count = seen.sum(axis=0).astype(np.float64)
    means = [
        np.where(seen, values, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan)
        for values in (points[frames, 0], points[frames, 1])
    ]
    return SteadyState(
        run=run.name,
        frames=stop - start,
        pressure=float(run.frame_pressure[frames].mean()),
        force=run.force[frames].mean(axis=0),
        moment=float(run.moment[frames].mean()),
        inputs=replace(
            fitted.inputs.subset(np.array([(start + stop) // 2])),
            pressure=fitted.inputs.pressure[frames].mean(keepdims=True),
            loads=fitted.inputs.loads[frames].mean(axis=0, keepdims=True),
        ),
        x=means[0],
        y=means[1],
        count=count,
    )


def longest_states(states: Sequence[SteadyState]) -> list[SteadyState]:
    """Remove short states between holds, if the holds span the pressures."""
    least = HOLD_SHARE * max((state.frames for state in states), default=0)
    holds = [state for state in states if state.frames >= least]
    if len(holds) >= FEWEST_HOLDS:
        spans = [np.ptp([state.pressure for state in group]) for group in (holds, states)]
        if spans[0] >= COVERED * spans[1]:
            return holds
    return list(states)


def thin(states: Sequence[SteadyState], count: int) -> list[SteadyState]:
    """Select at most this many states, evenly over pressure, preferring the longest."""
    if not states:
        return []
    places = np.array([state.pressure for state in states])
    half = 0.5 * float(np.ptp(places)) / max(count - 1, 1)
    chosen: list[int] = []
    for target in np.linspace(places.min(), places.max(), count).tolist():
        close = np.flatnonzero(np.abs(places - target) <= half).tolist()
        free = [place for place in close if place not in chosen]
        if free:
            distance = np.abs(places - target)
            chosen.append(max(free, key=lambda at: (states[at].frames, -distance[at])))
    return sorted((states[at] for at in chosen), key=lambda steady_state: steady_state.pressure)


def predict_states(arm: Arm, states: Sequence[SteadyState], arclength: Array) -> Array:
    """Predict the arm under these loads, (states, 6, arclength); NaN without an equilibrium.

    Fields as in `solver.interpolation.at_stations`; arclength in m.
    """
    if not states:
        return np.zeros((0, 6, arclength.size))
    series, all_inputs = ForwardModel(arclength), [steady_state.inputs for steady_state in states]
    past = [inputs.histories for inputs in all_inputs if inputs.histories is not None]
    inputs = Inputs(
        pressure=np.concatenate([inputs.pressure for inputs in all_inputs]),
        loads=np.concatenate([inputs.loads for inputs in all_inputs]),
        histories=tuple(map(np.concatenate, zip(*past, strict=True))) if past else None,
    )
    solved = series.solve(arm, inputs)
    return np.where(solved[:, None, None], series.fields, np.nan)
