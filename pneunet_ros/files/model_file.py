"""The model file: YAML in SI <-> an immutable `Arm`. Unknown keys are errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect
from pneunet_ros.effects.user_effects import add_installed_effects
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.files.yaml_file import or_default, YamlFile
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.gravity import Gravity, gravity_of, OUT_OF_PLANE
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import law_fields, MOMENT_LAWS, MomentLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import ModelCovariance, PlacementKnown, SensorNoise
from ruamel.yaml import YAML
from ruamel.yaml.representer import SafeRepresenter

SCHEMA_VERSION = 1
TOP = (
    'schema_version',
    'name',
    'arm',
    'intrinsic_curvature',
    'moment_law',
    'effects',
    'sensors',
    'covariance',
    'domain',
    'gravity',
    'motion',
    'sources',
    'provenance',
)
OPTIONAL = {'effects', 'covariance', 'domain', 'gravity', 'motion', 'sources', 'provenance'}
PLACEMENT_KEYS = ('mean', 'std', 'factor', 'origin')
MODEL_FILE = YamlFile(kind='model file', error=ModelError, number_name='a number in SI units')


class PointedRepresenter(SafeRepresenter):
    """YAML representer that writes 1e-05 as 1.0e-05: YAML 1.1 reads the former as a text."""

    def represent_float(self, data: float) -> Any:
        """Return a number with a decimal point."""
        node = super().represent_float(data)
        if '.' not in node.value:
            node.value = node.value.replace('e', '.0e')
        return node


PointedRepresenter.add_representer(float, PointedRepresenter.represent_float)


def load_model(path: str | Path) -> Arm:
    """Read a calibrated arm from a model file (YAML, SI).

    Args:
        path: model file; docs/model.md describes the format.

    Returns:
        The arm.

    Raises:
        ModelError: names the file, the key and the allowed values.
    """
    return MODEL_FILE.load(path, arm_from_mapping)


def save_model(arm: Arm, path: str | Path, overwrite: bool = False) -> None:
    """Write a calibrated arm to a model file, atomically.

    Args:
        arm: the arm.
        path: where to write the file.
        overwrite: whether to replace an existing file.

    Raises:
        PneunetError: the file exists already, or cannot be written.
    """
    yaml = YAML(typ='safe', pure=True)
    yaml.Representer = PointedRepresenter
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 99
    stream = io.StringIO()
    yaml.dump(mapping_from_arm(arm), stream)
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(stream.getvalue(), encoding='utf-8')


def model_hash(arm: Arm) -> str:
    """Return the SHA-256 hash of a model's content, independent of the layout of the file."""
    canonical = json.dumps(mapping_from_arm(arm), sort_keys=True, default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def model_label(arm: Arm) -> str:
    """Return a name and a short hash that identify a model."""
    return f'{arm.name} {model_hash(arm)[:12]}'


def arm_from_mapping(content: Any) -> Arm:
    """Build the arm from the content of a model file."""
    top = MODEL_FILE.block(content, '', TOP, OPTIONAL)
    MODEL_FILE.check_version(top['schema_version'], SCHEMA_VERSION)
    arm_keys = ('length', 'weight', 'tip_cap', 'clamp_angle', 'target_arclength')
    arm = MODEL_FILE.block(top['arm'], 'arm', arm_keys, set(arm_keys[2:]))
    curvature_keys = ('pressure', 'arclength', 'curvature')
    curvature = MODEL_FILE.block(top['intrinsic_curvature'], 'intrinsic_curvature', curvature_keys)
    if not isinstance(top['name'], str) or not top['name']:
        raise ModelError(f'name must be a text, not {top["name"]!r}', reason='not_a_text')
    covariance, domain = top.get('covariance'), top.get('domain')
    gravity, motion = top.get('gravity'), top.get('motion')
    return Arm(
        name=top['name'],
        divided=(),
        **{
            key: MODEL_FILE.number(value, f'arm.{key}')
            for key, value in arm.items()
            if key != arm_keys[4]
        },
        target_arclength=or_default(arm.get('target_arclength'), []),
        intrinsic_curvature=IntrinsicCurvature(**curvature),
        moment_law=law_from_mapping(top['moment_law']),
        effects=effects_from_mapping(or_default(top.get('effects'), {})),
        sensors=SensorNoise(**MODEL_FILE.numbers_of(SensorNoise, top['sensors'], 'sensors')),
        covariance=None if covariance is None else covariance_from_mapping(covariance),
        domain=None if domain is None else domain_from_mapping(domain),
        gravity=Gravity() if gravity is None else gravity_from_mapping(gravity),
        motion=None
        if motion is None
        else Motion(**MODEL_FILE.numbers_of(Motion, motion, 'motion')),
        sources=texts(or_default(top.get('sources'), {}), 'sources'),
        provenance=tree(or_default(top.get('provenance'), {}), 'provenance'),
    )


def mapping_from_arm(arm: Arm) -> dict[str, Any]:
    """Return the content of a model file, in the order of its documentation."""
    law, down = arm.moment_law, arm.gravity.direction
    content = {
        'schema_version': SCHEMA_VERSION,
        'name': arm.name,
        'arm': {
            'length': arm.length,
            'weight': arm.weight,
            'tip_cap': arm.tip_cap,
            'clamp_angle': arm.clamp_angle,
            'target_arclength': arm.target_arclength,
        },
        'intrinsic_curvature': {
            key: getattr(arm.intrinsic_curvature, key)
            for key in ('pressure', 'arclength', 'curvature')
        },
        'moment_law': {'kind': law.kind}
        | {key: getattr(law, key) for key in law_fields(type(law))},
        'effects': {
            effect.name: {item.name: getattr(effect, item.name) for item in quantities(effect)}
            for effect in arm.effects
        },
        'sensors': {item.name: getattr(arm.sensors, item.name) for item in fields(arm.sensors)},
        'covariance': None
        if arm.covariance is None
        else {
            'quantities': arm.covariance.quantities,
            'factor': arm.covariance.factor,
            **placement_block(arm.covariance.placement),
            **({'guessed': arm.covariance.guessed} if arm.covariance.guessed else {}),
        },
        'domain': None
        if arm.domain is None
        else {'pressure': arm.domain.pressure, 'end_load': arm.domain.end_load},
        **({} if down == OUT_OF_PLANE else {'gravity': {'direction': down}}),
        **({} if arm.motion is None else {'motion': asdict(arm.motion)}),
        'sources': arm.sources,
        'provenance': arm.provenance,
    }
    return dict(plain(content))


def law_from_mapping(content: Any) -> MomentLaw:
    """Build the moment law named by `kind`."""
    kinds = ', '.join(MOMENT_LAWS)
    kind = MODEL_FILE.mapping(content, 'moment_law').get('kind')
    if not isinstance(kind, str) or kind not in MOMENT_LAWS:
        raise ModelError(
            f'moment_law.kind must be one of {kinds}, not {kind!r}', reason='unknown_kind'
        )
    law = MOMENT_LAWS[kind]
    values = MODEL_FILE.block(content, 'moment_law', ('kind', *law_fields(law)))
    del values['kind']
    scalar = {item.name for item in quantities(law)}
    return law(
        **{
            key: MODEL_FILE.number(value, f'moment_law.{key}') if key in scalar else value
            for key, value in values.items()
        }
    )


def effects_from_mapping(content: Any) -> tuple[Effect, ...]:
    """Build the effects in the file, with their parameters."""
    add_installed_effects()
    for name in MODEL_FILE.mapping(content, 'effects'):
        if name not in EFFECTS:
            raise ModelError(
                f'unknown key effects.{name}; known effects: {", ".join(EFFECTS)}. To use an '
                'effect of your own, give its folder with --effects-path DIR, or with the '
                'parameter effects_path of a node',
                reason='unknown_key',
            )
    named = MODEL_FILE.block(content, 'effects', tuple(EFFECTS), set(EFFECTS))
    return tuple(
        EFFECTS[name](
            **MODEL_FILE.numbers_of(EFFECTS[name], or_default(values, {}), f'effects.{name}')
        )
        for name, values in named.items()
    )


def covariance_from_mapping(content: Any) -> ModelCovariance:
    """Build the low-rank covariance."""
    optional = {'placement', 'guessed'}
    keys = ('quantities', 'factor', 'placement', 'guessed')
    values = MODEL_FILE.block(content, 'covariance', keys, optional)
    names = values['quantities']
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ModelError(
            'covariance.quantities must be a list of dotted names', reason='not_a_list'
        )
    placement = values.get('placement')
    if placement is not None:
        placement = PlacementKnown(
            **MODEL_FILE.block(placement, 'covariance.placement', PLACEMENT_KEYS, {'origin'})
        )
    guessed = values.get('guessed', 0)
    if not isinstance(guessed, int) or isinstance(guessed, bool):
        raise ModelError(
            f'covariance.guessed must be a whole number, not {guessed!r}', reason='not_a_number'
        )
    return ModelCovariance(
        quantities=tuple(names), factor=values['factor'], placement=placement, guessed=guessed
    )


def placement_block(placement: PlacementKnown | None) -> dict[str, Any]:
    """Return the block for the placement; empty if it is unknown."""
    if placement is None:
        return {}
    return {'placement': {key: getattr(placement, key).tolist() for key in PLACEMENT_KEYS}}


def domain_from_mapping(content: Any) -> Domain:
    """Build the calibrated domain."""
    return Domain(**MODEL_FILE.block(content, 'domain', ('pressure', 'end_load')))


def gravity_from_mapping(content: Any) -> Gravity:
    """Build the direction of gravity."""
    return gravity_of(MODEL_FILE.block(content, 'gravity', ('direction',))['direction'])


def texts(content: Any, where: str) -> dict[str, str]:
    """Return a mapping of names to texts."""
    values = MODEL_FILE.mapping(content, where)
    for key, value in values.items():
        if not isinstance(value, str):
            raise ModelError(f'{where}.{key} must be a text, not {value!r}', reason='not_a_text')
    return values


def tree(content: Any, where: str) -> dict[str, Any]:
    """Return a mapping with text keys, recursively."""
    values = MODEL_FILE.mapping(content, where)
    inside: list[Any] = list(values.values())
    while inside:
        value = inside.pop()
        if isinstance(value, Mapping):
            inside.extend(MODEL_FILE.mapping(value, where).values())
        elif isinstance(value, list):
            inside.extend(value)
    return values


def plain(value: Any) -> Any:
    """Convert arrays to nested lists, and numbers of numpy to those of Python, at any depth."""
    if isinstance(value, Mapping):
        return {name: plain(inside) for name, inside in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inside) for inside in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
