"""What the pictures of a calibration show, worked out once: stances of its runs, their views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.fitted import FittedRun
from pneunet_ros.calibration.stances import by_pressure, by_time, spread, Stance, stances
from pneunet_ros.calibration.views import moment_view, MomentView
from pneunet_ros.centerline import FEWEST_TARGETS, Smoother, smoother_for
from pneunet_ros.report_style import PressureColors
from pneunet_ros.shape import Array

SHOWN = 12  # stances of a run
UNLOADED_SHOWN = 10  # as in the paper


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FigureData:
    """A calibration with what its pictures need.

    free: stances without load, spread over pressure; stances: those of all loaded runs, spread
    over each; main_stances: those of the loaded run that spans most pressure, spread over it. The
    views are theirs, without those that have too few targets for one.
    """

    calibration: Calibration
    colors: PressureColors
    free: tuple[Stance, ...]
    free_views: tuple[MomentView, ...]
    stances: tuple[Stance, ...]
    views: tuple[MomentView, ...]
    main: tuple[MomentView, ...]
    main_stances: tuple[Stance, ...]

    @property
    def loaded(self) -> tuple[FittedRun, ...]:
        """The loaded runs of the joint fit."""
        return tuple(item for item in self.calibration.joint.runs if item.run.loaded)

    @property
    def weight_length(self) -> float:
        """The scale of moments, mg l (N m)."""
        return self.calibration.arm.weight * self.calibration.arm.length


def figure_data(
    calibration: Calibration,
    each: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> FigureData:
    """Work out what the pictures show."""
    fit, arm = calibration.joint, calibration.arm
    # The placement that was found is taken off the targets, so no more of it is expected.
    exact = replace(arm, sensors=replace(arm.sensors, placement_std=0.0))
    smoother = smoother_for(exact) if arm.target_arclength.size >= FEWEST_TARGETS else None
    everything = [(item.run, stances(item, fit.arm)) for item in fit.runs]
    free = [stance for run, some in everything if not run.loaded for stance in some]
    loaded = [(run, some) for run, some in everything if run.loaded]
    chosen = [stance for _, some in loaded for stance in spread(some, SHOWN, by_time)]
    main: list[Stance] = []
    if loaded:
        widest = max(loaded, key=lambda item: float(np.ptp(item[0].frame_pressure)))
        main = spread(widest[1], SHOWN, by_pressure)
    unloaded = spread(free, UNLOADED_SHOWN)
    pressures = [stance.pressure for stance in (*unloaded, *chosen, *main)]
    sets = [unloaded, chosen, main]
    views: list[tuple[MomentView, ...]] = []
    for count, group in enumerate(sets):
        each('measured curvature', count, len(sets))
        views.append(views_of(calibration, smoother, group))
    return FigureData(
        calibration=calibration,
        colors=PressureColors(low=min(pressures), high=max(pressures)),
        free=tuple(unloaded),
        free_views=views[0],
        stances=tuple(chosen),
        views=views[1],
        main=views[2],
        main_stances=tuple(main),
    )


def views_of(
    calibration: Calibration, smoother: Smoother | None, some: list[Stance]
) -> tuple[MomentView, ...]:
    """Return the views of the stances that have one."""
    if smoother is None:
        return ()
    found = [moment_view(calibration.joint, smoother, stance) for stance in some]
    return tuple(view for view in found if view is not None)


def nearest_view(views: tuple[MomentView, ...], pressure: float) -> MomentView:
    """Return the view at the pressure nearest to this one (Pa)."""
    return min(views, key=lambda view: abs(view.stance.pressure - pressure))


def stations_of(length: float, count: int = 113) -> Array:
    """Return stations (m) for smooth lines."""
    return np.linspace(0.0, length, count)
