"""What errors move to second order: where the linearization alone would be too sure.

The tip of a nearly straight arm moves along the arm only by the square of an error, so that its
covariance to first order is singular there. One direction is enough: that in which the errors of
readings and model together move the tip most. With r(+-) the shapes one sigma to either side of
it, delta = (r(+) + r(-) - 2 r(0)) / 2 and an error of xi sigma moves the arm by xi J d + xi^2
delta; of a normal xi the second moment of the latter is 3 delta delta^T about the shape that is
published, of which 2 are its covariance and 1 the square of its mean. It has no correlation with
the first-order error, and so counts as one more independent source.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.model.equilibrium import is_stable, Sensitivity
from pneunet_ros.solver.boundary_value_problem import newton
from pneunet_ros.solver.columns import (
    CURVATURE,
    END_X,
    FORCE_X,
    FORCE_Y,
    LOADS,
    NODE_MOMENT,
    PANEL_FLEXIBILITY,
    PANEL_FORCE_X,
    PANEL_FORCE_Y,
    PANEL_LENGTH,
    THETA,
)
from pneunet_ros.solver.interpolation import at_stations
from pneunet_ros.solver.settings import ACCEPTED, SOLVER
from pneunet_ros.solver.solution import SolverNodes

SCALES = slice(PANEL_LENGTH, PANEL_FLEXIBILITY + 1)
SECOND_MOMENT = 3.0  # E[xi^4] of a normal xi


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondOrderSettings:
    """How far to either side the shape is solved."""

    steps: tuple[float, ...] = tuning(
        (1.0, 0.5, 0.25, 0.125),
        'along the leading error, the first at which both sides have an equilibrium of the kind',
        unit='sigma',
    )


DEFAULTS = SecondOrderSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SecondOrder:
    """The solved rod to either side of an estimate, `step` sigma along its leading error.

    sensitivity: of the estimate; rotation (2, pieces, 5): the intrinsic rotation of the sides, as
    in `Rods`.
    """

    sensitivity: Sensitivity
    before: SolverNodes
    after: SolverNodes
    rotation: Array
    step: float

    def stations(self, arclength: Array) -> Array:
        """Return one more independent error of x, y (m), theta (rad), (3, n), at places (m)."""
        twice = -2.0 * self.sensitivity.fields(arclength)
        fields = np.empty_like(twice)
        for side, rotation in zip((self.before, self.after), self.rotation, strict=True):
            panels, _, nodes = side.for_kernels()
            at_stations(panels, nodes, self.sensitivity.knots, rotation, arclength, fields)
            twice += fields
        error: Array = 0.5 * math.sqrt(SECOND_MOMENT) / self.step**2 * twice[:CURVATURE]
        return error


def second_order(
    sensitivity: Sensitivity, noise: Array, settings: SecondOrderSettings = DEFAULTS
) -> SecondOrder | None:
    """Solve the rod to either side of an estimate.

    sensitivity: of its shape; noise (sources, causes): the noise input matrix. None where there is
    no equilibrium of the same stability to both sides, however near: a limit point.

    Source: second-order filters by central differences, Norgaard, Poulsen, Ravn, Automatica 36
    (2000).
    """
    direction = sensitivity.single_causes(leading_error(sensitivity.tip, noise))
    further = direction[LOADS:]
    panels = along(further, sensitivity.panel_changes)
    panels[:, PANEL_FORCE_X] += direction[FORCE_X]
    panels[:, PANEL_FORCE_Y] += direction[FORCE_Y]
    ends = along(further, sensitivity.end_changes)
    ends[END_X:] += direction[:LOADS]
    nodes = along(direction, sensitivity.node_changes)
    rotation = along(further, sensitivity.rotation_changes)
    known = sensitivity.solution.panels[:, SCALES]
    largest = (np.abs(panels[:, SCALES]) / np.abs(known)).max()
    for step in settings.steps:
        if not step * largest < 1.0:
            continue  # a length or a rigidity would change its sign
        before = settle(sensitivity, -step * panels, -step * ends, -step * nodes)
        after = settle(sensitivity, step * panels, step * ends, step * nodes)
        if before is not None and after is not None:
            return SecondOrder(
                sensitivity=sensitivity,
                before=before,
                after=after,
                rotation=sensitivity.rotation + np.multiply.outer([-step, step], rotation),
                step=step,
            )
    return None


def leading_error(tip: Array, noise: Array) -> Array:
    """Return the causes (causes,) of the error of one sigma that moves the tip furthest.

    tip (causes, 3): sensitivity of x, y, theta; noise (sources, causes): the noise input matrix.
    """
    moved = noise @ tip[:, :THETA]
    (along_x, both), (_, along_y) = (moved.T @ moved).tolist()
    angle = 0.5 * math.atan2(2.0 * both, along_x - along_y)
    weights = moved @ np.array([math.cos(angle), math.sin(angle)])
    size = math.sqrt(weights @ weights)
    direction: Array = (weights / size if size > 0.0 else weights) @ noise
    return direction


def settle(
    sensitivity: Sensitivity, panels: Array, ends: Array, nodes: Array
) -> SolverNodes | None:
    """Solve the rod beside a solution, from changes of its tables along a tangent.

    None where Newton's method goes further than the tangent, or to a rod of another stability:
    that is no neighbor any more.
    """
    known = sensitivity.solution
    moved = SolverNodes(
        panels=known.panels + panels,
        ends=known.ends + ends,
        nodes=known.nodes + nodes,
        counts=known.counts,
    )
    predicted = moved.nodes.copy()
    residual, _ = newton(
        moved.panels, moved.ends, moved.nodes, SOLVER.frame_iterations, SOLVER.tolerance
    )
    if not residual <= ACCEPTED:
        return None
    further = np.abs(moved.nodes - predicted)[:, :NODE_MOMENT].max()
    if further > np.abs(nodes)[:, :NODE_MOMENT].max() + ACCEPTED:
        return None
    if sensitivity.stable is not None and is_stable(moved) is not sensitivity.stable:
        return None
    return moved


def along(amounts: Array, changes: Array) -> Array:
    """Return the sum of changes (causes, ...), so much of each."""
    total: Array = (amounts @ changes.reshape(amounts.size, -1)).reshape(changes.shape[1:])
    return total
