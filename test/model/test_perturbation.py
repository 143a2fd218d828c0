"""The stacked neighbors of an arm are the neighbors, one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.softening import Softening
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.perturbation import neighbors, PerturbationTable, with_pressure_change
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from support.example_arms import ALL_MECHANICS, paper_arm

HISTORY = (Creep(amplitude=0.2, time_constant=3.0), Softening(loss=0.2))
MODEL = {
    'arm.length': 1e-3,
    'arm.clamp_angle': 0.02,
    'moment_law.split.1': 0.01,
    'moment_law.rigidity.1.0': 0.01,
    'intrinsic_curvature.curvature.2.3': 0.5,
}
ROWS = {'moment_law.pressure.1': 200.0, 'intrinsic_curvature.pressure.2': 150.0}
OF_EFFECTS = {
    'effects.creep.amplitude': 0.02,
    'effects.softening.loss': 0.05,
    'effects.gravity.weight_y': 0.1,
    'effects.pressure_elongation.strain_per_pascal': 1e-7,
}
SOME = (Gravity(weight_y=1.0), PressureElongation(strain_per_pascal_squared=1e-11), *HISTORY)


def unsure(moves: dict[str, float], effects=()) -> Arm:
    """Return an arm with a column for each of these quantities, and one for all of them."""
    std = np.array(list(moves.values()))
    factor = np.column_stack([np.diag(std), std])
    covariance = ModelCovariance(quantities=tuple(moves), factor=factor)
    return replace(paper_arm(effects), covariance=covariance)


@pytest.mark.parametrize(
    ('moves', 'effects'),
    [
        (MODEL, ()),
        (ROWS, ()),
        (MODEL, ALL_MECHANICS),
        (MODEL, HISTORY),
        (OF_EFFECTS, SOME),
        (MODEL | OF_EFFECTS, SOME),
    ],
    ids=['model', 'rows', 'mechanics', 'history', 'effects', 'all'],
)
def test_the_table_holds_the_record_of_every_neighbor(moves, effects):
    arm = unsure(moves, effects)
    table = PerturbationTable(arm=arm)
    assert arm.covariance is not None
    history = arm.actuate(arm.initial_history(50e3), 0.5, 30e3)[0]
    for pressure in (-2e3, 0.0, 12.34e3, 31e3, 66e3, 68e3):
        rods, changes = table.at(pressure, history)
        own, by_pressure = with_pressure_change(arm, pressure, history)
        np.testing.assert_array_equal(rods.sections, own.sections)
        np.testing.assert_array_equal(changes.sections[:, :1], by_pressure.sections)
        np.testing.assert_array_equal(changes.rotation[:, :1], by_pressure.rotation)
        for place, column in enumerate(arm.covariance.columns(), start=1):
            *sides, distance = neighbors(arm, column)
            assert changes.distance[place] == distance
            for side, neighbor in enumerate(sides):
                record = neighbor.rods(np.array([pressure]), history)
                for name in ('sections', 'clamp', 'rotation'):
                    found = getattr(changes, name)[side, place]
                    expected = getattr(record, name)[0]
                    scale = np.abs(expected).max(axis=0)
                    assert np.all(np.abs(found - expected) <= 1e-13 * scale), name
                np.testing.assert_array_equal(changes.knots[side, place], record.knots)
                assert changes.length[side, place] == record.length


def test_an_arm_without_covariance_changes_with_pressure_alone():
    rods, changes = PerturbationTable(arm=paper_arm()).at(31e3)
    own, by_pressure = with_pressure_change(paper_arm(), 31e3)
    np.testing.assert_array_equal(rods.rotation, own.rotation)
    for name in ('length', 'sections', 'clamp', 'knots', 'rotation', 'distance'):
        np.testing.assert_array_equal(getattr(changes, name), getattr(by_pressure, name))


def test_what_effects_add_at_every_pressure_alike_stands_in_the_table():
    table = PerturbationTable(arm=unsure(OF_EFFECTS, SOME))
    names = [table.arm.effects[place].name for place in table.changing]
    assert names == ['pressure_elongation']
    assert PerturbationTable(arm=unsure(MODEL, (EFFECTS['stiffening'](),))).equal_terms == ()


def test_a_record_moved_along_columns_is_that_of_the_moved_arm():
    arm = unsure(MODEL, SOME)
    table = PerturbationTable(arm=arm)
    rods, changes = table.at(31e3)
    amounts = 1e-3 * np.random.default_rng(3).standard_normal(table.distance.size)
    amounts[0] = 0.0
    moved = changes.moved(rods, amounts)
    step = np.asarray(arm.covariance.factor) @ amounts[1:]
    expected = arm.with_changes(dict(zip(arm.covariance.quantities, step.tolist(), strict=True)))
    record = expected.rods(np.array([31e3]))
    for name in ('length', 'sections', 'clamp', 'knots', 'rotation'):
        found, right, before = (getattr(item, name) for item in (moved, record, rods))
        size = np.abs(np.asarray(right) - before).max()
        assert np.abs(np.asarray(found) - right).max() <= 1e-4 * size + 1e-12, name
    assert changes.moved(rods, np.zeros(table.distance.size)) is rods


def test_a_further_column_is_one_that_no_calibration_knows():
    arm, change = unsure(MODEL), {'arm.clamp_angle': 0.02, 'moment_law.rigidity.1.0': 0.01}
    table = PerturbationTable(arm=arm, further=(change,))
    rods, beside = table.at(30e3)
    amounts = np.zeros(table.distance.size)
    amounts[-1] = 0.5
    moved = beside.moved(rods, amounts)
    half = arm.with_changes({name: 0.5 * amount for name, amount in change.items()})
    expected = half.rods(np.array([30e3])).record(0)
    assert table.distance.size == 1 + len(MODEL) + 1 + 1  # pressure, one each, all, further
    for name in ('sections', 'clamp', 'rotation', 'knots'):
        assert getattr(moved, name) == pytest.approx(getattr(expected, name), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    'moves', [MODEL, {'moment_law.rigidity.1.0': 0.01}], ids=['length', 'law']
)
def test_what_is_known_to_stay_moves_as_if_it_were_not_known(moves):
    table = PerturbationTable(arm=unsure(moves))
    rods, change = table.at(31e3)
    assert change.same_places is ('arm.length' not in moves)
    amounts = np.linspace(-1.0, 1.0, change.distance.size)
    known, unknown = change.moved(rods, amounts), replace(change, same_places=False)
    for one, other in zip(known, unknown.moved(rods, amounts), strict=True):
        assert np.array_equal(one, other)
    assert (known.length == rods.length) is change.same_places
