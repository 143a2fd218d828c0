"""Polygons, glare, light and texture of the virtual lab, without subpixel accuracy."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.lab.pictures.lens import Camera
from pneunet_ros.lab.pictures.scene import Body, Glint, Label, Light, turn_points

Grey = npt.NDArray[np.float32]
Canvas = npt.NDArray[np.uint8]
Window = tuple[slice, slice]

FINE = 4  # subdivisions of a pixel, per axis, in the mask of a polygon
SUBPIXEL_BITS = 6
STUB = 0.008  # m of arm drawn before the first target, up to the clamp
CLAMP = (0.009, 0.016, 118.0)  # m: length along and half width across; grey level
CORNER_SAMPLES = 6  # along one chamber


def polygon_mask(corners: Array, width: int, height: int) -> tuple[Window, Grey] | None:
    """Return the window of a polygon (n, 2) px in the image and the covered shares in it."""
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, (width, height))
    if np.any(low >= high):
        return None
    columns, rows = (int(value) for value in high - low)
    mask = np.zeros((FINE * rows, FINE * columns), np.uint8)
    fill(mask, [FINE * (corners - low + 0.5) - 0.5], 255.0, smooth=False)
    coarse: Any = cv2.resize(mask, (columns, rows), interpolation=cv2.INTER_AREA)
    window = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    return window, coarse.astype(np.float32) / np.float32(255.0)


def fill(canvas: Canvas, polygons: list[Array], grey: float, smooth: bool = True) -> None:
    """Fill polygons, each (n, 2) px, on a canvas."""
    fixed_point: list[Any] = [
        np.rint(corners * 2**SUBPIXEL_BITS).astype(np.int32) for corners in polygons
    ]
    line = cv2.LINE_AA if smooth else cv2.LINE_8
    cv2.fillPoly(canvas, fixed_point, round(grey), line, SUBPIXEL_BITS)


def draw_label(canvas: Canvas, label: Label) -> None:
    """Draw a bright rectangle with lines of dark bars of uneven length, like words."""
    fill(canvas, [_rectangle(label, -0.5, 0.5, -0.5, 0.5)], label.grey)
    words = np.random.default_rng(label.lines)
    for line in range(label.lines):
        top = -0.4 + 0.8 * (line + 0.2) / label.lines
        bottom = top + 0.45 / label.lines
        cursor = -0.43
        while cursor < 0.3:
            end = min(cursor + words.uniform(0.06, 0.24), 0.43)
            fill(canvas, [_rectangle(label, cursor, end, top, bottom)], label.ink)
            cursor = end + 0.045


def _rectangle(label: Label, left: float, right: float, top: float, bottom: float) -> Array:
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    return turn_points(corners * [label.width, label.height], label.u, label.v, label.angle)


def draw_body(canvas: Canvas, body: Body, camera: Camera) -> None:
    """Draw the arm: a base layer, chambers with gaps, and the clamp."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(body.x), np.diff(body.y)))])
    start = np.array([body.x[0], body.y[0]])
    tangent = np.array([np.cos(body.theta[0]), np.sin(body.theta[0])])

    def outlines(s: Array, top: float, bottom: float) -> list[Array]:
        """Return corners (px) of bands between two heights over the curve, s (bands, places)."""
        theta = np.interp(s, length, body.theta)
        before = np.minimum(s, 0.0)
        x = np.interp(s, length, body.x) + before * tangent[0]
        y = np.interp(s, length, body.y) + before * tangent[1]
        sin, cos = np.sin(theta), np.cos(theta)
        u, v = camera.project(
            np.concatenate([x - top * sin, (x - bottom * sin)[:, ::-1]], axis=1),
            np.concatenate([y + top * cos, (y + bottom * cos)[:, ::-1]], axis=1),
        )
        return list(np.stack([u, v], axis=2))

    end = float(length[-1]) + 0.5 * body.below
    band = np.concatenate([[-STUB], length, [end]])[None]
    fill(canvas, outlines(band, 0.45 * body.above, -body.below), body.grey)
    fill(canvas, outlines(band, -0.72 * body.below, -body.below), body.grey + 16.0)
    starts = np.arange(-0.3 * body.pitch, end - 0.3 * body.pitch, body.pitch)[:, None]
    chambers = np.minimum(starts + np.linspace(0.0, 0.8 * body.pitch, CORNER_SAMPLES), end)
    fill(canvas, outlines(chambers, body.above, 0.2 * body.above), body.grey + 3.0)
    fill(canvas, outlines(chambers, body.above, 0.86 * body.above), body.grey + 20.0)
    reach, half, grey = CLAMP
    normal = np.array([-tangent[1], tangent[0]])
    inner_end, outer_end = start - STUB * tangent, start - (STUB + reach) * tangent
    block = np.array(
        [
            inner_end + half * normal,
            outer_end + half * normal,
            outer_end - half * normal,
            inner_end - half * normal,
        ]
    )
    fill(canvas, [np.stack(camera.project(block[:, 0], block[:, 1]), axis=1)], grey)


def glare(glints: tuple[Glint, ...], width: int, height: int) -> Grey:
    """Return the grey levels (height, width) added by glints."""
    layer = np.zeros((height, width), np.float32)
    for glint in glints:
        reach = int(4.0 * max(glint.major, glint.minor)) + 2
        rows = slice(max(int(glint.v) - reach, 0), max(int(glint.v) + reach + 1, 0))
        columns = slice(max(int(glint.u) - reach, 0), max(int(glint.u) + reach + 1, 0))
        window = layer[rows, columns]
        v, u = np.mgrid[rows, columns][:, : window.shape[0], : window.shape[1]]
        points = np.stack([u - glint.u, v - glint.v], axis=-1)
        along = points @ np.array([np.cos(glint.angle), np.sin(glint.angle)])
        across = points @ np.array([-np.sin(glint.angle), np.cos(glint.angle)])
        square = (along / glint.major) ** 2 + (across / glint.minor) ** 2
        window += (glint.strength * np.exp(-(square**2))).astype(np.float32)
    return layer


def illumination(light: Light, width: int, height: int) -> Grey:
    """Return the brightness of the light at every pixel, (height, width)."""
    u = (np.arange(width) - 0.5 * (width - 1)) / width
    v = ((np.arange(height) - 0.5 * (height - 1)) / height)[:, None]
    slope = 1.0 + light.gradient_u * u + light.gradient_v * v
    fall = 1.0 - light.vignette * 2.0 * (u**2 + v**2)
    return np.maximum(light.level * slope * fall, 0.0).astype(np.float32)


def backdrop(level: float, texture: float, seed: int, width: int, height: int) -> Grey:
    """Return an uneven background (height, width): large stains and a fine grain."""
    layer = np.full((height, width), level, np.float32)
    if texture > 0.0:
        rng = np.random.default_rng(seed)
        for sigma, share in ((0.06 * width, 0.8), (6.0, 0.5), (1.0, 0.35)):
            stains: Any = rng.standard_normal((height, width), np.float32)
            stains = cv2.GaussianBlur(stains, (0, 0), sigma)
            layer += texture * share / max(float(stains.std()), 1e-9) * stains
    return layer
