"""Resolution of symbolic links in paths (only in this module), and sibling file names."""

from __future__ import annotations

from pathlib import Path

from pneunet_ros.core.errors import PneunetError, RequestError


def resolve_links(path: str | Path, error: type[PneunetError] = RequestError) -> Path:
    """Return the absolute path with all symbolic links resolved; the file need not exist.

    Raises `error` for a loop of links, an invalid file name, or a folder without read permission.
    """
    try:
        return Path(path).resolve()
    except RuntimeError:  # raised by Python before 3.13 for a loop of links
        raise error(
            f'{path} is a symbolic link to itself: use the path of the file', reason='loop'
        ) from None
    except (OSError, ValueError) as reason:
        why = getattr(reason, 'strerror', None) or reason
        raise error(f'{path} cannot be found: {why}', reason='not_found') from reason


def sibling_path(path: Path, name: str) -> Path:
    """Return the path of this name in the folder of another; RequestError if that has no name."""
    if path.name in ('', '..'):
        raise RequestError(
            f"'{path}' is a folder without a name: give the name of a file or folder",
            reason='wrong_name',
        )
    return path.with_name(name)
