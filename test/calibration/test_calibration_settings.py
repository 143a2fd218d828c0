"""The numbers of a calibration: which are not the default is said."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.calibration.settings import CALIBRATION, EXPERIMENTS, MAP_ESTIMATION
from pneunet_ros.core.settings import settings_changed


def test_what_is_not_the_default_is_said():
    assert settings_changed(CALIBRATION) == {}
    changed = replace(
        CALIBRATION,
        experiments=replace(EXPERIMENTS, rows=7),
        fixed=replace(CALIBRATION.fixed, map_estimation=replace(MAP_ESTIMATION, small_step=0.1)),
    )
    assert settings_changed(changed) == {
        'ExperimentSettings.rows': 7,
        'MapEstimationSettings.small_step': 0.1,
    }
