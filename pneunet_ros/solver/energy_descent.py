"""A first guess for the loaded rod: a short chain that descends in energy.

Descent in energy ends at a stable equilibrium from any start, which Newton on the rod's equations
does not. It needs positive rigidity. Second order in the element length, which is enough for
Newton to take over.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import kernel
from pneunet_ros.solver.panel import GAUSS_ABSCISSAE, GAUSS_WEIGHTS, resolve, sine_cosine

Array = npt.NDArray[np.float64]

SETTLED = 0.02  # rad; a smaller step leaves the rest to Newton
LARGEST_STEP = 0.6  # rad


@kernel
def chain_energy(
    links: Array, ends: Array, theta: Array, gradient: Array, diagonal: Array, beside: Array
) -> float:
    """Energy (J) of the chain with joint angles theta, its gradient and tridiagonal Hessian.

    links[j] = length, rigidity, moment offset, cubic term, axial compliance, stretch, n1, n2 at
    mid-link, turning of the unloaded link. The tangent of a link is that of its mean angle.
    """
    count = links.shape[0]
    for j in range(count + 1):
        gradient[j], diagonal[j] = 0.0, 0.0
    energy = 0.0
    for j in range(count):
        link = links[j]
        h, rigidity, offset, cubic, axial = link[0], link[1], link[2], link[3], link[4]
        stretch, n1, n2, turned = link[5], link[6], link[7], link[8]
        d = (theta[j + 1] - theta[j] - turned) / h
        middle = 0.5 * (theta[j] + theta[j + 1])
        sine, cosine = sine_cosine(middle)
        t, u = resolve(sine, cosine, n1, n2)
        stretched = stretch + axial * t
        energy += h * (offset * d + 0.5 * rigidity * d * d * (1.0 + 0.5 * cubic * d * d))
        energy -= h * t * (stretch + 0.5 * axial * t)
        moment = offset + rigidity * d * (1.0 + cubic * d * d)
        stiffness = rigidity * (1.0 + 3.0 * cubic * d * d) / h
        gradient[j] -= moment + 0.5 * h * stretched * u
        gradient[j + 1] += moment - 0.5 * h * stretched * u
        bend = 0.25 * h * (stretched * t - axial * u * u)
        diagonal[j] += stiffness + bend
        diagonal[j + 1] += stiffness + bend
        beside[j] = bend - stiffness
    sine, cosine = sine_cosine(float(theta[count]))
    across = ends[3] * cosine + ends[4] * sine
    along = ends[4] * cosine - ends[3] * sine
    energy -= ends[5] * theta[count] + ends[2] * along
    gradient[count] += ends[2] * across - ends[5]
    diagonal[count] += ends[2] * along
    if ends[1] > 0.0:
        given = theta[0] - ends[0]
        energy += 0.5 * given * given / ends[1]
        gradient[0] += given / ends[1]
        diagonal[0] += 1.0 / ends[1]
    else:
        gradient[0], diagonal[0], beside[0] = 0.0, 1.0, 0.0
    return energy


@kernel
def descend(links: Array, ends: Array, theta: Array, most_iterations: int) -> None:
    """Newton in energy with line search, in place; indefinite directions are turned downhill."""
    count = links.shape[0]
    size = count + 1
    gradient, diagonal, beside = np.empty(size), np.empty(size), np.empty(size)
    step, trial = np.empty(size), np.empty(size)
    energy = chain_energy(links, ends, theta, gradient, diagonal, beside)
    length, softest = 0.0, np.inf
    for j in range(count):
        length += links[j, 0]
        softest = min(softest, links[j, 1])
    softest *= 0.01 / length
    for _ in range(most_iterations):
        for j in range(size):  # factor L D L^T, pivots kept positive
            pivot = abs(diagonal[j])
            diagonal[j] = max(pivot, softest)
            if j < count:
                lower = beside[j] / diagonal[j]
                diagonal[j + 1] -= lower * beside[j]
                gradient[j + 1] -= lower * gradient[j]
                beside[j] = lower
        largest = 0.0
        for j in range(count, -1, -1):
            step[j] = -gradient[j] / diagonal[j]
            if j < count:
                step[j] -= beside[j] * step[j + 1]
            largest = max(largest, abs(step[j]))
        if not largest < 1e300:
            return
        reach = min(1.0, LARGEST_STEP / largest) if largest > 0.0 else 1.0
        for _halving in range(12):
            for j in range(size):
                trial[j] = theta[j] + reach * step[j]
            lowered = chain_energy(links, ends, trial, gradient, diagonal, beside)
            if lowered <= energy:
                break
            reach *= 0.5
        for j in range(size):
            theta[j] = trial[j]
        energy = lowered
        if largest * reach < SETTLED:
            return


@kernel
def chain_of(panels: Array) -> Array:
    """Two links on every panel, with the columns that `chain_energy` reads."""
    links = np.empty((2 * panels.shape[0], 9))
    for p in range(panels.shape[0]):
        panel = panels[p]
        half = 0.5 * (panel[11] + panel[12])
        for i in range(2):
            link = links[2 * p + i]
            u = 0.25 + 0.5 * i
            link[0], link[1], link[2] = 0.5 * panel[0], 1.0 / panel[1], panel[2]
            link[3], link[4], link[5] = panel[3], panel[4], panel[5]
            link[6] = panel[6] - u * panel[8]
            link[7] = panel[7] - u * panel[9]
            link[8] = half if i == 0 else panel[14] - half
    return links


@kernel
def loaded_guess(panels: Array, ends: Array, nodes: Array) -> None:
    """Fill `nodes` with the loaded shape of a chain of two links on every panel."""
    count = panels.shape[0]
    links = chain_of(panels)
    theta = np.empty(2 * count + 1)
    theta[0] = ends[0]
    for j in range(2 * count):
        theta[j + 1] = theta[j] + links[j, 8]
    descend(links, ends, theta, 60)
    sine, cosine = sine_cosine(theta[2 * count])
    nodes[count, 0] = theta[2 * count]
    nodes[count, 5] = ends[5] - ends[2] * (ends[3] * cosine + ends[4] * sine)
    for p in range(count - 1, -1, -1):
        panel, node = panels[p], nodes[p]
        node[0] = theta[2 * p]
        middle = theta[2 * p + 1] - theta[2 * p] - links[2 * p, 8]
        last = theta[2 * p + 2] - theta[2 * p] - panel[14]
        moment = nodes[p + 1, 5]
        for i in range(4):  # a parabola for the turning beside that of the unloaded rod
            u = GAUSS_ABSCISSAE[i]
            bent = u * (4.0 * middle - last + u * (2.0 * last - 4.0 * middle))
            node[1 + i] = theta[2 * p] + panel[10 + i] + bent
            sine, cosine = sine_cosine(node[1 + i])
            along, across = resolve(sine, cosine, panel[6] - u * panel[8], panel[7] - u * panel[9])
            moment += panel[0] * GAUSS_WEIGHTS[i] * (panel[5] + panel[4] * along) * across
        node[5] = moment
