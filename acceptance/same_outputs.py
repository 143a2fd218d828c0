"""Compare the outputs of two checkouts of the package: record both, then compare.

    python acceptance/same_outputs.py record BEFORE --pneunet OTHER/.venv/bin/pneunet
    python acceptance/same_outputs.py record AFTER --pneunet .venv/bin/pneunet
    python acceptance/same_outputs.py compare BEFORE AFTER [--relative 1e-9]

Recorded: replays of all shipped recordings and of one with effects, a tracking, predictions, a
calibration and a diagnosis of `bags/lab_day`, and the same of a simulated arm with creep. All
commands run in the folder of this checkout, so that both packages are given the same files.
Compared is every number of every message, model and JSON output, relative to the largest of its
array; words are compared too, and differences in them are listed but do not fail, as words may be
improved, nor do entries that are new.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
import math
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
from ruamel.yaml import YAML

CHECKOUT = Path(__file__).resolve().parent.parent
LAB_DAY = [f'bags/lab_day/{name}.mcap' for name in ('unloaded', 'loaded', 'heldout')]
EFFECTS = (
    '{extensibility: {axial_stiffness: 40.0}, gravity: {weight_x: 0.2, weight_y: -0.6}, '
    'clamp_compliance: {compliance: 1.5}, load_offset: {offset: 0.002}, '
    'pressure_elongation: {strain_per_pascal: 2.0e-7}, pressure_lag: {time_constant: 0.3}, '
    'hysteresis: {width: 900.0}, creep: {amplitude: 0.1, time_constant: 8.0}, '
    'softening: {loss: 0.1}, stiffening: {coefficient: 1.0e-4}, '
    'force_misalignment: {angle: 0.03}, camera_scale: {factor: 1.01}, '
    'camera_rotation: {angle: 0.01}, pressure_gain: {gain: 1.02}, pressure_offset: {offset: 50.0}}'
)
CREEP = ('--effect', 'creep.amplitude=0.12', '--effect', 'creep.time_constant=6')
# What differs from run to run or from version to version, and means nothing here.
UNSTABLE = ('solve_time', 'version', 'sha256', 'seconds', 'created', 'file', 'took', 'frames_per_')


def commands(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield (name, arguments of `pneunet`), in the order in which they must run."""
    rich = folder / 'all_effects.yaml'
    text = (CHECKOUT / 'config' / 'paper_arm.yaml').read_text(encoding='utf-8')
    lines = [line for line in text.splitlines() if not line.startswith('effects:')]
    rich.write_text('\n'.join([*lines, f'effects: {EFFECTS}', '']), encoding='utf-8')
    for model in ('config/paper_arm.yaml', 'config/lab_arm.yaml', str(rich)):
        stem = Path(model).stem
        load = ['--pressure', '31000', '--force', '0.175', '0.07', '--model', model]
        yield f'predict_{stem}', ['predict', *load, '--json']
        tip = ['--pressure', '31000', '--tip', '0.1035', '0.0395', '--model', model]
        yield f'predict_tip_{stem}', ['predict', *tip, '--json']
        for bag in ('bags/table1', *LAB_DAY[1:]):
            name = f'replay_{Path(bag).stem}_{stem}'
            output = ['--output', str(folder / f'{name}.mcap')]
            yield name, ['replay', bag, '--model', model, *output, '--json']
    output = ['--output', str(folder / 'tracked.mcap')]
    yield 'track', ['track', 'bags/camera_demo', *output, '--json']
    for scenario, seed in (
        ('unloaded_ramp', 1),
        ('unloaded_staircase', 2),
        ('force_sweeps', 3),
        ('dead_weights', 4),
        ('random_mix', 5),
    ):
        output = ['--output', str(folder / f'{scenario}.mcap'), '--seed', str(seed)]
        yield f'simulate_{scenario}', ['simulate', scenario, *output, *CREEP, '--json']
    free, loaded, held = ([item] for item in LAB_DAY)
    made = [str(folder / f'{name}.mcap') for name in ('unloaded_ramp', 'unloaded_staircase')]
    pulled = [str(folder / f'{name}.mcap') for name in ('force_sweeps', 'dead_weights')]
    last = [str(folder / 'random_mix.mcap')]
    for name, first, second, third in (
        ('lab_day', free, loaded, held),
        ('simulated', made, pulled, last),
    ):
        model = folder / f'{name}.yaml'
        runs = ['--unloaded', *first, '--loaded', *second]
        yield f'calibrate_{name}', ['calibrate', *runs, '--output', str(model), '--json']
        train = ['--train', *first, *second, '--heldout', *third]
        output = ['--output', str(folder / f'diagnosis_{name}')]
        yield f'diagnose_{name}', ['diagnose', '--model', str(model), *train, *output, '--json']


def record(folder: Path, pneunet: Path) -> None:
    """Run all commands; what they print and write stays in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    for name, arguments in commands(folder.resolve()):
        begun = time.monotonic()
        done = subprocess.run(
            [str(pneunet), *arguments],
            cwd=CHECKOUT,
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )
        (folder / f'{name}.out.json').write_text(done.stdout, encoding='utf-8')
        print(f'{name}: exit code {done.returncode}, {time.monotonic() - begun:.1f} s', flush=True)
        if done.returncode == 2:
            raise SystemExit(done.stderr)


def leaves(content: Any, path: str = '') -> Iterator[tuple[str, Any]]:
    """Yield (dotted path, number or word) of nested content."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from leaves(value, f'{path}.{key}')
    elif isinstance(content, list):
        for place, value in enumerate(content):
            yield from leaves(value, f'{path}.{place}')
    else:
        yield path, content


def message_leaves(message: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield (field and place, number or word) of a message; a point cloud by its columns."""
    if hasattr(message, 'point_step'):
        yield from message_leaves(message.header, f'{path}.header')
        for name, column in columns_of(message).items():
            yield from leaves(column.tolist(), f'{path}.{name}')
    elif isinstance(message, np.ndarray):
        yield from leaves(message.tolist(), path)
    elif isinstance(message, (list, tuple)):
        for place, item in enumerate(message):
            yield from message_leaves(item, f'{path}.{place}')
    elif hasattr(message, '__dataclass_fields__'):
        for name in message.__dataclass_fields__:
            if name != '__msgtype__':
                yield from message_leaves(getattr(message, name), f'{path}.{name}')
    else:
        yield path, message


def columns_of(cloud: Any) -> dict[str, Any]:
    """Return the fields of a point cloud, an array each."""
    types = {1: 'i1', 2: 'u1', 3: '<i2', 4: '<u2', 5: '<i4', 6: '<u4', 7: '<f4', 8: '<f8'}
    layout = np.dtype(
        {
            'names': [item.name for item in cloud.fields],
            'formats': [types[item.datatype] for item in cloud.fields],
            'offsets': [item.offset for item in cloud.fields],
            'itemsize': cloud.point_step,
        }
    )
    table = np.frombuffer(cloud.data, dtype=layout)
    return {name: table[name].astype(float) for name in layout.names or ()}


def recording_leaves(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield (topic and place, number or word) of all messages of a recording."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([path], default_typestore=store) as reader:
        for count, (connection, stamp, raw) in enumerate(reader.messages()):
            yield f'{connection.topic}.{count}.log_time', stamp
            message = reader.deserialize(raw, connection.msgtype)
            yield from message_leaves(message, f'{connection.topic}.{count}')


def file_leaves(path: Path, folder: Path) -> list[tuple[str, Any]]:
    """Return what a recorded file holds; the path of the folder is left out of it."""
    if path.suffix == '.mcap':
        return list(recording_leaves(path))
    text = path.read_text(encoding='utf-8').replace(str(folder.resolve()), '')
    content = YAML(typ='safe').load(text) if path.suffix == '.yaml' else json.loads(text or 'null')
    return [item for item in leaves(content) if not any(word in item[0] for word in UNSTABLE)]


def array_of(path: str) -> str:
    """Return the array a number stands in: one near zero counts by the size of the others."""
    head, _, last = path.rpartition('.')
    return head if last.isdecimal() else path


def sizes_of(items: list[tuple[str, Any]]) -> dict[str, float]:
    """Return the largest number of every array."""
    sizes: dict[str, float] = {}
    for path, value in items:
        if isinstance(value, (int, float)) and math.isfinite(value):
            key = array_of(path)
            sizes[key] = max(sizes.get(key, 0.0), abs(value))
    return sizes


def difference(old: Any, new: Any, size: float) -> float | None:
    """Return how far two numbers are apart, relative to their array; None: words that differ.

    A number is infinitely far from what is not finite, and from what is no number.
    """
    if old == new or (old != old and new != new):
        return 0.0
    numbers = [value for value in (old, new) if isinstance(value, (int, float))]
    if not numbers:
        return None
    if len(numbers) < 2 or not all(map(math.isfinite, numbers)):
        return math.inf
    return abs(old - new) / max(abs(old), abs(new), size)


def compare(before: Path, after: Path, relative: float) -> bool:
    """Print a line per file; return whether all numbers agree."""
    good = True
    for path in sorted(before.rglob('*')):
        name = path.relative_to(before)
        if path.suffix not in ('.mcap', '.json', '.yaml') or name.name == 'all_effects.yaml':
            continue
        old, new = file_leaves(path, before), file_leaves(after / name, after)
        known, sizes, worst, where, words = dict(new), sizes_of(old), 0.0, '', []
        added, lost = sorted(known.keys() - dict(old)), sorted(dict(old).keys() - known)
        for place, value in old:
            far = difference(value, known.get(place), sizes.get(array_of(place), 0.0))
            if far is None:
                words.append(place)
            elif far > worst:
                worst, where = far, place
        right = worst <= relative and not lost
        good &= right
        verdict = 'same' if right else 'DIFFERENT'
        print(f'{verdict}  {name}: {len(old)} values, largest difference {worst:.2g} {where}')
        for what, entries in (('lost', lost), ('new', added)):
            if entries:
                print(f'    {what}: {len(entries)}, such as {", ".join(entries[:3])}')
        for place in words[:8]:
            print(f'    words: {place}: {dict(old)[place]!r} -> {known.get(place)!r}')
    return good


def main() -> None:
    """Record or compare."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = command.add_subparsers(dest='what', required=True)
    recorded = what.add_parser('record')
    recorded.add_argument('folder', type=Path)
    recorded.add_argument('--pneunet', type=Path, required=True, help='the command to run')
    compared = what.add_parser('compare')
    compared.add_argument('before', type=Path)
    compared.add_argument('after', type=Path)
    compared.add_argument('--relative', type=float, default=0.0, help='allowed difference')
    given = command.parse_args()
    if given.what == 'record':
        record(given.folder, given.pneunet.absolute())
    else:
        sys.exit(0 if compare(given.before, given.after, given.relative) else 1)


if __name__ == '__main__':
    main()
