"""The rest shape of a MuJoCo finger, computed without simulating transients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.mujoco.library import load_mujoco

STEP = 1e-6  # rad, of finite differences
SETTLED = 1e-11  # rad, of the last Newton step; convergence is quadratic
MOST_STEPS = 100
LONGEST_STEP = 0.03  # rad per hinge: a finger of 56 links turns by at most 1.7 rad per step


def come_to_rest(model: Any, data: Any, apply_loads: Callable[[], None]) -> None:
    """Move all joints to equilibrium of the MuJoCo forces by Newton's method, at rest.

    apply_loads: sets `data.qfrc_applied` and `data.xfrc_applied` at the positions in `data`.
    Contacts are ignored. Raises RequestError if no equilibrium is found.
    """
    mujoco = load_mujoco()

    def unbalanced(qpos: Array) -> Array:
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        apply_loads()
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        return np.array(data.qfrc_smooth)

    data.qvel[:] = 0.0
    qpos = np.array(data.qpos)
    for _ in range(MOST_STEPS):
        force = unbalanced(qpos)
        slope = np.empty((model.nv, model.nv))
        for joint, offset in enumerate(np.eye(model.nv) * STEP):
            slope[:, joint] = (unbalanced(qpos + offset) - unbalanced(qpos - offset)) / (
                2.0 * STEP
            )
        step = towards_rest(slope, force)
        largest = float(np.abs(step).max())
        qpos = qpos + step * min(1.0, LONGEST_STEP / max(largest, 1e-300))
        if largest < SETTLED:
            unbalanced(qpos)
            return
    raise RequestError(
        'no equilibrium of the MuJoCo finger was found: use smaller loads', reason='no_equilibrium'
    )


def towards_rest(slope: Array, force: Array) -> Array:
    """Return the Newton step (joints,) rad, or a downhill step if the energy is not convex.

    slope (joints, joints) of the unbalanced force (joints,). The downhill step uses the absolute
    eigenvalues (saddle-free Newton, Dauphin et al. 2014).
    """
    values, vectors = np.linalg.eigh(-0.5 * (slope + slope.T))
    if values[0] > 0.0:
        return np.asarray(np.linalg.solve(slope, -force))
    return np.asarray(vectors @ ((vectors.T @ force) / np.abs(values)))
