"""The log of a node, with rate-limited messages."""

from __future__ import annotations

import math
from typing import Any

from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.printable import printable

REPEAT_PERIOD = 60.0  # s
STARTING = 5.0  # s, for nodes started together to come up


class Log:
    """Writes to a logger of rclpy, at most one message of a kind every `REPEAT_PERIOD` seconds."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._logged_at: dict[str, float] = {}

    def warn(self, kind: str, sentence: str, now: float) -> None:
        """Log a warning, unless one of this kind was logged recently; now (s): steady clock."""
        if self._is_new(kind, now):
            self._logger.warning(printable(sentence))

    def error(self, kind: str, sentence: str, now: float) -> None:
        """Log an error, unless one of this kind was logged recently; now (s): steady clock."""
        if self._is_new(kind, now):
            self._logger.error(printable(sentence))

    def refusal(self, refusal: Refusal, since_ready: float, now: float) -> None:
        """Log a refusal; since_ready: time (s) since the node was ready."""
        if refusal.awaits_others and since_ready < STARTING:
            self.warn(f'{refusal.reason} while starting', refusal.sentence, now)
            return
        write = self.error if refusal.error else self.warn
        write(refusal.reason, refusal.sentence, now)

    def _is_new(self, kind: str, now: float) -> bool:
        if now - self._logged_at.get(kind, -math.inf) < REPEAT_PERIOD:
            return False
        self._logged_at[kind] = now
        return True
