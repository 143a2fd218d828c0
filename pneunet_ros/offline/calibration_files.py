"""Files of a calibration: provenance of the model, and the posterior for continuing it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.calibration import elongation
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.moment_law_parameters import (
    MajidiParameters,
    MOMENT_LAW_PARAMETERS,
    PiecewiseParameters,
)
from pneunet_ros.calibration.parameters import PosteriorState
from pneunet_ros.core.errors import ModelError, PneunetError, RequestError
from pneunet_ros.core.paths import sibling_path
from pneunet_ros.core.printable import printable
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.files.npz import ArchiveError, Declared, read_arrays
from pneunet_ros.files.regular_file import readable
from pneunet_ros.files.yaml_file import one_line
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.starting_arm import has_invented_stiffness, INVENTED
from pneunet_ros.recordings.bag_folder import stored_files
from pneunet_ros.recordings.mcap_file import check_is_mcap
from pneunet_ros.recordings.plain_mcap import plain_mcap

KNOWLEDGE_SUFFIX = '.knowledge.npz'
PIECE = 1 << 20  # bytes read at a time
KNOWLEDGE = {
    'pressure': Declared(axes=('rows',), increasing=True),
    'arclength': Declared(axes=('knots',), increasing=True),
    'kind': Declared(kind='text'),
    'stiffness': Declared(),
    'low': Declared(),
    'high': Declared(),
    'values': Declared(axes=('values',)),
    'placement': Declared(axes=('placement',)),
    'covariance': Declared(axes=('all', 'all'), definite='positive'),
    # Missing in files of older versions.
    'information': Declared(axes=('values', 'values'), definite='semi', required=False),
    'shapes': Declared(kind='integer', required=False),
    'elongates': Declared(kind='integer', required=False),
    'arm': Declared(axes=('reference',), required=False),
}


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a recording: of its file, or of the files of a rosbag2 folder."""
    digest = hashlib.sha256()
    for file in stored_files(path):
        with readable(file) as stream:
            while piece := stream.read(PIECE):
                digest.update(piece)
    return digest.hexdigest()


def check_recordings(paths: Iterable[Path]) -> None:
    """Raise RecordingError if a file is missing or not a recording, before any file is read."""
    for path in paths:
        for file in stored_files(path):
            check_is_mcap(plain_mcap(file), file)


def inputs_of(roles: Iterable[tuple[str, Sequence[Path]]]) -> list[dict[str, str]]:
    """Return path, hash and role of every recording."""
    return [
        {'file': printable(path.name), 'sha256': file_hash(path), 'role': role}
        for role, paths in roles
        for path in paths
    ]


def fitted_recordings(arm: Arm) -> list[dict[str, str]]:
    """Return name, hash and role of the recordings to which the statics of an arm were fitted."""
    recordings = arm.provenance.get('recordings')
    return [
        {'file': str(item['file']), 'sha256': str(item['sha256']), 'role': f'in {arm.name}'}
        for item in (recordings if isinstance(recordings, Sequence) else ())
        if isinstance(item, Mapping)
        and item.keys() >= {'file', 'sha256', 'role'}
        and item['role'] not in ('motion', 'left out')
    ]


def check_distinct(inputs: list[dict[str, str]]) -> None:
    """Reject a recording given twice, which would count twice and could not test a model."""
    seen: dict[str, dict[str, str]] = {}
    for item in inputs:
        other = seen.setdefault(item['sha256'], item)
        if other is not item:
            raise RequestError(
                f'{item["file"]} ({item["role"]}) and {other["file"]} ({other["role"]}) are the '
                'same recording: give it only once',
                reason='given_twice',
            )


def described_arm(
    calibration: Calibration, name: str, frame: Arm, provenance: dict[str, Any]
) -> Arm:
    """Return the calibrated arm with its name and the source of each number."""
    arm, joint = calibration.arm, calibration.joint
    sources = {key: text for key, text in frame.sources.items() if key.startswith('arm.')}
    fitted = f'fitted to {len(joint.runs)} recordings'
    sources['intrinsic_curvature'] = fitted
    if elongation.KEY in arm.sources:
        sources[elongation.KEY] = arm.sources[elongation.KEY]
    law = joint.parameters.law
    if isinstance(law, MajidiParameters):
        sources['moment_law.modulus'] = fitted
        assumed = (
            'assumed: the cross-section of the paper (Figure 1), because the given arm has none'
        )
        for key in law.section:
            source = frame.sources.get(f'moment_law.{key}', f'as in {frame.name}')
            sources[f'moment_law.{key}'] = assumed if law.assumed else source
    elif law is not None:
        sources['moment_law'] = fitted
        if isinstance(law, PiecewiseParameters):
            sources['moment_law.moment_offset'] = (
                'fixed at zero, because it cannot be distinguished from kappa_p0'
            )
    else:
        placeholder = f' ({INVENTED})' if has_invented_stiffness(frame) else ''
        sources['moment_law'] = (
            f'not fitted, because there was no loaded recording; as in {frame.name}{placeholder}'
        )
    for key, text in calibration.noise.sources.items():
        sources[f'sensors.{key}'] = text
    return replace(arm, name=printable(name), sources=sources, provenance=provenance)


def knowledge_file(model: Path) -> Path:
    """Return the path of the posterior of a model, e.g. arm.knowledge.npz for arm.yaml."""
    return sibling_path(model, f'{model.stem}{KNOWLEDGE_SUFFIX}')


def save_knowledge(knowledge: PosteriorState, model: Path, *, overwrite: bool) -> None:
    """Write the posterior next to its model file."""
    with atomic_output(knowledge_file(model), overwrite=overwrite) as temporary:
        values = {item.name: getattr(knowledge, item.name) for item in fields(knowledge)}
        arrays = {
            name: np.asarray(int(value) if isinstance(value, bool) else value)
            for name, value in values.items()
            if value is not None
        }
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def load_knowledge(model: Path) -> PosteriorState:
    """Read the posterior saved next to a model file; ModelError if missing or damaged."""
    path = knowledge_file(model)
    try:
        values = read_arrays(path, KNOWLEDGE)
        if values['kind'] not in ('', *MOMENT_LAW_PARAMETERS):
            allowed = ', '.join(MOMENT_LAW_PARAMETERS)
            raise ArchiveError(
                f'its kind of moment law is not one of {allowed}', reason='unknown_kind'
            )
        values.setdefault('information', np.zeros((values['values'].size,) * 2))
        if 'elongates' in values:
            values['elongates'] = bool(values['elongates'])
        return PosteriorState(**values)
    except FileNotFoundError:
        raise ModelError(
            f'{path} is missing: `pneunet calibrate` writes it next to the model, and --continue '
            'needs it; recalibrate with all recordings',
            reason='not_found',
        ) from None
    except (OSError, PneunetError) as error:
        raise ModelError(
            f'{path} is damaged: {one_line(error)}; recalibrate', reason='damaged'
        ) from None
