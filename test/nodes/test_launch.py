"""Launch files without `launch`, which no package index has: what they declare, by stand-ins.

What is not seen here: whether `ros2 launch` starts them. docs/launch.md says so.
"""

from __future__ import annotations

import re
import runpy
import sys
from types import ModuleType

from pneunet_ros.core.errors import PneunetError, RequestError
from pneunet_ros.core.share import share_path
import pytest
from support.setup_arguments import arguments_of_setup, commands_of

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.estimator.configuration import PARAMETERS as ESTIMATOR  # noqa: E402
from pneunet_ros.nodes.fusion.configuration import PARAMETERS as FUSION  # noqa: E402
from pneunet_ros.nodes.gripper.configuration import PARAMETERS as GRIPPER  # noqa: E402
from pneunet_ros.nodes.tracker.configuration import PARAMETERS as TRACKER  # noqa: E402
from pneunet_ros.nodes.virtual_arm.configuration import PARAMETERS as ARM  # noqa: E402
from pneunet_ros.nodes.virtual_gripper.configuration import PARAMETERS as VIRTUAL_GRIPPER  # noqa: E402
from support.refusals import refused  # noqa: E402

TABLES = {
    'estimator': ESTIMATOR,
    'tracker': TRACKER,
    'fusion': FUSION,
    'virtual_arm': ARM,
    'gripper': GRIPPER,
    'virtual_gripper': VIRTUAL_GRIPPER,
}
SHARED = 'pneunet_ros.nodes.launch_description'  # what the files have in common
PARAMS = str(share_path('config/estimator.yaml'))
GRIPPER_PARAMS = str(share_path('config/gripper.yaml'))
LAB_ARM = str(share_path('config/lab_arm.yaml'))
LAB_CAMERA = str(share_path('config/lab_camera.yaml'))
OF_ROS = {'use_sim_time'}  # a parameter of every node
EVERYWHERE = {'namespace', 'params_file', 'model_file', 'use_sim_time', 'log_level'}
FILES = {
    'estimate': (EVERYWHERE, ['estimator']),
    'track': (EVERYWHERE | {'camera_file'}, ['tracker']),
    'gripper': (EVERYWHERE | {'virtual', 'object_width'}, ['virtual_gripper', 'gripper']),
    'demo': (
        EVERYWHERE | {'camera_file', 'effects', 'fusion', 'rviz', 'scenario_file', 'swing_period'},
        ['virtual_arm', 'estimator', 'tracker', 'fusion', 'rviz2'],
    ),
}


class Recorded:
    """Any action or substitution: what it was made of."""

    def __init__(self, *values, **named):
        self.values, self.named = values, named

    def perform(self, context):
        """Give what stands for it: of an argument what `context` says."""
        if kind(self) != 'LaunchConfiguration':
            return '/'.join(map(str, self.values[0]))
        context['used'].add(self.values[0])
        return context[self.values[0]]

    @property
    def node_package(self):
        """The package of a node, as launch_ros gives it."""
        return self.named.get('package')

    @property
    def node_executable(self):
        """The executable of a node, as launch_ros gives it."""
        return self.named.get('executable')


# As documented for Jazzy: which module has which names, and what they take.
NAMES = {
    'launch': {'LaunchDescription': set()},
    'launch.actions': {
        'DeclareLaunchArgument': {'default_value', 'description'},
        'OpaqueFunction': {'function'},
    },
    'launch.substitutions': {'LaunchConfiguration': set(), 'PathJoinSubstitution': set()},
    'launch_ros': {},
    'launch_ros.actions': {
        'Node': {'package', 'executable', 'namespace', 'parameters', 'arguments', 'output'}
    },
    'launch_ros.parameter_descriptions': {'ParameterValue': {'value_type'}},
    'launch_ros.substitutions': {'FindPackageShare': set()},
}


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Let all executables be installed, in the folder that it gives."""
    executables = [('pneunet_ros', name) for name in TABLES] + [('rviz2', 'rviz2')]
    for package, name in executables:
        path = tmp_path / 'lib' / package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    monkeypatch.setattr('ament_index_python.packages.get_package_prefix', lambda name: tmp_path)
    return tmp_path / 'lib'


@pytest.fixture
def described(monkeypatch, installed):
    """Give a function that runs a launch file on stand-ins and returns what it describes."""
    for module, names in NAMES.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)
    sys.modules.pop(SHARED, None)

    def run(name, **given):
        content = runpy.run_path(str(share_path(f'launch/{name}.launch.py')))
        (actions,) = content['generate_launch_description']().values
        context = {'used': set()}
        for action in found(actions, 'DeclareLaunchArgument'):
            context[action.values[0]] = action.named['default_value']
        (later,) = found(actions, 'OpaqueFunction')
        nodes = later.named['function'](context | given)
        assert context['used'] == set(context) - {'used'}
        return [*actions, *nodes]

    yield run
    sys.modules.pop(SHARED, None)  # the others have no stand-ins


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


@pytest.mark.parametrize(
    'said, wanted', [('True', True), ('ON', True), ('0', False), ('No', False)]
)
def test_true_and_false_are_read_as_people_write_them(described, said, wanted):
    nodes = list(found(described('demo', fusion=said, rviz=said, use_sim_time=said), 'Node'))
    assert ('fusion' in [node.named['executable'] for node in nodes]) is wanted
    assert ('rviz2' in [node.named['executable'] for node in nodes]) is wanted
    of_package = [node for node in nodes if node.named['package'] == 'pneunet_ros']
    for node in of_package:
        assert node.named['parameters'][0]['use_sim_time'].values == (wanted,)


def test_what_is_neither_true_nor_false_is_refused(described):
    with refused(RequestError, 'not_a_flag'):
        described('demo', rviz='perhaps')


@pytest.mark.parametrize(
    ('argument', 'value'),
    [
        ('params_file', 'missing.yaml'),
        ('model_file', 'missing.yaml'),
        ('camera_file', PARAMS),
        ('namespace', 'left+right'),
        ('log_level', 'loud'),
        ('use_sim_time', 'perhaps'),
        ('swing_period', 'abc'),
        ('swing_period', '-1.0'),
        ('effects', 'hysteresis.widht=3'),
    ],
)
def test_what_a_node_would_refuse_starts_nothing(described, argument, value):
    for name in (name for name in FILES if argument in FILES[name][0]):
        with pytest.raises(PneunetError, match=rf'{argument}|{value}'):
            described(name, **{argument: value})


def test_parameters_of_a_file_that_a_node_would_refuse_start_nothing(described, tmp_path):
    path = tmp_path / 'own.yaml'
    path.write_text('/**/estimator:\n  ros__parameters: {wrench_sign: 3}\n')
    with refused(RequestError, 'unknown_kind'):
        described('estimate', params_file=str(path))
    path.write_text('/**/estimator:\n  ros__parameters: {wrench_sign: -1, watch_targets: no}\n')
    assert described('estimate', params_file=str(path))


@pytest.mark.parametrize('missing', ['rviz2/rviz2', 'pneunet_ros/tracker'])
def test_an_executable_that_is_not_installed_starts_nothing(described, installed, missing):
    (installed / missing).unlink()
    with refused(RequestError, 'not_installed'):
        described('demo', rviz='true')


@pytest.mark.parametrize(
    ('name', 'namespace', 'key', 'starts'),
    [
        ('estimate', '/pneunet', 'estimator', False),
        ('estimate', '/', 'estimator', True),
        ('estimate', 'left', '/left/estimator', True),
        ('estimate', '/pneunet', '/left/estimator', False),
        ('track', '/pneunet', '/**/estimator', False),
        ('demo', '/pneunet', '/**/tracker', True),
    ],
)
def test_a_file_of_parameters_names_a_node_that_is_started(
    described, tmp_path, name, namespace, key, starts
):
    """Otherwise ROS 2 ignores it without a word."""
    path = tmp_path / 'own.yaml'
    path.write_text(f'{key}:\n  ros__parameters: {{frame_id: base}}\n')
    given = {'namespace': namespace, 'params_file': str(path)}
    if name == 'demo':
        given |= {'fusion': 'true', 'swing_period': '8.0'}
    if starts:
        assert list(found(described(name, **given), 'Node'))
        return
    with refused(RequestError, 'unknown_node'):
        described(name, **given)


@pytest.mark.parametrize('name', FILES)
def test_every_node_exists_and_has_the_parameters_it_is_given(described, name):
    params = GRIPPER_PARAMS if name == 'gripper' else PARAMS
    said = {
        'rviz': 'true',
        'fusion': 'true',
        'virtual': 'true',
        'object_width': '0.03',
        'use_sim_time': 'true',
        'params_file': params,
        'namespace': '/left',
        'log_level': 'debug',
    }
    said |= {'model_file': LAB_ARM, 'camera_file': LAB_CAMERA, 'swing_period': '1.0'}
    said |= {'effects': 'hysteresis.width=3000.0'}
    said |= {'scenario_file': str(share_path('scenarios/lab_arm.yaml'))}
    given = {argument: said[argument] for argument in FILES[name][0]}
    nodes = list(found(described(name, **given), 'Node'))
    assert [node.named['executable'] for node in nodes] == FILES[name][1]
    commands = commands_of(arguments_of_setup('install'))
    passed = set()
    for node in nodes:
        executable, package = node.named['executable'], node.named['package']
        if package != 'pneunet_ros':
            assert (package, executable) == ('rviz2', 'rviz2')
            continue
        assert commands[executable] == f'pneunet_ros.nodes.{executable}.__main__:main'
        assert node.named['namespace'] == '/left'
        file, parameters = node.named['parameters']  # those of the file first: others go before
        assert file == params
        defaults = {field.name: field.default for field in TABLES[executable].fields}
        assert set(parameters) - OF_ROS <= set(defaults)
        for parameter, value in parameters.items():
            # A text such as 1.0 would be read as a number if its type were not said.
            of_type = bool if parameter in OF_ROS else type(defaults[parameter])
            assert value.named == {'value_type': of_type}
        passed |= set(parameters)
        assert node.named['arguments'] == ['--ros-args', '--log-level', 'debug']
    others = {'namespace', 'params_file', 'log_level', 'rviz', 'fusion', 'virtual'}
    assert passed >= FILES[name][0] - others


@pytest.mark.parametrize('name', FILES)
def test_what_is_not_given_does_not_hide_what_a_file_says(described, name):
    for node in found(described(name), 'Node'):
        (parameters,) = node.named['parameters']
        empty = {'effects', 'use_sim_time'}
        empty |= {'model_file', 'camera_file'} if name != 'demo' else set()
        assert not empty & set(parameters)


def test_defaults_of_the_demo_do_not_hide_what_a_file_says(described, tmp_path):
    path, own = tmp_path / 'own.yaml', str(share_path('config/paper_arm.yaml'))
    path.write_text(
        f'/**:\n  ros__parameters: {{model_file: {own}, use_sim_time: true}}\n'
        '/**/virtual_arm:\n  ros__parameters: {swing_period: 0.0, camera: targets}\n'
    )
    given = {'params_file': str(path), 'use_sim_time': 'false'}
    for node in found(described('demo', **given), 'Node'):
        _, parameters = node.named['parameters']
        assert not {'model_file', 'swing_period', 'camera'} & set(parameters)
        assert parameters['use_sim_time'].values == (False,)
    nodes = found(described('demo', **given, model_file=LAB_ARM, swing_period='2.0'), 'Node')
    virtual_arm, *others = (node.named['parameters'][1] for node in nodes)
    assert virtual_arm['swing_period'].values == (2.0,)
    assert [one['model_file'].values for one in others] == [(LAB_ARM,)] * 3


def test_a_relative_namespace_is_checked_as_an_absolute_one(described, tmp_path):
    assert list(found(described('gripper', virtual='true', namespace='hand'), 'Node'))
    path = tmp_path / 'own.yaml'
    path.write_text('/**/gripper:\n  ros__parameters: {model_file: /nowhere.yaml}\n')
    for namespace in ('hand', '/hand'):
        with pytest.raises(PneunetError, match='nowhere'):
            described('gripper', namespace=namespace, params_file=str(path))


@pytest.mark.parametrize('name', FILES)
def test_every_stand_in_takes_what_it_is_given(described, name):
    for names in NAMES.values():
        for item, allowed in names.items():
            for made in found(described(name), item):
                assert set(made.named) <= allowed


@pytest.mark.parametrize('name', FILES)
def test_arguments_are_empty_that_a_file_may_give(described, name):
    for argument in found(described(name), 'DeclareLaunchArgument'):
        expected = {'namespace': '/pneunet', 'log_level': 'info'}
        expected |= {'rviz': 'false', 'virtual': 'false', 'fusion': 'true'}
        assert argument.named['default_value'] == expected.get(argument.values[0], '')


@pytest.mark.parametrize('name', FILES)
def test_a_launch_file_is_short_and_documented(name, checkout):
    text = share_path(f'launch/{name}.launch.py').read_text()
    assert len(text.splitlines()) <= 80
    manual = (checkout / 'docs/launch.md').read_text()
    assert f'ros2 launch pneunet_ros {name}.launch.py' in manual
    for argument in FILES[name][0]:
        assert re.search(rf'^\| `{argument}` \|', manual, re.MULTILINE)


def test_there_are_no_others():
    files = {path.name for path in share_path('launch').glob('*.launch.py')}
    assert files == {f'{name}.launch.py' for name in FILES}
