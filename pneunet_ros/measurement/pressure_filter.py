"""Pressure readings without most of their noise, for what an effect remembers of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.dataset import RecordingData
from scipy.ndimage import uniform_filter1d


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureFilterSettings:
    """How readings of pressure are smoothed and thinned."""

    width: int = tuning(5, 'neighbors in a mean', unit='readings')
    most_readings: int = tuning(400, 'of a run, beside those of its frames')


PRESSURE_FILTER = PressureFilterSettings()


def smooth_pressure(
    run: RecordingData, settings: PressureFilterSettings = PRESSURE_FILTER
) -> RecordingData:
    """Return a run with fewer pressure readings, each a mean of neighbors, without most noise.

    A line or a play would else do good by smoothing the noise of the sensor alone. The noise of
    the reading at each frame is put back behind them.
    """
    count = len(run.pressure)
    if count < settings.width:
        return run
    smooth = uniform_filter1d(run.pressure, settings.width, mode='nearest')
    thinned = np.linspace(0, count - 1, min(count, settings.most_readings)).astype(np.int64)
    kept = np.union1d(thinned, run.reading)
    return replace(
        run,
        reading_stamp_ns=run.reading_stamp_ns[kept],
        pressure=smooth[kept],
        reading=np.searchsorted(kept, run.reading),
    )
