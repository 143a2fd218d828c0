"""The noise of recordings from the recordings themselves: every sigma within its own error."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from pneunet_ros.calibration.noise_estimate import ASSUMED as NOT_OBSERVED
from pneunet_ros.calibration.noise_estimate import (
    estimate_noise,
    LEAST_TARGET,
    resolution_of,
    resting_series,
    second_differences,
)
from pneunet_ros.model.uncertainty import SensorNoise
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made
from support.refusals import reasons

PAPER = paper_arm()
ASSUMED = SensorNoise(pressure_std=1.0, force_std=1.0, moment_std=1.0, target_std=1.0)
NAMES = tuple(
    item.name for item in fields(SensorNoise) if not item.name.startswith(('heading_', 'row_'))
)
TRUE = SensorNoise(
    pressure_std=80.0,
    force_std=2e-3,
    moment_std=1e-5,
    target_std=4e-5,
    placement_std=6e-5,
    registration_std=2e-4,
    drift_std=1e-4,
)
RUNS = 6
FRAMES = 200


def on_neighbors(estimate):
    """Return what is said of noise that neighboring targets have in common."""
    return [note for note in estimate.notes if note.reason == 'alike_neighbors']


def runs(noise: SensorNoise, seed: int = 0, frames: int = FRAMES):
    """Return ramps that begin at rest, every other one loaded."""
    up = np.concatenate([np.zeros(frames // 5), np.linspace(0.0, 55e3, frames - frames // 5)])
    turn = np.linspace(0.0, 1.0, frames)
    force = np.stack([0.1 + 0.1 * turn, 0.1 * np.sin(4.0 * turn)], axis=1)
    return [
        made(
            PAPER, up, force if which % 2 else None, noise=noise, seed=100 * seed + which,
            painted=seed,
        )
        for which in range(RUNS)
    ]  # fmt: skip


def test_every_sigma_is_found_within_its_error():
    found = {name: [] for name in NAMES}
    for seed in range(8):
        estimate = estimate_noise(runs(TRUE, seed), PAPER.target_arclength, ASSUMED)
        for name in NAMES:
            found[name].append(getattr(estimate.noise, name) / getattr(TRUE, name))
    # Of how many independent values each comes: readings, targets, runs.
    for name, spread in (('pressure_std', 0.03), ('force_std', 0.04), ('target_std', 0.02)):
        assert np.array(found[name]) == pytest.approx(1.0, abs=4.0 * spread), name
        assert np.mean(found[name]) == pytest.approx(1.0, abs=0.03), name
    for name, spread in (('placement_std', 0.2), ('registration_std', 0.25), ('drift_std', 0.2)):
        assert np.mean(found[name]) == pytest.approx(1.0, abs=3.0 * spread / np.sqrt(8)), name
        assert np.std(found[name]) < 1.6 * spread, name


def test_what_is_not_there_is_not_found():
    noise = replace(TRUE, placement_std=0.0, registration_std=0.0, drift_std=0.0)
    found = estimate_noise(runs(noise), PAPER.target_arclength, ASSUMED).noise
    for name in ('placement_std', 'registration_std', 'drift_std'):
        assert getattr(found, name) < 0.6 * noise.target_std
    assert found.target_std == pytest.approx(noise.target_std, rel=0.08)


def test_a_camera_is_never_found_to_be_still_by_chance():
    noise = replace(TRUE, target_std=5e-5, registration_std=1e-4, drift_std=5e-5)
    found = [
        estimate_noise(runs(noise, seed, frames=40), PAPER.target_arclength, ASSUMED).noise
        for seed in range(12)
    ]
    for name in ('registration_std', 'drift_std'):
        ratio = np.array([getattr(item, name) / getattr(noise, name) for item in found])
        assert ratio.min() > 0.4, name
        assert ratio.max() < 2.5, name


def test_dots_are_never_found_to_be_exact_by_chance():
    noise = replace(TRUE, placement_std=1e-5)
    found = [
        estimate_noise(runs(noise, seed, frames=40), PAPER.target_arclength, ASSUMED).noise
        for seed in range(12)
    ]
    assert min(item.placement_std for item in found) > 0.3 * noise.placement_std


def test_what_recordings_cannot_tell_is_assumed_and_said():
    free = [run for run in runs(TRUE) if not run.loaded]
    estimate = estimate_noise(free, PAPER.target_arclength, ASSUMED)
    assert estimate.noise.force_std == ASSUMED.force_std
    assert estimate.noise.moment_std == ASSUMED.moment_std
    for name in NAMES:
        assumed = name in ('force_std', 'moment_std')
        assert (estimate.sources[name] == NOT_OBSERVED) == assumed
    few = estimate_noise(free[:2], PAPER.target_arclength, ASSUMED)
    assert few.sources['registration_std'] == NOT_OBSERVED


def test_few_targets_tell_nothing_of_their_placement():
    arm = replace(PAPER, target_arclength=PAPER.target_arclength[::4])
    up = np.linspace(0.0, 55e3, 60)
    estimate = estimate_noise(
        [made(arm, up, noise=TRUE, seed=seed) for seed in range(3)], arm.target_arclength, ASSUMED
    )
    assert estimate.sources['placement_std'].startswith('assumed')
    assert estimate.noise.placement_std == pytest.approx(1e-3 * arm.target_arclength[-1], rel=0.01)


def painted_at(which, noise, seed=0):
    """Return the noise found in unloaded runs of the paper's arm with some of its targets."""
    arm = replace(PAPER, target_arclength=PAPER.target_arclength[which])
    up = np.concatenate([np.zeros(30), np.linspace(0.0, 55e3, 60)])
    some = [made(arm, up, noise=noise, seed=each, painted=seed) for each in range(3)]
    return some, arm.target_arclength


def test_a_few_targets_show_that_they_are_painted_by_hand():
    careless = replace(TRUE, placement_std=8e-4)
    found = [estimate_noise(*painted_at(slice(0, 18, 2), careless, seed), ASSUMED)
             for seed in range(8)]  # fmt: skip
    sizes = np.array([each.noise.placement_std for each in found])
    assert np.median(sizes) == pytest.approx(8e-4, rel=0.3)
    # By chance they may lie on a curve, and are then still not exactly where they should be.
    some, arclength = painted_at(slice(0, 18, 2), replace(TRUE, placement_std=0.0))
    exact = estimate_noise(some, arclength, ASSUMED)
    assert exact.noise.placement_std == pytest.approx(1e-3 * arclength[-1], rel=0.01)
    assert exact.sources['placement_std'] != NOT_OBSERVED


def test_targets_that_are_never_seen_do_not_hide_the_placement_of_the_others():
    some, arclength = painted_at(slice(None), TRUE)
    x = some[0].x.copy()
    x[:, 5:9] = np.nan
    hidden = [replace(run, x=np.where(np.isnan(x), x, run.x)) for run in some]
    estimate = estimate_noise(hidden, arclength, ASSUMED)
    assert estimate.sources['placement_std'] != NOT_OBSERVED
    assert estimate.noise.placement_std == pytest.approx(TRUE.placement_std, rel=0.5)


def test_an_arm_without_a_target_at_the_clamp_tells_nothing_of_the_camera():
    arm = replace(PAPER, target_arclength=PAPER.target_arclength[4:])
    up = np.linspace(0.0, 55e3, 60)
    estimate = estimate_noise(
        [made(arm, up, noise=TRUE, seed=seed) for seed in range(3)], arm.target_arclength, ASSUMED
    )
    for name in ('registration_std', 'drift_std'):
        assert estimate.sources[name].startswith('assumed')
        assert getattr(estimate.noise, name) > 1e-4  # m: a camera never stands exactly
    stated = replace(ASSUMED, registration_std=1e-5)
    assert estimate_noise([], arm.target_arclength, stated).noise.registration_std == 1e-5


@pytest.mark.parametrize('targets', [0, 1])
def test_arms_with_hardly_a_target_tell_what_they_can(targets):
    arm = replace(PAPER, target_arclength=PAPER.target_arclength[:targets])
    run = made(arm, np.linspace(0.0, 55e3, 60), noise=TRUE)
    estimate = estimate_noise([run], arm.target_arclength, ASSUMED)
    assert estimate.noise.pressure_std == pytest.approx(80.0, rel=0.5)
    assert estimate.sources['placement_std'].startswith('assumed')


def test_motion_and_steps_are_no_noise():
    random = np.random.default_rng(1)
    time = np.arange(400)
    steps = 1e4 * (time // 40) + 50.0 * random.standard_normal(400)
    assert second_differences([steps]) == pytest.approx(50.0, rel=0.15)
    ramp = 137.0 * time + 50.0 * random.standard_normal(400)
    assert second_differences([ramp]) == pytest.approx(50.0, rel=0.15)


def test_readings_of_which_most_show_changes_tell_their_noise():
    """Two thirds of the readings at 2 Hz of a pressure that steps follow a change."""
    found = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        levels = np.repeat(random.uniform(0.0, 6e4, 30), random.integers(2, 7, 30))
        found.append(second_differences([levels + 60.0 * random.standard_normal(levels.size)]))
    assert np.mean(found) == pytest.approx(60.0, rel=0.1)
    assert max(found) < 100.0


def test_readings_that_are_set_points_tell_nothing():
    assert second_differences([1e4 * (np.arange(400) // 40)]) is None
    assert second_differences([np.zeros(3)]) is None


def test_numbers_are_kept_to_what_they_mean():
    found = estimate_noise(runs(TRUE), PAPER.target_arclength, ASSUMED).noise
    for name in NAMES:
        value = getattr(found, name)
        assert value == float(f'{value:.3g}')


def test_readings_that_follow_a_restless_pressure_are_not_taken_for_noise():
    random = np.random.default_rng(8)
    still = [60.0 * random.standard_normal(160) for _ in range(2)]
    moving = [2e3 * random.standard_normal(160) for _ in range(4)]
    assert second_differences([*still, *moving]) > 150.0
    found = second_differences(resting_series([*still, *moving]))
    assert found == pytest.approx(second_differences(still)) == pytest.approx(60.0, rel=0.15)
    # Where none moves, all are used.
    alike = [60.0 * random.standard_normal(160) for _ in range(6)]
    assert len(resting_series(alike)) == 6
    assert resting_series([np.arange(30.0)]) != []


def test_neither_static_frames_nor_a_known_load_tell_of_noise_in_time():
    some = runs(TRUE)
    static = [replace(run, static=True) for run in some]
    found = estimate_noise(static, PAPER.target_arclength, ASSUMED)
    assert set(found.sources.values()) == {NOT_OBSERVED}
    known = [run.with_end_load(0.1, 0.0) if run.loaded else run for run in some]
    found = estimate_noise(known, PAPER.target_arclength, ASSUMED).noise
    assert (found.force_std, found.moment_std) == (ASSUMED.force_std, ASSUMED.moment_std)
    assert found.target_std < 2.0 * TRUE.target_std


def test_frames_in_which_nothing_was_attached_do_not_make_the_force_sensor_better():
    # A wrench of exactly zero is no reading: the laboratory's loads are hung on after a rest.
    found = []
    for seed in range(8):
        some = []
        for run in runs(TRUE, seed):
            resting = np.arange(len(run.stamp_ns)) < FRAMES // 4
            some.append(
                replace(
                    run,
                    force=np.where(resting[:, None], 0.0, run.force),
                    moment=np.where(resting, 0.0, run.moment),
                )
            )
        estimate = estimate_noise(some, PAPER.target_arclength, ASSUMED)
        found.append(estimate.noise.force_std / TRUE.force_std)
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)  # with them 0.64


def blurred(run, std: float, length: float, seed: int):
    """Return a run with noise of its targets that is alike over a length (m) of the arm."""
    place = PAPER.target_arclength / length
    root = np.linalg.cholesky(
        np.exp(-0.5 * np.subtract.outer(place, place) ** 2) + 1e-9 * np.eye(place.size)
    )
    random = np.random.default_rng([seed, 9])
    moved = [std * random.standard_normal(run.x.shape) @ root.T for _ in 'xy']
    return replace(run, x=run.x + moved[0], y=run.y + moved[1])


def test_noise_that_is_alike_in_neighboring_targets_is_widened_and_said():
    clean, assumed = runs(TRUE), replace(ASSUMED, pressure_std=60.0)
    estimate = estimate_noise(clean, PAPER.target_arclength, assumed)
    assert not on_neighbors(estimate)
    alike = [blurred(run, 1.5e-4, 0.02, seed) for seed, run in enumerate(clean)]
    found = estimate_noise(alike, PAPER.target_arclength, assumed)
    assert on_neighbors(found)
    # A shape that several targets span has to be as uncertain as with noise of their own.
    spacing = float(np.diff(PAPER.target_arclength).mean())
    together = np.sqrt(np.sqrt(2.0 * np.pi) * 0.02 / spacing)  # targets that err as one
    assert 0.5 * together < found.noise.target_std / 1.55e-4 < together


def test_motion_is_no_noise_that_targets_have_in_common():
    up = 25e3 + 20e3 * np.sin(np.arange(FRAMES) / 3.0)
    moving = [made(PAPER, up, noise=TRUE, seed=seed) for seed in range(3)]
    for assumed in (ASSUMED, replace(ASSUMED, pressure_std=60.0)):
        assert not on_neighbors(estimate_noise(moving, PAPER.target_arclength, assumed))


def test_a_few_frames_that_move_make_no_noise_in_common():
    """A film of an arm that twitches now and then, far more than the noise."""
    clean = [made(PAPER, np.full(FRAMES, 3e4), noise=TRUE, seed=seed) for seed in range(3)]
    bend = (PAPER.target_arclength / PAPER.length) ** 2
    twitch = np.where(np.arange(FRAMES) % 20 == 0, 1e-3, 0.0)[:, None] * bend
    moved = [replace(run, x=run.x - twitch, y=run.y + twitch) for run in clean]
    assumed = replace(ASSUMED, pressure_std=80.0)
    assert not on_neighbors(estimate_noise(moved, PAPER.target_arclength, assumed))


def read_in_steps(run, step: float):
    """Return a recording whose pressure was rounded to steps (Pa)."""
    return replace(run, pressure=step * np.round(run.pressure / step))


@pytest.mark.parametrize(('step', 'noise'), [(500.0, 80.0), (500.0, 5.0), (300.0, 80.0)])
def test_the_variance_of_coarse_steps_is_in_the_pressures(step, noise):
    """Rounding adds step^2 / 12, which differences of readings that repeat do not show."""
    exact = runs(replace(TRUE, pressure_std=noise))
    rounded = [read_in_steps(run, step) for run in exact]
    error = np.concatenate([b.pressure - a.pressure for a, b in zip(exact, rounded, strict=True)])
    assert np.std(error) == pytest.approx(step / np.sqrt(12.0), rel=0.15)
    estimate = estimate_noise(rounded, PAPER.target_arclength, replace(ASSUMED, pressure_std=60.0))
    true = np.hypot(noise, np.std(error))
    assert 0.85 * true < estimate.noise.pressure_std < 1.7 * true
    assert 'coarse_steps' in reasons(estimate.notes)


@pytest.mark.parametrize('components', [1, 2])
@pytest.mark.parametrize(('step', 'noise'), [(0.01, 2e-3), (0.01, 1e-4), (5e-3, 2e-3)])
def test_the_variance_of_coarse_steps_is_in_the_forces(step, noise, components):
    """Also where only one component pulls, and the other hardly changes."""
    exact = runs(replace(TRUE, force_std=noise))
    scale = np.array([1.0, 1.0 if components == 2 else 0.1])
    exact = [replace(run, force=scale * run.force) if run.loaded else run for run in exact]
    rounded = [replace(run, force=step * np.round(run.force / step)) for run in exact]
    pairs = zip(exact, rounded, strict=True)
    error = np.concatenate([b.force - a.force for a, b in pairs if a.loaded])
    estimate = estimate_noise(rounded, PAPER.target_arclength, replace(ASSUMED, force_std=1e-3))
    true = np.hypot(noise, np.std(error))
    # Half of the readings rest: what noise there is below the step is that of the arm file.
    least = 0.85 if components == 2 else 0.7
    assert least * true < estimate.noise.force_std < 1.7 * true
    assert 'coarse_steps' in reasons(estimate.notes)


@pytest.mark.parametrize('step', [0.0, 1.0, 40.0])
def test_steps_finer_than_the_noise_add_nothing(step):
    """The noise shows them; and what was never rounded has none."""
    given = [read_in_steps(run, step) if step else run for run in runs(TRUE)]
    estimate = estimate_noise(given, PAPER.target_arclength, ASSUMED)
    assert estimate.noise.pressure_std == pytest.approx(np.hypot(80.0, step / 12**0.5), rel=0.15)
    assert 'coarse_steps' not in reasons(estimate.notes)


def test_set_points_and_even_ramps_are_no_coarse_sensor():
    """Few levels that are held, or levels that never repeat, tell nothing of a sensor."""
    assert resolution_of([np.repeat([0.0, 1e4, 2e4, 3e4], 50)]) == 0.0
    assert resolution_of([np.linspace(0.0, 5e4, 200)]) == 0.0
    assert resolution_of([np.repeat(np.linspace(0.0, 5e4, 26), 8)]) == pytest.approx(2e3)


def test_noise_that_is_not_as_stated_is_said():
    """A file that states four times the noise is named with both numbers; a fair one is not."""
    stated = replace(TRUE, pressure_std=4.0 * TRUE.pressure_std, target_std=TRUE.target_std / 4.0)
    (note,) = estimate_noise(runs(TRUE), PAPER.target_arclength, stated).notes
    assert note.reason == 'other_noise'
    assert ('pressure_std' in note, 'target_std' in note, 'force_std' in note) == (
        True,
        True,
        False,
    )
    fair = replace(TRUE, pressure_std=1.5 * TRUE.pressure_std)
    assert estimate_noise(runs(TRUE), PAPER.target_arclength, fair).notes == ()


def test_a_tracker_that_repeats_a_pose_is_not_taken_for_exact():
    arm = paper_arm()
    (run, *_) = runs(TRUE)
    frames = len(run.stamp_ns)
    stuck = np.full((frames, 3), [0.11, 0.0, 0.0]) + 1e-12 * np.arange(frames)[:, None] ** 2
    found = estimate_noise([replace(run, tip_pose=stuck)], arm.target_arclength, arm.sensors)
    assert found.noise.heading_std == LEAST_TARGET


def test_a_load_that_several_frames_share_is_read_once():
    seldom = []
    for run in runs(TRUE, frames=5 * FRAMES):
        if not run.loaded:
            seldom.append(run)
            continue
        read = np.arange(2, len(run.stamp_ns), 5)  # in the middle of the frames that have it
        nearest = read[np.minimum(np.arange(len(run.stamp_ns)) // 5, read.size - 1)]
        seldom.append(
            replace(
                run,
                force=run.force[nearest],
                moment=run.moment[nearest],
                wrench_stamp_ns=run.stamp_ns[read],
                wrench=np.column_stack([run.force, run.moment])[read],
            )
        )
    found = estimate_noise(seldom, PAPER.target_arclength, ASSUMED).noise
    assert found.force_std == pytest.approx(TRUE.force_std, rel=0.15)
