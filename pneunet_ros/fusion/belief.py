"""What is believed of all unknowns at the stamp of a frame: a mean, and a root of the covariance.

The unknowns: the tip force, the pressure bias (what creep, hysteresis and a drifting sensor look
like), the camera's drift and place, by how much it is turned, by how much the force sensor is off
(offset and gain), the columns of the model's covariance in sigma, the painted places of the
targets along and across the arm, the force and place of a contact, and the noise of the readings
at this stamp. Without a contact its force and place are known to be zero; a camera that nobody
moved and a force sensor in order are known to be right, to a hair. In time the first ones move,
and how much of the curvature comes late, each with a largest std of its own; model, camera, force
sensor and dots stay; noise is new in every reading.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.lack import first_weights, lack_columns, scale_of, span_of
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import PlacementKnown
from pneunet_ros.solver.columns import END_LOAD_MOMENT
from pneunet_ros.solver.solution import SolverNodes
from scipy.linalg.lapack import dgeqrf, dpotrf, dtrtrs

FORCE = slice(0, 2)
BIAS = 2
OF_BIAS = slice(2, 3)
DRIFT = slice(3, 5)
CAMERA = slice(5, 7)
CONTACT = slice(-4, -2)  # force N along the normal, place m along the arm
TIP_FORCES = (0, 1)
FORCES = (*TIP_FORCES, -4)  # of the tip and of a contact
MOMENT_NOISE, PRESSURE_NOISE = -2, -1
TURN = 7  # rad, of the camera around the base
OFFSET = slice(8, 10)  # N, of the force sensor
GAIN = 10  # of the force sensor, beyond 1
COLUMNS = 11  # where the columns of the model's covariance begin
BLOCK = 32  # columns that LAPACK reflects at once


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unknowns:
    """The unknowns of an arm: how many, how uncertain without any frame, and how they move.

    std (n,): before any frame and reading, N, Pa, m, sigma, m; times (k,): correlation times (s)
    of bias, drift, camera, force sensor, columns and memory, which follow the force. force_scale:
    the largest force (N) that is likely; length (m): of the arm. lacking: where the unknowns are
    that stand for what the model lacks, whose std is that of a lack of all of the range; range
    (Pa): of the pressure; causes (causes, n): what one of each changes of every cause of
    `target_jacobian`, but for what goes with what was read. placement: of the targets that the
    model was calibrated with, None where it is not known. moving, moving_times, moving_std (m,):
    which of the unknowns move, how fast (the force: 1 s) and how far at most; lacking_moves: where
    those that are lacking stand among them.
    """

    columns: int
    memory: int
    lacking: npt.NDArray[np.intp]
    range: float
    targets: int
    std: Array
    times: Array
    force_scale: float
    length: float
    causes: Array
    placement: PlacementKnown | None = None
    moving: npt.NDArray[np.intp] = field(init=False)
    moving_times: Array = field(init=False)
    moving_std: Array = field(init=False)
    lacking_moves: npt.NDArray[np.intp] = field(init=False)
    lacking_times: tuple[float, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Note what moves."""
        times = np.concatenate([[1.0, 1.0], self.times])
        moves = np.isfinite(times)
        moves[self.lacking] = True
        moving = np.flatnonzero(moves)
        for name, value in (
            ('moving', moving),
            ('moving_times', freeze(times[moving])),
            ('moving_std', freeze(self.std[moving])),
            ('lacking_moves', np.searchsorted(moving, self.lacking)),
            ('lacking_times', tuple(times[self.lacking].tolist())),
        ):
            object.__setattr__(self, name, value)

    @property
    def of_columns(self) -> slice:
        """Where the columns of the model's covariance are."""
        return slice(COLUMNS, COLUMNS + self.columns)

    @property
    def of_memory(self) -> slice:
        """Where the parts of the curvature that come late are, and that of a play."""
        start = COLUMNS + self.columns
        return slice(start, start + self.memory)

    @property
    def along(self) -> slice:
        """Where the painted places along the arm are; those across it follow."""
        start = COLUMNS + self.columns + self.memory
        return slice(start, start + self.targets)

    @property
    def across(self) -> slice:
        """Where the painted places across the arm are."""
        start = COLUMNS + self.columns + self.memory + self.targets
        return slice(start, start + self.targets)

    @property
    def painted(self) -> slice:
        """Where the painted places along and across the arm are."""
        return slice(self.along.start, self.across.stop)


def unknowns_of(arm: Arm, settings: FusionSettings) -> Unknowns:
    """Return the unknowns of an arm; the force scale is the largest force of its calibration."""
    noise, targets = arm.sensors, arm.target_arclength.size
    known = 0 if arm.covariance is None else len(arm.covariance.columns())
    guessed = 0 if arm.covariance is None else arm.covariance.guessed
    further = len(lack_columns(settings, arm))
    columns = known + further
    largest = 0.0 if arm.domain is None else arm.domain.largest_force
    scale = largest if largest > 0.0 else arm.weight
    low, high = span_of(arm)
    std = np.concatenate(
        [
            [scale, scale, high - low],
            np.repeat([noise.drift_std, noise.registration_std], 2),
            [settings.camera_turn],
            np.repeat(settings.force_offset * scale, 2),
            [settings.force_gain],
            np.ones(columns),
            np.full(len(settings.lag_times), settings.creep_fraction),
            [settings.play_share],
            np.full(2 * targets, noise.placement_std),
            np.zeros(4),
        ]
    )
    times = np.concatenate(
        [
            [settings.bias_time, settings.drift_time, settings.drift_time, np.inf, np.inf],
            np.full(4, np.inf),
            np.full(known - guessed, np.inf),
            np.full(guessed, settings.guess_time),
            np.full(further, settings.bias_time),
            np.full(len(settings.lag_times) + 1, settings.memory_time),
        ]
    )
    return Unknowns(
        columns=columns,
        memory=len(settings.lag_times) + 1,
        lacking=np.array([BIAS, *range(COLUMNS + known, COLUMNS + columns)]),
        range=high - low,
        targets=targets,
        std=freeze(std),
        times=freeze(times),
        force_scale=scale,
        length=arm.length,
        causes=freeze(own_causes(columns, std.size)),
        placement=None if arm.covariance is None else arm.covariance.placement,
    )


def own_causes(columns: int, unknowns: int) -> Array:
    """Return the part of `frame_fit.causes_of` that is always the same, (causes, unknowns)."""
    causes = np.zeros((PRESSURE + 1 + columns, unknowns))
    causes[FORCE, FORCE] = np.eye(2)
    causes[END_LOAD_MOMENT, MOMENT_NOISE] = 1.0
    causes[PRESSURE, [BIAS, PRESSURE_NOISE]] = 1.0
    causes[PRESSURE + 1 :, COLUMNS : COLUMNS + columns] = np.eye(columns)
    return causes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Belief:
    """What is believed at a stamp: mean (n,), root (n, m) with root root^T the covariance.

    walk (N/sqrt(s)): of the forces, as they moved lately; usual_walk: of the tip force, as it did
    on average; interval (s): after which they go on as steadily as from frame to frame;
    lack_weights (scales,): of the sizes of what the model lacks, log; chamber: the pressure (Pa)
    as read, NaN where it was not; solution: the rod there, None before the first; frames: how many
    have been used. same_targets: they are taken for those of the calibration, which knows where
    they are painted; camera_moved: the camera is not where it was when the base frame was found.
    """

    stamp_ns: int
    mean: Array
    root: Array
    walk: float
    usual_walk: float
    lack_weights: Array
    interval: float = math.inf
    chamber: float = math.nan
    solution: SolverNodes | None = None
    frames: int = 0
    same_targets: bool = False
    camera_moved: bool = False

    @property
    def touched(self) -> bool:
        """Whether a contact is believed."""
        return bool(self.root[CONTACT].any())

    @property
    def force_covariance(self) -> Array:
        """Covariance (2, 2) N^2 of the force."""
        root = self.root[FORCE]
        return np.asarray(root @ root.T)

    def std(self, which: int) -> float:
        """Return one sigma of an unknown."""
        return math.sqrt(float(self.root[which] @ self.root[which]))


def first_belief(unknowns: Unknowns, settings: FusionSettings, stamp_ns: int) -> Belief:
    """Return what is believed before any frame.

    Where the calibration knows the placement of the targets, model and placement go together: the
    same pictures must not tell of the model twice.
    """
    mean, weights = np.zeros(unknowns.std.size), first_weights(settings)
    walk = settings.force_walk * unknowns.force_scale
    root = np.diag(scaled_std(unknowns, scale_of(settings, weights)))
    placement = unknowns.placement
    if placement is not None:
        painted, columns = unknowns.painted, placement.factor.shape[1]
        mean[painted] = placement.mean
        root[painted, painted] = np.diag(placement.std)
        root[painted, COLUMNS : COLUMNS + columns] = placement.factor
    return Belief(
        stamp_ns=stamp_ns,
        mean=freeze(mean),
        root=freeze(root),
        walk=walk,
        usual_walk=walk,
        lack_weights=weights,
        same_targets=placement is not None,
    )


def without_lessons(unknowns: Unknowns, settings: FusionSettings, belief: Belief) -> Belief:
    """Return what is believed before any frame, to be sought from where the arm is believed."""
    first = first_belief(unknowns, settings, belief.stamp_ns)
    mean = first.mean.copy()
    mean[FORCE] = belief.mean[FORCE]
    return replace(
        first,
        mean=freeze(mean),
        chamber=belief.chamber,
        solution=belief.solution,
        frames=belief.frames,
    )


def with_other_targets(unknowns: Unknowns, belief: Belief) -> Belief:
    """Return the belief of somebody who knows that other targets are painted on the arm."""
    forgotten = forget(belief, unknowns.painted, unknowns.std[unknowns.painted])
    return replace(forgotten, same_targets=False)


def with_moved_camera(unknowns: Unknowns, settings: FusionSettings, belief: Belief) -> Belief:
    """Return the belief of somebody who knows that the camera is not where it was.

    What frames have said of the force sensor may have come from that.
    """
    of_sensor = np.arange(OFFSET.start, GAIN + 1)
    where = np.array([CAMERA.start, CAMERA.start + 1, TURN, *of_sensor])
    moved = settings.camera_moved_by * unknowns.length
    turned = settings.camera_turned_by
    std = np.array([moved, moved, turned, *unknowns.std[of_sensor]])
    return replace(forget(belief, where, std), camera_moved=True)


def told_by_frames(unknowns: Unknowns, belief: Belief, which: int) -> tuple[float, float]:
    """Return what frames say by themselves of an unknown that is known to a hair, and its std.

    By the score of the narrow prior; infinite where they say nothing.
    Source: Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948).
    """
    prior = float(unknowns.std[which])
    share = 1.0 - (belief.std(which) / prior) ** 2 if prior > 0.0 else 0.0
    if share <= 0.0:
        return 0.0, math.inf
    return float(belief.mean[which]) / share, prior / math.sqrt(share)


def with_strange_targets(
    unknowns: Unknowns, settings: FusionSettings, belief: Belief, strange: npt.NDArray[np.intp]
) -> Belief:
    """Return the belief of somebody who knows that some targets are not where they were.

    They did not fit by their gate, and are further from their places than targets are.
    """
    where = np.concatenate([unknowns.along.start + strange, unknowns.across.start + strange])
    return forget(belief, where, math.sqrt(settings.target_gate) * unknowns.std[where])


def scaled_std(unknowns: Unknowns, scale: float) -> Array:
    """Return one sigma (n,) before any frame, of a model that lacks so much, of the range."""
    std = unknowns.std.copy()
    std[unknowns.lacking] *= scale
    return freeze(std)


def lack_grown(unknowns: Unknowns, seconds: float, pressed: float) -> Array:
    """Return one sigma (errors,) of the moves of what a model lacks, for a scale of 1.

    It moves with time, and with the pressure, which has moved by `pressed` (Pa).
    """
    by_pressure = pressed / unknowns.range
    return np.array(
        [
            math.hypot(math.sqrt(-math.expm1(-2.0 * seconds / time)), by_pressure)
            for time in unknowns.lacking_times
        ]
    )


def move_belief(
    unknowns: Unknowns,
    belief: Belief,
    stamp_ns: int,
    scale: float,
    pressed: float = 0.0,
    *,
    walk: float | None = None,
    noise: tuple[float, float] | None = None,
) -> Belief:
    """Return the belief at another stamp, before or after its own: it tells as little of both.

    scale: of what the model lacks; pressed (Pa): by how much the pressure has moved since; walk
    (N/sqrt(s)): of the forces from now on, None for as they moved lately; noise (N m, Pa): one
    sigma of readings of moment and pressure there, None where they are those of before. What
    moves is an Ornstein-Uhlenbeck process of the std before any frame, and what the model lacks
    moves with the pressure as well; the force keeps its mean, and only grows less certain: at
    first by its walk, and after `interval` as one that goes on steadily, since a load that swings
    does. One column of the root follows for all that moves, then those of the noise.
    """
    seconds = seconds_between(belief.stamp_ns, stamp_ns)
    steady = max(seconds / belief.interval, 1.0) if walk is None else 1.0
    walk = belief.walk if walk is None else walk
    moving = unknowns.moving
    times = unknowns.moving_times.copy()
    times[FORCE] = 2.0 * (unknowns.force_scale / walk) ** 2 / steady
    decay = np.exp(-seconds / times)
    grown = np.sqrt(1.0 - decay**2)
    grown[unknowns.lacking_moves] = scale * lack_grown(unknowns, seconds, pressed)
    known, count = belief.root.shape[1], moving.size
    mean = belief.mean.copy()
    root = with_columns(belief.root, count + (0 if noise is None else 2))
    mean[moving[BIAS:]] *= decay[BIAS:]
    root[moving, :known] *= decay[:, None]
    root[moving, np.arange(known, known + count)] = grown * unknowns.moving_std
    if noise is not None:
        set_noise(mean, root, noise)
    return Belief(
        stamp_ns=stamp_ns,
        mean=freeze(mean),
        root=freeze(root),
        walk=walk,
        usual_walk=belief.usual_walk,
        interval=belief.interval,
        lack_weights=belief.lack_weights,
        chamber=belief.chamber,
        solution=belief.solution,
        frames=belief.frames,
        same_targets=belief.same_targets,
        camera_moved=belief.camera_moved,
    )


def with_columns(root: Array, more: int) -> Array:
    """Return a copy of a root (n, m) with so many more columns, of zeros."""
    rows, columns = root.shape
    wider = np.empty((rows, columns + more))
    wider[:, :columns], wider[:, columns:] = root, 0.0
    return wider


def forget(belief: Belief, where: slice | npt.NDArray[np.intp], std: Array) -> Belief:
    """Return the belief of somebody who knows of some unknowns nothing but one sigma std (k,)."""
    mean, root = belief.mean.copy(), belief.root.copy()
    mean[where], root[where] = 0.0, 0.0
    return widen(replace(belief, mean=freeze(mean), root=root), where, std)


def widen(belief: Belief, where: slice | npt.NDArray[np.intp], std: Array) -> Belief:
    """Return the belief where some unknowns may have moved by any amount of one sigma std (k,)."""
    known = belief.root.shape[1]
    root = with_columns(belief.root, std.size)
    root[where, known:] = np.diag(std)
    return replace(belief, root=freeze(root))


def set_noise(mean: Array, root: Array, noise: tuple[float, float]) -> None:
    """Put noise (N m, Pa) into a mean and a root whose last two columns are still of nothing."""
    mean[MOMENT_NOISE:], root[MOMENT_NOISE:] = 0.0, 0.0
    root[MOMENT_NOISE, -2], root[PRESSURE_NOISE, -1] = noise


def with_walk(
    unknowns: Unknowns, settings: FusionSettings, before: Belief, after: Belief
) -> Belief:
    """Return the belief after a frame, with the random walk of the forces that it tells.

    before, after: the beliefs at the last frame and at this one, which are all but independent in
    the forces. What their two variances leave of a change is walk. It rises at once and falls
    in `walk_time`, but not below the walk of the tip force as it was on average.
    """
    seconds = seconds_between(before.stamp_ns, after.stamp_ns)
    if not before.frames or seconds <= 0.0:
        return replace(
            after, walk=before.walk, usual_walk=before.usual_walk, interval=before.interval
        )
    found, weights = [], []
    for force in FORCES:
        change = float(after.mean[force] - before.mean[force]) ** 2
        rows = before.root[force], after.root[force]
        explained = sum(float(row @ row) for row in rows)
        found.append((change - explained) / seconds)
        weights.append(explained**-2.0 if force in TIP_FORCES else 0.0)
    average = sum(weight * one for weight, one in zip(weights, found, strict=True)) / sum(weights)
    watched = settings.guess_counts + seconds * before.frames
    share = -math.expm1(-seconds / min(watched, settings.usual_time))
    usual = before.usual_walk**2 + share * (average - before.usual_walk**2)
    least = (unknowns.force_scale * settings.least_walk) ** 2
    largest = (unknowns.force_scale * settings.largest_walk) ** 2
    usual = min(max(usual, least), largest)
    recent = min(max(*found, usual), largest)
    share = 1.0 if recent > before.walk**2 else -math.expm1(-seconds / settings.walk_time)
    walk = before.walk**2 + share * (recent - before.walk**2)
    return replace(
        after,
        walk=math.sqrt(walk),
        usual_walk=math.sqrt(usual),
        interval=max(seconds, settings.steady_after),
    )


def take_measurement(belief: Belief, response: Array, value: Array, std: Array) -> Belief:
    """Return the belief after a linear measurement: value (k,) = response (k, n) x + noise.

    std (k,) of the noise, independent. The square-root form of the Kalman update.
    """
    seen = response @ belief.root / std[:, None]
    factor = innovation_factor(seen)
    root = root_after(belief.root, seen, factor)
    step = root @ (root.T @ (response.T @ ((value - response @ belief.mean) / std**2)))
    return replace(belief, mean=freeze(belief.mean + step), root=freeze(root))


def innovation_factor(seen: Array) -> Array:
    """Return the Cholesky factor (k, k), below its diagonal, of what is seen with white noise 1.

    seen (k, m): what a measurement sees of each column of the root.
    """
    covariance = seen @ seen.T
    covariance.flat[:: len(seen) + 1] += 1.0
    factor, _ = dpotrf(covariance.T, lower=1, overwrite_a=1)  # as Fortran has it: it is symmetric
    return np.asarray(factor)


def root_after(root: Array, seen: Array, factor: Array) -> Array:
    """Return the root of the covariance after a measurement of white noise 1.

    seen (k, m): what it sees of each column of the root (n, m); factor: `innovation_factor`.

    Source: Andrews, AIAA Journal 6 (1968).
    """
    with_white = factor.copy(order='F')
    with_white.flat[:: len(seen) + 1] += 1.0
    gain, _ = dtrtrs(with_white, seen, lower=1)
    gain, _ = dtrtrs(factor, gain, lower=1, trans=1, overwrite_b=1)
    return np.asarray(root - (root @ seen.T) @ gain)


def compress(root: Array) -> Array:
    """Return a square root (n, n) of the covariance of a root (n, m), m >= n."""
    size = len(root)
    reflected, _, _, _ = dgeqrf(root.T, lwork=BLOCK * size)
    return freeze(reflected[:size].T * lower_triangle(size))


def compressed(belief: Belief) -> Belief:
    """Return the same belief with a square root; the root grows with all that moves."""
    rows, columns = belief.root.shape
    return belief if columns <= rows else replace(belief, root=compress(belief.root))


@cache
def lower_triangle(size: int) -> Array:
    """Return ones on and below the diagonal, (size, size)."""
    return freeze(np.tri(size))
