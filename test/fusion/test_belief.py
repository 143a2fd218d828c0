"""What is believed of unknowns: how it moves, is forgotten, and takes a measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.belief import first_belief, move_belief, with_walk
from pneunet_ros.fusion.unknowns import unknowns_of
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.model_columns import GUESS_TIME, ModelColumns
from pneunet_ros.measurement.blocks.model_error import ModelDiscrepancy
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.tip_force import LEAST_WALK, TipForce, Walk
from pneunet_ros.measurement.inference.gaussian import compressed, forget, take_measurement, widen
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest

ARM = load_model(share_path('config/paper_arm.yaml'))
UNKNOWNS = unknowns_of(ARM)
FORCE = UNKNOWNS.at(TipForce)
TIP = UNKNOWNS.block(TipForce)
BIAS = UNKNOWNS.at(PressureError).start
LACK = UNKNOWNS.block(ModelDiscrepancy)
SECOND = 10**9
SIZE = 0.02  # of the model error


def believed(seed=3):
    """Return a belief in which all unknowns are correlated."""
    random = np.random.default_rng(seed)
    belief = first_belief(UNKNOWNS, SECOND)
    size = belief.mean.size
    mixed = belief.root @ (np.eye(size) + 0.1 * random.standard_normal((size, size)))
    mean = UNKNOWNS.std * random.standard_normal(size)
    return replace(belief, mean=mean, root=mixed, frames=1)


def covariance(belief):
    return belief.root @ belief.root.T


def test_the_force_is_held_and_grows_uncertain_up_to_its_scale():
    belief = believed()
    before = replace(belief, root=1e-3 * belief.root)
    soon = move_belief(UNKNOWNS, before, SECOND + SECOND // 10, SIZE)
    assert np.array_equal(soon.mean[FORCE], before.mean[FORCE])
    grown = covariance(soon)[FORCE, FORCE] - covariance(before)[FORCE, FORCE]
    assert np.diagonal(grown) == pytest.approx(0.1 * before.walk.recent**2, rel=0.01)
    late = move_belief(UNKNOWNS, before, SECOND * 10**5, SIZE)
    assert np.sqrt(np.diagonal(covariance(late))[FORCE]) == pytest.approx(TIP.scale)
    assert late.mean[BIAS] == pytest.approx(0.0, abs=1e-9)


def test_what_does_not_move_stays():
    belief = believed()
    late = move_belief(UNKNOWNS, belief, SECOND * 50, SIZE)
    place = UNKNOWNS.at(Camera, Camera.PLACE)
    still = [*range(place.start, place.stop)]
    still += range(UNKNOWNS.at(Placement).start, belief.mean.size)
    assert late.mean[still] == pytest.approx(belief.mean[still])
    was, found = (covariance(item)[np.ix_(still, still)] for item in (belief, late))
    assert found == pytest.approx(was, rel=1e-9, abs=1e-18)


def test_how_much_comes_late_is_forgotten_slowly():
    belief, memory = believed(), UNKNOWNS.at(ModelDiscrepancy, slice(2, 5))
    soon, late = (
        move_belief(UNKNOWNS, belief, SECOND + int(seconds * SECOND), SIZE)
        for seconds in (1.0, 10.0 * LACK.memory_time)
    )
    assert soon.mean[memory] == pytest.approx(belief.mean[memory], rel=0.006)
    assert late.mean[memory] == pytest.approx(np.zeros(memory.stop - memory.start), abs=1e-3)
    std = np.sqrt(np.diagonal(covariance(late))[memory])
    assert std == pytest.approx(UNKNOWNS.std[memory], rel=1e-3)


def test_a_linear_measurement_is_the_kalman_update():
    belief = believed()
    random = np.random.default_rng(5)
    response = random.standard_normal((3, belief.mean.size)) / (UNKNOWNS.std + 1e-9)
    value, std = random.standard_normal(3), np.array([0.3, 0.5, 2.0])
    after = take_measurement(belief, response, value, std)
    prior = covariance(belief)
    gain = prior @ response.T @ np.linalg.inv(response @ prior @ response.T + np.diag(std**2))
    mean = belief.mean + gain @ (value - response @ belief.mean)
    expected = prior - gain @ response @ prior
    scale = np.maximum(UNKNOWNS.std, 1e-12)
    assert after.mean / scale == pytest.approx(mean / scale, abs=1e-8)
    assert covariance(after) / np.outer(scale, scale) == pytest.approx(
        expected / np.outer(scale, scale), abs=1e-8
    )


def test_what_the_model_lacks_moves_with_time_and_with_the_pressure():
    known = replace(believed(), root=np.zeros((UNKNOWNS.std.size, 2)))
    rested = move_belief(UNKNOWNS, known, SECOND, SIZE)
    assert rested.std(BIAS) == 0.0
    pushed = move_belief(UNKNOWNS, known, SECOND, SIZE, pressure_change=0.1 * LACK.range)
    assert pushed.std(BIAS) == pytest.approx(0.1 * SIZE * LACK.range)
    assert pushed.std(UNKNOWNS.sized[1]) == pytest.approx(0.1 * SIZE)
    late = move_belief(UNKNOWNS, known, 10**5 * SECOND, SIZE)
    assert late.std(BIAS) == pytest.approx(SIZE * LACK.range)


def test_what_a_calibration_has_guessed_is_forgotten_and_what_it_knows_is_kept():
    covariance = ModelCovariance(
        quantities=('arm.length', 'moment_law.rigidity.0.0'), factor=1e-6 * np.eye(2), guessed=1
    )
    unknowns = unknowns_of(replace(ARM, covariance=covariance))
    first = first_belief(unknowns, SECOND)
    columns = unknowns.at(ModelColumns)
    constant, guess = columns.start, columns.start + 1
    response = np.eye(unknowns.std.size)[columns]
    seen = take_measurement(first, response, np.ones(2), np.full(2, 0.1))
    assert [seen.std(constant), seen.std(guess)] == pytest.approx([0.0995] * 2, rel=1e-3)
    late = move_belief(unknowns, seen, SECOND + round(20e9 * GUESS_TIME), SIZE)
    assert late.std(constant) == pytest.approx(seen.std(constant))
    assert late.mean[constant] == pytest.approx(seen.mean[constant])
    assert late.std(guess) == pytest.approx(1.0)
    assert late.mean[guess] == pytest.approx(0.0, abs=1e-6)


def test_what_is_forgotten_is_as_before_any_frame_and_the_rest_stays():
    belief = believed()
    found = forget(belief, FORCE, UNKNOWNS.std[FORCE])
    assert found.mean[FORCE] == pytest.approx([0.0, 0.0])
    assert covariance(found)[FORCE, FORCE] == pytest.approx(TIP.scale**2 * np.eye(2))
    assert covariance(found)[FORCE, 2:] == pytest.approx(0.0, abs=1e-15)
    kept = covariance(belief)[2:, 2:]
    assert covariance(found)[2:, 2:] == pytest.approx(kept, rel=1e-9, abs=1e-15)


def test_noise_is_new_in_every_reading():
    before = move_belief(UNKNOWNS, believed(), SECOND, SIZE, noise=(1.0, 1.0))
    belief = move_belief(UNKNOWNS, before, SECOND, SIZE, noise=(2e-5, 60.0))
    assert belief.mean[-2:] == pytest.approx([0.0, 0.0])
    assert covariance(belief)[-2:] @ np.ones(belief.mean.size) == pytest.approx([4e-10, 3600.0])
    more = widen(belief, slice(BIAS, BIAS + 1), np.array([1e4]))
    assert more.std(BIAS) == pytest.approx(np.hypot(belief.std(BIAS), 1e4))


def test_a_root_that_has_grown_is_made_square_and_means_the_same():
    belief = move_belief(UNKNOWNS, believed(), 2 * SECOND, SIZE, noise=(2e-5, 60.0))
    square = compressed(belief)
    assert square.root.shape == (belief.mean.size,) * 2 < belief.root.shape
    scale = np.sqrt(np.diagonal(covariance(belief))) + 1e-12
    assert covariance(square) / np.outer(scale, scale) == pytest.approx(
        covariance(belief) / np.outer(scale, scale), abs=1e-12
    )
    assert compressed(square) is square


def test_the_walk_rises_at_once_and_falls_slowly():
    start = replace(believed(), root=1e-6 * believed().root, walk=Walk(recent=1e-3, usual=1e-3))
    after = replace(start, stamp_ns=start.stamp_ns + SECOND // 10)
    jumped = replace(after, mean=start.mean + np.eye(start.mean.size)[0] * 0.02)
    assert with_walk(UNKNOWNS, start, jumped).walk.recent == pytest.approx(
        0.02 / np.sqrt(0.1), rel=0.01
    )
    moving = replace(start, walk=Walk(recent=0.05, usual=1e-3))
    share = np.exp(-0.1 / TIP.walk_time)
    assert with_walk(UNKNOWNS, moving, after).walk.recent == pytest.approx(
        0.05 * np.sqrt(share), rel=0.01
    )
    noisy = replace(start, root=1e2 * believed().root, walk=Walk(recent=0.05, usual=1e-3))
    assert with_walk(UNKNOWNS, noisy, replace(noisy, stamp_ns=after.stamp_ns)).walk.recent < 0.05


def test_an_error_common_to_two_frames_explains_no_change_of_the_force():
    start = believed()
    root = np.zeros((start.mean.size, 2))
    root[0] = 0.05, 1e-4  # N: of a direction of gravity, and of the targets of this frame alone
    root[1] = 0.0, 1e-4
    start = replace(start, root=root, frames=1, walk=Walk(recent=1e-3, usual=1e-3))
    mean = start.mean + np.eye(start.mean.size)[0] * 0.02
    after = replace(start, stamp_ns=start.stamp_ns + SECOND // 10, mean=mean)
    assert with_walk(UNKNOWNS, start, after).walk.recent < 2e-3
    kept = np.zeros((3, 2))
    kept[0, 0] = 0.05
    found = with_walk(UNKNOWNS, start, after, kept)
    assert found.walk.recent == pytest.approx(0.02 / np.sqrt(0.1), rel=0.01)
    assert found.walk.usual > with_walk(UNKNOWNS, start, after).walk.usual


@pytest.mark.parametrize('period', [0.02, 0.1, 0.5])
def test_a_force_that_moves_steadily_is_held_where_frames_come_late(period):
    speed = 0.03  # N/s: it stays small beside the largest force
    start = replace(
        believed(), root=1e-6 * believed().root, frames=1, walk=Walk(recent=1e-3, usual=1e-3)
    )
    belief = start
    for frame in range(1, 4):
        after = replace(
            belief,
            stamp_ns=belief.stamp_ns + round(period * SECOND),
            mean=start.mean + np.eye(start.mean.size)[0] * speed * period * frame,
        )
        belief = with_walk(UNKNOWNS, belief, after)
    assert belief.walk.interval == max(period, TIP.steady_after)

    def share(seconds):
        late = belief.stamp_ns + round(seconds * SECOND)
        return move_belief(UNKNOWNS, belief, late, 1.0).std(0) / (speed * seconds)

    # As a walk until then, and after that a share of the way that stays.
    steady = np.sqrt(period / belief.walk.interval)
    assert share(belief.walk.interval) == pytest.approx(steady, rel=0.1)
    assert share(4.0 * belief.walk.interval) == pytest.approx(steady, rel=0.2)
    assert share(0.5 * belief.walk.interval) == pytest.approx(
        np.sqrt(2.0 * period / belief.walk.interval), rel=0.1
    )


def test_a_force_that_rests_from_the_first_frame_is_soon_trusted_between_frames():
    belief = replace(believed(), root=1e-6 * believed().root, frames=0)
    first = belief.walk.usual
    for frame in range(151):
        after = replace(belief, stamp_ns=belief.stamp_ns + SECOND // 10, frames=frame + 1)
        belief = with_walk(UNKNOWNS, belief, after)
    # Fifteen seconds of frames beside the five for which the guess counts.
    assert belief.walk.usual == pytest.approx(first * np.sqrt(5.0 / 20.0), rel=0.05)
    assert belief.walk.recent == pytest.approx(belief.walk.usual, rel=0.05)


def test_a_force_that_moved_now_and_then_is_not_held_for_certain():
    belief = replace(believed(), root=1e-6 * believed().root, frames=1)
    random, force = np.random.default_rng(3), 0.0
    for frame in range(1, 1201):
        force += 0.05 * random.standard_normal() if frame % 40 == 0 else 0.0
        after = replace(
            belief,
            stamp_ns=belief.stamp_ns + SECOND // 10,
            mean=np.eye(belief.mean.size)[0] * force,
        )
        belief = with_walk(UNKNOWNS, belief, after)
    # Jumps of 50 mN every four seconds are, on average, a walk of 25 mN/sqrt(s) in one direction.
    assert belief.walk.usual == pytest.approx(0.025 / np.sqrt(2.0), rel=0.5)
    assert belief.walk.recent >= belief.walk.usual > 10.0 * LEAST_WALK * TIP.scale
