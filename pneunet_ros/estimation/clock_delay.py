"""Delay between the clocks of a film and a table of readings, estimated from the motion.

A frame stamped t shows the arm at t - delay. At the right delay, target positions are a smooth
function of pressure and load; at a wrong delay, the same pressure appears with many shapes. Other
behavior of a soft arm (dead bands, slow relaxations) is fitted as well, so that it is not mistaken
for a delay. A lag shorter than the shortest relaxation, for example of an air line, is mistaken
for a delay: 60 to 90 % of a lag of 20 to 100 ms, and 20 to 40 % of a lag of 500 ms. The standard
error does not include this bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.polynomial.chebyshev import chebvander
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.settings import tuning
import scipy

COARSE_FRAMES = 400  # frames used to scan all delays, before some are examined closely
COARSE_STEPS = 4000  # largest number of delays in the scan
CANDIDATES = 6  # delays of the scan that are examined closely
LARGEST_GRID = 100_000  # instants of the table: memory
CELLS = 4.0  # instants of the table in a frame
RIDGE = 1e-7  # of the variance: regularizes nearly collinear columns
BLOCKS = 16  # of the video, each left out once by the jackknife
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FEWEST_FRAMES = 40  # with targets
MOTION = 3.0  # std of the motion, over the noise of a frame
SEPARATION = 5.0  # frames between two separate delays
LAW_RANGE = 0.5  # s: search range of the delay without plays
BLUR = 0.02  # of the range of motion: displacement of a frame by the error of the delay

Indices = npt.NDArray[np.int64]
Plays = tuple[tuple[float, ...], int]  # widths, and exponents of the pressure as their weight


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockDelaySettings:
    """Settings of the delay fit, and criteria for rejecting a delay."""

    components: int = tuning(
        2, 'number of principal components of the motion', unit='number', source='sweep'
    )
    overlap: float = tuning(
        0.75, 'smallest overlap of film and table, relative to the shorter one', source='sweep'
    )
    explained: float = tuning(
        0.8, 'smallest share of the motion that pressure and load must explain', source='sweep'
    )
    rival: float = tuning(
        2.0, 'squared residual of the next best delay over that of the best', source='sweep'
    )
    powers: int = tuning(6, 'highest power of the pressure', unit='number', source='sweep')
    plays: tuple[Plays, ...] = tuning(
        (((0.01, 0.04, 0.16), 4), ((0.02, 0.08), 4), ((0.005, 0.015, 0.03, 0.06, 0.12), 2)),
        'sets of plays (dead bands), each fitted; the spread of the fits is part of the '
        'standard error',
        unit='range of pressure',
        source='sweep',
    )
    distinct: float = tuning(
        0.1,
        'relative error of the play effects on the delay, and smallest share of the effect of a '
        'delay that plays cannot represent',
        source='measured: 0.00 to 0.09 if the pressure repeats one loop, else 0.10 to 0.95',
    )
    relaxations: tuple[float, ...] = tuning(
        (1.0, 3.0, 10.0, 30.0), 'time constants', unit='s', source='sweep'
    )
    stamps: float = tuning(
        0.05, 'error of the stamps of frames and readings', unit='period', source='sweep'
    )


NO_PLAYS: Plays = ((), 1)
# In 30 videos of 10 s at 25 frames/s, of the arm of test_clock_delay.py, five such steps were
# enough in 25, six in 28, eight in all.
SIGMA_OF_MEDIAN = 0.6745  # median absolute value of a normal variable, over its standard deviation
REMEDY = 'eight quick steps to different levels, at irregular times, would determine it'
CLOCK_DELAY = ClockDelaySettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockDelay:
    """The delay between two clocks that start at the first frame and first reading.

    delay, std (s): a frame shows the arm at its stamp minus delay; std is the standard error;
    explained: share of the motion explained by pressure and load; frames: number used;
    frame_period (s). repeated: frames in which the arm stands still although its inputs change,
    because a film replaces a lost frame by the previous one. trouble: why the data do not
    determine the delay, None if they do.
    """

    delay: float
    std: float
    explained: float
    frames: int
    frame_period: float
    repeated: tuple[int, ...] = ()
    trouble: Note | None = None

    @property
    def sentence(self) -> str:
        """Describe the delay and its uncertainty."""
        share = self.std / self.frame_period
        return (
            f'the film is ahead of the table by {self.delay:.4f} s, with a standard error of '
            f'{self.std:.4f} s ({share:.2g} of a frame) if the arm follows its pressure at once: '
            f'a lag of less than {min(CLOCK_DELAY.relaxations):g} s counts as delay, and is then '
            'not in the recording; '
            f'from {self.frames} frames; pressure and load explain '
            f'{100.0 * self.explained:.5g} % of their motion'
        )


def estimate_delay(
    frame_time: Array, motion: Array, reading_time: Array, inputs: Array
) -> ClockDelay:
    """Return the offset of the clock of the film relative to that of the readings.

    The delay minimizes the residual of the motion as a smooth function of its inputs; its standard
    error is estimated by leaving out blocks of the film (jackknife), which allows for correlated
    residuals, and widened by Student's t if there are few blocks.

    Args:
        frame_time: (frames,) s, increasing.
        motion: (frames, coordinates) m of the targets, NaN where one was not seen.
        reading_time: (readings,) s, increasing.
        inputs: (readings, 1 + loads) pressure in Pa, then forces that change in N.

    Returns:
        The delay, with a sentence in `trouble` if the data do not determine it.
    """
    period = float(np.median(np.diff(frame_time))) if len(frame_time) > 1 else math.inf
    scores, kept = motion_components(motion)
    unknown = ClockDelay(
        delay=math.nan, std=math.inf, explained=0.0, frames=kept.size, frame_period=period
    )
    trouble = _why_insufficient(scores, period, reading_time, inputs)
    if trouble:
        return replace(unknown, trouble=trouble)
    without, *fits = (
        DelayFit(frame_time[kept], scores, reading_time, inputs, period, plays)
        for plays in (NO_PLAYS, *CLOCK_DELAY.plays)
    )
    candidates = fits[0].candidates()
    if not candidates:
        return replace(
            unknown,
            trouble=Note(
                'too few frames that show the targets lie in the table', reason='no_overlap'
            ),
        )
    best, *rivals = candidates
    within = SEPARATION * period
    delays = [best, *(fit.refine(best, within) for fit in fits[1:])]
    changed = float(np.mean(delays)) - without.refine(best, max(within, LAW_RANGE))
    details = [fit.details(delay) for fit, delay in zip(fits, delays, strict=True)]
    reading_period = float(np.median(np.diff(reading_time)))
    clock = replace(
        unknown,
        delay=float(np.mean(delays)),
        std=math.hypot(
            max(detail.std for detail in details),
            float(np.std(delays, ddof=1)),
            CLOCK_DELAY.distinct * changed,
            CLOCK_DELAY.stamps * math.hypot(period, reading_period),
        ),
        explained=details[0].explained,
        frames=details[0].frames,
    )
    trouble = _why_unreliable(clock, fits[0], rivals, details[0].rate)
    if not trouble and np.mean([detail.distinct for detail in details]) < CLOCK_DELAY.distinct:
        trouble = Note(
            'the pressure repeats one cycle, so hysteresis cannot be distinguished from a delay: '
            f'{REMEDY}',
            reason='not_determined',
        )
    repeated = kept[fits[0].repeated(delays[0])]
    return replace(clock, trouble=trouble, repeated=tuple(repeated.tolist()))


def _why_insufficient(
    scores: Array, period: float, reading_time: Array, inputs: Array
) -> Note | None:
    """Explain why the data are too few to estimate a delay; None if they suffice."""
    frames = len(scores)
    if frames < FEWEST_FRAMES:
        return Note(
            f'{frames} frames show the targets, and {FEWEST_FRAMES} are needed',
            reason='too_few_frames',
        )
    if len(reading_time) < 3 or not np.any(np.ptp(inputs, axis=0) > 0.0):
        return Note('neither pressure nor load changes in the table', reason='no_change')
    span = float(reading_time[-1] - reading_time[0])
    if span < FEWEST_FRAMES * period:
        return Note(
            f'the table lasts {span:.3g} s, and {FEWEST_FRAMES * period:.3g} s are needed',
            reason='too_short',
        )
    noise = np.median(np.abs(np.diff(scores[:, 0], 2))) / (SIGMA_OF_MEDIAN * math.sqrt(6.0))
    if not np.std(scores[:, 0]) > MOTION * noise:
        return Note('the arm does not move in the film', reason='not_in_motion')
    return None


def _why_unreliable(
    clock: ClockDelay, fit: DelayFit, rivals: Sequence[float], rate: float
) -> Note | None:
    """Explain why an estimated delay is unreliable; None if it is reliable."""
    if clock.explained < CLOCK_DELAY.explained:
        return Note(
            f'pressure and load explain at most {100.0 * clock.explained:.3g} % of the motion, '
            'at any delay: are film and table of the same run?',
            reason='nothing_in_common',
        )
    best = fit.unexplained(clock.delay)
    for rival in rivals:
        ratio = float(np.mean(fit.unexplained(rival) / best))
        if abs(rival - clock.delay) > SEPARATION * fit.period and ratio < CLOCK_DELAY.rival:
            return Note(
                f'delays of {clock.delay:.2f} s and {rival:.2f} s fit equally well, because the '
                f'pressure repeats itself or changes too evenly; {REMEDY}',
                reason='not_determined',
            )
    if not clock.std * rate < BLUR:
        return Note(
            f'the delay is {clock.delay:.2f} s with a standard error of {clock.std:.2g} s, which '
            f'moves a frame by more than {100.0 * BLUR:g} % of the motion, because the '
            f'pressure changes too evenly or too seldom; {REMEDY}',
            reason='not_determined',
        )
    return None


def motion_components(motion: Array) -> tuple[Array, Indices]:
    """Return the largest principal components of the motion (kept, components), and their frames.

    Computed from the targets that most frames show, in the frames that show all of them.
    """
    seen = np.isfinite(motion)
    with_targets = seen.any(axis=1)
    if not with_targets.any():
        return np.zeros((0, CLOCK_DELAY.components)), np.zeros(0, dtype=np.int64)
    often = 2 * seen.sum(axis=0) > np.count_nonzero(with_targets)
    kept = np.flatnonzero(seen[:, often].all(axis=1) & often.any())
    points = motion[kept][:, often]
    points = points - points.mean(axis=0) if kept.size else points
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    return points @ axes[: CLOCK_DELAY.components].T, kept


@dataclass(frozen=True, slots=True, kw_only=True)
class FitDetails:
    """Standard error (s) of one fit, the share of motion it explains, and its frames.

    distinct: share of the effect of a delay on the motion that no other column can represent.
    rate: mean rate of the motion (1/s), relative to its range.
    """

    std: float
    distinct: float
    rate: float
    explained: float
    frames: int


class DelayFit:
    """A linear fit of the motion to its inputs with one set of plays, at any delay."""

    def __init__(
        self,
        time: Array,
        scores: Array,
        reading_time: Array,
        inputs: Array,
        period: float,
        plays: Plays,
    ) -> None:
        self.time, self.scores, self.period = time, scores, period
        span = float(reading_time[-1] - reading_time[0])
        step = max(period / CELLS, span / LARGEST_GRID)
        self.grid = np.arange(reading_time[0], reading_time[-1], step)
        smooth = np.column_stack(
            [box_average(reading_time, column, self.grid, step) for column in inputs.T]
        )
        self.columns = regressors(smooth, step, plays)
        self.slopes = np.gradient(self.columns, step, axis=0)
        self.shorter = CLOCK_DELAY.overlap * min(float(time[-1] - time[0]), span)

    def inside(self, delay: float) -> Indices:
        """Return the frames covered by the table at a delay."""
        at = self.time - delay
        return np.flatnonzero((at >= self.grid[0]) & (at <= self.grid[-1]))

    def rows(self, table: Array, times: Array) -> Array:
        """Interpolate rows of a table on a regular grid at other times."""
        place = (times - self.grid[0]) / (self.grid[1] - self.grid[0])
        row = np.clip(place.astype(np.int64), 0, len(self.grid) - 2)
        above = (place - row)[:, None]
        return np.asarray((1.0 - above) * table[row] + above * table[row + 1])

    def design(self, times: Array) -> tuple[Array, Array]:
        """Return the regressors and a constant at these times, (n, k + 1), and scales (k,)."""
        columns = self.rows(self.columns, times)
        columns = columns - columns.mean(axis=0)
        scales = np.sqrt((columns**2).mean(axis=0)) + 1e-12
        return np.column_stack([np.ones(len(times)), columns / scales]), scales

    def normal(self, design: Array) -> Array:
        """Return the normal matrix of a design matrix."""
        ridge = RIDGE * len(design)
        return np.asarray(design.T @ design + ridge * np.eye(design.shape[1]))

    def unexplained(self, delay: float, every: int = 1) -> Array:
        """Return the unexplained share of each component's variance; inf with too few frames.

        The variance is taken over the frames covered by the table, because there is no motion to
        explain while the arm rests.
        """
        frames = self.inside(delay)
        fewest = max(FEWEST_FRAMES, 0.9 * self.shorter / self.period)
        if frames.size < min(fewest, 0.5 * self.time.size):
            return np.full(self.scores.shape[1], math.inf)
        frames = frames[::every]
        design, _ = self.design(self.time[frames] - delay)
        scores = self.scores[frames]
        residual = scores - design @ np.linalg.solve(self.normal(design), design.T @ scores)
        variance = np.var(scores, axis=0) + 1e-300
        return np.asarray((residual**2).mean(axis=0) / variance)

    def cost(self, delay: float, every: int = 1) -> float:
        """Return the log of the unexplained motion, summed over components."""
        return float(np.sum(np.log(self.unexplained(delay, every) + 1e-300)))

    def candidates(self) -> list[float]:
        """Return delays at minima of the residual, best first."""
        low = float(self.time[0] - self.grid[-1]) + self.shorter
        high = float(self.time[-1] - self.grid[0]) - self.shorter
        step = max(self.period, (high - low) / COARSE_STEPS)
        delays = np.arange(low, high + step, step)
        every = max(1, self.time.size // COARSE_FRAMES)
        costs = np.array([self.cost(float(delay), every) for delay in delays])
        padded = np.concatenate([[math.inf], costs, [math.inf]])
        lowest = np.isfinite(costs) & (costs <= padded[:-2]) & (costs <= padded[2:])
        ranked = sorted(np.flatnonzero(lowest).tolist(), key=lambda place: float(costs[place]))
        minima = [self.minimum(float(delays[place]), 1.5 * step) for place in ranked[:CANDIDATES]]
        return sorted(minima, key=self.cost)

    def refine(self, delay: float, within: float) -> float:
        """Return the minimum near (within s) a delay found with another set of plays."""
        delays = np.arange(delay - within, delay + within, 0.5 * self.period)
        best = min((float(other) for other in delays), key=self.cost)
        return self.minimum(best, self.period)

    def minimum(self, delay: float, within: float) -> float:
        """Return the minimum of the residual near (within s) a delay."""
        result = scipy.optimize.minimize_scalar(
            self.cost,
            bounds=(delay - within, delay + within),
            method='bounded',
            options={'xatol': 1e-4 * self.period},
        )
        return float(result.x) if math.isfinite(result.fun) else delay

    def repeated(self, delay: float) -> Indices:
        """Return the frames in which the arm stands still although its inputs change.

        Within the usual residual, the arm is in the position of the previous frame, but not in the
        position predicted by pressure and load: the image was repeated, or it was taken at the
        start of a motion, within the error of the delay.
        """
        frames = self.inside(delay)
        design, _ = self.design(self.time[frames] - delay)
        scores = self.scores[frames]
        residual = scores - design @ np.linalg.solve(self.normal(design), design.T @ scores)
        usual = np.median(np.abs(residual), axis=0) / SIGMA_OF_MEDIAN
        main = residual[:, 0]
        limit = math.sqrt(2.0) * MOTION * usual[0]
        is_repeated = (np.abs(np.diff(scores, axis=0)) < usual).all(axis=1)
        is_repeated &= np.abs(np.diff(main)) > limit
        is_repeated &= np.abs(main[1:]) > np.abs(main[:-1])  # if not, the previous image is wrong
        is_repeated &= np.diff(self.time[frames]) < 1.5 * self.period
        return np.asarray(frames[1:][is_repeated])

    def details(self, delay: float) -> FitDetails:
        """Return the uncertainty of a delay, by linearization and by a block jackknife.

        A few blocks may contain all information on the delay: Student's t has the effective number
        of equally informative blocks, minus one, as its degrees of freedom.
        """
        frames = self.inside(delay)
        at, scores = self.time[frames] - delay, self.scores[frames]
        design, scales = self.design(at)
        normal = self.normal(design)
        weights = np.linalg.solve(normal, design.T @ scores)
        residual = scores - design @ weights
        noise = residual.std(axis=0) + 1e-300
        sensitivity = -(self.rows(self.slopes, at) / scales) @ weights[1:] / noise
        alone = sensitivity - design @ np.linalg.solve(normal, design.T @ sensitivity)
        left_white = residual / noise
        count = BLOCKS
        information, without = np.zeros(count), np.zeros(count)
        for which, block in enumerate(np.array_split(np.arange(frames.size), count)):
            rest = np.setdiff1d(np.arange(frames.size), block, assume_unique=True)
            part = design[rest]
            shadow = np.linalg.solve(self.normal(part), part.T @ sensitivity[rest])
            free = sensitivity[rest] - part @ shadow
            information[which] = np.sum(alone[block] ** 2)
            without[which] = np.sum(free * left_white[rest]) / np.sum(free * sensitivity[rest])
        jackknife = math.sqrt((count - 1) * float(np.var(without)))
        dof = max(float(information.sum() ** 2 / np.sum(information**2)) - 1.0, 0.5)
        widened = 0.5 * float(scipy.special.stdtrit(dof, 0.97725))
        explained = 1.0 - float(np.sum(residual**2) / np.sum((scores - scores.mean(axis=0)) ** 2))
        return FitDetails(
            std=jackknife * widened,
            distinct=float(information.sum() / np.sum(sensitivity**2)),
            rate=float(noise[0] * np.abs(sensitivity[:, 0]).mean() / np.ptp(scores[:, 0])),
            explained=explained,
            frames=frames.size,
        )


def box_average(time: Array, values: Array, centers: Array, width: float) -> Array:
    """Return means over boxes of a width (s) of piecewise linear readings."""
    slopes = np.diff(values) / np.diff(time)
    areas = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])

    def integral(to: Array) -> Array:
        line = np.clip(np.searchsorted(time, to, side='right') - 1, 0, len(time) - 2)
        since = to - time[line]
        return np.asarray(areas[line] + values[line] * since + 0.5 * slopes[line] * since**2)

    low = np.maximum(centers - 0.5 * width, time[0])
    high = np.minimum(centers + 0.5 * width, time[-1])
    return np.asarray((integral(high) - integral(low)) / (high - low))


def regressors(inputs: Array, step: float, plays: Plays) -> Array:
    """Return the regressors of the motion, (instants, columns).

    Columns: powers of the pressure; the lag of a play operator of each width, times powers of the
    pressure; the lead of the pressure over each relaxation; powers of every load, and its products
    with the pressure.
    """
    pressure = unit_range(inputs[:, 0])
    widths, powers = plays
    columns = [chebvander(pressure, CLOCK_DELAY.powers)[:, 1:]]
    for width in widths:
        lag = (pressure - follow_play(pressure, width)) / width
        columns.append(lag[:, None] * chebvander(pressure, powers - 1))
    for constant in CLOCK_DELAY.relaxations:
        share = 1.0 - math.exp(-step / constant)
        late, _ = scipy.signal.lfilter(
            [share], [1.0, share - 1.0], pressure, zi=[pressure[0] * (1.0 - share)]
        )
        columns.append((late - pressure)[:, None])
    loads = [unit_range(load) for load in inputs[:, 1:].T if np.ptp(load) > 0.0]
    for load in loads:
        columns.append(load[:, None] * chebvander(pressure, 2))
        columns.append(np.column_stack([load**2, load**2 * pressure, load**3]))
    if len(loads) > 1:
        columns.append((loads[0] * loads[1])[:, None])
    return np.concatenate(columns, axis=1)


def unit_range(values: Array) -> Array:
    """Scale values to -1 to 1; zeros if they are constant."""
    low, span = float(values.min()), float(np.ptp(values))
    return np.asarray(2.0 * (values - low) / span - 1.0) if span > 0.0 else np.zeros(values.size)


def follow_play(values: Array, width: float) -> Array:
    """Return the output of a play for values in unit range; width: relative to that range."""
    followed, output = np.empty_like(values), float(values[0])
    for place, value in enumerate(values.tolist()):
        output = min(max(output, value - width), value + width)
        followed[place] = output
    return followed
