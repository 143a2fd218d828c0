"""Atomic output: files and folders appear complete or not at all.

Output is written under a hidden name next to its final path, and moved there at the very end. An
exception or interrupt leaves nothing behind. A killed process leaves only the hidden scratch
folder, which the next run that writes there removes. A running process holds a lock on its scratch
folder, which the system releases when the process ends for any reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
import errno
import fcntl
from fnmatch import fnmatch
import os
from pathlib import Path
import shutil
import tempfile

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.interrupt import defer_interrupts
from pneunet_ros.core.paths import resolve_links

# Errors due to missing space: disk full, quota used up, file larger than allowed.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
SCRATCH, PARTIAL = '.pneunet-', '.partial'  # prefix and suffix of the name of a scratch folder
REPLACED = f'{SCRATCH}replaced'  # name there of the folder that is being replaced
LONGEST_NAME = 255  # bytes of the name of a file


@contextmanager
def atomic_output(
    path: str | Path,
    *,
    overwrite: bool = False,
    inputs: Iterable[str | Path] = (),
    replaceable: Iterable[str] = (),
) -> Iterator[Path]:
    """Write a file or folder that appears under its name only when complete.

    Yields a path with the same name in a hidden folder next to the final one; write a file or make
    a folder there. On success it is moved to its final path, on an exception it is removed.

    overwrite: replace an existing file or folder, but only at the end. inputs: files and folders
    being read, which are never replaced. replaceable: patterns of file names; an existing folder
    is replaced only if all its entries match one of them, so that a mistyped name never deletes a
    folder of other files.

    Raises RecordingError immediately if the path cannot be used, and later if the disk is full.
    """
    output, group = None, _TOGETHER.get()
    try:
        with defer_interrupts():
            output = _open_output(path, overwrite, inputs, tuple(replaceable))
        with _full_disk_reported(path):
            yield output.temporary
        with defer_interrupts():
            if group is None:
                _put_in_place([output])
            else:
                group.append(output)
                output = None
    finally:
        if output is not None:
            output.discard()


@contextmanager
def all_or_none() -> Iterator[None]:
    """Move all outputs written in this context to their final paths at its end, or none."""
    finished: list[_Output] = []
    token = _TOGETHER.set(finished)
    try:
        yield
        with defer_interrupts():
            _put_in_place(finished)
    finally:
        _TOGETHER.reset(token)
        with defer_interrupts():
            for output in finished:
                output.discard()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Output:
    """A pending output: the name given by the user, its scratch path, and its final path.

    lock: the open file that holds the lock on the scratch folder.
    """

    path: str | Path
    final: Path
    overwrite: bool
    inputs: tuple[str | Path, ...]
    replaceable: tuple[str, ...]
    scratch: Path
    lock: int

    @property
    def temporary(self) -> Path:
        """The scratch path to write to."""
        return self.scratch / self.final.name

    def check(self) -> None:
        """Raise RecordingError if the output cannot be moved to its final path."""
        if self.final.exists() and not self.overwrite:
            raise RecordingError(
                f'{self.path} appeared in the meantime: choose another name or pass --overwrite',
                reason='exists',
            )
        # The path may have changed since the start, for example to a folder of somebody else.
        _check_place(self.path, self.final, self.overwrite, self.inputs, self.replaceable)
        if not self.temporary.exists():
            raise RecordingError(
                f'{self.path} was not written, because there is no content for it',
                reason='nothing_written',
            )

    def put_in_place(self) -> None:
        """Move the output to its final path; the old one is removed only after success."""
        _PUT.append((str(self.path), self.final, self.temporary.stat().st_ino))
        if not self.final.is_dir():
            os.replace(self.temporary, self.final)
            return
        # A folder cannot be renamed onto a folder with content: the old one is moved away first.
        aside = self.scratch / REPLACED
        os.rename(self.final, aside)
        try:
            os.rename(self.temporary, self.final)
        except BaseException:
            os.rename(aside, self.final)
            raise

    def discard(self) -> None:
        """Remove leftovers next to the final path."""
        with defer_interrupts():
            shutil.rmtree(self.scratch, ignore_errors=True)
            os.close(self.lock)


# Outputs that this process has begun or finished: the user's name, the path, and the inode of the
# written file or folder.
_PUT: list[tuple[str, Path, int]] = []
_TOGETHER: ContextVar[list[_Output] | None] = ContextVar('all_or_none', default=None)


def outputs_written() -> list[str]:
    """Return the finished outputs of this process, as the user named them.

    Checked on disk, because an interrupt may occur between renaming a file and recording its name.
    """
    return [
        path for path, final, number in _PUT if final.exists() and final.stat().st_ino == number
    ]


def _put_in_place(outputs: list[_Output]) -> None:
    """Move outputs into place once all of them are ready."""
    for output in outputs:
        output.check()
    for output in outputs:
        with _full_disk_reported(output.path):
            output.put_in_place()


@contextmanager
def _full_disk_reported(path: str | Path) -> Iterator[None]:
    """Turn a full disk into an error message."""
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM:
            raise RecordingError(
                f'{path} cannot be written: {error.strerror}; the incomplete file was removed',
                reason='unwritable',
            ) from error
        raise


def _open_output(
    path: str | Path, overwrite: bool, inputs: Iterable[str | Path], replaceable: tuple[str, ...]
) -> _Output:
    """Check the path of an output and make the scratch folder next to it."""
    final = _final_place(path, overwrite, inputs, replaceable)
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(final.parent)
        scratch, lock = _make_scratch(final.parent)
    except OSError as error:
        raise RecordingError(
            f'{path} cannot be written: {error.strerror}', reason='unwritable'
        ) from error
    return _Output(
        path=path,
        final=final,
        overwrite=overwrite,
        inputs=tuple(inputs),
        replaceable=replaceable,
        scratch=scratch,
        lock=lock,
    )


def _make_scratch(parent: Path) -> tuple[Path, int]:
    """Make a scratch folder and lock it; returns it and the open file that holds the lock."""
    while True:
        scratch = Path(tempfile.mkdtemp(prefix=SCRATCH, suffix=PARTIAL, dir=parent))
        try:
            lock = os.open(scratch, os.O_RDONLY)
        except FileNotFoundError:  # another run removed it as abandoned before it was locked
            continue
        _lock(lock)
        if scratch.exists():
            return scratch, lock
        os.close(lock)


def _lock(lock: int) -> bool:
    """Lock an open folder; False if another run holds it, or the file system has no locks."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _remove_abandoned(parent: Path) -> None:
    """Remove the scratch folders of killed runs, which no process has locked."""
    for scratch in parent.glob(f'{SCRATCH}*{PARTIAL}'):
        try:
            lock = os.open(scratch, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError:
            continue
        try:
            # If a run was killed at this point, the folder to be replaced is still there.
            if _lock(lock) and not (scratch / REPLACED).exists():
                shutil.rmtree(scratch, ignore_errors=True)
        finally:
            os.close(lock)


def _final_place(
    path: str | Path, overwrite: bool, inputs: Iterable[str | Path], replaceable: tuple[str, ...]
) -> Path:
    """Return the final path of an output; RecordingError if it cannot be written."""
    try:
        final = resolve_links(path, RecordingError)
        if not final.name:
            raise RecordingError(
                f'{path} cannot be written: it is the root of all folders', reason='unwritable'
            )
        if len(os.fsencode(final.name)) > LONGEST_NAME:
            raise RecordingError(
                f'{path} cannot be written: its name is longer than {LONGEST_NAME} bytes',
                reason='unwritable',
            )
        if Path(path).is_symlink() and not final.exists():
            raise RecordingError(
                f'{path} cannot be written: it is a broken link to {final}', reason='unwritable'
            )
        _check_place(path, final, overwrite, inputs, replaceable)
    except (OSError, ValueError) as error:  # an invalid file name, or a folder without permission
        why = getattr(error, 'strerror', None) or error
        raise RecordingError(f'{path} cannot be written: {why}', reason='unwritable') from error
    return final


def _is_replaceable(entry: Path, patterns: Iterable[str]) -> bool:
    """Whether an entry of an output folder may be from an earlier run.

    A pattern with a slash matches files in a subfolder, which may not contain any others.
    """
    if any(fnmatch(entry.name, pattern) for pattern in patterns):
        return True
    inside = [item.partition('/')[2] for item in patterns if item.startswith(f'{entry.name}/')]
    return (
        bool(inside)
        and entry.is_dir()
        and all(_is_replaceable(item, inside) for item in entry.iterdir())
    )


def _check_place(
    path: str | Path,
    final: Path,
    overwrite: bool,
    inputs: Iterable[str | Path],
    replaceable: tuple[str, ...],
) -> None:
    """Reject an unusable path before any work is done."""
    for name in inputs:
        source = resolve_links(name, RecordingError)
        if source == final or source in final.parents or final in source.parents:
            raise RecordingError(
                f'{path} would overwrite the input {name} or be inside it: choose another place',
                reason='overwrites_input',
            )
    if not final.exists():
        return
    if final.is_dir():
        foreign = [
            entry.name
            for entry in sorted(final.iterdir())
            if not _is_replaceable(entry, replaceable)
        ]
        if foreign:
            raise RecordingError(
                f'{path} is a folder that contains {foreign[0]}, not only an earlier output: '
                'choose another name',
                reason='holds_other_files',
            )
    elif not final.is_file():
        raise RecordingError(
            f'{path} is neither a file nor a folder: choose another name', reason='wrong_kind'
        )
    elif replaceable:
        raise RecordingError(
            f'{path} is a file, not a folder: choose another name', reason='wrong_kind'
        )
    if not overwrite:
        raise RecordingError(
            f'{path} exists already: choose another name or pass --overwrite', reason='exists'
        )
