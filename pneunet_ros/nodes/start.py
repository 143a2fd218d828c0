"""Start a node: signals first, then what takes a while to import, with answers at once.

Nothing that has kernels or ROS is imported before, so that a signal in the first seconds ends the
process as it does later.
"""

from __future__ import annotations

from importlib import import_module

from pneunet_ros.core.kernel_cache import answer_first, compile_first, compile_meanwhile
from pneunet_ros.nodes.signals import end_at_signal


def start(module: str, *, kernels_first: bool = False) -> int:
    """Import the module of a node, or of several, and run its `main`; returns the exit code.

    Where no kernel is compiled it works by plain Python while another process compiles them, or
    waits for that: a virtual arm by plain Python would be late for its clock.
    """
    end_at_signal()
    try:
        answer_first()
        main = import_module(module).main
        if kernels_first:
            compile_first(lambda: None)
        else:
            compile_meanwhile()
        code: int = main()
    except KeyboardInterrupt:
        return 0
    return code
