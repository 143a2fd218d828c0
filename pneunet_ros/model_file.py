"""The model file: YAML in SI <-> an immutable `Arm`; an unknown key is an error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, MISSING
import hashlib
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.arm import Arm
from pneunet_ros.curvature import IntrinsicCurvature
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect
from pneunet_ros.errors import ModelError
from pneunet_ros.moment_law import law_fields, MOMENT_LAWS, MomentLaw
from pneunet_ros.noise import ModelCovariance, SensorNoise
from pneunet_ros.output import atomic_output
from pneunet_ros.units import quantities
from ruamel.yaml import YAML
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.error import YAMLError

SCHEMA_VERSION = 1
LARGEST_FILE = 1_000_000  # bytes
LARGEST_CONTENT = 1_000_000  # values, counted as often as aliases repeat them
TOP = (
    'schema_version',
    'name',
    'arm',
    'intrinsic_curvature',
    'moment_law',
    'effects',
    'sensors',
    'covariance',
    'sources',
    'provenance',
)
LONGEST_SENTENCE = 600  # characters
OPTIONAL = {'effects', 'covariance', 'sources', 'provenance'}


class PlainConstructor(SafeConstructor):
    """Plain values alone: lists of merge keys would grow without bound, and nobody needs one."""

    def flatten_mapping(self, node: Any) -> None:
        """Refuse merge keys."""
        for key, _ in node.value:
            if key.tag == 'tag:yaml.org,2002:merge':
                raise ConstructorError(
                    problem='merge keys (<<) are not read here: write the values out',
                    problem_mark=key.start_mark,
                )
        super().flatten_mapping(node)


def load_model(path: str | Path) -> Arm:
    """Read a model file; ModelError names the file, the key and what is allowed there."""
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ModelError(
                f'{path} is larger than {LARGEST_FILE // 1_000_000} MB: no model file'
            )
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f'cannot read the model file {path}: {error}') from None
    try:
        yaml = YAML(typ='safe', pure=True)
        yaml.Constructor = PlainConstructor
        content = yaml.load(text)
    except (YAMLError, ValueError, LookupError, RecursionError) as error:
        raise ModelError(f'{path} is not valid YAML: {one_line(error)}') from None
    try:
        if size_of(content, {}) > LARGEST_CONTENT:
            raise ModelError(f'aliases make it more than {LARGEST_CONTENT:,} values')
        return arm_from_mapping(content)
    except ModelError as error:
        raise ModelError(f'{path}: {one_line(error)}') from None


def one_line(error: Exception) -> str:
    """Return the text of an error, in one line of bounded length."""
    words = ' '.join(str(error).split())
    return words if len(words) <= LONGEST_SENTENCE else f'{words[:LONGEST_SENTENCE]} ...'


def size_of(content: Any, known: dict[int, float]) -> float:
    """How many values this is with all aliases written out; infinite where it holds itself."""
    if not isinstance(content, (dict, list)):
        return 1.0
    if id(content) not in known:
        known[id(content)] = math.inf
        values = content.values() if isinstance(content, dict) else content
        known[id(content)] = 1.0 + sum(size_of(value, known) for value in values)
    return known[id(content)]


def save_model(arm: Arm, path: str | Path, overwrite: bool = False) -> None:
    """Write a model file, whole or not at all; an existing file is refused without `overwrite`."""
    yaml = YAML(typ='safe', pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 99
    stream = io.StringIO()
    yaml.dump(mapping_from_arm(arm), stream)
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(stream.getvalue(), encoding='utf-8')


def model_hash(arm: Arm) -> str:
    """Identity of a model: SHA-256 over its content, whatever the layout of the file."""
    canonical = json.dumps(mapping_from_arm(arm), sort_keys=True, default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def arm_from_mapping(content: Any) -> Arm:
    """Build the arm from the content of a model file."""
    top = block(content, '', TOP, OPTIONAL)
    if isinstance(top['schema_version'], bool) or top['schema_version'] != SCHEMA_VERSION:
        raise ModelError(
            f'schema_version {top["schema_version"]!r} is not known; known: {SCHEMA_VERSION}'
        )
    arm_keys = ('length', 'weight', 'clamp_angle', 'target_arclength')
    arm = block(top['arm'], 'arm', arm_keys, {'clamp_angle', 'target_arclength'})
    curvature_keys = ('pressure', 'arclength', 'curvature')
    curvature = block(top['intrinsic_curvature'], 'intrinsic_curvature', curvature_keys)
    if not isinstance(top['name'], str) or not top['name']:
        raise ModelError(f'name must be a text, not {top["name"]!r}')
    covariance = top.get('covariance')
    return Arm(
        name=top['name'],
        **{key: number(value, f'arm.{key}') for key, value in arm.items() if key != arm_keys[3]},
        target_arclength=given(arm.get('target_arclength'), []),
        intrinsic_curvature=IntrinsicCurvature(**curvature),
        moment_law=law_from_mapping(top['moment_law']),
        effects=effects_from_mapping(given(top.get('effects'), {})),
        sensors=SensorNoise(**numbers_of(SensorNoise, top['sensors'], 'sensors')),
        covariance=None if covariance is None else covariance_from_mapping(covariance),
        sources=texts(given(top.get('sources'), {}), 'sources'),
        provenance=tree(given(top.get('provenance'), {}), 'provenance'),
    )


def mapping_from_arm(arm: Arm) -> dict[str, Any]:
    """Return the content of a model file, in the order of its documentation."""
    law = arm.moment_law
    return {
        'schema_version': SCHEMA_VERSION,
        'name': arm.name,
        'arm': {
            'length': arm.length,
            'weight': arm.weight,
            'clamp_angle': arm.clamp_angle,
            'target_arclength': arm.target_arclength.tolist(),
        },
        'intrinsic_curvature': {
            key: getattr(arm.intrinsic_curvature, key).tolist()
            for key in ('pressure', 'arclength', 'curvature')
        },
        'moment_law': {'kind': law.kind}
        | {key: plain(getattr(law, key)) for key in law_fields(type(law))},
        'effects': {
            effect.name: {item.name: getattr(effect, item.name) for item in quantities(effect)}
            for effect in arm.effects
        },
        'sensors': {item.name: getattr(arm.sensors, item.name) for item in fields(arm.sensors)},
        'covariance': None
        if arm.covariance is None
        else {
            'quantities': list(arm.covariance.quantities),
            'factor': arm.covariance.factor.tolist(),
        },
        'sources': dict(arm.sources),
        'provenance': dict(arm.provenance),
    }


def law_from_mapping(content: Any) -> MomentLaw:
    """Build the moment law that `kind` names."""
    kinds = ', '.join(MOMENT_LAWS)
    kind = mapping(content, 'moment_law').get('kind')
    if not isinstance(kind, str) or kind not in MOMENT_LAWS:
        raise ModelError(f'moment_law.kind must be one of {kinds}, not {kind!r}')
    law = MOMENT_LAWS[kind]
    values = block(content, 'moment_law', ('kind', *law_fields(law)))
    del values['kind']
    scalar = {item.name for item in quantities(law)}
    return law(
        **{
            key: number(value, f'moment_law.{key}') if key in scalar else value
            for key, value in values.items()
        }
    )


def effects_from_mapping(content: Any) -> tuple[Effect, ...]:
    """Build the effects that the file names, with their parameters."""
    named = block(content, 'effects', tuple(EFFECTS), set(EFFECTS))
    return tuple(
        EFFECTS[name](**numbers_of(EFFECTS[name], given(values, {}), f'effects.{name}'))
        for name, values in named.items()
    )


def covariance_from_mapping(content: Any) -> ModelCovariance:
    """Build the low-rank covariance."""
    values = block(content, 'covariance', ('quantities', 'factor'))
    names = values['quantities']
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ModelError('covariance.quantities must be a list of dotted names')
    return ModelCovariance(quantities=tuple(names), factor=values['factor'])


def mapping(content: Any, where: str) -> dict[str, Any]:
    """Return a mapping with text keys, or ModelError."""
    if not isinstance(content, Mapping) or not all(isinstance(key, str) for key in content):
        raise ModelError(f'{where or "the file"} must be a mapping of names to values')
    return dict(content)


def block(
    content: Any, where: str, known: tuple[str, ...], optional: set[str] | None = None
) -> dict[str, Any]:
    """Return a mapping that holds all of the known keys (but the optional ones) and no other."""
    values = mapping(content, where)
    prefix = f'{where}.' if where else ''
    for key in values:
        if key not in known:
            raise ModelError(f'unknown key {prefix}{key}; known here: {", ".join(known)}')
    missing = [key for key in known if key not in values and key not in (optional or set())]
    if missing:
        raise ModelError(f'{prefix}{missing[0]} is missing; needed here: {", ".join(known)}')
    return values


def numbers_of(owner: type, content: Any, where: str) -> dict[str, float]:
    """Return the quantities of a dataclass from a mapping; those with a default are optional."""
    declared = quantities(owner)
    optional = {item.name for item in declared if item.default is not MISSING}
    values = block(content, where, tuple(item.name for item in declared), optional)
    return {key: number(value, f'{where}.{key}') for key, value in values.items()}


def number(value: Any, where: str) -> float:
    """Return a number of the file."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
        raise ModelError(f'{where} must be a number in SI units, not {value!r}')
    try:
        return float(value)
    except OverflowError:
        raise ModelError(f'{where} is too large for a number in SI units') from None


def texts(content: Any, where: str) -> dict[str, str]:
    """Return a mapping of names to texts."""
    values = mapping(content, where)
    for key, value in values.items():
        if not isinstance(value, str):
            raise ModelError(f'{where}.{key} must be a text, not {value!r}')
    return values


def tree(content: Any, where: str) -> dict[str, Any]:
    """Return a mapping with text keys, and so are all mappings inside."""
    values = mapping(content, where)
    inside: list[Any] = list(values.values())
    while inside:
        value = inside.pop()
        if isinstance(value, Mapping):
            inside.extend(mapping(value, where).values())
        elif isinstance(value, list):
            inside.extend(value)
    return values


def given(value: Any, otherwise: Any) -> Any:
    """Return what a file says at a key, or what an empty place stands for."""
    return otherwise if value is None else value


def plain(value: Any) -> Any:
    """Return an array as nested lists, anything else as it is."""
    return value.tolist() if isinstance(value, np.ndarray) else value
