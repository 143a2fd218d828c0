"""CPU time of a fusion step in a loop, without ROS: frames and pressure readings.

    python bench/fusion_step.py [--json] [--repeats N]

The random mix of the virtual lab (40 s, 50 readings and 10 frames a second, no force sensor), by
the calibrated model of its arm. A frame waits for the next pressure reading, whose step takes
both: to its estimate are these two steps, and a frame is that less the median of a pressure alone.
What a node does after it has published is not counted. Between two live readings other processes
use the caches of the processor: `cold` reads 24 MB before each step.
"""

from __future__ import annotations

import argparse
import json
import time

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.simulation import simulate

WARM_UP = 2_000_000_000  # ns at the beginning that are not counted
MEGABYTES = 24
GOAL_MS = 2.0  # of a frame, p50


def events(recording) -> list[PressureReading | TargetSightings]:
    """Return frames and pressure readings in the order of their stamps, a frame first."""
    unknown = np.full(recording.x.shape[1], np.nan)
    others = dict.fromkeys(('std', 'u', 'v', 'area', 'major', 'minor', 'angle'), unknown)
    found: list = [
        TargetSightings(stamp_ns=int(stamp), x=x, y=y, **others)
        for stamp, x, y in zip(recording.stamp_ns, recording.x, recording.y, strict=True)
    ]
    found += [
        PressureReading(stamp_ns=int(stamp), pressure=float(pressure))
        for stamp, pressure in zip(recording.reading_stamp_ns, recording.pressure, strict=True)
    ]
    return sorted(found, key=lambda event: event.stamp_ns)


def measure(fusion: Fusion, heard: list, other: np.ndarray | None) -> dict[str, list[float]]:
    """Return milliseconds of CPU of every step, by kind; other: what is read before each."""
    state, begin, frame = FusionState(), heard[0].stamp_ns, 0.0
    found: dict[str, list[float]] = {'frame to estimate': [], 'pressure alone': []}
    for event in heard:
        if other is not None:
            other.sum()
        begun = time.process_time()
        state, _ = fusion.step(state, event)
        spent = 1e3 * (time.process_time() - begun)
        counts = event.stamp_ns - begin > WARM_UP
        if isinstance(event, TargetSightings):
            frame = spent
            continue
        found['frame to estimate' if frame else 'pressure alone'] += [frame + spent] * counts
        frame, state = 0.0, fusion.settle(state)
    return found


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--repeats', type=int, default=3, help='repeats (default: 3)')
    arguments = command.parse_args()
    fusion = Fusion(arm=load_model(share_path('config/lab_arm.yaml')))
    heard = events(simulate(load_scenario(share_path('scenarios/random_mix.yaml'))))
    result = {}
    for name, other in (('warm', None), ('cold', np.ones(MEGABYTES * 2**20 // 8))):
        runs = [measure(fusion, heard, other) for _ in range(arguments.repeats)]
        steps = {kind: np.concatenate([run[kind] for run in runs]) for kind in runs[0]}
        steps['frame'] = steps['frame to estimate'] - np.median(steps['pressure alone'])
        for kind, every in steps.items():
            p50, p99 = np.percentile(every, (50.0, 99.0))
            result[f'{kind}, {name}'] = {'p50_ms': p50, 'p99_ms': p99, 'steps': every.size}
    if arguments.json:
        print(json.dumps({'bench': 'fusion_step', **result}))
        return
    for name, row in result.items():
        print(f'{name:24} p50 {row["p50_ms"]:.2f} ms, p99 {row["p99_ms"]:.2f} ms')
    print(f'target: p50 of a frame at most {GOAL_MS:g} ms')


if __name__ == '__main__':
    main()
