"""Cases over all verbs: implausible readings in valid messages, arrays, links, words.

What `cases.py` damages is mostly refused where bytes are read. Here every file can be read, and
what is odd reaches the mathematics, the tables and the figures.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import random
from typing import Any

import numpy as np
from pneunet_ros.cli.main import VERBS
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.messages.readings import SENSORS
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording

from hostile.mutations import damage_text
from hostile.place import Case, Kind, made_kind, Place

LONG = 150.0  # s of processor: a calibration or a diagnosis of a minute's readings
TARGET_PLACES = np.array([0.0, 0.028, 0.056, 0.084, 0.112])  # m, of the arm that is calibrated
ODD = (0.0, -0.0, 1.0, -1.0, 1e-300, 1e300, -1e300, np.inf, -np.inf, np.nan, 9999.0, 5e-324, 1e12)
ARM = """\
schema_version: 1
name: hostile-arm
arm: {length: 0.112, weight: 0.17, target_arclength: [0.0, 0.028, 0.056, 0.084, 0.112]}
intrinsic_curvature: {pressure: [0, 60000], arclength: [0, 1], curvature: [[0, 0], [20, 20]]}
moment_law: {kind: linear, bending_stiffness: 2.0e-4}
sensors: {pressure_std: 60.0, force_std: 0.001, moment_std: 1.0e-5, target_std: 0.00012}
"""
Rows = dict[str, tuple[np.ndarray, np.ndarray]]  # stamps (s) and rows by sensor


def readings(dice: random.Random, *, loaded: bool) -> Rows:
    """Return a minute on a bench: stairs of pressure, a curvature that follows, perhaps a load."""
    noise = np.random.default_rng(dice.randrange(2**32))
    time = np.arange(0.0, 20.0, 0.5)
    pressure = 6e4 * np.floor(6.0 * (1.0 - np.abs(time / 10.0 - 1.0))) / 6.0
    force = np.zeros((time.size, 3))
    if loaded:
        force[:, 0], force[:, 1] = 0.1, 0.05 * np.sin(time)
    kappa = 20.0 * pressure / 6e4 + 30.0 * force[:, 1]
    angle = kappa[:, None] * TARGET_PLACES
    safe = np.where(np.abs(kappa) < 1e-6, 1e-6, kappa)[:, None]
    x, y = np.sin(safe * TARGET_PLACES) / safe, (1.0 - np.cos(safe * TARGET_PLACES)) / safe
    points = np.stack([x, y], axis=1) + 1e-4 * noise.standard_normal((time.size, 2, 5))
    tip = np.column_stack([points[:, 0, -1], points[:, 1, -1], angle[:, -1]])
    rows: Rows = {'pressure': (time, pressure[:, None] + 60.0 * noise.standard_normal((40, 1)))}
    if loaded:
        rows['end_wrench'] = time, force + 1e-3 * noise.standard_normal(force.shape)
    if dice.random() < 0.7:
        rows['targets'] = time, points
    if 'targets' not in rows or dice.random() < 0.3:
        rows['tip_pose'] = time, tip
    return rows


def odd_values(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Put odd numbers into some or all readings of one component."""
    rows = rows.copy()
    flat = rows.reshape(len(rows), int(np.prod(rows.shape[1:])))
    if flat.size:
        chosen = [i for i in range(len(flat)) if dice.random() < dice.choice((0.02, 0.3, 1.0))]
        flat[chosen, dice.randrange(flat.shape[1])] = dice.choice(ODD)
    return time, rows


def scaled_values(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Take another unit, the other sign or another zero."""
    factor = dice.choice((-1.0, 1e-3, 1e3, 1e-6, 1e6, 1e-12, 0.0, 1.0))
    with np.errstate(all='ignore'):
        return time, factor * rows + dice.choice((0.0, 0.0, 101325.0, 1e-9))


def few_rows(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Keep none, one, two or the first few readings."""
    count = dice.choice((0, 1, 1, 2, 3, 7))
    return time[:count], rows[:count]


def odd_times(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Let stamps stand still, go back, jump or come in bursts."""
    kind = dice.randrange(6)
    if not time.size:
        return time, rows
    made = (
        np.zeros_like(time),
        time[::-1],
        np.where(time > time.mean(), time + 1e8, time),
        np.floor(time),
        time * 1e-9,
        np.repeat(time[: (time.size + 1) // 2], 2)[: time.size],
    )
    return made[kind], rows


def constant(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Let a sensor hang."""
    return time, np.repeat(rows[:1], len(rows), axis=0) * dice.choice((0.0, 1.0))


def unseen(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Lose some components, or some readings, altogether."""
    rows = rows.copy()
    if dice.random() < 0.5 and rows.ndim > 1 and rows.shape[-1]:
        rows[..., dice.randrange(rows.shape[-1])] = np.nan
    else:
        rows[dice.randrange(0, len(rows) + 1) :] = np.nan
    return time, rows


def other_count(time: np.ndarray, rows: np.ndarray, dice: random.Random) -> Any:
    """Show another number of targets."""
    return time, rows[..., : dice.choice((0, 1, 2, 4))] if rows.ndim == 3 else rows


SINS: tuple[Callable[[np.ndarray, np.ndarray, random.Random], Any], ...] = (
    odd_values, odd_values, scaled_values, few_rows, odd_times, constant, unseen, other_count,
)  # fmt: skip


def write_rows(path: Path, rows: Rows, frame: str = BASE_FRAME) -> Path:
    """Write readings as a recording, in the order of their stamps."""
    known = {sensor.name: sensor for sensor in SENSORS}
    with write_recording(path) as writer:
        added = {name: writer.add(f'/pneunet/{name}', known[name].type) for name in rows}
        lines = [
            (max(int(1e9 * stamp), 0), name, row)
            for name, (time, values) in rows.items()
            for stamp, row in zip(time, values, strict=True)
        ]
        for stamp, name, row in sorted(lines, key=lambda line: line[0]):
            try:
                message = known[name].message(stamp, row, frame, ROSBAGS_TYPES)
            except (ValueError, OverflowError):  # a number that the message cannot hold
                continue
            writer.write(added[name], stamp, message)
    return path


def odd_recording(place: Place, name: str, *, loaded: bool, sins: int) -> Path:
    """Write a recording with so many sins; a topic may be missing altogether."""
    dice, rows = place.dice, readings(place.dice, loaded=loaded)
    for _ in range(sins):
        if not rows:
            break
        sensor = dice.choice(sorted(rows))
        if dice.random() < 0.12:
            del rows[sensor]
        else:
            rows[sensor] = dice.choice(SINS)(*rows[sensor], dice)
    frame = dice.choice(('', 'tool0', 'mocap')) if dice.random() < 0.05 else BASE_FRAME
    return write_rows(place.folder / name, rows, frame)


def arm_file(place: Place) -> Path:
    """Write the arm that has these targets."""
    path = place.folder / 'arm.yaml'
    path.write_text(ARM)
    return path


def odd_readings(place: Place) -> Case:
    """Read odd readings by the verbs that take little time."""
    dice, arm = place.dice, arm_file(place)
    path = odd_recording(place, 'r.mcap', loaded=dice.random() < 0.5, sins=dice.randint(1, 3))
    verb = dice.choice(('check', 'check', 'export', 'replay', 'replay', 'fuse', 'fuse', 'compare'))
    options: tuple[object, ...] = ('--model', arm)
    if verb == 'export':
        return place.case('export', path, '--output', place.output('o.csv'))
    if verb == 'compare':
        return place.case('compare', path, place.take('replayed.mcap'), *options, seconds=60.0)
    if verb in ('replay', 'fuse'):
        options += ('--fuse',) * (verb == 'fuse')
        options += ('--no-wrench-required',) * (dice.random() < 0.7)
        options += ('--pressure-reference', 'absolute') * (dice.random() < 0.1)
        if dice.random() < 0.5:
            options += ('--output', place.output('o.mcap'))
        verb = 'replay'
    return place.case(verb, path, *options, seconds=60.0)


def odd_calibration(place: Place) -> Case:
    """Calibrate from odd readings, sometimes on top of another calibration."""
    dice, arm = place.dice, arm_file(place)
    free = odd_recording(place, 'free.mcap', loaded=False, sins=dice.randint(0, 2))
    pulled = odd_recording(place, 'pulled.mcap', loaded=True, sins=dice.randint(0, 2))
    words: list[object] = ['calibrate', '--unloaded', free, '--arm', arm]
    words += ['--loaded', pulled] if dice.random() < 0.6 else []
    words += ['--static'] if dice.random() < 0.2 else []
    words += ['--law', dice.choice(('linear', 'majidi'))] if dice.random() < 0.2 else []
    words += ['--no-compare', '--output', place.output('o.yaml')]
    place.output('o.knowledge.npz')
    return place.case(*words, seconds=LONG)


def odd_diagnosis(place: Place) -> Case:
    """Diagnose odd readings."""
    dice, arm = place.dice, arm_file(place)
    train = odd_recording(place, 't.mcap', loaded=dice.random() < 0.5, sins=dice.randint(1, 2))
    heldout = odd_recording(place, 'h.mcap', loaded=dice.random() < 0.5, sins=dice.randint(0, 1))
    words: list[object] = ['diagnose', '--model', arm, '--train', train, '--heldout', heldout]
    words += ['--static'] if dice.random() < 0.3 else []
    return place.case(*words, '--output', place.output('d'), seconds=LONG)


def odd_survey(place: Place) -> Case:
    """Survey a folder of arms, some of them with odd readings, empty or no arms at all."""
    dice, fleet = place.dice, place.folder / 'fleet'
    fleet.mkdir()
    arm_file(place)
    for number in range(dice.choice((0, 1, 1))):
        folder = fleet / f'arm{number}'
        folder.mkdir()
        inner = Place(place.kind, folder, place.corpus, dice)
        odd_recording(inner, 'unloaded.mcap', loaded=False, sins=2)
        if dice.random() < 0.3:
            odd_recording(inner, 'loaded.mcap', loaded=True, sins=2)
    if dice.random() < 0.3:
        (fleet / 'notes').write_text('x')
    source: Path = fleet
    if dice.random() < 0.4:
        source = place.folder / 'arms.csv'
        source.write_text('name,unloaded,loaded\na,fleet/arm0/unloaded.mcap,\nb,nowhere.mcap,\n')
        place.mutate(source, damage_text)
    options = ('--arm', place.folder / 'arm.yaml', '--workers', '1')
    return place.case('survey', source, '--output', place.folder / 's', *options, seconds=LONG)


def odd_array(array: np.ndarray, dice: random.Random) -> np.ndarray:
    """Return an array of another shape, type or size, singular, indefinite or near overflow."""
    kind = dice.randrange(12)
    numbers = array.dtype.kind in 'iuf'
    if kind == 0:
        return array[..., None]
    if kind == 1:
        return array.ravel()[: dice.randrange(array.size + 1)]
    if kind == 2:
        return np.array(dice.choice(('', 'x', 'linear', '{}', '[1]')))
    if kind == 3:
        return array.astype(dice.choice(('S8', 'U8', '?', 'c16', 'i4'))) if numbers else array
    if kind == 4 or not numbers:
        return np.array(dice.choice(ODD))
    if kind == 5:
        return np.zeros_like(array)
    if kind == 6:
        return array * dice.choice((-1.0, 1e300, 1e-300, 1e28, 1e-20))
    if kind == 7:
        return array[::-1].copy() if array.ndim else array
    if kind == 8:
        return np.concatenate([array, array]) if array.ndim else np.array([array, array])
    if kind == 9:
        return np.ones_like(array)
    changed = np.array(array, dtype=np.float64)
    if changed.size:
        changed.ravel()[dice.randrange(changed.size)] = dice.choice(ODD)
    return changed


def odd_memory(array: np.ndarray, dice: random.Random) -> np.ndarray:
    """Return a memory of the lab with other names, lengths or numbers."""
    memory = json.loads(str(array))
    kind = dice.randrange(5)
    if kind == 0:
        memory['past'] = {name: [*past, 1.0] for name, past in memory['past'].items()}
    elif kind == 1:
        memory['past'] = {name: past[:-1] for name, past in memory['past'].items()}
    elif kind == 2:
        memory['past'] = {'hysteresis': [dice.choice((1e29, -1e29, 0.0))] * dice.randrange(5)}
    elif kind == 3:
        memory[dice.choice(('time', 'pressure'))] = dice.choice((1e29, -1e29, True, None, '1', {}))
    else:
        memory = dice.choice(([], memory['past'], {'past': {}}, 3, None))
    return np.array(json.dumps(memory))


def change_arrays(path: Path, dice: random.Random) -> None:
    """Write an archive again with one to three odd arrays."""
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    for _ in range(dice.randint(1, 3)):
        name = dice.choice(sorted(arrays))
        if name == 'memory' and dice.random() < 0.8:
            arrays[name] = odd_memory(arrays[name], dice)
        elif dice.random() < 0.1:
            del arrays[name]
        else:
            arrays[name] = odd_array(arrays[name], dice)
        if not arrays:
            break
    np.savez(path, **arrays)


def odd_knowledge(place: Place) -> Case:
    """Continue a calibration whose arrays are not what they were."""
    place.take('known.yaml')
    path = place.take('known.knowledge.npz')
    if place.dice.random() < 0.95:
        change_arrays(path, place.dice)
    words = ('calibrate', '--unloaded', place.take('more.mcap'), '--no-compare')
    output = place.output('o.yaml')
    place.output('o.knowledge.npz')
    known = place.folder / 'known.yaml'
    return place.case(*words, '--continue', known, '--output', output, seconds=LONG)


def odd_truth(place: Place) -> Case:
    """Compare with, or go on from, a truth whose arrays are not what they were."""
    path = place.take('rec.truth.npz')
    change_arrays(path, place.dice)
    if place.dice.random() < 0.4:
        return place.case('compare', place.take('replayed.mcap'), path)
    scenario, text = place.take('scenario.yaml'), place.corpus.whole('scenario.yaml').read_text()
    scenario.write_text(text.replace('seed: 3', 'seed: 4\nstart: 5.0'))
    output = place.output('out.mcap')
    place.output('out.truth.npz')
    words = ('simulate', scenario, '--after', place.folder / 'rec.mcap')
    return place.case(*words, '--output', output)


def odd_path(place: Place) -> Case:
    """Give a verb a link that leads to itself, around, to nothing or through a file."""
    dice = place.dice
    link = place.folder / 'link.mcap'
    target = dice.choice(
        ('link.mcap', 'other', 'nowhere', 'file/inside', '/root/x', '.', 'f' * 300)
    )
    link.symlink_to(target)
    (place.folder / 'other').symlink_to('link.mcap')
    (place.folder / 'file').write_bytes(b'')
    rec = place.take('rec.mcap')
    table, out = place.take('readings.csv'), place.output('o.mcap')
    words = dice.choice(
        (
            ('check', link), ('export', link, '--output', 'o.csv'), ('replay', link),
            ('replay', rec, '--output', link), ('replay', rec, '--model', link),
            ('compare', rec, link), ('compare', link, link), ('compare', rec, '--truth', link),
            ('calibrate', '--unloaded', link, '--output', 'o.yaml'),
            ('calibrate', '--unloaded', rec, '--arm', link, '--output', 'o.yaml'),
            ('calibrate', '--unloaded', rec, '--continue', link, '--output', 'o.yaml'),
            ('calibrate', '--unloaded', rec, '--end-load', link, '1', '1', '--output', 'o.yaml'),
            ('calibrate', '--unloaded', rec, '--report', link, '--output', link),
            ('diagnose', '--model', link, '--train', rec, '--heldout', rec, '--output', 'd'),
            ('diagnose', '--model', rec, '--train', link, '--heldout', link, '--output', link),
            ('survey', link, '--output', 's'), ('survey', '.', '--arm', link, '--output', 's'),
            ('survey', '.', '--output', link), ('urdf', '--model', link, '--output', 'u'),
            ('urdf', '--output', link), ('new-arm', '--length', '0.1', '--output', link),
            ('simulate', link, '--output', out), ('simulate', 'strings', '--output', link),
            ('simulate', 'strings', '--after', link, '--output', out),
            ('explore', '--by-hand', '--model', link, '--output', 'e'),
            ('explore', '--by-hand', '--output', link), ('demo', '--output', link),
            ('effects', '--effects-path', link), ('predict', '--pressure', '1', '--model', link),
            ('track', link, '--camera-info', 'none'), ('track', place.folder, '--camera', link),
            ('track', place.folder, '--readings', link, '--output', out),
            ('track', place.folder, '--table', link, '--preview', link),
            ('import', link, '--output', out), ('import', table, '--output', link),
        )
    )  # fmt: skip
    place.outputs.clear()  # some of these may not be reached, and a link stands there already
    return place.case(*words)


WORDS = (
    '', '0', '-0', '-1', '1e300', 'nan', 'inf', '-inf', '31kPa', '5psi', '1m', '17g', '1e-300',
    'x', '0x10', '9' * 400, '1_0', ' ', '--', '-', '[bold]', '\x1b[2J', '=', 'a=b', ':', '/',
    'pressure=/x',
    'scenario.yaml', 'strings', 'creep', 'creep.amplitude=0.1', 'creep.amplitude=nan', 'rec.mcap',
    'model.yaml', 'readings.csv', 'rec.truth.npz', 'images', '.', 'link',
)  # fmt: skip


def odd_words(place: Place) -> Case:
    """Give a verb its own options with odd words, in any number."""
    dice = place.dice
    for name in ('scenario.yaml', 'rec.mcap', 'model.yaml', 'readings.csv', 'rec.truth.npz'):
        place.take(name)
    place.take('images')
    (place.folder / 'link').symlink_to('link')
    verb = dice.choice([verb for verb in VERBS if verb.name not in ('demo', 'compile')])
    if dice.random() < 0.6:  # the example of its help, as far as it goes, and one odd word
        words = verb.example.split()[1:]
        names = {'REC.mcap': 'rec.mcap', 'TABLE.csv': 'readings.csv', 'arm.yaml': 'model.yaml'}
        words = [names.get(word, word) for word in words]
        if len(words) > 1:
            words[dice.randrange(1, len(words))] = dice.choice(WORDS)
    else:
        words = [verb.name, *(dice.choice(WORDS) for _ in range(dice.randrange(3)))]
    options = place.corpus.options(verb.name)
    for _ in range(dice.randrange(3)):
        words += [dice.choice(options), *(dice.choice(WORDS) for _ in range(dice.randrange(3)))]
    # A robot, and a cluster that is waited for, are no input.
    outside = ('--live', '--scheduler', '--namespace')
    return place.case(*(word for word in words if word not in outside), seconds=LONG)


def odd_table(place: Place) -> Case:
    """Import what a logger may have written, with odd names, cells, separators and no rows."""
    dice = place.dice
    names = dice.choice(
        (
            ['millis', 'psi'], ['time', 'pressure_kpa', 'force_x'], ['Time [s]', 'P (kPa)'],
            ['t', 'pressure_pa', 'target_0_x', 'target_0_y'], ['ms', 'kPa', 'x0_mm', 'y0_mm'],
            ['date', 'time', 'psi'], ['millis', 'psi', 'psi'], ['', ''], ['1', '2', '3'],
            ['time_s', 'pressure_kPa', 'tip_x_mm', 'tip_y_mm', 'qx', 'qy', 'qz', 'qw'],
            ['stamp_ns', 'pressure'], ['millis', 'volts'], ['time_s', 'tip_x_m', 'tip_y_m'],
        )
    )  # fmt: skip
    separator = dice.choice((',', ',', ';', '\t', ' ', ', '))
    cells = [
        '0',
        '-1',
        '9999',
        'nan',
        'NaN',
        '',
        'inf',
        '1e300',
        '12,5',
        '1.5',
        '"3"',
        '#',
        'x',
        '1e9',
    ]
    lines = [separator.join(names)] if dice.random() < 0.9 else []
    for row in range(dice.choice((0, 0, 1, 2, 30))):
        line = [str(20 * row), *(f'{0.1 * row:.3f}' for _ in names[1:])]
        if dice.random() < 0.3:
            line[dice.randrange(len(line))] = dice.choice(cells)
        lines.append(separator.join(line))
    text = (
        dice.choice(('\n', '\r\n', '\r'))
        .join(lines)
        .encode(dice.choice(('utf-8', 'utf-8', 'utf-8', 'utf-16')))
    )
    path = place.folder / dice.choice(('t.csv', 't.txt', 't.npz', 't.tsv'))
    path.write_bytes(damage_text(text, dice) if text and dice.random() < 0.3 else text)
    if dice.random() < 0.25:
        film = ('--camera-info', 'none', '--readings', path, '--delay', '0')
        return place.case('track', place.take('images'), *film, '--output', place.output('o.mcap'))
    return place.case('import', path, '--output', place.output('o.mcap'))


ALL_VERBS: dict[str, Kind] = {
    'odd_readings': made_kind(odd_readings, 8),
    'odd_calibration': made_kind(odd_calibration, 4),
    'odd_diagnosis': made_kind(odd_diagnosis, 1),
    'odd_survey': made_kind(odd_survey, 1),
    'odd_knowledge': made_kind(odd_knowledge, 3),
    'odd_truth': made_kind(odd_truth, 3),
    'odd_path': made_kind(odd_path, 4),
    'odd_words': made_kind(odd_words, 5),
    'odd_table': made_kind(odd_table, 5),
}
