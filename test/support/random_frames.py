"""What a tracker claims of random frames, and pictures in files, for tests of messages."""

from __future__ import annotations

import cv2
import numpy as np
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import Tracking

TARGETS = 23


def random_sightings(missing=(), stamp_ns=1_500_000_007, seed=1):
    """Return sightings in which no two numbers are equal, and NaN where one is missing."""
    random = np.random.default_rng(seed)
    names = ('x', 'y', 'std', 'u', 'v', 'area', 'major', 'minor', 'angle')
    values = {name: random.uniform(1.0, 2.0, TARGETS) for name in names}
    for numbers in values.values():
        numbers[list(missing)] = np.nan
    return TargetSightings(stamp_ns=stamp_ns, **values)


def random_curve(stations=9, stamp_ns=1_500_000_007, seed=2):
    """Return a curve in which no two numbers are equal."""
    random = np.random.default_rng(seed)
    names = ('arclength', 'x', 'y', 'theta', 'curvature', 'std_curvature')
    values = {name: random.normal(size=stations) for name in names}
    return MeasuredCurve(stamp_ns=stamp_ns, rms=1e-5, **values)


def random_tracking(missing=(), **options):
    """Return an explained frame."""
    return Tracking(
        sightings=random_sightings(missing, **options),
        curve=random_curve(),
        reason='',
        sentence='',
    )


def soft_picture(width=64, height=48, seed=0):
    """Return grey levels that a jpeg can hold well."""
    random = np.random.default_rng(seed)
    noise = random.integers(0, 256, (height, width), np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 3.0)


def compressed(picture, kind='.jpg', *flags):
    """Return a picture as the bytes of a file."""
    done, data = cv2.imencode(kind, picture, flags)
    assert done
    return data.tobytes()
