"""`pneunet compile`: compile and cache all kernels ahead of time."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
import gc
import time

from pneunet_ros.cli import verb
from pneunet_ros.core.kernels.cache import (
    cache_folder,
    compilation_lock,
    kernels_are_cached,
    write_marker_file,
)


def options(parser: ArgumentParser) -> None:
    """Add the options."""


def run(arguments: Namespace) -> int:
    """Compile the missing kernels."""
    start = time.process_time()
    with compilation_lock(), verb.progress_bar(shown=not arguments.json) as bar:
        already_compiled = kernels_are_cached()
        if not already_compiled:
            # Imported late, to limit the memory of a process that only waits for another one.
            from pneunet_ros.offline.kernels import call_kernels

            gc.disable()  # numba keeps nearly all objects, so collections are slow and useless
            task = bar.add_task('compiling', total=None)
            call_kernels(
                lambda name, done, total: bar.update(
                    task, description=f'compiling {name}', completed=done, total=total
                )
            )
            write_marker_file()
    seconds = time.process_time() - start
    content = {'folder': cache_folder(), 'compiled': not already_compiled, 'cpu_seconds': seconds}
    text = f'compiled into {cache_folder()}: {seconds:.0f} s of CPU'
    if already_compiled:
        text = f'the kernels are already compiled, in {cache_folder()}'
    verb.present(arguments, content, lambda console: console.print(text))
    return verb.DONE
