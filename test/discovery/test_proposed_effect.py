"""The file of a proposed effect: for every kind of cause and every covariate it may follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.units import quantities
from pneunet_ros.diagnosis.fit.generic_field import high_pass
from pneunet_ros.discovery.covariates import (
    CONSTANT,
    Covariate,
    MEANINGS,
    PLAY,
    RATE,
    RATE_TIME,
    side_of_play,
)
from pneunet_ros.discovery.kinds import KINDS
from pneunet_ros.discovery.proposed_effect import effect_class, effect_source, parameter_of
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect, PressureScale
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.user_effects import add_effects, contract_violation
from pneunet_ros.files.model_file import load_model, save_model
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.equilibrium import solve
import pytest
from support.example_arms import paper_arm

LENGTH, PLAY_WIDTH = 0.112, 1300.0
SCALE = PressureScale(rows=(0.0, 30e3, 66e3), top=66e3, std=60.0)
SCALES = {'p': 6e4, 'p^2': 3.6e9, RATE: 2e4, 'F1': 0.2, 'F2': 0.2, '|F|': 0.2}
SCALES |= {name: 3e4 for name in MEANINGS if name.startswith('past')}
SCALES |= {'p F1': 1e4, 'p F2': 1e4, 't': 30.0}
COVARIATES = {
    name: Covariate(
        name=name, values=(np.full(3, SCALES.get(name, 1.0)),), scale=SCALES.get(name, 1.0)
    )
    for name in MEANINGS
}
CASES = [
    (kind, term)
    for kind in KINDS.values()
    for term in (*MEANINGS, *kind.natives)
    if term in kind.natives or MEANINGS[term].group in kind.follows or term == CONSTANT
]
every_kind = pytest.mark.parametrize('kind', KINDS.values(), ids=KINDS)


def source_of(kind, terms):
    """Return the text of a file with these terms."""
    parameters = [parameter_of(kind, term, COVARIATES) for term in terms]
    return effect_source(kind, parameters, 'It goes.', length=LENGTH, play=PLAY_WIDTH)


def all_terms(kind):
    """Return every term that an effect of a kind may have."""
    return tuple(term for other, term in CASES if other is kind)


@every_kind
def test_each_term_and_all_of_them_together_keep_the_contract_of_effects(kind):
    for terms in (*((term,) for term in all_terms(kind)), all_terms(kind)):
        text = source_of(kind, terms)
        effect = effect_class(text)
        assert contract_violation(effect) == ''
        shapes = [item for item in quantities(effect) if item.metadata['shape']]
        assert len(quantities(effect)) == len(terms) + len(shapes)
        assert all(len(line) <= 99 for line in text.splitlines())


@every_kind
def test_a_neutral_proposal_is_the_base_model_and_a_likely_one_is_not(kind):
    force = 0.12, 0.05
    base = solve(paper_arm(), 30e3, force, 1e-4)
    neutral = solve(
        paper_arm((effect_class(source_of(kind, all_terms(kind)))(),)), 30e3, force, 1e-4
    )
    assert same_values(neutral.x, base.x)
    assert same_values(neutral.y, base.y)
    for term in all_terms(kind):
        effect = effect_class(source_of(kind, (term,)))
        at_rest = term in MEANINGS and MEANINGS[term].group == 'past'
        if kind.method in ('see', 'frame_delay') or at_rest:
            continue
        parameter = quantities(effect)[0]
        likely = effect(**{parameter.name: 0.2 * parameter.metadata['prior'][1]})
        moved = solve(paper_arm((likely,)), 30e3, force, 1e-4)
        assert abs(moved.tip[0] - base.tip[0]) + abs(moved.tip[1] - base.tip[1]) > 1e-7


def recorded() -> RecordingData:
    """Return a run with pressure up, a hold, and down, a frame per reading."""
    seconds = np.arange(0.0, 20.0, 0.25)
    pressure = np.interp(seconds, [0.0, 6.0, 12.0, 18.0], [5e3, 50e3, 50e3, 12e3])
    stamps = (1e9 * seconds).astype(np.int64)
    nothing = np.zeros(seconds.size)
    return RecordingData(
        name='run',
        reading_stamp_ns=stamps,
        pressure=pressure,
        stamp_ns=stamps,
        reading=np.arange(seconds.size),
        loaded=False,
        force=np.zeros((seconds.size, 2)),
        moment=nothing,
        x=np.zeros((seconds.size, 2)),
        y=np.zeros((seconds.size, 2)),
    )


def chambers(effect: Effect, run: RecordingData) -> np.ndarray:
    """Return the chamber pressure that an effect makes of a run."""
    history, out = effect.initial(float(run.pressure[0]), SCALE), []
    steps = np.diff(run.reading_stamp_ns, prepend=run.reading_stamp_ns[0]) / 1e9
    for seconds, pressure in zip(steps.tolist(), run.pressure.tolist(), strict=True):
        history, chamber = effect.actuate(history, seconds, pressure, SCALE)
        out.append(chamber)
    return np.array(out)


@pytest.mark.parametrize(
    ('term', 'covariate'),
    [
        (PLAY, lambda run: side_of_play(run, PLAY_WIDTH)),
        ('side of a wide play', lambda run: side_of_play(run, 2.0 * PLAY_WIDTH)),
        (RATE, lambda run: high_pass(run, RATE_TIME) / RATE_TIME),
        ('past 3 s', lambda run: high_pass(run, 3.0)),
        ('past 30 s', lambda run: high_pass(run, 30.0)),
    ],
)
def test_a_file_follows_the_past_as_the_law_that_it_is_made_of_does(term, covariate):
    run = recorded()
    effect = effect_class(source_of(KINDS['chamber_pressure'], (term,)))
    name = quantities(effect)[0].name
    added = chambers(effect(**{name: 0.1}), run) - run.pressure
    assert added == pytest.approx(0.1 * covariate(run), abs=1e-6)


def test_covariates_of_the_past_are_those_of_the_effects_of_the_library():
    run = recorded()
    play = run.pressure - chambers(Hysteresis(width=PLAY_WIDTH), run)
    assert side_of_play(run, PLAY_WIDTH) == pytest.approx(play / (0.5 * PLAY_WIDTH))
    line = run.pressure - chambers(PressureLag(time_constant=3.0), run)
    assert high_pass(run, 3.0) == pytest.approx(line, abs=1e-6)
    # Frames that are steady states have no past.
    assert not side_of_play(replace(run, static=True), PLAY_WIDTH).any()
    assert not high_pass(replace(run, static=True), 3.0).any()


def test_a_file_is_loaded_by_its_path_and_a_model_file_has_it(tmp_path):
    folder = Path(tmp_path) / 'effects'
    folder.mkdir()
    (folder / 'proposed_push.py').write_text(source_of(KINDS['push'], (CONSTANT, 'p', 'F1')))
    (effect,) = add_effects(folder)
    try:
        arm = paper_arm((effect(constant=0.03, per_pressure=1e-7, position=0.62),))
        save_model(arm, tmp_path / 'model.yaml')
        assert load_model(tmp_path / 'model.yaml').effects == arm.effects
        # The next proposal of this kind has another name.
        assert "'proposed_push_2'" in source_of(KINDS['push'], (CONSTANT,))
    finally:
        del EFFECTS[effect.name]
