"""Answers before the kernels are compiled, and who compiles them for whom."""

from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys
import time
from types import SimpleNamespace

from pneunet_ros.cli.main import main
from pneunet_ros.core.kernels import cache as kernel_cache
from pneunet_ros.core.kernels import jit
import pytest

ROOT = Path(__file__).parents[2]
# A process that finds no kernel on the disk until the file is there, and has none compiled.
UNKEPT = """
import sys
from pathlib import Path
from pneunet_ros.core.kernels import cache as kernel_cache
kept = Path(sys.argv.pop(1))
kernel_cache.marker_file = lambda: kept
kernel_cache.COMPILE = (sys.executable, '-c', 'import time; time.sleep(600)')
"""
BOTH_WAYS = (
    UNKEPT
    + """
import json
from pneunet_ros.core.kernels import jit
kernel_cache.use_plain_python()
from pneunet_ros import load_model, solve
arm = load_model('config/paper_arm.yaml')
def answer():
    shape = solve(arm, 44.9e3, (0.15, 0.125))
    return [jit.state_of_kernels(), shape.x.tolist(), shape.status, shape.iterations]
first = [answer(), 'numba' in sys.modules]
kept.touch()
kernel_cache.compile_first()
from pneunet_ros.solver import collocation, interpolation
print(json.dumps([*first, answer(), all(
    hasattr(kernel, 'signatures') and kernel.signatures
    for kernel in (collocation.newton, interpolation.at_stations)
)]))
"""
)


@pytest.fixture
def unkept(tmp_path, monkeypatch):
    """Give the file that says that kernels are kept, which is not there."""
    file = tmp_path / 'kept'
    monkeypatch.setattr(kernel_cache, 'marker_file', lambda: file)
    monkeypatch.setattr(kernel_cache, 'cache_is_writable', lambda: True)
    monkeypatch.setattr(jit, 'HAVE_NUMBA', True)
    return file


def test_the_same_numbers_before_and_after_the_kernels_are_there(tmp_path):
    command = [sys.executable, '-W', 'error', '-c', BOTH_WAYS, str(tmp_path / 'kept')]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    plain, numba_was_needed, compiled, in_place = json.loads(done.stdout)
    assert plain[0] == 'plain Python while they are compiled'
    assert not numba_was_needed
    assert compiled[0] == 'compiled'
    assert in_place
    assert plain[1] == pytest.approx(compiled[1], abs=1e-12)
    assert plain[2:] == compiled[2:]


def test_predict_does_not_wait_for_the_kernels(tmp_path):
    script = UNKEPT + (
        'from pneunet_ros.cli.main import main\n'
        'code = main(sys.argv[1:])\n'
        "assert 'numba' not in sys.modules\n"
        'sys.exit(code)\n'
    )
    words = ['predict', '--pressure', '31000', '--force', '0.175', '0.07']
    answers = []
    for more in ([], ['--json']):
        command = [sys.executable, '-W', 'error', '-c', script, str(tmp_path / 'kept')]
        done = subprocess.run(
            [*command, *words, *more], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        answers.append(done)
    assert answers[0].stderr.count('\n') == 1
    assert answers[1].stderr == ''
    assert json.loads(answers[1].stdout)['status'].startswith('converged')


def test_one_process_compiles_for_all(unkept, monkeypatch):
    monkeypatch.setattr(kernel_cache, 'start_compiling', lambda: pytest.fail('a second one'))
    looks = []
    with kernel_cache.lock_file().open('w') as file:
        kernel_cache.fcntl.flock(file, kernel_cache.fcntl.LOCK_EX)
        assert kernel_cache.is_compiling()

        def look():
            looks.append(kernel_cache.is_compiling())
            if len(looks) == 2:
                unkept.touch()

        kernel_cache.wait_for_kernels(look)
    assert looks == [True, True]
    assert not kernel_cache.is_compiling()


def test_two_that_look_at_once_do_not_take_each_other_for_one_that_compiles(unkept):
    with kernel_cache.lock_file().open('w') as file:
        kernel_cache.fcntl.flock(file, kernel_cache.fcntl.LOCK_SH)
        assert not kernel_cache.is_compiling()


def test_who_waited_for_one_that_failed_compiles(unkept, monkeypatch):
    started = []

    def start():
        started.append(unkept.touch())
        return SimpleNamespace(poll=lambda: None)

    monkeypatch.setattr(kernel_cache, 'start_compiling', start)
    with kernel_cache.lock_file().open('w') as file:
        kernel_cache.fcntl.flock(file, kernel_cache.fcntl.LOCK_EX)
        looks = []

        def look():
            looks.append(len(started))
            if len(looks) == 2:
                kernel_cache.fcntl.flock(file, kernel_cache.fcntl.LOCK_UN)

        kernel_cache.wait_for_kernels(look)
    assert looks[:2] == [0, 0]
    assert len(started) == 1


def test_the_folder_of_the_first_kernels_is_made(monkeypatch, tmp_path):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'a' / 'b'))
    assert not kernel_cache.is_compiling()
    with kernel_cache.compilation_lock():
        kernel_cache.write_marker_file()
    assert kernel_cache.marker_file().exists()


def test_a_compiler_that_fails_is_not_waited_for(unkept, monkeypatch):
    used = []
    monkeypatch.setattr(jit.WAITING, 'expected', True)
    monkeypatch.setattr(kernel_cache, 'COMPILE', (sys.executable, '-c', 'raise SystemExit(1)'))
    monkeypatch.setattr(jit, 'use_compiled', lambda: used.append('compiled'))
    kernel_cache.compile_in_background()
    (thread,) = (one for one in kernel_cache.threading.enumerate() if one.name == 'kernels')
    thread.join(60.0)
    assert not used  # plain Python goes on
    kernel_cache.compile_first()
    assert used == ['compiled']  # what has long work compiles as it goes


def test_nobody_waits_where_nothing_can_be_kept(unkept, monkeypatch, tmp_path):
    assert not kernel_cache.kernels_are_cached()
    monkeypatch.undo()
    file = tmp_path / 'a file'
    file.touch()
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(file / 'below'))
    kernel_cache.cache_is_writable.cache_clear()
    try:
        assert not kernel_cache.cache_is_writable()
        assert kernel_cache.kernels_are_cached()
    finally:
        kernel_cache.cache_is_writable.cache_clear()


def test_kernels_of_other_equations_are_not_taken(monkeypatch):
    today = kernel_cache.marker_file()
    monkeypatch.setattr(jit, 'sources', lambda: 'other')
    assert kernel_cache.marker_file() != today
    assert kernel_cache.marker_file().parent == today.parent


@pytest.mark.skipif(not jit.HAVE_NUMBA, reason='no numba here')
def test_what_only_kernels_call_is_compiled_once_and_plain_for_python(monkeypatch):
    import numba
    from numba.core import event

    monkeypatch.setattr(jit, 'keep', lambda compiled: None)  # or an earlier run has compiled it

    def doubled(x):
        return 2.0 * x

    def raised(x):
        return doubled(x) + 1.0

    def entry(x):
        return raised(x) + doubled(x)

    assert jit.dispatcher(doubled, jit.INNER) is doubled
    assert jit.dispatcher(raised, jit.INLINED) is raised
    compiled = numba.njit(**jit.WITHIN)(entry)
    with event.install_recorder('numba:compile') as recorder:
        assert compiled(1.5) == entry(1.5) == 7.0
    begun = [what for _, what in recorder.buffer if what.is_start]
    functions = [what.data['dispatcher'].py_func.__name__ for what in begun]
    assert sorted(functions) == ['doubled', 'entry', 'raised']


def test_compile_says_that_all_is_there(capsys, unkept):
    unkept.touch()
    assert main(['compile']) == 0
    assert capsys.readouterr().out
    assert main(['compile', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['compiled'] is False


@pytest.mark.ros
def test_a_node_answers_by_plain_python_and_changes_over(tmp_path):
    pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")
    import os

    from support.dds_peer import EstimatorPeer, TIMEOUT

    domain = int(os.environ['ROS_DOMAIN_ID'])
    script = UNKEPT + ('from pneunet_ros.nodes.estimator.__main__ import main\nsys.exit(main())\n')
    kept = tmp_path / 'kept'
    process = subprocess.Popen(
        [sys.executable, '-c', script, str(kept), '--ros-args', '-r', '__ns:=/pneunet'],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )
    peer = EstimatorPeer(domain)
    try:
        peer.connect()
        assert said_of_kernels(peer, TIMEOUT, 'plain Python while they are compiled')
        kept.touch()
        assert said_of_kernels(peer, TIMEOUT, 'compiled')
    finally:
        peer.close()
        process.terminate()
        assert process.wait(TIMEOUT) == 0, process.stderr.read()
        process.stderr.close()


def said_of_kernels(peer, timeout, words):
    """Whether diagnostics say this of the kernels before long."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        peer.executor.spin_once(0.1)
        for status in peer.statuses:
            if {item.key: item.value for item in status.values}['kernels'] == words:
                return True
        peer.statuses.clear()
    return False
