"""Several rows of targets in the images of one camera: one tracker each, no target in two rows.

The trackers share the processing of an image. If two rows claim one blob, the row with the nearer
prediction keeps the blob, and the tracker of the other row processes the image again without it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.image import Image
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.pauses import pause
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import HomographyPlane, PosePlane
from pneunet_ros.vision.dots.blobs import same_blobs
from pneunet_ros.vision.rows.view import NONE_TAKEN
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking

Step = tuple[TrackerState, Tracking | Refusal | None]


def step_rows(
    trackers: Sequence[Tracker], states: Sequence[TrackerState], reading: Image | Lens
) -> list[Step]:
    """Process an image or a lens for all trackers, like `Tracker.step` for one.

    Tracked rows come first: their blobs are not available to a search. Each tracker that loses
    blobs to another one processes the image again. Because this may claim blobs of a third row,
    the procedure is repeated up to the number of trackers.
    """
    if isinstance(reading, Lens):
        return [one.step(state, reading) for one, state in zip(trackers, states, strict=True)]
    taken, found = [NONE_TAKEN] * len(trackers), dict[int, Step]()
    for place in sorted(range(len(trackers)), key=lambda place: states[place].row is None):
        if states[place].row is None:
            followed = (at for at in found if states[at].row is not None)
            claims = [_claims(trackers[at], states[at], found[at])[0] for at in followed]
            taken[place] = np.concatenate([NONE_TAKEN, *claims])
        pause()
        found[place] = trackers[place].step(states[place], reading, taken[place])
    steps = [found[place] for place in range(len(trackers))]
    for _ in trackers[1:]:
        lost = list(_lost_blobs(trackers, states, steps))
        for place, blobs in lost:
            taken[place] = np.concatenate([taken[place], blobs])
        for place in {place for place, _ in lost}:
            pause()
            steps[place] = trackers[place].step(states[place], reading, taken[place])
        if not lost:
            break
    return steps


def check_rows(trackers: Mapping[str, Tracker]) -> None:
    """Raise CameraError unless each tracker of a camera has its own row.

    A row is identified by its plane or its clamp_pixel.
    """
    if len(trackers) < 2:
        return
    rows: dict[object, str] = {}
    for name, tracker in trackers.items():
        plane = tracker.settings.plane
        is_known = isinstance(plane, HomographyPlane | PosePlane)
        row = plane if is_known else tracker.settings.clamp_pixel
        other = rows.setdefault(row, name)
        if row is None or other != name:
            who = name if row is None else f'{other} and {name}'
            raise CameraError(
                f'it is not known which row in the images of the shared camera belongs to {who}: '
                'set a clamp_pixel for each arm',
                reason='missing',
            )


def _lost_blobs(
    trackers: Sequence[Tracker], states: Sequence[TrackerState], steps: Sequence[Step]
) -> Iterator[tuple[int, Array]]:
    """Yield each tracker with the blobs (n, COLUMNS) that it loses to another one."""
    claims = [_claims(*one) for one in zip(trackers, states, steps, strict=True)]
    for second, (blobs, off) in enumerate(claims):
        for first, (others, others_off) in enumerate(claims[:second]):
            mine, theirs = np.nonzero(same_blobs(blobs, others))
            loses = others_off[theirs] <= off[mine]
            if loses.any():
                yield second, others[theirs[loses]]
            if not loses.all():
                yield first, blobs[mine[~loses]]


def _claims(tracker: Tracker, state: TrackerState, step: Step) -> tuple[Array, Array]:
    """Return the blobs claimed by a row (n, COLUMNS), and their distance from predictions, px.

    state: before the image. A row that was not tracked from the last image has no predictions.
    """
    row = step[0].row
    if row is None or not (isinstance(step[1], Tracking) and not step[1].reason):
        return NONE_TAKEN, np.empty(0)
    blobs = row.table[row.seen]
    if state.row is None:
        return blobs, np.full(len(blobs), np.inf)
    expected = state.row.predict(row.stamp_ns)[row.seen]
    return blobs, np.hypot(*(blobs[:, :2] - expected).T)
