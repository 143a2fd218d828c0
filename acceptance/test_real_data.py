"""Real measurements: what the bench finds in them, and that it finds what is in made ones."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import sys

from matplotlib.image import imread
import numpy as np
from pneunet_ros.core.errors import RecordingError
import pytest
import real_data
import real_data_fit as bench

MEASURED = pytest.mark.skipif(
    not bench.DATA.is_file(), reason=f'no real measurements here: {bench.DATA} is absent'
)
PRESSURES = np.array([0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0])  # as recorded
HEAD = ','.join(bench.COLUMNS)


def arc(turning: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Tip (n, 2) m of a circular arc, from the circle's own formula."""
    radius = bench.LENGTH * (1.0 + strain) / turning
    return np.stack([radius * np.sin(turning), radius * (1.0 - np.cos(turning))], axis=1)


def made(name: str, curvature: tuple[float, float], strain: tuple[float, float]) -> bench.Actuator:
    """Actuator whose turning and strain are quadratic in the share of the highest pressure."""
    share = PRESSURES[1:] / PRESSURES[-1]
    powers = np.stack([share, share**2])
    tip = np.vstack([[[bench.LENGTH, 0.0]], arc(curvature @ powers, strain @ powers)])
    return bench.Actuator(name=name, pressure=bench.PRESSURE_UNIT * PRESSURES, tip=tip)


def shortened(actuator: bench.Actuator, rows: int) -> bench.Actuator:
    return replace(actuator, pressure=actuator.pressure[:rows], tip=actuator.tip[:rows])


def as_table(actuators: list[bench.Actuator]) -> str:
    lines = [HEAD]
    for actuator in actuators:
        moved = 1000.0 * (actuator.tip - actuator.tip[0])
        for pressure, tip in zip(actuator.pressure / bench.PRESSURE_UNIT, moved, strict=True):
            lines.append(f'{actuator.name},{pressure:.5f},{tip[0]:.9f},{tip[1]:.9f}')
    return '\n'.join(lines)


@pytest.mark.parametrize('turning', [(-2.4, 0.2), (0.08, -0.04)])
def test_it_finds_the_elongation_that_was_put_in(turning):
    actuator = made('made', turning, (0.25, -0.1))
    highest = actuator.pressure[-1]
    score = bench.scored(actuator, 'quadratic')
    assert score.left_out_error.size == 7  # neither the first nor the last
    assert score.left_out_error.max() < 1e-3
    numbers = score.numbers()
    assert numbers['turning_rad'] == pytest.approx(sum(turning), rel=1e-4)
    assert numbers['strain_per_pascal'] == pytest.approx(0.25 / highest, rel=1e-3)
    assert numbers['strain_per_pascal_squared'] == pytest.approx(-0.1 / highest**2, rel=1e-2)
    assert bench.scored(actuator, 'linear').numbers()['left_out_mean'] > 0.2


def test_without_elongation_the_tip_stays_on_its_curve():
    bent = bench.scored(made('made', (1.5, 0.3), (0.0, 0.0)), 'without')
    assert bent.left_out_error.max() < 1e-3
    assert (
        bench.scored(made('made', (1.5, 0.3), (0.2, 0.0)), 'without').left_out_error.mean() > 5.0
    )
    # A straight arm shows it plainly: what is missed is the elongation, and nothing else.
    straight = bench.scored(made('made', (1e-9, 0.0), (0.2, 0.0)), 'best_curvature')
    assert straight.fitted_error == pytest.approx(20.0 * PRESSURES / 400.0, abs=1e-3)
    assert 'left_out_mean' not in straight.numbers()


def test_wrong_pressures_are_told_from_wrong_tips():
    actuator = made('made', (1.5, 0.3), (0.2, 0.0))
    wrong = np.array([0.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # a fit cannot follow
    late = replace(actuator, pressure=actuator.pressure + 100.0 * wrong)
    errors, share = bench.pressure_errors(late, bench.scored(late, 'quadratic'))
    assert share > 0.95
    assert np.corrcoef(errors, -wrong[1:])[0, 1] > 0.9
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(100.0, rel=0.25)


@MEASURED
def test_real_arms_lengthen():
    actuators = bench.read_actuators(bench.DATA)
    assert len(actuators) == 27
    assert sum(item.pressure.size for item in actuators) == 233
    some = actuators[::3]  # all of them in the slow test below
    best = [bench.scored(item, 'best_curvature').numbers()['fitted_mean'] for item in some]
    assert np.mean(best) == pytest.approx(11.52, abs=0.05)


@MEASURED
@pytest.mark.parametrize(
    ('name', 'without', 'linear', 'quadratic'),
    [
        ('DS30-EF30-1-1', 7.6, 1.21, 0.35),  # bends far: the worst with a linear elongation
        ('DS10-DS10-2-1', 8.3, 0.08, 0.09),  # hardly bends, seven rows
        ('DS30-DS10-6-6', 4.5, 0.14, 0.15),  # four rows
    ],
)
def test_a_pressure_left_out_is_predicted(name, without, linear, quadratic):
    actuator = next(item for item in bench.read_actuators(bench.DATA) if item.name == name)
    wanted = {'without': without, 'linear': linear, 'quadratic': quadratic}
    for model, error in wanted.items():
        found = bench.scored(actuator, model).numbers()['left_out_mean']
        assert found == pytest.approx(error, rel=0.05, abs=0.01), model


@pytest.mark.slow
@MEASURED
def test_all_real_arms_as_the_issue_wants_it():
    actuators = bench.read_actuators(bench.DATA)
    best = [bench.scored(item, 'best_curvature').numbers()['fitted_mean'] for item in actuators]
    assert np.mean(best) == pytest.approx(10.9, abs=0.05)
    linear = [bench.scored(item, 'linear').numbers()['left_out_mean'] for item in actuators]
    quadratic = [bench.scored(item, 'quadratic').numbers()['left_out_mean'] for item in actuators]
    assert np.mean(linear) < 0.6
    assert max(quadratic) < 0.6
    assert np.mean(quadratic) < 0.6 * np.mean(linear)


def test_the_bench_prints_one_object_and_draws(tmp_path, monkeypatch, capsys):
    actuators = [made('left', (1.5, 0.3), (0.2, 0.0)), made('right', (-0.5, 0.1), (0.2, 0.0))]
    table, picture = tmp_path / 'table.csv', tmp_path / 'picture.png'
    table.write_text(as_table([shortened(item, 5) for item in actuators]))

    def run(*arguments: str | Path) -> None:
        monkeypatch.setattr(sys, 'argv', ['real_data.py', *map(str, arguments)])
        real_data.main()

    run('--json', '--data', table, '--picture', picture)
    result = json.loads(capsys.readouterr().out)
    assert [row['actuator'] for row in result['actuators']] == ['left', 'right']
    assert result['summary']['linear.left_out_mean']['largest'] < 0.01
    assert result['summary']['best_curvature.fitted_mean']['mean'] > 3.0
    assert result['assumed']['pascal_per_unit'] == 100.0
    assert imread(picture).std() > 0.1
    with pytest.raises(SystemExit, match='2'):
        run('--data', table, '--picture', picture)
    assert '--overwrite' in capsys.readouterr().err
    with pytest.raises(SystemExit, match='2'):
        run('--data', tmp_path / 'absent.csv')
    told = capsys.readouterr().err
    assert 'absent.csv' in told
    assert '--data' in told


def test_the_bench_prints_a_table(capsys):
    _, result = real_data.measured([shortened(made('short', (1.5, 0.3), (0.2, 0.0)), 4)])
    real_data.show(result)
    told = capsys.readouterr().out
    assert 'short' in told
    assert '1 unit of pressure = 100 Pa' in told
    assert 'length 135 mm' in told


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('actuator,pressure\na,0', 'must have the columns'),
        (HEAD, 'holds no measurements'),
        (f'{HEAD}\na,0,0,0\na,50,x,0', 'line 3'),
        (f'{HEAD}\na,0,0,0\na,50,1', 'line 3'),
        (f'{HEAD}\na,0,0,0\na,50,1,1', 'three or more pressures'),
        (f'{HEAD}\na,0,0,0\na,100,1,1\na,50,1,1', 'rise from 0'),
        (f'{HEAD}\na,0,0,0\na,50,nan,1\na,100,1,1', 'finite'),
    ],
)
def test_another_table_is_refused(tmp_path, text, sentence):
    path = tmp_path / 'table.csv'
    path.write_text(text)
    with pytest.raises(RecordingError, match=sentence):
        bench.read_actuators(path)
