"""An interrupt that was dealt with is over: the exit code is the program's own."""

from __future__ import annotations


def forget_interrupt() -> None:
    """Let the process end with its exit code after a KeyboardInterrupt that was caught.

    Python notes an interrupt that leaves code made from text (dataclasses, numba and attrs make
    theirs so) as one that nobody caught, and at the end kills itself with SIGINT whatever the
    program returned. The next text that runs takes the note away.
    Source: run_eval_code_obj and Py_RunMain of CPython 3.8 to 3.13.
    """
    exec('')
