"""Open regular files for reading; pipes may block, and devices may never end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import errno
from pathlib import Path
import stat
from typing import BinaryIO

from pneunet_ros.core.errors import RecordingError

_KINDS = (
    (stat.S_ISFIFO, 'a pipe'),
    (stat.S_ISSOCK, 'a socket'),
    (stat.S_ISCHR, 'a device'),
    (stat.S_ISBLK, 'a device'),
    (stat.S_ISDIR, 'a folder'),
)


@contextmanager
def readable(path: Path, name: Path | None = None) -> Iterator[BinaryIO]:
    """Open a regular file for reading; RecordingError if it, or a part of it, cannot be read.

    name: the name to use in messages, if the file is a copy.
    """
    try:
        with open_regular(path) as stream:
            yield stream
    except OSError as error:
        raise RecordingError(
            f'{name or path} cannot be read: {error.strerror}', reason='unreadable'
        ) from error


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; OSError for pipes, devices and folders.

    Standard input may be a file (`< file`) but not a pipe, because readers here need random
    access. An invalid file name raises OSError as well.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        raise OSError(
            errno.EINVAL, 'its name contains a character that is not allowed in file names'
        ) from error
    for is_kind, called in _KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f'it is {called}, but a file is needed')
    return path.open('rb')
