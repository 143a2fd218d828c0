"""Make the picture of the README: that of `pneunet demo`, with fewer colors, so it is small."""

from __future__ import annotations

from pathlib import Path
import tempfile

from PIL import Image  # comes with matplotlib
from pneunet_ros.cli.main import main as pneunet

PICTURE = Path(__file__).resolve().parent / 'demo.png'
COLORS = 256


def main() -> None:
    """Run the demo and keep its picture."""
    with tempfile.TemporaryDirectory() as scratch:
        if pneunet(['demo', '--output', scratch]) != 0:
            raise SystemExit('the demo gave no picture')
        with Image.open(Path(scratch) / 'shapes.png') as drawn:
            palette = drawn.convert('RGB').quantize(COLORS, dither=Image.Dither.NONE)
    palette.save(PICTURE, optimize=True)


if __name__ == '__main__':
    main()
