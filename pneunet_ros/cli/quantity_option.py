"""Options for physical quantities: a number in SI, or with its unit, e.g. 31kPa."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
import math
import re
from typing import TYPE_CHECKING

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import PRESSURE_UNITS, SI_PER_UNIT

if TYPE_CHECKING:
    from pneunet_ros.model.string import String

_NUMBER_AND_UNIT = re.compile(
    r'\s*([-+]?[0-9.]+(?:[eE][-+]?\d+)?)\s*([A-Za-z][A-Za-z0-9_ .*·]*)?\s*', re.ASCII
)
_BETWEEN_UNITS = re.compile(r'[_ .*·]')
KIND_OF_UNIT = {  # of SI
    'Pa': 'pressure',
    'N': 'force',
    'N m': 'moment',
    'm': 'length',
    's': 'time',
    'rad': 'angle',
    'm/s^2': 'acceleration',
    'rad/s': 'turn_rate',
}
_EXAMPLES = {
    'pressure': '31kPa',
    'force': '150mN',
    'moment': '2mNm',
    'length': '112mm',
    'time': '300ms',
    'angle': '5deg',
    'acceleration': '1g',
    'turn_rate': '90deg_s',
}
_SHOWN = {
    **{name.lower(): name for name in PRESSURE_UNITS},
    'n': 'N',
    'mn': 'mN',
    'n_m': 'Nm',
    'n_mm': 'Nmm',
    'mn_m': 'mNm',
}


def parse_quantity(text: str, kind: str) -> float:
    """Return a number in SI; kind: a key of SI_PER_UNIT. RequestError lists the allowed units."""
    match = _NUMBER_AND_UNIT.fullmatch(text)
    units = {_joined(name): size for name, size in SI_PER_UNIT[kind].items()}
    value = math.nan
    if match is not None:
        unit = _joined(match[2] or '').lower()
        try:
            value = float(match[1]) * (units[unit] if unit else 1.0)
        except (ValueError, KeyError):
            value = math.nan
    if not math.isfinite(value):
        names = [_SHOWN.get(name, name) for name in SI_PER_UNIT[kind]]
        article = 'an' if kind.startswith('a') else 'a'
        raise RequestError(
            f'{text[:40]!r} is not {article} {kind}: write a number in '
            f'{next(unit for unit, one in KIND_OF_UNIT.items() if one == kind)}, or a number '
            f'directly followed by one of the units {", ".join(names)}, e.g. {_EXAMPLES[kind]}',
            reason='not_a_number',
        )
    return value


def quantity_of(option: str, text: str, kind: str) -> float:
    """Return the number of an option in SI; RequestError names the option."""
    try:
        return parse_quantity(text, kind)
    except RequestError as error:
        raise RequestError(f'{option}: {error}', reason='not_a_number') from error


def string_of(option: str, texts: Sequence[str]) -> String:
    """Return the string of tension, X and Y of an option; RequestError names the option."""
    from pneunet_ros.model.string import String

    kinds = ('force', 'length', 'length')
    tension, x, y = (quantity_of(option, *pair) for pair in zip(texts, kinds, strict=True))
    try:
        return String(tension=tension, x=x, y=y)
    except RequestError as error:
        raise RequestError(f'{option}: {error}', reason='not_a_number') from error


def quantity_type(kind: str) -> Callable[[str], float]:
    """Return the `type` function of argparse for options of this kind."""

    def convert(text: str) -> float:
        try:
            return parse_quantity(text, kind)
        except RequestError as error:
            raise ArgumentTypeError(str(error)) from error

    return convert


def _joined(unit: str) -> str:
    return _BETWEEN_UNITS.sub('', unit)


def seed(text: str) -> int:
    """Return a seed, a nonnegative integer."""
    if not text.isdecimal() or int(text) >= 2**63:
        raise ArgumentTypeError(f'{text!r} is not a whole number (0 or more)')
    return int(text)
