"""Settings: numbers that decide, each with its meaning and what is allowed."""

from __future__ import annotations

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
    """Declare a setting that is no physical quantity; bounds: closed interval allowed."""
    metadata = {'meaning': meaning, 'choices': choices}
    if bounds is not None:
        metadata['bounds'] = bounds
    return field(default=default, metadata=metadata)


def check_settings(owner: Any) -> None:
    """Refuse values of a dataclass that its `setting`s and `quantity`s do not allow."""
    check_quantities(owner, '', RequestError)
    for item in dataclasses.fields(owner):
        value = getattr(owner, item.name)
        choices = item.metadata.get('choices')
        if choices and value not in choices:
            allowed = ', '.join(str(choice) for choice in choices)
            raise RequestError(f'{item.name} must be one of {allowed}, not {value!r}')
        if isinstance(item.default, int) and 'bounds' in item.metadata:
            low, high = item.metadata['bounds']
            if not low <= value <= high:
                raise RequestError(f'{item.name} must lie between {low} and {high}, not {value}')
