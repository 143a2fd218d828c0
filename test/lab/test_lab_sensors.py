"""Noise of the virtual lab: of the sizes it says, and kept where it belongs."""

from __future__ import annotations

import dataclasses

import numpy as np
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.scenario import Detail
from pneunet_ros.lab.sensors import (
    draw_drift,
    draw_hidden,
    draw_stamps,
    LabNoise,
    random_stream,
    regular_times,
)
from pneunet_ros.lab.simulation import simulate
import pytest
from support.lab_pairs import NOISELESS, recorded
from support.lab_run import readings_at_frames

STRINGS = dataclasses.replace(recorded('strings').scenario, detail=Detail(elements=56.0))


def recording(scenario=STRINGS, **noise):
    return simulate(dataclasses.replace(scenario, noise=dataclasses.replace(NOISELESS, **noise)))


def test_without_noise_sensors_tell_the_truth():
    found = recording()
    truth = found.truth
    assert np.array_equal(found.x, truth.target_x)
    assert np.array_equal(found.y, truth.target_y)
    assert not found.wrench_moment.any()
    # Readings are up to 5 ms away from the frame; ramps go at 10 kPa/s and 0.1 N/s.
    reading, force, _ = readings_at_frames(found)
    assert np.abs(found.pressure[reading] - truth.pressure).max() < 100.0
    assert np.abs(force - truth.force).max() < 1e-3


def test_white_noise_has_its_sizes():
    quiet = recording()
    noisy = recording(pressure_std=60.0, force_std=1e-3, moment_std=1e-5, target_std=5e-5)
    for name, std in (
        ('pressure', 60.0),
        ('wrench_force', 1e-3),
        ('wrench_moment', 1e-5),
        ('x', 5e-5),
    ):
        error = getattr(noisy, name) - getattr(quiet, name)
        assert error.std() == pytest.approx(std, rel=0.1)
        assert abs(error.mean()) < 0.2 * std


def test_a_row_of_another_spacing_is_on_the_arm():
    """And not on the tangents where its targets should be."""
    arm = dataclasses.replace(STRINGS.arm, targets=0.95 * STRINGS.arm.targets)
    there = recording(dataclasses.replace(STRINGS, arm=arm))
    found = recording(row_spacing=-0.05)
    assert found.x == pytest.approx(there.x, abs=1e-12)
    assert found.y == pytest.approx(there.y, abs=1e-12)


def test_placement_turns_with_the_arm_and_belongs_to_it():
    quiet, painted = recording(), recording(placement_std=5e-5)
    again = recording(dataclasses.replace(STRINGS, seed=9, name='again'), placement_std=5e-5)
    assert np.array_equal(painted.truth.placement, again.truth.placement)
    assert painted.truth.placement.std() == pytest.approx(5e-5, rel=0.3)
    error = np.stack([painted.x - quiet.x, painted.y - quiet.y])
    # Of constant length in all frames, while the arm turns by more than a right angle.
    lengths = np.hypot(*error)
    assert lengths == pytest.approx(np.tile(lengths[0], (400, 1)), rel=1e-9)
    turned = np.unwrap(np.arctan2(error[1], error[0]), axis=0)[:, -1]
    theta = quiet.truth.theta[:, -1]
    assert turned - turned[0] == pytest.approx(theta - theta[0], abs=0.05)
    other = recording(
        dataclasses.replace(STRINGS, arm=vary_arm(STRINGS.arm, 1)), placement_std=5e-5
    )
    assert not np.array_equal(painted.truth.placement, other.truth.placement)


def test_registration_is_one_translation_per_recording():
    quiet, shifted = recording(), recording(registration_std=1e-4)
    error = np.stack([shifted.x - quiet.x, shifted.y - quiet.y], axis=-1)
    assert error == pytest.approx(np.broadcast_to(shifted.truth.registration, error.shape))
    # As `simulate` draws them.
    sizes = [random_stream('strings/registration', seed).standard_normal(2) for seed in range(500)]
    assert shifted.truth.registration == pytest.approx(1e-4 * sizes[STRINGS.seed])
    assert np.std(sizes) == pytest.approx(1.0, rel=0.1)


def test_drift_is_smooth_and_ends_at_its_size():
    noise = dataclasses.replace(NOISELESS, drift_std=5e-5)
    time = np.linspace(0.0, 40.0, 401)
    walks = np.array(
        [draw_drift(random_stream('drift', seed), time, 40.0, noise) for seed in range(500)]
    )
    assert not walks[:, 0].any()
    assert walks[:, -1].std() == pytest.approx(5e-5, rel=0.1)
    assert walks[:, 200].std() == pytest.approx(5e-5 / np.sqrt(2.0), rel=0.1)
    assert np.abs(np.diff(walks, axis=1)).max() < 1e-5  # in 0.1 s


def test_stamps_jitter_and_stay_in_order():
    time = regular_times(50.0, 40.0)
    noise = dataclasses.replace(NOISELESS, jitter_std=5e-4)
    late = (
        draw_stamps(random_stream('stamps', 1), time, 100.0, noise)
        - 1_750_000_100_000_000_000
        - time * 1e9
    )
    assert late[1:].std() == pytest.approx(5e5, rel=0.1)
    wild = dataclasses.replace(NOISELESS, jitter_std=0.1)
    assert np.diff(draw_stamps(random_stream('stamps', 1), time, 0.0, wild)).min() > 0


def test_targets_are_missing_at_random_and_in_groups():
    time = regular_times(10.0, 400.0)
    alone = draw_hidden(
        random_stream('a', 1), time, 400.0, 23, dataclasses.replace(NOISELESS, dropout=0.01)
    )
    assert alone.mean() == pytest.approx(0.01, rel=0.1)
    often = dataclasses.replace(NOISELESS, occlusions=0.5)
    together = draw_hidden(random_stream('a', 1), time, 400.0, 23, often)
    beside = together[:, 1:] & together[:, :-1]
    assert together.mean() > 0.01
    assert beside.sum() > 0.5 * together.sum()


def test_the_wrench_is_exactly_zero_while_nothing_hangs_on_the_arm():
    found = recorded('dead_weights')
    force = readings_at_frames(found)[1]
    hanging = found.truth.force.any(axis=1)
    assert 10 < np.count_nonzero(~hanging) < 40
    assert not force[~hanging][1:-1].any()
    assert force[hanging].all()


def test_noise_of_one_kind_leaves_the_others_as_they_are():
    both = recording(pressure_std=60.0, target_std=5e-5)
    alone = recording(pressure_std=60.0)
    assert np.array_equal(both.pressure, alone.pressure)
    assert not np.array_equal(both.x, alone.x)


def test_seeds_and_names_make_other_noise():
    def pressure(**changes):
        return recording(dataclasses.replace(STRINGS, **changes), pressure_std=60.0).pressure

    assert not np.array_equal(pressure(), pressure(seed=2))
    assert not np.array_equal(pressure(), pressure(name='other'))


def test_defaults_are_those_of_the_docs():
    noise = LabNoise()
    assert (noise.pressure_std, noise.force_std, noise.target_std) == (60.0, 1e-3, 5e-5)
    assert (noise.placement_std, noise.registration_std, noise.drift_std) == (5e-5, 1e-4, 5e-5)


def test_stamps_increase_with_a_camera_that_stamps_early():
    time = np.arange(20) * 0.1
    stamp = draw_stamps(np.random.default_rng(0), time - 1.0, 0.0, LabNoise())
    assert np.diff(stamp) == pytest.approx(np.full(19, 1e8), abs=1e7)
