"""Visibility of targets over time, as the cells of a heat map."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array

COLUMNS = 600  # at most
GAP = 3.0  # usual distances of frames, from which there is a gap


def heat(times: Array, statuses: Array) -> tuple[Array, Array]:
    """Return time edges (n + 1,) and cell values (n, targets) of a heat map.

    statuses (frames, targets): 1 seen, 0 missing, -1 without explanation. Cell values are the
    share of explained frames in which a target was seen, -1 without explained frames, NaN without
    frames.
    """
    together = math.ceil(len(times) / COLUMNS)
    usual = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    usual = usual or 1.0
    edges: list[float] = []
    shares: list[Array] = []
    for first in range(0, len(times), together):
        group = statuses[first : first + together]
        explained = group[group[:, 0] >= 0.0] if group.shape[1] else group
        if edges and times[first] > edges[-1] + GAP * usual:
            shares.append(np.full(group.shape[1], np.nan))
        elif edges:
            edges.pop()
        edges.append(float(times[first]))
        shares.append(explained.mean(axis=0) if len(explained) else np.full(group.shape[1], -1.0))
        edges.append(float(times[min(first + together, len(times)) - 1]) + usual)
    return np.array(edges), np.array(shares)
