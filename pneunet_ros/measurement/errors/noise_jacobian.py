"""Response to one sigma of each reading and of the model, and the resulting covariance."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.solver.columns import LOADS

PRESSURE = LOADS  # index of the chamber pressure among the causes of a sensitivity


def noise_jacobian(
    table: PerturbationTable, reading: Load, std: tuple[float, float, float, float]
) -> Array:
    """Return the noise input matrix: the change of every cause by one sigma of each error source.

    reading: pressure (Pa) and wrench (N, N m) of the sensors; std of F1, F2, M and the pressure.
    Returns (sources, causes), both in the order F1, F2, M, pressure, columns of the model's
    covariance; the causes are those of `model.equilibrium.linearize_shape`. Sensing effects change
    the response to a reading error, and columns of the model covariance change the meaning of a
    reading.
    """
    columns = table.distance.size - 1
    size = PRESSURE + 1 + columns
    jacobian = np.zeros((size, size))
    jacobian.flat[:: size + 1] = (*std, *(1.0,) * columns)
    if not table.arm.sensing:
        return jacobian
    base = (reading.force_x, reading.force_y, reading.moment, reading.pressure)
    correction = true_load(table.arm, base) - base
    for source, sigma in enumerate(std):
        shifted = (*base[:source], base[source] + sigma, *base[source + 1 :])
        jacobian[source, : PRESSURE + 1] += true_load(table.arm, shifted) - shifted - correction
    for column in range(columns):
        before, after = (table.neighbors[column], table.neighbors[columns + column])
        change = true_load(after, base) - true_load(before, base)
        jacobian[PRESSURE + 1 + column, : PRESSURE + 1] = change / table.distance[1 + column]
    return jacobian


def true_load(arm: Arm, load: tuple[float, ...]) -> Array:
    """Return the true F1, F2, M and pressure for given readings, in this order."""
    true = arm.sense(Load(force_x=load[0], force_y=load[1], moment=load[2], pressure=load[3]))
    return np.array([true.force_x, true.force_y, true.moment, true.pressure])


@kernel
def propagate_covariance(
    noise: Array, tip: Array, stations: Array, added: Array, covariance: Array, std: Array
) -> bool:
    """Propagate errors through a linear response; return whether the result is finite.

    noise (sources, causes): the noise input matrix; tip (causes, 3) and stations (causes, 6,
    stations) are the sensitivities; added (3, stations): an additional independent error of x, y
    (m) and theta (rad). Fills covariance (3, 3) of x, y, theta of the tip, and std (3, stations)
    of x, y and curvature.
    """
    sources, causes, count = noise.shape[0], noise.shape[1], stations.shape[2]
    size = len(std)  # a number here would compile the loops once per length
    tip_change, change = np.zeros((sources, size)), np.empty(count)
    for source in range(sources):
        for cause in range(causes):
            for i in range(size):
                tip_change[source, i] += noise[source, cause] * tip[cause, i]
    total = 0.0
    for i in range(size):
        for j in range(size):
            covariance[i, j] = added[i, -1] * added[j, -1]
            for source in range(sources):
                covariance[i, j] += tip_change[source, i] * tip_change[source, j]
            total += covariance[i, j]
    for i in range(size):
        field = 3 if i == 2 else i  # curvature is the fourth field of a station
        for station in range(count):
            std[i, station] = 0.0 if i == 2 else added[i, station] * added[i, station]
        for source in range(sources):
            change[:] = 0.0
            for cause in range(causes):
                weight = noise[source, cause]
                for station in range(count):  # the inner loops become vector instructions
                    change[station] += weight * stations[cause, field, station]
            for station in range(count):
                std[i, station] += change[station] * change[station]
        for station in range(count):
            std[i, station] = math.sqrt(std[i, station])
            total += std[i, station]
    return math.isfinite(total)
