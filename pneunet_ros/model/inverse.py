"""From the position of the tip to the end force and the shape (Figure 9 of the paper).

The end force is found by Levenberg and Marquardt's method on the distance of the tip; each trial
is a full solve of the rod. Where the tip hardly moves with some force, that force is not
determined, and this is said.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import (
    check_finite,
    DEFAULT_STATIONS,
    failed,
    linearize,
    solve_rod,
    station_arclength,
    steady_pressure,
)
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.solution import SolverNodes

DETERMINED = 1e-4  # m/N; below this singular value of d tip / d force a force is not determined
ROUNDING = 1e-13  # of the length; nearer than this no step helps
ARRIVED = 1e-10  # of the length; a tip this near is where it should be
NEAR = 1e-3  # of the length; nearly there, where the force is not determined anyway
PULLS = (-1.5, 1.5, 5.0, 15.0, 50.0)  # in B / l^2
MOST_TRIALS = 150


def solve_tip(
    arm: Arm,
    pressure: float,
    tip: tuple[float, float],
    moment: float = 0.0,
    start: Shape | None = None,
    stations: int = DEFAULT_STATIONS,
) -> Shape:
    """Find end force (N) and shape from the pressure (Pa, gauge) and the position of the tip (m).

    `moment` (N m) is the end moment, which must be known; `start` a neighboring shape whose branch
    is followed. The result's `force` is the force that the surroundings apply; where the tip does
    not determine it, the result is a failed Shape that says so. Raises RequestError for values
    that are no finite number.
    """
    check_finite(pressure=pressure, tip_x=tip[0], tip_y=tip[1], moment=moment)
    load = arm.sense(Load(pressure=pressure, moment=moment))
    rods = arm.rods(np.array([steady_pressure(arm, load.pressure)]))
    arclength = station_arclength(arm.length, stations)
    search = TipSearch(arm=arm, rods=rods, load=load, tip=np.array(tip, dtype=np.float64))
    unloaded = search.at((0.0, 0.0), None, arclength)
    begins = search.begins(unloaded) if unloaded.converged else []
    if start is not None and start.solution is not None:
        followed = search.at(start.force, start.solution, arclength)
        begins = [followed, *begins] if followed.converged else begins
    if not begins:
        return replace(unloaded, force=(math.nan, math.nan))
    found = [begins[0]]
    for begin in begins:
        found.append(search.descend(begin))
        if search.miss(found[-1]) <= ROUNDING * arm.length:
            break
    return search.judged(min(found, key=search.miss))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipSearch:
    """The search for the end force that brings the tip of one rod to `tip` (2,) m."""

    arm: Arm
    rods: Rods
    load: Load
    tip: Array

    def at(
        self,
        force: tuple[float, float],
        start: SolverNodes | None,
        arclength: Array,
        quick: bool = False,
    ) -> Shape:
        """Return the shape under a trial force; quick: or give up soon."""
        load = replace(self.load, force_x=float(force[0]), force_y=float(force[1]))
        return solve_rod(self.arm, self.rods, load, start, arclength, 0.0, quick)

    def miss(self, shape: Shape) -> float:
        """Distance (m) of a shape's tip from where it should be."""
        return math.dist(shape.tip[:2], self.tip)

    def begins(self, unloaded: Shape) -> list[Shape]:
        """Shapes to start from, nearest tip first: unloaded, and pulled or pushed along the chord.

        The pulls are multiples of B / l^2, the force at which the arm's own stiffness gives way.
        """
        stiffness = float(np.abs(self.rods.sections[0, :, 1]).min()) / self.arm.length**2
        chord = self.tip / max(float(np.hypot(*self.tip)), 1e-9)
        shapes = [unloaded]
        for pull in PULLS:
            force = pull * stiffness * chord
            shape = self.at((force[0], force[1]), None, unloaded.arclength)
            if shape.converged and shape.stable is not False:
                shapes.append(shape)
        return sorted(shapes, key=self.miss)

    def descend(self, shape: Shape) -> Shape:
        """Levenberg-Marquardt on the distance of the tip, among shapes of the same stability."""
        damping = 0.0
        left = self.miss(shape)
        jacobian = force_jacobian(self.rods, shape)
        for _ in range(MOST_TRIALS):
            scale = float(np.linalg.norm(jacobian))
            rows = np.vstack([jacobian, math.sqrt(damping) * scale * np.eye(2)])
            aim = np.concatenate([self.tip - shape.tip[:2], np.zeros(2)])
            step = np.linalg.lstsq(rows, aim, rcond=1e-12)[0]
            force = (shape.force[0] + float(step[0]), shape.force[1] + float(step[1]))
            trial = self.at(force, shape.solution, shape.arclength, quick=True)
            fits = trial.converged and trial.stable is shape.stable
            if fits and self.miss(trial) < left:
                shape, left = trial, self.miss(trial)
                jacobian = force_jacobian(self.rods, shape)
                damping = 0.0 if damping < 1e-9 else 0.1 * damping
            elif damping > 1e6 or left <= ROUNDING * self.arm.length:
                break
            else:
                damping = max(10.0 * damping, 1e-9)
        return shape

    def judged(self, shape: Shape) -> Shape:
        """Return the shape, or a failed one: tip not at the goal, or telling no force."""
        weakest = float(np.linalg.svd(force_jacobian(self.rods, shape), compute_uv=False)[-1])
        distance = self.miss(shape)
        if weakest < DETERMINED and distance < NEAR * self.arm.length:
            sentence = (
                'the end force is not determined by this tip position: one way, 1 N moves the '
                f'tip by {1000.0 * weakest:.2g} mm only '
                f'(at least {1000.0 * DETERMINED:.2g} mm is needed)'
            )
        elif distance > ARRIVED * self.arm.length:
            sentence = (
                f'no end force brings the tip to ({self.tip[0]:.6g}, {self.tip[1]:.6g}) m; '
                f'the nearest equilibrium found is {1000.0 * distance:.3g} mm away'
            )
        else:
            return shape
        unknown = replace(self.load, force_x=math.nan, force_y=math.nan)
        return failed(
            self.arm,
            unknown,
            shape.arclength,
            sentence,
            distance / self.arm.length,
            shape.iterations,
        )


def force_jacobian(rods: Rods, shape: Shape) -> Array:
    """d(x, y) of the tip / d(F1, F2), (2, 2) m/N."""
    assert shape.solution is not None
    tip: Array = linearize(shape.solution, rods).tip
    return tip[:2, :2].T
