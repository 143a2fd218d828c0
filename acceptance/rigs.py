"""Rigs of the virtual lab, each with its calibrated model, for the acceptance tests of the fusion.

A rig is an arm with parameters up to 15 % off; `calibrate` makes its model from six recordings. A
bench fuses further recordings of it. Rigs that are done can be kept in a folder and are not
computed again by the same commit.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
import dataclasses
from functools import partial
import json
import math
import multiprocessing
from pathlib import Path
import platform
import subprocess
import time

from calibration import LOADED, record, UNLOADED
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.json_text import plain
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.sensors import LabNoise
from pneunet_ros.model.arm import Arm
from rich.console import Console
from rich.progress import track
from scipy.stats import norm

FIRST_SEED = 5000
QUICK = 1, 4  # rigs, and recordings of each
ANSWERED = 0.95  # of what asks for an estimate, at least
WORST = 0.88  # of a recording within the stated 95 %, at least
Rows = dict[str, Array]  # of a rig, by what was tried
Try = Callable[[int, int], Rows]  # of the seed of a rig, and how many recordings
ALL = slice(None)


def model_of(seed: int, dots: slice | list[int] = ALL) -> Arm:
    """Return the model of a rig, calibrated; dots: those that are painted."""
    runs, scenario = record(seed)
    frame = load_model(share_path('config/paper_arm.yaml'))
    frame = dataclasses.replace(frame, target_arclength=scenario.arm.targets[dots])
    unloaded, loaded = (
        [dataclasses.replace(runs[name], x=runs[name].x[:, dots], y=runs[name].y[:, dots])
         for name in names]
        for names in (UNLOADED, LOADED)
    )  # fmt: skip
    return calibrate(unloaded, loaded, frame, compare=False).arm


def read_sensors(recording: LabRecording, random: np.random.Generator) -> Array:
    """Return what noisy sensors read: F1, F2 (N), M (N m), pressure (Pa), (instants, 4)."""
    truth, noise = recording.truth, LabNoise()
    size = np.array([noise.force_std, noise.force_std, noise.moment_std, noise.pressure_std])
    true = np.column_stack([truth.force, truth.moment, truth.pressure])
    return true + size * random.standard_normal(true.shape)


def wrench_of(stamp_ns: int, read: Array) -> WrenchReading:
    """Return the end wrench of a row of `read_sensors`."""
    force_x, force_y, moment, _ = read.tolist()
    return WrenchReading(
        stamp_ns=stamp_ns, force_x=force_x, force_y=force_y, moment=moment, frame_id=BASE_FRAME
    )


def sightings_of(stamp_ns: int, x: Array, y: Array) -> TargetSightings:
    """Return targets seen at places (targets,) m, of which nothing else is known."""
    names = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')
    nothing = np.full(x.shape, np.nan)
    return TargetSightings(stamp_ns=stamp_ns, x=x, y=y, **dict.fromkeys(names, nothing))


def force_error(fused: FusedEstimate, force: Array) -> tuple[float, float, int]:
    """Return how far (N) a force is off (2,) N, its NEES, and how many components are published.

    Of these alone; NaN of none. The NEES of one component is that of two that are as unlikely:
    on average 2 and in 95 % below the same limit, if the variance is right.
    """
    off, shown = force - fused.force, np.isfinite(fused.force)
    covariance = fused.force_covariance
    if shown.all():
        return float(np.hypot(*off)), float(off @ np.linalg.solve(covariance, off)), 2
    if not shown.any():
        return math.nan, math.nan, 0
    (far,), (variance,) = np.abs(off[shown]), np.diag(covariance)[shown]
    sigmas = far / math.sqrt(variance)
    return float(far), float(-2.0 * (math.log(2.0) + norm.logsf(sigmas))), 1


def missed_goals(
    numbers: Mapping[str, Mapping[str, float]],
    goals: Mapping[tuple[str, str], tuple[float, float]],
) -> list[str]:
    """Return a sentence for every goal that is missed; KeyError where its way was not tried."""
    return [
        f'{tried}: {what} = {numbers[tried][what]:.4g}, wanted {low:g} to {high:g}'
        for (tried, what), (low, high) in goals.items()
        if not low <= numbers[tried][what] <= high
    ]


def rig_command(
    description: str, recordings: int, quick: str = 'one rig, four recordings'
) -> argparse.ArgumentParser:
    """Return the options that all benches of rigs have; quick: what `--quick` does."""
    command = argparse.ArgumentParser(description=description)
    command.add_argument('--quick', action='store_true', help=quick)
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--rigs', type=int, default=5, help='number of rigs (default: 5)')
    command.add_argument(
        '--recordings',
        type=int,
        default=recordings,
        help=f'recordings of each (default: {recordings})',
    )
    command.add_argument(
        '--first', type=int, default=FIRST_SEED, help=f'first seed (default: {FIRST_SEED})'
    )
    command.add_argument('--keep', type=Path, help='folder of finished rigs, by commit')
    command.add_argument('--workers', type=int, default=1, help='processes (default: 1)')
    return command


def run_bench(
    name: str,
    arguments: argparse.Namespace,
    try_model: Try,
    summary_of: Callable[[list[Rows]], dict],
    show: Callable[[dict, str], None],
) -> int:
    """Try the models of all rigs and print what came of it; returns 1 where a goal is missed."""
    count, recordings = QUICK if arguments.quick else (arguments.rigs, arguments.recordings)
    seeds = range(arguments.first, arguments.first + count)
    keep = None if arguments.keep is None else arguments.keep / commit()
    one_rig = partial(
        rows_of_rig, bench=name, try_model=try_model, recordings=recordings, keep=keep
    )
    context = multiprocessing.get_context('spawn')
    begun = time.perf_counter()
    with ProcessPoolExecutor(arguments.workers, mp_context=context) as pool:
        rigs = list(
            track(
                pool.map(one_rig, seeds),
                total=count,
                console=Console(stderr=True),
                disable=arguments.json,
            )
        )
    summary = summary_of(rigs)
    if arguments.json:
        machine = {'machine': platform.machine(), 'python': platform.python_version()}
        seconds = time.perf_counter() - begun
        size = {'rigs': count, 'recordings': recordings, 'seconds': seconds}
        print(json.dumps(plain({'bench': name, **machine, **size, **summary}), allow_nan=False))
    else:
        show(summary, f'{name.capitalize()}, {count} rigs, {recordings} recordings of each')
    return 1 if summary['missed'] else 0


def rows_of_rig(
    seed: int, *, bench: str, try_model: Try, recordings: int, keep: Path | None
) -> Rows:
    """Calibrate a rig and try its model; what an earlier run kept in a folder is read."""
    kept = None if keep is None else keep / f'{bench}_{seed}_{recordings}.npz'
    if kept is not None and kept.exists():
        with np.load(kept) as rows:
            return dict(rows)
    found = try_model(seed, recordings)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(kept, **found)
    return found


def commit() -> str:
    """Return the commit of this checkout; rows of changed files are of none, and not kept."""
    words = ['git', '-C', str(Path(__file__).parent), 'describe', '--always', '--dirty']
    found = subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()
    if found.endswith('-dirty'):
        raise SystemExit('--keep: commit your changes first, for rows are kept by commit')
    return found
