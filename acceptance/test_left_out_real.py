"""What is printed of left-out pressures of an arm that lengthens, beside interpolation."""

from __future__ import annotations

import left_out_real as bench
from test_real_data_diagnosis import made


def test_interpolation_is_said_to_do_better_where_the_arm_lengthens():
    (row,) = bench.measured([made(0.2)], bench.NOISE, diagnosed=False)
    assert row['says'] == 'interpolation'
    assert row['answered']
    assert row['model'] > 5.0 * row['interpolation']
