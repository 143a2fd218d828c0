"""The scenario file of the virtual lab: YAML in SI -> `Scenario`. Unknown keys are errors."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pneunet_ros.core.arrays import table_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import list_fields
from pneunet_ros.files.yaml_file import or_default, YamlFile
from pneunet_ros.lab.lab_arm import LabArm, vary_arm
from pneunet_ros.lab.lab_effect import LabEffect
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.outside_effects import ALL_EFFECTS
from pneunet_ros.lab.protocols import Protocol, PROTOCOLS, SlowRamp
from pneunet_ros.lab.scenario import Detail, lab_effect, Scenario
from pneunet_ros.lab.sensors import LabNoise, Rates

SCHEMA_VERSION = 1
FOLDER = 'scenarios'  # of the scenarios in the package
NEEDED = ('schema_version', 'name', 'arm', 'protocol')
OPTIONAL = (
    'seed',
    'start',
    'arm_seed',
    'effects',
    'richness',
    'noise',
    'rates',
    'detail',
    'motion',
)
ARM_KEYS = (
    'schema_version',
    'name',
    'length',
    'weight',
    'tip_cap',
    'clamp_angle',
    'targets',
    'intrinsic_curvature',
    'moment_law',
)
FILE = YamlFile(kind='scenario file', error=RequestError, number_name='a number in SI units')
ARM_FILE = YamlFile(kind='lab arm file', error=RequestError, number_name='a number in SI units')


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file; RequestError names the file, the key and the allowed values."""
    path = Path(path)
    return FILE.load(path, lambda content: scenario_from_mapping(content, path.parent))


def load_lab(path: str | Path) -> Scenario:
    """Read a scenario file, or an arm file, which gives that arm with the lab's defaults."""
    path = Path(path)
    return FILE.load(path, lambda content: lab_from_mapping(content, path.parent))


def lab_from_mapping(content: Any, folder: Path) -> Scenario:
    """Build a scenario from a scenario file, or from an arm file, which has no `arm` key."""
    if isinstance(content, dict) and 'arm' not in content and 'protocol' not in content:
        arm = arm_from_mapping(content, '')
        return Scenario(name=arm.name, arm=arm, protocol=SlowRamp())
    return scenario_from_mapping(content, folder)


def scenario_from_mapping(content: Any, folder: Path) -> Scenario:
    """Build a scenario from the content of its file; its arm may be a file in that folder."""
    top = FILE.block(content, '', (*NEEDED, *OPTIONAL), set(OPTIONAL))
    FILE.check_version(top['schema_version'], SCHEMA_VERSION)
    arm = top['arm']
    if isinstance(arm, str):
        if not arm or Path(arm).name != arm or arm == '..':
            raise RequestError(
                f'arm must be a block, or the name of a file in the same folder, not {arm!r}',
                reason='wrong_kind',
            )
        arm = ARM_FILE.load(folder / arm, lambda content: arm_from_mapping(content, ''))
    else:
        arm = arm_from_mapping(arm, 'arm')
    richness = FILE.number(or_default(top.get('richness'), 0.0), 'richness')
    return Scenario(
        name=text(top['name'], 'name'),
        seed=whole_number(or_default(top.get('seed'), 0), 'seed'),
        start=FILE.number(or_default(top.get('start'), 0.0), 'start'),
        arm=vary_arm(arm, whole_number(or_default(top.get('arm_seed'), 0), 'arm_seed')),
        effects=effects_from_mapping(or_default(top.get('effects'), {}), richness),
        richness=richness,
        protocol=protocol_from_mapping(top['protocol']),
        noise=LabNoise(**FILE.numbers_of(LabNoise, or_default(top.get('noise'), {}), 'noise')),
        rates=Rates(**FILE.numbers_of(Rates, or_default(top.get('rates'), {}), 'rates')),
        detail=Detail(**FILE.numbers_of(Detail, or_default(top.get('detail'), {}), 'detail')),
        motion=None
        if 'motion' not in top
        else LabMotion(**values_of(LabMotion, or_default(top['motion'], {}), 'motion')),
    )


def arm_from_mapping(content: Any, where: str) -> LabArm:
    """Build an arm of the lab from its file or from the block `arm` of a scenario."""
    optional = {'tip_cap', 'clamp_angle', *(['schema_version'] if where else [])}
    values = FILE.block(content, where, ARM_KEYS, optional)
    FILE.check_version(values.get('schema_version', SCHEMA_VERSION), SCHEMA_VERSION)
    prefix = f'{where}.' if where else ''
    curvature, law = (f'{prefix}{name}' for name in ('intrinsic_curvature', 'moment_law'))
    kappa = FILE.block(values['intrinsic_curvature'], curvature, ('pressure', 'modes'))
    moment = FILE.block(values['moment_law'], law, ('pressure', 'split', 'rigidity'))
    return LabArm(
        name=text(values['name'], f'{prefix}name'),
        length=FILE.number(values['length'], f'{prefix}length'),
        weight=FILE.number(values['weight'], f'{prefix}weight'),
        tip_cap=FILE.number(values.get('tip_cap', 0.0), f'{prefix}tip_cap'),
        clamp_angle=FILE.number(values.get('clamp_angle', 0.0), f'{prefix}clamp_angle'),
        targets=table_array(values['targets'], f'{prefix}targets', 1, RequestError),
        curvature_pressure=table_array(
            kappa['pressure'], f'{curvature}.pressure', 1, RequestError
        ),
        modes=table_array(kappa['modes'], f'{curvature}.modes', 2, RequestError),
        law_pressure=table_array(moment['pressure'], f'{law}.pressure', 1, RequestError),
        split=table_array(moment['split'], f'{law}.split', 1, RequestError),
        rigidity=table_array(moment['rigidity'], f'{law}.rigidity', 2, RequestError),
    )


def effects_from_mapping(content: Any, richness: float) -> tuple[LabEffect, ...]:
    """Build the effects of a scenario; `richness` is the default richness."""
    effects = FILE.block(content, 'effects', tuple(ALL_EFFECTS), set(ALL_EFFECTS))
    built = []
    for name, parameters in effects.items():
        kind = ALL_EFFECTS[name]
        numbers = FILE.numbers_of(kind, or_default(parameters, {}), f'effects.{name}')
        built.append(lab_effect(name, numbers, richness))
    return tuple(built)


def protocol_from_mapping(content: Any) -> Protocol:
    """Build the protocol of a scenario."""
    values = FILE.mapping(content, 'protocol')
    kind = PROTOCOLS.get(str(values.get('kind')))
    if kind is None:
        raise RequestError(
            f'protocol.kind must be one of {", ".join(PROTOCOLS)}', reason='unknown_kind'
        )
    return kind(**values_of(kind, content, 'protocol', ('kind',)))


def values_of(
    kind: type[Protocol] | type[LabMotion],
    content: Any,
    where: str,
    other_keys: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Return numbers and lists of numbers of a block; other keys are ignored."""
    values, lists = FILE.mapping(content, where), list_fields(kind)
    numbers: dict[str, Any] = {**FILE.numbers_of(kind, content, where, (*other_keys, *lists))}
    return numbers | {
        name: tuple(table_array(values[name], f'{where}.{name}', 1, RequestError).tolist())
        for name in lists
        if name in values
    }


def changes_of(pairs: Iterable[str]) -> dict[str, dict[str, float]]:
    """Return parameters of effects by effect, from texts such as `gravity.weight_y=-1.5`."""
    changes: dict[str, dict[str, float]] = {}
    for pair in pairs:
        name, equals, value = pair.partition('=')
        effect, dot, parameter = name.partition('.')
        try:
            number = float(value)
        except ValueError:
            number = float('nan')
        if not (equals and dot and parameter) or number != number:
            raise RequestError(
                f'effect {pair} is not of the form NAME.PARAMETER=VALUE with a number as VALUE',
                reason='wrong_form',
            )
        changes.setdefault(effect, {})[parameter] = number
    return changes


def text(value: Any, where: str) -> str:
    """Return a text from the file."""
    if not isinstance(value, str) or not value:
        raise RequestError(f'{where} must be a text, not {value!r}', reason='not_a_text')
    return value


def whole_number(value: Any, where: str) -> int:
    """Return an integer from the file that can be used as a seed."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise RequestError(
            f'{where} must be a whole number, 0 or more, not {value!r}', reason='not_a_number'
        )
    return value
