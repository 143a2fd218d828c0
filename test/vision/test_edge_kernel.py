"""The compiled sums over the pixels of ellipses: the same as those in numpy, and as the truth."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.kernels import jit
from pneunet_ros.vision.dots import edge_kernel
from pneunet_ros.vision.dots.centroid import outlines
from pneunet_ros.vision.dots.ellipse_fit import fit_ellipses, MOMENTS
import pytest
from scipy.special import ndtr
from support.center_bound import draw_dot


def test_the_normal_distribution_is_exact():
    x = np.concatenate([np.linspace(-9.0, 9.0, 400), [-8.0, 8.0, 1.0 / 128.0]])
    above, density = np.transpose([edge_kernel.normal_at(it) for it in x])
    assert above == pytest.approx(ndtr(-x), abs=1e-12)
    assert density == pytest.approx(np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi), abs=1e-11)


@pytest.mark.parametrize(
    ('way', 'radius'),
    [
        ((0.0, 0.0), 5.0),
        ((1.0, 0.3), 5.0),
        ((-2.0, 1.5), 5.0),
        ((0.0, 5.0), 5.0),
        ((8.0, -4.0), 5.0),
        ((0.0, 0.0), 25.0),  # of more pixels than numpy multiplies at once
    ],
)
def test_compiled_and_numpy_fits_are_the_same(way, radius, monkeypatch):
    random = np.random.default_rng(2)
    middle = 4.0 * radius
    side = round(2.0 * middle) + 1
    near = (middle + 0.3, middle - 0.2)
    dot = draw_dot((side, side), near, radius, blur=0.8, streak=abs(way[0]))
    other = draw_dot((side, side), (middle, middle), 4.0, blur=0.8)
    dots = np.concatenate([dot, other], axis=1)
    grey = np.clip(dots + 3.0 * random.standard_normal(dots.shape), 0, 255).astype(np.uint8)
    grey.flags.writeable = False  # as that of an image
    one = np.ones(2)
    starts = outlines(
        np.array([[middle, middle], [middle + side, middle]]),
        np.array([[radius - 0.2, 0.1, radius - 0.1], [4.1, 0.0, 4.0]]),
        0.9 * one,
        np.array([way, (0.0, 0.0)]),
        (0.3 * one, 0.3, one),
    )
    fitted = []
    for compiled in (True, False):
        monkeypatch.setattr(jit, 'is_compiled', lambda it=compiled: it)
        fitted.append(fit_ellipses(grey, starts))
    assert np.isfinite(fitted[0]).all()
    assert fitted[0] == pytest.approx(fitted[1], abs=1e-9)


def test_few_moments_of_an_exposure_are_as_good_as_all():
    """Where edges are blurred by 0.9 px, of all ways that these moments are taken for."""
    place, all_times = np.linspace(-16.0, 16.0, 201)[:, None], (np.arange(2000) + 0.5) / 2000 - 0.5
    ways = [least for _, least in MOMENTS[1:]] + [20.0]
    for (moments, _), way in zip(MOMENTS, ways, strict=True):
        times = edge_kernel.TIMES[moments, :moments]
        parts = edge_kernel.PARTS[moments, :moments]
        some = ndtr((place - way * times) / 0.9) @ parts
        exact = ndtr((place - way * all_times) / 0.9).mean(axis=1)
        assert np.abs(some - exact).max() < 0.0021
