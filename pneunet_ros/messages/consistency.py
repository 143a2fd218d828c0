"""Pass messages of `targets` to the consistency monitor, live and in a replay."""

from __future__ import annotations

from typing import Any

from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.estimation.consistency import ConsistencyState, take_targets
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.messages.builders import UNREADABLE
from pneunet_ros.messages.readings import decode_targets


def take_targets_message(
    state: ConsistencyState, estimator: Estimator, message: Any
) -> tuple[ConsistencyState, Refusal | None]:
    """Compare a targets message with the estimates, or report why this is impossible.

    Without targets in the model, there is nothing to compare.
    """
    targets = estimator.arm.target_arclength.size
    if not targets:
        return state, None
    try:
        sightings = decode_targets(message, estimator.settings.frame_id, targets)
    except MessageError as error:
        refusal = drop(0, UNREADABLE, str(error))
        return state.count_unmatched(UNREADABLE), refusal
    return take_targets(state, estimator, sightings)
