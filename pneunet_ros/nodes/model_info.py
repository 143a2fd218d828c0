"""What the latched topic `model_info` says: which model is in use, as one JSON object."""

from __future__ import annotations

import json
from pathlib import Path

from pneunet_ros import __version__
from pneunet_ros.estimator import Estimator
from pneunet_ros.model_file import model_hash
from pneunet_ros.units import quantities


def model_info(estimator: Estimator, file: Path) -> str:
    """Return the JSON text for an estimator whose model was read from a file; numbers in SI."""
    arm, settings = estimator.arm, estimator.settings
    return json.dumps(
        {
            'name': arm.name,
            'hash': model_hash(arm),
            'file': str(file),
            'length': arm.length,
            'pressure_range': list(arm.pressure_range),
            'pressure_offset': settings.pressure_offset,
            'effects': {
                effect.name: {item.name: getattr(effect, item.name) for item in quantities(effect)}
                for effect in arm.effects
            },
            'frame_id': settings.frame_id,
            'stations': settings.stations,
            'version': __version__,
        }
    )
