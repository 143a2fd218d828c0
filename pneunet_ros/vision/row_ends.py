"""The end of a row of targets: a gap that is too long, unless similar blobs follow."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.vision.beam_search import (
    ALONG_STD,
    BeamSearchSettings,
    BlobColumns,
    HEADING,
    Indices,
    LAST,
    look_cost,
    misfit,
    NOTHING,
    off_arc,
    SCALE,
    search_numbers,
    SIZE,
    X,
    Y,
)


def truncate_row(
    x: Array,
    y: Array,
    arclength: Array,
    clamp_angle: float,
    chosen: Indices,
    search: BeamSearchSettings,
) -> None:
    """End a row at the first gap that does not match the number of missing targets.

    Beyond such a gap, the index may be off by one target. The length of a gap is that of a curve
    with the headings at its ends; the stretch of the arm is estimated from the targets next to the
    gap.
    """
    seen = np.flatnonzero(chosen >= 0)
    if seen.size < 3:
        return
    steps = np.hypot(np.diff(x[chosen[seen]]), np.diff(y[chosen[seen]]))
    scale = float(np.median(steps / np.diff(arclength[seen])))
    for place in np.flatnonzero(np.diff(seen, prepend=-1) > 1).tolist():
        target = seen[place]
        from_x = from_y = passed = 0.0
        heading = clamp_angle
        if place > 0:
            before = seen[place - 1]
            from_x, from_y = x[chosen[before]], y[chosen[before]]
            passed = arclength[before]
            if place > 1:
                heading = _end_heading(x, y, arclength, chosen, seen[:place][::-1][:3]) + math.pi
        onward = heading
        if place + 1 < seen.size:
            onward = _end_heading(x, y, arclength, chosen, seen[place:][:3])
        chord_x, chord_y = x[chosen[target]] - from_x, y[chosen[target]] - from_y
        chord = math.atan2(chord_y, chord_x)
        a, b = _wrap_angle(np.array([heading - chord, onward - chord])).tolist()
        longer = 1.0 + (2.0 * a * a + 2.0 * b * b - a * b) / 30.0
        length = longer * math.hypot(chord_x, chord_y)
        allowed = search.farthest * ALONG_STD * _spacing_at(arclength, target)
        if abs(length / scale - (arclength[target] - passed)) > allowed:
            chosen[target:] = NOTHING
            return


def _end_heading(x: Array, y: Array, arclength: Array, chosen: Indices, places: Indices) -> float:
    """Return the heading at the first of two or three targets, on the arc through them."""
    at = chosen[places]
    headings = np.arctan2(np.diff(y[at]), np.diff(x[at]))
    if places.size < 3:
        return float(headings[0])
    steps = np.abs(np.diff(arclength[places]))
    turn = _wrap_angle(headings[1:] - headings[0])[0]
    return float(headings[0] - turn * steps[0] / steps.sum())


def _wrap_angle(angle: Array) -> Array:
    """Wrap angles to (-pi, pi]."""
    return np.asarray(angle - 2.0 * math.pi * np.floor(angle / (2.0 * math.pi) + 0.5))


def continues_beyond(
    blobs: BlobColumns, arclength: Array, chosen: Indices, search: BeamSearchSettings
) -> bool:
    """Whether there is another similar blob one spacing beyond the last target of a row."""
    x, y, looks, _ = blobs
    seen = np.flatnonzero(chosen >= 0)
    if seen.size < 2:
        return False
    a, b = chosen[seen[-2:]].tolist()
    step_x, step_y = x[b] - x[a], y[b] - y[a]
    row = np.zeros(LAST + 1)
    row[X], row[Y], row[HEADING] = x[b], y[b], math.atan2(step_y, step_x)
    row[SIZE:LAST] = looks[:, b]
    row[SCALE] = math.hypot(step_x, step_y) / (arclength[-1] - arclength[seen[-2]])
    spacing = _spacing_at(arclength, arclength.size - 1)
    unit = float(row[SCALE]) * spacing
    return bool(_continues(blobs.table, row, b, spacing, unit, search_numbers(search)))


@kernel
def _continues(
    blobs: Array, row: Array, last: int, spacing: float, unit: float, search: BeamSearchSettings
) -> bool:
    """Whether a blob continues a row; last: the blob at its end.

    blobs (BLOB_ROWS, blobs): x, y, appearance and costs; row (LAST + 1,); spacing m; unit: the
    spacing in the image.
    """
    for blob in range(blobs.shape[1]):
        x, y = blobs[0, blob], blobs[1, blob]
        if blob == last or abs(x - row[X]) > 2.0 * unit or abs(y - row[Y]) > 2.0 * unit:
            continue
        along, across = off_arc(x, y, row, spacing)
        cost = misfit(along / unit, across / unit, 0.0, search)
        if cost + look_cost(blobs, blob, row, search) < search.continues:
            return True
    return False


def _spacing_at(arclength: Array, target: int) -> float:
    """Return the distance along the arm from the previous target, m."""
    return float(arclength[max(target, 1)] - arclength[max(target, 1) - 1])
