"""Pages that only the site has: the index, the pages of the root, and the reference of the code.

Each function returns the text of one page, from the tables and dataclasses that the code itself
uses. Nothing here is written by hand twice.
"""

from __future__ import annotations

from collections.abc import Iterator
import csv
import dataclasses
from functools import partial
from importlib import import_module
import inspect
from pathlib import Path
import pkgutil
import posixpath
import re
from types import ModuleType
from typing import Any

import pneunet_ros
from pneunet_ros.cli.main import parser, VERBS
from pneunet_ros.cli.verbs.effects import PLACES
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.moment_law import MOMENT_LAWS
from pneunet_ros.model.uncertainty import SensorNoise
from reasons import REASONS

GENERATED = 'generated'
# Not the folder above the pages: rosdoc2 builds a copy of them elsewhere.
CHECKOUT = Path(pneunet_ros.__file__).resolve().parent.parent
# Pages that stand elsewhere in the checkout, and their names in the site.
ELSEWHERE = {
    'README.md': 'readme.md',
    'CONTRIBUTING.md': 'contributing.md',
    'QUALITY_DECLARATION.md': 'quality_declaration.md',
    'CHANGELOG.rst': 'changelog.rst',
    'bags/table1/README.md': 'bag_table1.md',
    'bags/lab_day/README.md': 'bag_lab_day.md',
    'bags/camera_demo/README.md': 'bag_camera_demo.md',
    **{
        f'acceptance/{page.name}': f'measured_{page.name}'
        for page in sorted((CHECKOUT / 'acceptance').glob('*.md'))
    },
}
# Files to which pages link: a link out of the folder of the pages would be dead in the site.
DOWNLOADS = (
    'CITATION.cff',
    'LICENSE',
    'config/camera.yaml',
    'config/estimator.yaml',
    'config/fusion.yaml',
    'config/gripper.yaml',
    'config/paper_arm.yaml',
    'config/tracker.yaml',
    'config/virtual_arm.yaml',
    'examples/soft_wall.py',
    'examples/tip_controller.py',
)
LINK = re.compile(r'\]\((?!https?:|#)([^)#\s]+)(#[^)\s]*)?\)')
HELP_WIDTH = 88  # characters
SECTION = re.compile(r'^## (.+)$', re.MULTILINE)
# Title -> what the file is, where the shipped one is, and whose numbers stand under which key.
FILES: dict[str, tuple[str, str, dict[str, type]]] = {
    'Model file': (
        'An actuator: what `calibrate` and `diagnose` write, and everything else reads.',
        'config/paper_arm.yaml',
        {
            'arm': Arm,
            **{f'moment_law ({kind})': law for kind, law in MOMENT_LAWS.items()},
            'sensors': SensorNoise,
        },
    ),
    'Camera file': (
        'The working plane, and how targets look: `track --camera`, `camera_file` of the tracker.',
        'config/camera.yaml',
        {},
    ),
    'Parameters of the estimator': ('For `--params-file`.', 'config/estimator.yaml', {}),
    'Parameters of the tracker': ('For `--params-file`.', 'config/tracker.yaml', {}),
    'Parameters of the fusion': ('For `--params-file`.', 'config/fusion.yaml', {}),
    'Parameters of a gripper': ('For `--params-file`.', 'config/gripper.yaml', {}),
    'Parameters of the virtual arm': ('For `--params-file`.', 'config/virtual_arm.yaml', {}),
}


def write_site_pages(docs: Path) -> None:
    """Write `index.md` and all of `generated/` into the folder of the pages."""
    (docs / GENERATED).mkdir(exist_ok=True)
    for name, text in site_pages(docs).items():
        file = docs / name
        # A page that has not changed is not built again.
        if not file.exists() or file.read_text(encoding='utf-8') != text:
            file.write_text(text, encoding='utf-8')


def site_pages(docs: Path) -> dict[str, str]:
    """Return the pages and files that only the site has, by their place in `docs`."""
    reference = {
        f'{GENERATED}/commands.md': commands_page(),
        f'{GENERATED}/effects.md': effects_page(),
        f'{GENERATED}/files.md': files_page(),
        f'{GENERATED}/settings.md': settings_page(),
        f'{GENERATED}/reasons.md': reasons_page(),
        f'{GENERATED}/api.rst': api_page(),
    }
    moved = {}
    for page, name in ELSEWHERE.items():
        text = (CHECKOUT / page).read_text(encoding='utf-8')
        moved[f'{GENERATED}/{name}'] = with_links_of_the_site(text, page, f'docs/{GENERATED}')
    copied = {
        f'{GENERATED}/{posixpath.basename(file)}': (CHECKOUT / file).read_text(encoding='utf-8')
        for file in DOWNLOADS
    }
    index = index_page((docs / 'README.md').read_text(encoding='utf-8'), list(reference))
    return {**reference, **moved, **copied, 'index.md': index}


def with_links_of_the_site(text: str, page: str, folder: str) -> str:
    """Return the text of a page whose relative links lead to where the site has these files.

    page: where the text stands in the checkout. folder: where the site has it, in the checkout.
    """

    def moved(match: re.Match[str]) -> str:
        link, anchor = match.groups()
        file = posixpath.normpath(posixpath.join(posixpath.dirname(page), link))
        if file in ('docs', 'docs/README.md'):
            file = 'docs/index.md'
        elif file in ELSEWHERE:
            file = f'docs/{GENERATED}/{ELSEWHERE[file]}'
        elif file in DOWNLOADS:
            file = f'docs/{GENERATED}/{posixpath.basename(file)}'
        return f']({posixpath.relpath(file, folder)}{anchor or ""})'

    return LINK.sub(moved, text)


def index_page(readme: str, reference: list[str]) -> str:
    """Return the index: docs/README.md, and its links again as the tree of the site."""
    text = with_links_of_the_site(readme, 'docs/README.md', 'docs')
    made = '\n'.join(f'- []({name})' for name in reference)
    text = text.replace('## Reference\n', f'## Reference\n\n{made}')
    sections = SECTION.split(text)
    trees = [
        f'```{{toctree}}\n:hidden:\n:caption: {title}\n\n{listed}\n```\n'
        for title, content in zip(['Start', *sections[1::2]], sections[::2], strict=True)
        if (listed := '\n'.join(link for link, _ in LINK.findall(content)))
    ]
    for title, prefix in (('Shipped recordings', 'bag_'), ('Measurements', 'measured_')):
        listed = '\n'.join(
            f'{GENERATED}/{name}' for name in ELSEWHERE.values() if name.startswith(prefix)
        )
        trees.append(f'```{{toctree}}\n:hidden:\n:caption: {title}\n\n{listed}\n```\n')
    return '\n'.join([text, *trees])


def commands_page() -> str:
    """Return every verb with what `pneunet VERB --help` says."""
    parts = [
        '# Commands\n',
        'What `pneunet VERB --help` prints. Exit codes of every verb: 0 done; 1 done, and the\n'
        'answer is negative; 2 the request or a file was wrong.\n\n'
        'Completion with the tab key, in bash and zsh: install the extra `completion`\n'
        '(argcomplete), and put `eval "$(register-python-argcomplete pneunet)"` into the\n'
        'file that your shell reads at its start.\n',
    ]
    for verb in VERBS:
        said = _help_of(verb.name)
        parts.append(f'## {verb.name}\n\n```text\n{said}```\n')
    return '\n'.join(parts)


def _help_of(verb: str) -> str:
    """Return the help of a verb."""
    (subparsers,) = (
        action for action in parser([verb])._actions if isinstance(action.choices, dict)
    )
    assert isinstance(subparsers.choices, dict)
    options = subparsers.choices[verb]
    # As wide whatever terminal the pages are built in.
    options.formatter_class = partial(options.formatter_class, width=HELP_WIDTH)
    text: str = options.format_help()
    return text


def effects_page() -> str:
    """Return every effect with its parameters."""
    parts = [
        '# Effects\n',
        'What a model file may hold under `effects:`, in the order in which they act. An effect\n'
        'at its neutral value changes nothing. How to add one: [Extending](../extending.md).\n',
    ]
    for effect in EFFECTS.values():
        parts.append(f'## {effect.name}\n')
        parts.append(f'{effect.meaning}. Place: {effect.place} ({PLACES[effect.place]}).\n')
        rows = [
            [
                f'`{item.name}`',
                item.metadata['meaning'],
                item.metadata['unit'],
                f'{item.default:g}',
                _interval(item.metadata['bounds']),
                _interval(item.metadata['prior']),
            ]
            for item in quantities(effect)
        ]
        parts.append(_table(['parameter', 'meaning', 'unit', 'neutral', 'allowed', 'prior'], rows))
    return '\n'.join(parts)


def reasons_page() -> str:
    """Return every reason with its meaning."""
    rows = [[f'`{name}`', meaning] for name, meaning in sorted(REASONS.items())]
    return '\n'.join(
        [
            '# Reasons\n',
            'Why a command was refused (`reason` of `--json`), a reading dropped (diagnostics,\n'
            '`rejected`), or a frame not used. Sentences may change, these words do not.\n',
            _table(['reason', 'meaning'], rows),
        ]
    )


def files_page() -> str:
    """Return the files that people write: the shipped ones, and what the code allows in them."""
    parts = [
        '# File formats\n',
        'All are YAML in SI units; an unknown key is an error that names the known ones. These\n'
        'are the shipped files, with their comments. Other formats:\n'
        '[recordings and tables](../recordings.md), [scenarios](../lab.md).\n',
    ]
    for title, (about, file, owners) in FILES.items():
        text = (CHECKOUT / file).read_text(encoding='utf-8')
        parts.append(f'## {title}\n\n{about}\n\n`{file}`:\n\n```yaml\n{text}```\n')
        for key, owner in owners.items():
            rows = [
                [
                    f'`{key}.{item.name}`',
                    item.metadata['meaning'],
                    item.metadata['unit'],
                    _interval(item.metadata['bounds']),
                ]
                for item in quantities(owner)
            ]
            if rows:
                parts.append(_table(['key', 'meaning', 'unit', 'allowed'], rows))
    return '\n'.join(parts)


def settings_page() -> str:
    """Return every number by which an algorithm decides, with its meaning and its source."""
    parts = [
        '# Numbers that decide\n',
        'Every number by which an algorithm decides, from the settings dataclasses of the code.\n'
        '"Invented" means that somebody chose it: no measurement and no paper stands behind it.\n',
    ]
    swept = sweep_results()
    for owner in settings_classes():
        room = owner.__module__.removeprefix('pneunet_ros.')
        parts.append(f'## {owner.__name__} (`{room}`)\n')
        about = (owner.__doc__ or '').strip().split('\n\n')[0].replace('\n', ' ')
        parts.append(f'{" ".join(about.split())}\n')
        rows = [
            [
                f'`{item.name}`',
                item.metadata['meaning'],
                f'{item.default:g}' if isinstance(item.default, float) else str(item.default),
                item.metadata['used_unit'],
                swept[owner.__name__, item.name]
                if item.metadata['from'] == 'sweep'
                else item.metadata['from'],
            ]
            for item in _tunings(owner)
        ]
        parts.append(_table(['setting', 'meaning', 'value', 'unit', 'source'], rows))
    return '\n'.join(parts)


def sweep_results() -> dict[tuple[str, ...], str]:
    """Return what moved when a number was halved and doubled, by class and field."""
    with (CHECKOUT / 'acceptance' / 'sweep.csv').open(encoding='utf-8', newline='') as table:
        return {
            tuple(row['number'].split('.')): f'halved: {row["halved"]}; doubled: {row["doubled"]}'
            for row in csv.DictReader(table)
        }


def settings_classes() -> list[type]:
    """Return the dataclasses of the package that declare numbers that decide, room by room."""
    found: dict[type, None] = {}
    for module in _modules():
        for value in vars(module).values():
            if isinstance(value, type) and value.__module__ == module.__name__ and _tunings(value):
                found.setdefault(value)
    return list(found)


def _tunings(owner: type) -> list[dataclasses.Field[Any]]:
    if not dataclasses.is_dataclass(owner):
        return []
    own = inspect.get_annotations(owner)  # a number stands where it is declared
    return [
        item for item in dataclasses.fields(owner) if 'from' in item.metadata and item.name in own
    ]


def _modules() -> Iterator[ModuleType]:
    """Yield the modules of the package that need no ROS."""
    for info in pkgutil.walk_packages(pneunet_ros.__path__, 'pneunet_ros.'):
        if '.nodes' not in info.name and not info.name.endswith('__main__'):
            yield import_module(info.name)


def api_page() -> str:
    """Return the public names, for autodoc to fill in."""
    parts = [
        'Python API\n==========\n',
        'All that ``from pneunet_ros import ...`` gives. SI units, angles in rad, arrays of\n'
        'float64; the base frame is in :doc:`../units`. Everything else in the package may\n'
        'change at any time.\n',
        '.. currentmodule:: pneunet_ros\n',
    ]
    values = {name: getattr(pneunet_ros, name) for name in pneunet_ros.__all__}
    for title, classes in (('Functions', False), ('Classes', True)):
        parts.append(f'{title}\n{"-" * len(title)}\n')
        for name, value in values.items():
            if isinstance(value, type) is not classes:
                continue
            members = '\n   :members:' if classes else ''
            parts.append(f'.. auto{"class" if classes else "function"}:: {name}{members}\n')
    return '\n'.join(parts)


def _interval(bounds: tuple[float, float]) -> str:
    return f'{bounds[0]:g} to {bounds[1]:g}'


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ['---'] * len(head), *rows]
    return (
        '\n'.join(f'| {" | ".join(cell.replace("|", "/") for cell in row)} |' for row in lines)
        + '\n'
    )
