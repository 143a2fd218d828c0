"""Few frames of clamp and tip are enough to calibrate from, and to see that an arm lengthens."""

from __future__ import annotations

import few_frames as bench
import numpy as np
import pytest
from test_real_data_diagnosis import made


@pytest.mark.parametrize('count', [3, 6])
def test_made_tips_are_calibrated_and_left_out_ones_predicted(count):
    found = bench.tried(made(0.2), count, bench.NOISE)
    assert (found.converged, found.constant) == (True, True)
    assert found.right
    assert found.calibrated < 1.0
    assert found.diagnosed < 1.2  # of noisy tips
    (row,) = bench.summary([found])
    assert (row['frames'], row['converged'], row['right']) == (count, 1, 1)


def test_the_frames_are_spread_over_the_pressures():
    assert bench.chosen_rows(made(0.2), 4).tolist() == [0, 3, 5, 8]
    assert np.array_equal(bench.chosen_rows(made(0.2), 9), np.arange(9))
