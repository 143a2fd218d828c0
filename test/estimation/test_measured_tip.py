"""How sure a force is that was found from a measured tip: by solving again with what is wrong."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
import math

import numpy as np
from pneunet_ros import load_model, solve, solve_tip
from pneunet_ros.calibration.tip_force import end_forces
from pneunet_ros.cli.verbs.predict import predict
from pneunet_ros.core.share import share_path
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_model import measured_tip_std
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest

ARM = load_model(share_path('config/paper_arm.yaml'))
SOFTER = 5e-4  # one sigma of every alpha2
ROWS = len(ARM.moment_law.rigidity)
STIFFER = ModelCovariance(
    quantities=tuple(f'moment_law.rigidity.{row}.1' for row in range(ROWS)),
    factor=np.full((ROWS, 1), SOFTER),
)
KNOWN = replace(ARM, covariance=STIFFER)
PRESSURE, TIP = 31e3, (0.0989, 0.0475)
STD = 1e-4  # m


def predicted(arm, tip=TIP, std=STD, pressure=PRESSURE):
    shape = solve_tip(arm, pressure, tip)
    given = {'tip': tip, 'tip_std': std, 'pressure': pressure}
    unused = dict.fromkeys(('string', 'force', 'moment'))
    return predict(arm, shape, Namespace(**given, **unused))


def force(arm=ARM, tip=TIP, pressure=PRESSURE):
    return np.array(solve_tip(arm, pressure, tip).force)


def test_the_covariance_is_what_tip_and_pressure_do_when_solved_again():
    x, y = TIP
    wrong = [
        0.5 * (force(tip=(x + STD, y)) - force(tip=(x - STD, y))),
        0.5 * (force(tip=(x, y + STD)) - force(tip=(x, y - STD))),
    ]
    std = ARM.sensors.pressure_std
    wrong.append(0.5 * (force(pressure=PRESSURE + std) - force(pressure=PRESSURE - std)))
    expected = np.array(wrong).T @ np.array(wrong)
    assert predicted(ARM).force_covariance == pytest.approx(expected, rel=0.02)


def test_the_error_of_the_model_is_in_it():
    def moved(sign):
        law = KNOWN.moment_law
        rigidity = law.rigidity + sign * SOFTER * np.array([0.0, 1.0])
        return force(replace(ARM, moment_law=replace(law, rigidity=rigidity)))

    change = 0.5 * (moved(1.0) - moved(-1.0))
    more = predicted(KNOWN).force_covariance - predicted(ARM).force_covariance
    assert more == pytest.approx(np.outer(change, change), rel=0.05)


def test_it_is_the_covariance_that_calibration_finds_from_the_tip_alone():
    found = predicted(KNOWN, std=None)
    arm = replace(KNOWN, target_arclength=np.array([0.0, KNOWN.reach]))
    one = np.array([1])
    x, y = (np.array([[math.nan, value]]) for value in TIP)
    run = RecordingData(
        name='tip', reading_stamp_ns=one, pressure=np.array([PRESSURE]), stamp_ns=one,
        reading=np.array([0]), loaded=True, force=np.array([found.shape.force]),
        moment=np.zeros(1), x=x, y=y,
    )  # fmt: skip
    other = end_forces(arm, run, tip_only=True)
    assert found.shape.force == pytest.approx(other.force[0], rel=1e-4)
    assert found.force_covariance == pytest.approx(other.covariance[0], rel=0.02)


def test_the_tip_is_as_sure_as_it_was_measured():
    std = np.sqrt(np.diag(predicted(KNOWN).estimate.tip_covariance))
    assert std[:2] == pytest.approx([STD, STD], rel=1e-6)


def test_a_tip_measured_exactly_leaves_pressure_and_model():
    exact, usual = predicted(KNOWN, std=0.0), predicted(KNOWN)
    assert 0.0 < exact.force_covariance[0, 0] < usual.force_covariance[0, 0]


def test_a_target_is_as_sure_as_camera_and_paint():
    sensors = replace(ARM.sensors, target_std=3e-5, placement_std=4e-5, registration_std=0.0)
    assert measured_tip_std(replace(sensors, drift_std=0.0)) == pytest.approx(5e-5)
    assert measured_tip_std(replace(sensors, drift_std=1.2e-4)) == pytest.approx(1.3e-4)


def test_outside_the_domain_the_error_of_the_model_is_one_of_the_force():
    tip = solve(ARM, PRESSURE, (-0.1, 0.0)).tip[:2]
    found = predicted(ARM, tip=tip)
    assert found.estimate.shape.extrapolated
    allowed = found.estimate.position.error
    assert allowed[0] > 0.0
    assert np.all(np.diag(found.force_covariance) > np.square(allowed[:2]))
