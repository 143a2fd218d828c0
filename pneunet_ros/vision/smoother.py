"""From targets to the centerline: a smooth curve and its curvature (Eq 1), with uncertainty.

A Gaussian process whose prior was learnt once. What has to be done for a frame depends on which
targets were seen, not on where: it is worked out once for each set of targets and kept.

How exact the targets are is not taken from `sensors.target_std`, which is one number for all
cameras: the sightings say how exactly each was seen, and where the residuals of a frame show more
than that (dots painted beside their place), the noise is what explains them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
import functools
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import CameraError, RequestError
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import DEFAULT_STATIONS, station_arclength
from pneunet_ros.vision.curvature_prior import (
    CurvaturePrior,
    learned_priors,
    once_integrated,
    twice_integrated,
    without_line,
)
from pneunet_ros.vision.smoother_kernels import smooth_targets

FEWEST_TARGETS = 4
KEPT_OPERATORS = 256
LEAST_STD = 1e-5  # of the length: noise below this is not believed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredCurve:
    """The measured centerline at stations between the first and the last seen target.

    All arrays have one entry per station: material arclength (m), x and y (m, base frame), theta
    (rad, continuous, from (-pi, pi] at the first station), curvature of the curve as Eq 1 gives it
    (1/m, per length as it is, stretched) and its standard deviation (1/m). `rms` (m) is the root
    mean square distance of the seen targets from the curve, per coordinate, before the curve was
    shifted to pass the first target's place.
    """

    stamp_ns: int
    arclength: Array
    x: Array
    y: Array
    theta: Array
    curvature: Array
    std_curvature: Array
    rms: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothingOperator:
    """What smoothing needs to know for one set of seen targets; see `smooth_targets`.

    seen (n,) indices of targets; distances (n - 1,) m along the arm between them; slope (n,) of
    the straight line through the straightened arm. For each prior: modes (priors, n, n - 2) of
    that line, independent with mode_variances (priors, n - 2) m^2; theta_rows, curvature_rows
    (priors, n - 2, points) and prior_variance (priors, points) 1/m^2 at points (m): stations and
    targets, of which target_points and station_points are the indices. arclength (stations,) m.
    """

    seen: npt.NDArray[np.int64]
    distances: Array
    slope: Array
    modes: Array
    mode_variances: Array
    theta_rows: Array
    curvature_rows: Array
    prior_variance: Array
    points: Array
    target_points: npt.NDArray[np.int64]
    station_points: npt.NDArray[np.int64]
    arclength: Array

    def __post_init__(self) -> None:
        """Make all arrays read-only: they are kept, and used for many frames."""
        for item in fields(self):
            getattr(self, item.name).flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoother:
    """Smooths the targets at target_arclength (targets,) m into a curve at stations (m).

    `placement_std` (m) is how exactly targets were painted; how exactly they were seen is said by
    the sightings. More than both together is found in the residuals of a frame.
    """

    target_arclength: Array
    stations: Array
    priors: tuple[CurvaturePrior, ...]
    length: float
    placement_std: float = 0.0
    operator: Callable[[bytes], SmoothingOperator | None] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the targets and prepare what all sets of seen targets have in common."""
        targets = frozen_array(self.target_arclength)
        if targets.ndim != 1 or targets.size < FEWEST_TARGETS:
            raise CameraError(
                f'a centerline is measured from at least {FEWEST_TARGETS} targets; '
                f'arm.target_arclength of the model file names {targets.size}'
            )
        object.__setattr__(self, 'target_arclength', targets)
        object.__setattr__(self, 'stations', frozen_array(self.stations))
        points = np.unique(np.concatenate([targets, self.stations]))
        covariances = tuple(Covariances.between(prior, targets, points) for prior in self.priors)
        make = functools.partial(operator_for, covariances, targets, self.stations)
        object.__setattr__(self, 'operator', functools.lru_cache(KEPT_OPERATORS)(make))

    def smooth(self, sightings: TargetSightings) -> MeasuredCurve | None:
        """Return the curve through the seen targets; None when they are too few for one.

        Also None where two neighboring targets are said to be at one place. Raises RequestError
        for sightings of another number of targets.
        """
        if sightings.x.size != self.target_arclength.size:
            raise RequestError(
                f'the arm has {self.target_arclength.size} targets, '
                f'the sightings are of {sightings.x.size}'
            )
        seen = np.isfinite(sightings.x + sightings.y)
        operator = self.operator(seen.tobytes())
        if operator is None:
            return None
        least = math.hypot(LEAST_STD * self.length, self.placement_std)
        origin = float(self.target_arclength[0]) if seen[0] else math.nan
        out = np.empty((5, operator.arclength.size))
        rms = smooth_targets(
            sightings.x, sightings.y, sightings.std, operator.seen, operator.distances,
            operator.slope, operator.modes, operator.mode_variances, operator.theta_rows,
            operator.curvature_rows, operator.prior_variance, operator.points,
            operator.target_points, operator.station_points, least, origin, out,
        )  # fmt: skip
        if not math.isfinite(rms):
            return None
        freeze(out)
        return MeasuredCurve(
            stamp_ns=sightings.stamp_ns,
            arclength=operator.arclength,
            x=out[0],
            y=out[1],
            theta=out[2],
            curvature=out[3],
            std_curvature=out[4],
            rms=rms,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariances:
    """Prior covariances of the straightened arm: its line at targets, line with slope, curvature.

    points (points,) m; line (targets, targets) m^2; theta (points, targets) m; curvature
    (points, targets) dimensionless; variance (points,) 1/m^2 of curvature itself.
    """

    points: Array
    line: Array
    theta: Array
    curvature: Array
    variance: Array

    @staticmethod
    def between(prior: CurvaturePrior, targets: Array, points: Array) -> Covariances:
        """Integrate the covariance of curvature."""
        nodes, weights = prior.nodes(points)
        at_targets = twice_integrated(targets, nodes, weights)
        with_targets = prior.covariance(nodes, nodes) @ at_targets.T
        return Covariances(
            points=points,
            line=at_targets @ with_targets,
            theta=once_integrated(points, nodes, weights) @ with_targets,
            curvature=prior.covariance(points, nodes) @ at_targets.T,
            variance=np.diagonal(prior.covariance(points, points)).copy(),
        )


def operator_for(
    covariances: tuple[Covariances, ...], targets: Array, stations: Array, seen_bytes: bytes
) -> SmoothingOperator | None:
    """Return the operator for targets seen, (targets,) bool as bytes; None for too few."""
    seen = np.flatnonzero(np.frombuffer(seen_bytes, dtype=np.bool_))
    if seen.size < FEWEST_TARGETS:
        return None
    places = targets[seen]
    arclength = stations[(stations >= places[0]) & (stations <= places[-1])]
    if not arclength.size:
        return None
    points = np.unique(np.concatenate([places, arclength]))
    rows = np.searchsorted(covariances[0].points, points)
    line = np.stack([of.line[np.ix_(seen, seen)] for of in covariances])
    line_free = without_line(places)
    variances, turned = np.linalg.eigh(line_free.T @ line @ line_free)
    modes = line_free @ turned
    away = places - places.mean()
    slope = away / (away @ away)
    theta = np.stack([of.theta[np.ix_(rows, seen)] for of in covariances])
    curvature = np.stack([of.curvature[np.ix_(rows, seen)] for of in covariances])
    return SmoothingOperator(
        seen=seen.astype(np.int64),
        distances=np.diff(places),
        slope=slope,
        modes=modes,
        mode_variances=np.maximum(variances, 0.0),
        theta_rows=transposed((theta - (slope @ line)[:, None]) @ modes),
        curvature_rows=transposed(curvature @ modes),
        prior_variance=np.stack([of.variance[rows] for of in covariances]),
        points=points,
        target_points=np.searchsorted(points, places).astype(np.int64),
        station_points=np.searchsorted(points, arclength).astype(np.int64),
        arclength=frozen_array(arclength),
    )


def transposed(rows: Array) -> Array:
    """Return matrices with rows and columns exchanged, also in memory: loops run along points."""
    return np.ascontiguousarray(rows.transpose(0, 2, 1))


def smoother_for(arm: Arm, stations: int = DEFAULT_STATIONS) -> Smoother:
    """Return the smoother of this arm, at so many equally spaced stations; learns its prior.

    Raises CameraError when the model file names too few targets.
    """
    if arm.target_arclength.size < FEWEST_TARGETS:
        raise CameraError(
            f'a centerline is measured from at least {FEWEST_TARGETS} targets; '
            f'arm.target_arclength of the model file names {arm.target_arclength.size}'
        )
    return Smoother(
        target_arclength=arm.target_arclength,
        stations=station_arclength(arm.length, stations),
        priors=learned_priors(arm),
        length=arm.length,
        placement_std=arm.sensors.placement_std,
    )
