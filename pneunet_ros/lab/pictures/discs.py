"""Coverage of image pixels by a disc in the working plane, and the disc's true position.

The map from the disc to the image is expanded to second order around its center, which is accurate
to about 1e-4 px for discs of a few px. The covered share of a pixel is computed, not sampled: the
edge is straight within a small part of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.lab.pictures.lens import Camera

Places = npt.NDArray[np.int64]

EDGE_POINTS = 64
LONGEST_STEP_PX = 1.0  # between averaged positions of a moving disc
PARTS = 2  # of a pixel, per axis; in each the edge of a disc is straight
EDGE = 1.1  # px; pixels farther from the edge are entirely inside or outside
FINEST = 1e-3  # smallest slope of an edge against the axes, so that corners stay finite

_AROUND = 2.0 * np.pi * np.arange(EDGE_POINTS) / EDGE_POINTS
# Points of the unit disc at which the map is evaluated: center, four sides, four corners, then the
# edge.
_ACROSS = np.concatenate([[0.0, 1, -1, 0, 0, 1, 1, -1, -1], np.cos(_AROUND)])
_ALONG = np.concatenate([[0.0, 0, 0, 1, -1, 1, -1, 1, -1], np.sin(_AROUND)])
_PARTS = (np.arange(PARTS) + 0.5) / PARTS - 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Discs:
    """Images of n discs: second-order map from the unit disc (a, b) to the image.

    u, v (n,) px, image of the center; slope (n, 2, 2) and bend (n, 2, 3), first and second
    derivatives (aa, ab, bb) of (u, v); centroid (n, 2) px and area (n,) px^2 of the image; reach
    (n,) px, from the center to the farthest edge.
    """

    u: Array
    v: Array
    slope: Array
    bend: Array
    centroid: Array
    area: Array
    reach: Array


def see_discs(camera: Camera, x: Array, y: Array, radius: Array) -> Discs:
    """Return the images of discs in the working plane, all (n,) in m."""
    u, v = camera.project(
        x[:, None] + radius[:, None] * _ACROSS, y[:, None] + radius[:, None] * _ALONG
    )
    outline = np.stack([u[:, :9], v[:, :9]], axis=1)
    slope = 0.5 * np.stack(
        [outline[..., 1] - outline[..., 2], outline[..., 3] - outline[..., 4]], axis=2
    )
    middle = 2.0 * outline[..., 0]
    bend = np.stack(
        [
            outline[..., 1] + outline[..., 2] - middle,
            0.25 * (outline[..., 5] - outline[..., 6] - outline[..., 7] + outline[..., 8]),
            outline[..., 3] + outline[..., 4] - middle,
        ],
        axis=2,
    )
    edge_u, edge_v = u[:, 9:] - u[:, :1], v[:, 9:] - v[:, :1]
    return Discs(
        u=u[:, 0], v=v[:, 0], slope=slope, bend=bend, **_polygon(u[:, 0], v[:, 0], edge_u, edge_v)
    )


def flat_discs(u: Array, v: Array, major: Array, minor: Array, angle: Array) -> Discs:
    """Return ellipses given in the image: all (n,), px and rad (from +u towards +v)."""
    cos, sin = np.cos(angle), np.sin(angle)
    slope = np.stack(
        [np.stack([major * cos, -minor * sin], 1), np.stack([major * sin, minor * cos], 1)], 1
    )
    return Discs(
        u=u,
        v=v,
        slope=slope,
        bend=np.zeros((u.size, 2, 3)),
        centroid=np.stack([u, v], axis=1),
        area=math.pi * major * minor,
        reach=np.maximum(major, minor),
    )


def _polygon(u: Array, v: Array, edge_u: Array, edge_v: Array) -> dict[str, Array]:
    """Centroid, area and reach of closed outlines (n, points) around (u, v)."""
    next_u, next_v = np.roll(edge_u, -1, axis=1), np.roll(edge_v, -1, axis=1)
    cross = edge_u * next_v - next_u * edge_v
    twice = cross.sum(axis=1)
    safe = np.where(twice == 0.0, 1.0, twice)
    offset_u = ((edge_u + next_u) * cross).sum(axis=1) / (3.0 * safe)
    offset_v = ((edge_v + next_v) * cross).sum(axis=1) / (3.0 * safe)
    # The ratio of the areas of a circle and the polygon inscribed in it.
    missing = _AROUND[1] / math.sin(_AROUND[1])
    return {
        'centroid': np.stack([u + offset_u, v + offset_v], axis=1),
        'area': 0.5 * missing * np.abs(twice),
        'reach': np.sqrt((edge_u**2 + edge_v**2).max(axis=1)),
    }


def steps_of(length_px: float) -> Array:
    """Return the sampling times of the exposure, from -0.5 to 0.5."""
    count = max(1, math.ceil(length_px / LONGEST_STEP_PX))
    return (np.arange(count) + 0.5) / count - 0.5


def cover(
    discs: Discs, shift_u: Array, shift_v: Array, margin: int = 0
) -> tuple[Places, Places, Array]:
    """Return the mean coverage of pixels by moving discs: center + shift (n, times).

    The result is the window of each disc: column and row (n,) of its first pixel, as integers, and
    the covered shares (n, PARTS rows, PARTS columns) of the parts of its pixels, rows == columns,
    with a margin of a few px around the disc. Discs must be finite and not empty.
    """
    largest_radius = discs.reach + np.hypot(shift_u, shift_v).max(axis=1)
    half = math.ceil(float(largest_radius.max()) + 1.0) + margin
    size = 2 * half + 1
    column = np.rint(discs.u).astype(np.int64) - half
    row = np.rint(discs.v).astype(np.int64) - half
    inverse = np.asarray(np.linalg.inv(discs.slope), np.float64)
    shares = np.zeros((discs.u.size, size, PARTS, size, PARTS))
    turn = inverse[..., None, None]
    narrow = (discs.area / (math.pi * discs.reach))[:, None, None]  # the smaller half axis, px
    for time in range(shift_u.shape[1]):
        du = (column - discs.u - shift_u[:, time])[:, None] + np.arange(size)
        dv = (row - discs.v - shift_v[:, time])[:, None] + np.arange(size)
        a = turn[:, 0, 0] * du[:, None, :] + turn[:, 0, 1] * dv[:, :, None]
        b = turn[:, 1, 0] * du[:, None, :] + turn[:, 1, 1] * dv[:, :, None]
        inward = narrow - narrow * np.sqrt(a * a + b * b)
        inside = (inward > 0.0).astype(np.float64)
        shares += inside[:, :, None, :, None]
        disc, pixel_row, pixel_column = np.nonzero(np.abs(inward) < EDGE)
        distance, normal_u, normal_v = edge_of(
            inverse,
            discs.bend,
            disc[:, None, None].astype(np.int64),
            du[disc, pixel_column][:, None, None] + _PARTS,
            dv[disc, pixel_row][:, None, None] + _PARTS[:, None],
        )
        exact = half_plane(PARTS * distance, normal_u, normal_v)
        shares[disc, pixel_row, :, pixel_column] += (
            exact - inside[disc, pixel_row, pixel_column][:, None, None]
        )
    return column, row, shares.reshape(-1, PARTS * size, PARTS * size) / shift_u.shape[1]


def optics(size: int, blur: float) -> Array:
    """Return the matrix (size, PARTS size) that blurs parts of pixels and sums them to pixels.

    The light is blurred before it is summed, as in a camera: sigma is `blur` (px).
    """
    sharp = np.kron(np.eye(size), np.full((1, PARTS), 1.0 / PARTS))
    if blur <= 0.0:
        return sharp
    parts = np.arange(PARTS * size) / PARTS
    smear = np.exp(-0.5 * ((parts[:, None] - parts) / blur) ** 2)
    result: Array = sharp @ (smear / smear[parts.size // 2].sum())
    return result


def edge_of(
    inverse: Array, bend: Array, disc: Places, du: Array, dv: Array
) -> tuple[Array, Array, Array]:
    """Return the distance (px) from the edge of a disc, positive inside, and the normal there.

    disc: index of the disc; du, dv: px from the image of its center; all three must broadcast. The
    components of the normal are absolute values. The result is first-order accurate, and good near
    the edge.
    """
    turn = inverse[disc]
    a = turn[..., 0, 0] * du + turn[..., 0, 1] * dv
    b = turn[..., 1, 0] * du + turn[..., 1, 1] * dv
    if bend.any():
        halves = 0.5 * bend[disc]
        aa, ab, bb = a * a, 2.0 * a * b, b * b
        bent_u = halves[..., 0, 0] * aa + halves[..., 0, 1] * ab + halves[..., 0, 2] * bb
        bent_v = halves[..., 1, 0] * aa + halves[..., 1, 1] * ab + halves[..., 1, 2] * bb
        a -= turn[..., 0, 0] * bent_u + turn[..., 0, 1] * bent_v
        b -= turn[..., 1, 0] * bent_u + turn[..., 1, 1] * bent_v
    radius = np.maximum(np.sqrt(a * a + b * b), 1e-9)
    slope_u = np.abs(turn[..., 0, 0] * a + turn[..., 1, 0] * b) / radius
    slope_v = np.abs(turn[..., 0, 1] * a + turn[..., 1, 1] * b) / radius
    steep = np.maximum(np.sqrt(slope_u * slope_u + slope_v * slope_v), 1e-12)
    return (1.0 - radius) / steep, slope_u / steep, slope_v / steep


def half_plane(inward: Array, normal_u: Array, normal_v: Array) -> Array:
    """Return the share of a unit square within a half plane.

    inward: distance of the center of the square from the edge, positive inside; normal_u, normal_v
    >= 0: absolute components of the unit normal of the edge.
    """
    inward = np.clip(inward, -1.0, 1.0)
    large = np.maximum(normal_u, normal_v)
    small = np.maximum(np.minimum(normal_u, normal_v), FINEST)
    outer, inner = 0.5 * (large + small), 0.5 * (large - small)
    # The integral of the length of the edge within the square: four ramps, squared.
    share = np.maximum(inward + outer, 0.0) ** 2
    share -= np.maximum(inward + inner, 0.0) ** 2
    share -= np.maximum(inward - inner, 0.0) ** 2
    share += np.maximum(inward - outer, 0.0) ** 2
    result: Array = share / (2.0 * large * small)
    return result
