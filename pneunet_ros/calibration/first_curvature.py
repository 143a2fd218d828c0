"""The curvature with which the search for kappa_p0 begins: that of the arcs which frames show.

A search that begins with a straight arm comes by shapes that are nowhere near, and there a table
that jumps from row to row explains any misfit by the noise of the pressure: with a noisy sensor
it may never come back. Weight bends the arm as well, so this is where to begin and no more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

MOST_TURNS = 2.0  # of a tip; no finger curls more
ARCS = 401  # that are tried


def first_curvature(runs: Sequence[RecordingData], arm: Arm, pressure: Array) -> Array:
    """Return the curvature (rows,) 1/m at pressures (rows,) Pa, on a line over the pressure.

    runs: unloaded; arm: with the targets and the angle of the clamp.
    """
    read = np.concatenate([run.pressure[run.reading] for run in runs])
    upright = np.exp(-1j * arm.clamp_angle)
    shown = np.concatenate(
        [arc_curvature((run.x + 1j * run.y) * upright, arm.target_arclength) for run in runs]
    )
    if not np.ptp(read) > 0.0:
        return np.full(pressure.shape, shown.mean())
    middle = read.mean()
    slope, offset = np.polyfit(read - middle, shown, 1)
    return np.asarray(offset + slope * (pressure - middle))


def arc_curvature(seen: npt.NDArray[np.complex128], arclength: Array) -> Array:
    """Return the curvature (frames,) 1/m of the arcs from the clamp that targets lie on best.

    seen (frames, targets) m: x + i y of targets, x along the clamp, NaN where one was not seen;
    arclength (targets,) m.
    """
    most = 2.0 * np.pi * MOST_TURNS / arclength.max()
    arcs = np.linspace(-most, most, ARCS)
    half = 0.5 * arcs[:, None] * arclength
    chord = arclength * np.sinc(half / np.pi) * np.exp(1j * half)
    counts = np.isfinite(seen)
    places = np.where(counts, seen, 0.0)
    # Of |places - chord|^2 over the targets seen, what does not go with the arc is left out.
    misfit = counts @ np.abs(chord.T) ** 2 - 2.0 * (places @ chord.T.conj()).real
    return np.asarray(arcs[np.argmin(misfit, axis=1)])
