"""Relative rotations of frames, from the topics /tf and /tf_static."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from types import MappingProxyType

from pneunet_ros.core.frames import composition, inverse_rotation, Quaternion, UNTURNED
from pneunet_ros.core.readings import FrameReading
from pneunet_ros.core.stamps import BACKWARD_JUMP
from pneunet_ros.core.units import seconds_since


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTree:
    """The last rotation of every frame, by name; translations are not stored."""

    frames: Mapping[str, FrameReading] = field(default_factory=lambda: MappingProxyType({}))

    def after(self, readings: Iterable[FrameReading]) -> FrameTree:
        """Return the tree updated with readings of frames; the latest reading wins.

        A reading more than `BACKWARD_JUMP` before the stored one shows that the stored one had a
        stamp in the future, or that time has restarted.
        """
        found = dict(self.frames)
        for reading in readings:
            known = found.get(reading.frame_id)
            late = 0.0 if known is None else seconds_since(reading.stamp_ns, known.stamp_ns)
            if known is None or known.fixed or not 0.0 < late <= BACKWARD_JUMP:
                found[reading.frame_id] = reading
        return FrameTree(frames=MappingProxyType(found))

    def only_fixed(self) -> FrameTree:
        """Return the fixed transforms of the tree."""
        fixed = {name: one for name, one in self.frames.items() if one.fixed}
        return FrameTree(frames=MappingProxyType(fixed))

    def between(self, frame: str, other: str) -> tuple[Quaternion, int | None] | None:
        """Return the rotation from one frame to another.

        Also returns the stamp (ns) of the oldest reading in the chain that is not fixed; None if
        all are fixed. The result is None if no chain of readings connects the frames.
        """
        ups = self._upwards(frame), self._upwards(other)
        places = [{reading.parent: place for place, reading in enumerate(up, 1)} for up in ups]
        of_frame, of_other = {frame: 0} | places[0], {other: 0} | places[1]
        shared = [name for name in of_frame if name in of_other]
        if not shared:
            return None
        chains = ups[0][: of_frame[shared[0]]], ups[1][: of_other[shared[0]]]
        up, down = (
            reduce(composition, (one.quaternion for one in chain), UNTURNED) for chain in chains
        )
        moving = [one.stamp_ns for chain in chains for one in chain if not one.fixed]
        return composition(up, inverse_rotation(down)), min(moving, default=None)

    def _upwards(self, frame: str) -> list[FrameReading]:
        """Return the transforms from a frame to the root; stops at a cycle."""
        found: list[FrameReading] = []
        seen = {frame}
        while (reading := self.frames.get(frame)) is not None and reading.parent not in seen:
            found.append(reading)
            frame = reading.parent
            seen.add(frame)
        return found
