"""What a name requires besides passing the tests, requirement by requirement, on made records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks.held_out import Score
from pneunet_ros.diagnosis.confirmation import Confirmer, error_increase
from pneunet_ros.diagnosis.scores.lack_of_fit import LackOfFit
from pneunet_ros.diagnosis.selection import parameters_outside_prior, Record
from pneunet_ros.diagnosis.settings import DEFAULTS
import pytest
from support.lab_designs import fitted
from support.refusals import reasons

TRAINING = ('lab/ramp.mcap', 'lab/strings.mcap', 'lab/sweeps.mcap')
COORDINATES = 100  # of a run
BAD = LackOfFit(name='training: windows of time', statistic=90.0, dof=9, mean=9.0, std=4.0)


def record(*names: str, fall: float = 0.0, chi_squared: float = 1.0, **changes) -> Record:
    """Return a record of three training runs and a held-out one of which all speaks for it.

    fall: of chi squared in the held-out run; chi_squared: per coordinate of the training ones.
    """
    residual = np.full(COORDINATES, 1.0 if names else 3.0)
    whole = 0.0 if not names else 900.0
    values = {
        'names': names,
        'dof': len(names),
        'evidence': whole,
        'gain': 2.0 * whole,
        'tests': (replace(BAD, statistic=9.0),),
        'adequate': True,
        'plausible': True,
        'run_chi_squared': (
            *(COORDINATES * chi_squared for _ in TRAINING), float(residual @ residual) - fall
        ),
        'coordinates': (COORDINATES,) * (1 + len(TRAINING)),
        'log_probability': whole,
        'without': (2.0 / 3.0 * whole,) * len(TRAINING),
        'predicted': 0.5 * fall + (0.0 if not names else 400.0),
    }  # fmt: skip
    return Record(**(values | changes))


BASE = record(chi_squared=9.0)


def confirmer(*tried: Record, base: Record = BASE) -> Confirmer:
    return Confirmer(base=base, tried=(base, *tried), training=TRAINING, settings=DEFAULTS)


def objections(best: Record, *others: Record, alternatives: tuple[str, ...] = ()) -> list[str]:
    return reasons(confirmer(best, *others).objections(best, alternatives))


def test_what_all_speaks_for_keeps_its_name():
    best = record('creep')
    found = confirmer(best)
    assert (found.objections(best), found.untested(best)) == ((), ())


def test_a_law_may_leave_little_and_no_more():
    assert objections(record('creep', chi_squared=1.8, tests=(BAD,))) == []
    assert objections(record('creep', chi_squared=7.7, tests=(BAD,))) == ['misfit']
    # Wide priors of few frames: chi squared alone says nothing.
    assert objections(record('creep', chi_squared=7.7)) == []


@pytest.mark.parametrize('fall', [-900.0, -3.0, 0.0, 2.6, 2.8, 80.0])
@pytest.mark.parametrize('predicted', [-40.0, 0.0, 1.3, 1.4, 400.0])
@pytest.mark.parametrize('strong', [9.0, 4000.0])
def test_no_name_without_a_significant_fall_on_held_out_recordings(fall, predicted, strong):
    """By the contract, however strong the effect is in the training recordings."""
    base = replace(BASE, tests=(replace(BAD, statistic=strong),))
    before = base.run_chi_squared[-1]
    best = replace(
        record('creep', predicted=predicted),
        run_chi_squared=(*base.run_chi_squared[:-1], before - fall),
    )
    found = confirmer(best, base=base)
    falls = fall >= 2.7 and 2.0 * predicted >= 2.7
    assert ('no_fall' in reasons(found.objections(best))) is not falls
    assert found.untested(best) == ()


def test_without_a_held_out_recording_nothing_new_tests_a_name():
    runs = {'run_chi_squared': (100.0,) * 3, 'coordinates': (100,) * 3}
    best = replace(record('creep'), **runs)
    found = confirmer(best, base=replace(BASE, **runs))
    assert found.objections(best) == ()
    assert reasons(found.untested(best))[0] == 'no_held_out'


def test_a_name_that_nothing_tests_is_none():
    alone = replace(confirmer(record('gravity')), training=TRAINING[:1])
    runs = {'run_chi_squared': (100.0,), 'coordinates': (100,), 'without': (0.0,)}
    best = replace(record('gravity'), **runs)
    none = replace(alone, base=replace(BASE, **runs))
    assert reasons(none.objections(best)) == ['untested']
    # Of frames that are steady states each is an experiment of its own.
    assert replace(none, steady=True).objections(best) == ()
    # A recording that comes next will test it.
    untested = replace(DEFAULTS, tested=False)
    assert replace(none, settings=untested).objections(best) == ()
    two = {'run_chi_squared': (100.0, 900.0), 'coordinates': (100, 100), 'without': (0.0,)}
    shown = replace(record('gravity'), **two | {'run_chi_squared': (100.0, 100.0)})
    base = replace(BASE, **two)
    assert replace(alone, base=base).objections(shown) == ()


def test_a_name_that_another_takes_without_a_recording_is_none():
    best = record('creep')
    other = record('hysteresis', log_probability=850.0, without=(500.0, 700.0, 550.0))
    (note,) = confirmer(best, other).objections(best)
    named = 'strings.mcap' in note and 'hysteresis' in note
    assert (note.reason, named) == ('other_name', True)
    assert objections(best, other, alternatives=('hysteresis',)) == []
    assert objections(best, replace(other, without=(500.0, 610.0, 550.0))) == []
    # One that is better with all recordings was refused for another reason.
    assert objections(best, replace(other, log_probability=1000.0)) == []


def test_an_effect_that_one_recording_alone_wants_is_no_second_one():
    both = record('creep', 'hysteresis')
    alone = record('creep', log_probability=700.0, without=(600.0, 640.0, 400.0))
    assert objections(both, alone) == ['other_name']


def test_what_hangs_on_one_recording_is_said():
    best = record('softening', without=(2.0, 600.0, 600.0))
    found = confirmer(best)
    assert found.objections(best) == ()
    (note,) = found.untested(best)
    assert (note.reason, 'ramp.mcap' in note) == ('one_recording', True)
    one = replace(confirmer(best), training=TRAINING[:1])
    assert reasons(one.stability_untested(best)) == ['one_recording']


def test_an_arm_that_may_bend_unevenly():
    needed, needless = record('creep', nonuniform=950.0), record('creep', nonuniform=102.0)
    base = replace(BASE, nonuniform=100.0)
    assert confirmer(needed, base=base).nonuniform_arm(needed) == ()
    judge = confirmer(needless, base=base)
    assert reasons(judge.nonuniform_arm(needless)) == ['uneven_arm']
    # What something else explains as well may still be what it is.
    assert judge.refutations(needless) == ()


@pytest.mark.parametrize(('factor', 'count'), [(1.0, 0), (1.9, 0), (2.05, 0), (2.4, 1)])
def test_every_parameter_lies_within_its_prior(factor, count):
    # 6 mm; its prior ends at 12 mm, and its law is known to 5 %.
    fit = fitted('load_offset', 'load_offset')
    found = parameters_outside_prior(replace(fit, numbers=factor * fit.numbers))
    assert len(found) == count
    assert all('load_offset.offset = ' in sentence for sentence in found)


def scored(error: np.ndarray) -> list[Score]:
    """Return the score of a held-out recording with errors (frames, 2, targets) m."""
    return [Score(name='held out', rms=0.0, p95=0.0, missing=0.0, error=error)]


def test_a_model_that_is_surely_worse_on_held_out_recordings_has_no_name():
    random = np.random.default_rng(3)
    noise = random.normal(0.0, 2e-4, (80, 2, 12))
    noise[3, :, 4] = np.nan
    misfit = 4e-4 * np.sin(np.arange(80) / 5.0)[:, None, None] * np.linspace(0.0, 1.0, 12)
    good, bad = scored(noise), scored(noise + misfit)
    assert error_increase(bad, good) == ''
    assert error_increase(good, good) == ''
    risen = error_increase(good, bad)
    assert ('0.198 ' in risen, '0.256 ' in risen) == (True, True)
    once = noise.copy()
    once[70] *= 12.0  # one frame says nothing of the others
    assert error_increase(good, scored(once)) == ''
    few = [scored(item[:3]) for item in (noise, noise + 1e-2)]
    assert error_increase(*few) == ''
