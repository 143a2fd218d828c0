"""How a row moves on from one frame to the next."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.dots.centroid import AREA, COLUMNS, EXACT, MAJOR, MINOR, SEEN, STD, U, V
from pneunet_ros.vision.rows.row import ObservedRow, TrackedRow
from pneunet_ros.vision.rows.row_motion import next_row, velocity_along_row
from pneunet_ros.vision.settings import VISION
import pytest

ARCLENGTH = np.linspace(0.0, 0.11, 12)
TURNING = np.column_stack([-3.0 * ARCLENGTH, 40.0 * ARCLENGTH])  # px/s, of a row that turns


@pytest.mark.parametrize('known', [slice(0, 7), slice(4, 12), slice(0, 12, 2), slice(3, 10)])
def test_targets_that_are_not_seen_move_as_the_row_turns(known):
    seen = np.zeros(12, np.bool_)
    seen[known] = True
    velocity = velocity_along_row(TURNING[seen], ARCLENGTH, seen, neighbors=6)
    np.testing.assert_allclose(velocity, TURNING, atol=1e-12)


def test_few_targets_do_not_tell_how_the_row_turns():
    seen = np.zeros(12, np.bool_)
    seen[[2, 4, 5]] = True
    velocity = velocity_along_row(TURNING[seen], ARCLENGTH, seen, neighbors=6)
    np.testing.assert_allclose(velocity[6:], np.tile(TURNING[5], (6, 1)))
    np.testing.assert_allclose(velocity[:2], np.tile(TURNING[2], (2, 1)))


@pytest.mark.parametrize(('area', 'shown'), [(75.0, False), (84.0, True)])
def test_a_target_that_gets_smaller_does_not_show_its_own_size(area, shown):
    table = np.zeros((12, COLUMNS))
    table[:, U], table[:, V] = 40.0 * np.arange(12), 100.0
    table[:, AREA], table[:, [MAJOR, MINOR]] = 80.0, 10.0
    table[:, [SEEN, EXACT]], table[:, STD] = 1.0, 0.02
    last = TrackedRow(
        stamp_ns=1, pixels=table[:, :2].copy(), velocity=np.zeros((12, 2)),
        velocity_std=np.full(12, 1.0), area=table[:, AREA].copy(), table=table.copy(),
        seen=np.ones(12, np.bool_), sized=np.arange(12) < 11, spacing=40.0, exposure=0.0,
    )  # fmt: skip
    table[-1, AREA] = area
    row = ObservedRow(
        table=table, points=1e-4 * table[:, :2], std=np.full(12, 2e-6), seen=12, causes=('',) * 12
    )
    view = SimpleNamespace(
        arclength=ARCLENGTH,
        vision=VISION,
        settings=CameraSettings(),
        image=SimpleNamespace(stamp_ns=33_333_334),
    )
    now = next_row(view, row, last)
    assert bool(now.sized[-1]) is shown
    assert bool(now.area[-1] == area) is shown
