"""Belief of a swinging arm: propagation to the stamp of a frame or reading, and its estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import functools
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.bent_arm import BentArm
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.errors.propagated_errors import PropagatedErrors
from pneunet_ros.measurement.errors.second_order import second_order_factor
from pneunet_ros.measurement.inference.gaussian import with_columns
from pneunet_ros.measurement.moving_arm import is_settled, MotionEstimate, Moved
from pneunet_ros.measurement.swinging_arm import (
    Blow,
    EquilibriumBetween,
    Reference,
    SwingDeviation,
    SwingingArm,
)
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.solver.modes import modes_of
from pneunet_ros.solver.swing import Swing

SMALLEST = 1e-30  # m^2, variance of a tip that counts as known


def propagate_swing(
    arm: SwingingArm | None,
    before: Belief,
    propagated: Belief,
    bent: BentArm,
    path: Sequence[EquilibriumBetween] = (),
    causes: Array | None = None,
    turn_rate: float = math.nan,
) -> tuple[Belief, Moved | None]:
    """Propagate the swing of a belief to its new stamp; return the belief and the motion.

    before: the belief before; propagated: the belief at the new stamp, without its swing; bent:
    its equilibrium; path: see `SwingingArm.advance`; causes (causes, unknowns): derivatives by the
    unknowns, None if the force is known; turn_rate (rad/s) of the base at the new stamp. If there
    is no equilibrium, the swing is reset.
    """
    if arm is None:
        return propagated, None
    if not bent.shape.converged:
        return replace(arm.with_restarted_swing(propagated), reference=None), None
    known = before, before.reference, before.stamp_ns
    turning = None
    if causes is not None:
        turning = arm.headings(bent.linearize()).T @ causes
    advanced, reference, motion = arm.advance(
        known, propagated, bent.solution, propagated.stamp_ns, path, turning, turn_rate
    )
    if not np.isfinite(reference.left_out).all():  # such an arm cannot be followed
        return replace(arm.with_restarted_swing(propagated), reference=None), None
    return replace(advanced, reference=reference), motion


def with_blow(arm: SwingingArm, belief: Belief, blow: Blow, place: int) -> Belief:
    """Return the belief at a frame with the errors of a blow at one of its places."""
    size, reference = belief.root.shape[1], belief.reference
    assert reference is not None
    root = with_columns(belief.root, blow.swing.shape[2])
    root[arm.part(Motion.SWING), size:] = blow.swing[place]
    left_out = reference.left_out.copy()
    left_out[-1] = blow.left_out[place]
    return replace(
        belief, root=freeze(root), reference=replace(reference, left_out=freeze(left_out))
    )


def with_blow_on_contact(arm: SwingingArm, belief: Belief, bent: BentArm) -> Belief:
    """Return the belief at a frame with the errors of a blow on a contact that lasts.

    An arm that moves away from its contact gets none. bent: the equilibrium with the contact.
    """
    reference, contact = belief.reference, bent.contact
    if reference is None or contact is None or not bent.shape.converged:
        return belief
    swing = arm.swing_deviation(bent.solution, belief.mean, reference, arm.targets)
    acting = arm.force_on_shapes(swing, reference.turns, np.array([contact.place]))
    by_force = arm.headings(bent.linearize())[-2:-1]
    blow = arm.blow(belief, reference, acting, by_force)
    if blow is None or blow.impulse[0] * contact.force <= 0.0:
        return belief
    return with_blow(arm, belief, blow, 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingingEstimate:
    """A swinging arm at the stations of an estimate.

    belief: at the stamp; bent: the equilibrium; reference of the swing; swing_deviation:
    deviation from the equilibrium; arm_motion: None at the stamp of a frame.
    """

    arm: SwingingArm
    belief: Belief
    bent: BentArm
    reference: Reference
    swing_deviation: SwingDeviation
    arm_motion: Moved | None

    def errors(
        self, causes: Array, sensitivity: Sensitivity, equilibrium_errors: PropagatedErrors
    ) -> PropagatedErrors:
        """Return the errors of the arm; equilibrium_errors of its equilibrium.

        An error of the loads hardly moves a swinging arm itself. causes (causes, unknowns):
        derivatives by the unknowns.
        """
        root, swing_deviation = self.belief.root, self.swing_deviation
        by_cause = sensitivity.stations(self.bent.shape.arclength)[:, :4]
        by_cause = by_cause + swing_deviation.moves(self.arm.headings(sensitivity))
        moves = np.tensordot((causes @ root).T, by_cause, axes=1)
        moves += np.tensordot(
            root[self.arm.part(Motion.PLACE)].T, swing_deviation.by_shape, axes=1
        )
        further = np.zeros((1 + len(swing_deviation.left_out), *moves.shape[1:]))
        further[0], further[1:, :2] = self.curved(moves[:, :2, -1]), swing_deviation.left_out
        moves = np.concatenate([moves, further])
        std = np.sqrt(np.sum(moves**2, axis=0))
        tip = moves[:, :3, -1]
        return replace(
            equilibrium_errors, tip_covariance=freeze(tip.T @ tip), std=freeze(std[[0, 1, 3]])
        )

    def curved(self, tips: Array) -> Array:
        """Return the second-order effect of the leading tip error, (4, stations).

        tips (errors, 2) m: displacement of the tip by each error. See
        `measurement.errors.second_order`.
        """
        variances, axes = np.linalg.eigh(tips.T @ tips)
        leading = tips @ axes[:, -1] / math.sqrt(max(variances[-1], SMALLEST))
        where, mean = self.arm.part(Motion.PLACE), self.belief.mean
        displacement = np.zeros_like(mean)
        displacement[where] = self.belief.root[where] @ leading
        solution, places = self.bent.solution, self.arm.stations
        before, after = (
            self.arm.swing_deviation(
                solution, mean + sign * displacement, self.reference, places
            ).deviation
            for sign in (-1.0, 1.0)
        )
        return second_order_factor(1.0) * (before + after - 2.0 * self.swing_deviation.deviation)

    def motion(self, errors: PropagatedErrors) -> MotionEstimate | None:
        """Return the estimated motion of the arm; errors: propagated errors of its shape."""
        motion, moving, where = self.arm_motion, self.arm.moving, self.arm.part(Motion.SWING)
        if motion is None or moving.arm.inertia is None:
            return None
        covariance = self.belief.covariance_of(where)
        on = motion.stopped / moving.modes.frequency[0]
        damping_time = moving.arm.inertia.damping_time
        return MotionEstimate(
            velocity=freeze(motion.velocity),
            settled=is_settled(self.swing_deviation.deviation[:2, -1], on, errors.tip_covariance),
            swing=Swing(
                state=self.belief.mean[where].reshape(2, -1),
                covariance=covariance,
                columns=np.zeros((2, len(covariance))),
            ),
            at_nodes=freeze(motion.at_nodes),
            relative=np.zeros(2),
            left_out=0.0,
            modes=functools.partial(
                modes_of, self.swing_deviation.links, moving.masses, damping_time, Motion.SHAPES
            ),
        )


def swinging_estimate(
    arm: SwingingArm | None, belief: Belief, bent: BentArm, motion: Moved | None
) -> SwingingEstimate | None:
    """Return the estimate of a swinging arm; None if the belief has no swing.

    bent: the equilibrium at the stations; motion: the estimated motion.
    """
    reference = belief.reference
    if arm is None or reference is None or not bent.shape.converged:
        return None
    swing_deviation = arm.swing_deviation(bent.solution, belief.mean, reference, arm.stations)
    return SwingingEstimate(
        arm=arm,
        belief=belief,
        bent=bent,
        reference=reference,
        swing_deviation=swing_deviation,
        arm_motion=motion,
    )
