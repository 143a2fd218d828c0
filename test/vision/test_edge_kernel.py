"""The sums over the pixels of ellipses."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.vision.dots import edge_kernel
from pneunet_ros.vision.dots.ellipse_fit import MOMENTS
import pytest
from scipy.special import ndtr


def test_the_normal_distribution_is_exact():
    x = np.concatenate([np.linspace(-9.0, 9.0, 400), [-8.0, 8.0, 1.0 / 128.0]])
    above, density = np.transpose([edge_kernel.normal_at(it) for it in x])
    assert above == pytest.approx(ndtr(-x), abs=1e-12)
    assert density == pytest.approx(np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi), abs=1e-11)


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
