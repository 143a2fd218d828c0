"""What the node `fusion` says of itself, without DDS; and that it gets warm with any arm."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.estimation.health import EstimatorHealth, solve_values
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.fusion.contact import Contact
from pneunet_ros.fusion.estimate import ForceSensorFault, FusedEstimate, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import ForceReadings, FusionState, RunningNis
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.model.domain import Domain
import pytest
from support.example_arms import paper_arm
from support.random_estimates import random_estimate

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.fusion.health import FusionHealth  # noqa: E402
from pneunet_ros.nodes.fusion.warm_up import warm_up  # noqa: E402
from pneunet_ros.nodes.ros_types import RCLPY_TYPES, serialize  # noqa: E402

FUSION = Fusion(arm=paper_arm())


def fused(mode=Mode.FUSED, ambiguous=False, force=(0.1, 0.05), wrench_age=None, contact=None):
    known = not ambiguous
    return FusedEstimate(
        estimate=replace(random_estimate(3), wrench_age=wrench_age, warnings=()),
        mode=mode,
        force=np.array(force if known else (np.nan, np.nan)),
        force_covariance=np.eye(2) * (1e-6 if known else np.nan),
        contact=contact,
        pressure_bias=10.0,
        pressure_bias_std=20.0,
        force_sensor=None,
        ambiguous=ambiguous,
        nis=1.0,
        nis_limit=2.0,
        target_age=0.05,
    )


def report_of(outcome, state=None, at=100.1, now=100.2):
    """Return what is reported after one outcome of a pressure."""
    health = FusionHealth('/p/pressure', '/p/targets', 100.0)
    health.record('pressure', outcome, at, 0.001)
    return health.report(state or FusionState(), FUSION, now)


def contact(ambiguous):
    return Contact(
        x=0.07,
        y=0.03,
        arclength=0.067,
        std_arclength=2e-3,
        force=0.012,
        std_force=1e-3,
        log_odds=7.0,
        ambiguous=ambiguous,
    )


def test_a_sensor_that_is_worse_than_that_of_the_calibration_is_said():
    assert report_of(fused()).values['other_sensors'] == ''
    wrench = WrenchReading(
        stamp_ns=1, force_x=0.1, force_y=0.0, moment=0.0, frame_id='pneunet_base'
    )
    noisy = FusionState(force=ForceReadings(kept=(wrench,) * 8, noise=0.01))
    said = report_of(fused(), noisy).values['other_sensors']
    assert ' 0.01 N' in said


@pytest.mark.parametrize(
    ('outcome', 'level', 'words', 'values'),
    [
        (fused(), Level.OK, 'targets and pressure', {'mode': 'fused', 'determined': 'F1, F2'}),
        (fused(force=(np.nan, 0.1)), Level.OK, 'estimating at', {'determined': 'F2'}),
        (fused(contact=contact(False)), Level.OK, '', {'contact': '0.012 N at 0.067 m'}),
        (fused(contact=contact(True)), Level.OK, '', {'contact': 'ambiguous'}),
        (
            fused(Mode.CAMERA_ONLY),
            Level.WARN,
            'camera_only: targets alone: the pressure is too old',
            {'mode': 'camera_only'},
        ),
        (fused(Mode.PREDICTION), Level.WARN, 'the force is held', {'mode': 'prediction'}),
        (
            fused(ambiguous=True),
            Level.WARN,
            'no force is published',
            {'ambiguous': 'True', 'determined': 'none'},
        ),
        (fused(), Level.OK, '', {'force_judged': 'no: without an end wrench the force is not '
                                 'checked: a force on the arm would look the same'}),
        (fused(wrench_age=0.01), Level.OK, '', {'force_judged': 'yes', 'wrench_lag_s': '0.01'}),
        (
            Refusal(stamp_ns=1, reason='too_uncertain', sentence='the tip is lost', error=True),
            Level.ERROR,
            'the tip is lost',
            {'mode': 'none', 'determined': '', 'pressure_bias_pa': ''},
        ),
    ],
)  # fmt: skip
def test_level_and_words_are_those_of_the_estimate(outcome, level, words, values):
    report = report_of(outcome)
    assert report.level == level, report.message
    assert words in report.message
    assert {name: report.values[name] for name in values} == values


def test_solve_and_out_of_plane_wrench_are_those_of_the_estimator():
    wrench = WrenchReading(
        stamp_ns=1,
        force_x=0.1,
        force_y=0.0,
        moment=0.0,
        frame_id='base',
        force_z=0.03,
        moment_x=1e-3,
        moment_y=2e-3,
    )
    readings = EstimatorState().with_wrench(wrench)
    values = report_of(fused(), FusionState(readings=readings)).values
    health = EstimatorHealth('/p/pressure', 100.0)
    health.record_pressure(fused().estimate, 100.1, 0.001)
    expected = health.report(readings, EstimatorSettings(), 100.2).values
    names = {name for name in values if name in solve_values(None, None)}
    assert {'residual_rad', 'iterations', 'stable', 'load_beyond', 'gravity_x_g'} < names
    assert {name: values[name] for name in names} == {name: expected[name] for name in names}
    assert float(values['residual_rad']) == pytest.approx(
        fused().estimate.shape.residual, rel=1e-3
    )
    parts = ('force_z_n', 'moment_x_n_m', 'moment_y_n_m')
    assert [values[name] for name in parts] == ['0.03', '0.001', '0.002']


def test_a_force_sensor_that_is_no_longer_read_is_said():
    health = FusionHealth('/p/pressure', '/p/targets', 100.0)
    levels = []
    for at, outcome in enumerate((fused(), fused(wrench_age=0.01), fused(), fused())):
        health.record('pressure', outcome, 100.1 + at, 0.001)
        levels.append(health.report(FusionState(), FUSION, 100.2 + at).level)
    assert levels == [Level.OK, Level.OK, Level.WARN, Level.WARN]


def test_an_error_names_the_messages_dropped_meanwhile():
    health = FusionHealth('/p/pressure', '/p/targets', 100.0)
    dropped = Refusal(stamp_ns=1, reason='wrong_frame', sentence='other frame', error=False)
    unknown = Refusal(stamp_ns=1, reason='too_uncertain', sentence='no frame', error=True)
    health.record('targets', dropped, 100.1, 0.001)
    health.record('pressure', unknown, 100.2, 0.001)
    report = health.report(FusionState(), FUSION, 100.7)
    assert (report.level, report.message) == (Level.ERROR, 'no frame; other frame')
    # The pressure was usable; a frame that gives no estimate is not.
    assert (report.values['pressure_age_s'], report.values['targets_age_s']) == ('0.5', '')


def test_silence_is_an_error_and_what_belongs_to_an_estimate_is_empty():
    report = report_of(fused(), now=101.0)
    assert report.level == Level.ERROR
    assert '0.9 s' in report.message
    assert (report.values['mode'], report.values['ambiguous']) == ('none', '')


def test_a_running_nis_beyond_noise_is_told_once_for_each_new_frame():
    nis = RunningNis(stamp_ns=1, weight=5.0, last=9.0, mean=4.0, limit=2.0)
    health, state = FusionHealth('/p', '/t', 100.0), FusionState(nis=nis)
    health.record('pressure', fused(), 100.1, 0.001)
    report = health.report(state, FUSION, 100.2)
    assert report.level == Level.WARN
    assert [report.values[name] for name in ('nis', 'nis_mean', 'nis_limit')] == ['9', '4', '2']
    health.record('pressure', fused(), 100.3, 0.001)
    assert health.report(state, FUSION, 100.4).level == Level.OK


@pytest.mark.parametrize(
    'arm',
    [
        paper_arm(),
        replace(paper_arm(), domain=None),
        replace(
            paper_arm(), domain=Domain(pressure=(0.0, 66e3), end_load=[[0.0, -0.3, 0.0, 66e3]])
        ),
        replace(paper_arm(), target_arclength=np.array([0.0, 0.06, 0.112])),
    ],
    ids=['shipped', 'no domain', 'one weight', 'three targets'],
)
def test_the_warm_up_gives_an_estimate(arm):
    serializer = MessageSerializer(types=RCLPY_TYPES, serialize=serialize, frame_id='base')
    assert warm_up(Fusion(arm=arm), serializer) == ''


def test_errors_are_as_large_as_the_frames_of_the_last_while_say():
    def ratio(mean):
        nis = RunningNis(stamp_ns=1, weight=5.0, last=1.0, mean=mean, limit=2.0)
        return nis.birge_ratio(4.0)

    assert ratio(1.9) == 1.0  # noise has as much
    assert ratio(4.0) == 2.0
    assert ratio(1e5) == pytest.approx(math.sqrt(8.0))  # of a frame that is not used


def test_a_force_that_the_targets_do_not_determine_is_unknown():
    fault = ForceSensorFault(
        reading=np.array([0.1, np.nan]),
        targets=np.array([np.nan, 0.02]),
        targets_std=np.array([np.nan, 0.001]),
    )
    assert '(0.1000, unknown)' in fault.words
    assert '(unknown, 0.0200 ± 0.0010)' in fault.words
    assert fault.numbers['targets'] == [None, 0.02]
