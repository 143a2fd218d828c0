"""Grasp of several arms: one estimate from the fused estimates of all.

Each arm is mounted in the frame of the gripper, with the side to which it bends (y of its base)
towards the object. Seen along the mean direction of the arms, its bending plane is a line, and its
contact surface is perpendicular to that line: a circle tangent to all surfaces has a radius R and
a center c with q_i + R m_i = c for every arm, with q_i the position of its surface and m_i the
direction of its line. Two opposite arms give the distance between two parallel faces, three or
more the diameter of a round object. If fewer than two arms touch anything, the same quantity for
all arms is the opening.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.fusion.belief_estimate import estimate_at
from pneunet_ros.fusion.contact import Contact
from pneunet_ros.fusion.estimate import FusedEstimate, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import FusionState

FEWEST = 2  # fewest arms that can hold an object
PARALLEL = 1e-9  # of a unit vector: a component that rounding leaves of zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mount:
    """Pose of an arm in the frame of the gripper: origin (3,) m and axes (3, 3) of its base.

    thickness: m, from its centerline to its contact surface.
    """

    origin: Array
    axes: Array
    thickness: float

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the orientation of the base: x, y, z, w."""
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = self.axes.tolist()
        twice = np.array(  # its eigenvector of the largest value, Bar-Itzhack 2000
            [
                [xx - yy - zz, xy + yx, xz + zx, zy - yz],
                [xy + yx, yy - xx - zz, yz + zy, xz - zx],
                [xz + zx, yz + zy, zz - xx - yy, yx - xy],
                [zy - yz, xz - zx, yx - xy, xx + yy + zz],
            ]
        )
        x, y, z, w = np.linalg.eigh(twice)[1][:, -1].tolist()
        return x, y, z, w


def mount_of(place: Sequence[float], thickness: float) -> Mount:
    """Return the mount at x, y, z (m) and roll, pitch, yaw (rad), as in a URDF origin.

    Raises RequestError if these are not six finite numbers.
    """
    try:
        numbers = np.array(place, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.full(6, math.nan)
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise RequestError(
            f'mount must be x, y, z in m and roll, pitch, yaw in rad, not {place}',
            reason='wrong_shape',
        )
    cr, cp, cy = np.cos(numbers[3:])
    sr, sp, sy = np.sin(numbers[3:])
    axes = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return Mount(origin=freeze(numbers[:3].copy()), axes=freeze(axes), thickness=thickness)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touch:
    """Contact surface of an arm, touching something or not.

    point (2,) m and its covariance (2, 2), in the bending plane; force (2,) N on the arm and its
    covariance (2, 2): 0 if nothing touches, NaN where not determined.
    """

    point: Array
    covariance: Array
    force: Array
    force_covariance: Array
    is_touching: bool

    @property
    def size(self) -> float:
        """Magnitude (N) of the determined components of the force; NaN if its push is unknown."""
        return (
            math.nan if is_unknown(self.force) else float(np.linalg.norm(determined(self.force)))
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenArm:
    """An arm at its last frame.

    fused: its estimate at that frame, when a force is known much better than a moment later, after
    which the load may have changed. least (N), score (chi squared): thresholds for a contact
    force, above model error and noise.
    """

    fused: FusedEstimate
    least: float
    score: float

    def is_pushed(self, side: Array) -> bool:
        """Whether something pushes the tip against a unit vector (2,)."""
        push = -float(side @ determined(self.fused.force))
        variance = float(side @ determined(self.fused.force_covariance) @ side)
        return push > self.least and push**2 > self.score * variance


def determined(values: Array) -> Array:
    """Return a force or its covariance, with 0 for components that are not determined."""
    return np.nan_to_num(values)


def is_unknown(force: Array) -> bool:
    """Whether the push on an arm is not determined: F2, because mounts turn its y axis inward.

    F1 of a free straight arm is never determined.
    """
    return bool(np.isnan(force[1]))


def seen_arm(fusion: Fusion, state: FusionState) -> SeenArm | None:
    """Return an arm at its last frame; None if it has no frame, or no estimate at that frame."""
    belief = state.belief
    if belief is None or not belief.frames:
        return None
    instant, unknown = fusion.instant_shown(state, belief.stamp_ns)
    if unknown is not None:
        return None
    wrench = fusion.wrench_at(state, belief.stamp_ns, with_targets=True)
    _, fused = estimate_at(fusion.model, state, instant, wrench, Mode.FUSED, [])
    if not isinstance(fused, FusedEstimate):
        return None
    settings = fusion.settings
    least = settings.contact_least * fusion.model.force_scale
    return SeenArm(fused=fused, least=least, score=settings.contact_score)


def touch_of(seen: SeenArm, mount: Mount, inward: Array) -> Touch:
    """Return the contact surface of an arm: at its contact, or at its innermost point.

    inward (3,): unit vector to the object, perpendicular to the direction of the gripper.
    """
    fused, contact = seen.fused, seen.fused.contact
    if contact is not None and not contact.ambiguous:
        return at_contact(fused, contact, mount.thickness)
    side = mount.axes[:, :2].T @ inward
    shape, estimate = fused.estimate.shape, fused.estimate
    station = int(np.argmax(side[0] * shape.x + side[1] * shape.y))
    covariance = np.diag(np.square([estimate.std_x[station], estimate.std_y[station]]))
    if station == shape.x.size - 1:
        covariance = estimate.tip_covariance[:2, :2]
    force, force_covariance = np.zeros(2), np.zeros((2, 2))
    pushed = contact is None and seen.is_pushed(side)
    if contact is not None:  # the contact may also be a tip force of about this size
        normal = normal_at(fused, contact.arclength)
        force = contact.force * normal
        force_covariance = contact.std_force**2 * np.outer(normal, normal)
    elif pushed or is_unknown(fused.force):
        force, force_covariance = fused.force, fused.force_covariance
    return Touch(
        point=freeze(np.array([shape.x[station], shape.y[station]]) + mount.thickness * side),
        covariance=freeze(covariance),
        force=freeze(force),
        force_covariance=freeze(force_covariance),
        is_touching=contact is not None or pushed,
    )


def at_contact(fused: FusedEstimate, contact: Contact, thickness: float) -> Touch:
    """Return the surface at a contact along the arm."""
    estimate, normal = fused.estimate, normal_at(fused, contact.arclength)
    std = [
        float(np.interp(contact.arclength, estimate.shape.arclength, row))
        for row in (estimate.std_x, estimate.std_y)
    ]
    slide = contact.std_arclength * np.array([normal[1], -normal[0]])
    surface = -math.copysign(thickness, contact.force) * normal
    return Touch(
        point=freeze(np.array([contact.x, contact.y]) + surface),
        covariance=freeze(np.diag(np.square(std)) + np.outer(slide, slide)),
        force=freeze(contact.force * normal),
        force_covariance=freeze(contact.std_force**2 * np.outer(normal, normal)),
        is_touching=True,
    )


def normal_at(fused: FusedEstimate, arclength: float) -> Array:
    """Return the unit normal (2,) of an arm."""
    shape = fused.estimate.shape
    theta = float(np.interp(arclength, shape.arclength, shape.theta))
    return np.array([-math.sin(theta), math.cos(theta)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grasp:
    """A grasp, in the frame of the gripper; SI.

    touching: number of arms known to touch something. width (m): with two or more, the width of
    the object, else the opening between the tips, negative if they overlap. center (3,) m. force:
    sum of the magnitudes (N) of the forces of all arms; balance (3,) N: their vector sum on the
    object; each with its std, NaN where not determined.
    """

    stamp_ns: int
    touching: int
    center: Array
    width: float
    std_width: float
    force: float
    std_force: float
    balance: Array
    std_balance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gripper:
    """The mounts of the arms of a gripper, by name.

    Raises RequestError if there are fewer than two, or if they have no common direction.
    """

    mounts: Mapping[str, Mount]

    def __post_init__(self) -> None:
        """Reject invalid grippers."""
        if len(self.mounts) < FEWEST:
            raise RequestError('a gripper needs at least two arms', reason='too_few')
        mean = np.mean([mount.axes[:, 0] for mount in self.mounts.values()], axis=0)
        if np.linalg.norm(mean) < 0.5:  # cos 60 degrees
            raise RequestError(
                'the arms of the gripper have no common direction: check the mount of each arm '
                '(its x axis points along the arm)',
                reason='no_direction',
            )
        if any(abs(mount.axes[:, 1] @ self.direction) > 0.5 for mount in self.mounts.values()):
            raise RequestError(
                'an arm bends along the gripper instead of closing it: check the mount of each '
                'arm (its y axis points towards the object)',
                reason='no_direction',
            )

    @property
    def direction(self) -> Array:
        """Unit vector (3,) along the arms."""
        mean = np.mean([mount.axes[:, 0] for mount in self.mounts.values()], axis=0)
        return np.asarray(mean / np.linalg.norm(mean))

    def inward(self, name: str) -> Array:
        """Return the unit vector (3,) to the side to which an arm bends, across `direction`."""
        side, direction = self.mounts[name].axes[:, 1], self.direction
        across = side - (side @ direction) * direction
        return np.asarray(across / np.linalg.norm(across))

    @property
    def axis(self) -> Array:
        """The point (3,) m, perpendicular to `direction`, where the planes of the arms meet."""
        nothing = np.zeros((2, 2))
        clamps = {
            name: Touch(
                point=np.zeros(2),
                covariance=nothing,
                force=np.zeros(2),
                force_covariance=nothing,
                is_touching=False,
            )
            for name in self.mounts
        }
        center, _, _ = self.circle(clamps)
        return center

    def touches(self, seen: Mapping[str, SeenArm]) -> dict[str, Touch]:
        """Return the touch of each arm."""
        return {
            name: touch_of(seen[name], mount, self.inward(name))
            for name, mount in self.mounts.items()
        }

    def grasp(self, seen: Mapping[str, SeenArm]) -> Grasp:
        """Return the grasp from all arms at their last frames."""
        touches = self.touches(seen)
        holding = [name for name, touch in touches.items() if touch.is_touching]
        used = holding if len(holding) >= FEWEST else list(touches)
        center, width, std_width = self.circle({name: touches[name] for name in used})
        force, std_force, balance, std_balance = self.forces(touches)
        return Grasp(
            stamp_ns=max(seen[name].fused.stamp_ns for name in self.mounts),
            touching=len(holding),
            center=center,
            width=width,
            std_width=std_width,
            force=force,
            std_force=std_force,
            balance=balance,
            std_balance=std_balance,
        )

    def circle(self, touches: Mapping[str, Touch]) -> tuple[Array, float, float]:
        """Return center (3,) m, diameter and its std (m) of the circle through surfaces."""
        direction = self.direction
        flat = np.eye(3) - np.outer(direction, direction)
        rows, places, heights, covariances = [], [], [], []
        for name, touch in touches.items():
            axes = self.mounts[name].axes[:, :2]
            place = self.mounts[name].origin + axes @ touch.point
            rows.append(np.column_stack([flat, -self.inward(name)]))
            places.append(flat @ place)
            heights.append(float(direction @ place))
            covariances.append(axes @ touch.covariance @ axes.T)
        inverse = np.linalg.pinv(np.vstack(rows))
        *center, radius = inverse @ np.concatenate(places)
        parts = inverse[3].reshape(-1, 3) @ flat
        variance = sum(
            float(part @ one @ part) for part, one in zip(parts, covariances, strict=True)
        )
        middle = np.array(center) + direction * np.mean(heights)
        return freeze(middle), 2.0 * float(radius), 2.0 * math.sqrt(variance)

    def forces(self, touches: Mapping[str, Touch]) -> tuple[float, float, Array, Array]:
        """Return the sum of the force magnitudes and its std, the vector sum and its std, N."""
        total, variance = 0.0, 0.0
        balance, covariance = np.zeros(3), np.zeros((3, 3))
        for name, touch in touches.items():
            axes = self.mounts[name].axes[:, :2]
            force, force_covariance = determined(touch.force), determined(touch.force_covariance)
            total += touch.size
            if touch.size > 0.0:
                way = force / touch.size
                variance += float(way @ force_covariance @ way)
            balance -= axes @ force
            covariance += axes @ force_covariance @ axes.T
            balance[(np.abs(axes[:, np.isnan(touch.force)]) > PARALLEL).any(axis=1)] = math.nan
        std_balance = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        return (
            total,
            math.sqrt(variance) if math.isfinite(total) else math.nan,
            freeze(balance),
            freeze(np.where(np.isnan(balance), math.nan, std_balance)),
        )
