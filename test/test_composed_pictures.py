"""Pictures composed on photographs: their truth, and what the tracker makes of some of them."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
import pytest

pytest.importorskip('skimage', reason='the photographs of scikit-image')
pytest.importorskip('sklearn', reason='the photographs of scikit-learn')

from support.composed_pictures import Composer, Composition, HEIGHT, photograph, PHOTOGRAPHS, WIDTH


@pytest.fixture(scope='module')
def arm():
    return load_model(share_path('config/paper_arm.yaml'))


@pytest.mark.parametrize('name', PHOTOGRAPHS)
def test_a_photograph_fills_the_picture(name):
    assert photograph(name).shape == (HEIGHT, WIDTH, 3)


def test_dots_are_where_the_truth_says():
    frame = Composer(Composition(photograph='brick', polarity='bright', noise=0.0)).frame(20)
    grey = frame.picture.mean(axis=2)
    for u, v in np.column_stack([frame.u, frame.v])[:-1].tolist():
        left, top = round(u) - 8, round(v) - 8
        patch = np.maximum(grey[top : top + 17, left : left + 17] - 90.0, 0.0)
        rows, columns = np.mgrid[top : top + 17, left : left + 17]
        assert (patch * columns).sum() / patch.sum() == pytest.approx(u, abs=0.05)
        assert (patch * rows).sum() / patch.sum() == pytest.approx(v, abs=0.05)


def test_the_last_dot_is_cut_by_the_end_of_the_body():
    share = math.acos(0.8) - 0.8 * math.sqrt(1.0 - 0.8**2)  # of a circle's segment, of pi
    frame = Composer(Composition(photograph='china', polarity='dark')).frame(0)
    assert frame.visible[-1] == pytest.approx(1.0 - share / math.pi, abs=2e-3)
    assert frame.visible[:-1] == pytest.approx(1.0, abs=2e-3)


def test_a_hand_hides_targets():
    hand = Composition(photograph='coffee', polarity='dark', disturbances=frozenset({'hand'}))
    hidden = [Composer(hand).frame(number).visible < 0.5 for number in (5, 31)]
    assert not hidden[0].any()
    assert hidden[1].any()
    assert not hidden[1].all()


def test_the_same_number_gives_the_same_frame():
    composition = Composition(photograph='grass', polarity='dark')
    first, again = (Composer(composition).frame(13) for _ in range(2))
    assert np.array_equal(first.picture, again.picture)
    assert np.array_equal(first.u, again.u)
