"""Generic fields: columns against the arm bent, stretched and turned a little in truth."""

from __future__ import annotations

from dataclasses import replace
import functools

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.generic_field import (
    Fields,
    fields_of,
    high_pass,
    Regressors,
    ROTATION_REGRESSORS,
    stretch_fields,
    STRETCH_REGRESSORS,
)
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs, inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.columns import THETA
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made

FRAMES = 9
PRESSURE = np.linspace(2e3, 50e3, FRAMES)
FORCE = np.column_stack([np.linspace(0.02, 0.1, FRAMES), np.linspace(0.05, -0.05, FRAMES)])


@functools.cache
def loaded() -> tuple[Arm, RecordingData, Inputs, Fields, Regressors, ForwardModel]:
    """Return the paper's arm in a run under load, and the fields of that run."""
    arm = paper_arm()
    run = made(arm, PRESSURE, FORCE)
    (inputs,) = inputs_of(arm, [run])
    series = ForwardModel(arm.target_arclength)
    assert series.solve(arm, inputs).all()
    knots = series.jacobian(arm, inputs, np.zeros((0, 2), dtype=np.int64))[:, 3:, :2]
    knots = knots.reshape(FRAMES, knots.shape[1], -1).transpose(0, 2, 1)
    regressors = Regressors.of(arm, [run], [inputs])
    fields = fields_of(regressors, 0, knots, series.fields[:, THETA])
    return arm, run, inputs, fields, regressors, series


def column(name: str) -> Array:
    """Return one of the generic fields by name, (frames, 2 targets)."""
    fields = loaded()[3]
    return fields.generic[:, :, fields.names.index(name)]


def points_of(arm: Arm, inputs: Inputs) -> Array:
    """Return where the targets are, (frames, 2 targets)."""
    series = ForwardModel(arm.target_arclength)
    assert series.solve(arm, inputs).all()
    return series.points.reshape(FRAMES, -1).copy()


@pytest.mark.parametrize('mode', range(LINEARIZATION.modes + 1))
def test_a_curvature_mode_bends_the_arm(mode):
    arm, _, inputs, _, regressors, _ = loaded()
    table = arm.intrinsic_curvature
    shape = legendre.legval(2.0 * table.arclength - 1.0, np.eye(LINEARIZATION.modes + 1)[mode])

    def bent(size: float) -> Array:
        curvature = replace(table, curvature=table.curvature + size * shape)
        return points_of(replace(arm, intrinsic_curvature=curvature, covariance=None), inputs)

    answer = (bent(1e-3) - bent(-1e-3)) / 2e-3
    for function in ('p', 'F1', 'p F2'):
        felt = regressors.columns(0, [function])
        found = column(f'curvature {mode} x {function}')
        assert found == pytest.approx(felt * answer, abs=1e-5 * np.abs(answer).max())


def test_a_stretch_is_that_of_an_arm_without_a_load():
    arm = paper_arm()
    run = made(arm, PRESSURE)
    (inputs,) = inputs_of(arm, [run])
    series = ForwardModel(arm.target_arclength)
    series.solve(arm, inputs)
    theta = series.fields[:, THETA]
    share = arm.target_arclength / arm.length
    found = stretch_fields(share, theta, arm.clamp_angle, 1)[:, :, 0] * arm.length

    def stretched(size: float) -> Array:
        effect = PressureElongation(strain_per_pascal=size)
        return points_of(replace(arm, effects=(effect,)), inputs)

    answer = (stretched(1e-9) - points_of(arm, inputs)) / (1e-9 * PRESSURE[:, None])
    # The trapezoids from target to target are good to a thousandth of the arm.
    assert found == pytest.approx(answer, abs=1e-3 * arm.length)


@pytest.mark.parametrize('mode', range(3))
def test_a_stretch_mode_moves_points_of_a_straight_arm_along_it(mode):
    share = np.linspace(0.0, 1.0, 201)
    angle = 0.3
    found = stretch_fields(share, np.full((2, share.size), angle), angle, 3)[:, :, mode]
    whole = legendre.legint(np.eye(3)[mode], scl=0.5, lbnd=-1.0)
    moved = legendre.legval(2.0 * share - 1.0, whole)
    for frame in range(2):
        assert found[frame, :201] == pytest.approx(moved * np.cos(angle), abs=1e-4)
        assert found[frame, 201:] == pytest.approx(moved * np.sin(angle), abs=1e-4)


@pytest.mark.parametrize('share', [[0.5, 1.0], [1.0]])
def test_a_stretch_begins_at_the_clamp_and_not_at_the_first_target(share):
    found = stretch_fields(np.array(share), np.zeros((1, len(share))), 0.0, 1)[0, :, 0]
    assert found == pytest.approx([*share, *np.zeros(len(share))])


def test_a_turn_is_about_the_clamp():
    arm, _, _, _, regressors, series = loaded()
    targets = arm.target_arclength.size
    x, y = (series.points - series.points[:, :, :1]).transpose(1, 0, 2)
    felt = regressors.columns(0, ['F2'])
    found = column('rotation 0 x F2') * arm.length
    assert found[:, :targets] == pytest.approx(-y * felt, abs=1e-3 * arm.length)
    assert found[:, targets:] == pytest.approx(x * felt, abs=1e-3 * arm.length)


def test_every_function_is_about_one_and_what_it_says():
    arm, _, inputs, fields, regressors, _ = loaded()
    low, high = arm.pressure_range
    pressure = (inputs.pressure - low) / (high - low)
    assert regressors.columns(0, ['1', 'p', 'p^2']) == pytest.approx(
        np.column_stack([np.ones(FRAMES), pressure, pressure**2])
    )
    assert regressors.columns(0, ['t'])[[0, -1], 0].tolist() == [-1.0, 1.0]
    largest = np.abs(FORCE).max()
    assert regressors.columns(0, ['F1', 'F1 F2']) == pytest.approx(
        np.column_stack([FORCE[:, 0], FORCE[:, 0] * FORCE[:, 1] / largest]) / largest
    )
    assert not regressors.columns(0, ['F1 below highest p']).any()  # pressure has only grown
    assert np.abs(regressors.values[0]).max() <= 1.0
    assert len(fields.names) == fields.generic.shape[2]
    assert len(set(fields.names)) == len(fields.names)
    assert sum(name.startswith('stretch') for name in fields.names) == 3 * len(STRETCH_REGRESSORS)
    assert sum(name.startswith('rotation') for name in fields.names) == len(ROTATION_REGRESSORS)


def test_what_was_more_before_is_known_from_the_run_before():
    arm = paper_arm()
    force = np.tile([0.1, 0.05], (FRAMES, 1))
    second = made(arm, PRESSURE, force, name='second', start=FRAMES)
    first = made(arm, 1.1 * PRESSURE, name='first')
    runs = [second, first]  # in another order than that of their stamps
    regressors = Regressors.of(arm, runs, inputs_of(arm, runs))
    assert regressors.columns(0, ['F1 below highest p']) == pytest.approx(np.ones((FRAMES, 1)))
    assert not regressors.columns(1, ['F1 below highest p']).any()


def test_windows_and_single_targets():
    arm, _, _, fields, _, _ = loaded()
    targets = arm.target_arclength.size
    assert fields.weights.sum(axis=1) == pytest.approx(np.ones(FRAMES))
    windows = fields.windows().reshape(FRAMES, 2 * targets, -1, LINEARIZATION.windows)
    assert windows.sum(axis=3) == pytest.approx(fields.shapes, abs=1e-12)
    moved = fields.shapes[:, :, -2:]
    assert moved[:, :targets].tolist() == np.tile([1.0, 0.0], (FRAMES, targets, 1)).tolist()
    assert moved[:, targets:].tolist() == np.tile([0.0, 1.0], (FRAMES, targets, 1)).tolist()
    single = fields.single().reshape(FRAMES, 2 * targets, 2 * targets, -1)
    assert np.array_equal(single[:, 5, 5], fields.regressors)
    assert not single[:, 5, [0, 4, 6]].any()


def test_pressure_before_its_past_dies_away():
    arm, memory = paper_arm(), 3.0
    stamps = np.arange(400) * 50_000_000  # 20 s
    step = np.where(np.arange(400) < 100, 10e3, 30e3)
    run = replace(
        made(arm, np.zeros(400)), reading_stamp_ns=stamps, pressure=step, stamp_ns=stamps
    )
    felt = high_pass(run, memory)
    assert felt[:100] == pytest.approx(np.zeros(100), abs=1e-6)
    rise = 0.05  # s, along a straight line between two readings
    at_top = 20e3 * memory / rise * (1.0 - np.exp(-rise / memory))
    after = 1e-9 * (stamps[100:] - stamps[100])
    assert felt[100:] == pytest.approx(at_top * np.exp(-after / memory), abs=1e-6)


def test_the_past_of_a_night_between_two_readings_takes_no_memory():
    arm, stamps = paper_arm(), np.array([0, 1, 2, 100_000_001, 100_000_002]) * 1_000_000_000
    pressure = np.array([10e3, 20e3, 20e3, 30e3, 30e3])
    run = replace(
        made(arm, np.zeros(5)), reading_stamp_ns=stamps, pressure=pressure, stamp_ns=stamps
    )
    felt = high_pass(run, 1.0)
    assert felt[2] > 2e3
    assert abs(felt[3]) < 1e-3
