"""The numbers of a calibration: which are not the default is said."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.calibration.settings import CALIBRATION, EXPERIMENTS
from pneunet_ros.core.settings import settings_changed


def test_what_is_not_the_default_is_said():
    assert settings_changed(CALIBRATION) == {}
    changed = replace(CALIBRATION, experiments=replace(EXPERIMENTS, rows=7))
    assert settings_changed(changed) == {'ExperimentSettings.rows': 7}
