"""What launch files have in common: arguments, and the nodes of this package by what is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from pneunet_ros.core.errors import RequestError
from pneunet_ros.nodes.params_file import check_names_some

PACKAGE = 'pneunet_ros'
Given = Mapping[str, str]
TRUE_OR_FALSE = {
    **dict.fromkeys(('true', '1', 'yes', 'on'), True),
    **dict.fromkeys(('false', '0', 'no', 'off'), False),
}


def describe_launch(
    arguments: Mapping[str, tuple[Any, str]], nodes: Callable[[Given], list[Any]]
) -> Any:
    """Return the description of a launch.

    arguments: default and meaning by name, with namespace and params_file; nodes: returns what to
    start, of the values given. Raises RequestError at the start where params_file names none of
    these nodes, which would ignore it without a word, in a namespace that is absolute.
    """

    def start(context: Any) -> list[Any]:
        given = {name: LaunchConfiguration(name).perform(context) for name in arguments}
        started = nodes(given)
        own = [item for item in started if getattr(item, 'node_package', None) == PACKAGE]
        namespace = given['namespace']
        # What is above a relative one is known to whoever includes this launch alone.
        if own and given['params_file'] and namespace.startswith('/'):
            names = [f'{namespace.rstrip("/")}/{item.node_executable}' for item in own]
            check_names_some(given['params_file'], names)
        return started

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def is_true(name: str, given: Given) -> bool:
    """Return an argument that is true or false, in any case as people write it.

    Raises RequestError for any other value.
    """
    value = given[name].strip().lower()
    if value not in TRUE_OR_FALSE:
        raise RequestError(f'{name}:={given[name]}: one of {", ".join(TRUE_OR_FALSE)} is wanted')
    return TRUE_OR_FALSE[value]


def node(executable: str, given: Given, **parameters: Any) -> Any:
    """Return a node of this package.

    given: namespace, params_file (empty: none), use_sim_time and log_level. parameters go before
    those of params_file; those that are empty are not given. Raises RequestError where params_file
    is no file, without which launch_ros would start a node with other parameters than asked for.
    """
    parameters['use_sim_time'] = is_true('use_sim_time', given)
    wanted = {
        name: ParameterValue(value, value_type=type(value))
        for name, value in parameters.items()
        if value
    }
    file = [given['params_file']] if given['params_file'] else []
    if file and not Path(file[0]).is_file():
        raise RequestError(
            f'params_file:={file[0]}: there is no such file; '
            'name a YAML file of parameters, like config/estimator.yaml, or leave it out'
        )
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=given['namespace'],
        parameters=[*file, wanted],
        arguments=['--ros-args', '--log-level', given['log_level']],
        output='screen',
    )
