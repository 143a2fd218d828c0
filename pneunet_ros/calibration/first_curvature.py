"""Initial guess of kappa_p0: circular arcs through the targets of each frame.

A search that starts with a straight arm passes through shapes far from the data, where a table
that jumps from row to row explains any misfit by pressure noise; with a noisy sensor, the search
may not recover. The guess is only a starting point, because the weight also bends the arm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

MOST_TURNS = 2.0  # largest angle of the tip to try; invented
ARCS = 401  # tried


def first_curvature(runs: Sequence[RecordingData], arm: Arm, pressure: Array) -> Array:
    """Return the curvature (rows,) 1/m at pressures (rows,) Pa, linear in the pressure.

    runs: unloaded; arm: with the targets and the angle of the clamp.
    """
    read = np.concatenate([run.frame_pressure for run in runs])
    upright = np.exp(-1j * arm.clamp_angle)
    seen = np.concatenate([(run.x + 1j * run.y) * upright for run in runs])
    # The clamp's own target, alone in a frame, has no information.
    weights = np.isfinite(seen) @ arm.target_arclength**2
    shown = np.zeros(read.shape)
    if weights.any():
        shown = arc_curvature(seen, arm.target_arclength)
    else:
        turn, known = tip_turns(runs, arm)
        shown, weights = turn / arm.length, known.astype(np.float64)
    if not weights.any():
        return np.zeros(pressure.shape)
    middle = np.average(read, weights=weights)
    if not np.ptp(read[weights > 0.0]) > 0.0:
        return np.full(pressure.shape, np.average(shown, weights=weights))
    slope, offset = np.polyfit(read - middle, shown, 1, w=np.sqrt(weights))
    return np.asarray(offset + slope * (pressure - middle))


def tip_turns(runs: Sequence[RecordingData], arm: Arm) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the tip angle (frames,) rad relative to the clamp, and the frames that show the tip.

    The angle is assumed to change by less than half a turn from each frame to the frame with the
    next higher pressure, in any run.
    """
    pressure = np.concatenate([run.frame_pressure for run in runs])
    turn = np.concatenate(
        [np.full(len(run.x), np.nan) if run.heading is None else run.heading for run in runs]
    )
    order = np.argsort(pressure, kind='stable')
    order = order[np.isfinite(turn[order])]
    turn[order] = np.unwrap(turn[order] - arm.clamp_angle)
    return np.nan_to_num(turn), np.isfinite(turn)


def arc_curvature(seen: npt.NDArray[np.complex128], arclength: Array) -> Array:
    """Return the curvature (frames,) 1/m of the best-fitting arcs from the clamp.

    seen (frames, targets) m: x + i y of targets, x along the clamp, NaN where one was not seen;
    arclength (targets,) m.
    """
    most = 2.0 * np.pi * MOST_TURNS / arclength.max()
    arcs = np.linspace(-most, most, ARCS)
    half = 0.5 * arcs[:, None] * arclength
    chord = arclength * np.sinc(half / np.pi) * np.exp(1j * half)
    counts = np.isfinite(seen)
    places = np.where(counts, seen, 0.0)
    # |places - chord|^2 over the seen targets, without the terms that do not depend on the arc.
    misfit = counts @ np.abs(chord.T) ** 2 - 2.0 * (places @ chord.T.conj()).real
    return np.asarray(arcs[np.argmin(misfit, axis=1)])
