"""Hypothesis test over causes: each frame updates all hypotheses, and may add new ones.

The leading hypothesis is updated first. If it fits the frame within noise, the estimate is
published before the others are updated. If it does not fit, or only with a contact, or if all
frames together indicate a cause, every possible cause is added to it once. All hypotheses are
weighted by the evidence of the same frame, and those far less likely than the best are dropped.
"""

from __future__ import annotations

from dataclasses import replace
import math

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.belief import (
    Belief,
    CONTACT,
    first_belief,
    FORCE_SENSOR,
    forces_of,
    MOTION,
    PRESSURE,
)
from pneunet_ros.fusion.causes import (
    Alternative,
    Cause,
    CAUSES,
    CONTACTS,
    HIDDEN_AT_REST,
    RESET_RARITY,
    update_from,
)
from pneunet_ros.fusion.contact import CONTACT_APART
from pneunet_ros.fusion.hypothesis_update import (
    HypothesisUpdate,
    update_with_likeliest_walk,
    update_with_walk,
)
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.fusion.readings import ReadFrame, SeenFrame
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.tip_force import TipForce, Walk
from pneunet_ros.measurement.inference.bank import Hypothesis, ranked

FREE = 2.0  # average reduction of the chi squared of a frame by a free force
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FROZEN = 7.0  # sigma of the pressure, in which it changes behind a copy of a frame
FRAMES_LOST = 3  # one after the other, before a belief may be reset
MOST_MODEL_ERROR = 0.05  # of the range: beyond it the pressure is not used


def is_copy(model: PreparedModel, seen: SeenFrame, frame: ReadFrame) -> bool:
    """Whether a bit-identical frame is a copy, judging by a change of the pressure since."""
    pressure_change = abs(frame.instant.chamber - seen.chamber)
    return not frame.alone and pressure_change > FROZEN * frame.instant.std


def take(
    model: PreparedModel, state: FusionState, frame: ReadFrame, before: Belief
) -> HypothesisUpdate:
    """Return the update of the leading hypothesis by a frame.

    Of consecutive frames that were not used, only a few are searched over all forces.
    """
    widely = is_due(state) or not before.frames
    found_better = state.search.found_better
    return update_with_likeliest_walk(
        model, frame, before, found_better=found_better, widely=widely
    )


def estimate_walk(updated: HypothesisUpdate) -> Walk:
    """Return the walk of the tip force after a frame of a swinging arm."""
    walk, fit = updated.problem.prior.walk, updated.update.fit
    information = None if fit is None else fit[0].walk_information(fit[1])
    if information is None or not updated.before.frames:
        return replace(walk, most_likely=0.0)
    seconds = seconds_between(updated.before.stamp_ns, updated.frame.stamp_ns)
    force = updated.problem.unknowns.block(TipForce)
    after = force.estimate_walk(walk, *information, seconds, updated.before.frames)
    return replace(after, most_likely=walk.recent)


def kept_force_errors(model: PreparedModel, updated: HypothesisUpdate) -> Array | None:
    """Return what errors before a frame contribute to the forces after it, (forces, errors).

    None without a fit. None also if a force is read: its update has new errors.
    """
    fit = updated.update.fit
    if fit is None or model.used(updated.frame, updated.before.causes).wrench is not None:
        return None
    problem, linear = fit
    rows = problem.root[forces_of(problem.unknowns)]
    return linear.errors_after(rows)[:, : updated.before.root.shape[1]]


def with_estimated_walk(model: PreparedModel, updated: HypothesisUpdate) -> Belief:
    """Return the belief after a frame of a swinging arm, with its estimated random walk."""
    after = updated.after
    if updated.update.belief is None or model.of(after.causes).swinging is None:
        return after
    return replace(after, walk=estimate_walk(updated))


def is_due(state: FusionState) -> bool:
    """Whether a lost frame gets the full search: the 1st, 2nd, 4th, 8th... in a row.

    Frames that no hypothesis fits must not delay the frames that follow.
    """
    return not state.counts.lost & (state.counts.lost + 1)


def weigh(
    model: PreparedModel, state: FusionState, updated: HypothesisUpdate
) -> tuple[tuple[Hypothesis[Belief], ...], HypothesisUpdate]:
    """Return the likely hypotheses after a frame, and its update by the best one.

    updated: the hypothesis that was leading.
    """
    leading, *other_hypotheses = state.bank or (Hypothesis(belief=updated.before),)
    weighed = [(updated, leading.log_weight)]
    by = update_with_likeliest_walk if is_due(state) else update_with_walk
    weighed += [(by(model, updated.frame, one.belief), one.log_weight) for one in other_hypotheses]
    if not updated.before.frames and updated.update.belief is not None:
        for cause in CAUSES:
            if cause.hidden_at_rest and cause.is_possible(model, updated):
                weighed += with_cause(model, cause, weighed[0])
    best = best_of(weighed)
    # A frame that does not fit must not wait for its cause, unless none has fitted ever.
    if is_due(state) or (best[0].update.fit is not None and best[0].before.frames):
        touches = contact_alternatives(model, weighed, best)
        weighed += touches
        if should_test_causes(model, best[0], weighed, touches):
            weighed += cause_alternatives(model, state, weighed, best)
    likeliest, _ = best_of(weighed)
    if likeliest.update.belief is None:  # no hypothesis fits: no information
        return state.bank or (leading,), updated
    weights = log_weights(model, weighed, max(likeliest.cost_per_coordinate, 1.0))
    after = [with_estimated_walk(model, one) for one, _ in weighed]
    candidates = [
        Hypothesis(belief=belief, log_weight=weight)
        for belief, weight in zip(after, weights, strict=True)
    ]
    settings = model.settings
    bank = ranked(
        candidates,
        settings.bound,
        settings.most_hypotheses,
        lambda one, other: is_same(model, one, other),
    )
    # At rest the evidence of hidden causes is noise, and the first of the bank publishes the bend.
    bank = with_pressure_first(led_without(bank, HIDDEN_AT_REST))
    led = next(which for which, belief in enumerate(after) if belief is bank[0].belief)
    return bank, weighed[led][0]


def led_without(
    bank: tuple[Hypothesis[Belief], ...], causes: frozenset[str]
) -> tuple[Hypothesis[Belief], ...]:
    """Return the hypotheses, with one without some causes first if it is about as likely."""
    others = [one for one in bank if not one.belief.causes & causes]
    if bank[0] in others or not any(one.is_about_as_likely for one in others):
        return bank
    return tuple(sorted(bank, key=lambda one: bool(one.belief.causes & causes)))


def with_pressure_first(bank: tuple[Hypothesis[Belief], ...]) -> tuple[Hypothesis[Belief], ...]:
    """Return the hypotheses, with one that uses the pressure first if it is about as likely.

    If the leading hypothesis drops the pressure, so do all others. Therefore this waits until
    hypotheses that use the pressure are clearly less likely.
    """
    bank = led_without(bank, frozenset({PRESSURE}))
    if PRESSURE not in bank[0].belief.causes:
        return bank
    return tuple(one for one in bank if PRESSURE in one.belief.causes)


def best_of(weighed: list[Alternative]) -> Alternative:
    """Return the most likely hypothesis after a frame, preferably one that used the frame."""
    used = [one for one in weighed if one[0].update.belief is not None]
    return max(used or weighed, key=lambda one: one[1] + one[0].log_evidence)


def log_weights(model: PreparedModel, weighed: list[Alternative], temper: float) -> list[float]:
    """Return the log weights after a frame.

    temper: divides the log evidence of a frame that no hypothesis fits well.
    """
    swings = [
        one
        for one, _ in weighed
        if model.moving is not None and one.update.belief and MOTION in one.after.causes
    ]
    used = [one.update.belief is not None for one, _ in weighed]
    evidences = [
        evidence_comparable_with_swings(model, one, swings) if counts else -math.inf
        for (one, _), counts in zip(weighed, used, strict=True)
    ]
    gained = max(
        smoothness_of_loads(model, one, evidence, swings)
        for (one, _), evidence in zip(weighed, evidences, strict=True)
    )
    weights = [
        weight + (evidence + (gained if is_at_rest(one) else 0.0)) / temper
        for (one, weight), evidence in zip(weighed, evidences, strict=True)
    ]
    rests = [
        which for which, (one, _) in enumerate(weighed) if used[which] and is_open(model, one)
    ]
    if not rests:
        return weights
    contact = max(rests, key=lambda which: weights[which])
    for which, (one, weight) in enumerate(weighed):
        if used[which] and FORCE_SENSOR in one.after.causes:
            gain = 0.5 * (weighed[contact][0].cost - one.cost - FREE)
            level = weights[contact] - weighed[contact][1]
            weights[which] = weight + level + gain / temper
            if not one.after.touched and gain > -model.settings.bound:
                weights[which] = max(weights[which], weights[contact])
    return weights


def is_at_rest(updated: HypothesisUpdate) -> bool:
    """Whether a hypothesis has followed the frames so far without a swing."""
    return MOTION not in updated.before.causes and updated.before.frames > 0


def evidence_comparable_with_swings(
    model: PreparedModel, updated: HypothesisUpdate, swings: list[HypothesisUpdate]
) -> float:
    """Return the log evidence of a frame, comparable with that of swinging arms, if there are any.

    Without a swing, the force may change freely from frame to frame, which reduces the evidence
    even under a steady load. Therefore the recent random walk of the force is tried here as well.
    """
    if not swings or not is_at_rest(updated):
        return updated.log_evidence
    steady = update_from(model, updated, updated.before, updated.before.walk.recent)
    return max(updated.log_evidence, steady.log_evidence)


def smoothness_of_loads(
    model: PreparedModel,
    updated: HypothesisUpdate,
    evidence: float,
    swings: list[HypothesisUpdate],
) -> float:
    """Return the log evidence that an arm at rest lacks because of the noise of its readings.

    A swinging arm averages this noise, because its mass makes the motion smooth. That is no
    evidence for a mass, because loads are smooth as well. Where the force is read and the frame is
    explained, the prediction therefore counts as sharp as with known loads, or without a contact
    as with a swing, and the targets test the reading, which a swing only follows. All hypotheses
    of an arm at rest gain this. evidence: that of `evidence_comparable_with_swings`.
    """
    if not swings or not is_at_rest(updated) or updated.misfits or not math.isfinite(evidence):
        return 0.0
    if model.used(updated.frame, updated.before.causes).wrench is None:
        return 0.0
    sharpest = updated.log_sharpness_given_loads
    if not updated.after.touched:  # the freedom of a contact stays its own cost
        sharpest = max(sharpest, *(one.log_sharpness for one in swings))
    smooth = updated.log_evidence + max(sharpest - updated.log_sharpness, 0.0) + 0.5 * FREE
    return max(smooth - evidence, 0.0)


def is_open(model: PreparedModel, updated: HypothesisUpdate) -> bool:
    """Whether a contact relies on a force sensor that no frame has confirmed.

    The error of such a sensor may follow any law, so its reading is no evidence for a contact. A
    hypothesis without the sensor is not penalized for predicting fewer measurements: it remains as
    likely as the contact as long as it fits the frames nearly as well.
    """
    belief = updated.after
    read = model.used(updated.frame, belief.causes).wrench is not None
    return (
        belief.touched
        and read
        and not model.settings.free_tip
        and not model.force_sensor_is_confirmed(updated.before)
    )


def contact_alternatives(
    model: PreparedModel, weighed: list[Alternative], best: Alternative
) -> list[Alternative]:
    """Return updates with a contact, and updates in which a contact has ended."""
    updated = best[0]
    if not CONTACTS.is_possible(model, updated):
        return []
    if updated.before.touched:
        rest = updated.before.causes - {CONTACT}
        known = any(one.before.causes == rest for one, _ in weighed)
        if known or CONTACTS.is_sure(model, updated):
            return []
    elif any(one.before.touched and not one.misfits for one, _ in weighed):
        return []  # at the same place as before
    return with_cause(model, CONTACTS, best)


def with_cause(model: PreparedModel, cause: Cause, base: Alternative) -> list[Alternative]:
    """Return alternatives in which one cause is added to a hypothesis."""
    updated, weight = base
    against = weight - cause.rarity * model.settings.odds_against
    return [(one, against + earlier) for one, earlier in cause.alternatives(model, updated)]


def should_test_causes(
    model: PreparedModel,
    updated: HypothesisUpdate,
    weighed: list[Alternative],
    touches: list[Alternative],
) -> bool:
    """Whether to test causes other than the current hypothesis.

    True if no hypothesis fits the frame, if a contact would fit better (most other causes look
    like a contact), or if all frames together indicate a cause.
    """
    touched = any(one.after.touched for one, _ in touches)
    if touched or updated.misfits or updated.frame.pressure_still:
        return True
    if is_open(model, updated) and not any(FORCE_SENSOR in one.after.causes for one, _ in weighed):
        return True
    if model.size_of(updated.after) > MOST_MODEL_ERROR:
        return True
    return any(is_indicated(model, cause, updated.after) for cause in CAUSES)


def is_indicated(model: PreparedModel, cause: Cause, belief: Belief) -> bool:
    """Whether all frames together make a cause more likely than not."""
    if cause.name in belief.causes:
        return False
    return cause.log_odds_so_far(model, belief) > cause.rarity * model.settings.odds_against


def cause_alternatives(
    model: PreparedModel, state: FusionState, weighed: list[Alternative], best: Alternative
) -> list[Alternative]:
    """Return updates with each possible cause, and with a reset belief if frames are lost."""
    base = without_touch(weighed, best)
    found = [
        one for side in (base, *other_side(weighed, base)) for one in all_alternatives(model, side)
    ]
    found += with_restarted_swing(model, base)
    if state.counts.lost >= FRAMES_LOST and best_of([*weighed, *found])[0].misfits:
        updated, weight = base
        unknowns = model.of(state.lasting).unknowns
        first = first_belief(unknowns, updated.frame.stamp_ns, state.lasting)
        restarted = (
            update_from(model, updated, first),
            weight - RESET_RARITY * model.settings.odds_against,
        )
        found += [restarted, *all_alternatives(model, restarted)]
    return found


def with_restarted_swing(model: PreparedModel, base: Alternative) -> list[Alternative]:
    """Return the update of a swinging arm of which only the swing is wrong: something has hit it.

    Otherwise such a frame would cost all that is known, as in a belief that is begun anew.
    """
    updated, weight = base
    swinging = model.of(updated.before.causes).swinging
    if swinging is None or not updated.before.frames:
        return []
    hit = update_from(model, updated, swinging.with_restarted_swing(updated.before))
    return [(hit, weight - RESET_RARITY * model.settings.odds_against)]


def all_alternatives(model: PreparedModel, base: Alternative) -> list[Alternative]:
    """Return alternatives in which any one possible cause is added to a hypothesis."""
    updated = base[0]
    return [
        one
        for cause in CAUSES
        if (cause.hidden_at_rest or cause.name not in updated.before.causes)
        and cause.is_possible(model, updated)
        for one in with_cause(model, cause, base)
    ]


def other_side(weighed: list[Alternative], base: Alternative) -> list[Alternative]:
    """Return the best hypothesis that differs from another in what an arm at rest hides, if any.

    Until the arm bends, a further cause such as other targets fits with either of them.
    """
    own = base[0].after.causes & HIDDEN_AT_REST
    others = [one for one in weighed if one[0].after.causes & HIDDEN_AT_REST != own]
    return [best_of(others)] if others else []


def without_touch(weighed: list[Alternative], best: Alternative) -> Alternative:
    """Return the best hypothesis without its contact, if that hypothesis was evaluated.

    Most causes look like a contact, so a contact is accepted only after the others were tried.
    """
    causes = best[0].after.causes - {CONTACT}
    return next((one for one in weighed if one[0].after.causes == causes), best)


def is_same(model: PreparedModel, one: Belief, other: Belief) -> bool:
    """Whether two hypotheses are the same: equal causes, and a contact at the same place."""
    if one.causes != other.causes:
        return False
    place = model.unknowns.at(Push).stop - 1
    distance = abs(float(one.mean[place] - other.mean[place]))
    return distance <= CONTACT_APART * model.arm.length
