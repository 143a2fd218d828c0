"""A law as an effect: the source text of its file, and the class defined by it.

The joint fit, the report and `--effects-path` of a user all use the same class from the same text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import itertools
import re
import textwrap
from typing import Any

from pneunet_ros.discovery.covariates import CONSTANT, Covariate, MEANS, PLAYS, RATE, RATE_TIME
from pneunet_ros.discovery.kinds import Kind
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect

MOST = 1e3  # bounds of a parameter, relative to its usual size
LAW_ERROR = 0.1  # invented, as for most effects; a new arm follows no law with few terms
PREFIX, POSITION = 'proposed_', 'position'
LINE = 99

# A covariate in a file, by where it is known.
PRESENT = {CONSTANT: '', 'p': 'pressure', 'p^2': 'pressure**2'}
LOADED = {
    'F1': 'loads.force_x',
    'F2': 'loads.force_y',
    '|F|': 'np.hypot(loads.force_x, loads.force_y)',
    'p F1': 'loads.pressure * loads.force_x',
    'p F2': 'loads.pressure * loads.force_y',
}
SENSED = {term: code.replace('loads.', 'load.') for term, code in LOADED.items()} | {
    CONSTANT: '',
    'p': 'load.pressure',
    'p^2': 'load.pressure**2',
}
TIMES = {RATE: RATE_TIME, **MEANS}

# Imports of a file, of the standard library and of others: how a line begins, and its names.
IMPORTS = (
    (
        ('from dataclasses import', 'dataclass replace'),
        ('import', 'math'),
        ('from typing import', 'ClassVar'),
    ),
    (
        ('import numpy as', 'np'),
        ('from pneunet_ros.core.arrays import', 'Array'),
        ('from pneunet_ros.core.units import', 'quantity'),
        (
            'from pneunet_ros.effects.effect import',
            'Effect History Load Loads Part Place PressureScale Terms',
        ),
    ),
)
FILE = '''\
"""{sentence}

A proposal of `pneunet diagnose`: a law of the recordings that it was found in.
"""

{imports}
{functions}

@dataclass(frozen=True, slots=True, kw_only=True)
class {class_name}(Effect):
    """{about}."""

    name: ClassVar[str] = {name!r}
    place: ClassVar[Place] = {place!r}
    meaning: ClassVar[str] = {meaning!r}
    law_error: ClassVar[float] = {law_error!r}
{body}'''
FOLLOW = '''

def follow(mean: float, before: float, pressure: float, seconds: float, time: float) -> float:
    """Return a first-order mean (Pa) after a straight change of pressure."""
    if seconds <= 0.0:
        return mean
    behind = time * (pressure - before) / seconds
    return pressure - behind + (mean - before + behind) * math.exp(-seconds / time)
'''
FIELD = """\
    {name}: float = quantity(
        {default!r},
        unit={unit!r},
        meaning={meaning!r},
        bounds=({low!r}, {high!r}),
        prior=({first!r}, {last!r}),
        source={source!r},{shape}
    )
"""
MEMORY = '''
    def initial(self, pressure: float, scale: PressureScale) -> History:
        """At rest: the past is this pressure."""
        return ({at_rest})

    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Carry the past along."""
        before = history[0]
        history = (
            pressure,
            {following},
        )
        return history, {chamber}
'''
HISTORY_TERMS = '''
    def history_terms(self, history: Array, scale: PressureScale) -> Terms:
        """Return what the past adds."""
        amplitude = {amplitude}
        return {terms}
'''
TERMS = '''
    def terms(self, pressure: Array) -> Terms:
        """Return what is added at these pressures."""
{first}        return {terms}
'''
LOAD_TERMS = '''
    def load_terms(self, loads: Loads) -> Terms:
        """Return what is added under these loads."""
        amplitude = {amplitude}
        return {terms}
'''
ACTUATE = '''
    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Return the pressure in the chamber."""
        return history, pressure + {amplitude}
'''
SENSE = '''
    def sense(self, load: Load) -> Load:
        """Return the true load."""
        amplitude = {amplitude}
        return {code}
'''
SEE = '''
    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return where the points are measured."""
        amplitude = {amplitude}
        return {code}
'''
FRAME_DELAY = '''
    @property
    def frame_delay(self) -> float:
        """The delay."""
        return {amplitude}
'''
METHODS = {'actuate': ACTUATE, 'sense': SENSE, 'see': SEE, 'frame_delay': FRAME_DELAY}


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A parameter of a proposed effect: its term, and its usual size (SI)."""

    name: str
    term: str
    unit: str
    prior: float


def parameter_of(kind: Kind, term: str, covariates: Mapping[str, Covariate]) -> Parameter:
    """Return the parameter of a term: a covariate, or a quantity of the equilibrium."""
    if term in kind.natives:
        native = kind.natives[term]
        name = 'per_' + term.replace('^2', '_squared').replace(' ', '_')
        return Parameter(name=name, term=term, unit=native.unit, prior=native.prior)
    covariate = covariates[term]
    return Parameter(
        name=covariate.meaning.parameter,
        term=term,
        unit=per_unit(kind.unit, covariate.meaning.unit),
        prior=float(f'{kind.prior / covariate.scale:.3g}'),
    )


def per_unit(amplitude: str, covariate: str) -> str:
    """Return the unit of an amplitude per covariate."""
    if covariate == '-':
        return amplitude
    below = f'({covariate})' if ' ' in covariate or '/' in covariate else covariate
    if amplitude == '-':
        return f'1/{below}'
    above = f'({amplitude})' if '/' in amplitude else amplitude
    return f'{above}/{below}'


def effect_name(kind: Kind) -> str:
    """Return a name for the proposed effect of a kind, not used by any loaded effect."""
    name = PREFIX + kind.name
    count = itertools.count(2)
    while name in EFFECTS:
        name = f'{PREFIX}{kind.name}_{next(count)}'
    return name


def effect_source(
    kind: Kind,
    parameters: Sequence[Parameter],
    sentence: str,
    *,
    length: float,
    play: float,
    name: str = '',
) -> str:
    """Return the text of the file of a proposed effect.

    length (m) of the arm; play (Pa): full width of the usual play; name: of the effect, by default
    that of a proposal.
    """
    memory = [item.term for item in parameters if item.term in TIMES or item.term in PLAYS]
    name = name or effect_name(kind)
    body = ''.join(
        [
            *(field_text(kind, item) for item in parameters),
            position_text(kind),
            memory_text(kind, parameters, memory, play),
            present_text(kind, parameters, length),
        ]
    )
    functions = FOLLOW if set(TIMES) & set(memory) else ''
    wrapped = textwrap.fill(sentence, LINE, initial_indent='   ').lstrip()
    return FILE.format(
        sentence=wrapped,
        imports=imports_text(f'@dataclass Effect ClassVar Place {functions} {body}'),
        functions=functions,
        class_name=''.join(word.title() for word in name.split('_')),
        about=kind.subject[:1].upper() + kind.subject[1:],
        name=name,
        place='material' if memory and kind.place == 'mechanics' else kind.place,
        meaning=kind.subject,
        law_error=LAW_ERROR,
        body=body,
    )


def imports_text(used: str) -> str:
    """Return the imports needed by a text, one line per module."""
    groups = []
    for group in IMPORTS:
        lines = []
        for begin, names in group:
            found = [name for name in names.split() if re.search(rf'\b{name}\b', used)]
            line = f'{begin} {", ".join(found)}'
            if len(line) > LINE:
                line = f'{begin} (\n    ' + ',\n    '.join(found) + ',\n)'
            lines += [line] * bool(found)
        groups.append('\n'.join(lines))
    return '\n\n'.join(groups)


def field_text(kind: Kind, item: Parameter) -> str:
    """Return the declaration of a parameter."""
    meaning = f'{kind.amplitude} per covariate: {item.term}'
    if item.term == CONSTANT:
        meaning = f'{kind.amplitude}, the same all the time'
    low = 0.0 if item.term in kind.natives else -1.0
    return FIELD.format(
        name=item.name,
        default=0.0,
        unit=item.unit,
        meaning=meaning,
        low=low * MOST * item.prior,
        high=MOST * item.prior,
        first=2.0 * low * item.prior,
        last=2.0 * item.prior,
        source='prior: invented, twice what is usual of this kind of cause',
        shape='',
    )


def position_text(kind: Kind) -> str:
    """Return the declaration of the position, empty if a kind has none."""
    if kind.positions is None:
        return ''
    low, high = kind.positions
    return FIELD.format(
        name=POSITION,
        default=0.5,
        unit='-',
        meaning='middle of the part on which it acts, s / l; any where nothing acts',
        low=low,
        high=high,
        first=low,
        last=high,
        source='prior: anywhere on the arm',
        shape='\n        shape=True,',
    )


def sum_text(parameters: Sequence[Parameter], expressions: Mapping[str, str]) -> str:
    """Return the sum of parameters times covariates as Python; empty if there is none."""
    parts = [
        f'self.{item.name}' + (f' * {expressions[item.term]}' if expressions[item.term] else '')
        for item in parameters
        if item.term in expressions
    ]
    if len(parts) < 2:
        return ''.join(parts)
    lines = '\n            + '.join(parts)
    return f'(\n            {lines}\n        )'


def terms_text(kind: Kind, amplitude: str, natives: Mapping[str, str] | None = None) -> str:
    """Return a record of terms as Python; natives: parameter of each term of the equilibrium."""
    entries = [kind.code.replace('amplitude', amplitude)] if amplitude else []
    for term, name in (natives or {}).items():
        entries.append(kind.natives[term].code.replace('coefficient', f'self.{name}'))
    if kind.positions is not None:
        entries.insert(0, f'part=Part.around(self.position, {kind.width!r})')
    return f'Terms({", ".join(entries)})'


def memory_text(
    kind: Kind, parameters: Sequence[Parameter], memory: Sequence[str], play: float
) -> str:
    """Return the methods that update the history, and its terms."""
    if not memory:
        return ''
    following, covariates = [], {}
    for index, term in enumerate(memory, start=1):
        if term in PLAYS:
            half = repr(float(f'{0.5 * PLAYS[term] * play:.6g}'))
            following.append(f'min(max(history[{index}], pressure - {half}), pressure + {half})')
            covariates[term] = f'(history[0] - history[{index}]) / {half}'
        else:
            time = TIMES[term]
            following.append(f'follow(history[{index}], before, pressure, seconds, {time})')
            covariates[term] = f'(history[0] - history[{index}])'
            covariates[term] += f' / {time}' if term == RATE else ''
    amplitude = sum_text(parameters, covariates)
    chamber = f'pressure + {amplitude}' if kind.method == 'actuate' else 'pressure'
    text = MEMORY.format(
        at_rest=', '.join(['pressure'] * (1 + len(memory))),
        following=',\n            '.join(following),
        chamber=chamber,
    )
    if kind.method == 'terms':
        amplitude = amplitude.replace('history[', 'history[..., ')
        text += HISTORY_TERMS.format(amplitude=amplitude, terms=terms_text(kind, 'amplitude'))
    return text


def present_text(kind: Kind, parameters: Sequence[Parameter], length: float) -> str:
    """Return the methods for the dependence on present inputs."""
    if kind.method == 'terms':
        return present_terms_text(kind, parameters)
    expressions = SENSED if kind.method == 'sense' else PRESENT | LOADED
    amplitude = sum_text(parameters, expressions)
    code = kind.code.replace('{half}', repr(0.5 * length)).replace('\n', '\n        ')
    return METHODS[kind.method].format(amplitude=amplitude, code=code) if amplitude else ''


def present_terms_text(kind: Kind, parameters: Sequence[Parameter]) -> str:
    """Return the methods of a kind that changes the record of the rod."""
    natives = {item.term: item.name for item in parameters if item.term in kind.natives}
    text, amplitude = '', sum_text(parameters, PRESENT)
    if amplitude or natives:
        first = f'        amplitude = {amplitude}\n' if amplitude else ''
        terms = terms_text(kind, 'amplitude' if amplitude else '', natives)
        text += TERMS.format(first=first, terms=terms)
    loaded = sum_text(parameters, LOADED)
    if loaded:
        text += LOAD_TERMS.format(amplitude=loaded, terms=terms_text(kind, 'amplitude'))
    return text


def effect_class(source: str) -> type[Effect]:
    """Return the effect declared by the text of a file."""
    space: dict[str, Any] = {'__name__': __name__}
    exec(compile(source, '<proposed effect>', 'exec', dont_inherit=True), space)
    found = [
        item
        for item in space.values()
        if isinstance(item, type) and issubclass(item, Effect) and item is not Effect
    ]
    return found[0]
