"""Every refusal and note carries a reason; all reasons are listed, and one cause has one word."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
import runpy

import pneunet_ros

PACKAGE = Path(pneunet_ros.__file__).parent
REASONS = runpy.run_path(str(Path(__file__).resolve().parents[2] / 'docs/reasons.py'))['REASONS']
ERRORS = {'RequestError', 'ModelError', 'CameraError', 'MessageError', 'RecordingError'}
BY_PLACE = {
    'drop',
    'print_error',
    'refuse',
    'report_error',
}  # functions that take a reason by place


@cache
def trees() -> dict[str, ast.Module]:
    """Return what every file of the package holds."""
    return {
        str(path.relative_to(PACKAGE)): ast.parse(path.read_text(encoding='utf-8'))
        for path in sorted(PACKAGE.rglob('*.py'))
    }


def calls(tree: ast.Module) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def texts(node: ast.AST) -> set[str]:
    constants = (part for part in ast.walk(node) if isinstance(part, ast.Constant))
    return {part.value for part in constants if isinstance(part.value, str)}


def is_bare(call: ast.Call) -> bool:
    """Whether an error of the package is made from a sentence, and has no reason."""
    if not call.args or ast.unparse(call.func).rpartition('.')[2] not in ERRORS:
        return False
    made = isinstance(call.args[0], ast.JoinedStr | ast.Constant | ast.BinOp)
    return made and 'reason' not in {item.arg for item in call.keywords}


def reasons_of(call: ast.Call) -> set[str]:
    """Return the reasons that are written where an error, a note or a refusal is made."""
    found = set[str]().union(
        *(texts(item.value) for item in call.keywords if item.arg == 'reason')
    )
    if isinstance(call.func, ast.Name) and call.func.id in BY_PLACE:
        words = {item.value for item in call.args if isinstance(item, ast.Constant)}
        found |= {word for word in words if isinstance(word, str) and word.isidentifier()}
    return found - {''}


def test_what_is_refused_has_a_reason():
    bare = [
        f'{name}:{call.lineno}'
        for name, tree in trees().items()
        for call in calls(tree)
        if is_bare(call)
    ]
    assert not bare


def test_every_reason_has_its_meaning_and_none_is_left_over():
    given = {reason for tree in trees().values() for call in calls(tree)
             for reason in reasons_of(call)}  # fmt: skip
    assert given <= set(REASONS)
    assert set(REASONS) <= set[str]().union(*map(texts, trees().values()))
    assert len(set(REASONS.values())) == len(REASONS)
