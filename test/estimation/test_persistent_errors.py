"""Errors that all frames share, beside draws of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.estimation.persistent_errors import (
    equivalent_frames,
    FEWEST_FRAMES,
    FrameEvidence,
    KeptFrames,
    PERSISTENCE,
    persistent_errors,
    PersistentErrors,
    READINGS,
    tip_displacement_of,
)
from pneunet_ros.measurement.predicted_targets import PredictedTargets
from pneunet_ros.model.uncertainty import ModelCovariance, PlacementKnown
import pytest
from support.example_arms import paper_arm
from support.made_datasets import USUAL

ARM = replace(paper_arm(), sensors=USUAL)
TARGETS = ARM.target_arclength.size
SHARE = ARM.target_arclength / ARM.target_arclength[-1]

FRAMES = 60
SECOND = 1_000_000_000


def drawn(
    seed: int,
    off: float = 0.0,
    bump: float = 0.0,
    again: int = 1,
    known: PlacementKnown | None = None,
    truly: PlacementKnown | None = None,
    count: int = FRAMES,
) -> list[FrameEvidence]:
    """Return frames of an arm of which a force and one number of the model are not known.

    off: sigma by which that number is; bump (m): a sideways error that the model does not know,
    growing with time; again: frames in which noise is the same. known: where the model has the
    targets painted; truly: where they are, if elsewhere.
    """
    random = np.random.default_rng([seed, 5])
    number = random.standard_normal() if off == 0.0 else off
    placed = USUAL.placement_std * random.standard_normal((2, TARGETS))
    truly = truly or known
    if truly is not None:
        placed = (truly.mean + truly.factor @ [number]).reshape(2, TARGETS)
        placed = placed + truly.std.reshape(2, TARGETS) * random.standard_normal((2, TARGETS))
    camera = USUAL.registration_std * random.standard_normal((2, 1))
    frames: list[FrameEvidence] = []
    for index in range(count):
        theta = (0.5 + 0.5 * np.sin(0.3 * index)) * SHARE
        across = np.stack([-np.sin(theta), np.cos(theta)])
        errors = np.zeros((6, 2, TARGETS))
        errors[0] = 1e-4 * SHARE**2 * np.stack([np.cos(theta), np.sin(theta)])  # of F1
        errors[1] = 3e-4 * SHARE**2 * across  # of F2
        errors[4] = 5e-5 * np.sin(0.2 * index) * SHARE**2 * across  # of the model
        if index % again == 0:
            noise = USUAL.target_std * random.standard_normal((2, TARGETS))
            force = random.standard_normal(2)
        known_places = np.zeros((2, TARGETS)) if known is None else known.mean.reshape(2, TARGETS)
        turned, expected = (
            np.stack(
                [
                    np.cos(theta) * along - np.sin(theta) * across_arm,
                    np.sin(theta) * along + np.cos(theta) * across_arm,
                ]
            )
            for along, across_arm in (placed, known_places)
        )
        residual = (
            noise + np.tensordot(force, errors[:2], axes=1) + number * errors[4] + turned + camera
        )
        residual = residual + bump * (index / count) * np.sin(6.0 * SHARE) * across
        residual[:, random.integers(TARGETS)] = np.nan
        tip = errors[:-1, :, -1]
        frames.append(
            FrameEvidence(
                stamp_ns=SECOND * (1 + index),
                residual=residual,
                std=np.full(TARGETS, USUAL.target_std),
                predicted=PredictedTargets(
                    x=ARM.target_arclength,
                    y=0.0 * SHARE,
                    errors=errors,
                    by_load=np.zeros((3, 2, TARGETS)),
                    theta=theta,
                    share=SHARE,
                    placed=expected,
                    placed_std=np.full(TARGETS, USUAL.placement_std),
                ),
                tip_errors=tip,
                tip_covariance=tip.T @ tip + 1e-12 * np.eye(2),
            )
        )
    return frames


def found(*args, arm=ARM, **options) -> PersistentErrors:
    together = persistent_errors(drawn(*args, **options), arm)
    assert together is not None
    return together


@pytest.fixture(scope='module')
def clean():
    return [found(seed) for seed in range(120)]


def test_a_model_that_holds_moves_as_far_as_chance_says(clean):
    assert all(one.holds and not one.sentence for one in clean)
    for moved, unknowns in (('moved', 'unknowns'), ('moved_with_places', 'unknowns_with_places')):
        total = sum(getattr(one, moved) for one in clean)
        numbers = sum(getattr(one, unknowns) for one in clean)
        assert total == pytest.approx(numbers, abs=4.0 * np.sqrt(2.0 * numbers))
    assert np.mean([one.chance < 0.1 for one in clean]) < 0.2


def test_what_they_leave_is_the_noise(clean):
    left = [one.left for one in clean]
    assert np.mean(left) == pytest.approx(1.0, abs=0.01)
    assert max(left) < clean[0].left_limit
    assert np.mean([one.tips_outside for one in clean]) == pytest.approx(0.05, abs=0.02)


def test_a_number_that_is_far_off_is_found_and_may_be_calibrated_anew():
    off = found(1, off=10.0)
    assert not off.within_prior
    assert off.noise_left
    # One sigma of the number moves the tip by 0.05 mm at most.
    assert off.tip_rms == pytest.approx(10.0 * 5e-5 / np.sqrt(2.0), rel=0.25)


def test_the_share_of_tips_outside_is_that_of_draws():
    frames = drawn(1, off=10.0)
    together = persistent_errors(frames, ARM)
    random = np.random.default_rng(3)
    outside = []
    for frame in frames:
        errors = (
            random.standard_normal((500, 4)) @ frame.tip_errors[:4] + 10.0 * frame.tip_errors[4]
        )
        inside = np.sum(errors @ np.linalg.inv(frame.tip_covariance) * errors, axis=1) < 5.991
        outside.append(1.0 - np.mean(inside))
    assert together.tips_outside == pytest.approx(np.mean(outside), abs=0.06)


def test_what_the_model_does_not_know_is_left_and_calls_for_a_diagnosis():
    strange = found(1, bump=1e-3)
    assert not strange.noise_left
    assert 'diagnose' in strange.advice


def test_frames_that_say_the_same_again_count_once():
    fresh, again = found(2, count=160), found(2, again=8, count=160)
    assert fresh.repeated < 1.5
    assert 3.0 < again.repeated < 9.0
    chances = [found(seed, again=8, count=160).chance for seed in range(20)]
    assert min(chances) > 1e-3


def test_placement_that_is_known_goes_with_the_model():
    random = np.random.default_rng(8)
    known = PlacementKnown(
        mean=5e-5 * random.standard_normal(2 * TARGETS),
        std=np.full(2 * TARGETS, 1e-5),
        factor=3e-5 * random.standard_normal((2 * TARGETS, 1)),
    )
    arm = replace(
        ARM,
        covariance=ModelCovariance(
            quantities=('moment_law.rigidity.0.0',), factor=np.array([[1e-4]]), placement=known
        ),
    )
    assert all(found(seed, arm=arm, known=known).holds for seed in range(10))
    # Painted elsewhere than the calibration found:
    elsewhere = replace(known, mean=-known.mean)
    assert not found(1, arm=arm, known=known, truly=elsewhere).within_prior


def test_too_few_frames_tell_nothing():
    assert persistent_errors(drawn(1, count=FEWEST_FRAMES - 1), ARM) is None


def test_independent_scores_are_no_repetition():
    random = np.random.default_rng(4)
    alone = [equivalent_frames(random.standard_normal((200, 4))) for _ in range(20)]
    assert np.mean(alone) < 1.3
    wave = np.repeat(random.standard_normal((20, 4)), 10, axis=0)
    assert equivalent_frames(wave) > 4.0


def test_frames_are_kept_evenly_however_long_a_recording_is():
    frame, kept = drawn(1, count=20)[0], KeptFrames()
    for index in range(5000):
        kept = kept.after(replace(frame, stamp_ns=1 + index))
    assert PERSISTENCE.frames <= len(kept.frames) <= 2 * PERSISTENCE.frames
    steps = np.diff([one.stamp_ns for one in kept.frames])
    assert set(steps.tolist()) == {kept.stride}
    assert kept.frames[0].stamp_ns == 1
    assert kept.count == 5000


@pytest.mark.parametrize('size', [0.0, 1e-3])
def test_a_tip_without_stated_errors_is_outside_of_them_where_anything_moves_it(size):
    frame = drawn(1, count=1)[0]
    still = np.zeros_like(frame.tip_errors)
    still[READINGS:, 0] = size
    exact = replace(frame, tip_errors=still, tip_covariance=np.zeros((2, 2)))
    columns = len(still) - READINGS
    square, outside = tip_displacement_of(exact, np.ones(columns), np.zeros((columns, columns)))
    assert square == pytest.approx((columns * size) ** 2)
    assert outside == float(size > 0.0)
