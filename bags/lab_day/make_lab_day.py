"""Make the lab day: recordings of one virtual arm, each with its truth, from three scenarios.

The arm remembers the recording before. Every run makes the same readings and the same truth:

    python bags/lab_day/make_lab_day.py
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import tempfile

from pneunet_ros.cli.main import main as pneunet

FOLDER = Path(__file__).resolve().parent
NAMES = ('unloaded', 'loaded', 'heldout')  # in the order in which they were recorded


def make(folder: Path) -> None:
    """Write recordings and truth into a folder that has none of them, by `pneunet simulate`."""
    before: list[str] = []
    for name in NAMES:
        made = str(folder / f'{name}.mcap')
        command = ['simulate', str(FOLDER / f'{name}.yaml'), '--output', made, *before]
        if pneunet(command) != 0:
            raise SystemExit(f'{name} could not be made')
        before = ['--after', made]


def main() -> None:
    """Make the recordings beside this script, or where the command line says."""
    parser = argparse.ArgumentParser(description='Make the recordings of the lab day.')
    parser.add_argument('--output', type=Path, default=FOLDER)
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    # All of them take the place of the old ones when all are there.
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        make(Path(scratch))
        for file in Path(scratch).iterdir():
            os.replace(file, folder / file.name)


if __name__ == '__main__':
    main()
