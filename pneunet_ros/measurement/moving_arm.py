"""An arm in motion: its deviation from equilibrium, from one reading to the next.

The equilibrium of a reading is the shape without inertia; the link chain of `solver.swing` follows
it with mass and damping. The arm is assumed to be at rest at the first reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import functools
import math
from typing import Any, NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between
from pneunet_ros.measurement.errors.propagated_errors import PropagatedErrors
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.model.shape import Shape
from pneunet_ros.model.vibration import LINKS, masses_of, vibration
from pneunet_ros.solver.columns import LOAD_OFFSET
from pneunet_ros.solver.links import (
    bending_stiffness,
    Links,
    mass_matrix,
    Masses,
    room_for_links,
    stiffness_matrix,
)
from pneunet_ros.solver.modes import Modes, modes_of
from pneunet_ros.solver.swing import (
    advance_chain,
    at_rest,
    follow_series,
    follow_swing,
    part_shapes,
    room_for,
    Swing,
    widen,
)

SHAPES = 2  # with 3 the tip is up to 0.06 mm closer to MuJoCo, at three times the cost
# Error of the reduced model: relative error of frequency^2, of damping and, per swing of the tip,
# of each shape. Measured: with it 97 % and more of the tips lie in their ellipse of 95 % in
# MuJoCo, while they swing after steps of 20 to 40 kPa by up to 90 mm.
LEFT_OUT = 0.002
WITHIN_95 = 1.96  # standard deviations, 95 % of a normal error
# Prior for an arm whose model does not include its motion: the loss factor of silicone rubber
# (0.05 to 0.3, by hardness and frequency), and its weight as a model file has it.
LOSS_FACTOR, LOSS_FACTOR_ERROR, WEIGHT_ERROR = 0.15, 0.7, 0.2
STEP = 1.0  # of the integration, per shortest time of the motion; it is stable up to 2.8
MOST_STEPS = 2000  # between two readings: after a longer gap the motion of the arm is unknown


class BaseMotion(NamedTuple):
    """Motion of the base of an arm as an IMU on it reads it.

    turn_rate (rad/s), NaN if it is unknown: then it may be the apparent_rate, at which gravity
    turns in the base. variance ((m/s^2)^2) of each component of the specific force, 0 = unknown.
    lasting (s^2): time since the last estimate, times the duration for which a force reading is
    used.
    """

    turn_rate: float = math.nan
    apparent_rate: float = math.nan
    variance: float = 0.0
    lasting: float = 0.0


RESTING_BASE = BaseMotion()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingState:
    """State of the motion at a stamp: the equilibrium as links, and the swing.

    turned (shapes,) 1/s: rate of the equilibrium before the stamp, in units of q. turning: the
    state for a base that turns as gravity does, where its turn rate is unknown.
    """

    stamp_ns: int
    links: Links
    swing: Swing
    turned: Array
    turning: MovingState | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Positions along an arm relative to its links.

    nodes (links + 2, places): weights of the clamp, the link centers and the tip; joints (links +
    1, places): weights of the joints and the tip.
    """

    nodes: Array
    joints: Array


def places_along(reach: float, arclength: Array) -> Places:
    """Return the interpolation from links to arclengths (places,) m; reach (m) of the arm."""
    from scipy.interpolate import CubicSpline  # slow to import, and only moving arms need it

    joints = np.linspace(0.0, reach, LINKS + 1)
    nodes = np.concatenate([[0.0], 0.5 * (joints[1:] + joints[:-1]), [reach]])
    linear = np.array([np.interp(arclength, joints, unit) for unit in np.eye(joints.size)])
    return Places(nodes=freeze(CubicSpline(nodes, np.eye(nodes.size))(arclength).T), joints=linear)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionEstimate:
    """Motion of an arm about its equilibrium.

    velocity (3,) of the tip, m/s and rad/s. settled: whether the tip rests at its equilibrium,
    within its uncertainty. swing, at_nodes: see `solver.swing.follow_swing`; relative (2,): errors
    of mass and damping; left_out (m): truncation error of the tip in each shape. modes of the arm
    about its equilibrium.
    """

    velocity: Array
    settled: bool
    swing: Swing
    at_nodes: Array
    relative: Array
    left_out: float
    modes: functools.partial[Modes | None]

    def deviation(self, places: Places) -> Array:
        """Return the deviation of x, y (m), theta (rad) from equilibrium, (3, places)."""
        return np.asarray(self.at_nodes[:3] @ places.nodes)

    def errors(self, places: Places) -> Array:
        """Return independent errors (errors, 3, places) of the motion, one sigma each."""
        values, vectors = np.linalg.eigh(self.swing.covariance[:SHAPES, :SHAPES])
        by_noise = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        tips = np.hypot(*self.at_nodes[3:, -1].reshape(SHAPES, 3)[:, :2].T)
        spread = np.concatenate(
            [
                by_noise,
                self.relative[:, None] * self.swing.columns[:, :SHAPES],
                np.diag(self.left_out / tips),
            ]
        )
        return np.asarray(np.tensordot(spread, self.shapes(places), axes=1))

    def shapes(self, places: Places) -> Array:
        """Return the change of x, y (m), theta (rad) per q of each shape, (shapes, 3, places)."""
        return np.asarray((self.at_nodes[3:] @ places.nodes).reshape(SHAPES, 3, -1))


def delayed_noise_parts(errors: Array, shapes: Array) -> Array:
    """Return further errors of points, because the arm follows the noise of readings with a delay.

    errors (n, 2, points) m: errors of the equilibrium, per sigma of each reading; shapes (shapes,
    2, points): displacement per unit q of each shape. Returns (n shapes, 2, points) m, see
    `solver.swing.part_shapes`.
    """
    parts = np.empty((len(errors), len(shapes), errors[0].size))
    part_shapes(errors.reshape(len(errors), -1), shapes.reshape(len(shapes), -1), parts)
    return parts.reshape(-1, *shapes.shape[1:])


def likely_motion(arm: Arm) -> Motion | None:
    """Return the motion expected from its weight; None if no unloaded shape is stable."""
    modes = unloaded_modes(replace(arm, motion=Motion()))
    if modes is None:
        return None
    return Motion(
        damping_time=LOSS_FACTOR / float(modes.frequency[0]),
        mass_error=WEIGHT_ERROR,
        damping_error=LOSS_FACTOR_ERROR,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingArm:
    """An arm whose model has `motion`; table: its model errors.

    modes of the unloaded arm at the middle of its pressure range; the slowest ones describe the
    swing. relative (2,): one sigma of the errors of mass (for the given stiffness) and damping.
    Raises ModelError if the unloaded arm has no stable equilibrium to swing about.
    """

    arm: Arm
    table: PerturbationTable
    masses: Masses = field(init=False, repr=False)
    modes: Modes = field(init=False, repr=False)
    relative: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Compute the modes and their uncertainty."""
        modes = unloaded_modes(self.arm)
        if modes is None:
            raise ModelError(
                f'{self.arm.name} has `motion` but no stable unloaded shape to swing about: make '
                'its rigidities positive, or remove `motion` from the model file',
                reason='no_equilibrium',
            )
        object.__setattr__(self, 'modes', modes)
        object.__setattr__(self, 'masses', masses_of(self.arm))
        object.__setattr__(self, 'relative', self._relative_errors())

    def _relative_errors(self) -> Array:
        """Return the relative errors of squared frequency and of damping, per model column."""
        assert self.arm.inertia is not None
        motion = self.arm.inertia
        found = [[LEFT_OUT, LEFT_OUT], [motion.mass_error, motion.damping_error]]
        sides = self.table.neighbors
        pairs = zip(sides[: len(sides) // 2], sides[len(sides) // 2 :], strict=True)
        for pair, distance in zip(pairs, self.table.distance[1:].tolist(), strict=True):
            before, after = (unloaded_modes(side) for side in pair)
            if before is not None and after is not None:
                first = [np.array([m.frequency[0] ** 2, m.damping[0]]) for m in (before, after)]
                size = np.maximum(0.5 * (first[0] + first[1]), np.finfo(float).tiny)
                found.append(((first[1] - first[0]) / size / distance).tolist())
        return freeze(np.sqrt(np.sum(np.square(found), axis=0)))

    @property
    def damping_time(self) -> float:
        """Time constant (s) of the damping."""
        assert self.arm.inertia is not None
        return self.arm.inertia.damping_time

    def advance_through_loads(
        self, state: MovingState, stamp_ns: int, loaded: Sequence[tuple[int, Links]]
    ) -> tuple[MovingState, Array]:
        """Advance a state to a stamp, through the loads read in between.

        loaded: stamps (ns) of loads and the equilibria under them at the stamp, of which the first
        load acts at the state. All inputs except the load change linearly from the state to the
        stamp. Also returns the covariance of q and p at the stamp, due to the unknown instant of
        that change.
        """
        damping_time, duration_ns = self.damping_time, stamp_ns - state.stamp_ns
        start, first = state.links, loaded[0][1]
        resting = replace(state, swing=at_rest(SHAPES))
        whole = advance_between_readings(
            resting, stamp_ns, first, self.masses, damping_time, self.modes
        )
        for passed_ns, there in loaded[1:]:
            share = (stamp_ns - passed_ns) / duration_ns
            links = with_change(there, first, start, share)._replace(offset=there.offset)
            state = advance_between_readings(
                state, passed_ns, links, self.masses, damping_time, self.modes
            )
        return state, whole.swing.covariance

    def step(
        self,
        state: MovingState | None,
        stamp_ns: int,
        shape: Shape,
        errors: PropagatedErrors,
        by_reading: Array,
        places: Places,
        course: Array | None = None,
        base: BaseMotion = RESTING_BASE,
    ) -> tuple[MovingState, MotionEstimate, Shape, PropagatedErrors]:
        """Advance to the equilibrium of a reading.

        shape: the equilibrium at these places; errors of the equilibrium; by_reading (readings,
        3): change of x, y (m), theta of its tip by one sigma of each reading. course: covariance
        of `advance_through_loads`, if there were loads. Returns shape and errors of the moving
        arm.
        """
        assert shape.solution is not None
        damping_time = self.damping_time
        solved = shape.solution.for_kernels()
        following, moving = follow_reading(
            state, stamp_ns, solved, self.masses, damping_time, self.modes, base.turn_rate
        )
        if course is not None:
            following.swing.covariance[:] += course
        if base.variance > 0.0:
            following.swing.covariance[SHAPES:, SHAPES:] += self.gravity_noise_covariance(
                moving, base
            )
        swing, swinging = following.swing, moving.stopped / self.modes.frequency[0]
        along, bent = moving.at_nodes @ places.nodes, moving.at_joints @ places.joints
        std, covariance = errors.std.copy(), errors.tip_covariance.copy()
        left_out = LEFT_OUT * math.hypot(*along[:2, -1].tolist(), *swinging.tolist())
        length = self.arm.length
        widen(swing, self.relative, left_out, length, by_reading, along, bent, std, covariance)
        if state is not None and math.isfinite(base.apparent_rate):
            resting = replace(state, links=state.links._replace(turn_rate=0.0))
            before, rate = state.turning or resting, base.apparent_rate
            turning, there = follow_reading(
                before, stamp_ns, solved, self.masses, damping_time, self.modes, rate
            )
            following = replace(following, turning=turning)
            off = (there.at_nodes - moving.at_nodes)[:3] @ places.nodes
            bent_off = (there.at_joints - moving.at_joints)[0] @ places.joints
            std = np.hypot(std, [off[0], off[1], bent_off])
            covariance += np.outer(off[:, -1], off[:, -1])
            error = (turning.swing.state - swing.state).ravel()
            swing = swing._replace(covariance=swing.covariance + np.outer(error, error))
        motion = MotionEstimate(
            velocity=freeze(moving.velocity),
            settled=is_settled(along[:2, -1], swinging, covariance),
            swing=swing,
            at_nodes=freeze(moving.at_nodes),
            relative=self.relative,
            left_out=left_out,
            modes=functools.partial(modes_of, following.links, self.masses, damping_time, SHAPES),
        )
        return (
            following,
            motion,
            moved_shape(shape, along, bent),
            PropagatedErrors(
                tip_covariance=freeze(covariance),
                std=freeze(std),
                second_order=errors.second_order,
            ),
        )

    def gravity_noise_covariance(self, there: Moved, base: BaseMotion) -> Array:
        """Return the covariance of p due to the noise of gravity since the last estimate.

        Persistent noise acts as a wrong equilibrium, to which an arm at rest settles.
        """
        lasting = min(base.lasting, float(self.modes.frequency[0]) ** -2)
        mass = np.array([0.0, *self.masses.mass, self.masses.tip])
        pulled = there.at_nodes[3:].reshape(SHAPES, 3, -1)[:, :2] @ mass  # per m/s^2
        return np.asarray(base.variance * lasting * pulled @ pulled.T)


class Moved(NamedTuple):
    """Deviation of a chain from equilibrium: tables of `solver.swing.follow_swing`.

    velocity (3,) of the tip; stopped (2,) m/s: its velocity in x, y if the equilibrium were to
    stop moving.
    """

    at_nodes: Array
    at_joints: Array
    velocity: Array
    stopped: Array


def follow_reading(
    state: MovingState | None,
    stamp_ns: int,
    solved: tuple[Array, Array, Array],
    masses: Masses,
    damping_time: float,
    modes: Modes,
    turn_rate: float = math.nan,
) -> tuple[MovingState, Moved]:
    """Advance an arm to the stamp of a reading with a known equilibrium.

    solved: panels, ends and nodes; state: None if the arm is at rest; if it is too old, see
    `after_gap`. modes: their moments define the shapes; turn_rate (rad/s) of the base, NaN if it
    is unknown.
    """
    after = room_for_links(LINKS, float(solved[1][LOAD_OFFSET]), turn_rate)
    room = room_for(SHAPES, LINKS)
    swing, seconds, steps, gap, turned = at_rest(SHAPES), 1.0, 0, 0.0, np.zeros(SHAPES)
    before = after._replace(turn_rate=math.nan)  # at rest relative to the base
    if state is not None:
        elapsed = seconds_between(state.stamp_ns, stamp_ns)
        needed = steps_between(elapsed, damping_time, modes)
        if 0 < needed <= MOST_STEPS:
            seconds, steps, before, turned = elapsed, needed, state.links, state.turned.copy()
            old = state.swing
            swing = Swing(old.state.copy(), old.covariance.copy(), old.columns.copy())
        elif needed > 0:
            gap = elapsed
    start, end = turning_links(before, after, seconds / max(steps, 1))
    at_nodes, at_joints = np.empty((3 + 3 * SHAPES, LINKS + 2)), np.empty((2 + SHAPES, LINKS + 1))
    tip = np.empty(5)
    follow_swing(
        solved,
        swing,
        seconds,
        steps,
        start,
        end,
        masses,
        damping_time,
        modes.moment,
        turned,
        room,
        at_nodes,
        at_joints,
        tip,
    )
    if state is not None and gap > 0.0:
        swing.covariance[:] = after_gap(state, gap, after, masses, damping_time, modes.moment)
    following = MovingState(stamp_ns=stamp_ns, links=after, swing=swing, turned=turned)
    return following, Moved(at_nodes, at_joints, tip[:3], tip[3:])


def with_change(links: Links, before: Links, after: Links, share: float) -> Links:
    """Return an equilibrium with a share of the change from one equilibrium to another."""
    every: list[Any] = list(zip(links, before, after, strict=True))
    return Links(*(value + share * (there - here) for value, here, there in every))


def turning_links(before: Links, after: Links, step: float) -> tuple[Links, Links]:
    """Return two equilibria; the base is assumed at rest unless its turn rate is known at both.

    A rate too fast for time steps of this length (s) counts as unknown.
    """
    if step * (abs(before.turn_rate) + abs(after.turn_rate)) <= STEP:
        return before, after
    return before._replace(turn_rate=0.0), after._replace(turn_rate=0.0)


def follow_readings(
    stamp_ns: Stamps,
    solved: tuple[Array, Array, Array],
    start: Array,
    masses: Masses,
    damping_time: float,
    modes: Modes,
) -> Array:
    """Return the deviation of an arm from its equilibria, (readings, 2, links + 2) m.

    This equals repeated calls of `follow_reading`, starting from a state (2, SHAPES) of the swing
    at the first reading.
    """
    seconds = np.diff(stamp_ns, prepend=stamp_ns[0]) / NANOSECONDS_PER_SECOND
    steps = np.array([steps_between(item, damping_time, modes) for item in seconds.tolist()])
    steps[steps > MOST_STEPS] = 0
    pair = room_for_links(LINKS), room_for_links(LINKS)
    at_nodes = np.empty((len(stamp_ns), 3, LINKS + 2))
    room = room_for(SHAPES, LINKS)
    follow_series(
        solved, start, seconds, steps, masses, damping_time, modes.moment, pair, room, at_nodes
    )
    return at_nodes[:, :2]


def steps_between(seconds: float, damping_time: float, modes: Modes) -> int:
    """Return the number of integration steps for a time interval."""
    fastest = float(modes.frequency[-1])
    return math.ceil(seconds * fastest * max(1.0, damping_time * fastest) / STEP)


def advance_between_readings(
    state: MovingState,
    stamp_ns: int,
    after: Links,
    masses: Masses,
    damping_time: float,
    modes: Modes,
) -> MovingState:
    """Advance an arm to a stamp before the next reading, with a known equilibrium.

    After a gap that is too long to integrate, the state is unchanged.
    """
    seconds = seconds_between(state.stamp_ns, stamp_ns)
    steps = steps_between(seconds, damping_time, modes)
    if not 0 < steps <= MOST_STEPS:
        return state
    previous, turned = state.swing, state.turned.copy()
    start, end = turning_links(state.links, after, seconds / steps)
    swing = Swing(previous.state.copy(), previous.covariance.copy(), previous.columns.copy())
    advance_chain(
        swing,
        seconds,
        steps,
        start,
        end,
        masses,
        damping_time,
        modes.moment,
        turned,
        room_for(SHAPES, LINKS),
    )
    turning = state.turning
    if turning is not None:
        there = after._replace(turn_rate=turning.links.turn_rate)
        turning = advance_between_readings(turning, stamp_ns, there, masses, damping_time, modes)
    return MovingState(stamp_ns=stamp_ns, links=after, swing=swing, turned=turned, turning=turning)


def after_gap(
    state: MovingState,
    gap: float,
    links: Links,
    masses: Masses,
    damping_time: float,
    moment: Array,
) -> Array:
    """Return the covariance of q and p of a chain after a gap (s).

    links: the present equilibrium. The step to this equilibrium may have happened at any time in
    the gap, with equal probability: early swings have decayed, late ones have not. The swing
    continues through the gap with unknown phase.
    """
    from scipy.linalg import expm, solve_continuous_lyapunov  # slow to import, and gaps are rare

    rates, projection = linearized_rates(links, masses, damping_time, moment)
    displacement = np.zeros(2 * SHAPES)
    displacement[:SHAPES] = projection @ (state.links.heading - links.heading)
    rates_in_gap = rates - np.eye(2 * SHAPES) / (2.0 * gap)  # not longer ago than the gap
    state_before = state.swing.state.ravel()
    transition = expm(rates * gap)
    swings = (
        transition @ (state.swing.covariance + np.outer(state_before, state_before)) @ transition.T
    )
    steps = solve_continuous_lyapunov(rates_in_gap, -np.outer(displacement, displacement) / gap)
    return np.asarray(swings + steps)


def linearized_rates(
    links: Links, masses: Masses, damping_time: float, moment: Array
) -> tuple[Array, Array]:
    """Return d(q', p') / d(q, p) about an equilibrium at rest, and the projection on the shapes.

    The projection (shapes, links) gives the q for rotations of the links.
    """
    bends = np.cumsum(moment * links.compliance, axis=1)  # rotations of links per q
    inertia = bends @ mass_matrix(links, masses)
    gram = inertia @ bends.T
    slowed, none = np.linalg.inv(gram), np.zeros_like(gram)
    damped = damping_time * bends @ bending_stiffness(links) @ bends.T @ slowed
    rates = np.block([[none, slowed], [-bends @ stiffness_matrix(links) @ bends.T, -damped]])
    return rates, slowed @ inertia


def moved_shape(shape: Shape, displacement: Array, bent: Array) -> Shape:
    """Return a moving shape; displacement (3 or more, stations) and bent: from `follow_swing`."""
    return replace(
        shape,
        x=freeze(shape.x + displacement[0]),
        y=freeze(shape.y + displacement[1]),
        theta=freeze(shape.theta + displacement[2]),
        curvature=freeze(shape.curvature + bent[0]),
        moment=freeze(shape.moment + bent[1]),
    )


def unloaded_modes(arm: Arm) -> Modes | None:
    """Return the modes of an unloaded arm at mid-range pressure."""
    shape = solve(arm, 0.5 * sum(arm.pressure_range))
    return None if shape.stable is not True else vibration(arm, shape, SHAPES)


def is_settled(deviation: Array, swing: Array, covariance: Array) -> bool:
    """Whether the tip is at rest in its equilibrium, within its uncertainty.

    deviation (2,) m from the equilibrium; swing (2,) m: amplitude due to the present velocity, for
    a constant equilibrium; covariance (3, 3) of the tip. Deviation and swing together must be
    within 1.96 standard deviations of the tip position (95 % of reading errors).
    """
    distance_square = deviation @ deviation + swing @ swing
    return bool(distance_square <= WITHIN_95**2 * (covariance[0, 0] + covariance[1, 1]))
