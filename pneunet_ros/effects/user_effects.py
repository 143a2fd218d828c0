"""User-defined effects: files of a given folder, and effects from installed packages.

Effect files are code: they are executed only if a user names their folder, never because a model
file mentions their effects.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from functools import cache
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
import inspect
import math
from pathlib import Path
import sys
from types import ModuleType
from typing import Any, get_args
import zlib

from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.arm_size import DIMENSIONS
from pneunet_ros.effects.effect import DEFINES, Effect, METHODS, Place

ENTRY_POINTS = 'pneunet_ros.effects'  # entry points of installed packages with effects
FOREIGN = (Exception, SystemExit)  # errors that third-party code may raise during its import


def add_effects(directory: str | Path) -> tuple[type[Effect], ...]:
    """Append the effects in a folder of Python files to the table of effects.

    Args:
        directory: each file *.py in it, unless its name starts with an underscore, defines
            subclasses of `Effect`. A file that was added before is not loaded again.

    Returns:
        The effects of the folder, sorted by file name.

    Raises:
        ModelError: the folder does not exist, a file cannot be imported or defines no effect, or
            an effect violates the interface or has the name of another. Then nothing is added.
    """
    folder = resolve_links(directory)
    if not folder.is_dir():
        raise ModelError(f'effects path {directory} is not a folder', reason='unreadable')
    files = sorted(file for file in folder.glob('*.py') if not file.name.startswith('_'))
    if not files:
        raise ModelError(
            f'effects path {directory} contains no effect file (*.py)', reason='no_effect'
        )
    found: list[type[Effect]] = []
    for file in files:
        module = module_of(file)
        own_effects = [
            item
            for _, item in inspect.getmembers(module, inspect.isclass)
            if issubclass(item, Effect) and item.__module__ == module.__name__
        ]
        if not own_effects:
            raise ModelError(
                f'effect file {file} contains no subclass of Effect', reason='no_effect'
            )
        found += own_effects
    return add_to_table([(effect, f'effect file {inspect.getfile(effect)}') for effect in found])


@cache
def add_installed_effects() -> tuple[type[Effect], ...]:
    """Add the effects of installed packages to the table; ModelError as in `add_effects`."""
    found: list[tuple[Any, str]] = []
    for point in entry_points(group=ENTRY_POINTS):
        package = '' if point.dist is None else f' of the package {point.dist.name}'
        origin = f'effect {point.name}{package}'
        try:
            found.append((point.load(), origin))
        except FOREIGN as error:
            raise ModelError(
                f'{origin} cannot be imported: {reason(error)}', reason='not_imported'
            ) from error
    return add_to_table(found)


def module_of(file: Path) -> ModuleType:
    """Return the module of an effect file, imported once; ModelError if that fails."""
    # Derived from the path, so that worker processes find it under the same name.
    name = f'pneunet_effects_{file.stem}_{zlib.crc32(str(file).encode()):08x}'
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look up their module there
    try:
        spec.loader.exec_module(module)
    except FOREIGN as error:
        del sys.modules[name]
        raise ModelError(
            f'effect file {file} cannot be imported: {reason(error)}', reason='not_imported'
        ) from error
    return module


def reason(error: Exception | SystemExit) -> str:
    """Describe an error raised by user code."""
    line = getattr(error, 'lineno', None)
    where = f' (line {line})' if line else ''
    return f'{type(error).__name__}: {error}{where}'


def add_to_table(found: Iterable[tuple[Any, str]]) -> tuple[type[Effect], ...]:
    """Add effects to the table of effects, each with its origin for messages."""
    added: dict[str, type[Effect]] = {}
    for effect, origin in found:
        wrong = contract_violation(effect)
        if wrong:
            raise ModelError(
                f'{origin}: {getattr(effect, "__name__", effect)} {wrong}', reason='wrong_form'
            )
        known = added.get(effect.name, EFFECTS.get(effect.name, effect))
        if known is not effect:
            raise ModelError(
                f'{origin}: there is already an effect {effect.name}, in '
                f'{inspect.getfile(known)}; give this one another name',
                reason='given_twice',
            )
        added[effect.name] = effect
    EFFECTS.update(added)
    return tuple(added.values())


def contract_violation(effect: Any) -> str:
    """Describe how a class violates the contract of effects; empty if it complies.

    Numerical properties, e.g. that its neutral value has no influence, are tested by the property
    suite (`test/effects/test_effects.py`).
    """
    if not (inspect.isclass(effect) and issubclass(effect, Effect)):
        return 'is not a subclass of Effect'
    name: Any = getattr(effect, 'name', None)
    place: Any = getattr(effect, 'place', None)
    if not (isinstance(name, str) and name.isidentifier()):
        return f'needs a name of letters, digits and underscores, not {name!r}'
    if place not in get_args(Place):
        return f'needs a place, one of {", ".join(get_args(Place))}, not {place!r}'
    if not (isinstance(getattr(effect, 'meaning', None), str) and effect.meaning):
        return 'needs a meaning: what it does, in a few words'
    parameters = vars(effect).get('__dataclass_params__')  # without those of its base class
    if parameters is None or not parameters.frozen:
        return 'must be a dataclass with frozen=True, slots=True and kw_only=True'
    declared = quantities(effect)
    if not declared or len(declared) != len(fields(effect)):
        return 'must declare at least one parameter, each with quantity(...)'
    for item in declared:
        (low, high), (first, last) = item.metadata['bounds'], item.metadata['prior']
        where = f'parameter {item.name}'
        if not isinstance(item.default, float):
            return f'{where} needs a float as default, its neutral value'
        if not low <= item.default <= high:
            return f'{where}: the default {item.default} is not within the bounds [{low}, {high}]'
        if not (low <= first < last <= high and math.isfinite(first) and math.isfinite(last)):
            return f'{where} needs a prior of two finite, increasing numbers within the bounds'
        unit = item.metadata['unit']
        if item.metadata['prior_scales'] and unit not in DIMENSIONS:
            known = ', '.join(DIMENSIONS)
            return f'{where}: its prior cannot scale, because {unit} is none of: {known}'
    methods = METHODS & set(vars(effect))
    if not methods:
        return f'does nothing: it must have one of {", ".join(sorted(DEFINES[place]))}'
    if not methods <= DEFINES[place]:
        wrong = sorted(methods - DEFINES[place])[0]
        return f'acts in {place}, so it must not have {wrong}'
    return ''
