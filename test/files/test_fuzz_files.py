"""YAML files of people, damaged in any way: what they say, or a sentence; never anything else."""

from __future__ import annotations

import io
from pathlib import Path
from textwrap import indent

from hypothesis import strategies as st
from pneunet_ros.core.errors import CameraError, ModelError, RecordingError, RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera, load_camera_info
from pneunet_ros.files.model_file import load_model
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.model.arm import Arm
from pneunet_ros.recordings.bag_folder import METADATA, stored_files
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import CameraSettings
import pytest
from ruamel.yaml import YAML
from support.fuzzing import AMOUNTS, answer, damaged_text, damaged_tree, fuzz

MODEL = """\
schema_version: 1
name: arm
arm: {length: 0.112, weight: 0.17, clamp_angle: 0.0, target_arclength: [0.0, 0.005]}
intrinsic_curvature:
  pressure: [0.0, 55000.0]
  arclength: [0.0, 0.5, 1.0]
  curvature: [[0, 0, 0], [25, 30, 20]]
moment_law:
  kind: piecewise_linear
  pressure: [0.0, 66000.0]
  split: [0.10, 0.15]
  rigidity: [[0.06, 0.03], [0.07, 0.04]]
  moment_offset: [[0, 0], [-0.006, 0]]
effects: {extensibility: {axial_stiffness: 40.0}, creep: {amplitude: 0.1, time_constant: 2.0}}
sensors: {pressure_std: 60.0, force_std: 0.001, moment_std: 1.0e-5, target_std: 0.00012}
covariance: {quantities: [arm.length, moment_law.rigidity.0.1], factor: [[1e-5], [1e-3]]}
sources: {arm.length: measured}
provenance: {source: mine, recordings: []}
"""
CAMERA_INFO = """\
image_width: 640
image_height: 480
camera_name: camera
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0, 320, 0, 510.0, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0.001, -0.001, 0.0]}
"""
SCENARIO = """\
schema_version: 1
name: mine
seed: 3
effects: {gravity: {weight_y: -1.5}}
protocol: {kind: random_mix, duration: 5.0, force_x: [0.1, 0.2]}
noise: {pressure_std: 60.0}
rates: {pressure: 50.0}
detail: {elements: 64.0}
arm:
""" + indent(share_path('scenarios/lab_arm.yaml').read_text(), '  ')
BAG = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  relative_file_paths: [bag.mcap]
  compression_mode: ''
"""

# What a file is read by, what it becomes, its error, and one of it that is right.
KINDS = {
    'model': (load_model, Arm, ModelError, MODEL),
    'camera': (
        load_camera,
        CameraSettings,
        CameraError,
        share_path('config/camera.yaml').read_text(),
    ),
    'camera_info': (load_camera_info, Lens, CameraError, CAMERA_INFO),
    'scenario': (load_scenario, Scenario, RequestError, SCENARIO),
}
MARKS = ['-', '.', ',', ':', '? ', '[]', '{}', '[', '{', '|', '>', '%', '"', "'", '#', '~', '\t']
WORDS = [
    '.inf',
    '.nan',
    'null',
    '&a ',
    '*a',
    '1e999',
    '-1',
    '0',
    '1e-300',
    '2001-01-01',
    '0x',
    '<<',
]
TAGS = ['int', 'set', 'omap', 'binary', 'timestamp', 'float', 'bool', 'str', 'pairs', 'merge']
PYTHON = [
    '!!python/object/apply:os.system ["exit 1"]',
    '!!python/name:os.system',
    '!include /etc/os-release',
]
SCRAPS = st.sampled_from(
    ['\n', '\x85', '', *MARKS, *WORDS, *PYTHON, *(f'!!{tag} ' for tag in TAGS)]
) | st.text(max_size=6)
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(10**25), 10**25)
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(
        [0, -1, 1e-300, 1e300, -1e30, [], {}, [[]], [0.0], {'a': 1}, 'pose', 'majidi']
    )
    | st.lists(st.floats(allow_nan=False), max_size=4)
)


def check(kind: str, path: Path) -> None:
    """Read a file: either what it must become, or its error, which names the file in one line."""
    load, becomes, error, _ = KINDS[kind]
    found = answer(load, path)
    assert isinstance(found, (becomes, error))
    if isinstance(found, error):
        assert str(path) in str(found)
        assert '\n' not in str(found)


@AMOUNTS
@pytest.mark.parametrize('kind', KINDS)
def test_any_text_is_read_or_refused(tmp_path, kind, examples):
    path = tmp_path / 'file.yaml'

    def body(text: str) -> None:
        path.write_bytes(text.encode('utf-8', 'surrogatepass'))
        check(kind, path)

    fuzz(examples, body, text=damaged_text(KINDS[kind][3], SCRAPS))


@AMOUNTS
@pytest.mark.parametrize('kind', KINDS)
def test_any_values_are_read_or_refused(tmp_path, kind, examples):
    path = tmp_path / 'file.yaml'
    yaml = YAML(typ='safe', pure=True)
    tree = yaml.load(KINDS[kind][3])

    def body(changed: object) -> None:
        stream = io.StringIO()
        yaml.dump(changed, stream)
        path.write_text(stream.getvalue(), encoding='utf-8')
        check(kind, path)

    fuzz(examples, body, changed=damaged_tree(tree, LEAVES))


@AMOUNTS
def test_any_metadata_of_a_bag_is_read_or_refused(tmp_path, examples):
    with write_recording(tmp_path / 'bag') as writer:
        writer.add('/pneunet/pressure', 'sensor_msgs/msg/FluidPressure')

    def body(text: str) -> None:
        (tmp_path / 'bag' / METADATA).write_bytes(text.encode('utf-8', 'surrogatepass'))
        found = answer(stored_files, tmp_path / 'bag')
        if isinstance(found, RecordingError):
            assert found.reason
        else:
            assert all(file.parent == tmp_path / 'bag' for file in found)

    fuzz(examples, body, text=damaged_text(BAG, SCRAPS))


BOMB = 'a0: &a0 [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'a{level}: &a{level} [{", ".join([f"*a{level - 1}"] * 9)}]\n' for level in range(1, 12)
)
HOSTILE = {
    'python object': '!!python/object/apply:os.system ["touch was_here"]\n',
    'python name': 'name: !!python/name:os.system\n',
    'python module': 'name: !!python/module:os\n',
    'unknown tag': 'name: !include /etc/os-release\n',
    'aliases of aliases': BOMB,
    'deep lists': '[' * 100_000,
    'deep blocks': ''.join(f'{" " * level}a:\n' for level in range(1200)),
    'deep flow': '{a: ' * 20_000,
    'huge integer': f'name: {"9" * 200_000}\n',
    'huge exponent': 'schema_version: 1e999999999\n',
    'sexagesimal': f'schema_version: {":".join(["59"] * 50_000)}\n',
    'hexadecimal': f'schema_version: 0x{"f" * 100_000}\n',
    'many documents': '---\na: 1\n' * 10_000,
    'many anchors': ''.join(f'- &a{index} 1\n' for index in range(3000)),
    'an anchor twice': '&a name: &a 1\nschema_version: *a\n',
    'a zero in a text': 'schema_version: 1\nname: "a\\0b"\n',
    'half a character in a text': 'schema_version: 1\nname: "\\ud800"\n',
    'zeros': '\0' * 1000,
    'nothing': '',
}


@pytest.mark.parametrize('what', HOSTILE)
@pytest.mark.parametrize('kind', [*KINDS, 'bag'])
def test_no_file_executes_reads_or_blows_up(tmp_path, monkeypatch, kind, what):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / 'bag'
    folder.mkdir()
    path = folder / METADATA
    path.write_text(HOSTILE[what])
    found = answer(stored_files, folder) if kind == 'bag' else answer(KINDS[kind][0], path)
    assert isinstance(found, RecordingError if kind == 'bag' else KINDS[kind][2])
    assert 'NAME=' not in str(found), 'the content of another file'
    assert not (tmp_path / 'was_here').exists()


@pytest.mark.parametrize('kind', [*KINDS, 'bag'])
def test_a_file_without_end_is_not_read_to_its_end(tmp_path, kind):
    endless = Path('/dev/zero')
    if not endless.exists():
        pytest.skip('there is no such file here')
    if kind == 'bag':
        (tmp_path / METADATA).symlink_to(endless)
        found = answer(stored_files, tmp_path)
    else:
        found = answer(KINDS[kind][0], endless)
    assert found.reason == 'unreadable'


@pytest.mark.parametrize('kind', KINDS)
def test_a_huge_file_is_not_read_to_its_end(tmp_path, kind):
    path = tmp_path / 'file.yaml'
    with path.open('wb') as stream:
        stream.truncate(10_000_000_000)
    found = answer(KINDS[kind][0], path)
    assert found.reason == 'too_large'


@pytest.mark.parametrize(
    'arm', ['/etc/os-release', '../secret.yaml', 'a/../../secret.yaml', '..', '']
)
def test_a_scenario_names_an_arm_beside_it_and_no_other_file(tmp_path, arm):
    (tmp_path / 'secret.yaml').write_text('password: 1234\n')
    (tmp_path / 'lab' / 'a').mkdir(parents=True)
    path = tmp_path / 'lab' / 'scenario.yaml'
    path.write_text(f'{SCENARIO.partition("arm:")[0]}arm: "{arm}"\n')
    found = answer(load_scenario, path)
    assert isinstance(found, RequestError)
    assert 'in the same folder' in str(found)
    assert 'password' not in str(found)
