"""Detect frames in which the arm swings, from targets alone, without a model of the arm.

After a quick change an arm swings: its targets follow a damped vibration about a line in time. If
this fits the frames better than a smooth motion with as many parameters, or an undamped vibration,
its frequency and decay are used: the deviation and velocity in every frame then give the amplitude
about equilibrium, as in `measurement.moving_arm.is_settled`, but without a model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.checks.preconditions import check_runs
from pneunet_ros.calibration.noise_estimate import RESTS, white_of_targets
from pneunet_ros.calibration.settings import CALIBRATION, CalibrationSettings, EXPERIMENTS
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import PneunetError, RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, STANDARD_GRAVITY
from pneunet_ros.measurement.dataset import IDLE_SENSOR, RecordingData, SIGMA_OF_MEDIAN, thinned
from pneunet_ros.measurement.moving_arm import WITHIN_95
from pneunet_ros.model.arm import Arm

Flags = npt.NDArray[np.bool_]
Columns = Callable[[Array], Array]  # times (windows, frames) s -> (windows, frames, NUMBERS)

WAYS = 2  # shapes in which targets move: the tip goes along a curve
NUMBERS = 4  # of a vibration about a line, and of each smooth way
FEWEST = NUMBERS + 3  # frames in a window
PERIODS = 1.5  # in a window in which a vibration is sought: no cubic follows so much of one
FREQUENCIES = 48  # that are tried
RATIOS = (0.02, 0.05, 0.1, 0.2)  # of damping to the critical one, that are tried
# Stiffness of the softest arm, of that (alpha) where a search for it begins: such an arm would
# bend under its own weight, in the plane, by 25 times its length if it stayed linear.
SOFTEST = 0.1
CANTILEVER = 3.516  # frequency of its first mode, of sqrt(B / (m l^3))
# Of two decays, in windows: of an arm that creeps, or follows its pressure late.
DECAYS = ((0.05, 0.2), (0.1, 0.4), (0.2, 0.8), (0.4, 1.6))
MOST_WINDOWS = 500  # of a recording in which a vibration is sought, or that are fitted at once
GAIN_STD = 2.0  # of a window by white noise: half the difference of two chi^2 of 2 x WAYS


@dataclass(frozen=True, slots=True, kw_only=True)
class Vibration:
    """A vibration: observed frequency (rad/s), and decay rate (1/s)."""

    frequency: float
    rate: float

    def columns(self, time: Array) -> Array:
        """Return the columns of a line and of both phases of the vibration."""
        decay, turn = np.exp(-self.rate * time), self.frequency * time
        return np.stack([np.ones_like(time), turn, decay * np.cos(turn), decay * np.sin(turn)], -1)

    @property
    def period(self) -> float:
        """Time (s) of a swing."""
        return 2.0 * math.pi / self.frequency


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FramesInMotion:
    """Frames that show the arm in motion, and its vibration.

    moving: one mask (frames,) per recording.
    """

    moving: tuple[Flags, ...]
    vibration: Vibration

    @property
    def count(self) -> int:
        """Number of frames that show the arm in motion."""
        return sum(int(np.count_nonzero(flags)) for flags in self.moving)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return sum(len(flags) for flags in self.moving)

    @property
    def hertz(self) -> float:
        """Frequency (Hz) of the arm."""
        return 1.0 / self.vibration.period

    @property
    def decay_time(self) -> float:
        """Time (s) in which the amplitude falls to 1/e."""
        return 1.0 / self.vibration.rate

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return (
            f'{self.count} of {self.frames} frames show the arm in motion '
            f'({self.hertz:.2g} Hz, decays in {self.decay_time:.2g} s)'
        )

    @property
    def summary(self) -> dict[str, float]:
        """The numbers as JSON."""
        names = ('frames', 'count', 'hertz', 'decay_time')
        return {name: getattr(self, name) for name in names}

    @property
    def left_out(self) -> Note:
        """Describe the frames left out of a static fit, and the remedy."""
        return Note(
            f'{self.sentence}and were left out, because the fit is static. Change pressure and '
            'load slowly, or wait for the arm to settle; calibrate --motion fits mass and '
            'damping to such frames',
            reason='in_motion',
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """Motion of the targets of a recording.

    frame, time (s) and way (m), (n,), (n,) and (n, WAYS): each way is a unit vector of target
    motion, with tip (WAYS, 2) its part for the last target. drives (n, any): pressure and load,
    which move the arm, each over its noise.
    """

    frame: npt.NDArray[np.int64]
    time: Array
    way: Array
    tip: Array
    drives: Array

    @property
    def period(self) -> float:
        """Time (s) from frame to frame."""
        return float(np.median(np.diff(self.time)))

    def windows(self, seconds: float) -> npt.NDArray[np.int64]:
        """Return the frame indices (windows, frames) of every gapless window of this duration."""
        frames = max(FEWEST, round(seconds / self.period) + 1)
        places = np.arange(max(self.time.size - frames + 1, 0))[:, None] + np.arange(frames)
        spans = self.time[places[:, -1]] - self.time[places[:, 0]]
        return np.asarray(places[spans < (frames - 0.5) * self.period])


def frames_in_motion(runs: Sequence[RecordingData], arm: Arm) -> FramesInMotion | None:
    """Return the frames that show an arm in motion; None if no recording shows it swing.

    Skips recordings without usable stamps. Only the length of the arm is used: it bounds the
    period of a soft arm from above.
    """
    slowest = slowest_period(arm.length)
    courses = [course_of(run) for run in runs]
    common = vibration_of([course for course in courses if course is not None], slowest)
    if common is None:
        return None
    noise = white_of_targets([run for run in runs if not run.static]) or 0.0
    moving = [np.zeros(len(run.stamp_ns), np.bool_) for run in runs]
    for flags, course in zip(moving, courses, strict=True):
        if course is not None:  # a load changes how it swings
            own = vibration_of([course], slowest) or common
            flags[course.frame] = ~at_rest(course, own, noise)
    if not any(flags.any() for flags in moving):
        return None
    return FramesInMotion(moving=tuple(moving), vibration=common)


def without_motion(
    arm: Arm, *groups: Sequence[RecordingData]
) -> tuple[list[list[RecordingData]], FramesInMotion | None]:
    """Return recordings without the frames that show the arm in motion, and these frames.

    A recording in which the arm never rests is left out.
    """
    found = frames_in_motion(list(itertools.chain(*groups)), arm)
    if found is None:
        return [[*group] for group in groups], None
    moving = iter(found.moving)
    resting = [[(run, np.flatnonzero(~next(moving))) for run in group] for group in groups]
    return [[run.subset(kept) for run, kept in group if kept.size] for group in resting], found


def checked_at_rest(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    arm: Arm,
    *,
    first: bool = True,
    settings: CalibrationSettings = CALIBRATION,
) -> tuple[list[RecordingData], list[RecordingData], FramesInMotion | None]:
    """Return recordings without the frames in motion, checked by `check_runs`.

    Results of static checks do not apply to a moving arm. A loaded recording that is at rest only
    without its load is left out as well.
    """

    def check(free: Sequence[RecordingData], pulled: Sequence[RecordingData]) -> None:
        few = thinned([*free, *pulled], settings.experiments.most_frames)
        check_runs(few[: len(free)], few[len(free) :], arm, first=first, settings=settings)

    kept, motion = without_motion(arm, unloaded, loaded)
    if motion is not None:  # what rests before its load is there shows none
        idle = {run.name for run in loaded if run.is_idle(arm.sensors)}
        kept[1] = [one for one in kept[1] if one.name in idle or not one.is_idle(arm.sensors)]
    try:
        check(*kept)
    except PneunetError as error:
        if motion is None:
            raise
        check(unloaded, loaded)
        raise RecordingError(
            f'{motion.left_out}. Too few frames are left for a calibration', reason='in_motion'
        ) from error
    return kept[0], kept[1], motion


def course_of(run: RecordingData) -> Course | None:
    """Return the motion of the targets of a recording; None if it is too short."""
    often = run.seen.mean(axis=0) > 0.5
    if run.static or not often.any():
        return None
    points = run.points[:, :, often].reshape(len(run.stamp_ns), -1)
    known = np.isfinite(points).mean(axis=1) > 0.5
    if np.count_nonzero(known) < 2 * FEWEST:
        return None
    beside = points[known] - np.nanmedian(points, axis=0)
    ways = np.linalg.svd(np.nan_to_num(np.diff(beside, axis=0)), full_matrices=False)[2][:WAYS]
    way = np.nan_to_num(beside) @ ways.T
    for frame in np.flatnonzero(~np.isfinite(beside).all(axis=1)):
        seen = np.isfinite(beside[frame])
        way[frame], *_ = np.linalg.lstsq(ways[:, seen].T, beside[frame, seen], rcond=None)
    shown = run.at_instants(0.0)  # a step begins between two readings
    drives = [shown.frame_pressure, *(shown.load.T if run.loaded and not run.load_known else ())]
    return Course(
        frame=np.flatnonzero(known),
        time=freeze((run.instants[known] - run.instants[0]) / NANOSECONDS_PER_SECOND),
        way=freeze(way),
        tip=freeze(ways.reshape(WAYS, 2, -1)[:, :, -1]),
        drives=freeze(np.column_stack([over_noise(values[known]) for values in drives])),
    )


def over_noise(values: Array) -> Array:
    """Return readings (n,) in units of their white noise, or of their resolution."""
    changes = np.abs(np.diff(values))
    noise = SIGMA_OF_MEDIAN * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)
    if noise == 0.0:
        noise = float(np.min(changes, where=changes > 0.0, initial=np.inf))
    return np.asarray((values - values[0]) / noise)


def slowest_period(length: float) -> float:
    """Return the longest plausible swing period (s) of an arm of this length (m)."""
    alpha = SOFTEST * EXPERIMENTS.first_stiffness
    return 2.0 * math.pi / (CANTILEVER * math.sqrt(alpha * STANDARD_GRAVITY / length))


def vibration_of(courses: Sequence[Course], slowest: float) -> Vibration | None:
    """Return the vibration shown by the courses; None if smooth motions explain them as well.

    slowest (s): the longest period of a swing.
    """
    if not courses:
        return None
    shortest = (FEWEST - 1) * max(course.period for course in courses)
    longest = min(0.5 * max(float(course.time[-1]) for course in courses), PERIODS * slowest)
    if longest <= shortest:
        return None
    tried = {
        seconds: [
            Vibration(frequency=2.0 * math.pi * PERIODS / seconds, rate=ratio / seconds)
            for ratio in (2.0 * math.pi * PERIODS * ratio for ratio in RATIOS)
        ]
        for seconds in np.geomspace(shortest, longest, FREQUENCIES).tolist()
    }
    found = []
    for seconds, group in tried.items():
        straight = straight_windows(courses, seconds)
        count = sum(len(one.time) for one in straight)
        gains = gains_of(straight, group)
        found += [(gain, count, one) for gain, one in zip(gains, group, strict=True)]
    gain, windows, best = max(found, key=lambda item: item[0])
    by_noise = -NormalDist().inv_cdf(IDLE_SENSOR.chance / len(found)) * GAIN_STD
    if not gain > by_noise * math.sqrt(windows):
        return None
    vibration = refined(courses, best)
    return vibration if vibration.rate <= RATIOS[-1] * vibration.frequency else None


def refined(courses: Sequence[Course], first: Vibration) -> Vibration:
    """Return the local optimum of a vibration over the same windows."""
    from scipy.optimize import minimize  # slow to import, and few arms swing

    def vibration(numbers: Array) -> Vibration:
        frequency, rate = np.exp(numbers).tolist()
        return Vibration(frequency=frequency, rate=rate)

    start = np.log([first.frequency, first.rate])
    windows = straight_windows(courses, PERIODS * first.period)
    found = minimize(
        lambda numbers: -gains_of(windows, [vibration(numbers)])[0],
        start,
        method='Nelder-Mead',
        options={'initial_simplex': start + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.5]])},
    )
    return vibration(found.x)


class Windows(NamedTuple):
    """Windows of a course in which pressure and load are linear: times, targets, freedom.

    smooth (ways, windows): the sum of squared residuals of each smooth motion.
    """

    time: Array
    way: Array
    freedom: int
    smooth: Array

    def left(self, ways: Iterable[Columns]) -> Array:
        """Return the sum of squared residuals (ways, windows) of each motion."""
        left = [np.sum(left_of(way(self.time), self.way) ** 2, axis=(1, 2)) for way in ways]
        return np.array(left) + np.finfo(float).tiny


def straight_windows(courses: Sequence[Course], seconds: float) -> list[Windows]:
    """Return the windows (s long) of each course in which pressure and load are linear."""
    found, smooth = [], smooth_ways(seconds)
    for course in courses:
        places = course.windows(seconds)
        if not len(places):
            continue
        places = places[:: max(places.shape[1] // 2, len(places) // MOST_WINDOWS, 1)]
        time = course.time[places] - course.time[places[:, :1]]
        line = np.stack([np.ones_like(time), time / seconds], axis=-1)
        beside = np.sqrt(np.mean(left_of(line, course.drives[places]) ** 2, axis=1))
        straight = (beside <= WITHIN_95).all(axis=1)
        time, way = time[straight], course.way[places[straight]]
        freedom = WAYS * (places.shape[1] - NUMBERS)
        windows = Windows(time, way, freedom, np.empty(0))
        found.append(windows._replace(smooth=windows.left(smooth)))
    return found


def gains_of(windows: Sequence[Windows], vibrations: Sequence[Vibration]) -> list[float]:
    """Return the advantage of each vibration over all other explanations of the windows.

    vibrations: of one frequency. The gain is in log likelihood, each window with its own noise.
    """
    driven = replace(vibrations[0], rate=0.0)  # what goes on as long as it likes is driven
    gains = np.zeros((len(vibrations), 1))
    for one in windows:
        own = one.left(vibration.columns for vibration in vibrations)
        other = np.concatenate([one.left([driven.columns]), one.smooth])
        gains = gains + 0.5 * one.freedom * np.sum(np.log(other / own[:, None]), axis=2)
    return [float(gain) for gain in gains.min(axis=1)]


def smooth_ways(seconds: float) -> list[Columns]:
    """Return smooth motions with this many coefficients: a cubic and pairs of exponentials."""

    def cubic(time: Array) -> Array:
        return np.asarray((time / seconds)[..., None] ** np.arange(NUMBERS))

    def decaying(pair: tuple[float, float]) -> Columns:
        rates = np.array(pair) * seconds
        return lambda time: np.concatenate(
            [cubic(time)[..., :2], np.exp(-time[..., None] / rates)], axis=-1
        )

    return [cubic, *map(decaying, DECAYS)]


def left_of(columns: Array, values: Array) -> Array:
    """Return the residual of values (windows, n, any) after projection on columns (likewise)."""
    basis, _ = np.linalg.qr(columns)
    return np.asarray(values - basis @ (basis.transpose(0, 2, 1) @ values))


def at_rest(course: Course, vibration: Vibration, noise: float) -> Flags:
    """Return the frames (n,) in which the arm is in equilibrium and stays there.

    One window of a period, before, around or after a frame, must show this: its vibration is small
    relative to the noise (m) of a target, the rest is noise, and pressure and load have not just
    begun to change.
    """
    rest = np.zeros(course.time.size, np.bool_)
    judged = rest.copy()
    windows = course.windows(vibration.period)
    for first in range(0, len(windows), MOST_WINDOWS):
        places = windows[first : first + MOST_WINDOWS]
        time = course.time[places] - course.time[places[:, :1]]
        columns, way = vibration.columns(time), course.way[places]
        numbers = np.linalg.pinv(columns) @ way
        left = np.mean((way - columns @ numbers) ** 2, axis=(1, 2))
        freedom = 1.0 - NUMBERS / places.shape[1]
        begun = np.abs(left_of(columns[..., :2], course.drives[places])).max(axis=2) > RESTS
        swing = np.sum((numbers[:, 2:] @ course.tip) ** 2, axis=(1, 2))
        for place in (0, places.shape[1] // 2, places.shape[1] - 1):
            far = swing * np.exp(-2.0 * vibration.rate * time[:, place])
            small = (far <= 2.0 * (WITHIN_95 * noise) ** 2) & ~begun[:, place]
            rest[places[:, place]] |= small & (left <= freedom * (WITHIN_95 * noise) ** 2)
            judged[places[:, place]] = True
    return np.asarray(rest | ~judged)
