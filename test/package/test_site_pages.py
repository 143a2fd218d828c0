"""Pages that the site makes from the code: nothing is missing, and links lead somewhere."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
import posixpath
import re
import sys

import pneunet_ros
from pneunet_ros.cli.main import VERBS
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
import pytest

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r'\]\((?!https?:|#)([^)#\s]+)')


@pytest.fixture(scope='module')
def site():
    """Import docs/site_pages.py."""
    sys.path.insert(0, str(ROOT / 'docs'))
    return importlib.import_module('site_pages')


@pytest.fixture(scope='module')
def pages(site):
    """Return the pages that are made, by their place in the folder of the pages."""
    return site.site_pages(ROOT / 'docs')


def test_every_verb_stands_there_with_its_options(pages):
    page = pages['generated/commands.md']
    for verb in VERBS:
        assert f'## {verb.name}\n\n```text\nusage: pneunet {verb.name} ' in page
    assert '--heldout REC' in page
    assert '--wrench-yaw RAD' in page


def test_every_effect_stands_there_with_its_parameters(pages):
    page = pages['generated/effects.md']
    for effect in EFFECTS.values():
        (section,) = re.findall(rf'^## {effect.name}\n(.*?)(?=^## |\Z)', page, re.M | re.S)
        assert effect.meaning in section
        for item in quantities(effect):
            assert f'| `{item.name}` |' in section


def test_every_number_of_a_model_file_stands_there(pages):
    page = pages['generated/files.md']
    for key in ('arm.length', 'arm.tip_cap', 'moment_law (majidi).modulus', 'sensors.drift_std'):
        assert f'| `{key}` |' in page
    assert (ROOT / 'config/camera.yaml').read_text(encoding='utf-8') in page


def test_every_number_that_decides_stands_there(pages):
    """Counted in the source: each call of `tuning` is a row."""
    calls = 0
    for file in (ROOT / 'pneunet_ros').rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                calls += node.func.id == 'tuning'
    rows = re.findall(r'^\| `\w+` \|', pages['generated/settings.md'], re.M)
    assert len(rows) == calls > 100


def test_every_reason_stands_there_once(site, pages):
    rows = re.findall(r'^\| `(\w+)` \|', pages['generated/reasons.md'], re.M)
    assert rows == sorted(site.REASONS)


def test_every_public_name_stands_there(pages):
    page = pages['generated/api.rst']
    listed = re.findall(r'^\.\. auto(?:class|function):: (\w+)$', page, re.M)
    assert sorted(listed) == sorted(pneunet_ros.__all__)


def test_the_tree_of_the_site_has_every_page(pages):
    trees = re.findall(r'```\{toctree\}.*?```', pages['index.md'], re.S)
    listed = {
        line for tree in trees for line in tree.splitlines() if line.endswith(('.md', '.rst'))
    }
    written = {page.name for page in (ROOT / 'docs').glob('*.md')} - {'README.md', 'index.md'}
    made = {name for name in pages if name.endswith(('.md', '.rst'))} - {'index.md'}
    assert listed == written | made


def test_no_link_leads_out_of_the_site(site, pages):
    """Rosdoc2 builds a copy of docs/ alone: what a page links to must be in there."""
    pages = {
        **{
            page.name: site.with_links_of_the_site(
                page.read_text(encoding='utf-8'), f'docs/{page.name}', 'docs'
            )
            for page in (ROOT / 'docs').glob('*.md')
        },
        **pages,
    }
    for name, text in pages.items():
        for link in LINK.findall(text):
            file = posixpath.normpath(posixpath.join(posixpath.dirname(name), link))
            assert not file.startswith('..'), (name, link)
            assert file in pages or (ROOT / 'docs' / file).exists(), (name, link)


@pytest.mark.parametrize(
    ('page', 'folder', 'link', 'turned'),
    [
        ('README.md', 'docs/generated', 'docs/model.md', '../model.md'),
        ('README.md', 'docs/generated', 'CONTRIBUTING.md', 'contributing.md'),
        ('README.md', 'docs/generated', 'docs/README.md', '../index.md'),
        ('docs/time.md', 'docs', 'model.md', 'model.md'),
        ('docs/time.md', 'docs', '../bags/lab_day/README.md', 'generated/bag_lab_day.md'),
        ('docs/model.md', 'docs', '../config/paper_arm.yaml', 'generated/paper_arm.yaml'),
        ('README.md', 'docs/generated', 'LICENSE', 'LICENSE'),
    ],
)
def test_a_link_leads_to_where_the_site_has_the_file(site, page, folder, link, turned):
    text = site.with_links_of_the_site(f'[a]({link}#b) [c](https://d/e)', page, folder)
    assert text == f'[a]({turned}#b) [c](https://d/e)'
