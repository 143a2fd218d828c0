"""What is printed of left-out pressures of an arm that lengthens, beside interpolation."""

from __future__ import annotations

from types import SimpleNamespace

import left_out_real as bench
import numpy as np
from pneunet_ros.calibration.checks.left_out_levels import LeftOutLevels
from test_real_data_diagnosis import made


def test_the_model_of_an_arm_that_lengthens_does_no_worse_than_interpolation():
    (row,) = bench.measured([made(0.2)], bench.NOISE, diagnosed=False)
    assert row['answered']
    assert row['model'] < bench.AS_WELL * row['interpolation']
    assert row['model'] < 0.1 * row['arc']


def test_a_model_that_a_baseline_beats_is_an_answer_only_if_a_note_says_so():
    found = LeftOutLevels(levels=4, model=2e-3, arc=3e-3, interpolation=1e-3, changed=1.0,
                          excess=np.zeros((1, 4)), is_angle=False)  # fmt: skip
    silent, said, nothing = (
        bench.row_of(SimpleNamespace(left_out=left_out, notes=notes), 1.0)
        for left_out, notes in ((found, ()), (found, (found.sentence,)), (None, ()))
    )
    assert [row['answered'] for row in (silent, said, nothing)] == [False, True, False]
    assert bench.count_sentence([silent, said, nothing]).startswith('1 of 3 answered; in 2 a')
