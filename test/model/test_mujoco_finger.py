"""The finger in MuJoCo: at rest as the rod, in motion as the beam of the textbooks."""

from __future__ import annotations

import dataclasses
import itertools
import json
import sys

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.stiffening import Stiffening
from pneunet_ros.model import gravity as plane
from pneunet_ros.model.hinge_chain import hinge_chain
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.mujoco import Finger
from pneunet_ros.mujoco.equilibrium import come_to_rest
from pneunet_ros.mujoco.hinge_chain import mjcf
from pneunet_ros.mujoco.library import load_mujoco
import pytest
from support.refusals import refused

mujoco = pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")
TIP_GOAL = 0.05e-3  # m


def paper_arm():
    return load_model(share_path('config/paper_arm.yaml'))


def started(arm, *, tip_mass=0.0, **options):
    arm = dataclasses.replace(arm, motion=Motion(tip_mass=tip_mass))
    text = mjcf(hinge_chain(arm, **{'damping_time': 0.03} | options))
    model = mujoco.MjModel.from_xml_string(text)
    return Finger(model, mujoco.MjData(model))


def tip_at_rest(finger, pressure, force=(0.0, 0.0), moment=0.0):
    model, data = finger.model, finger.data
    tip = model.site('tip').id

    def load():
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(
            model,
            data,
            np.array([*force, 0.0]),
            np.array([0.0, 0.0, moment]),
            data.site_xpos[tip],
            model.site_bodyid[tip],
            data.qfrc_applied,
        )

    finger.put_at_rest(pressure)
    come_to_rest(model, data, load)
    return data.site_xpos[tip, :2].copy()


LOADS = (
    (0.0, (0.1, 0.02), 0.0),
    (17.2e3, (0.0, 0.0), 0.0),
    (37.1e3, (0.16, 0.1), 0.0),
    (66e3, (0.15, 0.275), 0.0),
    (30e3, (0.05, -0.03), -1e-3),
)


@pytest.mark.parametrize(
    'effects',
    [
        (),
        (Gravity(weight_x=0.4, weight_y=-0.9),),
        (ClampCompliance(compliance=8.0),),
        (Stiffening(coefficient=2e-4),),
    ],
    ids=['plain', 'gravity', 'clamp', 'stiffening'],
)
def test_at_rest_it_stands_where_the_rod_does(effects):
    arm = dataclasses.replace(paper_arm(), effects=effects)
    finger = started(arm)
    for pressure, force, moment in LOADS:
        shape = solve(arm, pressure=pressure, force=force, moment=moment)
        assert shape.converged
        tip = tip_at_rest(finger, pressure, force, moment)
        assert np.hypot(*(tip - shape.tip[:2])) < TIP_GOAL


def test_an_arm_that_hangs_with_a_mass_at_its_tip_stands_where_the_rod_does():
    arm = dataclasses.replace(
        paper_arm(), gravity=plane.Gravity(x=0.6, y=-0.8), motion=Motion(tip_mass=3e-3)
    )
    finger = started(arm, tip_mass=3e-3)
    for pressure, force, moment in LOADS[:3]:
        shape = solve(arm, pressure=pressure, force=force, moment=moment)
        tip = tip_at_rest(finger, pressure, force, moment)
        assert np.hypot(*(tip - shape.tip[:2])) < TIP_GOAL
    pulled = dataclasses.replace(arm, effects=(Gravity(weight_y=0.1),))
    with refused(RequestError, 'not_for_mujoco'):
        hinge_chain(pulled, damping_time=0.03)


def test_targets_and_a_rigid_cap_stand_where_the_rod_has_them():
    arm = paper_arm()
    targets = np.append(arm.target_arclength, 0.1165)
    arm = dataclasses.replace(arm, tip_cap=0.006, target_arclength=targets, clamp_angle=0.2)
    finger = started(arm)
    shape = solve(arm, pressure=40e3, force=(0.1, 0.1))
    tip = tip_at_rest(finger, 40e3, (0.1, 0.1))
    assert np.hypot(*(tip - shape.tip[:2])) < TIP_GOAL
    seen = [finger.data.site(f'target_{index}').xpos[:2] for index in range(targets.size)]
    expected = np.column_stack(
        [np.interp(targets, shape.arclength, line) for line in (shape.x, shape.y)]
    )
    assert np.abs(np.array(seen) - expected).max() < 0.1e-3


@pytest.mark.parametrize('tip_mass', [0.0, 5e-3])
def test_its_first_mode_is_that_of_a_cantilever(tip_mass):
    stiffness = 1.2e-4
    arm = dataclasses.replace(
        paper_arm(), moment_law=LinearLaw(bending_stiffness=stiffness), effects=()
    )
    finger = started(arm, tip_mass=tip_mass)
    finger.put_at_rest(0.0)
    model, data = finger.model, finger.data
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    found = np.sqrt(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(model.jnt_stiffness))))
    mass = arm.weight / STANDARD_GRAVITY
    # Roots of 1 + cos cosh = (tip mass / mass) beta (sin cosh - cos sinh), Blevins, table 8-8.
    roots = {0.0: 1.875104, 5e-3 / mass: cantilever_root(5e-3 / mass)}
    expected = roots[tip_mass / mass] ** 2 * np.sqrt(stiffness / (mass * arm.length**3))
    assert np.min(found.real) == pytest.approx(expected, rel=2e-3)


def cantilever_root(ratio):
    beta = np.linspace(0.5, 1.9, 200001)
    left = 1.0 + np.cos(beta) * np.cosh(beta)
    left -= ratio * beta * (np.sin(beta) * np.cosh(beta) - np.cos(beta) * np.sinh(beta))
    return beta[np.argmin(np.abs(left))]


def test_a_free_decay_has_the_frequency_and_the_damping_of_the_beam():
    # Short and stiff, so that a quarter of a second holds several periods.
    arm = dataclasses.replace(
        paper_arm(), moment_law=LinearLaw(bending_stiffness=0.1), target_arclength=np.zeros(0)
    )
    omega = 1.875104**2 * np.sqrt(0.1 / (arm.weight / STANDARD_GRAVITY * arm.length**3))
    finger = started(arm, damping_time=2 * 0.1 / omega, links=14)
    finger.model.opt.timestep = 5e-5
    finger.set_pressure(0.0)
    start = 1e-3 * np.linspace(1.0, 0.0, 14)
    finger.data.qpos[:] = start
    seen = []
    for _ in range(6000):
        mujoco.mj_step(finger.model, finger.data)
        seen.append(finger.data.qpos.sum())
    seen = np.array(seen[500:])
    crossing = np.flatnonzero(np.diff(np.sign(seen)))
    half = np.diff(crossing).mean() * 5e-5
    assert np.pi / half == pytest.approx(omega * np.sqrt(1 - 0.1**2), rel=0.02)
    peaks = [np.abs(seen[a:b]).max() for a, b in itertools.pairwise(crossing[:5])]
    decrement = np.log(peaks[0] / peaks[-1]) / (len(peaks) - 1)
    assert decrement / np.hypot(np.pi, decrement) == pytest.approx(0.1, rel=0.05)


def test_fingers_attached_to_one_model_have_pressures_of_their_own():
    text = mjcf(hinge_chain(paper_arm(), damping_time=0.03, links=8))
    gripper = mujoco.MjSpec()
    alone = started(paper_arm(), links=8)
    gripper.option.timestep = alone.model.opt.timestep
    gripper.option.integrator = alone.model.opt.integrator
    gripper.option.gravity = alone.model.opt.gravity
    for index in range(2):
        frame = gripper.worldbody.add_frame(pos=[0.0, 0.05 * index, 0.0])
        frame.attach_body(mujoco.MjSpec.from_string(text).body('base'), f'finger{index}_', '')
    model = gripper.compile()
    data = mujoco.MjData(model)
    fingers = [Finger(model, data, f'finger{index}_') for index in range(2)]
    fingers[0].put_at_rest(10e3)
    fingers[1].put_at_rest(50e3)
    for index, pressure in enumerate((10e3, 50e3)):
        alone.put_at_rest(pressure)
        tip = data.site(f'finger{index}_tip').xpos - [0.0, 0.05 * index, 0.0]
        assert np.allclose(tip, alone.data.site('tip').xpos, atol=1e-12)


def test_a_finger_touches_what_is_in_its_way():
    text = mjcf(hinge_chain(paper_arm(), damping_time=0.03, links=8))
    peg = '<geom name="peg" type="cylinder" size="0.01 0.05" pos="0.06 0.03 0"/></worldbody>'
    model = mujoco.MjModel.from_xml_string(text.replace('</worldbody>', peg))
    finger = Finger(model, mujoco.MjData(model))
    finger.put_at_rest(0.0)
    assert finger.data.ncon == 0
    finger.put_at_rest(40e3)
    assert finger.data.ncon > 0


def test_a_finger_of_a_centimeter_and_one_of_a_meter_are_models_of_mujoco():
    for length, weight in ((0.01, 1e-3), (1.0, 12.0)):
        arm = dataclasses.replace(
            paper_arm(), length=length, weight=weight, target_arclength=np.zeros(0), domain=None
        )
        finger = started(arm, tip_mass=1e-6)
        assert finger.model.body_mass.sum() == pytest.approx(weight / STANDARD_GRAVITY + 1e-6)


def test_what_it_cannot_carry_is_refused():
    stretching = dataclasses.replace(paper_arm(), effects=(Extensibility(axial_stiffness=20.0),))
    with refused(RequestError, 'not_for_mujoco'):
        hinge_chain(stretching, damping_time=0.03)
    law = paper_arm().moment_law
    offset = dataclasses.replace(law, moment_offset=np.full_like(law.moment_offset, -0.06))
    bent = dataclasses.replace(paper_arm(), moment_law=offset)
    hinge_chain(bent, damping_time=0.03)
    stiffening = dataclasses.replace(bent, effects=(Stiffening(coefficient=1e-3),))
    with refused(RequestError, 'not_for_mujoco'):
        hinge_chain(stiffening, damping_time=0.03)
    finger = started(paper_arm(), links=8)
    for pressure in (-10e3, 80e3, float('nan')):
        with refused(RequestError, 'out_of_bounds'):
            finger.set_pressure(pressure)
    with refused(RequestError, 'other_model'):
        Finger(finger.model, finger.data, 'left_')


def test_without_mujoco_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    with refused(RequestError, 'not_installed'):
        load_mujoco()


def test_the_verb_writes_a_file_that_mujoco_loads(tmp_path, capsys):
    output = tmp_path / 'finger.xml'
    command = ['mjcf', '--output', str(output), '--links', '20', '--json']
    assert main(command) == 0
    said = json.loads(capsys.readouterr().out)
    model = mujoco.MjModel.from_xml_path(str(output))
    assert said['hinges'] == model.njnt == 20
    # The half link at the clamp is fixed, and weighs as well.
    assert model.body_mass.sum() == pytest.approx(said['mass'], rel=1e-9)
    assert said['mass'] == pytest.approx(0.17 / STANDARD_GRAVITY)
    assert main([*command[:3], '--links', '1', '--overwrite']) == 2
