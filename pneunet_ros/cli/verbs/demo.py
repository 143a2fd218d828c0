"""`pneunet demo`: run the estimator on Table 1 of the paper; writes a table, MCAP and picture.

Kernels that are not cached are compiled when called, because the demo needs only a third of them,
and also runs without the image libraries.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.core.kernels.cache import kernels_are_cached
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.steady_estimates import steady_estimates
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.model.uncertainty import error_left_out
from pneunet_ros.offline.replay import input_topics, record_steps, Step
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
from rich.console import Console

RECORDING = 'bags/table1'


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    verb.add_model(parser)
    parser.add_argument(
        '--output',
        type=Path,
        default=Path('demo'),
        metavar='DIR',
        help='folder for table1.mcap and shapes.png (default: demo)',
    )
    verb.add_overwrite(parser)


def run(arguments: Namespace) -> int:
    """Replay the shipped recording, print its holds, write recording and picture."""
    arm = verb.model_of(arguments)
    estimator = Estimator(arm=arm)
    recording = open_recording(share_path(RECORDING))
    topics = input_topics(recording, estimator, {})
    mcap, picture = arguments.output / 'table1.mcap', arguments.output / 'shapes.png'
    estimates: list[ShapeEstimate] = []
    with (
        atomic_output(picture, overwrite=arguments.overwrite) as temporary,
        write_recording(mcap, overwrite=arguments.overwrite) as writer,
        verb.progress_bar(shown=not arguments.json) as bar,
    ):
        compiled = kernels_are_cached()
        if not compiled and not arguments.json:
            print(
                'compiling the kernels of the demo (once only): about 10 s of CPU', file=sys.stderr
            )
        name = 'replaying Table 1' if compiled else 'compiling, then replaying Table 1'
        task = bar.add_task(name, total=recording.count(topics))

        def on_progress(step: Step) -> None:
            bar.advance(task)
            if isinstance(step.outcome, ShapeEstimate):
                estimates.append(step.outcome)

        record_steps(writer, recording, estimator, topics, on_progress)
        holds = first_of_each_pressure(steady_estimates(estimates))
        from pneunet_ros.reports.demo_plot import draw_holds

        title = f"Table 1 of the paper (pressures and end forces) through '{arm.name}'"
        draw_holds(arm, holds, temporary, title)
    content = {
        'holds': [row_of(hold) for hold in holds],
        'std_leaves_out': error_left_out(arm.covariance, arm.sources),
        'estimates': len(estimates),
        'files': [mcap, picture],
    }
    verb.present(arguments, content, lambda console: show(content, console))
    return verb.DONE if holds else verb.NEGATIVE


def first_of_each_pressure(holds: list[ShapeEstimate]) -> list[ShapeEstimate]:
    """Return the holds of the upward sweep; the downward sweep repeats the same pressures."""
    seen: dict[float, ShapeEstimate] = {}
    for hold in holds:
        seen.setdefault(hold.shape.pressure, hold)
    return list(seen.values())


def row_of(hold: ShapeEstimate) -> dict[str, float]:
    """Return the results for one hold, SI."""
    shape = hold.shape
    x, y, theta = shape.tip
    std_x, std_y = np.sqrt(np.diag(hold.tip_covariance))[:2].tolist()
    largest = int(np.argmax(np.abs(shape.curvature)))
    return {
        'pressure': shape.pressure,
        'force_x': shape.force[0],
        'force_y': shape.force[1],
        'tip_x': x,
        'tip_y': y,
        'tip_theta': theta,
        'tip_std': math.hypot(std_x, std_y),
        'largest_curvature': float(shape.curvature[largest]),
        'residual': shape.residual,
    }


def show(content: dict[str, Any], console: Console) -> None:
    """Print the holds as a table."""
    columns: dict[str, tuple[str, Callable[[float], float], str]] = {
        'p (kPa)': ('pressure', kilopascals, 'z.1f'),
        'F1 (N)': ('force_x', float, '.3f'),
        'F2 (N)': ('force_y', float, '.3f'),
        'tip x (mm)': ('tip_x', millimeters, '.2f'),
        'tip y (mm)': ('tip_y', millimeters, '.2f'),
        'heading (deg)': ('tip_theta', math.degrees, '.1f'),
        'tip std (mm)': ('tip_std', millimeters, '.2f'),
        'largest curvature (1/m)': ('largest_curvature', float, '.1f'),
    }
    rows = [
        [f'{shown(row[name]):{form}}' for name, shown, form in columns.values()]
        for row in content['holds']
    ]
    title = f'The {len(rows)} holds of Table 1, as the estimator sees the arm'
    print_rows(console, title, tuple(columns), rows, numbers=range(len(columns)))
    console.print(
        'Pressures and forces are from the paper; stiffness and curvature of the arm are '
        'representative, not measured.'
    )
    if content['std_leaves_out']:
        verb.print_notes(console, [content['std_leaves_out']])
    mcap, picture = content['files']
    estimates = f'{content["estimates"]} estimates in {mcap}'
    console.print(f'{estimates} (Foxglove, PlotJuggler, ros2 bag play)')
    console.print(f'picture in {picture}')
