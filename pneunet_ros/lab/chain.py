"""Shapes of the lab arm: the chain of elements, its loads in every frame, and its equilibrium.

The chain is second-order accurate in the element length. See `chain_kernels` for the energy.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.chain_kernels import equilibria

SETTLED = 1e-10  # m, largest difference between the depth of the peg and its push
TURNED = 1e-9  # rad, largest difference between a push and the normal of the arm
MOST_STEPS = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Peg:
    """A stiff stop at height y (m), met from below by the point at `place` (m) along the arm.

    The stop is frictionless; its force is stiffness (N/m) times penetration.
    """

    place: float
    height: float
    stiffness: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Push:
    """A frictionless push at `place` (m): force (frames,) N along the arm's normal there.

    The normal is that of the deformed shape: it turns with the arm.
    """

    place: float
    force: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chain:
    """The lab arm as a chain of n elements, in a batch of frames.

    turning (frames, n + 1) rad: rotation of the unloaded arm at every joint; joints are at the
    clamp, between elements, and at the free end. rigidity (frames, 2) N m^2, before and after
    split (frames,) m. force (frames, 2) N and moment (frames,) N m at the free end. Effects give
    the remaining fields: rigidity_factors (frames, n + 1), one per joint; rest (frames, n) strain;
    line (n, 2) or (frames, n, 2) N, the force of loads along the arm beyond the middle of every
    element; axial_compliance 1/N, and its growth with the strain; cubic m^2 and quintic m^4 of the
    moment; clamp_compliance rad/(N m) and clamp_hardening 1/rad^2; end_offset_across,
    end_offset_along (m): offsets of the end force at the free end; peg; pushes. time (frames,) s,
    from the beginning of the recording. The weight of `mass` (kg) along the arm and of `tip_mass`
    (kg) at the free end follows pulls (frames, 2) m/s^2, gravity in the base frame.
    """

    length: float
    clamp_angle: float
    turning: Array
    rigidity: Array
    split: Array
    force: Array
    moment: Array
    rigidity_factors: Array = field(default_factory=lambda: np.zeros(0))
    rest: Array = field(default_factory=lambda: np.zeros(0))
    line: Array = field(default_factory=lambda: np.zeros(0))
    axial_compliance: float = 0.0
    axial_growth: float = 0.0
    cubic: float = 0.0
    quintic: float = 0.0
    clamp_compliance: float = 0.0
    clamp_hardening: float = 0.0
    end_offset_across: float = 0.0
    end_offset_along: float = 0.0
    peg: Peg | None = None
    pushes: tuple[Push, ...] = ()
    time: Array = field(default_factory=lambda: np.zeros(0))
    mass: float = 0.0
    tip_mass: float = 0.0
    pulls: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check the sizes; reject rigidities for which the energy has no minimum."""
        frames, joints = np.shape(self.turning)
        sizes = {
            'turning': (frames, joints),
            'rigidity_factors': (frames, joints),
            'rigidity': (frames, 2),
            'split': (frames,),
            'force': (frames, 2),
            'moment': (frames,),
            'time': (frames,),
            'pulls': (frames, 2),
            'rest': (frames, joints - 1),
            'line': (frames, joints - 1, 2),
        }
        for name, size in sizes.items():
            value = np.asarray(getattr(self, name), np.float64)
            value = (
                value if value.size else np.full(size, 1.0 if name == 'rigidity_factors' else 0.0)
            )
            value = np.broadcast_to(value, size) if name == 'line' else value
            object.__setattr__(self, name, frozen_array(value, size))
        if not (np.all(self.rigidity > 0.0) and np.all(self.rigidity_factors > 0.0)):
            raise RequestError(
                'the rigidity of the lab arm must be positive at all pressures',
                reason='singular_rigidity',
            )

    @property
    def element(self) -> float:
        """Length of an element (m)."""
        return self.length / len(self.rest[0])

    @property
    def middles(self) -> Array:
        """Arclength (m) of the middle of every element, (n,)."""
        return freeze((np.arange(len(self.rest[0]), dtype=np.float64) + 0.5) * self.element)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainShape:
    """A chain in equilibrium: angles (frames, n + 2) rad, joints x, y (frames, n + 1) m."""

    chain: Chain
    angles: Array
    x: Array
    y: Array

    def points(self, arclength: npt.ArrayLike) -> tuple[Array, Array, Array]:
        """Return x, y (m) and theta (rad) at places along the arm (m), each (frames, places).

        Beyond the free end the arm is straight, like its rigid cap.
        """
        places = np.asarray(arclength, np.float64)
        s = np.minimum(places, self.chain.length)
        joints = self.chain.element * np.arange(self.x.shape[1], dtype=np.float64)
        ends = np.concatenate([[0.0], self.chain.middles, [self.chain.length]])
        x, y = between(joints, self.x, s), between(joints, self.y, s)
        theta = between(ends, self.angles, s)
        x += (places - s) * np.cos(theta)
        y += (places - s) * np.sin(theta)
        return freeze(x), freeze(y), freeze(theta)

    def curvature(self, arclength: npt.ArrayLike) -> Array:
        """Return the curvature (1/m, per unstretched length) at places (m), (frames, places)."""
        h, count = self.chain.element, self.x.shape[1]
        span = np.full(count, h)
        places = h * np.arange(count, dtype=np.float64)
        span[[0, -1]] *= 0.5
        places[[0, -1]] += 0.25 * h, -0.25 * h
        positions = np.asarray(arclength, np.float64)
        s = np.clip(positions, places[0], places[-1])
        curvature = between(places, np.diff(self.angles, axis=1) / span, s)
        return freeze(np.where(positions > self.chain.length, 0.0, curvature))


def between(places: Array, values: Array, at: Array) -> Array:
    """Interpolate rows of values (frames, places) linearly; returns (frames, at)."""
    below = np.clip(np.searchsorted(places, at, side='right') - 1, 0, places.size - 2)
    weight = (at - places[below]) / (places[below + 1] - places[below])
    result: Array = (1.0 - weight) * values[:, below] + weight * values[:, below + 1]
    return result


def middle_joints(length: float, elements: int) -> Array:
    """Return the borders (m) of the parts of the arm represented by each joint, (n + 2,)."""
    middles = (np.arange(elements, dtype=np.float64) + 0.5) * (length / elements)
    return freeze(np.concatenate([[0.0], middles, [length]]))


def free_shape(chain: Chain, start: Array | None = None) -> ChainShape:
    """Return the equilibrium of the chain without peg and pushes, frame by frame.

    Each frame starts from the previous one, and the first frame from the angles `start` (n + 2,)
    if given, so that a branch of equilibria is followed as long as it exists. Raises RequestError
    with the first frame that has no equilibrium.
    """
    frames, joints = chain.turning.shape
    force, line = chain.force, chain.line
    if chain.pulls.any():
        beyond = chain.mass * (1.0 - chain.middles / chain.length)
        line = freeze(line + beyond[:, None] * chain.pulls[:, None])
        force = freeze(force + chain.tip_mass * chain.pulls)
    loads = np.column_stack([chain.rigidity, chain.split, force, chain.moment])
    numbers = np.array(
        [
            chain.element,
            chain.clamp_angle,
            chain.clamp_compliance,
            chain.clamp_hardening,
            chain.axial_compliance,
            chain.axial_growth,
            chain.cubic,
            chain.quintic,
            chain.end_offset_across,
            chain.end_offset_along,
        ]
    )
    angles = np.zeros((frames, joints + 1))
    if start is not None:
        angles[0] = start
    tables = (
        chain.turning,
        chain.rigidity_factors,
        chain.rest,
        line,
        freeze(loads),
        freeze(numbers),
    )
    solved = int(equilibria(*tables, angles, start is not None))
    if solved < frames:
        f1, f2 = force[solved]
        raise RequestError(
            f'the lab arm finds no equilibrium in frame {solved}, under the force '
            f'({f1:.3g}, {f2:.3g}) N: use smaller loads or effects',
            reason='no_equilibrium',
        )
    cosine, sine = np.cos(angles[:, 1:-1]), np.sin(angles[:, 1:-1])
    n1, n2 = (force[:, None, i] + line[:, :, i] for i in (0, 1))
    strain = chain.axial_compliance * (n1 * cosine + n2 * sine)
    stretched = chain.element * (1.0 + chain.rest + strain * (1.0 + chain.axial_growth * strain))
    zero = np.zeros((frames, 1))
    x, y = (
        freeze(np.concatenate([zero, np.cumsum(stretched * part, axis=1)], axis=1))
        for part in (cosine, sine)
    )
    return ChainShape(chain=chain, angles=freeze(angles), x=x, y=y)


def pushed_shape(chain: Chain, start: Array | None = None) -> ChainShape:
    """Return the equilibrium of the chain with pushes along its normals, without the peg.

    RequestError if the iteration between the arm and the directions of pushes does not converge.
    """
    pushes = [push for push in chain.pushes if push.force.any()]
    shape = free_shape(chain, start)
    if not pushes:
        return shape
    elements = np.arange(chain.rest.shape[1], dtype=np.float64)
    places = np.array([push.place for push in pushes])
    force = np.stack([push.force for push in pushes], axis=1)
    before = np.clip(places[:, None] / chain.element - elements, 0.0, 1.0)
    heading = shape.points(places)[2]
    previous_heading, previous_change = heading, np.zeros(heading.shape)
    for _ in range(MOST_STEPS):
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=2)
        line = np.einsum('fp,fpc,pe->fec', force, normal, before)
        shape = free_shape(replace(chain, line=chain.line + line), start)
        change = shape.points(places)[2] - heading
        if np.abs(change).max() < TURNED:
            return shape
        # Secant method on the heading of the push; it starts at the heading of the arm.
        slope = np.where(heading == previous_heading, 1.0, (previous_change - change) / np.where(
            heading == previous_heading, 1.0, heading - previous_heading))  # fmt: skip
        slope = np.where(slope > 0.0, slope, 1.0)
        previous_heading, previous_change = heading, change
        heading = heading + change / slope
    frame = int(np.argmax(np.abs(previous_change).max(axis=1)))
    raise RequestError(
        f'the lab arm finds no equilibrium under its push in frame {frame}: use a smaller force',
        reason='no_equilibrium',
    )


def equilibrium_shape(chain: Chain, start: Array | None = None) -> ChainShape:
    """Return the equilibrium of the chain under its loads, with contact at its peg.

    The peg acts on the joint nearest to its place, along -y. RequestError if no force of the peg
    balances the arm.
    """
    free, peg = pushed_shape(chain, start), chain.peg
    if peg is None or peg.stiffness <= 0.0:
        return free
    joint = round(min(peg.place, chain.length) / chain.element)
    before = np.arange(chain.rest.shape[1])[:, None] < joint
    gap = free.y[:, joint] - peg.height
    touching = gap > 0.0
    if not touching.any():
        return free
    # The stiffer the arm, the larger the push, up to that of a rigid arm.
    low, high = np.zeros(gap.size), peg.stiffness * np.maximum(gap, 0.0)
    bending = 3.0 * chain.rigidity.min(axis=1) / max(peg.place, chain.element) ** 3
    push = np.where(touching, np.maximum(gap, 0.0) / (1.0 / peg.stiffness + 1.0 / bending), 0.0)
    previous_push, previous_excess = np.zeros(gap.size), np.where(touching, gap, 0.0)
    for _ in range(MOST_STEPS):
        loaded = replace(chain, line=chain.line - push[:, None, None] * before * [0.0, 1.0])
        shape = pushed_shape(loaded, start)
        excess = shape.y[:, joint] - peg.height - push / peg.stiffness
        excess = np.where(touching, excess, 0.0)
        if np.abs(excess).max() < SETTLED:
            return shape
        low, high = np.where(excess > 0.0, push, low), np.where(excess < 0.0, push, high)
        fall = np.where(previous_excess == excess, np.inf, previous_excess - excess)
        step = excess * (push - previous_push) / fall
        previous_push, previous_excess = push, excess
        secant = push + step
        is_secant = (secant > low) & (secant < high) & (np.abs(excess) >= SETTLED)
        bisection = np.minimum(0.5 * (low + high), 2.0 * low + push)
        push = np.where(is_secant, secant, np.where(np.abs(excess) < SETTLED, push, bisection))
    frame = int(np.argmax(np.abs(excess)))
    raise RequestError(
        f'the lab arm finds no equilibrium at its peg in frame {frame}: use a softer peg or '
        'another place',
        reason='no_equilibrium',
    )
