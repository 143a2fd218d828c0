"""Nodes in a parameter file, whose keys ROS 2 matches against the full names of nodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
import re
from typing import Any

from pneunet_ros.core.errors import PneunetError, RequestError
from pneunet_ros.files.yaml_file import YamlFile

PARAMETERS = 'ros__parameters'
_FILE = YamlFile(kind='file of parameters', error=RequestError)
_NAMES_SHOWN = 12
_WILDCARDS = {'*': '/[^/]+', '**': '(?:/[^/]+)*'}


def check_names_some(path: str | Path, nodes: Sequence[str]) -> None:
    """Raise RequestError if a file has parameters for none of these nodes (full names)."""
    try:
        names = _names_in_file(path)
    except PneunetError:  # ROS reads the file as well and reports its errors
        return
    if not any(_matches(name, node) for name in names for node in nodes):
        raise RequestError(
            f'params_file:={path} {_names_none(names, nodes)}', reason='unknown_node'
        )


def parameters_of(path: str | Path, node: str) -> dict[str, Any]:
    """Return the parameters of a node (full name) in a file; later keys override earlier ones.

    RequestError if the file cannot be read.
    """
    given: dict[str, Any] = {}
    for name, parameters in _FILE.load(path, lambda content: list(_parameters(content, []))):
        if _matches(name, node) and isinstance(parameters, dict):
            given |= parameters
    return given


def own_parameters(path: str | Path, node: str) -> dict[str, Any]:
    """Return the parameters of a node (full name) under its name and its namespace in a file."""
    own = node.split('/')[-2:]
    try:
        found = _FILE.load(path, lambda content: list(_parameters(content, [])))
    except PneunetError:  # ROS has read the file and reported its errors
        return {}
    return {
        key: value
        for name, given in found
        if _matches(name, node) and name.strip('/').split('/')[-2:] == own
        for key, value in (given.items() if isinstance(given, dict) else ())
    }


def missed_node(path: str | Path, node: str) -> str:
    """Report a file that names a node (full name) only in other namespaces; '' otherwise."""
    try:
        names = _names_in_file(path)
    except PneunetError:  # ROS has read the file and reported its errors
        return ''
    base_name = node.rpartition('/')[2]
    same_base = [name for name in names if name.rpartition('/')[2] == base_name]
    if not same_base or any(_matches(name, node) for name in names):
        return ''
    return f'{path} {_names_none(same_base, [node])}'


def params_files(arguments: Sequence[str]) -> list[str]:
    """Return the parameter files on a command line."""
    return [path for option, path in pairwise(arguments) if option == '--params-file']


def _names_none(names: Sequence[str], nodes: Sequence[str]) -> str:
    more = ', ...' if len(names) > _NAMES_SHOWN else ''
    keys = (
        f'its keys are {", ".join(names[:_NAMES_SHOWN])}{more}'
        if names
        else ('it does not name a node')
    )
    first = nodes[0]
    return (
        f'has no parameters for {" or ".join(nodes)}: {keys}. ROS 2 matches only full names: use '
        f'{first}, /**/{first.rpartition("/")[2]} for any namespace, or /** for all nodes'
    )


def _names_in_file(path: str | Path) -> list[str]:
    return [name for name, _ in _FILE.load(path, lambda content: list(_parameters(content, [])))]


def _parameters(content: Any, above: list[str]) -> Iterator[tuple[str, Any]]:
    """Yield the nodes in a file, possibly in nested namespaces, with their values."""
    if not isinstance(content, dict):
        return
    if PARAMETERS in content and above:
        yield '/'.join(above), content[PARAMETERS]
    for key, below in content.items():
        if key != PARAMETERS:
            yield from _parameters(below, [*above, str(key)])


def _matches(name: str, node: str) -> bool:
    parts: Iterable[str] = name.strip('/').split('/')
    pattern = ''.join(_WILDCARDS.get(part, f'/{re.escape(part)}') for part in parts)
    return re.fullmatch(pattern, node) is not None
