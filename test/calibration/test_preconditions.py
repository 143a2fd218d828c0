"""Recordings that cannot give a calibration are refused in a sentence that says what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks import consistency
from pneunet_ros.calibration.checks.consistency import (
    check_same_arm,
    describe_misfit,
    describe_pressure_noise,
    has_rested,
    outlier_recordings,
    tip_distance,
)
from pneunet_ros.calibration.checks.preconditions import (
    check_different_loads,
    check_meaning,
    check_runs,
    check_unloaded,
)
from pneunet_ros.calibration.motion.swinging_run import has_constant_inputs
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
import pytest
from support.example_arms import paper_arm
from support.made_datasets import experiments, made, USUAL
from support.refusals import reasons, refused

PAPER = paper_arm()
FREE, LOADED = experiments(PAPER, USUAL, frames=30)


def bent(run, **changes):
    return replace(run, **changes)


def scaled(run, targets=1.0, pressure=1.0, force=1.0):
    return bent(
        run,
        x=targets * run.x,
        y=targets * run.y,
        pressure=pressure * run.pressure,
        force=force * run.force,
    )


def still(run):
    first = np.zeros(len(run.x), dtype=int)
    return bent(run, x=np.nan_to_num(run.x)[first], y=np.nan_to_num(run.y)[first])


def hanging(run):
    return bent(run, pressure=np.full_like(run.pressure, 2e4))


def at_one_pressure():
    return made(PAPER, np.full(30, 2e4), noise=USUAL, name='one.mcap')


def few_targets(run):
    x = np.array(run.x)
    x[:, 3:] = np.nan
    return bent(run, x=x)


def test_good_recordings_pass():
    check_runs(FREE, LOADED, PAPER)
    check_runs(FREE, [], PAPER)
    check_runs([], LOADED, PAPER, first=False)


def test_a_gauge_pressure_above_that_of_the_air_is_one_of_a_model_known_there():
    table, law = (
        replace(part, pressure=part.pressure + 1e5)
        for part in (PAPER.intrinsic_curvature, PAPER.moment_law)
    )
    stiff = replace(PAPER, intrinsic_curvature=table, moment_law=law, domain=None)
    check_runs([bent(FREE[0], pressure=FREE[0].pressure + 101_325.0)], [], stiff)


@pytest.mark.parametrize(
    ('free', 'loaded', 'sentence'),
    [
        ([], LOADED, 'no unloaded recording: .* --unloaded'),
        ([], [], 'no unloaded recording'),
        (
            [at_one_pressure()],
            [],
            'pressure spans 0.* kPa in one.mcap: .*at least two pressures; record a ramp',
        ),
        ([LOADED[0]], [], 'weights was given as unloaded, but its end force .*--loaded'),
        (FREE, [FREE[0]], 'up was given as loaded, but its end force .*--unloaded'),
        (
            FREE,
            [FREE[0].with_end_load(0.0, 0.0)],
            'up was given as loaded, but its end force .*--unloaded',
        ),
        ([still(FREE[0])], [], 'up: the targets hardly move although the pressure changes'),
        (FREE, [still(LOADED[1])], 'low sweep: the targets hardly move'),
        ([scaled(FREE[0], targets=1e3)], [], 'up: a target .* m from the clamp.*must be in m'),
        ([scaled(FREE[0], targets=1e-3)], [], 'up: the last target lies .* Is the unit right'),
        (
            [scaled(FREE[0], targets=0.1)],
            [],
            'up: the row of targets is never longer than 0.1 tim',
        ),
        ([hanging(FREE[0])], [], 'up: the pressure stays at 20 kPa, but the unloaded arm'),
        ([FREE[0], hanging(FREE[1])], [], 'down: the pressure stays at 20 kPa'),
        ([hanging(FREE[0])], [hanging(LOADED[0])], 'up: the pressure stays at 20 kPa'),
        ([scaled(FREE[0], pressure=1e3)], [], 'up: a pressure of .* gauge, in Pa'),
        ([scaled(FREE[0], pressure=1e-3)], [], 'up: .*most likely gauge kPa.*--pressure-unit kPa'),
        (
            [bent(FREE[0], pressure=FREE[0].pressure + 101_325.0)],
            [],
            'up: .*most likely absolute Pa.*--pressure-reference absolute',
        ),
        ([scaled(FREE[0], pressure=-1e-3)], [], 'up: .*--pressure-unit kPa --pressure-sign -1'),
        (FREE, [scaled(LOADED[0], force=1e3)], 'weights: an end force .* must be in N'),
        (
            [bent(FREE[0], x=FREE[0].x[:, 1:], y=FREE[0].y[:, 1:])],
            [],
            'up has 22 targets, but the',
        ),
        ([FREE[0].thin(2)], [], 'up: 2 frames .* need at least 3'),
        ([few_targets(FREE[0])], [], 'up shows fewer than 4 targets, and never the last'),
    ],
)
def test_what_cannot_be_calibrated_is_refused(free, loaded, sentence):
    with pytest.raises((RecordingError, RequestError), match=sentence):
        check_runs(free, loaded, PAPER)


def test_what_pressures_most_likely_mean_is_said_against_what_was_declared():
    declared = PressureConvention(unit='kPa', reference='absolute')
    low = bent(FREE[0], pressure=FREE[0].pressure - declared.ambient)
    with refused(RecordingError, 'other_pressure'):
        check_runs([low], [], PAPER, declared=declared)
    check_runs([FREE[0]], [], PAPER, declared=declared)
    check_runs([low], [], PAPER, declared=None)


def test_zero_between_two_recordings_is_zero_whichever_comes_first():
    """Vacuum and pressure in a recording each: not a gauge whose zero was never set."""
    share = np.linspace(0.0, 1.0, FREE[0].pressure.size)
    noise = 60.0 * np.random.default_rng(1).standard_normal(share.size)
    vacuum = bent(FREE[0], pressure=40e3 * (share - 1.0) + noise)
    pressed = bent(FREE[0], pressure=40e3 * share + noise)
    for runs in ([vacuum, pressed], [pressed, vacuum]):
        check_meaning(runs, PressureConvention(), PAPER, moves=True)
    never = [bent(FREE[0], pressure=one.pressure - 20e3) for one in (pressed, pressed)]
    with refused(RecordingError, 'other_pressure'):
        check_meaning(never, PressureConvention(), PAPER, moves=True)


def test_loads_that_differ_by_their_moment_are_different():
    one = at_one_pressure()
    moment = np.repeat([0.0, 1e-3], one.pressure.size // 2)
    noise = 1e-5 * np.sin(np.arange(one.pressure.size))
    loads = np.column_stack([one.force, moment])
    assert has_constant_inputs(one, np.column_stack([one.force, noise]), PAPER)
    assert not has_constant_inputs(one, loads, PAPER)
    check_different_loads([bent(one, moment=moment)], PAPER)
    with refused(RecordingError, 'one_load'):
        check_different_loads([bent(one, moment=noise)], PAPER)


def test_a_known_load_is_a_load_however_heavy_the_arm():
    heavy = replace(PAPER, weight=100.0 * PAPER.weight)
    check_unloaded(FREE[0].with_end_load(0.0, 0.0), heavy)
    with refused(RecordingError, 'loaded'):
        check_unloaded(FREE[0].with_end_load(0.05, 0.0), heavy)


def test_noise_of_a_force_sensor_is_no_load_of_a_light_arm():
    light = replace(PAPER, weight=0.04, sensors=USUAL)
    offset = 0.1 * light.weight
    read = bent(FREE[0], loaded=True, force=np.zeros_like(FREE[0].force))
    noise = 1.5 * USUAL.force_std * np.random.default_rng(3).standard_normal(read.force.shape)
    noisy = bent(read, force=noise + np.array([offset, 0.0]))
    assert np.abs(noisy.force).max() > 0.12 * light.weight
    check_unloaded(noisy, light)
    # A force that swings about zero, and one of a moment.
    frames = np.arange(len(noise))
    swing, touch = np.sin(6.28 * frames / frames.size), frames == 7
    swept, touched = (
        bent(read, force=noise + 0.02 * np.outer(course, [1.0, 0.0])) for course in (swing, touch)
    )
    for run in (swept, touched):
        with refused(RecordingError, 'loaded'):
            check_unloaded(run, light)


def other_arm(factor: float):
    table = PAPER.intrinsic_curvature
    return replace(PAPER, intrinsic_curvature=replace(table, curvature=factor * table.curvature))


def test_recordings_of_different_arms_are_refused():
    stranger = made(other_arm(0.85), np.linspace(0, 6e4, 30), noise=USUAL, name='stranger')
    with refused(RecordingError, 'inconsistent'):
        check_runs([FREE[0], stranger, FREE[1]], [], PAPER)


def test_the_past_of_an_arm_is_no_other_arm():
    arm = paper_arm((Hysteresis(width=8e3),))
    up = np.linspace(0, 6e4, 40)
    loop = made(arm, np.concatenate([up, up[::-1]]), noise=USUAL, name='loop')
    down = made(arm, up[::-1], noise=USUAL, name='down', start=200)
    check_same_arm([loop, made(arm, up, noise=USUAL, name='up', start=400), down], arm.length)


def test_a_line_that_fills_slowly_is_no_other_arm(monkeypatch):
    arm = paper_arm((PressureLag(time_constant=0.4),))
    levels = np.array([0.0, 5e4, 1e4, 6e4, 2e4, 3e4])
    one, other = (
        made(arm, np.repeat(order, 60), noise=USUAL, name=name, start=start)
        for order, name, start in ((levels, 'one', 0), (levels[::-1], 'other', 900))
    )
    top = float(levels.max())
    rested = tip_distance(one, other, top)
    with monkeypatch.context() as anywhere:
        anywhere.setattr(consistency, 'REST', 0.0)
        moving = tip_distance(one, other, top)
    assert moving is not None
    assert rested is not None
    assert rested < 0.03 * arm.length < moving
    check_same_arm([one, other], arm.length)


def test_a_film_whose_stamps_are_early_shows_no_other_arm(monkeypatch):
    levels = np.array([0.0, 5e4, 1e4, 6e4, 2e4, 3e4])
    made_runs = [
        made(PAPER, np.repeat(order, 15), noise=USUAL, name=name)
        for order, name in ((levels, 'one'), (levels[::-1], 'other'))
    ]
    # Each frame shows what comes a frame later: the last one of each level the next level.
    early = [replace(run, x=np.roll(run.x, -1, 0), y=np.roll(run.y, -1, 0)) for run in made_runs]
    top = float(levels.max())
    with monkeypatch.context() as at_once:
        at_once.setattr(consistency, 'EARLY', 0.0)
        without = tip_distance(*early, top)
    assert without is not None
    assert without > 0.06 * PAPER.length
    check_same_arm(early, PAPER.length)


def test_quick_steps_of_a_late_film_and_a_slow_ramp_are_one_arm():
    levels = np.repeat([0.0, 5e4, 1e4, 6e4, 2e4, 3e4], 15)
    steps = made(PAPER, levels, noise=USUAL, name='steps')
    # Each frame shows what was two frames before: 0.2 s, the most for camera_delay.
    late = replace(steps, x=np.roll(steps.x, 2, 0), y=np.roll(steps.y, 2, 0))
    up = np.linspace(0.0, 6e4, 150)
    ramp = made(PAPER, np.concatenate([up, up[::-1]]), noise=USUAL, name='ramp', start=900)
    top = float(up.max())
    assert has_rested(late, top).sum() > consistency.FEWEST_PAIRS > has_rested(ramp, top).sum()
    check_same_arm([late, ramp], PAPER.length)
    stranger = made(other_arm(0.85), up, noise=USUAL, name='stranger', start=1900)
    with refused(RecordingError, 'inconsistent'):
        check_same_arm([late, stranger], PAPER.length)


def test_one_recording_or_none_in_common_is_one_arm():
    check_same_arm([], 0.1)
    low, high = (
        made(other_arm(factor), np.linspace(*span, 30))
        for factor, span in ((1.0, (0.0, 2e4)), (0.8, (3e4, 6e4)))
    )
    check_same_arm([low, high], 0.112)


class Some:
    """A fitted run of fifty frames, as bad as chi squared per coordinate says."""

    def __init__(self, name, chi):
        self.run = replace(FREE[0], name=name)
        self.dof = np.full(50, 100)
        self.whitened = 100.0 * chi * np.ones(50)
        self.residual, self.solved = np.full((50, 2, 3), 1e-3), np.ones(50, np.bool_)


def fit_of(*runs):
    chi_squared, dof = (sum(float(values.sum()) for values in parts) for parts in (
        [run.whitened for run in runs], [run.dof for run in runs]
    ))  # fmt: skip
    values = dict.fromkeys(Fit.__dataclass_fields__)
    return Fit(**(values | {'runs': runs, 'chi_squared': chi_squared, 'dof': dof}))


def test_a_recording_that_does_not_fit_the_others_is_named():
    runs = [Some(name, chi) for name, chi in (('a', 1.1), ('b', 30.0), ('c', 0.9))]
    (note,) = outlier_recordings(fit_of(*runs))
    assert (note.reason, note.split()[0]) == ('outlier', 'b')
    assert outlier_recordings(fit_of(runs[0])) == []
    assert reasons(describe_misfit(fit_of(*runs))) == ['misfit']
    assert describe_misfit(fit_of(runs[0], runs[2])) == []


def test_a_few_frames_that_are_missed_are_no_missing_effect():
    bad, good = Some('a', 1.0), Some('b', 1.1)
    bad.whitened[[7, 30]] = 3e4, 9e4
    fit = fit_of(bad, good)
    (note,) = describe_misfit(fit)
    assert (note.reason, note[:8]) == ('few_misfit', '2 of 100')
    assert outlier_recordings(fit) == []
    bad.whitened[:10] = 3e4
    assert reasons(describe_misfit(fit_of(bad, good))) == ['misfit']
    assert len(outlier_recordings(fit_of(bad, good))) == 1


def test_a_short_recording_that_does_not_fit_is_no_few_frames():
    short = Some('short', 500.0)
    for name in ('whitened', 'dof', 'residual', 'solved'):
        setattr(short, name, getattr(short, name)[:2])
    fit = fit_of(short, *(Some(name, 1.0) for name in 'abcdef'))
    assert reasons(outlier_recordings(fit)) == ['outlier']
    assert reasons(describe_misfit(fit)) == ['misfit']


@pytest.mark.parametrize(('std', 'said'), [(1000.0, False), (1500.0, True)])
def test_a_pressure_with_much_noise_is_said_to_bias(std, said):
    assert reasons(describe_pressure_noise(std, 6.5e4)) == ['noisy_pressure'] * said
    assert describe_pressure_noise(std, 0.0) == []
