"""Paths followed through their links, the one place where a path that leads nowhere is met."""

from __future__ import annotations

from pathlib import Path

from pneunet_ros.core.errors import PneunetError, RequestError


def resolved(path: str | Path, error: type[PneunetError] = RequestError) -> Path:
    """Return the absolute path behind all links; it need not exist.

    Raises `error` for a link that leads to itself, a name that no file can have, and a folder
    that may not be looked into.
    """
    try:
        return Path(path).resolve()
    except RuntimeError:  # Python before 3.13, of a loop of links
        raise error(
            f'{path} leads back to itself by a link: name the file itself', reason='loop'
        ) from None
    except (OSError, ValueError) as reason:
        why = getattr(reason, 'strerror', None) or reason
        raise error(f'{path} cannot be found: {why}', reason='not_found') from reason
