"""Common parts of the configurations of an arm, and the content of `model_info`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from pneunet_ros import __version__
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.model_file import model_hash, model_label
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import error_left_out
from pneunet_ros.nodes.parameters import arm_from_file, model_path
from pneunet_ros.nodes.sensor_description import sensor_description


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmConfiguration(ABC):
    """An estimator or a fusion with the settings of its node."""

    node: Any

    @property
    @abstractmethod
    def arm(self) -> Arm:
        """The arm in use."""

    @property
    @abstractmethod
    def settings(self) -> EstimatorSettings:
        """The settings of its sensors."""

    @property
    def model(self) -> str:
        """Name and short hash of the model in use."""
        return model_label(self.arm)

    @property
    def left_out(self) -> str:
        """Describe the model error that the standard deviations do not include; empty if none."""
        return error_left_out(self.arm.covariance, self.arm.sources)

    @property
    def sensors(self) -> dict[str, Any]:
        """Meaning of sensor readings, by parameter."""
        return sensor_description(self.settings)

    def info_with(self, **entries: Any) -> str:
        """Return the content of the topic model_info, with additional entries."""
        arm, settings = self.arm, self.settings
        return model_info(
            arm,
            model_path(self.node.model_file),
            frame_id=settings.frame_id,
            pressure_range=list(arm.pressure_range),
            end_loads=None if arm.domain is None else arm.domain.end_load.tolist(),
            std_leaves_out=self.left_out,
            pressure_offset=settings.pressure_offset,
            sensors=self.sensors,
            stations=settings.stations,
            **entries,
        )


def arm_of(node: Any, current: ArmConfiguration | None) -> Arm:
    """Return the arm for a node's settings: that of `current`, or read from the model file."""
    if current is not None:
        before = current.node
        if (node.model_file, node.gravity) == (before.model_file, before.gravity):
            return current.arm
    return arm_from_file(node.model_file, node.effects_path, node.gravity)


def model_info(arm: Arm, file: Path, **entries: Any) -> str:
    """Return the JSON text of model_info for an arm from a file, with additional entries."""
    identity = {'name': arm.name, 'hash': model_hash(arm), 'file': str(file), 'length': arm.length}
    return json.dumps({**identity, **entries, 'version': __version__})
