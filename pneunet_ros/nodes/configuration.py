"""What the parameters of the estimator ask for, made ready to be used or refused as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneunet_ros.estimator import Estimator
from pneunet_ros.estimator_state import EstimatorState
from pneunet_ros.model_file import load_model
from pneunet_ros.nodes.parameters import NodeSettings, settings_from
from pneunet_ros.settings import EstimatorSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """An estimator with the settings of its node, ready for use."""

    node: NodeSettings
    estimator: Estimator

    def take_over(self, state: EstimatorState, before: Configuration) -> EstimatorState:
        """Return what remains valid of a state of the configuration used before."""
        new, old = self.estimator, before.estimator
        if new.arm is not old.arm:
            return state.fresh()
        if wrench_meaning(new.settings) != wrench_meaning(old.settings):
            return replace(state, wrench=None)
        return state


def configured(values: Mapping[str, Any], current: Configuration | None) -> Configuration:
    """Make ready what the values of all parameters ask for.

    The model file is read unless `current` already has the model of it. Raises PneunetError with
    what is wrong.
    """
    node, settings = settings_from(values)
    if current is not None and node.model_file == current.node.model_file:
        arm = current.estimator.arm
    else:
        arm = load_model(node.model_path)
    return Configuration(node=node, estimator=Estimator(arm=arm, settings=settings))


def wrench_meaning(settings: EstimatorSettings) -> tuple[int, float, str]:
    """Return the settings by which a wrench message is taken."""
    return settings.wrench_sign, settings.wrench_yaw, settings.wrench_frame
