"""Figures 10 and 11 of the paper: sensitivity of the shape, and linearity in pressure."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib import colormaps
from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.model.shape import Shape
from pneunet_ros.reports.calibration.figure_data import FigureData, nearest_view
from pneunet_ros.reports.calibration.shape_figures import load_label, run_label
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.paper_views.linearity import (
    change_linearity,
    intrinsic_linearity,
    Linearity,
    PLACES,
)
from pneunet_ros.reports.paper_views.sensitivity import FACTORS, Variation, variations
from pneunet_ros.reports.style import (
    as_shapes,
    draw_dots,
    draw_errors,
    legend,
    MEASURED,
    panels,
    same_height,
)

SIGNIFICANT = 3.0  # standard errors, by convention

PAPER_PRESSURE = 24_200.0  # Pa, of Figure 10
MARKERS = ('v', 's', '^', 'o')  # of the four places, as in the paper
PLACE_COLORS = ('#1f5a96', '#d1603d', '#4c9a6a', '#8a5aa8')


def sensitivity(data: FigureData) -> Picture | None:
    """Figure 10: sensitivity of the shape to one quantity at a time."""
    if not data.main_views:
        return None
    steady_state = nearest_view(data.main_views, PAPER_PRESSURE).steady_state
    arm = data.calibration.arm
    varied = variations(arm, steady_state)
    nominal = varied[0].shapes[FACTORS.index(1.0)]
    figure, axes = panels(len(varied), rows=2, height=6.4)
    shapes, displacements = axes[: len(varied)], axes[len(varied) :]
    x, y = millimeters(1.0) * steady_state.x, millimeters(1.0) * steady_state.y
    for place, variation in enumerate(varied):
        draw_variation(shapes[place], displacements[place], variation, nominal, arm.length)
        draw_dots(shapes[place], x, y, 2.6, color=MEASURED, zorder=4, label='measured')
        as_shapes(shapes[place], f'({"abc"[place]}) {variation.name}')
        legend(shapes[place], loc='best')
        displacements[place].set(
            title=f'free end moves {travel(variation)} in total',
            xlabel='arclength $s / l$',
            ylabel='distance from the fitted (mm)',
            xlim=(0.0, arm.reach / arm.length),
        )
    same_height(displacements, low=0.0)
    return Picture(
        '10_sensitivity',
        'Sensitivity of the shape',
        f'Predicted shapes at {load_label(steady_state)}, with one quantity changed at a time; '
        'dots are measured. Below, with a common scale: distance of each point of the arm from '
        'the fitted model. The larger it is, the better such recordings determine that '
        'quantity, and the more an error in that quantity matters.',
        figure,
        number='10',
    )


def draw_variation(
    shapes: Axes, displacements: Axes, variation: Variation, nominal: Shape, length: float
) -> None:
    """Draw the shapes of a variation, from dark to light, and their distance from the nominal.

    length (m): of the soft part.
    """
    colors = colormaps['plasma'](np.linspace(0.05, 0.8, len(variation.shapes)))
    for rgba, label, shape in zip(colors, variation.labels, variation.shapes, strict=True):
        color = tuple(rgba.tolist())
        shapes.plot(
            millimeters(1.0) * shape.x,
            millimeters(1.0) * shape.y,
            color=color,
            linewidth=1.3,
            label=label,
        )
        distance = millimeters(1.0) * np.hypot(shape.x - nominal.x, shape.y - nominal.y)
        displacements.plot(shape.arclength / length, distance, color=color, linewidth=1.5)


def travel(variation: Variation) -> str:
    """Describe the displacement of the free end."""
    if not np.isfinite(variation.travel):
        return 'no equilibrium for some values'
    return f'{millimeters(variation.travel):.1f} mm'


def linearity(data: FigureData) -> Picture | None:
    """Figure 11: kappa0, and kappa - kappa0, over pressure at four places.

    None if the pressure never changes.
    """
    free = intrinsic_linearity(data.calibration.joint)
    if not free:
        return None
    loaded = change_linearity(data.main_views, data.calibration.arm.length)
    figure, axes = panels(2 if loaded else 1)
    draw_lines(axes[0], free)
    axes[0].set(
        title=r'(a) $\kappa_0$, rows of the fitted table',
        xlabel='pressure (kPa)',
        ylabel=r'$\kappa_0$ (1/m)',
    )
    if loaded:
        draw_lines(axes[1], loaded)
        axes[1].set(
            title=r'(b) $\kappa - \kappa_0$ under load, measured',
            xlabel='pressure (kPa)',
            ylabel=r'$\kappa - \kappa_0$ (1/m)',
        )
    for panel in axes:
        legend(panel, loc='best')
    caption = (
        'Points with 2 sigma at four places of the arm, and straight lines through them. '
        f'kappa0: {verdict(free)}'
    )
    if loaded:
        caption += (
            f' kappa - kappa0 ({run_label(data)}): {verdict(loaded)} The load '
            'changes with pressure as in the recording, so these points need not lie on a '
            'straight line.'
        )
    return Picture('11_linearity', 'Linear in pressure?', caption, figure, number='11')


def draw_lines(axes: Axes, lines: Sequence[Linearity]) -> None:
    """Draw values with bars, and straight lines through them."""
    for item in lines:
        place = PLACES.index(item.place)
        color = PLACE_COLORS[place]
        x = kilopascals(1.0) * item.pressure
        draw_errors(
            axes,
            x,
            item.value,
            item.std,
            marker=MARKERS[place],
            markersize=5.0,
            markerfacecolor='white',
            color=color,
            elinewidth=0.9,
            label=f's / l = {item.place:g}',
        )
        ends = np.array([item.pressure.min(), item.pressure.max()])
        axes.plot(
            kilopascals(1.0) * ends,
            item.intercept + item.slope * ends,
            color=color,
            linestyle='--',
            linewidth=1.1,
        )


def verdict(lines: Sequence[Linearity]) -> str:
    """Describe the departure of the values from a straight line."""
    if not lines:
        return 'too few pressures for a straight line.'
    worst = max(lines, key=lambda item: item.sigmas)
    departure = abs(float(worst.departure[worst.largest]))
    share = 100.0 * departure / max(float(np.max(np.abs(item.value))) for item in lines)
    departed = (
        f'the clearest departure is {departure:.2g} 1/m ({share:.1f} % of the largest value) at '
        f's / l = {worst.place:g}, {kilopascals(float(worst.pressure[worst.largest])):z.0f} kPa: '
        f'{worst.sigmas:.1f} standard errors'
    )
    if worst.sigmas > SIGNIFICANT:
        return f'{departed}; these recordings show that it is not exactly linear.'
    return f'{departed}; the values are consistent with a straight line.'
