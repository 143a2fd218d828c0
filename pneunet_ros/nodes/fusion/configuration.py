"""Configuration of the fusion from its parameters, accepted or rejected as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneunet_ros.core.settings import check_settings, setting, settings_changed
from pneunet_ros.core.units import quantity
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION, FusionSettings
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.model.arm import Arm
from pneunet_ros.nodes.arm_configuration import arm_of, ArmConfiguration
from pneunet_ros.nodes.parameters import EFFECTS_PATH, GRAVITY, ParameterTable, SHIPPED_MODEL


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """Settings of the node, in addition to those of its sensors.

    These settings of the fusion depend on the setup.
    """

    model_file: str = setting('', f'model file of the arm; empty: the shipped {SHIPPED_MODEL}')
    effects_path: str = setting('', EFFECTS_PATH)
    gravity: str = setting('', GRAVITY)
    use_wrench: bool = setting(
        True, 'use end_wrench if it is published; false: ignore the force sensor'
    )
    free_tip: bool = setting(
        FUSION.free_tip,
        ('no load ever acts at the tip: ignore end_wrench and estimate contacts along the arm'),
    )
    delay_std: float = quantity(
        FUSION.delay_std,
        unit='s',
        meaning='std of the time between frames and pressure, beyond the delay of the model, of '
        'another clock or lost frames, for a model without motion: 0.03 is one frame; 0: none',
        bounds=(0.0, 1.0),
    )
    centerline_rate: float = quantity(
        30.0,
        unit='Hz',
        meaning='largest rate of fused/centerline; 0: every estimate',
        bounds=(0.0, 1000.0),
    )
    target_timeout: float = quantity(
        FUSION.target_timeout,
        unit='s',
        meaning='age of the last frame above which the estimate is a prediction only',
        bounds=(1e-3, 3600.0),
    )
    largest_tip_std: float = quantity(
        FUSION.largest_tip_std,
        unit='m',
        meaning='standard deviation of the tip above which no prediction is published',
        bounds=(1e-5, 1.0),
    )
    determined: float = quantity(
        FUSION.determined,
        unit='-',
        meaning='largest standard deviation of a published force component, as a share of the '
        'largest calibrated force',
        bounds=(1e-4, 1.0),
    )

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)

    @property
    def fusion(self) -> FusionSettings:
        """The settings of the fusion."""
        return replace(
            FUSION,
            free_tip=self.free_tip,
            delay_std=self.delay_std,
            target_timeout=self.target_timeout,
            largest_tip_std=self.largest_tip_std,
            determined=self.determined,
        )


PARAMETERS = ParameterTable(
    owners=(NodeSettings, EstimatorSettings),
    read_only=frozenset(
        {
            'delay_std',
            'effects_path',
            'frame_id',
            'free_tip',
            'gravity_frame',
            'stations',
            'use_wrench',
        }
    ),
    # A wrench is used if there is a fresh one, and targets are always required.
    left_out=frozenset({'wrench_required', 'watch_targets', 'watch_time'}),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionConfiguration(ArmConfiguration):
    """A fusion with the settings of its node."""

    node: NodeSettings
    fusion: Fusion

    @property
    def arm(self) -> Arm:
        """The arm in use."""
        return self.fusion.arm

    @property
    def settings(self) -> EstimatorSettings:
        """The settings of its sensors."""
        return self.fusion.sensors

    def info(self) -> str:
        """Return the content of the topic model_info."""
        targets, changed = len(self.arm.target_arclength), settings_changed(self.fusion.settings)
        return self.info_with(targets=targets, settings=changed)

    def carry_over(self, state: FusionState, before: FusionConfiguration) -> FusionState:
        """Return the part of an earlier state that remains valid with this configuration."""
        new, old = self.fusion, before.fusion
        if new.arm is not old.arm:
            return state.restarted()
        if new.sensors != old.sensors:
            return state.fresh()
        return state


def configured_fusion(
    values: Mapping[str, Any], current: FusionConfiguration | None
) -> FusionConfiguration:
    """Build the configuration from the values of all parameters.

    The model file is read unless `current` already has its model. Raises PneunetError for invalid
    values.
    """
    node, sensors = PARAMETERS.settings(values)
    arm = arm_of(node, current)
    fusion = Fusion(arm=arm, sensors=sensors, settings=node.fusion)
    return FusionConfiguration(node=node, fusion=fusion)
