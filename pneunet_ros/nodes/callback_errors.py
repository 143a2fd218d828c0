"""Internal errors in callbacks: counted, logged once each, and not fatal.

A robot can miss one reading, but not its node.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import wraps
from pathlib import Path
import traceback
from typing import Any

from pneunet_ros.nodes.signals import signal_came


class CallbackErrors:
    """Counts callback errors by type and line.

    log: called with the first error of each kind, as a key and a sentence with its traceback.
    """

    def __init__(self, log: Callable[[str, str], None]) -> None:
        self.total: Counter[str] = Counter()
        self._unreported: Counter[str] = Counter()
        self._log = log

    def guarded(
        self, callback: Callable[..., Any], failed: Callable[..., Any] = lambda *arguments: None
    ) -> Callable[..., Any]:
        """Wrap a callback so that it never raises; failed: returns the result after an error.

        After a signal, however, an error ends the node, because ROS raises errors in calls that a
        signal interrupts.
        """

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                if signal_came():
                    raise
                self.note(error)
                return failed(*arguments)

        return call

    def note(self, error: Exception) -> None:
        """Count an error, and log the first of its kind."""
        frames = traceback.extract_tb(error.__traceback__)
        where = f' at {Path(frames[-1].filename).name}:{frames[-1].lineno}' if frames else ''
        kind = f'{type(error).__name__}{where}'
        self.total[kind] += 1
        self._unreported[kind] += 1
        if self.total[kind] == 1:
            text = ''.join(traceback.format_exception(error))
            self._log(
                kind,
                f'internal error, {kind}: this message or call was skipped, and the node '
                f'continues. If it repeats, call ~/reset, and report this:\n{text}',
            )

    def sentence(self) -> str:
        """Report the number of errors since the last call; empty if there were none."""
        new, self._unreported = self._unreported, Counter()
        return '; '.join(
            (
                f'{count} internal error{"s" if count > 1 else ""}, {kind}: call ~/reset if '
                'this repeats'
            )
            for kind, count in sorted(new.items())
        )


def refuse_call(request: Any, response: Any) -> Any:
    """Return the response of a service that failed."""
    if hasattr(response, 'success') and hasattr(response, 'message'):
        response.success, response.message = False, 'internal error: see the log of the node'
    return response
