"""What one sigma of each reading moves, against the model at moved readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.effects.effect import Effect
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.measurement.between_readings import interpolated_noise
from pneunet_ros.measurement.disturbances import BETWEEN_NODES
from pneunet_ros.measurement.errors.noise_model import (
    attached_std,
    camera_errors,
    coordinate_stds,
    EDGE,
    model_errors,
    pressure_moves,
    pressure_std,
    reading_errors,
    target_std,
)
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.uncertainty import SensorNoise
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made, PERIOD, USUAL

NONE = np.zeros((0, 2), dtype=np.int64)
PRESSURE = np.array([5e3, 21e3, 43e3])
FORCE = np.array([[0.1, 0.05], [0.0, 0.0], [0.12, 0.0]])


def test_a_load_of_exactly_zero_is_no_reading():
    run = made(paper_arm(), PRESSURE, FORCE)
    force = USUAL.force_std
    assert attached_std(USUAL, run).tolist() == [[force, force, 0.0], [0.0] * 3, [force, force, 0]]
    pushed = replace(run, moment=np.array([0.0, 0.0, 1e-4]))
    assert attached_std(USUAL, pushed)[0].tolist() == [force, force, USUAL.moment_std]
    assert not attached_std(USUAL, run.without_load()).any()


def test_at_the_edge_of_a_push_a_load_may_be_there_already():
    frames = 40
    force = np.zeros((frames, 2))
    force[20:, 0] = 0.1
    run = made(paper_arm(), np.full(frames, 2e4), force)
    assert attached_std(USUAL, run)[:, 0].astype(bool).tolist() == [False] * 20 + [True] * 20
    read = replace(run, wrench_stamp_ns=run.stamp_ns, wrench=run.load)
    near = math.floor(EDGE * NANOSECONDS_PER_SECOND / PERIOD)
    known = attached_std(USUAL, read)[:, 0].astype(bool)
    assert known.tolist() == [False] * (20 - near) + [True] * (20 + near)
    assert 0 < near < 20


def test_a_known_load_is_no_error_of_a_frame():
    arm = paper_arm()
    read = made(arm, np.full(9, 3e4), np.tile([0.1, 0.05], (9, 1)))
    (inputs,) = inputs_of(arm, [read])
    model = ForwardModel(arm.target_arclength)
    assert model.solve(arm, inputs).all()
    jacobian = model.point_jacobian(arm, inputs, NONE)
    errors, known = (
        reading_errors(USUAL, model, arm, run, inputs, jacobian)
        for run in (read, read.with_end_load(0.1, 0.05))
    )
    assert errors[:, :, 1:3].any()
    np.testing.assert_array_equal(known, np.delete(errors, [1, 2, 3], axis=2))


def test_columns_are_what_moved_readings_move():
    arm = paper_arm()
    run = made(arm, PRESSURE, FORCE)
    (inputs,) = inputs_of(arm, [run])
    model = ForwardModel(arm.target_arclength)
    assert model.solve(arm, inputs).all()
    points = model.points.reshape(3, -1).copy()
    jacobian = model.point_jacobian(arm, inputs, NONE)
    found = reading_errors(USUAL, model, arm, run, inputs, jacobian)
    assert model.solve(
        arm, inputs.with_loads(inputs.loads + np.array([0.0, USUAL.force_std, 0.0]))
    ).all()
    moved = model.points.reshape(3, -1) - points
    attached = [0, 2]
    size = np.abs(moved).max()
    assert found[attached, :, 2] == pytest.approx(moved[attached], abs=2e-2 * size)
    assert not found[1, :, 1:4].any()
    assert found[:, :, 4:] == pytest.approx(
        np.broadcast_to(camera_errors(USUAL.drift_std * BETWEEN_NODES, 23), (3, 46, 2))
    )
    # The moment law moves with pressure, too: that is in the differences of the whole model alone.
    whole = model_errors(replace(arm, sensors=USUAL, covariance=None), inputs)
    assert whole.shape == (3, 46, 1)
    assert found[1, :, 0] == pytest.approx(whole[1, :, 0], rel=1e-4, abs=1e-9)


@dataclass(frozen=True, slots=True, kw_only=True)
class DraggingHose(Effect):
    """An end moment that goes with the pressure, as of a stiff hose."""

    name = 'dragging_hose'
    place = 'sensing'

    def sense(self, load):
        """Return the load with that of the hose."""
        return replace(load, moment=load.moment + 3e-8 * load.pressure)


@pytest.mark.parametrize(
    'effect', [DraggingHose(), PressureElongation(strain_per_pascal=1e-6)], ids=['load', 'strain']
)
def test_a_pressure_reading_moves_also_by_the_effects_that_go_with_it(effect):
    arm = replace(paper_arm(), effects=(effect,))
    model, moved = ForwardModel(arm.target_arclength), []
    for step in (-1.0, 1.0, 0.0):
        run = made(arm, PRESSURE + 30.0 * step, FORCE)
        (inputs,) = inputs_of(arm, [run])
        assert model.solve(arm, inputs).all()
        moved.append(model.points.reshape(3, -1).copy())
    jacobian = model.point_jacobian(arm, inputs, NONE)
    found = pressure_moves(model, arm, run, inputs, jacobian)
    expected = (moved[1] - moved[0]) / 60.0
    assert found == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    plain = pressure_moves(model, paper_arm(), run, inputs, jacobian)
    assert np.abs(plain - expected).max() > 0.02 * np.abs(expected).max()


def test_a_target_without_noise_has_a_sigma_all_the_same():
    noise = SensorNoise(pressure_std=0.0, force_std=0.0, moment_std=0.0, target_std=0.0)
    assert 0.0 < target_std(noise) < 1e-6
    assert target_std(replace(noise, target_std=3.0, placement_std=4.0)) == 5.0


def test_one_sigma_of_a_coordinate_is_that_of_readings_drawn_again():
    """Force and pressure readings move, the arm does not: how far predictions scatter."""
    arm, rng = paper_arm(), np.random.default_rng(5)
    run = made(arm, PRESSURE, FORCE)
    (inputs,) = inputs_of(arm, [run])
    noise = replace(USUAL, target_std=0.0, placement_std=0.0)
    model, drawn = ForwardModel(arm.target_arclength), []
    for _ in range(400):
        loads = inputs.loads.copy()
        loads += attached_std(noise, run) * rng.standard_normal(loads.shape)
        pressure = inputs.pressure + noise.pressure_std * rng.standard_normal(PRESSURE.size)
        assert model.solve(arm, replace(inputs, loads=loads, pressure=pressure)).all()
        drawn.append(model.points.copy())
    # The tip of a straight arm moves along it by squares: a millionth of a meter is no matter.
    np.testing.assert_allclose(
        coordinate_stds(arm, run, inputs, noise), np.std(drawn, axis=0), rtol=0.12, atol=1e-6
    )


def test_between_two_readings_a_part_of_their_noise_averages_out():
    arm = paper_arm()
    run = made(arm, PRESSURE, np.tile([0.1, 0.05], (PRESSURE.size, 1)))
    (inputs,) = inputs_of(arm, [run])
    noise = SensorNoise(pressure_std=0.0, force_std=1e-3, moment_std=0.0, target_std=0.0)
    beside = run.stamp_ns - PERIOD // 5
    twice = np.union1d(beside, beside + PERIOD // 2)
    wrench = np.repeat(run.load, 2, axis=0)
    halfway = [
        coordinate_stds(arm, replace(run, wrench_stamp_ns=stamps, wrench=wrench), inputs, noise)
        for stamps in (twice, np.union1d(run.stamp_ns, run.stamp_ns + PERIOD // 2))
    ]
    alone = coordinate_stds(arm, run, inputs, noise)
    assert halfway[1] == pytest.approx(alone)
    assert halfway[0] == pytest.approx(math.hypot(0.4, 0.6) * alone, abs=2e-7)
    # Two readings of one stamp, and frames before the first and after the last.
    stamps = np.array([10, 10, 30, 30])
    assert interpolated_noise(np.array([5, 10, 20, 99]), stamps).tolist() == pytest.approx(
        [1.0, 1.0, math.sqrt(0.5), 1.0]
    )


def test_one_sigma_of_a_target_that_was_not_seen_is_not_known():
    arm = paper_arm()
    run = made(arm, PRESSURE, FORCE)
    x = np.array(run.x)
    x[1, 3] = np.nan
    (inputs,) = inputs_of(arm, [run])
    stds = coordinate_stds(arm, replace(run, x=x), inputs, USUAL)
    assert np.isnan(stds[1, :, 3]).all()
    assert np.isnan(stds).sum() == 2
    assert stds[np.isfinite(stds)].min() >= target_std(USUAL)


def test_between_readings_a_jump_is_an_error_of_the_reading():
    arm, frames = paper_arm(), 20
    pressure = np.where(np.arange(frames) < 10, 2e4, 2.6e4)
    force = np.tile([0.1, 0.05], (frames, 1))
    force[10:, 0] = 0.14
    run = made(arm, pressure, force)
    run = replace(run, wrench_stamp_ns=run.stamp_ns, wrench=run.load)
    late = replace(run, stamp_ns=run.stamp_ns + PERIOD // 2)
    assert pressure_std(USUAL, arm, run).tolist() == [USUAL.pressure_std] * frames
    assert attached_std(USUAL, run)[:, 0].tolist() == [USUAL.force_std] * frames
    # Half a period on, frame 9 is in the jump, which is half done or is not.
    stds = pressure_std(USUAL, arm, late)
    assert stds[9] == pytest.approx(3e3, rel=0.01)
    loads = attached_std(USUAL, late)[:, 0]
    assert loads[9] == pytest.approx(0.02, rel=0.01)
    elsewhere = np.delete(np.arange(frames), 9)
    assert stds[elsewhere].tolist() == [USUAL.pressure_std] * (frames - 1)
    assert pressure_std(USUAL, arm, replace(late, static=True)).max() == USUAL.pressure_std


def test_one_sigma_includes_a_load_that_jumps_between_readings():
    arm = paper_arm()
    force = np.tile([0.1, 0.05], (20, 1))
    force[10:, 0] = 0.14
    run = made(arm, np.full(20, 3e4), force)
    run = replace(run, wrench_stamp_ns=run.stamp_ns - PERIOD // 2, wrench=run.load)
    (inputs,) = inputs_of(arm, [run])
    tips = coordinate_stds(arm, run, inputs, USUAL)[:, :, -1].max(axis=1)
    assert np.argmax(tips) in (9, 10)
    assert tips.max() > 5.0 * np.median(tips)


def test_frames_that_share_a_reading_share_its_noise():
    """Of 24 frames all have readings of their own, or every four share those of one."""
    arm, frames = paper_arm(), 24
    run = made(arm, np.full(frames, 3e4), np.tile([0.1, 0.05], (frames, 1)))
    own = replace(run, wrench_stamp_ns=run.stamp_ns, wrench=run.load)
    rare = run.stamp_ns[::4] - PERIOD // 2
    shared = replace(
        run,
        reading_stamp_ns=rare,
        pressure=run.pressure[::4],
        reading=np.repeat(np.arange(frames // 4), 4),
        wrench_stamp_ns=rare,
        wrench=run.load[::4],
    )
    (inputs,) = inputs_of(arm, [run])
    model = ForwardModel(arm.target_arclength)
    assert model.solve(arm, inputs).all()
    jacobian = model.point_jacobian(arm, inputs, NONE)
    alone, together, static = (
        reading_errors(USUAL, model, arm, item, inputs, jacobian)
        for item in (own, shared, replace(shared, static=True))
    )
    among = slice(0, frames - 8)  # the frames behind the last reading have it, too
    np.testing.assert_allclose(together[among, :, :3], 2.0 * alone[among, :, :3])
    np.testing.assert_allclose(together[:, :, 3:], alone[:, :, 3:])
    np.testing.assert_allclose(static, alone)


def test_behind_the_last_reading_a_value_may_go_on_changing():
    arm, frames = paper_arm(), 20
    force = np.tile([0.1, 0.05], (frames, 1)) + 0.01 * np.arange(frames)[:, None]
    run = made(arm, 1e3 * np.arange(frames), force)
    run = replace(run, wrench_stamp_ns=run.stamp_ns, wrench=run.load)
    late = replace(run, stamp_ns=run.stamp_ns + PERIOD // 2)
    assert pressure_std(USUAL, arm, late)[-1] == pytest.approx(math.hypot(60.0, 500.0), rel=0.01)
    assert attached_std(USUAL, late)[-1, 0] == pytest.approx(math.hypot(1e-3, 5e-3), rel=0.01)
    assert pressure_std(USUAL, arm, run)[-1] == USUAL.pressure_std
