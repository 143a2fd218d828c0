"""Health of the tracker: tracked, missed and rejected frames, summarized every second."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneunet_ros.core.health import count_texts, InputHealth, Level, Report, texts
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.units import millimeters
from pneunet_ros.vision.rest_plane import RESTING
from pneunet_ros.vision.tracker import TrackerState, Tracking

IMAGE_TIMEOUT = 2.0  # s without an image: an error


class TrackerHealth(InputHealth):
    """Collects the outcomes of images.

    The level of a report is the worst since the last report: ERROR if no frame was tracked, WARN
    if some frames were not, or if targets are missing. straight: whether a bow at rest is an
    error.
    """

    def __init__(self, image_topic: str, now: float, straight: bool = True) -> None:
        super().__init__(f'image on {image_topic}', now)
        self._straight = straight
        self._last: Tracking | None = None
        # Level and sentences of the last period with frames: a camera may be slower than reports.
        self._frames = Level.OK, [f'waiting for images on {image_topic}']
        self.begin_next(now)

    def begin_next(self, now: float) -> None:
        """Start the next report period."""
        super().begin_next(now)
        self._explained = 0
        self._sentences: dict[str, str] = {}
        self._missing: set[int] = set()

    def record_image(self, outcome: Tracking | Refusal, now: float) -> None:
        """Record the outcome of an image."""
        self.take(outcome, now)
        if isinstance(outcome, Refusal):
            return
        self._last = outcome
        if outcome.reason:
            self._sentences[outcome.reason] = outcome.sentence
        else:
            self._explained += 1
            self._missing.update(_missing(outcome))

    def report(self, state: TrackerState, now: float) -> Report:
        """Summarize the time since the last report, and start the next period."""
        level, message = self._verdict(now)
        values = self._values(state, now)
        self.begin_next(now)
        return Report(level=level, message=message, values=values)

    def _verdict(self, now: float) -> tuple[Level, str]:
        errors, dropped = self.problems()
        if self._results:
            self._frames = self._judge_frames(now)
        if self.silence(now) > IMAGE_TIMEOUT:
            errors.insert(0, self.silence_sentence(now))
        if errors:
            return Level.ERROR, '; '.join([*errors, *dropped])
        level, sentences = self._frames
        if dropped and level is Level.OK:
            return Level.WARN, '; '.join(dropped)
        return level, '; '.join([*dropped, *sentences])

    def _judge_frames(self, now: float) -> tuple[Level, list[str]]:
        """Return level and sentences of the frames since the last report."""
        unexplained, sentences = self._results - self._explained, list[str]()
        if unexplained:
            sentences.append(
                f'{unexplained} of {self._results} frames not tracked: '
                + '; '.join(self._sentences.values())
            )
        if unexplained == self._results and set(self._sentences) != {RESTING}:
            return Level.ERROR, sentences
        if self._missing:
            ids = ', '.join(str(target) for target in sorted(self._missing))
            sentences.append(f'targets not seen in every frame: {ids}')
        if sentences:
            return Level.WARN, sentences
        return Level.OK, [f'tracking at {self.rate(now):.3g} Hz']

    def _values(self, state: TrackerState, now: float) -> dict[str, str]:
        last = self._last
        seen = None if last is None else last.sightings.seen
        missing = None if last is None else _missing(last)
        values: dict[str, Any] = {
            'rate_hz': self.rate(now),
            'frames': state.frames,
            'explained': state.explained,
            'resets': state.resets,
            'image_age_s': self.input_age(now),
            'seen': seen,
            'missing': None if missing is None else len(missing),
            'missing_ids': None if missing is None else ', '.join(str(item) for item in missing),
            'rest_frames': state.rest.frames,
            'rest_bow': state.rest.bow if self._straight and state.rest.places else None,
            'scale_mm_per_px': _scale(state),
            'polarity': None if state.polarity is None else state.polarity.evidence,
            'reason': None if last is None else last.reason,
            'latency_p50_s': self.latency(50.0),
            'latency_p99_s': self.latency(99.0),
        }
        return (
            texts(values)
            | count_texts('unexplained', state.unexplained)
            | count_texts('rejected', state.rejected)
        )


def _scale(state: TrackerState) -> float | None:
    """Return the size of a pixel in the middle of the image, mm; None while unknown."""
    lens, plane = state.lens, state.plane
    if lens is None or plane is None:
        return None
    middle = lens.undistort([[0.5 * (lens.width - 1), 0.5 * (lens.height - 1)]])
    return millimeters(float(plane.scale(middle)[0] * lens.scale(middle)[0]))


def _missing(tracking: Tracking) -> list[int]:
    """Return the ids of the targets that were not seen."""
    missing: list[int] = np.flatnonzero(np.isnan(tracking.sightings.x)).tolist()
    return missing
