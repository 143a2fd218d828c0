"""A swinging arm: its motion between frames, and at points along it.

The equilibrium jumps when the estimated loads and pressure are corrected, but the arm itself
cannot jump. The unknown is therefore not the deviation q from equilibrium but the modal coordinate
w relative to a fixed reference: with S the projection on the modes and theta_e the headings of the
equilibrium's links,

    q = w - S (theta_e - theta_reference).

A single frame determines w but hardly the loads, which follow from the acceleration of the arm.
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
    advance_between_readings,
    follow_reading,
    LEFT_OUT,
    linearized_rates,
    Moved,
    moved_shape,
    MovingArm,
    MovingState,
    Places,
    with_change,
)
from pneunet_ros.model.equilibrium import Sensitivity, solve
from pneunet_ros.model.shape import Shape
from pneunet_ros.model.vibration import LINKS, links_at, vibration
from pneunet_ros.solver.links import center_derivatives, Links
from pneunet_ros.solver.solution import SolverNodes
from pneunet_ros.solver.swing import at_rest, P, Q, Swing

# Truncation error of a swing in each of the next shapes, as a share of the swing at the tip.
# Measured: with it steps of 50 kPa and 0.3 N leave chi squared near 1 on three rigs in MuJoCo.
NEXT, BEYOND = 3, 0.005
ERRORS = NEXT + 3  # of one frame alone: these, and faster shapes excited by a load or a blow
# Of a time in which a load walks: places and weights that integrate over it (Gauss, Legendre).
PLACES = 0.5 + math.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
Q_ROWS, P_ROWS = slice(0, Motion.SHAPES), slice(Motion.SHAPES, 2 * Motion.SHAPES)


class EquilibriumBetween(NamedTuple):
    """The equilibrium between two stamps.

    share: fraction of the interval; force_deviation (2,) N, chamber_deviation (Pa): deviations of
    tip force and pressure from linear interpolation; turn_rate (rad/s) of the base.
    """

    stamp_ns: int
    share: float
    force_deviation: Array | None = None
    chamber_deviation: float = 0.0
    turn_rate: float = math.nan


class Response(NamedTuple):
    """Response of faster shapes to loads at an unknown time of an interval.

    share: mean fraction of the response to a load that drifts; std: of that fraction, for a load
    step at an unknown time; lasting: rms force (1/s) per impulse to which they still respond.
    """

    share: float
    std: float
    lasting: float


class Impulses(NamedTuple):
    """Effect of impulses at an unknown time since the last reference.

    mobility (shapes, shapes): velocities per momentum; kicks (PLACES, 4, shapes): changes of
    coordinates and momenta by an impulse on each shape at PLACES; lasting (1/s): rms force per
    impulse to which faster shapes still respond, because they settle with the damping time.
    """

    mobility: Array
    kicks: Array
    lasting: float


class Blow(NamedTuple):
    """One sigma of a blow at some places of the arm, at an unknown time since the last reference.

    impulse (places,) N s: stops the arm there; swing (places, 4, PLACES): independent errors of
    coordinates and momenta; left_out (places, links) rad: lag of the faster shapes.
    """

    impulse: Array
    swing: Array
    left_out: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """Reference of the shape coordinates, and the equilibrium at some unknowns.

    heading (links,) rad of the reference; projection (shapes, links): S, and turns (shapes, links)
    of each shape. links of the equilibrium at the unknowns (n,), with turning (links, n):
    derivatives of their headings; turned (shapes,) 1/s: previous rate of the equilibrium, in units
    of q. at_tip (shapes, 2) m: displacement of the tip by each shape. lag (links,) rad: lag of
    faster shapes behind the equilibrium; left_out (ERRORS, links) rad: one sigma of the truncation
    error of a swing, and of the response of the faster modes. pull (4, shapes): effect of a load
    on coordinates and momenta since the last reference, per force on each shape; impulses: effect
    of a blow, None before the second frame. lost: whether the swing is unknown.
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
    impulses: Impulses | None = None
    lost: bool = False

    def place(self, w: Array, heading: Array) -> Array:
        """Return the displacement from equilibrium in each mode shape, (shapes,)."""
        return np.asarray(w - self.projection @ (heading - self.heading))

    def at_estimate(self, swing: SwingDeviation, unknowns: Array, turning: Array) -> Reference:
        """Return the reference with the equilibrium estimated from a frame."""
        return replace(
            self,
            links=swing.links._replace(turn_rate=self.links.turn_rate),
            unknowns=unknowns,
            turning=turning,
            at_tip=swing.at_tip,
            lost=False,
        )

    def unspanned_part(self, rotation: Array) -> Array:
        """Return the part of link angles (.., links) that the mode shapes do not span."""
        return np.asarray(rotation - rotation @ self.projection.T @ self.turns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingDeviation:
    """Deviation of an arm from equilibrium at some positions, and its derivatives.

    links of the equilibrium. Rows: x, y (m), theta (rad), curvature (1/m). deviation (4, places);
    by_link (links, 4, places): per rotation of each link of the equilibrium, at constant shape
    coordinates; by_shape (shapes, 4, places); moment (places,) N m relative to the equilibrium.
    at_tip (shapes, 2) m of the tip; left_out (ERRORS, 2, places) m: one sigma. displacements (2,
    links + 1, links) m: those of link centers and tip per rotation of each link; heading (links,)
    rad.
    """

    links: Links
    deviation: Array
    by_link: Array
    by_shape: Array
    moment: Array
    at_tip: Array
    left_out: Array
    displacements: Array
    heading: Array

    def shape(self, equilibrium: Shape) -> Shape:
        """Return the shape of the arm, at the points of its equilibrium."""
        bent = np.stack([self.deviation[3], self.moment])
        return moved_shape(equilibrium, self.deviation[:3], bent)

    def moved_by_shapes(self, motion: Array) -> Array:
        """Return the displacement (n, 4, places) by changes (n, 2 or more) of the shapes."""
        return np.tensordot(motion[:, : Motion.SHAPES], self.by_shape, axes=1)

    def moved_by_links(self, rotation: Array, places: Places) -> Array:
        """Return the displacement (n, 4, places) by rotations (n, links): only x and y."""
        moved = (self.displacements @ rotation.T).transpose(2, 0, 1) @ places.nodes[1:]
        return np.pad(moved, ((0, 0), (0, 2), (0, 0)))

    def moves(self, headings: Array) -> Array:
        """Return the derivatives of the deviation from equilibrium, (causes, 4, places).

        headings (causes, links): rotation of the equilibrium links by each cause.
        """
        return np.tensordot(headings, self.by_link, axes=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingingArm:
    """A moving arm, and the slice of its unknowns in the state vector.

    where: slice of `Motion`; tip: slice of the tip force; pressure: index of its error. start
    (4,): one sigma of coordinates and momenta before the first frame; stations, targets: along the
    arm. middles (links,) m: centers of its links; next_shapes (shapes, links): their rotations.
    """

    moving: MovingArm
    where: slice
    tip: slice
    pressure: int
    start: Array
    stations: Places
    targets: Places
    middles: Array = field(init=False, repr=False)
    next_shapes: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Compute the link centers, and the omitted shapes."""
        middles = self.moving.arm.reach * (np.arange(LINKS) + 0.5) / LINKS
        object.__setattr__(self, 'middles', freeze(middles))
        mid_range = solve(self.moving.arm, 0.5 * sum(self.moving.arm.pressure_range))
        modes = vibration(self.moving.arm, mid_range, Motion.SHAPES + NEXT)
        assert modes is not None  # `MovingArm` includes the slower ones
        object.__setattr__(self, 'next_shapes', modes.shape[Motion.SHAPES :])

    @property
    def mass_at_tip(self) -> float:
        """Force at the tip per acceleration (kg) of the last target, in the first mode."""
        moved = np.append(
            0.0, np.cumsum(self.moving.modes.shape[0]) * self.moving.arm.reach / LINKS
        )
        joints = np.linspace(0.0, self.moving.arm.reach, LINKS + 1)
        target = float(np.interp(self.moving.arm.target_arclength[-1], joints, moved))
        return 1.0 / abs(float(moved[-1]) * target)

    @property
    def first_swing(self) -> tuple[float, float]:
        """One sigma of the tip (m) and its velocity (m/s) in a swing of which nothing is known."""
        deviation = float(tips_of(self.moving)[0] * self.start[0])
        return deviation, deviation * float(self.moving.modes.frequency[0])

    def part(self, which: slice) -> slice:
        """Return the slice of one part (of `Motion`) of the unknowns of this frame."""
        return slice(self.where.start + which.start, self.where.start + which.stop)

    def headings(self, sensitivity: Sensitivity) -> Array:
        """Return the rotation of the equilibrium links by each cause, (causes, links) rad."""
        return sensitivity.stations(self.middles)[:, 2]

    def swing_deviation(
        self, solution: SolverNodes, unknowns: Array, reference: Reference, places: Places
    ) -> SwingDeviation:
        """Return the deviation of an arm from a solved equilibrium."""
        links, moments = links_at(solution), self.moving.modes.moment
        q = reference.place(unknowns[self.part(Motion.PLACE)], links.heading)
        bends = moments * links.compliance
        turns = np.cumsum(bends, axis=1)
        rotation = q @ turns + reference.lag
        bent = links._replace(heading=links.heading + rotation)
        displacements, equilibrium_displacements = (
            center_derivatives(bent),
            center_derivatives(links),
        )
        change = links.length * np.stack(
            [np.cos(bent.heading) - np.cos(links.heading),
             np.sin(bent.heading) - np.sin(links.heading)]
        )  # fmt: skip
        displacement = np.cumsum(change, axis=1)
        nodes = np.zeros((3, LINKS + 1))
        nodes[:2, :-1], nodes[:2, -1] = displacement - 0.5 * change, displacement[:, -1]
        nodes[2, :-1], nodes[2, -1] = rotation, rotation[-1]
        at_nodes, at_joints = places.nodes[1:], places.joints
        shapes = np.empty((len(q), 4, at_nodes.shape[1]))
        for shape, turn in enumerate(turns):
            shapes[shape, :2] = displacements @ turn @ at_nodes
            shapes[shape, 2] = np.append(turn, turn[-1]) @ at_nodes
        compliance = links.compliance.copy()
        compliance[0] = compliance[1]  # the first stands for half a link, and for the clamp
        curvature_by_shape = moments * compliance * LINKS / self.moving.arm.reach
        shapes[:, 3] = curvature_by_shape @ at_joints[:-1]
        deviation = np.empty((4, at_nodes.shape[1]))
        deviation[:3], deviation[3] = nodes @ at_nodes, q @ shapes[:, 3]
        by_link = -np.tensordot(reference.projection.T, shapes, axes=1)
        by_link[:, :2] += np.tensordot(
            displacements - equilibrium_displacements, at_nodes, axes=(1, 0)
        ).transpose(1, 0, 2)
        return SwingDeviation(
            links=links,
            deviation=deviation,
            by_link=by_link,
            by_shape=shapes,
            moment=q @ moments @ at_joints[:-1],
            at_tip=turns @ displacements[:, -1].T,
            displacements=displacements,
            heading=bent.heading,
            left_out=(displacements @ reference.left_out.T).transpose(2, 0, 1) @ at_nodes,
        )

    def advance(
        self,
        before: tuple[Known, Reference | None, int],
        propagated: Known,
        solution: SolverNodes,
        stamp_ns: int,
        path: Sequence[EquilibriumBetween] = (),
        turning: Array | None = None,
        turn_rate: float = math.nan,
    ) -> tuple[Known, Reference, Moved]:
        """Advance a swinging arm to a stamp with a solved equilibrium.

        Args:
            before: the belief, its reference (None before the first frame), and its stamp.
            propagated: the belief with all other unknowns propagated, and with the force if it was
                read.
            solution: the equilibrium at the mean of `propagated`; it is the new reference.
            stamp_ns: the new stamp.
            path: between the stamps.
            turning: rotation of the links there per unknown; None: as before, because on a
                straight arm an unknown force does not determine how the arm bends next.
            turn_rate: that of the base at the new stamp, rad/s.

        Returns:
            The belief there, its reference, and the motion of the arm.
        """
        known, previous, previous_ns = before
        time, masses, modes = self.moving.damping_time, self.moving.masses, self.moving.modes
        state, start_links = self.follow_path(before, propagated, solution, path)
        following, moving = follow_reading(
            state, stamp_ns, solution.for_kernels(), masses, time, modes, turn_rate
        )
        links = following.links
        rates, projection = linearized_rates(links, masses, time, modes.moment)
        reference = self.reference_at(following, moving, projection, propagated.mean)
        if previous is None or start_links is None:
            return propagated, reference, moving
        if not np.hypot(*moving.at_nodes[:2, -1]) < 2.0 * self.moving.arm.length:
            return self.with_restarted_swing(propagated), replace(reference, lost=True), moving
        seconds = seconds_between(previous_ns, stamp_ns)
        response = self.response(seconds)
        partial_transitions, transition = responses_to(rates, seconds)
        pull = (np.eye(len(transition)) - transition)[:, Q_ROWS] @ np.linalg.inv(
            -rates[P_ROWS, Q_ROWS]
        )
        projected_turning = self.projected_turning(previous, rates, projection, turning)
        belief = self.with_propagated_swing(
            propagated, projected_turning, following.swing, transition
        )
        force_walk = root_of(propagated.root[self.tip, known.root.shape[1] :])
        loads = previous.turning if turning is None else 0.5 * (previous.turning + turning)
        unspanned = reference.unspanned_part(loads[:, self.tip].T)
        response_error = response.std * force_walk.T @ unspanned
        start_lag = previous.lag - previous.unspanned_part(
            start_links.heading - previous.links.heading
        )
        lag = self.lag_of(
            start_lag, reference.unspanned_part(links.heading - start_links.heading), seconds
        )
        lost_walk = (transition - partial_transitions)[:, :, Q_ROWS]
        reductions = lost_walk @ projected_turning[:, self.tip] @ force_walk
        root = self.with_noise(belief.root, following.swing, moving)
        root = self.with_force_path_error(root, reductions)
        belief = replace(belief, root=freeze(root))
        reference = replace(
            reference,
            unknowns=belief.mean,
            lag=freeze(lag),
            pull=pull,
            impulses=Impulses(
                mobility=rates[Q_ROWS, P_ROWS],
                kicks=partial_transitions[:, :, P_ROWS],
                lasting=response.lasting,
            ),
            left_out=freeze(self.left_out(moving, response_error)),
        )
        return belief, reference, moving

    def follow_path(
        self,
        before: tuple[Known, Reference | None, int],
        propagated: Known,
        solution: SolverNodes,
        path: Sequence[EquilibriumBetween],
    ) -> tuple[MovingState | None, Links | None]:
        """Return the state of the swing at the end of a path, and the links at its beginning.

        Arguments as in `advance`; None before the first frame.
        """
        known, previous, previous_ns = before
        if previous is None:
            return None, None
        time, masses, modes = self.moving.damping_time, self.moving.masses, self.moving.modes
        start_links = previous.links._replace(
            heading=previous.links.heading + previous.turning @ (known.mean - previous.unknowns)
        )
        state = self.state_of(propagated, previous, start_links, previous_ns)
        end_links = links_at(solution) if path else start_links
        for passed in path:
            links_there = with_change(start_links, start_links, end_links, passed.share)
            rotation = previous.turning[:, self.pressure] * passed.chamber_deviation
            if passed.force_deviation is not None:
                rotation = rotation + previous.turning[:, self.tip] @ passed.force_deviation
            links_there = links_there._replace(
                heading=links_there.heading + rotation,
                offset=end_links.offset,
                turn_rate=passed.turn_rate,
            )
            state = advance_between_readings(
                state, passed.stamp_ns, links_there, masses, time, modes
            )
        return state, start_links

    def reference_at(
        self, following: MovingState, moving: Moved, projection: Array, unknowns: Array
    ) -> Reference:
        """Return the reference at a stamp, with all derivatives, lag and load effects zero."""
        links = following.links
        return Reference(
            heading=links.heading,
            projection=projection,
            turns=np.cumsum(self.moving.modes.moment * links.compliance, axis=1),
            links=links,
            turned=following.turned,
            unknowns=unknowns,
            turning=np.zeros((LINKS, unknowns.size)),
            at_tip=np.zeros((Motion.SHAPES, 2)),
            lag=np.zeros(LINKS),
            left_out=freeze(self.left_out(moving, np.zeros((2, LINKS)))),
            pull=np.zeros((2 * Motion.SHAPES, Motion.SHAPES)),
        )

    def projected_turning(
        self, previous: Reference, rates: Array, projection: Array, turning: Array | None
    ) -> Array:
        """Return S theta (shapes, unknowns) of `with_propagated_swing` between two references.

        rates, projection, turning: at the end; the mean of both ends is used if turning is known.
        """
        before = previous.projection @ previous.turning
        before[:, self.tip] = np.linalg.solve(-rates[P_ROWS, Q_ROWS], previous.at_tip)
        return before if turning is None else 0.5 * (before + projection @ turning)

    def force_on_shapes(self, swing: SwingDeviation, turns: Array, places: Array) -> Array:
        """Return the generalized force of 1 N along the normal, (shapes, places) N m.

        turns (shapes, links) of each shape; places (places,) m.
        """
        heading = np.interp(places, self.middles, swing.heading)
        normal = np.stack([-np.sin(heading), np.cos(heading)])
        nodes = np.concatenate([[0.0], self.middles, [self.moving.arm.reach]])
        displacements = np.einsum('dki,si->sdk', swing.displacements, turns)
        found = np.zeros((len(turns), places.size))
        for shape, displacement in enumerate(displacements):
            for axis in range(2):
                found[shape] += normal[axis] * np.interp(
                    places, nodes, np.append(0.0, displacement[axis])
                )
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

    def with_propagated_swing(
        self, known: Known, projected_turning: Array, swing: Swing, transition: Array
    ) -> Known:
        """Return the belief with the swing propagated; swing: that of the mean, with its columns.

        With z = (w, p), an error S theta of the equilibrium acts as a force: z becomes A z + (1 -
        A) (S theta, 0); transition (4, 4): A. projected_turning (shapes, unknowns): S theta of
        each unknown; the tip force acts at the actual tip.
        """
        where, relative = self.part(Motion.SWING), self.part(Motion.RELATIVE)
        mean, root = known.mean.copy(), known.root.copy()
        acting = (
            projected_turning @ root
        )  # all the time: for half of it, the force would oscillate
        root[where] = (
            transition @ root[where] + (np.eye(len(transition)) - transition)[:, Q_ROWS] @ acting
        )
        root[where] += swing.columns.T @ root[relative]
        mean[where] = swing.state.ravel() + mean[relative] @ swing.columns
        return replace(known, mean=freeze(mean), root=root)

    def swing_of(self, there: Moved) -> float:
        """Return the current and remaining amplitude (m) of the tip."""
        tip = there.at_nodes[:2, -1]
        return math.hypot(*tip.tolist(), *(there.stopped / self.moving.modes.frequency[0]))

    def left_out(self, there: Moved, response_error: Array) -> Array:
        """Return one sigma of the omitted rotations (ERRORS, links) rad.

        response_error (2, links) rad: one sigma of the response of faster shapes to the load. The
        last row is that to a blow: none.
        """
        tips = np.abs(self.next_shapes.sum(axis=1)) * self.moving.arm.reach / LINKS
        by_shape = BEYOND * self.swing_of(there) * self.next_shapes / tips[:, None]
        return np.concatenate([by_shape, response_error, np.zeros((1, LINKS))])

    def response(self, seconds: float) -> Response:
        """Return the response of faster shapes to loads that change within a time (s).

        Faster shapes are overdamped and settle with the damping time: of the response to a load
        step a time u ago, the fraction exp(-u / time) is still missing; to an impulse they respond
        like to a force that decays with it.
        """
        time = self.moving.damping_time
        if not time > 0.0 or not seconds > 0.0 or math.isinf(seconds):
            return Response(share=float(seconds > 0.0), std=0.0, lasting=0.0)
        ratio = time / seconds
        share = 1.0 + ratio * math.expm1(-seconds / time)
        missing_square = -0.5 * ratio * math.expm1(-2.0 * seconds / time)
        return Response(
            share=share,
            std=math.sqrt(max(missing_square - (1.0 - share) ** 2, 0.0)),
            lasting=math.sqrt(missing_square) / time,
        )

    def blow(
        self, known: Known, reference: Reference, acting: Array, turning: Array
    ) -> Blow | None:
        """Return a blow at some places; None before the second frame.

        acting (shapes, places), turning (places, links): generalized force of 1 N, and the
        rotation of the equilibrium's links by it.
        """
        impulses = reference.impulses
        if impulses is None:
            return None
        velocity = (impulses.mobility @ known.mean[self.part(Motion.MOMENTUM)]) @ acting
        mobility = np.einsum('sp,st,tp->p', acting, impulses.mobility, acting)
        impulse = np.divide(-velocity, mobility, out=np.zeros_like(velocity), where=mobility > 0.0)
        swing = np.einsum('tij,jp,p,t->pit', impulses.kicks, acting, impulse, np.sqrt(WEIGHTS))
        left_out = impulses.lasting * impulse[:, None] * reference.unspanned_part(turning)
        return Blow(impulse=impulse, swing=swing, left_out=left_out)

    def with_force_path_error(self, root: Array, reductions: Array) -> Array:
        """Add the error of a swing due to the unknown course of the tip force to a root.

        reductions (places, 4, 2): reduction of the motion of coordinates and momenta, per sigma of
        the walk, if it happened at PLACES of the interval instead of at its beginning.
        """
        more = np.zeros((len(root), reductions.shape[0] * reductions.shape[2]))
        by_column = np.sqrt(WEIGHTS)[:, None, None] * reductions
        more[self.part(Motion.SWING)] = by_column.transpose(1, 0, 2).reshape(
            reductions.shape[1], -1
        )
        return np.hstack([root, more])

    def lag_of(self, before: Array, rotation: Array, seconds: float) -> Array:
        """Return the lag (links,) rad of the faster modes behind the equilibrium.

        before: lag at the beginning; rotation (links,) rad: rotation of the equilibrium since
        then, in these shapes.
        """
        time = self.moving.damping_time
        if not time > 0.0:
            return np.zeros_like(before)
        decay = math.exp(-seconds / time)
        return decay * before - (1.0 - self.response(seconds).share) * rotation

    def with_noise(self, root: Array, swing: Swing, there: Moved) -> Array:
        """Add the process noise of the unknown path between two stamps to a root.

        The truncation errors of links and shapes are included, as in `moving_arm`.
        """
        values, vectors = np.linalg.eigh(swing.covariance)
        kicks = vectors * np.sqrt(np.maximum(values, 0.0))
        tip = there.at_nodes[:, -1]
        amplitude = self.swing_of(there)
        tips = np.hypot(*tip[3:].reshape(Motion.SHAPES, 3)[:, :2].T)
        left_out = np.zeros((len(kicks), Motion.SHAPES))
        left_out[: Motion.SHAPES] = np.diag(LEFT_OUT * amplitude / tips)
        more = np.zeros((len(root), kicks.shape[1] + Motion.SHAPES))
        more[self.part(Motion.SWING)] = np.hstack([kicks, left_out])
        return np.hstack([root, more])


def root_of(columns: Array) -> Array:
    """Return a square root (2, 2) of the covariance with the root (2, columns)."""
    variances, axes = np.linalg.eigh(columns @ columns.T)
    return np.asarray(axes * np.sqrt(np.fmax(variances, 0.0)))


def responses_to(rates: Array, seconds: float) -> tuple[Array, Array]:
    """Return state transitions (3, 4, 4) from PLACES of a time interval, and over all of it."""
    from scipy.linalg import expm  # slow to import, and only moving arms need it

    last, between = expm(np.multiply.outer([PLACES[0], 0.5 - PLACES[0]], rates * seconds))
    half = last @ between
    first = half @ between
    return np.stack([first, half, last]), first @ last


def tips_of(moving: MovingArm) -> Array:
    """Return how far (modes,) m the tip moves by each shape of unit modal mass."""
    return np.asarray(np.abs(moving.modes.shape.sum(axis=1)) * moving.arm.reach / LINKS)


def motion_block(moving: MovingArm, start: float) -> Motion:
    """Return the unknowns of a moving arm; start: initial amplitude at the tip over the length.

    Shapes have unit modal mass, so momenta are modal velocities.
    """
    modes, tips = moving.modes, tips_of(moving)
    place = start * moving.arm.length / tips[0] * (modes.frequency[0] / modes.frequency) ** 2
    return Motion(
        place_std=freeze(place),
        momentum_std=freeze(modes.frequency * place),
        relative=moving.relative,
    )
