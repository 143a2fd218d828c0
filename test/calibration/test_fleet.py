"""Arms side by side: the odd one is found, alike ones are not called odd, error bars count."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from pneunet_ros.calibration.calibration import describe_structure
from pneunet_ros.calibration.elongation import SIZE
from pneunet_ros.calibration.fleet import (
    arm_numbers,
    ArmNumber,
    ArmNumbers,
    compare_arms,
    compared_pressure,
    Fleet,
)
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from support.example_arms import paper_arm, vacuum_arm

NUMBERS = tuple(ArmNumber(name=name, meaning=name, unit='-') for name in 'abc')
CORRELATED = np.linalg.cholesky(0.9 + 0.1 * np.eye(3))


@pytest.fixture(autouse=True)
def fast(monkeypatch):
    """Simulate fewer fleets."""
    monkeypatch.setattr('pneunet_ros.calibration.fleet.DRAWS', 150)


def fleet(
    seed: int, arms: int = 24, errors: float = 0.5, moved: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> Fleet:
    """Compare alike arms whose numbers go together, scatter 1, the fourth of them moved."""
    random = np.random.default_rng(seed)
    known = {}
    for which in range(arms):
        std = errors * random.uniform(0.5, 1.5, 3)
        values = CORRELATED @ random.standard_normal(3) + std * random.standard_normal(3)
        values += np.array(moved) * (which == 3)
        known[f'arm{which}'] = ArmNumbers(
            values=dict(zip(NUMBERS, values.tolist(), strict=True)), covariance=np.diag(std**2)
        )
    return compare_arms(known, 4e4)


def test_alike_arms_are_hardly_ever_called_odd():
    found = [fleet(seed) for seed in range(6)]
    assert sum(bool(item.odd) for item in found) <= 1


def test_an_arm_that_is_off_in_one_number_is_found_and_the_number_is_said():
    found = fleet(1, moved=(0.0, 12.0, 0.0))
    assert [found.names[place] for place in found.odd] == ['arm3']
    assert abs(found.center[1]) < 1.0  # it does not draw the center after it
    assert 0.5 < found.scatter[1] < 2.0


def test_numbers_that_do_not_go_together_are_odd_where_none_is_unusual_alone():
    found = fleet(2, arms=40, errors=0.05, moved=(2.2, -2.2, 0.0))
    assert 'arm3' in [found.names[place] for place in found.odd]


def test_a_large_error_bar_makes_no_odd_arm():
    random = np.random.default_rng(3)
    number = NUMBERS[0]
    values, stds = random.normal(0.0, 0.1, 20), np.full(20, 0.1)
    values[5], stds[5] = 8.0, 10.0
    arms = {
        f'arm{k}': ArmNumbers(values={number: values[k]}, covariance=[[stds[k] ** 2]])
        for k in range(20)
    }
    assert compare_arms(arms, 1.0).odd == ()
    sure = arms | {'arm5': ArmNumbers(values={number: 8.0}, covariance=[[0.01]])}
    found = compare_arms(sure, 1.0)
    assert [found.names[place] for place in found.odd] == ['arm5']


def test_an_arm_that_lacks_a_number_is_compared_by_the_others():
    random = np.random.default_rng(4)
    arms = {}
    for which in range(20):
        known = NUMBERS[:2] if which % 2 else NUMBERS
        values = random.standard_normal(len(known)) + 15.0 * (which == 7)
        arms[f'arm{which}'] = ArmNumbers(
            values=dict(zip(known, values.tolist(), strict=True)),
            covariance=0.01 * np.eye(len(known)),
        )
    found = compare_arms(arms, 1.0)
    assert [found.names[place] for place in found.odd] == ['arm7']
    assert np.isnan(found.values[7, 2])


def test_an_odd_arm_is_described_by_a_number_that_is_compared():
    random = np.random.default_rng(5)
    arms = {}
    for which in range(16):
        values = {NUMBERS[0]: random.standard_normal() + 15.0 * (which == 0)}
        if which < 3:  # too few for a comparison
            values[NUMBERS[1]] = (50.0, 0.0, 1e-3)[which]
        arms[f'arm{which}'] = ArmNumbers(values=values, covariance=1e-6 * np.eye(len(values)))
    found = compare_arms(arms, 1.0)
    assert [found.names[place] for place in found.odd] == ['arm0']
    assert 'arm0: a is ' in found.sentence


def test_of_few_arms_none_is_called_odd():
    few = fleet(5, arms=5, moved=(50.0, 0.0, 0.0))
    assert few.odd == ()
    assert few.values.shape == (5, 3)
    assert compare_arms({}, np.nan).sentence == few.sentence


def test_the_numbers_of_an_arm_and_their_error_bars():
    arm = paper_arm()
    top = arm.pressure_range[1]
    names = ('intrinsic_curvature.curvature.1.0', 'effects.extensibility.axial_stiffness')
    arm = replace(
        arm,
        effects=(Extensibility(axial_stiffness=40.0),),
        covariance=ModelCovariance(quantities=names, factor=np.diag([0.5, 3.0])),
    )
    found = arm_numbers(arm, top, loaded=True)
    by_name = {number.name: value for number, value in found.values.items()}
    stds = dict(zip(by_name, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    share = np.linspace(0.0, 1.0, 2001)
    turning = arm.length * np.mean(arm.intrinsic_curvature.at(top, share))
    assert by_name['turning'] == pytest.approx(turning, rel=1e-3)
    assert by_name['extensibility.axial_stiffness'] == 40.0
    assert stds['extensibility.axial_stiffness'] == pytest.approx(3.0)
    assert stds['bending_stiffness'] == 0.0
    assert by_name['bending_stiffness'] == arm.mean_stiffness(0.5 * top)
    assert 'bending_stiffness' not in {
        number.name for number in arm_numbers(arm, top, loaded=False).values
    }
    beyond = {number.name for number in arm_numbers(arm, 1.5 * top, loaded=False).values}
    assert 'turning' not in beyond
    assert 'turning_at_half' in beyond


def test_sections_in_series_are_as_soft_as_the_soft_one_lets_them_be():
    arm = paper_arm()
    (sections,) = arm.moment_law.sections(np.array([3e4]), arm.length, arm.weight)
    value = arm.mean_stiffness(3e4)
    assert sections[:, 1].min() < value < sections[:, 1].max()


def test_arms_are_compared_where_most_of_them_have_been():
    arm = paper_arm()
    low = replace(
        arm,
        intrinsic_curvature=replace(
            arm.intrinsic_curvature, pressure=0.5 * arm.intrinsic_curvature.pressure
        ),
    )
    top = arm.pressure_range[1]
    assert compared_pressure([arm] * 9 + [low]) == top
    assert compared_pressure([arm, low]) == low.pressure_range[1] < top


def test_an_arm_that_falls_short_by_noise_is_compared():
    """Recordings end where noise lets them end: numbers were missing in a third of equal arms."""
    arm = paper_arm()
    low, top = arm.pressure_range
    just_beyond = arm_numbers(arm, top + 0.01 * (top - low), loaded=True)
    assert {item.name for item in just_beyond.values} >= {'turning', 'bending_stiffness'}


def test_arms_under_vacuum_are_compared_at_their_vacuum():
    arm, mirrored = paper_arm(), vacuum_arm()
    top = compared_pressure([mirrored] * 9)
    assert top == mirrored.pressure_range[0] == -arm.pressure_range[1]
    found, same = (
        {number.name: value for number, value in numbers.values.items()}
        for numbers in (
            arm_numbers(mirrored, top, loaded=True),
            arm_numbers(arm, -top, loaded=True),
        )
    )
    assert found == pytest.approx(same)
    deeper = {item.name for item in arm_numbers(mirrored, 1.5 * top, loaded=True).values}
    assert 'turning' not in deeper
    assert 'turning_at_rest' in deeper


def test_an_arm_under_vacuum_is_as_long_as_at_its_vacuum():
    slope = np.zeros(SIZE)
    slope[0] = 1.0
    pressure = np.linspace(-60e3, 0.0, 7)
    parameters = SimpleNamespace(
        shapes=None, elongates=True, pressure=pressure, cells=0, before_law=SIZE
    )
    fit = SimpleNamespace(parameters=parameters, values=slope, covariance=np.eye(SIZE))
    (note,) = describe_structure(fit, None)
    assert 'the arm shortens under pressure' in note
    assert 'at -60 kPa' in note
