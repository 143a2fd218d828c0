"""Where work that takes minutes goes: processes of this machine, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
import multiprocessing
import os

from pneunet_ros.core.errors import RequestError

# One thread of linear algebra per process: more would only be in each other's way.
THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
PATIENCE = 10  # s, to wait for a scheduler


@contextmanager
def open_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Give an executor: so many processes (None: one per core), or those of a Dask scheduler.

    What is submitted must be a function of a module, its arguments and results picklable. A
    cluster's workers need this package, in the same version. RequestError where Dask is not
    installed or no scheduler answers at the address.
    """
    if scheduler is not None:
        with cluster(scheduler) as executor:
            yield executor
        return
    if workers is not None and workers < 1:
        raise RequestError(f'workers must be 1 or more, not {workers}')
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, '1'))  # new processes read it as they start
    try:
        context = multiprocessing.get_context('spawn')
        with ProcessPoolExecutor(workers or os.cpu_count() or 1, mp_context=context) as pool:
            yield pool
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Give the executor of the Dask cluster whose scheduler is at this address."""
    try:
        from distributed import Client
    except ImportError as error:
        raise RequestError(
            f'--scheduler {address} needs Dask: install it by pip install "pneunet_ros[cluster]"'
        ) from error
    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise RequestError(f'no Dask scheduler answers at {address}: {error}') from error
    with client:
        executor: Executor = client.get_executor(pure=False)
        with executor:
            yield executor
