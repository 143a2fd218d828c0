"""The pages: links lead somewhere, commands can be given so, symbols stand where it says."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
import re
import shlex

from pneunet_ros.cli.main import parser, VERBS
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.effects import EFFECTS
from pneunet_ros.fusion.causes import CAUSES
import pytest
from support.manuals import table
from support.page_commands import blocks_of, DOCS, PAGES

ROOT = Path(__file__).resolve().parents[2]
MODEL = (ROOT / 'docs/model.md').read_text(encoding='utf-8')
MOST_WORDS = 30_000  # what is added takes something else away; tables go to acceptance/
every_page = pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)


def links(page):
    """Files that a page links."""
    found = re.findall(r'\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)', page.read_text(encoding='utf-8'))
    return [page.parent / link for link in found]


@every_page
def test_linked_files_exist(page):
    assert [link for link in links(page) if not link.exists()] == []


def test_the_index_leads_to_every_page():
    index = {link.resolve() for link in links(ROOT / 'docs/README.md')}
    assert {page for page in DOCS if page.stem != 'README'} <= index
    assert (ROOT / 'docs/README.md') in links(ROOT / 'README.md')


def test_the_pages_are_short_enough_to_be_read():
    read = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *DOCS]
    assert sum(len(page.read_text(encoding='utf-8').split()) for page in read) <= MOST_WORDS


def test_the_page_of_tables_has_all_units():
    page = (ROOT / 'docs/recordings.md').read_text(encoding='utf-8')
    lists = [set(words.split()) for words in re.findall(r'`([^`\n]+)`', page)]
    for kind, units in SI_PER_UNIT.items():
        if kind != 'pressure':  # its units are those of the sensor, above
            assert set(units) in lists, kind


def named_in(page, heading):
    """Names in backticks in the first column of the first table below a heading of a page."""
    text = (ROOT / page).read_text(encoding='utf-8').partition(f' {heading}\n')[2]
    (below, *_) = re.findall(r'\n\n(\|.*?)\n\n', text, re.DOTALL)
    return [
        name for row in below.splitlines() for name in re.findall(r'`(\w+)`', row.split('|')[1])
    ]


def test_every_effect_and_every_cause_of_the_fusion_has_a_row():
    assert named_in('docs/model.md', 'Effects') == list(EFFECTS)
    assert sorted(named_in('docs/fusion.md', 'Causes')) == sorted(item.name for item in CAUSES)


def commands(page):
    """Commands of `pneunet` in the blocks of a page."""
    for block in blocks_of(page):
        if block.kind in ('sh', 'console'):
            for line in block.commands:
                # What stands behind `||` says that the answer of the command is negative.
                words = shlex.split(line.partition('||')[0])
                if words[0] == 'pneunet':
                    yield words[1:]


@every_page
def test_commands_can_be_given_so(page):
    """Names and options are those of the verbs; whether files are there is another matter."""
    for words in commands(page):
        said = io.StringIO()
        try:
            with contextlib.redirect_stderr(said):
                parser(words).parse_args(words)
        except SystemExit:
            pytest.fail(f'{page.name}: pneunet {" ".join(words)}: {said.getvalue()}')


def test_verbs_are_shown_in_use():
    shown = {words[0] for page in PAGES for words in commands(page)}
    assert {verb.name for verb in VERBS} - shown <= {'demo', 'export', 'import'}


@every_page
def test_commands_in_a_text_name_verbs_and_options_that_exist(page):
    """Those with placeholders, too: `pneunet import TABLE.csv --output REC.mcap`."""
    verbs = {verb.name for verb in VERBS}
    text = re.sub(r'^```.*?^```$', '', page.read_text(encoding='utf-8'), flags=re.M | re.S)
    for command in re.findall(r'`pneunet ([^`]+)`', text.replace('\n', ' ')):
        verb, *words = command.split()
        if verb in ('VERB', '--version'):
            continue
        assert verb in verbs, command
        known = options_of(verb)
        for word in words:
            if word.startswith('--'):
                assert word in known, command


def options_of(verb):
    """Return the options of a verb."""
    (verbs,) = (item for item in parser([verb])._actions if isinstance(item.choices, dict))
    return verbs.choices[verb]._option_string_actions


@every_page
def test_scripts_that_a_page_names_are_there(page):
    """Benches and blind trials take minutes to hours: pages name them, and no test runs them."""
    for script in re.findall(r'`python (\S+?\.py)', page.read_text(encoding='utf-8')):
        assert (ROOT / script).is_file(), script


SYMBOLS = table(MODEL, 'symbol')


@pytest.mark.parametrize('row', SYMBOLS, ids=lambda row: row[0])
def test_a_symbol_stands_where_the_page_says(row):
    _, _, names, _, files = row
    files = [ROOT / 'pneunet_ros' / file.strip(' `') for file in files.split(',')]
    text = '\n'.join(file.read_text(encoding='utf-8') for file in files)
    for name in names.split(','):
        assert re.search(rf'\b{name.strip(" `")}\b', text), (name, files)


def test_the_equations_use_no_symbol_that_is_not_in_the_table():
    known = {symbol.strip() for row in SYMBOLS for symbol in row[0].split(',')}
    known |= {'r', 't', 'M_est', 'cos', 'sin', 'x', 'y', 'n1', 'n2', 'EA', 'theta', 'kappa'}
    (section,) = re.findall(r'## Equations\n(.*?)### Effects', MODEL, re.DOTALL)
    lines = [line for line in section.splitlines() if line.startswith('    ')]
    assert len(lines) >= 9
    for line in lines:
        equation = re.split(r'  +Eq|   +', line.strip())[0]
        for word in re.findall(r'[A-Za-z_][A-Za-z_0-9]*', equation):
            assert word in known, line


def test_what_the_tour_names_is_there():
    named = re.findall(r'`([\w/]+\.py):(\w+)`', (ROOT / 'CONTRIBUTING.md').read_text())
    assert len(named) > 20
    for file, name in named:
        text = (ROOT / 'pneunet_ros' / file).read_text()
        assert re.search(rf'^ *(def|class) {name}\b', text, re.M), f'{file}: {name}'


def test_every_table_that_an_extension_adds_a_line_to_is_there():
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    named = set(re.findall(r'`([A-Z][A-Z_]{3,})`', text))
    assert {'SENSORS', 'SOURCES', 'VERBS'} <= named
    files = (ROOT / 'pneunet_ros').rglob('*.py')
    package = '\n'.join(path.read_text(encoding='utf-8') for path in files)
    made = set(re.findall(r'^([A-Z][A-Z_]{3,})\b[^=\n]*= ', package, re.M))
    assert named <= made
