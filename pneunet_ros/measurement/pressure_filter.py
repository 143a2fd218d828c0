"""Pressure readings without most of their noise, for what an effect remembers of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.measurement.dataset import RecordingData
from scipy.ndimage import uniform_filter1d

CALM = 5  # readings
READINGS = 400  # of a run, beside those of its frames


def smooth_pressure(run: RecordingData) -> RecordingData:
    """Return a run with fewer pressure readings, each a mean of neighbors, without most noise.

    A line or a play would else do good by smoothing the noise of the sensor alone. The noise of
    the reading at each frame is put back behind them.
    """
    count = len(run.pressure)
    if count < CALM:
        return run
    smooth = uniform_filter1d(run.pressure, CALM, mode='nearest')
    spread = np.linspace(0, count - 1, min(count, READINGS)).astype(np.int64)
    kept = np.union1d(spread, run.reading)
    return replace(
        run,
        reading_stamp_ns=run.reading_stamp_ns[kept],
        pressure=smooth[kept],
        reading=np.searchsorted(kept, run.reading),
    )
