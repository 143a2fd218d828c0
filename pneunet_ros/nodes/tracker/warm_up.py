"""Warm-up before the first image: kernels, smoother, messages."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.image import Image, LARGEST_SIDE
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.messages.tracker import outputs_of
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import (
    AreaLimits,
    BRIGHT,
    CameraSettings,
    FixedBand,
    RestPlane,
)
from pneunet_ros.vision.overlay import curve_in_image, draw
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking


def warm_up(tracker: Tracker, serializer: MessageSerializer) -> str:
    """Run every kernel and every encoder once; return why targets were not seen, or ''.

    The arm is drawn at rest, and determines the plane regardless of the settings.
    """
    resting = replace(
        tracker.settings,
        plane=RestPlane(),
        clamp_pixel=None,
        rest_frames=1,
        polarity=BRIGHT,
        dot_color=None,
        area=AreaLimits(),
    )
    drawn = Tracker(tracker.arm, resting, tracker.vision)
    image, lens = drawn_arm(drawn.arm.target_arclength, resting)
    state, _ = drawn.step(TrackerState(), lens)
    outcome = None
    for stamp_ns in (1, 2, 3):
        state, outcome = drawn.step(state, replace(image, stamp_ns=stamp_ns))
    if not isinstance(outcome, Tracking):
        return '' if outcome is None else outcome.sentence
    if outcome.curve is not None and state.plane is not None:
        draw(image, outcome, curve_in_image(outcome.curve, state.plane, lens))
    for output, result in outputs_of(outcome):
        serializer.bytes_of(output, result)
    return outcome.sentence


def drawn_arm(arclength: np.ndarray, settings: CameraSettings) -> tuple[Image, Lens]:
    """Draw a row of white dots, the first on the left."""
    radius = 4.0
    margin = 10.0 * radius
    positions = np.asarray(arclength) - arclength[0]
    pixels_per_meter = 5.0 * radius / float(np.diff(positions).min())
    pixels_per_meter = min(pixels_per_meter, (LARGEST_SIDE - 2.0 * margin - 1.0) / positions[-1])
    u = margin + positions * pixels_per_meter
    width, height = math.ceil(u[-1] + margin), math.ceil(2.0 * margin)
    offset_u, offset_v = np.arange(width) - u[:, None], np.arange(height) - 0.5 * height
    distance = np.sqrt(offset_u[:, None, :] ** 2 + offset_v[None, :, None] ** 2).min(axis=0)
    band = settings.grey_band
    white = band.high if isinstance(band, FixedBand) else 255.0
    grey = np.clip(radius + 0.5 - distance, 0.0, 1.0) * white
    lens = Lens(
        width=width,
        height=height,
        model='plumb_bob',
        matrix=np.array([[width, 0.0, width / 2], [0.0, width, height / 2], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
    )
    image = Image(
        stamp_ns=1,
        frame_id='camera',
        width=width,
        height=height,
        step=width,
        encoding='mono8',
        data=np.rint(grey).astype(np.uint8).ravel(),
    )
    return image, lens
