"""A recording of the virtual lab as calibration and diagnosis see it, without a file between."""

from __future__ import annotations

import numpy as np
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.run import Run


def run_of(recording: LabRecording) -> Run:
    """Return the run in a recording of the virtual lab; frames without any target are left out."""
    kept = np.isfinite(recording.x).any(axis=1)
    return Run(
        name=recording.scenario.name,
        reading_stamp_ns=recording.reading_stamp_ns,
        pressure=recording.pressure,
        stamp_ns=recording.stamp_ns[kept],
        reading=recording.reading[kept],
        loaded=recording.loaded,
        force=recording.force[kept],
        moment=recording.moment[kept],
        x=recording.x[kept],
        y=recording.y[kept],
    )
