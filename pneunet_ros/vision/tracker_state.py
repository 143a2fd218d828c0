"""What a tracker remembers from one frame to the next, and what it makes of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.stamps import count_reason
from pneunet_ros.vision.camera_model import Lens
from pneunet_ros.vision.frame_tracker import FollowedRow
from pneunet_ros.vision.rest_plane import RestAverage
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.working_plane import Plane


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracking:
    """What a tracker makes of a frame: where targets were seen, and the smooth curve through them.

    Where the frame could not be explained `reason` is a key for counting, `sentence` says it to a
    person, nothing is seen and there is no curve; both are empty otherwise.
    """

    sightings: TargetSightings
    curve: MeasuredCurve | None
    reason: str = ''
    sentence: str = ''


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackerState:
    """All that a tracker remembers from one frame to the next.

    `frames` were looked at, `explained` of them show the arm; `unexplained` counts the others by
    reason, `rejected` the images that were not looked at. `trouble` says why there is no working
    plane for this lens.
    """

    lens: Lens | None = None
    plane: Plane | None = None
    trouble: str = ''
    rest: RestAverage = field(default_factory=RestAverage)
    row: FollowedRow | None = None
    stamp_ns: int | None = None
    frames: int = 0
    explained: int = 0
    resets: int = 0
    unexplained: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    rejected: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def fresh(self) -> TrackerState:
        """Forget camera and arm; only the counts go on."""
        return TrackerState(
            frames=self.frames,
            explained=self.explained,
            resets=self.resets + 1,
            unexplained=self.unexplained,
            rejected=self.rejected,
        )

    def seeing(self, row: FollowedRow) -> TrackerState:
        """Count one more frame that shows the arm; without `replace`, which takes longer."""
        return TrackerState(
            lens=self.lens,
            plane=self.plane,
            trouble=self.trouble,
            rest=self.rest,
            row=row,
            stamp_ns=row.stamp_ns,
            frames=self.frames + 1,
            explained=self.explained + 1,
            resets=self.resets,
            unexplained=self.unexplained,
            rejected=self.rejected,
        )

    def counting(self, reason: str) -> TrackerState:
        """Count one more image that was not looked at."""
        return replace(self, rejected=count_reason(self.rejected, reason))
