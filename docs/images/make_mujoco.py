"""Make the pictures of the page "The finger in MuJoCo": three pressures, and a gripper.

    MUJOCO_GL=egl python docs/images/make_mujoco.py

EGL renders in software where there is no graphics card.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use('Agg')
from matplotlib import pyplot as plt
import mujoco
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.model.hinge_chain import hinge_chain
from pneunet_ros.mujoco import Finger
from pneunet_ros.mujoco.hinge_chain import mjcf

FOLDER = Path(__file__).resolve().parent
PRESSURES = 0.0, 30e3, 60e3  # Pa
FINGERS, APART = 3, 0.045  # m, of the clamps from the axis
WIDTH, HEIGHT = 640, 560  # px
CLOSED = 60e3  # Pa


def finger_text(radius: float = 0.006) -> str:
    """Return the MJCF of the shipped arm."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    return mjcf(hinge_chain(arm, damping_time=0.05, radius=radius))


def decorate(spec: mujoco.MjSpec) -> None:
    """Give a scene light, a pale background and room for a picture."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.5, 0.5, 0.5]
    sky = spec.add_texture(name='sky')
    sky.type = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
    sky.rgb1 = sky.rgb2 = [1.0, 1.0, 1.0]
    sky.width = sky.height = 8


def picture(model, data, look_at, distance, azimuth, elevation):
    """Return a rendered picture (height, width, 3)."""
    camera = mujoco.MjvCamera()
    camera.lookat[:] = look_at
    camera.distance, camera.azimuth, camera.elevation = distance, azimuth, elevation
    renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    renderer.update_scene(data, camera)
    return renderer.render()


def save(pictures, titles, name: str, rows: slice = slice(None)) -> None:
    """Put pictures side by side into a file."""
    figure, axes = plt.subplots(1, len(pictures), figsize=(3.2 * len(pictures), 3.2), dpi=110)
    for axis, shown, title in zip(axes, pictures, titles, strict=True):
        axis.imshow(shown[rows])
        axis.set_title(title, fontsize=10)
        axis.axis('off')
    figure.tight_layout(pad=0.4)
    figure.savefig(FOLDER / name, bbox_inches='tight', pad_inches=0.05)
    plt.close(figure)


def at_three_pressures() -> None:
    """Make the picture of one finger."""
    spec = mujoco.MjSpec.from_string(finger_text())
    decorate(spec)
    spec.visual.global_.fovy = 8.0  # deg: from far away, without perspective
    for body in spec.bodies:
        for site in body.sites:
            site.size, site.rgba = [0.0022] * 3, [0.1, 0.1, 0.1, 1.0]
            site.pos = np.add(site.pos, [0.0, 0.0, 0.0055])
    model = spec.compile()
    data = mujoco.MjData(model)
    finger, shown = Finger(model, data), []
    for pressure in PRESSURES:
        finger.put_at_rest(pressure)
        shown.append(picture(model, data, [0.052, 0.045, 0.0], 1.1, 90, -89.9))
    titles = [f'{1e-3 * pressure:g} kPa' for pressure in PRESSURES]
    save(shown, titles, 'mujoco_finger.png')


def gripper() -> tuple[mujoco.MjModel, mujoco.MjData, list[Finger]]:
    """Return three fingers that hang from a palm around a cylinder, which stands on a table."""
    hand = mujoco.MjSpec()
    decorate(hand)
    hand.option.timestep = 5e-4
    hand.option.gravity = [0.0, 0.0, -STANDARD_GRAVITY]
    hand.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    hand.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.3, 0.3, 0.01], rgba=[0.9, 0.9, 0.9, 1.0]
    )
    palm = hand.worldbody.add_body(name='palm', pos=[0.0, 0.0, 0.125])
    palm.add_joint(name='lift', type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    palm.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[APART + 0.008, 0.006], mass=0.2,
        pos=[0.0, 0.0, 0.006], rgba=[0.3, 0.3, 0.33, 1.0],
    )  # fmt: skip
    for index in range(FINGERS):
        around = 2.0 * np.pi * index / FINGERS
        # x of the finger points down, its y to the axis.
        toward = np.array([-np.cos(around), -np.sin(around), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        axes = np.column_stack([down, toward, np.cross(down, toward)])
        turned = np.zeros(4)
        mujoco.mju_mat2Quat(turned, axes.ravel())
        frame = palm.add_frame(pos=-APART * toward, quat=turned)
        finger = mujoco.MjSpec.from_string(finger_text())
        finger.option.timestep = hand.option.timestep
        frame.attach_body(finger.body('base'), f'finger{index}_', '')
    held = hand.worldbody.add_body(name='cylinder', pos=[0.0, 0.0, 0.035])
    held.add_freejoint()
    held.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.022, 0.035], mass=3e-3,
        friction=[1.0, 0.005, 1e-4], rgba=[0.85, 0.5, 0.25, 1.0],
    )  # fmt: skip
    model = hand.compile()
    data = mujoco.MjData(model)
    return model, data, [Finger(model, data, f'finger{index}_') for index in range(FINGERS)]


def closing() -> None:
    """Make the picture of a gripper that closes on a cylinder and lifts it."""
    model, data, fingers = gripper()
    lift = model.joint('lift')
    shown = []
    model.jnt_stiffness[lift.id], model.dof_damping[lift.dofadr[0]] = 2000.0, 40.0
    model.qpos_spring[lift.qposadr[0]] = 0.2 * STANDARD_GRAVITY / 2000.0
    for until, pressure, height in ((1.0, 0.0, 0.0), (3.0, CLOSED, 0.0), (5.0, CLOSED, 0.04)):
        begun, before = data.time, float(fingers[0].model.qpos_spring[lift.qposadr[0]])
        start = CLOSED if len(shown) == 2 else 0.0
        while data.time < until:
            share = min((data.time - begun) / 1.0, 1.0)
            for finger in fingers:
                finger.set_pressure(start + share * (pressure - start))
            model.qpos_spring[lift.qposadr[0]] = before + share * height
            mujoco.mj_step(model, data)
        shown.append(picture(model, data, [0.0, 0.0, 0.085], 0.38, 60, -12))
        print(until, data.body('cylinder').xpos, data.ncon)
    save(shown, ['open, 0 kPa', 'closed, 60 kPa', 'lifted'], 'mujoco_gripper.png')


if __name__ == '__main__':
    at_three_pressures()
    closing()
