"""`pneunet predict`: one solution, for a given load or for a given position of the tip."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.cli.quantity_option import quantity_of, quantity_type, string_of
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.unit_system import DIMENSIONLESS, SHOWN_SI, Unit, UnitSystem
from pneunet_ros.core.units import kilopascals, millimeters, PASCALS_PER_KILOPASCAL
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.measured_tip import with_measured_tip
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.errors.noise_jacobian import true_load
from pneunet_ros.measurement.errors.noise_model import measured_tip_std
from pneunet_ros.measurement.meaning.pressure_convention import GAUGE, PressureConvention
from pneunet_ros.measurement.meaning.pressure_judge import expected_of, judge_pressure, record_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain_position import locate_load
from pneunet_ros.model.equilibrium import (
    DEFAULT_STATIONS,
    failed_shape,
    solve,
    station_arclength,
    steady_pressure,
)
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.pressure_search import pressure_for_force, pressure_for_tip
from pneunet_ros.model.shape import Shape
from pneunet_ros.model.string import solve_string, tip_amplification
from pneunet_ros.model.uncertainty import error_left_out
from rich.console import Console


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prediction:
    """A shape, its uncertainty, and the covariance (2, 2) N^2 of an estimated force."""

    shape: Shape
    estimate: ShapeEstimate | None = None
    force_covariance: Array | None = None


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    verb.add_model(parser)
    verb.add_gravity(parser)
    parser.add_argument(
        '--pressure',
        type=quantity_type('pressure'),
        metavar='PA',
        help='gauge pressure: Pa, or with a unit, e.g. 31kPa',
    )
    parser.add_argument(
        '--pressure-for',
        nargs='+',
        metavar='WHAT',
        help='find the pressure: --pressure-for tip X Y brings the tip as close as possible to '
        'X, Y; --pressure-for force F --tip X Y presses with force F while the tip is held '
        'at X, Y',
    )
    parser.add_argument(
        '--force',
        type=quantity_type('force'),
        nargs=2,
        metavar=('F1', 'F2'),
        help='force on the free end in the base frame: N, or with a unit, e.g. 150mN, or 20g for '
        'a weight; a force or moment that is given, even 0, is one that a sensor reads, with '
        'its errors (default: 0 0)',
    )
    parser.add_argument(
        '--string',
        nargs=3,
        metavar=('TENSION', 'X', 'Y'),
        help='a thread pulls the tip to a fixed eye or pulley at X, Y (base frame; m, or with a '
        'unit, e.g. 300mm), in addition to --force; TENSION: N, or with a unit, e.g. 20g',
    )
    parser.add_argument(
        '--moment',
        type=quantity_type('moment'),
        metavar='M',
        help='moment on the free end: N m, or with a unit, e.g. 0.2mNm (default: 0)',
    )
    parser.add_argument(
        '--tip',
        type=quantity_type('length'),
        nargs=2,
        metavar=('X', 'Y'),
        help='position of the tip: m, or with a unit, e.g. 95mm; the end force is estimated '
        'from it',
    )
    parser.add_argument(
        '--tip-std',
        type=quantity_type('length'),
        metavar='M',
        help='standard deviation of X and of Y in --tip (default: that of a target in the '
        "model's `sensors`)",
    )
    verb.add_dimensionless(parser, 'print')


def run(arguments: Namespace) -> int:
    """Solve and print."""
    if arguments.tip and arguments.force:
        raise RequestError(
            'give either --force or --tip, not both: --tip estimates the force', reason='exclusive'
        )
    if arguments.string and (arguments.tip or arguments.pressure_for):
        raise RequestError(
            '--string needs --pressure and cannot be combined with --tip or --pressure-for',
            reason='exclusive',
        )
    if arguments.tip_std is not None and not arguments.tip:
        raise RequestError('--tip-std needs --tip', reason='missing')
    if arguments.tip_std is not None and not 0.0 <= arguments.tip_std < math.inf:
        raise RequestError(
            f'--tip-std {arguments.tip_std} must be a length in m, zero or more',
            reason='out_of_bounds',
        )
    if arguments.pressure is not None and arguments.pressure_for is not None:
        raise RequestError(
            'give either --pressure or --pressure-for, not both: the latter finds the pressure',
            reason='exclusive',
        )
    if arguments.pressure is None and arguments.pressure_for is None:
        raise RequestError(
            'give --pressure (e.g. 31kPa) or --pressure-for (e.g. tip 95mm 40mm)', reason='missing'
        )
    arm = verb.still_model_of(arguments)
    prediction = predict(arm, solve_requested(arm, arguments), arguments)
    shown = verb.units_of(arguments, arm, SHOWN_SI)
    verb.present(
        arguments,
        content(arm, prediction, arguments.pressure, verb.units_of(arguments, arm)),
        lambda console: show(arm, prediction, arguments.pressure, shown, console),
    )
    return verb.DONE if prediction.shape.converged else verb.NEGATIVE


def solve_requested(arm: Arm, arguments: Namespace) -> Shape:
    """Return the shape under the load, or with the tip held in place."""
    moment = arguments.moment or 0.0
    if arguments.pressure_for is not None:
        arguments.pressure, shape = solve_for_pressure(arm, arguments)
        return shape
    pressure = arguments.pressure
    if arguments.tip:
        tip = arguments.tip[0], arguments.tip[1]
        return solve_tip(arm, pressure, tip, moment)
    force = tuple(arguments.force or (0.0, 0.0))
    if arguments.string:
        thread = string_of('--string', arguments.string)
        return solve_string(arm, pressure, thread, (force[0], force[1]), moment)
    return solve(arm, pressure, (force[0], force[1]), moment)


def solve_for_pressure(arm: Arm, arguments: Namespace) -> tuple[float, Shape]:
    """Return the requested pressure as read by a sensor, NaN if there is none, and the shape."""
    try:
        return search_pressure(arm, arguments)
    except RequestError as error:
        if error.reason not in ('no_equilibrium', 'not_reached'):
            raise
        x, y = (math.nan, math.nan) if arguments.tip else arguments.force or (0.0, 0.0)
        load = Load(pressure=math.nan, force_x=x, force_y=y, moment=arguments.moment or 0.0)
        stations = station_arclength(arm.reach, DEFAULT_STATIONS)
        return math.nan, failed_shape(arm, load, stations, str(error), math.nan, 0)


def search_pressure(arm: Arm, arguments: Namespace) -> tuple[float, Shape]:
    """Return the pressure and the shape found by the search; RequestError if there are none."""
    what, *numbers = arguments.pressure_for
    moment = arguments.moment or 0.0
    force = tuple(arguments.force or (0.0, 0.0))
    if what == 'tip' and len(numbers) == 2 and not arguments.tip:
        x, y = (quantity_of('--pressure-for tip', text, 'length') for text in numbers)
        pressure, shape = pressure_for_tip(arm, (x, y), (force[0], force[1]), moment)
        missed = millimeters(math.dist(shape.tip[:2], (x, y)))
        status = f'{shape.status}; the tip comes within {missed:.3g} mm of the requested position'
        return pressure, replace(shape, status=status)
    if what == 'force' and len(numbers) == 1 and arguments.tip:
        target_force = quantity_of('--pressure-for force', numbers[0], 'force')
        return pressure_for_force(arm, target_force, tuple(arguments.tip), moment)
    raise RequestError(
        'write --pressure-for tip X Y (e.g. tip 95mm 40mm) or --pressure-for force F --tip X Y '
        '(e.g. force 50mN)',
        reason='wrong_form',
    )


def predict(arm: Arm, shape: Shape, arguments: Namespace) -> Prediction:
    """Return a shape with its uncertainty, or a failed one if the load is out of range."""
    if not shape.converged:
        return Prediction(shape=shape)
    load = Load(
        pressure=shape.pressure,
        force_x=shape.force[0],
        force_y=shape.force[1],
        moment=shape.end_moment,
    )
    position = locate_load(arm, load, steady_pressure(arm, shape.pressure))
    if position.reason:
        failed = failed_shape(arm, load, shape.arclength, position.sentence, math.nan, 0)
        return Prediction(shape=replace(failed, extrapolated=True))
    loaded = any((arguments.tip, arguments.string, arguments.force, arguments.moment is not None))
    estimator = Estimator(arm=arm, settings=EstimatorSettings(wrench_required=loaded))
    estimate = estimate_uncertainty(estimator, shape, arguments.pressure)
    if arguments.string and estimate is not None:
        thread = string_of('--string', arguments.string)
        turned = tip_amplification(thread, np.array(shape.tip), estimate.jacobian)
        estimate = replace(
            estimate,
            jacobian=turned @ estimate.jacobian,
            tip_covariance=turned @ estimate.tip_covariance @ turned.T,
            std_curvature=np.full_like(estimate.std_curvature, np.nan),  # at a fixed force
        )
    if not arguments.tip or estimate is None:
        return Prediction(shape=shape, estimate=estimate)
    std = arguments.tip_std
    measured = with_measured_tip(
        estimator, estimate, measured_tip_std(arm.sensors) if std is None else std
    )
    if measured is None:
        return Prediction(shape=shape)
    return Prediction(
        shape=shape, estimate=measured.estimate, force_covariance=measured.force_covariance
    )


def estimate_uncertainty(
    estimator: Estimator, shape: Shape, pressure: float
) -> ShapeEstimate | None:
    """Return the answer of the estimator, with Jacobian and covariance."""
    state = EstimatorState(solution=shape.solution)
    along, across, moment = measured_wrench(estimator, shape, pressure)
    force = WrenchReading(
        stamp_ns=1, force_x=along, force_y=across, moment=moment, frame_id=BASE_FRAME
    )
    state, _ = estimator.step(state, force)
    _, outcome = estimator.step(state, PressureReading(stamp_ns=1, pressure=pressure))
    return outcome if isinstance(outcome, ShapeEstimate) else None


def measured_wrench(estimator: Estimator, shape: Shape, pressure: float) -> list[float]:
    """Return F1, F2 and M as sensors read them under the true load; all sensing is affine."""
    offset = true_load(estimator.arm, (0.0, 0.0, 0.0, pressure))[:3]
    units = np.eye(3).tolist()
    responses = [true_load(estimator.arm, (*unit, pressure))[:3] - offset for unit in units]
    true = np.array([*shape.force, shape.end_moment])
    read: list[float] = np.linalg.solve(np.transpose(responses), true - offset).tolist()
    return read


def content(
    arm: Arm, prediction: Prediction, pressure: float, units: UnitSystem
) -> dict[str, Any]:
    """Return the documented JSON content at a reading of the pressure (Pa), in these units."""
    shape, estimate = prediction.shape, prediction.estimate
    length, force, moment = (getattr(units, kind).per_si for kind in ('length', 'force', 'moment'))
    curvature = units.curvature.per_si
    x, y, theta = shape.tip
    tip_std, jacobian = None, None
    if estimate is not None:
        std_x, std_y, std_theta = deviations(estimate.tip_covariance)
        tip_std = {'x': length * std_x, 'y': length * std_y, 'theta': std_theta}
        causes = np.array([1.0, force, force, moment])
        jacobian = np.array([length, length, 1.0])[:, None] * estimate.jacobian / causes
    covariance = prediction.force_covariance
    return {
        'units': units.name,
        'scales': {'length': units.length.size, 'force': units.force.size},
        'status': shape.status,
        'converged': shape.converged,
        'residual': shape.residual,
        'iterations': shape.iterations,
        'stable': shape.stable,
        'extrapolated': shape.extrapolated,
        'pressure': pressure,
        'force': [force * value for value in shape.force],
        'force_std': None
        if covariance is None
        else [force * value for value in deviations(covariance)],
        'force_covariance': None if covariance is None else force**2 * covariance,
        'moment_at_end': moment * shape.end_moment,
        'arclength': length * shape.arclength,
        'x': length * shape.x,
        'y': length * shape.y,
        'theta': shape.theta,
        'curvature': curvature * shape.curvature,
        'intrinsic_curvature': curvature * shape.intrinsic_curvature,
        'moment': moment * shape.moment,
        'tip': {'x': length * x, 'y': length * y, 'theta': theta},
        'tip_std': tip_std,
        'std_leaves_out': error_left_out(arm.covariance, arm.sources),
        'warnings': [] if estimate is None else list(estimate.warnings),
        'jacobian': jacobian,
    }


def deviations(covariance: Array) -> list[float]:
    """Return the standard deviations of a covariance."""
    found: list[float] = np.sqrt(np.diag(covariance)).tolist()
    return found


def show(
    arm: Arm, prediction: Prediction, pressure: float, units: UnitSystem, console: Console
) -> None:
    """Print the answer at a reading of the pressure (Pa) for users."""
    shape, estimate = prediction.shape, prediction.estimate
    residual = f' (residual {shape.residual:.1e} rad)' if shape.converged else ''
    console.print(f'{shape.status}{residual}')
    if not shape.converged or estimate is None:
        return
    rows = []

    def add(name: str, value: float, std: float | None, unit: Unit, places: int) -> None:
        """Add a row: value and standard deviation in this unit."""
        texts = (
            '' if item is None or math.isnan(item) else f'{unit.per_si * item:.{places}f}'
            for item in (value, std)
        )
        rows.append((name, *texts, unit.name))

    length, force, moment = units.length, units.force, units.moment
    places = 5 if units.name == DIMENSIONLESS else 3
    covariance = prediction.force_covariance
    force_std = [None, None] if covariance is None else deviations(covariance)
    std = deviations(estimate.tip_covariance)
    largest = int(np.argmax(np.abs(shape.curvature)))
    at = f'at {length.per_si * shape.arclength[largest]:.3g} {length.name}'
    add('pressure', pressure, None, Unit(name='kPa', size=PASCALS_PER_KILOPASCAL), 3)
    for index, name in enumerate(('end force F1', 'end force F2')):
        add(name, shape.force[index], force_std[index], force, 5)
    add('end moment', shape.end_moment, None, moment, 4)
    for index, name in enumerate(('tip x', 'tip y')):
        add(name, shape.tip[index], std[index], length, places)
    add('tip heading', shape.tip[2], std[2], Unit(name='deg', size=math.radians(1.0)), 3)
    add(
        'largest curvature',
        float(shape.curvature[largest]),
        float(estimate.std_curvature[largest]),
        Unit(name=f'{units.curvature.name}, {at}', size=units.curvature.size),
        3,
    )
    add('moment at the clamp', float(shape.moment[0]), None, moment, 4)
    print_rows(console, '', ('quantity', 'value', 'std', 'unit'), rows, numbers=(1, 2))
    if units.name == DIMENSIONLESS:
        console.print(verb.scales_sentence(arm))
    left_out = error_left_out(arm.covariance, arm.sources)
    verb.print_notes(console, filter(None, (left_out, likely_pressure(arm, pressure))))


def likely_pressure(arm: Arm, pressure: float) -> str:
    """Return a question if a pressure (Pa) is so small that another unit was probably meant."""
    record = record_of([0], [pressure])
    verdict = judge_pressure(
        record, PressureConvention(), [expected_of(arm)], moves=True, running=True
    )
    if verdict is None or verdict.log_odds < 0.0 or verdict.other.reference != GAUGE:
        return ''
    low, high = arm.pressure_range
    return (
        f'the model is calibrated from {kilopascals(low):g} to {kilopascals(high):g} kPa; is '
        f'--pressure {verdict.other.sign * pressure:g}{verdict.other.unit} meant?'
    )
