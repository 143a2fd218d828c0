"""The pages of the nodes as tables and lists, to hold them against the code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
import re

ROOT = Path(__file__).resolve().parents[2]
REASON = re.compile(r'[a-z]+(_[a-z]+)*')


def page(node: str) -> str:
    """Return the page of a node."""
    return (ROOT / f'docs/{node}.md').read_text(encoding='utf-8')


def table(text: str, first_column: str) -> list[list[str]]:
    """Return the cells of all tables whose first column is called so, without the backticks."""
    rows: list[list[str]] = []
    inside = False
    for line in text.splitlines():
        if not line.startswith('|'):
            inside = False
            continue
        cells = [cell.strip().strip('`') for cell in line.strip('|').split('|')]
        if inside:
            rows.append(cells)
        elif cells[0] == first_column:
            inside = True
    return [cells for cells in rows if not set(cells[0]) <= set('-')]


def of_the_estimator(node: str) -> set[str]:
    """Return the names for which a page sends its readers to that of the estimator."""
    lists = re.findall(r'^As for the \[estimator\]\([^)]*\): ([^.]*)\.$', page(node), re.MULTILINE)
    return set(re.findall(r'`([^`]+)`', ' '.join(lists)))


def rows(node: str, first_column: str) -> list[list[str]]:
    """Return the rows of a page's tables, and those that it leaves to the estimator's page."""
    shared = of_the_estimator(node)
    left = [row for row in table(page('estimator'), first_column) if row[0] in shared]
    return [*table(page(node), first_column), *left]


def topics(node: str) -> dict[str, list[str]]:
    """Return type, direction and quality of service of every topic in a page."""
    return {name: rest for name, *rest in rows(node, 'topic')}


def values(node: str) -> list[str]:
    """Return the keys of the diagnostics in a page, and those left to the estimator's."""
    shared = of_the_estimator(node)
    return [*_values(node), *(name for name in _values('estimator') if name in shared)]


def _values(node: str) -> list[str]:
    (paragraph,) = re.findall(r'^Values: (.*?)\n\n', page(node), re.MULTILINE | re.DOTALL)
    without_remarks = re.sub(r'\([^)]*\)', '', paragraph)
    return re.findall(r'`([^`]+)`', without_remarks)


def reasons_in(module: str) -> set[str]:
    """Return the reasons of refusals that stand in a module of the package, by its syntax."""
    tree = ast.parse((ROOT / 'pneunet_ros' / f'{module}.py').read_text(encoding='utf-8'))
    return {text for place in _places(tree) for text in _words(place)}


def _places(tree: ast.AST) -> Iterator[ast.expr]:
    """Yield the expressions that give a reason; errors and notes do not refuse a reading."""
    others = {
        id(item)
        for node in ast.walk(tree)
        if isinstance(node, ast.Raise)
        or (isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'Note')
        for item in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in others:
            continue
        if isinstance(node, ast.keyword) and node.arg == 'reason':
            yield node.value
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in ('refuse', 'drop') and len(node.args) > 1:
                yield node.args[1]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            if node.func.attr == 'count_unused':
                yield node.args[0]
        elif isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
            yield node.value.elts[0]
        elif isinstance(node, ast.Assign):
            yield from _assigned(node)


def _assigned(node: ast.Assign) -> Iterator[ast.expr]:
    """Yield what an assignment gives to names called `reason`."""
    for target in node.targets:
        if isinstance(target, ast.Name) and target.id == 'reason':
            yield node.value
        if not isinstance(target, ast.Tuple) or not isinstance(node.value, ast.Tuple):
            continue
        for name, value in zip(target.elts, node.value.elts, strict=True):
            if isinstance(name, ast.Name) and name.id == 'reason':
                yield value


def _words(place: ast.expr) -> Iterator[str]:
    if isinstance(place, ast.IfExp):
        yield from _words(place.body)
        yield from _words(place.orelse)
    if isinstance(place, ast.Constant) and REASON.fullmatch(str(place.value)):
        yield place.value


def same_as_running(peer_node: object, node: str, left_out: set[str]) -> None:
    """Assert that a running node has the topics and services of its page, and no others.

    left_out: topics of the page that it was not asked for.
    """
    namespace = peer_node.get_namespace()
    found: dict[str, str] = {}
    for direction, ask in (
        ('in', peer_node.get_subscriber_names_and_types_by_node),
        ('out', peer_node.get_publisher_names_and_types_by_node),
    ):
        for name, (kind,) in ask(node, namespace):
            if name not in ('/rosout', '/parameter_events', '/clock'):
                found[name] = f'{direction} {kind}'
    written = {
        name if name.startswith('/') else f'{namespace}/{name}': (
            f'{direction.split(",")[0]} {kind.replace("/", "/msg/")}'
        )
        for name, (kind, direction, _) in topics(node).items()
        if name not in left_out
    }
    assert found == written
    services = peer_node.get_service_names_and_types_by_node(node, namespace)
    ours = {name for name, (kind,) in services if kind == 'std_srvs/srv/Trigger'}
    assert ours == {name.replace('~', f'{namespace}/{node}') for name, _ in rows(node, 'service')}
