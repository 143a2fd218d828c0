"""The block `motion` of a scenario: mass, damping, gravity, a rotating base, a peg.

MuJoCo simulates a scenario with this block; without it, the arm is always in equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, quantity, STANDARD_GRAVITY

Row = tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class LabMotion:
    """Motion of the arm and its base; its mass is `arm.weight` / 9.80665 m/s^2.

    gravity_x, gravity_y: the unit vector that points down, in the base frame while the base rests;
    zero: out of the plane. The base rotates about the clamp by `turn_angle` (rad), and moves by
    `shift_x` and `shift_y` (m, along fixed axes), at `turn_share` of the recording, with minimum
    jerk in between. The peg is fixed to the base and has friction `peg_friction`; radius 0: no
    peg. Without inertia, the arm is always in equilibrium, like the chain.
    """

    damping_time: float = quantity(
        0.03, unit='s', meaning='Kelvin-Voigt: damping of a hinge / stiffness', bounds=(0.0, 1e2)
    )
    tip_mass: float = quantity(0.0, unit='kg', meaning='mass at the free end', bounds=(0.0, 1e2))
    gravity_x: float = quantity(0.0, unit='-', meaning='share of gravity', bounds=(-1.0, 1.0))
    gravity_y: float = quantity(0.0, unit='-', meaning='share of gravity', bounds=(-1.0, 1.0))
    turn_share: Row = (0.0, 1.0)
    turn_angle: Row = (0.0, 0.0)
    shift_x: Row = (0.0, 0.0)
    shift_y: Row = (0.0, 0.0)
    inertia: float = quantity(
        1.0, unit='-', meaning='0: the arm is always in equilibrium', bounds=(0.0, 1.0)
    )
    peg_x: float = quantity(0.0, unit='m', meaning='axis of the peg', bounds=(-10.0, 10.0))
    peg_y: float = quantity(0.0, unit='m', meaning='axis of the peg', bounds=(-10.0, 10.0))
    peg_radius: float = quantity(0.0, unit='m', meaning='radius; 0: no peg', bounds=(0.0, 10.0))
    peg_friction: float = quantity(
        0.0, unit='-', meaning='friction coefficient', bounds=(0.0, 10.0)
    )
    radius: float = quantity(
        0.007, unit='m', meaning='radius of the arm where it touches the peg', bounds=(1e-6, 1.0)
    )
    links: float = quantity(56.0, unit='-', meaning='hinges of the arm', bounds=(4.0, 400.0))
    timestep: float = quantity(1e-3, unit='s', meaning='time step of MuJoCo', bounds=(1e-6, 0.01))

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_quantities(self, 'motion', RequestError)
        if not float(self.links).is_integer():
            raise RequestError(
                f'motion.links = {self.links} is not a whole number', reason='not_a_number'
            )
        if math.hypot(self.gravity_x, self.gravity_y) > 1.0 + 1e-9:
            raise RequestError(
                'motion.gravity_x and gravity_y must be components of a unit vector',
                reason='no_direction',
            )
        if self.inertia not in (0.0, 1.0):
            raise RequestError(
                'motion.inertia must be 1, or 0 for an arm in equilibrium', reason='out_of_bounds'
            )
        if not self.inertia and self.peg_radius > 0.0:
            raise RequestError('a peg of MuJoCo needs motion.inertia: 1', reason='not_for_mujoco')
        share = np.array(self.turn_share)
        ends = share.size >= 2 and share[0] == 0.0 and share[-1] == 1.0
        if not ends or np.any(np.diff(share) <= 0.0):
            raise RequestError('motion.turn_share must rise from 0 to 1', reason='not_increasing')
        for name in ('turn_angle', 'shift_x', 'shift_y'):
            row = np.array(getattr(self, name))
            if row.size != share.size and row.any():
                raise RequestError(
                    f'motion.{name} must have a number for each turn_share', reason='wrong_shape'
                )
            if not np.all(np.isfinite(row)):
                raise RequestError(f'motion.{name} must be finite numbers', reason='not_finite')

    def turn(self, share: Array) -> tuple[Array, Array, Array]:
        """Return angle (rad) of the base and its derivatives by the share of time (n,)."""
        return self.follow(self.turn_angle, share)

    def follow(self, row: Row, share: Array) -> tuple[Array, Array, Array]:
        """Interpolate a row at shares of time (n,) with minimum jerk; also returns derivatives."""
        if not any(row):
            zero = freeze(np.zeros(share.size))
            return zero, zero, zero
        knots, values = np.array(self.turn_share), np.array(row)
        part = np.clip(np.searchsorted(knots, share, side='right') - 1, 0, knots.size - 2)
        span = np.diff(knots)[part]
        u = np.clip((share - knots[part]) / span, 0.0, 1.0)
        change = np.diff(values)[part]
        return (
            freeze(values[part] + change * u**3 * (10.0 + u * (6.0 * u - 15.0))),
            freeze(change / span * 30.0 * u**2 * (1.0 - u) ** 2),
            freeze(change / span**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)),
        )

    def pull(self, times: Array, duration: float) -> Array:
        """Return the apparent gravity in a base frame that moves but does not turn.

        times (n,) s of a recording of this duration (s). (n, 3) m/s^2: gravity minus the
        acceleration of the base.
        """
        down = np.array([self.gravity_x, self.gravity_y])
        out_of_plane = -math.sqrt(max(1.0 - float(down @ down), 0.0))
        pulls = np.tile(STANDARD_GRAVITY * np.append(down, out_of_plane), (times.size, 1))
        share = freeze(times / duration)
        for axis, row in enumerate((self.shift_x, self.shift_y)):
            pulls[:, axis] -= self.follow(row, share)[2] / duration**2
        return freeze(pulls)

    def apparent_gravity(self, times: Array, duration: float) -> Array:
        """Return the apparent gravity in the frame of the base, which may rotate."""
        pulls = self.pull(times, duration).copy()
        angle = self.turn(freeze(times / duration))[0]
        cosine, sine = np.cos(angle), np.sin(angle)
        x, y = pulls[:, 0].copy(), pulls[:, 1].copy()
        pulls[:, 0], pulls[:, 1] = cosine * x + sine * y, cosine * y - sine * x
        return freeze(pulls)

    def imu(self, times: Array, duration: float) -> Array:
        """Return specific force (m/s^2) and turn rate (rad/s) of the base, (n, 4)."""
        rate = self.turn(freeze(times / duration))[1] / duration
        return freeze(np.column_stack([-self.apparent_gravity(times, duration), rate]))
