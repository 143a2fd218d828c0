"""What speaks for which effect, and what calibration without it had been hiding."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.calibration.moment_curvature import law_view
from pneunet_ros.core.units import kilopascals
from pneunet_ros.diagnosis.result import Diagnosis, Evaluation, Evidence
from pneunet_ros.reports.diagnosis.error_figures import AFTER, BEFORE
from pneunet_ros.reports.diagnosis.tables import ranked
from pneunet_ros.reports.diagnosis.words import rounded
from pneunet_ros.reports.style import (
    BAND_SIGMAS,
    legend,
    panels,
    Picture,
    picture,
    PressureColors,
    THIRD,
)

MOST_HYPOTHESES = 12
CURVES = 3  # pressures at which kappa_p0 is drawn


def evidence(diagnosis: Diagnosis) -> Picture | None:
    """How much better the recordings are explained by every effect that was fitted."""
    fitted = [item for item in ranked(diagnosis) if not math.isnan(item.evidence)]
    some = fitted[:MOST_HYPOTHESES][::-1]
    if not some:
        return None
    figure, axes = panels(2, height=1.6 + 0.36 * max(len(some), 3))
    names = [' + '.join(item.effects) for item in some]
    for one, values, title in (
        (axes[0], [item.chi_squared for item in some], '(a) chi squared gets less by'),
        (axes[1], [item.evidence for item in some], '(b) gain in recordings left out'),
    ):
        draw_evidence(one, some, names, values)
        one.set(title=title)
    axes[1].set_yticks(axes[1].get_yticks(), [''] * len(some))
    axes[1].set_xlabel('log probability, recording left out after recording')
    axes[0].set_xlabel('delta chi squared, training recordings')
    return picture(
        '06_evidence',
        'Evidence for every effect',
        'Promising effects were put into the model and everything refitted. (a) says how much '
        'better the training recordings fit, (b) how much better each of them is predicted from '
        'the others; below zero an effect does harm. Scales are linear near zero, then '
        'logarithmic. Green: beside it nothing is left to explain; grey: something is left, so '
        'that it is not the answer, however much it improves the fit.',
        figure,
    )


def draw_evidence(axes: Axes, some: list[Evidence], names: list[str], values: list[float]) -> None:
    """Draw one quantity of all hypotheses, adequate ones in green."""
    places = np.arange(len(some))
    colors = [THIRD if item.adequate else '#b5b5b5' for item in some]
    bars = axes.barh(places, values, 0.65, color=colors)
    axes.bar_label(bars, labels=[rounded(value) for value in values], fontsize=8, padding=3)
    # Sizes differ by orders of magnitude, and may be negative.
    axes.set_xscale('symlog', linthresh=10.0)
    axes.axvline(0.0, color='0.4', linewidth=0.9)
    axes.set_yticks(places, names)
    axes.grid(visible=False, axis='y')
    axes.margins(x=0.22)
    axes.set_ylim(-0.6, max(len(some), 3) - 0.4)


def hidden(diagnosis: Diagnosis) -> Picture:
    """Intrinsic curvature and moment law, before and after."""
    before, after = diagnosis.before, diagnosis.after
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
                label=f'{kilopascals(pressure):.0f} kPa' if side is after else None,
            )
    for side, color, name in ((before, BEFORE, 'before'), (after, AFTER, 'after')):
        draw_rigidities(rigidities, side, color, name)
    curvatures.set(
        title='(a) kappa_p0; dashed: before', xlabel='arclength s / l', ylabel='kappa_p0 (1/m)'
    )
    rigidities.set(
        title='(b) rigidity alpha = B / (mg l^2), 2 sigma', xlabel='pressure (kPa)', ylabel='alpha'
    )
    legend(curvatures, loc='best')
    legend(rigidities, loc='best')
    return picture(
        '07_hidden',
        'Intrinsic curvature and rigidity, before and after',
        'Numbers of the model fitted without what was missing, and with it. Calibration bends '
        'what it has until the model fits: curves that lie apart by more than their bands had '
        'been wrong to make up for the missing effect. Curves that agree were not touched by it.',
        figure,
    )


def draw_rigidities(axes: Axes, side: Evaluation, color: str, name: str) -> None:
    """Draw the rigidities of a side over pressure, with bands where they were fitted."""
    pressure = np.linspace(*side.arm.pressure_range, 61)
    known = np.clip(pressure, *side.arm.moment_law.pressure_range)
    found = law_view(side.fit, known)
    x = kilopascals(1.0) * pressure
    for section in range(found.rigidity.shape[1]):
        value, std = found.rigidity[:, section], BAND_SIGMAS * found.rigidity_std[:, section]
        axes.fill_between(x, value - std, value + std, color=color, alpha=0.25, linewidth=0)
        label = f'alpha{section + 1}, {name}' if found.rigidity.shape[1] > 1 else name
        axes.plot(
            x, value, color=color, linewidth=1.5, linestyle=('-', '--')[section % 2], label=label
        )
