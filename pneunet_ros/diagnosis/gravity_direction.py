"""The effect `gravity` interpreted as the weight of the arm in another direction.

A line load not larger than the weight of the arm may be that weight, if the model has a wrong
direction of gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from pneunet_ros.diagnosis.result import NamedEffect
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.model.arm import Arm

SURE = 2.0  # standard errors, by which a direction may be longer than a unit vector


def direction_notes(arm: Arm, effects: Sequence[NamedEffect]) -> tuple[str, ...]:
    """Describe the direction of gravity that explains the line load equally well; empty: none.

    arm: without the effect.
    """
    per_length = arm.weight / arm.length
    for effect in effects:
        if effect.name != Gravity.name:
            continue
        found = [effect.parameters[name] for name in ('weight_x', 'weight_y')]
        known = arm.gravity.x, arm.gravity.y
        x, y = (one.value / per_length + there for one, there in zip(found, known, strict=True))
        std = math.hypot(*(one.std / per_length for one in found))
        if math.hypot(x, y) > 1.0 + SURE * std:
            return ()
        longer = max(math.hypot(x, y), 1.0)
        x, y = x / longer, y / longer
        return (
            f'the line load equals the weight of the arm if gravity points along [{x:.2f}, '
            f'{y:.2f}] ± {std:.1g} instead of [{known[0]:.2f}, {known[1]:.2f}]: is the base '
            f'tilted? Try --gravity={x:.3f},{y:.3f}',
        )
    return ()
