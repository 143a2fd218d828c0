"""From recordings to a name, one effect of each place: a few frames of three recordings each."""

from __future__ import annotations

from pneunet_ros.effects import EFFECTS
from pneunet_ros.exploration.proposal import diagnose
import pytest
from support.lab_designs import frame, HELD_OUT, HIDDEN, recorded

FRAMES = 24  # of a recording
# What shows the effect, beside the unloaded ramp.
SHOWN_BY = {
    'force_misalignment': 'strings',
    'hysteresis': 'unloaded_staircase',
    'softening': 'strings',
    'extensibility': 'strings',
}


def test_every_place_of_an_effect_is_among_them():
    places = {EFFECTS[name].place for name in SHOWN_BY}
    others = {'motion'}  # of an arm that MuJoCo moves: test_inertia_diagnosis
    assert places | others == {effect.place for effect in EFFECTS.values()}


@pytest.mark.parametrize('name', SHOWN_BY)
def test_a_hidden_effect_is_named_with_its_size(name):
    runs = {run.name: run.thin(FRAMES) for run in recorded(name)}
    training = [runs['unloaded_ramp'], runs[SHOWN_BY[name]]]
    diagnosis = diagnose(frame(), training, [runs[HELD_OUT]], seed=3)
    assert diagnosis.answer == 'named'
    (effect,) = diagnosis.effects
    assert effect.name == name
    ((parameter, true),) = HIDDEN[name].items()
    size = effect.parameters[parameter]
    assert abs(size.value - true) < 4.0 * size.std
    assert size.std < 0.15 * true
    assert diagnosis.alternatives == ()
    assert diagnosis.adequacy_before.p_value < 1e-4
    assert diagnosis.adequacy_after.p_value > 0.002
    assert diagnosis.after.held_out.rms < diagnosis.before.held_out.rms
    assert [type(item) for item in diagnosis.after.arm.effects] == [EFFECTS[name]]
