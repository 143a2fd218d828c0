"""Provenance of outputs: recordings, settings, and versions."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
import platform
from typing import TYPE_CHECKING

from pneunet_ros import __version__
from pneunet_ros.cli import verb
from pneunet_ros.core.printable import printable

if TYPE_CHECKING:
    from pneunet_ros.calibration.calibration import Calibration
    from pneunet_ros.measurement.dataset import RecordingData


def provenance_of(
    arguments: Namespace, calibration: Calibration, roles: Mapping[str, Sequence[RecordingData]]
) -> dict[str, object]:
    """Return the provenance of a calibrated model, which is deterministic and has no seed."""
    from pneunet_ros.offline.calibration_files import inputs_of

    joint = calibration.joint
    lost = () if calibration.motion is None else calibration.motion.lost
    paths = [
        (role if run.name not in lost or role == 'motion' else 'left out', [Path(run.name)])
        for role, runs in roles.items()
        for run in runs
    ]
    return {
        'source': f'pneunet calibrate {__version__}',
        'recordings': inputs_of(paths),
        'arm': printable((arguments.arm or arguments.earlier or Path(verb.PAPER_ARM)).name),
        'continued': None if arguments.earlier is None else printable(arguments.earlier.name),
        'chi_squared_per_coordinate': round(joint.chi_squared / joint.dof, 4),
        'coordinates': joint.dof,
        'covariance_share': round(calibration.explained_variance, 4),
    }


def versions() -> dict[str, str]:
    """Return the versions of all software that may affect the numbers."""
    import numpy as np
    import scipy

    return {
        'pneunet_ros': __version__,
        'python': platform.python_version(),
        'numpy': np.__version__,
        'scipy': scipy.__version__,
    }
