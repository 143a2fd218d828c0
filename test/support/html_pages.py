"""HTML pages looked at: what they refer to, and what a real browser says of them."""

from __future__ import annotations

import html
from html.parser import HTMLParser
import json
from pathlib import Path
import re
import shutil
import subprocess

MAY_REFER = ('href', 'src', 'srcset', 'action', 'data', 'poster', 'background', 'formaction')
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
OWN = 'not an origin'  # initiator of what the browser asks for itself
QUIET = (
    '--headless', '--no-sandbox', '--disable-gpu', '--no-first-run', '--disable-sync',
    '--disable-background-networking', '--disable-component-update', '--disable-extensions',
    '--host-resolver-rules=MAP * ~NOTFOUND', '--enable-logging=stderr',
    '--virtual-time-budget=2000',
)  # fmt: skip

MEASURE = """
addEventListener('load', () => {
  const most = document.documentElement.clientWidth, beyond = [];
  for (const item of document.querySelectorAll('body *')) {
    let around = item.parentElement;
    while (around && getComputedStyle(around).overflowX === 'visible')
      around = around.parentElement;
    if (!around && item.getBoundingClientRect().right > most + 1)
      beyond.push(`${item.tagName} ${item.className} ${item.textContent.slice(0, 40)}`);
  }
  const width = document.documentElement.scrollWidth;
  parent.postMessage(JSON.stringify({ width, beyond }), '*');
});
"""
FRAME = """<!DOCTYPE html><meta name="color-scheme" content="light dark"><pre id="said"></pre>
<script>onmessage = (event) => {{ document.getElementById('said').textContent = event.data; }}
</script><iframe src="{page}" style="width: {width}px; height: 800px; border: 0"></iframe>"""


class Page(HTMLParser):
    """Collects what a page refers to, and its headings."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.tags: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in MAY_REFER:
                self.references.append(value or '')
            if name == 'id' and value:
                self.anchors.add(value)


def check_closed(text: str) -> None:
    """Check that nothing on a page leaves it, and that its own links lead somewhere."""
    page = Page(text)
    assert [item for item in page.references if not item.startswith(('data:', '#'))] == []
    assert not {'script', 'iframe', 'object', 'embed'} & set(page.tags)
    assert 'url(' not in text
    assert '@import' not in text
    assert "default-src 'none'" in text
    assert {item[1:] for item in page.references if item.startswith('#')} <= page.anchors


def browser() -> str | None:
    """Return the command of a Chromium; None where there is none."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def widest(page: Path, folder: Path, width: int, *, dark: bool = False) -> tuple[int, list[str]]:
    """Show a page in a frame of this width (px); return how wide it gets, and what sticks out.

    What stands in an element that scrolls or hides by itself does not stick out.
    """
    command = browser()
    assert command is not None
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', '', page.read_text('utf-8'))
    copy, frame = folder / 'copy.html', folder / 'frame.html'
    copy.write_text(text.replace('</head>', f'<script>{MEASURE}</script></head>'), 'utf-8')
    frame.write_text(FRAME.format(page=copy.as_uri(), width=width), 'utf-8')
    colors = ['--blink-settings=preferredColorScheme=0'] if dark else []
    done = subprocess.run(
        [
            command, *QUIET, '--hide-scrollbars', *colors, f'--user-data-dir={folder / "profile"}',
            f'--window-size={max(width, 600)},900', '--dump-dom', frame.as_uri(),
        ],
        capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip
    (said,) = re.findall(r'<pre id="said">(.*?)</pre>', done.stdout, re.DOTALL)
    measured = json.loads(html.unescape(said))
    return measured['width'], measured['beyond']


def opened(page: Path, folder: Path) -> tuple[list[str], list[str]]:
    """Open a page in Chromium; return what its console says, and what it asked the network for."""
    command = browser()
    assert command is not None
    log, picture = folder / 'net.json', folder / 'page.png'
    done = subprocess.run(
        [
            command, *QUIET, f'--user-data-dir={folder / "profile"}', f'--log-net-log={log}',
            '--window-size=1200,4000', f'--screenshot={picture}', page.resolve().as_uri(),
        ],
        capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip
    assert picture.stat().st_size > 1000
    console = re.findall(r'CONSOLE:\d+\] (.*)', done.stderr)
    events = [event.get('params', {}) for event in json.loads(log.read_text())['events']]
    asked = [item for item in events if item.get('initiator', OWN) != OWN]
    return console, [item['url'] for item in asked]
