"""A film is made, tracked, and its hidden delay found within the error; the sums are right."""

from __future__ import annotations

from dataclasses import replace

import film_delay as bench
import pytest


@pytest.mark.slow
def test_a_film_tells_its_delay(tmp_path):
    trial = bench.try_film(1, tmp_path)
    assert not trial.trouble
    assert abs(trial.deviation) < 3.0
    assert trial.share < 0.3


def test_the_summary_counts_what_was_found():
    good = bench.Trial(
        seed=1,
        frame_rate=25.0,
        reading_rate=100.0,
        effects=(),
        true=1.0,
        found=1.003,
        std=0.002,
        trouble='',
    )
    wrong, refused = replace(good, found=1.01), replace(good, trouble='the arm does not move')
    found = bench.summary([good, wrong, refused])
    assert (found['films'], found['refused'], found['within_two_sigma']) == (3, 1, 1)
    assert found['largest_deviation'] == pytest.approx(5.0)
    assert found['within_a_fifth_of_a_frame'] == 2
    assert found['rms_error_s'] == pytest.approx((0.5 * (0.003**2 + 0.01**2)) ** 0.5)
    assert 'sigma' in bench.line_of(good)
    assert bench.line_of(refused).endswith('the arm does not move')
