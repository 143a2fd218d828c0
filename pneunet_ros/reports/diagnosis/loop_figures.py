"""Moment against curvature while pressure rises and falls: loops show memory."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals
from pneunet_ros.diagnosis.result import Evaluation
from pneunet_ros.reports.calibration.figure_data import smoother_of
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.paper_views.moment_curvature import moment_view
from pneunet_ros.reports.paper_views.steady_states import arm_points, average
from pneunet_ros.reports.style import draw_dots, FIRST, GREY, legend, panels, same_height, SECOND
from pneunet_ros.solver.columns import CURVATURE, INTRINSIC_CURVATURE
from pneunet_ros.vision.smoother import FEWEST_TARGETS

FRAMES = 40  # of every recording, at most
DIRECTIONS = ((1.0, 'pressure rising', SECOND), (-1.0, 'pressure falling', FIRST))
HELD = (0.0, 'pressure not moved', GREY)
MILLI = 1000.0  # mN m per N m
TURN_SHARE = 0.02  # of the largest pressure: change of direction with an arrow of its own
TURN_SIGMAS = 6.0  # sigma of a pressure reading: the change must exceed the noise
LOOP_START = 0.3  # s / l; beginning of the averaged middle part of the arm
LOOP_STOP = 0.8  # s / l; its end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loop:
    """The middle of the arm in some frames, one value per frame.

    pressure (Pa) as read; direction -1, 0 or 1; moment (N m) from measured targets; change:
    measured kappa - kappa0, and expected: that of the model (1/m).
    """

    pressure: Array
    direction: Array
    moment: Array
    change: Array
    expected: Array


def moment_loops(data: FigureData) -> Picture | None:
    """Draw moment and curvature in the middle of the arm, by direction of pressure."""
    diagnosis = data.diagnosis
    if diagnosis.before.arm.target_arclength.size < FEWEST_TARGETS:
        return None
    columns = len(data.models)
    figure, axes = panels(columns, rows=2, height=7.4)
    sides = (diagnosis.before, diagnosis.after)[:columns]
    for column, (side, (when, _)) in enumerate(zip(sides, data.models, strict=True)):
        loop = loop_of(side)
        if not loop.pressure.size:
            return None
        draw(axes[column], loop.change, MILLI * loop.moment, loop.direction)
        axes[column].set(
            title=f'({"ab"[column]}) {when}',
            xlabel=r'measured $\kappa - \kappa_0$ (1/m)',
            ylabel=r'moment $M_\mathrm{est}$ (mN m)',
        )
        draw(
            axes[columns + column],
            kilopascals(1.0) * loop.pressure,
            loop.change - loop.expected,
            loop.direction,
        )
        axes[columns + column].axhline(0.0, color='0.4', linewidth=0.9, zorder=1)
        axes[columns + column].set(
            title=f'({"abcd"[columns + column]}) residual of the model, {when}',
            xlabel='pressure (kPa)',
            ylabel='measured - predicted curvature (1/m)',
        )
    for pair in (axes[:columns], axes[columns:]):
        same_height(pair)
    legend(axes[0], loc='best')
    return Picture(
        '06_loops',
        'Moment and curvature, by direction of pressure',
        f'Means over the middle of the arm (s / l from {LOOP_START:g} to {LOOP_STOP:g}) in the '
        'frames of all training recordings. Above: moment from measured shape and end force, '
        'against measured curvature minus that of the unloaded arm; rising and falling pressure '
        'should lie on one band. Below: curvature that the model does not predict. If red and '
        'blue separate into a loop, the history matters (hysteresis, lag, creep); a common '
        'trend indicates another cause; if no effect is missing, all points scatter about zero.',
        figure,
    )


def loop_of(side: Evaluation) -> Loop:
    """Return the loop of the middle of the arm in some frames of every training recording."""
    fit = side.fit
    arm = fit.arm
    smoother = smoother_of(fit)
    largest = max(float(np.abs(item.run.frame_pressure).max()) for item in fit.runs)
    band = max(TURN_SHARE * largest, TURN_SIGMAS * arm.sensors.pressure_std)
    rows = []
    for item in fit.runs:
        points, pressure = arm_points(item, arm), item.run.frame_pressure
        directions = directions_of(pressure, band)
        frames = len(points)
        for frame in np.unique(np.linspace(0, frames - 1, min(FRAMES, frames)).astype(int)):
            view = moment_view(fit, smoother, average(item, points, frame, frame + 1))
            if view is None:
                continue
            share = view.arclength / arm.length
            middle = (share >= LOOP_START) & (share <= LOOP_STOP)
            if not middle.any() or not item.solved[frame]:
                continue
            expected = np.interp(
                view.arclength[middle],
                arm.target_arclength,
                item.fields[frame, CURVATURE] - item.fields[frame, INTRINSIC_CURVATURE],
            )
            rows.append(
                (
                    view.steady_state.pressure,
                    directions[frame],
                    view.moment[middle].mean(),
                    view.change[middle].mean(),
                    expected.mean(),
                )
            )
    columns = np.array(rows).reshape(-1, 5).T
    names = ('pressure', 'direction', 'moment', 'change', 'expected')
    return Loop(**dict(zip(names, columns, strict=True)))


def directions_of(pressure: Array, band: float) -> Array:
    """Return the direction of the pressure, (frames,): 1 rising, -1 falling, 0 unchanged.

    A hold has the direction in which it was reached, because the arm has memory. The pressure has
    reversed when it is `band` (Pa) away from its last extreme.
    """
    direction, extreme = 0.0, float(pressure[0])
    out = np.zeros(pressure.size)
    for frame, value in enumerate(pressure.tolist()):
        if direction * (value - extreme) > 0.0:
            extreme = value
        elif abs(value - extreme) > band:
            direction, extreme = float(np.sign(value - extreme)), value
        out[frame] = direction
    return out


def draw(axes: Axes, x: Array, y: Array, direction: Array) -> None:
    """Draw points colored by direction."""
    for sign, label, color in (*DIRECTIONS, HELD):
        moving = direction == sign
        if moving.any():
            draw_dots(axes, x[moving], y[moving], 3.4, alpha=0.75, color=color, label=label)
