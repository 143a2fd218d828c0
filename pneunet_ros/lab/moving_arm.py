"""The lab arm with mass, simulated by MuJoCo: a chain of hinges with the springs of the chain.

A hinge represents two elements of a `Chain`, so that effects act on both in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.lab.chain import Chain
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.mujoco.equilibrium import come_to_rest
from pneunet_ros.mujoco.hinge_chain import HingeChain, mjcf_tree
from pneunet_ros.mujoco.library import load_mujoco

BLOCK = 1000  # steps whose springs and loads are computed at once
DRIVE = 1e6  # inertia of the drive of the base, relative to that of the arm about the clamp

HOLD = 1e3  # N m/rad, of the base while the arm comes to rest; anything that is not a spring of it

ChainAt = Callable[[Array], Chain]
Swing = tuple[Array, Array]  # positions and rates of the joints of MuJoCo


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionTruth:
    """Motion of an arm with mass at every frame, in the base frame, SI.

    tip_velocity (frames, 3): m/s, m/s, rad/s. contact_force (frames, 2) N on the arm and
    contact_place (frames,) m along it, NaN where it does not touch the peg. base_angle (frames,)
    rad, base_rate (frames,) rad/s, specific_force (frames, 2) m/s^2 as read by an accelerometer at
    the clamp.
    """

    tip_velocity: Array
    contact_force: Array
    contact_place: Array
    base_angle: Array
    base_rate: Array
    specific_force: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingShape:
    """Headings (frames, links + 1) rad of the links of an arm; x, y (frames, links + 1) m.

    The positions are the link centers, every `link` (m) from the clamp; for the half links at the
    clamp and at the free end, they are the ends of the arm.
    """

    link: float
    length: float
    heading: Array
    x: Array = field(init=False)
    y: Array = field(init=False)

    def __post_init__(self) -> None:
        """Compute the positions of the links."""
        before = 0.5 * self.link * np.ones(self.heading.shape[1] - 1)
        for name, part in (('x', np.cos(self.heading)), ('y', np.sin(self.heading))):
            steps = before * (part[:, :-1] + part[:, 1:])
            start = np.zeros((len(steps), 1))
            object.__setattr__(
                self, name, frozen_array(np.concatenate([start, np.cumsum(steps, axis=1)], axis=1))
            )

    def points(self, arclength: npt.ArrayLike) -> tuple[Array, Array, Array]:
        """Return x, y (m) and theta (rad) at places along the arm (m), each (frames, places).

        The curve consists of cubics with the headings of the links; beyond the free end the arm is
        straight.
        """
        places = np.asarray(arclength, np.float64)
        s = np.minimum(places, self.length)
        row = np.clip((s / self.link).astype(np.int64), 0, self.heading.shape[1] - 2)
        u = s / self.link - row
        theta = (1.0 - u) * self.heading[:, row] + u * self.heading[:, row + 1]
        first, last = self.link * u * (1.0 - u) ** 2, self.link * u**2 * (u - 1.0)
        blend = u**2 * (3.0 - 2.0 * u)
        found = []
        for values, part in ((self.x, np.cos), (self.y, np.sin)):
            slope = part(self.heading)
            position = (1.0 - blend) * values[:, row] + blend * values[:, row + 1]
            position = position + first * slope[:, row] + last * slope[:, row + 1]
            found.append(freeze(position + (places - s) * part(theta)))
        return found[0], found[1], freeze(theta)

    def curvature(self, arclength: npt.ArrayLike) -> Array:
        """Return the curvature (1/m) at places (m), (frames, places); 0 on the cap."""
        positions = np.asarray(arclength, np.float64)
        middles = self.link * (np.arange(self.heading.shape[1] - 1) + 0.5)
        bend = np.diff(self.heading, axis=1) / self.link
        s = np.clip(positions, middles[0], middles[-1])
        row = np.clip(np.searchsorted(middles, s, side='right') - 1, 0, middles.size - 2)
        above = (s - middles[row]) / self.link
        curvature = (1.0 - above) * bend[:, row] + above * bend[:, row + 1]
        return freeze(np.where(positions > self.length, 0.0, curvature))


class Frame(NamedTuple):
    """An instant: angles (rad) and rates (rad/s) of clamp and hinges (links + 1,), and contact."""

    angles: Array
    rates: Array
    contact_force: Array
    contact_place: float


def moving_shape(
    arm: LabArm, motion: LabMotion, chain_at: ChainAt, times: Array, duration: float
) -> tuple[MovingShape, MotionTruth]:
    """Return the shapes and the motion, at times (frames,) s, of an arm that starts at rest.

    chain_at: returns the chain (two elements per hinge) at times (n,) s. Raises RequestError if
    MuJoCo is not installed, does not support part of the chain, or diverges.
    """
    run = Run(arm, motion, chain_at, duration)
    frames = list(run.frames(times))
    angles = np.array([frame.angles for frame in frames])
    rates = np.array([frame.rates for frame in frames])
    shape = MovingShape(
        link=run.link,
        length=arm.length,
        heading=freeze(arm.clamp_angle + np.cumsum(angles, axis=1)),
    )
    base_angle, rate, _ = run.base_at(times)
    return shape, MotionTruth(
        tip_velocity=tip_velocity(shape, np.cumsum(rates, axis=1), arm.tip_cap),
        contact_force=freeze(np.array([frame.contact_force for frame in frames])),
        contact_place=freeze(np.array([frame.contact_place for frame in frames])),
        base_angle=base_angle,
        base_rate=rate,
        specific_force=freeze(-motion.apparent_gravity(times, duration)[:, :2]),
    )


def tip_velocity(shape: MovingShape, spin: Array, cap: float) -> Array:
    """Return the velocity (frames, 3) of the tip: m/s, m/s in the base frame, rad/s.

    spin (frames, links + 1) rad/s of the links.
    """
    weight = np.full(spin.shape[1], shape.link)
    weight[[0, -1]] *= 0.5
    weight[-1] += cap
    normal_rates = -np.sin(shape.heading) * spin, np.cos(shape.heading) * spin
    return freeze(
        np.column_stack([normal_rates[0] @ weight, normal_rates[1] @ weight, spin[:, -1]])
    )


def rotated(vector: Array, angle: Array) -> Array:
    """Rotate a vector (2,) counter-clockwise by angles (n,) rad; returns (n, 2)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vector
    return freeze(np.column_stack([cosine * x - sine * y, sine * x + cosine * y]))


class Hinges:
    """Springs and loads of the hinges of a chain, at its instants.

    stiffness (n, hinges) N m/rad, rest (n, hinges) rad, cubic (hinges,) 1/rad^2: the first hinge
    is a compliant clamp, if there is one. weight (n, links + 1, 2) N: loads along the arm, one row
    per link.
    """

    def __init__(self, chain: Chain, links: int) -> None:
        """Combine the two chain elements of each hinge."""
        frames, joints = chain.turning.shape
        edges = np.clip(chain.element * (np.arange(joints + 1) - 0.5), 0.0, chain.length)
        before = np.clip(chain.split[:, None] - edges[:-1], 0.0, np.diff(edges))
        first, second = chain.rigidity[:, :1], chain.rigidity[:, 1:]
        bend = (before / first + (np.diff(edges) - before) / second) / chain.rigidity_factors
        compliance, rest = paired(bend), paired(chain.turning)
        cubic = np.full(links, chain.cubic * (links / chain.length) ** 2)
        if chain.clamp_compliance > 0.0:
            clamp = np.full((frames, 1), chain.clamp_compliance)
            compliance = np.concatenate([clamp, compliance], axis=1)
            rest = np.concatenate([np.zeros((frames, 1)), rest], axis=1)
            cubic = np.append(0.0, cubic)
        self.stiffness, self.rest, self.cubic = 1.0 / compliance, rest, cubic
        borders = 0.5 * (chain.line[:, :-1:2] + chain.line[:, 1::2])
        clamped = 1.5 * chain.line[:, :1] - 0.5 * chain.line[:, 1:2]
        free = np.zeros_like(clamped)
        self.weight = -np.diff(np.concatenate([clamped, borders, free], axis=1), axis=1)


def paired(joints: Array) -> Array:
    """Sum the contributions of joints (n, 2 links + 1) to each hinge, (n, links).

    A hinge represents its own joint and half of each neighboring joint; at the clamp and at the
    free end, the whole neighboring joint.
    """
    shared = joints[:, ::2].copy()
    shared[:, 1:-1] *= 0.5
    result: Array = joints[:, 1::2] + shared[:, :-1] + shared[:, 1:]
    return result


def refuse_unsupported_effects(chain: Chain) -> None:
    """Raise RequestError for effects that hinges in MuJoCo cannot represent."""
    refused = {
        'extensibility': chain.axial_compliance > 0.0,
        'pressure_elongation': chain.rest.any(),
        'touching_peg': chain.peg is not None,
        'clamp_compliance of richness above 0': chain.clamp_hardening > 0.0,
        'stiffening of richness above 0': chain.quintic > 0.0,
    }
    names = [name for name, found in refused.items() if found]
    if names:
        peg = '; motion.peg_radius is the peg of MuJoCo' if 'touching_peg' in names else ''
        raise RequestError(
            f'MuJoCo cannot simulate the effect {", ".join(names)}: its links do not stretch, '
            f'and its springs are linear or cubic. Remove the effect{peg}',
            reason='not_for_mujoco',
        )


def check_damping_time(motion: LabMotion) -> None:
    """Raise RequestError for a damping time below one step, the damping of the integrator."""
    if motion.damping_time < motion.timestep:
        raise RequestError(
            f'MuJoCo cannot simulate a damping time of {motion.damping_time:g} s: its integrator '
            f'damps as a damping time of one step does. Set motion.damping_time, or '
            f'effects.inertia.damping_time, to motion.timestep ({motion.timestep:g} s) or more',
            reason='not_for_mujoco',
        )


class Run:
    """A MuJoCo simulation, starting at rest at the beginning of a recording."""

    def __init__(self, arm: LabArm, motion: LabMotion, chain_at: ChainAt, duration: float) -> None:
        """Build the model, and find its equilibrium under the initial loads."""
        self.mujoco = load_mujoco()
        self.arm, self.motion, self.chain_at, self.duration = arm, motion, chain_at, duration
        self.links = int(motion.links)
        self.link = arm.length / self.links
        self.turning = any(motion.turn_angle)
        chain = chain_at(np.zeros(1))
        refuse_unsupported_effects(chain)
        check_damping_time(motion)
        self.has_clamp_hinge = chain.clamp_compliance > 0.0
        self.hinges = Hinges(chain, self.links)
        root = mjcf_tree(self.hinge_chain())
        self.add_surroundings(root)
        text = ElementTree.tostring(root, encoding='unicode')
        self.model = self.mujoco.MjModel.from_xml_string(text)
        self.data = self.mujoco.MjData(self.model)
        start = self.model.body('link_1' if self.has_clamp_hinge else 'base').id
        self.bodies = slice(start, start + self.links + 1)
        self.dofs = slice(int(self.turning), None)
        # From the center of mass of each link back to its beginning (m).
        self.middles = np.full(self.links + 1, 0.5 * self.link)
        self.middles[[0, -1]] *= 0.5
        self.come_to_rest(chain)
        self.resting = self.swing

    def hinge_chain(self) -> HingeChain:
        """Return the arm as hinges, with the springs at its first instant."""
        arm, motion = self.arm, self.motion
        hinge = self.link * (np.arange(self.links, dtype=np.float64) + 0.5)
        return HingeChain(
            name='lab',
            length=arm.length,
            tip_cap=arm.tip_cap,
            clamp_angle=arm.clamp_angle,
            mass=arm.weight / STANDARD_GRAVITY,
            tip_mass=motion.tip_mass,
            damping_time=motion.damping_time,
            radius=motion.radius,
            timestep=motion.timestep,
            hinge=np.append(0.0, hinge) if self.has_clamp_hinge else hinge,
            pressure=np.zeros(1),
            stiffness=self.hinges.stiffness,
            rest=self.hinges.rest,
            cubic=self.hinges.cubic,
            gravity=STANDARD_GRAVITY * np.array([motion.gravity_x, motion.gravity_y]),
        )

    def add_surroundings(self, root: ElementTree.Element) -> None:
        """Add the rotation of the base, and the peg, which rotates with the base."""
        arm, motion = self.arm, self.motion
        base = root.find("worldbody/body[@name='base']")
        assert base is not None
        if self.turning:
            inertia = DRIVE * (arm.weight / STANDARD_GRAVITY + motion.tip_mass) * arm.reach**2
            ElementTree.SubElement(
                base, 'joint', name='turn', type='hinge', axis='0 0 1', armature=f'{inertia:.9g}'
            )
            if base.find('inertial') is None:
                ElementTree.SubElement(
                    base, 'inertial', pos='0 0 0', mass='1', diaginertia='1 1 1'
                )
        if motion.peg_radius > 0.0:
            x, y = rotated(np.array([motion.peg_x, motion.peg_y]), np.array([-arm.clamp_angle]))[0]
            ElementTree.SubElement(
                base,
                'geom',
                name='peg',
                type='cylinder',
                size=f'{motion.peg_radius:.9g} {2.0 * motion.radius:.9g}',
                pos=f'{x:.9g} {y:.9g} 0',
                mass='0',
            )
        # MuJoCo replaces friction 0 by 1e-5, and its forces are then noise.
        friction = {'friction': f'{motion.peg_friction:g} 0 0'}
        for geom in root.iter('geom'):
            geom.attrib.update(friction if motion.peg_friction else {'condim': '1'})

    def base_at(self, times: Array) -> tuple[Array, Array, Array]:
        """Return angle of the base (rad), its rate and its acceleration at times (n,) s."""
        angle, rate, acceleration = self.motion.turn(freeze(times / self.duration))
        return angle, freeze(rate / self.duration), freeze(acceleration / self.duration**2)

    def come_to_rest(self, chain: Chain) -> None:
        """Move the arm to the equilibrium under its initial loads, without the peg."""
        base = float(self.base_at(np.zeros(1))[0][0])
        self.set_springs(0)
        self.data.qpos[self.dofs] = self.hinges.rest[0]
        if self.turning:
            self.data.qpos[0] = base

        def loads() -> None:
            self.set_loads(chain, 0)
            if self.turning:  # the base would be free without it
                self.data.qfrc_applied[0] = -HOLD * (self.data.qpos[0] - base)

        come_to_rest(self.model, self.data, loads)
        if self.motion.peg_radius > 0.0:
            self.mujoco.mj_forward(self.model, self.data)
            if self.data.ncon:
                raise RequestError(
                    'the arm already touches the peg at the start: move the peg',
                    reason='touches_peg',
                )

    def set_springs(self, row: int) -> None:
        """Set springs and damping to those at one instant."""
        model, hinges, dofs = self.model, self.hinges, self.dofs
        stiffness, rest = hinges.stiffness[row], hinges.rest[row]
        bend = self.data.qpos[dofs] - rest
        model.jnt_stiffness[dofs], model.qpos_spring[dofs] = stiffness, rest
        model.jnt_stiffnesspoly[dofs, 1] = stiffness * hinges.cubic
        # The integrator `discrete` damps as a damping time of one step does.
        damping = self.motion.damping_time - self.motion.timestep
        model.dof_damping[dofs] = damping * stiffness * (1.0 + 3.0 * hinges.cubic * bend**2)

    def set_loads(self, chain: Chain, row: int) -> None:
        """Apply the forces at one instant to all links, at the positions in `data`."""
        qpos = self.data.qpos
        base = float(qpos[0]) if self.turning else 0.0
        bend_angles = np.cumsum(qpos[self.dofs])
        force = self.hinges.weight[row].copy()
        torque = np.zeros(self.links + 1)
        torque[-1] += chain.moment[row]
        end = 0.5 * self.link + chain.end_offset_along - self.middles[-1]
        heading = self.arm.clamp_angle + bend_angles[-1]
        lever = in_heading(heading, end, chain.end_offset_across)
        add_force(force, torque, self.links, chain.force[row], lever)
        # The mass is at the tip, but its weight acts where the end force does.
        beyond = in_heading(
            heading, chain.end_offset_along - self.arm.tip_cap, chain.end_offset_across
        )
        weight = chain.tip_mass * chain.pulls[row]
        torque[-1] += beyond[0] * weight[1] - beyond[1] * weight[0]
        for one in chain.pushes:
            position = one.place
            link = min(int(position / self.link + 0.5), self.links)
            start = max(link - 0.5, 0.0) * self.link
            before = link if self.has_clamp_hinge else link - 1
            relative = self.arm.clamp_angle + (bend_angles[before] if before >= 0 else 0.0)
            push = in_heading(relative, 0.0, float(one.force[row]))
            lever = in_heading(relative, position - start - self.middles[link], 0.0)
            add_force(force, torque, link, push, lever)
        if self.turning:
            cosine, sine = np.cos(base), np.sin(base)
            force = force @ np.array([[cosine, sine], [-sine, cosine]])
        applied = self.data.xfrc_applied[self.bodies]
        applied[:, :2], applied[:, 5] = force, torque

    def frames(self, times: Array) -> Iterator[Frame]:
        """Step through the recording; yield events at times (frames,) s, increasing."""
        step, index = self.motion.timestep, 0
        count = int(np.ceil(times[-1] / step))
        for first in range(0, count, BLOCK):
            begins = step * np.arange(first, min(first + BLOCK, count), dtype=np.float64)
            for row, joints in enumerate(self.steps(self.chain_at, begins, begins)):
                step_begin = float(begins[row])
                if index == times.size or times[index] > step_begin + step:
                    continue
                contact = self.contact()
                before, after = self.state(*joints), self.state(*self.joints)
                while index < times.size and times[index] <= step_begin + step:
                    share = float(times[index] - step_begin) / step
                    angles, rates = (
                        (1.0 - share) * one + share * two
                        for one, two in zip(before, after, strict=True)
                    )
                    yield Frame(angles, rates, *contact)
                    index += 1
            self.check(float(begins[-1]) + step)

    def steps(self, chain_at: ChainAt, begins: Array, of_base: Array) -> Iterator[Swing]:
        """Step at times (n,) s, the base at its own times; yield the joints before each step."""
        # Springs and loads of a step are evaluated at its middle.
        chain = chain_at(freeze(begins + 0.5 * self.motion.timestep))
        self.hinges = Hinges(chain, self.links)
        base, pulls = self.base_at(of_base), self.motion.pull(of_base, self.duration)
        for row in range(begins.size):
            before = self.joints
            self.model.opt.gravity[:2] = pulls[row, :2]
            self.step(chain, row, base)
            yield before

    def follow(self, swing: Swing, chain_at: ChainAt, begins: Array) -> Swing:
        """Return the motion of an arm by steps starting at times (n,) s.

        The base repeats its motion forever.
        """
        self.data.qpos[:], self.data.qvel[:] = swing
        self.data.qacc_warmstart[:] = 0.0
        for first in range(0, begins.size, BLOCK):
            times = begins[first : first + BLOCK]
            of_base = freeze(np.mod(times, self.duration))
            for _ in self.steps(chain_at, freeze(times), of_base):
                pass
            self.check(float(times[-1]))
        return self.swing

    @property
    def swing(self) -> Swing:
        """Positions and rates of all joints."""
        return freeze(self.data.qpos.copy()), freeze(self.data.qvel.copy())

    def shape(self, swing: Swing) -> MovingShape:
        """Return the shape of the swinging arm."""
        angles = swing[0][self.dofs]
        angles = angles if self.has_clamp_hinge else np.append(0.0, angles)
        heading = self.arm.clamp_angle + np.cumsum(angles)[None]
        return MovingShape(link=self.link, length=self.arm.length, heading=freeze(heading))

    def step(self, chain: Chain, row: int, base: tuple[Array, Array, Array]) -> None:
        """Advance by one step."""
        if self.turning:
            self.data.qpos[0], self.data.qvel[0] = base[0][row], base[1][row]
            self.data.qfrc_applied[0] = self.model.dof_armature[0] * base[2][row]
        self.set_springs(row)
        self.mujoco.mj_step1(self.model, self.data)
        self.set_loads(chain, row)
        self.mujoco.mj_step2(self.model, self.data)

    @property
    def joints(self) -> Swing:
        """Angles (rad) and rates (rad/s) of the hinges, and of the clamp if it is compliant."""
        return self.data.qpos[self.dofs].copy(), self.data.qvel[self.dofs].copy()

    def state(self, angles: Array, rates: Array) -> tuple[Array, Array]:
        """Return angles (rad) and rates (rad/s) of clamp and hinges, each (links + 1,)."""
        if self.has_clamp_hinge:
            return angles, rates
        return np.append(0.0, angles), np.append(0.0, rates)

    def contact(self) -> tuple[Array, float]:
        """Return the force (2,) N of the peg on the arm in the base frame, and its place (m)."""
        force, weighted_place, weight, result = np.zeros(2), 0.0, 0.0, np.zeros(6)
        for index in range(self.data.ncon):
            touch = self.data.contact[index]
            self.mujoco.mj_contactForce(self.model, self.data, index, result)
            contact_force = touch.frame.reshape(3, 3).T @ result[:3]
            bodies = [int(self.model.geom_bodyid[geom]) for geom in touch.geom]
            peg = self.model.geom('peg').id
            second = int(touch.geom[0]) == peg
            link = (bodies[1] if second else bodies[0]) - self.bodies.start
            force += (contact_force if second else -contact_force)[:2]
            size = float(np.hypot(*contact_force[:2]))
            body = self.bodies.start + link
            offset = float((touch.pos - self.data.xpos[body]) @ self.data.xmat[body][::3])
            weighted_place += size * (max(link - 0.5, 0.0) * self.link + offset)
            weight += size
        base = float(self.data.qpos[0]) if self.turning else 0.0
        place = weighted_place / weight if weight else float('nan')
        return rotated(force, np.array([-base]))[0], place

    def check(self, time: float) -> None:
        """Raise RequestError if MuJoCo reports that the simulation diverged."""
        warnings = self.mujoco.mjtWarning
        for kind in (warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC):
            if self.data.warning[int(kind)].number:
                raise RequestError(
                    f'the MuJoCo simulation diverges before {time:.3g} s: reduce motion.timestep '
                    f'({self.motion.timestep:g} s)',
                    reason='diverges',
                )


def in_heading(heading: float, forward: float, leftward: float) -> Array:
    """Return a vector (2,) given forward and to the left of a heading (rad)."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([forward * cosine - leftward * sine, forward * sine + leftward * cosine])


def add_force(force: Array, torque: Array, link: int, applied: Array, lever: Array) -> None:
    """Add a force (2,) N with a lever (2,) m from the center of mass of a link."""
    force[link] += applied
    torque[link] += lever[0] * applied[1] - lever[1] * applied[0]
