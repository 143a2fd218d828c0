"""Linking of kernels by symbol, as programs call a shared library.

By default, numba copies all callees into a function, because its cache entries must be
self-contained; nearly half of the compiled code would be copies. With linking, a kernel has its
own symbol in the process, callers refer only to this symbol, and their cache entries list the
kernels to load first.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cache
import hashlib
from pickle import UnpicklingError
from typing import Any

from pneunet_ros.core.interrupt import defer_interrupts

# The next line makes this file one of those that recompile the kernels (`jit.fingerprint`):
# core.kernels.jit import

# A kernel is also compiled per signature: its name here, and the types of its arguments.
KERNELS: dict[str, Any] = {}
NAMED: dict[str, tuple[str, tuple[Any, ...]]] = {}


@cache
def linked_cache() -> Any:
    """Return the class of the kernel cache, keyed by the function and the sources of all kernels.

    Numba is imported only for compiling.
    """
    from numba.core.caching import CompileResultCacheImpl, FunctionCache

    class KeptWithCalls(CompileResultCacheImpl):  # type: ignore[misc]
        """The cache entry of a compiled kernel, preceded by the kernels that it calls."""

        def reduce(self, result: Any) -> tuple[Any, ...]:
            """Return the content of the cache: the kernels that are called, and numba's data."""
            declared = {each.name for each in result.library._final_module.functions}
            calls = [NAMED[name] for name in sorted(declared & NAMED.keys())]
            return calls, super().reduce(result)

        def rebuild(self, target_context: Any, kept: tuple[Any, ...]) -> Any:
            """Return the compiled kernel after loading the kernels that it calls."""
            calls, result = kept
            for name, types in calls:
                KERNELS[name].compile(types)
            return super().rebuild(target_context, result)

    class KernelCache(FunctionCache):  # type: ignore[misc]
        """A kernel cache that is valid while the sources of all kernels are unchanged."""

        _impl_class = KeptWithCalls

        def __init__(self, function: Callable[..., Any], sources: str) -> None:
            super().__init__(function)
            # The version comes first, because numba checks it before the types.
            index = self._cache_file
            index._version = (index._version, sources)

        def _load_overload(self, types: tuple[Any, ...], target_context: Any) -> Any:
            """Return the cached kernel for some types; None if it is damaged or of other types.

            Numba writes the index and then the code, so if two processes run at once, one may find
            the code of the other. LLVM calls back while it loads: an interrupt raised there is
            lost, and the loaded symbol is a null pointer.
            """
            try:
                with defer_interrupts():
                    result = super()._load_overload(types, target_context)
            except (EOFError, KeyError, ValueError, UnpicklingError):
                return None
            same = result is not None and tuple(result.signature.args) == tuple(types)
            return result if same else None

    return KernelCache


def link(kernel: Any, sources: str) -> None:
    """Let other kernels call this one by symbol, and cache it on disk.

    sources: the fingerprint of all kernels. Raises RuntimeError if there is no cache folder.
    """
    kernel._cache = linked_cache()(kernel.py_func, sources)
    name = f'{kernel.py_func.__module__}.{kernel.py_func.__qualname__}'
    KERNELS[name] = kernel
    add_overload = kernel.add_overload

    def add_named(result: Any) -> None:
        give_name(name, result)
        add_overload(result)

    kernel.add_overload = add_named


def give_name(kernel: str, result: Any) -> None:
    """Give compiled code the same symbol in every process."""
    from llvmlite import binding  # a dependency of numba

    descriptor, types = copy(result.fndesc), tuple(result.signature.args)
    descriptor.typemap = descriptor.calltypes = None  # large, and not needed by callers
    digest = hashlib.sha256(f'{kernel}{types}'.encode()).hexdigest()[:16]
    descriptor.mangled_name = f'{kernel}.{digest}'
    address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
    binding.add_symbol(descriptor.mangled_name, address)
    NAMED[descriptor.mangled_name] = kernel, types
    result.target_context.remove_user_function(result.entry_point)
    result.target_context.insert_user_function(result.entry_point, descriptor)
