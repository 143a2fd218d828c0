"""Restricts linear algebra to one thread per process, because all matrices are small.

Several threads wait for each other and, on a busy machine, for a core.
"""

from __future__ import annotations

import os

THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


def use_one_thread() -> None:
    """Restrict numpy and scipy to one thread, unless the environment sets a number.

    Call this before importing them.
    """
    for name in THREADS:
        os.environ.setdefault(name, '1')
