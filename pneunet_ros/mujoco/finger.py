"""A finger in a running MuJoCo simulation, driven by its pressure."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.mujoco.hinge_chain import TABLES
from pneunet_ros.mujoco.library import load_mujoco


class Finger:
    """One finger of a MuJoCo model written by `pneunet mjcf`.

    model, data: `mujoco.MjModel` and `mujoco.MjData`, possibly with other bodies. prefix: of its
    names, if `MjSpec.attach` has added several fingers to one model.

    >>> finger = Finger(model, data)
    >>> finger.set_pressure(31e3)
    >>> mujoco.mj_step(model, data)

    Raises RequestError if the model has no such finger, or if MuJoCo is not installed.
    """

    def __init__(self, model: Any, data: Any, prefix: str = '') -> None:
        self.mujoco, self.model, self.data, self.prefix = load_mujoco(), model, data, prefix
        tables = {name: self._numeric(name) for name in TABLES}
        self._pressure, self._damping_time = tables['pressure'], float(tables['damping_time'][0])
        rows = self._pressure.size
        self._stiffness = freeze(tables['stiffness'].reshape(rows, -1))
        self._rest = freeze(tables['rest'].reshape(rows, -1))
        self._cubic = tables['cubic']
        hinges = [self._joint(f'bend_{index}') for index in range(self._cubic.size)]
        self._joints = np.array(hinges)
        self._qpos, self._dof = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]

    def _numeric(self, name: str) -> Array:
        """Return a table of the finger."""
        kind = self.mujoco.mjtObj.mjOBJ_NUMERIC
        place = self.mujoco.mj_name2id(self.model, kind, self.prefix + name)
        if place < 0:
            raise RequestError(
                f'the MuJoCo model has no numeric {self.prefix + name!r}: use a file written by '
                '`pneunet mjcf`, and the prefix with which the finger was attached',
                reason='other_model',
            )
        first = int(self.model.numeric_adr[place])
        values = self.model.numeric_data[first : first + int(self.model.numeric_size[place])]
        return freeze(np.array(values))

    def _joint(self, name: str) -> int:
        """Return the index of a hinge."""
        kind = self.mujoco.mjtObj.mjOBJ_JOINT
        place = int(self.mujoco.mj_name2id(self.model, kind, self.prefix + name))
        if place < 0:
            raise RequestError(
                f'the MuJoCo model has no joint {self.prefix + name!r}', reason='other_model'
            )
        return place

    @property
    def pressure_range(self) -> tuple[float, float]:
        """Range of pressure (Pa, gauge) for which the finger is defined."""
        return float(self._pressure[0]), float(self._pressure[-1])

    @property
    def angles(self) -> Array:
        """Angles of the hinges (hinges,) rad."""
        return freeze(np.array(self.data.qpos[self._qpos]))

    def springs_at(self, pressure: float) -> tuple[Array, Array]:
        """Return stiffness (N m/rad) and rest angle (rad) of every hinge (hinges,) at a pressure.

        pressure: Pa, gauge, in the chamber. Raises RequestError outside `pressure_range`.
        """
        low, high = self.pressure_range
        if not low <= pressure <= high:
            raise RequestError(
                f'the finger is defined from {low:g} to {high:g} Pa, not at {pressure:g} Pa',
                reason='out_of_bounds',
            )
        rows = self._pressure
        row = min(int(np.searchsorted(rows, pressure, side='right')) - 1, rows.size - 2)
        above = (pressure - rows[row]) / (rows[row + 1] - rows[row])
        stiffness, rest = (
            freeze((1.0 - above) * table[row] + above * table[row + 1])
            for table in (self._stiffness, self._rest)
        )
        return stiffness, rest

    def set_pressure(self, pressure: float) -> None:
        """Set springs and damping of all hinges for a chamber pressure (Pa, gauge).

        Call it whenever the pressure changes, before `mj_step`. Raises RequestError outside
        `pressure_range`.
        """
        stiffness, rest = self.springs_at(pressure)
        bend = self.data.qpos[self._qpos] - rest
        tangent = stiffness * (1.0 + 3.0 * self._cubic * bend**2)
        self.model.jnt_stiffness[self._joints] = stiffness
        self.model.jnt_stiffnesspoly[self._joints, 1] = stiffness * self._cubic
        self.model.qpos_spring[self._qpos] = rest
        self.model.dof_damping[self._dof] = self._damping_beyond_integrator() * tangent

    def _damping_beyond_integrator(self) -> float:
        """Return the damping time (s) that the hinges need in addition to that of the integrator.

        The integrator `discrete` steps with M + h D + h^2 K, which damps like a damping time of h.
        """
        option = self.model.opt
        if option.integrator != self.mujoco.mjtIntegrator.mjINT_DISCRETE:
            return self._damping_time
        return max(self._damping_time - float(option.timestep), 0.0)

    def put_at_rest(self, pressure: float) -> None:
        """Put the finger at rest in its unloaded shape at a pressure (Pa, gauge)."""
        _, rest = self.springs_at(pressure)
        self.data.qpos[self._qpos], self.data.qvel[self._dof] = rest, 0.0
        self.set_pressure(pressure)
        self.mujoco.mj_forward(self.model, self.data)
