"""Files of parameters: which nodes they name is what ROS itself makes of their keys."""

from __future__ import annotations

from pneunet_ros.core.errors import RequestError
import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.params_file import check_names_some, missed_node, params_files  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from support.refusals import refused  # noqa: E402

ONE = 'ros__parameters: {stations: 7}'
KEYS = [
    *('estimator', '/estimator', 'tracker', 'pneunet/estimator', '/pneunet/estimator'),
    *('/*', '*', '/**', '**', '/**/estimator', '**/estimator', '/*/estimator'),
    *('/pneunet/*', '/*/*', '/pneunet/**', '/a/b/estimator'),
]
NESTED = f'pneunet:\n  estimator:\n    {ONE}\n'


def named(path, node):
    """Whether a file has parameters for a node, as the package takes it."""
    try:
        check_names_some(path, [node])
    except RequestError:
        return False
    return True


def taken(path, namespace):
    """Whether ROS gives a node `estimator` in a namespace what is in a file."""
    context = Context()
    arguments = ['--ros-args', '--params-file', str(path), '-r', f'__ns:={namespace}']
    rclpy.init(context=context, args=arguments)
    declared = {'automatically_declare_parameters_from_overrides': True}
    node = Node('estimator', context=context, enable_rosout=False, **declared)
    there = node.has_parameter('stations')
    node.destroy_node()
    rclpy.shutdown(context=context)
    return there


@pytest.mark.parametrize(
    'text',
    [
        *(f'"{key}":\n  {ONE}\n' for key in KEYS),
        NESTED,
        NESTED.replace('pneunet', '/**'),
        f'estimator:\n  {ONE}\ntracker:\n  {ONE}\n/a/b:\n  estimator:\n    {ONE}\n',
    ],
)
def test_keys_are_taken_as_ros_takes_them(tmp_path, text):
    path = tmp_path / 'own.yaml'
    path.write_text(text)
    for namespace in ('/', '/pneunet', '/a/b'):
        node = f'{namespace.rstrip("/")}/estimator'
        assert named(path, node) == taken(path, namespace), (text, node)


def test_the_refusal_says_which_keys_would_match(tmp_path):
    path = tmp_path / 'own.yaml'
    path.write_text(f'estimator:\n  {ONE}\n')
    with pytest.raises(RequestError) as refusal:
        check_names_some(path, ['/pneunet/estimator', '/pneunet/tracker'])
    assert str(refusal.value) == (
        f'params_file:={path} has no parameters for /pneunet/estimator or /pneunet/tracker: its '
        'keys are estimator. ROS 2 matches only full names: use /pneunet/estimator, '
        '/**/estimator for any namespace, or /** for all nodes'
    )


@pytest.mark.parametrize('text', ['', 'stations: 7\n', 'ros__parameters: {stations: 7}\n', '[1]'])
def test_a_file_without_a_node_is_refused(tmp_path, text):
    path = tmp_path / 'own.yaml'
    path.write_text(text)
    with refused(RequestError, 'unknown_node'):
        check_names_some(path, ['/estimator'])


def test_a_node_is_told_of_parameters_that_miss_it(tmp_path):
    """A file for other nodes misses nobody."""
    path = tmp_path / 'own.yaml'
    path.write_text(f'estimator:\n  {ONE}\n/left/tracker:\n  {ONE}\n')
    assert '/pneunet/estimator' in missed_node(path, '/pneunet/estimator')
    assert missed_node(path, '/estimator') == ''
    assert missed_node(path, '/pneunet/fusion') == ''
    assert missed_node(path, '/left/tracker') == ''
    assert '/left/tracker' in missed_node(path, '/right/tracker')
    path.write_text('a: [')
    assert missed_node(path, '/estimator') == ''


def test_all_files_on_a_command_line_are_found():
    line = [
        'estimator',
        '--ros-args',
        '--params-file',
        'a.yaml',
        '-p',
        'x:=1',
        '--params-file',
        'b',
    ]
    assert params_files(line) == ['a.yaml', 'b']
