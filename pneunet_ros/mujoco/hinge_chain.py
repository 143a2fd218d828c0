"""A finger as a chain of hinges, and its MJCF.

Each hinge is in the middle of the part of the finger that it represents, so the first hinge is
half a link from the clamp; the links are straight and carry the mass. The angle of a hinge under a
bending moment M is rest + M / stiffness. Statics are second-order accurate in the length of a
link: with 56 links, a 112 mm finger is within 0.02 mm of the rod.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from xml.etree import ElementTree

import numpy as np
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, quantity, STANDARD_GRAVITY

LINKS = 56
# MuJoCo rejects an inertia of 1e-15 kg m^2 or less (mjMINVAL), as of a link of 10 mg and 35 um.
LEAST_INERTIA = 2e-15
TABLES = 'pressure', 'stiffness', 'rest', 'cubic', 'damping_time'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HingeChain:
    """Description of a finger for MuJoCo, SI, in the base frame.

    hinge (hinges,) m: positions of the hinges, the first one at 0 if the clamp is compliant;
    stiffness (rows, hinges) N m/rad and rest (rows, hinges) rad at every pressure (rows,) Pa,
    linear between; cubic (hinges,) 1/rad^2: the moment of a hinge is k d (1 + cubic d^2). target
    (targets,) m along the finger. gravity (2,) m/s^2 in the plane of bending.
    """

    name: str
    length: float = quantity(unit='m', meaning='soft length', bounds=(1e-4, 10.0))
    tip_cap: float = quantity(
        0.0, unit='m', meaning=('length of the rigid part beyond the soft end'), bounds=(0.0, 10.0)
    )
    clamp_angle: float = quantity(0.0, unit='rad', meaning='heading at rest', bounds=(-7.0, 7.0))
    mass: float = quantity(
        unit='kg', meaning=('mass, distributed evenly along the length'), bounds=(1e-9, 1e4)
    )
    tip_mass: float = quantity(0.0, unit='kg', meaning='mass at the free end', bounds=(0.0, 1e4))
    damping_time: float = quantity(
        0.0,
        unit='s',
        meaning='Kelvin-Voigt: damping of a hinge / its stiffness',
        bounds=(0.0, 1e3),
    )
    radius: float = quantity(
        unit='m', meaning='radius of the collision capsules', bounds=(1e-6, 1.0)
    )
    timestep: float = quantity(
        1e-3, unit='s', meaning='time step of the simulation', bounds=(1e-6, 0.1)
    )
    hinge: Array
    pressure: Array
    stiffness: Array
    rest: Array
    cubic: Array
    target: Array = field(default_factory=lambda: np.zeros(0))
    gravity: Array = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        """Check sizes; reject negative stiffness."""
        check_quantities(self, 'finger', RequestError)
        rows, hinges = len(self.pressure), len(self.hinge)
        sizes: dict[str, tuple[int, ...]] = {
            'hinge': (hinges,),
            'pressure': (rows,),
            'stiffness': (rows, hinges),
            'rest': (rows, hinges),
            'cubic': (hinges,),
            'target': (len(self.target),),
            'gravity': (2,),
        }
        for name, size in sizes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), size))
        if not np.all(self.stiffness > 0.0):
            raise RequestError(
                'MuJoCo needs positive bending stiffness at all pressures; this moment law has '
                'a negative one',
                reason='not_for_mujoco',
            )

    @property
    def reach(self) -> float:
        """Length from the clamp to the tip (m)."""
        return self.length + self.tip_cap

    @property
    def starts(self) -> Array:
        """Positions of the fixed part and of every link (hinges + 1,) m along the arm."""
        return freeze(np.concatenate([[0.0], self.hinge]))

    @property
    def ends(self) -> Array:
        """End positions of the fixed part at the clamp and of every link, (hinges + 1,) m."""
        return freeze(np.concatenate([self.hinge, [self.length]]))


def mjcf(chain: HingeChain) -> str:
    """Return the MJCF of a finger, see `mjcf_tree`, as text."""
    root = mjcf_tree(chain)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode', xml_declaration=True) + '\n'


def mjcf_tree(chain: HingeChain) -> ElementTree.Element:
    """Return the MJCF of a finger: clamp at the origin, straight along x, bending about z.

    Bodies `base` and `link_1` ... with hinges `bend_0` ... between them, a site `tip` and sites
    `target_0` ...; the tables over pressure are in `custom`, for `Finger`.
    """
    root = ElementTree.Element('mujoco', model=chain.name)
    ElementTree.SubElement(root, 'compiler', angle='radian')
    across = math.hypot(*chain.gravity)
    down = math.sqrt(max(STANDARD_GRAVITY**2 - across**2, 0.0))
    ElementTree.SubElement(
        root,
        'option',
        timestep=f'{chain.timestep:g}',
        integrator='discrete',
        gravity=numbers([*chain.gravity, -down]),
    )
    custom = ElementTree.SubElement(root, 'custom')
    for name in TABLES:
        values = np.atleast_1d(getattr(chain, name)).ravel()
        ElementTree.SubElement(
            custom, 'numeric', name=name, size=str(values.size), data=numbers(values)
        )
    body = ElementTree.SubElement(
        ElementTree.SubElement(root, 'worldbody'),
        'body',
        name='base',
        euler=numbers([0.0, 0.0, chain.clamp_angle]),
    )
    for index, (start, end) in enumerate(zip(chain.starts, chain.ends, strict=True)):
        if index:
            place = numbers([start - chain.starts[index - 1], 0.0, 0.0])
            body = ElementTree.SubElement(body, 'body', name=f'link_{index}', pos=place)
            add_hinge(body, chain, index - 1)
        add_link(body, chain, float(start), float(end))
    add_tip(body, chain)
    return root


def add_hinge(body: ElementTree.Element, chain: HingeChain, hinge: int) -> None:
    """Attach a body by a hinge, with the spring of the lowest pressure."""
    stiffness = float(chain.stiffness[0, hinge])
    cubic = stiffness * float(chain.cubic[hinge])
    ElementTree.SubElement(
        body,
        'joint',
        name=f'bend_{hinge}',
        type='hinge',
        axis='0 0 1',
        stiffness=numbers([stiffness, 0.0, cubic] if cubic else [stiffness]),
        springref=numbers([float(chain.rest[0, hinge])]),
        damping=numbers([stiffness * chain.damping_time]),
    )


def add_link(body: ElementTree.Element, chain: HingeChain, start: float, end: float) -> None:
    """Give a body the mass, the capsule and the targets of a part of the finger (m)."""
    length = end - start
    if length <= 0.0:
        return
    mass = chain.mass * length / chain.length
    # No hinge rotates about the axis of a link: the transverse inertia is used there as well.
    inertia = numbers([max(mass * length**2 / 12.0, LEAST_INERTIA)] * 3)
    middle = numbers([0.5 * length, 0.0, 0.0])
    ElementTree.SubElement(body, 'inertial', pos=middle, mass=numbers([mass]), diaginertia=inertia)
    add_capsule(body, chain, 0.0, length)
    last = end >= chain.length
    for index, place in enumerate(chain.target):
        if start <= place < end or (last and place >= end):
            ElementTree.SubElement(
                body, 'site', name=f'target_{index}', pos=numbers([place - start, 0.0, 0.0])
            )


def add_capsule(body: ElementTree.Element, chain: HingeChain, start: float, end: float) -> None:
    """Add a collision capsule; capsules of fingers do not touch each other."""
    ElementTree.SubElement(
        body,
        'geom',
        type='capsule',
        fromto=numbers([start, 0.0, 0.0, end, 0.0, 0.0]),
        size=numbers([chain.radius]),
        mass='0',
        contype='2',
        conaffinity='1',
        rgba='0.35 0.55 0.75 1',
    )


def add_tip(body: ElementTree.Element, chain: HingeChain) -> None:
    """Add the rigid cap, the tip mass, and the tip site."""
    soft_end = chain.length - float(chain.hinge[-1])
    tip = numbers([soft_end + chain.tip_cap, 0.0, 0.0])
    if chain.tip_cap > 0.0:
        add_capsule(body, chain, soft_end, soft_end + chain.tip_cap)
    if chain.tip_mass > 0.0:
        heavy = ElementTree.SubElement(body, 'body', name='tip_mass', pos=tip)
        # MuJoCo has no point mass: a sphere of a hundredth of the length of a link approximates
        # it.
        size = 1e-2 * chain.length / chain.hinge.size
        inertia = numbers([max(0.4 * chain.tip_mass * size**2, LEAST_INERTIA)] * 3)
        mass = numbers([chain.tip_mass])
        ElementTree.SubElement(heavy, 'inertial', pos='0 0 0', mass=mass, diaginertia=inertia)
    ElementTree.SubElement(body, 'site', name='tip', pos=tip)


def numbers(values: list[float] | Array) -> str:
    """Write numbers for MJCF, with 12 digits."""
    return ' '.join(f'{float(value):.12g}' for value in values)
