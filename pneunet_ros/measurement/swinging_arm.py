"""A swinging arm: its motion between frames, and at points along it.

The equilibrium follows the estimated loads and pressure, and jumps when these are corrected, but
the arm itself cannot jump. The unknown is therefore not the deviation q from equilibrium, but the
modal coordinate w relative to a fixed reference: with S the projection on the modes and theta_e
the headings of the equilibrium's links,

    q = w - S (theta_e - theta_reference).

A frame determines w, but hardly the loads: the acceleration of the arm does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import seconds_between
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.inference.gaussian import forget, Known
from pneunet_ros.measurement.moving_arm import (
    follow_reading,
    go_between,
    LEFT_OUT,
    Moved,
    moved_shape,
    MovingArm,
    MovingState,
    Places,
    rates_about,
)
from pneunet_ros.model.equilibrium import Sensitivity, solve
from pneunet_ros.model.shape import Shape
from pneunet_ros.model.vibration import LINKS, links_at, vibration
from pneunet_ros.solver.links import Links, ways
from pneunet_ros.solver.solution import SolverNodes
from pneunet_ros.solver.swing import at_rest, P, Q, Swing

# What is left out of a swing along each of the next shapes: at the tip, of its swing there.
# Measured: with it steps of 50 kPa and 0.3 N leave chi squared near 1 on three rigs in MuJoCo.
NEXT, BEYOND = 3, 0.005
ERRORS = NEXT + 2  # of one frame alone: these, and what faster shapes have answered of a load
# Of a time in which a load walks: places and weights that integrate over it (Gauss, Legendre).
PLACES = 0.5 + math.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
Q_ROWS, P_ROWS = slice(0, Motion.SHAPES), slice(Motion.SHAPES, 2 * Motion.SHAPES)


class Passed(NamedTuple):
    """The equilibrium between two stamps.

    share: fraction of the interval; beyond (2,) N: deviation of the tip force from the
    interpolation.
    """

    stamp_ns: int
    share: float
    beyond: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """Reference of the shape coordinates, and the equilibrium at some unknowns.

    heading (links,) rad: of the reference; projection (shapes, links): S, and turns (shapes,
    links) of each shape. links: of the equilibrium at the unknowns (n,), with turning (links, n):
    derivatives of their headings; turned (links,) rad/s: their previous rate. at_tip (shapes, 2)
    m: displacement of the tip by each shape. lag (links,) rad: lag of faster shapes behind the
    equilibrium; left_out (ERRORS, links) rad: one sigma of the truncation error of a swing, and of
    the response of the faster modes. pull (4, shapes): effect of a load on coordinates and momenta
    since the last reference, per force on each shape. lost: the swing is unknown.
    """

    heading: Array
    projection: Array
    links: Links
    turned: Array
    unknowns: Array
    turning: Array
    at_tip: Array
    lag: Array
    left_out: Array
    turns: Array
    pull: Array
    lost: bool = False

    def place(self, w: Array, heading: Array) -> Array:
        """Return the displacement from equilibrium in each mode shape, (shapes,)."""
        return np.asarray(w - self.projection @ (heading - self.heading))

    def seen(self, swung: Swung, unknowns: Array, turning: Array) -> Reference:
        """Return the motion with the equilibrium estimated from a frame."""
        return replace(
            self,
            links=swung.links,
            unknowns=unknowns,
            turning=turning,
            at_tip=swung.at_tip,
            lost=False,
        )

    def beyond(self, turned: Array) -> Array:
        """Return the part of the link angles (links,) that the mode shapes do not span."""
        return np.asarray(turned - (self.projection @ turned) @ self.turns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swung:
    """Deviation of an arm from equilibrium at some positions, and its derivatives.

    links: of the equilibrium. Rows: x, y (m), theta (rad), curvature (1/m). deviation (4, places);
    by_link (links, 4, places): per rotation of each link of the equilibrium, at constant shape
    coordinates; by_shape (shapes, 4, places); moment (places,) N m relative to the equilibrium.
    at_tip (shapes, 2) m: of the tip; left_out (ERRORS, 2, places) m: one sigma. along (2, links +
    1, links) m: displacement of link centers and tip per rotation of each link; heading (links,)
    rad.
    """

    links: Links
    deviation: Array
    by_link: Array
    by_shape: Array
    moment: Array
    at_tip: Array
    left_out: Array
    along: Array
    heading: Array

    def shape(self, equilibrium: Shape) -> Shape:
        """Return the shape of the arm, at the points of its equilibrium."""
        bent = np.stack([self.deviation[3], self.moment])
        return moved_shape(equilibrium, self.deviation[:3], bent)

    def moves(self, headings: Array) -> Array:
        """Return the derivatives of the deviation from equilibrium, (causes, 4, places).

        headings (causes, links): rotation of the equilibrium links by each cause.
        """
        return np.tensordot(headings, self.by_link, axes=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingingArm:
    """A moving arm, and the slice of its unknowns in the state vector.

    where: slice of `Motion`; tip: slice of the tip force. start (4,): one sigma of coordinates and
    momenta of an arm not seen before; stations, targets: along the arm. middles (links,) m:
    centers of its links; next_shapes (shapes, links): their rotations.
    """

    moving: MovingArm
    where: slice
    tip: slice
    start: Array
    stations: Places
    targets: Places
    middles: Array = field(init=False, repr=False)
    next_shapes: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Compute the link centers, and the omitted shapes."""
        middles = self.moving.arm.reach * (np.arange(LINKS) + 0.5) / LINKS
        object.__setattr__(self, 'middles', freeze(middles))
        still = solve(self.moving.arm, 0.5 * sum(self.moving.arm.pressure_range))
        modes = vibration(self.moving.arm, still, Motion.SHAPES + NEXT)
        assert modes is not None  # `MovingArm` has found the slower ones
        object.__setattr__(self, 'next_shapes', modes.shape[Motion.SHAPES :])

    def part(self, which: slice) -> slice:
        """Return the slice of one part of the unknowns of this frame; which: one of `Motion`."""
        return slice(self.where.start + which.start, self.where.start + which.stop)

    def headings(self, sensitivity: Sensitivity) -> Array:
        """Return the rotation of the equilibrium links by each cause, (causes, links) rad."""
        return sensitivity.stations(self.middles)[:, 2]

    def swung(
        self, solution: SolverNodes, unknowns: Array, reference: Reference, places: Places
    ) -> Swung:
        """Return the deviation of an arm from a solved equilibrium."""
        links, moments = links_at(solution), self.moving.modes.moment
        q = reference.place(unknowns[self.part(Motion.PLACE)], links.heading)
        bends = moments * links.compliance
        turns = np.cumsum(bends, axis=1)
        turned = q @ turns + reference.lag
        there = links._replace(heading=links.heading + turned)
        along, still = ways(there), ways(links)
        change = links.length * np.stack(
            [np.cos(there.heading) - np.cos(links.heading),
             np.sin(there.heading) - np.sin(links.heading)]
        )  # fmt: skip
        far = np.cumsum(change, axis=1)
        nodes = np.zeros((3, LINKS + 1))
        nodes[:2, :-1], nodes[:2, -1] = far - 0.5 * change, far[:, -1]
        nodes[2, :-1], nodes[2, -1] = turned, turned[-1]
        at_nodes, at_joints = places.nodes[1:], places.joints
        shapes = np.empty((len(q), 4, at_nodes.shape[1]))
        for shape, turn in enumerate(turns):
            shapes[shape, :2] = along @ turn @ at_nodes
            shapes[shape, 2] = np.append(turn, turn[-1]) @ at_nodes
        compliance = links.compliance.copy()
        compliance[0] = compliance[1]  # the first stands for half a link, and for the clamp
        bent = moments * compliance * LINKS / self.moving.arm.reach
        shapes[:, 3] = bent @ at_joints[:-1]
        deviation = np.empty((4, at_nodes.shape[1]))
        deviation[:3], deviation[3] = nodes @ at_nodes, q @ shapes[:, 3]
        by_link = -np.tensordot(reference.projection.T, shapes, axes=1)
        by_link[:, :2] += np.tensordot(along - still, at_nodes, axes=(1, 0)).transpose(1, 0, 2)
        return Swung(
            links=links,
            deviation=deviation,
            by_link=by_link,
            by_shape=shapes,
            moment=q @ moments @ at_joints[:-1],
            at_tip=turns @ along[:, -1].T,
            along=along,
            heading=there.heading,
            left_out=(along @ reference.left_out.T).transpose(2, 0, 1) @ at_nodes,
        )

    def go_on(
        self,
        before: tuple[Known, Reference | None, int],
        moved: Known,
        solution: SolverNodes,
        stamp_ns: int,
        path: Sequence[Passed] = (),
        turning: Array | None = None,
    ) -> tuple[Known, Reference, Moved]:
        """Advance a swinging arm to a stamp with a solved equilibrium.

        Args:
            before: the belief, its reference (None if the arm was not seen), and its stamp.
            moved: the belief with all other unknowns propagated, and with the force if it was
                read.
            solution: the equilibrium at the mean of `moved`; it is the new reference.
            stamp_ns: the new stamp.
            path: between the stamps.
            turning: rotation of the links there per unknown; None: as before, because along a
                straight arm an unknown force does not determine how it bends next.

        Returns:
            The belief there, its reference, and the motion of the arm.
        """
        known, old, old_ns = before
        motion, masses, modes = self.moving.arm.motion, self.moving.masses, self.moving.modes
        assert motion is not None
        state, since = None, None
        if old is not None:
            since = old.links._replace(
                heading=old.links.heading + old.turning @ (known.mean - old.unknowns)
            )
            state = self.state_of(moved, old, since, old_ns)
            ahead = links_at(solution) if path else since
            for passed in path:
                there = between(since, ahead, passed.share)
                if passed.beyond is not None:
                    turned = old.turning[:, self.tip] @ passed.beyond
                    there = there._replace(heading=there.heading + turned)
                state = go_between(
                    state, passed.stamp_ns, there, masses, motion.damping_time, modes
                )
        following, moving = follow_reading(
            state, stamp_ns, solution.for_kernels(), masses, motion.damping_time, modes
        )
        links = following.links
        rates, onto = rates_about(links, masses, motion.damping_time, modes.moment)
        reference = Reference(
            heading=links.heading,
            projection=onto,
            turns=np.cumsum(modes.moment * links.compliance, axis=1),
            links=links,
            turned=following.turned,
            unknowns=moved.mean,
            turning=np.zeros((LINKS, moved.mean.size)),
            at_tip=np.zeros((Motion.SHAPES, 2)),
            lag=np.zeros(LINKS),
            left_out=freeze(self.left_out(moving, np.zeros((2, LINKS)))),
            pull=np.zeros((2 * Motion.SHAPES, Motion.SHAPES)),
        )
        if old is None or since is None:
            return moved, reference, moving
        if not np.hypot(*moving.at_nodes[:2, -1]) < 2.0 * self.moving.arm.length:
            return self.with_restarted_swing(moved), replace(reference, lost=True), moving
        seconds = seconds_between(old_ns, stamp_ns)
        early, on = responses_to(rates, seconds)
        pull = (np.eye(len(on)) - on)[:, Q_ROWS] @ np.linalg.inv(-rates[P_ROWS, Q_ROWS])
        pulled = old.projection @ old.turning
        pulled[:, self.tip] = np.linalg.solve(-rates[P_ROWS, Q_ROWS], old.at_tip)
        if turning is not None:
            pulled = 0.5 * (pulled + onto @ turning)
        swung = self.swung_on(moved, pulled, following.swing, on)
        walked = root_of(moved.root[self.tip, known.root.shape[1] :])
        loads = old.turning if turning is None else 0.5 * (old.turning + turning)
        beyond = np.stack([reference.beyond(load) for load in loads[:, self.tip].T])
        unanswered = self.unanswered(seconds) * walked.T @ beyond
        late = old.lag - old.beyond(since.heading - old.links.heading)
        lag = self.lag_of(late, reference.beyond(links.heading - since.heading), seconds)
        root = self.with_noise(swung.root, following.swing, moving)
        root = self.with_walk(root, (on - early)[:, :, Q_ROWS] @ pulled[:, self.tip] @ walked)
        swung = replace(swung, root=freeze(root))
        reference = replace(
            reference,
            unknowns=swung.mean,
            lag=freeze(lag),
            pull=pull,
            left_out=freeze(self.left_out(moving, unanswered)),
        )
        return swung, reference, moving

    def pushed(self, swung: Swung, turns: Array, at: Array) -> Array:
        """Return the generalized force of 1 N along the normal, (shapes, places) N m.

        turns (shapes, links): of each shape; at (places,) m.
        """
        heading = np.interp(at, self.middles, swung.heading)
        normal = np.stack([-np.sin(heading), np.cos(heading)])
        nodes = np.concatenate([[0.0], self.middles, [self.moving.arm.reach]])
        ways = np.einsum('dki,si->sdk', swung.along, turns)
        found = np.zeros((len(turns), at.size))
        for shape, way in enumerate(ways):
            for axis in range(2):
                found[shape] += normal[axis] * np.interp(at, nodes, np.append(0.0, way[axis]))
        return found

    def state_of(self, known: Known, old: Reference, links: Links, stamp_ns: int) -> MovingState:
        """Return the state of the swing at a stamp, relative to an equilibrium."""
        swing, start = known.mean[self.part(Motion.SWING)], at_rest(Motion.SHAPES)
        start.state[Q] = old.place(swing[Q_ROWS], links.heading)
        start.state[P] = swing[P_ROWS]
        return MovingState(stamp_ns=stamp_ns, links=links, swing=start, turned=old.turned)

    def with_restarted_swing(self, known: Known) -> Known:
        """Return the belief with the swing reset to an uninformed prior."""
        return forget(known, self.part(Motion.SWING), self.start)

    def swung_on(self, moved: Known, pulled: Array, swing: Swing, on: Array) -> Known:
        """Return the belief with the swing propagated; swing: of the mean, with its columns.

        With z = (w, p), an error S theta of the equilibrium acts as a force: z becomes A z + (1 -
        A) (S theta, 0); on (4, 4): A. pulled (shapes, unknowns): S theta of each unknown; the tip
        force acts at the actual tip.
        """
        where, relative = self.part(Motion.SWING), self.part(Motion.RELATIVE)
        mean, root = moved.mean.copy(), moved.root.copy()
        acting = pulled @ root  # all the time: half of it would let the force swing to and fro
        root[where] = on @ root[where] + (np.eye(len(on)) - on)[:, Q_ROWS] @ acting
        root[where] += swing.columns.T @ root[relative]
        mean[where] = swing.state.ravel() + mean[relative] @ swing.columns
        return replace(moved, mean=freeze(mean), root=root)

    def swing_of(self, there: Moved) -> float:
        """Return the current and remaining amplitude (m) of the tip."""
        tip = there.at_nodes[:2, -1]
        return math.hypot(*tip.tolist(), *(there.stopped / self.moving.modes.frequency[0]))

    def left_out(self, there: Moved, unanswered: Array) -> Array:
        """Return one sigma of the omitted rotations (ERRORS, links) rad.

        unanswered (2, links) rad: one sigma of the response of faster shapes to the load.
        """
        tips = np.abs(self.next_shapes.sum(axis=1)) * self.moving.arm.reach / LINKS
        swung = BEYOND * self.swing_of(there) * self.next_shapes / tips[:, None]
        return np.concatenate([swung, unanswered])

    def answered(self, seconds: float) -> float:
        """Return the share of the response of faster shapes to a load that has walked for a time.

        Faster shapes are overdamped and creep to their equilibrium with the damping time: a
        first-order lag behind a ramp.
        """
        motion = self.moving.arm.motion
        assert motion is not None
        time = motion.damping_time
        if not time > 0.0 or not seconds > 0.0 or math.isinf(seconds):
            return float(seconds > 0.0)
        return 1.0 + time / seconds * math.expm1(-seconds / time)

    def unanswered(self, seconds: float) -> float:
        """Return one sigma of `answered`, from the unknown time at which the load walked.

        A load step at a time u ago leaves exp(-u / time) of its response open; this is the spread
        over all u.
        """
        motion = self.moving.arm.motion
        assert motion is not None
        time = motion.damping_time
        if not time > 0.0 or not seconds > 0.0 or math.isinf(seconds):
            return 0.0
        left = 1.0 - self.answered(seconds)
        squared = -0.5 * time / seconds * math.expm1(-2.0 * seconds / time)
        return math.sqrt(max(squared - left**2, 0.0))

    def with_walk(self, root: Array, late: Array) -> Array:
        """Return a root including the error of a swing, from the unknown walk of the tip force.

        late (places, 4, 2): reduction of the motion of coordinates and momenta, per sigma of the
        walk, if it happened at PLACES of the interval instead of at its beginning.
        """
        more = np.zeros((len(root), late.shape[0] * late.shape[2]))
        by_column = np.sqrt(WEIGHTS)[:, None, None] * late
        more[self.part(Motion.SWING)] = by_column.transpose(1, 0, 2).reshape(late.shape[1], -1)
        return np.hstack([root, more])

    def lag_of(self, before: Array, beyond: Array, seconds: float) -> Array:
        """Return the lag (links,) rad of the faster modes behind the equilibrium.

        before: lag at the beginning; beyond (links,) rad: rotation since then, in these shapes.
        """
        motion = self.moving.arm.motion
        assert motion is not None
        if not motion.damping_time > 0.0:
            return np.zeros_like(before)
        left = math.exp(-seconds / motion.damping_time)
        return left * before - (1.0 - self.answered(seconds)) * beyond

    def with_noise(self, root: Array, swing: Swing, there: Moved) -> Array:
        """Return a root including the unknown path between two stamps.

        It also includes the truncation errors of links and shapes, as in `moving_arm`.
        """
        values, vectors = np.linalg.eigh(swing.covariance)
        kicks = vectors * np.sqrt(np.maximum(values, 0.0))
        tip = there.at_nodes[:, -1]
        far = self.swing_of(there)
        tips = np.hypot(*tip[3:].reshape(Motion.SHAPES, 3)[:, :2].T)
        left_out = np.zeros((len(kicks), Motion.SHAPES))
        left_out[: Motion.SHAPES] = np.diag(LEFT_OUT * far / tips)
        more = np.zeros((len(root), kicks.shape[1] + Motion.SHAPES))
        more[self.part(Motion.SWING)] = np.hstack([kicks, left_out])
        return np.hstack([root, more])


def root_of(columns: Array) -> Array:
    """Return a square root (2, 2) of the covariance with the root (2, columns)."""
    variances, axes = np.linalg.eigh(columns @ columns.T)
    return np.asarray(axes * np.sqrt(np.fmax(variances, 0.0)))


def responses_to(rates: Array, seconds: float) -> tuple[Array, Array]:
    """Return transitions of the state from PLACES of a time (3, 4, 4), and over the whole time."""
    from scipy.linalg import expm  # slow to import, and only moving arms need it

    last, between = expm(np.multiply.outer([PLACES[0], 0.5 - PLACES[0]], rates * seconds))
    half = last @ between
    first = half @ between
    return np.stack([first, half, last]), first @ last


def between(before: Links, after: Links, share: float) -> Links:
    """Interpolate between two equilibria."""
    return Links(
        heading=before.heading + share * (after.heading - before.heading),
        length=before.length + share * (after.length - before.length),
        compliance=before.compliance + share * (after.compliance - before.compliance),
        force=before.force + share * (after.force - before.force),
        offset=after.offset,
    )


def motion_block(moving: MovingArm, start: float) -> Motion:
    """Return the unknowns of a moving arm; start: initial amplitude at the tip, of the length.

    Shapes have unit modal mass, so momenta are modal velocities.
    """
    modes = moving.modes
    tips = np.abs(modes.shape.sum(axis=1)) * moving.arm.reach / LINKS
    place = start * moving.arm.length / tips[0] * (modes.frequency[0] / modes.frequency) ** 2
    return Motion(
        place_std=freeze(place),
        momentum_std=freeze(modes.frequency * place),
        relative=moving.relative,
    )
