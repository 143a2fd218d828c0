"""Compile the kernels where numba is at hand; they run as plain Python where it is not.

The kernels of this package are written so that both give the same numbers; `HAVE_NUMBA` tells
which it is. Contraction to fused multiply-adds is the only relaxation of IEEE arithmetic: NaN
stays NaN.
"""

from __future__ import annotations

from collections.abc import Callable
import importlib.util
import os
from typing import Any, TypeVar

Function = TypeVar('Function', bound=Callable[..., Any])

HAVE_NUMBA = importlib.util.find_spec('numba') is not None and not os.environ.get(
    'PNEUNET_NO_NUMBA'
)


def kernel(function: Function) -> Function:
    """Compile a kernel (cached on disk), or hand it back unchanged where there is no numba."""
    if not HAVE_NUMBA:
        return function
    import numba

    options = {'error_model': 'numpy', 'fastmath': {'contract'}}
    compiled: Function
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except (
        RuntimeError
    ):  # nowhere to keep a cache: neither beside this file nor in the home folder
        compiled = numba.njit(**options)(function)
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
