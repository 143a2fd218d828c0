"""The table of figures of a calibration: each is a function in this package and a line here."""

from __future__ import annotations

from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.core.progress import OnProgress
from pneunet_ros.reports.calibration.figure_data import figure_data, FigureData
from pneunet_ros.reports.calibration.force_figures import end_forces
from pneunet_ros.reports.calibration.moment_figures import law, moments, one_moment
from pneunet_ros.reports.calibration.residual_figures import (
    draw_residuals_by_frame,
    draw_residuals_by_target,
    law_comparison,
)
from pneunet_ros.reports.calibration.shape_figures import free_shapes, loaded_shapes
from pneunet_ros.reports.calibration.trend_figures import linearity, sensitivity
from pneunet_ros.reports.figure import draw_figures, Figures, Pictures

FIGURES: Figures[FigureData] = {
    'paper': (
        free_shapes,
        loaded_shapes,
        moments,
        one_moment,
        law,
        end_forces,
        sensitivity,
        linearity,
    ),
    'residuals': (
        draw_residuals_by_frame,
        draw_residuals_by_target,
        law_comparison,
    ),
}  # fmt: skip


def calibration_figures(calibration: Calibration, on_progress: OnProgress) -> Pictures:
    """Draw all figures that these recordings allow; `on_progress` reports progress."""
    return draw_figures(FIGURES, figure_data(calibration, on_progress), on_progress)
