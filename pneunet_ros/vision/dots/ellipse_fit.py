"""Fit ellipses to the edges of blobs, pixel by pixel: the computations of `centroid`."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
import functools
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.settings import numbers_type, tuning
from pneunet_ros.vision.dots.outline_kernel import fit_outlines

Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# An ellipse, before and after the fit: center u, v px; symmetric axes (xx, xy, yy) px, which map
# the unit circle to it; blur px of its edge where it does not move; its motion during the
# exposure, px (of unknown sign, because an image does not show it); grey levels of plateau and
# background.
CENTER_U, CENTER_V, AXIS_XX, AXIS_XY, AXIS_YY, WIDTH, SMEAR_U, SMEAR_V = range(8)
PLATEAU, BEHIND = 8, 9
# Only before: one sigma of shape (of its radius), blur and motion (px), plateau and size (of its
# radius); infinite for an unknown plateau.
SHAPE_STD, WIDTH_STD, SMEAR_STD, PLATEAU_STD, SIZE_STD = range(10, 15)
# Only after: std of the center px; share of the visible edge near the ellipse, and share of the
# whole edge exactly on it; share of the inside that is as bright as modeled; share of the whole
# edge clearly outside of the ellipse.
ERROR, NEAR_EDGE, ON_EDGE, WITHIN, OUTSIDE = range(10, 15)
FITTED = 15

# Number of averaged instants of an exposure, and motion (px) from which they are used. The error
# of the coverage of a pixel is then below 0.2 %, up to a motion of 20 px with edges blurred by 0.9
# px.
MOMENTS = ((2, 0.5), (3, 1.3), (5, 3.2), (9, 6.5), (13, 13.0))
QUANTIZATION = 1.0 / 12.0  # variance of a grey level that has been rounded
SIGMA = 1.4826  # standard deviation over the median absolute deviation, for Gaussian noise


@dataclass(frozen=True, slots=True, kw_only=True)
class EllipseSettings:
    """Settings of the ellipse fit to the edge of a blob."""

    sectors: int = tuning(
        16,
        'number of sectors around a blob, each with its own background and edge',
        source='sweep',
    )
    passes: int = tuning(8, 'largest number of iterations', source='sweep')
    done: float = tuning(
        0.003, 'step of the center at which the fit ends', unit='px', source='sweep'
    )
    largest_change: float = tuning(
        0.25, 'largest change of size and shape per iteration', unit='radius', source='sweep'
    )
    widest_step: float = tuning(
        0.3, 'largest change of the blur per iteration', unit='px', source='sweep'
    )
    least_off: float = tuning(
        0.02, 'usual distance of edges from the outline', unit='px', source='sweep'
    )
    around: float = tuning(
        3.0,
        'width of the pixels used on either side of an edge',
        unit='blur',
        source='convention: three sigma',
    )
    shift: float = tuning(
        1.5,
        'largest initial offset of an edge, and largest change of center and motion per iteration',
        unit='px',
        source=('sweep'),
    )
    tilt_std: float = tuning(
        0.015, 'slope of the light over a blob', unit='contrast / radius', source=('sweep')
    )
    plateau_share: float = tuning(
        0.3,
        'share of the pixels inside that are brighter than the first plateau',
        source=('sweep'),
    )
    cut: float = tuning(
        2.5,
        'distance from the outline above which an edge is excluded',
        unit='usual distance',
        source='sweep',
    )
    knows: float = tuning(
        0.3, 'largest position error of an informative edge', unit='px', source=('sweep')
    )
    on_edge: float = tuning(
        0.03, 'largest distance of an edge on the outline', unit='px', source='sweep'
    )
    on_edge_share: float = tuning(
        0.006,
        'lower limit of on_edge',
        unit='radius',
        source='measured: 15 px, edges blurred by 2 px',
    )
    near_edge: float = tuning(
        0.12, 'largest distance of an edge near the outline', unit='px', source='sweep'
    )
    near_edge_share: float = tuning(0.02, 'addition to near_edge', unit='radius', source='sweep')
    uneven: float = tuning(
        0.7,
        'of what is on either side of an edge, not explained',
        unit='grey level',
        source='measured',
    )
    smear_error: float = tuning(
        0.003,
        'error of the center due to backgrounds that move along',
        unit='way^2 / radius',
        source='measured',
    )


EllipseNumbers = numbers_type(EllipseSettings, 'EllipseNumbers')
ELLIPSE = EllipseSettings()


def for_colors(settings: EllipseSettings) -> EllipseSettings:
    """Return settings for images compared by color, which is stored at half resolution.

    Measured with JPEG 4:2:0, quality 85, dots of 12 and 16 px: errors of edges up to 0.25 px, of
    centers 0.06 px rms, 12 grey levels of an edge of 200.
    """
    return replace(settings, on_edge=0.25, near_edge=0.4, uneven=12.0)


@functools.lru_cache
def ellipse_numbers(settings: EllipseSettings) -> Any:
    """Return settings in the form that kernels take."""
    return EllipseNumbers(*astuple(settings))


def fit_ellipses(grey: Bytes, starts: Array, settings: EllipseSettings = ELLIPSE) -> Array:
    """Fit ellipses from initial guesses, (n, FITTED); NaN if a fit fails.

    starts (n, FITTED): centers, axes, blur, and their uncertainties.
    """
    fitted = np.full_like(starts, np.nan)
    if not len(starts):
        return fitted
    rules = QUANTIZATION, SIGMA
    fit_outlines(grey, starts, _moments(starts), ellipse_numbers(settings), rules, fitted)
    return fitted


def _moments(starts: Array) -> Integers:
    """Return the number of moments of an exposure per ellipse, (n,)."""
    smear, moments = _smear(starts), np.ones(len(starts), np.int64)
    for many, least in MOMENTS:
        moments[smear >= least] = many
    return moments


def _smear(ellipses: Array) -> Array:
    """Return the motion of ellipses (n, FITTED) during the exposure, px (n,)."""
    return np.asarray(np.hypot(ellipses[:, SMEAR_U], ellipses[:, SMEAR_V]))
