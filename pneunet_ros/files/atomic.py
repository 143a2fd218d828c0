"""Output files and folders that appear whole or not at all.

Everything is written beside its final place under a hidden name and moved there at the very end.
After an exception nothing is left; after a kill only the hidden scratch folder is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import errno
from fnmatch import fnmatch
import os
from pathlib import Path
import shutil
import tempfile

from pneunet_ros.core.errors import RecordingError

# What the system says when there is no room: disk full, quota used up, file larger than allowed.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def atomic_output(
    path: str | Path,
    *,
    overwrite: bool = False,
    inputs: Iterable[str | Path] = (),
    replaceable: Iterable[str] = (),
) -> Iterator[Path]:
    """Write a file or a folder that stands under its name only when it is complete.

    Yields a path with the same name in a hidden folder beside the final place; write a file or
    make a folder there. On a clean exit it takes the final name, on an exception it is removed.

    overwrite: replace what exists, at the end and only then. inputs: files and folders being read,
    which are never replaced. replaceable: patterns of file names; an existing folder is replaced
    only when all it holds matches one of them, so that a wrong name never costs a folder of other
    things.

    Raises RecordingError at once when the place cannot be used, and later when there is no room.
    """
    final = Path(path).resolve()
    _check_place(path, final, overwrite, inputs, tuple(replaceable))
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(
            tempfile.mkdtemp(prefix=f'.{final.name}.', suffix='.partial', dir=final.parent)
        )
    except OSError as error:
        raise RecordingError(f'{path} cannot be written: {error.strerror}') from error
    try:
        temporary = scratch / final.name
        yield temporary
        _put_in_place(path, temporary, final, overwrite)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise RecordingError(
                f'{path} cannot be written: {error.strerror}; nothing of it was kept'
            ) from error
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _check_place(
    path: str | Path,
    final: Path,
    overwrite: bool,
    inputs: Iterable[str | Path],
    replaceable: tuple[str, ...],
) -> None:
    """Refuse, before any work is done, a place that could not be used at the end."""
    for name in inputs:
        source = Path(name).resolve()
        if source == final or source in final.parents or final in source.parents:
            raise RecordingError(
                f'{path} would overwrite the input {name} or lie inside it: choose another place'
            )
    if not final.exists():
        return
    if final.is_dir():
        others = [
            entry.name
            for entry in sorted(final.iterdir())
            if not any(fnmatch(entry.name, pattern) for pattern in replaceable)
        ]
        if others:
            raise RecordingError(
                f'{path} is a folder that holds {others[0]}, not just an earlier output: '
                'choose another name'
            )
    elif not final.is_file():
        raise RecordingError(f'{path} is neither a file nor a folder: choose another name')
    elif replaceable:
        raise RecordingError(
            f'{path} is a file, and a folder is to be written: choose another name'
        )
    if not overwrite:
        raise RecordingError(f'{path} exists already: choose another name or pass --overwrite')


def _put_in_place(path: str | Path, temporary: Path, final: Path, overwrite: bool) -> None:
    """Move a finished output to its final name; an older one is gone only when that has worked."""
    if final.exists() and not overwrite:
        raise RecordingError(
            f'{path} has appeared meanwhile: choose another name or pass --overwrite'
        )
    if not temporary.exists():
        raise RecordingError(f'{path} was not written: its maker produced nothing')
    if not final.is_dir():
        os.replace(temporary, final)
        return
    # A folder cannot be renamed onto a filled one: the old one steps aside, and back if need be.
    aside = temporary.with_name(f'{temporary.name}.replaced')
    os.rename(final, aside)
    try:
        os.rename(temporary, final)
    except OSError:
        os.rename(aside, final)
        raise
