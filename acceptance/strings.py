"""Error from treating a string over a pulley as a constant force, and improvement by `String`.

    python acceptance/strings.py [--json]

The paper's arm, pulled along E1 by 0.1 N over a pulley 0.2 to 2 m beyond its straight tip: how far
the tip is from where a constant force would have it. Then the arm of the virtual lab, pulled so by
0.1, 0.2 and 0.3 N at 5 to 60 kPa, beside two unloaded recordings: rigidities of the calibration,
rms of their errors, with the pull called constant and as strings; the lab finds its equilibrium by
code of its own.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

from calibration import law_values, UNLOADED
import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.string_load import with_string
from pneunet_ros.model.string import solve_string, String
from support.lab_run import run_of, true_model
from support.pulley import pulled

AWAY = (0.2, 0.3, 0.5, 1.0, 2.0)  # m
TENSIONS = (0.1, 0.2, 0.3)  # N
PRESSURES = (20e3, 40e3, 60e3)  # Pa


def tip_moved(away: float) -> list[float]:
    """Return how far (m) tips are from those under a constant force, at PRESSURES."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    string = String(tension=TENSIONS[0], x=arm.reach + away, y=0.0)
    return [
        math.dist(
            solve_string(arm, pressure, string).tip[:2],
            solve(arm, pressure, (TENSIONS[0], 0.0)).tip[:2],
        )
        for pressure in PRESSURES
    ]


def unloaded() -> tuple[list, object, object]:
    """Return two unloaded recordings, the arm to begin with, and the truth."""
    scenarios = [load_scenario(share_path(f'scenarios/{name}.yaml')) for name in UNLOADED]
    truth = true_model(scenarios[0])
    frame = load_model(share_path('config/paper_arm.yaml'))
    frame = dataclasses.replace(frame, target_arclength=truth.target_arclength)
    return [run_of(simulate(one)) for one in scenarios], frame, truth


def rigidities_off(away: float | None, *, as_string: bool) -> float:
    """Return the rms relative error of the rigidities of a calibration; NaN: it fails."""
    free, frame, truth = unloaded()
    loaded = []
    for seed, tension in enumerate(TENSIONS):
        run = pulled(tension, away, seed)
        if as_string:
            string = String(tension=tension, x=frame.reach + away, y=0.0)
            loaded.append(with_string(run, frame, string)[0])
        else:
            loaded.append(run.with_end_load(tension, 0.0))
    found = calibrate(free, loaded, frame, compare=False)
    if not found.joint.converged:
        return math.nan
    off = law_values(found.arm)[:2] / law_values(truth)[:2] - 1.0
    return float(np.sqrt(np.mean(off**2)))


def main() -> int:
    """Print the table; 1 where a string gives rigidities 1 % worse than a constant force."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--json', action='store_true')
    asked = parser.parse_args()
    constant = rigidities_off(None, as_string=False)
    rows = [
        {
            'away': away,
            'tip': tip_moved(away),
            'called_constant': rigidities_off(away, as_string=False),
            'string': rigidities_off(away, as_string=True),
        }
        for away in AWAY
    ]
    if asked.json:
        print(json.dumps({'constant': constant, 'rows': rows}))
    else:
        print(f'a constant force that is one: rigidities {100 * constant:.2f} % off\n')
        print('| pulley | tip at 20 | 40 | 60 kPa | rigidities, called constant | as a string |')
        print('|---|---|---|---|---|---|')
        for row in rows:
            tips = ' | '.join(f'{1e3 * one:.1f} mm' for one in row['tip'])
            print(
                f'| {row["away"]:g} m | {tips} | {100 * row["called_constant"]:.1f} % | '
                f'{100 * row["string"]:.2f} % |'
            )
    return int(not all(abs(row['string'] - constant) <= 0.01 for row in rows))


if __name__ == '__main__':
    sys.exit(main())
