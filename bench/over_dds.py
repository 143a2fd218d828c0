"""Common parts of the node benchmarks: separate ROS domain, node process, bare node.

A bare node answers a message with a constant one: what it takes is DDS, Python and the machine.
The bench itself is one, started by `--bare-node`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
from typing import Any

CHECKOUT = Path(__file__).resolve().parent.parent
NAMESPACE = '/pneunet'


def bench_options(description: str, bare_node: Callable[[], Any]) -> argparse.ArgumentParser:
    """Return a command line with --json; with --bare-node this process is that node, and ends."""
    if '--bare-node' in sys.argv:
        spin(bare_node)
        sys.exit(0)
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    return parser


def spin(make_node: Callable[[], Any]) -> None:
    """Run one node in this process until a signal."""
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(make_node(), SingleThreadedExecutor())


@contextlib.contextmanager
def own_domain() -> Iterator[Path]:
    """Keep to this machine and to a domain of this process; yields a folder for logs and files."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 101 + 1))
    with tempfile.TemporaryDirectory() as folder:
        os.environ['ROS_LOG_DIR'] = folder
        yield Path(folder)


@contextlib.contextmanager
def running_node(what: list[str], namespace: str = NAMESPACE) -> Iterator[subprocess.Popen[bytes]]:
    """Start a node as a user would, and end it by SIGINT; what: arguments of Python."""
    arguments = what if '--ros-args' in what else [*what, '--ros-args']
    process = subprocess.Popen(
        [sys.executable, *arguments, '-r', f'__ns:={namespace}'],
        cwd=CHECKOUT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10)


def cpu_seconds(pid: int) -> float:
    """Processor time a process has used, all its threads."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
