"""One cause, one word: the list of reasons, and where they are given."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pneunet_ros
from pneunet_ros.core.reasons import REASONS

PACKAGE = Path(pneunet_ros.__file__).parent
REFUSING = {'complain', 'drop', 'print_error', 'refuse'}  # functions that take a reason by place


def texts(node: ast.AST) -> set[str]:
    return {
        part.value
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    }


def trees() -> Iterator[ast.Module]:
    for file in sorted(PACKAGE.rglob('*.py')):
        if file.name != 'reasons.py':
            yield ast.parse(file.read_text(encoding='utf-8'))


def given_in(tree: ast.Module) -> set[str]:
    """Return the reasons that are written where an error, a note or a refusal is made."""
    found = set[str]()
    for call in ast.walk(tree):
        if not isinstance(call, ast.Call):
            continue
        for item in call.keywords:
            if item.arg == 'reason':
                found |= texts(item.value)
        if isinstance(call.func, ast.Name) and call.func.id in REFUSING:
            words = [item.value for item in call.args if isinstance(item, ast.Constant)]
            found |= {word for word in words if isinstance(word, str) and word.isidentifier()}
    return found


def test_every_reason_has_its_meaning_and_none_is_left_over():
    given, written = set[str](), set[str]()
    for tree in trees():
        given |= given_in(tree)
        written |= texts(tree)
    assert given - {''} <= set(REASONS)
    assert set(REASONS) <= written
    assert len(set(REASONS.values())) == len(REASONS)
