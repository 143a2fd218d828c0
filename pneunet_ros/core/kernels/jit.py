"""Compile the kernels if numba is installed; otherwise they run as plain Python.

Both ways give the same numbers. Contraction to fused multiply-adds, and the order of sums in
`summing` kernels, are the only relaxations of IEEE arithmetic: NaN remains NaN.

A process that must respond at once calls `use_plain_python` before it imports any kernel. Kernels
that are not cached then run as plain Python until `use_compiled` replaces them
(`core.kernels.cache` compiles them meanwhile, in a separate process).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import hashlib
import importlib.util
import operator
import os
from pathlib import Path
import sys
from typing import Any, TypeVar

Function = TypeVar('Function', bound=Callable[..., Any])

HAVE_NUMBA = importlib.util.find_spec('numba') is not None and not os.environ.get(
    'PNEUNET_NO_NUMBA'
)
# Without numba's passes for array expressions, because kernels contain none.
WITHIN = {
    'error_model': 'numpy',
    'fastmath': {'contract'},
    'no_cfunc_wrapper': True,
    'no_rewrites': True,
}
KERNEL = dict(WITHIN)
INNER = {**WITHIN, 'no_cpython_wrapper': True}
INLINED = {**INNER, 'forceinline': True}
SUMMING = {**INNER, 'fastmath': {'contract', 'reassoc'}}
# Functions called by kernels only: the plain function -> its compiled form.
INNER_KERNELS: dict[Callable[..., Any], Any] = {}


def fingerprint(package: Path) -> str:
    """Hash all files of a package that affect its kernels: those that import this module.

    One hash covers all files, because kernels call kernels and use constants of other files. Files
    without kernels import this module, but no names from it.
    """
    whole = hashlib.sha256()
    for folder, folders, names in os.walk(package):
        folders.sort()
        for name in sorted(names):
            if name.endswith('.py'):
                content = Path(folder, name).read_bytes()
                if b'core.kernels.jit import' in content:  # as in this line: of this file, too
                    whole.update(hashlib.sha256(content).digest())
    return whole.hexdigest()


@cache
def sources() -> str:
    """Return the fingerprint of this package."""
    return fingerprint(Path(__file__).parents[2])


class Waiting:
    """The kernels that run as plain Python until they are replaced by compiled ones.

    plain: the functions and the options of their compiled twins, in the order of definition.
    """

    def __init__(self) -> None:
        self.expected = False
        self.plain: list[tuple[Callable[..., Any], dict[str, Any]]] = []


WAITING = Waiting()


def use_plain_python() -> None:
    """Run kernels imported after this call as plain Python until `use_compiled`."""
    WAITING.expected = HAVE_NUMBA


def is_waiting() -> bool:
    """Whether kernels run as plain Python until they are replaced by compiled ones."""
    return WAITING.expected


def is_compiled() -> bool:
    """Whether the kernels are compiled rather than plain Python."""
    return HAVE_NUMBA and not is_waiting()


def state_of_kernels() -> str:
    """Return 'compiled', or the reason for running the kernels as plain Python."""
    if is_compiled():
        return 'compiled'
    return 'plain Python while they are compiled' if is_waiting() else 'plain Python: no numba'


def kernel(function: Function) -> Function:
    """Compile a kernel and cache it on disk; without numba, return it unchanged.

    A cached kernel is recompiled when any of the files has changed. Numba itself only checks the
    file of the kernel, and would keep using outdated equations from other files.
    """
    return compiled_or_plain(function, KERNEL)


def inner(function: Function) -> Function:
    """Compile a function that only kernels call, without the Python entry point.

    Python can call it as well; it then runs as plain Python.
    """
    return compiled_or_plain(function, INNER)


def inlined(function: Function) -> Function:
    """Compile an equation that is copied into its callers, so that loops vectorize.

    Python can call it as well; it then runs as plain Python.
    """
    return compiled_or_plain(function, INLINED)


def summing(function: Function) -> Function:
    """Compile a function for kernels that may reorder sums, so that they vectorize.

    Python can call it as well; it then runs as plain Python.
    """
    return compiled_or_plain(function, SUMMING)


def compiled_or_plain(function: Function, options: dict[str, Any]) -> Function:
    """Return a function that is compiled when called, or the plain function while waiting."""
    if not HAVE_NUMBA:
        return without_warnings(function) if options is KERNEL else function
    if WAITING.expected:
        WAITING.plain.append((function, options))
        return function
    return dispatcher(function, options)


def without_warnings(function: Function) -> Function:
    """Return a kernel that raises no floating-point warnings, like compiled ones."""
    import numpy as np

    quiet: Function = np.errstate(divide='ignore', invalid='ignore', over='ignore')(function)
    return quiet


def dispatcher(function: Function, options: dict[str, Any]) -> Function:
    """Return the numba function, which is compiled on its first call.

    An inlined equation is returned unchanged; numba compiles it with its callers.
    """
    import numba
    from numba.core import types
    from numba.core.typing.templates import infer_global

    numbers_and_arrays_first()
    compiled: Any = numba.njit(**options)(function)
    if options is not INLINED:
        keep(compiled)
    # Kernels call it by the plain function. numba's `register_jitable` would compile it again for
    # callers with other options.
    infer_global(function, types.Dispatcher(compiled))
    if options is KERNEL:
        kernel_function: Function = compiled
        return kernel_function
    INNER_KERNELS[function] = compiled
    return function


def keep(compiled: Any) -> None:
    """Cache a kernel on disk for all callers, or give each caller a copy.

    Each caller gets a copy if there is no writable folder, neither next to its file nor in the
    home folder, or if numba has no such cache.
    """
    try:
        from pneunet_ros.core.kernels.links import link

        link(compiled, sources())
    except (RuntimeError, AttributeError, ImportError):
        pass


@cache
def numbers_and_arrays_first() -> None:
    """Make numba resolve arithmetic and array access first.

    By default, numba tries them last, after strings, lists and all kinds of arrays. The result is
    the same, but this order halves the time of type inference.
    """
    from numba.core.typing import arraydecl, builtins
    from numba.core.typing.templates import infer_global

    for operation, template in (
        (operator.getitem, arraydecl.GetItemBuffer),
        (operator.setitem, arraydecl.SetItemBuffer),
        (operator.add, builtins.BinOpAdd),
        (operator.sub, builtins.BinOpSub),
        (operator.mul, builtins.BinOpMul),
        (operator.truediv, builtins.BinOpTrueDiv),
    ):
        more_specific = {'key': operation, 'metadata': {'target': 'cpu'}}
        infer_global(operation)(type(template.__name__, (template,), more_specific))


def not_literal(value: int) -> Any:
    """Return an integer that is not a literal to numba, which would compile once per literal.

    Use it for arguments of equations and for starts of loops.
    """
    import numpy as np

    return np.int64(value)


def use_compiled() -> None:
    """Replace the plain kernels by the compiled ones in all modules.

    Cached kernels are loaded first, so that no caller waits for them.
    """
    if not is_waiting():
        return
    compiled = {id(function): dispatcher(function, options) for function, options in WAITING.plain}
    for compiled_kernel in compiled.values():
        load_kept(compiled_kernel)
    for module in list(sys.modules.values()):
        names = getattr(module, '__dict__', {})
        for name, value in list(names.items()):
            if id(value) in compiled:
                names[name] = compiled[id(value)]
    WAITING.expected = False
    WAITING.plain.clear()


def load_kept(function: Any) -> None:
    """Load all cached overloads of a kernel."""
    try:
        for signature, *_ in function._cache._cache_file._load_index():
            function.compile(signature)
    except AttributeError:
        pass  # no cache, or another cache layout of numba: loaded at the first call
