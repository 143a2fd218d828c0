"""The picture of the demo: shapes, curvatures and moment law."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.units import millimeters
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.model.arm import Arm
from pneunet_ros.reports.style import as_shapes, draw_force, figure_text, panels, PressureColors
from pneunet_ros.solver.columns import START

ELLIPSE_SIGMAS = 2.0


def draw_holds(arm: Arm, holds: Sequence[ShapeEstimate], path: Path, title: str) -> None:
    """Draw shapes, curvatures and moment law of estimates, colored by pressure."""
    pressures = [hold.shape.pressure for hold in holds]
    colors = PressureColors(low=min(pressures, default=0.0), high=max(pressures, default=0.0))
    figure, (shapes, curvatures, moments) = panels(3, height=5.6, width=15.0)
    for hold, pressure in zip(holds, pressures, strict=True):
        color = colors(pressure)
        draw_shape(shapes, hold, color)
        share = hold.shape.arclength / arm.length
        curvatures.plot(share, hold.shape.curvature, color=color, linewidth=1.8)
        curvatures.plot(
            share, hold.shape.intrinsic_curvature, color=color, linewidth=0.9, linestyle=':'
        )
        draw_moment(moments, arm, hold, color)
    as_shapes(shapes, 'Predicted shapes, end forces and 2-sigma tips')
    curvatures.set(
        title='Curvature; dotted: intrinsic, unloaded',
        xlabel='arclength s / l',
        ylabel='curvature (1/m)',
        xlim=(0.0, 1.0),
    )
    moments.set(
        title='Moment law (Eq 10): dashed [0, l1), solid [l1, l]',
        xlabel='curvature minus intrinsic curvature (1/m)',
        ylabel='moment (mN m)',
    )
    colors.bar(figure, moments)
    figure.suptitle(figure_text(title), fontsize=14)
    figure.savefig(path, dpi=130, format=path.suffix.lstrip('.') or 'png')


def draw_shape(axes: Axes, estimate: ShapeEstimate, color: tuple[float, ...]) -> None:
    """Draw the centerline, the end force as an arrow, and the ellipse of the tip's uncertainty."""
    shape = estimate.shape
    x, y = millimeters(1.0) * shape.x, millimeters(1.0) * shape.y
    axes.plot(x, y, color=color, linewidth=2.2, solid_capstyle='round')
    if np.hypot(*shape.force) > 0.0:
        draw_force(axes, np.array([x[-1], y[-1]]), np.array(shape.force), color)
    values, vectors = np.linalg.eigh(estimate.tip_covariance[:2, :2])
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    circle = np.array([np.cos(angle), np.sin(angle)])
    radii = ELLIPSE_SIGMAS * millimeters(1.0) * np.sqrt(np.maximum(values, 0.0))
    ellipse = vectors @ (radii[:, None] * circle)
    axes.plot(x[-1] + ellipse[0], y[-1] + ellipse[1], color=color, linewidth=1.0)


def draw_moment(axes: Axes, arm: Arm, estimate: ShapeEstimate, color: tuple[float, ...]) -> None:
    """Draw moment against change of curvature, one line per section of the law."""
    shape = estimate.shape
    sections = arm.rods(np.array([estimate.chamber_pressure])).sections[0]
    change = shape.curvature - shape.intrinsic_curvature
    for index, section in enumerate(sections):
        stop = sections[index + 1, START] if index + 1 < len(sections) else arm.length
        inside = (shape.arclength >= section[START]) & (shape.arclength <= stop)
        style = '--' if index + 1 < len(sections) else '-'
        axes.plot(
            change[inside],
            1000.0 * shape.moment[inside],
            color=color,
            linestyle=style,
            linewidth=1.6,
        )
