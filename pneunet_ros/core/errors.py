"""The errors of this package; each names the fault and the allowed values.

::

PneunetError ├── RequestError      an argument of a function or a command is not usable ├──
ModelError        a model file or a model parameter is wrong ├── CameraError       a camera file,
or its description of camera and targets, is wrong ├── MessageError      a ROS message does not
have the expected content └── RecordingError    a recording or an output file cannot be used as
requested

A solve that does not converge and a reading that cannot be used are not errors but values with a
status sentence (`shape.Shape.status`, `shape.Refusal`).
"""

from __future__ import annotations

LONGEST_SENTENCE = 2_000  # characters; a sentence may quote megabytes of a file


class PneunetError(Exception):
    """Base of all errors of this package; its text is one sentence for the user.

    `reason` is the machine-readable cause, as in a `Refusal` (meanings: docs/reasons.py); it may
    be empty. A sentence that is too long is shortened in the middle.
    """

    def __init__(self, sentence: object = '', *, reason: str = '') -> None:
        """Initialize with a sentence, or with the text and reason of another error."""
        super().__init__(shorten(str(sentence)))
        self.reason = reason or getattr(sentence, 'reason', '')


def read_failure(error: Exception) -> str:
    """Return the reason why a file cannot be read."""
    return 'not_found' if isinstance(error, FileNotFoundError) else 'unreadable'


def shorten(sentence: str, longest: int = LONGEST_SENTENCE) -> str:
    """Return a text of bounded length, shortened in the middle if it is too long."""
    if len(sentence) <= longest:
        return sentence
    end = longest // 3
    return f'{sentence[: longest - end]} ... {sentence[-end:]}'


class RequestError(PneunetError):
    """An argument of a function or a command is not usable."""


class ModelError(PneunetError):
    """A model file or a model parameter is wrong."""


class CameraError(PneunetError):
    """A camera file, or its description of camera and targets, is wrong."""


class MessageError(PneunetError):
    """A ROS message does not have the expected content."""


class RecordingError(PneunetError):
    """A recording or an output file cannot be used as requested."""
