"""A law as an effect: the text of its file, and the class that this text makes.

What is fitted jointly, what the report shows and what a user loads with `--effects-path` are the
same class, made of the same text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import textwrap
from typing import Any

from pneunet_ros.discovery.covariates import CONSTANT, Covariate, PLAY, RATE, RATE_TIME
from pneunet_ros.discovery.kinds import Kind
from pneunet_ros.effects.effect import Effect

LEAST, MOST = 1e-3, 1e3  # bounds of a parameter: so many times its prior range
PREFIX = 'proposed_'
LINE = 99
ACTUATE = 'history: History, seconds: float, pressure: float, scale: PressureScale'
RETURNED = 'tuple[History, float]'

# Name of the parameter of a term; {unit} of the amplitude per unit of the covariate.
PARAMETERS = {
    CONSTANT: 'constant',
    'p': 'per_pressure',
    'p^2': 'per_squared_pressure',
    RATE: 'per_pressure_rate',
    PLAY: 'in_play',
    'past 3 s': 'per_pressure_of_three_seconds',
    'past 10 s': 'per_pressure_of_ten_seconds',
    'past 30 s': 'per_pressure_of_half_a_minute',
    'F1': 'per_force_x',
    'F2': 'per_force_y',
    '|F|': 'per_force',
    'p F1': 'per_pressure_and_force_x',
    'p F2': 'per_pressure_and_force_y',
}
# The covariate in the file, by where it is known.
IN_PRESSURE = {CONSTANT: '', 'p': 'pressure', 'p^2': 'pressure**2'}
IN_LOADS = {
    'F1': 'loads.force_x',
    'F2': 'loads.force_y',
    '|F|': 'np.hypot(loads.force_x, loads.force_y)',
    'p F1': 'pressure * loads.force_x',
    'p F2': 'pressure * loads.force_y',
}
TIMES = {RATE: RATE_TIME, 'past 3 s': 3.0, 'past 10 s': 10.0, 'past 30 s': 30.0}
FOLLOW = '''

def follow(mean: float, before: float, pressure: float, seconds: float, time: float) -> float:
    """Return a first-order mean (Pa) after a straight change of pressure."""
    if seconds <= 0.0:
        return mean
    behind = time * (pressure - before) / seconds
    return pressure - behind + (mean - before + behind) * math.exp(-seconds / time)
'''


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A parameter of a proposed effect: of which term, and how large it may be (SI)."""

    name: str
    term: str
    unit: str
    prior: float


def parameters_of(
    kind: Kind, terms: Sequence[str], covariates: Mapping[str, Covariate]
) -> tuple[Parameter, ...]:
    """Return the parameters of the terms of a law, in order."""
    found = []
    for term in terms:
        if term in kind.natives:
            native = kind.natives[term]
            name = 'per_' + '_'.join(
                word.replace('^2', '_squared') for word in term.split() if word != 'the'
            )
            parameter = Parameter(name=name, term=term, unit=native.unit, prior=native.prior)
        else:
            covariate = covariates[term]
            parameter = Parameter(
                name=PARAMETERS[term],
                term=term,
                unit=per_unit(kind.unit, covariate.meaning.unit),
                prior=float(f'{kind.prior / covariate.scale:.3g}'),
            )
        found.append(parameter)
    return tuple(found)


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
    """Return the name of the proposed effect of a kind."""
    return PREFIX + kind.name


def effect_source(
    kind: Kind,
    parameters: Sequence[Parameter],
    sentence: str,
    *,
    length: float,
    play: float,
    prefix: str = PREFIX,
) -> str:
    """Return the text of the file of a proposed effect.

    length (m) of the arm; play (Pa): full width of the one behind the side of the play.
    """
    terms = {item.term for item in parameters}
    memory = [term for term in (*TIMES, PLAY) if term in terms]
    place = kind.place if not memory or kind.place == 'actuation' else 'material'
    name = prefix + kind.name
    body = [*fields_text(kind, parameters), *memory_text(kind, parameters, memory, play)]
    body += speaking_text(kind, parameters, length)
    text = '\n'.join(
        [
            f'"""{wrapped(sentence)}',
            '',
            'A proposal of `pneunet diagnose`: a law of the recordings that it was found in.',
            '"""',
            '',
            'from dataclasses import dataclass, replace',
            'import math',
            'from typing import ClassVar',
            '',
            'import numpy as np',
            'from pneunet_ros.core.arrays import Array',
            'from pneunet_ros.core.units import quantity',
            'from pneunet_ros.effects.effect import (',
            '    Effect,',
            '    History,',
            '    Load,',
            '    Loads,',
            '    Part,',
            '    Place,',
            '    PressureScale,',
            '    Terms,',
            ')',
            FOLLOW.rstrip() if set(TIMES) & terms else '',
            '',
            '@dataclass(frozen=True, slots=True, kw_only=True)',
            f'class {"".join(word.title() for word in name.split("_"))}(Effect):',
            f'    """{capitalized(kind.subject)}."""',
            '',
            f'    name: ClassVar[str] = {name!r}',
            f'    place: ClassVar[Place] = {place!r}',
            f'    meaning: ClassVar[str] = {kind.subject!r}',
            *body,
            '',
        ]
    )
    return without_unused(text)


def fields_text(kind: Kind, parameters: Sequence[Parameter]) -> list[str]:
    """Return the declarations of the parameters."""
    lines = []
    for item in parameters:
        native = kind.natives.get(item.term)
        meaning = native.words if native else f'{kind.amplitude} per covariate: {item.term}'
        if item.term == CONSTANT:
            meaning = f'{kind.amplitude}, the same all the time'
        low = 0.0 if native and native.one_sided else -1.0
        lines += [
            f'    {item.name}: float = quantity(',
            '        0.0,',
            f'        unit={item.unit!r},',
            f'        meaning={meaning!r},',
            f'        bounds=({low * MOST * item.prior!r}, {MOST * item.prior!r}),',
            f'        prior=({2.0 * low * item.prior!r}, {2.0 * item.prior!r}),',
            "        source='prior: invented, twice the usual size of this kind of cause',",
            '    )',
        ]
    if kind.positions is not None:
        first, last = kind.positions
        lines += [
            '    position: float = quantity(',
            '        0.5,',
            "        unit='-',",
            "        meaning='where it acts, s / l; any where nothing acts',",
            f'        bounds=({first!r}, {last!r}),',
            f'        prior=({first!r}, {last!r}),',
            "        source='prior: anywhere on the arm',",
            '        shape=True,',
            '    )',
        ]
    return lines


def sum_text(parameters: Sequence[Parameter], expressions: Mapping[str, str]) -> str:
    """Return the sum of parameters times covariates as Python; empty where there is none."""
    parts = [
        f'self.{item.name}' + (f' * {expressions[item.term]}' if expressions[item.term] else '')
        for item in parameters
        if item.term in expressions
    ]
    return ' + '.join(parts)


def memory_text(
    kind: Kind, parameters: Sequence[Parameter], memory: Sequence[str], play: float
) -> list[str]:
    """Return the methods that carry the past along, and what it adds."""
    if not memory:
        return []
    following, covariates = [], {}
    for place, term in enumerate(memory, start=1):
        if term == PLAY:
            half = repr(0.5 * play)
            following.append(f'min(max(past[{place}], pressure - {half}), pressure + {half})')
            covariates[term] = f'(past[0] - past[{place}]) / {half}'
        else:
            time = TIMES[term]
            following.append(f'follow(past[{place}], past[0], pressure, seconds, {time})')
            covariates[term] = f'(past[0] - past[{place}])' + (
                f' / {time}' if term == RATE else ''
            )
    amplitude = sum_text(parameters, covariates)
    lines = [
        '',
        '    def initial(self, pressure: float, scale: PressureScale) -> History:',
        '        """At rest: the past is this pressure."""',
        f'        return ({", ".join(["pressure"] * (1 + len(memory)))})',
        *method('actuate', ACTUATE, 'Carry the past along.', RETURNED),
        '        past = history',
        '        past = (',
        '            pressure,',
        *(f'            {item},' for item in following),
        '        )',
        f'        return past, pressure{" + " + amplitude if kind.method == "actuate" else ""}',
    ]
    if kind.method == 'terms':
        amplitude = amplitude.replace('past[', 'history[..., ')
        lines += [
            *method(
                'history_terms',
                'history: Array, scale: PressureScale',
                'Return what the past adds.',
                'Terms',
            ),
            f'        return {terms_text(kind, amplitude)}',
        ]
    return lines


def method(name: str, arguments: str, about: str, returns: str) -> list[str]:
    """Return the head of a method."""
    head = f'    def {name}(self, {arguments}) -> {returns}:'
    if len(head) > LINE:
        return [
            '',
            f'    def {name}(',
            f'        self, {arguments}',
            f'    ) -> {returns}:',
            f'        """{about}"""',
        ]
    return ['', head, f'        """{about}"""']


def terms_text(kind: Kind, amplitude: str, natives: Mapping[str, str] = {}) -> str:
    """Return a record of terms with an amplitude, and what comes out of the equilibrium."""
    entries = [kind.code.replace('amplitude', amplitude)] if amplitude else []
    entries += [
        kind.natives[term].code.replace('coefficient', f'self.{name}')
        for term, name in natives.items()
    ]
    if kind.positions is not None:
        entries.insert(0, f'part=Part.around(self.position, {kind.width!r})')
    return f'Terms({", ".join(entries)})'


def speaking_text(kind: Kind, parameters: Sequence[Parameter], length: float) -> list[str]:
    """Return the methods in which the kind speaks of the present."""
    natives = {item.term: item.name for item in parameters if item.term in kind.natives}
    by_pressure, by_load = (sum_text(parameters, table) for table in (IN_PRESSURE, IN_LOADS))
    present = sum_text(parameters, IN_PRESSURE | IN_LOADS)
    amplitude = f'({present})' if ' ' in present else present
    code = kind.code.replace('{half}', repr(0.5 * length)).replace('\n', '\n        ')
    lines: list[str] = []
    if natives or (kind.method == 'terms' and by_pressure):
        lines += [
            *method(
                'terms', 'pressure: Array', 'Return what is added at these pressures.', 'Terms'
            ),
            f'        return {terms_text(kind, by_pressure, natives)}',
        ]
    if kind.method == 'terms' and by_load:
        lines += [
            *method(
                'load_terms', 'loads: Loads', 'Return what is added under these loads.', 'Terms'
            ),
            f'        return {terms_text(kind, by_load.replace("pressure *", "loads.pressure *"))}',
        ]
    match kind.method if present else '':
        case 'actuate':
            lines += [
                *method('actuate', ACTUATE, 'Return the pressure in the chamber.', RETURNED),
                f'        return history, pressure + {amplitude}',
            ]
        case 'sense':
            present = present.replace('loads.', 'load.')
            known = (
                ['        pressure = load.pressure']
                if by_pressure or 'pressure *' in present
                else []
            )
            lines += [
                *method('sense', 'load: Load', 'Return the true load.', 'Load'),
                *known,
                f'        amplitude = {present}',
                f'        return {code}',
            ]
        case 'see':
            lines += [
                *method(
                    'see',
                    'x: Array, y: Array',
                    'Return where the points are measured.',
                    'tuple[Array, Array]',
                ),
                f'        amplitude = {present}',
                f'        return {code}',
            ]
        case 'frame_delay':
            head = method('frame_delay', '', 'The delay.', 'float')
            lines += [
                '',
                '    @property',
                *(line.replace('(self, )', '(self)') for line in head[1:]),
                f'        return {present}',
            ]
    return lines


def wrapped(sentence: str) -> str:
    """Return a sentence on lines that a file may have."""
    return '\n'.join(textwrap.wrap(sentence, LINE - 3))


def capitalized(text: str) -> str:
    """Return a text that begins with a capital."""
    return text[:1].upper() + text[1:]


def without_unused(text: str) -> str:
    """Return the text of a file without imports that it does not use."""
    head, body = text.split('@dataclass', 1)
    lines = head.split('\n')
    unused = {
        'from dataclasses import dataclass, replace': (
            'replace(',
            'from dataclasses import dataclass',
        ),
        'import math': ('math.', None),
        'import numpy as np': ('np.', None),
        'from pneunet_ros.core.arrays import Array': ('Array', None),
        '    History,': ('History', None),
        '    Load,': ('-> Load:', None),
        '    Loads,': ('Loads', None),
        '    Part,': ('Part.', None),
        '    PressureScale,': ('PressureScale', None),
        '    Terms,': ('Terms', None),
    }
    functions = head.split(')\n', 1)[-1]
    kept = []
    for line in lines:
        word, instead = unused.get(line, ('', None))
        if word and word not in body and word not in functions:
            if instead is None:
                continue
            line = instead
        kept.append(line)
    return '\n'.join(kept) + '@dataclass' + body


def effect_class(source: str) -> type[Effect]:
    """Return the effect that the text of a file declares."""
    space: dict[str, Any] = {'__name__': __name__}
    exec(compile(source, '<proposed effect>', 'exec', dont_inherit=True), space)
    found = [
        item
        for item in space.values()
        if isinstance(item, type) and issubclass(item, Effect) and item is not Effect
    ]
    return found[0]
