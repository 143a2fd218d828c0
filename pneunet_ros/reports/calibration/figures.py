"""The pictures of a calibration, in the order of the paper's figures, then its residuals."""

from __future__ import annotations

from collections.abc import Callable

from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.reports.calibration.figure_data import Each, figure_data, FigureData
from pneunet_ros.reports.calibration.force_figures import end_force_picture
from pneunet_ros.reports.calibration.moment_figures import law, moments, one_moment
from pneunet_ros.reports.calibration.residual_figures import (
    law_comparison,
    over_frames,
    over_runs,
    over_targets,
)
from pneunet_ros.reports.calibration.shape_figures import (
    free_shapes,
    loaded_shapes,
    predicted_shapes,
)
from pneunet_ros.reports.calibration.trend_figures import linearity, sensitivity
from pneunet_ros.reports.style import Picture

Draw = Callable[[FigureData], Picture]


def calibration_figures(calibration: Calibration, each: Each) -> tuple[Picture, ...]:
    """Draw all pictures that these recordings allow; `each` is told how far it is."""
    data = figure_data(calibration, each)
    draws = chosen_draws(data, each)
    pictures = []
    for count, draw in enumerate(draws):
        each('pictures', count, len(draws))
        pictures.append(draw(data))
    each('pictures', len(draws), len(draws))
    return tuple(pictures)


def chosen_draws(data: FigureData, each: Each) -> list[Draw]:
    """Return what can be drawn: without load no moment law, with few targets no views."""
    draws: list[Draw] = [free_shapes]
    if data.main:
        draws.append(loaded_shapes)
    if data.main_views:
        draws += [moments, one_moment]
    if data.main:
        draws.append(law)
    if data.main_views:
        draws.append(predicted_shapes)
    if data.main:
        draws.append(lambda known: end_force_picture(known, each))
    if data.main_views:
        draws.append(sensitivity)
    draws += [linearity, over_frames, over_targets, over_runs]
    if data.calibration.laws:
        draws.append(law_comparison)
    return draws
