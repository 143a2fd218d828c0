"""Files that are not recordings: their kinds by name, and the verbs that read them."""

from __future__ import annotations

from pathlib import Path

VIDEOS = ('.mp4', '.m4v', '.avi', '.mov', '.mkv', '.webm')
COMPRESSED = ('.png', '.jpg', '.jpeg')
PICTURES = (*COMPRESSED, '.bmp', '.tif', '.tiff')
TABLES = ('.csv', '.tsv')
NO_LENS = 'none'  # given instead of a file: images without distortion
FOLDER_RATE = 30.0  # Hz


def holds_pictures(folder: Path) -> bool:
    """Whether a folder holds images that `track` reads."""
    return any(file.suffix.lower() in PICTURES for file in folder.iterdir())


def recording_from(path: Path) -> str:
    """Describe how to make a recording from a path that is not a recording."""
    if path.suffix.lower() in VIDEOS or (path.is_dir() and holds_pictures(path)):
        return (
            'contains images: `pneunet track FILM --readings TABLE.csv --output REC.mcap` turns '
            'a film and a table of pressures into a recording'
        )
    if path.suffix.lower() in TABLES:
        return (
            'is a table: `pneunet import TABLE.csv --output REC.mcap` turns it into a recording; '
            'with a film, use `pneunet track FILM --readings TABLE.csv`'
        )
    films = ', '.join(VIDEOS)
    return (
        f'is not an MCAP file: `pneunet track` takes films ({films}) and folders of images, '
        '`pneunet import` tables, and `ros2 bag convert` converts other bags to MCAP'
    )
