"""Named columns of every table of the solver, and functions to read a row.

New columns are added here: kernels access every entry by its name, and allocate by the widths. For
a quantity at the four Gauss points of a panel, the name refers to the first of four columns.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined
from pneunet_ros.solver.panel import Four, Law, Mechanics, Turn

# Sections of the rod: start m, rigidity N m^2, moment offset N m, cubic term m^2, axial compliance
# 1/N, rest strain -, line load N/m.
START, RIGIDITY, MOMENT_OFFSET, CUBIC, AXIAL_COMPLIANCE, REST_STRAIN, LOAD_X, LOAD_Y = range(8)
SECTION_WIDTH = 8
# Position of a number of the sections: section and column.
PLACE_SECTION, PLACE_COLUMN = range(2)

# Intrinsic rotation on a piece between two knots, rad: coefficients of s^0 to s^4, s in m from the
# knot before; that of s^1 is the intrinsic curvature there.
CURVATURE_AT_KNOT = 1
ROTATION_WIDTH = 5

# Ends of the rod: angle of the clamp rad, its compliance rad/(N m), transverse offset of the load
# m; then the load F1, F2 in N, M in N m. The record of the clamp is the first five: there the
# force is the weight of what the arm carries at its tip, to which an end load adds.
CLAMP_ANGLE, CLAMP_COMPLIANCE, LOAD_OFFSET, END_X, END_Y, END_MOMENT = range(6)
CLAMP_WIDTH, END_WIDTH = 5, 6

# Loads, and the causes of a sensitivity: F1, F2 in N, M in N m; further causes come after them.
FORCE_X, FORCE_Y, END_LOAD_MOMENT = range(3)
LOADS = 3

# Panels: length m, 1/B in 1/(N m^2), moment offset N m, cubic term m^2, axial compliance 1/N,
# stretch at no force -, force at the start N, its loss over the panel N, intrinsic rotation over
# the panel to its Gauss points and to its end rad, arclength of the start m.
PANEL_LENGTH, PANEL_FLEXIBILITY, PANEL_OFFSET, PANEL_CUBIC, PANEL_AXIAL, PANEL_STRETCH = range(6)
PANEL_FORCE_X, PANEL_FORCE_Y, PANEL_LOSS_X, PANEL_LOSS_Y = range(6, 10)
PANEL_ROTATION, PANEL_ROTATION_END, PANEL_START = 10, 14, 15
PANEL_WIDTH = 16

# Nodes: theta at the start of the panel and at its Gauss points rad, moment at the start N m. The
# last row is the free end, and has no Gauss points.
NODE_THETA, NODE_GAUSS, NODE_MOMENT = 0, 1, 5
NODE_WIDTH = 6

# Slopes of a panel, for Newton: residual at the Gauss points rad; theta rad and moment N m at its
# end beyond the next node's; h dM'/d theta at the Gauss points N m; h d kappa/dM there 1/(N m).
SLOPE_RESIDUAL, SLOPE_THETA_GAP, SLOPE_MOMENT_GAP, SLOPE_OF_MOMENT, SLOPE_OF_THETA = 0, 4, 5, 6, 10
SLOPE_WIDTH = 14

# Steps of Newton on a panel: change at the Gauss points from the residual rad, per theta - and per
# moment 1/(N m) at the start; at the start the state that the clamp leaves free and the particular
# one (rad, N m); component of the particular one along the free one, and the factor that shortened
# the free one.
STEP_RESIDUAL, STEP_PER_THETA, STEP_PER_MOMENT = 0, 4, 8
STEP_FREE_THETA, STEP_FREE_MOMENT, STEP_HELD_THETA, STEP_HELD_MOMENT = range(12, 16)
STEP_ALONG, STEP_SHRINK = 16, 17
STEP_WIDTH = 18

# Common to all causes of a sensitivity on a panel: change at the Gauss points per theta - and per
# moment 1/(N m) at the start, displacement in x and y per change there m/rad, free state and
# shrink.
FREE_PER_THETA, FREE_PER_MOMENT, FREE_WAY_X, FREE_WAY_Y = 0, 4, 8, 12
FREE_THETA, FREE_MOMENT, FREE_SHRINK = range(16, 19)
FREE_WIDTH = 19

# Effect of one cause on a panel: change at the Gauss points, particular state at the start, its
# component along the free one; rad and N m per unit of the cause.
HELD_GAUSS, HELD_THETA, HELD_MOMENT, HELD_ALONG = 0, 4, 5, 6
HELD_WIDTH = 7

# Links of the chain: length m, rigidity N m^2, moment offset N m, cubic term m^2, axial compliance
# 1/N, stretch at no force -, force at mid-link N, intrinsic rotation rad.
LINK_LENGTH, LINK_RIGIDITY, LINK_OFFSET, LINK_CUBIC, LINK_AXIAL, LINK_STRETCH = range(6)
LINK_FORCE_X, LINK_FORCE_Y, LINK_ROTATION = range(6, 9)
LINK_WIDTH = 9

# Fields at stations, in the order of FIELDS: m, m, rad, 1/m, 1/m, N m; x, y, theta of a tip.
FIELDS = ('x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment')
X, Y, THETA, CURVATURE, INTRINSIC_CURVATURE, MOMENT = range(6)
FIELD_COUNT, TIP_WIDTH = 6, 3

# Integrals over a panel: x and y in m, moment N m, curvature change rad.
SERIES_X, SERIES_Y, SERIES_MOMENT, SERIES_BEND = range(4)
SERIES_COUNT = 4

# Change of a panel by one cause: its columns, then theta at the start, at the Gauss points and at
# the end in rad, moment at the start and the end in N m; all per unit of the cause.
CHANGE_THETA, CHANGE_GAUSS, CHANGE_THETA_END, CHANGE_MOMENT, CHANGE_MOMENT_END = 16, 17, 21, 22, 23
CHANGE_WIDTH = 24

# Quantities at a point where a panel is differentiated: sine, cosine, axial and transverse force
# N, stretch -, moment above its offset N m, curvature change 1/m, its slope in 1/B N m and in the
# moment 1/(N m^2).
POINT_SINE, POINT_COSINE, POINT_AXIAL, POINT_TRANSVERSE, POINT_STRETCH = range(5)
POINT_MOMENT, POINT_BEND, POINT_PER_COMPLIANCE, POINT_PER_MOMENT = range(5, 9)
POINT_WIDTH = 9

# Quantities at a station: its position v from -1 to 1 on the panel, slopes in v of the four
# integrals over the panel, and the quantities of the law at a point.
STATION_V, STATION_SLOPES, STATION_MOMENT, STATION_BEND = 0, 1, 5, 6
STATION_PER_COMPLIANCE, STATION_PER_MOMENT, STATION_WIDTH = 7, 8, 9


@inlined
def four(row: Array, first: int) -> Four:
    """Return the entries of a row at the four Gauss points."""
    return row[first], row[first + 1], row[first + 2], row[first + 3]


@inlined
def set_four(row: Array, first: int, values: Four) -> None:
    """Write the entries of a row at the four Gauss points."""
    row[first], row[first + 1], row[first + 2], row[first + 3] = values


@inlined
def powers(row: Array) -> Turn:
    """Return the coefficients of the intrinsic rotation on a piece, of s^0 to s^4."""
    return row[0], row[1], row[2], row[3], row[4]


@inlined
def read_panel(panels: Array, p: int) -> tuple[float, Law, Mechanics, Turn]:
    """Return length, law, mechanics and intrinsic rotation of one panel."""
    row = panels[p]
    law = (row[PANEL_FLEXIBILITY], row[PANEL_OFFSET], row[PANEL_CUBIC])
    mechanics = (
        row[PANEL_AXIAL],
        row[PANEL_STRETCH],
        row[PANEL_FORCE_X],
        row[PANEL_FORCE_Y],
        row[PANEL_LOSS_X],
        row[PANEL_LOSS_Y],
    )
    r1, r2, r3, r4 = four(row, PANEL_ROTATION)
    return row[PANEL_LENGTH], law, mechanics, (r1, r2, r3, r4, row[PANEL_ROTATION_END])


@inlined
def panel_force(row: Array, share: float) -> tuple[float, float]:
    """Return the contact force (N) within a panel, at a share of its length."""
    n1 = row[PANEL_FORCE_X] - share * row[PANEL_LOSS_X]
    return n1, row[PANEL_FORCE_Y] - share * row[PANEL_LOSS_Y]


@inlined
def end_load(ends: Array) -> Four:
    """Return transverse offset, F1, F2 and M of the load on the free end."""
    return ends[LOAD_OFFSET], ends[END_X], ends[END_Y], ends[END_MOMENT]


@inlined
def set_ends(clamp: Array, load: Array, ends: Array) -> None:
    """Join the record of the clamp (5,) and the load (3,) to the ends of a rod (6,)."""
    for i in range(END_X):
        ends[i] = clamp[i]
    ends[END_X] = clamp[END_X] + load[FORCE_X]
    ends[END_Y] = clamp[END_Y] + load[FORCE_Y]
    ends[END_MOMENT] = load[END_LOAD_MOMENT]


def join_ends(clamp: Array, loads: Array) -> Array:
    """Return the ends (n, 6) of rods with these records of the clamp (n, 5) and loads (n, 3)."""
    ends = np.zeros((len(clamp), END_WIDTH))
    ends[:, :CLAMP_WIDTH] = clamp
    ends[:, END_X:] += loads
    return ends


@inlined
def write(values: Array, out: Array) -> None:
    """Copy a table over another of the same shape.

    With an array assignment, numba would also compile the text of its errors.
    """
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            out[row, column] = values[row, column]
