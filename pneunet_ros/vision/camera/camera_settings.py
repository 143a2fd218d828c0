"""Camera and appearance of targets: the content of camera.yaml."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
import math
from typing import Any, ClassVar

from pneunet_ros.core.arrays import Array, table_array
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.image import lab_color
from pneunet_ros.core.units import check_quantities, quantity

BRIGHT, DARK, AUTO = 'bright', 'dark', 'auto'
POLARITIES = (AUTO, BRIGHT, DARK)
LEAST_CHROMA = 20.0  # of a color, in L*a*b* of 8 bits: below it a print looks grey to most people
UNIT = 0.01  # a quaternion this near to unit length was rounded and is normalized


def finite_numbers(values: Any, where: str, count: int) -> tuple[float, ...]:
    """Return this many finite numbers; CameraError, which names the place, for anything else."""
    numbers = table_array(values, where, 1, CameraError)
    if numbers.size != count:
        raise CameraError(
            f'{where} must be {count} numbers, not {numbers.size}', reason='wrong_shape'
        )
    return tuple(numbers.tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class RestPlane:
    """Scale and base frame from the first and last target of the straight arm (as in the paper).

    The camera looks along -z of the base frame at the working plane.
    """

    method: ClassVar[str] = 'rest'


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvedRestPlane:
    """Scale and base frame from the arm at rest, if it is bent even at rest.

    The scale is the arclength between the targets, x points along the arm at the clamp. The camera
    looks along -z of the base frame at the working plane.
    """

    method: ClassVar[str] = 'curved_rest'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HomographyPlane:
    """The working plane from known points: pixels (n, 2), points (n, 2) m in base.

    Pixels are those of the raw image, with the distortion of the lens.
    """

    method: ClassVar[str] = 'homography'
    pixels: Array
    points: Array

    def __post_init__(self) -> None:
        """Check that there are at least four points, and equally many in image and plane."""
        pixels = table_array(self.pixels, 'plane.pixels', 2, CameraError)
        points = table_array(self.points, 'plane.points', 2, CameraError)
        if pixels.shape != points.shape or pixels.shape[1:] != (2,):
            raise CameraError(
                'plane.pixels and plane.points must be lists with the same number of pairs, not '
                f'{_size(pixels)} and {_size(points)} numbers',
                reason='wrong_shape',
            )
        if len(pixels) < 4:
            raise CameraError(
                f'plane.pixels needs at least four points, not {len(pixels)}', reason='too_few'
            )
        object.__setattr__(self, 'pixels', pixels)
        object.__setattr__(self, 'points', points)


def _size(array: Array) -> str:
    return ' x '.join(map(str, array.shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePlane:
    """The pose of the camera's optical frame in the base frame (base_from_camera).

    position: x, y, z in m; quaternion: x, y, z, w, of unit length. The optical frame has z
    forward, x to the right and y down in the image.
    """

    method: ClassVar[str] = 'pose'
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        """Check the numbers; normalize a rounded quaternion."""
        position = finite_numbers(self.position, 'plane.position', 3)
        quaternion = finite_numbers(self.quaternion, 'plane.quaternion', 4)
        length = math.hypot(*quaternion)
        if not abs(length - 1.0) <= UNIT:
            raise CameraError(
                f'plane.quaternion (x, y, z, w) must have length 1, not {length:.6g}',
                reason='no_direction',
            )
        quaternion = tuple(value / length for value in quaternion)
        object.__setattr__(self, 'position', position)
        object.__setattr__(self, 'quaternion', quaternion)


PlaneMethod = RestPlane | CurvedRestPlane | HomographyPlane | PosePlane


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedBand:
    """Targets are areas within these grey levels."""

    method: ClassVar[str] = 'fixed'
    low: float = quantity(
        150.0, unit='grey level', meaning='darkest that a target is', bounds=(1.0, 255.0)
    )
    high: float = quantity(
        255.0, unit='grey level', meaning='brightest that a target is', bounds=(1.0, 255.0)
    )

    def __post_init__(self) -> None:
        """Check the band."""
        check_quantities(self, 'grey_band', CameraError)
        if not self.low < self.high:
            raise CameraError(
                f'grey_band.low = {self.low} must be below high = {self.high}',
                reason='wrong_order',
            )

    def inverted(self) -> FixedBand:
        """Return the band of the same pixels in an inverted image."""
        return FixedBand(low=max(255.0 - self.high, 1.0), high=max(255.0 - self.low, 1.5))


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptiveBand:
    """Targets differ from their surroundings by a contrast, in any light."""

    method: ClassVar[str] = 'adaptive'
    contrast: float = quantity(
        30.0, unit='grey level', meaning='from the surroundings, at least', bounds=(2.0, 255.0)
    )

    def __post_init__(self) -> None:
        """Check the contrast."""
        check_quantities(self, 'grey_band', CameraError)

    def inverted(self) -> AdaptiveBand:
        """Return this band: contrast does not change in an inverted image."""
        return self


GreyBand = FixedBand | AdaptiveBand


@dataclass(frozen=True, slots=True, kw_only=True)
class AreaLimits:
    """Criteria for areas that can be targets."""

    smallest: float = quantity(
        12.0, unit='px^2', meaning='areas below are dropped', bounds=(4.0, 1e6)
    )
    largest: float = quantity(
        4000.0, unit='px^2', meaning='areas above are dropped', bounds=(4.0, 1e6)
    )
    elongation: float = quantity(
        2.5, unit='-', meaning='largest axis over smallest, at most', bounds=(1.0, 20.0)
    )
    hole: float = quantity(
        20.0, unit='px^2', meaning='an area with a larger hole is no target', bounds=(0.0, 1e5)
    )

    def __post_init__(self) -> None:
        """Check the limits."""
        check_quantities(self, 'area', CameraError)
        if not self.smallest < self.largest:
            raise CameraError(
                f'area.smallest = {self.smallest} must be below largest = {self.largest}',
                reason='wrong_order',
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Shutter:
    """Exposure times of the rows of an image, relative to its stamp."""

    readout: float = quantity(
        0.0,
        unit='s',
        meaning='from the exposure of the first row to that of the last; 0: all at once',
        bounds=(-0.1, 0.1),
    )
    exposure: float = quantity(
        0.0,
        unit='s',
        meaning='the shutter is open, from the stamp on; 0: the stamp is amid the exposure',
        bounds=(0.0, 0.1),
    )

    def __post_init__(self) -> None:
        """Check the times."""
        check_quantities(self, 'shutter', CameraError)

    @property
    def is_at_stamp(self) -> bool:
        """Whether all rows of the image are exposed at its stamp."""
        return self.readout == 0.0 and self.exposure == 0.0

    @property
    def least_interval(self) -> float:
        """Shortest time between two images, s: the larger of readout and exposure."""
        return max(abs(self.readout), self.exposure)

    def seconds_after_stamp(self, v: Array, height: int) -> Array:
        """Return the mid-exposure times of rows v (n,) px, s after the stamp.

        The stamp is the time of the first exposed row, which is the last row if readout is
        negative.
        """
        first = min(self.readout, 0.0)
        after: Array = 0.5 * self.exposure + self.readout * v / max(height - 1, 1) - first
        return after


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSettings:
    """Content of `config/camera.yaml`: the working plane, and the appearance of targets.

    plane: mapping of pixels to the base frame; polarity: whether targets are bright on a dark arm,
    dark on a pale one, or either (auto); dot_color: red, green and blue, 0 to 255, of targets
    distinguished by color, None: by brightness; grey_band, area: criteria for pixels and areas of
    targets; shutter: exposure times of rows; clamp_pixel: approximate position (u, v) px of the
    target next to the clamp; None: the clamp is at the left end of the row of targets. Raises
    CameraError for values outside their bounds.
    """

    plane: PlaneMethod = field(default_factory=RestPlane)
    clamp_pixel: tuple[float, float] | None = None
    rest_frames: int = dataclasses.field(
        default=5, metadata={'meaning': 'frames of the arm at rest that are averaged'}
    )
    rest_straightness: float = quantity(
        0.02,
        unit='-',
        meaning='largest distance of a target from the line, of its length, at rest',
        bounds=(1e-4, 0.2),
    )
    polarity: str = dataclasses.field(
        default=AUTO, metadata={'meaning': 'bright or dark targets, or whichever show a row'}
    )
    dot_color: tuple[float, float, float] | None = None
    grey_band: GreyBand = field(default_factory=AdaptiveBand)
    area: AreaLimits = field(default_factory=AreaLimits)
    shutter: Shutter = field(default_factory=Shutter)
    gate: float = quantity(
        0.4,
        unit='-',
        meaning='largest jump of a target between frames, of the spacing of targets',
        bounds=(0.05, 2.0),
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, '', CameraError)
        if self.clamp_pixel is not None:
            clamp_pixel = finite_numbers(self.clamp_pixel, 'clamp_pixel', 2)
            object.__setattr__(self, 'clamp_pixel', clamp_pixel)
        if self.dot_color is not None:
            color = finite_numbers(self.dot_color, 'dot_color', 3)
            if not all(0.0 <= value <= 255.0 for value in color):
                raise CameraError(
                    f'dot_color = {list(color)} must be red, green and blue, each 0 to 255',
                    reason='wrong_shape',
                )
            if lab_color((color[0], color[1], color[2]))[1] < LEAST_CHROMA:
                raise CameraError(
                    f'dot_color = {list(color)} is a shade of grey: remove it, and set polarity '
                    'instead',
                    reason='not_a_color',
                )
            object.__setattr__(self, 'dot_color', color)
        if self.polarity not in POLARITIES:
            raise CameraError(
                f'polarity must be one of {", ".join(POLARITIES)}, not {self.polarity!r}',
                reason='unknown_kind',
            )
        if isinstance(self.rest_frames, bool) or not isinstance(self.rest_frames, int):
            raise CameraError(
                f'rest_frames must be an integer, not {self.rest_frames!r}', reason='not_a_number'
            )
        if not 1 <= self.rest_frames <= 1000:
            raise CameraError(
                f'rest_frames = {self.rest_frames} is not within [1, 1000]', reason='out_of_bounds'
            )
