"""Formatting of numbers with their errors and significant digits."""

from __future__ import annotations

import math

from pneunet_ros.diagnosis.result import Estimated

LEAST_P_VALUE = 1e-6  # a smaller one is only called smaller


def with_error(found: Estimated) -> str:
    """Format a number and its standard error, rounded to significant digits."""
    unit = unit_text(found.unit)
    if not (math.isfinite(found.std) and math.isfinite(found.value)) or found.std <= 0.0:
        return f'{found.value:.4g}{unit}'
    last = math.floor(math.log10(found.std)) - 1  # two digits of the error
    if last >= -4 and abs(found.value) < 1e6:
        places = max(-last, 0)
        value, std = round(found.value, -last), round(found.std, -last)
        return f'{value:.{places}f} ± {std:.{places}f}{unit}'
    scale = math.floor(math.log10(max(abs(found.value), found.std)))
    places = max(scale - last, 0)
    value, std = found.value / 10.0**scale, found.std / 10.0**scale
    return f'({value:.{places}f} ± {std:.{places}f})e{scale}{unit}'


def p_value_text(p_value: float) -> str:
    """Format a p-value; values below the resolution are written as an upper limit."""
    return f'{p_value:.2g}' if p_value >= LEAST_P_VALUE else f'< {LEAST_P_VALUE:g}'


def unit_text(unit: str) -> str:
    """Return a unit as a suffix of a number."""
    return '' if unit == '-' else f' {unit}'


def round_value(value: float) -> str:
    """Write a number with its significant digits."""
    return f'{value:.0f}' if abs(value) >= 10.0 else f'{value:.1f}'
