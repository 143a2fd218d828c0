"""What setup.py says, without running it for real."""

from __future__ import annotations

from pathlib import Path
import sys
from typing import Any

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


def arguments_of_setup(*words: str) -> dict[str, Any]:
    """Return the arguments of `setup()` for one of its commands."""
    import setuptools

    given: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(CHECKOUT)
        patch.setattr(sys, 'argv', ['setup.py', *words])
        patch.setattr(setuptools, 'setup', given.update)
        code = compile((CHECKOUT / 'setup.py').read_text(encoding='utf-8'), 'setup.py', 'exec')
        exec(code, {'__name__': '__main__'})
    return given


def commands_of(arguments: dict[str, Any]) -> dict[str, str]:
    """Return what every command calls, by its name."""
    lines = arguments['entry_points']['console_scripts']
    return dict(line.split(' = ') for line in lines)
