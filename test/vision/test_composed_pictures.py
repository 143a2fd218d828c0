"""Pictures composed on photographs: their truth, and what the tracker makes of some of them."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
import math

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.readings import unseen_targets
from pneunet_ros.core.share import share_path
from pneunet_ros.vision.tracker import Tracking
import pytest

pytest.importorskip('skimage', reason='the photographs of scikit-image')
pytest.importorskip('sklearn', reason='the photographs of scikit-learn')

from support.composed_pictures import Composer, Composition, HEIGHT, photograph, PHOTOGRAPHS, WIDTH
from support.tracked_films import Score, score_film, track_film


@pytest.fixture(scope='module')
def arm():
    return load_model(share_path('config/paper_arm.yaml'))


@pytest.mark.parametrize('name', PHOTOGRAPHS)
def test_a_photograph_fills_the_picture(name):
    assert photograph(name).shape == (HEIGHT, WIDTH, 3)


def test_few_dots_stand_out_of_the_rows_of_printed_text(arm):
    """Letters stand in a hundred rows of seven at rest; no row of them is as regular."""
    few = Composition(
        photograph='page',
        polarity='bright',
        targets=7,
        spacing=139.0,
        radius=6.5,
        overhang=1.6,
        frames=9,
    )
    score = score_film(few, arm)
    assert (score.reasons.total(), score.false, score.swapped) == (0, 0, 0)
    assert score.found == score.visible == 7 * 5


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


@pytest.mark.parametrize(
    ('name', 'polarity', 'disturbances'),
    [
        ('gravel', 'bright', ()),
        ('china', 'dark', ('jpeg', 'flicker')),
        ('china', 'bright', ('uneven',)),
    ],
)
def test_the_arm_is_tracked_before_a_photograph(arm, name, polarity, disturbances):
    """Five frames of rest, then it moves; acceptance/composed_pictures.py looks at many more."""
    composition = Composition(
        photograph=name, polarity=polarity, disturbances=frozenset(disturbances), begin=3, frames=9
    )
    numbers = score_film(composition, arm).numbers()
    assert (numbers['resting'], numbers['unexplained']) == (4, 0)
    assert numbers['found_share'] == numbers['tip_found_share'] == 1.0
    assert numbers['false'] == numbers['swapped'] == 0
    assert numbers['rms_px'] < 0.1
    assert 0.7 < numbers['normalized'] < 1.5


def test_a_tip_in_blur_is_found_from_neighbors_that_were_found_in_part(arm):
    """The fastest frame of this film in which it is: no other fit begins near enough."""
    composition = Composition(
        photograph='china', polarity='bright', disturbances=frozenset({'blur'}), frames=60
    )
    *_, (frame, tracking, _) = islice(track_film(composition, arm), 16)
    off = np.hypot(tracking.sightings.u - frame.u, tracking.sightings.v - frame.v)
    assert off.max() < 2.0  # px: a radius is 5, its way 17


def test_a_score_tells_what_is_lost_false_and_swapped():
    frame = Composer(Composition(photograph='brick', polarity='bright')).frame(0)
    seen = unseen_targets(1, 23)
    u, v, std = frame.u.copy(), frame.v.copy(), np.full(23, 1e-5)
    u[3] = np.nan  # lost
    u[5] += 5.0  # false
    u[[7, 8]] = u[[8, 7]]  # swapped
    score = Score()
    tracking = Tracking(sightings=replace(seen, u=u, v=v, std=std), curve=None)
    score.count(tracking, frame, 1e-4)
    numbers = score.numbers()
    assert (score.visible, score.found, score.false, score.swapped) == (23, 22, 3, 2)
    assert numbers['tip_found_share'] == 1.0
    assert numbers['tip_rms_px'] == 0.0
