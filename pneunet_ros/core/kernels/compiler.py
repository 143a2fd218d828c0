"""A numba compiler that optimizes kernels only once.

By default, numba runs the optimization passes of LLVM up to three times, to remove reference
counts of lists and arrays early. Kernels have few of those and are not inlined into their callers
(`core.kernels.links`): the last run suffices if loops have the form that can be vectorized, which
saves a tenth of the time.
"""

from __future__ import annotations

from functools import cache
from typing import Any

# The next line makes this file one of those that recompile the kernels (`jit.fingerprint`):
# core.kernels.jit import


@cache
def kernel_compiler() -> Any:
    """Return the class that compiles kernels; numba is imported only to compile.

    Raises ImportError if numba has no such classes.
    """
    from llvmlite import binding  # it comes with numba
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler

    class OptimizedOnce(JITCodeLibrary):  # type: ignore[misc]
        """The compiled form of a kernel and everything inlined into it."""

        def _optimize_functions(self, module: Any) -> None:
            """Do nothing: functions are optimized with the whole module."""
            module.data_layout = self._codegen._data_layout

        def _optimize_final_module(self) -> None:
            """Canonicalize loops as numba does, then optimize the whole module once."""
            try:
                passes, builder = self._codegen._module_pass_manager()
                first = binding.create_new_module_pass_manager()
                first.add_loop_rotate_pass()
                first.add_instruction_combine_pass()
                first.add_jump_threading_pass()
            except (TypeError, AttributeError):  # another numba: use its own way
                super()._optimize_final_module()
                return
            first.run(self._final_module, builder)
            passes.run(self._final_module, builder)

    class KernelCompiler(Compiler):  # type: ignore[misc]
        """Numba's compiler with a module that is optimized once, at the end."""

        def define_pipelines(self) -> Any:
            """Return numba's own steps."""
            state = self.state
            if state.library is None:
                name = state.func_id.func_qualname
                state.library = OptimizedOnce(state.targetctx.codegen(), name)
                state.library.enable_object_caching()
            return super().define_pipelines()

    return KernelCompiler
