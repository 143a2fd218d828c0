"""The sentences of a room as people see them, read from its code: refusals, notes and errors."""

from __future__ import annotations

import ast
from pathlib import Path

import pneunet_ros

PACKAGE = Path(pneunet_ros.__file__).parent
TESTS = Path(__file__).resolve().parents[1]
SAID_BY = {
    'CameraError', 'MessageError', 'ModelError', 'Note', 'RecordingError', 'Refusal',
    'RequestError', 'drop',
}  # fmt: skip
ROOMS = tuple(sorted(item.name for item in PACKAGE.iterdir() if (item / '__init__.py').exists()))


def table_file(room: str) -> Path:
    """Return the table of a room; MuJoCo is tested with the model."""
    return TESTS / ('model' if room == 'mujoco' else room) / f'sentences_of_{room}.txt'


def name_of(node: ast.AST) -> str:
    """Name what a sentence inserts: the value that is formatted, as the code calls it."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case ast.Call(args=[first, *_]):
            return name_of(first)
        case ast.Call(func=ast.Attribute(value=owner)):
            return name_of(owner)
        case ast.Call(func=inner) | ast.Subscript(value=inner):
            return name_of(inner)
        case ast.BinOp(left=ast.Constant(), right=inner) | ast.BinOp(left=inner):
            return name_of(inner)
        case ast.IfExp(body=ast.Constant(), orelse=inner) | ast.IfExp(body=inner):
            return name_of(inner)
        case ast.GeneratorExp(elt=inner) | ast.ListComp(elt=inner) | ast.UnaryOp(operand=inner):
            return name_of(inner)
    return '...'


def shown(node: ast.AST) -> str:
    """Return a text with names in braces for what is inserted."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return ''.join(map(shown, node.values))
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return shown(node.left) + shown(node.right)
    value = node.value if isinstance(node, ast.FormattedValue) else node
    return f'{{{name_of(value)}}}'


def sentence_of(call: ast.Call) -> tuple[str, str] | None:
    """Return reason and sentence of a call that makes a refusal or a note; None for others."""
    if ast.unparse(call.func).rpartition('.')[2] not in SAID_BY:
        return None
    given = {item.arg: item.value for item in call.keywords}
    texts = [item for item in (*call.args, given.get('sentence')) if item is not None]
    said = max(map(shown, texts), key=len, default='')
    reason = given.get('reason')
    return (shown(reason) if reason is not None else '', said) if ' ' in said else None


def table_of(room: str) -> str:
    """Return the table of a room: a line per sentence with its reason, sorted."""
    found = set[tuple[str, str]]()
    for file in sorted((PACKAGE / room).rglob('*.py')):
        tree = ast.parse(file.read_text(encoding='utf-8'))
        calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
        found |= {said for call in calls if (said := sentence_of(call)) is not None}
    return ''.join(f'{reason}: {" ".join(said.split())}\n' for reason, said in sorted(found))
