"""Small multiples: the shape of every arm under the same pressures."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import millimeters
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import GREY, panels, PressureColors, SECOND, short
from pneunet_ros.reports.survey.survey_data import SurveyData

COLUMNS = 7
PRESSURES = 5  # from none to that of the comparison
STATIONS = 25
PANEL_HEIGHT = 1.55  # inches


def shapes(data: SurveyData) -> Picture | None:
    """Draw the unloaded shape of every arm, with the median of the fleet."""
    arms = [(item.name, item.arm) for item in data.done if item.arm is not None]
    if not arms:
        return None
    pressures = np.linspace(0.0, data.fleet.pressure, PRESSURES)
    curves = np.array([curves_of(arm, pressures) for _, arm in arms])
    median = median_curves(curves)
    columns = min(COLUMNS, len(arms))
    rows = -(-len(arms) // columns)
    figure, axes = panels(columns, rows=rows, height=0.5 + PANEL_HEIGHT * rows)
    colors = PressureColors(low=0.0, high=data.fleet.pressure)
    for panel, (name, _), curve in zip(axes, arms, curves, strict=False):
        for place, pressure in enumerate(pressures.tolist()):
            panel.plot(*median[place], color='0.82', linewidth=2.6, zorder=1)
            panel.plot(*curve[place], color=colors(pressure), linewidth=1.1, zorder=2)
        odd = name in data.odd
        panel.set_title(short(name), fontsize=7, color=SECOND if odd else GREY)
        panel.set_aspect('equal')
        panel.tick_params(labelsize=6, length=0)
        if odd:
            panel.spines[:].set(visible=True, color=SECOND, linewidth=1.6)
    low, high = np.nanmin(curves, axis=(0, 1, 3)), np.nanmax(curves, axis=(0, 1, 3))
    margin = 0.05 * float(np.max(high - low))
    for place, panel in enumerate(axes[: len(arms)]):
        panel.set_xlim(low[0] - margin, high[0] + margin)
        panel.set_ylim(low[1] - margin, high[1] + margin)
        left, bottom = place % columns == 0, place + columns >= len(arms)
        panel.tick_params(labelleft=left, labelbottom=bottom)
        panel.set_xlabel('x (mm)' if bottom else '', fontsize=7)
        panel.set_ylabel('y (mm)' if left else '', fontsize=7)
    for panel in axes[len(arms) :]:
        panel.set_visible(False)
    colors.bar(figure, axes[min(columns, len(axes)) - 1])
    return Picture(
        '03_shapes',
        'Every arm under the same pressures',
        'Unloaded centerlines, predicted by the models with the missing effects, all to the same '
        'scale; grey: the median of the fleet. Red frames: odd arms. Pressures to which an arm '
        'was not calibrated are not drawn.',
        figure,
    )


def curves_of(arm: Arm, pressures: Array) -> Array:
    """Return centerlines in mm, (pressures, 2, stations), NaN beyond the calibrated range."""
    out = np.full((pressures.size, 2, STATIONS), np.nan)
    for place, pressure in enumerate(pressures.tolist()):
        if pressure <= arm.pressure_range[1]:
            shape = solve(arm, pressure, stations=STATIONS)
            out[place] = millimeters(1.0) * np.stack([shape.x, shape.y])
    return out


def median_curves(curves: Array) -> Array:
    """Return the median centerline at each pressure, NaN where no arm has one."""
    out = np.full(curves.shape[1:], np.nan)
    known = np.isfinite(curves).any(axis=0)
    out[known] = np.nanmedian(curves[:, known], axis=0)
    return out
