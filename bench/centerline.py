"""Accuracy of measured curvature, compared with common methods on the same noisy targets.

    python bench/centerline.py [--json] [--repeats N]

Root mean square error of curvature (1/m) over stations between first and last target, at 0.03,
0.1 and 0.3 px of 0.2 mm. Shapes: clothoids and arcs; the shipped arm free and under the loads of
Table 1 (whose curvature has a break at l1); clothoids with a break of 2.5/m. Each of the others
knows the noise, or has its setting chosen by the truth: the spline is told how much noise to
leave, the best window of the local cubic is taken for every set of shapes and noise. The Gaussian
process of scikit-learn learns its hyperparameters anew for every frame, of x and of y; it takes so
long that it sees the first few frames of each shape only.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from pathlib import Path
import platform
import statistics
import sys
import time
import warnings

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.model.arm import Arm
from pneunet_ros.vision.smoother import smoother_for
from scipy.interpolate import UnivariateSpline

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support.example_arms import TABLE_1

CLOTHOIDS = ((0, 0), (5, 5), (15, 15), (25, 25), (0, 20), (20, 0), (5, 30), (-10, 10), (10, 20))
BREAK, SPLITS = 2.5, (0.10, 0.115, 0.13, 0.15)  # 1/m; l1 / l
PIXEL = 2e-4  # m
NOISES_PX = (0.03, 0.1, 0.3)
WINDOWS = (5, 7, 9, 11, 13)
SEED = 3
FEW = 3  # frames of every shape that scikit-learn sees
Points = np.ndarray  # (targets, 2) m
Method = Callable[[Points, float], np.ndarray]  # points, noise (m) -> curvature at stations


def eq_1(x1: np.ndarray, y1: np.ndarray, x2: np.ndarray, y2: np.ndarray) -> np.ndarray:
    """Curvature from first and second derivatives."""
    return (x1 * y2 - x2 * y1) / (x1 * x1 + y1 * y1) ** 1.5


class Shapes:
    """The sets of shapes: points at targets, curvature at the stations between them."""

    def __init__(self, arm: Arm, stations: int = 57) -> None:
        self.arm = arm
        self.targets = arm.target_arclength
        every = np.linspace(0.0, arm.length, stations)
        inside = (every >= self.targets[0]) & (every <= self.targets[-1])
        self.stations = every[inside]
        pressures = np.linspace(*arm.pressure_range, 11)[1:].tolist()
        broken = [(first, last, split) for first, last in ((5, 15), (20, 5)) for split in SPLITS]
        self.sets = {
            'clothoids and arcs': [self.clothoid(*ends, 0.0) for ends in CLOTHOIDS],
            'arm, free': [self.solved(pressure, 0.0, 0.0) for pressure in pressures],
            'arm, Table 1': [self.solved(row.pressure, *row.force) for row in TABLE_1[1:]],
            'clothoids with a break': [
                self.clothoid(first, last, split) for first, last, split in broken
            ],
        }

    def solved(self, pressure: float, along: float, across: float) -> tuple[Points, np.ndarray]:
        """Return the shape that the model predicts."""
        shape = solve(self.arm, pressure, (along, across), stations=2241)
        points = [np.interp(self.targets, shape.arclength, axis) for axis in (shape.x, shape.y)]
        curvature = np.interp(self.stations, shape.arclength, shape.curvature)
        return np.column_stack(points), curvature

    def clothoid(self, first: float, last: float, split: float) -> tuple[Points, np.ndarray]:
        """Curvature linear in arclength, less by BREAK before `split`."""
        s = np.linspace(0.0, self.arm.length, 20001)

        def kappa(at: np.ndarray) -> np.ndarray:
            before = at < split * self.arm.length
            return first + (last - first) * at / self.arm.length - BREAK * before

        step, values = s[1], kappa(s)
        theta = np.append(0.0, np.cumsum(0.5 * step * (values[1:] + values[:-1])))
        tangent = np.exp(1j * theta)
        z = np.append(0.0, np.cumsum(0.5 * step * (tangent[1:] + tangent[:-1])))
        points = [np.interp(self.targets, s, axis) for axis in (z.real, z.imag)]
        return np.column_stack(points), kappa(self.stations)


def ours(arm: Arm) -> Method:
    """Smooth as the tracker does."""
    smoother = smoother_for(arm)
    nothing = np.full(arm.target_arclength.size, np.nan)

    def curvature(points: Points, noise: float) -> np.ndarray:
        sightings = TargetSightings(
            stamp_ns=0, x=points[:, 0], y=points[:, 1], std=np.full(len(points), noise),
            u=nothing, v=nothing, area=nothing, major=nothing, minor=nothing, angle=nothing,
        )  # fmt: skip
        return smoother.smooth(sightings).curvature

    return curvature


def gaussian_process(targets: np.ndarray, stations: np.ndarray) -> Method:
    """Smooth with scikit-learn, RBF and white noise learnt for every frame; textbook."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, RBF, WhiteKernel

    at = targets[:, None] / targets[-1]
    away = (stations[:, None] - targets) / targets[-1]

    def derivatives(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        kernel = ConstantKernel(1.0, (1e-3, 1e6)) * RBF(0.5, (0.05, 10.0))
        kernel += WhiteKernel(1e-6, (1e-12, 1e-1))
        process = GaussianProcessRegressor(kernel, normalize_y=True).fit(at, values)
        learnt = process.kernel_.k1
        width = learnt.k2.length_scale
        weights = learnt.k1.constant_value * np.exp(-0.5 * (away / width) ** 2) * process.alpha_
        weights *= np.std(values) / targets[-1]
        slope = np.sum(-away / width**2 * weights, axis=1)
        bend = np.sum((away**2 / width**4 - 1.0 / width**2) * weights, axis=1)
        return slope, bend / targets[-1]

    def curvature(points: Points, noise: float) -> np.ndarray:
        (x1, x2), (y1, y2) = derivatives(points[:, 0]), derivatives(points[:, 1])
        return eq_1(x1, y1, x2, y2)

    return curvature


def quintic_spline(targets: np.ndarray, stations: np.ndarray) -> Method:
    """Smooth with a quintic spline that leaves the noise as residual."""

    def curvature(points: Points, noise: float) -> np.ndarray:
        splines = [
            UnivariateSpline(targets, axis, k=5, s=targets.size * noise**2) for axis in points.T
        ]
        (x1, y1), (x2, y2) = (
            [spline.derivative(order)(stations) for spline in splines] for order in (1, 2)
        )
        return eq_1(x1, y1, x2, y2)

    return curvature


def local_cubic(targets: np.ndarray, stations: np.ndarray, window: int) -> Method:
    """Fit a cubic to the targets around each station."""
    rows = np.zeros((2, stations.size, targets.size))
    for index, station in enumerate(stations):
        start = np.searchsorted(targets, station) - window // 2
        start = int(np.clip(start, 0, targets.size - window))
        near = slice(start, start + window)
        fit = np.linalg.pinv(np.vander(targets[near] - station, 4, increasing=True))
        rows[0, index, near], rows[1, index, near] = fit[1], 2.0 * fit[2]

    def curvature(points: Points, noise: float) -> np.ndarray:
        (x1, y1), (x2, y2) = (row.T for row in rows @ points)
        return eq_1(x1, y1, x2, y2)

    return curvature


def error_of(method: Method, shapes: list, noise: float, repeats: int) -> tuple[float, float]:
    """Root mean square error (1/m) and median seconds per frame; the same noise for each."""
    squares, seconds = [], []
    for index, (points, curvature) in enumerate(shapes):
        random = np.random.default_rng([SEED, index])
        for _ in range(repeats):
            noisy = points + noise * random.normal(size=points.shape)
            start = time.perf_counter()
            found = method(noisy, noise)
            seconds.append(time.perf_counter() - start)
            squares.append(np.mean((found - curvature) ** 2))
    return float(np.sqrt(np.mean(squares))), statistics.median(seconds)


def curvature_errors(arm: Arm, repeats: int) -> dict[str, object]:
    """Errors (1/m) by set of shapes, method and noise in px; median microseconds per frame."""
    shapes = Shapes(arm)
    places = shapes.targets, shapes.stations
    methods = {
        'ours': [ours(arm)],
        'scikit-learn': [gaussian_process(*places)],
        'quintic spline': [quintic_spline(*places)],
        'local cubic': [local_cubic(*places, window) for window in WINDOWS],
    }
    errors: dict[str, dict[str, dict[str, float]]] = {}
    times: dict[str, list[float]] = {name: [] for name in methods}
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # both libraries warn of fits that did not converge
        for title, members in shapes.sets.items():
            errors[title] = {name: {} for name in methods}
            for noise_px in NOISES_PX:
                for name, variants in methods.items():
                    frames = min(repeats, FEW) if name == 'scikit-learn' else repeats
                    found = [error_of(one, members, noise_px * PIXEL, frames) for one in variants]
                    error, seconds = min(found)
                    errors[title][name][f'{noise_px:g}'] = error
                    times[name].append(seconds)
    return {
        'curvature_error_per_m': errors,
        'median_us': {name: 1e6 * statistics.median(values) for name, values in times.items()},
    }


def show(result: dict) -> None:
    """Print the errors as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title='rms error of curvature, 1/m')
    table.add_column('shapes')
    table.add_column('method')
    for noise_px in NOISES_PX:
        table.add_column(f'{noise_px:g} px', justify='right')
    for title, methods in result['curvature_error_per_m'].items():
        for name, values in methods.items():
            cells = [f'{value:.3f}' for value in values.values()]
            table.add_row(title if name == 'ours' else '', name, *cells)
        table.add_section()
    console = Console(width=100)
    console.print(table)
    times = ', '.join(f'{name} {value:.3g}' for name, value in result['median_us'].items())
    console.print(f'median time per frame, us: {times}')


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument(
        '--repeats',
        type=int,
        default=20,
        help='number of noisy frames of each shape (default: 20)',
    )
    arguments = command.parse_args()
    result = curvature_errors(load_model(share_path('config/paper_arm.yaml')), arguments.repeats)
    if arguments.json:
        machine = {'machine': platform.machine(), 'python': platform.python_version()}
        print(json.dumps({'bench': 'centerline', **machine, **result}))
    else:
        show(result)


if __name__ == '__main__':
    main()
