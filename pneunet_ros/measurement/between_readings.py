"""Linear interpolation of a sensor between two readings, with its uncertainty.

On the straight line between two readings, a part of their white noise averages out. But the values
in between are unknown: a steady ramp follows the line, a value that jumped was at either end, and
a ramp that began in between lies to one side of the line.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import Stamps

# Rows of `line_between`:
VALUE, NOISE, MISSED, FURTHEST = range(4)
NEVER = 1e-6  # fraction of the interval between two readings in which no value jumps
SIGMA_OF_SECOND = math.sqrt(6.0)  # of a second difference, over that of a reading


@dataclass(frozen=True, slots=True, kw_only=True)
class BetweenReadingsSettings:
    """Criteria for changes between readings that interpolation misses."""

    noise: float = tuning(
        2.0,
        'size of a second difference that noise does not explain',
        unit='sigma',
        source='invented',
    )


BETWEEN_READINGS = BetweenReadingsSettings()


def interpolate(shown: Stamps, stamp_ns: Stamps, values: Array) -> Array:
    """Return values (stamps,) interpolated linearly at other stamps."""
    first = stamp_ns[0]  # a float cannot hold a stamp
    return np.asarray(np.interp(shown - first, stamp_ns - first, values))


def interpolated_noise(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the noise of interpolated values (stamps,), relative to that of a reading.

    On the line between two readings, a part of their white noise averages out.
    """
    if len(stamp_ns) < 2:
        return np.ones(len(shown))
    _, fraction = places_between(shown, stamp_ns)
    return np.asarray(np.hypot(1.0 - fraction, fraction))


def places_between(shown: Stamps, stamp_ns: Stamps) -> tuple[Stamps, Array]:
    """Return the index of the reading before each stamp, and the fraction to the next, 0 to 1."""
    before = np.minimum(np.maximum(stamp_ns.searchsorted(shown), 1), len(stamp_ns) - 1) - 1
    start = stamp_ns[before]
    interval = np.maximum(stamp_ns[before + 1] - start, 1)  # of one stamp: no line
    fraction = np.minimum(np.maximum((shown - start) / interval, 0.0), 1.0)
    return before, np.asarray(fraction)


def frames_sharing(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the number of shown frames that share the readings of each frame, (shown,).

    These frames share the noise of the same two readings, and the error of the line between them:
    they are the frames within the time between those readings. shown: not decreasing.
    """
    if len(stamp_ns) < 2:
        return np.full(len(shown), float(len(shown)))
    before, _ = places_between(shown, stamp_ns)
    half = np.diff(stamp_ns)[before] // 2
    center = np.minimum(np.maximum(shown, shown[0] + half), shown[-1] - half)
    first, last = np.searchsorted(shown, [center - half, center + half])
    at_last_frame = center == shown[-1] - half  # where the window ends with the last frame
    after_window = np.searchsorted(shown, [center - half, center + half], side='right')
    first, last = np.where(at_last_frame, after_window, [first, last])
    return np.asarray(np.maximum(last - first, 1), dtype=np.float64)


def interpolation_error(
    shown: Stamps,
    stamp_ns: Stamps,
    values: Array,
    noise: npt.ArrayLike,
    settings: BetweenReadingsSettings = BETWEEN_READINGS,
) -> Array:
    """Return one sigma of the error of linear interpolation between readings, (shown, ...).

    stamp_ns (readings,) and values (readings, ...) with white noise of this size (...). The error
    follows from the changes of slope at the reading before and at the one after. Without any, the
    line is right. If both have the same sign, the course is bent: it lies anywhere between the
    line and the extrapolations from either side, with equal probability. If they cancel, the value
    jumped: after a fraction w of the interval it had jumped with probability w, so the error has a
    standard deviation of sqrt(w (1 - w)) of the jump. A change that spans two intervals, but not
    the ones before and after, began in the first and ended in the second, at any time: after a
    fraction w of the second it has ended with probability w, and the line misses the rest. Before
    the first and after the last reading, the value is assumed to be constant; after the last, it
    may continue to change as before.
    """
    errors = np.zeros((len(shown), *values.shape[1:]))
    if len(stamp_ns) < 2:
        return errors
    before, fraction = places_between(shown, stamp_ns)
    columns = frozen_array(values.reshape(len(stamp_ns), -1))
    least = np.empty(columns.shape[1])
    least[:] = explained_changes(np.asarray(noise), settings)
    intervals = np.maximum(stamp_ns[1:] - stamp_ns[:-1], 1).astype(np.float64)
    since_last = np.maximum(shown - stamp_ns[-1], 0).astype(np.float64)
    missed_by_lines(
        columns, intervals, least, before, fraction, since_last, errors.reshape(len(shown), -1)
    )
    return errors


def explained_changes(noise: Array, settings: BetweenReadingsSettings = BETWEEN_READINGS) -> Array:
    """Return the squares of the second differences that white noise of these sizes explains."""
    return np.asarray(np.square(settings.noise * SIGMA_OF_SECOND * noise))


def place_between(shown_ns: int, stamp_ns: Stamps) -> tuple[int, float]:
    """Return `places_between` of one stamp."""
    places, fractions = places_between(np.array([shown_ns]), stamp_ns)
    return int(places[0]), float(fractions[0])


@kernel
def missed_by_lines(
    values: Array,
    intervals: Array,
    least: Array,
    before: Stamps,
    fraction: Array,
    since_last: Array,
    errors: Array,
) -> None:
    """`interpolation_error` into errors (shown, columns).

    values (readings, columns), intervals (readings - 1,) ns; least (columns,): square of a second
    difference that noise explains; before, fraction (shown,): from `places_between`; since_last
    (shown,) ns: time after the last reading.
    """
    for column in range(values.shape[1]):
        for frame in range(before.size):
            errors[frame, column] = missed_by_line(
                values,
                intervals,
                least[column],
                before[frame],
                fraction[frame],
                since_last[frame],
                column,
            )


@inner
def line_between(shown_ns: int, stamp_ns: Stamps, values: Array, least: Array, out: Array) -> None:
    """Interpolate at one stamp, with noise and errors, into out (4, columns).

    values (readings, columns); least (columns,): from `explained_changes`. Rows: VALUE, as by
    `interpolate`; NOISE, as by `interpolated_noise`; MISSED, as by `interpolation_error`;
    FURTHEST, as by `furthest_error`.
    """
    count, columns = values.shape
    before, fraction, since_last = 0, 0.0, 0.0
    intervals = np.ones(max(count - 1, 0))
    for i in range(count - 1):
        intervals[i] = max(stamp_ns[i + 1] - stamp_ns[i], 1)
        if i == 0 or stamp_ns[i] < shown_ns:
            before = i
    if count > 1:
        fraction = min(max((shown_ns - stamp_ns[before]) / intervals[before], 0.0), 1.0)
        since_last = max(shown_ns - stamp_ns[count - 1], 0) * 1.0
    for column in range(columns):
        out[VALUE, column], out[NOISE, column] = values[before, column], 1.0
        out[MISSED, column], out[FURTHEST, column] = 0.0, math.sqrt(3.0)
        if count > 1:
            out[VALUE, column] += fraction * (values[before + 1, column] - values[before, column])
            out[NOISE, column] = math.hypot(1.0 - fraction, fraction)
            out[MISSED, column] = missed_by_line(
                values, intervals, least[column], before, fraction, since_last, column
            )
            out[FURTHEST, column] = furthest_jump(fraction)


@inlined
def furthest_jump(fraction: float) -> float:
    """Return `furthest_error` at a fraction of the interval between two readings."""
    shorter = max(min(fraction, 1.0 - fraction), NEVER)
    jump: float = max(math.sqrt(3.0), math.sqrt((1.0 - shorter) / shorter))
    return jump


@inner
def missed_by_line(
    values: Array,
    intervals: Array,
    least: float,
    before: int,
    fraction: float,
    since_last: float,
    column: int,
) -> float:
    """Return `interpolation_error` of one column at one stamp.

    least: square of a second difference that noise explains; before, fraction: place between
    readings; since_last (ns): time after the last reading.
    """
    length = intervals[before]
    if since_last > 0.0:
        extrapolated: float = min(since_last, length)
        return abs(slope_between(values, intervals, column, intervals.size - 1)) * extrapolated
    earlier = bend_at(values, intervals, column, before - 1) * length
    first = bend_at(values, intervals, column, before) * length
    second = bend_at(values, intervals, column, before + 1) * length
    later = bend_at(values, intervals, column, before + 2) * length
    of_earlier = math.sqrt(max(earlier * earlier - least, 0.0))
    of_first = math.sqrt(max(first * first - least, 0.0))
    of_second = math.sqrt(max(second * second - least, 0.0))
    of_later = math.sqrt(max(later * later - least, 0.0))
    if first * second < 0.0:
        missed = min(of_first, of_second) * math.sqrt(fraction * (1.0 - fraction))
    else:
        missed = min(fraction * of_first, (1.0 - fraction) * of_second) / math.sqrt(3.0)
    if earlier * second < 0.0:
        remaining = 1.0 - fraction
        began = min(of_earlier, of_second) * remaining * math.sqrt(1.0 - remaining * remaining)
        missed = max(missed, began)
    if first * later < 0.0:
        ended = min(of_first, of_later) * fraction * math.sqrt(1.0 - fraction * fraction)
        missed = max(missed, ended)
    return missed


@inlined
def bend_at(values: Array, intervals: Array, column: int, reading: int) -> float:
    """Return the change of slope at a reading; zero outside the readings."""
    if reading < 0 or reading >= len(values):
        return 0.0
    slope = slope_between(values, intervals, column, reading)
    return slope - slope_between(values, intervals, column, reading - 1)


@inlined
def slope_between(values: Array, intervals: Array, column: int, reading: int) -> float:
    """Return the slope from a reading to the next; zero before the first and after the last."""
    if reading < 0 or reading >= intervals.size:
        return 0.0
    slope: float = (values[reading + 1, column] - values[reading, column]) / intervals[reading]
    return slope


def furthest_error(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the bound of the interpolation error relative to `interpolation_error`.

    For a jump, the whole jump, if the value jumped in the shorter part of the interval; for a bent
    course, the extrapolation from either side, (shown,).
    """
    of_bent_course = np.full(len(shown), math.sqrt(3.0))
    if len(stamp_ns) < 2:
        return of_bent_course
    _, fraction = places_between(shown, stamp_ns)
    shorter = np.maximum(np.minimum(fraction, 1.0 - fraction), NEVER)
    return np.asarray(np.maximum(of_bent_course, np.sqrt((1.0 - shorter) / shorter)))


def error_between(shown_ns: int, stamp_ns: Stamps, values: Array, noise: float) -> float:
    """Return a plausible bound of the interpolation error at one stamp, for values (stamps,).

    It is sqrt(3) sigma, or the largest possible error if that is smaller. noise: white, of a
    value. Values after the last one are not known yet.
    """
    shown = np.array([shown_ns])
    error = interpolation_error(shown, stamp_ns, values, noise)
    return float(error[0]) * min(float(furthest_error(shown, stamp_ns)[0]), math.sqrt(3.0))
