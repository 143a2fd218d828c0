"""Where compiled kernels are kept, whether they are there, and who compiles them meanwhile.

A file that is named after all that compiled kernels depend on says that they are on the disk. It
is written by `pneunet compile`, once it has called every kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import fcntl
import hashlib
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import subprocess
import sys
from threading import Thread
import time

from pneunet_ros.core import jit

COMPILE = (sys.executable, '-m', 'pneunet_ros.cli', 'compile')
LOOK_AGAIN = 0.2  # s


def cache_folder() -> Path:
    """Return where numba keeps the kernels, or where it may be written if that is elsewhere."""
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    if chosen:
        return Path(chosen)
    beside = Path(__file__).parent / '__pycache__'
    if os.access(beside if beside.exists() else beside.parent, os.W_OK):
        return beside
    home = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(home) / 'pneunet_ros'


def kept_file() -> Path:
    """Return the file that says that the kernels are on the disk."""
    parts = [jit.sources(), platform.python_version(), processor()]
    for library in ('numba', 'llvmlite', 'numpy'):
        try:
            parts.append(version(library))
        except PackageNotFoundError:
            parts.append('')
    name = hashlib.sha256('\n'.join(parts).encode()).hexdigest()[:16]
    return cache_folder() / f'pneunet_kernels_{name}'


def processor() -> str:
    """Return what this processor can do: kernels are compiled for it."""
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
    except OSError:
        return platform.processor()
    wanted = ('model name', 'flags', 'Features')
    return '\n'.join(dict.fromkeys(line for line in lines if line.startswith(wanted)))


def kernels_kept() -> bool:
    """Whether there is nothing to compile: the kernels are on the disk, or there is no numba."""
    return not jit.HAVE_NUMBA or kept_file().exists()


def note_kept() -> None:
    """Say that the kernels are on the disk."""
    file = kept_file()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()


@contextmanager
def alone() -> Iterator[None]:
    """Wait until no other process compiles these kernels."""
    lock = kept_file().with_suffix('.lock')
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open('w') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def start_compiling() -> subprocess.Popen[bytes]:
    """Start a process that compiles the kernels; it goes on when this one ends."""
    return subprocess.Popen(
        COMPILE,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def answer_first() -> None:
    """Let kernels run as plain Python where they are not on the disk; before any is imported."""
    if not kernels_kept():
        jit.answer_first()


def compile_meanwhile() -> bool:
    """Have the kernels compiled in a process of its own, and use them when they are there.

    Whether there was something to compile. Another thread waits for them and puts them in place.
    """
    if kernels_kept():
        return False
    process = start_compiling()

    def take_over() -> None:
        process.wait()
        if kernels_kept():
            jit.use_compiled()

    Thread(target=take_over, name='kernels', daemon=True).start()
    return True


def compile_first(on_wait: Callable[[], None]) -> None:
    """Wait until the kernels are on the disk, and use them; on_wait: is called meanwhile."""
    if kernels_kept():
        return
    process = start_compiling()
    while process.poll() is None:
        on_wait()
        time.sleep(LOOK_AGAIN)
    jit.use_compiled()
