"""Properties that hold for every effect in the table: a new line there is covered here."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
import json
import math
from typing import NamedTuple

from arms import ALL_MECHANICS, paper_arm
import numpy as np
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect, Load
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.equilibrium import (
    Change,
    respond,
    solve_rod,
    station_arclength,
    with_pressure_change,
)
from pneunet_ros.errors import ModelError
from pneunet_ros.estimator import Estimator
from pneunet_ros.estimator_state import EstimatorState
from pneunet_ros.frames import BASE_FRAME
from pneunet_ros.model_file import load_model, save_model
from pneunet_ros.readings import PressureReading, WrenchReading
from pneunet_ros.shape import same_values, ShapeEstimate
from pneunet_ros.units import quantities
import pytest

# Names and units are part of the contract (design, section 2.5).
CONTRACT = {
    'extensibility': {'axial_stiffness': 'N'},
    'pressure_elongation': {'strain_per_pascal': '1/Pa', 'strain_per_pascal_squared': '1/Pa^2'},
    'gravity': {'weight_x': 'N/m', 'weight_y': 'N/m'},
    'clamp_compliance': {'compliance': 'rad/(N m)'},
    'load_offset': {'offset': 'm'},
    'pressure_offset': {'offset': 'Pa'},
    'pressure_gain': {'gain': '-'},
    'pressure_lag': {'time_constant': 's'},
    'hysteresis': {'width': 'Pa'},
    'creep': {'amplitude': '-', 'time_constant': 's'},
    'stiffening': {'coefficient': 'm^2'},
    'softening': {'loss': '-'},
    'force_misalignment': {'angle': 'rad'},
    'camera_scale': {'factor': '-'},
    'camera_rotation': {'angle': 'rad'},
}

# Where an effect may speak, by the place it declares.
MAY_DEFINE = {
    'sensing': {'sense'},
    'actuation': {'initial', 'actuate'},
    'material': {'terms'},
    'mechanics': {'terms'},
}
SPEAKS = set().union(*MAY_DEFINE.values())


class Parameter(NamedTuple):
    """A parameter of an effect, with a value that is likely and not neutral."""

    effect: type[Effect]
    name: str
    neutral: float
    bounds: tuple[float, float]
    prior: tuple[float, float]

    @property
    def path(self) -> str:
        return f'effects.{self.effect.name}.{self.name}'

    @property
    def value(self) -> float:
        """A value inside the prior that is not neutral and has no short binary form."""
        return self.prior[0] + 0.3 * (self.prior[1] - self.prior[0])

    @property
    def step(self) -> float:
        return 1e-4 * (self.prior[1] - self.prior[0])

    def at(self, value: object) -> Effect:
        return self.effect(**{self.name: value})


PARAMETERS = [
    Parameter(effect, item.name, item.default, item.metadata['bounds'], item.metadata['prior'])
    for effect in EFFECTS.values()
    for item in quantities(effect)
]
every_effect = pytest.mark.parametrize('effect', EFFECTS.values(), ids=EFFECTS)
every_parameter = pytest.mark.parametrize('parameter', PARAMETERS, ids=lambda item: item.path)


def likely(effect: type[Effect]) -> Effect:
    """Make an effect with all its parameters at likely values."""
    return effect(**{item.name: item.value for item in PARAMETERS if item.effect is effect})


# ---- what an effect declares -------------------------------------------------------------------


@every_effect
def test_names_and_units_are_those_of_the_contract(effect):
    declared = {item.name: item.metadata['unit'] for item in quantities(effect)}
    assert declared == CONTRACT[effect.name]


@every_effect
def test_an_effect_speaks_in_its_place_and_nowhere_else(effect):
    defined = SPEAKS & set(vars(effect))
    assert defined
    assert defined <= MAY_DEFINE[effect.place]
    assert effect.meaning
    assert effect.__doc__


@every_parameter
def test_a_parameter_is_declared_in_full(parameter):
    item = next(item for item in quantities(parameter.effect) if item.name == parameter.name)
    assert item.metadata['meaning']
    assert item.metadata['source'].startswith('prior: ')
    low, high = parameter.bounds
    assert low <= parameter.neutral <= high
    assert low <= parameter.prior[0] < parameter.prior[1] <= high
    assert all(math.isfinite(end) for end in parameter.prior)
    assert parameter.value != parameter.neutral


# ---- values ------------------------------------------------------------------------------------


@every_parameter
def test_both_bounds_are_allowed_and_what_lies_beyond_is_refused(parameter):
    for bound, beyond in zip(parameter.bounds, (-math.inf, math.inf), strict=True):
        assert getattr(parameter.at(bound), parameter.name) == bound
        if math.isinf(bound):
            continue
        with pytest.raises(ModelError) as caught:
            parameter.at(math.nextafter(bound, beyond))
        low, high = parameter.bounds
        assert str(caught.value).startswith(f'{parameter.path} = ')
        assert f'is not within [{low}, {high}]' in str(caught.value)


@every_parameter
@pytest.mark.parametrize('value', [math.nan, True, '0.5', None, [0.5]], ids=repr)
def test_what_is_no_number_is_refused(parameter, value):
    with pytest.raises(ModelError) as caught:
        parameter.at(value)
    assert str(caught.value).startswith(parameter.path)


@every_parameter
def test_an_effect_is_a_value(parameter):
    effect = parameter.at(parameter.value)
    assert effect == parameter.at(parameter.value) != parameter.effect()
    assert len({effect, parameter.at(parameter.value), parameter.effect()}) == 2
    with pytest.raises(FrozenInstanceError):
        setattr(effect, parameter.name, parameter.neutral)


@every_parameter
def test_a_value_survives_the_model_file_to_the_last_bit(parameter, tmp_path):
    effect = parameter.at(parameter.value / 3 if parameter.neutral == 0 else parameter.value)
    save_model(paper_arm((effect,)), tmp_path / 'model.yaml')
    assert load_model(tmp_path / 'model.yaml').effects == (effect,)


# ---- what an effect does to estimates ----------------------------------------------------------

PRESSURES = (10e3, 10e3, 18e3, 35e3, 52e3, 52e3, 52e3, 30e3, 6e3, 6e3)  # ramps and holds
WRENCHES = {0: (0.1, 0.02, 1e-4), 4: (0.15, 0.09, -2e-4), 7: (0.05, -0.03, 0.0)}


def readings():
    """Ten pressures, 0.1 s apart, and three end wrenches."""
    for index, pressure in enumerate(PRESSURES):
        stamp = (index + 1) * 100_000_000
        if index in WRENCHES:
            x, y, moment = WRENCHES[index]
            yield WrenchReading(
                stamp_ns=stamp, force_x=x, force_y=y, moment=moment, frame_id=BASE_FRAME
            )
        yield PressureReading(stamp_ns=stamp, pressure=pressure)


def estimates(arm):
    """Estimate from all readings."""
    estimator, state, made = Estimator(arm=arm), EstimatorState(), []
    for reading in readings():
        state, outcome = estimator.step(state, reading)
        if isinstance(reading, PressureReading):
            assert isinstance(outcome, ShapeEstimate), outcome
            made.append(outcome)
    assert len(made) == len(PRESSURES)
    return made


@pytest.fixture(scope='module')
def base_estimates():
    return estimates(paper_arm())


@every_effect
def test_a_neutral_effect_is_the_base_model_to_the_last_bit(effect, base_estimates):
    neutral = estimates(paper_arm((effect(),)))
    assert all(map(same_values, neutral, base_estimates))


def test_all_neutral_effects_together_are_the_base_model_to_the_last_bit(base_estimates):
    neutral = estimates(paper_arm(tuple(effect() for effect in EFFECTS.values())))
    assert all(map(same_values, neutral, base_estimates))


@every_parameter
def test_a_likely_value_moves_the_tip(parameter, base_estimates):
    changed = estimates(paper_arm((parameter.at(parameter.value),)))
    moved = [
        math.dist(one.shape.tip[:2], other.shape.tip[:2])
        for one, other in zip(changed, base_estimates, strict=True)
    ]
    assert 1e-5 < max(moved) < 0.05  # m, of an arm of 0.112 m


@every_effect
def test_the_same_readings_give_the_same_estimates(effect):
    arm = paper_arm((likely(effect),))
    assert all(map(same_values, estimates(arm), estimates(arm)))


# ---- sensitivities -----------------------------------------------------------------------------


def ramp_up(arm):
    """Give true load and chamber pressure, half a second into a ramp from 20 to 40 kPa."""
    reading = Load(pressure=20e3, force_x=0.12, force_y=0.06, moment=2e-4)
    history = arm.initial_history(arm.sense(reading).pressure)
    load = arm.sense(replace(reading, pressure=40e3))
    return load, arm.actuate(history, 0.5, load.pressure)[1]


def causes(arm):
    """F1, F2, M and chamber pressure behind the readings of `ramp_up`."""
    load, chamber = ramp_up(arm)
    return np.array([load.force_x, load.force_y, load.moment, chamber])


def solved(arm):
    """Solve at `ramp_up`: x, y, theta, curvature, intrinsic curvature, moment."""
    load, chamber = ramp_up(arm)
    stations = station_arclength(arm.length, 57)
    shape = solve_rod(arm, arm.rods(np.array([chamber])), load, None, stations, 1e-13)
    assert shape.converged, shape.status
    rows = shape.x, shape.y, shape.theta, shape.curvature, shape.intrinsic_curvature, shape.moment
    return np.array(rows), shape


@every_parameter
@pytest.mark.parametrize('company', ['alone', 'among others'])
def test_solving_anew_agrees_with_the_linear_response(parameter, company):
    effects = {effect.name: effect for effect in ALL_MECHANICS if company != 'alone'}
    effects[parameter.effect.name] = likely(parameter.effect)
    arm = paper_arm(tuple(effects.values()))
    h = parameter.step
    less, more = arm.changed({parameter.path: -h}), arm.changed({parameter.path: h})
    anew = (solved(more)[0] - solved(less)[0]) / (2 * h)

    _, shape = solved(arm)
    chamber = np.array([ramp_up(arm)[1]])
    rods, per_pascal = with_pressure_change(arm, chamber[0])
    change = Change(before=less.rods(chamber), after=more.rods(chamber), distance=2 * h)
    response = respond(shape.solution, rods, (per_pascal, change), shape.arclength)
    # Through what a reading means and the chamber pressure; and through the record of the rod.
    through = [*((causes(more) - causes(less)) / (2 * h)), 1.0]
    linear = np.tensordot(through, response.stations, axes=1)
    tip = through @ response.tip

    assert np.abs(anew[:2]).max() * (parameter.prior[1] - parameter.prior[0]) > 1e-5  # m
    for one, other in zip(linear, anew, strict=True):
        assert one == pytest.approx(other, rel=1e-4, abs=1e-5 * np.abs(other).max())
    assert tip == pytest.approx(anew[:3, -1], rel=1e-4)


# ---- history and purity ------------------------------------------------------------------------


@every_effect
def test_an_effect_does_not_change_what_it_is_given(effect):
    effect = likely(effect)
    pressure = np.linspace(0.0, 66e3, 7)
    pressure.flags.writeable = False
    load = Load(pressure=30e3, force_x=0.1, force_y=0.2, moment=1e-4)
    history = effect.initial(10e3)
    assert same_values(effect.terms(pressure), effect.terms(pressure))
    assert effect.sense(load) == effect.sense(load)
    assert effect.actuate(history, 0.1, 20e3) == effect.actuate(history, 0.1, 20e3)
    assert history == effect.initial(10e3)


@every_effect
def test_history_starts_in_equilibrium_and_stays_there(effect):
    effect = likely(effect)
    history = effect.initial(31e3)
    _, chamber = effect.actuate(history, 0.0, 31e3)
    for seconds in (0.0, 0.1, 7.0):
        history, later = effect.actuate(history, seconds, 31e3)
        assert later == pytest.approx(chamber, rel=1e-15)
    assert history == pytest.approx(effect.initial(31e3), rel=1e-15)


@every_effect
def test_history_is_a_tuple_of_numbers_and_survives_json(effect):
    effect = likely(effect)
    history, _ = effect.actuate(effect.initial(10e3), 0.1, 30e3)
    assert isinstance(history, tuple)
    assert all(type(value) is float for value in history)
    again = tuple(json.loads(json.dumps(history)))
    assert effect.actuate(again, 0.2, 5e3) == effect.actuate(history, 0.2, 5e3)


@every_effect
@pytest.mark.parametrize('share', [0.01, 0.4, 0.9])
def test_a_straight_line_may_be_read_in_one_go_or_in_two(effect, share):
    effect = likely(effect)
    begin, _ = effect.actuate(effect.initial(10e3), 0.3, 25e3)
    at_once = effect.actuate(begin, 1.5, 55e3)
    halfway, _ = effect.actuate(begin, share * 1.5, 25e3 + share * 30e3)
    in_two = effect.actuate(halfway, (1 - share) * 1.5, 55e3)
    assert in_two[0] == pytest.approx(at_once[0], rel=1e-12)
    assert in_two[1] == pytest.approx(at_once[1], rel=1e-12)


def test_the_lag_follows_a_ramp_and_settles_in_a_hold():
    tau, rate = 0.4, 20e3
    lag = PressureLag(time_constant=tau)
    history = lag.initial(10e3)
    for step in range(1, 11):  # a ramp: z = p - rate tau (1 - exp(-t / tau))
        time = 0.15 * step
        pressure = 10e3 + rate * time
        history, chamber = lag.actuate(history, 0.15, pressure)
        assert chamber == pytest.approx(pressure - rate * tau * (1 - math.exp(-time / tau)))
    behind = pressure - chamber
    assert behind > 7e3
    for step in range(1, 11):  # a hold: z = p - behind exp(-t / tau)
        history, settled = lag.actuate(history, 0.15, pressure)
        assert settled == pytest.approx(pressure - behind * math.exp(-0.15 * step / tau))


@pytest.mark.parametrize('tau', [1e-12, 5e-324])
def test_the_fastest_lag_is_none(tau):
    lag = PressureLag(time_constant=tau)
    _, chamber = lag.actuate(lag.initial(10e3), 0.01, 30e3)
    assert chamber == pytest.approx(30e3)


# ---- several effects ---------------------------------------------------------------------------


@pytest.mark.parametrize('reverse', [False, True])
def test_the_table_decides_the_order_whatever_the_order_in_the_file(tmp_path, reverse):
    lines = [
        '  pressure_gain: {gain: 1.1}',
        '  pressure_offset: {offset: 500.0}',
        '  gravity: {weight_y: 1.0}',
    ]
    save_model(paper_arm(), tmp_path / 'model.yaml')
    text = (tmp_path / 'model.yaml').read_text()
    assert text.count('effects: {}') == 1
    lines = '\n'.join(['effects:', *(reversed(lines) if reverse else lines)])
    (tmp_path / 'model.yaml').write_text(text.replace('effects: {}', lines))
    arm = load_model(tmp_path / 'model.yaml')
    names = [effect.name for effect in arm.effects]
    assert names == [name for name in EFFECTS if name in names]
    assert len(names) == 3
    # The gain comes before the offset.
    assert arm.sense(Load(pressure=10e3)).pressure == pytest.approx(1.1 * 10e3 + 500.0, rel=1e-15)


@every_effect
def test_an_effect_stands_once(effect):
    with pytest.raises(ModelError, match=f'given twice: {effect.name}, {effect.name}'):
        paper_arm((effect(), likely(effect)))


def test_uncertainty_of_a_reading_passes_through_its_effects(base_estimates):
    # Error of the reading x gain, at the same pressure in the chamber.
    effects = (PressureGain(gain=0.5), PressureOffset(offset=5e3))
    first = estimates(paper_arm(effects))[0]
    assert first.chamber_pressure == base_estimates[0].chamber_pressure
    own = np.outer(first.jacobian[:, 0], first.jacobian[:, 0]) * (60.0**2)
    more = first.tip_covariance - base_estimates[0].tip_covariance
    assert more == pytest.approx(-0.75 * own, rel=1e-6, abs=1e-6 * np.abs(own).max())
