"""pneunet_ros: where a pneu-net arm is, from pressure and end force, by a calibrated rod model.

>>> from pneunet_ros import load_model, solve, solve_tip

The public API is what `__init__.pyi` lists; each name is imported when it is first used (PEP 562).
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
import re
from typing import Any

_LISTED = Path(__file__).with_suffix('.pyi').read_text(encoding='utf-8')
_MODULES = {name: module for module, name in re.findall(r'from (\S+) import (\w+) as', _LISTED)}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    """Import a name of the public API, or look up the version."""
    if name == '__version__':
        version = globals()[name] = _version()
        return version
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value


def _version() -> str:
    """Return the version from the shipped manifest, its only source."""
    from pneunet_ros.core.share import share_path

    manifest = share_path('package.xml').read_text(encoding='utf-8')
    return manifest.partition('<version>')[2].partition('</version>')[0]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
