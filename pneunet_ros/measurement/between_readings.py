"""Linear interpolation of a sensor between two readings, with its uncertainty.

Linear interpolation averages out a part of the white noise of both readings. But the true course
between them is unknown: a steady ramp follows the line, a step stays at either end, and a ramp
that begins in between lies to one side of the line.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import Stamps

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

    Interpolation averages out a part of the white noise of both readings.
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

    Frames between the same two readings share the noise of both and the interpolation error.
    shown: times, not decreasing.
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
    follows from the changes of slope at the readings before and after. If the slope does not
    change, the interpolation is exact. If both changes have the same sign, the signal is curved:
    it lies anywhere between the line and the extrapolations from either side, with equal
    probability. If the changes cancel, the signal jumped: after a fraction w of the interval the
    jump has happened with probability w, so the error has a standard deviation of sqrt(w (1 - w))
    of the jump. A change that spans exactly two intervals began in the first and ended in the
    second, at any time: after a fraction w of the second interval the change has ended with
    probability w, and interpolation misses the rest. Before the first and after the last reading,
    the value is assumed to be constant; after the last reading, the value may continue to change
    as before.
    """
    if len(stamp_ns) < 2:
        return np.zeros((len(shown), *values.shape[1:]))
    before, fraction = places_between(shown, stamp_ns)
    columns, fraction = values.reshape(len(stamp_ns), -1), fraction[:, None]
    intervals = np.maximum(np.diff(stamp_ns), 1).astype(np.float64)[:, None]
    slopes, bends = (np.zeros((len(stamp_ns) + n, columns.shape[1])) for n in (1, 2))
    # Slopes and bends are zero before the first and after the last reading:
    slopes[1:-1] = np.diff(columns, axis=0) / intervals
    bends[1:-1] = np.diff(slopes, axis=0)
    length = intervals[before]
    earlier, first, second, later = bent = bends[before + np.arange(4)[:, None]] * length
    least = np.ravel(np.square(settings.noise * SIGMA_OF_SECOND * np.asarray(noise)))
    of_earlier, of_first, of_second, of_later = np.sqrt(np.maximum(bent**2 - least, 0.0))
    rest = 1.0 - fraction
    jumped = np.minimum(of_first, of_second) * np.sqrt(fraction * rest)
    curved = np.minimum(fraction * of_first, rest * of_second) / math.sqrt(3.0)
    began = np.minimum(of_earlier, of_second) * rest * np.sqrt(1.0 - rest**2)
    ended = np.minimum(of_first, of_later) * fraction * np.sqrt(1.0 - fraction**2)
    missed = np.where(first * second < 0.0, jumped, curved)
    missed = np.maximum(missed, np.where(earlier * second < 0.0, began, 0.0))
    missed = np.maximum(missed, np.where(first * later < 0.0, ended, 0.0))
    since_last = np.maximum(shown - stamp_ns[-1], 0).astype(np.float64)[:, None]
    extrapolated = np.abs(slopes[-2]) * np.minimum(since_last, length)
    error: Array = np.where(since_last > 0.0, extrapolated, missed)
    return error.reshape(len(shown), *values.shape[1:])


def furthest_error(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the largest possible interpolation error relative to `interpolation_error`.

    (shown,). For a jump: the whole jump, if it happened in the shorter part of the interval. For a
    curved signal: the extrapolation from either side.
    """
    of_bent_course = np.full(len(shown), math.sqrt(3.0))
    if len(stamp_ns) < 2:
        return of_bent_course
    _, fraction = places_between(shown, stamp_ns)
    shorter = np.maximum(np.minimum(fraction, 1.0 - fraction), NEVER)
    return np.asarray(np.maximum(of_bent_course, np.sqrt((1.0 - shorter) / shorter)))


def rate_of(times: Array, values: Array, noise: float) -> float:
    """Return the rate of values (n,) at times (n,) s, of a line through them; 0 for fewer than 2.

    It is multiplied by the share of its square that noise does not explain: noise has no course.
    noise: white noise of a value; what the values scatter about the line, if that is more.
    """
    if len(times) < 2:
        return 0.0
    times = times - times.mean()
    length = float(times @ times)
    rate = float(times @ values) / length
    residual = values - values.mean() - rate * times
    scatter = float(residual @ residual) / max(len(times) - 2, 1)
    variance = max(scatter, noise**2) / length
    return rate - variance / rate if rate**2 > variance else 0.0


def error_between(shown_ns: int, stamp_ns: Stamps, values: Array, noise: float) -> float:
    """Return a plausible bound of the interpolation error at one stamp, for values (stamps,).

    It is sqrt(3) sigma, or the largest possible error if that is smaller. noise: white noise of a
    value. Values after the last one are not known yet.
    """
    shown = np.array([shown_ns])
    error = interpolation_error(shown, stamp_ns, values, noise)
    return float(error[0]) * min(float(furthest_error(shown, stamp_ns)[0]), math.sqrt(3.0))
