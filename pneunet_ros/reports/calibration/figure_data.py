"""Data for the figures of a calibration, computed once: steady states and their views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.progress import OnProgress
from pneunet_ros.measurement.linearization import FittedRun
from pneunet_ros.reports.paper_views.moment_curvature import moment_view, MomentView
from pneunet_ros.reports.paper_views.steady_states import (
    find_steady_states,
    longest_states,
    SteadyState,
    thin,
)
from pneunet_ros.reports.style import PressureColors
from pneunet_ros.vision.smoother import FEWEST_TARGETS, Smoother, smoother_for

UNLOADED_SHOWN, LOADED_SHOWN = 10, 12  # steady states, at most


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FigureData:
    """A calibration with the data of its figures.

    free: steady states without load; main: those of the loaded run with the largest pressure span,
    both spread over pressure. The views are those of the states with enough targets.
    """

    calibration: Calibration
    colors: PressureColors
    free: tuple[SteadyState, ...]
    free_views: tuple[MomentView, ...]
    main: tuple[SteadyState, ...]
    main_views: tuple[MomentView, ...]
    on_progress: OnProgress

    @property
    def moment_views(self) -> tuple[MomentView, ...]:
        """The views of the loaded run whose moment is known."""
        return tuple(view for view in self.main_views if view.has_moment)

    @property
    def loaded(self) -> tuple[FittedRun, ...]:
        """The loaded runs of the joint fit."""
        return tuple(item for item in self.calibration.joint.runs if item.run.loaded)


def figure_data(calibration: Calibration, on_progress: OnProgress) -> FigureData:
    """Compute the data of the figures."""
    fit = calibration.joint
    if fit.arm.target_arclength.size != calibration.arm.target_arclength.size:  # a pose of the tip
        arm, covariance = calibration.arm, calibration.arm.covariance
        if covariance is not None:
            covariance = replace(covariance, placement=None)
        arm = replace(arm, target_arclength=fit.arm.target_arclength, covariance=covariance)
        calibration = replace(calibration, arm=arm)
    states = [(item.run, find_steady_states(item, fit.arm)) for item in fit.runs]
    free = [state for run, of_run in states if not run.loaded for state in of_run]
    loaded = [(run, of_run) for run, of_run in states if run.loaded]
    main: tuple[SteadyState, ...] = ()
    if loaded:
        _, main = max(loaded, key=lambda item: float(np.ptp(item[0].frame_pressure)))
    groups = [thin(free, UNLOADED_SHOWN), thin(longest_states(main), LOADED_SHOWN)]
    pressures = [steady_state.pressure for group in groups for steady_state in group]
    on_progress('measured curvature', 0, 1)
    views = views_of(calibration, groups)
    on_progress('measured curvature', 1, 1)
    return FigureData(
        calibration=calibration,
        colors=PressureColors(low=min(pressures), high=max(pressures)),
        free=tuple(groups[0]),
        free_views=views[0],
        main=tuple(groups[1]),
        main_views=views[1],
        on_progress=on_progress,
    )


def views_of(
    calibration: Calibration, groups: Sequence[Sequence[SteadyState]]
) -> list[tuple[MomentView, ...]]:
    """Return the existing views of steady states, group by group."""
    fit = calibration.joint
    if fit.arm.target_arclength.size < FEWEST_TARGETS:
        return [() for _ in groups]
    smoother = smoother_of(fit)
    views = [
        [moment_view(fit, smoother, steady_state) for steady_state in group] for group in groups
    ]
    return [tuple(view for view in group if view is not None) for group in views]


def smoother_of(fit: Fit) -> Smoother:
    """Return the smoother for targets after subtraction of the estimated placement."""
    sensors = replace(fit.arm.sensors, placement_std=0.0)  # already subtracted
    return smoother_for(replace(fit.arm, sensors=sensors))


def nearest_view(views: tuple[MomentView, ...], pressure: float) -> MomentView:
    """Return the view at the nearest pressure (Pa)."""
    return min(views, key=lambda view: abs(view.steady_state.pressure - pressure))


def stations_of(length: float) -> Array:
    """Return stations (m) for smooth lines."""
    return np.linspace(0.0, length, 113)
