"""The row of targets in one frame: followed from the last one, or found among all blobs.

Tables of blobs have one line per target with the columns of `centroid`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Image
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.units import seconds_between
from pneunet_ros.vision.association import (
    least_seen,
    near_row_from_clamp,
    near_rows_anywhere,
    row_from_clamp,
)
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import CameraSettings, CurvedRestPlane
from pneunet_ros.vision.camera.working_plane import Plane
from pneunet_ros.vision.dots.areas import Appearance, round_areas, RoundAreas
from pneunet_ros.vision.dots.blobs import (
    Blobs,
    blobs_at,
    find_areas,
    measure_areas,
    nearest_blobs,
)
from pneunet_ros.vision.dots.centroid import (
    ANGLE,
    AREA,
    axes_of,
    BLUR,
    COLUMNS,
    CONTRAST,
    is_possible,
    MAJOR,
    MINOR,
    outlines,
    rows_of,
    SMEAR,
    STD,
    U,
    V,
)
from pneunet_ros.vision.dots.ellipse_fit import (
    AXIS_XX,
    AXIS_YY,
    CENTER_U,
    CENTER_V,
    SIZE_STD,
    SMEAR_U,
    SMEAR_V,
)
from pneunet_ros.vision.dots.moving_dots import (
    as_fitted,
    end_of_arm,
    fit_moving_dot,
    is_dot,
    known_by,
    moves_far,
    MovingDot,
    nothing_known,
)
from pneunet_ros.vision.gating import (
    consistent_motion,
    consistent_size,
    consistent_spacing,
    expected_points,
    gating_numbers,
    initial_area,
    Mask,
)
from pneunet_ros.vision.rest_plane import (
    Failure,
    plane_at_rest,
    RestSearch,
    row_at_rest,
    row_points,
    spacing_of,
)
from pneunet_ros.vision.row_look import (
    believable_parts,
    has_whole_edge,
    is_larger,
    looks_of_neighbors,
    part_stds,
    share_of_area,
    shows_own_size,
    whole_targets,
)
from pneunet_ros.vision.settings import VisionSettings

NO_AREAS = Failure(
    reason='no_areas',
    sentence='no area could be a target: look at light, exposure, focus, grey_band and area',
)
# Why a target of a row that was found is not seen, as a person reads it after "target N: ".
CAUSES = {
    'no_dot': 'nothing at its place looks like a dot: it is covered, out of focus, out of the '
    'picture, or stands out too little (grey_band, area)',
    'size': 'the dot at its place is not as large as it was: it is partly covered, or a glint '
    'touches it',
    'motion': 'what is at its place does not move as its neighbors do: it is partly covered, or '
    'a glint is beside it',
    'place': 'what is near its place is off the row: is its entry in target_arclength right?',
    'part': 'too little of its edge is seen to know its center',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackedRow:
    """A row of targets as it was in a frame, from which the next one is predicted.

    pixels (targets, 2): where each target was, or must have been; velocity (targets, 2) px/s, and
    velocity_std (targets,): one sigma of it per axis at this frame, infinite where nothing tells;
    area (targets,): how large each is to be expected, px^2; table (targets, columns): how each
    looked when it was last seen, NaN of one that never was; seen (targets,): whether it was;
    sized (targets,): whether its area is its own, as it has shown it;
    spacing: distance of neighbors, px; exposure: how long the shutter seems to be open, s,
    0 where nothing is known of it.
    """

    stamp_ns: int
    pixels: Array
    velocity: Array
    velocity_std: Array
    area: Array
    table: Array
    seen: Mask
    sized: Mask
    spacing: float
    exposure: float

    def predict(self, stamp_ns: int, longest: float) -> Array:
        """Return where the targets are expected at a stamp, (targets, 2) px.

        longest: how long (s) their velocities tell anything.
        """
        seconds = seconds_between(self.stamp_ns, stamp_ns)
        return np.asarray(self.pixels + min(seconds, longest) * self.velocity)

    def outlines(self, places: Array, vision: VisionSettings) -> Array:
        """Return where edges are expected of targets that look as they did; places (n, 2) px."""
        blobs, smear = vision.blobs, self.exposure * self.velocity
        stds = blobs.smear_std + vision.row_tracker.smear_std * np.hypot(*smear.T)
        return outlines(
            places,
            axes_of(self.table),
            self.table[:, BLUR],
            smear,
            (np.full(len(places), blobs.shape_std), blobs.blur_std, stds),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObservedRow:
    """The targets in a frame, NaN where one is not seen.

    table (targets, columns): what was measured in the image, in the columns of `centroid`;
    points (targets, 2) m in base; std (targets,) m; seen: how many are; causes (targets,): why
    each is not seen, empty where it is.
    """

    table: Array
    points: Array
    std: Array
    seen: int
    causes: tuple[str, ...]

    @property
    def missing(self) -> dict[int, str]:
        """Targets that are not seen, and why: a key of CAUSES."""
        return {target: cause for target, cause in enumerate(self.causes) if cause}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A frame with all that is needed to look at it.

    areas: what may be a blob, where that has been found already; shallow: whether to look only at
    what stands out, as long as another look can follow.
    """

    image: Image
    lens: Lens
    plane: Plane
    arclength: Array
    clamp_angle: float
    settings: CameraSettings
    vision: VisionSettings
    areas: RoundAreas | None = None
    shallow: bool = False

    def round_areas(self) -> RoundAreas:
        """Return the areas that may be blobs, those that stand out most first."""
        if self.areas is None:
            return find_areas(self.image, self.appearance)
        return self.areas.only(slice(self.appearance.blobs.most))

    @property
    def appearance(self) -> Appearance:
        """What counts as a blob."""
        return self.vision.appearance(self.settings)


def follow_row(view: View, last: TrackedRow) -> tuple[ObservedRow, TrackedRow] | None:
    """Find the row near where it must be by now, and what comes next; None where it is lost."""
    vision, count = view.vision, view.arclength.size
    settings = vision.row_tracker
    predicted = last.predict(view.image.stamp_ns, settings.longest_prediction)
    table = blobs_at(view.image, last.outlines(predicted, vision), view.appearance)
    lost = np.isnan(table[:, U])
    if lost.any() and np.count_nonzero(~lost) > 1:
        # Where others moved otherwise than expected, so did these.
        off, neighbors = (table[:, :2] - predicted)[~lost], vision.row_look.neighbors
        places = predicted + velocity_along_row(off, view.arclength, ~lost, neighbors)
        outlines_there = last.outlines(places, vision)[lost]
        table[lost] = blobs_at(view.image, outlines_there, view.appearance)
    table = with_nearest(view, table, predicted, view.settings.gate * last.spacing)
    # Of a target whose size nobody has seen yet, it is what its whole edge says.
    shown = shows_own_size(table, vision.row_look, vision.gating) & ~last.sized
    usual = np.where(shown, table[:, AREA], last.area)
    row = gate_row(view, table, usual, last)
    for _ in range(settings.most_passes):
        if row.seen == count or row.seen < 2:
            break
        places = expected_pixels(view, row.points)
        table = with_nearest(view, row.table, places, settings.reach_again * last.spacing)
        more = gate_row(view, table, usual, last, causes=row.causes)
        if more.seen <= row.seen:
            break
        row = more
    for _ in range(settings.most_passes):
        before, row = row.seen, with_partial(view, row, usual, last.sized, last)
        if row.seen == count or row.seen <= before:
            break
        # What was found tells better where those beyond it are.
    if row.seen < min(count, vision.association.least_followed):
        return None
    return row, next_row(view, row, last)


def with_nearest(view: View, table: Array, places: Array, reach: float) -> Array:
    """Return a table with the nearest blob for each target that is not seen.

    places (targets, 2) px; reach: from there, px.
    """
    table, lost = table.copy(), np.isnan(table[:, U])
    if lost.any():
        across = float(table[~lost, MAJOR].max(initial=0.0))
        across = across or math.sqrt(view.settings.area.largest)
        table[lost] = nearest_blobs(view.image, places[lost], reach, across, view.appearance)
    return table


def with_partial(
    view: View, row: ObservedRow, usual: Array, sized: Mask, last: TrackedRow | None = None
) -> ObservedRow:
    """Return a row with the targets of which a part is seen, where their neighbors tell the rest.

    sized (targets,): whose usual area is their own; other arguments as of `gate_row`.
    """
    settings = view.vision.row_look
    if row.seen <= settings.fewest:
        return row
    starts = _places_by_neighbors(view, row, last)
    large = is_larger(usual, view.vision.gating) & ~sized
    own = np.where(sized | large, usual, np.nan)
    expected = looks_of_neighbors(row.table, starts[0], own, settings)
    expected[large, SIZE_STD] = settings.own_std
    expected[large, AXIS_XX : AXIS_YY + 1] *= 1.0 + settings.own_std
    share = share_of_area(row.table, expected)
    partial = ~whole_targets(row.table, expected, settings)
    same = has_whole_edge(row.table, settings) & (
        row.table[:, AREA] >= settings.least_area * usual
    )
    if last is None:  # nothing tells yet how large each is
        partial &= ~same
    found = np.full_like(row.table, np.nan)
    swept = expected
    if last is not None and partial.any():
        swept = _with_ways(view, row, expected, last)
    moving = partial & moves_far(swept, view.vision.moving_dots)
    if moving.any():
        found[moving] = _moving_at(view, row, moving, swept, starts, last)[moving]
    for places in starts:
        expected[:, [CENTER_U, CENTER_V]] = places
        looked_at = partial & ~moving & np.isfinite(places[:, 0])
        if looked_at.any():
            part = _parts_at(view, row, usual, looked_at, expected, last)
            better = np.isfinite(part[:, U]) & ~(found[:, STD] <= part[:, STD])
            found[better] = part[better]
    believed = np.isfinite(found[:, U])
    # What is neither as large as it has been, nor a part of what its neighbors are, is something
    # else.
    other = partial & ~believed & ~same & np.isfinite(share)
    if not (believed | other).any():
        return row
    table = np.where(believed[:, None], found, row.table)
    table[other] = np.nan
    causes = tuple(np.where(other, 'part', row.causes).tolist())
    return gate_row(view, table, usual, last, believed, causes)


def _parts_at(
    view: View,
    row: ObservedRow,
    usual: Array,
    partial: Mask,
    expected: Array,
    last: TrackedRow | None,
) -> Array:
    """Return the targets that are what their neighbors are, as far as they are seen.

    partial (targets,): which are looked at; expected: where, and as `looks_of_neighbors`. Rows
    (targets, columns), NaN where there is none to be believed.
    """
    settings = view.vision.row_look
    found = np.full_like(row.table, np.nan)
    found[partial] = blobs_at(view.image, expected[partial], view.appearance)
    found[:, STD] = part_stds(found, expected, settings)
    off = np.hypot(*(found[:, :2] - expected[:, [CENTER_U, CENTER_V]]).T)
    believed = off <= settings.moved * np.sqrt(usual / math.pi)
    believed &= believable_parts(found, expected, share_of_area(row.table, expected), settings)
    if last is not None:
        # What was not seen before must be on the row: a finger nail is as bright and as large.
        worse = found[:, STD] > settings.worse * np.nanmedian(row.table[:, STD])
        believed &= _are_on_row(view, row, found, partial & (~last.seen | worse))
    found[~believed] = np.nan
    return found


def _with_ways(view: View, row: ObservedRow, expected: Array, last: TrackedRow) -> Array:
    """Return outlines (targets, FITTED) that move as the row does while the shutter is open.

    A line over how neighbors are smeared tells too little where most of them are not seen whole:
    the longer way counts of that one and of the way since the last frame.
    """
    outlines, both = expected.copy(), np.isfinite(row.table[:, U]) & last.seen
    if both.any():
        seconds = seconds_between(last.stamp_ns, view.image.stamp_ns)
        moved = (row.table[both, :2] - last.pixels[both]) / seconds
        neighbors = view.vision.row_look.neighbors
        ways = last.exposure * velocity_along_row(moved, view.arclength, both, neighbors)
        longer = np.hypot(*ways.T) > np.hypot(expected[:, SMEAR_U], expected[:, SMEAR_V])
        outlines[longer, SMEAR_U : SMEAR_V + 1] = ways[longer]
    return outlines


def _moving_at(
    view: View,
    row: ObservedRow,
    moving: Mask,
    expected: Array,
    starts: tuple[Array, ...],
    last: TrackedRow | None,
) -> Array:
    """Return the targets that move far while the shutter is open, rows (targets, columns).

    moving (targets,): which are looked for, at each of `starts`, and where the others lead, as a
    blob that is smeared may be elsewhere; expected: as `looks_of_neighbors`. NaN where there is
    none to be believed.
    """
    without = replace(row, table=row.table.copy(), points=row.points.copy())
    without.table[moving] = without.points[moving] = np.nan
    starts = _places_by_neighbors(view, without, last) + starts
    settings, look, grey = view.vision.moving_dots, view.vision.row_look, view.image.grey()
    along = np.gradient(starts[0], axis=0)
    along /= np.hypot(*along.T)[:, None]
    ends = np.full(len(along), math.inf)
    ends[-1] = end_of_arm(expected[-1], along[-1], settings)
    tell = np.flatnonzero(whole_targets(row.table, expected, look)).tolist()
    if not tell:
        return np.full_like(row.table, np.nan)
    fitted: dict[int, MovingDot | None] = {}
    found = np.full_like(row.table, np.nan)
    away = np.abs(np.arange(len(moving))[:, None] - tell).min(axis=1)
    for target in sorted(np.flatnonzero(moving).tolist(), key=lambda it: int(away[it])):
        nearest = sorted(tell, key=lambda it: abs(it - target))[: settings.alike]
        for other in nearest:
            if other not in fitted:
                outline = expected[other].copy()
                outline[[CENTER_U, CENTER_V]] = row.table[other, :2]
                nothing = nothing_known(outline, row.table[other, CONTRAST], settings)
                fitted[other] = fit_moving_dot(
                    grey, outline, along[other], ends[other], nothing, settings
                )
        alike = [dot for it in nearest if (dot := fitted[it]) is not None]
        if len(alike) < settings.fewest:
            continue
        known = known_by(alike, settings)
        for places in starts:
            outline = expected[target].copy()
            outline[[CENTER_U, CENTER_V]] = places[target]
            near = settings.near * math.sqrt(expected[target, AXIS_XX] * expected[target, AXIS_YY])
            again = math.hypot(*(places[target] - found[target, :2])) < near
            if np.isnan(outline).any() or again:
                continue
            dot = fit_moving_dot(grey, outline, along[target], ends[target], known, settings)
            if dot is None or not is_dot(dot, known, settings):
                continue
            fitting = rows_of(as_fitted(outline, dot)[None])[0]
            radius = math.sqrt(fitting[AREA] / math.pi)
            off = math.hypot(*(dot.center - places[target]))
            sure = dot.std <= look.unsure * radius and not found[target, STD] <= dot.std
            if sure and off <= settings.astray * radius:
                found[target], fitted[target] = fitting, dot
        if target in fitted:  # skin and light change along the arm: it tells the next one more
            tell.append(target)
    found[~is_possible(found, view.appearance.look, grey.shape)] = np.nan
    if last is not None:
        worse = found[:, STD] > look.worse * np.nanmedian(row.table[:, STD])
        found[~_are_on_row(view, row, found, moving & (~last.seen | worse))] = np.nan
    return found


def _places_by_neighbors(
    view: View, row: ObservedRow, last: TrackedRow | None
) -> tuple[Array, ...]:
    """Return where targets are, or may be by those next to them, (targets, 2) px each.

    One that is not seen is where the row leads, which tells little beyond a gap; or, if it was
    seen in the last row, where its motion leads and the others are off theirs (NaN of all others).
    """
    seen = np.isfinite(row.table[:, U])
    on_row = np.where(seen[:, None], row.table[:, :2], expected_pixels(view, row.points))
    if last is None:
        return (on_row,)
    lost, both = last.seen & ~seen, last.seen & seen
    if not (lost.any() and both.any()):
        return (on_row,)
    predicted = last.predict(view.image.stamp_ns, view.vision.row_tracker.longest_prediction)
    moved, off = np.full_like(predicted, np.nan), (row.table[:, :2] - predicted)[both]
    for axis in range(2):
        more = np.interp(view.arclength[lost], view.arclength[both], off[:, axis])
        moved[lost, axis] = predicted[lost, axis] + more
    return on_row, moved


def _are_on_row(view: View, row: ObservedRow, found: Array, doubtful: Mask) -> Mask:
    """Whether doubtful targets are where those on either side of them say (targets,).

    found (targets, columns): where each is; doubtful (targets,): which appear by a part, or fit
    badly. True of all others, and of those at an end of what is seen.
    """
    others = np.where(doubtful[:, None], np.nan, row.points)
    seen = np.flatnonzero(np.isfinite(others[:, 0]))
    if seen.size < 2:
        return ~doubtful
    between = np.zeros_like(doubtful)
    between[seen[0] : seen[-1]] = True
    off = np.hypot(*(found[:, :2] - expected_pixels(view, others)).T)
    reach = view.vision.row_look.appeared * np.sqrt(found[:, AREA] / math.pi)
    return np.asarray(~(doubtful & between) | (off <= reach))


def search_around(view: View, last: TrackedRow) -> ObservedRow | Failure:
    """Find the row that starts at the clamp around where it was last."""
    reach = view.vision.gating.farthest * last.spacing
    places = last.pixels[np.isfinite(last.pixels[:, 0])]
    if not (len(places) and math.isfinite(reach)):
        return NO_AREAS
    size = view.image.width, view.image.height
    first = np.clip(np.floor(places.min(axis=0) - reach), 0, size).astype(np.int64)
    after = np.clip(np.ceil(places.max(axis=0) + reach) + 1.0, 0, size).astype(np.int64)
    piece = view.image.grey()[first[1] : after[1], first[0] : after[0]]
    if not piece.size:
        return NO_AREAS
    areas = round_areas(piece, view.appearance)
    areas = areas._replace(centers=areas.centers + first)
    return search_row(replace(view, areas=areas, shallow=True))


def search_row(view: View) -> ObservedRow | Failure:
    """Find the row that starts at the clamp among all areas of the frame.

    Areas on a row, as their moments say, are measured first. Where that does not show all of the
    targets, all areas are.
    """
    areas = view.round_areas()
    points = view.plane.points(view.lens.undistort(areas.centers))
    usable = np.flatnonzero(np.isfinite(points[:, 0]))
    near = usable[
        near_row_from_clamp(
            points[usable],
            areas.areas[usable],
            view.arclength,
            view.clamp_angle,
            view.vision.beam_search,
        )
    ]
    if len(near) < len(areas.centers):
        row = row_among(view, measure_areas(view.image, areas.only(near), view.appearance))
        if isinstance(row, ObservedRow) and row.seen == view.arclength.size:
            return row
        if view.shallow:
            return replace(row, found=areas.centers) if isinstance(row, Failure) else row
    blobs = measure_areas(view.image, areas, view.appearance)
    if len(blobs) == 0:
        return NO_AREAS
    found = row_among(view, blobs)
    return replace(found, found=blobs.centers) if isinstance(found, Failure) else found


def row_among(view: View, blobs: Blobs) -> ObservedRow | Failure:
    """Find the row that starts at the clamp among these blobs."""
    vision = view.vision
    points = view.plane.points(view.lens.undistort(blobs.centers))
    usable = np.flatnonzero(np.isfinite(points[:, 0]))
    row = row_from_clamp(
        points[usable], blobs.area[usable], view.arclength, view.clamp_angle, vision.beam_search
    )
    targets = view.arclength.size
    least = least_seen(targets, vision.association)
    table, chosen = np.full((targets, COLUMNS), np.nan), row.chosen >= 0
    table[chosen] = blobs.table.T[usable[row.chosen[chosen]]]
    shown = shows_own_size(table, vision.row_look, vision.gating)
    usual = initial_area(table[:, AREA], shown, vision.gating)
    sized = has_whole_edge(table, vision.row_look)
    found = with_partial(view, gate_row(view, table, usual), usual, sized)
    if found.seen < least or not is_at_clamp(view, found.points):
        return Failure(
            reason='no_row',
            seen=found.seen,
            sentence=f'only {found.seen} of {targets} targets stand in a row from the clamp, '
            f'among {len(blobs)} areas; {least} are needed: is the arm covered, or has '
            'the camera moved?',
        )
    return found


def search_at_rest(view: View, rest: RestSearch) -> Array | Failure:
    """Find the targets of the arm at rest, normalized (targets, 2), NaN where one is not seen.

    view: its plane is not known yet, and not used; rest: where the arm has rested so far, which
    tells the targets of a frame that does not show a row by itself.
    """
    areas = view.round_areas()
    if len(areas.centers) == 0:
        return NO_AREAS
    first = _search_what_stands_out(view, areas)
    if view.shallow or not (isinstance(first, Failure) or np.isnan(first).any()):
        return first
    blobs = measure_areas(view.image, areas, view.appearance)
    if len(blobs) == 0:
        return NO_AREAS
    points = view.lens.undistort(blobs.centers)
    found = _search_anew(view, blobs, points)
    if not isinstance(found, Failure):
        return found
    found = replace(found, found=blobs.centers)
    if found.reason != 'no_row':
        return found
    seen = points[np.isfinite(points[:, 0])]
    again = rest.recognize(seen, view.arclength, view.vision)
    return found if again is None else again


def _search_what_stands_out(view: View, areas: RoundAreas) -> Array | Failure:
    """Find the targets of the arm at rest by the areas that stand out, as `search_at_rest`.

    Only those on a row, as their moments say, are measured, and all areas near it.
    """
    points = view.lens.undistort(areas.centers)
    usable = np.isfinite(points[:, 0])
    clear = areas.stand_out(view.appearance)
    clear = clear[usable[clear]]
    near = near_rows_anywhere(points, areas.areas, view.arclength, clear, view.vision.beam_search)
    near = near[usable[near]]
    if not len(near):
        return Failure(
            reason='no_row',
            sentence=f'no row of {view.arclength.size} targets at their distances among '
            f'{len(clear)} areas that stand out clearly',
            found=areas.centers[clear],
        )
    blobs = measure_areas(view.image, areas.only(near), view.appearance)
    if len(blobs) == 0:
        return NO_AREAS
    found = _search_anew(view, blobs, view.lens.undistort(blobs.centers))
    return replace(found, found=blobs.centers) if isinstance(found, Failure) else found


def _search_anew(view: View, blobs: Blobs, points: Array) -> Array | Failure:
    """Find the targets of the arm at rest by this frame alone, as `search_at_rest` returns them.

    points (blobs, 2): the blobs, normalized. A row that is found must be what is found again from
    its clamp once the plane is known by it: what a frame says does not depend on what was known
    before.
    """
    settings, vision, arclength = view.settings, view.vision, view.arclength
    at_rest = whole = _row_at_rest(view, blobs, points, arclength)
    if isinstance(whole, Failure):
        # The last target may be seen in part: its neighbors tell where to look for it.
        short = arclength.size > vision.association.least_targets
        if whole.reason != 'no_row' or not short:
            return whole
        at_rest = _row_at_rest(view, blobs, points, arclength[:-1])
    if isinstance(at_rest, Failure):
        return whole
    plane = plane_at_rest(at_rest, arclength[: len(at_rest)], settings.plane)
    found = row_among(replace(view, plane=plane), blobs)
    if isinstance(found, Failure):
        return found
    ambiguous = isinstance(whole, Failure) and np.isnan(found.std[-1])
    if ambiguous and not _begins_at_clamp_pixel(view, found):
        return Failure(
            reason='no_row',
            seen=found.seen,
            sentence=f'only {arclength.size - 1} of {arclength.size} targets are seen, and their '
            f'distances do not tell whether target 0 or target {arclength.size - 1} is missing: '
            'give clamp_pixel (--clamp-pixel U V) to within half of their spacing. Does one of '
            'them stand out too little (contrast, focus), or lie half beyond the end of the arm?',
        )
    again = view.lens.undistort(found.table[:, :2])
    # One beside a slot or a glint is measured anew by its neighbors' look: the same target still.
    apart = np.hypot(*(again[: len(at_rest)] - at_rest).T)
    same = np.count_nonzero(apart < 0.5 * spacing_of(at_rest, arclength[: len(at_rest)]))
    if same < vision.beam_search.seen * arclength.size:
        return Failure(
            reason='no_row',
            seen=int(same),
            sentence=f'of the row of {arclength.size} targets at rest only {same} are found '
            'again from its clamp: are their places those of target_arclength?',
        )
    return again


def _begins_at_clamp_pixel(view: View, row: ObservedRow) -> bool:
    """Whether clamp_pixel says beyond doubt which target the first one of a row is."""
    if view.settings.clamp_pixel is None:
        return False
    spacing = float(np.nanmedian(np.hypot(*np.diff(row.table[:, :2], axis=0).T)))
    return math.hypot(*(row.table[0, :2] - view.settings.clamp_pixel)) < 0.5 * spacing


def _row_at_rest(view: View, blobs: Blobs, points: Array, arclength: Array) -> Array | Failure:
    """Return the targets of a resting arm among blobs, normalized (targets, 2), NaN where missing.

    points (blobs, 2) normalized, NaN where the lens does not see.
    """
    settings, usable = view.settings, np.isfinite(points[:, 0])
    row = row_at_rest(
        points[usable],
        blobs.centers[usable],
        blobs.area[usable],
        arclength,
        settings.clamp_pixel,
        math.inf if isinstance(settings.plane, CurvedRestPlane) else settings.rest_straightness,
        view.vision,
    )
    return row if isinstance(row, Failure) else row_points(row, points[usable])


def start_row(view: View, row: ObservedRow) -> TrackedRow:
    """Return a row that was found from nothing as the next frame needs it."""
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
    """Return what the next frame starts from.

    Targets that are not seen are where the others say, and move as those next to them.
    """
    arclength, seen = view.arclength, np.isfinite(row.table[:, U])
    pixels, area = row.table[:, :2].copy(), last.area.copy()
    shown = shows_own_size(row.table, view.vision.row_look, view.vision.gating) & ~last.sized
    area[shown] = row.table[shown, AREA]
    area[seen] += view.vision.row_tracker.area_gain * (row.table[seen, AREA] - area[seen])
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
        # It is that of the middle between the frames; how it changed tells how it goes on.
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
        sized=last.sized | has_whole_edge(row.table, view.vision.row_look),
        spacing=float(np.median(known)) if known.size else math.nan,
        exposure=exposure,
    )


def velocity_along_row(moved: Array, arclength: Array, known: Mask, neighbors: int) -> Array:
    """Return how all targets move, (targets, 2) px or px/s, by those of which it is known.

    moved (known, 2), in the same unit. Between two of them it changes evenly; beyond the last ones
    it goes on as along so many neighbors: the end of an arm moves faster than what is before it.
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
    """Return how long (s) the shutter seems to be open, by how far targets are smeared.

    velocity (n, 2) px/s; seconds: between frames; before: what it seemed to be in the last frame,
    0 where nothing is known. Where hardly anything moves a frame tells nothing of it.
    """
    settings = vision.row_tracker
    least, most = settings.least_exposure * seconds, settings.most_exposure * seconds
    if before == 0.0:
        before = settings.first_exposure * seconds
    smeared = (table[:, SMEAR] != 0.0).any(axis=1)
    square = np.sum(velocity[smeared] ** 2)
    if square * seconds**2 < settings.least_way**2:
        return before
    along = np.sum(np.abs(np.sum(velocity[smeared] * table[smeared, SMEAR], axis=1)))
    return float(np.clip(along / square, least, most))


def gate_row(
    view: View,
    table: Array,
    usual: Array,
    last: TrackedRow | None = None,
    parts: Mask | None = None,
    causes: tuple[str, ...] | None = None,
) -> ObservedRow:
    """Return the blobs of a table that are believed to be targets.

    usual (targets,) px^2: how large they are compared with each other; parts (targets,): which of
    them were measured by a part, with the size of their neighbors; causes: why some are not in the
    table. Those that were seen in the last row must have moved as their neighbors; without one the
    ends of the row must be near the other targets.
    """
    table, gating = table.copy(), view.vision.gating
    there = np.isfinite(table[:, U])
    why = np.array(causes or ('',) * len(table), dtype='U8')
    why[there] = ''
    why[~there & (why == '')] = 'no_dot'
    farthest = gating.farthest
    if last is not None:
        off = table[:, :2] - last.predict(
            view.image.stamp_ns, view.vision.row_tracker.longest_prediction
        )
        off[~last.seen] = np.nan
        alone = consistent_motion(off, last.spacing, gating)[1]
        table[alone], why[alone] = np.nan, 'motion'
        farthest = math.inf
    normalized = view.lens.undistort(table[:, :2])
    points = view.plane.points(normalized)
    sized = consistent_size(table[:, AREA], usual, table[:, MAJOR] / table[:, MINOR], gating)
    if parts is not None:
        sized |= parts
    points[~sized] = np.nan
    why[~sized & (why == '')] = 'size'
    x, y = np.ascontiguousarray(points.T)
    seen = consistent_spacing(x, y, view.arclength, farthest, gating_numbers(gating))
    std = table[:, STD] * view.lens.scale(normalized) * view.plane.scale(normalized)
    table[~seen] = points[~seen] = std[~seen] = np.nan
    why[~seen & (why == '')] = 'place'
    return ObservedRow(
        table=table,
        points=points,
        std=std,
        seen=int(np.count_nonzero(seen)),
        causes=tuple(why.tolist()),
    )


def expected_pixels(view: View, points: Array) -> Array:
    """Return where all targets are expected by those that are seen, (targets, 2) px.

    points (targets, 2) m in base, NaN where a target is not seen.
    """
    x, y = np.ascontiguousarray(points.T)
    gating = gating_numbers(view.vision.gating)
    expected = np.column_stack(expected_points(x, y, view.arclength, gating))
    return view.lens.distort(view.plane.normalized(expected))


def is_at_clamp(view: View, points: Array) -> bool:
    """Whether the first target that is seen, if it is near the clamp, is where it must be."""
    settings, arclength, clamp_angle = view.vision.row_tracker, view.arclength, view.clamp_angle
    seen = np.flatnonzero(np.isfinite(points[: settings.near_clamp, 0]))
    if not seen.size:
        return True
    first = int(seen[0])
    x, y = points[first].tolist()
    aside = y * math.cos(clamp_angle) - x * math.sin(clamp_angle)
    allowed = (1.0 + first) * float(arclength[1] - arclength[0])
    off_along = abs(math.hypot(x, y) - float(arclength[first]))
    return off_along <= settings.off_along * allowed and abs(aside) <= settings.off_aside * allowed


def at_stamp(view: View, row: ObservedRow, now: TrackedRow) -> ObservedRow:
    """Return a row as it was at the stamp of its frame, by how it moves.

    A rolling shutter sees each target at a time of its own. One whose motion is not known, as in
    the first frame that shows it, stays where it was seen.
    """
    shutter = view.settings.shutter
    known = np.isfinite(row.points[:, 0]) & np.isfinite(now.velocity_std)
    if shutter.is_at_stamp or not known.any():
        return row
    seconds = shutter.seconds_after_stamp(row.table[known, V], view.image.height)
    normalized = view.lens.undistort(row.table[known, :2] - seconds[:, None] * now.velocity[known])
    points, std = row.points.copy(), row.std.copy()
    points[known] = view.plane.points(normalized)
    scale = view.lens.scale(normalized) * view.plane.scale(normalized)
    std[known] = np.hypot(std[known], np.abs(seconds) * now.velocity_std[known] * scale)
    return replace(row, points=points, std=std)


def target_sightings(view: View, row: ObservedRow) -> TargetSightings:
    """Return what is published of the targets that are seen."""
    table = np.empty((COLUMNS + 2, len(row.table)))
    table[:COLUMNS], table[COLUMNS:] = row.table.T, row.points.T
    freeze(table)
    return TargetSightings(
        stamp_ns=view.image.stamp_ns,
        x=table[COLUMNS],
        y=table[COLUMNS + 1],
        std=freeze(row.std),
        u=table[U],
        v=table[V],
        area=table[AREA],
        major=table[MAJOR],
        minor=table[MINOR],
        angle=table[ANGLE],
    )
