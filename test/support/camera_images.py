"""What a camera sends of the virtual lab, and what gets in its way."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.lab.pictures.scene import Occluder, turn_points

# Some encodings, and what their channels hold.
CHANNELS = {'mono8': 'g', 'rgb8': 'rgb', 'bgr8': 'bgr', 'rgba8': 'rgba', 'bgra8': 'bgra'}


def bar(
    u: float, v: float, length: float, width: float, angle: float, grey: float = 62.0
) -> Occluder:
    """Return a bar with round ends: the middle of it in px, its angle from +u towards +v."""
    turns = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 9)
    straight = 0.5 * (length - width)
    half = np.stack([straight + 0.5 * width * np.cos(turns), 0.5 * width * np.sin(turns)], axis=1)
    return Occluder(corners=turn_points(np.concatenate([half, -half]), u, v, angle), grey=grey)


def hand(
    u: float, v: float, size: float, angle: float, grey: float = 62.0
) -> tuple[Occluder, ...]:
    """Return a gloved hand, `size` px long, with forearm: palm at (u, v), fingers to `angle`.

    All in px, the angle in rad from +u towards +v.
    """
    # Forearm, palm, fingers, thumb: middle along and across, length, width (in sizes), turn (rad).
    parts = (
        (-1.85, 0.0, 3.6, 0.34, 0.0),
        (0.0, 0.0, 0.55, 0.50, 0.0),
        (0.39, -0.20, 0.78, 0.115, -0.06),
        (0.46, -0.07, 0.92, 0.115, -0.02),
        (0.44, 0.07, 0.88, 0.115, 0.02),
        (0.34, 0.20, 0.68, 0.115, 0.07),
        (0.15, 0.33, 0.50, 0.14, 0.7),
    )
    bars = []
    for along, across, length, width, turn in parts:
        (there,) = turn_points(size * np.array([[along, across]]), u, v, angle).tolist()
        bars.append(bar(there[0], there[1], size * length, size * width, angle + turn, grey))
    return tuple(bars)


def as_image(
    grey: Bytes,
    *,
    stamp_ns: int,
    frame_id: str = 'camera',
    encoding: str = 'mono8',
    padding: int = 0,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Image:
    """Return a rendered picture as a camera would send it.

    padding: bytes of rubbish after every row; tint: factors of red, green and blue, to tell them
    apart. Raises MessageError for an encoding that is none.
    """
    height, width = grey.shape
    channels = CHANNELS.get(encoding, 'g')
    factors = dict(zip('rgb', tint, strict=True))

    def plane(name: str) -> Bytes:
        if name == 'a':
            return np.full_like(grey, 255)
        if factors[name] == 1.0:
            return grey
        return np.clip(np.rint(factors[name] * grey), 0.0, 255.0).astype(np.uint8)

    step = width * len(channels) + padding
    data = np.full((height, step), 170, np.uint8)
    pixels = np.stack([plane(name) for name in channels], axis=2)
    data[:, : step - padding] = pixels.reshape(height, -1)
    return Image(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        width=width,
        height=height,
        step=step,
        encoding=encoding,
        data=freeze_bytes(data),
    )


def freeze_bytes(data: Bytes) -> Bytes:
    """Return rows of bytes as one read-only run."""
    run = data.reshape(-1)
    run.flags.writeable = False
    return run
