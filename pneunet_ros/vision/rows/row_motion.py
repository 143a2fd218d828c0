"""Motion of a row: from frame to frame, and during the exposure."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.vision.dots.centroid import AREA, SMEAR, STD, U, V
from pneunet_ros.vision.gating import initial_area, Mask
from pneunet_ros.vision.row_look import has_whole_edge, shows_own_size
from pneunet_ros.vision.rows.row import ObservedRow, TrackedRow
from pneunet_ros.vision.rows.row_gate import expected_pixels
from pneunet_ros.vision.rows.view import View
from pneunet_ros.vision.settings import VisionSettings

LEAST_WAY = 5.0  # px, motion of all targets between two frames, before the exposure is estimated


def start_row(view: View, row: ObservedRow) -> TrackedRow:
    """Return a newly found row as a tracked row with unknown velocity."""
    shown = shows_own_size(row.table, view.vision.row_look, view.vision.gating)
    nowhere = TrackedRow(
        stamp_ns=view.image.stamp_ns - 1,
        pixels=row.table[:, :2],
        velocity=np.zeros((len(row.table), 2)),
        velocity_std=np.full(len(row.table), math.inf),
        area=initial_area(row.table[:, AREA], shown, view.vision.gating),
        table=row.table,
        seen=np.zeros(len(row.table), np.bool_),
        sized=has_whole_edge(row.table, view.vision.row_look),
        spacing=math.nan,
        exposure=0.0,
    )
    return next_row(view, row, nowhere)


def next_row(view: View, row: ObservedRow, last: TrackedRow) -> TrackedRow:
    """Return the tracked row for the next frame.

    Positions and velocities of targets that are not seen are interpolated from the others.
    """
    arclength, seen = view.arclength, np.isfinite(row.table[:, U])
    pixels, area = row.table[:, :2].copy(), last.area.copy()
    # A shrinking target is cut off or covered: the rest of its edge looks whole by chance.
    look = view.vision.row_look
    smaller = last.seen & (row.table[:, AREA] < look.least_area * last.area)
    shown = shows_own_size(row.table, look, view.vision.gating) & ~last.sized & ~smaller
    area[shown] = row.table[shown, AREA]
    area[seen] += (1.0 - view.vision.beam_search.memory) * (row.table[seen, AREA] - area[seen])
    if not seen.all():
        pixels[~seen] = expected_pixels(view, row.points)[~seen]
    velocity, exposure = np.zeros_like(pixels), last.exposure
    velocity_std = np.full(len(pixels), math.inf)
    both = seen & last.seen
    if both.any():
        seconds = seconds_between(last.stamp_ns, view.image.stamp_ns)
        moved = (pixels[both] - last.pixels[both]) / seconds
        velocity = velocity_along_row(moved, arclength, both, view.vision.row_look.neighbors)
        exposure = exposure_of(row.table[both], moved, seconds, last.exposure, view.vision)
        exposure = view.settings.shutter.exposure or exposure
        noise = np.hypot(row.table[both, STD], last.table[both, STD]) / seconds
        # This is the velocity half way between the frames; its change predicts the next one.
        change = 0.5 * np.hypot(*(velocity - last.velocity)[both].T)
        velocity_std[both] = np.hypot(noise, change)
        velocity_std[~both] = velocity_std[both].max()
    steps = np.hypot(*np.diff(pixels, axis=0).T)
    known = steps[np.isfinite(steps)]
    looked = np.where(seen[:, None], row.table, last.table)
    return TrackedRow(
        stamp_ns=view.image.stamp_ns,
        pixels=pixels,
        velocity=velocity,
        velocity_std=velocity_std,
        area=area,
        table=looked,
        seen=seen,
        sized=last.sized | (has_whole_edge(row.table, look) & ~smaller),
        spacing=float(np.median(known)) if known.size else math.nan,
        exposure=exposure,
    )


def velocity_along_row(moved: Array, arclength: Array, known: Mask, neighbors: int) -> Array:
    """Return the velocities of all targets, (targets, 2) px or px/s, from the known ones.

    moved (known, 2), in the same unit. The velocity is interpolated linearly between two known
    targets, and extrapolated from several neighbors beyond the last ones, because the end of an
    arm moves fastest.
    """
    velocity, places = np.empty((len(arclength), 2)), arclength[known]
    for axis in range(2):
        velocity[:, axis] = np.interp(arclength, places, moved[:, axis])
    if len(places) < neighbors:
        return velocity
    for beyond, near in (
        (arclength < places[0], slice(neighbors)),
        (arclength > places[-1], slice(-neighbors, None)),
    ):
        away = places[near] - places[near].mean()
        slope = away @ (moved[near] - moved[near].mean(axis=0)) / (away @ away)
        end = np.clip(arclength[beyond], places[0], places[-1])
        velocity[beyond] += (arclength[beyond] - end)[:, None] * slope
    return velocity


def exposure_of(
    table: Array, velocity: Array, seconds: float, before: float, vision: VisionSettings
) -> float:
    """Return the exposure time (s) estimated from the motion blur of targets.

    velocity (n, 2) px/s; seconds: between frames; before: estimate at the last frame, 0 if
    unknown. A frame in which almost nothing moves does not change it.
    """
    settings = vision.row_tracker
    least = settings.least_exposure * seconds  # and at most the time between frames
    if before == 0.0:
        before = math.sqrt(least * seconds)
    smeared = (table[:, SMEAR] != 0.0).any(axis=1)
    square = np.sum(velocity[smeared] ** 2)
    if square * seconds**2 < LEAST_WAY**2:
        return before
    along = np.sum(np.abs(np.sum(velocity[smeared] * table[smeared, SMEAR], axis=1)))
    return float(np.clip(along / square, least, seconds))


def at_stamp(view: View, row: ObservedRow, now: TrackedRow, interval: float) -> ObservedRow:
    """Return a row moved to the stamp of its frame.

    A rolling shutter exposes each target at a different time. A target of unknown motion, for
    example in the first frame that shows it, is not moved; instead, its uncertainty allows for the
    highest speed that can be tracked from frame to frame. interval (s): from the last image, 0 if
    unknown.
    """
    shutter, seen = view.settings.shutter, np.isfinite(row.points[:, 0])
    if shutter.is_at_stamp or not seen.any():
        return row
    seconds = shutter.seconds_after_stamp(row.table[seen, V], view.image.height)
    table = row.table[seen]
    table[:, :2] -= seconds[:, None] * now.velocity[seen]
    normalized = view.dot_centers(table)
    points, std = row.points.copy(), row.std.copy()
    points[seen] = view.plane.points(normalized)
    scale = view.lens.scale(normalized) * view.plane.scale(normalized)
    fastest = view.settings.gate * now.spacing / max(interval, shutter.least_interval)
    velocity_std = np.where(np.isfinite(now.velocity_std), now.velocity_std, fastest)[seen]
    std[seen] = np.hypot(std[seen], np.abs(seconds) * velocity_std * scale)
    return replace(row, points=points, std=std)
