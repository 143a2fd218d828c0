"""The lab arm as a chain: its energy, and its minimization by Newton's method.

The chain consists of straight elements joined by bending springs. Its unknowns are the tangent
angles at the clamp, of every element, and at the free end. The code shares nothing with the solver
of the model.

`numbers` are, in this order: element length m, clamp angle rad, clamp compliance rad/(N m), its
hardening 1/rad^2, axial compliance 1/N, its growth -, cubic term m^2, quintic term m^4, offset of
the end force across and along the arm m.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel

SETTLED = 1e-11  # rad, largest last step
NEAR = 1e-6  # rad, step up to which a full step is taken
MOST_STEPS = 80
LONGEST_STEP = 0.5  # rad
LOAD_STEPS = 24  # of the way back from the unloaded arm


@inner
def bending_moment(
    d: float, rigidity: float, cubic: float, quintic: float
) -> tuple[float, float, float]:
    """Return energy per length (N), moment (N m), stiffness (N m^2) at a curvature d from rest."""
    q = d * d
    energy = rigidity * q * (0.5 + q * (0.25 * cubic + q * quintic / 6.0))
    moment = rigidity * d * (1.0 + q * (cubic + q * quintic))
    return energy, moment, rigidity * (1.0 + q * (3.0 * cubic + 5.0 * q * quintic))


@inner
def joint(
    turn: float,
    before: float,
    after: float,
    first: float,
    second: float,
    cubic: float,
    quintic: float,
) -> tuple[float, float, float]:
    """Return energy (J), moment (N m) and stiffness (N m) of a joint turned by `turn` beyond rest.

    before, after (m): the lengths of its part of the arm on either side of l1, where the rigidity
    changes from `first` to `second`. Both sides carry the same moment.
    """
    if after <= 0.0 or before <= 0.0:
        span = before if after <= 0.0 else after
        rigidity = first if after <= 0.0 else second
        energy, moment, stiffness = bending_moment(turn / span, rigidity, cubic, quintic)
        return span * energy, moment, stiffness / span
    d = turn * second / (before * second + after * first)
    e1, m1, k1 = bending_moment(d, first, cubic, quintic)
    e2, m2, k2 = bending_moment((turn - before * d) / after, second, cubic, quintic)
    for _ in range(30):
        step = (m1 - m2) / (k1 + k2 * before / after)
        d -= step
        e1, m1, k1 = bending_moment(d, first, cubic, quintic)
        e2, m2, k2 = bending_moment((turn - before * d) / after, second, cubic, quintic)
        if abs(step) <= 1e-13 * (1.0 + abs(d)):
            break
    return before * e1 + after * e2, 0.5 * (m1 + m2), 1.0 / (before / k1 + after / k2)


class ChainFrame(NamedTuple):
    """The chain in one frame.

    turning (n + 1,) rad of the unloaded joints and factor (n + 1,) of their rigidity, rest (n,)
    strain and line (n, 2) N of the elements; load = rigidities (2), l1, force (2), moment;
    numbers as above.
    """

    turning: Array
    factor: Array
    rest: Array
    line: Array
    load: Array
    numbers: Array


@inner
def energy_of(
    angles: Array,
    frame: ChainFrame,
    share: float,
    gradient: Array,
    diagonal: Array,
    off_diagonal: Array,
) -> float:
    """Return the energy (J) of the chain; fills its gradient and tridiagonal Hessian.

    angles (n + 2,); share of all loads.
    """
    turning, factor, rest, line, load, numbers = frame
    count = rest.shape[0]
    h, axial, growth = numbers[0], numbers[4], numbers[5]
    force_x, force_y, end_moment = share * load[3], share * load[4], share * load[5]
    for i in range(count + 2):
        gradient[i], diagonal[i] = 0.0, 0.0
    energy: float = 0.0
    for j in range(count + 1):
        low = max(0.0, (j - 0.5) * h)
        high = min(count * h, (j + 0.5) * h)
        before = min(max(load[2] - low, 0.0), high - low)
        part, moment, stiffness = joint(
            angles[j + 1] - angles[j] - turning[j],
            before,
            high - low - before,
            load[0],
            load[1],
            numbers[6],
            numbers[7],
        )
        part, moment, stiffness = factor[j] * part, factor[j] * moment, factor[j] * stiffness
        energy += part
        gradient[j] -= moment
        gradient[j + 1] += moment
        diagonal[j] += stiffness
        diagonal[j + 1] += stiffness
        off_diagonal[j] = -stiffness
    for i in range(count):
        sine, cosine = math.sin(angles[i + 1]), math.cos(angles[i + 1])
        n1, n2 = force_x + share * line[i, 0], force_y + share * line[i, 1]
        axial_force, transverse = n1 * cosine + n2 * sine, n2 * cosine - n1 * sine
        strain = axial * axial_force
        length = 1.0 + rest[i] + strain * (1.0 + growth * strain)
        energy -= h * axial_force * (1.0 + rest[i] + strain * (0.5 + growth * strain / 3.0))
        gradient[i + 1] -= h * length * transverse
        slope = axial * (1.0 + 2.0 * growth * strain)
        diagonal[i + 1] += h * (length * axial_force - slope * transverse * transverse)
    sine, cosine = math.sin(angles[count + 1]), math.cos(angles[count + 1])
    axial_force, transverse = force_x * cosine + force_y * sine, force_y * cosine - force_x * sine
    energy -= numbers[8] * transverse + numbers[9] * axial_force + end_moment * angles[count + 1]
    gradient[count + 1] += numbers[8] * axial_force - numbers[9] * transverse - end_moment
    diagonal[count + 1] += numbers[8] * transverse + numbers[9] * axial_force
    if numbers[2] > 0.0:
        clamp_turn = angles[0] - numbers[1]
        hardening = numbers[3] * clamp_turn * clamp_turn
        energy += 0.5 * clamp_turn * clamp_turn / numbers[2] * (1.0 + 0.5 * hardening)
        gradient[0] += clamp_turn / numbers[2] * (1.0 + hardening)
        diagonal[0] += (1.0 + 3.0 * hardening) / numbers[2]
    else:
        gradient[0], diagonal[0], off_diagonal[0] = 0.0, 1.0, 0.0
    return energy


@inner
def settle(angles: Array, frame: ChainFrame, share: float, work: Array) -> float:
    """Minimize the energy over the angles, in place; returns the last step in rad.

    work (5, n + 2) is scratch. A step is shortened until it lowers the energy; negative pivots of
    the matrix change sign, so that the direction is always downhill.
    """
    size = angles.shape[0]
    gradient, diagonal, off_diagonal, step, trial = work[0], work[1], work[2], work[3], work[4]
    energy = energy_of(angles, frame, share, gradient, diagonal, off_diagonal)
    load = frame.load
    floor = 1e-3 * min(load[0], load[1]) / (frame.numbers[0] * frame.rest.shape[0])
    largest = math.inf
    for _ in range(MOST_STEPS):
        diagonal[0] = max(abs(diagonal[0]), floor)
        for i in range(1, size):
            ratio = off_diagonal[i - 1] / diagonal[i - 1]
            diagonal[i] = max(abs(diagonal[i] - ratio * off_diagonal[i - 1]), floor)
            gradient[i] -= ratio * gradient[i - 1]
        step[size - 1] = -gradient[size - 1] / diagonal[size - 1]
        largest = abs(step[size - 1])
        for i in range(size - 2, -1, -1):
            step[i] = -(gradient[i] + off_diagonal[i] * step[i + 1]) / diagonal[i]
            largest = max(largest, abs(step[i]))
        if not largest < 1e100:
            return math.inf
        if largest < SETTLED:
            for i in range(size):
                angles[i] += step[i]
            break
        reach = min(1.0, LONGEST_STEP / max(largest, 1e-300))
        lowered = energy
        for _halving in range(20):
            for i in range(size):
                trial[i] = angles[i] + reach * step[i]
            lowered = energy_of(trial, frame, share, gradient, diagonal, off_diagonal)
            # The effect of a very small step on the energy cannot be distinguished from rounding.
            if largest < NEAR or lowered <= energy + 1e-14 * abs(energy):
                break
            reach *= 0.5
        for i in range(size):
            angles[i] = trial[i]
        energy = lowered
    return largest


@kernel
def equilibria(
    turning: Array,
    factor: Array,
    rest: Array,
    line: Array,
    loads: Array,
    numbers: Array,
    angles: Array,
    has_start: bool,
) -> int:
    """Solve the frames in order, each from the previous one; return the number of solved frames.

    turning and factor (frames, n + 1), rest (frames, n), line (frames, n, 2), loads (frames, 6);
    fills angles (frames, n + 2), whose first row is the start if `has_start`. A frame that cannot
    be reached from the previous one is solved from the unloaded arm, by adding the load in steps.
    """
    frames: int = angles.shape[0]
    size = angles.shape[1]
    work = np.empty((5, size))
    for f in range(frames):
        now = angles[f]
        frame = ChainFrame(turning[f], factor[f], rest[f], line[f], loads[f], numbers)
        if f > 0 or has_start:
            if f > 0:
                for i in range(size):
                    now[i] = angles[f - 1, i]
            if numbers[2] <= 0.0:
                now[0] = numbers[1]
            last_step = settle(now, frame, 1.0, work)
            if last_step < SETTLED:
                continue
        now[0] = numbers[1]
        for i in range(size - 1):
            now[i + 1] = now[i] + turning[f, i]
        last_step = settle(now, frame, 1.0, work)
        if last_step < SETTLED:
            continue
        now[0] = numbers[1]
        for i in range(size - 1):
            now[i + 1] = now[i] + turning[f, i]
        for k in range(LOAD_STEPS):
            share = (k + 1.0) / LOAD_STEPS
            last_step = settle(now, frame, share, work)
        if not last_step < SETTLED:
            return f
    return frames
