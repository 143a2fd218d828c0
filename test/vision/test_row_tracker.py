"""How a row moves on from one frame to the next."""

from __future__ import annotations

import numpy as np
from pneunet_ros.vision.rows.row_motion import velocity_along_row
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
