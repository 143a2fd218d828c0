"""Detect frames in which the arm swings, from targets alone, without a model of the arm.

After a quick change, the targets of an arm follow a damped vibration about a straight line in
time. The vibration is accepted if it fits the frames better than a smooth motion with as many
parameters and better than an undamped vibration. With its frequency and decay, deviation and
velocity in every frame give the amplitude about equilibrium, as in
`measurement.moving_arm.is_settled`, but without a model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.checks.preconditions import check_runs
from pneunet_ros.calibration.noise_estimate import noise_of_targets, RESTS
from pneunet_ros.calibration.settings import EXPERIMENTS, GAUGE_PASCALS
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import PneunetError, RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, STANDARD_GRAVITY
from pneunet_ros.measurement.dataset import CHANCE, RecordingData, SIGMA_OF_MEDIAN, thin_runs
from pneunet_ros.measurement.inputs import runs_in_order
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.moving_arm import WITHIN_95
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise

Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]
Columns = Callable[[Array], Array]  # times (windows, frames) s -> (windows, frames, NUMBERS)

DIRECTIONS = 2  # of target motion: the tip moves along a curve
NUMBERS = 4  # coefficients of a vibration about a line, and of any smooth motion
FEWEST = NUMBERS + 3  # least frames per window
PERIODS = 1.5  # per search window: no cubic can follow this many periods of a vibration
FREQUENCIES = 48  # tried
RATIOS = (0.02, 0.05, 0.1, 0.2)  # damping ratios to try
# Stiffness (alpha) of the softest arm, a tenth of that where a search for it begins: such an arm
# would bend under its own weight, in the plane, by 25 times its length if it stayed linear.
SOFTEST = 0.005
CANTILEVER = 3.516  # frequency of the first mode over sqrt(B / (m l^3))
# Time constants of two decays, in windows: an arm that creeps, or lags behind its pressure.
DECAYS = ((0.05, 0.2), (0.1, 0.4), (0.2, 0.8), (0.4, 1.6))
MOST_WINDOWS = 500  # per recording, searched for a vibration and fitted at once
GAIN_STD = 2.0  # of a window with white noise: half the difference of two chi^2 of 2 x DIRECTIONS


@dataclass(frozen=True, slots=True, kw_only=True)
class Vibration:
    """Observed frequency (rad/s) and decay rate (1/s) of a vibration."""

    frequency: float
    rate: float

    def columns(self, time: Array) -> Array:
        """Return the columns of a line and of both phases of the vibration."""
        decay, turn = np.exp(-self.rate * time), self.frequency * time
        return np.stack([np.ones_like(time), turn, decay * np.cos(turn), decay * np.sin(turn)], -1)

    @property
    def period(self) -> float:
        """Period (s) of the vibration."""
        return 2.0 * math.pi / self.frequency


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FramesInMotion:
    """Frames that show the arm in motion, and its vibration.

    moving, unchecked: one mask (frames,) per recording; unchecked frames may be in motion too.
    lost: recordings without any usable frame; idle: number of their frames before the load was
    applied.
    """

    moving: tuple[Flags, ...]
    unchecked: tuple[Flags, ...]
    vibration: Vibration
    lost: tuple[str, ...] = ()
    idle: int = 0

    @property
    def count(self) -> int:
        """Number of frames that show the arm in motion."""
        return sum(int(np.count_nonzero(flags)) for flags in self.moving)

    @property
    def unchecked_count(self) -> int:
        """Number of frames that are too far from others in time, or show too few targets."""
        return sum(int(np.count_nonzero(flags)) for flags in self.unchecked)

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
        """The result as a sentence."""
        return f'{self.seen}{self.untested}'

    @property
    def seen(self) -> str:
        """The frames in motion in words."""
        return (
            f'{self.count} of {self.frames} frames show the arm in motion '
            f'({self.hertz:.2g} Hz, decays in {self.decay_time:.2g} s)'
        )

    @property
    def untested(self) -> str:
        """The unchecked frames in words; empty if there are none."""
        count = self.unchecked_count
        return f'; {count} could not be tested for motion' if count else ''

    @property
    def summary(self) -> dict[str, float]:
        """The numbers for the JSON summary."""
        names = ('frames', 'count', 'unchecked_count', 'hertz', 'decay_time')
        return {name: getattr(self, name) for name in names}

    @property
    def left_out(self) -> Note:
        """Describe the frames left out of a static fit, and the remedy."""
        idle = f' ({self.idle} frames at rest are from before its load)' if self.idle else ''
        lost = f'; nothing is left of {", ".join(self.lost)}{idle}' if self.lost else ''
        return Note(
            f'{self.seen} and were excluded, because the fit is static{lost}{self.untested}. '
            'Change pressure and load slowly, or wait for the arm to settle; calibrate --motion '
            'fits mass and damping to such frames',
            reason='in_motion',
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetMotion:
    """Motion of the targets of a recording.

    frame (n,), time (n,) s and coordinates (n, DIRECTIONS) m along unit vectors of target motion,
    tip (DIRECTIONS, 2) are their components for the last target. drives (n, any): pressure and
    load, which move the arm, each divided by its noise.
    """

    frame: npt.NDArray[np.int64]
    time: Array
    coordinates: Array
    tip: Array
    drives: Array

    @property
    def period(self) -> float:
        """Time (s) from one frame to the next."""
        return float(np.median(np.diff(self.time)))

    def windows(self, seconds: float, longest: float) -> tuple[Indices, Indices]:
        """Return the first frame and the number of frames of every window, (windows,) each.

        A window lasts `seconds`, or up to `longest` (s) if needed to contain FEWEST frames. Frames
        may be missing inside a window but not at its end.
        """
        first = np.arange(max(self.time.size - FEWEST + 1, 0))
        span = (round(seconds / self.period) + 0.5) * self.period
        end = np.searchsorted(self.time, self.time[first] + span)
        end = np.maximum(end, first + FEWEST)
        found = self.time[end - 1] - self.time[first]
        most = (round(longest / self.period) + 0.5) * self.period
        complete = (found > span - self.period) & (found < most)
        return first[complete], (end - first)[complete]


def frames_in_motion(runs: Sequence[RecordingData], arm: Arm) -> FramesInMotion | None:
    """Return the frames that show an arm in motion; None if no recording shows a swing.

    Each recording is tested alone; recordings without a swing of their own are checked with the
    vibration found in the others. The noise of targets is estimated from all recordings, as in a
    calibration. Recordings without usable stamps are skipped. The length of the arm gives an upper
    bound of the period of a soft arm and a lower bound of the noise.
    """
    slowest = slowest_period(arm.length)
    courses = [motion_of(run) for run in runs]
    chance = CHANCE / max(sum(course is not None for course in courses), 1)
    vibrations = [
        None if course is None else vibration_of([course], slowest, chance) for course in courses
    ]
    swings = [
        (course, vibration)
        for course, vibration in zip(courses, vibrations, strict=True)
        if course is not None and vibration is not None
    ]
    if not swings:
        return None
    common = swings[0][1]
    if len(swings) > 1:
        common = vibration_of([course for course, _ in swings], slowest, CHANCE) or common
    noise, _ = noise_of_targets(
        [run for run in runs if not run.static], arm.target_arclength, arm.sensors.target_std
    )
    moving = [np.zeros(len(run.stamp_ns), np.bool_) for run in runs]
    unchecked = [np.full(len(run.stamp_ns), not run.static) for run in runs]
    for which, (course, vibration) in enumerate(zip(courses, vibrations, strict=True)):
        if course is not None:  # a load changes the vibration
            rest, checked = frames_at_rest(course, vibration or common, noise)
            moving[which][course.frame] = checked & ~rest
            unchecked[which][course.frame] = ~checked
    if not any(flags.any() for flags in moving):
        return None
    return FramesInMotion(moving=tuple(moving), unchecked=tuple(unchecked), vibration=common)


def without_motion(
    arm: Arm, *groups: Sequence[RecordingData]
) -> tuple[list[list[RecordingData]], FramesInMotion | None]:
    """Return recordings without the frames that show the arm in motion, and these frames.

    A recording in which the arm never rests is dropped, as is a loaded one in which the arm rests
    only without its load. Their pressures are prepended to the next recording, because the arm has
    a memory of them.
    """
    runs = list(itertools.chain(*groups))
    found = frames_in_motion(runs, arm)
    if found is None:
        return [[*group] for group in groups], None
    kept, lost = select_frames(groups, [~flags for flags in found.moving], arm.sensors)
    rests = zip(runs, found.moving, strict=True)
    idle = sum(int(np.count_nonzero(~flags)) for run, flags in rests if run.name in lost)
    return kept, replace(found, lost=lost, idle=idle)


def select_frames(
    groups: Sequence[Sequence[RecordingData]], kept: Sequence[Flags], noise: SensorNoise
) -> tuple[list[list[RecordingData]], tuple[str, ...]]:
    """Return the recordings with the selected frames, and the names of excluded recordings.

    A recording without any selected frame, or without one under its load, is excluded. The arm
    remembers the excluded pressures, so they are prepended to the next recording.
    """
    runs = list(itertools.chain(*groups))
    found = [select_part(run, flags, noise) for run, flags in zip(runs, kept, strict=True)]
    lost = tuple(run.name for run, part in zip(runs, found, strict=True) if part is None)
    parts = iter(prepend_earlier_pressures(runs, found))
    return [[part for _ in group if (part := next(parts)) is not None] for group in groups], lost


def select_part(run: RecordingData, flags: Flags, noise: SensorNoise) -> RecordingData | None:
    """Return the selected frames of a run; None if none, or none under its load, remains."""
    if not flags.any():
        return None
    part = run.subset(np.flatnonzero(flags))
    lost = run.loaded and part.is_idle(noise) and not run.is_idle(noise)
    return None if lost else part


def prepend_earlier_pressures(
    runs: Sequence[RecordingData], kept: Sequence[RecordingData | None]
) -> list[RecordingData | None]:
    """Prepend the pressures of dropped runs (None) to the next run that is kept."""
    found, lost = [*kept], list[RecordingData]()
    for which, goes_on in runs_in_order(runs):
        part, lost = kept[which], lost if goes_on else []
        if part is None:
            lost.append(runs[which])
            continue
        for run in reversed(lost):
            before = run.reading_stamp_ns < part.reading_stamp_ns[0]
            part = replace(
                part,
                reading_stamp_ns=np.append(run.reading_stamp_ns[before], part.reading_stamp_ns),
                pressure=np.append(run.pressure[before], part.pressure),
                reading=part.reading + np.count_nonzero(before),
            )
        found[which], lost = part, []
    return found


def check_runs_at_rest(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    arm: Arm,
    *,
    first: bool = True,
    declared: PressureConvention | None = GAUGE_PASCALS,
) -> tuple[list[RecordingData], list[RecordingData], FramesInMotion | None]:
    """Return recordings without the frames in motion, checked by `check_runs`.

    Results of static checks do not apply to a moving arm.
    """

    def check(unloaded: Sequence[RecordingData], loaded: Sequence[RecordingData]) -> None:
        few = thin_runs([*unloaded, *loaded], EXPERIMENTS.most_frames)
        check_runs(few[: len(unloaded)], few[len(unloaded) :], arm, first=first, declared=declared)

    kept, motion = without_motion(arm, unloaded, loaded)
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


def motion_of(run: RecordingData) -> TargetMotion | None:
    """Return the motion of the targets of a recording; None if it is too short."""
    often = run.seen.mean(axis=0) > 0.5
    if run.static or len(run.reading_stamp_ns) < 2 or not often.any():
        return None
    points = run.points[:, :, often].reshape(len(run.stamp_ns), -1)
    known = np.isfinite(points).mean(axis=1) > 0.5
    if np.count_nonzero(known) < 2 * FEWEST:
        return None
    displacement = points[known] - np.nanmedian(points, axis=0)
    steps = np.nan_to_num(np.diff(displacement, axis=0))
    directions = np.linalg.svd(steps, full_matrices=False)[2][:DIRECTIONS]
    coordinates = np.nan_to_num(displacement) @ directions.T
    for frame in np.flatnonzero(~np.isfinite(displacement).all(axis=1)):
        seen = np.isfinite(displacement[frame])
        coordinates[frame], *_ = np.linalg.lstsq(
            directions[:, seen].T, displacement[frame, seen], rcond=None
        )
    shown = run.at_instants(0.0)  # a step begins between two readings
    drives = [shown.frame_pressure, *(shown.load.T if run.loaded and not run.load_known else ())]
    return TargetMotion(
        frame=np.flatnonzero(known),
        time=freeze((run.instants[known] - run.instants[0]) / NANOSECONDS_PER_SECOND),
        coordinates=freeze(coordinates),
        tip=freeze(directions.reshape(DIRECTIONS, 2, -1)[:, :, -1]),
        drives=freeze(np.column_stack([in_noise_units(values[known]) for values in drives])),
    )


def in_noise_units(values: Array) -> Array:
    """Return readings (n,) in units of their white noise, or of their resolution."""
    changes = np.abs(np.diff(values))
    noise = SIGMA_OF_MEDIAN * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)
    if noise == 0.0:
        noise = float(np.min(changes, where=changes > 0.0, initial=np.inf))
    return np.asarray((values - values[0]) / noise)


def slowest_period(length: float) -> float:
    """Return the longest plausible swing period (s) of an arm of this length (m)."""
    return 2.0 * math.pi / (CANTILEVER * math.sqrt(SOFTEST * STANDARD_GRAVITY / length))


def vibration_of(
    courses: Sequence[TargetMotion], slowest: float, chance: float
) -> Vibration | None:
    """Return the vibration of the courses; None if smooth motions explain them equally well.

    slowest (s): the longest period of a swing; chance: probability of mistaking noise for a
    vibration.
    """
    shortest = (FEWEST - 1) * min(course.period for course in courses)
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
        windows = linear_windows(courses, seconds)
        count = sum(len(one.time) for one in windows)
        gains = gains_of(windows, group)
        found += [(gain, count, one) for gain, one in zip(gains, group, strict=True)]
    gain, count, best = max(found, key=lambda item: item[0])
    by_noise = -NormalDist().inv_cdf(chance / len(found)) * GAIN_STD
    if not gain > by_noise * math.sqrt(count):
        return None
    vibration = refine_vibration(courses, best)
    return vibration if vibration.rate <= RATIOS[-1] * vibration.frequency else None


def refine_vibration(courses: Sequence[TargetMotion], first: Vibration) -> Vibration:
    """Return a local optimum of the vibration, over the same windows."""
    from scipy.optimize import minimize  # slow to import, and needed only if an arm swings

    def vibration(numbers: Array) -> Vibration:
        frequency, rate = np.exp(numbers).tolist()
        return Vibration(frequency=frequency, rate=rate)

    start = np.log([first.frequency, first.rate])
    windows = linear_windows(courses, PERIODS * first.period)
    found = minimize(
        lambda numbers: -gains_of(windows, [vibration(numbers)])[0],
        start,
        method='Nelder-Mead',
        options={'initial_simplex': start + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.5]])},
    )
    return vibration(found.x)


class Windows(NamedTuple):
    """Windows of a course in which pressure and load are linear.

    time (windows, frames) s. coordinates (windows, frames, DIRECTIONS) m. freedom: degrees of
    freedom of the residuals of a window. smooth_squares (motions, windows): sums of squared
    residuals of the smooth motions.
    """

    time: Array
    coordinates: Array
    freedom: int
    smooth_squares: Array

    def squares_of(self, motions: Iterable[Columns]) -> Array:
        """Return the sum of squared residuals (motions, windows) of each motion."""
        squares = [
            np.sum(residual_of(columns(self.time), self.coordinates) ** 2, axis=(1, 2))
            for columns in motions
        ]
        return np.array(squares) + np.finfo(float).tiny


def linear_windows(courses: Sequence[TargetMotion], seconds: float) -> list[Windows]:
    """Return the windows (s long) of each course in which pressure and load are linear."""
    found, smooth = [], smooth_motions(seconds)
    for course in courses:
        first, count = course.windows(seconds, seconds)
        if not first.size:
            continue
        step = max(int(np.median(count)) // 2, first.size // MOST_WINDOWS, 1)
        for indices in group_by_frame_count(first[::step], count[::step]):
            time = course.time[indices] - course.time[indices[:, :1]]
            line = np.stack([np.ones_like(time), time / seconds], axis=-1)
            drive_rms = np.sqrt(np.mean(residual_of(line, course.drives[indices]) ** 2, axis=1))
            is_linear = (drive_rms <= WITHIN_95).all(axis=1)
            time, coordinates = time[is_linear], course.coordinates[indices[is_linear]]
            freedom = DIRECTIONS * (indices.shape[1] - NUMBERS)
            windows = Windows(time, coordinates, freedom, np.empty(0))
            found.append(windows._replace(smooth_squares=windows.squares_of(smooth)))
    return found


def group_by_frame_count(first: Indices, count: Indices) -> Iterator[Indices]:
    """Yield the frame indices (windows, frames) of all windows with equally many frames."""
    for frames in np.unique(count):
        yield first[count == frames, None] + np.arange(frames)


def gains_of(windows: Sequence[Windows], vibrations: Sequence[Vibration]) -> list[float]:
    """Return the log likelihood gain of each vibration over all other explanations of the windows.

    vibrations: all of one frequency. Each window has its own noise.
    """
    driven = replace(vibrations[0], rate=0.0)  # an undamped vibration is driven
    gains = np.zeros((len(vibrations), 1))
    for one in windows:
        vibration_squares = one.squares_of(vibration.columns for vibration in vibrations)
        alternative_squares = np.concatenate(
            [one.squares_of([driven.columns]), one.smooth_squares]
        )
        gains = gains + 0.5 * one.freedom * np.sum(
            np.log(alternative_squares / vibration_squares[:, None]), axis=2
        )
    return [float(gain) for gain in gains.min(axis=1)]


def smooth_motions(seconds: float) -> list[Columns]:
    """Return smooth motions with this many coefficients: a cubic and pairs of exponentials."""

    def cubic(time: Array) -> Array:
        return np.asarray((time / seconds)[..., None] ** np.arange(NUMBERS))

    def decaying(pair: tuple[float, float]) -> Columns:
        rates = np.array(pair) * seconds
        return lambda time: np.concatenate(
            [cubic(time)[..., :2], np.exp(-time[..., None] / rates)], axis=-1
        )

    return [cubic, *map(decaying, DECAYS)]


def residual_of(columns: Array, values: Array) -> Array:
    """Return the residuals of values (windows, n, any) after projection on such columns."""
    basis, _ = np.linalg.qr(columns)
    return np.asarray(values - basis @ (basis.transpose(0, 2, 1) @ values))


def frames_at_rest(
    course: TargetMotion, vibration: Vibration, noise: float
) -> tuple[Flags, Flags]:
    """Return the frames (n,) of an arm that stays in equilibrium, and the frames checked.

    A frame is at rest if, in one window of a period before, around or after it, the vibration is
    small relative to the noise (m) of a target, the remainder is noise, and pressure and load have
    not just begun to change. A frame without any window is not checked.
    """
    rest = np.zeros(course.time.size, np.bool_)
    checked, allowed = rest.copy(), (WITHIN_95 * noise) ** 2
    first, count = course.windows(vibration.period, PERIODS * vibration.period)
    for begin in range(0, first.size, MOST_WINDOWS):
        part = slice(begin, begin + MOST_WINDOWS)
        for indices in group_by_frame_count(first[part], count[part]):
            time = course.time[indices] - course.time[indices[:, :1]]
            columns, coordinates = vibration.columns(time), course.coordinates[indices]
            coefficients = np.linalg.pinv(columns) @ coordinates
            residual_variance = np.mean((coordinates - columns @ coefficients) ** 2, axis=(1, 2))
            freedom = 1.0 - NUMBERS / indices.shape[1]
            is_driven = (
                np.abs(residual_of(columns[..., :2], course.drives[indices])).max(axis=2) > RESTS
            )
            swing = np.sum((coefficients[:, 2:] @ course.tip) ** 2, axis=(1, 2))
            for index in (0, indices.shape[1] // 2, indices.shape[1] - 1):
                amplitude_square = swing * np.exp(-2.0 * vibration.rate * time[:, index])
                small = (amplitude_square <= 2.0 * allowed) & ~is_driven[:, index]
                rest[indices[:, index]] |= small & (residual_variance <= freedom * allowed)
                checked[indices[:, index]] = True
    return rest, checked
