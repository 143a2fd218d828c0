"""Model files: what is read, what is written, and what is refused with which sentence."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
import math
import os
from pathlib import Path
import random
import subprocess
import sys

import numpy as np
from pneunet_ros import load_model, save_model, solve
from pneunet_ros.core.errors import ModelError, RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.files.model_file import mapping_from_arm, model_hash
from pneunet_ros.model.moment_law import LinearLaw, MajidiLaw
from pneunet_ros.model.uncertainty import ModelCovariance, PlacementKnown
import pytest
from ruamel.yaml import YAML
from support.example_arms import ALL_MECHANICS, PAPER_ARM, paper_arm, plain_arm, rebuilt
from support.refusals import refused
import yaml

# The example of the contract, section 2.4, word for word.
EXAMPLE = """\
schema_version: 1
name: paper-arm
arm:
  length: 0.112                  # m
  weight: 0.17                   # N, the scale mg
  clamp_angle: 0.0               # rad
  target_arclength: [0.0, 0.005] # m, place of each target; index = target id (23 for the paper's arm)
intrinsic_curvature:             # kappa_p0(p, s), linear in p between rows, C2 cubic spline (not-a-knot) in s
  pressure: [0.0, 55000.0]       # Pa
  arclength: [0.0, 0.5, 1.0]     # s / l
  curvature: [[0, 0, 0], [25, 30, 20]]   # 1/m, a row per pressure
moment_law:
  kind: piecewise_linear         # or: linear (bending_stiffness N m^2); majidi (modulus Pa, width, ...)
  pressure: [0.0, 66000.0]       # Pa
  split: [0.10, 0.15]            # l1 / l
  rigidity: [[0.06, 0.03], [0.07, 0.04]]     # alpha1, alpha2 = B / (mg l^2); may be negative
  moment_offset: [[0, 0], [-0.006, 0]]       # M_O1, M_O2 in mg l
effects: {}                      # e.g. extensibility: {axial_stiffness: 40.0}
sensors:                         # one sigma, SI; the last three optional, 0 when absent
  {pressure_std: 60.0, force_std: 0.001, moment_std: 1.0e-5, target_std: 0.00012, placement_std: 0.0, registration_std: 0.0, drift_std: 0.0}
covariance: null                 # or {quantities: [dotted names], factor: [[...]]}
domain: {pressure: [0.0, 55000.0], end_load: [[0.25, 0.0, 0.0, 0.0], [0.15, 0.2, 0.0, 54000.0]]}
sources: {}                      # dotted key -> where the number comes from
provenance: {source: "...", recordings: []}
"""  # noqa: E501


@pytest.fixture
def write(tmp_path):
    """Write a model file: the example with one text replaced by another."""

    def written(old='', new=''):
        assert old in EXAMPLE
        path = tmp_path / 'model.yaml'
        path.write_text(EXAMPLE.replace(old, new, 1))
        return path

    return written


def refusal(path):
    """Load a file that is refused: the sentence, which names the file and stands in one line."""
    with pytest.raises(ModelError) as caught:
        load_model(path)
    sentence = str(caught.value)
    assert str(path) in sentence
    assert '\n' not in sentence
    return Note(sentence, reason=caught.value.reason)


# ---- what is read -------------------------------------------------------------------------------


def test_the_example_of_the_contract_is_read(write):
    arm = load_model(write())
    assert arm.name == 'paper-arm'
    assert (arm.length, arm.weight, arm.clamp_angle) == (0.112, 0.17, 0.0)
    assert arm.target_arclength.tolist() == [0.0, 0.005]
    assert arm.intrinsic_curvature.curvature.tolist() == [[0, 0, 0], [25, 30, 20]]
    assert arm.moment_law.kind == 'piecewise_linear'
    assert arm.moment_law.split.tolist() == [0.10, 0.15]
    assert arm.moment_law.rigidity.tolist() == [[0.06, 0.03], [0.07, 0.04]]
    assert arm.moment_law.moment_offset.tolist() == [[0, 0], [-0.006, 0]]
    assert arm.effects == ()
    assert arm.sensors.moment_std == 1e-5
    assert arm.covariance is None
    assert arm.provenance['source'] == '...'
    assert arm.pressure_range == (0.0, 55e3)
    assert solve(arm, 31e3, (0.175, 0.07)).converged


def test_the_shipped_model_is_read():
    arm = load_model(str(PAPER_ARM))
    assert arm.name == 'paper-arm'
    assert arm.target_arclength.size == 23
    assert arm.pressure_range == (0.0, 66e3)


def test_every_number_of_the_shipped_model_has_a_source():
    arm = load_model(PAPER_ARM)
    content = mapping_from_arm(arm)
    blocks = ('arm', 'intrinsic_curvature', 'moment_law', 'sensors')
    named = {f'{block}.{key}' for block in blocks for key in content[block]}
    assert set(arm.sources) == named | {'domain'}
    assert all('paper' in text or 'representative' in text for text in arm.sources.values())


def test_the_domain_is_read_written_and_may_be_left_out(write, tmp_path):
    arm = load_model(write())
    assert arm.domain.pressure == arm.pressure_range == (0.0, 55e3)
    assert arm.domain.end_load.tolist() == [[0.25, 0.0, 0.0, 0.0], [0.15, 0.2, 0.0, 54e3]]
    save_model(arm, tmp_path / 'again.yaml')
    again = load_model(tmp_path / 'again.yaml')
    assert again.domain.end_load.tolist() == arm.domain.end_load.tolist()
    assert model_hash(again) == model_hash(arm)
    line = next(line for line in EXAMPLE.splitlines() if line.startswith('domain:'))
    for text in ('', 'domain: null', 'domain:'):
        bare = load_model(write(line, text))
        assert bare.domain is None
        assert model_hash(bare) != model_hash(arm)
        save_model(bare, tmp_path / 'bare.yaml', overwrite=True)
        assert load_model(tmp_path / 'bare.yaml').domain is None


@pytest.mark.parametrize(
    ('old', 'new', 'reason'),
    [
        ('domain: {pressure: [0.0, 55000.0], ', 'domain: {', 'missing_key'),
        ('domain: {', 'domain: {forces: 3, ', 'unknown_key'),
        ('[0.25, 0.0, 0.0, 0.0], ', '[0.25, 0.0, 0.0], ', 'not_a_table'),
        ('[0.25, 0.0, 0.0, 0.0], ', '[.nan, 0.0, 0.0, 0.0], ', 'not_finite'),
        ('[0.25, 0.0, 0.0, 0.0], ', '[0.25, 0.0, 0.0, true], ', 'not_a_table'),
        ('0.0, 54000.0]', '0.0, 56000.0]', 'out_of_bounds'),
    ],
)
def test_a_domain_that_is_none_is_refused(write, old, new, reason):
    with refused(ModelError, reason):
        load_model(write(old, new))


LAW = EXAMPLE[EXAMPLE.index('moment_law:') : EXAMPLE.index('effects:')]


@pytest.mark.parametrize(
    ('block', 'law'),
    [
        ('{kind: linear, bending_stiffness: 2e-4}', LinearLaw(bending_stiffness=2e-4)),
        (
            '{kind: majidi, modulus: 1e6, width: 0.015, thickness: 0.003, height: 0.012, '
            't1: 0.002, t2: 0.008}',
            MajidiLaw(modulus=1e6, width=0.015, thickness=0.003, height=0.012, t1=0.002, t2=0.008),
        ),
    ],
)
def test_the_other_laws_are_read(write, block, law):
    assert load_model(write(LAW, f'moment_law: {block}\n')).moment_law == law


def test_optional_blocks_may_be_left_out(write):
    for old in (
        'effects: {}',
        'covariance: null',
        'sources: {}',
        'provenance: {source: "...", recordings: []}',
        '  clamp_angle: 0.0',
        '  target_arclength: [0.0, 0.005]',
        ', placement_std: 0.0, registration_std: 0.0, drift_std: 0.0',
    ):
        arm = load_model(write(old))
        assert arm.effects == ()
        assert arm.clamp_angle == 0.0


@pytest.mark.parametrize('empty', ['effects:', 'effects: null', 'sources:', 'provenance:'])
def test_empty_blocks_are_none(write, empty):
    old = next(line for line in EXAMPLE.splitlines() if line.startswith(empty.split(':')[0]))
    assert load_model(write(old, empty)).effects == ()


def test_numbers_without_a_point_are_numbers(write):
    # YAML 1.1 reads 1e-5 as a text; users write it.
    assert load_model(write('1.0e-5', '1e-5')).sensors.moment_std == 1e-5
    assert load_model(write('0.17 ', '17e-2 ')).weight == 0.17
    assert load_model(write('pressure_std: 60.0', 'pressure_std: 60')).sensors.pressure_std == 60.0
    assert load_model(write('[0.0, 55000.0]', '[0, 55e3]')).intrinsic_curvature.pressure[1] == 55e3


def texts_of_numbers(content, where=''):
    """Yield where a text stands that is a number."""
    if isinstance(content, dict | list):
        items = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in items:
            yield from texts_of_numbers(value, f'{where}.{key}')
    elif isinstance(content, str):
        with suppress(ValueError):
            float(content)
            yield where


@pytest.mark.parametrize('folder', ['bags', 'config', 'scenarios'])
def test_a_reader_of_yaml_1_1_finds_numbers_in_every_shipped_file(folder):
    paths = list(share_path(folder).rglob('*.yaml'))
    assert paths
    for path in paths:
        assert not list(texts_of_numbers(yaml.safe_load(path.read_text()))), path


def test_a_reader_of_yaml_1_1_finds_numbers_in_every_written_file(tmp_path):
    factor = [[1e-05, 0.0], [-1e-07, 1e22]]
    covariance = ModelCovariance(
        quantities=('arm.length', 'moment_law.rigidity.0.1'), factor=factor
    )
    arm = replace(paper_arm((Extensibility(axial_stiffness=math.inf),)), covariance=covariance)
    save_model(arm, tmp_path / 'model.yaml')
    read = yaml.safe_load((tmp_path / 'model.yaml').read_text())
    assert not list(texts_of_numbers(read))
    assert read['sensors']['moment_std'] == 1e-05
    assert read['covariance']['factor'] == factor
    assert read['effects']['extensibility']['axial_stiffness'] == math.inf
    assert model_hash(load_model(tmp_path / 'model.yaml')) == model_hash(arm)


def test_effects_are_read_with_their_parameters(write):
    arm = load_model(write('effects: {}', 'effects: {gravity: {weight_y: -1.5}, extensibility: }'))
    assert {effect.name for effect in arm.effects} == {'gravity', 'extensibility'}
    extensibility, gravity = arm.effects
    assert (gravity.weight_x, gravity.weight_y) == (0.0, -1.5)
    assert extensibility == Extensibility()


def test_infinite_stiffness_is_read_and_written(write, tmp_path):
    arm = load_model(write('effects: {}', 'effects: {extensibility: {axial_stiffness: .inf}}'))
    save_model(arm, tmp_path / 'again.yaml')
    assert load_model(tmp_path / 'again.yaml').effects[0].axial_stiffness == math.inf


def test_a_covariance_is_read(write):
    arm = load_model(
        write(
            'covariance: null',
            'covariance: {quantities: [arm.length, moment_law.rigidity.0.1], '
            'factor: [[1e-4, 0], [1e-3, 2e-3]]}',
        )
    )
    assert arm.covariance.quantities == ('arm.length', 'moment_law.rigidity.0.1')
    assert arm.covariance.columns() == (
        {'arm.length': 1e-4, 'moment_law.rigidity.0.1': 1e-3},
        {'arm.length': 0.0, 'moment_law.rigidity.0.1': 2e-3},
    )


# ---- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('old', 'new', 'where', 'known'),
    [
        ('name: paper-arm', 'nam: paper-arm', 'nam', 'schema_version, name, arm'),
        ('effects: {}', 'effect: {}', 'effect', 'effects, sensors'),
        ('  weight:', '  wieght:', 'arm.wieght', 'length, weight, tip_cap, clamp_angle'),
        ('  arclength:', '  stations:', 'intrinsic_curvature.stations', 'pressure, arclength'),
        ('  split:', '  l1:', 'moment_law.l1', 'kind, pressure, split, rigidity, moment_offset'),
        ('effects: {}', 'effects: {extension: {}}', 'effects.extension', 'extensibility'),
        (
            'effects: {}',
            'effects: {extensibility: {stiffness: 3}}',
            'effects.extensibility.stiffness',
            'axial_stiffness',
        ),
        ('force_std', 'force_sigma', 'sensors.force_sigma', 'pressure_std, force_std'),
        (
            'covariance: null',
            'covariance: {names: [], factor: []}',
            'covariance.names',
            'quantities, factor',
        ),
    ],
)
def test_an_unknown_key_is_refused_with_the_known_ones(write, old, new, where, known):
    sentence = refusal(write(old, new))
    assert (sentence.reason, where in sentence) == ('unknown_key', True)
    assert known in sentence


def test_a_key_of_another_law_is_unknown(write):
    sentence = refusal(write('kind: piecewise_linear', 'kind: linear'))
    assert (sentence.reason, 'moment_law.pressure' in sentence) == ('unknown_key', True)


@pytest.mark.parametrize(
    ('line', 'missing'),
    [
        ('schema_version: 1', 'schema_version'),
        ('name: paper-arm', 'name'),
        ('  length: 0.112', 'arm.length'),
        ('  weight: 0.17', 'arm.weight'),
        ('  pressure: [0.0, 55000.0]', 'intrinsic_curvature.pressure'),
        ('  split: [0.10, 0.15]', 'moment_law.split'),
        ('force_std: 0.001, ', 'sensors.force_std'),
    ],
)
def test_a_missing_key_is_named(write, line, missing):
    sentence = refusal(write(line))
    assert (sentence.reason, missing in sentence) == ('missing_key', True)


@pytest.mark.parametrize(
    ('old', 'new', 'sentence'),
    [
        ('schema_version: 1', 'schema_version: 2', 'schema_version 2 is not supported, only 1'),
        ('schema_version: 1', 'schema_version: "1"', "schema_version '1' is not supported"),
        ('name: paper-arm', 'name: 7', 'name must be a text, not 7'),
        ('name: paper-arm', 'name: ""', 'name must be a text'),
        ('0.112 ', '"0.112" ', "arm.length must be a number in SI units, not '0.112'"),
        ('0.112 ', '[0.112] ', 'arm.length must be a number in SI units'),
        ('0.112 ', '.nan ', 'arm.length must be a number in SI units, not nan'),
        ('0.112 ', '.inf ', 'arm.length = inf is not within'),
        ('0.112 ', 'true ', 'arm.length must be a number in SI units, not True'),
        ('0.112 ', ' ', 'arm.length must be a number in SI units, not None'),
        ('0.112 ', '112 ', r'arm.length = 112.0 is not within [0.0001, 10.0] m'),
        ('[0.0, 0.005]', '[0.0, 0.5]', 'arm.target_arclength must increase, from 0 or more to'),
        ('[0.0, 0.005]', '{a: 1}', 'arm.target_arclength must be'),
        ('[0.0, 0.005]', '[0.0, .nan]', 'arm.target_arclength contains NaN'),
        ('[[0, 0, 0], [25, 30, 20]]', '[[0, 0], [25, 30]]', '2 x 3, not 2 x 2'),
        ('[[0, 0, 0], [25, 30, 20]]', '[[0, 0, 0]]', '2 x 3, not 1 x 3'),
        ('[[0, 0, 0], [25, 30, 20]]', '[[0, 0], [25, 30, 20]]', 'rows of equal length'),
        ('[[0, 0, 0], [25, 30, 20]]', '[[0, 0, x], [25, 30, 20]]', 'must be a table of numbers'),
        ('[[0, 0, 0], [25, 30, 20]]', '[[0, 0, "1"], [25, 30, 20]]', 'a table of numbers'),
        ('[0.0, 0.005]', '[true, false]', 'must be a table of numbers'),
        ('[0.0, 0.005]', '&a [*a]', 'aliases expand to more than 1,000,000 values'),
        ('[[0, 0, 0], [25, 30, 20]]', '[0, 25]', 'must be a list of rows of numbers'),
        ('[0.0, 0.5, 1.0]', '[0.0, 0.056, 0.112]', 'must increase from 0.0 to 1.0'),
        ('[0.0, 55000.0]', '[55000.0, 0.0]', 'strictly increasing values in Pa'),
        ('[0.0, 66000.0]', '[70e3, 80e3]', 'have no pressure in common'),
        ('kind: piecewise_linear', 'kind: cubic', 'must be one of piecewise_linear, linear'),
        ('kind: piecewise_linear', 'kind: [linear]', 'moment_law.kind must be one of'),
        ('[[0.06, 0.03], [0.07, 0.04]]', '[[-0.06, 0.03], [0.07, 0.04]]', 'change sign'),
        ('[[0.06, 0.03], [0.07, 0.04]]', '[[0.0, 0.03], [0.07, 0.04]]', 'must not be zero'),
        ('[[0.06, 0.03], [0.07, 0.04]]', '[[0.06], [0.07]]', 'not 2 x 1'),
        ('[0.10, 0.15]', '[0.10]', 'moment_law.split must hold 2 values'),
        ('[0.10, 0.15]', '[0.10, 1.5]', 'moment_law.split must lie between 0 and 1'),
        ('force_std: 0.001', 'force_std: -0.001', 'sensors.force_std = -0.001 is not within'),
        ('force_std: 0.001', 'force_std: .nan', 'sensors.force_std must be a number'),
        ('force_std: 0.001', 'force_std: .inf', 'sensors.force_std = inf is not within'),
        ('schema_version: 1', 'schema_version: true', 'schema_version True is not supported'),
        ('0.112 ', f'1{400 * "0"} ', 'arm.length is too large to be a number'),
        ('[0.0, 0.005]', '[0.0, [0.005]]', 'arm.target_arclength must be a table of numbers'),
        ('[0.0, 0.005]', '[false, 0.005]', 'arm.target_arclength must be a table of numbers'),
        ('[0.0, 0.005]', '"0.0"', 'arm.target_arclength must be a table of numbers'),
        ('[25, 30, 20]', '["25", 30, 20]', 'curvature must be a table of numbers'),
        ('[25, 30, 20]', '[true, 30, 20]', 'curvature must be a table of numbers'),
        ('[25, 30, 20]', f'[1{400 * "0"}, 30, 20]', 'curvature must be a table of numbers'),
        ('effects: {}', 'effects: false', 'effects must be a mapping of names to values'),
        ('effects: {}', 'effects: {gravity: 0}', 'effects.gravity must be a mapping'),
        ('sources: {}', 'sources: []', 'sources must be a mapping'),
        ('recordings: []}', 'recordings: [{1: a, b: c}]}', 'provenance must be a mapping'),
        ('effects: {}', '"two\\nlines": 1', 'unknown key two lines; known keys'),
        ('effects: {}', 'effects: [gravity]', 'effects must be a mapping of names to values'),
        ('effects: {}', 'effects: {gravity: 3}', 'effects.gravity must be a mapping'),
        ('effects: {}', 'effects: {gravity: {weight_y: .nan}}', 'weight_y must be a number'),
        ('sources: {}', 'sources: {arm.length: 3}', 'sources.arm.length must be a text, not 3'),
        ('sources: {}', 'sources: [paper]', 'sources must be a mapping'),
        ('provenance: {source: "...", recordings: []}', 'provenance: me', 'provenance must be'),
        ('covariance: null', 'covariance: 3', 'covariance must be a mapping'),
        (
            'covariance: null',
            'covariance: {quantities: arm.length, factor: [[1]]}',
            'covariance.quantities must be a list of dotted names',
        ),
        (
            'covariance: null',
            'covariance: {quantities: [arm.lenght], factor: [[1e-5]]}',
            'the model has no quantity arm.lenght',
        ),
        (
            'covariance: null',
            'covariance: {quantities: [arm.length], factor: [[1e-5], [1e-5]]}',
            'not 2 x 1',
        ),
        (
            'covariance: null',
            f'covariance: {{quantities: [arm.length], factor: [[{13 * "1e-5, "}]]}}',
            '1 to 12 columns, not 1 x 13',
        ),
        *(
            (
                'covariance: null',
                f'covariance: {{quantities: [arm.length], factor: [[1e-5]], guessed: {guessed}}}',
                sentence,
            )
            for guessed, sentence in (
                (2, 'covariance.guessed must be 0 to 1'),
                ('true', 'must be a whole number, not True'),
            )
        ),
        (
            'covariance: null',
            'covariance: {quantities: [arm.length.0], factor: [[1e-5]]}',
            'the model has no quantity arm.length.0',
        ),
        *(
            (
                'covariance: null',
                'covariance: {quantities: [arm.length], factor: [[1e-5]], placement: '
                f'{{mean: {mean}, std: {std}, factor: {factor}}}}}',
                sentence,
            )
            for mean, std, factor, sentence in (
                ([0, 0], [0, 0], [[0], [0]], 'is for 1 targets, but the arm has 2'),
                ([0, 0], [0, 0], [[0, 0], [0, 0]], 'must have 1 columns'),
                ([0, 0], [0], [[0], [0]], 'across the arm, not 2, 1 and 2'),
                ([0, 0, 0, 0], [0, 0, 0, -1], 4 * [[0]], 'std must not be negative'),
            )
        ),
    ],
)
def test_wrong_content_is_refused(write, old, new, sentence):
    assert sentence in refusal(write(old, new))


@pytest.mark.parametrize('text', ['', '3', '[1, 2]', 'hello', '- a\n- b', '1: 2'])
def test_what_is_no_mapping_is_refused(tmp_path, text):
    (tmp_path / 'model.yaml').write_text(text)
    assert refusal(tmp_path / 'model.yaml').reason == 'not_a_mapping'


@pytest.mark.parametrize(
    'text',
    [
        'a: [1, 2',
        'a: b: c',
        '\t- a',
        'name: x\nname: y',
        '&a [*a',
        'a: *nowhere',
        '!!python/object/apply:os.system ["touch /tmp/pneunet_ros_was_here"]',
        '!!python/object:pathlib.Path {}',
        'a: !mine 3',
        '%YAML 9.9\n---\na: 1',
        '---\na: 1\n---\nb: 2',
        'a: 2001-99-99',
        'a: !!int ""',
        'a: !!bool maybe',
        'a: {<<: {b: 1}}',
        '[' * 400,
    ],
)
def test_what_is_no_yaml_for_us_is_refused(tmp_path, text):
    (tmp_path / 'model.yaml').write_text(text)
    assert refusal(tmp_path / 'model.yaml').reason == 'not_yaml'
    assert not Path('/tmp/pneunet_ros_was_here').exists()


def test_a_key_given_twice_is_refused_by_name(write):
    sentence = refusal(write('  weight: 0.17', '  length: 0.2\n  weight: 0.17'))
    assert (sentence.reason, 'length' in sentence) == ('not_yaml', True)


def test_text_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / 'model.yaml'
    path.write_bytes(random.Random(1).randbytes(1_000_000))
    assert refusal(path).reason == 'unreadable'


@pytest.mark.parametrize('key', ['name: ', 'provenance:\n  a: ', 'covariance: '])
@pytest.mark.parametrize('levels', [20, 2000])
def test_aliases_that_repeat_without_bound_are_refused(tmp_path, key, levels):
    lines = [f'a{level}: &a{level} [{9 * f"*a{level - 1}, "}]' for level in range(1, levels)]
    lines = ['a0: &a0 [1, 2, 3]', *lines, f'{key}*a{levels - 1}']
    (tmp_path / 'model.yaml').write_text('\n'.join(lines))
    assert refusal(tmp_path / 'model.yaml').reason == 'too_large'


def test_merge_keys_that_repeat_without_bound_are_refused(tmp_path):
    lines = [f'a{level}: &a{level} {{<<: [{9 * f"*a{level - 1}, "}]}}' for level in range(1, 40)]
    (tmp_path / 'model.yaml').write_text('\n'.join(['a0: &a0 {b: 1}', *lines]))
    assert refusal(tmp_path / 'model.yaml').reason == 'not_yaml'


def test_what_holds_itself_is_refused(write):
    assert 'aliases' in refusal(write('{source: "...", recordings: []}', '&a {source: *a}'))


def test_a_row_may_be_repeated_by_an_alias(write):
    arm = load_model(write('[[0.06, 0.03], [0.07, 0.04]]', '[&row [0.06, 0.03], *row]'))
    assert arm.moment_law.rigidity.tolist() == [[0.06, 0.03], [0.06, 0.03]]


def test_a_megabyte_of_letters_is_refused(tmp_path):
    path = tmp_path / 'model.yaml'
    letters = random.Random(2)
    path.write_text(''.join(letters.choices('abc:{}[]&*!|>-\n #"\'', k=1_000_000)))
    refusal(path)


def test_a_file_too_large_is_not_even_read(tmp_path):
    path = tmp_path / 'model.yaml'
    with path.open('wb') as stream:
        stream.truncate(30_000_000)
    assert refusal(path).reason == 'too_large'


def test_missing_and_unreadable_files_are_named(tmp_path):
    assert refusal(tmp_path / 'nowhere.yaml').reason == 'not_found'
    assert refusal(tmp_path).reason == 'unreadable'


# ---- what is written ----------------------------------------------------------------------------


def same_content(left, right):
    return mapping_from_arm(left) == mapping_from_arm(right)


@pytest.mark.parametrize(
    'arm',
    [
        paper_arm(),
        paper_arm(ALL_MECHANICS),
        plain_arm(curvature=1 / 3, law=LinearLaw(bending_stiffness=-1 / 7e4)),
        plain_arm(
            law=MajidiLaw(
                modulus=1e6, width=0.015, thickness=0.003, height=0.012, t1=0.002, t2=0.008
            )
        ),
        rebuilt(
            paper_arm(),
            name='mit Umlaut: ä, "quoted", # and more',
            covariance=ModelCovariance(
                quantities=('arm.length', 'moment_law.split.0'),
                factor=[[1e-5, 1 / 3e5], [0, 1e-3]],
                placement=PlacementKnown(
                    mean=np.linspace(-1e-4, 1e-4, 46),
                    std=np.full(46, 1 / 3e5),
                    factor=np.full((46, 2), -1 / 7e5),
                    origin=np.array([0.0, -2e-3]),
                ),
                guessed=1,
            ),
            provenance={'recordings': [{'file': 'a.mcap', 'sha256': '0' * 64}], 'seed': 3},
        ),
    ],
)
def test_what_is_written_is_read_again_to_the_last_bit(tmp_path, arm):
    path = tmp_path / 'model.yaml'
    save_model(arm, path)
    again = load_model(path)
    assert same_content(again, arm)
    assert model_hash(again) == model_hash(arm)
    save_model(again, tmp_path / 'again.yaml')
    assert (tmp_path / 'again.yaml').read_bytes() == path.read_bytes()
    one, other = solve(arm, 31e3, (0.1, 0.05)), solve(again, 31e3, (0.1, 0.05))
    assert np.array_equal(one.x, other.x)


def test_numbers_of_numpy_are_written_as_numbers(tmp_path):
    arm, path = paper_arm(), tmp_path / 'model.yaml'
    effects = (Gravity(weight_y=np.float64(0.5)),)
    seed = {'seed': np.int64(3)}
    counted = replace(arm, length=np.float64(0.12), effects=effects, provenance=seed)
    save_model(counted, path)
    assert load_model(path).length == 0.12
    assert load_model(path).provenance == {'seed': 3}
    assert model_hash(load_model(path)) == model_hash(counted)


def test_written_files_follow_the_order_of_the_contract(tmp_path):
    save_model(paper_arm(), tmp_path / 'model.yaml')
    lines = (tmp_path / 'model.yaml').read_text().splitlines()
    top = [line.split(':')[0] for line in lines if line[:1].isalpha()]
    assert top == [line.split(':')[0] for line in EXAMPLE.splitlines() if line[:1].isalpha()]


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(path, text, **options):
        path.write_bytes(text[:100].encode())
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(Path, 'write_text', full)
    with refused(RecordingError, 'unwritable'):
        save_model(paper_arm(), tmp_path / 'model.yaml')
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_refused_and_kept(tmp_path):
    path = tmp_path / 'model.yaml'
    path.write_text('mine')
    with refused(RecordingError, 'exists'):
        save_model(paper_arm(), path)
    assert path.read_text() == 'mine'
    save_model(paper_arm(), path, overwrite=True)
    assert same_content(load_model(path), paper_arm())
    assert [entry.name for entry in tmp_path.iterdir()] == ['model.yaml']


# ---- identity -----------------------------------------------------------------------------------


def test_the_hash_does_not_see_layout_and_comments(write, tmp_path):
    plain = write()
    other = tmp_path / 'other.yaml'
    with other.open('w') as stream:
        YAML(typ='safe').dump(dict(reversed(YAML(typ='safe').load(plain).items())), stream)
    assert other.read_text() != plain.read_text()
    assert model_hash(load_model(other)) == model_hash(load_model(plain))


@pytest.mark.parametrize(
    'name',
    [
        'arm.length',
        'moment_law.rigidity.0.1',
        'intrinsic_curvature.curvature.3.5',
        'sensors.force_std',
    ],
)
def test_the_hash_sees_the_last_digit_of_every_number(name):
    assert model_hash(paper_arm().with_changes({name: 1e-12})) != model_hash(paper_arm())


def test_the_hash_is_the_same_in_another_process(foreign_environment):
    code = (
        'from pneunet_ros.files.model_file import load_model, model_hash; '
        f'print(model_hash(load_model({str(PAPER_ARM)!r})))'
    )
    root = str(PAPER_ARM.parent.parent)
    environment = {**foreign_environment, 'PYTHONPATH': root, 'PYTHONHASHSEED': '77'}
    result = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == model_hash(paper_arm())
    assert os.environ.get('PYTHONHASHSEED') != '77'
