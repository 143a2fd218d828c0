"""An interrupt waits for what must be completed; a caught one leaves the exit code alone."""

from __future__ import annotations

import signal
import subprocess
import sys

from pneunet_ros.core.interrupt import defer_interrupts, Deferrable
import pytest

PROGRAM = """
import sys
from pneunet_ros.core.interrupt import clear_interrupt
try:
    exec('raise KeyboardInterrupt')
except KeyboardInterrupt:
    {then}
sys.exit(130)
"""


@pytest.mark.parametrize(('then', 'code'), [('pass', -2), ('clear_interrupt()', 130)])
def test_an_interrupt_of_code_made_from_text_is_forgotten(then, code, tmp_path):
    (tmp_path / 'interrupted.py').write_text(PROGRAM.format(then=then))
    command = [sys.executable, '-m', 'interrupted']
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == code


@pytest.fixture
def handlers():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_deferrable_handler_waits_and_stays_where_it_is(handlers, number):
    came = []
    handler = Deferrable(lambda number, frame: came.append(number))
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, handler)
    with defer_interrupts():
        with defer_interrupts():
            signal.raise_signal(number)
        assert signal.getsignal(signal.SIGINT) is handler
        assert came == []
    assert came == [number]
    signal.raise_signal(number)
    assert came == [number] * 2


def test_an_interrupt_waits_though_nothing_was_set_up(handlers):
    signal.signal(signal.SIGINT, signal.default_int_handler)
    done = []
    with pytest.raises(KeyboardInterrupt), defer_interrupts():
        signal.raise_signal(signal.SIGINT)
        done.append(True)
    assert done == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
