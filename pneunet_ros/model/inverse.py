"""End force and shape from the position of the tip (Figure 9 of the paper).

The end force is found by the Levenberg-Marquardt method (scipy) on the position of the tip; each
trial is a full solve of the rod. A force to which the tip hardly responds is reported as not
determined.
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
    check_pair,
    DEFAULT_STATIONS,
    failed_shape,
    linearize_shape,
    solve_rod,
    station_arclength,
    steady_pressure,
    with_position,
)
from pneunet_ros.model.perturbation import Perturbation, with_pressure_change
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.columns import RIGIDITY
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.settings import SolverSettings
from pneunet_ros.solver.solution import SolverNodes

ROUNDING = 1e-13  # of the length; tip error where no step helps: some last digits of float64
ARRIVED = 1e-10  # of the length; tip error of a solution: a thousand times ROUNDING
# B / l^2; first forces along the chord, of which the search begins with the nearest.
PULLS = (-1.5, 1.5, 5.0, 15.0, 50.0)
# Per initial guess; the Levenberg-Marquardt method normally ends long before.
MOST_TRIALS = 150
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
DETERMINED = 1.5e-4  # force_scale / length: least singular value of d tip / d force
FORCE_AT_FAULT = 1e-3  # of the length; tip error below which an undetermined force is the cause
MILLIMETERS = 10.0  # lengths: the position of a tip this far away is probably in millimeters


EXACT = SolverSettings(tolerance=0.0)  # each trial is as exact as rounding allows


def solve_tip(
    arm: Arm,
    pressure: float,
    tip: tuple[float, float],
    moment: float = 0.0,
    start: Shape | None = None,
    stations: int = DEFAULT_STATIONS,
) -> Shape:
    """Estimate the end force and the shape from pressure and tip position (Figure 9 (b)).

    Args:
        arm: the calibrated arm.
        pressure: reading of the sensor, held constant; Pa gauge.
        tip: x, y of the free end, m, in the base frame.
        moment: on the free end, which must be known; N m.
        start: a neighboring shape, whose branch is followed.
        stations: number of equally spaced points along the arm.

    Returns:
        The shape; its `force` acts on the arm. If the tip does not
        determine the force, a failed shape whose `status` says so.

    Raises:
        RequestError: a value is not a finite number.
    """
    check_finite(pressure=pressure, moment=moment)
    check_pair(tip=tip)
    load = arm.sense(Load(pressure=pressure, moment=moment))
    chamber = steady_pressure(arm, load.pressure)
    arclength = station_arclength(arm.reach, stations)
    search = TipSearch(arm=arm, chamber=chamber, load=load, tip=np.array(tip, dtype=np.float64))
    unloaded = search.at((0.0, 0.0), None, arclength)
    guesses = search.initial_guesses(unloaded) if unloaded.converged else []
    if start is not None and start.solution is not None:
        followed = search.at(start.force, start.solution, arclength)
        guesses = [followed, *guesses] if followed.converged else guesses
    if not guesses:
        return replace(unloaded, force=(math.nan, math.nan))
    shapes = [guesses[0]]
    for guess in guesses:
        shapes.append(search.descend(guess))
        if search.tip_error(shapes[-1]) <= ROUNDING * arm.length:
            break
    return search.check(min(shapes, key=search.tip_error))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipSearch:
    """Search for the end force that brings the tip of a rod to `tip` (2,) m.

    chamber: pressure (Pa) in the chamber.
    """

    arm: Arm
    chamber: float
    load: Load
    tip: Array

    def at(
        self,
        force: tuple[float, float],
        start: SolverNodes | None,
        arclength: Array,
        quick: bool = False,
    ) -> Shape:
        """Return the shape under a trial force; quick: give up early."""
        load = replace(self.load, force_x=float(force[0]), force_y=float(force[1]))
        rods = self.arm.rods(np.array([self.chamber]), loads=load.row)
        return solve_rod(self.arm, rods, load, start, arclength, EXACT, quick)

    def tip_error(self, shape: Shape) -> float:
        """Return the distance (m) of a shape's tip from the goal."""
        return math.dist(shape.tip[:2], self.tip)

    def initial_guesses(self, unloaded: Shape) -> list[Shape]:
        """Return initial shapes, nearest tip first: unloaded, pulled and pushed along the chord.

        The pulls are multiples of B / l^2, the force scale of bending.
        """
        rods = self.arm.rods(np.array([self.chamber]))
        stiffness = float(np.abs(rods.sections[0, :, RIGIDITY]).min()) / self.arm.length**2
        chord = self.tip / max(float(np.hypot(*self.tip)), 1e-9)
        shapes = [unloaded]
        for pull in PULLS:
            force = pull * stiffness * chord
            shape = self.at((force[0], force[1]), None, unloaded.arclength)
            if shape.converged and shape.stable is not False:
                shapes.append(shape)
        return sorted(shapes, key=self.tip_error)

    def descend(self, guess: Shape) -> Shape:
        """Run Levenberg-Marquardt on the tip, among shapes with the stability of the guess."""
        from scipy.optimize import least_squares  # slow to import, and rarely needed

        best = latest = guess
        lost = np.full(2, self.tip_error(guess) + self.arm.length)  # cost of a failed trial

        def fits(force: Array) -> bool:
            nonlocal best, latest
            if tuple(force.tolist()) == latest.force:
                return True
            start = best.solution
            trial = self.at((force[0], force[1]), start, guess.arclength, quick=True)
            if not (trial.converged and trial.stable is guess.stable):
                return False
            latest = trial
            best = min(best, trial, key=self.tip_error)
            return True

        least_squares(
            lambda force: np.subtract(latest.tip[:2], self.tip) if fits(force) else lost,
            guess.force,
            jac=lambda force: self.force_jacobian(latest if fits(force) else best),
            method='lm',
            x_scale='jac',
            max_nfev=MOST_TRIALS,
            **dict.fromkeys(('xtol', 'ftol', 'gtol'), 1e-15),  # to rounding
        )
        return best

    def check(self, shape: Shape) -> Shape:
        """Return the shape, or a failed one if the goal is missed or the force undetermined."""
        weakest = float(np.linalg.svd(self.force_jacobian(shape), compute_uv=False)[-1])
        least = DETERMINED * self.arm.length / self.arm.force_scale
        distance = self.tip_error(shape)
        if weakest < least and distance < FORCE_AT_FAULT * self.arm.length:
            sentence = (
                'this tip position does not determine the end force: in one direction, 1 N moves '
                f'the tip by only {1000.0 * weakest:.2g} mm (at least '
                f'{1000.0 * least:.2g} mm is needed)'
            )
        elif distance > ARRIVED * self.arm.length:
            sentence = (
                f'no end force brings the tip to ({self.tip[0]:.6g}, {self.tip[1]:.6g}) m; '
                f'the nearest equilibrium found is {1000.0 * distance:.3g} mm away'
            )
            if float(np.hypot(*self.tip)) > MILLIMETERS * self.arm.length:
                sentence += f': the arm is {self.arm.length:g} m long, so are these millimeters?'
        else:
            load = replace(self.load, force_x=shape.force[0], force_y=shape.force[1])
            return with_position(self.arm, shape, load, self.chamber)
        unknown = replace(self.load, force_x=math.nan, force_y=math.nan)
        return failed_shape(
            self.arm,
            unknown,
            shape.arclength,
            sentence,
            distance / self.arm.length,
            shape.iterations,
        )

    def force_jacobian(self, shape: Shape) -> Array:
        """Return the Jacobian of the tip by the force, including effects that depend on it."""
        load = replace(self.load, force_x=shape.force[0], force_y=shape.force[1])
        rods, changes = with_pressure_change(self.arm, self.chamber, load=load)
        return force_jacobian(rods, shape, changes if self.arm.by_load else None)


def force_jacobian(rods: Rods, shape: Shape, changes: Perturbation | None = None) -> Array:
    """Return d(x, y) of the tip / d(F1, F2), (2, 2) m/N."""
    assert shape.solution is not None
    tip: Array = linearize_shape(shape.solution, rods, changes).tip
    return tip[:2, :2].T
