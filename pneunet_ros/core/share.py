"""Location of files that the package ships: model files, recordings, launch files."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import sys

from pneunet_ros.core.errors import PneunetError

SHARE = Path('share', 'pneunet_ros')


def share_path(relative: str) -> Path:
    """Return the path of a shipped file or folder, e.g. 'config/paper_arm.yaml'."""
    folders = list(dict.fromkeys(_folders()))
    for folder in folders:
        if (folder / relative).exists():
            return folder / relative
    raise PneunetError(
        f'the shipped file {relative} is missing; looked in {", ".join(map(str, folders))}; '
        'install pneunet_ros again',
        reason='not_found',
    )


def _folders() -> Iterator[Path]:
    """Return possible folders of shipped files: the checkout, or the prefix of any package."""
    package = Path(__file__).resolve().parent.parent
    if (package.parent / 'package.xml').is_file():
        yield package.parent
    # <prefix>/lib/python3.x/site-packages/pneunet_ros, or <target>/pneunet_ros
    yield from (parent / SHARE for parent in package.parents[:4] if (parent / SHARE).is_dir())
    yield Path(sys.prefix) / SHARE
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        if prefix:
            yield Path(prefix) / SHARE
