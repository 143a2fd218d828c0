"""Linearization: from changes of a rod's record to its panels, and from its nodes to the stations.

`station_changes` is the derivative of `interpolation`: exact, and cheap for any number of causes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel, not_literal
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import prepare, rotation_at
from pneunet_ros.solver.columns import four, powers, read_panel
from pneunet_ros.solver.interpolation import (
    CORRECTION,
    COSINE,
    INNER,
    INNER_ABSCISSAE,
    integrate,
    MOMENTS,
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

# Where a panel is differentiated: Gauss points, its ends, inner points by the first angle and by
# the second.
GAUSS, ENDS, FIRST, SECOND = map(not_literal, (0, 4, 6, 6 + INNER))
OF_GAUSS, OF_GAUSS_AND_ENDS, OF_INNER = map(not_literal, (4, 6, INNER))
POINTS = 6 + 2 * INNER
ABSCISSAE = np.concatenate([GAUSS_ABSCISSAE, [0.0, 1.0], INNER_ABSCISSAE, INNER_ABSCISSAE])
GAUSS_TO_GAUSS = np.ascontiguousarray(GAUSS_INTEGRATION.T)
TO_INNER_FROM_ENDS = np.ascontiguousarray(TO_INNER[[1, 2, 3, 4, 0, 5]])
BY_POWER = np.ascontiguousarray(TO_SERIES.T)
AT_END = TO_SERIES.sum(axis=1)
AT_JOINT = 1e-9  # of a panel: a station this close to a joint counts as at it


@inlined
def note_forces(
    mechanics: Mechanics, point: int, sine: float, cosine: float, fields: Array
) -> None:
    """Store the forces at a point of a panel with this angle."""
    axial, stretch, n1, n2, q1, q2 = mechanics
    share = ABSCISSAE[point]
    t, u = resolve(sine, cosine, n1 - share * q1, n2 - share * q2)
    fields[col.POINT_SINE, point], fields[col.POINT_COSINE, point] = sine, cosine
    fields[col.POINT_AXIAL, point], fields[col.POINT_TRANSVERSE, point] = t, u
    fields[col.POINT_STRETCH, point] = stretch + axial * t


@inlined
def note_law(law: Law, point: int, moment: float, fields: Array) -> None:
    """Store the moment law evaluated at a point."""
    d, e = curvature_change(moment, law)
    fields[col.POINT_MOMENT, point], fields[col.POINT_BEND, point] = moment - law[1], d
    fields[col.POINT_PER_COMPLIANCE, point], fields[col.POINT_PER_MOMENT, point] = e / law[0], e


@inner
def panel_points(panels: Array, nodes: Array, p: int, work: Array, fields: Array) -> None:
    """Fill fields (9, POINTS) of panel p; work: as left by `panel_series`."""
    h, law, mechanics, _ = read_panel(panels, p)
    theta = four(nodes[p], col.NODE_GAUSS)
    sine, cosine, _, _, _, moment, _, _ = panel_fields(
        h, law, mechanics, theta, nodes[p, col.NODE_MOMENT]
    )
    for i in range(4):
        note_forces(mechanics, i, sine[i], cosine[i], fields)
        note_law(law, i, moment[i], fields)
    note_law(law, ENDS, nodes[p, col.NODE_MOMENT], fields)
    note_law(law, ENDS + 1, nodes[p + 1, col.NODE_MOMENT], fields)
    for i in range(INNER):
        sine_1, cosine_1, d = work[SINE, i], work[COSINE, i], work[CORRECTION, i]
        note_forces(mechanics, FIRST + i, sine_1, cosine_1, fields)
        c, s = 1.0 - 0.5 * d * d, d - d * d * d / 6.0
        sine_2, cosine_2 = sine_1 * c + cosine_1 * s, cosine_1 * c - sine_1 * s
        note_forces(mechanics, SECOND + i, sine_2, cosine_2, fields)
        note_law(law, SECOND + i, work[MOMENTS, i], fields)


@inlined
def change_forces(
    panel: Array, fields: Array, first: int, count: int, change: Array, turned: Array, out: Array
) -> None:
    """Return the change of h x', h y' and h M' at points of a panel by a change of its angle."""
    h, axial = panel[col.PANEL_LENGTH], panel[col.PANEL_AXIAL]
    for i in range(count):
        at = first + i
        sine, cosine, strain = (
            fields[col.POINT_SINE, at],
            fields[col.POINT_COSINE, at],
            fields[col.POINT_STRETCH, at],
        )
        t, u = fields[col.POINT_AXIAL, at], fields[col.POINT_TRANSVERSE, at]
        f1 = change[col.PANEL_FORCE_X] - ABSCISSAE[at] * change[col.PANEL_LOSS_X]
        f2 = change[col.PANEL_FORCE_Y] - ABSCISSAE[at] * change[col.PANEL_LOSS_Y]
        dt = u * turned[i] + f1 * cosine + f2 * sine
        du = f2 * cosine - f1 * sine - t * turned[i]
        along = change[col.PANEL_LENGTH] * strain
        along += h * (change[col.PANEL_STRETCH] + change[col.PANEL_AXIAL] * t + axial * dt)
        across = h * strain * turned[i]
        out[col.SERIES_X, i] = along * cosine - across * sine
        out[col.SERIES_Y, i] = along * sine + across * cosine
        out[col.SERIES_MOMENT, i] = -along * u - h * strain * du


@inlined
def change_law(
    panel: Array, fields: Array, first: int, count: int, change: Array, moved: Array, out: Array
) -> None:
    """Return the change of h (kappa - kappa0) at points by a change of the moment."""
    h, compliance = panel[col.PANEL_LENGTH], panel[col.PANEL_FLEXIBILITY]
    for i in range(count):
        at = first + i
        d = fields[col.POINT_BEND, at]
        mu = (
            fields[col.POINT_MOMENT, at] * change[col.PANEL_FLEXIBILITY]
            - compliance * change[col.PANEL_OFFSET]
        )
        mu -= change[col.PANEL_CUBIC] * d * d * d
        bent = (
            fields[col.POINT_PER_COMPLIANCE, at] * mu + fields[col.POINT_PER_MOMENT, at] * moved[i]
        )
        out[i] = h * bent + change[col.PANEL_LENGTH] * d


@inlined
def angle_at(c: Array, t: float) -> float:
    """Return the angle of a piece of the rotation table at a distance from its knot."""
    c0, c1, c2, c3, c4 = powers(c)
    return c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))


@inlined
def slope_at(c: Array, t: float) -> float:
    """Return the slope of a piece of the rotation table: the intrinsic curvature."""
    _, c1, c2, c3, c4 = powers(c)
    return c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4))


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
    """Write changes of h x', h y', h M', h (kappa - kappa0) at the inner points to out (4, INNER).

    angle (INNER,) of the unloaded rod from the start of the panel. missing (4,): the change of
    the whole panel minus the integral of out.
    """
    moment, bent, gauss = scratch[0], scratch[1], scratch[4:]
    first, second = scratch[2], scratch[3]
    for i in range(6):
        moment[i] = change[col.CHANGE_MOMENT]
    moment[5] = change[col.CHANGE_MOMENT_END]
    change_forces(panel, fields, GAUSS, OF_GAUSS, change, change[col.CHANGE_GAUSS :], gauss)
    integrate(GAUSS_TO_GAUSS, gauss[col.SERIES_MOMENT], moment)
    for field in range(2):
        missing[field] = 0.0
        for i in range(4):
            missing[field] += GAUSS_WEIGHTS[i] * gauss[field, i]
    change_law(panel, fields, GAUSS, OF_GAUSS_AND_ENDS, change, moment, bent)
    for i in range(INNER):
        first[i] = second[i] = angle[i] + change[col.CHANGE_THETA]
        moment[i] = change[col.CHANGE_MOMENT]
    integrate(TO_INNER_FROM_ENDS, bent, first)
    change_forces(panel, fields, FIRST, OF_INNER, change, first, out)
    integrate(TO_INNER_AGAIN, out[col.SERIES_MOMENT], moment)
    change_law(panel, fields, SECOND, OF_INNER, change, moment, out[col.SERIES_BEND])
    integrate(TO_INNER_AGAIN, out[col.SERIES_BEND], second)
    change_forces(panel, fields, SECOND, OF_INNER, change, second, out)
    missing[col.SERIES_MOMENT] = change[col.CHANGE_MOMENT_END] - change[col.CHANGE_MOMENT]
    missing[col.SERIES_BEND] = (
        change[col.CHANGE_THETA_END] - change[col.CHANGE_THETA] - change[col.PANEL_ROTATION_END]
    )
    for field in range(4):
        for j in range(INNER):
            missing[field] -= AT_END[j] * out[field, j]


@inlined
def gather(
    panel_changes: Array, node_changes: Array, p: int, cause: int, loads: int, change: Array
) -> None:
    """Collect the changes of panel p and its nodes by a cause in change (col.CHANGE_WIDTH,)."""
    for column in range(col.CHANGE_THETA):
        change[column] = panel_changes[cause - loads, p, column] if cause >= loads else 0.0
    for i in range(5):
        change[col.CHANGE_THETA + i] = node_changes[cause, p, i]
    change[col.CHANGE_THETA_END] = node_changes[cause, p + 1, col.NODE_THETA]
    change[col.CHANGE_MOMENT] = node_changes[cause, p, col.NODE_MOMENT]
    change[col.CHANGE_MOMENT_END] = node_changes[cause, p + 1, col.NODE_MOMENT]
    if cause < 2:  # the forces F1 and F2
        change[col.PANEL_FORCE_X + cause] = 1.0


@kernel
def panel_changes(
    length: Array,
    sections: Array,
    knots: Array,
    rotation: Array,
    distance: Array,
    clamp: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    out: Array,
) -> None:
    """Compute the change of the panels per unit of each cause, into out (causes, panels, 16).

    length (2, causes), sections (2, causes, sections, 8), knots (2, causes, pieces + 1) and
    rotation (2, causes, pieces, 5) and clamp (2, causes, 5) are records on both sides of each
    cause, distance (causes,) apart; ends and counts are those of the rod.
    """
    shape = out.shape[1], out.shape[2]
    before, after = np.empty(shape), np.empty(shape)
    moved = ends.copy()
    for cause in range(distance.size):
        scale = 1.0 / distance[cause]
        for side, panels in enumerate((before, after)):
            for column in (col.END_X, col.END_Y):
                weighs = clamp[side, cause, column] - clamp[0, cause, column]
                moved[column] = ends[column] + weighs
            prepare(
                length[side, cause],
                sections[side, cause],
                knots[side, cause],
                rotation[side, cause],
                moved,
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
    rotation: Array,
    panel_changes: Array,
    rotation_changes: Array,
    node_changes: Array,
    arclength: Array,
    out: Array,
) -> None:
    """Write changes of x, y, theta, kappa, kappa0, M at stations to out (causes, 6, stations).

    The causes are those of `sensitivity.sensitivities`: F1, F2, M and the further ones, for which
    panel_changes and rotation_changes are given. This is the derivative of `at_stations`.
    """
    count, causes, stations = len(panels), len(node_changes), arclength.size
    loads = causes - len(panel_changes)
    work, series = np.empty((9, INNER)), np.empty((4, INNER + 1))
    fields, scratch = np.empty((col.POINT_WIDTH, POINTS)), np.empty((8, INNER))
    change, angle = np.empty(col.CHANGE_WIDTH), np.zeros(INNER)
    inner, missing = np.empty((4, INNER)), np.empty(4)
    joints = np.zeros((2, causes))  # change of x and y at the start of the panel
    pieces, from_knot = np.empty(INNER, dtype=np.int64), np.empty(INNER)
    weights = np.empty((stations, INNER))  # from inner points to a station
    known = np.empty(
        (stations, col.STATION_WIDTH)
    )  # of a station: v, slopes of the four series in v, the law
    places, distances = np.empty(stations, dtype=np.int64), np.empty(stations)
    for cause in range(causes):
        for field in range(col.FIELD_COUNT):
            for i in range(stations):
                out[cause, field, i] = 0.0
    first, following, reached = 0, 0, 0
    before = 0.0  # length of the panel before
    for p in range(count):
        panel = panels[p]
        h, law, _, _ = read_panel(panels, p)
        start = panel[col.PANEL_START]
        first, last = following, following
        if p + 1 == count:
            last = stations
        else:
            stop, near = panels[p + 1, col.PANEL_START], AT_JOINT * h
            while last < stations and arclength[last] <= stop + near:
                last += 1
            following = last
            while following > first and arclength[following - 1] >= stop - near:
                following -= 1
        if first == stations:
            break
        _, reached = rotation_at(start, knots, rotation, reached)
        panel_series(panels, nodes, p, knots, rotation, reached, work, series)
        panel_points(panels, nodes, p, work, fields)
        from_start = start - knots[reached]
        piece = reached
        for i in range(INNER):
            s = start + INNER_ABSCISSAE[i] * h
            _, piece = rotation_at(s, knots, rotation, piece)
            pieces[i], from_knot[i] = piece, s - knots[piece]
        for i in range(first, last):
            v = 2.0 * (arclength[i] - start) / h - 1.0
            _, piece = rotation_at(arclength[i], knots, rotation, 0 if i == 0 else places[i - 1])
            places[i], distances[i] = piece, arclength[i] - knots[piece]
            for j in range(INNER):
                weights[i, j] = 0.0
            for k in range(INNER, -1, -1):
                for j in range(INNER):
                    weights[i, j] = weights[i, j] * v + BY_POWER[k, j]
            moment = nodes[p, col.NODE_MOMENT]
            known[i, col.STATION_V] = v
            for field in range(4):
                total, slope = 0.0, 0.0
                for k in range(INNER, -1, -1):
                    slope = slope * v + total
                    total = total * v + series[field, k]
                known[i, col.STATION_SLOPES + field] = slope
                if field == col.SERIES_MOMENT and arclength[i] > start:
                    moment += total
            d, e = curvature_change(moment, law)
            known[i, col.STATION_MOMENT], known[i, col.STATION_BEND] = moment - law[1], d
            known[i, col.STATION_PER_COMPLIANCE] = e / law[0]
            known[i, col.STATION_PER_MOMENT] = e
        for cause in range(causes):
            gather(panel_changes, node_changes, p, cause, loads, change)
            joint = 0.0
            if cause >= loads:
                table = rotation_changes[cause - loads]
                joint = slope_at(rotation[reached], from_start) * change[col.PANEL_START]
                joint += angle_at(table[reached], from_start)
            for i in range(INNER):
                angle[i] = 0.0
                if cause >= loads:
                    moved = change[col.PANEL_START] + INNER_ABSCISSAE[i] * change[col.PANEL_LENGTH]
                    angle[i] = slope_at(rotation[pieces[i]], from_knot[i]) * moved - joint
                    angle[i] += angle_at(table[pieces[i]], from_knot[i])
            change_panel(panel, fields, change, angle, scratch, inner, missing)
            for i in range(first, last):
                station = known[i]
                # A station at a moving joint belongs equally to both panels.
                at_joint = i >= following and p + 1 < count
                at_joint = at_joint or (p > 0 and arclength[i] <= start + AT_JOINT * before)
                share = 0.5 if at_joint else 1.0
                x, y, gained, bent = 0.0, 0.0, 0.0, 0.0
                if arclength[i] > start:  # exactly zero at a joint
                    for j in range(INNER):
                        weight = weights[i, j]
                        x += weight * inner[col.SERIES_X, j]
                        y += weight * inner[col.SERIES_Y, j]
                        gained += weight * inner[col.SERIES_MOMENT, j]
                        bent += weight * inner[col.SERIES_BEND, j]
                    closing = 0.5 * (1.0 + station[col.STATION_V])
                    x += closing * missing[col.SERIES_X]
                    y += closing * missing[col.SERIES_Y]
                    gained += closing * missing[col.SERIES_MOMENT]
                    bent += closing * missing[col.SERIES_BEND]
                # The station stays in place while the panel moves.
                moved = (
                    -(
                        2.0 * change[col.PANEL_START]
                        + (station[col.STATION_V] + 1.0) * change[col.PANEL_LENGTH]
                    )
                    / h
                )
                moment = change[col.CHANGE_MOMENT] + gained
                moment += station[col.STATION_SLOPES + col.SERIES_MOMENT] * moved
                intrinsic, turned = 0.0, 0.0
                if cause >= loads:
                    turned = angle_at(table[places[i]], distances[i]) - joint
                    intrinsic = slope_at(table[places[i]], distances[i])
                mu = (
                    station[col.STATION_MOMENT] * change[col.PANEL_FLEXIBILITY]
                    - law[0] * change[col.PANEL_OFFSET]
                )
                mu -= (
                    change[col.PANEL_CUBIC]
                    * station[col.STATION_BEND]
                    * station[col.STATION_BEND]
                    * station[col.STATION_BEND]
                )
                turned += (
                    change[col.CHANGE_THETA]
                    + bent
                    + station[col.STATION_SLOPES + col.SERIES_BEND] * moved
                )
                out[cause, col.X, i] += share * (
                    joints[col.SERIES_X, cause]
                    + x
                    + station[col.STATION_SLOPES + col.SERIES_X] * moved
                )
                out[cause, col.Y, i] += share * (
                    joints[col.SERIES_Y, cause]
                    + y
                    + station[col.STATION_SLOPES + col.SERIES_Y] * moved
                )
                out[cause, col.THETA, i] += share * turned
                out[cause, col.CURVATURE, i] += share * (
                    intrinsic
                    + station[col.STATION_PER_COMPLIANCE] * mu
                    + station[col.STATION_PER_MOMENT] * moment
                )
                out[cause, col.INTRINSIC_CURVATURE, i] += share * intrinsic
                out[cause, col.MOMENT, i] += share * moment
            for field in range(2):
                for j in range(INNER):
                    joints[field, cause] += AT_END[j] * inner[field, j]
                joints[field, cause] += missing[field]
        before = h
