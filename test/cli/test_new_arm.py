"""`new-arm`: an arm to start from, and a sheet on which a millimeter is a millimeter."""

from __future__ import annotations

import json
import re

import matplotlib
from matplotlib.patches import Rectangle
import numpy as np
from pneunet_ros import solve
from pneunet_ros.cli.main import main
from pneunet_ros.cli.verbs import new_arm
from pneunet_ros.files.model_file import load_model
from pneunet_ros.model.starting_arm import even_places, INVENTED, TURN
from pneunet_ros.reports.target_template import PAGES, RULER, STRIPS, template_page, write_template
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.tracker import Tracker
import pytest

SIZES = ('--length', '112mm', '--weight', '17g', '--pressure', '60kPa', '--dot', '3mm')
POINT = 25.4 / 72.0  # mm, the unit of a PDF


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the verb in an empty folder; returns its exit code and what it says."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('sys.stdin.isatty', lambda: False, raising=False)

    def run(*arguments):
        code = main(['new-arm', *arguments])
        said = capsys.readouterr()
        return code, said.out + said.err

    return run


def test_an_arm_to_start_from(run, tmp_path):
    code, said = run(*SIZES, '--targets', '12')
    assert code == 0
    assert 'placeholders' in said
    arm = load_model(tmp_path / 'arm.yaml')
    assert arm.length == 0.112
    assert arm.weight == pytest.approx(0.017 * 9.80665)
    assert arm.pressure_range == (0.0, 60e3)
    np.testing.assert_allclose(arm.target_arclength, 0.01 * np.arange(12), rtol=1e-12)
    assert arm.sources['moment_law'] == INVENTED
    assert (tmp_path / 'arm.pdf').read_bytes().startswith(b'%PDF')
    Tracker(arm, CameraSettings())  # and it can be looked for
    code, said = run(*SIZES, '--targets', '12')
    assert (code, 'exists' in said) == (2, True)


def test_an_arm_under_vacuum_bends_as_one_under_pressure(run, tmp_path):
    code, said = run(*SIZES, '--pressure', '-60kPa', '--targets', '12', '--no-template')
    assert (code, 'up to -60 kPa' in said) == (0, True)
    arm = load_model(tmp_path / 'arm.yaml')
    assert arm.pressure_range == (-60e3, 0.0)
    assert solve(arm, pressure=-60e3).tip[2] == pytest.approx(TURN)
    assert solve(arm, pressure=0.0).tip[2] == pytest.approx(0.0)


def test_places_that_were_measured(run, tmp_path):
    places = ('--places', '0', '9.5mm', '0.021', '40mm')
    code, said = run(*SIZES, *places, '--output', 'mine.yaml', '--no-template', '--json')
    assert code == 0
    assert json.loads(said)['target_arclength'] == [0.0, 0.0095, 0.021, 0.04]
    assert load_model(tmp_path / 'mine.yaml').name == 'mine'
    assert sorted(path.name for path in tmp_path.iterdir()) == ['mine.yaml']


def test_what_is_not_given_is_asked_for(run, tmp_path, monkeypatch):
    answers = iter(['95 mm', '', '0.5bar', '2.5mm', '9'])
    monkeypatch.setattr(new_arm.sys.stdin, 'isatty', lambda: True, raising=False)
    monkeypatch.setattr('builtins.input', lambda question: next(answers))
    code, _ = run('--output', 'asked.yaml')
    assert code == 0
    arm = load_model(tmp_path / 'asked.yaml')
    assert (arm.length, arm.pressure_range[1], arm.target_arclength.size) == (0.095, 5e4, 9)
    assert arm.weight == pytest.approx(0.017 * 9.80665)  # the usual


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (('--length', '112mm'), 'missing'),
        (('--length', '112', *SIZES[2:], '--targets', '9'), 'out_of_bounds'),
        ((*SIZES, '--places', '0', '10', '20'), 'out_of_bounds'),
        ((*SIZES, '--targets', '2'), 'out_of_bounds'),
        ((*SIZES, '--targets', '40'), 'out_of_bounds'),
        ((*SIZES[:-1], '3furlong', '--targets', '9'), 'not_a_number'),
        ((*SIZES[:-1], '0mm', '--targets', '9'), 'out_of_bounds'),
        ((*SIZES, '--pressure', '0', '--targets', '9'), 'out_of_bounds'),
        ((*SIZES, '--pressure=-120kPa', '--targets', '9'), 'out_of_bounds'),
        ((*SIZES, '--targets', '9', '--places', '0', '1'), 'exclusive'),
        ((*SIZES, '--places', '0', '10mm', '5mm'), 'not_increasing'),
        ((*SIZES, '--places', '0', '20mm', '22mm'), 'out_of_bounds'),
        ((*SIZES, '--targets', '9', '--output', 'arm.txt'), 'wrong_suffix'),
        (('--length', '0.6', *SIZES[2:], '--targets', '12'), 'too_large'),
    ],
)
def test_what_makes_no_arm_is_said(run, tmp_path, capsys, arguments, reason):
    main(['new-arm', *arguments, '--json'])
    assert json.loads(capsys.readouterr().out)['reason'] == reason
    assert not list(tmp_path.iterdir())


def test_places_lie_on_the_marks_of_a_ruler_and_dots_on_the_arm():
    for length, targets, diameter in ((0.112, 12, 0.003), (0.0777, 9, 0.0025), (0.2, 23, 0.005)):
        places = even_places(length, targets, diameter, 0.0005)
        np.testing.assert_allclose(places / 0.0005, np.round(places / 0.0005), atol=1e-9)
        assert places[-1] + 0.5 * diameter <= length
        assert places.size == targets


def pages(path):
    """Return the pages of an uncompressed PDF: width and height (mm), and what draws them."""
    text = path.read_bytes().decode('latin-1')
    sizes = re.findall(r'/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]', text)
    streams = re.findall(r'stream\n(/DeviceRGB CS.*?)endstream', text, re.DOTALL)
    return [(float(w) * POINT, float(h) * POINT) for w, h in sizes], streams


def circles(stream):
    """Return the centers and diameters (mm) of all circles: paths of eight curves."""
    number = r'-?[\d.]+'
    curve = rf'(?:{number} ){{6}}c\n'
    found = []
    for path in re.findall(rf'{number} {number} m\n(?:{curve}){{8}}', stream):
        values = np.array(re.findall(number, path), float).reshape(-1, 2) * POINT
        low, high = values.min(axis=0), values.max(axis=0)
        found.append((*(0.5 * (low + high)), *(high - low)))
    return np.array(found)


def test_the_sheet_is_one_to_one(tmp_path):
    places = np.array([0.0, 0.0125, 0.02, 0.04, 0.1005])
    with matplotlib.rc_context({'pdf.compression': 0}):
        write_template(tmp_path / 'sheet.pdf', 'mine', places, 0.003)
    sizes, streams = pages(tmp_path / 'sheet.pdf')
    np.testing.assert_allclose(sizes, list(PAGES.values()), atol=0.01)
    assert len(streams) == len(PAGES)
    for stream, (width, height) in zip(streams, PAGES.values(), strict=True):
        dots = circles(stream)
        assert len(dots) == len(STRIPS) * places.size
        np.testing.assert_allclose(dots[:, 2:], 3.0, atol=2e-3)
        for strip in range(len(STRIPS)):
            row = dots[strip * places.size : (strip + 1) * places.size]
            np.testing.assert_allclose(row[:, 0], row[0, 0], atol=1e-3)
            np.testing.assert_allclose(row[:, 1] - row[0, 1], 1e3 * places, atol=2e-3)
        assert np.all((dots[:, :2] > 10.0) & (dots[:, :2] < [width - 10.0, height - 10.0]))
        # The scale: lines one after the other, a millimeter apart.
        line = r'([\d.]+) ([\d.]+) m\n([\d.]+) ([\d.]+) l\n'
        lines = np.array(re.findall(line, stream), float) * POINT
        ticks = lines[np.isclose(lines[:, 0], lines[-1, 0]) & np.isclose(lines[:, 1], lines[:, 3])]
        np.testing.assert_allclose(np.diff(ticks[:, 1]), 1.0, atol=2e-3)
        assert ticks[-1, 1] - ticks[0, 1] == pytest.approx(RULER, abs=2e-3)


def test_every_strip_says_which_arm_and_which_end_it_is():
    """Labels lie within the strip that is cut out, the clamp at the end of dot 0."""
    page = template_page('A4', 'mine', np.arange(12) * 0.01, 0.003)
    page.canvas.draw()
    (axes,) = page.axes
    strips = [patch.get_bbox() for patch in axes.patches if isinstance(patch, Rectangle)]
    assert len(strips) == len(STRIPS)
    to_page = axes.transData.inverted()
    for strip in strips:
        within = {}
        for text in axes.texts:
            box = text.get_window_extent().transformed(to_page)
            if strip.x0 <= box.x0 and box.x1 <= strip.x1:
                assert strip.y0 <= box.y0 and box.y1 <= strip.y1
                within[text.get_text()] = box
        assert set(within) == {'CLAMP', 'mine', 'FREE END', 'dots 3 mm, every 10 mm'}
        assert within['CLAMP'].y1 < within['mine'].y0 < within['FREE END'].y0
        assert within['CLAMP'].y0 < strip.y0 + 5.0


@pytest.mark.parametrize(
    ('first', 'label', 'goes'),
    [(0.0, 'CLAMP', 'goes to the clamp.'), (0.02, 'CLAMP SIDE', 'goes 20 mm from the clamp.')],
)
def test_the_sheet_says_where_the_first_dot_goes(first, label, goes):
    (axes,) = template_page('A4', 'mine', first + np.arange(5) * 0.02, 0.003).axes
    texts = [text.get_text() for text in axes.texts]
    assert texts.count(label) == len(STRIPS)
    assert any(text.endswith(goes) for text in texts)
