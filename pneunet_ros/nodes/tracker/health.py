"""How the tracker is doing: what it saw, missed and refused, summed up once a second."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.units import millimeters
from pneunet_ros.nodes.health import age, counted, Latencies, Level, Report, texts
from pneunet_ros.vision.rest_plane import RESTING
from pneunet_ros.vision.tracker import TrackerState, Tracking

IMAGE_TIMEOUT = 2.0  # s; silence of the camera that is an error


class TrackerHealth:
    """Collects what happens to images. All times are seconds of one steady clock.

    The level of a report is the worst since the last one: ERROR while no frame is explained, WARN
    where some are not, or targets are missing.
    """

    def __init__(self, image_topic: str, now: float) -> None:
        self._image_topic = image_topic
        self._started = self._reported = now
        self._image_at: float | None = None
        self._latencies = Latencies()
        self._last: Tracking | None = None
        self._stopped: Refusal | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin the time up to the next report."""
        self._frames = self._explained = 0
        self._problems: dict[str, Refusal] = {}
        self._sentences: dict[str, str] = {}
        self._missing: set[int] = set()

    def took_image(self, outcome: Tracking | Refusal, now: float) -> None:
        """Note what became of an image."""
        if isinstance(outcome, Refusal):
            self.refused(outcome)
            if not outcome.error:
                return
            self._stopped = outcome
        else:
            self._stopped = None
            self._looked_at(outcome)
        self._image_at = now

    def _looked_at(self, tracking: Tracking) -> None:
        self._last = tracking
        self._frames += 1
        if tracking.reason:
            self._sentences[tracking.reason] = tracking.sentence
        else:
            self._explained += 1
            self._missing.update(_missing(tracking))

    def refused(self, refusal: Refusal) -> None:
        """Note a message that was refused."""
        self._problems[refusal.reason] = refusal

    def published(self, latency: float) -> None:
        """Note the time (s) from the receipt of an image until its targets were published."""
        self._latencies.note(latency)

    def silence(self, now: float) -> float:
        """Return for how long (s) there has been no usable image."""
        return now - (self._started if self._image_at is None else self._image_at)

    def report(self, state: TrackerState, now: float) -> Report:
        """Sum up the time since the last report, and begin the next one."""
        rate = self._frames / max(now - self._reported, 1e-9)
        level, message = self._verdict(rate, now)
        values = self._values(state, rate, now)
        self._reported = now
        self._begin()
        return Report(level=level, message=message, values=values)

    def _verdict(self, rate: float, now: float) -> tuple[Level, str]:
        problems = self._problems
        if self._stopped is not None:
            problems = {self._stopped.reason: self._stopped, **problems}
        errors = [problem.sentence for problem in problems.values() if problem.error]
        warnings = [problem.sentence for problem in problems.values() if not problem.error]
        silence = self.silence(now)
        if silence > IMAGE_TIMEOUT:
            # What was refused in the meantime is the likely cause.
            sentence = f'no usable image on {self._image_topic} for {silence:.1f} s'
            return Level.ERROR, '; '.join([sentence, *errors, *warnings])
        if errors:
            return Level.ERROR, '; '.join(errors)
        unexplained = self._frames - self._explained
        if unexplained:
            warnings.append(
                f'{unexplained} of {self._frames} frames not explained: '
                + '; '.join(self._sentences.values())
            )
        if unexplained == self._frames > 0 and set(self._sentences) != {RESTING}:
            return Level.ERROR, '; '.join(warnings)
        if self._missing:
            ids = ', '.join(str(target) for target in sorted(self._missing))
            warnings.append(f'targets not always seen: {ids}')
        if warnings:
            return Level.WARN, '; '.join(warnings)
        if self._last is None:
            return Level.OK, f'waiting for images on {self._image_topic}'
        return Level.OK, f'tracking at {rate:.3g} Hz'

    def _values(self, state: TrackerState, rate: float, now: float) -> dict[str, str]:
        last = self._last
        seen = None if last is None else last.sightings.seen
        missing = None if last is None else _missing(last)
        values: dict[str, Any] = {
            'rate_hz': rate,
            'frames': state.frames,
            'explained': state.explained,
            'resets': state.resets,
            'image_age_s': age(self._image_at, now),
            'seen': seen,
            'missing': None if missing is None else len(missing),
            'missing_ids': None if missing is None else ', '.join(str(item) for item in missing),
            'rest_frames': state.rest.frames,
            'scale_mm_per_px': _scale(state),
            'reason': None if last is None else last.reason,
            'latency_p50_s': self._latencies.percentile(50.0),
            'latency_p99_s': self._latencies.percentile(99.0),
        }
        return (
            texts(values)
            | counted('unexplained', state.unexplained)
            | counted('rejected', state.rejected)
        )


def _scale(state: TrackerState) -> float | None:
    """Return the size of a pixel in the middle of the image, mm; None while it is not known."""
    lens, plane = state.lens, state.plane
    if lens is None or plane is None:
        return None
    middle = lens.undistorted([[0.5 * (lens.width - 1), 0.5 * (lens.height - 1)]])
    return millimeters(float(plane.scale(middle)[0] * lens.scale(middle)[0]))


def _missing(tracking: Tracking) -> list[int]:
    """Ids of the targets that were not seen."""
    missing: list[int] = np.flatnonzero(np.isnan(tracking.sightings.x)).tolist()
    return missing
