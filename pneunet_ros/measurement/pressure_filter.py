"""Pressure readings as straight lines between corners, for what an effect remembers of them.

An effect with a memory takes noise off the readings: a play as wide as the noise holds them still,
and a line averages them. Where pressure rests, that predicts better than the readings themselves,
and both come out of recordings that have neither. So they are given what the readings say beyond
their noise, and every frame keeps the noise of its own reading, whatever the memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.dataset import RecordingData

Piece = tuple[int, int]  # first and last reading of a straight line


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureFilterSettings:
    """From when on noise does not explain that readings leave a straight line."""

    corner: float = tuning(25.0, 'gain of two lines over one', unit='chi squared')
    slope: float = tuning(9.0, 'gain of a slope over none', unit='chi squared')
    scatter: float = tuning(4.0, 'chi squared of a line above its mean', unit='std')
    least_std: float = tuning(1e-3, 'stands for readings without noise', unit='Pa')
    same_instant: float = tuning(0.1, 'distance of a frame from its reading', unit='period')


PRESSURE_FILTER = PressureFilterSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilteredPressure:
    """A run with the corners of its pressure, and a reading at the instant of each of its frames.

    noise (frames,) Pa: by how much the reading of each frame lies above its line.
    """

    run: RecordingData
    noise: Array


def filter_pressure(
    run: RecordingData, std: float, settings: PressureFilterSettings = PRESSURE_FILTER
) -> FilteredPressure:
    """Return the straight lines that a run's pressure follows.

    Between corners the readings lie on a straight line within their noise, std (Pa), so that a
    step, a turning point and all else that can be seen in the readings stays where it was; a step
    between two readings, and readings that noise does not explain, are kept as they are. A frame
    between two readings is on the line between them. Static frames are left alone.
    """
    if run.static:
        return FilteredPressure(run=run, noise=np.zeros(len(run.stamp_ns)))
    stamps = run.reading_stamp_ns
    seconds = (stamps - stamps[0]) / NANOSECONDS_PER_SECOND
    lines = Lines(seconds, run.pressure, max(std, settings.least_std), settings)
    pieces = lines.pieces()
    fitted = np.concatenate([lines.fitted(*piece) for piece in pieces])
    instants = frame_instants(run, settings)
    kept = np.union1d(stamps[np.array(pieces).ravel()], instants)
    return FilteredPressure(
        run=replace(
            run,
            reading_stamp_ns=kept,
            pressure=np.interp((kept - stamps[0]) / NANOSECONDS_PER_SECOND, seconds, fitted),
            reading=np.searchsorted(kept, instants),
        ),
        noise=run.frame_pressure - fitted[run.reading],
    )


def frame_instants(run: RecordingData, settings: PressureFilterSettings) -> Stamps:
    """Return when every frame was taken, (frames,) ns: at its reading where they hardly differ.

    A camera that is triggered by the readings has stamps with a jitter of their own.
    """
    own = run.reading_stamp_ns[run.reading]
    if len(run.reading_stamp_ns) < 2:
        return own
    period = float(np.median(np.diff(run.reading_stamp_ns)))
    together = np.abs(run.stamp_ns - own) <= settings.same_instant * period
    instants: Stamps = np.where(together, own, run.stamp_ns)
    return instants.clip(run.reading_stamp_ns[0], run.reading_stamp_ns[-1])


class Lines:
    """Least-squares lines through parts of a series, by sums over all that comes before."""

    def __init__(
        self, seconds: Array, values: Array, std: float, settings: PressureFilterSettings
    ) -> None:
        self.time, self.settings = seconds - seconds.mean(), settings
        self.level = float(values.mean())
        self.values = (values - self.level) / std
        self.std = std
        products = np.stack(
            [
                np.ones_like(self.time),
                self.time,
                self.time**2,
                self.values,
                self.time * self.values,
                self.values**2,
            ]
        )
        self.sums = np.concatenate([np.zeros((6, 1)), np.cumsum(products, axis=1)], axis=1)

    def moments(
        self, first: npt.ArrayLike, last: npt.ArrayLike
    ) -> tuple[Array, Array, Array, Array]:
        """Return count, and central sums of t t, t p and p p of parts of the series."""
        first, last = np.broadcast_arrays(first, last)
        sums = self.sums[:, last + 1] - self.sums[:, first]
        count, t, tt, p, tp, pp = sums
        return count, tt - t * t / count, tp - t * p / count, pp - p * p / count

    def chi_squared(self, first: npt.ArrayLike, last: npt.ArrayLike) -> Array:
        """Return what the best lines leave of parts of the series, in units of the noise."""
        count, tt, tp, pp = self.moments(first, last)
        left = pp - np.divide(tp**2, tt, out=np.zeros_like(tp), where=count > 1)
        return np.where(count > 2, np.maximum(left, 0.0), 0.0)

    def pieces(self) -> list[Piece]:
        """Return the lines: parts are split in two while noise does not explain them."""
        waiting, split = [(0, self.values.size - 1)], []
        while waiting:
            first, last = waiting.pop()
            corner = self.corner(first, last)
            if corner is None:
                split.append((first, last))
            else:
                waiting += [(corner + 1, last), (first, corner)]
        pieces: list[Piece] = []
        for piece in split:  # where the first split of all was none
            if pieces and self.corner(pieces[-1][0], piece[1]) is None:
                pieces[-1] = (pieces[-1][0], piece[1])
            else:
                pieces.append(piece)
        return pieces

    def corner(self, first: int, last: int) -> int | None:
        """Return after which reading a part is best split; None where a line explains it."""
        count = last - first + 1
        if count < 3:
            return None
        after = np.arange(first, last)
        both = self.chi_squared(first, after) + self.chi_squared(after + 1, last)
        best, whole = int(np.argmin(both)), float(self.chi_squared(first, last))
        scatter = whole - count > self.settings.scatter * np.sqrt(2.0 * count)
        if whole - both[best] <= self.settings.corner and not scatter:
            return None
        return first + best

    def fitted(self, first: int, last: int) -> Array:
        """Return the line (Pa) at every reading of a part; level where noise explains its slope.

        Two readings are no line: they stay as they are.
        """
        part = self.values[first : last + 1]
        if part.size < 3:
            return np.asarray(self.level + self.std * part)
        _, tt, tp, _ = (float(value) for value in self.moments(first, last))
        slope = tp / tt if tp**2 > self.settings.slope * tt else 0.0
        time = self.time[first : last + 1]
        line = part.mean() + slope * (time - time.mean())
        return np.asarray(self.level + self.std * line)
