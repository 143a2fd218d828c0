"""Annotated image of a frame: targets with ids, curve, reason."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.working_plane import Plane
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import Tracking

# Blue, green, red.
SEEN, CURVE, GOOD, BAD, SHADE = (60, 160, 255), (80, 220, 80), (255, 255, 255), (80, 80, 255), 0.45
AREA = 6.0  # px, radius of a ring around an area, where lines are one pixel wide
FONT = cv2.FONT_HERSHEY_SIMPLEX
REFERENCE_HEIGHT = 480  # px of an image in which lines are one pixel wide
SUBPIXEL_BITS = 4
LABEL_WIDTH = 22.0  # px, room for an id where lines are one pixel wide
MOST_IDS = 12  # ids listed in the line of text


def draw(image: Image, tracking: Tracking, curve: Array | None = None) -> Bytes:
    """Return the annotated grey image, (height, width, 3), blue-green-red.

    curve: (n, 2) px: image of `tracking.curve`, from `curve_in_image`.
    """
    picture = cv2.cvtColor(image.grey(), cv2.COLOR_GRAY2BGR)
    size = max(1.0, image.height / REFERENCE_HEIGHT)
    if curve is not None:
        points = _fixed(curve[np.isfinite(curve).all(axis=1)])
        cv2.polylines(
            picture, [points], False, CURVE, round(size), cv2.LINE_AA, shift=SUBPIXEL_BITS
        )
    _mark_targets(picture, tracking.sightings, size)
    _mark_others(picture, tracking, size)
    _write(picture, headline(tracking), GOOD if not tracking.reason else BAD, size)
    return np.asarray(picture, np.uint8)


def curve_in_image(curve: MeasuredCurve, plane: Plane, lens: Lens) -> Array:
    """Return the image of a curve in the working plane, (n, 2) px; NaN outside."""
    return lens.distort(plane.normalized(np.column_stack([curve.x, curve.y])))


def headline(tracking: Tracking) -> str:
    """Return the headline of a frame: the reason for a missing result, or the missing targets."""
    if tracking.reason:
        return f'{tracking.reason}: {tracking.sentence}'
    sightings = tracking.sightings
    missing = np.flatnonzero(np.isnan(sightings.x)).tolist()
    text = f'{sightings.seen} of {len(sightings.x)} targets'
    if missing:
        named = ', '.join(str(target) for target in missing[:MOST_IDS])
        text += f', missing {named}' + (', ...' if len(missing) > MOST_IDS else '')
    return text


def _mark_targets(picture: Any, sightings: TargetSightings, size: float) -> None:
    seen = np.flatnonzero(np.isfinite(sightings.u))
    centers = np.column_stack([sightings.u, sightings.v])[seen]
    for (u, v), major in zip(_fixed(centers), sightings.major[seen], strict=True):
        radius = round((0.5 * float(major) + 2.0 * size) * 2**SUBPIXEL_BITS)
        cv2.circle(
            picture, (int(u), int(v)), radius, SEEN, round(size), cv2.LINE_AA, SUBPIXEL_BITS
        )
    if len(seen) < 2:
        return
    # Ids next to the row, as many as fit.
    steps = np.diff(centers, axis=0) / np.diff(seen)[:, None]
    spacing = float(np.median(np.hypot(*steps.T)))
    every = int(np.ceil(LABEL_WIDTH * size / max(spacing, 1.0)))
    away = 0.5 * float(np.median(sightings.major[seen])) + 12.0 * size
    for target, (u, v), (along_u, along_v) in zip(
        seen, centers, np.vstack([steps, steps[-1:]]), strict=True
    ):
        if target % every == 0:
            length = max(float(np.hypot(along_u, along_v)), 1e-9)
            place = u - along_v / length * away, v + along_u / length * away
            _text(picture, str(target), place, 0.4 * size, SEEN, centered=True)


def _mark_others(picture: Any, tracking: Tracking, size: float) -> None:
    """Mark the areas in a frame without a row, and the positions of missing targets."""
    radius = round(AREA * size * 2**SUBPIXEL_BITS)
    for u, v in _fixed(tracking.found).tolist():
        cv2.circle(picture, (u, v), radius, BAD, round(size), cv2.LINE_AA, SUBPIXEL_BITS)
    for target, missing in tracking.missing.items():
        if abs(missing.u) < 1e5 and abs(missing.v) < 1e5:
            place = round(missing.u), round(missing.v)
            side = round(2.0 * AREA * size)
            cv2.drawMarker(picture, place, BAD, cv2.MARKER_TILTED_CROSS, side, round(size))
            label = missing.u + 1.5 * AREA * size, missing.v + 0.6 * AREA * size
            _text(picture, f'{target}: {missing.cause}', label, 0.4 * size, BAD, centered=False)


def _write(picture: Any, text: str, color: tuple[int, int, int], size: float) -> None:
    """Write a text at the top, on a darkened band, with line breaks."""
    scale, margin, pitch = 0.5 * size, 6.0 * size, 20.0 * size
    # The fonts of OpenCV have no other characters.
    text = text.encode('ascii', 'replace').decode()
    lines = _lines(text, scale, picture.shape[1] - 2.0 * margin)
    band = picture[: round(len(lines) * pitch + margin)]
    np.multiply(band, SHADE, out=band, casting='unsafe')
    for number, line in enumerate(lines, start=1):
        _text(picture, line, (margin, number * pitch - 0.5 * margin), scale, color, centered=False)


def _lines(text: str, scale: float, room: float) -> list[str]:
    """Break a text into lines that fit into `room` (px); a single word may be too long."""
    lines: list[str] = []
    for word in text.split():
        longer = f'{lines[-1]} {word}' if lines else word
        if lines and cv2.getTextSize(longer, FONT, scale, 1)[0][0] <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _text(
    picture: Any,
    text: str,
    place: tuple[float, float],
    scale: float,
    color: tuple[int, int, int],
    *,
    centered: bool,
) -> None:
    u, v = place
    if centered:
        (width, height), _ = cv2.getTextSize(text, FONT, scale, 1)
        u, v = u - 0.5 * width, v + 0.5 * height
    if abs(u) < 1e5 and abs(v) < 1e5:
        thickness = max(1, round(1.5 * scale))
        cv2.putText(
            picture, text, (round(u), round(v)), FONT, scale, color, thickness, cv2.LINE_AA
        )


def _fixed(points: Array) -> npt.NDArray[np.int32]:
    """Return points (n, 2) px in OpenCV's fixed-point form (SUBPIXEL_BITS)."""
    return np.asarray(np.rint(np.clip(points, -1e5, 1e5) * 2**SUBPIXEL_BITS), np.int32)
