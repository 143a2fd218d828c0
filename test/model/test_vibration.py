"""Vibrations of an arm: beams, columns, hanging chains, and a finger in MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.vibration import LINKS, links_at, masses_of, vibration
from pneunet_ros.solver.links import stiffness_matrix
from pneunet_ros.solver.modes import modes_of
import pytest
from scipy.optimize import brentq
from support.example_arms import LENGTH, paper_arm
from support.refusals import refused

WEIGHT, STIFFNESS = 0.17, 4e-4
MASS = WEIGHT / STANDARD_GRAVITY


def beam(stiffness: float = STIFFNESS, gravity: object = 'out_of_plane', **motion: float) -> Arm:
    """Return a straight arm of one stiffness (N m^2)."""
    return replace(
        paper_arm(),
        moment_law=LinearLaw(bending_stiffness=stiffness),
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0, 6e4], arclength=[0.0, 0.5, 1.0], curvature=[[0.0] * 3] * 2
        ),
        gravity=gravity_of(gravity),
        motion=Motion(**motion),
        covariance=None,
        domain=None,
    )


def test_a_beam_has_the_frequencies_of_euler_and_bernoulli():
    arm = beam(damping_time=0.02)
    modes = vibration(arm, solve(arm, 0.0), count=2)
    wanted = np.square([1.8751, 4.6941]) * np.sqrt(STIFFNESS / (MASS * LENGTH**3))
    assert modes.frequency == pytest.approx(wanted, rel=5e-3)
    assert modes.frequency[0] == pytest.approx(wanted[0], rel=1e-3)
    assert modes.damping == pytest.approx(0.02 * modes.frequency**2, rel=1e-9)
    assert modes.decay_time == pytest.approx(2.0 / modes.damping[0])


def test_a_heavy_tip_is_a_mass_on_a_spring():
    tip = 100.0 * MASS
    arm = beam(tip_mass=tip)
    (found,) = vibration(arm, solve(arm, 0.0), count=1).frequency
    wanted = np.sqrt(3.0 * STIFFNESS / (LENGTH**3 * (tip + 33.0 / 140.0 * MASS)))
    assert found == pytest.approx(wanted, rel=2e-3)


def column_frequency(push: float) -> float:
    """Return the first frequency (rad/s) of a clamped column under a dead push (N) at its end.

    y = cos a s - cosh b s + c (sin a s - a / b sinh b s), without moment and cross force at s = l.
    """
    line = MASS / LENGTH

    def end(frequency: float) -> float:
        root = np.sqrt(push**2 + 4.0 * STIFFNESS * line * frequency**2)
        a, b = (np.sqrt((root + sign * push) / (2.0 * STIFFNESS)) for sign in (1.0, -1.0))
        x, z = a * LENGTH, b * LENGTH
        moment = [a**2 * np.cos(x) + b**2 * np.cosh(z), a**2 * np.sin(x) + a * b * np.sinh(z)]
        slope = [-a * np.sin(x) - b * np.sinh(z), a * (np.cos(x) - np.cosh(z))]
        third = [a**3 * np.sin(x) - b**3 * np.sinh(z), -(a**3) * np.cos(x) - a * b**2 * np.cosh(z)]
        cross = [STIFFNESS * three + push * one for three, one in zip(third, slope, strict=True)]
        return float(moment[0] * cross[1] - moment[1] * cross[0])

    return float(brentq(end, 1.0, 1.5 * 3.516 * np.sqrt(STIFFNESS / (MASS * LENGTH**3))))


def test_a_column_loses_its_frequency_where_it_buckles():
    arm, least = beam(), np.pi**2 * STIFFNESS / (4.0 * LENGTH**2)
    for share in (0.3, 0.9, 0.99):
        pushed = solve(arm, 0.0, force=(-share * least, 0.0))
        found = vibration(arm, pushed).frequency[0]
        assert found == pytest.approx(column_frequency(share * least), rel=2e-3 / (1.0 - share))
    straight = links_at(solve(arm, 0.0).solution)
    beyond = straight._replace(force=np.tile([-1.1 * least, 0.0], (straight.length.size, 1)))
    assert np.linalg.eigvalsh(stiffness_matrix(beyond))[0] < 0.0
    assert modes_of(beyond, masses_of(arm), 0.0, 1) is None


def test_a_limp_arm_that_hangs_is_a_chain_and_with_a_weight_a_pendulum():
    chain = beam(1e-7, [1.0, 0.0])
    (found,) = vibration(chain, solve(chain, 0.0), count=1).frequency
    assert found == pytest.approx(1.2024 * np.sqrt(STANDARD_GRAVITY / LENGTH), rel=0.02)
    pendulum = beam(1e-7, [1.0, 0.0], tip_mass=300.0 * MASS)
    (found,) = vibration(pendulum, solve(pendulum, 0.0), count=1).frequency
    assert found == pytest.approx(np.sqrt(STANDARD_GRAVITY / LENGTH), rel=5e-3)


def test_a_clamp_that_gives_makes_it_slower():
    # A rigid bar on a spring: frequency^2 = 1 / (compliance I), I = m l^2 / 3
    compliance = 50.0
    arm = replace(beam(10.0), effects=(ClampCompliance(compliance=compliance),))
    (found,) = vibration(arm, solve(arm, 0.0), count=1).frequency
    assert found == pytest.approx(np.sqrt(3.0 / (compliance * MASS * LENGTH**2)), rel=1e-2)


def test_the_weight_of_a_cap_is_that_of_the_soft_part_alone():
    arm = replace(beam(tip_mass=0.003), tip_cap=0.02)
    masses = masses_of(arm)
    assert masses.mass.sum() + masses.tip == pytest.approx(MASS + 0.003)
    assert masses.mass[-3:] == pytest.approx(0.0)


def capped_frequency(cap: float, tip: float) -> float:
    """Return the first frequency (rad/s) of a beam with a tip (kg) at the end of a cap (m).

    The cap is stiff and has no mass: the inertia of the tip is a force and a moment at the end of
    the beam y = cosh z - cos z + c (sinh z - sin z), z = k s.
    """

    def end(wave: float) -> float:
        z = wave * LENGTH
        cosh, cos, sinh, sin = np.cosh(z), np.cos(z), np.sinh(z), np.sin(z)
        even = (cosh - cos, sinh + sin, cosh + cos, sinh - sin)  # with its derivatives by z
        conditions = []
        for part in (even, (even[3], *even[:3])):
            value, slope, second, third = np.array(part) * wave ** np.arange(4.0)
            inertia = tip * wave**4 * LENGTH / MASS * (value + cap * slope)
            conditions.append((second - cap * inertia, third + inertia))
        (moment, cross), (moment_c, cross_c) = conditions
        return float(moment * cross_c - moment_c * cross)

    wave = float(brentq(end, 0.3 / LENGTH, 1.9 / LENGTH))
    return wave**2 * float(np.sqrt(STIFFNESS * LENGTH / MASS))


@pytest.mark.parametrize('tip', [0.0, 0.004])
@pytest.mark.parametrize('cap', [0.01, 0.012, 0.03])
def test_a_cap_is_a_lever_without_mass(cap, tip):
    arm = replace(beam(tip_mass=tip), tip_cap=cap)
    modes = vibration(arm, solve(arm, 0.0), count=2)
    assert modes.frequency[0] == pytest.approx(capped_frequency(cap, tip), rel=3e-3)
    assert modes.shape[:, -1] == pytest.approx(modes.shape[:, -2], rel=1e-6)
    with refused(RequestError, 'out_of_bounds'):
        vibration(arm, solve(arm, 0.0), count=LINKS)


def test_what_cannot_vibrate_is_refused():
    arm = beam()
    with refused(RequestError, 'out_of_bounds'):
        vibration(arm, solve(arm, 0.0), count=0)
    with refused(RequestError, 'no_equilibrium'):
        vibration(arm, solve(arm, 1e6))


@pytest.mark.parametrize(('pressure', 'gravity'), [(0.0, [1.0, 0.0]), (45e3, 'out_of_plane')])
def test_mujoco_has_the_same_first_mode(pressure, gravity):
    mujoco = pytest.importorskip('mujoco', reason="no MuJoCo here: pip install '.[mujoco]'")
    from pneunet_ros.model.hinge_chain import hinge_chain
    from pneunet_ros.mujoco.equilibrium import come_to_rest
    from pneunet_ros.mujoco.finger import Finger
    from pneunet_ros.mujoco.hinge_chain import mjcf

    damping_time = 1e-3
    motion = Motion(tip_mass=0.002, damping_time=damping_time)
    arm = replace(paper_arm(), gravity=gravity_of(gravity), motion=motion)
    shape = solve(arm, pressure)
    modes = vibration(arm, shape)
    model = mujoco.MjModel.from_xml_string(mjcf(hinge_chain(arm, damping_time=damping_time)))
    data = mujoco.MjData(model)
    finger = Finger(model, data)
    finger.put_at_rest(pressure)
    come_to_rest(model, data, lambda: None)
    still = data.qpos.copy()
    data.qpos[:] += 1e-5 * np.interp(
        np.arange(still.size) / still.size,
        np.arange(LINKS) / LINKS,
        np.diff(modes.shape[0], prepend=0.0),
    )
    seconds, turned = model.opt.timestep, []
    for _ in range(round(3.5 * np.pi / modes.frequency[0] / seconds)):
        mujoco.mj_step(model, data)
        turned.append(float((data.qpos - still).sum()))
    turned = np.array(turned)
    (zeros,) = np.nonzero(turned[:-1] * turned[1:] < 0.0)
    exact = zeros - turned[zeros] / (turned[zeros + 1] - turned[zeros])
    period = seconds * (exact[2] - exact[0])
    assert 1.0 / period == pytest.approx(modes.hertz, rel=0.01)
