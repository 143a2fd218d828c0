"""Which meaning of end wrench readings is the most likely."""

from __future__ import annotations

import cmath
from dataclasses import replace
import math

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.sensor_mapping import base_wrench
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.meaning.wrench_judge import (
    expected_load,
    judge_wrench,
    load_hint,
    ShownForces,
    WrenchConvention,
)
import pytest

ARM = load_model(share_path('config/paper_arm.yaml'))
DICE = np.random.default_rng(7)
NEWTON = WrenchConvention()
PRESSURE = np.linspace(0.0, 66e3, 12)
FORCE = np.linspace(0.25, 0.15, 12) + 1j * np.linspace(0.0, 0.27, 12)
PULLS = DICE.uniform(-0.2, 0.2, 12) + 1j * DICE.uniform(-0.2, 0.2, 12)
TRUE = {
    'mN': WrenchConvention(unit='mN'),
    'gf': WrenchConvention(unit='gf'),
    'reaction': WrenchConvention(sign=-1),
    'reaction in gf': WrenchConvention(unit='gf', sign=-1),
    'turned': WrenchConvention(yaw=0.5 * math.pi),
}
SHOWN = TRUE | {
    'kgf': WrenchConvention(unit='kgf'),
    'lbf': WrenchConvention(unit='lbf'),
    'askew': WrenchConvention(yaw=-0.7),
    'untared': WrenchConvention(offset_x=0.1, offset_y=-0.08),
}


def shown(meaning, force):
    noise = 0.01 * (DICE.normal(size=force.size) + 1j * DICE.normal(size=force.size))
    return ShownForces(
        force=force + noise,
        std=np.full(force.size, 0.01),
        reading=meaning.reading(force),
        scale=ARM.domain.largest_force,
    )


def equivalent(one, other):
    """Whether two meanings take the same force for a reading."""
    return abs(one.factor / other.factor - 1.0) < 0.1 and abs(one.offset - other.offset) < 0.03


@pytest.mark.parametrize('name', TRUE)
def test_the_calibrated_loads_tell_unit_sign_and_axes(name):
    found = judge_wrench(TRUE[name].reading(FORCE), NEWTON, expected_load(ARM, PRESSURE), None)
    assert found.contradicted
    assert equivalent(found.other, TRUE[name])


@pytest.mark.parametrize('force', [FORCE, PULLS], ids=['strings', 'all around'])
@pytest.mark.parametrize('name', SHOWN)
def test_targets_tell_more(name, force):
    meaning = SHOWN[name]
    found = judge_wrench(meaning.reading(force), NEWTON, None, shown(meaning, force))
    assert found.contradicted
    assert equivalent(found.other, meaning)
    assert set(found.changes) == set(meaning.changes_from(NEWTON))


@pytest.mark.parametrize('force', [FORCE, PULLS, 1.3 * FORCE, 0.3 * FORCE, 0.0 * FORCE])
def test_right_readings_are_not_accused(force):
    for expected in (None, expected_load(ARM, PRESSURE)):
        for seen in (None, shown(NEWTON, force)):
            found = judge_wrench(force, NEWTON, expected, seen)
            if expected is not None and force is PULLS and seen is None:
                continue  # loads of directions that were not calibrated: no estimates either
            assert found is None or not found.contradicted


@pytest.mark.parametrize('share', [0.0, 0.2])
def test_an_error_of_the_model_is_no_tare(share):
    force = share * FORCE + 0.002 * (DICE.normal(size=12) + 1j * DICE.normal(size=12))
    of_model = replace(shown(NEWTON, force), force=force + 0.03j, std=np.full(12, 0.003))
    for expected in (None, expected_load(ARM, PRESSURE)):
        found = judge_wrench(force, NEWTON, expected, of_model)
        assert found.log_odds < found.limit


def test_a_declared_meaning_that_is_right_is_kept():
    meaning = WrenchConvention(unit='gf', sign=-1, yaw=0.3)
    found = judge_wrench(
        meaning.reading(FORCE), meaning, expected_load(ARM, PRESSURE), shown(meaning, FORCE)
    )
    assert not found.contradicted


def test_one_load_outside_the_domain_hints_at_its_unit():
    assert 'wrench_unit' in load_hint(ARM, NEWTON, 175.0 + 70.0j, 31e3)
    assert 'wrench_sign' in load_hint(ARM, NEWTON, -0.175 - 0.07j, 31e3)
    assert load_hint(ARM, NEWTON, 0.175 + 0.07j, 31e3) == ''


@pytest.mark.parametrize('meaning', SHOWN.values(), ids=SHOWN)
def test_the_estimator_takes_a_wrench_as_the_judge_does(meaning):
    settings = EstimatorSettings(
        wrench_unit=meaning.unit,
        wrench_sign=meaning.sign,
        wrench_yaw=meaning.yaw,
        force_offset_x=meaning.offset_x,
        force_offset_y=meaning.offset_y,
    )
    assert settings.wrench == meaning
    reading = complex(meaning.reading(np.array([cmath.rect(0.2, 0.4)]))[0])
    wrench = base_wrench(
        settings,
        WrenchReading(
            stamp_ns=1, force_x=reading.real, force_y=reading.imag, moment=0.0, frame_id=''
        ),
    )
    assert complex(wrench.force_x, wrench.force_y) == pytest.approx(cmath.rect(0.2, 0.4))
