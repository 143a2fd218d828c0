"""Check that targets are numbered from the clamp, and that the clamp is fixed.

The direction of an arm is constant at the clamp and changes most at the free end. This holds in
every coordinate frame, even in one that moves with the first target.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array

# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FEWEST_FRAMES = 5  # with a target, for its motion
CHORD = 0.1  # of the length, from an end to the target that gives its direction
TURNS = 0.2  # rad: least rotation of the first targets at a wrong end
TIMES = 3.0  # rotations of the last targets: a uniform bend gives a third or less
AT_CLAMP = 0.01  # of the length: a target so near to the clamp does not move with the arm
CLAMP_MOVES = 0.005  # of the length, with the pressure: a note is given
CLAMP_NOISE = 5.0  # sigma of a target, which a note exceeds as well
CLAMP_LOOSE = 0.05  # of the length: the recording is refused
EXPLAINED = 0.5  # share of its variance that the pressure must explain


def numbered_from_tip(points: Array, arclength: Array) -> bool:
    """Whether targets (frames, 2, targets) m at arclength (targets,) m are numbered from the tip.

    Also False if too few were seen, or if nothing bends.
    """
    turns = end_turns(points, arclength)
    if turns is None:
        return False
    first, last = turns
    return first > TURNS and first > TIMES * last


def first_target_moves(points: Array, arclength: Array) -> bool:
    """Whether the first target (frames, 2, targets) m moves while the last one rests.

    This indicates an arm numbered from its free end and measured by a fixed camera.
    """
    travels = []
    for end in (0, -1):
        places = points[:, :, end]
        places = places[np.isfinite(places[:, 0])]
        if len(places) < FEWEST_FRAMES:
            return False
        low, high = np.quantile(places, (0.05, 0.95), axis=0)
        travels.append(float(np.hypot(*(high - low))))
    first, last = travels
    length = float(arclength[-1] - arclength[0])
    return first > AT_CLAMP * length + arclength[0] and first > TIMES * last


def end_turns(points: Array, arclength: Array) -> tuple[float, float] | None:
    """Return the angles (rad) by which the first and the last targets turn; None if unknown."""
    seen = np.isfinite(points[:, 0]).sum(axis=0) >= FEWEST_FRAMES
    known = np.flatnonzero(seen)
    if known.size < 3 or arclength[known[0]] > CHORD * arclength[-1]:
        return None  # a small rotation at the clamp is not visible
    reach = CHORD * (arclength[known[-1]] - arclength[known[0]])
    first, last = arclength[known[0]] + reach, arclength[known[-1]] - reach
    after = int(known[1:][arclength[known[1:]] >= first - 1e-12][0])
    before = int(known[:-1][arclength[known[:-1]] <= last + 1e-12][-1])
    turns = [line_turning(points, *pair) for pair in ((known[0], after), (before, known[-1]))]
    if turns[0] is None or turns[1] is None:
        return None
    return turns[0], turns[1]


def line_turning(points: Array, start: int, end: int) -> float | None:
    """Return the range (rad) of the angle of the line between two targets, for 90 % of frames."""
    chord = points[:, :, end] - points[:, :, start]
    chord = chord[np.isfinite(chord).all(axis=1)]
    if not len(chord):
        return None
    along = np.arctan2(chord[:, 1], chord[:, 0])
    middle = np.angle(np.mean(np.exp(1j * along)))
    low, high = np.quantile(np.angle(np.exp(1j * (along - middle))), (0.05, 0.95))
    return float(high - low)


def clamp_motion(points: Array, pressure: Array, arclength: Array, length: float) -> float:
    """Return the motion (m) of the target at the clamp with pressure; 0 if unknown.

    points (frames, 2, targets) m, pressure (frames,) Pa, length (m) of the arm. Motion that does
    not follow the pressure is noise and drift of the camera.
    """
    if not arclength.size or arclength[0] > AT_CLAMP * length:
        return 0.0
    position, seen = points[:, :, 0], np.isfinite(points[:, 0, 0])
    position, pressure = position[seen], pressure[seen]
    span = float(np.ptp(pressure)) if pressure.size else 0.0
    if len(position) < 2 * FEWEST_FRAMES or span == 0.0:
        return 0.0
    columns = np.vander((pressure - pressure.min()) / span, 3)
    coefficients, *_ = np.linalg.lstsq(columns, position, rcond=None)
    fitted = columns @ coefficients
    variance = float(np.var(position, axis=0).sum())
    if variance == 0.0 or np.var(fitted, axis=0).sum() < EXPLAINED * variance:
        return 0.0
    return float(np.hypot(*np.ptp(fitted, axis=0)))
