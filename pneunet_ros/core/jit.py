"""Compile the kernels where numba is at hand; they run as plain Python where it is not.

The kernels of this package are written so that both give the same numbers; `HAVE_NUMBA` tells
which it is. Contraction to fused multiply-adds is the only relaxation of IEEE arithmetic: NaN
stays NaN.
"""

from __future__ import annotations

from collections.abc import Callable
import hashlib
import importlib.util
import os
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar('Function', bound=Callable[..., Any])

HAVE_NUMBA = importlib.util.find_spec('numba') is not None and not os.environ.get(
    'PNEUNET_NO_NUMBA'
)


def fingerprint(package: Path) -> str:
    """Compute a hash of all files of a package that have to do with kernels: they import this one.

    Kernels call kernels and take constants from other files, hence one hash for them all.
    """
    whole = hashlib.sha256()
    for folder, folders, names in os.walk(package):
        folders.sort()
        for name in sorted(names):
            if name.endswith('.py'):
                content = Path(folder, name).read_bytes()
                if b'core.jit import' in content:  # as in this line: of this file, too
                    whole.update(hashlib.sha256(content).digest())
    return whole.hexdigest()


SOURCES = fingerprint(Path(__file__).parent.parent) if HAVE_NUMBA else ''


def kernel(function: Function) -> Function:
    """Compile a kernel (cached on disk), or hand it back unchanged where there is no numba.

    A cached kernel is compiled again when any of the files has changed. Numba itself looks at the
    kernel's own file alone and would go on with equations of another file as they once were.
    """
    if not HAVE_NUMBA:
        return function
    import numba

    options = {'error_model': 'numpy', 'fastmath': {'contract'}}
    compiled: Any
    try:
        compiled = numba.njit(cache=True, **options)(function)
        index = compiled._cache._cache_file
        index._source_stamp = (index._source_stamp, SOURCES)
    except (RuntimeError, AttributeError):
        # Nowhere to keep a cache, neither beside this file nor in the home folder; or a numba
        # that keeps it in another way.
        compiled = numba.njit(**options)(function)
    kernel_function: Function = compiled
    return kernel_function


def part(function: Function) -> Function:
    """Compile what only kernels call: it is kept on disk within them, not on its own.

    Numba optimizes across calls only where it compiles both sides; what it finds on disk is called
    as it is. Kernels that share such a part are as fast whichever of them was compiled first.
    """
    if not HAVE_NUMBA:
        return function
    import numba

    compiled: Function = numba.njit(error_model='numpy', fastmath={'contract'})(function)
    return compiled


def inlined(function: Function) -> Function:
    """Compile an equation that is copied into its callers, so that loops vectorize."""
    if not HAVE_NUMBA:
        return function
    import numba

    compiled: Function = numba.njit(error_model='numpy', fastmath={'contract'}, forceinline=True)(
        function
    )
    return compiled
