"""Work goes to processes of this machine, or to a Dask cluster, and comes back the same."""

from __future__ import annotations

import math
import os
import sys

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.executor import open_executor
import pytest
from support.refusals import refused

VARIABLE = 'OPENBLAS_NUM_THREADS'


def test_processes_have_one_thread_of_linear_algebra_each(monkeypatch):
    monkeypatch.setenv(VARIABLE, '7')
    monkeypatch.delenv('OMP_NUM_THREADS', raising=False)
    with open_executor(workers=2) as executor:
        assert executor.submit(os.getenv, VARIABLE).result() == '1'
        assert executor.submit(os.getpid).result() != os.getpid()
        assert list(executor.map(math.sqrt, [1.0, 4.0, 9.0])) == [1.0, 2.0, 3.0]
    assert os.environ[VARIABLE] == '7'
    assert 'OMP_NUM_THREADS' not in os.environ


def test_no_workers_are_refused():
    with refused(RequestError, 'out_of_bounds'), open_executor(0):
        pass


def test_without_dask_what_to_install_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with refused(RequestError, 'not_installed'), open_executor(scheduler='tcp://nowhere:8786'):
        pass


def test_a_cluster_of_two_workers_does_the_same():
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host='127.0.0.1'
    ) as local:
        with open_executor(scheduler=local.scheduler_address) as executor:
            roots = list(executor.map(math.sqrt, [float(i * i) for i in range(20)]))
            pids = {executor.submit(os.getpid).result() for _ in range(20)}
        assert roots == [float(i) for i in range(20)]
        assert os.getpid() not in pids
        # The cluster itself goes on.
        with open_executor(scheduler=local.scheduler_address) as executor:
            assert executor.submit(math.hypot, 3.0, 4.0).result() == 5.0


def test_a_scheduler_that_does_not_answer_is_said(monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr('pneunet_ros.core.executor.PATIENCE', 1)
    with refused(RequestError, 'no_answer'), open_executor(scheduler='tcp://127.0.0.1:9'):
        pass
