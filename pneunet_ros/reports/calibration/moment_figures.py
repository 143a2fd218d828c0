"""Figures 7 and 8 of the paper: the moment along the arm and versus kappa - kappa0."""

from __future__ import annotations

from functools import partial
from typing import Any

from matplotlib.axes import Axes
import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals
from pneunet_ros.model.arm import Arm
from pneunet_ros.reports.calibration.figure_data import FigureData, nearest_view
from pneunet_ros.reports.calibration.shape_figures import load_label, run_label
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.paper_views.moment_curvature import law_view, LawView, Line, MomentView
from pneunet_ros.reports.style import (
    BAND_SIGMAS,
    draw_band,
    draw_errors,
    FIRST,
    legend,
    MEASURED,
    panels,
    SECOND,
)
from pneunet_ros.solver.columns import RIGIDITY

PAPER_PRESSURE = 53_800.0  # Pa, of Figure 8 (a)
MILLI = 1000.0  # mN m per N m
SECTION_COLORS = (FIRST, SECOND)
# Largest relative error of a slope in a figure: beyond it only the error bar is visible.
RIGIDITY_ERROR = 0.3


def moments(data: FigureData) -> Picture | None:
    """Figure 7: M_est along the arm and versus kappa - kappa0, for each load."""
    if not data.moment_views:
        return None
    figure, (along, against) = panels(2)
    for view in data.moment_views:
        color = data.colors(view.steady_state.pressure)
        along.plot(view.arclength / data.calibration.arm.length, MILLI * view.moment, color=color)
        against.plot(view.change, MILLI * view.moment, color=color, linewidth=1.4)
        against.plot(
            view.change[0], MILLI * view.moment[0], color=color, marker='s', markersize=4.5
        )
    along.set(
        title='(a) moment along the arm',
        xlabel='arclength $s / l$',
        ylabel=r'moment $M_\mathrm{est}$ (mN m)',
        xlim=(0.0, 1.0),
    )
    against.set(
        title='(b) moment against change of curvature; square: nearest the clamp',
        xlabel=r'measured $\kappa - \kappa_0$ (1/m)',
        ylabel=r'moment $M_\mathrm{est}$ (mN m)',
    )
    data.colors.bar(figure, against)
    return Picture(
        '07_moments',
        'Moment from measured shape and load',
        f'{run_label(data)}. M_est is Eq 9, computed from the measured targets and the end '
        'force, without a model. If M = EI (kappa - kappa0) held, all curves in (b) would be one '
        'straight line through zero; a bend near the clamp (square) is the second section of Eq '
        '10. The curvature is that of a smoothed curve, least certain at both ends of the arm.',
        figure,
        number='7',
    )


def one_moment(data: FigureData) -> Picture | None:
    """Figure 8 (a): the two lines of Eq 10 at one pressure."""
    if not data.moment_views:
        return None
    arm = data.calibration.arm
    view = nearest_view(data.moment_views, PAPER_PRESSURE)
    pressure = float(view.steady_state.inputs.pressure[0])
    figure, (lines, along) = panels(2)
    sections = arm.moment_law.sections(
        np.clip([pressure], *arm.pressure_range), arm.length, arm.weight
    )[0]
    for place, section in enumerate(sections):
        start = section[0]
        stop = sections[place + 1][0] if place + 1 < len(sections) else arm.length
        color = SECTION_COLORS[place]
        along.axvspan(start / arm.length, stop / arm.length, color=color, alpha=0.08, linewidth=0)
        inside = (view.arclength >= start) & (view.arclength <= stop)
        if inside.any():
            draw_section(lines, view, sections, place, inside)
    share = view.arclength / arm.length
    draw_band(along, share, view.change, view.std, MEASURED, alpha=0.18)
    along.plot(share, view.change, color=MEASURED, label='measured')
    along.plot(
        share,
        view.moment / rigidity_along(sections, view.arclength),
        color='#8a5aa8',
        linestyle='--',
        label=r'$M_\mathrm{est}$ / fitted rigidity',
    )
    lines.axhline(0.0, color='0.6', linewidth=0.7)
    lines.axvline(0.0, color='0.6', linewidth=0.7)
    lines.set(
        title=f'(a) {load_label(view.steady_state)}',
        xlabel=r'$\kappa - \kappa_0$ (1/m)',
        ylabel=r'moment $M_\mathrm{est}$ (mN m)',
    )
    legend(lines, loc='best')
    along.set(
        title='(b) the same along the arm; shaded: the sections',
        xlabel='arclength $s / l$',
        ylabel=r'$\kappa - \kappa_0$ (1/m)',
        xlim=(0.0, 1.0),
    )
    legend(along, loc='best')
    return Picture(
        '08a_moment_law',
        'The moment law at one pressure (Eq 10)',
        f'Recording {view.steady_state.run}. {line_sentence(view, data)} Points scatter about '
        'the lines of the fitted law by their bars. The dashed lines follow the paper: straight '
        'lines through measured points, each with its own intercept. They are for illustration '
        'only: M_O cannot be distinguished from kappa0, and smoothing rounds off the step at l1.',
        figure,
        number='8 (a)',
    )


def draw_section(
    axes: Axes, view: MomentView, sections: Array, place: int, inside: npt.NDArray[np.bool_]
) -> None:
    """Draw the points inside a section, its fitted law, and the line through the points."""
    color, name = SECTION_COLORS[place], section_name(place, len(sections))
    axes.errorbar(
        view.change[inside],
        MILLI * view.moment[inside],
        xerr=BAND_SIGMAS * view.std[inside],
        linestyle='',
        marker='o',
        markersize=3.5,
        color=color,
        elinewidth=0.6,
        alpha=0.8,
        label=f'measured, {name}',
    )
    moment = np.array([view.moment[inside].min(), view.moment[inside].max()])
    moment = moment + 0.15 * np.ptp(moment) * np.array([-1.0, 1.0])
    axes.plot(
        moment / sections[place, RIGIDITY],
        MILLI * moment,
        color=color,
        linewidth=2.0,
        label=f'fitted law, {name}',
    )
    seen = view.lines[place]
    if seen is not None:
        axes.plot(
            (moment - seen.offset) / seen.rigidity,
            MILLI * moment,
            color=color,
            linewidth=1.3,
            linestyle='--',
            label=f'line through the measured, {name}',
        )


def line_sentence(view: MomentView, data: FigureData) -> str:
    """Describe the lines of a view in the units of the paper."""
    arm = data.calibration.arm
    scale, parts = arm.weight * arm.length, []
    for place, item in enumerate(view.lines):
        if item is None:
            parts.append(f'section {place + 1}: too few targets for a line.')
            continue
        alpha, alpha_std = (
            value / (scale * arm.length) for value in (item.rigidity, item.rigidity_std)
        )
        parts.append(
            f'Section {place + 1}: alpha = {alpha:.4f} ± {alpha_std:.4f}, M_O = '
            f'({item.offset / scale:.4f} ± {item.offset_std / scale:.4f}) mg l.'
        )
    return ' '.join(parts)


def rigidity_along(sections: Array, arclength: Array) -> Array:
    """Return the rigidity (N m^2) at arclengths (m)."""
    which = np.searchsorted(sections[:, 0], arclength, side='right') - 1
    return np.asarray(sections[which, RIGIDITY])


def section_name(place: int, count: int) -> str:
    """Name a section for a legend."""
    if count == 1:
        return 'whole arm'
    return 's < l1' if place == 0 else 's > l1'


def law(data: FigureData) -> Picture | None:
    """Figure 8 (b): rigidities and l1 over pressure."""
    if not data.main:
        return None
    arm, fit = data.calibration.arm, data.calibration.joint
    pressure = np.linspace(data.colors.low, data.colors.high, 101)
    fitted = law_view(fit, np.clip(pressure, *arm.pressure_range))
    two = fitted.split is not None
    figure, axes = panels(2 if two else 1)
    worst = RIGIDITY_ERROR
    for place in range(fitted.rigidity.shape[1]):
        color = SECTION_COLORS[place]
        name = rf'$\alpha_{place + 1}$' if two else r'$\alpha$'
        label = f'{name}, fitted, 2 sigma'
        draw_rigidity(axes[0], fitted.pressure, fitted, place, color=color, label=label)
        slopes = [
            (view.steady_state.pressure, item)
            for view in data.moment_views
            for item in [view.lines[place]]
            if item is not None and item.rigidity_std < worst * abs(item.rigidity)
        ]
        if slopes:
            draw_slopes(axes[0], slopes, arm.weight * arm.length**2, color, name)
    axes[0].set(
        title=r'(a) rigidity $\alpha = B / (mg\,l^2)$', xlabel='pressure (kPa)', ylabel=r'$\alpha$'
    )
    add_stiffness_axis(axes[0], arm)
    limits = [fitted.rigidity.min(), fitted.rigidity.max(), 0.0]
    margin = 0.35 * (max(limits) - min(limits))
    axes[0].set_ylim(min(limits) - 0.1 * margin, max(limits) + margin)
    legend(axes[0], loc='lower left', ncols=2)
    if fitted.split is not None and fitted.split_std is not None:
        x = kilopascals(1.0) * pressure
        draw_band(axes[1], x, fitted.split, fitted.split_std, MEASURED, alpha=0.18)
        axes[1].plot(x, fitted.split, color=MEASURED, linewidth=1.8, label='fitted, 2 sigma')
        axes[1].set(
            title='(b) transition point of the stiffness l1 / l',
            xlabel='pressure (kPa)',
            ylabel='l1 / l (-)',
        )
        axes[1].set_ylim(bottom=0.0)
        legend(axes[1], loc='lower right')
    return Picture(
        '08b_law_over_pressure',
        'Moment law over pressure',
        "Bands: the fitted law, with rigidities linear in pressure. Hollow points: the paper's "
        'method, slopes of the lines of Figure 8 (a), one per load, with two standard errors; '
        'dashed: their regression. alpha2 should follow the band. alpha1 from slopes scatters '
        'and tends to be too small, because the first section has few targets and the smoothed '
        'curvature rounds off the step at l1. The fit needs no curvature and has no such bias. '
        f'Slopes with an error above {100 * worst:.0f} % are omitted.',
        figure,
        number='8 (b)',
    )


def draw_rigidity(
    axes: Axes, pressure: Array, fitted: LawView, section: int, *, color: str, **style: Any
) -> None:
    """Draw a fitted rigidity over pressure (Pa), with its band."""
    x, value = kilopascals(1.0) * pressure, fitted.rigidity[:, section]
    draw_band(axes, x, value, fitted.rigidity_std[:, section], color)
    axes.plot(x, value, color=color, **({'linewidth': 1.8} | style))


def add_stiffness_axis(axes: Axes, arm: Arm) -> None:
    """Add an axis with the bending stiffness EI to that of alpha."""
    unit = arm.weight * arm.length**2
    functions = (partial(np.multiply, unit), partial(np.multiply, 1.0 / unit))
    other = axes.secondary_yaxis('right', functions=functions)
    other.set_ylabel('EI (N m^2)')
    other.ticklabel_format(axis='y', scilimits=(0, 0), useMathText=True)


def draw_slopes(
    axes: Axes, slopes: list[tuple[float, Line]], scale: float, color: str, name: str
) -> None:
    """Draw slopes of lines through measured points, and their regression in pressure."""
    x = np.array([kilopascals(pressure) for pressure, _ in slopes])
    value = np.array([item.rigidity for _, item in slopes]) / scale
    std = np.array([item.rigidity_std for _, item in slopes]) / scale
    draw_errors(
        axes,
        x,
        value,
        std,
        markersize=4.5,
        markerfacecolor='white',
        color=color,
        elinewidth=0.7,
        alpha=0.75,
        label=f'{name}, from lines',
    )
    if np.ptp(x) > 0.0 and x.size > 2:
        # Weighted by relative errors: a standard error is about proportional to its rigidity.
        slope, level = np.polyfit(x, value, 1, w=np.abs(value) / std)
        ends = np.array([x.min(), x.max()])
        axes.plot(ends, level + slope * ends, color=color, linestyle='--', linewidth=1.2)
