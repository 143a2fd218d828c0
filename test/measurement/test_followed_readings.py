"""An arm in motion, followed at once and reading by reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.share import share_path
from pneunet_ros.measurement.moving_arm import (
    follow_reading,
    follow_readings,
    SHAPES,
    unloaded_modes,
)
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.vibration import masses_of

DAMPING_TIME = 0.03


def test_a_series_is_what_its_readings_are_one_after_the_other():
    """With pressure and load that change, an arm that swings at first, and a long gap."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    arm = replace(arm, motion=Motion(damping_time=DAMPING_TIME))
    modes, masses = unloaded_modes(arm), masses_of(arm)
    random = np.random.default_rng(1)
    seconds = np.r_[0.0, random.uniform(0.005, 0.03, 30), 600.0, random.uniform(0.005, 0.03, 8)]
    stamps = (1e9 * np.cumsum(seconds)).astype(np.int64)
    shapes = [
        solve(arm, pressure, (0.0, force)).solution.for_kernels()
        for pressure, force in zip(
            20e3 + 5e3 * random.uniform(size=40), 0.02 * random.uniform(size=40), strict=True
        )
    ]
    start = np.array([[2e-3, 1e-4], [1e-6, -1e-6]])
    state, alone = None, []
    for stamp, shape in zip(stamps.tolist(), shapes, strict=True):
        state, moved = follow_reading(state, stamp, shape, masses, DAMPING_TIME, modes)
        alone.append(moved.at_nodes[:2])
        if len(alone) == 1:
            state.swing.state[:] = start
    solved = tuple(np.array(tables) for tables in zip(*shapes, strict=True))
    together = follow_readings(stamps, solved, start, masses, DAMPING_TIME, modes)
    assert start.shape == (2, SHAPES)
    assert np.array_equal(together[1:], alone[1:])
    assert np.abs(alone[31]).max() == 0.0 < np.abs(alone[32]).max()
