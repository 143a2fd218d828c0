"""The kernel cache: its location and state, and the process that fills it.

A marker file, named by a hash of all dependencies of the compiled kernels, shows that the kernels
are cached. `pneunet compile` writes it after calling every kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import fcntl
from functools import cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import subprocess
import sys
import threading
import time

from pneunet_ros.core.kernels import jit

# A low priority: processes that wait for kernels run plain Python meanwhile.
COMPILE = ('nice', '-n', '5', sys.executable, '-m', 'pneunet_ros.cli', 'compile')
LOOK_AGAIN = 0.2  # s


def cache_folder() -> Path:
    """Return the folder where numba caches kernels, or a writable one."""
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    if chosen:
        return Path(chosen)
    package_cache = Path(__file__).parent / '__pycache__'
    if os.access(package_cache if package_cache.exists() else package_cache.parent, os.W_OK):
        return package_cache
    home = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(home) / 'pneunet_ros'


def marker_file() -> Path:
    """Return the marker file, which exists if all kernels are cached."""
    parts = [jit.sources(), platform.python_version(), processor()]
    for library in ('numba', 'llvmlite', 'numpy'):
        try:
            parts.append(version(library))
        except PackageNotFoundError:
            parts.append('')
    name = hashlib.sha256('\n'.join(parts).encode()).hexdigest()[:16]
    return cache_folder() / f'pneunet_kernels_{name}'


def processor() -> str:
    """Return the features of this processor, for which the kernels are compiled."""
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
    except OSError:
        return platform.processor()
    wanted = ('model name', 'flags', 'Features')
    return '\n'.join(dict.fromkeys(line for line in lines if line.startswith(wanted)))


def kernels_are_cached() -> bool:
    """Whether the kernels are cached or cannot be cached.

    Caching requires numba and a writable folder.
    """
    return not jit.HAVE_NUMBA or marker_file().exists() or not cache_is_writable()


@cache
def cache_is_writable() -> bool:
    """Whether there is a writable folder for kernels."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def write_marker_file() -> None:
    """Write the marker file, which states that the kernels are cached."""
    marker_file().touch()


@contextmanager
def compilation_lock() -> Iterator[None]:
    """Context manager: hold the lock for compiling these kernels; waits for other processes."""
    with lock_file().open('w') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def is_compiling() -> bool:
    """Whether a process is compiling these kernels."""
    with lock_file().open('w') as file:
        try:
            # A shared lock: two processes that look at once do not mistake each other for a
            # compiling one.
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def lock_file() -> Path:
    """Return the lock file of the compiling process; creates its folder."""
    file = marker_file().with_suffix('.lock')
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


def use_plain_python() -> None:
    """Run uncached kernels as plain Python; call before importing any kernel."""
    if not kernels_are_cached():
        jit.use_plain_python()


def compile_in_background() -> None:
    """Compile the kernels in the background, and use them as soon as they are cached.

    Another thread waits for the kernels and installs them. If compiling fails, plain Python
    remains in use, because compiling a kernel when it is called would delay the results.
    """

    def take_over() -> None:
        wait_for_kernels()
        if kernels_are_cached():
            jit.use_compiled()

    if jit.is_waiting():
        threading.Thread(target=take_over, name='kernels', daemon=True).start()


def compile_first(on_wait: Callable[[], None] = lambda: None) -> None:
    """Wait until the kernels are cached, and use them; on_wait is called meanwhile.

    If compiling fails, each kernel is compiled when it is called.
    """
    wait_for_kernels(on_wait)
    jit.use_compiled()


def wait_for_kernels(on_wait: Callable[[], None] = lambda: None) -> None:
    """Wait for the process that compiles the kernels; start it unless one is running.

    If this process ends, the compilation continues. If a compilation by another process fails,
    this process restarts it.
    """
    process = None
    while not kernels_are_cached():
        if not is_compiling():
            if process is None:
                process = start_compiling()
            elif process.poll() is not None:
                return
        on_wait()
        time.sleep(LOOK_AGAIN)


def start_compiling() -> subprocess.Popen[bytes]:
    """Start a process that compiles the kernels."""
    return subprocess.Popen(
        COMPILE,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
