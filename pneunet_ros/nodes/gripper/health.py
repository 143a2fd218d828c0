"""Health of a gripper: arms without frames, limited grasps and rejected commands."""

from __future__ import annotations

from collections.abc import Iterable

from pneunet_ros.core.health import Level


class GraspHealth:
    """Collects frames and grasps; all times are in seconds of one steady clock.

    A fault appears in the next report, as an ERROR if there was no grasp since the last report.
    Missing frames are a fault only while a grasp is requested.
    """

    def __init__(self, arms: Iterable[str]) -> None:
        self.arms, self.grasps, self.rejected = tuple(arms), 0, 0
        self._frame_at: dict[str, float] = {}
        self._longest: dict[str, float] = {}
        self._faults: dict[str, None] = {}

    def take_frame(self, arm: str, now: float) -> None:
        """Record a usable frame of an arm."""
        gap = now - self._frame_at.get(arm, now)
        self._longest[arm] = max(gap, self._longest.get(arm, 0.0))
        self._frame_at[arm] = now

    def forget_frames(self) -> None:
        """Restart with the next frame of every arm."""
        self._frame_at.clear()
        self._longest.clear()

    def note(self, fault: str) -> None:
        """Record a sentence for the next report."""
        self._faults[fault] = None

    def reject(self, fault: str) -> None:
        """Record a rejected command."""
        self.rejected += 1
        self.note(fault)

    def report(self, longest: float, now: float, *, is_wanted: bool) -> tuple[Level, str]:
        """Return level and sentence for the time since the last report, and start the next one.

        longest: tolerated time (s) without a frame; is_wanted: whether a grasp is requested.
        """
        faults = list(self._faults)
        if is_wanted:
            gaps = {
                arm: max(now - self._frame_at.setdefault(arm, now), self._longest.get(arm, 0.0))
                for arm in self.arms
            }
            late = [f'{arm} for {gap:.2f} s' for arm, gap in gaps.items() if gap > longest]
            if late:
                faults.insert(
                    0,
                    f'no usable frame of {", of ".join(late)}: commands are held after '
                    f'{longest:g} s (hold_after)',
                )
        else:
            self.forget_frames()
        level = Level.WARN if faults else Level.OK
        if faults and is_wanted and not self.grasps:
            level = Level.ERROR
        self.grasps = 0
        self._longest.clear()
        self._faults.clear()
        return level, '; '.join(faults)
