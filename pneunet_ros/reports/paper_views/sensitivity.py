"""Sensitivity of the predicted shape to F1, l1 and rigidities, one at a time (Figure 10)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.moment_law import LinearLaw, MajidiLaw, MomentLaw, PiecewiseLinearLaw
from pneunet_ros.model.shape import Shape
from pneunet_ros.reports.paper_views.steady_states import SteadyState

FACTORS = (0.8, 0.9, 1.0, 1.1, 1.2)
SPLITS = (0.05, 0.075, 0.1, 0.125, 0.15)  # l1 / l
RIGIDITY_NAMES = {
    PiecewiseLinearLaw.kind: 'alpha1, alpha2',
    LinearLaw.kind: 'EI',
    MajidiLaw.kind: 'E',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variation:
    """Shapes for several values of one quantity: its name, the shapes, and a label for each.

    travel (m) of the free end from the first to the last shape, NaN if one is missing.
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
    """Return the variations of Figure 10 around the load of a steady state.

    F1 +- 20 %, l1 from 0.05 to 0.15 of the length (for a law with l1), rigidity +- 20 %.
    """
    f1, f2 = steady_state.force.tolist()

    def vary(name: str, labels: tuple[str, ...], cases: list[tuple[Arm, float]]) -> Variation:
        pressure, moment = steady_state.pressure, steady_state.moment
        shapes = tuple(solve(case, pressure, (along, f2), moment) for case, along in cases)
        return Variation(name=name, labels=labels, shapes=shapes)

    def with_law(changed: MomentLaw) -> tuple[Arm, float]:
        return replace(arm, moment_law=changed, covariance=None), f1

    law = arm.moment_law
    percent = tuple(
        f'{100.0 * (factor - 1.0):+.0f} %' if factor != 1.0 else 'as fitted' for factor in FACTORS
    )
    found = [vary('F1', percent, [(arm, factor * f1) for factor in FACTORS])]
    if isinstance(law, PiecewiseLinearLaw):
        splits = [replace(law, split=np.full(law.split.size, split)) for split in SPLITS]
        labels = tuple(f'{split:g}' for split in SPLITS)
        found.append(vary('l1 / l', labels, [with_law(item) for item in splits]))
    stiffened = [with_law(scale_rigidity(law, factor)) for factor in FACTORS]
    return (*found, vary(RIGIDITY_NAMES[law.kind], percent, stiffened))


def scale_rigidity(law: MomentLaw, factor: float) -> MomentLaw:
    """Return a law whose rigidity (Majidi: modulus) is larger by a factor."""
    if isinstance(law, PiecewiseLinearLaw):
        return replace(law, rigidity=factor * law.rigidity)
    if isinstance(law, LinearLaw):
        return replace(law, bending_stiffness=factor * law.bending_stiffness)
    assert isinstance(law, MajidiLaw)
    return replace(law, modulus=factor * law.modulus)
