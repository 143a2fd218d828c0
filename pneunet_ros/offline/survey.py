"""A fleet on disk: the recordings of each arm, the finished arms, and the work on the others.

The work on an arm is any function that takes an arm of the fleet and returns files. It may run in
processes of this machine or on a cluster.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager
import csv
from dataclasses import dataclass
from fnmatch import fnmatch
import glob
import hashlib
import itertools
import json
from pathlib import Path
import shlex
from typing import Any

from pneunet_ros.core.errors import PneunetError, RecordingError, RequestError
from pneunet_ros.core.printable import printable
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.files.json_text import json_text
from pneunet_ros.files.regular_file import open_regular, readable
from pneunet_ros.recordings.bag_folder import is_recording
from pneunet_ros.tables.header import delimiter

ROLES = ('unloaded', 'loaded', 'heldout')
ARM = 'arm.yaml'
COLUMNS = ('name', 'arm', *ROLES)
ARMS, ROW = 'arms', 'arm.json'  # folder of all arms in the output, and file with the row of an arm
MOST_BYTES = 10_000_000  # of a table of arms

Files = Mapping[str, bytes]  # by their path in the folder of the arm


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetArm:
    """An arm of a fleet: its name, arm file, and recordings by role (one of `ROLES`).

    ignored: recordings in its folder whose names contain no role.
    """

    name: str
    arm: Path
    roles: Mapping[str, tuple[Path, ...]]
    ignored: tuple[str, ...] = ()

    @property
    def recordings(self) -> tuple[Path, ...]:
        """All recordings."""
        return tuple(itertools.chain(*(self.roles[role] for role in ROLES)))


def read_fleet(source: Path, arm: Path) -> tuple[FleetArm, ...]:
    """Return the arms of a fleet.

    Args:
        source: a folder with one folder per arm, or a CSV table with one row per arm.
        arm: the arm file of arms without one of their own.

    Returns:
        The arms, sorted by name for a folder, in the order of the rows for a table.

    Raises:
        RequestError: there is no arm, or the table is invalid.
    """
    if not source.exists():
        raise RequestError(
            f'{source} does not exist: give a folder of arms or a table of arms',
            reason='not_found',
        )
    fleet = fleet_of_folder(source, arm) if source.is_dir() else fleet_of_table(source, arm)
    if not fleet:
        raise RequestError(
            f'{source} contains no arm: an arm is a folder with recordings whose names begin '
            f'with {", ".join(ROLES)}',
            reason='no_arm',
        )
    return fleet


def folders_left_out(source: Path, fleet: Sequence[FleetArm]) -> tuple[str, ...]:
    """Return the names of folders in a source that contain no arm."""
    if not source.is_dir():
        return ()
    arms = {arm.name for arm in fleet}
    names = sorted(path.name for path in source.iterdir() if path.is_dir())
    return tuple(printable(name) for name in names if name not in arms and name[0] != '.')


def fleet_of_folder(folder: Path, arm: Path) -> tuple[FleetArm, ...]:
    """Return the arms in a folder: each subfolder with an arm file or recordings of a role."""
    shared = folder / ARM
    found = []
    for entry in sorted(folder.iterdir()):
        if not entry.is_dir() or entry.name.startswith('.'):
            continue
        roles = {role: recordings_of(entry, role) for role in ROLES}
        own_file = entry / ARM
        if not any(roles.values()) and not own_file.is_file():
            continue
        known = {path for paths in roles.values() for path in paths}
        ignored = [item for item in recordings_in(entry) if item not in known]
        found.append(
            FleetArm(
                name=entry.name,
                arm=next((file for file in (own_file, shared) if file.is_file()), arm),
                ignored=tuple(printable(item.name) for item in ignored),
                roles=roles,
            )
        )
    return tuple(found)


def recordings_of(folder: Path, role: str) -> tuple[Path, ...]:
    """Return the recordings of a role, named by the prefix of their name or of their folder's.

    Case is ignored.
    """
    found: list[Path] = []
    for path in sorted(folder.iterdir()):
        if not path.name.lower().startswith(role):
            continue
        if is_recording(path):
            found.append(path)
        elif path.is_dir():
            found += recordings_in(path)
    return tuple(found)


def recordings_in(folder: Path) -> list[Path]:
    """Return the recordings in a folder."""
    return [path for path in sorted(folder.iterdir()) if is_recording(path)]


def fleet_of_table(table: Path, arm: Path) -> tuple[FleetArm, ...]:
    """Return the arms in a table: paths relative to the table, with patterns as in a shell."""
    found, names = [], set()
    for line, row in rows_of(table):
        name = row['name']
        if not name or name in ('.', '..') or '/' in name or printable(name) != name:
            raise RequestError(
                f'{table}, line {line}: {name!r} cannot be the name of a folder',
                reason='wrong_name',
            )
        if name.startswith('#'):
            raise RequestError(
                f'{table}, line {line}: {name!r} looks like a comment, but comments stand only '
                'above the columns: delete this row, or rename the arm',
                reason='wrong_name',
            )
        if name in names:
            raise RequestError(
                f'{table}, line {line}: there are two arms with the name {name}',
                reason='given_twice',
            )
        names.add(name)
        try:
            roles = {role: expand_paths(row.get(role, ''), table.parent) for role in ROLES}
        except ValueError as error:
            raise RequestError(f'{table}, line {line}: {error}', reason='wrong_form') from error
        arm_file = row.get('arm', '')
        found.append(
            FleetArm(name=name, arm=table.parent / arm_file if arm_file else arm, roles=roles)
        )
    return tuple(found)


def rows_of(table: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the rows of a table of arms with line numbers; skips comments (#) above it."""
    try:
        with open_regular(table) as stream:
            text = stream.read(MOST_BYTES + 1).decode('utf-8-sig')
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(
            f'{table} cannot be read as a table of arms: {error}', reason='unreadable'
        ) from error
    if len(text) > MOST_BYTES:
        raise RequestError(
            f'{table} has more than {MOST_BYTES // 10**6} MB: it is not a table of arms',
            reason='too_large',
        )
    lines = text.splitlines()
    skipped = len(
        list(itertools.takewhile(lambda line: not line.strip() or line[0] == '#', lines))
    )
    mark = delimiter(lines[skipped]) if skipped < len(lines) else ','
    reader = csv.DictReader(lines[skipped:], strict=True, skipinitialspace=True, delimiter=mark)
    try:
        names = [str(name).strip().lower() for name in reader.fieldnames or ()]
        reader.fieldnames = names
        if 'name' not in names or not set(names) <= set(COLUMNS):
            raise RequestError(
                f'{table}: the columns of a table of arms are {", ".join(COLUMNS)}, of which name '
                f'is required; this table has {", ".join(names[: len(COLUMNS) + 3]) or "none"}',
                reason='unknown_column',
            )
        for row in reader:
            if None in row or None in row.values():
                raise RequestError(
                    f'{table}, line {skipped + reader.line_num}: the number of cells is not that '
                    'of the columns',
                    reason='wrong_shape',
                )
            yield skipped + reader.line_num, {key: value.strip() for key, value in row.items()}
    except csv.Error as error:
        raise RequestError(
            f'{table}, line {skipped + reader.line_num + 1}: {error}', reason='damaged'
        ) from error


def expand_paths(cell: str, folder: Path) -> tuple[Path, ...]:
    """Return the recordings in a cell: names separated by blanks, quoted if needed."""
    found: list[Path] = []
    for word in shlex.split(cell):
        matches = sorted(glob.glob(word, root_dir=folder))
        found += [folder / match for match in matches or [word]]
    return tuple(found)


def arm_key(arm: FleetArm, decided: Mapping[str, Any]) -> tuple[str, list[dict[str, str]]]:
    """Return a key that identifies the work on an arm, and the recordings with their hashes.

    decided: all other inputs that affect the outcome. RecordingError if a file cannot be read.
    """
    from pneunet_ros.offline.calibration_files import inputs_of

    inputs = inputs_of([(role, arm.roles[role]) for role in ROLES])
    with readable(arm.arm) as stream:
        model = hashlib.sha256(stream.read()).hexdigest()
    content = json_text({'arm': model, 'inputs': inputs, 'decided': decided})
    return hashlib.sha256(content.encode()).hexdigest(), inputs


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyFolder:
    """The output of a survey: a folder per finished arm, each written atomically."""

    path: Path
    overwrite: bool

    def check(self, pages: Sequence[str]) -> None:
        """Reject a folder with foreign files; pages: patterns of the survey's own files."""
        if self.path.exists() and not self.path.is_dir():
            raise RecordingError(f'{self.path} is a file, not a folder', reason='wrong_kind')
        for path in sorted(self.path.iterdir()) if self.path.is_dir() else ():
            if path.name != ARMS and not any(fnmatch(path.name, name) for name in pages):
                raise RecordingError(
                    f'{self.path} contains {path.name}, which was not written by a survey: '
                    'choose another folder',
                    reason='holds_other_files',
                )

    def folder(self, name: str) -> Path:
        """Return the folder of an arm."""
        return self.path / ARMS / name

    def finished_row(self, name: str, key: str) -> dict[str, Any] | None:
        """Return the row of a finished arm; None if the arm must be processed.

        Raises RecordingError if it was processed with other recordings, another arm file or other
        options, unless outputs may be replaced. An arm that failed with other inputs is simply
        processed again.
        """
        row = self.row(name)
        if row is None:
            return None
        if row.get('key') == key:
            return row
        if row.get('failed') or self.overwrite:
            return None
        raise RecordingError(
            f'{self.folder(name)} was made from other recordings, with another arm file, other '
            'options or another version: choose another --output, or pass --overwrite to '
            'process this arm again',
            reason='other_inputs',
        )

    def row(self, name: str) -> dict[str, Any] | None:
        """Return the written row of an arm, or None."""
        file = self.folder(name) / ROW
        try:
            content = json.loads(file.read_text(encoding='utf-8'))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise RecordingError(
                f'{file} is damaged: remove its folder ({error})', reason='damaged'
            ) from error
        if not isinstance(content, dict):
            raise RecordingError(f'{file} is damaged: remove its folder', reason='damaged')
        return content

    def write(self, name: str, files: Files, row: Mapping[str, Any]) -> None:
        """Write the files of an arm and its row, replacing any earlier ones."""
        earlier = self.folder(name)
        written = [item.name for item in earlier.iterdir()] if earlier.is_dir() else []
        with atomic_output(earlier, overwrite=True, replaceable=written) as folder:
            folder.mkdir()
            for file, content in files.items():
                (folder / file).parent.mkdir(exist_ok=True)
                (folder / file).write_bytes(content)
            (folder / ROW).write_text(json_text(row, indent=1), encoding='utf-8')


Outcome = tuple[FleetArm, Files | Exception]
Work = Callable[[FleetArm], Files]
OpenWorkers = Callable[[], AbstractContextManager[Executor]]


def work_on_fleet(
    arms: Sequence[FleetArm], work: Work, open_workers: OpenWorkers, concurrency: int
) -> Iterator[Outcome]:
    """Yield the result of each arm as it finishes.

    A process that dies ends all others of its pool, so the arms in progress are processed again
    one by one: an arm whose process dies when it runs alone is the cause, and the others continue.

    Args:
        arms: the arms of the fleet.
        work: the function to apply to each; it must be picklable.
        open_workers: returns new workers.
        concurrency: number of arms submitted at a time.

    Yields:
        The arm, and its files or the exception that was raised.
    """
    pending = list(arms)
    while pending:
        suspects, pending = yield from work_concurrently(pending, work, open_workers, concurrency)
        for arm in suspects:
            died, _ = yield from work_concurrently([arm], work, open_workers, 1)
            for one in died:
                why = 'its process died unexpectedly, possibly because memory ran out'
                yield one, ChildProcessError(why)


def work_concurrently(
    arms: Sequence[FleetArm], work: Work, open_workers: OpenWorkers, concurrency: int
) -> Generator[Outcome, None, tuple[list[FleetArm], list[FleetArm]]]:
    """Yield the results of arms until all are done or a process dies.

    Returns the arms in progress at that time, and the arms that were not started.
    """
    pending, suspects = deque(arms), list[FleetArm]()
    running: dict[Future[Files], FleetArm] = {}
    with open_workers() as executor:
        try:
            while running or (pending and not suspects):
                while pending and not suspects and len(running) < concurrency:
                    running[executor.submit(work, pending[0])] = pending[0]
                    pending.popleft()
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    arm, error = running.pop(future), future.exception()
                    if isinstance(error, BrokenExecutor):
                        suspects.append(arm)
                    elif error is not None and not isinstance(error, Exception):
                        raise error
                    else:
                        yield arm, future.result() if error is None else error
        except BrokenExecutor:  # detected while submitting work
            suspects += running.values()
        finally:
            for future in running:
                future.cancel()
    return suspects, list(pending)


def sentence_of(error: Exception) -> str:
    """Describe the error of an arm, with its type if the error is not ours."""
    if isinstance(error, (PneunetError, ChildProcessError)):
        return str(error)
    return f'{type(error).__name__}: {" ".join(str(error).split())}'
