"""Track: from images through `Tracker.step` to a recording, with the live step and messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import CameraError, PneunetError, RecordingError
from pneunet_ros.core.image import Image
from pneunet_ros.core.notes import Note
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.measurement.row_order import first_target_moves, numbered_from_tip
from pneunet_ros.messages.tracker import outputs_of, refusal_of, TRACKER_OUTPUTS
from pneunet_ros.recordings.images.image_sources import IMAGE_TYPES
from pneunet_ros.recordings.images.image_stream import ImageStream, StreamItem
from pneunet_ros.recordings.recording_writer import OutputTopics, RecordingWriter
from pneunet_ros.vision.beam_search import BEAM_SEARCH, ODD
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.rest_plane import RESTING, UPRIGHT
from pneunet_ros.vision.rows.row import CAUSES
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking

OFTEN = 0.03  # share of the frames without a target, above which a note is given
UPRIGHT_FRAMES = 30  # frames with an upright arm, after which the film is rejected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackStep:
    """One message of a stream with its outcome and the state of the tracker after it.

    frame: whether it is an image, readable or not.
    """

    item: StreamItem
    frame: bool
    outcome: Tracking | Refusal | None
    state: TrackerState


def look_ahead(
    stream: ImageStream, tracker: Tracker, on_frame: Callable[[TrackStep], None]
) -> tuple[TrackerState, str]:
    """Return the initial state of the tracker, and a note if it is not empty.

    If a recording begins with the arm bent or hidden, scale and base frame are determined from
    later frames in which the arm is at rest. A recording that begins at rest is tracked as it
    would be live, as is a recording in which camera_info changes, or stamps jump, before the arm
    rests. `on_frame` is called with each frame that was searched. Raises CameraError if the arm is
    upright from the beginning, so that it is unknown which end is the clamp.
    """
    state, frames, first = TrackerState(), 0, ''
    for item in stream.read(()):
        if isinstance(item.reading, Image | Lens):
            state, outcome = tracker.step(state, item.reading)
            if outcome is not None:
                frames += 1
                on_frame(TrackStep(item=item, frame=True, outcome=outcome, state=state))
                if outcome.reason != RESTING:
                    first = first or outcome.sentence  # an arm at rest may move later
                if frames == UPRIGHT_FRAMES == state.unexplained.get(UPRIGHT):
                    raise CameraError(f'{first} (track: --clamp-pixel U V)', reason='wrong_end')
        if state.plane is not None or state.resets:
            break
    is_immediate = sum(state.unexplained.values()) < tracker.settings.rest_frames
    if state.plane is None or state.resets or is_immediate:
        return TrackerState(), ''
    missed = sum(state.unexplained.values()) - state.unexplained.get(RESTING, 0)
    return TrackerState(plane=state.plane, rest=state.rest), (
        f'scale and base frame come from frames up to number {frames}, but {missed} of them do '
        f'not show the arm at rest: {first}'
    )


def track_steps(
    stream: ImageStream,
    tracker: Tracker,
    other_topics: Collection[str] = (),
    start: TrackerState | None = None,
) -> Iterator[TrackStep]:
    """Pass images and lenses to the tracker in the order of their log time.

    Messages of the topics in `other_topics` are passed on with the outcome None. start: initial
    state of the tracker from `look_ahead`; None: empty, as live.
    """
    state = start or TrackerState()
    for item in stream.read(other_topics):
        outcome: Tracking | Refusal | None = None
        if isinstance(item.reading, PneunetError):
            outcome = refusal_of(item.reading, item.log_time_ns)
            state = state.count_rejected(outcome.reason)
        elif item.reading is not None:
            state, outcome = tracker.step(state, item.reading)
        frame = item.topic == stream.image_topic
        yield TrackStep(item=item, frame=frame, outcome=outcome, state=state)


def record_tracking(
    writer: RecordingWriter,
    stream: ImageStream,
    tracker: Tracker,
    frame_id: str,
    with_images: bool,
    on_progress: Callable[[TrackStep], None],
    start: TrackerState | None = None,
) -> tuple[str, ...]:
    """Write all tracker outputs, and the other topics of a recording unchanged.

    with_images: whether to copy the images as well. `on_progress` is called with every step.
    start: as in `track_steps`. Returns sentences about omitted topics.
    """
    names = {f'{stream.namespace}/{output.name}': output for output in TRACKER_OUTPUTS}
    topics = OutputTopics(writer, names, frame_id)
    copies, sentences = {}, []
    for topic in stream.recording.topics if stream.recording is not None else ():
        if topic.type in IMAGE_TYPES.values() and not with_images:
            continue
        if topic.name in names:
            sentences.append(
                Note(
                    f'{topic.name} was already in the recording and was replaced',
                    reason='rewritten',
                )
            )
            continue
        try:
            copies[topic.name] = writer.add_copy(topic)
        except RecordingError as error:
            sentences.append(Note(f'{topic.name} was not copied: {error}', reason=error.reason))
    for step in track_steps(stream, tracker, copies, start):
        on_progress(step)
        item = step.item
        if item.topic in copies:
            writer.write_raw(copies[item.topic], item.log_time_ns, item.raw)
        if isinstance(step.outcome, Tracking):
            for written, raw in topics.messages(outputs_of(step.outcome)):
                writer.write_raw(written, item.log_time_ns, raw)
    return tuple(sentences)


@dataclass(slots=True)
class TrackTally:
    """Tracking counts; each frame counts once, under one reason or none.

    warnings: number of frames with each warning about the previous frame; seen (targets,): number
    of explained frames in which each target was seen; sentences: the latest for each reason;
    causes: counts of the causes (keys of CAUSES) for which a target was not seen. points: (2,
    targets) m of each explained frame; last_pixel: first position of the last target; log_areas
    (targets,): sum of log areas relative to the median of their frame. rest_bow: of the row at
    rest, relative to its length; NaN if it was not used.
    """

    targets: int
    frames: int = 0
    explained: int = 0
    resting: int = 0
    curves: int = 0
    worst_rms: float = 0.0
    reasons: Counter[str] = field(default_factory=Counter)
    causes: Counter[tuple[str, int]] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)
    sentences: dict[str, str] = field(default_factory=dict)
    seen: Array = field(init=False)
    last_pixel: tuple[float, float] | None = None
    points: list[Array] = field(default_factory=list)
    log_areas: Array = field(init=False)
    rest_bow: float = math.nan
    _squares: float = 0.0
    _meters: float = 0.0
    _pixels: float = 0.0

    def __post_init__(self) -> None:
        """Start with no target seen."""
        self.seen = np.zeros(self.targets)
        self.log_areas = np.zeros(self.targets)

    def count(self, step: TrackStep) -> None:
        """Count one step."""
        outcome = step.outcome
        self.frames += step.frame
        if step.state.plane is not None:
            self.rest_bow = step.state.rest.bow
        if outcome is None:
            return
        if isinstance(outcome, Tracking) and outcome.warning:
            self.warnings[outcome.warning] += 1
        if isinstance(outcome, Refusal) or outcome.reason:
            self.sentences[outcome.reason] = outcome.sentence
            self.resting += outcome.reason == RESTING
            self.reasons[outcome.reason] += step.frame
            return
        self._count_explained(outcome)

    def _count_explained(self, outcome: Tracking) -> None:
        self.explained += 1
        self.causes.update((it.cause, target) for target, it in outcome.missing.items())
        found = outcome.sightings
        self.seen += np.isfinite(found.x)
        known = np.isfinite(found.area)
        if known.any():
            self.log_areas[known] += np.log(found.area[known] / np.median(found.area[known]))
        self.points.append(np.stack([found.x, found.y]))
        if self.last_pixel is None and math.isfinite(found.u[-1]):
            self.last_pixel = float(found.u[-1]), float(found.v[-1])
        lengths = np.hypot(np.diff(found.x), np.diff(found.y))
        pixels = np.hypot(np.diff(found.u), np.diff(found.v))
        self._meters += float(np.nansum(lengths))
        self._pixels += float(np.nansum(pixels))
        if outcome.curve is not None:
            self.curves += 1
            self._squares += outcome.curve.rms**2
            self.worst_rms = max(self.worst_rms, outcome.curve.rms)

    @property
    def missing(self) -> Array:
        """Number of explained frames in which each target was not seen (targets,)."""
        return self.explained - self.seen

    @property
    def main_sentence(self) -> str:
        """The most frequent sentence among untracked frames of one cause."""
        causes = Counter({it: many for it, many in self.reasons.items() if it != RESTING})
        counted = causes or (Counter() if self.explained else self.reasons)
        return self.sentences[counted.most_common(1)[0][0]] if counted else ''

    @property
    def notes(self) -> list[str]:
        """Explain why targets are missing in more than the share OFTEN of the frames."""
        often = np.flatnonzero(self.missing > OFTEN * self.explained)
        mostly: dict[str, list[int]] = {}
        for target in often.tolist():
            cause = max(CAUSES, key=lambda cause: self.causes[cause, target])
            mostly.setdefault(cause, []).append(target)
        return [
            f'target{"s" if len(targets) > 1 else ""} {", ".join(map(str, targets))} '
            f'not seen in up to '
            f'{self.missing[targets].max():.0f} of {self.explained} frames: {CAUSES[cause]} '
            '(--preview shows where)'
            for cause, targets in mostly.items()
        ] + [
            *(f'{warning} (frames: {count})' for warning, count in self.warnings.items()),
            *self.odd_sized_dots,
        ]

    @property
    def odd_sized_dots(self) -> list[str]:
        """Name the targets whose average size differs from the rest of the row.

        Such dots are tracked less reliably than the others.
        """
        size = self.log_areas / np.maximum(self.seen, 1.0)  # of logarithmic areas
        odd = np.abs(size) > ODD * BEAM_SEARCH.size_std
        return [
            f'target {target} is {math.exp(0.5 * size[target]):.2g} times as wide as the others: '
            'it was tracked, but not reliably: repaint the dot, or remove whatever touches it '
            '(--preview shows it)'
            for target in np.flatnonzero(odd & (self.seen > 0)).tolist()
        ]

    @property
    def scale(self) -> float:
        """Mean scale along the arm, meters per pixel; NaN if nothing was seen."""
        return self._meters / self._pixels if self._pixels > 0.0 else math.nan

    @property
    def rms(self) -> float:
        """Return the RMS distance (m) of targets from the smoothed curves."""
        return math.sqrt(self._squares / self.curves) if self.curves else math.nan


def check_row_order(tracker: Tracker, tally: TrackTally) -> None:
    """Raise CameraError if the arm was tracked from its free end to the clamp.

    In that case, the first targets rotate like those at a free end, or move while the last ones
    are at rest.
    """
    if not tally.points or tally.last_pixel is None:
        return
    points, arclength = np.array(tally.points), tracker.arm.target_arclength
    known = tracker.settings.clamp_pixel is not None
    moves = first_target_moves(points, arclength) or 'wrong_clamp' in tally.reasons
    if not numbered_from_tip(points, arclength) and (known or not moves):
        return
    u, v = tally.last_pixel
    raise CameraError(
        'the targets are numbered from the free end, because the clamp is not at the left of the '
        f'image: give the pixel of the target at the clamp at rest, about [{u:.0f}, {v:.0f}], '
        f'with --clamp-pixel {u:.0f} {v:.0f} or as clamp_pixel in the camera file',
        reason='wrong_end',
    )
