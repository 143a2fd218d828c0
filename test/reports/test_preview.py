"""Pictures of tracking: drawn whatever came, without a warning, and not in vain."""

from __future__ import annotations

from pathlib import Path

from matplotlib.image import imread
import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.reports.tracking.preview import (
    CURVES,
    heat,
    overlay_of,
    PICTURES,
    Preview,
    thin,
    write_at_end,
)
from pneunet_ros.vision.tracker import Tracker, Tracking
import pytest
from support.films import ARM, FRAMES, PERIOD_NS, tracked_steps

TRACKER = Tracker(ARM, load_camera(share_path('config/camera.yaml')))
TARGETS = ARM.target_arclength.size


@pytest.fixture(scope='module')
def steps(tmp_path_factory):
    """List the steps of frames in which the arm rests, bends, and is hidden for a while."""
    return tracked_steps(tmp_path_factory.mktemp('film') / 'in.mcap', TRACKER)


def fill(preview, steps, *, period_ns: int = PERIOD_NS, readable: bool = True) -> None:
    for index, step in enumerate(steps):
        image = step.item.reading if readable else None
        tracking = step.outcome if readable else None
        preview.add(1 + index * period_ns, image, tracking, step.state)


def drawn(path, steps, **options):
    preview = Preview(frames=len(steps), targets=TARGETS)
    with write_at_end(path, preview, lambda place: preview.draw(place, 'a title')):
        fill(preview, steps, **options)
    return imread(path)[..., :3]


def test_the_picture_shows_what_was_seen(steps, tmp_path):
    picture = drawn(tmp_path / 'p.PNG', steps)
    assert min(picture.shape[:2]) > 1200
    assert (picture < 0.9).any(axis=2).mean() > 0.05  # it is not empty
    other = drawn(tmp_path / 'other.png', [*steps[:6], steps[7], *steps[7:]])
    assert picture.shape == other.shape
    assert (picture != other).any()


@pytest.mark.parametrize(
    ('count', 'options'),
    [(0, {}), (1, {}), (FRAMES, {'readable': False}), (FRAMES, {'period_ns': 0})],
    ids=['none', 'one-at-rest', 'unreadable', 'of-one-time'],
)
def test_little_is_drawn_too(steps, tmp_path, count, options):
    assert drawn(tmp_path / 'p.png', steps[:count], **options).size


def test_after_an_exception_there_is_no_picture(tmp_path):
    with pytest.raises(KeyboardInterrupt), write_at_end(tmp_path / 'p.png', None, Path.touch):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_shown_are_the_first_explained_frame_of_every_quarter_and_the_last(steps):
    preview = Preview(frames=len(steps), targets=TARGETS)
    fill(preview, steps)
    shown = [seen.log_time_ns // PERIOD_NS for seen in preview.shown()]
    assert [bool(steps[index].outcome.reason) for index in range(7)] == 4 * [1] + [0, 0, 1]
    assert shown == [0, 4, 7, 9, 11]  # in the first quarter all rest, and one is dark in the third


def test_where_nothing_was_explained_the_frames_say_why(steps):
    preview = Preview(frames=10, targets=TARGETS)
    fill(preview, 10 * [steps[0]])
    assert len(preview.shown()) == PICTURES
    assert preview.shown()[-1].log_time_ns == 1 + 9 * PERIOD_NS


def test_a_long_recording_keeps_few_images_and_curves(steps):
    preview = Preview(frames=1000, targets=TARGETS)
    fill(preview, 1000 * [steps[-1]])
    assert len(preview.shown()) == PICTURES
    times = [time for time, _ in preview.curves()]
    assert CURVES / 2 <= len(times) <= CURVES
    assert len(set(np.diff(times))) == 1  # evenly over time
    assert times[-1] > 900 * PERIOD_NS


def test_the_heat_map_has_edges_between_frames_and_gaps_where_there_are_none():
    status = np.array([[1.0, 0.0], [1.0, 1.0], [-1.0, -1.0], [0.0, 1.0]])
    edges, shares = heat(np.array([0.0, 1.0, 2.0, 9.0]), status)
    assert edges.tolist() == [0.0, 1.0, 2.0, 3.0, 9.0, 10.0]
    np.testing.assert_array_equal(
        shares, [[1.0, 0.0], [1.0, 1.0], [-1.0, -1.0], [np.nan, np.nan], [0.0, 1.0]]
    )


def test_frames_share_a_column_where_there_are_many():
    status = np.ones((1200, 2))
    status[0, 1] = 0.0
    status[2:4] = -1.0
    status[4] = -1.0
    edges, shares = heat(np.arange(1200.0), status)
    assert (len(edges), len(shares)) == (601, 600)
    assert shares[:3].tolist() == [[1.0, 0.5], [-1.0, -1.0], [1.0, 1.0]]


def test_things_are_spread_from_first_to_last():
    assert thin(0, 8) == []
    assert thin(1, 8) == [0]
    assert thin(3, 8) == [0, 1, 2]
    assert thin(100, 3) == [0, 50, 99]


def test_the_curve_is_in_the_overlay(steps):
    step = steps[-1]
    with_curve = overlay_of(step.item.reading, step.outcome, step.state)
    without = overlay_of(
        step.item.reading, Tracking(sightings=step.outcome.sightings, curve=None), step.state
    )
    changed = np.argwhere((with_curve != without).any(axis=2))
    u, v = step.outcome.sightings.u, step.outcome.sightings.v
    low, high = changed.min(axis=0), changed.max(axis=0)
    assert np.abs(low - [v.min(), u.min()]).max() < 6
    assert np.abs(high - [v.max(), u.max()]).max() < 6
