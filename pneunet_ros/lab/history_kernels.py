"""Effects with history on the lab arm, integrated in small time steps."""

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

    time (n,) s, pressure (n,) Pa: before the line; start (Pa): behind the line at time[0].
    """
    lagging = np.empty(time.size)
    lagging[0] = start
    for k in range(1, time.size):
        driving = 0.5 * (pressure[k - 1] + pressure[k])
        constant = filling if driving > lagging[k - 1] else emptying
        part = 1.0
        if constant > 0.0:
            part = 1.0 - math.exp(-(time[k] - time[k - 1]) / constant)
        else:
            driving = pressure[k]
        lagging[k] = lagging[k - 1] + part * (driving - lagging[k - 1])
    return lagging


@kernel
def play_pressure(pressure: Array, start: Array, half_widths: Array) -> Array:
    """Return the outputs (n, plays) of plays with these half widths (Pa), starting at `start`."""
    outputs = np.empty((pressure.size, start.size))
    for i in range(start.size):
        output, half = start[i], half_widths[i]
        for k in range(pressure.size):
            output = min(max(output, pressure[k] - half), pressure[k] + half)
            outputs[k, i] = output
    return outputs


@kernel
def relax_curvature(time: Array, target: Array, start: Array, constant: float) -> Array:
    """Return columns (n, columns) that follow `target` (n, columns) with a time constant (s)."""
    outputs = np.empty(target.shape)
    outputs[0] = start
    for k in range(1, time.size):
        part = 1.0
        if constant > 0.0:
            part = 1.0 - math.exp(-(time[k] - time[k - 1]) / constant)
        for i in range(target.shape[1]):
            middle = 0.5 * (target[k - 1, i] + target[k, i])
            outputs[k, i] = outputs[k - 1, i] + part * (middle - outputs[k - 1, i])
    return outputs


@kernel
def largest_so_far(time: Array, pressure: Array, start: float, forgetting: float) -> Array:
    """Return the largest pressure (Pa) so far, decaying at this rate (1/s) until reached again."""
    largest = np.empty(time.size)
    current = max(start, pressure[0])
    largest[0] = current
    for k in range(1, time.size):
        current -= (current - pressure[k]) * (
            1.0 - math.exp(-forgetting * (time[k] - time[k - 1]))
        )
        current = max(current, pressure[k])
        largest[k] = current
    return largest
