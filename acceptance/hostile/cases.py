"""The kinds of cases: the input, its mutation, and the verb that reads it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import random
import shutil
import struct

from mcap.opcode import Opcode
from mcap.writer import Writer
from pneunet_ros.messages.readings import PRESSURE_TYPE
from pneunet_ros.recordings.mcap_records import MAGIC
from pneunet_ros.recordings.message_store import jazzy
import zstandard

from hostile.all_verbs import ALL_VERBS
from hostile.corpus import Corpus
from hostile.mutations import damage_bytes, damage_text, flip_bit, replace_by_no_file
from hostile.place import Case, Made, made_kind, Place

NAMES = (
    '[/]',
    '\x1b[2J\x1b]0;owned\x07',
    'a' * 100_000,
    '[bold red]x[/bold]',
    '\u202egnp',
    'a\nb',
    '$x^{',
    '\ud800',
    '\0',
    '',
    '/',
    '..',
    'x' * 300,
    '{}',
    '%s',
)


def case_of(kind: str, number: int, corpus: Corpus) -> Case:
    """Return the case of this kind and number; the same one whenever it is asked for."""
    dice = random.Random(f'{kind}/{number}')
    folder = corpus.trials / f'{kind}-{number}'
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return CASES[kind].make(kind, folder, corpus, dice)


def model(place: Place) -> Case:
    path = place.mutate(place.take('model.yaml'), damage_text, damage_text, damage_bytes)
    if place.dice.random() < 0.2:
        recording = place.take('rec.mcap')
        return place.case('check', recording, '--model', path)
    if place.dice.random() < 0.1:
        return place.case('urdf', '--model', path, '--output', place.output('arm.urdf'))
    tip = ('--tip', '0.08', '0.05') if place.dice.random() < 0.2 else ('--force', '0.1', '0.02')
    return place.case('predict', '--model', path, '--pressure', '20000', *tip)


def camera(place: Place) -> Case:
    path = place.mutate(place.take('camera.yaml'), damage_text, damage_text, damage_bytes)
    table = place.output('table.csv')
    return place.case(
        'track', place.take('images'), '--camera', path, '--camera-info', 'none', '--table', table
    )


def camera_info(place: Place) -> Case:
    path = place.mutate(place.take('camera_info.yaml'), damage_text, damage_text, damage_bytes)
    return place.case('track', place.take('images'), '--camera-info', path)


def scenario(place: Place) -> Case:
    path = place.mutate(place.take('scenario.yaml'), damage_text, damage_text, damage_bytes)
    output = place.output('out.mcap')
    place.output('out.truth.npz')
    return place.case('simulate', path, '--output', output)


def read_recording(place: Place, path: Path, read_back: Path | None = None) -> Case:
    """Run one of the verbs that read a recording of readings."""
    verb = place.dice.choice(('check', 'export', 'export', 'replay', 'compare'))
    words: tuple[object, ...] = ()
    if verb == 'compare':
        words = (place.take('replayed.mcap'),)
        read_back = None  # it says less of a recording than its numbers
    elif verb == 'export':
        words = ('--output', place.output(place.dice.choice(('out.csv', 'out.npz'))))
    elif verb == 'replay' and place.dice.random() < 0.5:
        words = ('--output', place.output('out.mcap'))
    return place.case(verb, path, *words, read_back=read_back)


def our_recording(place: Place) -> Case:
    path = place.mutate(place.take('rec.mcap'), flip_bit, flip_bit, damage_bytes)
    return read_recording(place, path, read_back=path)


def our_folder(place: Place) -> Case:
    path = place.take('bag')
    place.mutate(path / place.dice.choice(('bag.mcap', 'metadata.yaml')), flip_bit, damage_bytes)
    return read_recording(place, path, read_back=path)


def foreign_recording(place: Place) -> Case:
    name = place.dice.choice(('zstd', 'lz4', 'none', 'loose'))
    return read_recording(place, place.mutate(place.take(f'{name}.mcap'), damage_bytes))


def metadata(place: Place) -> Case:
    path = place.take('bag')
    place.mutate(path / 'metadata.yaml', damage_text)
    return read_recording(place, path)


def table(place: Place) -> Case:
    path = place.mutate(place.take('table.csv'), damage_text, damage_text, damage_bytes)
    return place.case('import', path, '--output', place.output('out.mcap'))


def compared(place: Place) -> Case:
    path = place.mutate(place.take('rec.truth.npz'), flip_bit, damage_bytes)
    recording = place.take('replayed.mcap')
    if place.dice.random() < 0.5:
        return place.case('compare', recording, path)
    return place.case('compare', recording, recording, '--truth', path)


def film_and_table(place: Place) -> Case:
    film, readings = place.take('film.mp4'), place.take('readings.csv')
    if place.dice.random() < 0.7:
        place.mutate(readings, damage_text, damage_text, damage_bytes)
    else:
        place.mutate(film, flip_bit, damage_bytes)
    delay = place.dice.choice(('auto', '0.1', '-1e9', '1e300'))
    words = ('--camera-info', 'none', '--readings', readings, '--delay', delay)
    return place.case('track', film, *words, '--output', place.output('out.mcap'))


def truth(place: Place) -> Case:
    scenario = place.take('scenario.yaml')
    place.mutate(place.take('rec.truth.npz'), flip_bit, damage_bytes)
    scenario.write_text(scenario.read_text().replace('seed: 3', 'seed: 4\nstart: 5.0'))
    output = place.output('out.mcap')
    place.output('out.truth.npz')
    after = place.folder / 'rec.mcap'
    return place.case('simulate', scenario, '--after', after, '--output', output)


def knowledge(place: Place) -> Case:
    path = place.take('model.yaml')
    place.mutate(place.take('model.knowledge.npz'), flip_bit, damage_bytes)
    return place.case(
        'calibrate',
        '--unloaded',
        'missing.mcap',
        '--continue',
        path,
        '--output',
        place.output('o.yaml'),
    )


def images(place: Place) -> Case:
    folder = place.take('images')
    for path in sorted(folder.iterdir()):
        if place.dice.random() < 0.6:
            place.mutate(path, flip_bit, damage_bytes)
    words: tuple[object, ...] = ()
    if place.dice.random() < 0.3:
        words = ('--preview', place.output(place.dice.choice(('p.png', 'p.mp4'))))
    return place.case('track', folder, '--camera-info', 'none', *words)


def film(place: Place) -> Case:
    path = place.mutate(place.take('film.mp4'), flip_bit, damage_bytes)
    output = place.output('out.mcap')
    return place.case('track', path, '--camera-info', 'none', '--output', output)


def image_recording(place: Place) -> Case:
    path = place.mutate(place.take('camera.mcap'), flip_bit, damage_bytes)
    if place.dice.random() < 0.3:
        return place.case('check', path)
    return place.case('track', path, '--output', place.output('out.mcap'))


def no_file(place: Place) -> Case:
    """Put a pipe, a device, a folder, nothing or a sparse file where each input was."""
    made = place.dice.choice(
        (
            model,
            camera,
            camera_info,
            scenario,
            our_recording,
            metadata,
            table,
            truth,
            knowledge,
            images,
            film,
            image_recording,
            train,
        )
    )
    case = made(place)
    changed = [path for path in sorted(place.folder.rglob('*')) if path.is_file()]
    kept = [path for path in changed if not made_with(made, path)]
    replace_by_no_file(place.dice.choice(kept or changed), place.dice)
    return replace(case, read_back=None)


def made_with(made: Made, path: Path) -> bool:
    """Whether a file only stands beside the input of such a case."""
    return made in (camera, camera_info) and path.parent.name == 'images'


def train(place: Place) -> Case:
    path = place.mutate(place.take('rec.mcap'), damage_bytes)
    missing = place.folder / 'missing.mcap'
    return place.case(
        'diagnose',
        '--model',
        place.take('model.yaml'),
        '--train',
        path,
        missing,
        '--output',
        place.output('report'),
    )


def bomb(place: Place) -> Case:
    """Make a small recording that wants much memory or time."""
    dice, path = place.dice, place.folder / 'bomb.mcap'
    message = struct.pack('<BQHIQQ', Opcode.MESSAGE, 22, 1, 0, dice.randrange(2**64), 0)
    kind = dice.randrange(5)
    chunks = [_chunk(message * dice.choice((1000, 300_000, 3_000_000)))]
    if kind == 1:
        chunks = [_chunk(bytes(dice.choice((10**6, 10**8))))] * dice.choice((1, 30))
    elif kind == 2:
        chunks = [_chunk(message * 10, announced=dice.choice((1, 10**6, 2**40, 2**63)))]
    elif kind == 3:
        huge = struct.pack('<BQ', dice.choice((3, 4, 5, 6, 9, 10)), dice.choice((10**9, 2**62)))
        chunks = [huge]
    path.write_bytes(MAGIC + b''.join(chunks) + whole_tail(place, kind))
    if kind == 3:
        with path.open('r+b') as stream:
            stream.truncate(12_000_000_000)
    if kind == 4:
        folder = place.take('bag')
        text = (folder / 'metadata.yaml').read_text()
        (folder / 'metadata.yaml').write_text(
            text.replace('  - bag.mcap', '  - bag.mcap\n' * 2000, 1)
        )
        path = folder
    return read_recording(place, path)


def whole_tail(place: Place, kind: int) -> bytes:
    """Return what follows the bomb: sometimes a whole recording, without its beginning."""
    raw = place.corpus.whole('rec.mcap').read_bytes()
    return raw[len(MAGIC) :] if place.dice.random() < 0.5 and kind != 3 else b''


def _chunk(content: bytes, announced: int | None = None) -> bytes:
    packed = zstandard.compress(content)
    size = len(content) if announced is None else announced
    head = struct.pack('<QQQII', 0, 0, size, 0, 4) + b'zstd' + struct.pack('<Q', len(packed))
    return struct.pack('<BQ', Opcode.CHUNK, len(head) + len(packed)) + head + packed


def name(place: Place) -> Case:
    """Give a topic, a model, a scenario, an output or a recording a name that no one expects."""
    dice, text = place.dice, place.dice.choice(NAMES)
    kind = dice.randrange(5)
    if kind == 0:
        path = place.folder / 'r.mcap'
        _write_topic(path, text, dice)
        return read_recording(place, path)
    if kind in (1, 2):
        path = place.take('model.yaml' if kind == 1 else 'scenario.yaml')
        lines = path.read_text().splitlines()
        place_of_name = next(i for i, line in enumerate(lines) if line.startswith('name:'))
        escaped = ''.join(f'\\u{ord(letter):04x}' for letter in text)
        lines[place_of_name] = f'name: "{escaped}"'
        path.write_text('\n'.join(lines))
        if kind == 2:
            output = place.output('out.mcap')
            place.output('out.truth.npz')
            return place.case('simulate', path, '--output', output)
        recording = place.take('rec.mcap')
        if dice.random() < 0.5:
            return place.case('replay', recording, '--model', path)
        preview = place.output('p.png')
        return place.case(
            'track',
            place.take('images'),
            '--camera-info',
            'none',
            '--model',
            path,
            '--preview',
            preview,
        )
    text = text.replace('\0', '').replace('\ud800', '\udcff')
    if kind == 3:
        return place.case('check', place.folder / text[:4000])
    path = place.take('rec.mcap')
    suffix = '' if text.startswith('/') else dice.choice(('.csv', '.mcap', ''))
    target = place.folder / f'{text[:4000]}{suffix}'
    if dice.random() < 0.3:
        target = place.folder / f'link{suffix}'
        target.symlink_to('nowhere')
    if suffix == '.mcap':
        return place.case('replay', path, '--output', target)
    return place.case('export', path, '--output', target)


def _write_topic(path: Path, text: str, dice: random.Random) -> None:
    """Write a recording with a topic, a type or a frame of this name."""
    safe = text.replace('\ud800', '?')
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        definition, _ = jazzy().generate_msgdef(PRESSURE_TYPE, ros_version=2)
        kind = PRESSURE_TYPE if dice.random() < 0.7 else f'{safe}/msg/{safe}'
        schema = writer.register_schema(kind, 'ros2msg', definition.encode())
        for topic in (f'/{safe}/pressure', '/other/pressure', f'/{safe}'):
            channel = writer.register_channel(topic, dice.choice(('cdr', safe)), schema)
            writer.add_message(channel, 5, dice.randbytes(40), 5)
        writer.finish()


def full_disk(place: Place) -> Case:
    """Let a verb that writes run out of room."""
    make = place.dice.choice((scenario, table, images, our_recording, train))
    case = make(Place(place.kind, place.folder, place.corpus, random.Random('whole')))
    for path in sorted(place.folder.iterdir()):  # whole inputs again
        source = place.corpus.whole(path.name)
        if source.is_file():
            shutil.copy(source, path)
        elif source.is_dir():
            shutil.rmtree(path)
            shutil.copytree(source, path)
    words, outputs = list(case.words), list(case.outputs)
    if make is images:
        outputs = [place.folder / 'p.mp4']
        words = [*words[:4], '--preview', str(outputs[0])]
    room = place.dice.choice((0, 100, 4096, 20_000, 60_000))
    return replace(case, words=tuple(words), outputs=tuple(outputs), read_back=None, room=room)


def killed(place: Place) -> Case:
    """Kill a verb that writes while it does."""
    return replace(full_disk(place), room=None, kill=place.dice.uniform(0.0, 0.6))


CASES = {
    'model': made_kind(model, 5),
    'camera': made_kind(camera, 3),
    'camera_info': made_kind(camera_info, 2),
    'scenario': made_kind(scenario, 4),
    'recording': made_kind(our_recording, 8),
    'bag': made_kind(our_folder, 3),
    'foreign_recording': made_kind(foreign_recording, 6),
    'metadata': made_kind(metadata, 2),
    'table': made_kind(table, 4),
    'truth': made_kind(truth, 2),
    'knowledge': made_kind(knowledge, 2),
    'images': made_kind(images, 3),
    'film': made_kind(film, 2),
    'film_and_table': made_kind(film_and_table, 3),
    'compared': made_kind(compared, 2),
    'image_recording': made_kind(image_recording, 2),
    'no_file': made_kind(no_file, 4),
    'bomb': made_kind(bomb, 2),
    'name': made_kind(name, 3),
    'full_disk': made_kind(full_disk, 2),
    'killed': made_kind(killed, 2),
    **ALL_VERBS,
}
