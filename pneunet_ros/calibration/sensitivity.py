"""What the predicted shape is sensitive to: F1, l1, rigidities, one at a time (Figure 10)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.steady_states import SteadyState
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.moment_law import LinearLaw, MajidiLaw, MomentLaw, PiecewiseLinearLaw
from pneunet_ros.model.shape import Shape

FACTORS = (0.8, 0.9, 1.0, 1.1, 1.2)
SPLITS = (0.05, 0.075, 0.1, 0.125, 0.15)  # l1 / l
RIGIDITY_NAMES = {
    PiecewiseLinearLaw.kind: 'alpha1, alpha2',
    LinearLaw.kind: 'EI',
    MajidiLaw.kind: 'E',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variation:
    """The shapes for some values of one quantity; `name`, and a label per shape.

    travel (m): how far the free end moves between the first and the last shape, NaN without one.
    """

    name: str
    labels: tuple[str, ...]
    shapes: tuple[Shape, ...]

    @property
    def travel(self) -> float:
        """Distance of the free end between first and last value (m)."""
        first, last = self.shapes[0], self.shapes[-1]
        return float(np.hypot(first.x[-1] - last.x[-1], first.y[-1] - last.y[-1]))


def variations(arm: Arm, steady_state: SteadyState) -> tuple[Variation, ...]:
    """Return the variations of Figure 10 around the load of a stance.

    F1 +- 20 %, l1 from 0.05 to 0.15 of the length (for a law that has it), rigidity +- 20 %.
    """
    f1, f2 = steady_state.force.tolist()

    def shape(arm: Arm, along: float = f1) -> Shape:
        return solve(arm, steady_state.pressure, (along, f2), steady_state.moment)

    percent = tuple(
        f'{100.0 * (factor - 1.0):+.0f} %' if factor != 1.0 else 'as fitted' for factor in FACTORS
    )
    found = [
        Variation(
            name='F1', labels=percent, shapes=tuple(shape(arm, factor * f1) for factor in FACTORS)
        )
    ]
    law = arm.moment_law
    if isinstance(law, PiecewiseLinearLaw):
        moved = [replace(law, split=np.full(law.split.size, split)) for split in SPLITS]
        found.append(
            Variation(
                name='l1 / l',
                labels=tuple(f'{split:g}' for split in SPLITS),
                shapes=tuple(
                    shape(replace(arm, moment_law=item, covariance=None)) for item in moved
                ),
            )
        )
    found.append(
        Variation(
            name=RIGIDITY_NAMES[law.kind],
            labels=percent,
            shapes=tuple(
                shape(replace(arm, moment_law=stiffer(law, factor), covariance=None))
                for factor in FACTORS
            ),
        )
    )
    return tuple(found)


def stiffer(law: MomentLaw, factor: float) -> MomentLaw:
    """Return a law with its rigidity (Majidi: its modulus) larger by a factor."""
    if isinstance(law, PiecewiseLinearLaw):
        return replace(law, rigidity=factor * law.rigidity)
    if isinstance(law, LinearLaw):
        return replace(law, bending_stiffness=factor * law.bending_stiffness)
    assert isinstance(law, MajidiLaw)
    return replace(law, modulus=factor * law.modulus)
