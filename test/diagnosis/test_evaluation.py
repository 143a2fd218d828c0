"""The model error in meters: what is removed of it, and the floor that noise puts under it."""

from __future__ import annotations

from dataclasses import replace
import functools

import numpy as np
from pneunet_ros.diagnosis.evaluation import distances, misfit, noise_floor, removed_share, scores
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_model import attached_std
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
import pytest
from support.lab_designs import base, design, fitted, FRAMES, noise, recorded, TRAINING
from support.made_datasets import made

DRAWS = 30


@pytest.mark.parametrize(
    ('before', 'after', 'floor', 'share'),
    [
        (5.0, 3.0, 3.0, 1.0),
        (5.0, 5.0, 3.0, 0.0),
        (5.0, 4.0, 3.0, 9.0 / 16.0),
        (5.0, 7.0, 3.0, -24.0 / 16.0),
        (3.0, 2.0, 3.0, None),
        (2.0, 2.0, 3.0, None),
    ],
)
def test_the_share_of_the_removable_gap_that_is_closed(before, after, floor, share):
    found = removed_share(before, after, floor)
    assert found is None if share is None else found == pytest.approx(share)


def test_distances_of_what_was_seen():
    error = np.array([[[3.0, np.nan, 0.0], [4.0, np.nan, -2.0]]])
    assert distances(error).tolist() == [5.0, 2.0]


@functools.cache
def own() -> Arm:
    """Return the arm that makes the clean runs: the base model."""
    return base().arm


def clean(sensors: SensorNoise, seed: int) -> list[RecordingData]:
    """Return a run without and one with a load of a perfectly known arm."""
    turn = np.linspace(0.0, 1.0, FRAMES)
    force = np.column_stack([0.05 + 0.1 * turn, 0.05 * np.sin(6.0 * turn)])
    both = ((60e3 * turn, None), (55e3 * (1.0 - 0.7 * turn), force))
    return [
        made(own(), pressure, load, noise=sensors, seed=2 * seed + which, painted=seed,
             start=2 * which * FRAMES, name=str(which))
        for which, (pressure, load) in enumerate(both)
    ]  # fmt: skip


def floor_of(sensors: SensorNoise) -> tuple[float, float]:
    """Return the floor of such runs, and its scatter."""
    return noise_floor(own(), clean(sensors, 0), sensors)


NOTHING = SensorNoise(
    pressure_std=0.01, force_std=1e-7, moment_std=1e-9, target_std=1e-6,
    placement_std=0.0, registration_std=0.0, drift_std=0.0,
)  # fmt: skip


@pytest.mark.parametrize(
    'part',
    [
        {'target_std': 1e-4},
        {'placement_std': 2e-4},
        {'pressure_std': 300.0},
        {'force_std': 5e-3},
        {'registration_std': 5e-3},
        {'pressure_std': 100.0, 'force_std': 3e-3, 'target_std': 8e-5, 'placement_std': 8e-5},
    ],
)
def test_the_floor_is_the_score_of_the_true_model_on_clean_runs(part):
    sensors = replace(NOTHING, **part)
    means = []
    for seed in range(DRAWS):
        errors = [item.error for item in scores(own(), clean(sensors, 1 + seed))]
        means.append(float(np.nanmean(np.concatenate(errors) ** 2)))
    reached = float(np.sqrt(np.mean(means)))
    floor, scatter = floor_of(sensors)
    # A score has lost the mean that registration could be: of 23 targets a little.
    assert floor == pytest.approx(reached, rel=0.12, abs=2e-6)
    assert floor > 0.95 * reached
    if len(part) > 1 or 'registration_std' not in part:
        assert scatter == pytest.approx(float(np.std(np.sqrt(means), ddof=1)), rel=0.7, abs=1e-6)


def test_the_misfit_of_a_fit():
    found = fitted(hidden='load_offset')
    own_scores = scores(found.point.arm, found.linearization.runs[: len(TRAINING)])
    before = misfit(own_scores, found.gaussian.squares, found.linearization.runs[: len(TRAINING)])
    squares = np.concatenate([item.error[np.isfinite(item.error)] ** 2 for item in own_scores])
    assert before.rms == pytest.approx(np.sqrt(squares.mean()))
    assert before.rms < before.p95 < 6.0 * before.rms
    known = fitted('load_offset', 'load_offset')
    arm = known.point.arm
    runs = known.linearization.runs[: len(TRAINING)]
    after = misfit(scores(arm, runs), known.gaussian.squares, runs)
    assert after.chi_squared == pytest.approx(1.0, abs=0.1)
    assert before.chi_squared > 1.15 * after.chi_squared
    floor, _ = noise_floor(
        arm, known.linearization.runs[: len(TRAINING)], known.linearization.noise
    )
    assert after.rms == pytest.approx(floor, rel=0.25)
    share = removed_share(before.rms, after.rms, floor)
    assert share is not None
    assert share > 0.85


def test_the_floor_is_that_of_the_recordings_it_is_asked_of():
    around = design('extensibility')
    arm = around.point.arm
    apart = around.runs[len(TRAINING) :]
    (floor, _), (other, _) = (noise_floor(arm, runs, noise()) for runs in (apart, around.runs))
    assert floor != other
    assert floor > noise().target_std


def test_frames_beside_a_load_are_without_it():
    """What a fit allows a frame near the edge of a load for is in no clean run's error."""
    _, run = clean(NOTHING, 0)
    force = run.force.copy()
    force[: FRAMES // 2] = 0.0
    before = replace(run, force=force, wrench_stamp_ns=None, wrench=None)
    beside = replace(before, wrench_stamp_ns=run.stamp_ns, wrench=before.load)
    sensors = replace(NOTHING, force_std=5e-3)
    assert attached_std(sensors, beside).sum() > attached_std(sensors, before).sum()
    assert noise_floor(own(), [beside], sensors) == noise_floor(own(), [before], sensors)


def test_a_known_load_makes_no_noise_from_frame_to_frame():
    force = np.tile([0.1, 0.05], (FRAMES, 1))
    run = made(own(), np.linspace(0.0, 60e3, FRAMES), force, noise=NOTHING)
    sensors = replace(NOTHING, target_std=1e-4, force_std=5e-3)
    exact = replace(sensors, force_std=0.0)
    known = replace(run, load_known=True)
    assert noise_floor(own(), [known], sensors) == noise_floor(own(), [run], exact)
    assert noise_floor(own(), [run], sensors)[0] > 2.0 * noise_floor(own(), [known], sensors)[0]


def test_what_an_arm_remembers_is_carried_from_run_to_run():
    arm = replace(own(), effects=(PressureLag(time_constant=2.0),), covariance=None)
    runs = [run.thin(FRAMES) for run in recorded()[:2]]
    together = scores(arm, runs)
    assert together[0].rms == scores(arm, runs[:1])[0].rms
    late = replace(runs[1], reading_stamp_ns=runs[0].reading_stamp_ns[-1] + 1
                   + (runs[1].reading_stamp_ns - runs[1].reading_stamp_ns[0]))  # fmt: skip
    assert scores(arm, [runs[0], late])[1].rms != scores(arm, [late])[0].rms
