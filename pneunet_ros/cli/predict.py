"""`pneunet predict`: one solve, from the load or from the position of the tip."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
import math

import numpy as np
from pneunet_ros.cli.verb import (
    add_json,
    add_model,
    DONE,
    model_of,
    NEGATIVE,
    output_console,
    print_json,
)
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.noise_jacobian import true_load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain_position import locate_load
from pneunet_ros.model.equilibrium import (
    DEFAULT_STATIONS,
    failed_shape,
    solve,
    steady_pressure,
)
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.shape import Shape
from pneunet_ros.model.uncertainty import error_left_out
from rich.table import Table


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    add_model(parser)
    parser.add_argument(
        '--pressure', type=float, required=True, metavar='PA', help='gauge pressure, Pa'
    )
    parser.add_argument(
        '--force',
        type=float,
        nargs=2,
        metavar=('F1', 'F2'),
        help='force on the free end in the base frame, N (default: 0 0)',
    )
    parser.add_argument(
        '--moment',
        type=float,
        default=0.0,
        metavar='M',
        help='moment on the free end, N m (default: 0)',
    )
    parser.add_argument(
        '--tip',
        type=float,
        nargs=2,
        metavar=('X', 'Y'),
        help='position of the tip, m: also find the end force',
    )
    parser.add_argument(
        '--stations',
        type=int,
        default=DEFAULT_STATIONS,
        metavar='N',
        help=f'stations along the arm (default: {DEFAULT_STATIONS})',
    )
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Solve and print."""
    if arguments.tip and arguments.force:
        raise RequestError('give either --force or --tip: with --tip the force is the answer')
    arm = model_of(arguments)
    shape, estimate = solve_within_domain(arm, solved(arm, arguments), arguments.pressure)
    if arguments.json:
        print_json(content(arm, shape, estimate))
    else:
        show(arm, shape, estimate)
    return DONE if shape.converged else NEGATIVE


def solved(arm: Arm, arguments: Namespace) -> Shape:
    """Return the shape under the load, or that with its tip where it must be."""
    pressure, moment, stations = arguments.pressure, arguments.moment, arguments.stations
    if arguments.tip:
        tip = arguments.tip[0], arguments.tip[1]
        return solve_tip(arm, pressure, tip, moment, stations=stations)
    force = arguments.force or (0.0, 0.0)
    return solve(arm, pressure, (force[0], force[1]), moment, stations=stations)


def solve_within_domain(
    arm: Arm, shape: Shape, pressure: float
) -> tuple[Shape, ShapeEstimate | None]:
    """Return a shape with its uncertainty; none of both where the model says nothing of the load.

    pressure: what the sensor reads, Pa.
    """
    if not shape.converged:
        return shape, None
    load = Load(
        pressure=shape.pressure,
        force_x=shape.force[0],
        force_y=shape.force[1],
        moment=shape.end_moment,
    )
    position = locate_load(arm, load, steady_pressure(arm, shape.pressure))
    if position.reason:
        failed = failed_shape(arm, load, shape.arclength, position.sentence, math.nan, 0)
        return replace(failed, extrapolated=True), None
    settings = EstimatorSettings(stations=shape.arclength.size)
    return shape, estimate_uncertainty(Estimator(arm=arm, settings=settings), shape, pressure)


def estimate_uncertainty(
    estimator: Estimator, shape: Shape, pressure: float
) -> ShapeEstimate | None:
    """Return the answer as the estimator gives it, with Jacobian and covariance."""
    state = EstimatorState(solution=shape.solution)
    along, across, moment = wrench_read(estimator, shape, pressure)
    force = WrenchReading(
        stamp_ns=1, force_x=along, force_y=across, moment=moment, frame_id=BASE_FRAME
    )
    state, _ = estimator.step(state, force)
    _, outcome = estimator.step(state, PressureReading(stamp_ns=1, pressure=pressure))
    return outcome if isinstance(outcome, ShapeEstimate) else None


def wrench_read(estimator: Estimator, shape: Shape, pressure: float) -> list[float]:
    """Return F1, F2 and M that sensors show under the true load; all sensing is affine."""
    nothing = true_load(estimator.arm, (0.0, 0.0, 0.0, pressure))[:3]
    units = np.eye(3).tolist()
    responses = [true_load(estimator.arm, (*unit, pressure))[:3] - nothing for unit in units]
    true = np.array([*shape.force, shape.end_moment])
    read: list[float] = np.linalg.solve(np.transpose(responses), true - nothing).tolist()
    return read


def content(arm: Arm, shape: Shape, estimate: ShapeEstimate | None) -> dict[str, object]:
    """Return the JSON of the contract."""
    x, y, theta = shape.tip
    return {
        'status': shape.status,
        'converged': shape.converged,
        'residual': shape.residual,
        'iterations': shape.iterations,
        'stable': shape.stable,
        'extrapolated': shape.extrapolated,
        'pressure': shape.pressure,
        'force': list(shape.force),
        'moment_at_end': shape.end_moment,
        'arclength': shape.arclength,
        'x': shape.x,
        'y': shape.y,
        'theta': shape.theta,
        'curvature': shape.curvature,
        'intrinsic_curvature': shape.intrinsic_curvature,
        'moment': shape.moment,
        'tip': {'x': x, 'y': y, 'theta': theta},
        'tip_std': None
        if estimate is None
        else dict(zip('xy', tip_std(estimate)[:2], strict=True)) | {'theta': tip_std(estimate)[2]},
        'std_leaves_out': error_left_out(arm.covariance, arm.sources),
        'warnings': [] if estimate is None else list(estimate.warnings),
        'jacobian': None if estimate is None else estimate.jacobian,
    }


def tip_std(estimate: ShapeEstimate) -> list[float]:
    """Return standard deviations of x, y (m) and theta (rad) of the tip."""
    deviations: list[float] = np.sqrt(np.diag(estimate.tip_covariance)).tolist()
    return deviations


def show(arm: Arm, shape: Shape, estimate: ShapeEstimate | None) -> None:
    """Print the answer for people."""
    console = output_console()
    residual = f' (residual {shape.residual:.1e} rad)' if shape.converged else ''
    console.print(f'{shape.status}{residual}')
    if not shape.converged or estimate is None:
        return
    x, y, theta = shape.tip
    std = tip_std(estimate)
    table = Table(show_header=True)
    for name in ('quantity', 'value', 'std', 'unit'):
        table.add_column(name, justify='left' if name in ('quantity', 'unit') else 'right')
    table.add_row('pressure', f'{kilopascals(shape.pressure):.3f}', '', 'kPa')
    table.add_row('end force F1', f'{shape.force[0]:.5f}', '', 'N')
    table.add_row('end force F2', f'{shape.force[1]:.5f}', '', 'N')
    table.add_row('end moment', f'{1000.0 * shape.end_moment:.4f}', '', 'mN m')
    table.add_row('tip x', f'{millimeters(x):.3f}', f'{millimeters(std[0]):.3f}', 'mm')
    table.add_row('tip y', f'{millimeters(y):.3f}', f'{millimeters(std[1]):.3f}', 'mm')
    table.add_row(
        'tip heading', f'{math.degrees(theta):.3f}', f'{math.degrees(std[2]):.3f}', 'deg'
    )
    largest = int(np.argmax(np.abs(shape.curvature)))
    at = millimeters(float(shape.arclength[largest]))
    table.add_row(
        'largest curvature',
        f'{shape.curvature[largest]:.3f}',
        f'{estimate.std_curvature[largest]:.3f}',
        f'1/m, at {at:.0f} mm',
    )
    table.add_row('moment at the clamp', f'{1000.0 * shape.moment[0]:.4f}', '', 'mN m')
    console.print(table)
    left_out = error_left_out(arm.covariance, arm.sources)
    if left_out:
        console.print(f'note: {left_out}')
