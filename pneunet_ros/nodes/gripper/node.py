"""The node `gripper`: the nodes of several arms in one process and one thread.

Each arm has its estimator and, if requested, its fusion and tracker, in a namespace named after
the arm. These are the nodes of a single arm, with all their topics and services.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import sys
import time
from typing import Any, ClassVar

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.health import Level, Report
from pneunet_ros.fusion.grasp import Gripper
from pneunet_ros.nodes.configured_node import ConfiguredNode
from pneunet_ros.nodes.estimator.node import EstimatorNode
from pneunet_ros.nodes.fusion.node import FusionNode
from pneunet_ros.nodes.gripper.action import gripper_command, GripperGoals, serve_action
from pneunet_ros.nodes.gripper.configuration import (
    arms_of,
    check_own,
    configured_gripper,
    GripperConfiguration,
    is_used,
    PARAMETERS,
    parameters_of,
)
from pneunet_ros.nodes.gripper.grasping import Grasping
from pneunet_ros.nodes.gripper.services import ask_all
from pneunet_ros.nodes.node_options import NodeOptions
from pneunet_ros.nodes.parameters import overrides, undeclared_overrides
from pneunet_ros.nodes.params_file import params_files
from pneunet_ros.nodes.tracker.node import TrackerNode
from std_srvs.srv import Trigger

USAGE = """usage: pneunet-gripper [--ros-args ...]

Estimates all arms of a gripper in one process. The parameter arms lists their names; the
settings of each arm are in a block with its name, as in config/gripper.yaml:

  pneunet-gripper --ros-args --params-file config/gripper.yaml
  pneunet-gripper --ros-args -p arms:="[thumb, index]" -p thumb.model_file:=/path/to/thumb.yaml
"""
CLASSES: dict[str, Callable[[NodeOptions], Any]] = {
    'estimator': EstimatorNode,
    'fusion': FusionNode,
    'tracker': TrackerNode,
}


class GripperNode(ConfiguredNode[GripperConfiguration]):
    """Combines the estimates of all arms of a gripper and reports on them."""

    INFO_TOPIC: ClassVar[str] = 'gripper_info'

    def __init__(self) -> None:
        """Declare all parameters; `members_of` then makes the nodes of the arms."""
        super().__init__('gripper', PARAMETERS, configured_gripper)
        self.members: list[Any] = []
        self.grasping: Grasping | None = None

    def open(self, gripper: Gripper | None, fusions: Mapping[str, Any]) -> None:
        """Open services and topics, now that all arms exist."""
        self.open_services()
        if gripper is not None:
            self.grasping = Grasping(self, self.configuration.node, gripper, fusions)
            kind = gripper_command()
            if kind is not None:
                self.action = serve_action(self, GripperGoals(self.grasping, kind))
        self.create_service(Trigger, '~/zero_pressure', self.zero_pressure)
        self.check_given()
        self.log_ready()

    def check_given(self) -> None:
        """Raise RequestError for unknown parameters given to this node alone."""
        arms = self.configuration.node.arms
        alone = [
            name
            for name in undeclared_overrides(self)
            if name.partition('.')[0] not in (*arms, 'qos_overrides')  # of topics not open now
            and not any(name in overrides(member) for member in self.members)
        ]
        if alone:
            raise RequestError(
                f'{", ".join(alone)}: the gripper has no parameter of this name, and only a block '
                f'with the name of an arm ({", ".join(arms)}) gives parameters to its nodes',
                reason='unknown_key',
            )

    def unknown_parameters(self) -> list[str]:
        """Return given names without effect, including those in blocks of nodes not started."""
        settings = self.configuration.node
        return [
            name
            for name in super().unknown_parameters()
            if (
                not is_used(settings, name.partition('.')[2])
                if name.partition('.')[0] in settings.arms
                else not any(member.has_parameter(name) for member in self.members)
            )
        ]

    def forget(self) -> str:
        """Discard all readings of all arms."""
        for member in self.members:
            member.forget()
        if self.grasping is not None:
            self.grasping.forget()
        return 'all arms were reset'

    def zero_pressure(self, request: Any, response: Any) -> Any:
        """Serve ~/zero_pressure of a vented gripper; each node sets its own offset."""
        zeros = {member: member.zero.serve for member in self.members if hasattr(member, 'zero')}
        return ask_all(zeros, request, response)

    def reload_model(self, request: Any, response: Any) -> Any:
        """Serve ~/reload_model: each node reads its files again."""
        return ask_all({one: one.reload_model for one in self.members}, request, response)

    def reconfigure(self, configuration: GripperConfiguration) -> None:
        """Use the new command settings; all other parameters are fixed until restart."""
        if self.grasping is not None:
            self.grasping.settings = configuration.node

    def diagnose(self) -> None:
        """Publish the number of dropped frames per arm, and the grasp."""
        shed = {member.get_namespace(): member.shedding.total for member in self.members}
        dropped = [f'{arm}: {count}' for arm, count in shed.items() if count]
        values = {'frames_shed_of': '; '.join(dropped), 'nodes': str(len(self.members))}
        report = Report(level=Level.OK, message='', values={})
        if self.grasping is not None:
            report = self.grasping.report(time.monotonic())
            if report.message:
                self.log.warn('grasp', report.message, time.monotonic())
        message = report.message or f'{len(self.configuration.node.arms)} arms'
        values |= report.values
        self.publish_report('arms', Report(level=report.level, message=message, values=values))


def gripper_nodes() -> Iterator[Any]:
    """Yield the nodes of a gripper: its own, then all estimators, all fusions, ..."""
    gripper = GripperNode()
    settings = gripper.configuration.node
    given = {name: parameter.value for name, parameter in overrides(gripper).items()}
    namespace = gripper.get_namespace().rstrip('/')
    clock = {'use_sim_time': gripper.get_parameter('use_sim_time').value}
    blocks, mounted = arms_of(settings, given)
    yield gripper
    fusions: dict[str, Any] = {}
    cameras: dict[tuple[str, str], Any] = {}
    for kind in settings.nodes:
        models: dict[Any, Any] = {}
        for arm, block in blocks.items():
            parameters = parameters_of(settings, block, kind)
            check_own(params_files(sys.argv), f'{namespace}/{arm}/{kind}', parameters)
            node_options = NodeOptions(
                namespace=f'{namespace}/{arm}',
                parameters=clock | parameters,
                topics=block.topics,
                sibling=models.get(parameters.get('model_file')),
                foreign_parameters=given,
                cameras=cameras,
            )
            member = CLASSES[kind](node_options)
            models.setdefault(parameters.get('model_file'), member.configuration)
            gripper.members.append(member)
            if kind == 'fusion':
                fusions[arm] = member
            yield member
    gripper.open(mounted, fusions)
