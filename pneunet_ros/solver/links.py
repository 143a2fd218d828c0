"""A solved rod as a chain of equal links, the form in which its motion is computed.

Link i is straight, with the heading of the rod in its middle, and begins with a joint that has the
stiffness of the rod. Frequencies and shapes are second-order accurate in the length of a link.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.columns import panel_force, read_panel
from pneunet_ros.solver.panel import C1, C2, C3, C4, curvature_change, resolve, sine_cosine

ABSCISSAE = np.array([0.0, C1, C2, C3, C4, 1.0])  # places on a panel at which nodes have theta


class Links(NamedTuple):
    """An equilibrium of a rod as n links.

    heading (n,) rad; length (n,) m; compliance (n,) rad/(N m) of the joint at the beginning of
    each, for small changes; force (n, 2) N, the contact force in the middle of each. offset m:
    distance across the tip at which the end load acts; turn_rate rad/s of the base.
    """

    heading: Array
    length: Array
    compliance: Array
    force: Array
    offset: float
    turn_rate: float


class Masses(NamedTuple):
    """Masses of a chain: mass (n,) kg of the links, spread evenly; tip (kg) at its end."""

    mass: Array
    tip: float


def room_for_links(count: int, offset: float = 0.0, turn_rate: float = 0.0) -> Links:
    """Return an uninitialized chain of this many links; offset, turn_rate: see `Links`."""
    return Links(
        heading=np.empty(count),
        length=np.empty(count),
        compliance=np.empty(count),
        force=np.empty((count, 2)),
        offset=offset,
        turn_rate=turn_rate,
    )


def links_of(panels: Array, ends: Array, nodes: Array, count: int) -> Links:
    """Return a solved rod (tables as in `solver.columns`) as a chain of this many links."""
    links = room_for_links(count, float(ends[col.LOAD_OFFSET]))
    cut_links(panels, ends, nodes, links.heading, links.length, links.compliance, links.force)
    return links


@kernel
def cut_links(
    panels: Array,
    ends: Array,
    nodes: Array,
    heading: Array,
    length: Array,
    compliance: Array,
    force: Array,
) -> None:
    """Fill the tables of `Links` from those of a solved rod."""
    count = heading.size
    last = len(panels) - 1
    reach = panels[last, col.PANEL_START] + panels[last, col.PANEL_LENGTH]
    p, passed = 0, ends[col.CLAMP_COMPLIANCE]  # compliance up to panel p
    before = 0.0
    for i in range(count):
        s = reach * (i + 0.5) / count
        while p < last and s >= panels[p + 1, col.PANEL_START]:
            passed += panels[p, col.PANEL_LENGTH] * bending_compliance(panels, nodes, p)
            p += 1
        row = panels[p]
        share = (s - row[col.PANEL_START]) / row[col.PANEL_LENGTH]
        k = 0
        while k < ABSCISSAE.size - 2 and share >= ABSCISSAE[k + 1]:
            k += 1
        low = nodes[p, k]
        high = nodes[p, k + 1] if k + 2 < ABSCISSAE.size else nodes[p + 1, col.NODE_THETA]
        weight = (share - ABSCISSAE[k]) / (ABSCISSAE[k + 1] - ABSCISSAE[k])
        heading[i] = (1.0 - weight) * low + weight * high
        force[i, 0], force[i, 1] = panel_force(row, share)
        sine, cosine = sine_cosine(heading[i])
        axial, _ = resolve(sine, cosine, force[i, 0], force[i, 1])
        length[i] = reach / count * (row[col.PANEL_STRETCH] + row[col.PANEL_AXIAL] * axial)
        to_here = passed + share * row[col.PANEL_LENGTH] * bending_compliance(panels, nodes, p)
        compliance[i] = to_here - before
        before = to_here


@kernel
def bending_compliance(panels: Array, nodes: Array, p: int) -> float:
    """Return d kappa / d M, 1/(N m^2), in the middle of a panel."""
    _, law, _, _ = read_panel(panels, p)
    moment = 0.5 * (nodes[p, col.NODE_MOMENT] + nodes[p + 1, col.NODE_MOMENT])
    _, compliance = curvature_change(moment, law)
    return compliance


def center_derivatives(links: Links) -> Array:
    """Return derivatives of link centers and tip by the link angles, (2, n + 1, n) m."""
    count = links.heading.size
    beyond = np.tril(np.ones((count + 1, count)), -1)
    beyond[np.arange(count), np.arange(count)] = 0.5
    across = links.length * np.stack([-np.sin(links.heading), np.cos(links.heading)])
    return np.asarray(beyond * across[:, None, :])


def mass_matrix(links: Links, masses: Masses) -> Array:
    """Return the inertia matrix (n, n) kg m^2 of the chain for rotations of its links."""
    way = center_derivatives(links)
    inertia = np.append(masses.mass, masses.tip)
    matrix = np.einsum('dki,k,dkj->ij', way, inertia, way)
    matrix[np.diag_indices_from(matrix)] += masses.mass * links.length**2 / 12.0
    return np.asarray(matrix)


def bending_stiffness(links: Links) -> Array:
    """Return the stiffness matrix (n, n) N m/rad of the joints for rotations of the links."""
    stiffness = 1.0 / links.compliance
    matrix = np.diag(stiffness + np.append(stiffness[1:], 0.0))
    between = np.arange(stiffness.size - 1)
    matrix[between, between + 1] = matrix[between + 1, between] = -stiffness[1:]
    return matrix


def stiffness_matrix(links: Links) -> Array:
    """Return the second variation (n, n) N m/rad of the energy, including its dead loads."""
    cosine, sine = np.cos(links.heading), np.sin(links.heading)
    along = links.length * (links.force[:, 0] * cosine + links.force[:, 1] * sine)
    along[-1] += links.offset * (links.force[-1, 1] * cosine[-1] - links.force[-1, 0] * sine[-1])
    return bending_stiffness(links) + np.diag(along)
