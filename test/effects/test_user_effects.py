"""Effects of a user: from a folder that is named, or from an installed package."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
import subprocess
import sys

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import ModelError
from pneunet_ros.effects import EFFECTS, user_effects
from pneunet_ros.effects.user_effects import add_effects, add_installed_effects
from pneunet_ros.files.model_file import load_model, save_model
from pneunet_ros.model.equilibrium import solve
import pytest
from support.example_arms import paper_arm
from support.refusals import refused

TESTS = Path(__file__).parent
EFFECT = '''
"""A part of the arm is softer under pull."""
from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Loads, Part, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class SoftPart(Effect):
    """Rigidity x (1 + gain F1) around a place."""

    name: ClassVar[str] = 'soft_part'
    place: ClassVar[Place] = 'material'
    meaning: ClassVar[str] = 'a part is softer under pull'
    gain: float = quantity(
        0.0, unit='1/N', meaning='per F1', bounds=(-2.0, 2.0), prior=(-1.0, 1.0),
        source='prior: invented',
    )
    middle: float = quantity(
        0.5, unit='-', meaning='s / l', bounds=(0.1, 0.9), prior=(0.2, 0.8),
        source='prior: on the arm', shape=True,
    )

    def load_terms(self, loads: Loads) -> Terms:
        """Soften."""
        part = Part.around(self.middle, 0.2)
        return Terms(part=part, rigidity_factor=1.0 + self.gain * loads.force_x)
'''


@pytest.fixture(autouse=True)
def _table_of_the_library(monkeypatch):
    """Leave no effect behind."""
    library = dict(EFFECTS)
    add_installed_effects.cache_clear()
    yield
    EFFECTS.clear()
    EFFECTS.update(library)
    add_installed_effects.cache_clear()


def folder(tmp_path: Path, text: str = EFFECT, name: str = 'soft_part.py') -> Path:
    """Return a folder with one effect file, and one that is none."""
    path = tmp_path / 'effects'
    path.mkdir()
    (path / name).write_text(text, encoding='utf-8')
    (path / '_notes.py').write_text('1 / 0', encoding='utf-8')
    return path


def test_an_effect_of_a_folder_is_one_of_the_table(tmp_path):
    path = folder(tmp_path)
    (soft_part,) = add_effects(path)
    assert add_effects(path) == (soft_part,)
    assert list(EFFECTS)[-1] == 'soft_part'
    arm = paper_arm((soft_part(gain=-0.8),))
    save_model(arm, tmp_path / 'arm.yaml')
    known = load_model(tmp_path / 'arm.yaml')
    assert known.effects == arm.effects
    pulled, plain = (solve(item, 30e3, (0.1, 0.05)) for item in (known, paper_arm()))
    assert 3e-5 < np.hypot(*np.subtract(pulled.tip[:2], plain.tip[:2])) < 0.02


def test_a_model_with_an_unknown_effect_says_what_to_do(tmp_path, capsys):
    path = folder(tmp_path)
    (soft_part,) = add_effects(path)
    save_model(paper_arm((soft_part(gain=-0.8),)), tmp_path / 'arm.yaml')
    del EFFECTS['soft_part']
    asked = ['predict', '--model', str(tmp_path / 'arm.yaml'), '--pressure', '30000']
    assert main(asked) == 2
    said = capsys.readouterr().err
    assert 'effects.soft_part' in said
    assert '--effects-path' in said
    assert main([*asked, '--effects-path', str(path)]) == 0
    assert main(['effects', '--effects-path', str(path)]) == 0
    assert 'soft_part' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('before', 'after', 'words'),
    [
        ('Part, Place', 'Part, Plaice', "cannot be imported: ImportError: cannot import name 'Pl"),
        ('part = Part', 'part = = Part', 'cannot be imported: SyntaxError: invalid syntax'),
        ("= 'soft_part'", "= 'gravity'", 'there is already an effect gravity, in '),
        ("= 'soft_part'", "= 'soft part'", 'SoftPart needs a name of letters'),
        ("= 'material'", "= 'here'", 'needs a place, one of sensing, actuation, material, mech'),
        ("= 'material'", "= 'sensing'", 'acts in sensing, so it must not have load_terms'),
        ('prior=(-1.0, 1.0)', 'prior=(-9.0, 1.0)', 'parameter gain needs a prior of two finite'),
        (
            "unit='-',",
            "unit='1/(m Pa)', prior_scales=True,",
            'prior cannot scale, because 1/(m Pa)',
        ),
        ('        0.5, unit', '        5.0, unit', 'default 5.0 is not within the bounds [0.1'),
        ('(frozen=True, ', '(', 'cannot be imported: TypeError'),
        ('from typing', 'raise SystemExit(3)\nfrom typing', 'cannot be imported: SystemExit: 3'),
        ('def load_terms', 'def loud_terms', 'SoftPart does nothing: it must have one of actuate'),
        ('SoftPart(Effect)', 'SoftPart', 'contains no subclass of Effect'),
    ],
    ids=lambda item: item[:12],
)
def test_what_is_wrong_with_a_file_is_one_sentence(tmp_path, before, after, words):
    assert EFFECT.count(before) == 1
    library = dict(EFFECTS)
    with pytest.raises(ModelError) as caught:
        add_effects(folder(tmp_path, EFFECT.replace(before, after)))
    assert words in str(caught.value)
    assert 'soft_part.py' in str(caught.value)
    assert '\n' not in str(caught.value)
    assert library == EFFECTS


def test_a_folder_without_effects_is_refused(tmp_path):
    with refused(ModelError, 'unreadable'):
        add_effects(tmp_path / 'nothing')
    with refused(ModelError, 'no_effect'):
        add_effects(tmp_path)


def test_installed_packages_may_offer_effects(tmp_path, monkeypatch):
    folder(tmp_path)
    monkeypatch.syspath_prepend(tmp_path / 'effects')

    def offer(value):
        point = EntryPoint(name='soft', value=value, group=user_effects.ENTRY_POINTS)
        monkeypatch.setattr(user_effects, 'entry_points', lambda group: [point])
        add_installed_effects.cache_clear()

    offer('soft_part:SoftPart')
    assert [effect.name for effect in add_installed_effects()] == ['soft_part']
    assert 'soft_part' in EFFECTS
    for value, reason in (('soft_part:Hard', 'not_imported'), ('soft_part:Terms', 'wrong_form')):
        offer(value)
        with refused(ModelError, reason):
            add_installed_effects()


def test_the_property_suite_takes_a_file_of_a_user(tmp_path):
    def failures(text):
        (path / 'soft_part.py').write_text(text, encoding='utf-8')
        done = subprocess.run(
            [
                # Without bytecode: that of a file of the same size and second is taken for new.
                sys.executable, '-B', '-m', 'pytest', '-q', '-n', '0', '-p', 'no:cacheprovider',
                str(TESTS / 'test_effects.py'), '-k', 'soft_part and (adds_nothing or declared)',
                '--effects-path', str(path),
            ],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout

    path = folder(tmp_path)
    assert failures(EFFECT)[0] == 0
    code, said = failures(EFFECT.replace('1.0 + self.gain', '1.1 + self.gain'))
    assert code == 1
    assert 'test_a_neutral_effect_adds_nothing[soft_part]' in said
