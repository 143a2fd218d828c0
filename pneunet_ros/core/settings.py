"""Settings: tuning constants, each with its meaning, source and bounds.

One frozen dataclass per algorithm has its numbers as fields made by `tuning`; `settings_used`
lists the settings of a result, and `settings_changed` those that differ from the default.
"""

from __future__ import annotations

from collections import namedtuple
import dataclasses
from dataclasses import field
from typing import Any

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities


def setting(
    default: Any,
    meaning: str,
    choices: tuple[Any, ...] = (),
    bounds: tuple[int, int] | None = None,
) -> Any:
    """Declare a setting that is not a physical quantity; bounds: closed interval allowed."""
    metadata = {'meaning': meaning, 'choices': choices}
    if bounds is not None:
        metadata['bounds'] = bounds
    return field(default=default, metadata=metadata)


def tuning(default: Any, meaning: str, *, unit: str = '-', source: str) -> Any:
    """Declare a tuning constant of an algorithm.

    unit: SI unit, '-' for none, or the reference of a share or multiple. source: origin of the
    number: 'measured', 'literature: ...', 'convention', or 'invented' for a free choice; 'sweep':
    acceptance/sweep.csv lists the results that change when the number is halved and doubled, which
    shows that the number matters, not that it is right.
    """
    return field(default=default, metadata={'meaning': meaning, 'used_unit': unit, 'from': source})


def numbers_type(settings: type, name: str) -> Any:
    """Return a named tuple type with the fields of settings, for kernels.

    name: of its variable in the module, where cached kernels look it up.
    """
    names = [item.name for item in dataclasses.fields(settings)]
    return namedtuple(name, names, module=settings.__module__)


def settings_used(*owners: Any) -> dict[str, Any]:
    """Return every tuning constant of these settings, by `Class.field`.

    Nested settings are listed with the class that declares the number. A field without a
    declaration is not a setting.
    """
    used: dict[str, Any] = {}
    for owner in owners:
        for item in dataclasses.fields(owner):
            value = getattr(owner, item.name)
            if dataclasses.is_dataclass(value):
                used |= settings_used(value)
            elif item.metadata:
                used[f'{type(owner).__name__}.{item.name}'] = value
    return used


def settings_changed(*owners: Any) -> dict[str, Any]:
    """Return the settings that differ from the default, by `Class.field`."""
    defaults = settings_used(*(type(owner)() for owner in owners))
    return {key: value for key, value in settings_used(*owners).items() if value != defaults[key]}


def check_settings(owner: Any) -> None:
    """Reject values of a dataclass that its `setting`s and `quantity`s do not allow."""
    check_quantities(owner, '', RequestError)
    for item in dataclasses.fields(owner):
        value = getattr(owner, item.name)
        choices = item.metadata.get('choices')
        if choices and value not in choices:
            allowed = ', '.join(str(choice) for choice in choices)
            raise RequestError(
                f'{item.name} must be one of {allowed}, not {value!r}', reason='unknown_kind'
            )
        if isinstance(item.default, int) and 'bounds' in item.metadata:
            low, high = item.metadata['bounds']
            if not low <= value <= high:
                raise RequestError(
                    f'{item.name} must lie between {low} and {high}, not {value}',
                    reason='out_of_bounds',
                )
