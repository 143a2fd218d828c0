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
NEVER = 1e-6  # share of the time between two readings in which nothing jumps
SIGMA_OF_SECOND = math.sqrt(6.0)  # of a second difference, over that of a reading


@dataclass(frozen=True, slots=True, kw_only=True)
class BetweenReadingsSettings:
    """Criteria for changes between readings that interpolation misses."""

    noise: float = tuning(
        2.0, 'size of a second difference that noise does not explain', unit='sigma'
    )


BETWEEN_READINGS = BetweenReadingsSettings()


def interpolate(shown: Stamps, stamp_ns: Stamps, values: Array) -> Array:
    """Return values (stamps,) interpolated linearly at other stamps."""
    first = stamp_ns[0]  # no float holds a stamp
    return np.asarray(np.interp(shown - first, stamp_ns - first, values))


def interpolated_noise(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the noise of interpolated values (stamps,), relative to that of a reading.

    On the line between two readings, a part of their white noise averages out.
    """
    if len(stamp_ns) < 2:
        return np.ones(len(shown))
    _, share = places_between(shown, stamp_ns)
    return np.asarray(np.hypot(1.0 - share, share))


def places_between(shown: Stamps, stamp_ns: Stamps) -> tuple[Stamps, Array]:
    """Return the index of the reading before each stamp, and the fraction to the next, 0 to 1."""
    before = np.minimum(np.maximum(stamp_ns.searchsorted(shown), 1), len(stamp_ns) - 1) - 1
    start = stamp_ns[before]
    apart = np.maximum(stamp_ns[before + 1] - start, 1)  # of one stamp: no line
    share = np.minimum(np.maximum((shown - start) / apart, 0.0), 1.0)
    return before, np.asarray(share)


def frames_sharing(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the number of shown frames that share the readings of each frame, (shown,).

    These frames share the noise of the same two readings, and the error of the line between them:
    they are the frames within the time between those readings. shown: not decreasing.
    """
    if len(stamp_ns) < 2:
        return np.full(len(shown), float(len(shown)))
    before, _ = places_between(shown, stamp_ns)
    half = np.diff(stamp_ns)[before] // 2
    around = np.minimum(np.maximum(shown, shown[0] + half), shown[-1] - half)
    first, last = np.searchsorted(shown, [around - half, around + half])
    at_end = around == shown[-1] - half  # where the window ends with the last frame
    behind = np.searchsorted(shown, [around - half, around + half], side='right')
    first, last = np.where(at_end, behind, [first, last])
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
    out = np.zeros((len(shown), *values.shape[1:]))
    if len(stamp_ns) < 2:
        return out
    before, share = places_between(shown, stamp_ns)
    columns = frozen_array(values.reshape(len(stamp_ns), -1))
    least = np.empty(columns.shape[1])
    least[:] = explained_changes(np.asarray(noise), settings)
    apart = np.maximum(stamp_ns[1:] - stamp_ns[:-1], 1).astype(np.float64)
    late = np.maximum(shown - stamp_ns[-1], 0).astype(np.float64)
    missed_by_lines(columns, apart, least, before, share, late, out.reshape(len(shown), -1))
    return out


def explained_changes(noise: Array, settings: BetweenReadingsSettings = BETWEEN_READINGS) -> Array:
    """Return the squares of the second differences that white noise of these sizes explains."""
    return np.asarray(np.square(settings.noise * SIGMA_OF_SECOND * noise))


def place_between(shown_ns: int, stamp_ns: Stamps) -> tuple[int, float]:
    """Return `places_between` of one stamp."""
    places, shares = places_between(np.array([shown_ns]), stamp_ns)
    return int(places[0]), float(shares[0])


@kernel
def missed_by_lines(
    values: Array,
    apart: Array,
    least: Array,
    before: Stamps,
    share: Array,
    late: Array,
    out: Array,
) -> None:
    """`interpolation_error` into out (shown, columns).

    values (readings, columns), `apart` (readings - 1,) ns; least (columns,): square of a second
    difference that noise explains; before, share (shown,): as from `places_between`; late (shown,)
    ns: time after the last reading.
    """
    for column in range(values.shape[1]):
        for frame in range(before.size):
            out[frame, column] = missed_by_line(
                values, apart, least[column], before[frame], share[frame], late[frame], column
            )


@inner
def line_between(shown_ns: int, stamp_ns: Stamps, values: Array, least: Array, out: Array) -> None:
    """Interpolate at one stamp, with noise and errors, into out (4, columns).

    values (readings, columns); least (columns,): as of `explained_changes`. Rows: VALUE, as of
    `interpolate`; NOISE, as of `interpolated_noise`; MISSED, as of `interpolation_error`;
    FURTHEST, as of `furthest_error`.
    """
    count, columns = values.shape
    here, part, late = 0, 0.0, 0.0
    apart = np.ones(max(count - 1, 0))
    for i in range(count - 1):
        apart[i] = max(stamp_ns[i + 1] - stamp_ns[i], 1)
        if i == 0 or stamp_ns[i] < shown_ns:
            here = i
    if count > 1:
        part = min(max((shown_ns - stamp_ns[here]) / apart[here], 0.0), 1.0)
        late = max(shown_ns - stamp_ns[count - 1], 0) * 1.0
    for column in range(columns):
        out[VALUE, column], out[NOISE, column] = values[here, column], 1.0
        out[MISSED, column], out[FURTHEST, column] = 0.0, math.sqrt(3.0)
        if count > 1:
            out[VALUE, column] += part * (values[here + 1, column] - values[here, column])
            out[NOISE, column] = math.hypot(1.0 - part, part)
            out[MISSED, column] = missed_by_line(
                values, apart, least[column], here, part, late, column
            )
            out[FURTHEST, column] = furthest_jump(part)


@inlined
def furthest_jump(part: float) -> float:
    """Return `furthest_error` at a share of the way between two readings."""
    least = max(min(part, 1.0 - part), NEVER)
    furthest: float = max(math.sqrt(3.0), math.sqrt((1.0 - least) / least))
    return furthest


@inner
def missed_by_line(
    values: Array, apart: Array, least: float, here: int, part: float, late: float, column: int
) -> float:
    """Return `interpolation_error` of one column at one stamp.

    least: square of a second difference that noise explains; here, part: place between readings;
    late (ns): behind the last reading.
    """
    length = apart[here]
    if late > 0.0:
        further: float = min(late, length)
        return abs(slope_between(values, apart, column, apart.size - 1)) * further
    earlier = bend_at(values, apart, column, here - 1) * length
    first = bend_at(values, apart, column, here) * length
    second = bend_at(values, apart, column, here + 1) * length
    later = bend_at(values, apart, column, here + 2) * length
    of_earlier = math.sqrt(max(earlier * earlier - least, 0.0))
    of_first = math.sqrt(max(first * first - least, 0.0))
    of_second = math.sqrt(max(second * second - least, 0.0))
    of_later = math.sqrt(max(later * later - least, 0.0))
    if first * second < 0.0:
        missed = min(of_first, of_second) * math.sqrt(part * (1.0 - part))
    else:
        missed = min(part * of_first, (1.0 - part) * of_second) / math.sqrt(3.0)
    if earlier * second < 0.0:
        left = 1.0 - part
        began = min(of_earlier, of_second) * left * math.sqrt(1.0 - left * left)
        missed = max(missed, began)
    if first * later < 0.0:
        ended = min(of_first, of_later) * part * math.sqrt(1.0 - part * part)
        missed = max(missed, ended)
    return missed


@inlined
def bend_at(values: Array, apart: Array, column: int, reading: int) -> float:
    """Return the change of slope at a reading; zero outside the readings."""
    if reading < 0 or reading >= len(values):
        return 0.0
    slope = slope_between(values, apart, column, reading)
    return slope - slope_between(values, apart, column, reading - 1)


@inlined
def slope_between(values: Array, apart: Array, column: int, reading: int) -> float:
    """Return the slope from a reading to the next; zero before the first and after the last."""
    if reading < 0 or reading >= apart.size:
        return 0.0
    slope: float = (values[reading + 1, column] - values[reading, column]) / apart[reading]
    return slope


def furthest_error(shown: Stamps, stamp_ns: Stamps) -> Array:
    """Return the bound of the interpolation error relative to `interpolation_error`.

    For a jump, the whole jump, if the value jumped in the shorter part of the interval; for a bent
    course, the extrapolation from either side, (shown,).
    """
    bent = np.full(len(shown), math.sqrt(3.0))
    if len(stamp_ns) < 2:
        return bent
    _, share = places_between(shown, stamp_ns)
    least = np.maximum(np.minimum(share, 1.0 - share), NEVER)
    return np.asarray(np.maximum(bent, np.sqrt((1.0 - least) / least)))


def error_between(shown_ns: int, stamp_ns: Stamps, values: Array, noise: float) -> float:
    """Return a plausible bound of the interpolation error at one stamp, for values (stamps,).

    It is sqrt(3) sigma, or the largest possible error if that is smaller. noise: white, of a
    value. Values after the last one are not known yet.
    """
    shown = np.array([shown_ns])
    error = interpolation_error(shown, stamp_ns, values, noise)
    return float(error[0]) * min(float(furthest_error(shown, stamp_ns)[0]), math.sqrt(3.0))
