"""Direction of gravity at the base, from an accelerometer on it or a tf frame.

An accelerometer measures the specific force, the opposite of the apparent gravity in the base
frame of the arm. A tf frame gives the direction of gravity but no accelerations.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np
from pneunet_ros.core.frame_tree import FrameTree
from pneunet_ros.core.frames import is_rotation, Quaternion, rotation_matrix, UNTURNED
from pneunet_ros.core.outcome import drop, Refusal, refuse
from pneunet_ros.core.readings import BaseReading, FrameReading, ImuReading
from pneunet_ros.core.stamps import RESTARTED, stamp_fault
from pneunet_ros.core.units import seconds_between, seconds_since, STANDARD_GRAVITY
from pneunet_ros.estimation.settings import EstimatorSettings, turn_of
from pneunet_ros.measurement.moving_arm import BaseMotion
from pneunet_ros.model.gravity import FIXED, Gravity, IMU

WHAT = 'base_imu reading'
LEFT_OUT = 'the parameter gravity (--gravity) replaces base_imu'
# Geometric means of the norms at rest in g and in m/s^2, and in m/s^2 and in mg.
SMALLEST = math.sqrt(STANDARD_GRAVITY)
LARGEST = math.sqrt(STANDARD_GRAVITY * 1000.0)
Direction = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class GravityReading:
    """Gravity in the base frame: components along x and y, in g.

    turn_rate: angular velocity (rad/s) of the base in the bending plane; NaN: not measured.
    variance (m/s^2)^2 of each component; 0 = unknown.
    """

    stamp_ns: int
    direction: Direction
    turn_rate: float
    variance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseGravity:
    """State of gravity at the base: frames, and the last usable reading.

    earlier: the previous usable reading; published: whether base_imu was ever received.
    """

    frames: FrameTree = field(default_factory=FrameTree)
    reading: GravityReading | None = None
    earlier: GravityReading | None = None
    published: bool = False

    def fresh(self) -> BaseGravity:
        """Discard all readings, but keep static frames and whether there is an accelerometer."""
        return BaseGravity(frames=self.frames.only_fixed(), published=self.published)


@dataclass(frozen=True, slots=True, kw_only=True)
class GravitySource:
    """Source of the direction of gravity; settings: meaning of readings; gravity of the arm.

    frame: a tf frame whose z axis points up; empty: use `base_imu`, which is required once it has
    been received or if the model does not state the direction, and ignored if the direction is
    fixed.
    """

    settings: EstimatorSettings
    gravity: Gravity
    frame: str = field(init=False)

    def __post_init__(self) -> None:
        """Determine the frame."""
        named = self.gravity.source if self.gravity.is_measured else ''
        frame = '' if self.gravity.source == FIXED else self.settings.gravity_frame or named
        object.__setattr__(self, 'frame', '' if frame == IMU else frame.lstrip('/'))

    @property
    def uses_imu(self) -> bool:
        """Whether `base_imu` is used."""
        return not self.frame and self.gravity.source != FIXED

    def take(self, known: BaseGravity, reading: BaseReading) -> tuple[BaseGravity, Refusal | None]:
        """Process a reading of the accelerometer or of frames; an invalid one is refused."""
        if not isinstance(reading, ImuReading):
            return self.take_frames(known, reading)
        if not self.uses_imu:
            return known, None
        refusal, found = self.unfit(known, reading), None
        if refusal is None:
            found, refusal = self.gravity_of(known.frames, reading)
        known = replace(known, published=True)
        if found is None:
            return known, refusal
        return replace(known, reading=found, earlier=known.reading), None

    def take_frames(
        self, known: BaseGravity, readings: tuple[FrameReading, ...]
    ) -> tuple[BaseGravity, Refusal | None]:
        """Process readings of frames; invalid rotations are ignored."""
        good = [one for one in readings if is_rotation(one.quaternion)]
        if not self.frame and not any(one.fixed for one in good):
            good = []  # a moving frame does not give the mounting of an accelerometer on the base
        found = replace(known, frames=known.frames.after(good)) if good else known
        bad = next((one for one in readings if not is_rotation(one.quaternion)), None)
        if bad is None:
            return found, None
        sentence = f'the transform to {bad.frame_id!r} is not a rotation: {bad.quaternion}'
        return found, drop(bad.stamp_ns, 'no_rotation', sentence)

    def unfit(self, known: BaseGravity, reading: ImuReading) -> Refusal | None:
        """Return why a reading of the accelerometer is invalid; None if it is valid."""
        stamp_ns, force = reading.stamp_ns, (reading.x, reading.y, reading.z)
        if not all(map(math.isfinite, force)):
            return drop(stamp_ns, 'not_finite', f'{WHAT} contains NaN or infinity')
        last = None if known.reading is None else known.reading.stamp_ns
        reason, sentence = stamp_fault(WHAT, last, stamp_ns)
        if reason and reason != RESTARTED:
            return drop(stamp_ns, reason, sentence)
        size = math.hypot(*force)
        if not reading.known:
            sentence = (
                f'{WHAT}: the sensor reports that it does not measure acceleration (the first '
                'number of linear_acceleration_covariance is -1)'
            )
            return refuse(stamp_ns, 'imu_without_acceleration', sentence)
        if SMALLEST < size < LARGEST:
            return None
        likely = 'is the unit g' if 0.5 < size < 1.5 else 'was gravity subtracted'
        likely = likely if size <= SMALLEST else 'is the unit mg or counts'
        sentence = (
            f'{WHAT} of {size:.3g} m/s^2: an accelerometer at rest reads {STANDARD_GRAVITY:.2f}; '
            f'{likely}? Set the driver to publish the specific force in m/s^2; {LEFT_OUT}'
        )
        return refuse(stamp_ns, 'imu_unit', sentence)

    def gravity_of(
        self, frames: FrameTree, reading: ImuReading
    ) -> tuple[GravityReading | None, Refusal | None]:
        """Return gravity and turn rate of the base, or the reason for which they are unknown."""
        turn = self.turn_of_imu(frames, reading.frame_id)
        if turn is None:
            base = self.settings.frame_id
            sentence = (
                f'{WHAT} in frame {reading.frame_id!r}, but /tf_static has no transform from it '
                f'to {base!r}: publish one, or set imu_from_base; {LEFT_OUT}'
            )
            return None, refuse(reading.stamp_ns, 'imu_frame', sentence)
        rotation, read = rotation_matrix(turn), np.array([reading.x, reading.y, reading.z])
        force = rotation @ read / STANDARD_GRAVITY
        found = GravityReading(
            stamp_ns=reading.stamp_ns,
            direction=(0.0 - float(force[0]), 0.0 - float(force[1])),
            turn_rate=float(rotation[2] @ reading.rate),
            variance=reading.variance,
        )
        return found, None

    def turn_of_imu(self, frames: FrameTree, frame_id: str) -> Quaternion | None:
        """Return the rotation from the frame of the accelerometer to the base."""
        turn = turn_of(self.settings.imu_from_base)
        if turn is not None:
            return turn
        if frame_id == self.settings.frame_id:
            return UNTURNED
        found = frames.only_fixed().between(frame_id.lstrip('/'), self.settings.frame_id)
        return None if found is None else found[0]

    def at(self, known: BaseGravity, stamp_ns: int) -> tuple[Direction | None, Refusal | None]:
        """Return gravity at a stamp, in g (None: use the model file), or the reason if unknown."""
        if self.frame:
            return self.by_frame(known, stamp_ns)
        if not self.uses_imu:
            return None, None
        if known.reading is None:
            if not known.published and not self.gravity.is_measured:
                return None, None
            sentence = (
                'no usable base_imu received, from which the direction of gravity is taken: '
                'publish it, or set the direction (parameter gravity, --gravity)'
            )
            return None, refuse(stamp_ns, 'no_imu', sentence, awaits_others=True)
        age = seconds_between(known.reading.stamp_ns, stamp_ns)
        if age <= self.settings.gravity_timeout:
            return known.reading.direction, None
        return None, refuse(stamp_ns, 'stale_imu', self.stale('base_imu', age))

    def turn_rate_at(self, known: BaseGravity, stamp_ns: int) -> float:
        """Return the angular velocity (rad/s) of the base at a stamp; NaN if it is unknown."""
        last = known.reading
        if not self.uses_imu or last is None:
            return math.nan
        age = seconds_between(last.stamp_ns, stamp_ns)
        return last.turn_rate if age <= self.settings.gravity_timeout else math.nan

    def motion_at(self, known: BaseGravity, stamp_ns: int, since_ns: int | None) -> BaseMotion:
        """Return the motion of the base at a stamp; since_ns: of the previous estimate, if any."""
        last, earlier = known.reading, known.earlier
        if not self.uses_imu or last is None:
            return BaseMotion()
        seconds = 0.0 if since_ns is None else seconds_between(since_ns, stamp_ns)
        period = 0.0 if earlier is None else seconds_between(earlier.stamp_ns, last.stamp_ns)
        turn_rate = apparent_rate = self.turn_rate_at(known, stamp_ns)
        if earlier is not None and period > 0.0:
            (x, y), (before_x, before_y) = last.direction, earlier.direction
            apparent_rate = (before_y * x - before_x * y) / period
        return BaseMotion(
            turn_rate=turn_rate,
            apparent_rate=math.nan if math.isfinite(turn_rate) else apparent_rate,
            variance=last.variance,
            lasting=seconds * max(seconds, period),
        )

    def change_since(self, known: BaseGravity, stamp_ns: int) -> Direction | None:
        """Return the likely change of gravity since the last base_imu, in g; None: there is none.

        Gravity may have continued to change at the rate between the last two readings, for at most
        this time.
        """
        last, earlier = known.reading, known.earlier
        if not self.uses_imu or last is None or earlier is None:
            return None
        age = seconds_since(last.stamp_ns, stamp_ns)
        between = seconds_since(earlier.stamp_ns, last.stamp_ns)
        if not (age > 0.0 and between > 0.0) or last.direction == earlier.direction:
            return None
        share = min(age / between, 1.0)
        (x, y), (before_x, before_y) = last.direction, earlier.direction
        return share * (x - before_x), share * (y - before_y)

    def by_frame(
        self, known: BaseGravity, stamp_ns: int
    ) -> tuple[Direction | None, Refusal | None]:
        """Return gravity from a frame with z pointing up, in g, or why there is no estimate."""
        base = self.settings.frame_id
        found = known.frames.between(self.frame, base)
        if found is None:
            sentence = (
                f'no transform from gravity_frame {self.frame!r} to {base!r}: check the name, '
                'and that it is published on /tf or /tf_static'
            )
            return None, refuse(stamp_ns, 'no_gravity_frame', sentence, awaits_others=True)
        turn, read_ns = found
        age = 0.0 if read_ns is None else seconds_between(read_ns, stamp_ns)
        if age > self.settings.gravity_timeout:
            sentence = self.stale(f'the transform from {self.frame!r} to {base!r}', age)
            return None, refuse(stamp_ns, 'stale_gravity_frame', sentence)
        x, y, _ = rotation_matrix(turn)[:, 2].tolist()
        return (0.0 - x, 0.0 - y), None

    def moves(self, known: BaseGravity) -> bool:
        """Whether the frame may rotate relative to the base frame."""
        found = known.frames.between(self.frame, self.settings.frame_id)
        return found is None or found[1] is not None

    def stale(self, what: str, age: float) -> str:
        """Return the error for a reading that is too old."""
        return (
            f'{what} is {age:.3g} s away from the reading, more than gravity_timeout = '
            f'{self.settings.gravity_timeout:.3g} s'
        )
