"""From the position of the tip to the end force and the shape (Figure 9 of the paper).

The end force is found by Levenberg and Marquardt's method on the tip's distance; each trial is a full solve
of the rod. Where the tip hardly moves with some force, that force is not determined, and this is said.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from pneunet_ros.arm import Arm
from pneunet_ros.effects.effect import Load
from pneunet_ros.equilibrium import (
    DEFAULT_STATIONS,
    check_finite,
    failed,
    respond,
    solve_rod,
    station_arclength,
    steady_pressure,
)
from pneunet_ros.rod import Rods
from pneunet_ros.shape import Array, Shape

DETERMINED = 1e-4  # m/N; below this singular value of d tip / d force a force is not determined
REACHED = 1e-14  # m; rounding of a tip position
NEAR = 1e-9  # of the length; a tip this close that cannot be improved counts as reached
MOST_TRIALS = 200


def solve_tip(
    arm: Arm,
    pressure: float,
    tip: tuple[float, float],
    moment: float = 0.0,
    start: Shape | None = None,
    stations: int = DEFAULT_STATIONS,
) -> Shape:
    """Find end force (N) and shape from the pressure (Pa, gauge) and the position of the tip (m).

    `moment` (N m) is the end moment, which must be known; `start` a neighboring shape whose branch is
    followed. The result's `force` is the force that the surroundings apply; where the tip does not
    determine it, the result is a failed Shape that says so. Raises RequestError for values that are no
    finite number.
    """
    check_finite(pressure=pressure, tip_x=tip[0], tip_y=tip[1], moment=moment)
    load = arm.sense(Load(pressure=pressure, moment=moment))
    rods = arm.rods(np.array([steady_pressure(arm, load.pressure)]))
    arclength = station_arclength(arm.length, stations)
    first = solve_rod(arm, rods, load, None, arclength, 0.0)
    if not first.converged:
        return first
    if start is not None and start.solution is not None:
        begun = replace(load, force_x=start.force[0], force_y=start.force[1])
        followed = solve_rod(arm, rods, begun, start.solution, arclength, 0.0)
        first = followed if followed.converged else first
    return descend(arm, rods, load, first, np.array(tip, dtype=np.float64))


def descend(arm: Arm, rods: Rods, load: Load, shape: Shape, tip: Array) -> Shape:
    """Levenberg-Marquardt from a shape to the one whose tip is at `tip`."""
    damping = 0.0
    miss = tip - shape.tip[:2]
    jacobian = force_jacobian(rods, shape)
    for _ in range(MOST_TRIALS):
        if math.hypot(*miss) <= REACHED:
            break
        normal = jacobian.T @ jacobian
        scale = max(float(np.trace(normal)), DETERMINED**2)
        step = np.linalg.lstsq(
            np.vstack([jacobian, math.sqrt(damping * scale) * np.eye(2)]),
            np.concatenate([miss, np.zeros(2)]),
            rcond=1e-12,
        )[0]
        trial = solve_rod(
            arm,
            rods,
            replace(
                load,
                force_x=shape.force[0] + float(step[0]),
                force_y=shape.force[1] + float(step[1]),
            ),
            shape.solution,
            shape.arclength,
            0.0,
        )
        if trial.converged and math.dist(tip, trial.tip[:2]) < math.hypot(*miss):
            shape = trial
            miss = tip - shape.tip[:2]
            jacobian = force_jacobian(rods, shape)
            damping = 0.0 if damping < 1e-6 else 0.1 * damping
        else:
            if math.hypot(*miss) <= 1e-12 * arm.length or damping > 1e8:
                break
            damping = max(10.0 * damping, 1e-4)
    distance = math.hypot(*miss)
    sentence = ''
    weakest = float(np.linalg.svd(jacobian, compute_uv=False)[-1])
    if distance > NEAR * arm.length:
        sentence = (
            f'no end force found that brings the tip to ({tip[0]:.6g}, {tip[1]:.6g}) m; '
            f'the nearest equilibrium found leaves {1000.0 * distance:.3g} mm'
        )
    elif weakest < DETERMINED:
        sentence = (
            'the end force is not determined by this tip position: along one direction 1 N moves the '
            f'tip by {1000.0 * weakest:.2g} mm only (at least {1000.0 * DETERMINED:.2g} mm is needed)'
        )
    if sentence:
        unknown = replace(load, force_x=math.nan, force_y=math.nan)
        return failed(arm, unknown, shape.arclength, sentence, distance, shape.iterations)
    return shape


def force_jacobian(rods: Rods, shape: Shape) -> Array:
    """d(x, y) of the tip / d(F1, F2), (2, 2) m/N."""
    assert shape.solution is not None
    tip: Array = respond(shape.solution, rods, (), shape.arclength[-1:]).tip
    return tip[:2, :2].T
