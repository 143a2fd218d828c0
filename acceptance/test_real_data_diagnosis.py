"""A diagnosis finds that pressure lengthens real actuators, and in made ones what is so."""

from __future__ import annotations

from dataclasses import replace
import json
import sys

import numpy as np
from pneunet_ros.core.errors import RecordingError
import pytest
import real_data_diagnosis as bench
import real_data_fit as table

MEASURED = pytest.mark.skipif(
    not table.DATA.is_file(), reason=f'no real measurements here: {table.DATA} is absent'
)
SHARES = np.linspace(0.0, 1.0, 9)
TOP = 4e4  # Pa


def made(strain: float, turning: float = 1.5, seed: int = 0) -> table.Actuator:
    """Return an actuator that bends and lengthens with pressure, its tips with noise."""
    bend = turning * (SHARES + 0.1 * SHARES**2)
    chord = table.LENGTH * (1.0 + strain * SHARES) * np.sinc(bend / (2.0 * np.pi))
    tip = chord[:, None] * np.column_stack([np.cos(bend / 2.0), np.sin(bend / 2.0)])
    noise = 0.01 * bench.NOISE * table.LENGTH
    tip[1:] += np.random.default_rng(seed).normal(0.0, noise, tip[1:].shape)
    return table.Actuator(name='made', pressure=TOP * SHARES, tip=tip)


def test_elongation_is_named_with_its_size():
    found = bench.diagnosed(made(0.2), bench.NOISE)
    assert found.answer == 'named'
    assert found.effects == ('pressure_elongation',)
    assert found.right
    assert found.strain_per_pascal == pytest.approx(
        0.2 / TOP, abs=3.0 * found.strain_per_pascal_std
    )
    assert found.strain_per_pascal_std < 0.1 * found.strain_per_pascal
    assert found.fitted.before > 5.0
    assert found.held_out.before > 5.0
    assert found.fitted.after < 0.6
    assert found.held_out.after < 0.9  # of noisy tips


def test_an_arm_that_only_bends_is_not_said_to_lengthen():
    found = bench.diagnosed(made(0.0), bench.NOISE)
    assert found.answer in ('none', 'unobservable')
    assert found.effects == ()
    assert not found.right
    assert found.fitted.before == found.fitted.after < 0.9


def test_two_tips_are_no_recording():
    short = made(0.2)
    short = replace(short, pressure=short.pressure[:2], tip=short.tip[:2])
    with pytest.raises(RecordingError) as caught:
        bench.diagnosed(short, bench.NOISE)
    assert caught.value.reason == 'too_few_frames'


@MEASURED
@pytest.mark.parametrize(
    ('name', 'before', 'after'),
    [
        ('DS30-EF30-1-1', 7.84, 0.32),  # bends far
        ('DS30-DS10-6-6', 5.94, 0.11),  # four rows
    ],
)
def test_real_arms_are_said_to_lengthen(name, before, after):
    actuator = next(item for item in table.read_actuators(table.DATA) if item.name == name)
    found = bench.diagnosed(actuator, bench.NOISE)
    assert found.right, found
    assert found.fitted.before == pytest.approx(before, abs=0.2)
    assert found.fitted.after == pytest.approx(after, abs=0.1)


@pytest.mark.slow
@MEASURED
def test_all_real_arms_as_the_issue_wants_it():
    result = bench.summary(bench.measured(table.read_actuators(table.DATA), bench.NOISE))
    assert result['right'] == result['actuators'] == 27
    assert result['fitted_before']['mean'] == pytest.approx(10.9, abs=0.1)
    assert result['fitted_after']['largest'] < 0.6
    assert result['held_out_before']['mean'] > 8.0
    assert result['held_out_after']['mean'] < 0.6


def test_the_bench_prints_one_object_and_a_table(tmp_path, monkeypatch, capsys):
    actuator = made(0.2)
    moved = 1000.0 * (actuator.tip - actuator.tip[0])
    rows = zip(actuator.pressure / table.PRESSURE_UNIT, moved, strict=True)
    lines = [f'made,{pressure:.5f},{tip[0]:.9f},{tip[1]:.9f}' for pressure, tip in rows]
    file = tmp_path / 'table.csv'
    file.write_text('\n'.join([','.join(table.COLUMNS), *lines]))

    def run(*arguments):
        command = ['real_data_diagnosis.py', *map(str, arguments)]
        monkeypatch.setattr(sys, 'argv', command)
        bench.main()
        return capsys.readouterr().out

    result = json.loads(run('--json', '--data', file))
    assert result['actuators'][0]['effects'] == ['pressure_elongation']
    assert result['summary']['right'] == 1
    gap = bench.Gap(before=8.0, after=0.25)
    found = bench.Found(
        actuator='made',
        pressures=9,
        answer='inseparable',
        effects=('camera_scale',),
        alternatives=('pressure_elongation',),
        strain_per_pascal=None,
        strain_per_pascal_std=None,
        fitted=gap,
        answer_of_rest='unknown',
        effects_of_rest=(),
        held_out=gap,
    )
    bench.show([found], 0.4)
    told = ' '.join(capsys.readouterr().out.split())
    assert 'inseparable 1; pressure_elongation in 1 of 1' in told
    assert 'camera_scale or' in told
    assert 'noise of a tip 0.4 %' in told
    assert 'from 8.0 % (10.9 known) to 0.25 %' in told
    with pytest.raises(SystemExit, match='2'):
        run('--data', tmp_path / 'absent.csv')
