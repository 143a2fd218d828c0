"""Figure 9 (c) of the paper: end forces estimated from targets versus readings."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.calibration import tip_force
from pneunet_ros.calibration.tip_force import EndForces
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals
from pneunet_ros.reports.calibration.figure_data import FigureData
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import BAND_SIGMAS, draw_errors, FIRST, legend, panels, SECOND

FRAMES = 60  # in all, of all loaded runs
MILLI = 1000.0  # mN per N
WIDEST = 3.0  # times the largest force: the limits of the axis ignore more uncertain ones
WAYS = (('all targets', False, FIRST), ('the tip alone', True, SECOND))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedForces:
    """Forces of some frames: pressure (n,) Pa, measured (n, 2) N with read_std, and estimated."""

    pressure: Array
    read: Array
    read_std: float
    ways: tuple[EndForces, ...]


def estimated_forces(data: FigureData) -> EstimatedForces:
    """Estimate the end force of some frames of every loaded run by both methods."""
    arm, loaded = data.calibration.arm, data.loaded
    most = max(FRAMES // len(loaded), 2)
    runs = [item.run.thin(most) for item in loaded]
    parts: list[list[EndForces]] = [[], []]
    for place, run in enumerate(runs):
        for way, (_, tip_only, _) in enumerate(WAYS):
            data.on_progress('end forces', 2 * place + way, 2 * len(runs))
            parts[way].append(tip_force.end_forces(arm, run, tip_only=tip_only))
    return EstimatedForces(
        pressure=np.concatenate([run.frame_pressure for run in runs]),
        read=np.concatenate([run.force for run in runs]),
        read_std=arm.sensors.force_std,
        ways=tuple(
            EndForces(
                force=np.concatenate([item.force for item in of_way]),
                covariance=np.concatenate([item.covariance for item in of_way]),
            )
            for of_way in parts
        ),
    )


def end_forces(data: FigureData) -> Picture | None:
    """Figure 9 (c)."""
    if not data.main:
        return None
    found = estimated_forces(data)
    figure, axes = panels(2, rows=2, height=7.6)
    largest = MILLI * float(np.max(np.abs(found.read)))
    for component in range(2):
        for (name, _, color), way in zip(WAYS, found.ways, strict=True):
            draw_comparison(
                axes[component], axes[2 + component], found, way, component, name, color
            )
        read = MILLI * found.read[:, component]
        ends = np.array([read.min(), read.max()])
        margin = 0.12 * max(float(np.ptp(ends)), 0.2 * largest)
        ends = ends + margin * np.array([-1.0, 1.0])
        axes[component].plot(ends, ends, color='0.4', linewidth=0.9, zorder=1)
        label = f'F{component + 1}'
        axes[component].set(
            title=f'({"ac"[component]}) {label} along {"xy"[component]}',
            xlabel=f'{label} measured (mN)',
            ylabel=f'{label} found (mN)',
            xlim=ends,
            ylim=ends + np.array([-0.25, 0.25]) * np.ptp(ends),
        )
        axes[2 + component].axhline(0.0, color='0.4', linewidth=0.9)
        axes[2 + component].set(
            title=f'({"bd"[component]}) error of {label}',
            xlabel='pressure (kPa)',
            ylabel=f'{label} found - measured (mN)',
        )
        limit = limit_of(found, component)
        axes[2 + component].set_ylim(-limit, limit)
    legend(axes[1], loc='upper left')
    return Picture(
        '09c_end_forces',
        'End force found from targets',
        f'The pressure is known, the force is not: {" ".join(sentences(found))} Bars are 2 '
        'sigma; they should reach the line in 19 of 20 cases. Bars from the tip alone are long '
        'where the arm is nearly straight, because one point hardly determines the pull (some '
        'bars are cut off). Errors from the tip alone are correlated, because all depend on the '
        'position of that one target. If errors from all targets exceed the bars and keep their '
        'sign over a range of pressure, an effect is missing in the model.',
        figure,
        number='9 (c)',
    )


def draw_comparison(
    against: Axes,
    error: Axes,
    found: EstimatedForces,
    way: EndForces,
    component: int,
    name: str,
    color: str,
) -> None:
    """Draw estimated versus measured forces, and their errors over pressure."""
    sigma = way.sigma[:, component]
    value = way.force[:, component]
    x = MILLI * found.read[:, component], kilopascals(1.0) * found.pressure
    y = MILLI * value, MILLI * (value - found.read[:, component])
    error_std = np.hypot(sigma, found.read_std)
    all_targets = color == FIRST
    for axes, at, what, std in zip((against, error), x, y, (sigma, error_std), strict=True):
        draw_errors(
            axes,
            at,
            what,
            MILLI * std,
            markersize=3.6,
            markerfacecolor=color if all_targets else 'white',
            color=color,
            elinewidth=1.4 if all_targets else 0.7,
            alpha=0.9 if all_targets else 0.7,
            zorder=4 if all_targets else 3,
            label=f'from {name}',
        )


def limit_of(found: EstimatedForces, component: int) -> float:
    """Return the limit (mN) of the error axis, which includes most bars of both methods."""
    reach = [
        np.abs(way.force[:, component] - found.read[:, component])
        + BAND_SIGMAS * np.hypot(way.sigma[:, component], found.read_std)
        for way in found.ways
    ]
    values = np.concatenate(reach)
    values = values[np.isfinite(values)]
    if values.size == 0:
        return 1.0
    largest = WIDEST * float(np.max(np.abs(found.read)))
    return MILLI * 1.15 * min(float(np.quantile(values, 0.8)), largest)


def sentences(found: EstimatedForces) -> list[str]:
    """Describe the error of each force estimate, and the coverage of its interval."""
    lines = []
    for (name, _, _), way in zip(WAYS, found.ways, strict=True):
        known = np.isfinite(way.force[:, 0])
        if not known.any():
            lines.append(f'From {name}, no force was found in any of {known.size} frames.')
            continue
        error = way.force[known] - found.read[known]
        std = np.hypot(way.sigma[known], found.read_std)
        inside = np.mean(np.abs(error) < 1.96 * std, axis=0)
        median = MILLI * np.median(way.sigma[known], axis=0)
        lines.append(
            f'From {name}, found in {np.count_nonzero(known)} of {known.size} frames: median '
            f'sigma {median[0]:.2g} and {median[1]:.2g} mN of F1 and F2; {100 * inside[0]:.0f} % '
            f'and {100 * inside[1]:.0f} % of the 95 % intervals contain the measured force.'
        )
    return lines
