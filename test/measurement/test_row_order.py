"""Targets numbered from the wrong end, and clamps that move, are noticed."""

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks.preconditions import check_runs, describe_clamp
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.measurement.row_order import clamp_motion, end_turns, numbered_from_tip
import pytest
from support.example_arms import paper_arm
from support.made_datasets import experiments, USUAL
from support.refusals import refused

PAPER = paper_arm()
FREE, LOADED = experiments(PAPER, USUAL, frames=30)


def arcs(curvatures, arclength):
    """Return points (frames, 2, targets) of arcs that begin along x at the origin."""
    angle = curvatures[:, None] * arclength
    return np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1) / curvatures[:, None, None]


def from_tip(points):
    """Return points numbered from the free end, in the frame of that end in the first frame."""
    turned = points[:, :, ::-1]
    return turned * np.array([-1.0, 1.0])[:, None] - np.array([-turned[0, 0, 0], 0.0])[:, None]


def riding(points):
    """Shift every frame so that its first target lies in the origin."""
    return points - points[:, :, :1]


@pytest.mark.parametrize('targets', [4, 5, 12, 23])
@pytest.mark.parametrize('shifted', [False, True])
def test_an_arc_from_the_wrong_end_is_noticed(targets, shifted):
    """An arc turns by its whole bend at one end; the other way round it is not noticed."""
    arclength = np.linspace(0.0, 0.1, targets)
    points = arcs(np.linspace(0.1, 15.0, 20), arclength)
    rng = np.random.default_rng(0)
    points = points + rng.normal(0.0, 1e-4, points.shape)
    wrong = from_tip(points)
    if shifted:
        points, wrong = riding(points), riding(wrong)
    assert numbered_from_tip(wrong, arclength)
    assert not numbered_from_tip(points, arclength)


def test_the_turn_of_the_ends_is_that_of_the_arc():
    """The chord of the first tenth of an arc turns by a twentieth of its bend."""
    arclength = np.linspace(0.0, 0.1, 21)
    points = arcs(np.linspace(0.1, 10.1, 201), arclength)
    first, last = end_turns(points, arclength)
    assert first == pytest.approx(0.9 * 10.0 * 0.1 * 0.05, rel=1e-3)
    assert last == pytest.approx(0.9 * 10.0 * 0.1 * 0.95, rel=1e-3)


def test_what_hardly_bends_or_is_hardly_seen_is_not_judged():
    """A straight arm has no wrong end, and neither have three frames."""
    arclength = np.linspace(0.0, 0.1, 9)
    straight = arcs(np.linspace(0.01, 0.5, 20), arclength)
    assert not numbered_from_tip(from_tip(straight), arclength)
    assert not numbered_from_tip(from_tip(arcs(np.array([0.1, 5.0, 15.0]), arclength)), arclength)


def backwards(run):
    """Return a recording with targets numbered from the free end."""
    points = from_tip(run.points)
    return replace(run, x=points[:, 0], y=points[:, 1])


def moved(run, by):
    """Let the whole arm move along y with the pressure, by so many m at the highest."""
    share = run.frame_pressure / max(float(np.max(run.frame_pressure)), 1.0)
    return replace(run, y=run.y + by * share[:, None])


def test_recordings_from_the_wrong_end_are_refused():
    """The sentence names the recording and the way out; loaded ones likewise."""
    with refused(RecordingError, 'wrong_end'):
        check_runs([backwards(FREE[0]), *FREE[1:]], [], PAPER)
    with refused(RecordingError, 'wrong_end'):
        check_runs(FREE, [backwards(LOADED[0]), LOADED[1]], PAPER)


def test_a_clamp_that_moves_is_refused_or_named():
    """8 mm are refused, 1 mm is said, and 0.2 mm is what a camera does."""
    with refused(RecordingError, 'clamp_moves'):
        check_runs([moved(FREE[0], 8e-3)], [], PAPER)
    (sentence,) = describe_clamp([moved(FREE[0], 1e-3), FREE[1]], PAPER)
    assert FREE[0].name in sentence and FREE[1].name not in sentence
    assert describe_clamp([moved(FREE[0], 2e-4), *FREE[1:]], PAPER) == ()


def test_motion_that_does_not_go_with_the_pressure_is_the_cameras():
    """Drift back and forth while the pressure rises is none of the clamp."""
    arclength, pressure = np.linspace(0.0, 0.1, 9), np.linspace(0.0, 5e4, 200)
    points = arcs(np.linspace(0.1, 10.0, 200), arclength)
    swinging = points + 2e-3 * np.sin(np.linspace(0.0, 25.0, 200))[:, None, None]
    assert clamp_motion(swinging, pressure, arclength, 0.1) == 0.0
    going = points + 2e-3 * np.array([0.0, 1.0])[:, None] * (pressure / 5e4)[:, None, None]
    assert clamp_motion(going, pressure, arclength, 0.1) == pytest.approx(2e-3, rel=1e-6)


def test_targets_that_begin_far_from_the_clamp_say_nothing_of_their_order():
    """The first of them turns as the last one of an arm that is held there."""
    arclength = np.linspace(0.0, 0.1, 11)
    angles = np.linspace(0.0, 0.6, 30)[:, None] * np.linspace(1.0, 0.1, 11)
    points = np.stack([arclength * np.cos(angles), arclength * np.sin(angles)], axis=1)
    assert end_turns(points, arclength) is not None
    points[:, :, :4] = np.nan
    assert end_turns(points, arclength) is None
