"""An arm with dots composed on photographs of the real world, with exact truth.

Nothing here knows the detection, the tracker or the virtual lab: shapes are integrated from a
smooth curvature, dots are drawn by area coverage, and light, shadow, optics, exposure and
compression are those of an ordinary camera. Photographs are those that scikit-image and
scikit-learn ship. Pixel (0, 0) is the center of the first pixel, u to the right, v down.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import functools
import math

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]

PHOTOGRAPHS = ('brick', 'china', 'coffee', 'grass', 'gravel', 'motorcycle')
POLARITIES = ('bright', 'dark')
DISTURBANCES = ('blur', 'jpeg', 'flicker', 'hand', 'uneven')

WIDTH, HEIGHT = 1280, 720
FRAME_NS = 33_333_333
FINE = 16  # parts of a pixel, per axis, of which a dot covers whole ones
COARSE = 4  # the same, of the outlines of body and hand
STATIONS = 1601  # of the curve from the clamp to the end of the body
GHOSTS = 1.5  # px, that the arm moves at most between moments of an exposure

FLICKER = 0.15
UNEVEN = 0.1  # of the radius, one sigma, of dots painted by hand
JPEG_QUALITY = 70
EDGES = np.array([-0.5, 0.5])  # of an exposure, in it
EXPOSURE = 0.5  # of a frame, for which the shutter is open where motion blurs
ROOM_AROUND = 44  # px around the body, into which its shadow falls
OPTICS = 0.7  # px, one sigma of the blur of the lens


def photograph(name: str) -> Bytes:
    """Return a photograph that a package ships, (height, width, 3) BGR, as large as the camera."""
    picture = _shipped(name)
    if picture.ndim == 2:
        picture = np.repeat(picture[:, :, None], 3, axis=2)
    height, width = picture.shape[:2]
    larger = max(WIDTH / width, HEIGHT / height)
    size = (math.ceil(larger * width), math.ceil(larger * height))
    picture = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)
    top, left = (size[1] - HEIGHT) // 2, (size[0] - WIDTH) // 2
    return np.ascontiguousarray(picture[top : top + HEIGHT, left : left + WIDTH, ::-1])


def _shipped(name: str) -> Bytes:
    if name in ('china', 'flower'):
        from sklearn.datasets import load_sample_image

        return np.asarray(load_sample_image(f'{name}.jpg'), np.uint8)
    from skimage import data

    if name == 'motorcycle':
        return np.asarray(data.stereo_motorcycle()[0], np.uint8)
    return np.asarray(getattr(data, name)(), np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Composition:
    """What is seen: a photograph, an arm in front of it, and what disturbs the picture.

    polarity: `bright` dots on a dark arm or `dark` dots on a pale one through which the photograph
    shines; disturbances: some of DISTURBANCES. The arm rests for `resting` frames, bent by
    `rest_bend` rad from end to end, and then bends by up to `bend` rad; `begin` is the frame of
    this motion with which the film begins. Dots are `spacing` apart and have `radius` px at the
    clamp, `taper` times that at the tip; the body ends `overhang` radii beyond the center of the
    last one, which is cut off there where that is below 1.
    """

    photograph: str
    polarity: str
    disturbances: frozenset[str] = frozenset()
    frames: int = 60
    begin: int = 0
    resting: int = 8
    targets: int = 23
    spacing: float = 38.0
    radius: float = 5.0
    taper: float = 1.0
    bend: float = 1.7
    rest_bend: float = 0.0
    overhang: float = 0.8
    noise: float = 2.0
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A picture (height, width, 3) BGR, and the truth about its dots, (targets,).

    u, v px: their centers, in the middle of the exposure; visible: which share of a whole dot is
    on the body and not covered; spacing px: between neighbors along the arm.
    """

    stamp_ns: int
    picture: Bytes
    u: Array
    v: Array
    visible: Array
    spacing: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """The centerline in the image at STATIONS: arclength, u, v in px, heading in rad."""

    s: Array
    u: Array
    v: Array
    heading: Array

    def at(self, s: Array) -> Array:
        """Return u, v and heading at arclengths (n,), as rows (3, n)."""
        return np.array([np.interp(s, self.s, rows) for rows in (self.u, self.v, self.heading)])

    def outline(self, half: float) -> Array:
        """Return the polygon (n, 2) around a body of this half width."""
        side = half * np.column_stack([-np.sin(self.heading), np.cos(self.heading)])
        middle = np.column_stack([self.u, self.v])
        return np.concatenate([middle + side, (middle - side)[::-1]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A part of the picture: its first pixel, and how many there are."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Return rows and columns of the picture."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    @property
    def corner(self) -> Array:
        """The first pixel, (u, v)."""
        return np.array([self.left, self.top], np.float64)


class Composer:
    """Composes the frames of one film; iterating gives them in order."""

    def __init__(self, composition: Composition) -> None:
        self.composition = it = composition
        rng = np.random.default_rng([it.seed, *it.photograph.encode(), len(it.polarity)])
        self.length = (it.targets - 1) * it.spacing
        self.up = float(rng.choice([-1.0, 1.0]))  # to which side the arm bends, v down
        self.roll = rng.uniform(-0.05, 0.05)
        self.waves = rng.uniform(-1.0, 1.0, 4)
        self.phases = rng.uniform(0.0, 2.0 * math.pi, 3)
        self.radii = it.radius * np.linspace(1.0, it.taper, it.targets)
        if 'uneven' in it.disturbances:
            painted = np.random.default_rng([it.seed, *it.photograph.encode()])
            self.radii *= 1.0 + UNEVEN * painted.standard_normal(it.targets)
        self.half = 2.9 * it.radius
        self.margin = it.overhang * self.radii[-1]
        self.base = np.zeros(2)
        self.base = self._centered() + rng.uniform(-10.0, 10.0, 2)
        room = photograph(it.photograph).astype(np.float32)
        self.light = _light(rng.uniform(-0.12, 0.12, 2))[:, :, None]
        self.room = room * self.light
        self.through = cv2.GaussianBlur(room, (0, 0), 5.0) * self.light
        self.far = cv2.GaussianBlur(self.room, (0, 0), OPTICS)
        self.grain = it.noise * rng.standard_normal((HEIGHT + 64, WIDTH + 64, 3), np.float32)

    def __iter__(self) -> Iterator[Frame]:
        for number in range(self.composition.frames):
            yield self.frame(number)

    def frame(self, number: int) -> Frame:
        """Compose one frame of the film; the same number gives the same frame again."""
        it = self.composition
        moments = np.array([float(it.begin + number)])
        if 'blur' in it.disturbances:
            way = np.ptp([self._tip(moment) for moment in moments + EXPOSURE * EDGES], axis=0)
            count = 1 + math.ceil(math.hypot(*way) / GHOSTS)
            moments = moments + EXPOSURE * ((np.arange(count) + 0.5) / count - 0.5)
        window = self._window(moments)
        drawn = [self._draw(moment, window) for moment in moments.tolist()]
        picture = self.far.copy()
        picture[window.slices] = sum(one[0] for one in drawn) / np.float32(len(drawn))
        u, v = np.mean([one[1] for one in drawn], axis=0)
        return Frame(
            stamp_ns=(number + 1) * FRAME_NS,
            picture=self._expose(picture, number),
            u=u,
            v=v,
            visible=np.mean([one[2] for one in drawn], axis=0),
            spacing=it.spacing,
        )

    def empty(self, number: int) -> Bytes:
        """Return the picture before the arm is in it, (height, width, 3) BGR."""
        return self._expose(self.far, number)

    def _centered(self) -> Array:
        """Return where the clamp must be for the motion to be in the middle of the picture."""
        it = self.composition
        moments = it.begin + np.arange(0, it.frames, 4)
        places = np.concatenate([
            np.column_stack([curve.u, curve.v]) for curve in map(self.curve, moments)
        ])  # fmt: skip
        return 0.5 * (np.array([WIDTH, HEIGHT]) - places.min(axis=0) - places.max(axis=0))

    def _window(self, moments: Array) -> Window:
        """Return the part of the picture in which something is drawn at these moments."""
        shapes = [self.curve(moment).outline(self.half) for moment in moments.tolist()]
        shapes += [part for moment in moments.tolist() for part in self._hand(moment)]
        places = np.concatenate(shapes)
        low = np.clip(places.min(axis=0) - ROOM_AROUND - 40, 0, [WIDTH - 1, HEIGHT - 1])
        high = np.clip(places.max(axis=0) + ROOM_AROUND, 1, [WIDTH, HEIGHT])
        left, top = (int(value) for value in low)
        return Window(left=left, top=top, width=int(high[0]) - left, height=int(high[1]) - top)

    def curve(self, moment: float) -> Curve:
        """Return the centerline at a moment (frames): its curvature is smooth along the arm."""
        it = self.composition
        since = max(moment - it.resting, 0.0)
        bent = math.sin(math.pi * since / 74.0) ** 2
        second = 0.35 * math.sin(2.0 * math.pi * since / 47.0) * min(since / 10.0, 1.0)
        s = np.linspace(-0.7 * it.spacing, self.length + self.margin, STATIONS)
        share = s / self.length
        wave = 1.0 + 0.3 * self.waves[0] * np.cos(2.0 * share) + 0.3 * self.waves[1] * share
        curvature = it.bend * bent * wave + second * np.sin(2.5 * share + self.waves[2])
        curvature += it.rest_bend * (1.0 + 0.25 * self.waves[3] * np.cos(3.0 * share))
        curvature *= self.up * (s > 0.0) / self.length
        heading = self.roll + _integral(curvature, s)
        u, v = _integral(np.cos(heading), s), _integral(np.sin(heading), s)
        at_base = np.interp(0.0, s, u), np.interp(0.0, s, v)
        return Curve(
            s=s, u=u - at_base[0] + self.base[0], v=v - at_base[1] + self.base[1], heading=heading
        )

    def _tip(self, moment: float) -> Array:
        """Return where the end of the body is at a moment."""
        curve = self.curve(moment)
        return np.array([curve.u[-1], curve.v[-1]])

    def _draw(self, moment: float, window: Window) -> tuple[Floats, Array, Array]:
        """Draw what the lens sees at a moment; centers (2, targets) and visible shares."""
        it = self.composition
        curve = self.curve(moment)
        body = _coverage([curve.outline(self.half)], window)
        shadow = cv2.GaussianBlur(np.roll(body, (14, 9), axis=(0, 1)), (0, 0), 9.0)
        picture = self.room[window.slices] * (1.0 - 0.45 * shadow)[:, :, None]
        picture += self._clamp(curve, window) * (118.0 * self.light[window.slices] - picture)
        skin = self._shading(curve, window)
        if it.polarity == 'bright':
            arm = 46.0 * skin[:, :, None] * np.array([1.05, 1.0, 0.97], np.float32)
            paint = np.array([216.0, 222.0, 224.0], np.float32)
        else:
            arm = 149.0 * skin[:, :, None] * np.array([0.93, 1.0, 1.02], np.float32)
            arm += 0.2 * self.through[window.slices]
            paint = np.array([44.0, 40.0, 42.0], np.float32)
        picture += body[:, :, None] * (arm - picture)
        hand = self._hand(moment)
        covered = _coverage(hand, window)
        centers = curve.at(it.spacing * np.arange(it.targets))
        visible = np.ones(it.targets)
        for target in range(it.targets):
            rows, columns, share = self._dot(target, centers[:, target], window)
            light = skin[rows, columns] / skin[rows, columns].mean()
            color = paint * (0.55 + 0.45 * light)[:, :, None]
            picture[rows, columns] += share[:, :, None] * (color - picture[rows, columns])
            seen = share * (1.0 - covered[rows, columns])
            visible[target] = seen.sum() / (math.pi * self.radii[target] ** 2)
        if hand:
            picture += covered[:, :, None] * (_skin(hand, covered, window) - picture)
        return cv2.GaussianBlur(picture, (0, 0), OPTICS), centers[:2], visible

    def _dot(self, target: int, center: Array, window: Window) -> tuple[slice, slice, Floats]:
        """Return which rows and columns of the window a dot is in, and its share of each pixel."""
        u, v, heading = center.tolist()
        radius = float(self.radii[target])
        reach = math.ceil(radius) + 2
        left, top, side = round(u) - reach, round(v) - reach, 2 * reach + 1
        parts = (np.arange(side * FINE) + 0.5) / FINE - 0.5
        across, down = left + parts - u, (top + parts - v)[:, None]
        inside = across**2 + down**2 <= radius**2
        if target == self.composition.targets - 1:
            inside &= across * math.cos(heading) + down * math.sin(heading) <= self.margin
        share = inside.reshape(side, FINE, side, FINE).mean(axis=(1, 3))
        left, top = left - window.left, top - window.top
        rows, columns = slice(top, top + side), slice(left, left + side)
        return rows, columns, share.astype(np.float32)

    def _shading(self, curve: Curve, window: Window) -> Floats:
        """Return how bright the body is: round across, uneven and ribbed along."""
        it = self.composition
        height, width = window.height // 2 + 1, window.width // 2 + 1  # smooth: every other pixel
        points = np.rint(0.5 * (np.column_stack([curve.u, curve.v]) - window.corner))
        points = np.clip(points, 0, [width - 1, height - 1]).astype(np.int64)
        line = np.full((height, width), 255, np.uint8)
        line[points[:, 1], points[:, 0]] = 0
        _, labels = cv2.distanceTransformWithLabels(
            line, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        station = np.zeros(labels.max() + 1, np.int64)
        station[labels[points[:, 1], points[:, 0]]] = np.arange(STATIONS)
        near = station[labels]
        rows, columns = np.mgrid[:height, :width]
        across = (2.0 * rows + window.top - curve.v[near]) * np.cos(curve.heading)[near]
        across -= (2.0 * columns + window.left - curve.u[near]) * np.sin(curve.heading)[near]
        across = np.clip(across / self.half, -1.2, 1.2)
        share = curve.s / self.length
        along = 1.0 + 0.22 * np.sin(4.0 * share + self.phases[0])
        along += 0.1 * np.sin(9.0 * share + self.phases[1])
        along *= 1.0 + 0.03 * np.sin(2.0 * math.pi * curve.s / (1.37 * it.spacing))
        small = (along[near] * (1.0 - 0.3 * across**2 - 0.05 * across)).astype(np.float32)
        # The small picture's pixel (i, j) is the window's (2 i, 2 j).
        places = np.mgrid[: window.height, : window.width].astype(np.float32) / 2.0
        return np.asarray(
            cv2.remap(cv2.GaussianBlur(small, (0, 0), 1.0), places[1], places[0], cv2.INTER_LINEAR)
        )

    def _clamp(self, curve: Curve, window: Window) -> Floats:
        """Return where the block is that holds the arm, (height, width, 1)."""
        u, v, heading = curve.at(np.array([-0.35 * self.composition.spacing]))[:, 0].tolist()
        along = np.array([math.cos(heading), math.sin(heading)])
        corners = np.array([[-40.0, -34.0], [0.0, -34.0], [0.0, 34.0], [-40.0, 34.0]])
        block = np.array([u, v]) + corners @ np.array([along, [-along[1], along[0]]])
        return _coverage([block], window)[:, :, None]

    def _hand(self, moment: float) -> list[Array]:
        """Return the outlines of palm and fingers, none where no hand is in the picture."""
        if 'hand' not in self.composition.disturbances:
            return []
        way = (moment - 12.0) / 38.0  # comes from beside the arm, reaches over it, and leaves
        near = math.sin(math.pi * min(max(way, 0.0), 1.0))
        place = self.curve(moment).at(np.array([(0.35 + 0.5 * way) * self.length]))[:, 0]
        side = np.array([0.3, self.up])
        palm = place[:2] + side * (330.0 - 215.0 * near)
        aim = math.atan2(-side[1], -side[0])
        parts = (
            (-160.0, 0.0, 260.0, 62.0, 0.0),
            (0.0, 0.0, 92.0, 78.0, 0.0),
            (74.0, -31.0, 100.0, 19.0, -0.14),
            (86.0, -11.0, 118.0, 20.0, -0.04),
            (84.0, 11.0, 112.0, 19.0, 0.05),
            (66.0, 32.0, 88.0, 17.0, 0.16),
            (22.0, 54.0, 78.0, 22.0, 0.75),
        )
        return [_capsule(palm, aim, *part) for part in parts]

    def _expose(self, picture: Floats, number: int) -> Bytes:
        """Return what the camera makes of it: flicker, noise, eight bits, compression."""
        it = self.composition
        left, top = np.random.default_rng([it.seed, number]).integers(0, 64, 2)
        if 'flicker' in it.disturbances:
            picture = picture * np.float32(1.0 + FLICKER * math.sin(2.4 * number + self.phases[2]))
        picture = picture + self.grain[top : top + HEIGHT, left : left + WIDTH]
        seen = np.clip(np.rint(picture), 0.0, 255.0).astype(np.uint8)
        if 'jpeg' not in it.disturbances:
            return seen
        _, packed = cv2.imencode('.jpg', seen, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)


def _integral(values: Array, places: Array) -> Array:
    """Return the integral from the first place on, by the trapezoidal rule."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(places)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _light(tilt: Array) -> Floats:
    """Return how light falls on the room: from one side, darker in the corners."""
    u, v = np.linspace(-1.0, 1.0, WIDTH), np.linspace(-1.0, 1.0, HEIGHT)[:, None]
    return np.asarray(0.92 + tilt[0] * u + tilt[1] * v - 0.08 * (u**2 + v**2), np.float32)


def _coverage(polygons: list[Array], window: Window) -> Floats:
    """Return which share of each pixel of a window polygons (n, 2) px cover."""
    white = np.zeros((COARSE * window.height, COARSE * window.width), np.uint8)
    for polygon in polygons:
        fine = np.rint(16.0 * (COARSE * (polygon - window.corner + 0.5) - 0.5)).astype(np.int32)
        cv2.fillPoly(white, [fine], 255, shift=4)
    size = (window.width, window.height)
    small = cv2.resize(white, size, interpolation=cv2.INTER_AREA)
    return small.astype(np.float32) / np.float32(255.0)


def _skin(hand: list[Array], covered: Floats, window: Window) -> Floats:
    """Return the color of the hand: skin with soft shade, and nails at the fingers' ends."""
    depth = cv2.GaussianBlur(covered, (0, 0), 7.0)[:, :, None]
    color = np.array([128.0, 158.0, 205.0], np.float32) * (0.62 + 0.42 * depth**2)
    shine = _coverage([_nail(finger) for finger in hand[2:6]], window)[:, :, None]
    nail = np.array([198.0, 208.0, 232.0], np.float32)
    return np.asarray(color + shine * (nail - color), np.float32)


def _capsule(
    palm: Array, aim: float, along: float, across: float, length: float, width: float, turn: float
) -> Array:
    """Return the outline of a bar with round ends whose middle is (along, across) of the palm."""
    turns = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 13)
    straight = 0.5 * (length - width)
    half = np.column_stack([straight + 0.5 * width * np.cos(turns), 0.5 * width * np.sin(turns)])
    own = np.concatenate([half, -half]) @ _turning(turn) + np.array([along, across])
    return np.asarray(palm + own @ _turning(aim))


def _nail(finger: Array) -> Array:
    """Return the outline of the nail near the end of a finger, given as `_capsule` does."""
    tip = finger[6]
    root = finger[len(finger) // 2 + 6]
    way = (root - tip) / math.hypot(*(root - tip))
    turns = np.linspace(0.0, 2.0 * math.pi, 25)[:-1]
    own = np.column_stack([7.0 * np.cos(turns), 5.0 * np.sin(turns)])
    return np.asarray(tip + 10.0 * way + own @ np.array([way, [-way[1], way[0]]]))


@functools.cache
def _turning(angle: float) -> Array:
    return np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
