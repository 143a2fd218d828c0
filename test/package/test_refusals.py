"""Every refusal carries a reason: the key by which programs and tests know it."""

from __future__ import annotations

import ast
from pathlib import Path

import pneunet_ros
import pytest

PACKAGE = Path(pneunet_ros.__file__).parent
ERRORS = {'RequestError', 'ModelError', 'CameraError', 'MessageError', 'RecordingError'}
ROOMS = sorted(path.parent.name for path in PACKAGE.glob('*/__init__.py'))


@pytest.mark.parametrize('room', ROOMS)
def test_what_is_refused_has_a_reason(room):
    bare = [
        f'{path.relative_to(PACKAGE)}:{node.lineno}'
        for path in sorted((PACKAGE / room).rglob('*.py'))
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
        if isinstance(node, ast.Raise) and is_bare(node.exc)
    ]
    assert not bare


def is_bare(error: ast.expr | None) -> bool:
    """Whether an error of the package is made from a sentence, and has no reason."""
    if not isinstance(error, ast.Call) or not error.args:
        return False
    name = ast.unparse(error.func).rpartition('.')[2]
    made = isinstance(error.args[0], ast.JoinedStr | ast.Constant | ast.BinOp)
    return name in ERRORS and made and 'reason' not in {one.arg for one in error.keywords}
