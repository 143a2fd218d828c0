"""Tracking of the row of targets from one frame to the next."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.vision.association import LEAST_FOLLOWED
from pneunet_ros.vision.dots.blobs import blobs_at, nearest_blobs
from pneunet_ros.vision.dots.centroid import AREA, MAJOR, U
from pneunet_ros.vision.row_look import shows_own_size
from pneunet_ros.vision.rows.partial_targets import with_partial
from pneunet_ros.vision.rows.row import ObservedRow, TrackedRow
from pneunet_ros.vision.rows.row_gate import expected_pixels, gate_row
from pneunet_ros.vision.rows.row_motion import next_row, velocity_along_row
from pneunet_ros.vision.rows.view import View

MOST_PASSES = 3  # over a frame, while lost targets are found again


def follow_row(view: View, last: TrackedRow) -> tuple[ObservedRow, TrackedRow] | None:
    """Find the row near its prediction, and predict the next row; None if the row is lost."""
    vision, count = view.vision, view.arclength.size
    predicted, reach = last.predict(view.image.stamp_ns), view.settings.gate * last.spacing
    table = blobs_at(view.image, last.outlines(predicted, vision), view.appearance)
    lost = np.isnan(table[:, U])
    if lost.any() and np.count_nonzero(~lost) > 1:
        # These targets moved as unexpectedly as the others.
        off, neighbors = (table[:, :2] - predicted)[~lost], vision.row_look.neighbors
        places = predicted + velocity_along_row(off, view.arclength, ~lost, neighbors)
        outlines_there = last.outlines(places, vision)[lost]
        table[lost] = blobs_at(view.image, outlines_there, view.appearance)
    table = with_nearest(view, table, predicted, reach)
    # A target of unknown size has the size of its whole edge.
    shown = shows_own_size(table, vision.row_look, vision.gating) & ~last.sized
    usual = np.where(shown, table[:, AREA], last.area)
    row = gate_row(view, table, usual, last)
    for _ in range(MOST_PASSES):
        if row.seen == count or row.seen < 2:
            break
        places = expected_pixels(view, row.points)
        table = with_nearest(view, row.table, places, reach)
        more = gate_row(view, table, usual, last, causes=row.causes)
        if more.seen <= row.seen:
            break
        row = more
    for _ in range(MOST_PASSES):
        before, row = row.seen, with_partial(view, row, usual, last.sized, last)
        if row.seen == count or row.seen <= before:
            break
        # Found targets improve the prediction of those beyond them.
    if row.seen < min(count, LEAST_FOLLOWED):
        return None
    return row, next_row(view, row, last)


def with_nearest(view: View, table: Array, places: Array, reach: float) -> Array:
    """Return a table with the nearest blob for each target that is not seen.

    places (targets, 2) px; reach: search radius, px.
    """
    table, lost = table.copy(), np.isnan(table[:, U])
    if lost.any():
        across = float(table[~lost, MAJOR].max(initial=0.0))
        across = across or math.sqrt(view.settings.area.largest)
        table[lost] = nearest_blobs(view.image, places[lost], reach, across, view.appearance)
    return table
