"""An arm as a chain of hinges for MuJoCo; each hinge bends like its part of the rod."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.model.arm import Arm
from pneunet_ros.mujoco.hinge_chain import HingeChain, LINKS
from pneunet_ros.solver.columns import (
    AXIAL_COMPLIANCE,
    CLAMP_ANGLE,
    CLAMP_COMPLIANCE,
    CUBIC,
    END_X,
    END_Y,
    LOAD_OFFSET,
    LOAD_X,
    LOAD_Y,
    MOMENT_OFFSET,
    REST_STRAIN,
    RIGIDITY,
    START,
)
from pneunet_ros.solver.rod import Rods

# Between the rows of the tables the laws are linear in pressure, but 1/B and l1 within a hinge are
# not: with this many rows the interpolation error is below 1 um at the tip.
ROWS = 64
SLENDER = 1.0 / 16.0  # radius of the capsules / length: a finger of 112 mm is 14 mm thick


def hinge_chain(
    arm: Arm, *, damping_time: float, radius: float | None = None, links: int = LINKS
) -> HingeChain:
    """Return an arm as a chain of hinges with its masses, springs and damping.

    damping_time: s, damping over stiffness of a hinge (Kelvin-Voigt); radius: m, of the capsules,
    by default a sixteenth of the length; links: their number. Sensor effects are not part of the
    finger, and effects with a history are in their rest state. Raises RequestError if the arm has
    an effect that a chain of hinges cannot represent.
    """
    pressure = table_pressures(arm)
    rods = arm.rods(pressure)
    refuse_unsupported_loads(arm, rods)
    borders = np.linspace(0.0, arm.length, links + 1)
    sections = section_overlaps(rods, borders)
    stretch_per_moment = sections / rods.sections[:, None, :, RIGIDITY]
    compliance = stretch_per_moment.sum(axis=2)
    offset = (stretch_per_moment * rods.sections[:, None, :, MOMENT_OFFSET]).sum(axis=2)
    rest = np.diff(rotation_at(rods, borders), axis=1) - offset
    cubic = rods.sections[0, 0, CUBIC] / np.diff(borders) ** 2
    hinge = 0.5 * (borders[:-1] + borders[1:])
    clamp = rods.clamp[:, CLAMP_COMPLIANCE : CLAMP_COMPLIANCE + 1]
    if clamp.any():
        compliance = np.concatenate([clamp, compliance], axis=1)
        rest = np.concatenate([np.zeros_like(clamp), rest], axis=1)
        cubic, hinge = np.append(0.0, cubic), np.append(0.0, hinge)
    mass = arm.weight / STANDARD_GRAVITY
    return HingeChain(
        name=arm.name,
        length=arm.length,
        tip_cap=arm.tip_cap,
        clamp_angle=float(rods.clamp[0, CLAMP_ANGLE]),
        mass=mass,
        tip_mass=0.0 if arm.inertia is None else arm.inertia.tip_mass,
        damping_time=damping_time,
        radius=arm.length * SLENDER if radius is None else radius,
        hinge=hinge,
        pressure=pressure,
        stiffness=1.0 / compliance,
        rest=rest,
        cubic=cubic,
        target=arm.target_arclength,
        gravity=gravity_of(arm, rods),
    )


def table_pressures(arm: Arm) -> Array:
    """Return the pressures of the arm's tables, and `ROWS` steps between the first and last."""
    rows = arm.table.pressure
    return freeze(np.union1d(rows, np.linspace(rows[0], rows[-1], ROWS + 1)))


def refuse_unsupported_loads(arm: Arm, rods: Rods) -> None:
    """Raise RequestError if the rod stretches, or has loads that hinges cannot represent."""
    soft = rods.sections[:, : rods.sections.shape[1] - bool(arm.tip_cap)]
    everywhere = soft[:, :, [LOAD_X, LOAD_Y, CUBIC]]
    refused = {
        'stretches': soft[:, :, [AXIAL_COMPLIANCE, REST_STRAIN]].any(),
        'is pushed at a place': bool(rods.push.any()),
        'is loaded at an offset from its tip': rods.clamp[:, LOAD_OFFSET].any(),
        'changes with its end load': bool(arm.by_load),
        'stiffens, and has a moment offset': (
            soft[:, :, CUBIC].any() and soft[:, :, MOMENT_OFFSET].any()
        ),
        'has a weight or a stiffening that is not uniform along the arm': (
            not np.allclose(everywhere, everywhere[0, 0], rtol=1e-9, atol=0.0)
        ),
        'has a clamp whose heading depends on the pressure': (
            np.ptp(rods.clamp[:, CLAMP_ANGLE]) > 0.0
        ),
    }
    for what, found in refused.items():
        if found:
            names = ', '.join(effect.name for effect in arm.effects if not effect.is_neutral)
            raise RequestError(
                f'{arm.name} {what}, which a chain of hinges cannot represent: remove the effect '
                f'from the model file (its effects: {names})',
                reason='not_for_mujoco',
            )


def gravity_of(arm: Arm, rods: Rods) -> Array:
    """Return the in-plane gravity (2,) m/s^2 that produces the line load of the arm.

    Raises RequestError if it does not produce the weight of the tip mass.
    """
    load = rods.sections[0, 0, [LOAD_X, LOAD_Y]]
    gravity = load * arm.length * STANDARD_GRAVITY / arm.weight
    tip_mass = 0.0 if arm.inertia is None else arm.inertia.tip_mass
    if not np.allclose(tip_mass * gravity, rods.clamp[0, [END_X, END_Y]], rtol=1e-9):
        raise RequestError(
            f'{arm.name} has a mass at its tip, and an effect gravity in addition to its weight, '
            'but MuJoCo has one gravity for both: remove the effect, and give the direction of '
            'gravity (--gravity=0,-1)',
            reason='not_for_mujoco',
        )
    return freeze(gravity)


def section_overlaps(rods: Rods, borders: Array) -> Array:
    """Return the overlap (m) of every part between borders with every section.

    borders (parts + 1,) m; returns (pressures, parts, sections).
    """
    starts = rods.sections[:, None, :, START]
    after = np.full((*starts.shape[:2], 1), np.inf)
    stops = np.concatenate([starts[:, :, 1:], after], axis=2)
    low, high = borders[:-1, None], borders[1:, None]
    return np.asarray(np.clip(np.minimum(high, stops) - np.maximum(low, starts), 0.0, None))


def rotation_at(rods: Rods, places: Array) -> Array:
    """Return the angle (rad) of the unloaded rod at places (m), (pressures, places)."""
    last = rods.knots.size - 2
    piece = np.clip(np.searchsorted(rods.knots, places, side='right') - 1, 0, last)
    powers = (places - rods.knots[piece])[:, None] ** np.arange(float(rods.rotation.shape[2]))
    return np.asarray((rods.rotation[:, piece] * powers).sum(axis=2))
