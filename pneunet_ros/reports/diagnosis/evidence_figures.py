"""The evidence for each effect, and which parameters were biased by the missing effect."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.units import kilopascals
from pneunet_ros.diagnosis.result import Evaluation, Evidence
from pneunet_ros.reports.calibration.moment_figures import add_stiffness_axis, draw_rigidity
from pneunet_ros.reports.diagnosis.figure_data import AFTER, BEFORE, FigureData
from pneunet_ros.reports.diagnosis.tables import added_effects, rank_evidence
from pneunet_ros.reports.diagnosis.words import round_value
from pneunet_ros.reports.figure import Picture, picture
from pneunet_ros.reports.paper_views.moment_curvature import law_view
from pneunet_ros.reports.style import legend, panels, PressureColors, THIRD

LINEAR = 10.0  # up to which a scale of evidence is
CURVES = 3  # pressures at which kappa_p0 is drawn


def evidence(data: FigureData) -> Picture | None:
    """Gain of every scored effect in explaining the recordings."""
    shown = rank_evidence(data.diagnosis)[::-1]
    if not shown:
        return None
    quantities = [
        (
            [item.chi_squared for item in shown],
            '(a) chi squared gets less by',
            'delta chi squared, training recordings',
        ),
        (
            [item.evidence for item in shown],
            '(b) gain in recordings left out',
            'log probability, recording left out after recording',
        ),
    ]
    if all(math.isnan(item.evidence) for item in shown):
        del quantities[1]
    figure, axes = panels(len(quantities), height=1.6 + 0.3 * max(len(shown), 3))
    for panel, (values, title, label) in zip(axes, quantities, strict=True):
        draw_evidence(panel, shown, values)
        panel.set(title=title, xlabel=label)
    for panel in axes[1:]:
        panel.set_yticks(panel.get_yticks(), [''] * len(shown))
    return picture(
        '07_evidence',
        'Evidence for every effect',
        'All effects that were scored; promising ones were put into the model and everything '
        'refitted. (a) says how much '
        'better the training recordings fit, (b) how much better each of them is predicted from '
        'the others; below zero an effect does harm. Scales are linear to ten, then '
        'logarithmic. Green: it leaves nothing but noise, or what its law may miss; grey: it '
        'leaves more, so that it is not the answer, however much it improves the fit; white: its '
        'score promised too little to be worth a fit, and (a) shows that score.',
        figure,
    )


def draw_evidence(axes: Axes, shown: list[Evidence], values: list[float]) -> None:
    """Draw one quantity of all hypotheses: adequate ones in green, those not fitted in white."""
    places = np.arange(len(shown))
    fitted = [not math.isnan(item.evidence) for item in shown]
    colors = [
        'white' if not tried else THIRD if item.adequate else '#b5b5b5'
        for item, tried in zip(shown, fitted, strict=True)
    ]
    lengths = np.nan_to_num(values)
    bars = axes.barh(places, lengths, 0.65, color=colors, edgecolor='0.6', linewidth=0.6)
    texts = ['' if math.isnan(value) else round_value(value) for value in values]
    axes.bar_label(bars, labels=texts, fontsize=8, padding=3)
    # Sizes differ by orders of magnitude, and may be negative.
    if np.abs(lengths).max() > LINEAR:
        axes.set_xscale('symlog', linthresh=LINEAR)
    axes.axvline(0.0, color='0.4', linewidth=0.9)
    axes.set_yticks(places, [' + '.join(item.effects) for item in shown])
    axes.grid(visible=False, axis='y')
    axes.margins(x=0.22)
    axes.set_ylim(-0.6, max(len(shown), 3) - 0.4)


def biased_parameters(data: FigureData) -> Picture | None:
    """Intrinsic curvature and moment law, before and after."""
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
    return picture(
        '08_biased_parameters',
        'Intrinsic curvature and rigidity, before and after',
        'Parameters of the model fitted without the missing effect, and with it. Calibration '
        'changes the parameters that it has until the model fits: curves that differ by more '
        'than their bands were biased by the missing effect. Curves that agree were not.',
        figure,
    )


def draw_rigidities(axes: Axes, side: Evaluation, color: str, name: str) -> None:
    """Draw the rigidities of a side over pressure, with bands where they were fitted."""
    pressure = np.linspace(*side.arm.pressure_range, 61)
    fitted = law_view(side.fit, np.clip(pressure, *side.arm.moment_law.pressure_range))
    sections = fitted.rigidity.shape[1]
    for section in range(sections):
        label = rf'$\alpha_{section + 1}$, {name}' if sections > 1 else name
        style = {'linestyle': ('-', '--')[section % 2], 'linewidth': 1.5, 'label': label}
        draw_rigidity(axes, pressure, fitted, section, color=color, **style)
