"""A recording of an oscillating arm, with the equilibrium at each of its readings.

At constant pressure, the arm was plucked, and the recording starts at its release.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.measurement.between_readings import interpolate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.reading_filter import without_reading_noise
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.collocation import prepare
from pneunet_ros.solver.columns import CURVATURE, join_ends, PANEL_WIDTH, THETA

LARGE_SWING = 0.5  # share of the largest swing; the arm is free after the last such frame
Solved = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingingRun:
    """A recording with the equilibrium at each of its readings.

    stamp_ns (readings,); solved: tables of the rod, (readings, ...) each; equilibrium
    (readings, 2, targets) m: the targets in equilibrium; theta_and_curvature (readings, 2,
    targets) rad and 1/m there; reading (frames,) of each frame; points (frames, 2, targets)
    m. plucked: whether the pressure is constant.
    """

    name: str
    stamp_ns: Stamps
    solved: Solved
    equilibrium: Array
    reading: Stamps
    points: Array
    theta_and_curvature: Array
    plucked: bool

    @property
    def deviation(self) -> Array:
        """Measured targets relative to equilibrium, (frames, 2, targets) m, NaN where not seen."""
        return self.points - self.equilibrium[self.reading]

    def part(self, frames: slice, readings: slice) -> SwingingRun:
        """Return the recording restricted to these frames and readings."""
        panels, ends, nodes = self.solved
        return replace(
            self,
            stamp_ns=self.stamp_ns[readings],
            solved=(panels[readings], ends[readings], nodes[readings]),
            equilibrium=self.equilibrium[readings],
            reading=self.reading[frames] - (readings.start or 0),
            points=self.points[frames],
            theta_and_curvature=self.theta_and_curvature[readings],
        )

    def beginning_with(self, other: SwingingRun) -> SwingingRun:
        """Return the recording from the first frame of another recording on."""
        begin = other.stamp_ns[other.reading[0]]
        frame = int(np.searchsorted(self.stamp_ns[self.reading], begin))
        if len(self.reading) - frame != len(other.reading):
            return other
        return self.starting_at(frame)

    def starting_at(self, frame: int) -> SwingingRun:
        """Return the recording starting at the reading of a frame."""
        return self.part(slice(frame, None), slice(int(self.reading[frame]), None))

    def centered(self, values: Array) -> Array:
        """Subtract from each coordinate of (frames, 2, targets, ...) its mean; NaN if never seen.

        The camera position is not motion, and the state at the release is not known yet.
        """
        left_out = ~np.isfinite(self.points)
        left_out[self.plucked * (self.reading == 0)] = True
        seen = values.copy()
        seen[left_out] = np.nan
        times_seen = np.maximum((~left_out).sum(axis=0), 1)
        mean = np.nansum(seen, axis=0).T / times_seen.T
        return np.asarray(seen - mean.T)


def swinging_run(arm: Arm, run: RecordingData) -> SwingingRun:
    """Solve the equilibrium at every reading and frame of a recording."""
    run = without_reading_noise(run, arm.sensors).at_instants(arm.frame_delay)
    stamps, count = run.reading_stamp_ns, len(run.reading_stamp_ns)
    loads = np.zeros((count, 3))
    if run.loaded:
        known = (run.stamp_ns, run.load)
        if run.wrench_stamp_ns is not None and run.wrench is not None:
            known = (run.wrench_stamp_ns, run.wrench)
        loads = np.column_stack([interpolate(stamps, known[0], part) for part in known[1].T])
    unseen = np.full((count, arm.target_arclength.size), np.nan)
    every = replace(
        run,
        stamp_ns=stamps,
        reading=np.arange(count),
        force=loads[:, :2],
        moment=loads[:, 2],
        x=unseen,
        y=unseen,
        tip_pose=None,
        gravity=run.gravity_at(stamps),
        wrench_stamp_ns=None,
        wrench=None,
    )
    prompt_effects = tuple(item for item in arm.effects if not item.frame_delay)
    prompt = replace(arm, effects=prompt_effects, covariance=None)
    (inputs,) = inputs_of(prompt, [every])
    model = ForwardModel(arm.target_arclength)
    if not model.solve(arm, inputs).all():
        raise RequestError(
            f'{run.name}: at some readings the arm has no equilibrium; cut the recording to '
            'pressures and loads of the calibrated domain',
            reason='no_equilibrium',
        )
    rods = inputs.rods(arm)
    ends = join_ends(rods.clamp, inputs.loads)
    panels = np.empty((count, model.nodes.shape[1] - 1, PANEL_WIDTH))
    for index, table in enumerate(panels):
        sections, rotation = rods.sections[index], rods.rotation[index]
        prepare(rods.length, sections, rods.knots, rotation, ends[index], model.counts, table)
    is_plucked = has_constant_inputs(run, loads, arm)
    swinging = SwingingRun(
        name=run.name,
        stamp_ns=stamps,
        solved=(panels, ends, model.nodes.copy()),
        equilibrium=model.points,
        reading=run.reading,
        points=run.points,
        theta_and_curvature=model.fields[:, [THETA, CURVATURE]],
        plucked=is_plucked,
    )
    return crop_to_release(swinging) if is_plucked else swinging


def has_constant_inputs(run: RecordingData, loads: Array, arm: Arm) -> bool:
    """Whether pressure and loads (readings, 3) are constant, so the arm must have been plucked."""
    reach, noise = 2.0 * run.idle_reach(), arm.sensors
    known = (
        (run.pressure, noise.pressure_std),
        (loads[:, :2], noise.force_std),
        (loads[:, 2], noise.moment_std),
    )
    return all(float(np.max(np.ptp(values, axis=0))) <= reach * std for values, std in known)


def crop_to_release(run: SwingingRun) -> SwingingRun:
    """Return a recording from the last frame of a large swing on.

    Raises RequestError if fewer than two frames show targets, or fewer than two after the release.
    """
    distance = np.hypot(*run.deviation.transpose(1, 0, 2))
    seen = np.isfinite(distance).any(axis=1)
    if np.count_nonzero(seen) < 2:
        raise RequestError(
            f'{run.name}: fewer than two frames show targets; record the arm while it swings',
            reason='too_few_frames',
        )
    mean_distance = np.zeros(len(distance))
    mean_distance[seen] = np.nanmean(distance[seen], axis=1)
    large = np.flatnonzero(mean_distance[:-1] >= LARGE_SWING * mean_distance.max())
    first = int(large[-1]) + 1 if large.size else len(distance)
    if np.count_nonzero(seen[first + 1 :]) < 2:
        raise RequestError(
            f'{run.name}: at constant pressure the arm does not swing freely: pluck it, let it go '
            'and record 20 s',
            reason='not_in_motion',
        )
    return run.starting_at(first)
