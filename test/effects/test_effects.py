"""Properties that hold for every effect in the table: a new line there is covered here."""

from __future__ import annotations

from dataclasses import fields, FrozenInstanceError, replace
import json
import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.camera_rotation import CameraRotation
from pneunet_ros.effects.camera_scale import CameraScale
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.effect import Effect, Load, Loads, PressureScale, Terms
from pneunet_ros.effects.force_misalignment import ForceMisalignment
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.effects.softening import Softening
from pneunet_ros.effects.user_effects import contract_violation
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.files.model_file import load_model, save_model
from pneunet_ros.model.equilibrium import (
    linearize_shape,
    solve,
    solve_rod,
    station_arclength,
    tip_jacobian,
)
from pneunet_ros.model.perturbation import Perturbation, with_pressure_change
from pneunet_ros.model.uncertainty import ModelCovariance
from pneunet_ros.solver.columns import RIGIDITY
import pytest
from support.example_arms import ALL_MECHANICS, paper_arm, rebuilt
from support.refusals import refused

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
    'camera_delay': {'delay': 's'},
    'camera_tilt': {'tilt_x': '1/m', 'tilt_y': '1/m'},
    'lens_distortion': {'radial': '1/m^2', 'middle_x': 'm', 'middle_y': 'm'},
    'contact': {'force': 'N', 'arclength': '-'},
    'inertia': {'tip_mass': 'kg', 'damping_time': 's'},
}


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
# The table of kappa_p0 has rows inside and at the ends of the pressures below.
SCALE = PressureScale(rows=(0.0, 12e3, 30e3, 41e3, 66e3), top=66e3, std=60.0)
every_effect = pytest.mark.parametrize('effect', EFFECTS.values(), ids=EFFECTS)
every_parameter = pytest.mark.parametrize('parameter', PARAMETERS, ids=lambda item: item.path)


def likely(effect: type[Effect]) -> Effect:
    """Make an effect with all its parameters at likely values."""
    return effect(**{item.name: item.value for item in PARAMETERS if item.effect is effect})


def sees(effect):
    """Whether an effect changes where or when points are measured, and no estimate."""
    return bool({'see', 'frame_delay'} & set(vars(effect)))


ESTIMATED = [item for item in PARAMETERS if not sees(item.effect)]
estimated_parameter = pytest.mark.parametrize('parameter', ESTIMATED, ids=lambda item: item.path)
# What moves an arm does nothing to its equilibrium.
static_parameter = pytest.mark.parametrize(
    'parameter',
    [item for item in ESTIMATED if item.effect.place != 'motion'],
    ids=lambda item: item.path,
)


# ---- what an effect declares -------------------------------------------------------------------


@pytest.mark.parametrize(
    'effect',
    [item for item in EFFECTS.values() if item.__module__.startswith('pneunet_ros.effects.')],
    ids=lambda item: item.name,
)
def test_names_and_units_are_those_of_the_contract(effect):
    declared = {item.name: item.metadata['unit'] for item in quantities(effect)}
    assert declared == CONTRACT[effect.name]


@every_effect
def test_an_effect_acts_in_its_place_and_nowhere_else(effect):
    assert not contract_violation(effect)
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
def test_a_neutral_effect_adds_nothing(effect):
    neutral, pressure = effect(), np.array([5e3, 40e3])
    loads = Loads(
        pressure=pressure,
        force_x=np.array([0.1, 0.2]),
        force_y=np.array([0.0, 0.1]),
        moment=np.array([1e-3, 0.0]),
    )
    history, _ = neutral.actuate(neutral.initial(10e3, SCALE), 0.1, 30e3, SCALE)
    for terms in (
        neutral.terms(pressure),
        neutral.load_terms(loads),
        neutral.history_terms(np.array(history), SCALE),
    ):
        for item in fields(Terms):
            if item.name not in ('part', 'row_weights'):
                assert np.all(getattr(terms, item.name) == item.default), item.name


@every_effect
def test_a_neutral_effect_is_the_base_model_to_the_last_bit(effect, base_estimates):
    neutral = estimates(paper_arm((effect(),)))
    assert all(map(same_values, neutral, base_estimates))


def test_all_neutral_effects_together_are_the_base_model_to_the_last_bit(base_estimates):
    neutral = estimates(paper_arm(tuple(effect() for effect in EFFECTS.values())))
    assert all(map(same_values, neutral, base_estimates))


@estimated_parameter
def test_a_likely_value_moves_the_tip(parameter):
    effect = likely(parameter.effect)
    neutral = replace(effect, **{parameter.name: parameter.neutral})
    moved = [
        math.dist(one.shape.tip[:2], other.shape.tip[:2])
        for one, other in zip(
            estimates(paper_arm((effect,))), estimates(paper_arm((neutral,))), strict=True
        )
    ]
    assert 1e-6 < max(moved) < 0.1  # m, of an arm of 0.112 m


@every_effect
def test_the_same_readings_give_the_same_estimates(effect):
    arm = paper_arm((likely(effect),))
    runs = [
        [replace(one, motion=one.motion and replace(one.motion, modes=None)) for one in made]
        for made in (estimates(arm), estimates(arm))
    ]
    assert all(map(same_values, *runs))


# ---- sensitivities -----------------------------------------------------------------------------


def up_and_down(arm):
    """Return history, true load and chamber pressure after a second from 20 to 50 to 40 kPa."""
    reading = Load(pressure=20e3, force_x=0.12, force_y=0.06, moment=2e-4)
    history = arm.initial_history(arm.sense(reading).pressure)
    for seconds, pressure in ((0.7, 50e3), (0.3, 40e3)):
        load = arm.sense(replace(reading, pressure=pressure))
        history, chamber = arm.actuate(history, seconds, load.pressure)
    return history, load, chamber


def causes(arm):
    """F1, F2, M and chamber pressure behind the readings of `up_and_down`."""
    _, load, chamber = up_and_down(arm)
    return np.array([load.force_x, load.force_y, load.moment, chamber])


def solved(arm):
    """Solve after `up_and_down`: x, y, theta, curvature, intrinsic curvature, moment."""
    history, load, chamber = up_and_down(arm)
    stations = station_arclength(arm.length, 57)
    rods = arm.rods(np.array([chamber]), history, load.row)
    shape = solve_rod(arm, rods, load, None, stations)
    assert shape.converged, shape.status
    rows = shape.x, shape.y, shape.theta, shape.curvature, shape.intrinsic_curvature, shape.moment
    return np.array(rows), shape


@static_parameter
@pytest.mark.parametrize('company', ['alone', 'among others'])
def test_solving_anew_agrees_with_the_linear_response(parameter, company):
    effects = {effect.name: effect for effect in ALL_MECHANICS if company != 'alone'}
    effects[parameter.effect.name] = likely(parameter.effect)
    arm = paper_arm(tuple(effects.values()))
    h = parameter.step
    less, more = arm.with_changes({parameter.path: -h}), arm.with_changes({parameter.path: h})
    anew = (solved(more)[0] - solved(less)[0]) / (2 * h)

    fields, shape = solved(arm)
    history, load, chamber = up_and_down(arm)
    rods, per_pascal = with_pressure_change(arm, chamber, history, load)
    before, after = (
        side.rods(rods.pressure, up_and_down(side)[0], load.row) for side in (less, more)
    )
    changes = per_pascal.followed_by(Perturbation.between(before, after, 2 * h))
    response = linearize_shape(shape.solution, rods, changes)
    # Through what a reading means and the chamber pressure; and through the record of the rod.
    through = [*((causes(more) - causes(less)) / (2 * h)), 1.0]
    linear = np.tensordot(through, response.stations(shape.arclength), axes=1)
    tip = through @ response.tip

    assert np.abs(anew[:2]).max() * (parameter.prior[1] - parameter.prior[0]) > 1e-5  # m
    for one, other, field in zip(linear, anew, fields, strict=True):
        rounding = 1e-14 * np.abs(field).max() / h
        wanted = pytest.approx(other, rel=1e-4, abs=1e-5 * np.abs(other).max() + rounding)
        assert one == wanted
    assert tip == pytest.approx(anew[:3, -1], rel=1e-4)


# ---- history and purity ------------------------------------------------------------------------


@every_effect
def test_an_effect_does_not_change_what_it_is_given(effect):
    effect = likely(effect)
    pressure = np.linspace(0.0, 66e3, 7)
    pressure.flags.writeable = False
    load = Load(pressure=30e3, force_x=0.1, force_y=0.2, moment=1e-4)
    history = effect.initial(10e3, SCALE)
    past = np.array(effect.actuate(history, 0.1, 20e3, SCALE)[0])
    past.flags.writeable = False
    assert same_values(effect.terms(pressure), effect.terms(pressure))
    loads = Loads(pressure=pressure, force_x=pressure, force_y=pressure, moment=pressure)
    assert same_values(effect.load_terms(loads), effect.load_terms(loads))
    assert same_values(effect.history_terms(past, SCALE), effect.history_terms(past, SCALE))
    assert effect.sense(load) == effect.sense(load)
    np.testing.assert_array_equal(effect.see(pressure, pressure), effect.see(pressure, pressure))
    again = (effect.actuate(history, 0.1, 20e3, SCALE) for _ in range(2))
    assert next(again) == next(again)
    assert history == effect.initial(10e3, SCALE)


@every_effect
def test_history_starts_in_equilibrium_and_stays_there(effect):
    effect = likely(effect)
    history = effect.initial(31e3, SCALE)
    _, chamber = effect.actuate(history, 0.0, 31e3, SCALE)
    for seconds in (0.0, 0.1, 7.0):
        history, later = effect.actuate(history, seconds, 31e3, SCALE)
        assert later == pytest.approx(chamber, rel=1e-15)
    assert history == pytest.approx(effect.initial(31e3, SCALE), rel=1e-15)


@every_effect
def test_history_is_a_tuple_of_numbers_and_survives_json(effect):
    effect = likely(effect)
    history, _ = effect.actuate(effect.initial(10e3, SCALE), 0.1, 30e3, SCALE)
    assert isinstance(history, tuple)
    assert all(type(value) is float for value in history)
    again = tuple(json.loads(json.dumps(history)))
    assert effect.actuate(again, 0.2, 5e3, SCALE) == effect.actuate(history, 0.2, 5e3, SCALE)


@every_effect
@pytest.mark.parametrize('share', [0.01, 0.4, 0.9])
def test_a_straight_line_may_be_read_in_one_go_or_in_two(effect, share):
    effect = likely(effect)
    begin, _ = effect.actuate(effect.initial(10e3, SCALE), 0.3, 25e3, SCALE)
    at_once = effect.actuate(begin, 1.5, 55e3, SCALE)
    halfway, _ = effect.actuate(begin, share * 1.5, 25e3 + share * 30e3, SCALE)
    in_two = effect.actuate(halfway, (1 - share) * 1.5, 55e3, SCALE)
    assert in_two[0] == pytest.approx(at_once[0], rel=1e-12)
    assert in_two[1] == pytest.approx(at_once[1], rel=1e-12)


def test_the_lag_follows_a_ramp_and_settles_in_a_hold():
    tau, rate = 0.4, 20e3
    lag = PressureLag(time_constant=tau)
    history = lag.initial(10e3, SCALE)
    for step in range(1, 11):  # a ramp: z = p - rate tau (1 - exp(-t / tau))
        time = 0.15 * step
        pressure = 10e3 + rate * time
        history, chamber = lag.actuate(history, 0.15, pressure, SCALE)
        assert chamber == pytest.approx(pressure - rate * tau * (1 - math.exp(-time / tau)))
    behind = pressure - chamber
    assert behind > 7e3
    for step in range(1, 11):  # a hold: z = p - behind exp(-t / tau)
        history, settled = lag.actuate(history, 0.15, pressure, SCALE)
        assert settled == pytest.approx(pressure - behind * math.exp(-0.15 * step / tau))


@pytest.mark.parametrize('tau', [1e-12, 5e-324])
def test_the_fastest_lag_is_none(tau):
    lag = PressureLag(time_constant=tau)
    _, chamber = lag.actuate(lag.initial(10e3, SCALE), 0.01, 30e3, SCALE)
    assert chamber == pytest.approx(30e3)


def chambers(effect, pressures):
    """Chamber pressures at readings 0.1 s apart, after a rest at the first."""
    history, found = effect.initial(pressures[0], SCALE), []
    for pressure in pressures:
        history, chamber = effect.actuate(history, 0.1, pressure, SCALE)
        found.append((chamber, effect.in_play(history)))
    return found


def test_the_play_takes_up_half_its_width_at_first_and_its_width_at_every_turn():
    play = Hysteresis(width=4e3)
    pressures = [10e3, 11e3, 12e3, 20e3, 20e3, 19e3, 16e3, 15e3, 17e3, 19e3, 19.5e3, 7e3]
    expected = [10e3, 10e3, 10e3, 18e3, 18e3, 18e3, 18e3, 17e3, 17e3, 17e3, 17.5e3, 9e3]
    inside = [True, True, False, False, False, True, False, False, True, False, False, False]
    assert chambers(play, pressures) == list(zip(expected, inside, strict=True))


def test_the_end_of_the_play_is_met_exactly_whatever_the_numbers():
    play = Hysteresis(width=1e3 / 3)
    ramp = (10e3 + np.cumsum(np.random.default_rng(1).uniform(200.0, 900.0, 200))).tolist()
    assert not any(in_play for _, in_play in chambers(play, ramp)[1:])
    assert not any(in_play for _, in_play in chambers(play, ramp[::-1])[1:])


def curvature_weights(creep, path):
    """Weights of the rows after (seconds, pressure)..., from a rest at the first pressure."""
    history = creep.initial(path[0][1], SCALE)
    for seconds, pressure in path[1:]:
        history, chamber = creep.actuate(history, seconds, pressure, SCALE)
        assert chamber == pressure
    return np.array(history[1:])


def hats(pressure):
    """Weights of the rows of a linear table, through numpy; outside it goes on."""
    rows = np.array(SCALE.rows)
    weights = np.array([np.interp(pressure, rows, row) for row in np.eye(rows.size)])
    for end, inner in ((0, 1), (-1, -2)):
        beyond = (pressure - rows[end]) / (rows[end] - rows[inner])
        if beyond > 0.0:
            weights[end] += beyond
            weights[inner] -= beyond
    return weights


@pytest.mark.parametrize('pressure', [-2e3, 0.0, 5e3, 12e3, 29e3, 66e3, 69e3])
def test_creep_starts_with_the_curvature_of_the_pressure(pressure):
    begun = np.array(Creep(amplitude=0.1).initial(pressure, SCALE)[1:])
    np.testing.assert_allclose(begun, hats(pressure), rtol=1e-14, atol=1e-16)


def test_creep_after_a_step_settles_exponentially():
    creep, tau = Creep(amplitude=0.1, time_constant=8.0), 8.0
    for time in (0.3, 4.0, 40.0):
        # A jump takes no time: the late part has not moved.
        found = curvature_weights(creep, [(0, 5e3), (0.0, 50e3), (time, 50e3)])
        expected = hats(50e3) + (hats(5e3) - hats(50e3)) * math.exp(-time / tau)
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-15)


def test_creep_on_a_ramp_between_two_rows_lags_like_a_first_order_line():
    tau, rate, time = 8.0, 1e3, 9.0
    creep = Creep(amplitude=0.1, time_constant=tau)
    found = curvature_weights(creep, [(0, 14e3), (time, 14e3 + rate * time)])
    behind = rate * tau * (1.0 - math.exp(-time / tau))
    np.testing.assert_allclose(found, hats(14e3 + rate * time - behind), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize('tau', [0.4, 3.0, 200.0])
def test_creep_over_many_rows_is_that_of_small_steps(tau):
    # Up over three rows, down beyond the lowest, up beyond the highest, and a rest.
    path = [(0.0, 5e3), (2.0, 55e3), (3.0, -2e3), (1.5, 68e3), (0.7, 68e3)]
    weights, before = hats(5e3), 5e3
    for seconds, pressure in path[1:]:
        steps = 3_000
        for step in range(steps):
            middle = before + (pressure - before) * (step + 0.5) / steps
            # The midpoint rule: second order, so 1e-6 of the answer is left.
            weights = hats(middle) + (weights - hats(middle)) * math.exp(-seconds / steps / tau)
        before = pressure
    found = curvature_weights(Creep(amplitude=0.1, time_constant=tau), path)
    np.testing.assert_allclose(found, weights, atol=2e-6)
    assert found.sum() == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize('tau', [0.0, 5e-324, 1e-12])
def test_the_fastest_creep_is_none(tau):
    found = curvature_weights(Creep(amplitude=1.0, time_constant=tau), [(0, 5e3), (0.1, 50e3)])
    np.testing.assert_allclose(found, hats(50e3), atol=1e-9)


def test_creep_leaves_part_of_the_intrinsic_curvature_behind():
    share = 0.2
    arm = paper_arm((Creep(amplitude=share, time_constant=60.0),))
    history, _ = arm.actuate(arm.initial_history(20e3), 0.0, 50e3)
    after = arm.rods(np.array([50e3]), history).rotation[0]
    fresh, settled = arm.rods(np.array([20e3, 50e3])).rotation
    np.testing.assert_allclose(after, (1 - share) * settled + share * fresh, rtol=1e-12)
    rested = arm.rods(np.array([50e3]), arm.initial_history(50e3)).rotation[0]
    np.testing.assert_allclose(rested, settled, rtol=1e-12)


def test_softening_begins_below_the_largest_pressure_and_ends_there():
    arm = paper_arm((Softening(loss=0.3),))
    top, history = arm.pressure_range[1], arm.initial_history(20e3)
    unconditioned = paper_arm()
    for pressure, largest in [
        (20e3, None),
        (50e3, None),
        (35e3, 50e3),
        (10e3, 50e3),
        (49e3, 50e3),
        (50e3, None),
        (60e3, None),
        (50e3, 60e3),
        (1.04 * top, None),
        (50e3, top),  # no loss beyond that of the calibrated range
    ]:
        history, chamber = arm.actuate(history, 0.1, pressure)
        assert chamber == pressure
        found = arm.rods(np.array([pressure]), history).sections[0, :, RIGIDITY]
        factor = 1.0 if largest is None else 1.0 - 0.3 * largest / top
        base = unconditioned.rods(np.array([pressure])).sections[0, :, RIGIDITY]
        np.testing.assert_allclose(found, factor * base, rtol=1e-14)


def test_noise_of_a_pressure_at_rest_softens_nothing():
    softening, noise = Softening(loss=0.3), np.random.default_rng(5).normal(0.0, 60.0, 10_000)
    history = softening.initial(30e3, SCALE)
    for pressure in 30e3 + noise:
        history, _ = softening.actuate(history, 0.01, float(pressure), SCALE)
        assert history[1] == 0.0
    history, _ = softening.actuate(history, 0.01, 29e3, SCALE)
    assert history[1] == 1.0


def test_an_arm_of_vacuum_alone_does_not_soften():
    vacuum = PressureScale(rows=(-60e3, 0.0), top=0.0, std=60.0)
    softening = Softening(loss=0.3)
    history, _ = softening.actuate(softening.initial(-1e3, vacuum), 1.0, -50e3, vacuum)
    assert softening.history_terms(np.array(history), vacuum).rigidity_factor == 1.0


def test_many_histories_at_once_are_those_one_by_one():
    arm = paper_arm(tuple(likely(EFFECTS[name]) for name in ('creep', 'softening')))
    pressures, history, histories = (20e3, 50e3, 30e3, 45e3), arm.initial_history(20e3), []
    for pressure in pressures:
        history, _ = arm.actuate(history, 3.0, pressure)
        histories.append(history)
    stacked = tuple(np.array(past) for past in zip(*histories, strict=True))
    together = arm.rods(np.array(pressures), stacked)
    for index, pressure in enumerate(pressures):
        alone = arm.rods(np.array([pressure]), histories[index])
        np.testing.assert_allclose(together.rotation[index], alone.rotation[0], rtol=1e-13)
        np.testing.assert_array_equal(together.sections[index], alone.sections[0])


def test_without_a_history_the_arm_has_rested_for_ever():
    effects = tuple(likely(EFFECTS[name]) for name in ('hysteresis', 'creep', 'softening'))
    pressures = np.array([10e3, 50e3])
    rested, base = paper_arm(effects).rods(pressures), paper_arm().rods(pressures)
    np.testing.assert_array_equal(rested.rotation, base.rotation)
    np.testing.assert_array_equal(rested.sections, base.sections)


# ---- what estimates make of a history ----------------------------------------------------------


def pressed(arm, *pressures):
    """Return the last estimate of an unloaded arm from pressures 0.1 s apart, and the state."""
    estimator = Estimator(arm=arm, settings=EstimatorSettings(wrench_required=False))
    state = EstimatorState()
    for index, pressure in enumerate(pressures):
        reading = PressureReading(stamp_ns=(index + 1) * 100_000_000, pressure=pressure)
        state, estimate = estimator.step(state, reading)
    assert isinstance(estimate, ShapeEstimate), estimate
    return estimate, state


def test_the_pressure_column_is_zero_in_the_gap_of_the_play_and_its_uncertainty_stays():
    arm, base = paper_arm((Hysteresis(width=4e3),)), paper_arm()
    for pressures, chamber, moves in [
        ((20e3,), 20e3, False),
        ((20e3, 21e3), 20e3, False),
        ((20e3, 30e3), 28e3, True),
        ((20e3, 30e3, 29e3), 28e3, False),
        ((20e3, 30e3, 25e3), 27e3, True),
    ]:
        found, _ = pressed(arm, *pressures)
        plain, _ = pressed(base, chamber)
        assert found.chamber_pressure == chamber
        expected = plain.jacobian * [float(moves), 1.0, 1.0, 1.0]
        np.testing.assert_allclose(found.jacobian, expected, rtol=1e-6, atol=1e-14)
        np.testing.assert_allclose(found.tip_covariance, plain.tip_covariance, rtol=1e-5)
        assert (found.jacobian[:, 0] == 0.0).all() == (not moves)


def test_the_jacobian_of_an_arm_at_rest_is_that_of_its_first_estimate():
    for name in EFFECTS:
        arm = paper_arm((likely(EFFECTS[name]),))
        first, _ = pressed(arm, 31e3)
        found = tip_jacobian(arm, solve(arm, 31e3))
        np.testing.assert_allclose(found, first.jacobian, rtol=1e-6, atol=1e-13, err_msg=name)


@pytest.mark.parametrize('name', ['pressure_lag', 'creep', 'softening'])
@pytest.mark.parametrize('pressures', [(20e3, 30e3), (20e3, 50e3, 30e3)])
def test_the_jacobian_is_what_a_sudden_change_of_the_chamber_does(name, pressures):
    arm = paper_arm((likely(EFFECTS[name]),))
    estimate, state = pressed(arm, *pressures)
    tips = []
    for step in (-5.0, 5.0):
        at = np.array([estimate.chamber_pressure + step])
        rods = arm.rods(at, state.history)
        load = Load(pressure=float(at[0]))
        shape = solve_rod(arm, rods, load, state.solution, estimate.shape.arclength)
        tips.append(shape.tip)
    slope = (np.array(tips[1]) - np.array(tips[0])) / 10.0
    np.testing.assert_allclose(estimate.jacobian[:, 0], slope, rtol=1e-5)


def test_the_neighbors_of_a_model_share_the_history_of_the_arm():
    # A loss of rigidity is uncertain only where there is one.
    arm = paper_arm((Softening(loss=0.3), EFFECTS['gravity'](weight_y=1.0)))
    unsure = rebuilt(
        arm, covariance=ModelCovariance(quantities=('effects.softening.loss',), factor=[[0.1]])
    )
    for pressures, grows in [((20e3, 50e3), False), ((20e3, 50e3, 30e3), True)]:
        found, sure = pressed(unsure, *pressures)[0], pressed(arm, *pressures)[0]
        more = np.diag(found.tip_covariance - sure.tip_covariance)
        assert (more > 0.1 * np.diag(sure.tip_covariance)).all() == grows
        assert (more == 0.0).all() == (not grows)


# ---- what a camera sees ------------------------------------------------------------------------


def test_measured_points_are_scaled_and_turned_about_the_base():
    x, y = np.array([[0.0, 0.03], [0.1, np.nan]]), np.array([[0.0, 0.04], [0.0, np.nan]])
    measured = paper_arm((CameraScale(factor=1.1),)).see(x, y)
    np.testing.assert_allclose(measured, (1.1 * x, 1.1 * y), rtol=1e-15)
    quarter = paper_arm((CameraRotation(angle=math.pi / 2),)).see(x, y)
    np.testing.assert_allclose(quarter, (-y, x), atol=1e-17)
    angle = 0.03
    both = paper_arm((CameraRotation(angle=angle), CameraScale(factor=0.9))).see(x, y)
    turned = 0.9 * np.exp(1j * angle) * (x + 1j * y)
    np.testing.assert_allclose(both, (turned.real, turned.imag), rtol=1e-14, atol=1e-17)


@every_effect
def test_an_effect_sees_neutrally_by_default_and_alike_every_time(effect):
    x, y = np.array([0.0, 0.05, np.nan]), np.array([0.0, 0.07, np.nan])
    np.testing.assert_array_equal(paper_arm((effect(),)).see(x, y), (x, y))
    found = paper_arm((likely(effect),)).see(x, y)
    assert ('see' in vars(effect)) == (abs(found[0][1] - x[1]) > 1e-4)
    assert (found[0][0], found[1][0]) == (0.0, 0.0)


@every_effect
def test_frames_are_in_time_by_default_and_delays_of_effects_add(effect):
    assert paper_arm((effect(),)).frame_delay == 0.0
    delayed = paper_arm((likely(effect),)).frame_delay
    assert ('frame_delay' in vars(effect)) == (delayed != 0.0)


@pytest.mark.parametrize(
    'effect', [item for item in EFFECTS.values() if sees(item)], ids=lambda item: item.name
)
def test_an_effect_of_the_camera_changes_no_estimate(effect, base_estimates):
    assert all(map(same_values, estimates(paper_arm((likely(effect),))), base_estimates))


def test_a_turned_force_sensor_is_turned_back():
    load = Load(pressure=10e3, force_x=0.2, force_y=0.0, moment=3e-4)
    true = paper_arm((ForceMisalignment(angle=math.pi / 6),)).sense(load)
    assert (true.force_x, true.force_y) == pytest.approx((0.2 * math.sqrt(0.75), 0.1), rel=1e-15)
    assert (true.pressure, true.moment) == (10e3, 3e-4)


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
    with refused(ModelError, 'given_twice'):
        paper_arm((effect(), likely(effect)))


def test_uncertainty_of_a_reading_passes_through_its_effects(base_estimates):
    # Error of the reading x gain, at the same pressure in the chamber.
    effects = (PressureGain(gain=0.5), PressureOffset(offset=5e3))
    first = estimates(paper_arm(effects))[0]
    assert first.chamber_pressure == base_estimates[0].chamber_pressure
    own = np.outer(first.jacobian[:, 0], first.jacobian[:, 0]) * (60.0**2)
    more = first.tip_covariance - base_estimates[0].tip_covariance
    assert more == pytest.approx(-0.75 * own, rel=1e-6, abs=1e-6 * np.abs(own).max())
