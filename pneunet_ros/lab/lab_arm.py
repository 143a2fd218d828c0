"""The arm of the virtual lab: its own description of the truth, independent of the model.

Intrinsic curvature is a sum of Legendre polynomials in s, smooth along the whole arm; between rows
it is linear in p, like rigidities and l1, so that the model can represent this arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, quantity

CAP_BEGINS = 1e-9  # relative to half the length, beyond the soft end
VARIATION = 0.15  # largest relative change of a parameter of the arm by a seed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabArm:
    """Ground truth of an arm.

    targets (targets,) m along the arm; curvature_pressure (rows,) Pa and modes (rows, degree + 1)
    1/m: kappa0 = sum of modes[k] P_k(2 s / l - 1); law_pressure (rows,) Pa, split (rows,) l1 / l,
    rigidity (rows, 2) alpha = B / (mg l^2), positive. `seed` determines where targets are painted,
    and the parameters of an arm made by `vary_arm`.
    """

    name: str
    length: float = quantity(unit='m', meaning='length', bounds=(1e-3, 10.0))
    weight: float = quantity(unit='N', meaning='mg', bounds=(1e-6, 1e4))
    tip_cap: float = quantity(
        0.0, unit='m', meaning='length of the rigid part beyond the soft end', bounds=(0.0, 10.0)
    )
    clamp_angle: float = quantity(0.0, unit='rad', meaning='theta(0)', bounds=(-7.0, 7.0))
    targets: Array
    curvature_pressure: Array
    modes: Array
    law_pressure: Array
    split: Array
    rigidity: Array
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the tables."""
        check_quantities(self, 'arm', RequestError)
        modes, rows = np.atleast_2d(self.modes), (len(self.law_pressure),)
        sizes: dict[str, tuple[int, ...]] = {
            'targets': (len(self.targets),),
            'curvature_pressure': (len(self.curvature_pressure),),
            'modes': (len(self.curvature_pressure), modes.shape[1]),
            'law_pressure': rows,
            'split': rows,
            'rigidity': (*rows, 2),
        }
        for name, size in sizes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), size))
            if not np.all(np.isfinite(getattr(self, name))):
                raise RequestError(f'arm: {name} contains NaN or infinity', reason='not_finite')
        for name in ('curvature_pressure', 'law_pressure', 'targets'):
            values = getattr(self, name)
            if values.size < 2 or not np.all(np.diff(values) > 0.0):
                raise RequestError(
                    f'arm: {name} must have two or more increasing values', reason='not_increasing'
                )
        if self.targets[0] < 0.0 or self.targets[-1] > self.reach:
            raise RequestError(
                f'arm: targets must lie between 0 and the length {self.reach} m',
                reason='out_of_bounds',
            )
        if not np.all((self.split > 0.0) & (self.split < 1.0)):
            raise RequestError(
                'arm: split must lie between 0 and 1 (l1 / l)', reason='out_of_bounds'
            )
        if not np.all(self.rigidity > 0.0):
            raise RequestError(
                'arm: rigidity must be positive, because the lab minimizes energy',
                reason='singular_rigidity',
            )
        if not self.pressure_range[0] < self.pressure_range[1]:
            raise RequestError(
                'arm: curvature and moment law have no pressures in common',
                reason='no_common_pressure',
            )

    @property
    def reach(self) -> float:
        """Length including the cap (m)."""
        return self.length + self.tip_cap

    @property
    def pressure_range(self) -> tuple[float, float]:
        """Pressures (Pa) covered by both tables."""
        tables = self.curvature_pressure, self.law_pressure
        return max(float(t[0]) for t in tables), min(float(t[-1]) for t in tables)

    def curvature_weights(self, pressure: Array) -> Array:
        """Return the weights of the rows of `modes` at pressures (n,) Pa, (n, rows)."""
        rows = self.curvature_pressure
        below = np.clip(np.searchsorted(rows, pressure, side='right') - 1, 0, rows.size - 2)
        above = (pressure - rows[below]) / (rows[below + 1] - rows[below])
        weights = np.zeros((pressure.size, rows.size))
        each = np.arange(pressure.size)
        weights[each, below] = 1.0 - above
        weights[each, below + 1] = above
        return freeze(weights)

    def intrinsic_curvature(self, arclength: npt.ArrayLike) -> Array:
        """Return kappa0 (1/m) of every row at places along the arm (m), (rows, places)."""
        u = 2.0 * np.asarray(arclength, np.float64) / self.length - 1.0
        curvature = np.asarray(legendre.legval(u, self.modes.T))
        return freeze(np.where(u > 1.0 + CAP_BEGINS, 0.0, curvature))

    def turning_angle(self, arclength: npt.ArrayLike) -> Array:
        """Return the angle (rad) of the unloaded arm at places (m), for each row."""
        u = 2.0 * np.asarray(arclength, np.float64) / self.length - 1.0
        integral = legendre.legint(self.modes.T, lbnd=-1.0, axis=0)
        return frozen_array(0.5 * self.length * np.asarray(legendre.legval(u, integral)))

    def stiffness(self, pressure: Array) -> tuple[Array, Array]:
        """Return rigidities (n, 2) N m^2 and l1 (n,) m at pressures (n,) Pa."""
        scale = self.weight * self.length**2
        rigidity = [np.interp(pressure, self.law_pressure, alpha) for alpha in self.rigidity.T]
        split = np.interp(pressure, self.law_pressure, self.split)
        return freeze(scale * np.column_stack(rigidity)), freeze(self.length * split)


def vary_arm(arm: LabArm, seed: int) -> LabArm:
    """Return another arm of the same type: parameters up to 15 % off, targets repainted.

    Seed 0 gives the same arm.
    """
    if seed == 0:
        return replace(arm, seed=0)
    random = np.random.default_rng([seed, 7])
    size, lean, first, second, tilt, position = random.uniform(-1.0, 1.0, 6)
    # A factor 1 + VARIATION (2/3 size + 1/3 lean u), u from -1 at the clamp to 1 at the end.
    factor = [1.0 + VARIATION * size * 2.0 / 3.0, VARIATION * lean / 3.0]
    modes = np.stack([pad(legendre.legmul(row, factor), row.size + 1) for row in arm.modes])
    low, high = arm.pressure_range
    along = 2.0 * (arm.law_pressure - low) / (high - low) - 1.0
    stiffer = 1.0 + VARIATION * (np.array([first, second]) * 0.75 + 0.25 * tilt * along[:, None])
    return replace(
        arm,
        name=f'{arm.name}-{seed}',
        seed=seed,
        modes=modes,
        rigidity=arm.rigidity * stiffer,
        split=arm.split * (1.0 + VARIATION * position),
    )


def pad(row: Array, size: int) -> Array:
    """Return coefficients with zeros appended."""
    return np.concatenate([row, np.zeros(size - row.size)])
