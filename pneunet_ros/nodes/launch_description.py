"""Common parts of launch files: arguments, and the nodes of this package.

Invalid parameters are rejected before the first process starts, because `launch` ends at an error
but leaves the processes running that it has started.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix, PackageNotFoundError
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.kernels.cache import use_plain_python
from pneunet_ros.nodes.params_file import check_names_some, parameters_of
from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

PACKAGE = 'pneunet_ros'
Given = Mapping[str, str]
TRUE_OR_FALSE = {
    **dict.fromkeys(('true', '1', 'yes', 'on'), True),
    **dict.fromkeys(('false', '0', 'no', 'off'), False),
}
LOG_LEVELS = ('debug', 'info', 'warn', 'error', 'fatal')


def describe_launch(
    arguments: Mapping[str, tuple[Any, str]], nodes: Callable[[Given], list[Any]]
) -> Any:
    """Return the description of a launch.

    arguments: default and meaning by name, including namespace and params_file; nodes: returns the
    nodes to start for given values. Raises RequestError, before any process is started, if a node
    cannot be started, or if params_file names none of these nodes in an absolute namespace, so
    that the file would be silently ignored.
    """

    def start(context: Any) -> list[Any]:
        given = {name: LaunchConfiguration(name).perform(context) for name in arguments}
        started = nodes(given)
        check_installed(started)
        package_nodes = [
            item for item in started if getattr(item, 'node_package', None) == PACKAGE
        ]
        # The parent of a relative namespace is known only to the including launch file.
        if package_nodes and given['params_file'] and given['namespace'].startswith('/'):
            names = [full_name(item.node_executable, given) for item in package_nodes]
            check_names_some(given['params_file'], names)
        return started

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def check_installed(started: Iterable[Any]) -> None:
    """Raise RequestError if an executable to be started is not installed."""
    for item in started:
        package = getattr(item, 'node_package', None)
        if package is None:
            continue
        executable = item.node_executable
        try:
            is_installed = Path(get_package_prefix(package), 'lib', package, executable).exists()
        except PackageNotFoundError:
            is_installed = False
        if not is_installed:
            raise RequestError(
                f'nothing was started, because {executable} of the package {package} is not '
                'installed. Install it (sudo apt install '
                f'ros-$ROS_DISTRO-{package.replace("_", "-")}), or leave it out',
                reason='not_installed',
            )


def is_true(name: str, given: Given) -> bool:
    """Return an argument that is true or false, in upper or lower case.

    Raises RequestError for any other value.
    """
    value = given[name].strip().lower()
    if value not in TRUE_OR_FALSE:
        raise RequestError(
            f'{name}:={given[name]}: must be one of {", ".join(TRUE_OR_FALSE)}',
            reason='not_a_flag',
        )
    return TRUE_OR_FALSE[value]


def number(name: str, given: Given) -> float | str:
    """Return an argument that is a number, or '' if empty; RequestError for any other value."""
    try:
        return float(given[name]) if given[name] else ''
    except ValueError as error:
        raise RequestError(
            f'{name}:={given[name]}: must be a number', reason='not_a_number'
        ) from error


def parameters_in_file(executable: str, given: Given) -> dict[str, Any]:
    """Return the parameters of a node in params_file; none without one."""
    file = given['params_file']
    return parameters_of(file, full_name(executable, given)) if file else {}


def argument(name: str, executable: str, given: Given, default: Any) -> Any:
    """Return an argument; without one, '' for a parameter in params_file, or else a default."""
    in_file = parameters_in_file(executable, given).get(name, '')
    return given.get(name, '') or (default if in_file == '' else '')


def node(executable: str, given: Given, **parameters: Any) -> Any:
    """Return a node of this package.

    given: namespace, params_file (empty: none), use_sim_time (empty: as in params_file) and
    log_level. parameters come before those of params_file; empty ones are omitted. Raises
    RequestError for values that the node would reject. Also raises it if params_file is not a
    file, because launch_ros would then start a node with other parameters than requested.
    """
    used = {name: value for name, value in parameters.items() if value != ''}
    check_names(given)
    check_parameters(executable, given, used)
    if given['use_sim_time']:
        used['use_sim_time'] = is_true('use_sim_time', given)
    typed = {name: ParameterValue(value, value_type=type(value)) for name, value in used.items()}
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=given['namespace'],
        parameters=[*([given['params_file']] if given['params_file'] else []), typed],
        arguments=['--ros-args', '--log-level', given['log_level']],
        output='screen',
    )


def check_names(given: Given) -> None:
    """Raise RequestError for an invalid namespace, log level or parameter file."""
    namespace, level, file = given['namespace'], given['log_level'], given['params_file']
    try:
        validate_namespace(namespace if namespace.startswith('/') else f'/{namespace}')
    except InvalidNamespaceException as error:
        raise RequestError(f'namespace:={namespace}: {error}', reason='wrong_name') from error
    if level.lower() not in LOG_LEVELS:
        raise RequestError(
            f'log_level:={level}: must be one of {", ".join(LOG_LEVELS)}', reason='unknown_kind'
        )
    if file and not Path(file).is_file():
        raise RequestError(
            f'params_file:={file} does not exist. Give a YAML file of parameters, such as '
            'config/estimator.yaml, or omit the argument',
            reason='not_found',
        )


def check_parameters(executable: str, given: Given, used: Mapping[str, Any]) -> None:
    """Raise PneunetError if a node of this package would reject its parameters or files."""
    use_plain_python()
    of_node = import_module(f'{PACKAGE}.nodes.{executable}.configuration')
    in_file = parameters_in_file(executable, given)
    table, configured = of_node.PARAMETERS, getattr(of_node, f'configured_{executable}')
    texts = {item.name for item in table.fields if isinstance(item.default, str)}
    known = {  # ROS reads more words as true or as a number than YAML does
        name: value
        for name, value in in_file.items()
        if name in texts or not isinstance(value, str)
    }
    configured(table.completed({**known, **used}), None)
    if hasattr(of_node, 'check_blocks'):
        of_node.check_blocks({**known, **used})


def full_name(executable: str, given: Given) -> str:
    """Return the full name of a node; a relative namespace has no parent here."""
    names = [*filter(None, given['namespace'].split('/')), executable]
    return f'/{"/".join(names)}'
