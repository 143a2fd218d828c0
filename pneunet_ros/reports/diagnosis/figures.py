"""The table of figures of a diagnosis: a figure is a function in this package and a line here."""

from __future__ import annotations

from pneunet_ros.reports.diagnosis.bias_figures import biased_parameters
from pneunet_ros.reports.diagnosis.discovery_figures import amplitude, causes
from pneunet_ros.reports.diagnosis.error_figures import errors_along_arm, model_error
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.diagnosis.localization_figures import misfit_maps, shares
from pneunet_ros.reports.diagnosis.loop_figures import moment_loops
from pneunet_ros.reports.figure import Figures

FIGURES: Figures[FigureData] = {
    'error': (errors_along_arm, model_error),
    'where': (misfit_maps, shares, moment_loops),
    'discovered': (causes, amplitude),
    'biased': (biased_parameters,),
}
