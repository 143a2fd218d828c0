"""The rod of a fusion for given unknowns, and its sensitivity to them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.effects.effect import Load
from pneunet_ros.measurement.blocks.block import FrameInputs
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.model.equilibrium import linearize_shape, Sensitivity, solve_rod
from pneunet_ros.model.part_load import PartLoad, with_part_changes, with_part_load
from pneunet_ros.model.perturbation import Perturbation, PerturbationTable
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.settings import SOLVER
from pneunet_ros.solver.solution import SolverNodes

# Frames follow one another: a mesh that was refined is kept while it may be needed (the detail on
# half as many panels is at most so many times larger), and not tried without and refined again.
# The targets are where they are on the coarser mesh to within its detail, 1e-6 of the length.
FOLLOWING = replace(SOLVER, coarser=80.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BentArm:
    """The rod for given unknowns, at places along it; rods: the model without the contact."""

    rods: Rods
    changes: Perturbation
    shape: Shape
    contact: PartLoad | None

    @property
    def solution(self) -> SolverNodes:
        """The solved rod."""
        assert self.shape.solution is not None
        return self.shape.solution

    def linearize(self) -> Sensitivity:
        """Return the derivatives of the rod by loads, pressure and covariance columns.

        With a contact, also by its force and position.
        """
        if self.contact is None:
            return linearize_shape(self.solution, self.rods, self.changes)
        changes = with_part_changes(self.rods, self.changes, self.contact)
        return linearize_shape(self.solution, with_part_load(self.rods, self.contact), changes)


def bend_arm(
    table: PerturbationTable,
    inputs: FrameInputs,
    changes: Array,
    start: SolverNodes | None,
    arclength: Array,
    *,
    quick: bool,
    contact: PartLoad | None = None,
) -> BentArm:
    """Solve the rod under the readings, with changes (causes,) by the unknowns.

    quick: whether to give up early if no solution is near the start. contact: a force along the
    normal of the arm.
    """
    force_x, force_y, moment, error = changes[: PRESSURE + 1].tolist()
    pressure = inputs.chamber + error
    load = Load(
        pressure=pressure,
        force_x=force_x,
        force_y=force_y,
        moment=inputs.moment + moment,
        gravity=inputs.gravity,
    )
    rods, perturbation = table.at(pressure, inputs.history, load)
    amounts = changes[PRESSURE:].copy()
    amounts[0] = 0.0  # the record already includes the pressure
    rods = perturbation.moved(rods, amounts)
    pushed = rods if contact is None else with_part_load(rods, contact)
    quick = quick and start is not None
    shape = solve_rod(table.arm, pushed, load, start, arclength, FOLLOWING, quick)
    return BentArm(rods=rods, changes=perturbation, shape=shape, contact=contact)


def causes_with_contact(unknowns: Unknowns, causes: Array, contact: PartLoad | None) -> Array:
    """Return the derivatives of all causes by the unknowns, including those of a contact, if any.

    causes (causes, unknowns): derivatives without a contact. Those of the force and position of
    the contact come last.
    """
    if contact is None:
        return causes
    own = np.zeros((2, causes.shape[1]))
    own[:, unknowns.at(Push)] = np.eye(2)
    return np.vstack([causes, own])
