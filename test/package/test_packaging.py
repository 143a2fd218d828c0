"""The package as it is installed: what it needs, what it ships, where that is found."""

from __future__ import annotations

import ast
import importlib
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import venv
from xml.etree import ElementTree

import pneunet_ros
from pneunet_ros.core import share
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.share import share_path
import pytest
from ruamel.yaml import YAML
from support.refusals import refused
from support.setup_arguments import arguments_of_setup, commands_of

CHECKOUT = Path(__file__).resolve().parents[2]
PACKAGE = CHECKOUT / 'pneunet_ros'
ROS = ('rclpy', 'builtin_interfaces', 'std_srvs', 'std_msgs', 'sensor_msgs', 'geometry_msgs')
SHIPPED = ('config', 'launch', 'rviz', 'foxglove', 'plotjuggler', 'bags/table1', 'scenarios')
LARGEST = 1_000_000  # bytes of all that is installed beside the code
NOT_SOURCE = shutil.ignore_patterns(
    '.git', '.venv*', 'build', 'install', 'log', '*.egg-info', '__pycache__', '.*_cache'
)

# Import name -> name on PyPI, name of rosdep; that of mcap brings it with what it needs itself.
LIBRARIES = {
    'cv2': ('opencv-python-headless', 'python3-opencv'),
    'jinja2': ('jinja2', 'python3-jinja2'),
    'lz4': ('lz4', 'mcap-ros2-support'),
    'matplotlib': ('matplotlib', 'python3-matplotlib'),
    'mcap': ('mcap', 'mcap-ros2-support'),
    'llvmlite': ('numba', 'python3-numba'),  # numba comes with it
    'numba': ('numba', 'python3-numba'),
    'numpy': ('numpy', 'python3-numpy'),
    'rich': ('rich', 'python3-rich'),
    'rosbags': ('rosbags', 'python3-rosbags-pip'),
    'ruamel': ('ruamel.yaml', 'python3-ruamel.yaml'),
    'scipy': ('scipy', 'python3-scipy'),
    'zstandard': ('zstandard', 'mcap-ros2-support'),
}

# Imported where they are asked for only, and absent from most robots: extras of setup.py.
OPTIONAL = {'argcomplete': 'completion', 'distributed': 'cluster', 'mujoco': 'mujoco'}


OF_TESTS = {
    'hypothesis': 'python3-hypothesis',
    'pytest': 'python3-pytest',
    'setuptools': 'python3-setuptools',
    'yaml': 'python3-yaml',
}
# Skipped without them, or scripts beside the pages.
BESIDE_TESTS = {'extensible_arm_story', 'make_my_finger', 'mujoco', 'skimage', 'sklearn'}


@pytest.fixture(scope='module')
def manifest():
    return ElementTree.parse(CHECKOUT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def setup_arguments():
    """Return the arguments of `setup()` for a wheel."""
    return arguments_of_setup('bdist_wheel')


def imported_outside_the_house():
    """Top names of all that the package imports beyond the standard library and itself."""
    return imported_by(PACKAGE) - {'pneunet_ros'}


def imported_by(folder):
    """Top names of all that the files of a folder import beyond the standard library."""
    names = set()
    for file in folder.rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.split('.')[0])
    return names - sys.stdlib_module_names


def test_versions_agree(manifest, setup_arguments):
    assert manifest.findtext('version') == setup_arguments['version'] == pneunet_ros.__version__


def test_names_agree(manifest, setup_arguments):
    name = manifest.findtext('name')
    assert name == setup_arguments['name'] == 'pneunet_ros'
    assert (CHECKOUT / 'resource' / name).is_file()
    assert manifest.findtext('license') == setup_arguments['license'] == 'Apache-2.0'


def test_what_is_imported_is_declared(manifest, setup_arguments):
    requirements = {
        re.match(r'[\w.-]+', line).group() for line in setup_arguments['install_requires']
    }
    depends = {element.text for element in manifest.iter('exec_depend')}
    extras = setup_arguments['extras_require']
    for name in imported_outside_the_house():
        if name in OPTIONAL:
            lines = extras[OPTIONAL[name]]
            assert any(line.startswith(name) for line in lines), f'{name} is in no extra'
        elif name in LIBRARIES:
            on_pypi, of_rosdep = LIBRARIES[name]
            assert on_pypi in requirements, f'{name} is imported; setup.py does not require it'
            assert of_rosdep in depends, f'{of_rosdep} is not in package.xml'
        else:
            assert name in depends, (
                f'{name} is imported and declared nowhere: add it to package.xml, '
                'and to setup.py and LIBRARIES of this test if it is no ROS package'
            )


def test_what_tests_import_is_declared(manifest):
    kinds = ('exec_depend', 'test_depend')
    depends = {element.text for kind in kinds for element in manifest.iter(kind)}
    own = {path.stem for path in (CHECKOUT / 'test').rglob('*.py')} | {'support', 'pneunet_ros'}
    keys = {name: key for name, (_, key) in LIBRARIES.items()} | OF_TESTS
    for name in imported_by(CHECKOUT / 'test') - own - BESIDE_TESTS:
        assert keys.get(name, name) in depends, f'{name}: no test_depend of package.xml'


def test_a_test_lies_in_the_room_that_it_tests():
    rooms = {path.parent.name for path in PACKAGE.glob('*/__init__.py')} | {'package'}
    flat = {path.name for path in (CHECKOUT / 'test').glob('test_*.py')}
    assert not flat, f'move into the room of test/ that is tested: {", ".join(sorted(flat))}'
    assert {path.parent.name for path in (CHECKOUT / 'test').glob('*/test_*.py')} <= rooms


def test_the_manifest_names_what_launch_files_and_workflow_need(manifest):
    depends = {element.text for element in manifest.iter('exec_depend')}
    assert {'ros2launch', 'launch', 'launch_ros', 'ament_index_python'} <= depends
    workflow = YAML(typ='safe').load(CHECKOUT / '.github/workflows/ci.yaml')
    assert workflow['jobs']['ros']['container'].startswith('ros:jazzy')


def test_pip_puts_only_names_of_the_package_on_the_path(setup_arguments):
    words = (
        'estimator', 'tracker', 'fusion', 'virtual-arm', 'gripper', 'virtual-gripper', 'stack',
    )  # fmt: skip
    nodes = {f'pneunet-{word}' for word in words}
    assert set(commands_of(setup_arguments)) == {'pneunet', *nodes}


@pytest.mark.parametrize('word', ['install', 'develop'])
def test_colcon_has_the_names_that_ros2_run_and_launch_files_use(word):
    names = set(commands_of(arguments_of_setup(word)))
    assert names == {
        'pneunet', 'estimator', 'tracker', 'fusion', 'virtual_arm', 'gripper',
        'virtual_gripper', 'pneunet_stack',
    }  # fmt: skip


def test_the_long_description_leads_nowhere_that_it_does_not_know(setup_arguments):
    text = setup_arguments['long_description']
    assert 'pneunet' in text and '```' in text
    assert re.findall(r'\]\((?!https?:)', text) == []
    assert '<img' not in text


def test_what_is_installed_beside_the_code_is_small(setup_arguments):
    files = [file for _, files in setup_arguments['data_files'] for file in files]
    assert sum((CHECKOUT / file).stat().st_size for file in files) < LARGEST


def test_the_citation_has_the_version_and_the_paper(manifest):
    text = (CHECKOUT / 'CITATION.cff').read_text(encoding='utf-8')
    assert f'version: {manifest.findtext("version")}\n' in text
    assert '10.1016/j.eml.2016.02.007' in text


def test_commands_exist(setup_arguments):
    for command, target in commands_of(setup_arguments).items():
        module, function = target.split(':')
        file = CHECKOUT / Path(*module.split('.')).with_suffix('.py')
        names = {
            node.name
            for node in ast.parse(file.read_text(encoding='utf-8')).body
            if isinstance(node, ast.FunctionDef)
        }
        assert function in names, f'{command}: no such function'


def test_all_shipped_files_are_installed(setup_arguments):
    installed = {file for _, files in setup_arguments['data_files'] for file in files}
    for folder in SHIPPED:
        for file in (CHECKOUT / folder).rglob('*'):
            if file.is_file() and '__pycache__' not in file.parts:
                assert file.relative_to(CHECKOUT).as_posix() in installed
    for target, files in setup_arguments['data_files']:
        assert target.startswith('share/')
        for file in files:
            if not file.startswith(('resource/', 'package.xml')):
                assert Path(target) == Path('share/pneunet_ros', file).parent


def test_shipped_files_are_found_in_a_checkout():
    assert share_path('config') == CHECKOUT / 'config'
    assert share_path('package.xml').is_file()


def test_shipped_files_are_found_where_pip_puts_them(tmp_path, monkeypatch):
    config = tmp_path / 'share/pneunet_ros/config'
    config.mkdir(parents=True)
    module = tmp_path / 'lib/python3.12/site-packages/pneunet_ros/core/share.py'
    monkeypatch.setattr(share, '__file__', str(module))
    assert share_path('config') == config


def test_shipped_files_are_found_below_the_prefix_of_python(tmp_path, monkeypatch):
    config = tmp_path / 'share/pneunet_ros/config'
    config.mkdir(parents=True)
    monkeypatch.setattr(share, '__file__', '/nowhere/pneunet_ros/core/share.py')
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    assert share_path('config') == config


def test_shipped_files_are_found_where_colcon_puts_them(tmp_path, monkeypatch):
    config = tmp_path / 'share/pneunet_ros/config'
    config.mkdir(parents=True)
    monkeypatch.setattr(share, '__file__', '/nowhere/pneunet_ros/core/share.py')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/elsewhere{os.pathsep}{tmp_path}')
    assert share_path('config') == config


def test_a_missing_file_is_named_with_where_it_was_looked_for(monkeypatch):
    monkeypatch.setenv('AMENT_PREFIX_PATH', '/elsewhere')
    with refused(PneunetError, 'not_found'):
        share_path('config/nothing.yaml')


def test_all_but_the_nodes_imports_without_ros_and_numba():
    missing = (*ROS, 'numba')
    modules = [
        '.'.join(file.relative_to(CHECKOUT).with_suffix('').parts).removesuffix('.__init__')
        for file in sorted(PACKAGE.rglob('*.py'))
        if 'nodes' not in file.parts and file.name != '__main__.py'
    ]
    script = (
        'import importlib, sys\n'
        f'sys.modules.update(dict.fromkeys({missing!r}))\n'
        f'for module in {modules!r}:\n'
        '    importlib.import_module(module)\n'
    )
    subprocess.run([sys.executable, '-c', script], check=True, cwd=CHECKOUT)


@pytest.mark.parametrize('module', ['estimator.__main__', 'tracker.__main__', 'stack'])
def test_a_node_without_ros_says_so_in_one_sentence(module):
    script = (
        "import sys; sys.modules['rclpy'] = None; "
        f'from pneunet_ros.nodes.{module} import main; sys.exit(main())'
    )
    command = [sys.executable, '-c', script]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.count('\n') == 1
    assert "pip install '.[ros]' in a clone" in done.stderr


def installed_command(python, *arguments, environment, cwd):
    """Run an installed thing from a folder that is no checkout; what it says on stdout."""
    done = subprocess.run(
        [python, *arguments], env=environment, cwd=cwd, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, f'{arguments}: {done.stdout}{done.stderr}'
    return done.stdout


@pytest.mark.slow
def test_pip_install_gives_commands_and_files(tmp_path, foreign_environment):
    """`pip install .` without ROS, from a copy that is gone afterwards; libraries are borrowed."""
    source = tmp_path / 'source'
    shutil.copytree(CHECKOUT, source, ignore=NOT_SOURCE)
    place = tmp_path / 'place'
    venv.create(place, with_pip=True)
    python = place / 'bin/python'
    (site,) = place.glob('lib/python3*/site-packages')
    libraries = Path(importlib.import_module('numpy').__file__).parent.parent
    (site / 'borrowed.pth').write_text(f'{libraries}\n')
    # That of a new environment is too old to make a wheel by itself (before 70.1): borrow ours.
    for old in site.glob('setuptools*'):
        shutil.rmtree(old)
    run = {'environment': foreign_environment, 'cwd': tmp_path}
    pip = ['-m', 'pip', 'install', '--quiet', '--no-deps', '--no-build-isolation']
    installed_command(python, *pip, source, **run)
    shutil.rmtree(source)

    where = 'from pneunet_ros.core.share import share_path as at; print(at("config"), at("bags"))'
    found = installed_command(python, '-c', where, **run).split()
    assert found == [str(place / 'share/pneunet_ros' / top) for top in ('config', 'bags')]
    assert 'demo' in installed_command(place / 'bin/pneunet', '--help', **run)
    assert (place / 'bin/pneunet-estimator').is_file()
    assert (place / 'bin/pneunet-tracker').is_file()


def test_the_demo_imports_no_more_than_its_small_environment_has(tmp_path):
    text = (CHECKOUT / 'setup.py').read_text()
    listed = text.partition('READINGS = [')[2].partition(']')[0]
    assert 'opencv' not in listed
    assert '[*READINGS, ' in text
    program = (
        'import sys\n'
        'from pneunet_ros.cli.main import main\n'
        f"assert main(['demo', '--output', {str(tmp_path / 'demo')!r}]) == 0\n"
        "print(*{name.partition('.')[0] for name in sys.modules})\n"
    )
    found = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True, cwd=CHECKOUT
    )
    assert not {'cv2', 'jinja2', 'sklearn', 'mujoco'} & set(found.stdout.split())
