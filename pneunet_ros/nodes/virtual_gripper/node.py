"""The node `virtual_gripper`: virtual arms around an object, for the node `gripper`.

Arms and mounts are read from the parameters of the gripper. The object is a soft cylinder in the
middle of the gripper, along its direction, that pushes the tips back.
"""

from __future__ import annotations

from collections.abc import Iterator
import sys
from typing import Any, ClassVar

from pneunet_ros.core.health import Level, Report
from pneunet_ros.fusion.grasp import Gripper
from pneunet_ros.lab.live import Load
from pneunet_ros.nodes.configured_node import ConfiguredNode
from pneunet_ros.nodes.gripper.services import ask_all
from pneunet_ros.nodes.node_options import NodeOptions
from pneunet_ros.nodes.parameters import overrides
from pneunet_ros.nodes.params_file import params_files
from pneunet_ros.nodes.virtual_arm.node import VirtualArmNode
from pneunet_ros.nodes.virtual_gripper.configuration import (
    configured_virtual_gripper,
    PARAMETERS,
    simulated_gripper,
    VirtualGripperConfiguration,
)

USAGE = """usage: pneunet-virtual-gripper [--ros-args ...]

Simulates the arms of a gripper, with their valves, sensors and cameras, and an object between
them. The arms are those of the node gripper in a file of parameters, by default
config/gripper.yaml

  pneunet-virtual-gripper --ros-args -r __ns:=/hand --params-file my_gripper.yaml
  pneunet-virtual-gripper --ros-args -r __ns:=/hand -p object_width:=0.03
"""


class VirtualGripperNode(ConfiguredNode[VirtualGripperConfiguration]):
    """Simulates an object that pushes back the arms that reach into it."""

    INFO_TOPIC: ClassVar[str] = 'lab_info'

    def __init__(self) -> None:
        """Declare all parameters; `virtual_gripper_nodes` then makes the arms."""
        super().__init__('virtual_gripper', PARAMETERS, configured_virtual_gripper)
        played = f'{self.get_namespace().rstrip("/")}/gripper'
        self.gripper: Gripper
        self.gripper, self.frames = simulated_gripper(params_files(sys.argv), played)
        self.members: dict[str, VirtualArmNode] = {}
        self.forces = dict.fromkeys(self.gripper.mounts, 0.0)  # N

    def open(self) -> None:
        """Open the services and start, now that all arms exist."""
        self.open_services()
        self.call_every(1.0 / self.configuration.node.rate, self.push)
        self.log_ready()

    def push(self) -> None:
        """Push every arm in proportion to its penetration into the object."""
        settings, center = self.configuration.node, self.gripper.axis
        for arm, member in self.members.items():
            mount, inward = self.gripper.mounts[arm], self.gripper.inward(arm)
            tip = member.tip_now()
            if tip is None:
                continue
            surface = mount.origin + mount.axes[:, :2] @ tip + mount.thickness * inward
            depth = float(inward @ (surface - center)) + 0.5 * settings.object_width
            outward = -(mount.axes[:, :2].T @ inward)
            # An arm without mass yields at once, up to 300 times as far as the object.
            compliance_ratio = 1.0 / (
                1.0 + settings.object_stiffness * member.tip_compliance(outward)
            )
            force = self.forces[arm]
            force += compliance_ratio * (settings.object_stiffness * depth - force)
            self.forces[arm] = max(force, 0.0) * (settings.object_width > 0.0)
            force_x, force_y = (self.forces[arm] * outward).tolist()
            member.load = Load(force_x=force_x, force_y=force_y)

    def forget(self) -> str:
        """Replace the arms by unconditioned ones (no prior loading)."""
        for member in self.members.values():
            member.forget()
        return 'unconditioned arms (no prior loading), vented'

    def reload_model(self, request: Any, response: Any) -> Any:
        """Serve ~/reload_model: each arm reads its files again."""
        services = {member: member.reload_model for member in self.members.values()}
        return ask_all(services, request, response)

    def reconfigure(self, configuration: VirtualGripperConfiguration) -> None:
        """Continue with another object."""

    def diagnose(self) -> None:
        """Publish the grip force on the object."""
        values = {f'force_n/{arm}': f'{force:.6g}' for arm, force in self.forces.items()}
        values |= {'object_width_m': f'{self.configuration.node.object_width:.6g}'}
        values |= {'force_n': f'{sum(self.forces.values()):.6g}'}
        message = f'{len(self.forces)} virtual arms'
        self.publish_report('object', Report(level=Level.OK, message=message, values=values))


def virtual_gripper_nodes() -> Iterator[Any]:
    """Yield the nodes of a virtual gripper: its own, then the arms."""
    gripper = VirtualGripperNode()
    settings, namespace = gripper.configuration.node, gripper.get_namespace().rstrip('/')
    clock = {'use_sim_time': gripper.get_parameter('use_sim_time').value}
    yield gripper
    for number, (arm, frame) in enumerate(gripper.frames.items()):
        rates = {'rate': settings.rate, 'frame_rate': settings.frame_rate}
        parameters = {'seed': number, 'frame_id': frame} | rates
        member = VirtualArmNode(
            NodeOptions(
                namespace=f'{namespace}/{arm}',
                parameters=parameters | clock,
                foreign_parameters=overrides(gripper),
            )
        )
        gripper.members[arm] = member
        yield member
    gripper.open()
