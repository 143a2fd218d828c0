"""Camera intrinsics: mapping between raw image pixels and undistorted coordinates.

Normalized coordinates (x/z, y/z) are those of the camera's optical frame: z forward, x to the
right and y down in the image. A lens maps them to

    (x, y) radial + (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y),
    radial = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).

This is the gradient of a potential. Where its Jacobian, a symmetric matrix, is positive definite
in a whole disc, the potential is convex there and no two points of the disc share a pixel. Beyond
the largest such disc the image may fold back on itself and is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, table_array
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.image import LARGEST_SIDE
from pneunet_ros.core.kernels.jit import inlined, kernel

# Model -> possible numbers of coefficients. More than eight are of models with more terms, whose
# coefficients must then be zero.
COEFFICIENTS = {'plumb_bob': (0, 4, 5), 'rational_polynomial': (0, 8, 12, 14)}
TERMS = 8  # k1, k2, p1, p2, k3, k4, k5, k6
FOCAL_LENGTHS = (1.0, 1e7)  # px
LARGEST_COEFFICIENT = 1e12  # of a long lens, in which r is small
FARTHEST = 1e3  # normalized; 0.06 degrees from a right angle to the axis
MOST_ITERATIONS = 60
MOST_HALVINGS = 40
DONE_PX = 1e-11
ACCEPTED_PX = 1e-9
TOUCHING = 1e-6  # relative imaginary part of a root that may as well be a real double root


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens:
    """Pinhole and distortion parameters of a camera, from a camera_info.

    width, height of the image in px; model 'plumb_bob' or 'rational_polynomial'; matrix (3, 3) is
    K, px; distortion (n,) is D, empty if there is none. `limit` is the radius, in normalized
    coordinates, within which the distortion neither folds nor exceeds FARTHEST. Raises CameraError
    for anything else.
    """

    width: int
    height: int
    model: str
    matrix: Array
    distortion: Array
    limit: float = field(init=False)
    coefficients: Array = field(init=False, repr=False)  # fx, fy, cx, cy and the TERMS

    def __post_init__(self) -> None:
        """Check the camera_info."""
        for name in ('width', 'height'):
            side: Any = getattr(self, name)
            if isinstance(side, bool) or not isinstance(side, int) or not 0 < side <= LARGEST_SIDE:
                raise CameraError(
                    f'the {name} of the camera image (image_{name}) must be 1 to '
                    f'{LARGEST_SIDE} px, not {side!r}',
                    reason='out_of_bounds',
                )
        matrix = table_array(self.matrix, 'K (camera_matrix)', 2, CameraError)
        distortion = table_array(self.distortion, 'D (distortion_coefficients)', 1, CameraError)
        coefficients = np.concatenate([pinhole(matrix), distortion_terms(self.model, distortion)])
        object.__setattr__(self, 'matrix', matrix)
        object.__setattr__(self, 'distortion', distortion)
        object.__setattr__(self, 'coefficients', freeze(coefficients))
        object.__setattr__(self, 'limit', distortion_limit(coefficients[4:]))

    def distort(self, normalized: npt.ArrayLike) -> Array:
        """Return pixels (n, 2) for normalized points (n, 2); NaN beyond the limit."""
        points = copy_pairs(normalized)
        distort_points(points, self.coefficients, self.limit)
        return points

    def undistort(self, pixels: npt.ArrayLike) -> Array:
        """Return normalized points (n, 2) for pixels (n, 2); NaN if there is none.

        Iterated until `distort` reproduces the pixel to 1e-9 px. NaN if no point within the limit
        of the distortion maps to the pixel.
        """
        points = copy_pairs(pixels)
        undistort_points(points, self.coefficients, self.limit)
        return points

    def scale(self, normalized: npt.ArrayLike) -> Array:
        """Return normalized length per px at normalized (n, 2), the largest in any direction."""
        points = copy_pairs(normalized)
        out = np.empty(len(points))
        magnify_points(points, self.coefficients, self.limit, out)
        return out


def copy_pairs(values: npt.ArrayLike) -> Array:
    """Return pairs (n, 2) in a new array, for a kernel to overwrite; CameraError for others."""
    pairs = np.array(values, dtype=np.float64, order='C')
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise CameraError(
            f'points must be pairs (n, 2), not an array of shape {pairs.shape}',
            reason='wrong_shape',
        )
    return pairs


def pinhole(matrix: Array) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy in px from K (3, 3); CameraError if it is invalid."""
    if matrix.shape != (3, 3):
        raise CameraError(
            f'K (camera_matrix) must be 3 x 3, not of shape {matrix.shape}', reason='wrong_shape'
        )
    if matrix[0, 0] == 0.0:
        raise CameraError(
            'the camera is not calibrated: its K (camera_matrix) is zero', reason='not_calibrated'
        )
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    low, high = FOCAL_LENGTHS
    if not (low <= fx <= high and low <= fy <= high):
        raise CameraError(
            f'the focal lengths {fx} and {fy} of K (camera_matrix) must lie within '
            f'{low:g} and {high:g} px',
            reason='out_of_bounds',
        )
    if not np.array_equal(matrix, [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]):
        raise CameraError(
            'K (camera_matrix) must read fx 0 cx, 0 fy cy, 0 0 1 (no skew)', reason='wrong_form'
        )
    return fx, fy, cx, cy


def distortion_terms(model: str, distortion: Array) -> Array:
    """Return all TERMS of the distortion from D; CameraError for other models and numbers."""
    if not isinstance(model, str) or (model not in COEFFICIENTS and (model or distortion.size)):
        raise CameraError(
            f'distortion_model {model!r} is not known; known: {", ".join(COEFFICIENTS)}',
            reason='unknown_kind',
        )
    allowed = COEFFICIENTS.get(model, (0,))
    if distortion.size not in allowed or np.any(distortion[TERMS:]):
        raise CameraError(
            f'D (distortion_coefficients) of {model} must have {", ".join(map(str, allowed))} '
            f'numbers (zero after the eighth), not {distortion.size}: {distortion.tolist()}',
            reason='wrong_shape',
        )
    if np.any(np.abs(distortion) > LARGEST_COEFFICIENT):
        raise CameraError(
            f'D (distortion_coefficients) contains a number beyond {LARGEST_COEFFICIENT:g}: '
            f'{distortion.tolist()}',
            reason='too_large',
        )
    terms = np.zeros(TERMS)
    terms[: min(distortion.size, TERMS)] = distortion[:TERMS]
    return terms


def distortion_limit(terms: Array) -> float:
    """Compute the radius up to which the distortion neither folds nor exceeds FARTHEST.

    With the tangential strength p = |(p1, p2)| the eigenvalues of the Jacobian at r are at least
    the smaller of radial and d(r radial)/dr, less 6 p r. The radius is the first at which one of
    them, or the denominator of radial, becomes zero, or at which the image, at most r radial + 3 p
    r^2 from the axis, reaches FARTHEST; itself at most FARTHEST.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = terms.tolist()
    polynomial = np.polynomial.Polynomial
    r = polynomial([0.0, 1.0])
    above = polynomial([1.0, 0.0, k1, 0.0, k2, 0.0, k3])
    below = polynomial([1.0, 0.0, k4, 0.0, k5, 0.0, k6])
    tangential = 6.0 * math.hypot(p1, p2) * r
    outward = r * (above + 0.5 * tangential * below)
    growth = (r * above).deriv() * below - r * above * below.deriv()
    radius = FARTHEST
    for positive in (
        below,
        above - tangential * below,
        growth - tangential * below * below,
        below - outward / FARTHEST,
    ):
        # All are 1 at r = 0, so 1/r are the roots of a polynomial with the leading coefficient 1,
        # which needs no division by coefficients that may be tiny.
        inverse = np.roots(np.asarray(positive.coef))
        real = inverse.real[np.abs(inverse.imag) <= TOUCHING * np.abs(inverse)]
        radius = min([radius, *(1.0 / real[real > 1.0 / FARTHEST]).tolist()])
    return radius


def check_whole_image(
    lens: Lens, binning: tuple[int, int], region: tuple[int, int, int, int]
) -> None:
    """Reject a camera_info with binning or a region of interest.

    binning: x, y; region of interest: x_offset, y_offset, width, height. Zeros: none. Raises
    CameraError.
    """
    if not set(binning) <= {0, 1}:
        raise CameraError(
            f'camera_info with binning {binning[0]} x {binning[1]} is not supported: '
            'publish the image unbinned, or a camera_info of the binned image',
            reason='not_supported',
        )
    if tuple(region) not in ((0, 0, 0, 0), (0, 0, lens.width, lens.height)):
        raise CameraError(
            f'camera_info with a region of interest (x, y, width, height = {tuple(region)}) is '
            'not supported: publish the whole image, or a camera_info of the part',
            reason='not_supported',
        )


@inlined
def distort(x: float, y: float, c: Array) -> tuple[float, float, float, float, float]:
    """Compute the distorted coordinates of (x, y), and the Jacobian: xx, xy = yx, yy."""
    q = x * x + y * y
    above = 1.0 + q * (c[4] + q * (c[5] + q * c[8]))
    below = 1.0 + q * (c[9] + q * (c[10] + q * c[11]))
    radial = above / below
    slope = c[4] + q * (2.0 * c[5] + q * 3.0 * c[8])
    slope = 2.0 * (slope - radial * (c[9] + q * (2.0 * c[10] + q * 3.0 * c[11]))) / below
    p1, p2 = c[6], c[7]
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (q + 2.0 * x * x),
        y * radial + p1 * (q + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@kernel
def distort_points(points: Array, c: Array, limit: float) -> None:
    """Convert normalized points (n, 2) to pixels in place; NaN beyond the limit."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        points[i, 0] = points[i, 1] = np.nan
        if not (abs(x) < limit and abs(y) < limit and x * x + y * y < limit * limit):
            continue
        x, y, _, _, _ = distort(x, y, c)
        if abs(x) < FARTHEST and abs(y) < FARTHEST:
            points[i, 0] = c[0] * x + c[2]
            points[i, 1] = c[1] * y + c[3]


@kernel
def undistort_points(points: Array, c: Array, limit: float) -> None:
    """Convert pixels (n, 2) to normalized points in place; NaN if there is none within the limit.

    Uses Newton's method; steps are halved until they reduce the error and stay within the limit.
    """
    for i in range(points.shape[0]):
        u, v = points[i, 0], points[i, 1]
        points[i, 0] = points[i, 1] = np.nan
        if not (abs(u - c[2]) < FARTHEST * c[0] and abs(v - c[3]) < FARTHEST * c[1]):
            continue
        goal_x, goal_y = (u - c[2]) / c[0], (v - c[3]) / c[1]
        shrink = min(1.0, 0.99 * limit / max(math.hypot(goal_x, goal_y), 1e-30))
        x, y = goal_x * shrink, goal_y * shrink
        at_x, at_y, xx, xy, yy = distort(x, y, c)
        miss_x, miss_y = goal_x - at_x, goal_y - at_y
        miss = (c[0] * miss_x) ** 2 + (c[1] * miss_y) ** 2
        for _ in range(MOST_ITERATIONS):
            if miss <= DONE_PX**2:
                break
            determinant = xx * yy - xy * xy
            step_x = (yy * miss_x - xy * miss_y) / determinant
            step_y = (xx * miss_y - xy * miss_x) / determinant
            nearer = False
            for _ in range(MOST_HALVINGS):
                new_x, new_y = x + step_x, y + step_y
                if new_x * new_x + new_y * new_y < limit * limit:
                    at_x, at_y, new_xx, new_xy, new_yy = distort(new_x, new_y, c)
                    miss_x, miss_y = goal_x - at_x, goal_y - at_y
                    new_miss = (c[0] * miss_x) ** 2 + (c[1] * miss_y) ** 2
                    if new_miss < miss:
                        nearer = True
                        break
                step_x *= 0.5
                step_y *= 0.5
            if not nearer:
                break
            x, y, xx, xy, yy, miss = new_x, new_y, new_xx, new_xy, new_yy, new_miss
        if miss <= ACCEPTED_PX**2:
            points[i, 0] = x
            points[i, 1] = y


@kernel
def magnify_points(points: Array, c: Array, limit: float, out: Array) -> None:
    """Compute the largest singular value of d normalized / d pixel at points (n, 2), into out."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        out[i] = np.nan
        if abs(x) < limit and abs(y) < limit and x * x + y * y < limit * limit:
            _, _, xx, xy, yy = distort(x, y, c)
            a, b, e, d = c[0] * xx, c[0] * xy, c[1] * xy, c[1] * yy
            largest = 0.5 * (math.hypot(a + d, e - b) + math.hypot(a - d, e + b))
            out[i] = largest / abs(a * d - b * e)
