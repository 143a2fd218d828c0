"""Draw docs/images/tracking_page.webp: the page of `track --preview` as Chromium shows it.

Run it from the root of the checkout: python docs/images/make_tracking_page.py
"""

from __future__ import annotations

from pathlib import Path
import subprocess
import tempfile

from PIL import Image
from pneunet_ros.cli.main import main

FRAME = 11  # in which a hand covers a part of the arm
SIZE = 900, 1480  # px
HERE = Path(__file__).resolve().parent


def draw(folder: Path) -> None:
    """Replay, track, open the page, and keep what it looks like."""
    estimates, page, shot = (folder / name for name in ('out.mcap', 'page.html', 'page.png'))
    replay = ['replay', 'bags/camera_demo', '--no-wrench-required', '--output', str(estimates)]
    track = ['track', 'bags/camera_demo', '--estimates', str(estimates), '--preview', str(page)]
    if main(replay) or main(track):
        raise SystemExit('nothing was replayed or tracked')
    subprocess.run(
        [
            'chromium', '--headless', '--no-sandbox', '--disable-gpu', '--hide-scrollbars',
            f'--user-data-dir={folder / "profile"}', '--virtual-time-budget=3000',
            f'--window-size={SIZE[0]},{SIZE[1]}', f'--screenshot={shot}',
            f'{page.as_uri()}#{FRAME}',
        ],
        check=True, capture_output=True,
    )  # fmt: skip
    Image.open(shot).convert('RGB').save(HERE / 'tracking_page.webp', quality=80)


if __name__ == '__main__':
    with tempfile.TemporaryDirectory() as name:
        draw(Path(name))
