"""The domain of a model: the pressures and end loads spanned by its calibration.

Inside the domain, the covariance of the model covers its errors. Slightly outside, the model is
extrapolated, with a warning; further out, there is no estimate. `locate_load` is the only place
that decides this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze, table_array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.units import kilopascals
from pneunet_ros.solver.branches.convex_hull import way_from_hull

MOST_LOADS = 64  # rows of `domain.end_load`: each takes time at every reading
FAR = 1e6  # sizes of a hull, or newtons; larger distances are not distinguished
ROUNDING = 1e-9  # of a load: rounding of a distance of zero
MOMENT, PRESSURE = 2, 3  # columns of `domain.end_load`, after F1 and F2
THINNING = 0.01  # of the size of the hull; loads nearer to it than this are omitted in the file
WRITTEN_LOADS = 32  # rows of `domain.end_load` that calibration writes: half of MOST_LOADS


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainSettings:
    """Thresholds of the domain: inside, extrapolated, or outside."""

    pressure_margin: float = tuning(
        0.05,
        'largest pressure beyond the range for which the model is extrapolated',
        unit='of the range',
        source='sweep',
    )
    load_margin: float = tuning(
        0.5,
        'largest load beyond the hull for which the model is extrapolated',
        unit='of the size of the hull',
        source='sweep',
    )
    pressure_noise: float = tuning(
        8.0,
        'largest pressure beyond the range that noise explains',
        unit='pressure_std',
        source='sweep',
    )
    significant: float = tuning(
        4.0,
        'largest deviation that noise explains: of a load beyond the hull, of readings from a '
        'line, of residuals that an effect removes',
        unit='sigma',
        source='sweep',
    )
    stretch: float = tuning(
        1.3, 'largest distance of two places on the arm, relative to that along it', source='sweep'
    )
    load_error: float = tuning(
        0.2,
        "one sigma of the model's own error beyond the hull, as a force in any direction",
        unit='of the force beyond it',
        source='measured: acceptance/load_domain.py',
    )
    pressure_error: float = tuning(
        0.3,
        "one sigma of the model's own error beyond the range, as a pressure",
        unit='of the pressure beyond it',
        source='sweep',
    )


DOMAIN = DomainSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Domain:
    """The range of a calibration.

    pressure: lowest and highest, Pa gauge; end_load (loads, 4): F1, F2 (N), M (N m), p (Pa), the
    vertices of the convex hull of the loads seen, or the corners of a box. The unloaded arm is
    always inside, at every pressure, because kappa_p0 describes it. largest_force (N),
    largest_end_moment (N m): the largest in the calibration.
    """

    pressure: tuple[float, float]
    end_load: Array
    largest_force: float = field(init=False, repr=False)
    largest_end_moment: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check numbers and shapes."""
        pressure = table_array(self.pressure, 'domain.pressure', 1)
        if pressure.size != 2 or not pressure[0] <= pressure[1]:
            raise ModelError(
                'domain.pressure must be two numbers, the lowest and the highest pressure in Pa',
                reason='wrong_shape',
            )
        loads = table_array(self.end_load, 'domain.end_load', 2)
        if loads.shape[1] != 4 or not 1 <= len(loads) <= MOST_LOADS:
            raise ModelError(
                f'domain.end_load must be 1 to {MOST_LOADS} rows of F1 (N), F2 (N), M (N m) and '
                f'p (Pa), not {loads.shape[0]} of {loads.shape[1]} numbers',
                reason='wrong_shape',
            )
        low, high = pressure.tolist()
        if not np.all((loads[:, PRESSURE] >= low) & (loads[:, PRESSURE] <= high)):
            raise ModelError(
                f'domain.end_load has a pressure outside domain.pressure, {low:g} to {high:g} Pa',
                reason='out_of_bounds',
            )
        object.__setattr__(self, 'pressure', (low, high))
        object.__setattr__(self, 'end_load', loads)
        forces, moments = np.hypot(*loads[:, :MOMENT].T), np.abs(loads[:, MOMENT])
        object.__setattr__(self, 'largest_force', float(forces.max()))
        object.__setattr__(self, 'largest_end_moment', float(moments.max()))

    @property
    def unloaded(self) -> Array:
        """The loads (2, 4) of the unloaded arm at the lowest and the highest pressure."""
        return unloaded(self.pressure)

    @property
    def words(self) -> str:
        """Return the calibrated range as text for the user."""
        low, high = (kilopascals(value) for value in self.pressure)
        force, moment = self.largest_force, 1000.0 * self.largest_end_moment
        loads = [f'end forces up to {force:.3g} N'] * (force > 0.0)
        loads += [f'end moments up to {moment:.3g} mN m'] * (moment > 0.0)
        return f'{low:.4g} to {high:.4g} kPa, {" and ".join(loads) or "no end load"}'

    def largest_moment(self, length: float) -> float:
        """Return the largest moment (N m) in an arm of a length (m) under the calibrated loads."""
        return max(self.largest_end_moment, length * self.largest_force)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadHull:
    """The convex hull of the loads of a domain, in newtons in all directions.

    scale (4,) converts F1, F2, M and p to newtons: a moment is converted to the force that
    produces it at the length of the arm, and the whole range of pressure to the largest load.
    points (n, 4) N; size: the largest load, N.
    """

    scale: Array
    points: Array
    size: float

    def way_out(self, at: Array) -> Array:
        """Return the vector (4,) N from the nearest point of the hull to a scaled load (4,) N.

        Zero inside the hull, except for rounding.
        """
        way = np.empty(4)
        way_from_hull(self.points, at, way)
        return way

    def distance(self, load: Sequence[float] | Array, noise: Sequence[float] | Array) -> float:
        """Return the distance (N) of a load (4,) from the hull, minus its noise (4,), SI."""
        return float(
            distance_beyond(
                self.points,
                self.scale,
                self.size,
                np.array(load, np.float64),
                np.array(noise, np.float64),
            )
        )

    def share(self, distance: float) -> float:
        """Return a distance (N) relative to the size of the hull."""
        if distance == 0.0:
            return 0.0
        return distance / self.size if self.size > 0.0 else math.inf


@kernel
def distance_beyond(points: Array, scale: Array, size: float, load: Array, noise: Array) -> float:
    """Compute `LoadHull.distance` from its points, scale and size."""
    outer_limit = FAR * max(size, 1.0)
    at, way = np.empty(load.size), np.empty(load.size)
    for i in range(load.size):
        at[i] = min(max(load[i] * scale[i], -outer_limit), outer_limit)
    way_from_hull(points, at, way)
    largest, distance, along = 0.0, 0.0, 0.0
    for i in range(load.size):
        largest = max(largest, abs(at[i]))
        distance += way[i] ** 2  # zero where a square is too small for a number
        along += (way[i] * noise[i] * scale[i]) ** 2
    distance = math.sqrt(distance)
    if distance <= ROUNDING * largest:
        return 0.0
    return max(distance - math.sqrt(along) / distance, 0.0)


def load_hull(end_load: Array, pressure: tuple[float, float], length: float) -> LoadHull:
    """Return the hull of loads (n, 4) and of the unloaded arm; length (m) of the arm."""
    low, high = pressure
    scale = np.array([1.0, 1.0, 1.0 / length, 0.0])
    size = float(np.max(np.linalg.norm(end_load * scale, axis=1)))
    if high > low:
        scale[PRESSURE] = size / (high - low)
    points = np.unique(np.vstack([unloaded(pressure), end_load]) * scale, axis=0)
    return LoadHull(scale=freeze(scale), points=freeze(points), size=size)


def spanned_domain(end_load: Array, length: float, span: tuple[float, float]) -> Domain:
    """Return the domain spanned by the given loads, with few vertices.

    end_load (frames, 4): F1, F2, M, p, SI; length (m) of the arm; span (Pa): the range of its
    tables. Greedy selection: the load furthest from the hull of the selected loads is added next,
    until all others are within `THINNING` of the hull. Numbers are rounded to six digits.
    """
    loads = np.array(end_load)
    loads[:, PRESSURE] = np.clip(loads[:, PRESSURE], *span)
    loads = np.array([[float(f'{value:.6g}') for value in load] for load in loads.tolist()])
    pressure = float(loads[:, PRESSURE].min()), float(loads[:, PRESSURE].max())
    hull = load_hull(loads, pressure, length)
    scaled, near = loads * hull.scale, THINNING * hull.size
    hull = replace(hull, points=freeze(hull.scale * unloaded(pressure)))
    distance, taken = np.linalg.norm(scaled[:, :PRESSURE], axis=1), list[int]()
    while len(taken) < WRITTEN_LOADS:
        furthest = int(np.argmax(distance))
        if distance[furthest] <= near:
            break
        # The distance may be smaller now, because the hull has grown since.
        distance[furthest] = np.linalg.norm(hull.way_out(scaled[furthest]))
        if distance[furthest] == distance.max():
            taken.append(furthest)
            hull = replace(hull, points=freeze(np.vstack([hull.points, scaled[furthest]])))
            distance[furthest] = 0.0
    return Domain(pressure=pressure, end_load=loads[taken or [0]])


def unloaded(pressure: tuple[float, float]) -> Array:
    """Return the loads (2, 4) of the unloaded arm at the lowest and the highest pressure (Pa)."""
    low, high = pressure
    return np.array([[0.0, 0.0, 0.0, low], [0.0, 0.0, 0.0, high]])
