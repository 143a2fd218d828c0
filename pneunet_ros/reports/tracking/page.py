"""Preview of tracking as one HTML page: a verdict, and frames to scrub through.

Each frame shows image, targets, measured centerline and, if the recording has estimates, the
predicted one; the distances of each target from these lines are shown below.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import hashlib
import importlib.resources
import math
import shlex
from typing import Any

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Image
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.stamps import match_stamps
from pneunet_ros.core.units import millimeters, seconds_since
from pneunet_ros.estimation.shape_error import Centerlines, median_period
from pneunet_ros.reports.figure import render_page
from pneunet_ros.reports.tracking.preview import Preview
from pneunet_ros.vision.overlay import curve_in_image, headline
from pneunet_ros.vision.rest_plane import RESTING
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import TrackerState, Tracking
import scipy

FOLLOWS = 0.99  # share of tracked frames from which the tracking counts as successful

TEMPLATE = 'tracking_report.html.jinja'
SCRIPT = 'scrub.js'
SHOWN = 48  # largest number of frames; of a longer film at least half as many
WIDEST = 720  # px, of a frame in the page
JPEG_QUALITY = 70
MICRO = 1e6


@dataclass(slots=True, kw_only=True)
class TrackingPage:
    """Collects the frames of a recording for a page.

    source: as given by the user; model: name of the arm; target_arclength (targets,) m; estimated:
    the shapes in the recording, None without; preview: of all frames; film: numbers of the delay
    of a film with a table, filled before the page is made, otherwise empty. arm_options,
    image_options: the options for the arm and for the images, as typed.
    """

    source: str
    model: str
    target_arclength: Array
    preview: Preview
    estimated: Centerlines | None = None
    film: Mapping[str, Any] = field(default_factory=dict)
    arm_options: Sequence[str] = ()
    image_options: Sequence[str] = ()
    _every: int = 1
    _count: int = 0
    _explained: int = 0
    _start_ns: int = 0
    _seen: int = 0
    _reasons: Counter[str] = field(default_factory=Counter)
    _sentences: dict[str, str] = field(default_factory=dict)
    _stds: list[float] = field(default_factory=list)
    _rms: list[float] = field(default_factory=list)
    _frames: list[dict[str, Any]] = field(default_factory=list)

    def add(
        self,
        log_time_ns: int,
        image: Image | None,
        outcome: Tracking | Refusal | None,
        state: TrackerState,
    ) -> None:
        """Add a frame, readable or not; None for a skipped one."""
        self.preview.add(log_time_ns, image, outcome, state)
        self._start_ns = self._start_ns or log_time_ns
        if outcome is not None:
            self._tally(outcome)
        if image is not None and isinstance(outcome, Tracking) and self._count % self._every == 0:
            seconds = seconds_since(self._start_ns, log_time_ns)
            self._frames.append(self._frame(seconds, image, outcome, state))
        if len(self._frames) > SHOWN:
            self._frames = self._frames[::2]
            self._every *= 2
        self._count += 1

    def _tally(self, outcome: Tracking | Refusal) -> None:
        if isinstance(outcome, Refusal) or outcome.reason:
            self._reasons[outcome.reason] += 1
            self._sentences[outcome.reason] = outcome.sentence
            return
        self._explained += 1
        self._seen += outcome.sightings.seen
        self._stds.append(float(np.nanmedian(outcome.sightings.std)))
        if outcome.curve is not None:
            self._rms.append(outcome.curve.rms)

    def _frame(
        self, seconds: float, image: Image, tracking: Tracking, state: TrackerState
    ) -> dict[str, Any]:
        """Return the data of a frame for the script of the page, in pixels of the small image."""
        grey = image.grey()
        scale = min(1.0, WIDEST / image.width)
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        _, jpeg = cv2.imencode('.jpg', small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        sightings = tracking.sightings
        frame: dict[str, Any] = {
            'text': f't = {seconds:.3f} s: {headline(tracking)}',
            'image': f'data:image/jpeg;base64,{base64.b64encode(jpeg.tobytes()).decode()}',
            'width': small.shape[1],
            'height': small.shape[0],
            'targets': pixels(np.column_stack([sightings.u, sightings.v]), scale),
            'radius': 3.0
            if tracking.reason
            else round(0.5 * scale * float(np.nanmedian(sightings.major)) + 2.0, 1),
        }
        if tracking.reason or state.plane is None or state.lens is None:
            return frame
        if tracking.curve is not None:
            frame['measured'] = pixels(
                curve_in_image(tracking.curve, state.plane, state.lens), scale
            )
            frame['from_measured'] = self._distances(tracking, *line_of(tracking.curve))
        points = self._estimate_at(sightings.stamp_ns)
        if points is not None and self.estimated is not None:
            in_image = state.lens.distort(state.plane.normalized(points.T))
            frame['predicted'] = pixels(in_image, scale)
            frame['from_predicted'] = self._distances(tracking, self.estimated.arclength, points)
        return frame

    def _distances(self, tracking: Tracking, arclength: Array, points: Array) -> list[int | None]:
        """Return the distance (um) of each target to the left of a curve; None if unknown."""
        at = self.target_arclength
        inside = (at >= arclength[0] - 1e-9) & (at <= arclength[-1] + 1e-9)
        spline = scipy.interpolate.CubicSpline(arclength, points, axis=1)
        x, y = spline(at)
        slope_x, slope_y = spline(at, 1)
        normal = (tracking.sightings.y - y) * slope_x - (tracking.sightings.x - x) * slope_y
        distance = np.where(inside, MICRO * normal / np.hypot(slope_x, slope_y), np.nan)
        return [round(value) if math.isfinite(value) else None for value in distance.tolist()]

    def _estimate_at(self, stamp_ns: int) -> Array | None:
        """Return estimated points (2, stations) m nearest to a stamp; None if there are none."""
        if self.estimated is None or not self.estimated.stamp_ns.size:
            return None
        reach = 0.5 * median_period(self.estimated.stamp_ns)
        found, is_matched = match_stamps(
            np.array([stamp_ns]), self.estimated.stamp_ns, reach if math.isfinite(reach) else 0.0
        )
        return self.estimated.points[found[0]] if is_matched[0] else None

    def html(self, output: str) -> str:
        """Return the page; output: the written recording, '' if there is none."""
        script = importlib.resources.files('pneunet_ros.reports.templates').joinpath(SCRIPT)
        text = script.read_text(encoding='utf-8')
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        next_step, command = self._next(output)
        return render_page(
            TEMPLATE,
            source=self.source,
            model=self.model,
            verdict=self._verdict(),
            certainty=self._certainty(),
            delay=self._delay(),
            next_step=next_step,
            command=command,
            reasons=[
                (reason, count, self._sentences[reason])
                for reason, count in self._reasons.most_common()
            ],
            frames=self._frames,
            total=self._count,
            first=self._first_tracked(),
            length=float(self.target_arclength[-1]),
            arclength=self.target_arclength.tolist(),
            summary=self.preview.summary().inline,
            script=text,
            script_digest=digest,
            provenance=[('source', self.source), ('model', self.model), ('output', output)],
        )

    def _first_tracked(self) -> int:
        """Return the first shown frame in which targets were found."""
        tracked = [place for place, item in enumerate(self._frames) if 'measured' in item]
        return tracked[0] if tracked else 0

    @property
    def _moving(self) -> int:
        """Number of frames after the frames that determined the arm at rest."""
        return self._count - self._reasons[RESTING]

    @property
    def _good(self) -> bool:
        return self._explained >= FOLLOWS * max(self._moving, 1)

    def _verdict(self) -> str:
        if not self._count:
            return 'It contains no frames.'
        frames = f'{self._explained} of {self._moving} frames tracked'
        if self._reasons[RESTING]:
            frames += f' after {self._reasons[RESTING]} of the arm at rest'
        if not self._explained:
            return f'The arm was not found: {frames}.'
        share = self._seen / (self._explained * self.target_arclength.size)
        seen = f'{100.0 * share:.1f} % of the targets in them seen'
        if self._good:
            return f'The tracker follows the arm: {frames}, {seen}.'
        return f'The tracker loses the arm: {frames}, {seen}.'

    def _certainty(self) -> str:
        if not self._stds:
            return 'No target was found, so there is no accuracy to state.'
        text = (
            f'One sigma of a target is {millimeters(float(np.median(self._stds))):.2g} mm '
            'per coordinate, as the tracker estimates it from the image'
        )
        if self._rms:
            rms = millimeters(float(np.median(self._rms)))
            text += f'; targets are {rms:.2g} mm rms from the smooth curve'
        return f'{text}. Check below that this is the right row.'

    def _delay(self) -> str:
        """Describe the delay of the film relative to the table; '' without a table."""
        if not self.film:
            return ''
        covered = f'{self.film["frames_covered"]} of {self._count} frames lie within the table'
        return f'{self.film["delay_sentence"]}; {covered}.'

    def _next(self, output: str) -> tuple[str, str]:
        track = ['pneunet', 'track', self.source, *self.arm_options, *self.image_options]
        if not self._good:
            return (
                'Look at the frames that were not tracked, and describe the targets in a camera '
                'file.',
                shlex.join([*track, '--camera', 'CAMERA.yaml', '--preview', 'AGAIN.html']),
            )
        if self.film and not self.film['frames_covered']:
            return (
                'Nothing was written: give the delay by which the film is ahead of the table.',
                shlex.join(
                    [
                        *track,
                        '--readings',
                        self.film['readings'],
                        '--delay',
                        'S',
                        '--output',
                        output,
                    ]
                ),
            )
        if not output:
            return (
                'Write the targets into a recording.',
                shlex.join([*track, '--output', 'TRACKED.mcap']),
            )
        return (
            'Check what the recording can be used for.',
            shlex.join(['pneunet', 'check', output, *self.arm_options]),
        )


def line_of(curve: MeasuredCurve) -> tuple[Array, Array]:
    """Return arclength (stations,) m and points (2, stations) m of a measured curve."""
    return curve.arclength, np.stack([curve.x, curve.y])


def pixels(points: Array, scale: float) -> list[list[float] | None]:
    """Return points (n, 2) px in a scaled image, to a tenth; None if missing."""
    return [
        [round(scale * u, 1), round(scale * v, 1)] if math.isfinite(u + v) else None
        for u, v in points.tolist()
    ]
