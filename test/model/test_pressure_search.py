"""The pressure for a wanted tip, or for a wanted force against a tip that is held."""

from __future__ import annotations

from dataclasses import replace
import json
import math

from pneunet_ros import save_model, solve
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RequestError
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.pressure_search import pressure_for_force, pressure_for_tip
import pytest
from support.example_arms import paper_arm
from support.refusals import refusal, refused


@pytest.mark.parametrize('force', [(0.0, 0.0), (0.1, 0.05)])
def test_the_pressure_of_a_tip_on_the_way_is_found(force):
    arm = paper_arm((PressureGain(gain=1.1),))
    pressure, shape = pressure_for_tip(arm, solve(arm, 27.3e3, force).tip[:2], force)
    assert pressure == pytest.approx(27.3e3, abs=1.0)
    assert shape.pressure == pytest.approx(1.1 * pressure)


def test_beside_the_way_the_nearest_place_is_taken():
    arm, step = paper_arm(), 50.0
    wanted = (0.095, 0.04)
    pressure, shape = pressure_for_tip(arm, wanted)
    sides = [math.dist(solve(arm, pressure + sign * step).tip[:2], wanted) for sign in (-1.0, 1.0)]
    assert math.dist(shape.tip[:2], wanted) < min(sides)


def test_the_pressure_of_a_force_is_found_where_the_tip_is_held():
    arm = paper_arm()
    tip = solve(arm, 20e3, (0.03, 0.01)).tip[:2]
    wanted = math.hypot(*solve_tip(arm, 26e3, tip).force)
    pressure, shape = pressure_for_force(arm, wanted, tip)
    assert math.hypot(*shape.force) == pytest.approx(wanted, rel=1e-3)
    assert shape.tip[:2] == pytest.approx(tip, abs=1e-8)
    assert 0.0 < pressure < 66e3


@pytest.mark.parametrize('wanted', [0.001, 0.018])
def test_of_several_pressures_it_is_the_lowest(wanted):
    arm = paper_arm()
    noisy = replace(arm, sensors=replace(arm.sensors, force_std=0.05))
    mid = 30e3
    tip = solve(arm, mid).tip[:2]
    pressure, shape = pressure_for_force(noisy, wanted, tip)
    assert math.hypot(*shape.force) == pytest.approx(wanted, abs=1e-6)
    assert 10e3 < pressure < mid  # the other one is above, 0.7 kPa for the smaller force


def test_the_limits_are_those_of_the_true_pressure():
    arm = paper_arm((PressureGain(gain=0.8), PressureOffset(offset=-2e3)))
    pressure, shape = pressure_for_tip(arm, solve(paper_arm(), 60e3).tip[:2])
    assert pressure == pytest.approx(77.5e3, abs=1.0)
    assert shape.pressure == pytest.approx(60e3, abs=1.0) and not shape.extrapolated
    pressure, _ = pressure_for_tip(arm, solve(paper_arm(), 0.0).tip[:2])
    assert pressure == pytest.approx(2.5e3, abs=1.0)


def test_predict_prints_the_reading(tmp_path, capsys):
    path = tmp_path / 'model.yaml'
    save_model(paper_arm((PressureGain(gain=1.1),)), path)
    assert main(['predict', '--model', str(path), '--pressure', '30kPa', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['pressure'] == 30e3
    assert main(['predict', '--model', str(path), '--pressure', '30kPa']) == 0
    assert '30.000' in capsys.readouterr().out


@pytest.mark.parametrize('tip', [(0.05,), (0.05, 0.05, 0.0), 0.05, (0.05, None)])
def test_a_tip_that_is_no_point_is_refused(tip):
    with refused(RequestError, 'not_finite'):
        pressure_for_tip(paper_arm(), tip)
    with refused(RequestError, 'not_finite'):
        pressure_for_force(paper_arm(), 0.1, tip)


def test_a_force_beyond_all_pressures_is_refused():
    arm = paper_arm()
    with refused(RequestError, 'not_reached'):
        pressure_for_force(arm, 5.0, solve(arm, 20e3).tip[:2])


def test_the_verb_takes_one_of_the_two(capsys):
    assert main(['predict', '--pressure-for', 'tip', '95mm', '40mm', '--json']) == 0
    assert '"pressure"' in capsys.readouterr().out
    for wrong in (
        [],
        ['--pressure', '1kPa', '--pressure-for', 'tip', '1', '1'],
        ['--pressure-for', 'tip', '1'],
        ['--pressure-for', 'force', '1'],
    ):
        assert main(['predict', *wrong]) == 2
    capsys.readouterr()
    words = ['predict', '--pressure', '1kPa', '--pressure-for', 'tip', '1', '1', '--json']
    assert refusal((main(words), *capsys.readouterr())) == 'exclusive'


def test_a_force_that_no_pressure_gives_is_a_negative_answer(capsys):
    words = ['predict', '--pressure', '20kPa', '--json']
    assert main(words) == 0
    keys = json.loads(capsys.readouterr().out).keys()
    tip = map(str, solve(paper_arm(), 20e3).tip[:2])
    assert main(['predict', '--pressure-for', 'force', '5', '--tip', *tip, '--json']) == 1
    said = json.loads(capsys.readouterr().out)
    assert said.keys() == keys
    assert (said['converged'], said['pressure'], said['tip']['x']) == (False, None, None)
    assert 'no pressure within the calibrated range gives 5 N' in said['status']
