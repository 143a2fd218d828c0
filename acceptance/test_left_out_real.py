"""What is printed of left-out pressures of an arm that lengthens, beside interpolation."""

from __future__ import annotations

import left_out_real as bench
from test_real_data_diagnosis import made


def test_the_model_of_an_arm_that_lengthens_does_no_worse_than_interpolation():
    (row,) = bench.measured([made(0.2)], bench.NOISE, diagnosed=False)
    assert row['answered']
    assert row['model'] < bench.AS_WELL * row['interpolation']
    assert row['model'] < 0.1 * row['arc']
