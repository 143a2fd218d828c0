"""Whether an arm is late because it has mass: which of two investigations is believed."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.calibration.motion.motion_fit import MotionFit
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis import late_arm
from pneunet_ros.diagnosis.conclusion import withdraw_name
from pneunet_ros.diagnosis.diagnosis import investigate
from pneunet_ros.diagnosis.fit.hypothesis import hypothesis
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.diagnosis.late_arm import with_late_arm
from pneunet_ros.effects.arm_size import ArmSize
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.motion import Motion
from pneunet_ros.reports.diagnosis.tables import added_effects
import pytest
from support.lab_run import run_of, true_model

FIT = MotionFit(
    motion=Motion(tip_mass=0.001, damping_time=0.03),
    tip_mass_std=1e-4,
    damping_time_std=1e-3,
    hertz=1.2,
    decay_time=1.0,
    still_rms=1e-3,
    moving_rms=1e-4,
    in_motion=100,
    frames=120,
)
SCENARIO = load_scenario(share_path('scenarios/unloaded_ramp.yaml'))


@pytest.fixture(scope='module')
def nothing():
    """Return an investigation of an arm that lacks nothing, and its recording."""
    given = replace(SCENARIO, protocol=replace(SCENARIO.protocol, duration=30.0))
    run = run_of(simulate(given)).without_load()
    return investigate(true_model(SCENARIO), [run], [], seed=1), [run]


def judged(found, log_probability, predicted=0.0, names=(), answer=None):
    """Return an investigation as if its best set explained the recordings so well."""
    record = replace(
        found.best.record, names=names, log_probability=log_probability, predicted=predicted
    )
    best = replace(found.best, record=record)
    diagnosis = found.diagnosis
    if answer is not None:
        diagnosis = replace(diagnosis, answer=answer)
    return replace(found, best=best, diagnosis=diagnosis)


@pytest.fixture
def asked(nothing, monkeypatch):
    """Ask of a late camera, against recordings less a swing that are so much more probable."""
    found, runs = nothing
    monkeypatch.setattr(late_arm, 'fit_motion', lambda *args, **kwargs: FIT)
    monkeypatch.setattr(late_arm, 'without_swing', lambda arm, motion, runs: runs)
    late = judged(found, 0.0, names=(CameraDelay.name,), answer='named')

    def ask(gained, *, start=late, held_out=(), searched=None, **moving):
        calls = []

        def search(*recordings, allowed):
            calls.append(allowed)
            return judged(found, gained, **moving)

        return with_late_arm(start, searched or search, runs, held_out), calls

    return ask


def names_of(found):
    return [item.name for item in found.diagnosis.effects]


def test_a_swing_that_makes_the_recordings_more_probable_is_named(asked):
    found, calls = asked(100.0)
    assert (found.diagnosis.answer, names_of(found)) == ('named', ['inertia'])
    assert found.diagnosis.after.arm.motion == FIT.motion
    assert len(calls) == 2  # once more without the late camera, which is not found any more
    assert found.diagnosis.detectable['inertia'].smallest == pytest.approx(2e-3)


def test_a_late_camera_stays_one_where_a_swing_explains_less(asked):
    found, _ = asked(-100.0)
    assert found.diagnosis.answer == 'named'
    assert 'inertia' not in (*names_of(found), *found.diagnosis.alternatives)


def test_what_explains_as_well_is_an_alternative(asked):
    found, _ = asked(0.5)
    assert found.diagnosis.answer == 'inseparable'
    assert found.diagnosis.alternatives == ('inertia',)


def test_a_swing_that_leaves_something_is_a_note_and_no_name(asked):
    found, calls = asked(100.0, names=('gravity',), answer='unknown')
    assert names_of(found) == []
    assert len(calls) == 2  # once more, with what was found beside it
    assert found.diagnosis.notes[-1].reason == 'closest'


@pytest.mark.parametrize(
    ('gains', 'rounds', 'believed'),
    [([0.0, 2.0], 2, 1), ([0.0, 9.0, 18.0, 17.0], 4, 2), ([0.0, 9.0, 18.0, 27.0, 36.0], 5, 4)],
)
def test_mass_is_fitted_while_the_recordings_become_more_probable(
    nothing, monkeypatch, gains, rounds, believed
):
    """A camera that is late as well takes a part of the damping with it in each round."""
    fits = iter([replace(FIT, hertz=float(which)) for which in range(rounds)])
    monkeypatch.setattr(late_arm, 'fit_motion', lambda *args, **kwargs: next(fits))
    monkeypatch.setattr(late_arm, 'without_swing', lambda arm, motion, runs: runs)
    left = [100.0 + gain for gain in gains]

    def search(*recordings, allowed):
        names = (CameraDelay.name,)
        return judged(nothing[0], left.pop(0), names=names, answer='named')

    late = judged(nothing[0], 0.0, names=(CameraDelay.name,), answer='named')
    moving = late_arm.subtract_motion(late, search, nothing[1], [])
    assert not left
    assert moving.fit.hertz == believed


def test_a_swing_that_held_out_recordings_do_not_show_is_no_name(asked, nothing):
    found, _ = asked(100.0, held_out=nothing[1], predicted=-1.0)
    assert names_of(found) == []
    assert found.diagnosis.notes[-1].reason == 'closest'


def test_mass_is_not_asked_of_an_arm_that_is_not_late(asked, nothing):
    found, calls = asked(100.0, start=nothing[0])
    assert not calls
    assert math.isinf(found.diagnosis.detectable['inertia'].smallest)


def test_mass_is_fitted_beside_what_was_found_without_it(nothing, monkeypatch):
    """Its numbers as well: a camera that stands for the damping comes to be less late."""
    found, runs = nothing
    asked = hypothesis(CameraDelay, ArmSize())
    refit = replace(found.best.refit, hypotheses=(asked,), numbers=np.array([0.05]))
    best = replace(found.best, refit=refit, record=replace(found.best.record, names=(asked.name,)))
    bare, swung = found.diagnosis.after.arm, []
    arm = replace(bare, effects=(CameraDelay(delay=0.05),), covariance=None)

    def fit(arm, runs, *, perturbed_arms, **kwargs):
        swung.extend(perturbed_arms)
        return replace(FIT, shares=(-0.4,))

    def without_swing(arm, *args):
        swung.append(arm)
        return runs

    monkeypatch.setattr(late_arm, 'fit_motion', fit)
    monkeypatch.setattr(late_arm, 'without_swing', without_swing)
    monkeypatch.setattr(late_arm, 'augment_model', lambda *args: arm)
    monkeypatch.setattr(late_arm, 'fit_with_effects', lambda *args: None)
    late_arm.subtract_motion(
        replace(found, best=best), lambda *args, allowed: judged(found, 0.0), runs, []
    )
    assert [one.frame_delay for one in swung[:3]] == pytest.approx([0.051, 0.01, 0.01])


def test_a_late_camera_stays_one_where_no_mass_explains_it(asked, monkeypatch):
    def fit(*args, **kwargs):
        raise RequestError('too light', reason='wrong_weight')

    monkeypatch.setattr(late_arm, 'fit_motion', fit)
    found, calls = asked(100.0)
    assert not calls
    assert (found.diagnosis.answer, names_of(found)) == ('named', [])


def test_a_name_that_is_taken_back_is_said_with_the_reason(asked):
    found, _ = asked(100.0)
    taken = withdraw_name(found, 'a push says it better')
    assert (taken.answer, taken.effects) == ('unknown', ())
    assert 'inertia' in taken.sentence
    assert [note.reason for note in taken.notes if note.endswith('a push says it better')] == [
        'closest'
    ]


def test_its_report_shows_the_model_after(asked):
    assert added_effects(asked(100.0)[0].diagnosis) == ['inertia']
    assert added_effects(asked(-100.0)[0].diagnosis) == []


def test_before_and_after_are_whitened_by_the_same_noise(asked, nothing):
    """A swing that is taken for noise makes what is left beside it look small."""
    found = nothing[0]
    noise = replace(
        found.selection.linearization.noise,
        target_std=0.5 * found.selection.linearization.noise.target_std,
    )
    known = found.selection.linearization
    quiet = Linearization(found.base.refit.point, known.runs, known.training, noise)
    less = replace(found, selection=replace(found.selection, linearization=quiet))

    moving, _ = asked(100.0, searched=lambda *_, allowed: judged(less, 100.0))
    before = moving.diagnosis.before.training.chi_squared
    assert found.diagnosis.before.training.chi_squared == pytest.approx(1.0, abs=0.1)
    assert before == pytest.approx(4.0, rel=0.2)
    assert moving.diagnosis.adequacy_before.p_value < 1e-3


def test_the_evidence_has_a_row_of_inertia_whether_it_is_named_or_not(asked):
    for gained in (100.0, 0.5, -100.0):
        found, _ = asked(gained)
        (row,) = (item for item in found.diagnosis.evidence if 'inertia' in item.effects)
        assert row.evidence == pytest.approx(found.best.record.evidence + gained, abs=1.0)
