"""What README.md promises a new user; that its commands run is in test_page_commands."""

from __future__ import annotations

from pathlib import Path
import re

from pneunet_ros.cli.main import VERBS
import pytest
from support.page_commands import PAGES

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / 'README.md').read_text(encoding='utf-8')
TARGETS = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))


@pytest.mark.parametrize('verb', VERBS, ids=lambda verb: verb.name)
def test_every_verb_is_documented(verb) -> None:
    assert re.search(rf'pneunet {verb.name}\b|make {verb.name}\b', README)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_make_targets_exist(page) -> None:
    named = re.findall(
        r'(?:`|^)make ([a-z][a-z-]*)', page.read_text(encoding='utf-8'), re.MULTILINE
    )
    assert set(named) <= TARGETS


def test_the_targets_of_the_contract_are_there() -> None:
    assert {'setup', 'demo', 'live', 'test', 'quick', 'bench', 'check', 'docs'} <= TARGETS


def test_the_moving_picture_is_small_and_on_the_first_screen() -> None:
    (line,) = (place for place, text in enumerate(README.splitlines()) if 'film.webp' in text)
    assert line < 15
    assert (ROOT / 'docs/images/film.webp').stat().st_size < 400_000
