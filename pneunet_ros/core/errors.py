"""The errors of this package; every one names what was wrong and what is allowed.

::

    PneunetError
    ├── RequestError      an argument of a function or a command is not usable
    ├── ModelError        a model file or a model parameter is wrong
    ├── CameraError       a camera file or what it says of camera and targets is wrong
    ├── MessageError      a ROS message does not hold what its topic promises
    └── RecordingError    a recording or an output file cannot be used as asked

A solve that does not converge and a reading that cannot be used are no errors: they are values
with a status sentence (`shape.Shape.status`, `shape.Refusal`).
"""

from __future__ import annotations


class PneunetError(Exception):
    """Base of all errors of this package; its text is one sentence for a person."""


class RequestError(PneunetError):
    """An argument of a function or a command is not usable."""


class ModelError(PneunetError):
    """A model file or a model parameter is wrong."""


class CameraError(PneunetError):
    """A camera file or what it says of camera and targets is wrong."""


class MessageError(PneunetError):
    """A ROS message does not hold what its topic promises."""


class RecordingError(PneunetError):
    """A recording or an output file cannot be used as asked."""
