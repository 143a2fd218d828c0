"""Motion of a chain of links about a moving equilibrium, in a few shapes.

The headings are theta(t) = theta_e(t) + Phi(t)^T q(t): theta_e of the equilibrium, which moves
linearly from one reading to the next, and Phi (shapes, links) the bending of the joints under
fixed bending moments. The shapes thus adapt to a stiffness that depends on the pressure. The
kinematics are exact, so a swing may be large. With the energies T of motion and V of bending and
loads, Lagrange's equations in the momenta p = dT/dq' are

    q' = A^-1 (p - A_e),   p' = d(T - V)/dq - damping,

A (shapes, shapes) the inertia of the shapes and A_e that of the moving equilibrium against them.
Momenta are continuous when the pressure begins to rise. T is the kinetic energy in space, so that
Euler, centrifugal and Coriolis forces act if the base turns; before and after, p is relative to
the base. Damping is of the Kelvin-Voigt type: damping_time times the stiffness of a joint times
its bending rate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.links import cut_links, Links, Masses
from pneunet_ros.solver.panel import sine_cosine

Q, P = range(2)  # rows of a state
MASS, DAMPING = range(2)  # constant errors


class Swing(NamedTuple):
    """State of a chain relative to its equilibrium, with covariance.

    state (2, shapes): q in units of the moments, then momenta p. covariance (2 shapes, 2 shapes)
    of q and p as one vector, due to changes between readings; columns (2, 2 shapes): the change of
    the state per relative error of all masses, and of the damping.
    """

    state: Array
    covariance: Array
    columns: Array


class Room(NamedTuple):
    """Output arrays of the kernels: see `slopes`; rates (2, shapes) of q and p, at the end.

    base (3 + shapes,): velocity of the tip (m/s, rad/s) and momenta by the base alone, at the end.
    """

    turns: Array
    way: Array
    gram: Array
    bends: Array
    damped: Array
    rates: Array
    base: Array


def at_rest(shapes: int) -> Swing:
    """Return a chain at rest in its equilibrium."""
    size = 2 * shapes
    return Swing(
        state=np.zeros((2, shapes)), covariance=np.zeros((size, size)), columns=np.zeros((2, size))
    )


def room_for(shapes: int, links: int) -> Room:
    """Return the work arrays of `advance_chain`."""
    return Room(
        turns=np.empty((2 * shapes + 1, links)),
        way=np.empty((shapes + 1, 2, links + 1)),
        gram=np.empty((shapes + 1, shapes + 1)),
        bends=np.empty((shapes, links)),
        damped=np.empty(shapes),
        rates=np.zeros((2, shapes)),
        base=np.zeros(3 + shapes),
    )


@inner
def solve_small(matrix: Array, right: Array) -> None:
    """Solve a small positive definite system (k, k) for columns (k, m); both are overwritten."""
    size, columns = right.shape
    for i in range(size):
        for j in range(i + 1, size):
            factor = matrix[j, i] / matrix[i, i]
            for k in range(i, size):
                matrix[j, k] -= factor * matrix[i, k]
            for k in range(columns):
                right[j, k] -= factor * right[i, k]
    for i in range(size - 1, -1, -1):
        for k in range(columns):
            value = right[i, k]
            for j in range(i + 1, size):
                value -= matrix[i, j] * right[j, k]
            right[i, k] = value / matrix[i, i]


@inner
def between(before: float, after: float, share: float) -> float:
    """Interpolate linearly between two numbers."""
    return (1.0 - share) * before + share * after


@inner
def slopes(
    state: Array,
    share: float,
    rate: float,
    before: Links,
    after: Links,
    masses: Masses,
    damping_time: float,
    moments: Array,
    room: Room,
    out: Array,
) -> None:
    """Write the rates (2, shapes) of q and p at a share of the time between readings to out.

    rate 1/s of that fraction; p: in space. Fills in room: turns, of the base and equilibrium with
    its shapes per second (1, links), then the shapes (shapes, links), then their change per
    second; way (1 + shapes, 2, links + 1) m, the motion of link centers and tip per unit of these;
    gram (1 + shapes, 1 + shapes), their inertia; bends (shapes, links) rad of the joints; damped
    (shapes,), the damping of p.
    """
    count, links = moments.shape
    turn_rate = between(before.turn_rate, after.turn_rate, share)
    turns, way, gram, bends = room.turns, room.way, room.gram, room.bends
    heading, length = np.empty(links), np.empty(links)
    sine, cosine, tilt_x, tilt_y = (
        np.empty(links),
        np.empty(links),
        np.empty(links),
        np.empty(links),
    )
    for a in range(count):
        bent, changed = 0.0, 0.0
        for i in range(links):
            bends[a, i] = moments[a, i] * between(before.compliance[i], after.compliance[i], share)
            bent += bends[a, i]
            changed += moments[a, i] * rate * (after.compliance[i] - before.compliance[i])
            turns[1 + a, i] = bent
            turns[1 + count + a, i] = changed
    for i in range(links):
        equilibrium_heading = between(before.heading[i], after.heading[i], share)
        heading[i] = equilibrium_heading
        turns[0, i] = turn_rate + rate * (after.heading[i] - before.heading[i])
        for a in range(count):
            heading[i] += turns[1 + a, i] * state[Q, a]
            turns[0, i] += turns[1 + count + a, i] * state[Q, a]
        length[i] = between(before.length[i], after.length[i], share)
        sine[i], cosine[i] = sine_cosine(heading[i])
        sine_e, cosine_e = sine_cosine(equilibrium_heading)
        tilt_x[i], tilt_y[i] = cosine[i] - cosine_e, sine[i] - sine_e
    for a in range(1 + count):
        x, y = 0.0, 0.0
        for i in range(links):
            rotated_link = length[i] * turns[a, i]
            way[a, 0, i], way[a, 1, i] = (
                x - 0.5 * sine[i] * rotated_link,
                y + 0.5 * cosine[i] * rotated_link,
            )
            x -= sine[i] * rotated_link
            y += cosine[i] * rotated_link
        way[a, 0, links], way[a, 1, links] = x, y
        for b in range(a + 1):
            total = masses.tip * (x * way[b, 0, links] + y * way[b, 1, links])
            for i in range(links):
                product = way[a, 0, i] * way[b, 0, i] + way[a, 1, i] * way[b, 1, i]
                inertia_of_link = length[i] * length[i] / 12.0 * turns[a, i] * turns[b, i]
                total += masses.mass[i] * (product + inertia_of_link)
            gram[a, b] = total
            gram[b, a] = total
    matrix, right = np.empty((count, count)), np.empty((count, 1))
    for a in range(count):
        right[a, 0] = state[P, a] - gram[1 + a, 0]
        for b in range(count):
            matrix[a, b] = gram[1 + a, 1 + b]
    solve_small(matrix, right)
    for a in range(count):
        out[Q, a], out[P, a], room.damped[a] = right[a, 0], 0.0, 0.0
    # From the tip inwards: the momentum of everything further out.
    x, y = masses.tip * velocity(way, out, 0, links), masses.tip * velocity(way, out, 1, links)
    for i in range(links - 1, -1, -1):
        mx = masses.mass[i] * velocity(way, out, 0, i)
        my = masses.mass[i] * velocity(way, out, 1, i)
        px, py = x + 0.5 * mx, y + 0.5 * my
        x += mx
        y += my
        fx = between(before.force[i, 0], after.force[i, 0], share)
        fy = between(before.force[i, 1], after.force[i, 1], share)
        turning, inner_turning, bent = turns[0, i], turn_rate, 0.0
        if i > 0:
            inner_turning = turns[0, i - 1]
        for a in range(count):
            turning += out[Q, a] * turns[1 + a, i]
            bent += state[Q, a] * moments[a, i]
            if i > 0:
                inner_turning += out[Q, a] * turns[1 + a, i - 1]
        push = length[i] * (fy * tilt_x[i] - fx * tilt_y[i])
        push -= length[i] * turning * (cosine[i] * px + sine[i] * py)
        if i + 1 == links:  # the load acts at an offset from the tip
            offset = between(before.offset, after.offset, share)
            push -= offset * (fx * tilt_x[i] + fy * tilt_y[i])
        spin = length[i] * (cosine[i] * py - sine[i] * px)
        spin += masses.mass[i] * length[i] * length[i] / 12.0 * turning
        for a in range(count):
            damping = damping_time * moments[a, i] * (turning - inner_turning)
            room.damped[a] += damping
            out[P, a] += turns[1 + a, i] * push + turns[1 + count + a, i] * spin
            out[P, a] -= bends[a, i] * bent + damping


@inner
def carry(
    state: Array, links: Links, masses: Masses, damping_time: float, moments: Array, room: Room
) -> None:
    """Fill room.base for an arm in a state that does not move relative to its turning base."""
    count, last = moments.shape
    rates = np.empty((2, count))
    slopes(state, 0.0, 1.0, links, links, masses, damping_time, moments, room, rates)
    for axis in range(2):
        room.base[axis] = room.way[0, axis, last]
    room.base[2] = links.turn_rate
    for a in range(count):
        room.base[3 + a] = room.gram[1 + a, 0]


@inner
def velocity(way: Array, rates: Array, axis: int, place: int) -> float:
    """Return the velocity (m/s) of a point, by the equilibrium and by the shapes."""
    total = way[0, axis, place]
    for a in range(rates.shape[1]):
        total += rates[Q, a] * way[1 + a, axis, place]
    return total


@inner
def advance(
    state: Array,
    seconds: float,
    steps: int,
    before: Links,
    after: Links,
    masses: Masses,
    damping_time: float,
    moments: Array,
    room: Room,
) -> None:
    """Advance a state (2, shapes) in place by one fourth-order Runge-Kutta step."""
    count = moments.shape[0]
    rates, moved, total = np.empty((2, count)), np.empty((2, count)), np.empty((2, count))
    h, rate = seconds / steps, 1.0 / seconds
    for step in range(steps):
        for stage in range(4):
            part = 0.5 if stage in (1, 2) else (1.0 if stage == 3 else 0.0)
            for row in range(2):
                for a in range(count):
                    moved[row, a] = state[row, a]
                    if stage:
                        moved[row, a] += part * h * rates[row, a]
            share = (step + part) / steps
            slopes(moved, share, rate, before, after, masses, damping_time, moments, room, rates)
            weight = 2.0 if stage in (1, 2) else 1.0
            for row in range(2):
                for a in range(count):
                    if stage == 0:
                        total[row, a] = 0.0
                    total[row, a] += weight * rates[row, a]
        for row in range(2):
            for a in range(count):
                state[row, a] += h / 6.0 * total[row, a]


@inner
def constant_error_rates(
    state: Array, damping: Array, room: Room, inverse: Array, out: Array
) -> None:
    """Return derivatives of the rates by relative errors of mass and damping, (2, 2 shapes).

    damping (shapes, shapes) of p per q'; inverse: that of the inertia of the shapes.
    """
    count = damping.shape[0]
    for a in range(count):
        q_rate, p_rate = 0.0, 0.0
        for b in range(count):
            q_rate -= inverse[a, b] * state[P, b]
            for c in range(count):
                p_rate += damping[a, b] * inverse[b, c] * state[P, c]
        out[MASS, a], out[MASS, count + a] = q_rate, p_rate
        out[DAMPING, a], out[DAMPING, count + a] = 0.0, -room.damped[a]


@inner
def linear_rates(
    links: Links, damping_time: float, moments: Array, room: Room, damping: Array, inverse: Array
) -> Array:
    """Return d(rates) / d(q, p), (2 shapes, 2 shapes), at the state that `slopes` has seen last.

    Fills damping and inverse (shapes, shapes) in the form for `constant_error_rates`.
    """
    count, size = moments.shape
    stiff, gram = np.zeros((count, count)), np.empty((count, count))
    along = np.empty(size)
    for i in range(size):
        sine, cosine = sine_cosine(links.heading[i])
        along[i] = links.length[i] * (links.force[i, 0] * cosine + links.force[i, 1] * sine)
        if i + 1 == size:
            across = links.force[i, 1] * cosine - links.force[i, 0] * sine
            along[i] += links.offset * across
    for a in range(count):
        for b in range(count):
            gram[a, b] = room.gram[1 + a, 1 + b]
            inverse[a, b] = 1.0 if a == b else 0.0
            bending = 0.0
            for i in range(size):
                bending += moments[a, i] * room.bends[b, i]
                stiff[a, b] += room.turns[1 + a, i] * along[i] * room.turns[1 + b, i]
            stiff[a, b] += bending
            damping[a, b] = damping_time * bending
    solve_small(gram, inverse)
    rates = np.zeros((2 * count, 2 * count))
    for a in range(count):
        for b in range(count):
            rates[a, count + b] = inverse[a, b]
            rates[count + a, b] = -stiff[a, b]
            for c in range(count):
                rates[count + a, count + b] -= damping[a, c] * inverse[c, b]
    return rates


@inner
def product(left: Array, right: Array, factor: float, out: Array) -> None:
    """Compute factor left @ right of two small matrices."""
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            total = 0.0
            for k in range(left.shape[1]):
                total += left[i, k] * right[k, j]
            out[i, j] = factor * total


@inner
def transition(rates: Array, seconds: float) -> Array:
    """Return exp(rates seconds), (k, k), by one step of fourth-order Runge-Kutta."""
    size = rates.shape[0]
    result, power, work = np.eye(size), np.eye(size), np.empty((size, size))
    for order in range(1, 5):
        product(power, rates, seconds / order, work)
        for i in range(size):
            for j in range(size):
                power[i, j] = work[i, j]
                result[i, j] += work[i, j]
    return result


@inner
def add_unknown_course(covariance: Array, step: Array, steps: int, change: Array) -> None:
    """Add the covariance of a change at an unknown instant between two readings, in place.

    change (shapes,): of the equilibrium, in units of q; step: transition over one of the steps
    between the readings. The mean of a step at an unknown instant, uniformly distributed, is the
    linear change that `advance` follows; the covariance is that of the step about this mean.
    """
    size = covariance.shape[0]
    late, early, mean = np.zeros(size), np.empty(size), np.zeros(size)
    square = np.zeros((size, size))
    for a in range(change.size):
        late[a] = change[a]
    for _ in range(steps):  # after a later change, less of its swing has passed
        for i in range(size):
            early[i] = 0.0
            for j in range(size):
                early[i] += step[i, j] * late[j]
        for i in range(size):
            mean[i] += 0.5 * (late[i] + early[i]) / steps
            for j in range(size):
                ends = late[i] * late[j] + early[i] * early[j]
                across = late[i] * early[j] + early[i] * late[j]
                square[i, j] += (2.0 * ends + across) / (6.0 * steps)
        for i in range(size):
            late[i] = early[i]
    for i in range(size):
        for j in range(size):
            covariance[i, j] += square[i, j] - mean[i] * mean[j]


@kernel
def advance_chain(
    swing: Swing,
    seconds: float,
    steps: int,
    before: Links,
    after: Links,
    masses: Masses,
    damping_time: float,
    moments: Array,
    turned: Array,
    room: Room,
) -> None:
    """Advance a chain in place; moments (shapes, n) N m: those of the shapes.

    before, after: its equilibrium at either end. turned (shapes,) 1/s: rate of the equilibrium
    relative to the base until `before`, in units of q, and then until `after`. The common part of
    the change since then and the change of the rate may have happened at any instant, see
    `add_unknown_course`.
    """
    count = moments.shape[0]
    rates = np.empty((2, count))
    damping, inverse = np.empty((count, count)), np.empty((count, count))
    errors = np.empty((2, 2 * count))
    for i in range(3 + count):
        room.base[i] = 0.0
    base_turns = before.turn_rate != 0.0 or after.turn_rate != 0.0
    if base_turns:
        carry(swing.state, before, masses, damping_time, moments, room)
        add_momenta(swing, room, 1.0)
    advance(swing.state, seconds, steps, before, after, masses, damping_time, moments, room)
    if base_turns:
        carry(swing.state, after, masses, damping_time, moments, room)
    slopes(
        swing.state, 1.0, 1.0 / seconds, before, after, masses, damping_time, moments, room, rates
    )
    for row in range(2):
        for a in range(count):
            room.rates[row, a] = rates[row, a]
    linear = linear_rates(after, damping_time, moments, room, damping, inverse)
    constant_error_rates(swing.state, damping, room, inverse, errors)
    step = transition(linear, seconds / steps)
    size = 2 * count
    transition_matrix, covariance = np.eye(size), np.empty((size, size))
    for _ in range(steps):
        product(step, transition_matrix, 1.0, covariance)
        for i in range(size):
            for j in range(size):
                transition_matrix[i, j] = covariance[i, j]
    columns = np.empty((2, size))
    for cause in range(2):
        for i in range(size):
            columns[cause, i] = seconds * errors[cause, i]
            for j in range(size):
                columns[cause, i] += transition_matrix[i, j] * swing.columns[cause, j]
    for cause in range(2):
        for i in range(size):
            swing.columns[cause, i] = columns[cause, i]
    product(transition_matrix, swing.covariance, 1.0, covariance)
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += covariance[i, k] * transition_matrix[j, k]
            swing.covariance[i, j] = total
    change, bend = np.empty(count), np.empty(count)
    for a in range(count):
        rate = 0.0
        for b in range(count):
            rate += inverse[a, b] * (room.gram[1 + b, 0] - room.base[3 + b])
        change[a], bend[a] = seconds * rate, seconds * (rate - turned[a])
        turned[a] = rate
    if inertia_of(bend, room) < inertia_of(change, room):
        change = bend
    add_unknown_course(swing.covariance, step, steps, change)
    if base_turns:
        add_momenta(swing, room, -1.0)


@inner
def add_momenta(swing: Swing, room: Room, factor: float) -> None:
    """Add the momenta by the turning base, which are proportional to the mass, in place."""
    count = swing.state.shape[1]
    for a in range(count):
        swing.state[P, a] += factor * room.base[3 + a]
        swing.columns[MASS, count + a] += factor * room.base[3 + a]


@inner
def inertia_of(q: Array, room: Room) -> float:
    """Return the square of a motion of the shapes, weighted with their inertia."""
    total = 0.0
    for a in range(q.size):
        for b in range(q.size):
            total += q[a] * room.gram[1 + a, 1 + b] * q[b]
    return total


@inner
def add_deviation(links: Links, q: Array, turns: Array, at_nodes: Array) -> None:
    """Fill the first rows of at_nodes of `follow_swing`: the displacement by q."""
    count, size = q.size, links.heading.size
    at_nodes[0, 0], at_nodes[1, 0], at_nodes[2, 0] = 0.0, 0.0, 0.0
    x, y = 0.0, 0.0
    for i in range(size):
        added = 0.0
        for a in range(count):
            added += q[a] * turns[1 + a, i]
        sine, cosine = sine_cosine(links.heading[i] + added)
        sine_e, cosine_e = sine_cosine(links.heading[i])
        dx, dy = links.length[i] * (cosine - cosine_e), links.length[i] * (sine - sine_e)
        at_nodes[0, 1 + i], at_nodes[1, 1 + i] = x + 0.5 * dx, y + 0.5 * dy
        at_nodes[2, 1 + i] = added
        x += dx
        y += dy
    at_nodes[0, 1 + size], at_nodes[1, 1 + size] = x, y
    at_nodes[2, 1 + size] = at_nodes[2, size]


@kernel
def follow_series(
    solved: tuple[Array, Array, Array],
    start: Array,
    seconds: Array,
    steps: Array,
    masses: Masses,
    damping_time: float,
    moments: Array,
    pair: tuple[Links, Links],
    room: Room,
    at_nodes: Array,
) -> None:
    """Follow a chain through a series of solved rods, without the errors of its swing.

    solved: tables of the rods, (readings, ...) each. start (2, shapes): q and p at the first.
    seconds (readings,): since the previous reading; steps (readings,) of the integration, 0 where
    the chain is at rest again. pair: room for two chains. Fills at_nodes (readings, 3, n + 2): x,
    y (m), theta (rad) relative to the equilibrium, at the clamp, the link centers and the tip.
    """
    panels, ends, nodes = solved
    first, second = pair
    offset = 0.0
    count, links = moments.shape
    state = np.empty((2, count))
    for row in range(2):
        for a in range(count):
            state[row, a] = start[row, a]
    for which in range(len(panels)):
        before = Links(first.heading, first.length, first.compliance, first.force, offset, 0.0)
        offset = ends[which, col.LOAD_OFFSET]
        after = Links(second.heading, second.length, second.compliance, second.force, offset, 0.0)
        cut_links(
            panels[which],
            ends[which],
            nodes[which],
            after.heading,
            after.length,
            after.compliance,
            after.force,
        )
        if steps[which]:
            advance(
                state,
                seconds[which],
                steps[which],
                before,
                after,
                masses,
                damping_time,
                moments,
                room,
            )
        else:
            if which:
                for row in range(2):
                    for a in range(count):
                        state[row, a] = 0.0
            slopes(state, 0.0, 1.0, after, after, masses, damping_time, moments, room, room.rates)
        add_deviation(after, state[Q], room.turns, at_nodes[which])
        for i in range(links):
            before.heading[i], before.length[i] = after.heading[i], after.length[i]
            before.compliance[i] = after.compliance[i]
            before.force[i, 0], before.force[i, 1] = after.force[i, 0], after.force[i, 1]


@kernel
def follow_swing(
    solved: tuple[Array, Array, Array],
    swing: Swing,
    seconds: float,
    steps: int,
    before: Links,
    after: Links,
    masses: Masses,
    damping_time: float,
    moments: Array,
    turned: Array,
    room: Room,
    at_nodes: Array,
    at_joints: Array,
    tip: Array,
) -> None:
    """Advance a chain to the equilibrium of a solved rod, and return its position there.

    solved: tables of the rod, whose links are written into after. swing is advanced in place;
    steps: 0 if arm and base are at rest, and `before` is not used. Other arguments as in
    `advance_chain`. Fills at_nodes (3 + 3 shapes, n + 2), at the clamp, the link centers and the
    tip: x, y (m), theta (rad) relative to the equilibrium, then their changes per q of each shape;
    at_joints (2 + shapes, n + 1), at the joints and the tip: curvature (1/m) and moment (N m)
    relative to the equilibrium, then the change of curvature per q; tip (5,): its velocity
    relative to the base (m/s, rad/s), and its velocity in x, y if the equilibrium stopped.
    """
    panels, ends, nodes = solved
    cut_links(panels, ends, nodes, after.heading, after.length, after.compliance, after.force)
    count, links = moments.shape
    if steps:
        advance_chain(
            swing, seconds, steps, before, after, masses, damping_time, moments, turned, room
        )
    else:
        slopes(
            swing.state, 0.0, 1.0, after, after, masses, damping_time, moments, room, room.rates
        )
        for a in range(count):
            turned[a] = 0.0
    q = swing.state[Q]
    for i in range(2 + links):  # nodes
        for a in range(count):
            for axis in range(2):
                at_nodes[3 + 3 * a + axis, i] = 0.0 if i == 0 else room.way[1 + a, axis, i - 1]
            turns = room.turns[1 + a, min(i, links) - 1] if i else 0.0
            at_nodes[5 + 3 * a, i] = turns
    add_deviation(after, q, room.turns, at_nodes)
    reach = 0.0
    for p in range(len(panels)):
        reach += panels[p, col.PANEL_LENGTH]
    for i in range(links):
        at_joints[0, i], at_joints[1, i] = 0.0, 0.0
        # The joint at the clamp represents half a link, and includes the compliance of the clamp.
        compliance = after.compliance[i] if i else after.compliance[1]
        for a in range(count):
            bend = moments[a, i] * compliance * links / reach
            at_joints[2 + a, i] = bend
            at_joints[0, i] += q[a] * bend
            at_joints[1, i] += q[a] * moments[a, i]
    for row in range(2 + count):
        at_joints[row, links] = 0.0
    held, matrix = np.empty((count, 1)), np.empty((count, count))
    for a in range(count):
        held[a, 0] = swing.state[P, a]
        for b in range(count):
            matrix[a, b] = room.gram[1 + a, 1 + b]
    solve_small(matrix, held)
    for axis in range(2):
        tip[axis] = velocity(room.way, room.rates, axis, links) - room.base[axis]
        tip[3 + axis] = 0.0
        for a in range(count):
            tip[3 + axis] += held[a, 0] * room.way[1 + a, axis, links]
    tip[2] = room.turns[0, links - 1] - room.base[2]
    for a in range(count):
        tip[2] += room.rates[Q, a] * room.turns[1 + a, links - 1]


@kernel
def widen(
    swing: Swing,
    relative: Array,
    left_out: float,
    length: float,
    by_reading: Array,
    along: Array,
    bent: Array,
    std: Array,
    covariance: Array,
) -> None:
    """Add the uncertainty of a swing to standard deviations, in place.

    The noise of a reading moves the equilibrium at once, and the arm with a delay that differs
    between shapes, so that errors across the direction of the equilibrium no longer cancel.

    relative (2,): one sigma of mass and damping; left_out m of the tip, in each shape; length (m)
    of the arm; by_reading (readings, 3): change of x, y (m), theta of the tip in equilibrium by
    one sigma of each reading, which covariance includes. along (3 + 3 shapes, places), bent (2 +
    shapes, places): as at_nodes and at_joints of `follow_swing`, at places of which the last is
    the tip; std (3, places) of x, y (m) and curvature (1/m); covariance (3, 3) of x, y, theta of
    the tip.
    """
    count = swing.state.shape[1]
    q = np.empty((count, count))
    for a in range(count):
        for b in range(count):
            q[a, b] = swing.covariance[a, b]
            for cause in range(2):
                square = relative[cause] * relative[cause]
                q[a, b] += square * swing.columns[cause, a] * swing.columns[cause, b]
    places = std.shape[1]
    for a in range(count):
        x, y = along[3 + 3 * a, places - 1], along[4 + 3 * a, places - 1]
        q[a, a] += left_out * left_out / (x * x + y * y)
    for place in range(places):
        for row in range(3):
            total = std[row, place] * std[row, place]
            for a in range(count):
                for b in range(count):
                    if row < 2:
                        both = along[3 + 3 * a + row, place] * along[3 + 3 * b + row, place]
                    else:
                        both = bent[2 + a, place] * bent[2 + b, place]
                    total += q[a, b] * both
            std[row, place] = np.sqrt(total)
    tip = places - 1
    for row in range(3):
        for column in range(3):
            for a in range(count):
                for b in range(count):
                    both = along[3 + 3 * a + row, tip] * along[3 + 3 * b + column, tip]
                    covariance[row, column] += q[a, b] * both
    unit = np.ones(3)
    unit[2] = length  # weight of an angle
    moved, shapes = np.empty(by_reading.shape), np.empty((count, 3))
    parts = np.empty((len(by_reading), count, 3))
    for row in range(3):
        for a in range(count):
            shapes[a, row] = unit[row] * along[3 + 3 * a + row, tip]
        for reading in range(len(by_reading)):
            moved[reading, row] = unit[row] * by_reading[reading, row]
    part_shapes(moved, shapes, parts)
    for row in range(3):
        for column in range(3):
            for reading in range(len(by_reading)):
                for a in range(count):
                    both = parts[reading, a, row] * parts[reading, a, column]
                    covariance[row, column] += both / (unit[row] * unit[column])


@kernel
def part_shapes(errors: Array, shapes: Array, parts: Array) -> None:
    """Split the effects of errors among the shapes.

    errors (errors, coordinates): displacement by each error; shapes (shapes, coordinates): the
    same per q of each shape. Fills parts (errors, shapes, coordinates) by a least-squares fit.
    """
    count, coordinates = shapes.shape
    matrix, q = np.zeros((count, count)), np.zeros((count, len(errors)))
    for a in range(count):
        for i in range(coordinates):
            for b in range(count):
                matrix[a, b] += shapes[a, i] * shapes[b, i]
            for error in range(len(errors)):
                q[a, error] += shapes[a, i] * errors[error, i]
    solve_small(matrix, q)
    for error in range(len(errors)):
        square = 0.0
        for i in range(coordinates):
            square += errors[error, i] * errors[error, i]
        for a in range(count):
            component = 0.0
            for i in range(coordinates):
                component += shapes[a, i] * errors[error, i]
            if square > 0.0:
                component /= square
            for i in range(coordinates):
                remainder = shapes[a, i] - component * errors[error, i]
                parts[error, a, i] = q[a, error] * remainder
