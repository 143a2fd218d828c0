"""Pressures that close a gripper to a width, limited by a force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.fusion.grasp import determined, Grasp, Gripper, is_unknown, Mount, SeenArm, Touch
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.pressure_search import readings

AS_HARD = 0.05  # tolerance of a force: forces are known to this accuracy, acceptance/grasp.py


@dataclass(frozen=True, slots=True, kw_only=True)
class GripCommand:
    """Commanded width between the surfaces (m), and the largest force (N) of every arm."""

    width: float
    force: float

    def __post_init__(self) -> None:
        """Reject NaN and infinity."""
        if not (np.isfinite(self.width) and np.isfinite(self.force) and self.force >= 0.0):
            raise RequestError(
                f'a width of {self.width} m with at most {self.force} N is not possible',
                reason='out_of_bounds',
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """Inward positions (n,) m of the surface of an unloaded arm, by readings (n,) of Pa.

    They are measured from the origin of the gripper, in the direction of the object.
    """

    pressure: Array
    inward: Array

    def pressure_for(self, inward: float) -> float:
        """Return the pressure (Pa) for this inward position, or for the nearest possible one."""
        return float(np.interp(inward, self.inward, self.pressure))


def reach_of(arm: Arm, mount: Mount, inward: Array) -> Reach:
    """Return the reach of an arm over its calibrated pressures; inward: unit vector (3,)."""
    side = mount.axes[:, :2].T @ inward
    pressures = np.array(readings(arm))
    reached, start = [], None
    for pressure in pressures.tolist():
        shape = solve(arm, pressure, start=start)
        if shape.converged:
            start = shape
            reached.append(float(np.max(side[0] * shape.x + side[1] * shape.y)))
        else:
            reached.append(np.nan)
    known = np.isfinite(reached)
    if not known.any():
        raise RequestError(
            'the arm has no equilibrium at any calibrated pressure', reason='no_equilibrium'
        )
    clamp = float(inward @ mount.origin) + mount.thickness
    places = np.maximum.accumulate(np.array(reached)[known]) + clamp
    return Reach(pressure=freeze(pressures[known]), inward=freeze(places))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closing:
    """Controls the pressures of the arms of a gripper.

    reaches: the reach of each arm, by name. rate: fastest change, Pa/s; gain: 1/s, the share of
    the remaining error that is corrected per second.
    """

    gripper: Gripper
    reaches: Mapping[str, Reach]
    rate: float
    gain: float

    def places(self, width: float) -> dict[str, float]:
        """Return the inward positions (m) of the arms for a width (m) between them."""
        center = self.gripper.axis
        return {
            name: float(self.gripper.inward(name) @ center) - 0.5 * width for name in self.reaches
        }

    def step(
        self,
        seen: Mapping[str, SeenArm],
        pressures: Mapping[str, float],
        command: GripCommand,
        elapsed: float,
    ) -> dict[str, float]:
        """Return the pressures (Pa) to command after this many seconds."""
        touches, places = self.gripper.touches(seen), self.places(command.width)
        most, after = self.rate * elapsed, {}
        for name, pressure in pressures.items():
            missing_pressure = self.missing(
                name, seen[name], touches[name], places[name], pressure, command.force
            )
            moved = pressure + float(np.clip(self.gain * elapsed * missing_pressure, -most, most))
            low, high = self.reaches[name].pressure[[0, -1]].tolist()
            after[name] = min(max(moved, low), high)
        return after

    def missing(
        self, name: str, seen: SeenArm, touch: Touch, place: float, pressure: float, force: float
    ) -> float:
        """Return the pressure (Pa) still needed to reach a place (m, inward), limited by a force.

        The pressure follows from the model or from the local sensitivity of the tip, whichever
        gives more, because an obstacle keeps an arm from its modeled position. It is limited to
        the pressure that an arm with a fixed tip needs for the remaining force. An arm whose push
        is unknown does not close any further.
        """
        mount, inward = self.gripper.mounts[name], self.gripper.inward(name)
        side, jacobian = mount.axes[:, :2].T @ inward, seen.fused.estimate.jacobian
        by_model = self.reaches[name].pressure_for(place) - pressure
        most = 0.0 if is_unknown(touch.force) else np.inf
        slope, give = float(side @ jacobian[:2, 0]), float(side @ jacobian[:2, 1:3] @ side)
        if slope <= 0.0 or give <= 0.0:  # inside a play gap
            return min(by_model, most)
        left = (place - float(inward @ mount.origin + side @ touch.point)) / slope
        missing_pressure = max(by_model, left, key=abs) if by_model * left > 0.0 else left
        grip_force = determined(touch.force if touch.is_touching else seen.fused.force)
        remaining = force - float(np.linalg.norm(grip_force))
        return min(missing_pressure, most, remaining * give / slope)

    def is_stalled(
        self,
        seen: Mapping[str, SeenArm],
        pressures: Mapping[str, float],
        command: GripCommand,
        width: float,
    ) -> bool:
        """Whether no arm can do more to fulfil a command.

        Then each touching arm presses with the largest allowed force, or all arms are at a limit
        of their pressures. pressures (Pa): the last command; width (m): the measured one.
        """
        touches = self.gripper.touches(seen)
        touching = {name for name, one in touches.items() if one.is_touching}
        hard = hard_pressed(touches, command, width)
        ended = self.ended(pressures, command, width)
        return (len(touching) > 1 and hard == touching) or hard | ended == touches.keys()

    def is_blind(
        self,
        seen: Mapping[str, SeenArm],
        pressures: Mapping[str, float],
        command: GripCommand,
        width: float,
    ) -> bool:
        """Whether no arm can do more until the push of some is known again; see `is_stalled`."""
        touches = self.gripper.touches(seen)
        unknown = {name for name, one in touches.items() if is_unknown(one.force)}
        spent = hard_pressed(touches, command, width) | self.ended(pressures, command, width)
        is_open = width > command.width
        return is_open and not unknown <= spent and unknown | spent == touches.keys()

    def ended(
        self, pressures: Mapping[str, float], command: GripCommand, width: float
    ) -> set[str]:
        """Return the arms at the limit of their pressures towards a commanded width."""
        end = -1 if width > command.width else 0
        return {name for name in pressures if pressures[name] == self.reaches[name].pressure[end]}


def hard_pressed(touches: Mapping[str, Touch], command: GripCommand, width: float) -> set[str]:
    """Return the arms that close with the largest force of a command."""
    largest = (1.0 - AS_HARD) * command.force
    return {
        name
        for name, one in touches.items()
        if width > command.width and one.is_touching and one.size >= largest
    }


def is_reached(grasp: Grasp, command: GripCommand, tolerance: float) -> bool:
    """Whether the width is within a tolerance (m) of the command."""
    return abs(grasp.width - command.width) <= tolerance
