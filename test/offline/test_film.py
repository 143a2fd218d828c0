"""A film and a table on two clocks: one recording, in which frames stand at the right readings."""

from __future__ import annotations

import json
import re
import struct

import cv2
import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.films import ARM, FRAMES, pictures, RATE, REST, STEP, write_folder, write_video
from support.refusals import reasons, refusal

DELAY = 0.1  # s, by which the film began before the table
TARGETS = ARM.target_arclength.size
READ_EVERY = 0.01  # s


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with a film, and a table of the pressures that made it."""
    folder = tmp_path_factory.mktemp('film')
    write_video(folder / 'film.avi', pictures())
    write_folder(folder / 'frames', pictures())
    time = np.arange(0.0, FRAMES / RATE, READ_EVERY)
    frame = (time + DELAY) * RATE
    pressure = STEP * np.maximum(0.0, frame - REST + 1.0)
    rows = [
        f'{t:.2f};{1e-3 * p:.6f}'.replace('.', ',') for t, p in zip(time, pressure, strict=True)
    ]
    (folder / 'table.csv').write_text('\n'.join(['Time (s);Pressure [kPa]', *rows]))
    return folder


@pytest.fixture
def track(folder, tmp_path, capsys):
    """Run the verb; returns its exit code, what it says, and where it writes."""

    def track(source, *more):
        output = tmp_path / 'out.mcap'
        table = ('--readings', str(folder / 'table.csv'), '--camera-info', 'none')
        code = main(['track', str(folder / source), *table, '--output', str(output), *more])
        said = capsys.readouterr()
        return code, said.out + said.err, output

    return track


@pytest.mark.parametrize('source', ['film.avi', 'frames'])
def test_frames_belong_to_the_pressure_of_their_time(track, source):
    rate = ('--rate', f'{RATE:g}') if source == 'frames' else ()
    code, _, output = track(source, '--delay', str(DELAY), *rate)
    assert code == 0
    run, _ = read_run(output, TARGETS)
    # The frames before the table, and the first of rest, have nothing to belong to.
    shown = np.arange(FRAMES)[-len(run.stamp_ns) :]
    assert run.frame_pressure == pytest.approx(STEP * np.maximum(0, shown - REST + 1), abs=1e-6)
    assert len(run.stamp_ns) == FRAMES - REST + 1
    # A table that counts from zero is moved, as no stamp is zero; the frames with it.
    first = open_recording(output).start_ns
    assert first == 10**9
    assert (run.reading_stamp_ns[0] - first) * 1e-9 == pytest.approx(DELAY, abs=1e-8)


@pytest.mark.parametrize('uneven', [0.05, 0.1])
def test_dots_painted_by_hand_are_found(tmp_path, capsys, uneven):
    write_video(tmp_path / 'film.avi', pictures(uneven=uneven))
    words = [str(tmp_path / 'film.avi'), '--camera-info', 'none', '--json']
    assert main(['track', *words, '--output', str(tmp_path / 'out.mcap')]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['seen'] >= 0.99 * TARGETS * summary['explained'] > 0, summary


def test_without_forces_nothing_hangs_and_a_known_load_is_no_reading(track):
    bare, _ = read_run(track('film.avi', '--delay', '0.1')[2], TARGETS)
    assert not bare.loaded
    code, said, output = track(
        'film.avi', '--delay', '0.1', '--end-load', '0.1', '-0.02', '--overwrite'
    )
    assert code == 0
    assert 'the weight of 10.4 g' in said
    hung, sentences = read_run(output, TARGETS)
    assert hung.load_known
    np.testing.assert_array_equal(hung.force, np.tile([0.1, -0.02], (len(hung.stamp_ns), 1)))
    assert 'known_load' in reasons(sentences)
    assert 'the weight of 10.4 g' in ' '.join(sentences)


def test_a_string_has_no_load_where_no_film_shows_the_tip(track):
    """The first and the last tip of the film were those of all rows before and after it."""
    code, _, output = track('film.avi', '--delay', '-0.2', '--string', '10g', '0.3', '0')
    assert code == 0
    recording = open_recording(output)
    pulled, frames, rows = (
        [message.log_time_ns for message in recording.messages([f'/pneunet/{name}'])]
        for name in ('string_wrench', 'targets', 'pressure')
    )
    assert rows[0] < frames[0] <= pulled[0] < pulled[-1] <= frames[-1]


@pytest.mark.parametrize('readable', [True, False])
def test_a_string_has_no_load_while_frames_show_no_arm(track, folder, readable):
    shown = list(pictures())
    write_folder(folder / f'{readable}', [*shown[:7], *[np.zeros_like(shown[0])] * 3, *shown[10:]])
    for index in () if readable else (7, 8, 9):
        (folder / f'{readable}' / f'frame{index}.png').write_bytes(b'no picture')
    more = ('--rate', f'{RATE:g}', '--delay', '0', '--string', '10g', '0.3', '0')
    recording = open_recording(track(f'{readable}', *more)[2])
    pulled = [it.log_time_ns for it in recording.messages(['/pneunet/string_wrench'])]
    frames = (np.array(pulled) - recording.start_ns) * 1e-9 * RATE
    assert np.count_nonzero(frames < 6.01) > 0 < np.count_nonzero(frames > 9.99)
    assert not frames[(frames > 6.01) & (frames < 9.99)].size


def test_json_tells_the_delay_and_the_clock_of_the_film(track):
    code, said, _ = track('film.avi', '--delay', '0.1', '--json')
    found = json.loads(said)
    assert code == 0
    assert found['delay'] == 0.1
    assert found['delay_std'] is None
    assert found['frames_covered'] == np.count_nonzero(np.arange(FRAMES) / RATE >= DELAY)


def test_what_cannot_tell_the_delay_gives_no_recording(track, tmp_path):
    code, said, output = track('film.avi', '--json')
    assert code == 1
    found = json.loads(said)
    assert '--delay' in found['delay_sentence']
    assert found['output'] is None
    assert not output.exists()


def test_the_table_of_targets_has_the_stamps_of_the_recording(track, tmp_path):
    table = tmp_path / 'targets.csv'
    assert track('film.avi', '--delay', '0.1', '--table', str(table))[0] == 0
    stamps = {int(line.split(',')[0]) for line in table.read_text().splitlines()[1:]}
    run, _ = read_run(tmp_path / 'out.mcap', TARGETS)
    assert set(run.stamp_ns.tolist()) <= stamps


@pytest.mark.parametrize(
    ('more', 'said'),
    [
        (('--delay', '100'), 'no frame of the film lies within the time range'),
        (('--delay', '1e300'), '--delay 1e.300 must lie between'),
        (('--delay', 'soon'), "--delay: 'soon' is not a time"),
        (('--end-load', 'x', '0'), "--end-load: 'x' is not a force"),
        (('--ignore', 'Pressure [kPa]'), 'no reading|has no pressure'),
    ],
)
def test_what_does_not_go_together_is_said(track, more, said):
    code, text, output = track('film.avi', *more)
    assert code == 2
    assert re.search(said, text)
    assert not output.exists()


def test_a_film_is_no_table(folder, tmp_path, capsys):
    words = ['import', str(folder / 'film.avi'), '--output', str(tmp_path / 'r.mcap'), '--json']
    assert refusal((main(words), *capsys.readouterr())) == 'wrong_kind'


def test_options_of_a_table_need_one(folder, capsys):
    def why(*words):
        return refusal((main(['track', *words, '--json']), *capsys.readouterr()))

    film, table = str(folder / 'film.avi'), str(folder / 'table.csv')
    demo = str(share_path('bags/camera_demo'))
    assert why(film, '--camera-info', 'none', '--delay', '1') == 'missing'
    assert why(demo, '--readings', table, '--output', 'x.mcap') == 'other_source'
    assert why(film, '--camera-info', 'none', '--readings', table) == 'missing'


def test_forces_and_targets_of_a_table_are_looked_at(folder, tmp_path, capsys):
    table = tmp_path / 'table.csv'

    def why(text, *words):
        table.write_text(text)
        film = ['track', str(folder / 'film.avi'), '--camera-info', 'none', '--delay', '0']
        output = ['--output', str(tmp_path / 'out.mcap'), '--readings', str(table), '--json']
        return refusal((main([*film, *output, *words]), *capsys.readouterr()))

    assert why('time_s,pressure_pa,x0_m,y0_m\n0,0,0,0\n1,0,0,0\n') == 'given_twice'
    forces = 'time_s,pressure_pa,force_x_n\n0,0,0.1\n1,0,0.2\n'
    assert why(forces, '--end-load', '0.1', '0') == 'exclusive'
    assert why('time_s,force_x_n\n0,0.1\n1,0.2\n') == 'no_pressure'


def test_a_clamp_at_the_right_is_noticed_and_what_is_said_helps(tmp_path, capsys):
    """A mirrored film is refused, and nothing is written; with that clamp_pixel it is tracked."""
    write_video(tmp_path / 'film.avi', [np.ascontiguousarray(p[:, ::-1]) for p in pictures(28)])
    output = tmp_path / 'out.mcap'
    command = ['track', str(tmp_path / 'film.avi'), '--camera-info', 'none', '--output']
    assert main([*command, str(output)]) == 2
    said = capsys.readouterr().err
    assert not output.exists()
    pixel = re.search(r'about \[(\d+), (\d+)\]', said)
    assert f'--clamp-pixel {pixel[1]} {pixel[2]}' in said
    assert main([*command, str(output), '--clamp-pixel', pixel[1], pixel[2]]) == 0
    assert output.exists()


def test_a_turned_film_or_folder_has_no_rows_of_the_sensor(tmp_path, capsys):
    """As a phone writes it that was held the other way round: its readout is along no row."""
    write_video(tmp_path / 'upright.avi', pictures(8))
    film = tmp_path / 'film.mp4'
    writer = cv2.VideoWriter(
        str(film), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*'mp4v'), RATE, pictures()[0].shape[::-1]
    )
    for picture in pictures(8):
        writer.write(cv2.cvtColor(picture[::-1, ::-1], cv2.COLOR_GRAY2BGR))
    writer.release()
    content = bytearray(film.read_bytes())
    matrix = content.index(b'tkhd') + 44  # of ISO 14496-12: what a player does with the pixels
    turn = np.array([-1, 0, 0, 0, -1, 0, *pictures()[0].shape[::-1], 1 << 14], '>i4')
    turn[[0, 4, 6, 7]] <<= 16
    content[matrix : matrix + 36] = turn.tobytes()
    film.write_bytes(content)
    (tmp_path / 'folder').mkdir()
    entry = struct.pack('<HHIHH', 0x0112, 3, 1, 3, 0)  # EXIF: turned by 180 degrees
    exif = b'Exif\0\0II*\0\x08\0\0\0' + struct.pack('<H', 1) + entry + bytes(4)
    segment = b'\xff\xe1' + struct.pack('>H', len(exif) + 2) + exif
    for number, picture in enumerate(pictures(8)):
        jpeg = cv2.imencode('.jpg', picture[::-1, ::-1])[1].tobytes()
        (tmp_path / f'folder/{number}.jpg').write_bytes(jpeg[:2] + segment + jpeg[2:])
    camera = share_path('config/camera.yaml').read_text()
    for name, readout, code in (
        ('film.mp4', 0.02, 2),
        ('film.mp4', 0.0, 0),
        ('folder', 0.02, 2),
        ('folder', 0.0, 0),
        ('upright.avi', 0.02, 0),
    ):
        file = tmp_path / 'camera.yaml'
        file.write_text(camera.replace('readout: 0.0', f'readout: {readout}'))
        words = [str(tmp_path / name), '--camera-info', 'none', '--camera', str(file), '--json']
        assert main(['track', *words]) == code
        said = capsys.readouterr()
        if code:
            assert refusal((code, *said)) == 'not_supported'


def test_an_upright_arm_is_refused_at_once_and_what_is_said_helps(tmp_path, capsys):
    """A portrait film names both ends; the one that is the clamp makes it a recording."""
    turned = [np.ascontiguousarray(np.rot90(p, -1)) for p in pictures(8)]  # it hangs
    write_video(tmp_path / 'film.avi', [*[turned[0]] * 30, *turned])
    output = tmp_path / 'out.mcap'
    command = ['track', str(tmp_path / 'film.avi'), '--camera-info', 'none', '--output']
    assert main([*command, str(output)]) == 2
    said = capsys.readouterr().err
    assert 'upright' in said
    assert not output.exists()
    ends = re.findall(r'\[\d+, \d+\]', said)
    top = min(ends, key=lambda end: json.loads(end)[1])
    camera = share_path('config/camera.yaml').read_text()
    (tmp_path / 'camera.yaml').write_text(
        camera.replace('clamp_pixel: null', f'clamp_pixel: {top}')
    )
    assert main([*command, str(output), '--camera', str(tmp_path / 'camera.yaml')]) == 0
    assert output.exists()
