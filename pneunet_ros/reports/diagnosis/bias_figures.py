"""Parameters that were biased by the missing effect, before and after."""

from __future__ import annotations

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.units import kilopascals
from pneunet_ros.diagnosis.result import Evaluation
from pneunet_ros.reports.calibration.moment_figures import add_stiffness_axis, draw_rigidity
from pneunet_ros.reports.diagnosis.figure_data import AFTER, BEFORE, FigureData
from pneunet_ros.reports.diagnosis.tables import added_effects
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.paper_views.moment_curvature import law_view
from pneunet_ros.reports.style import legend, panels, PressureColors

CURVES = 3  # pressures at which kappa_p0 is drawn


def biased_parameters(data: FigureData) -> Picture | None:
    """Draw intrinsic curvature and moment law, before and after."""
    if not added_effects(data.diagnosis):
        return None
    before, after = data.diagnosis.before, data.diagnosis.after
    low, high = after.arm.pressure_range
    figure, (curvatures, rigidities) = panels(2, height=4.2)
    share = np.linspace(0.0, 1.0, 101)
    colors = PressureColors(low=low, high=high)
    for pressure in np.linspace(low, high, CURVES + 1)[1:].tolist():
        for side, style in ((before, '--'), (after, '-')):
            curvatures.plot(
                share,
                side.arm.intrinsic_curvature.at(pressure, share),
                linestyle=style,
                color=colors(pressure),
                linewidth=1.5,
                label=f'{kilopascals(pressure):z.0f} kPa' if side is after else None,
            )
    for side, color, name in ((before, BEFORE, 'before'), (after, AFTER, 'after')):
        draw_rigidities(rigidities, side, color, name)
    curvatures.set(
        title=r'(a) $\kappa_{p0}$; dashed: before',
        xlabel='arclength $s / l$',
        ylabel=r'$\kappa_{p0}$ (1/m)',
    )
    rigidities.set(
        title=r'(b) rigidity $\alpha = B / (mg\,l^2)$, 2 sigma',
        xlabel='pressure (kPa)',
        ylabel=r'$\alpha$',
    )
    add_stiffness_axis(rigidities, after.arm)
    legend(curvatures, loc='best')
    legend(rigidities, loc='best')
    return Picture(
        '08_biased_parameters',
        'Intrinsic curvature and rigidity, before and after',
        'Parameters of the model fitted without and with the missing effect. Without the '
        'effect, calibration distorts the other parameters until the model fits: curves that '
        'differ by more than their bands were biased by the missing effect, curves that agree '
        'were not.',
        figure,
    )


def draw_rigidities(axes: Axes, side: Evaluation, color: str, name: str) -> None:
    """Draw the rigidities of a model over pressure, with bands if fitted."""
    pressure = np.linspace(*side.arm.pressure_range, 61)
    fitted = law_view(side.fit, np.clip(pressure, *side.arm.moment_law.pressure_range))
    sections = fitted.rigidity.shape[1]
    for section in range(sections):
        label = rf'$\alpha_{section + 1}$, {name}' if sections > 1 else name
        style = {'linestyle': ('-', '--')[section % 2], 'linewidth': 1.5, 'label': label}
        draw_rigidity(axes, pressure, fitted, section, color=color, **style)
