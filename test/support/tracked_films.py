"""What the tracker makes of composed films, scored against their truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
import math

import numpy as np
from pneunet_ros.core.image import Image
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.model.arm import Arm
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.rest_plane import RESTING
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking

from support.composed_pictures import Composer, Composition, Frame, HEIGHT, WIDTH

VISIBLE, HIDDEN = 0.9, 0.25  # share of a whole dot: from here on to be found, below never
FALSE_PX = 1.5  # a center further off is not that of the target
FOCAL_PX = 1400.0


def lens_of_films() -> Lens:
    """Return the lens of all composed films: free of distortion."""
    matrix = np.array([
        [FOCAL_PX, 0.0, 0.5 * (WIDTH - 1)],
        [0.0, FOCAL_PX, 0.5 * (HEIGHT - 1)],
        [0.0, 0.0, 1.0],
    ])  # fmt: skip
    return Lens(
        width=WIDTH, height=HEIGHT, model='plumb_bob', matrix=matrix, distortion=np.zeros(5)
    )


def image_of(frame: Frame) -> Image:
    """Return a composed frame as a camera sends it."""
    return Image(
        stamp_ns=frame.stamp_ns,
        frame_id='camera',
        width=WIDTH,
        height=HEIGHT,
        step=3 * WIDTH,
        encoding='bgr8',
        data=np.frombuffer(frame.picture.tobytes(), np.uint8),
    )


def arm_of(arm: Arm, composition: Composition) -> Arm:
    """Return the arm with as many targets as a film shows, over the same length."""
    ends = arm.target_arclength[[0, -1]].tolist()
    return replace(arm, target_arclength=np.linspace(*ends, composition.targets))


@dataclass(slots=True)
class Score:
    """How many targets were found, missed, false or swapped, and how far off.

    `errors` (n, 2) px and `claims` (n,) px, what the tracker says of them itself, are those of the
    targets that are wholly visible; the same of the tip, which may be cut off, are apart.
    """

    frames: int = 0
    resting: int = 0
    visible: int = 0
    found: int = 0
    tip_visible: int = 0
    tip_found: int = 0
    false: int = 0
    swapped: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    errors: list[np.ndarray] = field(default_factory=list)
    claims: list[np.ndarray] = field(default_factory=list)
    tip_errors: list[np.ndarray] = field(default_factory=list)
    tip_claims: list[float] = field(default_factory=list)

    def count(self, tracking: Tracking, frame: Frame, meters_per_pixel: float) -> None:
        """Compare what was seen in a frame with the truth; frames of the rest count apart."""
        if tracking.reason == RESTING:
            self.resting += 1
            return
        if tracking.reason:
            self.reasons[tracking.reason] += 1
        self._compare(tracking.sightings, frame, meters_per_pixel)

    def _compare(self, seen_as: TargetSightings, frame: Frame, meters_per_pixel: float) -> None:
        seen = np.isfinite(seen_as.u)
        error = np.column_stack([seen_as.u - frame.u, seen_as.v - frame.v])
        off = np.hypot(*error.T)
        visible = frame.visible >= VISIBLE
        both = visible & seen
        self.frames += 1
        self.visible += np.count_nonzero(visible)
        self.found += np.count_nonzero(both)
        self.tip_visible += int(visible[-1])
        self.tip_found += int(both[-1])
        self.false += np.count_nonzero(seen & ((off > FALSE_PX) | (frame.visible < HIDDEN)))
        self.swapped += np.count_nonzero(seen & (off > 0.5 * frame.spacing))
        claims = seen_as.std / meters_per_pixel
        self.errors.append(error[:-1][both[:-1]])
        self.claims.append(claims[:-1][both[:-1]])
        if both[-1]:
            self.tip_errors.append(error[-1])
            self.tip_claims.append(float(claims[-1]))

    def add(self, other: Score) -> None:
        """Take another film into account."""
        for name in self.__dataclass_fields__:
            mine, more = getattr(self, name), getattr(other, name)
            setattr(self, name, mine + more)

    def numbers(self) -> dict[str, float]:
        """Return the score as a row of a table."""
        errors, tips = _stacked(self.errors), _stacked(self.tip_errors)
        claims = np.concatenate([*self.claims, np.zeros(0)])
        return {
            'frames': self.frames,
            'resting': self.resting,
            'unexplained': self.reasons.total(),
            'visible': self.visible,
            'found_share': self.found / max(self.visible, 1),
            'tip_visible': self.tip_visible,
            'tip_found_share': self.tip_found / max(self.tip_visible, 1),
            'false': self.false,
            'swapped': self.swapped,
            'rms_px': _rms(np.concatenate([errors, tips])),
            'tip_rms_px': _rms(tips),
            'normalized': _rms(errors / claims[:, None]),
            'tip_normalized': _rms(tips / np.array(self.tip_claims)[:, None]),
        }


def _stacked(errors: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros((0, 2)), *(np.reshape(error, (-1, 2)) for error in errors)])


def _rms(values: np.ndarray) -> float:
    """Root mean square per axis; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def track_film(
    composition: Composition, arm: Arm, settings: CameraSettings | None = None
) -> Iterator[tuple[Frame, Tracking, TrackerState]]:
    """Follow the arm through a film as a node does, frame by frame."""
    tracker = Tracker(arm_of(arm, composition), settings or CameraSettings())
    state, _ = tracker.step(TrackerState(), lens_of_films())
    for frame in Composer(composition):
        state, outcome = tracker.step(state, image_of(frame))
        assert isinstance(outcome, Tracking)
        yield frame, outcome, state


def score_film(
    composition: Composition, arm: Arm, settings: CameraSettings | None = None
) -> Score:
    """Return how the tracker does on a film."""
    score = Score()
    length = (composition.targets - 1) * composition.spacing
    meters = float(arm.target_arclength[-1] - arm.target_arclength[0])
    for frame, tracking, _ in track_film(composition, arm, settings):
        score.count(tracking, frame, meters / length)
    return score
