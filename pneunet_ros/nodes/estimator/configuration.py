"""Configuration of the estimator from its parameters, accepted or rejected as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.settings import check_settings, setting
from pneunet_ros.core.units import quantities, quantity
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.messages.builders import Output
from pneunet_ros.messages.link_chain import JOINT_STATES
from pneunet_ros.messages.markers import ArmInUse, markers_output, TIP_FRAME, transform_output
from pneunet_ros.model.arm import Arm
from pneunet_ros.nodes.arm_configuration import arm_of, ArmConfiguration
from pneunet_ros.nodes.parameters import EFFECTS_PATH, GRAVITY, ParameterTable, SHIPPED_MODEL


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """Settings of the node, in addition to those of the estimator."""

    model_file: str = setting('', f'model file of the arm; empty: the shipped {SHIPPED_MODEL}')
    effects_path: str = setting('', EFFECTS_PATH)
    gravity: str = setting('', GRAVITY)
    centerline_rate: float = quantity(
        30.0,
        unit='Hz',
        meaning='largest rate of centerline and markers; 0: every estimate',
        bounds=(0.0, 1000.0),
    )
    publish_markers: bool = setting(
        False, 'publish the topic markers: the arm, its targets and the end force, for displays'
    )
    publish_tf: bool = setting(False, 'publish the transform from frame_id to tip_frame on /tf')
    publish_joint_states: bool = setting(
        False, 'publish the topic joint_states of the chain of links that `pneunet urdf` writes'
    )
    tip_frame: str = setting(TIP_FRAME, 'frame of the free end in /tf')

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)
        if not self.tip_frame:
            raise RequestError('tip_frame must not be empty', reason='empty')

    def markers(self, arm: ArmInUse) -> tuple[Output[ShapeEstimate], ...]:
        """Return the requested outputs for visualization."""
        outputs = []
        if self.publish_tf:
            outputs.append(transform_output(self.tip_frame))
        if self.publish_markers:
            outputs.append(markers_output(arm))
        if self.publish_joint_states:
            outputs.append(JOINT_STATES)
        return tuple(outputs)


PARAMETERS = ParameterTable(
    owners=(NodeSettings, EstimatorSettings),
    read_only=frozenset(
        {
            'effects_path',
            'frame_id',
            'gravity_frame',
            'publish_joint_states',
            'publish_markers',
            'publish_tf',
            'stations',
            'tip_frame',
            'watch_targets',
            'wrench_required',
        }
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorConfiguration(ArmConfiguration):
    """An estimator with the settings of its node."""

    node: NodeSettings
    estimator: Estimator

    @property
    def arm(self) -> Arm:
        """The arm in use."""
        return self.estimator.arm

    @property
    def settings(self) -> EstimatorSettings:
        """The settings of its sensors."""
        return self.estimator.settings

    def info(self) -> str:
        """Return the content of the topic model_info."""
        effects = {
            effect.name: {item.name: getattr(effect, item.name) for item in quantities(effect)}
            for effect in self.arm.effects
        }
        return self.info_with(effects=effects)

    def carry_over(self, state: EstimatorState, before: EstimatorConfiguration) -> EstimatorState:
        """Return the part of an earlier state that remains valid with this configuration."""
        new, old = self.estimator, before.estimator
        if new.arm is not old.arm:
            return state.fresh()
        if new.settings.wrench != old.settings.wrench:
            return replace(state, wrench=None)
        return state


def share_arm_and_settings(new: EstimatorConfiguration, old: EstimatorConfiguration) -> bool:
    """Whether two configurations give the same estimates for the same readings."""
    return new.estimator.arm is old.estimator.arm and (
        new.estimator.settings == old.estimator.settings
    )


def configured_estimator(
    values: Mapping[str, Any], current: EstimatorConfiguration | None
) -> EstimatorConfiguration:
    """Build the configuration of all parameter values.

    The model file is read unless `current` already has its model. Raises PneunetError for invalid
    values.
    """
    node, settings = PARAMETERS.settings(values)
    arm = arm_of(node, current)
    return EstimatorConfiguration(node=node, estimator=Estimator(arm=arm, settings=settings))
