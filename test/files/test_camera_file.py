"""Camera files: the shipped one, what is read, and what is refused with which sentence."""

from __future__ import annotations

import dataclasses
from pathlib import Path
import random

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.notes import Note
from pneunet_ros.files.camera_file import load_camera, load_camera_info, settings_from_mapping
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import (
    AdaptiveBand,
    AreaLimits,
    CameraSettings,
    FixedBand,
    HomographyPlane,
    PosePlane,
    RestPlane,
    Shutter,
)
import pytest
from ruamel.yaml import YAML
from support.refusals import refused

SHIPPED = Path(__file__).resolve().parents[2] / 'config' / 'camera.yaml'
EXAMPLE = """\
schema_version: 1
plane: {method: rest}
clamp_pixel: [100, 240.5]
rest_frames: 7
rest_straightness: 0.03
grey_band: {method: fixed, low: 140, high: 250}
area: {smallest: 10, largest: 900, elongation: 3, hole: 5}
gate: 0.5
"""
# As cameracalibrator writes it.
CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [611.5, 0., 322.5, 0., 605., 238., 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.09, -1e-3, 5.0e-4, 0.]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [600., 0., 322., 0., 0., 600., 238., 0., 0., 0., 1., 0.]
"""


@pytest.fixture
def write(tmp_path):
    """Write a file: an example with one text replaced by another."""

    def written(old='', new='', example=EXAMPLE):
        assert old in example
        path = tmp_path / 'mine.yaml'
        path.write_text(example.replace(old, new, 1))
        return path

    return written


def refusal(path, load=load_camera):
    """Load a file that is refused: the sentence, which names the file and stands in one line."""
    with pytest.raises(CameraError) as caught:
        load(path)
    sentence = str(caught.value)
    assert str(path) in sentence
    assert '\n' not in sentence
    return Note(sentence, reason=caught.value.reason)


# ---- the shipped file ---------------------------------------------------------------------------


def test_the_shipped_file_holds_the_defaults():
    assert dataclasses.asdict(load_camera(SHIPPED)) == dataclasses.asdict(CameraSettings())
    assert type(load_camera(SHIPPED).plane) is type(CameraSettings().plane)
    assert type(load_camera(SHIPPED).grey_band) is type(CameraSettings().grey_band)


def test_the_shipped_file_holds_every_setting():
    content = YAML(typ='safe').load(SHIPPED)
    assert list(content)[1:] == [field.name for field in dataclasses.fields(CameraSettings)]
    assert list(content['area']) == [field.name for field in dataclasses.fields(AreaLimits)]
    assert list(content['shutter']) == [field.name for field in dataclasses.fields(Shutter)]
    assert list(content['grey_band'])[1:] == [
        field.name for field in dataclasses.fields(AdaptiveBand)
    ]


def test_every_key_of_the_shipped_file_is_commented():
    above = ''
    keys = []
    for line in SHIPPED.read_text().splitlines():
        if line.strip() and not line.strip().startswith('#'):
            keys.append(line.split(':')[0].strip())
            assert above.strip().startswith('#') or '#' in line, f'{line}: no comment'
        above = line
    assert len(keys) == 20


def test_polarity_is_one_of_three():
    assert settings_from_mapping({'schema_version': 1}).polarity == 'auto'
    assert settings_from_mapping({'schema_version': 1, 'polarity': 'dark'}).polarity == 'dark'
    with refused(CameraError, 'unknown_kind'):
        settings_from_mapping({'schema_version': 1, 'polarity': 'white'})


def test_a_fixed_band_of_dark_targets_is_that_of_the_inverted_image():
    band = FixedBand(low=10.0, high=90.0).inverted()
    assert (band.low, band.high) == (165.0, 245.0)


@pytest.mark.parametrize('owner', [RestPlane, HomographyPlane, PosePlane, AdaptiveBand, FixedBand])
def test_the_shipped_file_shows_all_alternatives(owner):
    text = SHIPPED.read_text()
    assert f'{owner.method}: ' in text
    for field in dataclasses.fields(owner):
        assert f' {field.name}: ' in text


@pytest.mark.parametrize('method', ['homography', 'pose', 'fixed'])
def test_alternatives_are_read_as_the_comments_show_them(tmp_path, method):
    lines = SHIPPED.read_text().splitlines()
    start = next(at for at, line in enumerate(lines) if f'method: {method}' in line)
    end = next(at for at in range(start, len(lines)) if not lines[at].startswith('  #     '))
    key = 'grey_band' if method == 'fixed' else 'plane'
    block = [line.replace('  #     ', '  ') for line in lines[start:end]]
    path = tmp_path / 'camera.yaml'
    path.write_text('\n'.join(['schema_version: 1', f'{key}:', *block]))
    assert getattr(load_camera(path), key).method == method


# ---- what is read -------------------------------------------------------------------------------


def test_all_settings_are_read(write):
    camera = load_camera(str(write()))
    assert camera.plane == RestPlane()
    assert camera.clamp_pixel == (100.0, 240.5)
    assert (camera.rest_frames, camera.rest_straightness, camera.gate) == (7, 0.03, 0.5)
    assert camera.grey_band == FixedBand(low=140.0, high=250.0)
    assert camera.area == AreaLimits(smallest=10.0, largest=900.0, elongation=3.0, hole=5.0)
    assert type(camera.area.smallest) is type(camera.grey_band.low) is float


def test_what_is_left_out_has_its_default(write):
    text = 'schema_version: 1\nplane:\narea: {hole: 3.0}\ngrey_band:\nshutter: {readout: 0.02}\n'
    camera = load_camera(write(EXAMPLE, text))
    assert camera.shutter == Shutter(readout=0.02, exposure=0.0)
    assert camera.area == AreaLimits(hole=3.0)
    assert (camera.plane, camera.grey_band) == (RestPlane(), AdaptiveBand())
    assert camera.clamp_pixel is None


def test_the_other_planes_are_read(write):
    pose = '{method: pose, position: [0, 0, 0.5], quaternion: [1, 0, 0, 0]}'
    camera = load_camera(write('{method: rest}', pose))
    assert camera.plane == PosePlane(position=(0, 0, 0.5), quaternion=(1, 0, 0, 0))
    points = '{method: homography, pixels: [[1, 2], [3, 4], [5, 6], [7, 9]], '
    points += 'points: [[0, 0], [0, 1], [1, 1], [1, 2e-1]]}'
    plane = load_camera(write('{method: rest}', points)).plane
    assert plane.pixels.tolist() == [[1, 2], [3, 4], [5, 6], [7, 9]]
    assert plane.points.tolist() == [[0, 0], [0, 1], [1, 1], [1, 0.2]]


def test_a_calibration_is_read(write):
    lens = load_camera_info(str(write(example=CALIBRATION)))
    assert (lens.width, lens.height, lens.model) == (640, 480, 'plumb_bob')
    assert lens.matrix.tolist() == [[611.5, 0, 322.5], [0, 605, 238], [0, 0, 1]]
    assert lens.distortion.tolist() == [-0.28, 0.09, -1e-3, 5e-4, 0]


def test_a_calibration_of_the_other_model_is_read(write):
    text = CALIBRATION.replace('plumb_bob', 'rational_polynomial')
    path = write('-1e-3, 5.0e-4, 0.', '0, 0, 0, 0.1, 0.2, 0.3', text)
    assert load_camera_info(path).model == 'rational_polynomial'


@pytest.mark.parametrize('data', ['[]', ''])
def test_a_calibration_without_distortion_is_read(write, data):
    lens = load_camera_info(write('[-0.28, 0.09, -1e-3, 5.0e-4, 0.]', data, CALIBRATION))
    assert lens.distortion.size == 0
    assert isinstance(lens, Lens)


# ---- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('old', 'new', 'where', 'known'),
    [
        ('gate:', 'gates:', 'gates', 'schema_version, plane, clamp_pixel, rest_frames'),
        ('smallest:', 'small:', 'area.small', 'smallest, largest, elongation, hole'),
        ('low:', 'contrast:', 'grey_band.contrast', 'method, low, high'),
        ('fixed, low: 140,', 'adaptive, contrast: 9,', 'grey_band.high', 'method, contrast'),
        ('method: rest', 'method: rest, scale: 1', 'plane.scale', 'known keys: method'),
        (
            'method: rest',
            'method: pose, position: [0, 0, 1], orientation: [1, 0, 0, 0]',
            'plane.orientation',
            'method, position, quaternion',
        ),
    ],
)
def test_an_unknown_key_is_refused_with_the_known_ones(write, old, new, where, known):
    sentence = refusal(write(old, new))
    assert (sentence.reason, where in sentence) == ('unknown_key', True)
    assert known in sentence


POSE = 'pose, position: [0, 0, 1], quaternion: '


@pytest.mark.parametrize(
    ('old', 'new', 'reason'),
    [
        ('schema_version: 1', '', 'missing_key'),
        ('schema_version: 1', 'schema_version: 2', 'unknown_version'),
        ('schema_version: 1', 'schema_version: true', 'unknown_version'),
        ('{method: rest}', 'rest', 'not_a_mapping'),
        ('{method: rest}', '{}', 'unknown_kind'),
        ('method: rest', 'method: [rest]', 'unknown_kind'),
        ('method: rest', 'method: homography', 'missing_key'),
        ('method: rest', 'method: homography, pixels: 3, points: 4', 'wrong_shape'),
        (
            'method: rest',
            'method: homography, pixels: [[1, 2], [3, 4], [5, 6]], points: [[1, 2]]',
            'wrong_shape',
        ),
        (
            'method: rest',
            'method: homography, pixels: [[1, 2], [3, 4]], points: [[1, 2], [1, 3]]',
            'too_few',
        ),
        ('method: rest', 'method: homography, pixels: [[1, x]], points: [[1, 2]]', 'not_a_table'),
        ('method: rest', 'method: pose', 'missing_key'),
        ('rest}', POSE + '[1, 0, 0]}', 'wrong_shape'),
        ('rest}', POSE + '[1, 1, 0, 0]}', 'no_direction'),
        ('rest}', POSE + '[.nan, 1, 0, 0]}', 'not_finite'),
        ('rest}', POSE + '"1 0 0 0"}', 'not_a_table'),
        ('[100, 240.5]', '[100]', 'wrong_shape'),
        ('[100, 240.5]', 'left', 'not_a_table'),
        ('[100, 240.5]', '[.inf, 3]', 'not_finite'),
        ('rest_frames: 7', 'rest_frames: 7.0', 'not_a_number'),
        ('rest_frames: 7', 'rest_frames: true', 'not_a_number'),
        ('rest_frames: 7', 'rest_frames: 0', 'out_of_bounds'),
        ('0.03', '0.3', 'out_of_bounds'),
        ('0.03', '', 'not_a_number'),
        ('gate: 0.5', 'gate: "0.5"', 'not_a_number'),
        ('gate: 0.5', 'gate: .nan', 'not_a_number'),
        ('gate: 0.5', 'gate: true', 'not_a_number'),
        ('gate: 0.5', f'gate: 1{400 * "0"}', 'too_large'),
        ('gate: 0.5', f'gate: 0x{9000 * "f"}', 'not_yaml'),
        ('schema_version: 1', f'schema_version: 0x{9000 * "f"}', 'not_yaml'),
        ('fixed', 'otsu', 'unknown_kind'),
        ('low: 140', 'low: 251', 'wrong_order'),
        ('low: 140', 'low: 0', 'out_of_bounds'),
        ('low: 140', 'low: dark', 'not_a_number'),
        ('{smallest: 10, largest: 900, elongation: 3, hole: 5}', '9', 'not_a_mapping'),
        ('smallest: 10', 'smallest: 901', 'wrong_order'),
        ('elongation: 3', 'elongation: 0.5', 'out_of_bounds'),
        ('gate: 0.5', 'gate: 0.5\ngate: 0.4', 'not_yaml'),
        ('gate: 0.5', 'gate: *a', 'not_yaml'),
        ('[100, 240.5]', '&a [*a]', 'too_large'),
    ],
)
def test_wrong_settings_are_refused(write, old, new, reason):
    assert refusal(write(old, new)).reason == reason


@pytest.mark.parametrize(
    ('old', 'new', 'reason'),
    [
        ('image_width: 640\n', '', 'missing_key'),
        ('image_width: 640', 'image_width: wide', 'out_of_bounds'),
        ('image_height: 480', 'image_height: 0', 'out_of_bounds'),
        ('camera_matrix:', 'matrix:', 'missing_key'),
        ('611.5, ', '', 'wrong_shape'),
        ('611.5', 'x', 'not_a_table'),
        ('611.5', '.nan', 'not_finite'),
        ('[611.5, 0., 322.5, 0., 605., 238., 0., 0., 1.]', '', 'wrong_shape'),
        ('611.5', '0.', 'not_calibrated'),
        ('plumb_bob', 'equidistant', 'unknown_kind'),
        ('plumb_bob', '[plumb_bob]', 'unknown_kind'),
        (', 0.]\nrect', ', 0., 0.]\nrect', 'wrong_shape'),
        ('distortion_coefficients:', 'distortion_coefficients: 3\nother:', 'not_a_mapping'),
        (CALIBRATION, EXAMPLE, 'missing_key'),
        (CALIBRATION, '', 'not_a_mapping'),
    ],
)
def test_wrong_calibrations_are_refused(write, old, new, reason):
    assert refusal(write(old, new, CALIBRATION), load_camera_info).reason == reason


@pytest.mark.parametrize('load', [load_camera, load_camera_info])
def test_files_that_cannot_be_read_are_named(tmp_path, load):
    assert refusal(tmp_path / 'nowhere.yaml', load).reason == 'not_found'
    assert refusal(tmp_path, load).reason == 'unreadable'
    path = tmp_path / 'large.yaml'
    path.write_bytes(random.Random(1).randbytes(1_000_000))
    assert refusal(path, load).reason == 'unreadable'
    path.write_bytes(bytes(1_000_001))
    assert refusal(path, load).reason == 'too_large'


# ---- anything at all ----------------------------------------------------------------------------


def read_or_refused(path, content):
    """Both readers give their result or a sentence in one line, whatever the bytes."""
    path.write_bytes(content)
    for load, kind in ((load_camera, CameraSettings), (load_camera_info, Lens)):
        try:
            assert isinstance(load(path), kind)
        except CameraError as error:
            assert str(path) in str(error)
            assert '\n' not in str(error)


# What YAML gives a meaning of its own.
MARKS = [
    '-',
    '.',
    ',',
    ':',
    '? ',
    '[]',
    '{}',
    '|',
    '>',
    '%',
    '"',
    "'",
    '#',
    '~',
    '\t',
    '\n',
    '\x85',
]
WORDS = ['.inf', 'null', '&a ', '*a', '1e999', '2001-01-01', '0x', '<<', '{{a: b}: c}', '[[1]]: 2']
TAGS = ['int', 'set', 'omap', 'binary', 'timestamp', 'float', 'bool', 'null', 'str', 'pairs']
anything = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@anything
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tmp_path, content):
    read_or_refused(tmp_path / 'any.yaml', content)


@anything
@given(data=st.data(), example=st.sampled_from([EXAMPLE, CALIBRATION]))
def test_any_change_of_a_file_is_read_or_refused(tmp_path, data, example):
    scraps = st.sampled_from([*MARKS, *WORDS, *(f'!!{tag} ' for tag in TAGS)]) | st.text(
        max_size=6
    )
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(example)))
        end = min(start + data.draw(st.integers(0, 12)), len(example))
        scrap = data.draw(scraps)
        example = example[:start] + scrap + example[end:]
    read_or_refused(tmp_path / 'changed.yaml', example.encode('utf-8', 'surrogatepass'))


def test_settings_know_their_arrays_are_frozen(write):
    points = '{method: homography, pixels: [[1, 2], [3, 4], [5, 6], [7, 9]], '
    plane = load_camera(
        write('{method: rest}', points + 'points: [[0, 0], [0, 1], [1, 1], [1, 2]]}')
    )
    with pytest.raises(ValueError, match='read-only'):
        plane.plane.pixels[0, 0] = 3.0
    assert np.asarray(plane.plane.points).dtype == np.float64
