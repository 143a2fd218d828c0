"""Figures 5, 6 and 9 of the paper: shapes and curvature, measured and fitted."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.reports.calibration.figure_data import FigureData, stations_of
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.paper_views.moment_curvature import curvature_std, MomentView
from pneunet_ros.reports.paper_views.steady_states import predict_states, SteadyState
from pneunet_ros.reports.style import (
    as_shapes,
    Color,
    draw_band,
    draw_dots,
    draw_force,
    FORCE_SCALE,
    legend,
    panels,
)
from pneunet_ros.solver.columns import CURVATURE, X, Y

COMPARED = 4  # loads whose curvature is drawn
STYLES = [
    Line2D([], [], color='0.3', marker='o', linestyle='', markersize=4, label='measured'),
    Line2D([], [], color='0.3', label='model'),
]


def free_shapes(data: FigureData) -> Picture:
    """Figure 5: shapes and kappa_p0 of the unloaded arm."""
    arm, fit = data.calibration.arm, data.calibration.joint
    figure, (shapes, curvatures) = panels(2)
    stations = stations_of(arm.reach)
    fields = predict_states(arm, data.free, stations)
    for steady_state, field in zip(data.free, fields, strict=True):
        draw_shape(shapes, steady_state, field, data.colors(steady_state.pressure))
    pressures = [state.pressure for state in data.free] or fit.parameters.pressure.tolist()
    share = stations / arm.length
    for pressure in pressures:
        color = data.colors(pressure)
        value = arm.intrinsic_curvature.at(pressure, share)
        std = curvature_std(fit, np.array([pressure]), share)[0]
        draw_band(curvatures, share, value, std, color)
        curvatures.plot(share, value, color=color, linewidth=1.6)
    for view in data.free_views:
        draw_measured(curvatures, view, arm.length, data.colors(view.steady_state.pressure))
    as_shapes(shapes, '(a) shapes without load')
    legend(shapes, handles=STYLES, loc='best')
    as_curvatures(curvatures, r'(b) intrinsic curvature $\kappa_{p0}$ with 2-sigma band')
    data.colors.bar(figure, curvatures)
    return Picture(
        '05_unloaded',
        'Unloaded arm: shapes and intrinsic curvature',
        'Dots are measured: mean target positions over intervals of constant pressure, and the '
        'curvature of a smooth curve through them. Lines are the fitted model. Lines should '
        'pass through the dots in (a), but not necessarily in (b), because the model is fitted '
        'to the points of (a), and the dots of (b) are smoothed and uncertain near both ends. A '
        'wide band shows where the recordings do not determine kappa_p0.',
        figure,
        number='5',
    )


def loaded_shapes(data: FigureData) -> Picture | None:
    """Figures 6 and 9 (a), (b): shapes and curvature under load, measured and predicted."""
    if not data.main:
        return None
    arm = data.calibration.arm
    figure, (shapes, curvatures) = panels(2)
    stations = stations_of(arm.reach)
    fields = predict_states(arm, data.main, stations)
    for steady_state, field in zip(data.main, fields, strict=True):
        color = data.colors(steady_state.pressure)
        draw_shape(shapes, steady_state, field, color)
        tip = millimeters(1.0) * field[[X, Y], -1]
        draw_force(shapes, tip, steady_state.force, color)
    views = data.main_views[:: math.ceil(len(data.main_views) / COMPARED) or 1]
    fields = predict_states(arm, [view.steady_state for view in views], stations)
    for view, field in zip(views, fields, strict=True):
        color, share = data.colors(view.steady_state.pressure), view.arclength / arm.length
        label = load_label(view.steady_state)
        draw_band(curvatures, share, view.curvature, view.std, color, alpha=0.2)
        draw_measured(curvatures, view, arm.length, color)
        curvatures.plot(
            stations / arm.length, field[CURVATURE], color=color, linewidth=1.6, label=label
        )
    as_shapes(shapes, '(a) shapes under load, with the end force')
    legend(shapes, handles=STYLES, loc='upper left')
    as_curvatures(curvatures, '(b) curvature; band: 2 sigma of the measured one')
    if views:
        legend(curvatures, loc='best')
    data.colors.bar(figure, curvatures)
    return Picture(
        '06_loaded',
        'Loaded arm: shapes and curvature',
        f'{run_label(data)}: the same under an end force (arrows, {FORCE_SCALE:g} mm per N). '
        'Lines are predicted from pressure and end force alone; they should pass through the '
        'measured dots, and in (b) stay within the band, except at the step at l1, which is '
        'rounded off by the smoothing of the measured curve.',
        figure,
        number='6 and 9 (a), (b)',
    )


def load_label(steady_state: SteadyState) -> str:
    """Name a load: kPa, and F1, F2 in mN."""
    f1, f2 = (round(1000.0 * value) for value in steady_state.force.tolist())
    return f'{kilopascals(steady_state.pressure):z.1f} kPa, F = ({f1}, {f2}) mN'


def run_label(data: FigureData) -> str:
    """Name the recording of Figures 6, 7 and 11."""
    return f'Recording {", ".join(sorted({state.run for state in data.main}))}'


def draw_shape(axes: Axes, steady_state: SteadyState, field: Array, color: Color) -> None:
    """Draw the model as a line and mean targets as dots, in mm."""
    axes.plot(millimeters(1.0) * field[X], millimeters(1.0) * field[Y], color=color, linewidth=1.4)
    x, y = millimeters(1.0) * steady_state.x, millimeters(1.0) * steady_state.y
    draw_dots(axes, x, y, 3.2, color=color)


def draw_measured(axes: Axes, view: MomentView, length: float, color: Color) -> None:
    """Draw measured curvature as dots, at every other station."""
    draw_dots(axes, view.arclength[::2] / length, view.curvature[::2], 2.6, color=color)


def as_curvatures(axes: Axes, title: str) -> None:
    """Label axes of curvature along the arm."""
    axes.set(title=title, xlabel='arclength $s / l$', ylabel='curvature (1/m)', xlim=(0.0, 1.0))
