"""Open files for reading, but only regular ones: a pipe may block, a device may never end."""

from __future__ import annotations

import errno
from pathlib import Path
import stat
from typing import BinaryIO

_KINDS = (
    (stat.S_ISFIFO, 'a pipe'),
    (stat.S_ISSOCK, 'a socket'),
    (stat.S_ISCHR, 'a device'),
    (stat.S_ISBLK, 'a device'),
    (stat.S_ISDIR, 'a folder'),
)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; OSError for pipes, devices and folders.

    Standard input may also be a file (`< file`), but not a pipe, because readers here need random
    access. An invalid file name is an OSError, too.
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
