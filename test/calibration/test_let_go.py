"""Where an arm that was plucked is let go: behind its last large swing."""

from __future__ import annotations

import numpy as np
from pneunet_ros.calibration.motion.swinging_run import crop_to_release, SwingingRun
from pneunet_ros.core.errors import RequestError
import pytest
from support.refusals import refused


def plucked(away: list[float]) -> SwingingRun:
    """Return a plucked recording with a frame a reading, whose one target is so far away (m)."""
    count = len(away)
    points = np.zeros((count, 2, 1))
    points[:, :, 0] = np.column_stack([away, away])
    return SwingingRun(
        name='plucked',
        stamp_ns=np.arange(count) * 10_000_000,
        solved=(np.zeros((count, 1)),) * 3,
        equilibrium=np.zeros((count, 2, 1)),
        reading=np.arange(count),
        points=points,
        theta_and_curvature=np.zeros((count, 2, 1)),
        plucked=True,
    )


def test_it_begins_behind_the_last_large_swing_though_frames_miss_all_targets():
    run = crop_to_release(plucked([0.01, 0.01, np.nan, 0.002, 0.001]))
    assert run.reading.tolist() == [0, 1, 2]
    assert run.stamp_ns[0] == 20_000_000


@pytest.mark.parametrize('away', [[], [0.01], [np.nan, 0.01, np.nan]])
def test_a_pluck_that_no_two_frames_show_is_refused(away):
    with refused(RequestError, 'too_few_frames'):
        crop_to_release(plucked(away))
