"""`pneunet compile`: compile and cache all kernels ahead of time."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
import gc
import time

from pneunet_ros.cli import verb
from pneunet_ros.core.kernels.cache import alone, cache_folder, kernels_kept, note_kept


def options(parser: ArgumentParser) -> None:
    """Add the options."""


def run(arguments: Namespace) -> int:
    """Compile the missing kernels."""
    begun = time.process_time()
    with alone(), verb.progress_bar(shown=not arguments.json) as bar:
        there = kernels_kept()
        if not there:
            # What waits for its turn need not have imported all that has kernels.
            from pneunet_ros.offline.kernels import call_kernels

            gc.disable()  # nearly all that numba makes is kept; to look for what is not takes long
            task = bar.add_task('compiling', total=None)
            call_kernels(
                lambda name, done, total: bar.update(
                    task, description=f'compiling {name}', completed=done, total=total
                )
            )
            note_kept()
    seconds = time.process_time() - begun
    content = {'folder': cache_folder(), 'compiled': not there, 'cpu_seconds': seconds}
    said = f'compiled into {cache_folder()}: {seconds:.0f} s of CPU'
    if there:
        said = f'the kernels are already compiled, in {cache_folder()}'
    verb.present(arguments, content, lambda console: console.print(said))
    return verb.DONE
