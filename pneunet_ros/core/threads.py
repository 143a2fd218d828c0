"""One thread of linear algebra in a process: matrices here are small.

More threads wait for each other, and on a busy machine for a core: a diagnosis took 74 s beside
another process, and 22 s with one thread.
"""

from __future__ import annotations

import os

THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


def use_one_thread() -> None:
    """Restrict numpy and scipy to one thread, unless the environment sets a number.

    Only before they are imported.
    """
    for name in THREADS:
        os.environ.setdefault(name, '1')
