"""Drawn dots with a known center, and how well any method at all could find that center.

Shares no code with the package: dots are drawn by dense supersampling.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

FINE = 8  # samples per pixel and axis


def draw_dot(
    shape,
    center,
    radius,
    *,
    amplitude=160.0,
    background=40.0,
    blur=0.0,
    aspect=1.0,
    angle=0.0,
    streak=0.0,
    slope=(0.0, 0.0),
):
    """Return a picture (rows, columns) with one bright dot on a dark background, as floats.

    center (u, v), or several (n, 2) for where it was during the exposure, and radius in px;
    `aspect` shrinks the dot across `angle` (rad); `blur` is the standard deviation of a
    Gaussian, px; `streak` the length of motion along u, px; `slope` of the background, grey levels
    per px.
    """
    rows, columns = shape
    fine = np.zeros((rows * FINE, columns * FINE))
    centers = np.atleast_2d(center)
    for at in centers:
        u = (np.arange(columns * FINE) + 0.5) / FINE - 0.5 - at[0]
        v = ((np.arange(rows * FINE) + 0.5) / FINE - 0.5 - at[1])[:, None]
        along = u * np.cos(angle) + v * np.sin(angle)
        across = (v * np.cos(angle) - u * np.sin(angle)) / aspect
        edge = 0.5 + (radius - np.hypot(along, across)) * FINE
        fine += np.clip(edge, 0.0, 1.0) / len(centers)
    if streak:
        steps = round(streak * FINE / 2)
        padded = np.pad(fine, ((0, 0), (steps, steps)))
        total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
        fine = (total[:, 2 * steps + 1 :] - total[:, : -2 * steps - 1]) / (2 * steps + 1)
    if blur:
        fine = gaussian_filter(fine, blur * FINE)
    coverage = fine.reshape(rows, FINE, columns, FINE).mean((1, 3))
    middle = centers.mean(axis=0)
    light = background + slope[0] * (np.arange(columns) - middle[0])
    light = light + slope[1] * (np.arange(rows)[:, None] - middle[1])
    return light + amplitude * coverage


def center_bound(radius, noise, *, amplitude=160.0, background=40.0, blur=0.0):
    """Return the Cramér-Rao bound of the center of a dot, px per axis (root mean square of both).

    The unknowns are center, radius, amplitude and background; shape and blur are known. `noise` is
    the standard deviation of a pixel in grey levels. The bound is the mean over places of the
    center within a pixel.
    """
    # Rounding adds to the noise.
    variance = noise**2 + 1.0 / 12.0
    return variance**0.5 * bound_per_noise(radius, amplitude, background, blur)


@cache
def bound_per_noise(radius, amplitude, background, blur):
    """Return the bound for a noise of one grey level."""
    size = int(2 * (radius + 3 * blur) + 8)
    step = 0.05

    def picture(u, v, radius, amplitude, background):
        return draw_dot(
            (size, size),
            (size // 2 + u, size // 2 + v),
            radius,
            amplitude=amplitude,
            background=background,
            blur=blur,
        )

    variances = []
    for u, v in ((0.0, 0.25), (0.5, 0.4)):
        parameters = np.array([u, v, radius, amplitude, background])
        derivatives = []
        for change in np.eye(5) * [step, step, step, 1.0, 1.0]:
            difference = picture(*(parameters + change)) - picture(*(parameters - change))
            derivatives.append(difference.ravel() / (2.0 * change.sum()))
        information = np.array(derivatives) @ np.array(derivatives).T
        variances.append(np.linalg.inv(information).diagonal()[:2].mean())
    return float(np.sqrt(np.mean(variances)))
