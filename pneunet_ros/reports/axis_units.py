"""Axes of figures in other units than those in which they were drawn."""

from __future__ import annotations

from typing import Any

from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator, FuncFormatter
import numpy as np
from pneunet_ros.core.unit_system import SI, Unit, UnitSystem

# The units that labels of axes end with: the kind of quantity, and how much of SI each is.
DRAWN: dict[str, tuple[str, float]] = {
    'mm': ('length', 1e-3),
    'um': ('length', 1e-6),
    'N': ('force', 1.0),
    'mN': ('force', 1e-3),
    'mN m': ('moment', 1e-3),
    '1/m': ('curvature', 1.0),
}


class ScaledLocator(AutoLocator):
    """Places ticks at round numbers of another unit, `per_drawn` of which make one drawn."""

    def __init__(self, per_drawn: float) -> None:
        """Take the ratio of the units."""
        super().__init__()
        self.per_drawn = per_drawn

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Return the places of the ticks, as drawn."""
        ticks = super().tick_values(vmin * self.per_drawn, vmax * self.per_drawn)
        return np.asarray(ticks) / self.per_drawn


def use_units(figure: Figure, units: UnitSystem) -> None:
    """Show the axes of a figure in these units; what is drawn and its shape stay as they are.

    An axis is known by the unit in brackets at the end of its label. SI is what figures are drawn
    in, with the prefixes that people read.
    """
    if units is SI:
        return
    for axes in figure.get_axes():
        for axis in (axes.xaxis, axes.yaxis):
            head, _, unit = axis.get_label_text().rpartition('(')
            drawn = DRAWN.get(unit.removesuffix(')'))
            if drawn is None:
                continue
            other = units.of_kind(drawn[0])
            assert other is not None
            axis.set_label_text(f'{head}({other.name})')
            rescale(axis, drawn[1], other)


def rescale(axis: Axis, drawn: float, unit: Unit) -> None:
    """Put the ticks of an axis that was drawn in so many SI units at round numbers of a unit."""
    per_drawn = drawn * unit.per_si
    axis.set_major_locator(ScaledLocator(per_drawn))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f'{value * per_drawn:.4g}'))
