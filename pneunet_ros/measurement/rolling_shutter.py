"""Targets that a frame shows at times of their own: a rolling shutter reads row by row.

The times differ linearly over the picture, whose rows may run in any direction.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array

# From the first to the last row, s. Convention: a camera of 30 images per second reads all the
# time; the readout of most cameras takes 10 to 33 ms.
READOUT = 1.0 / 30.0
# One sigma of the time of a frame, s. Convention: the stamp of a driver or of another clock.
STAMP_STD = 0.1


def row_errors(motion: Array, at_once: Array, curved: Array, places: Array) -> Array:
    """Return one sigma of the errors of the targets of a frame, (errors, 2, targets) m.

    Args:
        motion: how the arm moves during READOUT, (motions, 2, targets) m, by each cause.
        at_once: how all targets move in the time that the stamp may be wrong, (n, 2, targets) m.
        curved: the second-order part of the whole motion, (2, targets) m.
        places: x and y of the targets over the length of the arm, (2, targets).

    Returns:
        Independent errors: at_once; then by how much the time changes from that of the clamp along
        x and along y (READOUT per length of the arm); then the second-order part.
    """
    apart = [moved * place for place in places for moved in motion]
    return np.stack([*at_once, *apart, *(curved * time**2 for time in (0.5, *places))])


def second_order_motion(turn: Array, heading: Array, joints: Array, arclength: Array) -> Array:
    """Return the second-order part (2, places) m of a motion of the arm.

    turn (links,) rad: rotation of links by the motion, from heading (links,) rad; joints (links +
    1,) m: their ends; arclength (places,) m.
    """
    inward = -0.5 * turn**2 * np.diff(joints) * np.stack([np.cos(heading), np.sin(heading)])
    ends = np.pad(np.cumsum(inward, axis=1), ((0, 0), (1, 0)))
    return np.stack([np.interp(arclength, joints, row) for row in ends])
