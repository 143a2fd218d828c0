"""Effects with history in the lab arm, integrated in small time steps."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel


@kernel
def lag_pressure(
    time: Array, pressure: Array, start: float, filling: float, emptying: float
) -> Array:
    """Return the pressure (Pa) behind a line that fills and empties with these time constants (s).

    time (n,) s, pressure (n,) Pa before the line, start: behind it at time[0].
    """
    behind = np.empty(time.size)
    behind[0] = start
    for k in range(1, time.size):
        before = 0.5 * (pressure[k - 1] + pressure[k])
        constant = filling if before > behind[k - 1] else emptying
        part = 1.0
        if constant > 0.0:
            part = 1.0 - math.exp(-(time[k] - time[k - 1]) / constant)
        else:
            before = pressure[k]
        behind[k] = behind[k - 1] + part * (before - behind[k - 1])
    return behind


@kernel
def play_pressure(pressure: Array, start: Array, half_widths: Array) -> Array:
    """Return the outputs (n, plays) of plays with these half widths (Pa), starting at `start`."""
    answers = np.empty((pressure.size, start.size))
    for i in range(start.size):
        here, half = start[i], half_widths[i]
        for k in range(pressure.size):
            here = min(max(here, pressure[k] - half), pressure[k] + half)
            answers[k, i] = here
    return answers


@kernel
def relax_curvature(time: Array, wanted: Array, start: Array, constant: float) -> Array:
    """Return columns (n, columns) that follow `wanted` (n, columns) with a time constant (s)."""
    answers = np.empty(wanted.shape)
    answers[0] = start
    for k in range(1, time.size):
        part = 1.0
        if constant > 0.0:
            part = 1.0 - math.exp(-(time[k] - time[k - 1]) / constant)
        for i in range(wanted.shape[1]):
            middle = 0.5 * (wanted[k - 1, i] + wanted[k, i])
            answers[k, i] = answers[k - 1, i] + part * (middle - answers[k - 1, i])
    return answers


@kernel
def largest_so_far(time: Array, pressure: Array, start: float, forgetting: float) -> Array:
    """Return the largest pressure (Pa) so far, decaying at this rate (1/s) until reached again."""
    largest = np.empty(time.size)
    here = max(start, pressure[0])
    largest[0] = here
    for k in range(1, time.size):
        here -= (here - pressure[k]) * (1.0 - math.exp(-forgetting * (time[k] - time[k - 1])))
        here = max(here, pressure[k])
        largest[k] = here
    return largest
