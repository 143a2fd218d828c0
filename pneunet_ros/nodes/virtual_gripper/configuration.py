"""Configuration from the parameters of the virtual gripper and of the simulated gripper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json
from typing import Any

from pneunet_ros import __version__
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.settings import check_settings, setting
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import quantity
from pneunet_ros.fusion.grasp import Gripper
from pneunet_ros.nodes.gripper.configuration import (
    arms_of,
    configured_gripper,
    flatten_blocks,
    MOUNT,
)
from pneunet_ros.nodes.gripper.configuration import PARAMETERS as OF_GRIPPER
from pneunet_ros.nodes.parameters import ParameterTable
from pneunet_ros.nodes.params_file import parameters_of

SHIPPED = 'config/gripper.yaml'


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualGripperSettings:
    """The object between the arms."""

    object_width: float = quantity(
        0.04, unit='m', meaning='diameter of the object; 0: no object', bounds=(0.0, 1.0)
    )
    object_stiffness: float = quantity(
        30.0, unit='N/m', meaning='contact stiffness between object and tip', bounds=(0.1, 60.0)
    )
    rate: float = quantity(100.0, unit='Hz', meaning='rate of all readings', bounds=(1.0, 1000.0))
    frame_rate: float = quantity(
        30.0, unit='Hz', meaning='rate of targets of each arm', bounds=(0.1, 100.0)
    )
    frame_id: str = setting(BASE_FRAME, 'frame of the gripper')

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)


PARAMETERS = ParameterTable(
    owners=(VirtualGripperSettings,), read_only=frozenset({'rate', 'frame_rate', 'frame_id'})
)


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualGripperConfiguration:
    """The settings of a virtual gripper."""

    node: VirtualGripperSettings

    @property
    def model(self) -> str:
        """Identity of the gripper."""
        return 'virtual gripper'

    def info(self) -> str:
        """Return the content of the topic lab_info: the truth."""
        return json.dumps({'object_width': self.node.object_width, 'version': __version__})


def configured_virtual_gripper(
    values: Mapping[str, Any], current: VirtualGripperConfiguration | None
) -> VirtualGripperConfiguration:
    """Return the configuration of all parameter values; RequestError for invalid ones."""
    (node,) = PARAMETERS.settings(values)
    return VirtualGripperConfiguration(node=node)


def simulated_gripper(files: Sequence[str], name: str) -> tuple[Gripper, dict[str, str]]:
    """Return the simulated gripper, and the frames of its arms.

    files: parameter files; if there are none, the shipped one is used; name: full name of the node
    `gripper`. RequestError if its arms have no mounts.
    """
    given: dict[str, Any] = {}
    for path in files or [str(share_path(SHIPPED))]:
        given |= parameters_of(path, name)
    settings = configured_gripper(OF_GRIPPER.completed(given), None).node
    blocks, gripper = arms_of(settings, dict(flatten_blocks(given)))
    if gripper is None:
        raise RequestError(
            f'{", ".join(settings.arms)} have no {MOUNT}. Use the params_file of the gripper, '
            f'with a {MOUNT} in the block of each arm, as in {SHIPPED}',
            reason='missing',
        )
    frames = {
        arm: str(block.parameters['fusion'].get('frame_id', BASE_FRAME))
        for arm, block in blocks.items()
    }
    return gripper, frames
