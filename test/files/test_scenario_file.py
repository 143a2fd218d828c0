"""Scenario files: what they mean, and that every mistake in one is a sentence."""

from __future__ import annotations

from pathlib import Path
import shutil

from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import changes_of, load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.protocols import Strings
from pneunet_ros.lab.scenario import describe
import pytest
from support.lab_pairs import recorded
from support.refusals import refused

FOLDER = share_path('scenarios')
PROTOCOL = 'protocol: {kind: slow_ramp}\n'
HEAD = 'schema_version: 1\nname: mine\narm: lab_arm.yaml\n'


@pytest.fixture
def load(tmp_path):
    """Load a scenario from its text, beside the shipped arm."""
    shutil.copy(FOLDER / 'lab_arm.yaml', tmp_path)

    def load(text):
        (tmp_path / 'mine.yaml').write_text(text)
        return load_scenario(tmp_path / 'mine.yaml')

    return load


def test_a_file_of_a_few_lines_is_enough(load):
    scenario = load(HEAD + PROTOCOL)
    assert (scenario.name, scenario.seed, scenario.start, scenario.effects) == ('mine', 0, 0.0, ())
    assert same_values(scenario.arm, recorded('strings').scenario.arm)


def test_all_keys_are_read(load):
    scenario = load(
        HEAD + 'seed: 4\nstart: 60.0\narm_seed: 3\nrichness: 0.5\n'
        'effects: {gravity: {weight_y: -1.5}, creep: {amplitude: 0.1, richness: 0.0}}\n'
        'protocol: {kind: strings, pressures: [0.0, 1.0e+3], pull_a: [0.2, 0.1], '
        'pull_b: [0.0, 0.1], angle_b: 1.2, duration: 12.0}\n'
        'noise: {target_std: 1.0e-4}\nrates: {frames: 5.0}\ndetail: {elements: 100}\n'
    )
    assert (scenario.seed, scenario.start) == (4, 60.0)
    assert same_values(scenario.arm, vary_arm(recorded('strings').scenario.arm, 3))
    creep, gravity = scenario.effects  # in the order of the table
    assert (creep.name, creep.amplitude, creep.richness) == ('creep', 0.1, 0.0)
    assert (gravity.name, gravity.weight_y, gravity.richness) == ('gravity', -1.5, 0.5)
    more = scenario.with_effects({'softening': {'loss': 0.1}, 'gravity': {'weight_x': 1.0}})
    assert [effect.richness for effect in more.effects] == [0.0, 0.5, 0.5]
    assert more.with_effects({'push': {'force': 0.1}}).effects[-1].force == 0.1
    assert scenario.protocol == Strings(
        pressures=(0.0, 1e3), pull_a=(0.2, 0.1), pull_b=(0.0, 0.1), angle_b=1.2, duration=12.0
    )
    assert (scenario.noise.target_std, scenario.noise.force_std) == (1e-4, 1e-3)
    assert (scenario.rates.frames, scenario.detail.elements) == (5.0, 100.0)


def test_the_arm_may_stand_in_the_scenario_itself(load):
    lines = (FOLDER / 'lab_arm.yaml').read_text().splitlines()
    block = ''.join(f'  {line}\n' for line in lines if not line.startswith('schema_version'))
    scenario = load(f'schema_version: 1\nname: mine\n{PROTOCOL}arm:\n{block}')
    assert same_values(scenario.arm, recorded('strings').scenario.arm)


def test_a_description_holds_all_of_a_scenario():
    scenario = recorded('strings').scenario.with_effects({'extensibility': {'richness': 1.0}})
    content = describe(scenario)
    assert content['arm']['split'] == [0.1, 0.1, 0.15, 0.15]
    assert content['effects'] == {'extensibility': {'richness': 1.0, 'axial_stiffness': 'inf'}}
    assert content['protocol']['kind'] == 'strings'
    assert content['protocol']['pull_b'][-1] == 0.275


def test_changes_are_put_over_what_is_there():
    scenario = recorded('strings').scenario.with_effects(
        changes_of(['gravity.weight_x=0.5', 'gravity.weight_y=-1'])
    )
    changed = scenario.with_effects(changes_of(['gravity.weight_x=0.25', 'creep.amplitude=0.1']))
    creep, gravity = changed.effects
    assert (gravity.weight_x, gravity.weight_y, creep.amplitude) == (0.25, -1.0, 0.1)


@pytest.mark.parametrize('text', ['gravity', 'gravity=1', 'gravity.weight_x', 'gravity.x=', '.=1'])
def test_a_change_of_another_form_is_refused(text):
    with refused(RequestError, 'wrong_form'):
        changes_of([text])


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        (HEAD, 'missing_key'),
        (HEAD + PROTOCOL + 'sead: 1\n', 'unknown_key'),
        (HEAD + PROTOCOL + 'seed: -1\n', 'not_a_number'),
        (HEAD + PROTOCOL + 'richness: much\n', 'not_a_number'),
        (HEAD + PROTOCOL + 'noise: {std: 1}\n', 'unknown_key'),
        (HEAD + PROTOCOL + 'detail: {elements: 99.5}\n', 'not_a_number'),
        (HEAD + PROTOCOL + 'rates: {frames: 0}\n', 'out_of_bounds'),
        (HEAD + PROTOCOL + 'effects: {drag: {}}\n', 'unknown_key'),
        (HEAD + PROTOCOL + 'effects: {creep: {a: 1}}\n', 'unknown_key'),
        (HEAD + 'protocol: {kind: jump}\n', 'unknown_kind'),
        (HEAD + 'protocol: {kind: slow_ramp, hight: 1}\n', 'unknown_key'),
        (HEAD + 'protocol: {kind: staircase, pressures: [a]}\n', 'not_a_table'),
        (HEAD + 'protocol: {kind: slow_ramp, ramp: 1}\n', 'unknown_key'),
        (HEAD + 'protocol: {kind: strings, rest: 1}\n', 'unknown_key'),
        (HEAD + 'protocol: {kind: corners, rest: 1}\n', 'unknown_key'),
        (HEAD + 'protocol: {kind: random_mix, seed: 1.5}\n', 'not_a_number'),
        (HEAD + 'protocol: {kind: random_mix, force_x: [0.1, 0.2, 0.3]}\n', 'wrong_shape'),
        (HEAD + PROTOCOL + 'effects: {push: {richness: 1}}\n', 'unknown_key'),
        (HEAD + PROTOCOL + 'effects: {inertia: {richness: 1}}\n', 'unknown_key'),
        (HEAD.replace('1', '2', 1) + PROTOCOL, 'unknown_version'),
        (HEAD.replace('lab_arm', 'no_arm') + PROTOCOL, 'not_found'),
        (HEAD.replace('mine', '""') + PROTOCOL, 'not_a_text'),
        (HEAD.replace('lab_arm.yaml', '{name: x}') + PROTOCOL, 'missing_key'),
    ],
)
def test_what_is_wrong_in_a_scenario_is_said(load, text, reason):
    with refused(RequestError, reason) as caught:
        load(text)
    assert 'mine.yaml: ' in str(caught.value)


def test_a_wrong_arm_file_is_named(load, tmp_path):
    arm = tmp_path / 'lab_arm.yaml'
    arm.write_text(arm.read_text().replace('split:', 'splat:'))
    with refused(RequestError, 'unknown_key'):
        load(HEAD + PROTOCOL)


@pytest.mark.parametrize('file', sorted(FOLDER.glob('*.yaml')), ids=lambda file: file.stem)
def test_shipped_scenarios_are_named_as_their_files(file: Path):
    if file.stem != 'lab_arm':
        assert load_scenario(file).name == file.stem
