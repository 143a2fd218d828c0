"""Initial guess for the loaded rod: energy descent of a short chain.

Energy descent ends at a stable equilibrium from any start, unlike Newton's method on the equations
of the rod. It needs positive rigidity. The chain is accurate to second order in the element
length, which is enough for Newton's method to take over.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.columns import end_load, panel_force
from pneunet_ros.solver.panel import (
    free_end,
    GAUSS_ABSCISSAE,
    GAUSS_POINTS,
    GAUSS_WEIGHTS,
    resolve,
    sine_cosine,
)
from pneunet_ros.solver.settings import DESCENT_HALVINGS, DESCENT_ITERATIONS, LARGEST_STEP, SETTLED


@inner
def chain_energy(
    links: Array, ends: Array, theta: Array, gradient: Array, diagonal: Array, coupling: Array
) -> float:
    """Return the energy (J) of a chain with joint angles theta; fills gradient and Hessian.

    The tangent of a link is that of its mean angle.
    """
    count = len(links)
    for j in range(count + 1):
        gradient[j], diagonal[j] = 0.0, 0.0
    energy = 0.0
    for j in range(count):
        link = links[j]
        h, rigidity, offset = link[col.LINK_LENGTH], link[col.LINK_RIGIDITY], link[col.LINK_OFFSET]
        cubic, axial, rest = link[col.LINK_CUBIC], link[col.LINK_AXIAL], link[col.LINK_STRETCH]
        d = (theta[j + 1] - theta[j] - link[col.LINK_ROTATION]) / h
        middle = 0.5 * (theta[j] + theta[j + 1])
        sine, cosine = sine_cosine(middle)
        t, u = resolve(sine, cosine, link[col.LINK_FORCE_X], link[col.LINK_FORCE_Y])
        stretch = rest + axial * t
        energy += h * (offset * d + 0.5 * rigidity * d * d * (1.0 + 0.5 * cubic * d * d))
        energy -= h * t * (rest + 0.5 * axial * t)
        moment = offset + rigidity * d * (1.0 + cubic * d * d)
        stiffness = rigidity * (1.0 + 3.0 * cubic * d * d) / h
        gradient[j] -= moment + 0.5 * h * stretch * u
        gradient[j + 1] += moment - 0.5 * h * stretch * u
        bend = 0.25 * h * (stretch * t - axial * u * u)
        diagonal[j] += stiffness + bend
        diagonal[j + 1] += stiffness + bend
        coupling[j] = bend - stiffness
    sine, cosine = sine_cosine(float(theta[count]))
    offset = ends[col.LOAD_OFFSET]
    across = ends[col.END_X] * cosine + ends[col.END_Y] * sine
    along = ends[col.END_Y] * cosine - ends[col.END_X] * sine
    energy -= ends[col.END_MOMENT] * theta[count] + offset * along
    gradient[count] += offset * across - ends[col.END_MOMENT]
    diagonal[count] += offset * along
    compliance = ends[col.CLAMP_COMPLIANCE]
    if compliance > 0.0:
        given = theta[0] - ends[col.CLAMP_ANGLE]
        energy += 0.5 * given * given / compliance
        gradient[0] += given / compliance
        diagonal[0] += 1.0 / compliance
    else:
        gradient[0], diagonal[0], coupling[0] = 0.0, 1.0, 0.0
    return energy


@inner
def descend(links: Array, ends: Array, theta: Array, most_iterations: int) -> None:
    """Minimize the energy in place, by Newton's method with line search, always downhill."""
    count = len(links)
    size = count + 1
    gradient, diagonal, coupling = np.empty(size), np.empty(size), np.empty(size)
    step, trial = np.empty(size), np.empty(size)
    energy = chain_energy(links, ends, theta, gradient, diagonal, coupling)
    length, softest = 0.0, np.inf
    for j in range(count):
        length += links[j, col.LINK_LENGTH]
        softest = min(softest, links[j, col.LINK_RIGIDITY])
    softest *= 0.01 / length
    for _ in range(most_iterations):
        for j in range(size):  # factor L D L^T, pivots kept positive
            pivot = abs(diagonal[j])
            diagonal[j] = max(pivot, softest)
            if j < count:
                lower = coupling[j] / diagonal[j]
                diagonal[j + 1] -= lower * coupling[j]
                gradient[j + 1] -= lower * gradient[j]
                coupling[j] = lower
        largest = 0.0
        for j in range(count, -1, -1):
            step[j] = -gradient[j] / diagonal[j]
            if j < count:
                step[j] -= coupling[j] * step[j + 1]
            largest = max(largest, abs(step[j]))
        if not largest < 1e300:
            return
        reach = min(1.0, LARGEST_STEP / largest) if largest > 0.0 else 1.0
        for _halving in range(DESCENT_HALVINGS):
            for j in range(size):
                trial[j] = theta[j] + reach * step[j]
            lowered = chain_energy(links, ends, trial, gradient, diagonal, coupling)
            if lowered <= energy:
                break
            reach *= 0.5
        for j in range(size):
            theta[j] = trial[j]
        energy = lowered
        if largest * reach < SETTLED:
            return


@inner
def chain_of(panels: Array) -> Array:
    """Return the chain with two links on every panel."""
    links = np.empty((2 * len(panels), col.LINK_WIDTH))
    for p in range(len(panels)):
        panel = panels[p]
        half = 0.5 * (panel[col.PANEL_ROTATION + 1] + panel[col.PANEL_ROTATION + 2])
        for i in range(2):
            link = links[2 * p + i]
            link[col.LINK_LENGTH] = 0.5 * panel[col.PANEL_LENGTH]
            link[col.LINK_RIGIDITY] = 1.0 / panel[col.PANEL_FLEXIBILITY]
            link[col.LINK_OFFSET], link[col.LINK_CUBIC] = (
                panel[col.PANEL_OFFSET],
                panel[col.PANEL_CUBIC],
            )
            link[col.LINK_AXIAL], link[col.LINK_STRETCH] = (
                panel[col.PANEL_AXIAL],
                panel[col.PANEL_STRETCH],
            )
            link[col.LINK_FORCE_X], link[col.LINK_FORCE_Y] = panel_force(panel, 0.25 + 0.5 * i)
            link[col.LINK_ROTATION] = half if i == 0 else panel[col.PANEL_ROTATION_END] - half
    return links


@kernel
def loaded_guess(panels: Array, ends: Array, nodes: Array) -> None:
    """Fill `nodes` with the loaded shape of a chain of two links on every panel."""
    count = len(panels)
    links = chain_of(panels)
    theta = np.empty(2 * count + 1)
    theta[0] = ends[col.CLAMP_ANGLE]
    for j in range(2 * count):
        theta[j + 1] = theta[j] + links[j, col.LINK_ROTATION]
    descend(links, ends, theta, DESCENT_ITERATIONS)
    nodes[count, col.NODE_THETA] = theta[2 * count]
    nodes[count, col.NODE_MOMENT], _ = free_end(end_load(ends), theta[2 * count])
    for p in range(count - 1, -1, -1):
        panel, node = panels[p], nodes[p]
        start = theta[2 * p]
        node[col.NODE_THETA] = start
        middle = theta[2 * p + 1] - start - links[2 * p, col.LINK_ROTATION]
        last = theta[2 * p + 2] - start - panel[col.PANEL_ROTATION_END]
        moment = nodes[p + 1, col.NODE_MOMENT]
        for i in range(GAUSS_POINTS):  # a parabola for the rotation added to the intrinsic one
            u = GAUSS_ABSCISSAE[i]
            bend = u * (4.0 * middle - last + u * (2.0 * last - 4.0 * middle))
            angle = start + panel[col.PANEL_ROTATION + i] + bend
            node[col.NODE_GAUSS + i] = angle
            sine, cosine = sine_cosine(angle)
            n1, n2 = panel_force(panel, u)
            along, across = resolve(sine, cosine, n1, n2)
            stretch = panel[col.PANEL_STRETCH] + panel[col.PANEL_AXIAL] * along
            moment += panel[col.PANEL_LENGTH] * GAUSS_WEIGHTS[i] * stretch * across
        node[col.NODE_MOMENT] = moment
