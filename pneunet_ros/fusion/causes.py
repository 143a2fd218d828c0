"""Possible causes of error, one class each.

A cause competes with all others by its evidence (`fusion.weighing`): its prior odds, and the
evidence of frames for a belief that includes it.
"""

from __future__ import annotations

import abc
from collections.abc import Iterator
from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.fusion.belief import (
    Belief,
    CONTACT,
    first_belief,
    FORCE_SENSOR,
    FRAME_TIMES,
    LASTING,
    MIRRORED,
    MOTION,
    PRESSURE,
    reset_to_prior,
)
from pneunet_ros.fusion.contact import differs_from_zero, find_contacts, without_contact
from pneunet_ros.fusion.frame_update import excess, force_at, FrameUpdate, misfits, with_fit
from pneunet_ros.fusion.hypothesis_update import (
    HypothesisUpdate,
    update_with_likeliest_walk,
    update_with_walk,
)
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.force_sensor import ForceSensor
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.target_row import TargetRow
from pneunet_ros.measurement.blocks.tilt import Tilt
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.inference.gaussian import (
    forget,
    prior_log_odds,
    widen,
    with_prior,
    without_prior,
)

CAMERA, TARGETS, TILT = 'camera', 'targets', 'tilt'
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
CONTACT_GONE = 25.0  # chi squared of a contact force below which it may have ended
TURN_TOLERANCE = 0.002  # rad, below which a camera is never taken for moved
Alternative = tuple[HypothesisUpdate, float]  # and its log odds without the evidence of the frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause(abc.ABC):
    """A cause of error that a hypothesis may include.

    sentence: what to fix on the rig. rarity: prior log odds against the cause, in units of
    `odds_against`; more than 1 if a model error looks similar. hidden_at_rest: whether frames of
    an arm at rest say nothing of it: then it is a rival from the first frame on, and if it is
    believed, so is its end.
    """

    name: ClassVar[str]
    sentence: ClassVar[str]
    rarity: ClassVar[float] = 1.0
    hidden_at_rest: ClassVar[bool] = False

    def log_odds_so_far(self, model: PreparedModel, belief: Belief) -> float:
        """Return the log odds of the cause from the belief after all frames so far."""
        return -math.inf

    @abc.abstractmethod
    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Whether this cause may explain a frame that fits no hypothesis without a contact."""

    @abc.abstractmethod
    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Yield updates by the frame with this cause added.

        Each comes with the log odds (nats) by which earlier frames favor it; 0 if they are
        uninformative. updated: the hypothesis without this cause.
        """


def update_from(
    model: PreparedModel, updated: HypothesisUpdate, before: Belief, walk: float | None = None
) -> HypothesisUpdate:
    """Return the update of another belief by the same frame, starting at any last shape.

    walk (N/sqrt(s)): random walk of the tip force on a swinging arm; None: as in `updated`.
    """
    if walk is None and before.frames and updated.problem.swinging is not None:
        walk = updated.problem.prior.walk.recent
    return update_with_walk(model, updated.frame, before, walk)


def with_posterior(updated: HypothesisUpdate, after: Belief) -> HypothesisUpdate:
    """Return the frame with the belief that another initial prior would have given.

    A frame that was not used says nothing of that either.
    """
    if updated.update.belief is None:
        return updated
    return replace(updated, update=replace(updated.update, belief=after))


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactCause(Cause):
    """An object touches the arm. A hypothesis with a contact also tests whether it has ended."""

    name: ClassVar = CONTACT
    sentence: ClassVar = ''

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether there is a fit to start from; the score test decides."""
        return updated.update.fit is not None

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Search for a contact along the arm, starting without the current one."""
        fit, frame, before = updated.update.fit, updated.frame, updated.before
        if fit is None:
            return
        if before.touched:
            free = update_with_likeliest_walk(
                model, frame, without_contact(model.unknowns, before)
            )
            yield free, 0.0
            if free.update.fit is None or excess(fit) <= 1.0:
                return
            updated, fit, before = free, free.update.fit, free.before
        seen = int(np.count_nonzero(updated.problem.used))
        read = frame.wrench is not None
        for found, share in find_contacts(updated.problem, fit, unexplained=misfits(fit)):
            begun = FrameUpdate(belief=None, unchecked=None if read else found, settled=read)
            update = with_fit(begun, found, found, seen)
            with_contact = HypothesisUpdate(
                frame=frame, before=before, problem=updated.problem, update=update
            )
            yield with_contact, share

    def is_sure(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Whether a contact is still certain, because it fits the frame and the measured force.

        Without a force sensor, even a large contact force proves nothing: another tip force may
        fit without a contact.
        """
        fit = updated.update.fit
        read = model.settings.free_tip or updated.frame.wrench is not None
        return (
            read
            and fit is not None
            and excess(fit) <= 1.0
            and differs_from_zero(fit, CONTACT_GONE)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCause(Cause):
    """The camera was moved or turned."""

    name: ClassVar = CAMERA
    rarity: ClassVar = 3.0
    sentence: ClassVar = (
        'the camera has moved since it was registered: its pose is estimated from the '
        'arm, and the stated errors include it. Find base_from_camera again and reset; '
        'if the camera did not move, run pneunet diagnose'
    )

    def priors(self, model: PreparedModel) -> tuple[slice, Array, Array, Array]:
        """Return its unknowns, one sigma if the camera stayed and if it moved, and the mean."""
        unknowns = model.unknowns
        where = slice(unknowns.at(Camera, Camera.PLACE).start, unknowns.at(Camera).stop)
        center = unknowns.block(Camera).prior.mean[Camera.PLACE.start :]
        return where, unknowns.std[where], unknowns.block(Camera).moved_std, center

    def log_odds_so_far(self, model: PreparedModel, belief: Belief) -> float:
        """Weigh a rotation that causes no misfit, because a tip force looks similar."""
        if not model.camera_is_observable or not model.force_is_known(belief):
            return -math.inf  # with an undetermined force the rotation is undetermined as well
        where, before, after, _ = self.priors(model)
        turn = slice(where.stop - 1, where.stop)
        innocent = np.array([TURN_TOLERANCE])
        return log_odds_beyond(belief, turn, before[-1:], innocent, after[-1:])

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether the model error is known; otherwise it may look like a moved camera."""
        return model.camera_is_observable

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try a camera that moved since the last frame, or that was misplaced from the start.

        The latter only if the frames so far support it.
        """
        where, stayed, moved, center = self.priors(model)
        now = widen(updated.before, where, moved)
        yield update_from(model, updated, replace_causes(now, self.name)), 0.0
        if self.log_odds_so_far(model, updated.after) > 0.0:
            initial, earlier = with_prior(updated.after, where, stayed, moved, center)
            yield with_posterior(updated, replace_causes(initial, self.name)), earlier


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetsCause(Cause):
    """The targets are not those of the calibration."""

    name: ClassVar = TARGETS
    sentence: ClassVar = (
        'the targets are not where the calibration found them: ignoring their calibrated '
        'positions. Calibrate again, or remove covariance.placement from the model file'
    )

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether the calibrated model knows the positions of the targets."""
        return model.unknowns.block(Placement).known is not None

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try a repainted row, then individually repainted targets.

        That they have changed between two frames is as rare as a belief that is wrong.
        """
        unknowns, later = model.unknowns, 0.0
        if updated.before.frames:
            later = (self.rarity - RESET_RARITY) * model.settings.odds_against
        row = unknowns.at(TargetRow)
        each = slice(unknowns.at(Placement).start, row.stop)
        for where in (row, each):
            other = forget(updated.before, where, unknowns.std[where])
            yield update_from(model, updated, replace_causes(other, TARGETS)), later


@dataclass(frozen=True, slots=True, kw_only=True)
class TiltCause(Cause):
    """The base is tilted, so the weight of the arm bends it."""

    name: ClassVar = TILT
    rarity: ClassVar = 3.0
    sentence: ClassVar = (
        'gravity acts in a different direction than in the model: level the base, or set the '
        'direction of gravity (parameter gravity, --gravity), and reset'
    )

    def log_odds_so_far(self, model: PreparedModel, belief: Belief) -> float:
        """Weigh a tilt that a tip force nearly hides in each frame."""
        tilt, where = model.unknowns.block(Tilt), model.unknowns.at(Tilt)
        if not model.camera_is_observable or self.name in belief.causes:
            return -math.inf
        return log_odds_beyond(belief, where, tilt.std, 2.0 * tilt.std, tilt.tilted_std)

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether the model error is known; otherwise it may look like a tilted base."""
        return model.camera_is_observable

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try a base that tilted since the last frame, or that was tilted from the start.

        Gravity that has just turned has not moved an arm with mass yet, so that only many frames
        can show it. A tilt from the start begins anew if a contact, a swing or a fault of the
        force sensor may have explained the tilt until now, because what frames taught of all other
        unknowns is then wrong as well. Other causes, and a known motion, are not found again along
        the way.
        """
        tilt, where = model.unknowns.block(Tilt), model.unknowns.at(Tilt)
        before = updated.before
        if model.swinging is None:
            now = widen(before, where, tilt.tilted_std)
            yield update_from(model, updated, replace_causes(now, self.name)), 0.0
        earlier = self.log_odds_so_far(model, updated.after)
        if earlier <= 0.0:
            return
        if model.swinging is None and before.causes <= LASTING | {CONTACT}:
            lasting = before.causes & LASTING - {MOTION, FORCE_SENSOR}
            first = first_belief(model.unknowns, before.stamp_ns, lasting | {self.name})
            yield update_from(model, updated, widen(first, where, tilt.tilted_std)), earlier
            return
        level, tilted = tilt.std, tilt.tilted_std
        initial, earlier = with_prior(updated.after, where, level, tilted)
        yield with_posterior(updated, replace_causes(initial, self.name)), earlier


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceSensorCause(Cause):
    """The force sensor is faulty: wrong zero, wrong gain, a swapped axis, a dead cable.

    Because there are many kinds of faults, the readings are not used.
    """

    name: ClassVar = FORCE_SENSOR
    sentence: ClassVar = (
        'ignoring the force sensor: it disagrees with the targets. Check its sign, axes and '
        'cable, the pressure, and whether the camera was turned; then tare it with the arm '
        'unloaded and reset, or run pneunet diagnose'
    )

    def log_odds_so_far(self, model: PreparedModel, belief: Belief) -> float:
        """Weigh a sensor error that is small in every single frame."""
        sensor, where = model.unknowns.block(ForceSensor), model.unknowns.at(ForceSensor)
        if FORCE_SENSOR in belief.causes:
            return -math.inf
        return log_odds_beyond(belief, where, sensor.std, sensor.innocent_std, sensor.off_std)

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether a sensor is used."""
        return updated.frame.wrench is not None and not model.settings.free_tip

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try a sensor that failed since the last frame, or that was faulty from the start."""
        sensor, where = model.unknowns.block(ForceSensor), model.unknowns.at(ForceSensor)
        if not sensor.std.all():
            return
        now = replace_causes(updated.before, FORCE_SENSOR)
        yield update_from(model, updated, now), 0.0
        if self.log_odds_so_far(model, updated.after) > 0.0:
            initial, earlier = with_prior(updated.after, where, sensor.std, sensor.off_std)
            initial = replace_causes(initial, FORCE_SENSOR)
            yield with_posterior(updated, initial), earlier


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureCause(Cause):
    """The pressure reading is wrong: the sensor is frozen, or its zero or unit has changed."""

    name: ClassVar = PRESSURE
    rarity: ClassVar = 2.0
    sentence: ClassVar = (
        'ignoring the pressure sensor: it disagrees with the targets. Check for a '
        'frozen reading, the unit, the zero offset, the valve and the clocks (frames lost from a '
        'film, late stamps: set delay_std), then reset; if all are right, run pneunet diagnose'
    )

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return False if readings are too far apart to interpolate the pressure."""
        frame = updated.frame
        missed = frame.instant.missed > model.arm.sensors.pressure_std
        return model.camera_is_observable and not frame.alone and not missed

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try ignoring the pressure from now on, or from the start if earlier readings were wrong.

        These compete with a belief that is reset but keeps the sensor, because the belief itself
        may be wrong.
        """
        frame, before = updated.frame, updated.before
        now = replace_causes(before, PRESSURE)
        yield update_from(model, updated, now), 0.0
        if not before.frames:
            return
        restarted = reset_to_prior(model.of(updated.after.causes).unknowns, updated.after)
        lost = -RESET_RARITY * model.settings.odds_against
        yield update_from(model, updated, replace_causes(restarted, PRESSURE)), lost
        if math.isinf(frame.instant.step):  # the sensor may be coarse rather than wrong
            frame = frame.with_pressure_std(model.coarsest_pressure)
        with_pressure = HypothesisUpdate(
            frame=frame, before=restarted, problem=updated.problem, update=updated.update
        )
        yield (
            update_from(model, with_pressure, restarted),
            lost + self.rarity * model.settings.odds_against,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MirroredCause(Cause):
    """The image is mirrored, by a mirror in front of the camera or by its driver."""

    name: ClassVar = MIRRORED
    hidden_at_rest: ClassVar = True
    sentence: ClassVar = (
        'the image is mirrored: the arm bends to the wrong side. Flip the image in '
        'the camera driver, or calibrate base_from_camera again, and reset'
    )

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether the frame can show it.

        Far from its predicted shape, an arm that swings may be on either side: none if the model
        error is unknown, and only the first frame of a belief if the motion is a guess.
        """
        if MOTION in updated.before.causes and updated.before.frames:
            return False
        return model.of(updated.before.causes).swinging is None or model.camera_is_observable

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try the targets on the other side of the arm's axis, as in no mirror or in one."""
        before = updated.before
        yield update_from(model, updated, replace(before, causes=before.causes ^ {MIRRORED})), 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTimesCause(Cause):
    """Frames show the arm at other times than their stamps say, row by row."""

    name: ClassVar = FRAME_TIMES
    sentence: ClassVar = (
        'frames show the moving arm at other times than their stamps say: set shutter.readout in '
        'the camera file if its rows are read one after the other, or delay_std if its clock or '
        'that of the pressure is late, and reset'
    )

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether a frame can show it: model error, pressure and force sensor are known.

        A blow on an arm that swings by its model looks like that too.
        """
        causes = updated.before.causes
        if not model.camera_is_observable or model.swinging is not None or PRESSURE in causes:
            return False
        unread = model.settings.free_tip or model.used(updated.frame, causes).wrench is None
        return unread or model.force_sensor_is_confirmed(updated.before)

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try frames of unknown times."""
        yield update_from(model, updated, replace_causes(updated.before, self.name)), 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionCause(Cause):
    """The arm swings, but its model has no motion."""

    name: ClassVar = MOTION
    sentence: ClassVar = (
        'the arm swings, but its model has no `motion`: assuming the mass that follows from its '
        'weight, and a typical damping. Calibrate with --motion'
    )

    def log_odds_so_far(self, model: PreparedModel, belief: Belief) -> float:
        """Weigh a mass whose inertia a tip force has explained so far."""
        return -math.inf if belief.inertial is None else belief.inertial.log_odds

    def is_possible(self, model: PreparedModel, updated: HypothesisUpdate) -> bool:
        """Return whether the model has no motion."""
        return model.moving is not None

    def alternatives(
        self, model: PreparedModel, updated: HypothesisUpdate
    ) -> Iterator[Alternative]:
        """Try a swing since the last frame, from the start, or since the arm was at rest.

        Since the last frame it swings by an unknown force. That an arm at rest began to swing is
        a prediction, so earlier frames may speak against it.
        """
        before, fit = updated.before, updated.update.fit
        if fit is None:
            return
        causes = before.causes | {self.name}
        unknowns = model.of(causes).unknowns
        first = first_belief(unknowns, before.stamp_ns, causes)
        force = unknowns.at(TipForce)
        recent = extended(widen(before, force, unknowns.std[force]), first)
        mean = recent.mean.copy()
        mean[force] = force_at(fit[0], fit[1].trial)  # the search begins there
        solution = fit[1].trial.bent.solution
        recent = replace(recent, mean=freeze(mean), solution=solution)
        odds = 0.0 if before.inertial is None else before.inertial.log_odds
        earlier, lost = max(odds, 0.0), RESET_RARITY * model.settings.odds_against
        begun = [(recent, earlier), (first, earlier - lost)]
        # Odds of exactly 0 are no evidence: then only a frame that needs a swing begins one.
        if odds or not updated.explained:
            begun += [(since, odds) for since in self.since_rest(model, updated)]
        for other, favored in begun:
            swinging = update_from(model, updated, other)
            if not swinging.misfits:  # if not, it is unmodeled noise, not a swing
                yield swinging, favored

    def since_rest(self, model: PreparedModel, updated: HypothesisUpdate) -> Iterator[Belief]:
        """Yield the belief of an arm with mass after the last frame in which it was at rest.

        Nothing if there is no such frame, the readings since then are no longer kept, or what they
        mean has changed.
        """
        before, frame = updated.before, updated.frame
        rest, readings = before.rest, frame.before
        if rest is None or not readings or readings[0].stamp_ns > rest.frame.stamp_ns:
            return
        changed = (before.causes ^ rest.before.causes) & {MIRRORED, FORCE_SENSOR}
        if changed or rest.frame.stamp_ns >= frame.stamp_ns:
            return
        causes = rest.before.causes | before.causes & {FRAME_TIMES} | {self.name}
        model = model.of(causes)
        first = first_belief(model.unknowns, rest.before.stamp_ns, causes)
        still = nearly_at_rest(model, extended(rest.before, first), rest.swing)
        after = update_with_walk(model, rest.frame, still).update.belief
        if after is not None:
            yield after


def nearly_at_rest(model: PreparedModel, belief: Belief, swing: tuple[float, float]) -> Belief:
    """Return a belief with a smaller swing: one sigma of the tip (m) and its velocity (m/s)."""
    assert model.swinging is not None
    deviation, velocity = model.swinging.first_swing
    where, root = model.unknowns.at(Motion).start, belief.root.copy()
    for part, share in (
        (Motion.PLACE, swing[0] / deviation),
        (Motion.MOMENTUM, swing[1] / velocity),
    ):
        root[where + part.start : where + part.stop] *= min(share, 1.0)
    return replace(belief, root=freeze(root))


def extended(known: Belief, first: Belief) -> Belief:
    """Return the belief about the first unknowns, extended by the prior of the remaining ones."""
    known_size, columns = known.mean.size, known.root.shape[1]
    remaining_root = first.root[known_size:, first.root[known_size:].any(axis=0)]
    root = np.zeros((first.mean.size, columns + remaining_root.shape[1]))
    root[:known_size, :columns], root[known_size:, columns:] = known.root, remaining_root
    mean = np.concatenate([known.mean, first.mean[known_size:]])
    return replace(
        known, mean=freeze(mean), root=freeze(root), causes=first.causes, walk=first.walk
    )


def log_odds_beyond(
    belief: Belief, where: slice, before: Array, innocent: Array, after: Array
) -> float:
    """Return the log odds of a wide prior from all frames so far, if the error is not harmless.

    before, after: one sigma (k,) of the original prior of the belief, and of the wide one;
    innocent (k,): harmless errors. -inf if all errors are smaller, or if the frames cannot resolve
    such a small error, as along a straight arm, where the force is held.
    """
    large = False
    for which, std, limit in zip(range(where.start, where.stop), before, innocent, strict=True):
        value, known = without_prior(belief, which, float(std))
        if known >= limit:
            return -math.inf
        large |= abs(value) > limit
    return prior_log_odds(belief, where, before, after) if large else -math.inf


def replace_causes(belief: Belief, *more: str) -> Belief:
    """Return a belief with further active causes."""
    return replace(belief, causes=belief.causes | set(more))


CONTACTS = ContactCause()
CAUSES: tuple[Cause, ...] = (
    CameraCause(),
    TargetsCause(),
    TiltCause(),
    ForceSensorCause(),
    PressureCause(),
    MirroredCause(),
    FrameTimesCause(),
    MotionCause(),
)
# Of a belief that is completely wrong: it is as rare as the rarest cause.
RESET_RARITY = max(cause.rarity for cause in CAUSES)
HIDDEN_AT_REST = frozenset(cause.name for cause in CAUSES if cause.hidden_at_rest)
