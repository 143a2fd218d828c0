"""Detection and localization of a contact along the arm.

A contact is a force along the normal of the arm at some place. A score test in every frame shows
whether there may be one: the gain of a push on each panel of the rod, with all other unknowns
adapted. Only if so, the contact is searched for from the best places, as a frame problem with two
more unknowns.

Source: score test, Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.fusion.belief import Belief, CONTACT
from pneunet_ros.fusion.frame_fit import FrameLinearization, FrameProblem
from pneunet_ros.fusion.frame_update import evidence_cost, excess, Fit, leave_out, left_out_cost
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.predicted_targets import measured_moves
from pneunet_ros.model.part_load import pushed_on_panels
from pneunet_ros.solver.columns import LOADS

CONTACT_STARTS = 3  # number of best places from which a contact is searched for
CONTACT_APART = 0.05  # lengths between two contacts; idle in acceptance/sweep.py


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A contact: its position and force.

    x, y (m) in the base frame; arclength, std_arclength (m) along the arm; force, std_force (N)
    along its normal (-sin theta, cos theta); log_odds of a contact against none; ambiguous:
    whether contact and tip force cannot be told apart because no sensor measures the latter.
    """

    x: float
    y: float
    arclength: float
    std_arclength: float
    force: float
    std_force: float
    log_odds: float
    ambiguous: bool


def without_contact(unknowns: Unknowns, belief: Belief) -> Belief:
    """Reset the contact to none: nothing touches the arm."""
    mean, root, where = belief.mean.copy(), belief.root.copy(), unknowns.at(Push)
    mean[where], root[where] = 0.0, 0.0
    return replace(belief, mean=freeze(mean), root=freeze(root), causes=belief.causes - {CONTACT})


def with_any_contact(unknowns: Unknowns, belief: Belief) -> Belief:
    """Allow a contact with any force, anywhere on the arm."""
    mean, where = belief.mean.copy(), unknowns.at(Push)
    mean[where], std = unknowns.block(Push).touching_prior
    more = np.zeros((mean.size, 2))
    more[where] = np.diag(std)
    root = freeze(np.hstack([belief.root, more]))
    return replace(belief, mean=freeze(mean), root=root, causes=belief.causes | {CONTACT})


def differs_from_zero(fit: Fit, limit: float) -> bool:
    """Whether the contact force of a fit differs significantly from zero (chi squared)."""
    belief, which = fit[0].posterior(fit[1]), fit[0].unknowns.at(Push).start
    force, std = belief.mean[which], belief.std(which)
    return bool(force**2 > limit * std**2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushScores:
    """The gain of a push on each panel of the rod, linearized around a fit without one.

    place (panels,) m; force (panels,) N, the most likely one at each; gain (panels,) chi squared;
    pushes, weighed (coordinates, panels): whitened displacement by a push, and the inverse
    covariance times that; information (panels,) of the force; freedom (N, m): one sigma of the
    prior force, and the length of the arm.
    """

    place: Array
    force: Array
    gain: Array
    pushes: Array
    weighed: Array
    information: Array
    freedom: tuple[float, float]

    def evidence(self) -> Array:
        """Return the gain (panels,) minus the Occam factor of an unknown force and place.

        It uses the Laplace approximation.
        """
        std, length = self.freedom
        anywhere = 12.0 / length**2  # 1 / variance of an unknown place
        slide, weighed_slide = (
            self.force * np.gradient(side, self.place, axis=1)
            for side in (self.pushes, self.weighed)
        )
        cross = np.sum(slide * self.weighed, axis=0)
        along = np.sum(slide * weighed_slide, axis=0) + anywhere
        volume = self.information * along - cross**2
        return np.asarray(self.gain - np.log(volume * std**2 / anywhere))

    def step(self, fit: FrameLinearization, panel: int) -> Array:
        """Return the response of the other unknowns (n,) in xi to a push on a panel."""
        remaining = fit.weighed - self.weighed[:, panel] * self.force[panel]
        return np.asarray(remaining @ fit.jacobian - fit.trial.xi)


def score_pushes(problem: FrameProblem, fit: FrameLinearization) -> PushScores:
    """Score a push on each panel; all other unknowns are projected out with their covariance."""
    bent, arm = fit.trial.bent, problem.table.arm
    place, sensitivity = pushed_on_panels(bent.solution, bent.rods)
    displacement = measured_moves(arm, sensitivity)
    problem.add_swing(fit.trial, sensitivity, displacement)
    displacement, pulled = displacement[LOADS:], pulled_at(problem, fit, place)
    if pulled is not None and fit.trial.swing_deviation is not None:
        displacement = displacement + np.tensordot(
            pulled[: Motion.SHAPES].T, fit.trial.swing_deviation.by_shape, axes=1
        )
    pushes = problem.whiten(problem.along_arm(fit.trial, displacement)).T
    weighed, std = fit.solve(pushes), problem.unknowns.block(Push).scale
    information = np.sum(pushes * weighed, axis=0) + std**-2
    score = fit.innovation @ weighed
    force = score / information
    low, high = problem.unknowns.block(Push).limits
    return PushScores(
        place=place,
        force=force,
        gain=np.where((place >= low) & (place <= high), score * force, 0.0),
        pushes=pushes,
        weighed=weighed,
        information=information,
        freedom=(std, arm.length),
    )


def pulled_at(problem: FrameProblem, fit: FrameLinearization, place: Array) -> Array | None:
    """Return the motion of a swinging arm within one frame interval per 1 N at each place.

    place (places,): arclength (m). Returns the changes of the modal coordinates and momenta
    (4, places); None if the arm does not swing.
    """
    swing, reference, arm = fit.trial.swing_deviation, problem.prior.reference, problem.swinging
    if swing is None or reference is None or arm is None:
        return None
    return np.asarray(reference.pull @ arm.force_on_shapes(swing, reference.turns, place))


def with_pull(problem: FrameProblem, pulled: Array) -> Belief:
    """Return the prior of a frame for a contact that has acted since the last frame.

    pulled (4,): change of the modal coordinates and momenta per 1 N of contact force.
    """
    prior, arm = problem.prior, problem.swinging
    assert arm is not None
    root = prior.root.copy()
    force = problem.unknowns.at(Push).start
    root[arm.part(Motion.SWING), -2] += pulled * root[force, -2]
    return replace(prior, root=freeze(root))


def find_contacts(
    problem: FrameProblem, fit: FrameLinearization, *, unexplained: bool
) -> list[Fit]:
    """Return fits with a contact, the best one for each place, best first.

    Empty if no contact is needed. fit: the fit without a contact; its linearization shows whether
    one is needed, unless that fit is inconsistent with the frame (unexplained). The best places
    are local minima of the cost along the arm: weak contacts have several.
    """
    settings, length = problem.settings, problem.table.arm.length
    if fit.trial.residual.size != problem.std.size:  # of all targets, including those left out
        trial = problem.try_at(fit.trial.solved, fit.trial.bent.solution)
        again = None if trial is None else problem.linearize(trial)
        if again is None:
            return []
        fit = again
    scores = score_pushes(problem, fit)
    likely = scores.gain >= settings.contact_score
    indicated = likely.any() and np.any(likely & (scores.evidence() > 0.0))
    if not indicated and not unexplained:
        return []
    padded = np.concatenate([[0.0], scores.gain, [0.0]])
    peaks = np.flatnonzero((scores.gain >= padded[:-2]) & (scores.gain >= padded[2:]))
    starts = peaks[np.argsort(-scores.gain[peaks])][:CONTACT_STARTS]
    prior = with_any_contact(problem.unknowns, problem.prior)
    touched = replace(problem, prior=prior)
    tried = [search_at(touched, fit, scores, int(panel)) for panel in starts]
    seen = int(np.count_nonzero(problem.used))
    # Beyond this the problem is not linear, and a std of the force is meaningless.
    predicted_gain = 2.0 * float(scores.gain.max())

    free = evidence_cost((problem, fit), seen) - 2.0 * settings.odds_against

    def is_needed(item: Fit) -> bool:
        cost = item[1].cost + left_out_cost(item, seen)
        beyond = unexplained and excess(item) <= 1.0 and fit.cost - cost > predicted_gain
        return beyond or evidence_cost(item, seen) < free

    # A contact of no force is another minimum without one, or a tip force.
    pressing = [
        item
        for item in tried
        if item is not None
        and (differs_from_zero(item, settings.contact_score) or is_needed(item))
    ]
    found: list[Fit] = []
    for item in sorted(pressing, key=lambda one: evidence_cost(one, seen)):
        separation = CONTACT_APART * length
        if all(abs(place_of(item) - place_of(other)) > separation for other in found):
            found.append(item)
    return found


def place_of(fit: Fit) -> float:
    """Return the place (m) of the contact of a fit."""
    contact = fit[1].trial.bent.contact
    assert contact is not None
    return contact.place


def search_at(
    problem: FrameProblem, fit: FrameLinearization, scores: PushScores, panel: int
) -> Fit | None:
    """Return the fit with a contact, searched from a panel."""
    where = problem.unknowns.at(Push)
    pulled = pulled_at(problem, fit, scores.place[panel : panel + 1])
    if pulled is not None and problem.swinging is not None:
        problem = replace(problem, prior=with_pull(problem, pulled[:, 0]))
    force_std, place_std = np.diagonal(problem.root[where, -2:])
    contact = np.array(
        [
            scores.force[panel] / force_std,
            (scores.place[panel] - problem.mean[where.stop - 1]) / place_std,
        ]
    )
    xi = np.concatenate([fit.trial.xi + scores.step(fit, panel), contact])
    found = problem.search(xi, fit.trial.bent.solution)
    return None if found is None else leave_out(problem, found)
