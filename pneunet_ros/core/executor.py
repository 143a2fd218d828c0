"""Executors for work that takes minutes: local processes or a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
import multiprocessing
import os

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.threads import THREADS

PATIENCE = 10  # s, to wait for a scheduler


@contextmanager
def open_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Open an executor: this many processes (None: one per core), or a Dask cluster.

    Submitted functions must be at module level, with picklable arguments and results. Workers of a
    cluster need the same version of this package. RequestError if Dask is not installed or no
    scheduler answers at the address.
    """
    if scheduler is not None:
        with cluster(scheduler) as executor:
            yield executor
        return
    if workers is not None and workers < 1:
        raise RequestError(
            f'the number of workers must be 1 or more, not {workers}', reason='out_of_bounds'
        )
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, '1'))  # new processes read this when they start
    try:
        context = multiprocessing.get_context('spawn')
        count = workers or os.cpu_count() or 1
        with ProcessPoolExecutor(count, mp_context=context) as pool:
            yield pool
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Connect to the Dask cluster whose scheduler has this address."""
    try:
        from distributed import Client
    except ImportError as error:
        raise RequestError(
            f'--scheduler {address} needs Dask: pip install "pneunet_ros[cluster]"',
            reason='not_installed',
        ) from error
    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise RequestError(
            f'no Dask scheduler answers at {address}: {error}', reason='no_answer'
        ) from error
    with client:
        executor: Executor = client.get_executor(pure=False)
        with executor:
            yield executor
