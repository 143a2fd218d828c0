"""Readings as a piecewise linear function, for values at other times.

An effect with memory smooths the readings: a play operator as wide as the noise holds them
constant, and a lag averages them, as does a delay that places a frame between two readings. At
constant pressure and load, smoothed readings predict better than raw ones, so that such effects
would be found in recordings without them. Effects with memory therefore use filtered readings, and
every frame keeps the noise of its own reading, for any memory and delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.between_readings import interpolate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.domain import DOMAIN
from pneunet_ros.model.uncertainty import SensorNoise

Piece = tuple[int, int]  # first and last reading of a straight line


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingFilterSettings:
    """Thresholds at which noise no longer explains a deviation from a straight line."""

    corner: float = tuning(
        25.0,
        'significant improvement by a slope, or by a second line',
        unit='chi squared',
        source='sweep',
    )


READING_FILTER = ReadingFilterSettings()
NO_NOISE = 1e-9  # std in place of zero, relative to the range of the readings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilteredReadings:
    """A run with piecewise linear pressure, and a reading at each frame.

    The load is that read at the frames; the wrench is piecewise linear. noise (frames,) Pa:
    deviation of the pressure reading of each frame from its line.
    """

    run: RecordingData
    noise: Array


def filter_readings(run: RecordingData, noise: SensorNoise) -> FilteredReadings:
    """Return the piecewise linear pressure and load of a run.

    Between corners, the readings follow a straight line within their noise; steps, turning points
    and other visible features keep their times. Steps between two readings, and readings that
    noise does not explain, are unchanged. Static frames are not changed.
    """
    if run.static:
        return FilteredReadings(run=run, noise=np.zeros(len(run.stamp_ns)))
    stamps = run.reading_stamp_ns
    lines = Lines(stamps, run.pressure, noise.pressure_std)
    pieces = lines.pieces()
    fitted = lines.joined(pieces)
    kept = np.union1d(stamps[np.array(pieces).ravel()], run.instants)
    return FilteredReadings(
        run=replace(
            run,
            reading_stamp_ns=kept,
            pressure=interpolate(kept, stamps, fitted),
            reading=np.searchsorted(kept, run.instants),
            wrench=filter_wrench(run, noise),
        ),
        noise=run.frame_pressure - fitted[run.reading],
    )


def filter_wrench(run: RecordingData, noise: SensorNoise) -> Array | None:
    """Return the piecewise linear load at all its readings (wrenches, 3) N, N m."""
    if run.wrench_stamp_ns is None or run.wrench is None:
        return run.wrench
    return filter_load(run.wrench_stamp_ns, run.wrench, noise)


def filter_load(stamp_ns: Stamps, load: Array, noise: SensorNoise) -> Array:
    """Return the piecewise linear fit of loads (n, 3) N, N m."""
    stds = noise.force_std, noise.force_std, noise.moment_std
    return np.column_stack(
        [filtered(stamp_ns, values, std) for values, std in zip(load.T, stds, strict=True)]
    )


def filtered(stamp_ns: Stamps, values: Array, std: float) -> Array:
    """Return the piecewise linear fit of values (n,)."""
    lines = Lines(stamp_ns, values, std)
    return lines.joined(lines.pieces())


def without_reading_noise(run: RecordingData, noise: SensorNoise) -> RecordingData:
    """Return a run with all readings replaced by their piecewise linear fit.

    Used to simulate an arm with mass, which the noise of the readings would excite.
    """
    if run.static:
        return run
    load = run.load
    if run.loaded and run.wrench is None:
        load = filter_load(run.stamp_ns, load, noise)
    return replace(
        run,
        pressure=filtered(run.reading_stamp_ns, run.pressure, noise.pressure_std),
        force=load[:, :2],
        moment=load[:, 2],
        wrench=filter_wrench(run, noise),
    )


class Lines:
    """Least-squares lines through parts of a series, from cumulative sums."""

    def __init__(self, stamp_ns: Stamps, values: Array, std: float) -> None:
        seconds = (stamp_ns - stamp_ns[0]) / NANOSECONDS_PER_SECOND
        self.time = seconds - seconds.mean()
        self.level = float(values.mean())
        self.std = max(std, NO_NOISE * float(np.ptp(values))) or 1.0
        self.values = (values - self.level) / self.std

    def sums_of(self, first: int, last: int) -> Array:
        """Return the sums of the first readings of a part, (6, readings): of one, of two, ...

        Time and values are relative to the middle of the part: in a long series the differences of
        sums over all of it would be rounding errors.
        """
        part = slice(first, last + 1)
        time = self.time[part] - self.time[part].mean()
        values = self.values[part] - self.values[part].mean()
        products = np.stack([np.ones_like(time), time, time**2, values, time * values, values**2])
        return np.asarray(np.cumsum(products, axis=1))

    def pieces(self) -> list[Piece]:
        """Return the line segments, split until noise explains their residuals."""
        pending, segments = [(0, self.values.size - 1)], []
        while pending:
            first, last = pending.pop()
            corner = self.corner(first, last)
            if corner is None:
                segments.append((first, last))
            else:
                pending += [(corner + 1, last), (first, corner)]
        pieces: list[Piece] = []
        for piece in segments:  # merge pieces again after an unnecessary early split
            if pieces and self.corner(pieces[-1][0], piece[1]) is None:
                pieces[-1] = (pieces[-1][0], piece[1])
            else:
                pieces.append(piece)
        return pieces

    def corner(self, first: int, last: int) -> int | None:
        """Return the best index at which to split a segment; None if one line explains it."""
        count = last - first + 1
        if count < 3:
            return None
        sums = self.sums_of(first, last)
        two_lines = chi_squared(sums[:, :-1]) + chi_squared(sums[:, -1:] - sums[:, :-1])
        best, one_line = int(np.argmin(two_lines)), float(chi_squared(sums[:, -1:])[0])
        scatter = one_line - count > DOMAIN.significant * np.sqrt(2.0 * count)
        if one_line - two_lines[best] <= READING_FILTER.corner and not scatter:
            return None
        return first + best

    def joined(self, pieces: list[Piece]) -> Array:
        """Return the fitted value at every reading."""
        return np.concatenate([self.fitted(*piece) for piece in pieces])

    def fitted(self, first: int, last: int) -> Array:
        """Return the line fitted to a segment; constant if noise explains its slope.

        Two readings are not fitted: they are kept unchanged.
        """
        part = self.values[first : last + 1]
        if part.size < 3:
            return np.asarray(self.level + self.std * part)
        time = self.time[first : last + 1] - self.time[first : last + 1].mean()
        tt, tp = float(time @ time), float(time @ part)
        slope = tp / tt if tp**2 > READING_FILTER.corner * tt else 0.0
        line = part.mean() + slope * time
        return np.asarray(self.level + self.std * line)


def moments(sums: Array) -> tuple[Array, Array, Array, Array]:
    """Return count and central sums of t t, t p, p p, from sums (6, n) of parts of a series."""
    count, t, tt, p, tp, pp = sums
    return count, tt - t * t / count, tp - t * p / count, pp - p * p / count


def chi_squared(sums: Array) -> Array:
    """Return the chi squared of the best lines through parts of a series, (n,)."""
    count, tt, tp, pp = moments(sums)
    remainder = pp - np.divide(tp**2, tt, out=np.zeros_like(tp), where=tt > 0.0)
    return np.where(count > 2, np.maximum(remainder, 0.0), 0.0)
