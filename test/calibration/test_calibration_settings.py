"""The numbers of a calibration: which are not the default is said."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.settings import CALIBRATION, EXPERIMENTS, MAP_ESTIMATION, RESOLUTION
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.settings import settings_changed
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.diagnosis import diagnose
from pneunet_ros.diagnosis.settings import DEFAULTS, SELECTION
import pytest
from support.refusals import refused

EASIER = replace(SELECTION, least_gain=4.0)


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


@pytest.mark.parametrize(
    'settings',
    [
        replace(DEFAULTS, fixed=replace(DEFAULTS.fixed, selection=EASIER)),
        replace(DEFAULTS, hypothesis=replace(DEFAULTS.hypothesis, shapes=3)),
        replace(CALIBRATION, experiments=replace(EXPERIMENTS, first_frames=7)),
    ],
)
def test_a_change_that_would_have_no_effect_is_refused(settings):
    arm = load_model(share_path('config/paper_arm.yaml'))
    ask = diagnose if isinstance(settings, type(DEFAULTS)) else calibrate
    with refused(RequestError, 'fixed_setting'):
        ask(*([], [], arm) if ask is calibrate else (arm, [], []), settings=settings)


def test_what_is_read_from_the_settings_can_be_changed():
    finer = replace(CALIBRATION, resolution=replace(RESOLUTION, knots=RESOLUTION.knots + 1))
    with pytest.raises(RequestError) as refusal:  # there are no recordings
        calibrate([], [], load_model(share_path('config/paper_arm.yaml')), settings=finer)
    assert refusal.value.reason != 'fixed_setting'
