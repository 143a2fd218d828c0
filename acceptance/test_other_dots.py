"""The bench of other dots: a model that takes the camera for exact fails it."""

from __future__ import annotations

import dataclasses

from fusion import COLUMNS, fuse, recording_of, WAYS
import numpy as np
import other_dots as bench
from pneunet_ros.fusion.fusion import Fusion
import pytest
from support.lab_run import true_model


def rows(exact: bool) -> np.ndarray:
    """Return what the true model makes of dots away from the clamp, by a camera known or not."""
    whole, dots = recording_of(77, 0, duration=10.0), bench.DOTS['eleven, none at the clamp']
    arm = true_model(whole.scenario)
    noise = dataclasses.replace(arm.sensors, registration_std=1e-9, drift_std=1e-9)
    arm = dataclasses.replace(
        arm, target_arclength=arm.target_arclength[dots], sensors=noise if exact else arm.sensors
    )
    seen = dataclasses.replace(whole, x=whole.x[:, dots], y=whole.y[:, dots])
    return fuse(Fusion(arm=arm), seen, WAYS['no wrench'], 77)[None]


@pytest.mark.slow
def test_a_camera_that_is_taken_for_exact_misses_the_goals():
    found = {}
    for exact in (False, True):
        one = rows(exact)
        assert one.shape[-1] == len(COLUMNS)
        found[exact] = bench.summary_of([{f'{dots}, {name}': one for dots in bench.DOTS
                                          for name in bench.SENSORS}])  # fmt: skip
    missed = {
        exact: [one for one in summary['missed'] if 'tip_covered' in one]
        for exact, summary in found.items()
    }
    assert not missed[False]
    assert len(missed[True]) == len(bench.DOTS) * len(bench.SENSORS)
