"""Launch files without `launch`, which no package index has: what they declare, by stand-ins.

What is not seen here: whether `ros2 launch` starts them. docs/launch.md says so.
"""

from __future__ import annotations

import re
import runpy
import sys
from types import ModuleType

from pneunet_ros.core.share import share_path
import pytest
from support.setup_arguments import arguments_of_setup, commands_of

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.estimator.configuration import PARAMETERS as ESTIMATOR  # noqa: E402
from pneunet_ros.nodes.tracker.configuration import PARAMETERS as TRACKER  # noqa: E402
from pneunet_ros.nodes.virtual_arm.configuration import PARAMETERS as ARM  # noqa: E402

TABLES = {'estimator': ESTIMATOR, 'tracker': TRACKER, 'virtual_arm': ARM}
OF_ROS = {'use_sim_time'}  # a parameter of every node
EVERYWHERE = {'namespace', 'model_file', 'use_sim_time', 'log_level'}
FILES = {
    'estimate': (EVERYWHERE, ['estimator']),
    'track': (EVERYWHERE | {'camera_file'}, ['tracker']),
    'demo': (
        EVERYWHERE | {'camera_file', 'effects', 'rviz'},
        ['virtual_arm', 'estimator', 'tracker', 'rviz2'],
    ),
}


class Recorded:
    """Any action or substitution: what it was made of."""

    def __init__(self, *values, **named):
        self.values, self.named = values, named


# As documented for Jazzy: which module has which names, and what they take.
NAMES = {
    'launch': {'LaunchDescription': set()},
    'launch.actions': {'DeclareLaunchArgument': {'default_value', 'description'}},
    'launch.conditions': {'IfCondition': set()},
    'launch.substitutions': {'LaunchConfiguration': set(), 'PathJoinSubstitution': set()},
    'launch_ros': {},
    'launch_ros.actions': {
        'Node': {
            *('package', 'executable', 'namespace', 'parameters', 'arguments', 'output'),
            'condition',
        }
    },
    'launch_ros.parameter_descriptions': {'ParameterValue': {'value_type'}},
    'launch_ros.substitutions': {'FindPackageShare': set()},
}


@pytest.fixture
def described(monkeypatch):
    """Give a function that runs a launch file on stand-ins and returns what it describes."""
    for module, names in NAMES.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)

    def run(name):
        content = runpy.run_path(str(share_path(f'launch/{name}.launch.py')))
        (actions,) = content['generate_launch_description']().values
        return actions

    return run


def kind(item):
    return type(item).__name__


def found(value, name):
    """Yield all items of this name in a tree of actions, lists and dictionaries."""
    if kind(value) == name:
        yield value
    parts = ()
    if isinstance(value, Recorded):
        parts = (*value.values, *value.named.values())
    elif isinstance(value, (list, tuple)):
        parts = value
    elif isinstance(value, dict):
        parts = value.values()
    for part in parts:
        yield from found(part, name)


@pytest.mark.parametrize('name', FILES)
def test_all_arguments_are_declared_with_a_meaning_and_used(described, name):
    actions = described(name)
    declared = {
        action.values[0]: action.named for action in found(actions, 'DeclareLaunchArgument')
    }
    assert set(declared) == FILES[name][0]
    assert all(named['description'] for named in declared.values())
    used = {item.values[0] for item in found(actions, 'LaunchConfiguration')}
    assert used == set(declared)


@pytest.mark.parametrize('name', FILES)
def test_every_node_exists_and_has_the_parameters_it_is_given(described, name):
    nodes = list(found(described(name), 'Node'))
    assert [node.named['executable'] for node in nodes] == FILES[name][1]
    commands = commands_of(arguments_of_setup('install'))
    for node in nodes:
        executable, package = node.named['executable'], node.named['package']
        assert set(node.named) <= NAMES['launch_ros.actions']['Node']
        if package != 'pneunet_ros':
            assert (package, executable) == ('rviz2', 'rviz2')
            assert kind(node.named['condition']) == 'IfCondition'
            continue
        assert commands[executable] == f'pneunet_ros.nodes.{executable}.__main__:main'
        (given,) = node.named['parameters']
        defaults = {field.name: field.default for field in TABLES[executable].fields}
        assert set(given) - OF_ROS <= set(defaults)
        assert given['use_sim_time'].named == {'value_type': bool}
        for parameter in set(given) - OF_ROS:
            value = given[parameter]
            # An empty text would be read as nothing if its type were not said.
            of_type = value.named['value_type'] if isinstance(value, Recorded) else type(value)
            assert of_type is type(defaults[parameter])
        assert node.named['arguments'][:2] == ['--ros-args', '--log-level']


@pytest.mark.parametrize('name', FILES)
def test_every_stand_in_takes_what_it_is_given(described, name):
    for names in NAMES.values():
        for item, allowed in names.items():
            for made in found(described(name), item):
                assert set(made.named) <= allowed


@pytest.mark.parametrize('name', FILES)
def test_defaults_are_those_of_the_nodes_or_shipped_files(described, name):
    for argument in found(described(name), 'DeclareLaunchArgument'):
        default = argument.named['default_value']
        if isinstance(default, str):
            expected = {'namespace': '/pneunet', 'log_level': 'info'}
            expected |= dict.fromkeys(('use_sim_time', 'rviz'), 'false')
            assert default == expected.get(argument.values[0], '')
        else:
            ((share, *path),) = default.values
            assert share.values == ('pneunet_ros',)
            assert share_path('/'.join(path)).is_file()


@pytest.mark.parametrize('name', FILES)
def test_a_launch_file_is_short_and_documented(name, checkout):
    text = share_path(f'launch/{name}.launch.py').read_text()
    assert len(text.splitlines()) <= 60
    manual = (checkout / 'docs/launch.md').read_text()
    assert f'ros2 launch pneunet_ros {name}.launch.py' in manual
    for argument in FILES[name][0]:
        assert re.search(rf'^\| `{argument}` \|', manual, re.MULTILINE)


def test_there_are_no_others():
    files = {path.name for path in share_path('launch').glob('*.launch.py')}
    assert files == {f'{name}.launch.py' for name in FILES}
