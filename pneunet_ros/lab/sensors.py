"""The sensors of the virtual lab and their noise.

Every kind of noise has its own random stream, so that one can be changed without the others.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
import zlib

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, NANOSECONDS_PER_SECOND, quantity
import scipy

DRIFT_KNOTS = 9  # of the random walk of the drift
OCCLUSION = 0.3, 1.2  # s, shortest and longest
HIDDEN = 2, 5  # targets, fewest and most, by one occlusion
START = 1_750_000_000  # s, stamp at which the time of a lab begins
_SIZE = (0.0, 1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabNoise:
    """Standard deviations of all measurement errors, SI."""

    pressure_std: float = quantity(
        60.0, unit='Pa', meaning='white noise of a reading', bounds=_SIZE
    )
    force_std: float = quantity(
        1e-3, unit='N', meaning='white noise of each component', bounds=_SIZE
    )
    moment_std: float = quantity(
        1e-5, unit='N m', meaning='white noise of a reading', bounds=_SIZE
    )
    target_std: float = quantity(
        5e-5, unit='m', meaning='white noise of each coordinate', bounds=_SIZE
    )
    placement_std: float = quantity(
        5e-5, unit='m', meaning='constant position error of each target on the arm', bounds=_SIZE
    )
    row_offset: float = quantity(
        0.0, unit='m', meaning='offset of all targets from the neutral line'
    )
    row_spacing: float = quantity(
        0.0, unit='-', meaning='relative error of the spacing of all targets'
    )
    registration_std: float = quantity(
        1e-4, unit='m', meaning='position of the camera, per recording', bounds=_SIZE
    )
    drift_std: float = quantity(
        5e-5, unit='m', meaning='drift of the camera at the end of a recording', bounds=_SIZE
    )
    imu_std: float = quantity(
        0.02,
        unit='m/s^2',
        meaning=('white noise of each component of the accelerometer'),
        bounds=_SIZE,
    )
    gyro_std: float = quantity(
        0.002,
        unit='rad/s',
        meaning='white noise of the angular velocity of the base',
        source='BMI088: 0.014 deg/s per square root of Hz, 60 Hz',
        bounds=_SIZE,
    )
    jitter_std: float = quantity(5e-4, unit='s', meaning='jitter of stamps', bounds=(0.0, 1.0))
    dropout: float = quantity(
        0.003, unit='-', meaning='share of targets that are not seen', bounds=(0.0, 0.9)
    )
    occlusions: float = quantity(
        0.05, unit='1/s', meaning='how often an occluder hides targets', bounds=(0.0, 100.0)
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, 'noise', RequestError)


def noiseless() -> LabNoise:
    """Return sensors without noise."""
    return LabNoise(**{item.name: 0.0 for item in fields(LabNoise)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """Rates of the sensors (Hz)."""

    pressure: float = quantity(50.0, unit='Hz', bounds=(0.1, 1e4))
    wrench: float = quantity(50.0, unit='Hz', bounds=(0.1, 1e4))
    frames: float = quantity(10.0, unit='Hz', bounds=(0.1, 1e4))
    imu: float = quantity(0.0, unit='Hz', meaning='0: no such sensor', bounds=(0.0, 1e4))

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, 'rates', RequestError)


def random_stream(name: str, *seeds: int) -> np.random.Generator:
    """Return the random numbers for this name and these seeds."""
    return np.random.default_rng([zlib.crc32(name.encode()), *seeds])


def regular_times(rate: float, duration: float, offset: float = 0.0) -> Array:
    """Return the times (s) of sensor readings, the first after `offset` periods."""
    count = int(np.floor(rate * duration + 1e-9))
    if not count:
        return freeze(np.zeros(0))
    return freeze((np.arange(count, dtype=np.float64) + offset) / rate)


def draw_stamps(
    random: np.random.Generator, time: Array, start: float, noise: LabNoise
) -> npt.NDArray[np.int64]:
    """Return stamps (ns) of readings at times (s) after `start`, with jitter."""
    period = float(np.min(np.diff(time))) if time.size > 1 else 1.0
    late = np.clip(noise.jitter_std * random.standard_normal(time.size), -period / 3, period / 3)
    since = (start + time + late) * NANOSECONDS_PER_SECOND
    result: npt.NDArray[np.int64] = START * NANOSECONDS_PER_SECOND + np.rint(since).astype(
        np.int64
    )
    return result


def draw_placement(random: np.random.Generator, places: Array, noise: LabNoise) -> Array:
    """Return placement errors (targets, 2) m of targets at places (targets,) m.

    Errors along and across the arm: an independent error of each target, plus the error of the
    whole row.
    """
    row = np.column_stack([noise.row_spacing * places, np.full(places.size, noise.row_offset)])
    return freeze(row + noise.placement_std * random.standard_normal((places.size, 2)))


def draw_drift(
    random: np.random.Generator, time: Array, duration: float, noise: LabNoise
) -> Array:
    """Return the drift of the camera (n, 2) m: smooth, from zero to drift_std."""
    steps = random.standard_normal((DRIFT_KNOTS - 1, 2)) / np.sqrt(DRIFT_KNOTS - 1)
    walk = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    knots = np.linspace(0.0, duration, DRIFT_KNOTS)
    return freeze(
        noise.drift_std * np.asarray(scipy.interpolate.PchipInterpolator(knots, walk)(time))
    )


def draw_hidden(
    random: np.random.Generator, time: Array, duration: float, targets: int, noise: LabNoise
) -> npt.NDArray[np.bool_]:
    """Return a mask of hidden targets, (frames, targets)."""
    missing: npt.NDArray[np.bool_] = random.uniform(size=(time.size, targets)) < noise.dropout
    for _ in range(int(random.poisson(noise.occlusions * duration))):
        start, length = random.uniform(0.0, duration), random.uniform(*OCCLUSION)
        first, count = random.integers(targets), random.integers(HIDDEN[0], HIDDEN[1] + 1)
        frames = (time >= start) & (time < start + length)
        missing[frames, first : first + count] = True
    return missing
