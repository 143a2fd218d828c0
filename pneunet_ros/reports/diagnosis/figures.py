"""The table of figures of a diagnosis: a figure is a function in this room and a line here."""

from __future__ import annotations

from pneunet_ros.reports.diagnosis.discovery_figures import amplitude, causes, discovered_error
from pneunet_ros.reports.diagnosis.error_figures import (
    errors_along_arm,
    model_error,
    shapes,
)
from pneunet_ros.reports.diagnosis.evidence_figures import biased_parameters, evidence
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.diagnosis.localization_figures import maps, shares
from pneunet_ros.reports.diagnosis.loop_figures import loops
from pneunet_ros.reports.figure import Figures

FIGURES: Figures[FigureData] = {
    'error': (errors_along_arm, model_error, shapes),
    'where': (maps, shares, loops),
    'discovered': (causes, amplitude, discovered_error),
    'evidence': (evidence,),
    'biased': (biased_parameters,),
}
