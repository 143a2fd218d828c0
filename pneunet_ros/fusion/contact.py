"""Detection and localization of a contact along the arm.

A contact is a force along the normal of the arm at some place. A score test in every frame shows
whether there may be one: the gain of a push on each panel of the rod, with all other unknowns
adapted. Only if so, the contact is searched for from the best places, as a frame problem with two
more unknowns. If it may begin with a blow, each part of the arm has a search of its own.

Source: score test, Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.fusion.belief import Belief, CONTACT
from pneunet_ros.fusion.frame_fit import FrameLinearization, FrameProblem
from pneunet_ros.fusion.frame_update import evidence_cost, excess, Fit, leave_out, left_out_cost
from pneunet_ros.fusion.swinging import with_blow
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.predicted_targets import measured_moves
from pneunet_ros.measurement.swinging_arm import Blow, ERRORS, PLACES
from pneunet_ros.model.part_load import pushed_on_panels
from pneunet_ros.solver.columns import LOADS

CONTACT_STARTS = 3  # number of places from which a contact is searched for
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


def with_any_contact(
    unknowns: Unknowns, belief: Belief, ends: tuple[float, float] = (0.0, 1.0)
) -> Belief:
    """Allow a contact with any force on a part of the arm; ends: in shares of its length."""
    mean, where = belief.mean.copy(), unknowns.at(Push)
    mean[where], std = unknowns.block(Push).touching_prior(*ends)
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
class ContactMotion:
    """How a contact that has begun since the last frame moves a swinging arm, panel by panel.

    pull (panels, 4): changes of modal coordinates and momenta by 1 N since the last frame; blow:
    one sigma of the blow with which the contact may have begun, None if unknown.
    """

    pull: Array
    blow: Blow | None

    def with_prior(self, problem: FrameProblem, panel: int) -> FrameProblem:
        """Return the problem of a contact on a panel, with the motion by it.

        Its force is the last unknown but one of the prior's root.
        """
        prior, arm = problem.prior, problem.swinging
        assert arm is not None and prior.reference is not None
        force = prior.root.shape[1] - 2
        root = prior.root.copy()
        root[arm.part(Motion.SWING), force] += (
            self.pull[panel] * root[problem.unknowns.at(Push).start, force]
        )
        prior = replace(prior, root=freeze(root))
        if self.blow is not None:
            prior = with_blow(arm, prior, self.blow, panel)
        return replace(problem, prior=prior)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushScores:
    """The gain of a contact on each panel of the rod, linearized around a fit without one.

    place (panels,) m; amounts (panels, k): the most likely force there, and blow with which the
    contact began, in units of one sigma; gain (panels,) chi squared; responses, weighed
    (coordinates, panels, k): whitened displacement by each, and the inverse covariance times that;
    information (panels, k, k) of the amounts; scale (N): one sigma of the force; length (m) of
    the arm; motion: None if it does not swing.
    """

    place: Array
    amounts: Array
    gain: Array
    responses: Array
    weighed: Array
    information: Array
    scale: float
    length: float
    motion: ContactMotion | None

    def evidence(self) -> Array:
        """Return the gain (panels,) minus the Occam factor of an unknown contact and place.

        It uses the Laplace approximation.
        """
        anywhere = 12.0 / self.length**2  # 1 / variance of an unknown place
        slide, weighed_slide = (
            np.einsum('cpk,pk->cp', np.gradient(side, self.place, axis=1), self.amounts)
            for side in (self.responses, self.weighed)
        )
        size = self.amounts.shape[1]
        volume = np.empty((len(self.place), size + 1, size + 1))
        volume[:, :size, :size] = self.information
        cross = np.einsum('cp,cpk->pk', slide, self.weighed)
        volume[:, :size, size] = volume[:, size, :size] = cross
        volume[:, size, size] = np.sum(slide * weighed_slide, axis=0) + anywhere
        return np.asarray(self.gain - np.linalg.slogdet(volume)[1] + math.log(anywhere))

    @property
    def parts(self) -> int:
        """Number of equal parts of the arm, with a search and a prior each.

        A blow moves the arm by where it acts, which no search follows.
        """
        return 1 if self.motion is None or self.motion.blow is None else CONTACT_STARTS

    def starts(self) -> list[tuple[int, tuple[float, float]]]:
        """Return the panels to search from, each with the part of the arm (shares) of its prior.

        The best one of each part; or the best local maxima of the gain on an undivided arm: weak
        contacts have several.
        """
        if self.parts == 1:
            padded = np.concatenate([[0.0], self.gain, [0.0]])
            peaks = np.flatnonzero((self.gain >= padded[:-2]) & (self.gain >= padded[2:]))
            best = peaks[np.argsort(-self.gain[peaks])][:CONTACT_STARTS]
            return [(panel, (0.0, 1.0)) for panel in best.tolist()]
        part_of = np.minimum(self.place * self.parts // self.length, self.parts - 1)
        found = []
        for part in range(self.parts):
            gain = np.where(part_of == part, self.gain, 0.0)
            if gain.any():
                ends = (part / self.parts, (part + 1) / self.parts)
                found.append((int(gain.argmax()), ends))
        return found

    def step(self, fit: FrameLinearization, panel: int) -> Array:
        """Return the response of the other unknowns (n,) in xi to a contact on a panel."""
        remaining = fit.weighed - self.weighed[:, panel] @ self.amounts[panel]
        return np.asarray(remaining @ fit.jacobian - fit.trial.xi)


def score_pushes(problem: FrameProblem, fit: FrameLinearization) -> PushScores:
    """Score a contact on each panel, with the covariance of all other unknowns."""
    bent = fit.trial.bent
    place, sensitivity = pushed_on_panels(bent.solution, bent.rods)
    displacement = measured_moves(problem.table.arm, sensitivity)
    turning = problem.add_swing(fit.trial, sensitivity, displacement)
    scale, motion = problem.unknowns.block(Push).scale, None
    moves = [scale * displacement[LOADS:]]
    swing, reference, arm = fit.trial.swing_deviation, problem.prior.reference, problem.swinging
    if arm is not None and reference is not None and swing is not None and turning is not None:
        acting = arm.force_on_shapes(swing, reference.turns, place)
        blow = arm.blow(problem.prior, reference, acting, turning[LOADS:])
        motion = ContactMotion(pull=(reference.pull @ acting).T, blow=blow)
        moves[0] = moves[0] + scale * swing.moved_by_shapes(motion.pull)
        if blow is not None:
            moves += [swing.moved_by_shapes(blow.swing[:, :, when]) for when in range(PLACES.size)]
            moves.append(swing.moved_by_links(blow.left_out, arm.targets))
    responses = np.stack(
        [problem.whiten(problem.along_arm(fit.trial, move)).T for move in moves], axis=2
    )
    weighed = fit.solve(responses.reshape(len(responses), -1)).reshape(responses.shape)
    information = np.einsum('cpi,cpj->pij', responses, weighed) + np.eye(len(moves))
    score = np.einsum('c,cpk->pk', fit.innovation, weighed)
    amounts = np.linalg.solve(information, score[:, :, None])[:, :, 0]
    low, high = problem.unknowns.block(Push).limits
    return PushScores(
        place=place,
        amounts=amounts,
        gain=np.where((place >= low) & (place <= high), np.sum(score * amounts, axis=1), 0.0),
        responses=responses,
        weighed=weighed,
        information=information,
        scale=scale,
        length=problem.table.arm.length,
        motion=motion,
    )


def find_contacts(
    problem: FrameProblem, best: Fit, *, unexplained: bool
) -> list[tuple[Fit, float]]:
    """Return fits with a contact, the best one for each place, best first.

    Each comes with the log probability that a contact anywhere is in the part of its prior. Empty
    if no contact is needed. problem: of all targets seen; best: the fit without a contact, perhaps
    without some targets; its linearization shows whether a contact is needed, unless that fit is
    inconsistent with the frame (unexplained).
    """
    settings, length = problem.settings, problem.table.arm.length
    fit = base = best[1]
    if unexplained and problem.swinging is not None:  # a blow has distorted the fit
        base = problem.linearize_at(np.zeros(fit.trial.xi.size), problem.prior.solution) or fit
    if base.trial.residual.size != problem.std.size:  # of all targets, including those left out
        again = problem.linearize_at(fit.trial.solved, fit.trial.bent.solution)
        if again is None:
            return []
        base = again
    scores = score_pushes(problem, base)
    likely = scores.gain >= settings.contact_score
    indicated = likely.any() and np.any(likely & (scores.evidence() > 0.0))
    if not indicated and not unexplained:
        return []
    log_share = -math.log(scores.parts)
    tried = [
        search_at(
            replace(problem, prior=with_any_contact(problem.unknowns, problem.prior, ends)),
            base,
            scores,
            panel,
        )
        for panel, ends in scores.starts()
    ]
    seen = int(np.count_nonzero(problem.used))
    # Beyond this the problem is not linear, and a std of the force is meaningless.
    predicted_gain = 2.0 * float(scores.gain.max())

    free = evidence_cost(best, seen) - 2.0 * (settings.odds_against - log_share)
    free_cost = fit.cost + left_out_cost(best, seen)

    def is_needed(item: Fit) -> bool:
        cost = item[1].cost + left_out_cost(item, seen)
        beyond = unexplained and excess(item) <= 1.0 and free_cost - cost > predicted_gain
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
    return [(item, log_share) for item in found]


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
    place_std = problem.root[where.stop - 1, -1]
    place = (scores.place[panel] - problem.mean[where.stop - 1]) / place_std
    others, (force, *blow) = scores.step(fit, panel), scores.amounts[panel].tolist()
    if scores.motion is not None:
        problem = scores.motion.with_prior(problem, panel)
    if blow and problem.left_out is not None:
        others[problem.left_out + ERRORS - 1] += blow.pop()
    start = np.concatenate([fit.trial.xi, [0.0, place], np.zeros(len(blow))])
    step = np.concatenate([others, [force, 0.0, *blow]])
    # A blow may be beyond the reach of one linear step: then the search begins without it.
    for xi in (start + step, start):
        found = problem.search(xi, fit.trial.bent.solution)
        if found is not None:
            return leave_out(problem, found)
    return None
