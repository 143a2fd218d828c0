"""What the latched topic `model_info` of the estimator says."""

from __future__ import annotations

from pathlib import Path

from pneunet_ros.core.units import quantities
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.nodes.model_info import model_info


def estimator_info(estimator: Estimator, file: Path) -> str:
    """Return the JSON text for an estimator whose model was read from a file; numbers in SI."""
    arm, settings = estimator.arm, estimator.settings
    return model_info(
        arm,
        file,
        frame_id=settings.frame_id,
        pressure_range=list(arm.pressure_range),
        pressure_offset=settings.pressure_offset,
        effects={
            effect.name: {item.name: getattr(effect, item.name) for item in quantities(effect)}
            for effect in arm.effects
        },
        stations=settings.stations,
    )
