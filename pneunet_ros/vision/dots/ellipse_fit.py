"""Fit ellipses to the edges of blobs, pixel by pixel: the computations of `centroid`.

All blobs of an image are fitted together, as columns of numbers over their pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.settings import numbers_type, tuning
from pneunet_ros.vision.dots.edge_kernel import (
    COLUMNS,
    EDGE,
    LEFT,
    Linearized,
    PARTS,
    TIMES,
    UNKNOWNS,
)
from pneunet_ros.vision.dots.outline_kernel import fit_outlines
import scipy

Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# An ellipse, before and after the fit: center u, v px; symmetric axes (xx, xy, yy) px, which map
# the unit circle to it; blur px of its edge where it does not move; its way while the shutter is
# open, px (forward or backward: a picture does not tell); grey levels of plateau and background.
CENTER_U, CENTER_V, AXIS_XX, AXIS_XY, AXIS_YY, WIDTH, SMEAR_U, SMEAR_V = range(8)
PLATEAU, BEHIND = 8, 9
# Only before: how well its shape (of its radius), blur and way (px), plateau and size (of its
# radius) are known, one sigma; infinite of a plateau that is not known.
SHAPE_STD, WIDTH_STD, SMEAR_STD, PLATEAU_STD, SIZE_STD = range(10, 15)
# Only after: std of the center px; share near the ellipse of the edge that can be seen, and share
# exactly on it of all the edge; share of what is within that is as bright as it is drawn; share of
# all the edge that is clearly outside of the ellipse.
ERROR, NEAR_EDGE, ON_EDGE, WITHIN, OUTSIDE = range(10, 15)
FITTED = 15

# Moments of an exposure that are averaged, and from which way (px) on. No share of a pixel that is
# covered is then off by more than 0.2 %, up to a way of 20 px where edges are blurred by 0.9 px.
MOMENTS = ((2, 0.5), (3, 1.3), (5, 3.2), (9, 6.5), (13, 13.0))
QUANTIZATION = 1.0 / 12.0  # variance of a grey level that has been rounded
PEAK = 1.0 / math.sqrt(2.0 * math.pi)  # of the normal density
PRODUCT = 512  # pixels in a product of matrices: more than 700 wake the threads of OpenBLAS
TOGETHER = 1 << 15  # pixels of ellipses that are fitted side by side: what a cache holds
SIGMA = 1.4826  # standard deviation over the median of what is off, of Gaussian noise


@dataclass(frozen=True, slots=True, kw_only=True)
class EllipseSettings:
    """Settings of the ellipse fit to the edge of a blob."""

    sectors: int = tuning(16, 'sectors around a blob, each with its own background and edge')
    passes: int = tuning(8, 'most passes of the fit')
    done: float = tuning(0.003, 'step of the center after which the fit ends', unit='px')
    inward: float = tuning(2.5, 'width of the pixels used inside the edge', unit='blur')
    outward: float = tuning(3.0, 'width of the pixels used outside the edge', unit='blur')
    margin: float = tuning(1.0, 'width of pixels added on either side', unit='px')
    shift: float = tuning(
        1.5,
        'largest initial offset of an edge, and largest change of center and motion per pass',
        unit='px',
        source=(
            'invented; '
            'sweep: halved: hand and blur: tip rms px 0.115 -> 0.0852; doubled: hand and '
            'blur: rms px 0.0277 -> 0.0204'
        ),
    )
    least_blur: float = tuning(0.29, 'least blur of an edge: a pixel is a square', unit='px')
    most_blur: float = tuning(3.5, 'largest blur of an edge', unit='px')
    tilt_std: float = tuning(
        0.015,
        'slope of the light over a blob',
        unit='contrast / radius',
        source=(
            'invented; '
            'sweep: halved: jpeg, uneven: tip error/std 0.971 -> 1.23; doubled: hand and '
            'blur: tip rms px 0.115 -> 0.0852'
        ),
    )
    largest_change: float = tuning(
        0.25, 'largest change of size and shape per pass', unit='radius'
    )
    widest_step: float = tuning(0.3, 'largest change of the blur per pass', unit='px')
    most_smear: float = tuning(
        20.0,
        'largest motion during an exposure',
        unit='px',
        source='sweep: halved: hand and blur: tip rms px 0.115 -> 0.053; doubled: nothing',
    )
    least_axis: float = tuning(0.5, 'half the smallest axis, at least', unit='px')
    plateau_share: float = tuning(
        0.3,
        'share of the pixels inside that are brighter than the first plateau',
        source=(
            'invented; '
            'sweep: halved: hand and blur: tip rms px 0.115 -> 0.0896; doubled: hand and '
            'blur: rms px 0.0277 -> 0.0223'
        ),
    )
    cut: float = tuning(
        2.5,
        'distance from the outline above which an edge is left out',
        unit='usual distance',
        source=(
            'sweep: halved: jpeg, uneven: tip rms px 0.0956 -> 0.135; doubled: hand and blur: '
            'tip error/std 0.992 -> 1.32'
        ),
    )
    least_off: float = tuning(0.02, 'usual distance of edges from the outline', unit='px')
    knows: float = tuning(
        0.3,
        'largest position error of an informative edge',
        unit='px',
        source=(
            'invented; '
            'sweep: halved: hand and blur: tip rms px 0.115 -> 0.0868; doubled: hand and '
            'blur: tip rms px 0.115 -> 0.0845'
        ),
    )
    told: float = tuning(
        0.5,
        'smallest share of sectors with a visible edge, and of these with one on the outline',
        source='sweep: halved: hand and blur: tip error/std 0.992 -> 0.985; doubled: nothing',
    )
    within: float = tuning(
        0.9,
        'of the most that a blob covers of a pixel, where it is its inside',
        source='invented; sweep: halved: nothing; doubled: jpeg, uneven: tip found share 0.9 -> 0',
    )
    plain: float = tuning(0.3, 'inside of a blob, darker than it is drawn at most', unit='height')
    on_edge: float = tuning(
        0.03,
        'distance of an edge that is on the outline',
        unit='px',
        source='sweep: halved: nothing; doubled: jpeg, uneven: tip error/std 0.971 -> 1.23',
    )
    on_edge_share: float = tuning(
        0.006, 'the same, at least', unit='radius', source='measured: 15 px, edges blurred by 2 px'
    )
    near_edge: float = tuning(
        0.12,
        'distance of an edge that is near the outline',
        unit='px',
        source='sweep: halved: nothing; doubled: jpeg, uneven: tip rms px 0.0956 -> 0.114',
    )
    near_edge_share: float = tuning(
        0.02,
        'the same, added',
        unit='radius',
        source='sweep: halved: nothing; doubled: jpeg, uneven: tip rms px 0.0956 -> 0.114',
    )
    uneven: float = tuning(
        0.7,
        'of what is on either side of an edge, not explained',
        unit='grey level',
        source='measured',
    )
    smear_error: float = tuning(
        0.003,
        'of the center, for backgrounds that move along',
        unit='way^2 / radius',
        source='measured',
    )


EllipseNumbers = numbers_type(EllipseSettings, 'EllipseNumbers')
ELLIPSE = EllipseSettings()


def for_colors(settings: EllipseSettings) -> EllipseSettings:
    """Return settings for images compared by color, which is stored at half resolution.

    Measured with JPEG of 4:2:0, quality 85, dots of 12 and 16 px: edges are off by up to 0.25 px,
    and centers by 0.06 px rms, 12 grey levels of an edge of 200.
    """
    return replace(settings, on_edge=0.25, near_edge=0.4, uneven=12.0)


@functools.lru_cache
def ellipse_numbers(settings: EllipseSettings) -> Any:
    """Return settings in the form that kernels take."""
    return EllipseNumbers(*astuple(settings))


class Seen(NamedTuple):
    """Pixels relative to their ellipses, (pixels,) each.

    across, down: the point of the unit circle next to a pixel; ratio: how many times further out
    the pixel is; out_x, out_y: normal of the outline there; stretch: px of the outline per unit;
    outside: px outside of it.
    """

    across: Array
    down: Array
    ratio: Array
    out_x: Array
    out_y: Array
    stretch: Array
    outside: Array


class Rims(NamedTuple):
    """Pixels possibly near the edges of ellipses, one ellipse after the other, (pixels,) each.

    owner: index of the ellipse; x, y: px from the start of its fit; levels: brightness; before,
    after: the sectors on either side of a pixel, counted over all ellipses; share: its position
    between them, 0 to 1.
    """

    owner: Integers
    x: Array
    y: Array
    levels: Array
    before: Integers
    after: Integers
    share: Array

    def only(self, which: Integers) -> Rims:
        """Return some of the pixels."""
        return Rims(
            owner=self.owner[which],
            x=self.x[which],
            y=self.y[which],
            levels=self.levels[which],
            before=self.before[which],
            after=self.after[which],
            share=self.share[which],
        )

    def by_sector(self, values: Array, shape: tuple[int, int]) -> Array:
        """Return the sums of values (pixels,) over sectors, (ellipses, sectors)."""
        size, part = shape[0] * shape[1], self.share * values
        sums = np.bincount(self.before, values - part, size)
        return np.asarray((sums + np.bincount(self.after, part, size)).reshape(shape))

    def between(self, table: Array) -> Array:
        """Return a table (ellipses, sectors) interpolated at the pixels."""
        flat = table.ravel()
        before = flat[self.before]
        return np.asarray(before + self.share * (flat[self.after] - before))

    def pieces(self, which: Integers) -> Iterator[slice]:
        """Return the pixels of each of these ellipses."""
        last = np.cumsum(np.bincount(self.owner, minlength=which[-1] + 1))
        return map(slice, (last[which - 1] * (which > 0)).tolist(), last[which].tolist())


@dataclass(slots=True, eq=False)
class Fit:
    """Intermediate fits of ellipses, one row each.

    now (n, FITTED); moments (n,): number of moments of the exposure used for each; off (n, 2) px:
    displacement of the center so far; shape (n, 3): changes of size and shape so far; slopes (n,
    2) of the light, grey levels per px; reached (n, sectors): which have pixels; believed (n,
    sectors): weights.
    """

    now: Array
    moments: Integers
    off: Array
    shape: Array
    slopes: Array
    reached: Mask
    believed: Array


class Solution(NamedTuple):
    """The result of a pass over some ellipses.

    step (m, UNKNOWNS); error (m,) px: of the center; behind (m, sectors): grey levels of the
    background; edges, stds (m, sectors) px: distance of an edge outside of the outline, and its
    std; covered (pixels,): share of each pixel that the ellipses cover.
    """

    step: Array
    error: Array
    behind: Array
    edges: Array
    stds: Array
    covered: Array


def fit_ellipses(grey: Bytes, starts: Array, settings: EllipseSettings = ELLIPSE) -> Array:
    """Fit ellipses from initial guesses, (n, FITTED); NaN if a fit fails.

    starts (n, FITTED): centers, axes, blur, and their uncertainties.
    """
    fitted = np.full_like(starts, np.nan)
    if not len(starts):
        return fitted
    if jit.is_compiled():
        rules = QUANTIZATION, SIGMA
        numbers = ellipse_numbers(settings)
        fit_outlines(grey, starts, _moments(starts), numbers, rules, fitted)
        return fitted
    boxes = _boxes(grey, starts, settings)
    pixels = np.cumsum(boxes[:, 2] * boxes[:, 3])
    for some in np.split(np.arange(len(starts)), np.flatnonzero(np.diff(pixels // TOGETHER)) + 1):
        fitted[some] = _fit_together(grey, starts[some], boxes[some], settings)
    return fitted


def _moments(starts: Array) -> Integers:
    """Return the number of moments of an exposure per ellipse, (n,)."""
    smear, moments = _smear(starts), np.ones(len(starts), np.int64)
    for many, least in MOMENTS:
        moments[smear >= least] = many
    return moments


def _fit_together(grey: Bytes, starts: Array, boxes: Integers, settings: EllipseSettings) -> Array:
    """Fit ellipses whose pixels lie within boxes (n, 4)."""
    count = len(starts)
    rims = _cut_rims(grey, starts, boxes, settings)
    fit = _begun(rims, starts, settings)
    fitted = np.full_like(starts, np.nan)
    going = np.flatnonzero(np.bincount(rims.owner, minlength=count) >= 2 * UNKNOWNS)
    for turn in range(settings.passes):
        if not len(going):
            break
        found = _solve(rims, starts, fit, going, settings)
        whole = _move(fit, found.step, going, settings)
        way = np.abs(found.step[:, :2]).max(axis=1)
        done = (turn > 1) & (way < settings.done) | (turn == settings.passes - 1)
        ended = np.flatnonzero(done & whole)
        if len(ended):
            fitted[going[ended]] = _results(rims, starts, fit, going, found, ended, settings)
        on = np.flatnonzero(~done & whole)
        fit.believed[going[on]] = _believed(found.edges[on], found.stds[on], turn == 0, settings)
        going = going[on]
    return fitted


def _begun(rims: Rims, starts: Array, settings: EllipseSettings) -> Fit:
    """Return initialized fits."""
    count, now, moments = len(starts), starts.copy(), _moments(starts)
    now[moments == 1, SMEAR_U : SMEAR_V + 1] = 0.0
    now[:, WIDTH] = np.clip(starts[:, WIDTH], settings.least_blur, settings.most_blur)
    unknown = np.isinf(starts[:, PLATEAU_STD])
    now[unknown, PLATEAU] = _first_plateaus(rims, starts, settings)[unknown]
    shape = count, settings.sectors
    return Fit(
        now=now,
        moments=moments,
        off=np.zeros((count, 2)),
        shape=np.zeros((count, 3)),
        slopes=np.zeros((count, 2)),
        reached=rims.by_sector(np.ones(len(rims.x)), shape) > 0.0,
        believed=np.ones(shape),
    )


def _boxes(grey: Bytes, starts: Array, settings: EllipseSettings) -> Integers:
    """Return the parts of an image in which ellipses can be: left, top, width, height, (n, 4)."""
    center, axes = starts[:, [CENTER_U, CENTER_V]], starts[:, [AXIS_XX, AXIS_XY, AXIS_YY]]
    outward = settings.outward * starts[:, WIDTH] + settings.shift + settings.margin
    outward += 0.5 * _smear(starts)
    reach = np.hypot(axes[:, [0, 1]], axes[:, [1, 2]]) + outward[:, None]
    first = np.maximum(np.floor(center - reach), 0.0)
    last = np.minimum(np.ceil(center + reach), np.array([grey.shape[1], grey.shape[0]]) - 1.0)
    size = last - first + 1.0
    size[(size < 1.0).any(axis=1)] = 0.0
    return np.column_stack([first, size]).astype(np.int64)


def _cut_rims(grey: Bytes, starts: Array, boxes: Integers, settings: EllipseSettings) -> Rims:
    """Collect the pixels that can be near the edges of ellipses."""
    left, top, width, height = boxes.T
    room = width * height
    owner = np.repeat(np.arange(len(starts)), room)
    down, across = np.divmod(
        np.arange(len(owner)) - np.repeat(np.cumsum(room) - room, room), width[owner]
    )
    row, column = down + top[owner], across + left[owner]
    x, y = column - starts[owner, CENTER_U], row - starts[owner, CENTER_V]
    seen = _see(starts, owner, x, y)
    more = settings.shift + settings.margin + 0.5 * _smear(starts)[owner]
    blur = starts[owner, WIDTH]
    rim = (seen.outside > -settings.inward * blur - more) & (
        seen.outside < settings.outward * blur + more
    )
    around = np.arctan2(seen.down[rim], seen.across[rim]) * settings.sectors / (2.0 * math.pi)
    around %= settings.sectors
    before = np.minimum(around.astype(np.int64), settings.sectors - 1)
    owner = owner[rim]
    return Rims(
        owner=owner,
        x=x[rim],
        y=y[rim],
        levels=grey[row[rim], column[rim]].astype(np.float64),
        before=owner * settings.sectors + before,
        after=owner * settings.sectors + (before + 1) % settings.sectors,
        share=around - before,
    )


def _smear(ellipses: Array) -> Array:
    """Return the motion of ellipses (n, FITTED) during the exposure, px (n,)."""
    return np.asarray(np.hypot(ellipses[:, SMEAR_U], ellipses[:, SMEAR_V]))


def _see(ellipses: Array, owner: Integers, x: Array, y: Array) -> Seen:
    """Transform positions (px from the center) to the frames of ellipses (n, FITTED)."""
    xx, xy, yy = ellipses[:, [AXIS_XX, AXIS_XY, AXIS_YY]].T
    determinant = xx * yy - xy * xy
    xx, xy, yy = ((it / determinant)[owner] for it in (yy, -xy, xx))  # the inverse
    across, down = xx * x + xy * y, xy * x + yy * y
    ratio = np.maximum(np.sqrt(across * across + down * down), 1e-6)
    across /= ratio
    down /= ratio
    out_x, out_y = xx * across + xy * down, xy * across + yy * down
    # At the very center there is no normal; it is far inside then.
    stretch = 1.0 / np.maximum(np.sqrt(out_x * out_x + out_y * out_y), 1e-12)
    return Seen(
        across, down, ratio, out_x * stretch, out_y * stretch, stretch, (ratio - 1.0) * stretch
    )


def _first_plateaus(rims: Rims, starts: Array, settings: EllipseSettings) -> Array:
    """Return grey levels exceeded by only some of the pixels within ellipses, (n,)."""
    count = len(starts)
    plateaus = np.zeros(count)
    np.maximum.at(plateaus, rims.owner, rims.levels)
    within = _see(starts, rims.owner, rims.x, rims.y).outside < -0.5
    owner, levels = rims.owner[within], rims.levels[within]
    order = np.lexsort((levels, owner))
    sizes = np.bincount(owner, minlength=count)
    some = sizes > 0
    above = (settings.plateau_share * sizes).astype(np.int64)
    plateaus[some] = levels[order[(np.cumsum(sizes) - 1 - above)[some]]]
    return plateaus


class Drawn(NamedTuple):
    """Ellipses as rendered, (pixels,) each.

    covered: share of the exposure for which they cover a pixel; further: how many times further
    out it is than their edge; edge: derivative of covered by an outward shift of the edge, per px;
    moved (UNKNOWNS - 3, pixels): the same for all other unknowns except plateau and slopes, per px
    or radius.
    """

    covered: Array
    further: Array
    edge: Array
    moved: Array


def _draw(
    rims: Rims, fit: Fit, moments: int, settings: EllipseSettings
) -> tuple[Integers, Array, Array, Drawn]:
    """Draw ellipses over the pixels near their edges, averaged over an exposure.

    Returns the indices of these pixels, their positions (x, y px from the centers), and the
    drawing.
    """
    now, owner = fit.now, rims.owner
    x, y = rims.x - fit.off[owner, 0], rims.y - fit.off[owner, 1]
    times, parts = TIMES[moments, :moments], PARTS[moments, :moments]
    middle, more = _see(now, owner, x, y), settings.margin + 0.5 * _smear(now)[owner]
    blur = now[owner, WIDTH]
    near = np.flatnonzero(
        (middle.outside > -settings.inward * blur - more)
        & (middle.outside < settings.outward * blur + more)
    )
    x, y, owner, blur = x[near], y[near], owner[near], blur[near]
    smear_u, smear_v = now[owner, SMEAR_U], now[owner, SMEAR_V]
    views = [_see(now, owner, x - time * smear_u, y - time * smear_v) for time in times.tolist()]
    distance = np.array([seen.outside for seen in views]) / blur
    edge = PEAK * parts[:, None] / blur * np.exp(-0.5 * distance * distance)
    moved = np.zeros((UNKNOWNS - 3, len(blur)))
    further = np.zeros(len(blur))
    for time, part, seen, there, by_edge in zip(times, parts, views, distance, edge, strict=True):
        across, down, ratio, out_x, out_y, stretch, _ = seen
        by_u, by_v, stretched = by_edge * out_x, by_edge * out_y, by_edge * stretch
        moved[0] += by_u
        moved[1] += by_v
        moved[2] += stretched
        moved[3] += stretched * (across * across - down * down)
        moved[4] += 2.0 * stretched * across * down
        moved[5] += by_edge * there
        moved[6] += time * by_u
        moved[7] += time * by_v
        further += part * ratio
    covered = 0.5 * parts @ scipy.special.erfc(distance / math.sqrt(2.0))
    drawn = Drawn(covered, further, edge.sum(axis=0), moved)
    return near, x, y, drawn


def _solve(
    rims: Rims,
    starts: Array,
    fit: Fit,
    going: Integers,
    settings: EllipseSettings,
) -> Solution:
    """One Gauss-Newton step for the ellipses that have not converged."""
    products, weights, behind, edges, covered = _linearize(rims, fit, going, settings)
    searched = np.where(fit.moments[going] > 1, UNKNOWNS, UNKNOWNS - 2)  # not where nothing moves
    variance = products[:, LEFT, LEFT] / np.maximum(weights - searched, 4.0)
    variance = np.maximum(variance, QUANTIZATION)
    now = fit.now[going]
    typical = now[:, PLATEAU] - _median_of(behind, fit.reached[going])
    normal, gradient = _with_expectations(
        products, variance, typical, starts, fit, going, settings
    )
    covariance = np.linalg.inv(normal)
    step = (covariance @ gradient[:, :, None])[:, :, 0]
    tells = np.maximum(edges[:, :, EDGE], 1e-9)
    left = edges[:, :, LEFT] - (edges[:, :, :UNKNOWNS] @ step[:, :, None])[:, :, 0]
    larger = variance * np.maximum(covariance[:, 0, 0], covariance[:, 1, 1])
    return Solution(
        step=step,
        error=np.sqrt(larger + _model_error(now, typical, settings) ** 2),
        behind=behind,
        edges=left / tells,
        stds=np.sqrt(variance[:, None] / tells),
        covered=covered,
    )


def _no_sums(rims: Rims, fit: Fit, going: Integers) -> Linearized:
    """Return empty arrays for a linearization."""
    count, sectors = len(going), fit.believed.shape[1]
    return Linearized(
        products=np.empty((count, UNKNOWNS + 1, UNKNOWNS + 1)),
        weights=np.empty(count),
        behind=np.empty((count, sectors)),
        edges=np.empty((count, sectors, COLUMNS)),
        covered=np.zeros(len(rims.x)),
    )


def _linearize(rims: Rims, fit: Fit, going: Integers, settings: EllipseSettings) -> Linearized:
    """Linearize around some ellipses, those with the same number of moments together."""
    sums = _no_sums(rims, fit, going)
    for moments in np.unique(fit.moments[going]).tolist():
        alike = np.flatnonzero(fit.moments[going] == moments)
        _linearize_alike(rims, fit, going[alike], moments, settings, alike, sums)
    return sums


def _linearize_alike(
    rims: Rims,
    fit: Fit,
    going: Integers,
    moments: int,
    settings: EllipseSettings,
    lines: Integers,
    sums: Linearized,
) -> None:
    """Linearize ellipses with the same number of exposure moments, as columns over their pixels.

    lines (m,): where in `sums` their results are written.
    """
    now, size = fit.now, fit.believed.shape
    theirs = np.zeros(len(now), np.bool_)
    theirs[going] = True
    places = np.flatnonzero(theirs[rims.owner])
    near, x, y, drawn = _draw(rims.only(places), fit, moments, settings)
    rims = rims.only(places[near])
    # First the background of each sector. Uneven light tells on the blob from its center on,
    # behind it from the edge on.
    covered, bare = drawn.covered, 1.0 - drawn.covered
    lever = covered + bare * (1.0 - 1.0 / drawn.further)
    plateau = now[rims.owner, PLATEAU]
    tilt = fit.slopes[rims.owner, 0] * x + fit.slopes[rims.owner, 1] * y
    left = rims.levels - plateau * covered - lever * tilt
    behind = _smoothed(rims.by_sector(bare * left, size)) / np.maximum(
        _smoothed(rims.by_sector(bare * bare, size)), 1e-6
    )
    background = rims.between(behind)
    # Then the sums.
    height = plateau - background + tilt / drawn.further
    columns = np.empty((COLUMNS, len(x)))
    columns[: UNKNOWNS - 3] = height * drawn.moved
    columns[8], columns[9], columns[10] = covered, lever * x, lever * y
    columns[LEFT], columns[EDGE] = left - bare * background, height * drawn.edge
    weight = rims.between(fit.believed)
    # All that is summed up, by what it is multiplied with: weighted columns, edges by sector.
    factors = np.zeros((UNKNOWNS + 1 + size[1], len(x)))
    np.multiply(columns[: UNKNOWNS + 1], weight, out=factors[: UNKNOWNS + 1])
    line, first = np.arange(len(x)), rims.before % size[1]
    part = rims.share * columns[EDGE]
    factors[UNKNOWNS + 1 + first, line] = columns[EDGE] - part
    factors[UNKNOWNS + 1 + (first + 1) % size[1], line] = part
    products = np.array([_product(columns, factors, piece) for piece in rims.pieces(going)])
    sums.products[lines] = products[:, : UNKNOWNS + 1, : UNKNOWNS + 1]
    sums.weights[lines] = np.bincount(rims.owner, weight, len(now))[going]
    sums.behind[lines] = behind[going]
    sums.edges[lines] = products[:, :, UNKNOWNS + 1 :].transpose(0, 2, 1)
    sums.covered[places[near]] = covered


def _product(columns: Array, factors: Array, piece: slice) -> Array:
    """Return the sums over a piece of the pixels of products of columns with factors.

    In pieces: on a busy processor, threads for such small products cost a thousand times more than
    they gain.
    """
    first, last = piece.start, piece.stop
    total = np.zeros((len(columns), len(factors)))
    for begin in range(first, last, PRODUCT):
        some = slice(begin, min(begin + PRODUCT, last))
        total += columns[:, some] @ factors[:, some].T
    return total


def _model_error(ellipses: Array, height: Array, settings: EllipseSettings) -> Array:
    """Return the error (n,) px of centers due to the shape model of a blob.

    An uneven surface moves an edge by its grey levels over the height (n,) of the edge.
    """
    uneven = settings.uneven / np.maximum(np.abs(height), 1.0)
    smeared = settings.smear_error * _smear(ellipses) ** 2 / _radius(ellipses)
    return np.asarray(np.hypot(uneven, smeared))


def _smoothed(sums: Array) -> Array:
    """Return sums over sectors (n, sectors), each plus half of its neighbors."""
    around = np.concatenate([sums[:, -1:], sums, sums[:, :1]], axis=1)
    return np.asarray(sums + 0.5 * (around[:, :-2] + around[:, 2:]))


def _with_expectations(
    products: Array,
    variance: Array,
    height: Array,
    starts: Array,
    fit: Fit,
    going: Integers,
    settings: EllipseSettings,
) -> tuple[Array, Array]:
    """Add the prior to the normal equations.

    products (n, UNKNOWNS + 1, UNKNOWNS + 1): of the derivatives and the residual; variance of a
    pixel and height (n,). Returns matrices (n, UNKNOWNS, UNKNOWNS) and right sides (n, UNKNOWNS).
    """
    now, start = fit.now[going], starts[going]
    std, off = np.full((len(going), UNKNOWNS), math.inf), np.zeros((len(going), UNKNOWNS))
    std[:, 2], std[:, 3:5] = start[:, SIZE_STD], start[:, [SHAPE_STD]]
    off[:, 2:5] = fit.shape[going]
    std[:, 5], off[:, 5] = start[:, WIDTH_STD], now[:, WIDTH] - start[:, WIDTH]
    std[:, 6:8] = start[:, [SMEAR_STD]]
    off[:, 6:8] = now[:, [SMEAR_U, SMEAR_V]] - start[:, [SMEAR_U, SMEAR_V]]
    std[:, 8] = start[:, PLATEAU_STD]
    off[:, 8] = np.where(np.isinf(std[:, 8]), 0.0, now[:, PLATEAU] - start[:, PLATEAU])
    tilt_std = settings.tilt_std * np.maximum(np.abs(height), 1.0) / _radius(now)
    std[:, 9:], off[:, 9:] = tilt_std[:, None], fit.slopes[going]
    known = variance[:, None] / (std * std)
    normal = products[:, :UNKNOWNS, :UNKNOWNS] + (known + 1e-9)[:, :, None] * np.eye(UNKNOWNS)
    return normal, products[:, :UNKNOWNS, UNKNOWNS] - known * off


def _radius(ellipses: Array) -> Array:
    """Return the radius of circles with the area of ellipses (n, FITTED)."""
    xx, xy, yy = ellipses[:, [AXIS_XX, AXIS_XY, AXIS_YY]].T
    return np.asarray(np.sqrt(xx * yy - xy * xy))


def _move(fit: Fit, step: Array, going: Integers, settings: EllipseSettings) -> Mask:
    """Change ellipses by steps (n, UNKNOWNS), keeping axes symmetric; return which are valid.

    The rest of a fit is unchanged.
    """
    now = fit.now[going]
    fit.off[going] += np.clip(step[:, :2], -settings.shift, settings.shift)
    change = np.clip(step[:, 2:5], -settings.largest_change, settings.largest_change)
    fit.shape[going] += change
    size, along, aslant = change.T
    xx, xy, yy = now[:, [AXIS_XX, AXIS_XY, AXIS_YY]].T
    a, b = xx * (1.0 + size + along) + xy * aslant, xx * aslant + xy * (1.0 + size - along)
    c, d = xy * (1.0 + size + along) + yy * aslant, xy * aslant + yy * (1.0 + size - along)
    # The symmetric root of the matrix times its transpose.
    square_xx, square_xy, square_yy = a * a + b * b, a * c + b * d, c * c + d * d
    root = np.abs(a * d - b * c)
    scale = np.sqrt(square_xx + square_yy + 2.0 * root)
    xx, xy, yy = (square_xx + root) / scale, square_xy / scale, (square_yy + root) / scale
    now[:, AXIS_XX], now[:, AXIS_XY], now[:, AXIS_YY] = xx, xy, yy
    now[:, WIDTH] += np.clip(step[:, 5], -settings.widest_step, settings.widest_step)
    now[:, WIDTH] = np.clip(now[:, WIDTH], settings.least_blur, settings.most_blur)
    smear_step = np.clip(step[:, 6:8], -settings.shift, settings.shift)
    smear_step[fit.moments[going] == 1] = 0.0
    now[:, [SMEAR_U, SMEAR_V]] += smear_step
    now[:, PLATEAU] += step[:, 8]
    fit.slopes[going] += step[:, 9:]
    fit.now[going] = now
    smallest = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    return np.asarray((smallest >= settings.least_axis) & (_smear(now) <= settings.most_smear))


def _believed(edges: Array, stds: Array, gently: bool, settings: EllipseSettings) -> Array:
    """Return the weights of sectors (n, sectors): 0 if their edge is off the outline.

    gently: tolerate larger distances, for the first steps.
    """
    usual = SIGMA * _median_of(np.abs(edges), stds < settings.knows)
    usual = np.where(np.isnan(usual), 1.0, np.maximum(usual, settings.least_off))
    ratio = np.abs(edges) / (settings.cut * usual[:, None])
    if gently:
        return np.asarray(1.0 / (1.0 + 4.0 * ratio * ratio))
    return np.asarray((1.0 - np.minimum(ratio, 1.0) ** 2) ** 2)


def _median_of(values: Array, which: Mask) -> Array:
    """Return the median of the selected values in each row; NaN without any."""
    order = np.sort(np.where(which, values, np.inf), axis=1)
    count, line = np.count_nonzero(which, axis=1), np.arange(len(values))
    median = 0.5 * (order[line, np.maximum(count - 1, 0) // 2] + order[line, count // 2])
    return np.where(count > 0, median, math.nan)


def _results(
    rims: Rims,
    starts: Array,
    fit: Fit,
    going: Integers,
    found: Solution,
    ended: Integers,
    settings: EllipseSettings,
) -> Array:
    """Return the rows (ended, FITTED) of converged ellipses.

    ended: their indices among those still being fitted.
    """
    which = going[ended]
    fitted = fit.now[which]
    fitted[:, [CENTER_U, CENTER_V]] = starts[which][:, [CENTER_U, CENTER_V]] + fit.off[which]
    fitted[:, ERROR] = found.error[ended]
    reached = fit.reached[which]
    fitted[:, BEHIND] = _median_of(found.behind[ended], reached)
    fitted[:, WITHIN] = _plain_within(rims, which, fitted, found.covered, settings)
    edges, stds = found.edges[ended], found.stds[ended]
    clear = stds < settings.knows
    near = settings.near_edge + settings.near_edge_share * _radius(fitted)[:, None]
    told = np.count_nonzero(clear, axis=1)
    seen = np.count_nonzero(clear & (np.abs(edges) < near + 2.0 * stds), axis=1)
    enough = told >= settings.told * np.count_nonzero(reached, axis=1)
    fitted[:, NEAR_EDGE] = np.where(enough, seen / np.maximum(told, 1), 0.0)
    on = np.maximum(settings.on_edge, settings.on_edge_share * _radius(fitted))[:, None]
    on_edge = clear & (np.abs(edges) < on + 2.0 * stds)
    fitted[:, ON_EDGE] = np.count_nonzero(on_edge, axis=1) / settings.sectors
    outside = clear & (edges > near + 2.0 * stds)
    fitted[:, OUTSIDE] = np.count_nonzero(outside, axis=1) / settings.sectors
    return fitted


def _plain_within(
    rims: Rims, which: Integers, fitted: Array, covered: Array, settings: EllipseSettings
) -> Array:
    """Return the share of the inside of ellipses with the modeled brightness (which,).

    covered (pixels,): the covered share of each pixel.
    """
    shares = np.empty(len(which))
    pieces = rims.pieces(which)
    for number, (piece, one) in enumerate(zip(pieces, fitted, strict=True)):
        plateau, behind = one[PLATEAU], one[BEHIND]
        inside = covered[piece] > settings.within * covered[piece].max()
        covers, levels = covered[piece][inside], rims.levels[piece][inside]
        plain = levels >= behind + (covers - settings.plain) * (plateau - behind)
        shares[number] = np.count_nonzero(plain) / max(len(plain), 1)
    return shares
