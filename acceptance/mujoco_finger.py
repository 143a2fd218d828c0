"""Comparison of the MJCF of `pneunet mjcf` with `solve` at rest, and with the modes of a rod.

    python acceptance/mujoco_finger.py [--model FILE] [--json]

At rest: every load of the hull of the domain, at 0, 1/3, 2/3 and all of it, at its own pressure
and at the pressures of the moment law. The first mode of the unloaded finger at five pressures:
MuJoCo's mass matrix and springs beside a rod of 2000 points, in Legendre polynomials of its angle
(Rayleigh-Ritz), which shares nothing with the chain of hinges. Exit code 1 where a goal is missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import mujoco
import numpy as np
from numpy.polynomial import legendre
from pneunet_ros import load_model, solve
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.model.hinge_chain import hinge_chain
from pneunet_ros.model.motion import Motion
from pneunet_ros.mujoco import Finger
from pneunet_ros.mujoco.equilibrium import come_to_rest
from pneunet_ros.mujoco.hinge_chain import mjcf

GOAL, MODE_GOAL = 0.05e-3, 0.02  # m, relative
POINTS, POLYNOMIALS = 2000, 16
TIP_MASS = 5e-3  # kg


def finger_of(arm, links=56):
    """Return the arm in MuJoCo."""
    text = mjcf(hinge_chain(arm, damping_time=0.03, links=links))
    model = mujoco.MjModel.from_xml_string(text)
    return Finger(model, mujoco.MjData(model))


def tip_at_rest(finger, pressure, force):
    """Return the tip (2,) m under an end force (2,) N."""
    model, data, tip = finger.model, finger.data, finger.model.site('tip').id

    def load():
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(
            model, data, np.array([*force, 0.0]), np.zeros(3), data.site_xpos[tip],
            model.site_bodyid[tip], data.qfrc_applied,
        )  # fmt: skip

    finger.put_at_rest(pressure)
    come_to_rest(model, data, load)
    return data.site_xpos[tip, :2].copy()


def at_rest(arm, finger):
    """Return distances (m) of tips, and how many of them there are."""
    off = []
    for force_x, force_y, _, own in arm.domain.end_load:
        pressures = {own, *arm.moment_law.table_pressures[:1], *arm.domain.pressure}
        for pressure in pressures:
            for share in (0.0, 1 / 3, 2 / 3, 1.0):
                force = share * force_x, share * force_y
                shape = solve(arm, pressure=float(pressure), force=force)
                if shape.converged and shape.stable:
                    tip = tip_at_rest(finger, float(pressure), force)
                    off.append(np.hypot(*(tip - shape.tip[:2])))
    return np.array(off)


def mode_of_hinges(finger, pressure):
    """Return the first frequency (Hz) of MuJoCo's unloaded finger."""
    finger.put_at_rest(pressure)
    model, inertia = finger.model, np.zeros((finger.model.nv, finger.model.nv))
    mujoco.mj_fullM(model, finger.data, inertia)
    squared = np.linalg.eigvals(np.linalg.solve(inertia, np.diag(model.jnt_stiffness)))
    return float(np.sqrt(squared.real.min())) / (2.0 * np.pi)


def mode_of_rod(arm, pressure):
    """Return the first frequency (Hz) of the unloaded rod by Rayleigh-Ritz."""
    shape = solve(arm, pressure=pressure, force=(0.0, 0.0))
    edges = np.linspace(0.0, arm.length, POINTS + 1)
    s, h = 0.5 * (edges[1:] + edges[:-1]), arm.length / POINTS
    theta = np.interp(s, shape.arclength, shape.theta)
    sections = arm.moment_law.sections(np.array([pressure]), arm.length, arm.weight)[0]
    part = np.searchsorted(sections[:, 0], s, side='right') - 1
    rigidity = sections[part, 1]
    u = 2.0 * s / arm.length - 1.0
    # The angle vanishes at the clamp: (1 + u) P_k(u).
    angle, bend = [], []
    for k in range(POLYNOMIALS):
        row = legendre.legmul([1.0, 1.0], np.eye(POLYNOMIALS)[k, : k + 1])
        angle.append(legendre.legval(u, row))
        bend.append(legendre.legval(u, legendre.legder(row)) * 2.0 / arm.length)
    angle, bend = np.array(angle), np.array(bend)
    way = [np.cumsum(angle * part, axis=1) * h for part in (-np.sin(theta), np.cos(theta))]
    density = arm.weight / STANDARD_GRAVITY / arm.length
    inertia = sum(density * h * (one @ one.T) for one in way)
    if arm.motion is not None:
        inertia += sum(arm.motion.tip_mass * np.outer(one[:, -1], one[:, -1]) for one in way)
    stiffness = (bend * rigidity * h) @ bend.T
    squared = np.linalg.eigvals(np.linalg.solve(inertia, stiffness))
    return float(np.sqrt(squared.real.min())) / (2.0 * np.pi)


def main() -> int:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--model', type=Path, default=share_path('config/paper_arm.yaml'))
    command.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = command.parse_args()
    arm = load_model(arguments.model)
    found = {'links': [], 'modes': []}
    for links in (14, 28, 56, 112):
        off = at_rest(arm, finger_of(arm, links))
        row = {'links': links, 'loads': off.size, 'median': np.median(off), 'max': off.max()}
        found['links'].append(row)
    for tip_mass in (0.0, TIP_MASS):
        heavy = dataclasses.replace(arm, motion=Motion(tip_mass=tip_mass))
        finger = finger_of(heavy)
        for pressure in np.linspace(*arm.domain.pressure, 5):
            hinges, rod = mode_of_hinges(finger, pressure), mode_of_rod(heavy, pressure)
            row = {'tip_mass': tip_mass, 'pressure': pressure, 'hinges': hinges, 'rod': rod}
            found['modes'].append(row)
    if arguments.json:
        print(json.dumps(found, default=float))
    else:
        show(found)
    worst = next(row['max'] for row in found['links'] if row['links'] == 56)
    off = max(abs(row['hinges'] / row['rod'] - 1.0) for row in found['modes'])
    return int(worst > GOAL or off > MODE_GOAL)


def show(found) -> None:
    """Print the tables of docs/mujoco.md."""
    print('| links | loads | tip, median | tip, largest |\n|---|---|---|---|')
    for row in found['links']:
        median, largest = (f'{1e3 * row[name]:.4f} mm' for name in ('median', 'max'))
        print(f'| {row["links"]} | {row["loads"]} | {median} | {largest} |')
    print('\n| mass at the tip | pressure | f1 in MuJoCo | f1 of the rod | off |')
    print('|---|---|---|---|---|')
    for row in found['modes']:
        off = 100.0 * (row['hinges'] / row['rod'] - 1.0)
        print(
            f'| {1e3 * row["tip_mass"]:g} g | {1e-3 * row["pressure"]:g} kPa | '
            f'{row["hinges"]:.4f} Hz | {row["rod"]:.4f} Hz | {off:+.2f} % |'
        )


if __name__ == '__main__':
    raise SystemExit(main())
