"""Start the command: `python -m pneunet_ros.cli`, and `pneunet`.

Slow imports are done inside `main`, so that Ctrl-C is handled during them as well.
"""

from __future__ import annotations

import signal
import sys

from pneunet_ros.core.interrupt import clear_interrupt
from pneunet_ros.core.threads import use_one_thread

INTERRUPTED = 130  # exit code


def main() -> int:
    """Run one verb of the command line; returns the exit code."""
    use_one_thread()
    try:
        from pneunet_ros.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # later signals have no effect
        clear_interrupt()
        print(f'pneunet: interrupted; {written_sentence()}', file=sys.stderr)
        return INTERRUPTED


def written_sentence() -> str:
    """Name the outputs that were finished before an error."""
    from pneunet_ros.files.atomic import outputs_written

    written = outputs_written()
    return f'written before that: {", ".join(written)}' if written else 'nothing was written'


if __name__ == '__main__':
    sys.exit(main())
