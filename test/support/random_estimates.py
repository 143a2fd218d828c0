"""Estimates of random numbers and messages of both bindings, for tests of what is published."""

from __future__ import annotations

import array
import dataclasses
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import frozen_array
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.model.shape import Shape


def random_estimate(stations: int = 57, stamp_ns: int = 1_500_000_007, seed: int = 1):
    """Return an estimate in which no two numbers are equal."""
    random = np.random.default_rng(seed)

    def numbers(*shape):
        return frozen_array(random.normal(size=shape))

    shape = Shape(
        arclength=numbers(stations),
        x=numbers(stations),
        y=numbers(stations),
        theta=numbers(stations),
        curvature=numbers(stations),
        intrinsic_curvature=numbers(stations),
        moment=numbers(stations),
        force=(0.175, 0.07),
        end_moment=0.0,
        pressure=31e3,
        converged=True,
        status='converged',
        residual=1e-12,
        iterations=3,
        stable=True,
        extrapolated=False,
        solution=None,
    )
    return ShapeEstimate(
        stamp_ns=stamp_ns,
        shape=shape,
        chamber_pressure=31e3,
        jacobian=numbers(3, 4),
        tip_covariance=numbers(3, 3),
        std_x=numbers(stations),
        std_y=numbers(stations),
        std_curvature=numbers(stations),
        wrench_age=0.01,
        warnings=(),
    )


class RclpyTypes:
    """The message classes of rclpy, as a node has them."""

    def __call__(self, type_name: str, /):
        return rclpy_class(type_name)

    def sequence(self, values: Any, /):
        return array.array(values.dtype.char, values.tobytes())


@cache
def rclpy_class(type_name: str):
    """Return the class of a type, imported when it is asked for."""
    package, _, name = type_name.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def plain(message: Any) -> Any:
    """Return a message of either binding as nested dicts, lists and numbers, to compare by ==."""
    if hasattr(message, 'get_fields_and_field_types'):
        return {
            name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()
        }
    if dataclasses.is_dataclass(message):
        # rosbags' constants look like fields, too.
        fields = [field for field in dataclasses.fields(message) if 'ClassVar' not in field.type]
        return {field.name: plain(getattr(message, field.name)) for field in fields}
    if isinstance(message, np.ndarray | array.array):
        return message.tolist()
    if isinstance(message, list | tuple):
        return [plain(entry) for entry in message]
    return message
