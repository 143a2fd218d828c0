"""Distances between shapes of an arm: at the tip, and along the arm.

Points are compared at the same material arclength, and frames at the nearest stamps: each frame of
the slower series is matched with the nearest frame of the faster series, within half a period of
the latter.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import match_stamps, Stamps
from pneunet_ros.measurement.errors.white_noise import white_std
from pneunet_ros.measurement.inference.adequacy import LARGEST_95

END = 1e-6  # m; a curve is known this far beyond its last station: rounding of float32
# Largest differences between two sides of one run. Invented.
LONGER = 1.05  # ratio of the lengths of both arms, each up to its known end
STRETCHED = 1.3  # distance of the first and last target, over that along the arm
OTHER_PRESSURE = 0.1  # root mean square difference of pressures, over their span
NOISE = 3.0  # sigma of the readings, the same: three sigma


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Centerlines:
    """Points along an arm over time; stamp_ns (frames,) increasing, arclength (points,) m.

    points (frames, 2, points): x, y in m, NaN where unknown. topic: their source.
    """

    topic: str
    stamp_ns: Stamps
    arclength: Array
    points: Array

    def __post_init__(self) -> None:
        """Check that the shapes of the arrays agree."""
        frames, places = len(self.stamp_ns), len(self.arclength)
        if frames < 1 or places < 2 or not np.all(np.diff(self.arclength) > 0.0):
            raise RecordingError(
                f'{self.topic} is not a centerline over time: that needs a frame, at least two '
                'points, and an arclength that increases along them',
                reason='no_centerline',
            )
        object.__setattr__(self, 'points', frozen_array(self.points, (frames, 2, places)))

    def at(self, frames: Stamps, arclength: Array) -> Array:
        """Return x, y at places (m) along the arm in these frames, (frames, 2, places) m."""
        chosen = self.points[frames]
        if np.array_equal(arclength, self.arclength):
            return chosen
        known = np.isfinite(chosen).all(axis=(1, 2))
        found = np.full((len(frames), 2, len(arclength)), np.nan)
        if known.any():
            from scipy.interpolate import CubicSpline  # slow to import, and rarely needed

            found[known] = CubicSpline(self.arclength, chosen[known], axis=2)(arclength)
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tips:
    """The free end over time: place (frames, 2) m, heading (frames,) rad; NaN where unknown.

    covariance (frames, 2, 2) m^2 of the position; None if the source has none.
    """

    topic: str
    stamp_ns: Stamps
    place: Array
    heading: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        """Check that the arrays fit together."""
        frames = len(self.stamp_ns)
        object.__setattr__(self, 'place', frozen_array(self.place, (frames, 2)))
        object.__setattr__(self, 'heading', frozen_array(self.heading, (frames,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pressures:
    """Pressures (readings,) Pa of a source at stamp_ns (readings,), which increase."""

    stamp_ns: Stamps
    values: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapeSeries:
    """Shapes of one source: centerlines, the free end, or both.

    frame: the coordinate frame, '' if unknown. exact: whether it is a ground truth without errors.
    pressures: its pressures, None if unknown. whole: whether its centerlines are known to reach
    the free end (those of a truth may or may not).
    """

    name: str
    centerlines: Centerlines | None
    tips: Tips | None
    frame: str = ''
    exact: bool = False
    pressures: Pressures | None = None
    whole: bool = False
    sentences: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorStatistics:
    """Statistics of distances (m): count, rms, median, 95th percentile, largest."""

    count: int
    rms: float
    median: float
    p95: float
    max: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipErrors:
    """Tip errors over matched frames.

    difference (frames, 2) m; heading (frames,) rad, NaN if unknown on one side; motion (frames,)
    m: motion of the tip, at its speed, in the time between the stamps. at (m): compared place
    along the arm; at_end: whether this is the free end. inside_95: share of the frames whose 95 %
    ellipse contains the truth, NaN without covariance or truth. topics: those of the two sides.
    """

    topics: tuple[str, str]
    stamp_ns: Stamps
    stamp_offset: Array
    difference: Array
    heading: Array
    motion: Array
    at: float
    at_end: bool
    inside_95: float

    @property
    def distance(self) -> Array:
        """Distance (m) in every matched frame."""
        return np.hypot(self.difference[:, 0], self.difference[:, 1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CenterlineErrors:
    """Shape errors over matched frames, at arclength (places,) m.

    of, to (frames, 2, places) m. topics: those of the two sides.
    """

    topics: tuple[str, str]
    stamp_ns: Stamps
    stamp_offset: Array
    arclength: Array
    of: Array
    to: Array

    @property
    def distance(self) -> Array:
        """Distance (frames, places) m, NaN where the point is unknown on one side."""
        difference = self.of - self.to
        return np.hypot(difference[:, 0], difference[:, 1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Comparison of one source with another; length (m) of the arm, NaN if unknown.

    tip, shape: None if one side does not have them, if no frame matches, or if the two sides are
    of different arms, as described in `unlike`.
    """

    of: ShapeSeries
    to: ShapeSeries
    length: float
    tip: TipErrors | None
    shape: CenterlineErrors | None
    unlike: tuple[Note, ...] = ()


def compare_shapes(of: ShapeSeries, to: ShapeSeries, length: float | None = None) -> Comparison:
    """Compare the shapes of one source with those of another, frame by frame.

    length of the arm, m; None: the reach of the centerlines. Raises RecordingError if the two
    have nothing in common to compare, whatever their stamps.
    """
    if of.frame and to.frame and of.frame != to.frame:
        raise RecordingError(
            f'{of.name} is in the frame {of.frame} and {to.name} in {to.frame}: '
            'shapes in different frames cannot be compared',
            reason='wrong_frame',
        )
    reach = [item.centerlines.arclength[-1] for item in (of, to) if item.centerlines is not None]
    shape = tip = None
    if of.centerlines is not None and to.centerlines is not None:
        shape = compare_centerlines(of.centerlines, to.centerlines)
    if of.tips is not None and to.tips is not None and not ends_before_tip(of, to):
        at = length or max(reach, default=math.nan)
        tip = compare_tips(of.tips, to.tips, at=at, exact=(of.exact, to.exact))
    elif of.centerlines is not None and to.centerlines is not None:
        tip = compare_last_points(shape)
    else:
        raise RecordingError(
            f'{of.name} has {describe_contents(of)} and {to.name} has {describe_contents(to)}: '
            'they have nothing in common',
            reason='nothing_in_common',
        )
    unlike = arm_differences(of, to)
    return Comparison(
        of=of,
        to=to,
        length=length or max(reach, default=math.nan),
        tip=None if unlike else tip,
        shape=None if unlike else shape,
        unlike=unlike,
    )


def last_stations(of: ShapeSeries, to: ShapeSeries) -> list[float]:
    """Return the arclength (m) of the last stations of the sides that may end at the tip."""
    return [
        float(item.centerlines.arclength[-1])
        for item in (of, to)
        if (item.whole or item.exact) and item.centerlines is not None
    ]


def ends_before_tip(of: ShapeSeries, to: ShapeSeries) -> bool:
    """Whether the stations of a truth end before the tip."""
    ends = last_stations(of, to)
    is_open = any(item.exact and not item.whole for item in (of, to))
    return is_open and len(ends) == 2 and abs(ends[0] - ends[1]) > END


def arm_differences(of: ShapeSeries, to: ShapeSeries) -> tuple[Note, ...]:
    """Explain why two sides are of different arms; empty if they may be the same."""
    notes = []
    ends = last_stations(of, to)
    if len(ends) == 2 and max(ends) > LONGER * min(ends):
        long, short = (of, to) if ends[0] > ends[1] else (to, of)
        notes.append(
            Note(
                f'they are of different arms: {1e3 * max(ends):.4g} mm long in {long.name}, '
                f'{1e3 * min(ends):.4g} mm in {short.name}',
                reason='other_length',
            )
        )
    for item in (of, to):
        stretch = _stretch(item.centerlines)
        if stretch > STRETCHED:
            notes.append(
                Note(
                    f'{item.name}: the first and the last target are {stretch:.3g} times as far '
                    'apart as on the arm of the model: give the model of this arm with --model',
                    reason='other_length',
                )
            )
    return tuple(notes)


def _stretch(line: Centerlines | None) -> float:
    """Return the largest distance of the ends relative to the arclength, 0 if unknown."""
    if line is None:
        return 0.0
    chord = np.hypot(*(line.points[:, :, -1] - line.points[:, :, 0]).T)
    chord = chord[np.isfinite(chord)]
    if not chord.size:
        return 0.0
    return float(np.quantile(chord, 0.95) / (line.arclength[-1] - line.arclength[0]))


def other_pressures(of: ShapeSeries, to: ShapeSeries) -> list[Note]:
    """Report that the pressures of two sides differ at the same stamps."""
    mine, other = of.pressures, to.pressures
    if mine is None or other is None:
        return []
    low = max(mine.stamp_ns[0], other.stamp_ns[0])
    high = min(mine.stamp_ns[-1], other.stamp_ns[-1])
    within = (mine.stamp_ns >= low) & (mine.stamp_ns <= high)
    if not within.any():
        return []
    other_values = np.interp(mine.stamp_ns[within] - low, other.stamp_ns - low, other.values)
    difference = float(np.sqrt(np.mean((mine.values[within] - other_values) ** 2)))
    span = max(float(np.ptp(mine.values)), float(np.ptp(other.values)))
    noise = math.hypot(*(white_std(one.values[:, None]) for one in (mine, other)))
    if difference < max(OTHER_PRESSURE * span, NOISE * noise):
        return []
    return [
        Note(
            f'at the same stamps the pressures of {of.name} and {to.name} differ by '
            f'{1e-3 * difference:.3g} kPa rms: they are of different runs, or of sensors with '
            'another unit, sign or reference',
            reason='other_run',
        )
    ]


def describe_contents(series: ShapeSeries) -> str:
    """List the contents of a source."""
    known = [item.topic for item in (series.tips, series.centerlines) if item is not None]
    return ' and '.join(known) or 'nothing'


def compare_tips(of: Tips, to: Tips, *, at: float, exact: tuple[bool, bool]) -> TipErrors | None:
    """Compare the free ends; at: arclength (m); exact: whether each side is the truth."""
    mine, other = match_series(of.stamp_ns, to.stamp_ns)
    difference = of.place[mine] - to.place[other]
    kept = np.isfinite(difference).all(axis=1)
    mine, other, difference = mine[kept], other[kept], difference[kept]
    if not mine.size:
        return None
    heading_difference = of.heading[mine] - to.heading[other]
    inside = math.nan
    if exact[1] and of.covariance is not None:
        inside = share_inside(difference, of.covariance[mine])
    elif exact[0] and to.covariance is not None:
        inside = share_inside(difference, to.covariance[other])
    stamp_offset = stamps_apart(of.stamp_ns[mine], to.stamp_ns[other])
    return TipErrors(
        topics=(of.topic, to.topic),
        stamp_ns=of.stamp_ns[mine],
        stamp_offset=stamp_offset,
        motion=stamp_offset * speed(to.stamp_ns, to.place)[other],
        difference=freeze(difference),
        heading=freeze(np.arctan2(np.sin(heading_difference), np.cos(heading_difference))),
        at=at,
        at_end=True,
        inside_95=inside,
    )


def speed(stamp_ns: Stamps, place: Array) -> Array:
    """Return the speed (frames,) m/s of a point at place (frames, 2) m; 0 for a single frame."""
    if stamp_ns.size < 2:
        return np.zeros(stamp_ns.size)
    velocity = np.gradient(place, (stamp_ns - stamp_ns[0]) * 1e-9, axis=0)
    return np.hypot(velocity[:, 0], velocity[:, 1])


def share_inside(difference: Array, covariance: Array) -> float:
    """Return the share of differences (frames, 2) m within the 95 % ellipse of a covariance.

    NaN if no frame has a covariance.
    """
    known = np.isfinite(covariance).all(axis=(1, 2)) & (np.linalg.det(covariance) > 0.0)
    if not known.any():
        return math.nan
    solved = np.linalg.solve(covariance[known], difference[known][:, :, None])[:, :, 0]
    distance = np.sum(difference[known] * solved, axis=1)
    return float(np.mean(distance <= LARGEST_95))


def compare_centerlines(of: Centerlines, to: Centerlines) -> CenterlineErrors | None:
    """Compare at the places of one side, over the common range of arclength.

    The places are those of the side with missing points, or with fewer points; the other side is
    interpolated by cubic splines over arclength. None if no frame matches.
    """
    coarse, fine = sorted(
        (of, to), key=lambda item: (bool(np.isfinite(item.points).all()), len(item.arclength))
    )
    low, high = fine.arclength[0] - END, fine.arclength[-1] + END
    common = (coarse.arclength >= low) & (coarse.arclength <= high)
    mine, other = match_series(of.stamp_ns, to.stamp_ns)
    if not mine.size or not common.any():
        return None
    arclength = coarse.arclength
    points = of.at(mine, arclength)[:, :, common], to.at(other, arclength)[:, :, common]
    kept = np.any(np.all(np.isfinite(points[0] - points[1]), axis=1), axis=1)
    if not kept.any():
        return None
    return CenterlineErrors(
        topics=(of.topic, to.topic),
        stamp_ns=of.stamp_ns[mine[kept]],
        stamp_offset=stamps_apart(of.stamp_ns[mine], to.stamp_ns[other])[kept],
        arclength=arclength[common],
        of=freeze(points[0][kept]),
        to=freeze(points[1][kept]),
    )


def compare_last_points(shape: CenterlineErrors | None) -> TipErrors | None:
    """Return the errors at the last place along the arm that both sides have."""
    if shape is None:
        return None
    difference = (shape.of - shape.to)[:, :, -1]
    kept = np.isfinite(difference).all(axis=1)
    if not kept.any():
        return None
    return TipErrors(
        topics=shape.topics,
        stamp_ns=shape.stamp_ns[kept],
        stamp_offset=shape.stamp_offset[kept],
        motion=shape.stamp_offset[kept] * speed(shape.stamp_ns[kept], shape.to[kept, :, -1]),
        difference=freeze(difference[kept]),
        heading=freeze(np.full(np.count_nonzero(kept), np.nan)),
        at=float(shape.arclength[-1]),
        at_end=False,
        inside_95=math.nan,
    )


def match_series(of_ns: Stamps, to_ns: Stamps) -> tuple[Stamps, Stamps]:
    """Match the frames of two series; each frame of the slower series gets a partner."""
    empty = np.zeros(0, dtype=np.int64)
    if not of_ns.size or not to_ns.size:
        return empty, empty
    period = median_period(to_ns)
    if median_period(of_ns) < period:
        other, mine = match_series(to_ns, of_ns)
        return mine, other
    found, is_matched = match_stamps(of_ns, to_ns, 0.5 * period if math.isfinite(period) else 0.0)
    return np.flatnonzero(is_matched), found[is_matched]


def median_period(stamp_ns: Stamps) -> float:
    """Return the median time (ns) from one stamp to the next; infinite for a single one."""
    return float(np.median(np.diff(stamp_ns))) if stamp_ns.size > 1 else math.inf


def stamps_apart(of_ns: Stamps, to_ns: Stamps) -> Array:
    """Return the time differences (s) of matched stamps."""
    return np.asarray(np.abs(of_ns - to_ns) * 1e-9)


def error_statistics(distance: npt.NDArray[np.float64]) -> ErrorStatistics:
    """Return the statistics of distances (m), of which at least one is finite; NaN is ignored."""
    values = distance[np.isfinite(distance)]
    return ErrorStatistics(
        count=values.size,
        rms=float(np.sqrt(np.mean(values**2))),
        median=float(np.median(values)),
        p95=float(np.percentile(values, 95.0)),
        max=float(np.max(values)),
    )
