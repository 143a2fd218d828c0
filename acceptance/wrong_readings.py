"""Detection of wrongly declared readings in 60 recordings, and false alarms in correct ones.

The recordings are the shipped ones and some of the virtual lab, changed message by message with
numbers that are written here: nothing is shared with the judge, which is asked through `check`
and `replay` as a user would. Printed is a line for each recording that was not named right first,
and at the end how many were, how many gave estimates with exit code 0 although they are wrong,
and how many right recordings were accused.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import contextlib
from dataclasses import replace
import io
import json
import math
from pathlib import Path
import tempfile
from typing import Any

from pneunet_ros.cli.main import main
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

ROOT = Path(__file__).resolve().parents[1]
STORE = get_typestore(Stores.ROS2_JAZZY)
PAPER, LAB = 'paper', 'lab'  # models: the shipped one, and that of a calibration
PSI, MMHG, POUND, GRAM = 6894.757, 133.3224, 4.448222, 9.80665e-3
Messages = list[tuple[str, str, int, Any]]


def read(path: Path) -> Messages:
    """All messages of readings of a bag: topic, type, log time, message; no images."""
    with AnyReader([path], default_typestore=STORE) as bag:
        wanted = [one for one in bag.connections if 'Image' not in one.msgtype]
        return [
            (one.topic, one.msgtype, time, bag.deserialize(raw, one.msgtype))
            for one, time, raw in bag.messages(connections=wanted)
        ]


def write(path: Path, messages: Messages) -> None:
    """Write messages as a rosbag2 folder."""
    known: dict[str, Any] = {}
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for topic, kind, time, message in messages:
            if topic not in known:
                known[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(known[topic], time, STORE.serialize_cdr(message, kind))


def pressures(change: Callable[[float], float]) -> Callable[[Messages], Messages]:
    """Change what the pressure sensor says, Pa gauge."""

    def change_all(messages: Messages) -> Messages:
        return [
            (topic, kind, time, replace(message, fluid_pressure=change(message.fluid_pressure)))
            if kind.endswith('FluidPressure')
            else (topic, kind, time, message)
            for topic, kind, time, message in messages
        ]

    return change_all


def wrenches(
    scale: float = 1.0, turn: float = 0.0, tare: tuple[float, float] = (0.0, 0.0), frame: str = ''
) -> Callable[[Messages], Messages]:
    """Change what the force sensor says: times a factor, turned (degrees), with a tare (N)."""
    cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))

    def changed(message: Any) -> Any:
        x, y = message.wrench.force.x + tare[0], message.wrench.force.y + tare[1]
        force = replace(
            message.wrench.force,
            x=scale * (cosine * x - sine * y),
            y=scale * (sine * x + cosine * y),
        )
        header = replace(message.header, frame_id=frame or message.header.frame_id)
        torque = replace(message.wrench.torque, z=scale * message.wrench.torque.z)
        return replace(
            message, header=header, wrench=replace(message.wrench, force=force, torque=torque)
        )

    def change_all(messages: Messages) -> Messages:
        return [
            (t, kind, time, changed(m) if kind.endswith('WrenchStamped') else m)
            for t, kind, time, m in messages
        ]

    return change_all


def without_targets(messages: Messages) -> Messages:
    """Leave the targets out."""
    return [one for one in messages if one[1].rsplit('/', 1)[-1] != 'PointCloud2']


SOURCES = {
    'table1': (ROOT / 'bags/table1', PAPER),
    'camera': (ROOT / 'bags/camera_demo', PAPER),
    'unloaded': (ROOT / 'bags/lab_day/unloaded.mcap', LAB),
    'loaded': (ROOT / 'bags/lab_day/loaded.mcap', LAB),
    'heldout': (ROOT / 'bags/lab_day/heldout.mcap', LAB),
}
# source, what was done, what must be named first: settings, None for any value
Case = tuple[str, Callable[[Messages], Messages], dict[str, str | None]]
GAUGE_ONLY: dict[str, str | None] = {'pressure_reference': 'absolute', 'ambient_pressure': None}


def unit(name: str, **more: str | None) -> dict[str, str | None]:
    return {'pressure_unit': name, **more}


def cases() -> list[tuple[str, Case]]:
    """Return all 60 by name."""
    found: list[tuple[str, Case]] = []
    for source in ('table1', 'camera', 'unloaded', 'loaded'):
        for name, size in (('hPa', 100.0), ('kPa', 1e3), ('psi', PSI), ('bar', 1e5)):
            change = pressures(lambda value, size=size: value / size)
            found.append((f'{source} in {name}', (source, change, unit(name))))
    for source in ('table1', 'heldout', 'camera'):
        for name, size, air in (
            ('Pa', 1.0, 98_700.0),
            ('Pa', 1.0, 83_400.0),
            ('hPa', 100.0, 101_100.0),
            ('kPa', 1e3, 97_200.0),
            ('psi', PSI, 99_900.0),
        ):
            change = pressures(lambda value, size=size, air=air: (value + air) / size)
            expected = GAUGE_ONLY | ({} if name == 'Pa' else unit(name))
            found.append((f'{source} absolute in {name}, air {air:g}', (source, change, expected)))
    for source in ('table1', 'unloaded', 'loaded'):
        reverse = pressures(lambda value: -value)
        found.append((f'{source} reversed', (source, reverse, {'pressure_sign': '-1'})))
    for name, size in (('kPa', 1e3), ('psi', PSI)):
        change = pressures(lambda value, size=size: -value / size)
        expected = unit(name, pressure_sign='-1')
        found.append((f'camera reversed in {name}', ('camera', change, expected)))
    for source, zero in (('unloaded', 8e3), ('unloaded', -8e3), ('heldout', -9e3)):
        change = pressures(lambda value, zero=zero: value + zero)
        found.append((f'{source} zero {zero:g}', (source, change, {'pressure_offset': None})))
    change = pressures(lambda value: value - 1e4)
    found.append(('table1 zero -10 kPa', ('table1', change, {'pressure_offset': None})))
    for source in ('loaded', 'heldout'):
        for name, scale in (('gf', 1.0 / GRAM), ('mN', 1e3), ('lbf', 1.0 / POUND)):
            change = wrenches(scale)
            found.append((f'{source} force in {name}', (source, change, {'wrench_unit': name})))
        for turn, expected in (
            (180.0, {'wrench_sign': '-1'}),
            (90.0, {'wrench_yaw': '-1.571'}),
            (-90.0, {'wrench_yaw': '1.571'}),
            (40.0, {'wrench_yaw': None}),
        ):
            named = f'{source} force turned by {turn:g}'
            found.append((named, (source, wrenches(turn=turn), expected)))
        tare = wrenches(tare=(0.12, -0.09))
        expected = {'force_offset_x': None, 'force_offset_y': None}
        found.append((f'{source} not tared', (source, tare, expected)))
    found.append(('table1 reaction', ('table1', wrenches(-1.0), {'wrench_sign': '-1'})))
    found.append(('table1 force in gf', ('table1', wrenches(1.0 / GRAM), {'wrench_unit': 'gf'})))
    found.append(
        ('table1 in frame cell', ('table1', wrenches(frame='cell'), {'wrench_frame': 'cell'}))
    )
    cell = wrenches(turn=90.0, frame='cell')
    expected = {'wrench_frame': 'cell', 'wrench_yaw': '-1.571'}
    found.append(('loaded force in frame cell, turned', ('loaded', cell, expected)))
    return found


def ask(*words: str) -> tuple[int, dict[str, Any]]:
    """Return exit code and JSON of a command."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = main([*words, '--json'])
    return code, json.loads(out.getvalue())


def named(path: Path, model: Path) -> tuple[int, dict[str, str]]:
    """Return the exit code of `check`, and the settings that it names."""
    code, summary = ask('check', str(path), '--model', str(model))
    settings: dict[str, str] = {}
    for verdict in summary['recordings'][0]['verdicts'].values():
        settings |= verdict['settings']
    return code, settings


def replayed(path: Path, model: Path) -> tuple[int, int]:
    """Return exit code and number of estimates of `replay`."""
    with AnyReader([path], default_typestore=STORE) as bag:
        loaded = any(one.msgtype.endswith('WrenchStamped') for one in bag.connections)
    extra = [] if loaded else ['--no-wrench-required']
    code, summary = ask('replay', str(path), '--model', str(model), *extra)
    return code, int(summary.get('estimates', 0))


def models(folder: Path) -> dict[str, Path]:
    """Return the shipped model and that of the lab's arm, which is calibrated here."""
    day, fitted = ROOT / 'bags/lab_day', folder / 'lab.yaml'
    words = ['--unloaded', f'{day}/unloaded.mcap', '--loaded', f'{day}/loaded.mcap']
    code, _ = ask('calibrate', *words, '--no-compare', '--output', str(fitted))
    assert code == 0
    return {PAPER: ROOT / 'config/paper_arm.yaml', LAB: fitted}


def run(folder: Path) -> dict[str, int]:
    """Make all recordings in a folder and ask; returns what is counted."""
    everything = cases()
    counts = {'cases': len(everything), 'named': 0, 'silent': 0, 'right': 0, 'accused': 0}
    known = models(folder)
    messages = {name: read(path) for name, (path, _) in SOURCES.items()}
    for index, (name, (source, change, expected)) in enumerate(everything):
        path = folder / f'case{index:02d}'
        write(path, change(messages[source]))
        model = known[SOURCES[source][1]]
        code, settings = named(path, model)
        right = code == 1 and settings.keys() == expected.keys()
        right = right and all(value in (None, settings[key]) for key, value in expected.items())
        counts['named'] += right
        result, estimates = replayed(path, model)
        counts['silent'] += result == 0 and estimates > 0
        if not right or result == 0:
            print(f'{name}: named {settings or "nothing"}; replay {result}, {estimates} estimates')
    for source, (_, model) in SOURCES.items():
        for variant, kept in (('', lambda all_: all_), (' without targets', without_targets)):
            copy = folder / f'right {source}{variant}'.replace(' ', '_')
            write(copy, kept(messages[source]))
            code, settings = named(copy, known[model])
            counts['right'] += 1
            counts['accused'] += code != 0
            if code:
                print(f'{source}{variant} is right, and was accused: {settings}')
    print(
        f'{counts["named"]} of {counts["cases"]} named right first; {counts["silent"]} wrong '
        f'estimates with exit code 0; {counts["accused"]} of {counts["right"]} right ones accused'
    )
    return counts


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', nargs='?', type=Path, help='keep the recordings in this folder')
    with tempfile.TemporaryDirectory() as made:
        run(parser.parse_args().folder or Path(made))
