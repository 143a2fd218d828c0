"""Recordings linearized around a fit, against dense covariances and against moved models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.measurement.errors.covariance import Whitening
import pytest
from scipy.linalg import sqrtm
from support.lab_designs import base, design, FRAMES, TRAINING


def residual(values: Array, around: Linearization) -> list[Array]:
    """Return residuals of the training runs for a base model."""
    found = around.residual(values, (), range(around.training))
    assert found is not None
    return found


def test_integrating_out_is_the_inverse_root_of_a_covariance():
    columns = np.random.default_rng(1).standard_normal((8, 3)) * [1.0, 10.0, 0.1]
    columns = np.column_stack([columns, columns[:, 0] - columns[:, 1]])  # one says nothing new
    filtered = Whitening(1.0, columns)(np.eye(8))
    root = np.real(sqrtm(np.eye(8) + columns @ columns.T))
    assert filtered == pytest.approx(np.linalg.inv(root), abs=1e-8)


def test_blocks_are_white_of_all_that_a_run_has_of_its_own():
    block = design().blocks[2]
    flat = np.random.default_rng(2).standard_normal((block.base.shape[0], 2))
    covariance = np.eye(flat.shape[0]) + block.path @ block.path.T
    # It is symmetric: twice the inverse root is the inverse.
    found = block.path_filter(block.path_filter(flat))
    assert np.allclose(found, np.linalg.solve(covariance, flat), atol=1e-8)
    assert not np.allclose(block.path_filter(flat), flat, atol=1e-3)


def test_columns_of_the_base_are_what_a_changed_model_moves():
    found = design()
    values, scale = np.array(found.point.values), found.scale[: found.size, : found.size]
    for place in (3, found.size // 2, found.size - 1):
        step = 1e-3 * scale[:, place]
        ahead, behind = residual(values + step, found), residual(values - step, found)
        for which in range(len(TRAINING)):
            answer = (behind[which] - ahead[which]) / 2e-3
            column = found.blocks[which].base[:, place]
            assert column == pytest.approx(answer, abs=2e-4 * max(np.abs(answer).max(), 1.0))


def painted(point: LinearizationPoint, place: int, size: float) -> LinearizationPoint:
    """Return a point with one target painted elsewhere, along and across."""
    placement = np.array(point.placement)
    placement[:, place] += size * np.array([1.0, 0.5])
    return replace(point, placement=placement)


def test_columns_of_placement_are_what_other_places_move():
    """Millimeters beside the line too: targets are on the arc, and turn with the arm."""
    place, step = 15, 1e-6
    found = design().at(painted(design().point, place, 5e-3))
    targets = found.blocks[0].run.x.shape[1]
    column = np.zeros(2 * targets)
    column[[place, targets + place]] = 1.0, 0.5
    scaled = np.linalg.solve(found.scale[found.size :, found.size :], column)
    point, sides = found.point, []
    for size in (step, -step):
        found.point = painted(point, place, size)
        sides.append(found.points(point.arm, range(len(found.blocks))))
    ahead, behind = sides
    for block, above, below in zip(found.blocks, ahead, behind, strict=True):
        moved = ((above - below) / (2.0 * step)).reshape(len(above), -1, 1)
        wanted = block.white(moved)[:, 0]
        found_column = block.base[:, found.size :] @ scaled
        assert found_column == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())


def test_a_changed_model_turns_targets_that_are_beside_the_line():
    found = design().at(painted(design().point, 15, 5e-3))
    values, place = np.array(found.point.values), found.size // 2
    step = 1e-3 * found.scale[: found.size, place]
    ahead, behind = residual(values + step, found), residual(values - step, found)
    for which in range(len(TRAINING)):
        answer = (behind[which] - ahead[which]) / 2e-3
        column = found.blocks[which].base[:, place]
        assert column == pytest.approx(answer, abs=2e-4 * max(np.abs(answer).max(), 1.0))


def test_the_position_is_that_of_the_point():
    found = design()
    values = found.mean + found.scale @ found.position
    assert values[: found.size] == pytest.approx(base().values)
    assert values[found.size :] == pytest.approx(base().placement.ravel(), abs=1e-12)


def test_harmless_departures_move_points_by_their_tolerance_together():
    found = design()
    squares, rows = 0.0, 0
    for block in found.blocks:
        squares += float(np.sum((block.fields.generic * found.tolerance) ** 2))
        rows += block.fields.generic.shape[0] * block.fields.generic.shape[1]
    assert np.sqrt(squares / rows) == pytest.approx(
        LINEARIZATION.tolerance * found.length, rel=1e-6
    )
    felt = [np.any(block.fields.generic, axis=(0, 1)) for block in found.blocks]
    assert np.array_equal(found.tolerance > 0.0, np.any(felt, axis=0))


def test_a_frame_without_a_shape_counts_nothing_and_harmless_departures_stay():
    found = design()
    loaded = next(which for which, run in enumerate(found.runs) if run.loaded)
    run = found.runs[loaded]
    pressure = run.pressure.copy()
    pressure[run.reading[5]] = 1e6  # Pa, far beyond what the curvature is known for
    runs = [*found.runs[:loaded], replace(run, pressure=pressure), *found.runs[loaded + 1 :]]
    lost = found.at(found.point, runs)
    block = lost.blocks[loaded]
    assert np.flatnonzero(~block.linear.fitted.solved).tolist() == [5]
    assert all(np.isfinite(columns).all() for columns in lost.fixed)
    rows = lost.fixed[loaded].reshape(FRAMES, -1)
    assert np.abs(block.linear.whitening(block.fields.generic)[5]).max() == 0.0
    assert np.abs(rows[4]).max() > 0.0
    assert np.array_equal(lost.tolerance > 0.0, found.tolerance > 0.0)


def test_what_was_not_seen_counts_nothing():
    found = design()
    hidden = ~np.concatenate([np.repeat(run.seen[:, None], 2, axis=1).ravel()
                              for run in found.runs[: found.training]])  # fmt: skip
    assert hidden.any()
    run = found.blocks[0]
    rows = ~np.repeat(run.run.seen[:, None], 2, axis=1).ravel()
    field = run.linear.whitening(run.fields.generic).reshape(rows.size, -1)
    assert not field[rows].any()


def test_an_effect_beside_the_model_is_the_model_with_it():
    found = design('load_offset')
    effect = LoadOffset(offset=0.004)
    beside = found.residual(found.point.values, (effect,), range(found.training))
    own = found.at(replace(found.point, effects=(effect,)))
    assert own.point.arm.effects[-1] == effect
    points = found.points(own.point.arm, range(found.training))
    assert beside is not None
    assert points is not None
    for which, values in enumerate(beside):
        run = found.runs[which]
        block = found.blocks[which]
        apart = (np.stack([run.x, run.y], axis=1) - points[which]).reshape(FRAMES, -1)
        white = block.white((apart + block.linear.tangent)[:, :, None])[:, 0]
        assert values == pytest.approx(white, abs=1e-4)


def test_a_model_without_a_shape_in_most_frames_has_no_residuals():
    found = design()
    far = PressureOffset(offset=50e3)  # Pa, beyond all that the curvature is known for
    assert found.residual(found.point.values, (far,), range(found.training)) is None


def test_readings_without_a_past_are_those_of_the_frames_at_their_instants():
    found = design()
    for inputs, run in zip(found.known_inputs.of(found.point.arm), found.runs, strict=True):
        steepest = np.abs(np.diff(run.pressure)).max()  # from reading to reading
        assert np.abs(inputs.pressure - run.frame_pressure).max() <= 0.5 * steepest
        assert inputs.histories is None


def test_noise_of_a_reading_has_no_past():
    found = design()
    late = found.at(replace(found.point, effects=(PressureLag(time_constant=1e-6),)))
    without = found.known_inputs.of(found.point.arm)
    for inputs, other in zip(late.known_inputs.of(late.point.arm), without, strict=True):
        assert inputs.pressure == pytest.approx(other.pressure, abs=0.05)
    slow = found.at(replace(found.point, effects=(PressureLag(time_constant=0.3),)))
    for inputs, quick, run in zip(
        slow.known_inputs.of(slow.point.arm), slow.known_inputs.filtered, found.runs, strict=True
    ):
        followed = inputs.pressure - quick.noise
        assert np.abs(followed - run.frame_pressure).max() > 100.0 or not run.loaded
    assert late.known_inputs is found.known_inputs  # one table for all points
    assert len(found.known_inputs.known) >= 3


def test_training_runs_alone_are_the_same_runs():
    found = design()
    part = found.of_training()
    assert len(part.blocks) == part.training == found.training
    for mine, whole in zip(part.blocks, found.blocks, strict=False):
        assert np.allclose(mine.base, whole.base, atol=1e-6 * np.abs(whole.base).max())
    assert part.known_inputs is not found.known_inputs
