"""From small changes of the record of a rod to its panels, and from its nodes to the stations.

`station_changes` is `interpolation` differentiated: exact, and cheap for any number of causes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.solver.collocation import load_panel, prepare, turning_at
from pneunet_ros.solver.interpolation import (
    CORRECTION,
    COSINE,
    INNER,
    INNER_ABSCISSAE,
    MOMENT,
    panel_series,
    SINE,
    TO_INNER,
    TO_INNER_AGAIN,
    TO_SERIES,
)
from pneunet_ros.solver.panel import (
    curvature_change,
    GAUSS_ABSCISSAE,
    GAUSS_INTEGRATION,
    GAUSS_WEIGHTS,
    Law,
    Mechanics,
    panel_fields,
    resolve,
)

Array = npt.NDArray[np.float64]

# Columns of a panel, as of `collocation`; one cause's change of the panel and of the nodes, behind
# them: theta at the start, at the four Gauss points and at the end, moment at the start and end.
LENGTH, COMPLIANCE, OFFSET, CUBIC, AXIAL, STRETCH, N1, N2, LOSS1, LOSS2 = range(10)
TURN, START, THETA, THETA_END, MOMENT_A, MOMENT_B, COLUMNS = 14, 15, 16, 21, 22, 23, 24
# Where a panel is differentiated: Gauss points, its ends, inner points by the first angle and by
# the second.
ENDS, FIRST, SECOND, POINTS = 4, 6, 6 + INNER, 6 + 2 * INNER
ABSCISSAE = np.concatenate([GAUSS_ABSCISSAE, [0.0, 1.0], INNER_ABSCISSAE, INNER_ABSCISSAE])
# What is known there: sine, cosine, axial and transverse force, stretch; moment above its offset,
# d = kappa - kappa0, d d/dM times 1/compliance and d d/dM.
SIN, COS, ALONG, ACROSS, STRETCHED, ABOVE, BEND, SOFT, FLEXIBILITY, FIELDS = range(10)
# What is integrated along a panel, as of `interpolation.panel_series`.
WAY_X, WAY_Y, GAINED, BENT = range(4)
GAUSS_TO_GAUSS = np.ascontiguousarray(GAUSS_INTEGRATION.T)
TO_INNER_FROM_ENDS = np.ascontiguousarray(TO_INNER[[1, 2, 3, 4, 0, 5]])
BY_POWER = np.ascontiguousarray(TO_SERIES.T)
AT_END = TO_SERIES.sum(axis=1)
AT_JOINT = 1e-9  # of a panel: a station so near a joint is at it


@inlined
def note_forces(
    mechanics: Mechanics, point: int, sine: float, cosine: float, fields: Array
) -> None:
    """Write down what forces make at a point of a panel with this angle."""
    axial, stretch, n1, n2, q1, q2 = mechanics
    share = ABSCISSAE[point]
    t, u = resolve(sine, cosine, n1 - share * q1, n2 - share * q2)
    fields[SIN, point], fields[COS, point] = sine, cosine
    fields[ALONG, point], fields[ACROSS, point] = t, u
    fields[STRETCHED, point] = stretch + axial * t


@inlined
def note_law(law: Law, point: int, moment: float, fields: Array) -> None:
    """Write down what the law makes of the moment at a point."""
    d, e = curvature_change(moment, law)
    fields[ABOVE, point], fields[BEND, point] = moment - law[1], d
    fields[SOFT, point], fields[FLEXIBILITY, point] = e / law[0], e


@kernel
def panel_points(panels: Array, nodes: Array, p: int, work: Array, fields: Array) -> None:
    """Fill fields (9, POINTS) of panel p; work holds what `panel_series` left there."""
    h, law, mechanics, _ = load_panel(panels, p)
    theta = (nodes[p, 1], nodes[p, 2], nodes[p, 3], nodes[p, 4])
    sine, cosine, _, _, _, moment, _, _ = panel_fields(h, law, mechanics, theta, nodes[p, 5])
    for i in range(4):
        note_forces(mechanics, i, sine[i], cosine[i], fields)
        note_law(law, i, moment[i], fields)
    note_law(law, ENDS, nodes[p, 5], fields)
    note_law(law, ENDS + 1, nodes[p + 1, 5], fields)
    for i in range(INNER):
        sine_1, cosine_1, d = work[SINE, i], work[COSINE, i], work[CORRECTION, i]
        note_forces(mechanics, FIRST + i, sine_1, cosine_1, fields)
        c, s = 1.0 - 0.5 * d * d, d - d * d * d / 6.0
        sine_2, cosine_2 = sine_1 * c + cosine_1 * s, cosine_1 * c - sine_1 * s
        note_forces(mechanics, SECOND + i, sine_2, cosine_2, fields)
        note_law(law, SECOND + i, work[MOMENT, i], fields)


@inlined
def change_forces(
    panel: Array, fields: Array, first: int, count: int, change: Array, turned: Array, out: Array
) -> None:
    """Change of h x', h y' and h M' at points of a panel whose angle is turned by so much."""
    h, axial = panel[LENGTH], panel[AXIAL]
    for i in range(count):
        at = first + i
        sine, cosine, strain = fields[SIN, at], fields[COS, at], fields[STRETCHED, at]
        t, u = fields[ALONG, at], fields[ACROSS, at]
        f1 = change[N1] - ABSCISSAE[at] * change[LOSS1]
        f2 = change[N2] - ABSCISSAE[at] * change[LOSS2]
        dt = u * turned[i] + f1 * cosine + f2 * sine
        du = f2 * cosine - f1 * sine - t * turned[i]
        along = change[LENGTH] * strain
        along += h * (change[STRETCH] + change[AXIAL] * t + axial * dt)
        across = h * strain * turned[i]
        out[WAY_X, i] = along * cosine - across * sine
        out[WAY_Y, i] = along * sine + across * cosine
        out[GAINED, i] = -along * u - h * strain * du


@inlined
def change_law(
    panel: Array, fields: Array, first: int, count: int, change: Array, moved: Array, out: Array
) -> None:
    """Change of h (kappa - kappa0) at points where the moment is moved by so much."""
    h, compliance = panel[LENGTH], panel[COMPLIANCE]
    for i in range(count):
        at = first + i
        d = fields[BEND, at]
        mu = fields[ABOVE, at] * change[COMPLIANCE] - compliance * change[OFFSET]
        mu -= change[CUBIC] * d * d * d
        bent = fields[SOFT, at] * mu + fields[FLEXIBILITY, at] * moved[i]
        out[i] = h * bent + change[LENGTH] * d


@inlined
def add_integral(weights: Array, values: Array, out: Array) -> None:
    """Add the integral of values at points to out, by weights (points, out.size)."""
    for j in range(weights.shape[0]):
        value = values[j]
        for k in range(weights.shape[1]):  # the inner loop becomes vector instructions
            out[k] += value * weights[j, k]


@inlined
def angle_at(c: Array, t: float) -> float:
    """Angle by a piece of a table of turning at a distance from its knot."""
    return c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))


@inlined
def slope_at(c: Array, t: float) -> float:
    """Slope of a piece of a table of turning: the intrinsic curvature."""
    return c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * 4.0 * c[4]))


@inlined
def change_panel(
    panel: Array,
    fields: Array,
    change: Array,
    angle: Array,
    scratch: Array,
    out: Array,
    missing: Array,
) -> None:
    """Change of h x', h y', h M' and h (kappa - kappa0) at the inner points, into out (4, INNER).

    angle (INNER,): of the unloaded rod from the start of the panel. missing (4,): what the change
    of the panel as a whole is more than the integral of out.
    """
    moment, bent, gauss = scratch[0], scratch[1], scratch[4:]
    first, second = scratch[2], scratch[3]
    for i in range(6):
        moment[i] = change[MOMENT_A]
    moment[5] = change[MOMENT_B]
    change_forces(panel, fields, 0, 4, change, change[THETA + 1 :], gauss)
    add_integral(GAUSS_TO_GAUSS, gauss[GAINED], moment)
    for field in range(2):
        missing[field] = 0.0
        for i in range(4):
            missing[field] += GAUSS_WEIGHTS[i] * gauss[field, i]
    change_law(panel, fields, 0, 6, change, moment, bent)
    for i in range(INNER):
        first[i] = second[i] = angle[i] + change[THETA]
        moment[i] = change[MOMENT_A]
    add_integral(TO_INNER_FROM_ENDS, bent, first)
    change_forces(panel, fields, FIRST, INNER, change, first, out)
    add_integral(TO_INNER_AGAIN, out[GAINED], moment)
    change_law(panel, fields, SECOND, INNER, change, moment, out[BENT])
    add_integral(TO_INNER_AGAIN, out[BENT], second)
    change_forces(panel, fields, SECOND, INNER, change, second, out)
    missing[GAINED] = change[MOMENT_B] - change[MOMENT_A]
    missing[BENT] = change[THETA_END] - change[THETA] - change[TURN]
    for field in range(4):
        for j in range(INNER):
            missing[field] -= AT_END[j] * out[field, j]


@inlined
def gather(
    panel_changes: Array, node_changes: Array, p: int, cause: int, loads: int, change: Array
) -> None:
    """Put what a cause changes of panel p and its nodes into change (COLUMNS,)."""
    for column in range(THETA):
        change[column] = panel_changes[cause - loads, p, column] if cause >= loads else 0.0
    for i in range(5):
        change[THETA + i] = node_changes[cause, p, i]
    change[THETA_END] = node_changes[cause, p + 1, 0]
    change[MOMENT_A], change[MOMENT_B] = node_changes[cause, p, 5], node_changes[cause, p + 1, 5]
    if cause < 2:  # the forces F1 and F2
        change[N1 + cause] = 1.0


@kernel
def panel_changes(
    length: Array,
    sections: Array,
    knots: Array,
    turning: Array,
    distance: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    out: Array,
) -> None:
    """Change of the panels of a mesh per unit of each cause, into out (causes, panels, 16).

    length (2, causes), sections (2, causes, sections, 8), knots (2, causes, pieces + 1) and
    turning (2, causes, pieces, 5) are records on both sides of it, distance (causes,) apart; ends
    and counts are those of the rod.
    """
    before, after = np.empty(out.shape[1:]), np.empty(out.shape[1:])
    for cause in range(distance.size):
        scale = 1.0 / distance[cause]
        for side, panels in enumerate((before, after)):
            prepare(
                length[side, cause],
                sections[side, cause],
                knots[side, cause],
                turning[side, cause],
                ends,
                counts,
                panels,
            )
        for p in range(out.shape[1]):
            for column in range(out.shape[2]):
                out[cause, p, column] = scale * (after[p, column] - before[p, column])


@kernel
def station_changes(
    panels: Array,
    nodes: Array,
    knots: Array,
    turning: Array,
    panel_changes: Array,
    turning_changes: Array,
    node_changes: Array,
    arclength: Array,
    out: Array,
) -> None:
    """Change of x, y, theta, kappa, kappa0, M at stations, into out (causes, 6, stations).

    The causes are those of `sensitivity.sensitivities`: F1, F2, M and the further ones, for which
    panel_changes and turning_changes are given. It is the derivative of `at_stations`.
    """
    count, causes, stations = panels.shape[0], node_changes.shape[0], arclength.size
    loads = causes - panel_changes.shape[0]
    work, series = np.empty((9, INNER)), np.empty((4, INNER + 1))
    fields, scratch = np.empty((FIELDS, POINTS)), np.empty((8, INNER))
    change, angle = np.empty(COLUMNS), np.zeros(INNER)
    inner, missing = np.empty((4, INNER)), np.empty(4)
    joints = np.zeros((2, causes))  # change of x and y at the start of the panel
    pieces, from_knot = np.empty(INNER, dtype=np.int64), np.empty(INNER)
    weights = np.empty((stations, INNER))  # from inner points to a station
    known = np.empty((stations, 9))  # of a station: v, slopes of the four series in v, the law
    places, distances = np.empty(stations, dtype=np.int64), np.empty(stations)
    out[:] = 0.0
    first, following, reached = 0, 0, 0
    before = 0.0  # length of the panel before
    for p in range(count):
        panel = panels[p]
        h, law, _, _ = load_panel(panels, p)
        start = panel[START]
        first, last = following, following
        if p + 1 == count:
            last = stations
        else:
            stop, near = panels[p + 1, START], AT_JOINT * h
            while last < stations and arclength[last] <= stop + near:
                last += 1
            following = last
            while following > first and arclength[following - 1] >= stop - near:
                following -= 1
        if first == stations:
            break
        _, reached = turning_at(start, knots, turning, reached)
        panel_series(panels, nodes, p, knots, turning, reached, work, series)
        panel_points(panels, nodes, p, work, fields)
        from_start = start - knots[reached]
        piece = reached
        for i in range(INNER):
            s = start + INNER_ABSCISSAE[i] * h
            _, piece = turning_at(s, knots, turning, piece)
            pieces[i], from_knot[i] = piece, s - knots[piece]
        for i in range(first, last):
            v = 2.0 * (arclength[i] - start) / h - 1.0
            _, piece = turning_at(arclength[i], knots, turning, 0 if i == 0 else places[i - 1])
            places[i], distances[i] = piece, arclength[i] - knots[piece]
            for j in range(INNER):
                weights[i, j] = 0.0
            for k in range(INNER, -1, -1):
                for j in range(INNER):
                    weights[i, j] = weights[i, j] * v + BY_POWER[k, j]
            moment = nodes[p, 5]
            known[i, 0] = v
            for field in range(4):
                total, slope = 0.0, 0.0
                for k in range(INNER, -1, -1):
                    slope = slope * v + total
                    total = total * v + series[field, k]
                known[i, 1 + field] = slope
                if field == GAINED and arclength[i] > start:
                    moment += total
            d, e = curvature_change(moment, law)
            known[i, 5], known[i, 6], known[i, 7], known[i, 8] = moment - law[1], d, e / law[0], e
        for cause in range(causes):
            gather(panel_changes, node_changes, p, cause, loads, change)
            joint = 0.0
            if cause >= loads:
                table = turning_changes[cause - loads]
                joint = slope_at(turning[reached], from_start) * change[START]
                joint += angle_at(table[reached], from_start)
            for i in range(INNER):
                angle[i] = 0.0
                if cause >= loads:
                    moved = change[START] + INNER_ABSCISSAE[i] * change[LENGTH]
                    angle[i] = slope_at(turning[pieces[i]], from_knot[i]) * moved - joint
                    angle[i] += angle_at(table[pieces[i]], from_knot[i])
            change_panel(panel, fields, change, angle, scratch, inner, missing)
            for i in range(first, last):
                station = known[i]
                # A station at a joint that moves belongs to both panels alike.
                at_joint = i >= following and p + 1 < count
                at_joint = at_joint or (p > 0 and arclength[i] <= start + AT_JOINT * before)
                share = 0.5 if at_joint else 1.0
                x, y, gained, bent = 0.0, 0.0, 0.0, 0.0
                if arclength[i] > start:  # exactly zero at a joint
                    for j in range(INNER):
                        weight = weights[i, j]
                        x += weight * inner[WAY_X, j]
                        y += weight * inner[WAY_Y, j]
                        gained += weight * inner[GAINED, j]
                        bent += weight * inner[BENT, j]
                    closing = 0.5 * (1.0 + station[0])
                    x += closing * missing[WAY_X]
                    y += closing * missing[WAY_Y]
                    gained += closing * missing[GAINED]
                    bent += closing * missing[BENT]
                # The station stays where it is while the panel moves.
                moved = -(2.0 * change[START] + (station[0] + 1.0) * change[LENGTH]) / h
                moment = change[MOMENT_A] + gained + station[3] * moved
                intrinsic, turned = 0.0, 0.0
                if cause >= loads:
                    turned = angle_at(table[places[i]], distances[i]) - joint
                    intrinsic = slope_at(table[places[i]], distances[i])
                mu = station[5] * change[COMPLIANCE] - law[0] * change[OFFSET]
                mu -= change[CUBIC] * station[6] * station[6] * station[6]
                turned += change[THETA] + bent + station[4] * moved
                out[cause, 0, i] += share * (joints[0, cause] + x + station[1] * moved)
                out[cause, 1, i] += share * (joints[1, cause] + y + station[2] * moved)
                out[cause, 2, i] += share * turned
                out[cause, 3, i] += share * (intrinsic + station[7] * mu + station[8] * moment)
                out[cause, 4, i] += share * intrinsic
                out[cause, 5, i] += share * moment
            for field in range(2):
                for j in range(INNER):
                    joints[field, cause] += AT_END[j] * inner[field, j]
                joints[field, cause] += missing[field]
        before = h
