"""Kinds of cause that may act on the arm or its image, each with an amplitude.

A kind is an effect with one amplitude per frame. `method` is the method of the effect interface
(`effects/effect.py`) that it implements, and `code` its return value as Python with `amplitude`
(for `terms`, the arguments of `Terms`). The field of a unit amplitude, the joint fit of a law and
the proposed effect file are all generated from this code (`proposed_effect.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from pneunet_ros.discovery.covariates import Group
from pneunet_ros.effects.arm_size import ArmSize
from pneunet_ros.effects.effect import Place

Method = Literal['terms', 'sense', 'actuate', 'see', 'frame_delay']


@dataclass(frozen=True, slots=True, kw_only=True)
class Native:
    """A covariate computed from the equilibrium, which an amplitude cannot follow.

    code: arguments of `Terms`, with `coefficient`; words as for a covariate; unit and prior std
    (SI) of the coefficient for the paper's arm, which is never negative.
    """

    code: str
    words: str
    unit: str
    prior: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One kind of cause.

    subject: beginning of a sentence that ends with the law of the amplitude; unit and prior std
    (SI) of the amplitude for the paper's arm. positions: allowed range along the arm (s / l), None
    without a position; width (s / l): of the part on which it acts. place: as in the contract of
    effects.
    """

    name: str
    subject: str
    amplitude: str
    unit: str
    prior: float
    code: str
    place: Place = 'mechanics'
    method: Method = 'terms'
    positions: tuple[float, float] | None = None
    width: float = 0.0
    natives: dict[str, Native] = field(default_factory=dict)

    @property
    def follows(self) -> frozenset[Group]:
        """Covariates available to an effect of this kind at run time."""
        groups: dict[Method, frozenset[Group]] = {
            'terms': frozenset({'constant', 'pressure', 'past', 'load'}),
            'actuate': frozenset({'past'}),
            'sense': frozenset({'constant', 'pressure', 'load'}),
            'see': frozenset({'constant'}),
            'frame_delay': frozenset({'constant'}),
        }
        return groups[self.method]


AXES = (('x', 'E1'), ('y', 'E2'))
# {half}: half of the arm's length (m).
RADIAL = (
    '(\n'
    '    x + amplitude * ((x - {half}) ** 2 + y**2) / {half} ** 2 * (x - {half}),\n'
    '    y + amplitude * ((x - {half}) ** 2 + y**2) / {half} ** 2 * y,\n'
    ')'
)
PERSPECTIVE = 'x * (1.0 + 0.5 * amplitude * x / {half}), y * (1.0 + 0.5 * amplitude * x / {half})'

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            name='stretch',
            subject='the whole arm is stretched',
            amplitude='stretch',
            unit='-',
            prior=0.02,
            code='rest_strain=amplitude',
            natives={
                'tension': Native(
                    code='axial_compliance=coefficient',
                    words='grows with the tension along the arm',
                    unit='1/N',
                    prior=0.02,
                )
            },
        ),
        Kind(
            name='clamp_turn',
            subject='the arm turns at its clamp',
            amplitude='turn',
            unit='rad',
            prior=0.05,
            code='clamp_angle=amplitude',
            natives={
                'moment at the clamp': Native(
                    code='clamp_compliance=coefficient',
                    words='grows with the moment at the clamp',
                    unit='rad/(N m)',
                    prior=10.0,
                )
            },
        ),
        Kind(
            name='stiffness',
            subject='the stiffness of the whole arm changes',
            amplitude='share that is added to the stiffness',
            unit='-',
            prior=0.2,
            place='material',
            code='rigidity_factor=1.0 + amplitude',
            natives={
                'bending^2': Native(
                    code='cubic=coefficient',
                    words='grows with the square of how far it is bent from its free shape',
                    unit='m^2',
                    prior=5e-4,
                )
            },
        ),
        Kind(
            name='curvature',
            subject='the free shape of the whole arm changes',
            amplitude='curvature',
            unit='1/m',
            prior=1.0,
            place='material',
            code='curvature=amplitude',
        ),
        Kind(
            name='bump',
            subject='the free shape of a short stretch of the arm changes',
            amplitude='curvature',
            unit='1/m',
            prior=5.0,
            place='material',
            code='curvature=amplitude',
            positions=(0.05, 0.95),
            width=0.1,
        ),
        Kind(
            name='section_stiffness',
            subject='the stiffness of a short stretch of the arm changes',
            amplitude='share that is added to the stiffness',
            unit='-',
            prior=0.3,
            place='material',
            code='rigidity_factor=1.0 + amplitude',
            positions=(0.05, 0.95),
            width=0.1,
        ),
        Kind(
            name='push',
            subject='a force pushes the arm along its normal',
            amplitude='force',
            unit='N',
            prior=0.05,
            code='push=amplitude',
            positions=(0.05, 1.0),
            width=0.02,
        ),
        Kind(
            name='chamber_pressure',
            subject='the pressure in the chamber differs from its reading',
            amplitude='difference from the reading',
            unit='Pa',
            prior=2e3,
            place='actuation',
            method='actuate',
            code='amplitude',
        ),
        *(
            Kind(
                name=f'line_load_{axis}',
                subject=f'a load along {vector} is distributed over the arm',
                amplitude='load per length',
                unit='N/m',
                prior=1.0,
                code=f'line_load_{axis}=amplitude',
            )
            for axis, vector in AXES
        ),
        *(
            Kind(
                name=f'end_force_{axis}',
                subject=f'the end force along {vector} differs from its reading',
                amplitude='difference from the reading',
                unit='N',
                prior=0.03,
                place='sensing',
                method='sense',
                code=f'replace(load, force_{axis}=load.force_{axis} + amplitude)',
            )
            for axis, vector in AXES
        ),
        Kind(
            name='end_moment',
            subject='the moment at the free end differs from its reading',
            amplitude='difference from the reading',
            unit='N m',
            prior=1e-3,
            place='sensing',
            method='sense',
            code='replace(load, moment=load.moment + amplitude)',
        ),
        Kind(
            name='load_beside',
            subject='the end load acts off the centerline',
            amplitude='distance',
            unit='m',
            prior=0.006,
            code='load_offset=amplitude',
        ),
        Kind(
            name='camera_scale',
            subject='the scale of the image is wrong',
            amplitude='share of the scale',
            unit='-',
            prior=0.01,
            place='sensing',
            method='see',
            code='x * (1.0 + amplitude), y * (1.0 + amplitude)',
        ),
        Kind(
            name='camera_rotation',
            subject='the image is rotated about the base',
            amplitude='turn',
            unit='rad',
            prior=0.05,
            place='sensing',
            method='see',
            code='(\n'
            '    math.cos(amplitude) * x - math.sin(amplitude) * y,\n'
            '    math.sin(amplitude) * x + math.cos(amplitude) * y,\n'
            ')',
        ),
        Kind(
            name='camera_radial',
            subject='radial lens distortion, centered on the middle of the straight arm',
            amplitude='relative shift half a length from the middle',
            unit='-',
            prior=0.02,
            place='sensing',
            method='see',
            code=RADIAL,
        ),
        Kind(
            name='camera_perspective_x',
            subject='the camera is tilted, so that the scale changes along E1',
            amplitude='change of the scale over a length',
            unit='-',
            prior=0.02,
            place='sensing',
            method='see',
            code=PERSPECTIVE,
        ),
        Kind(
            name='time_offset',
            subject='the stamps of the camera are wrong',
            amplitude='delay',
            unit='s',
            prior=0.1,
            place='sensing',
            method='frame_delay',
            code='amplitude',
        ),
    )
}


def kinds_of(size: ArmSize) -> tuple[Kind, ...]:
    """Return all kinds with the priors of an arm of this size."""
    return tuple(
        replace(
            kind,
            prior=kind.prior * size.of(kind.unit),
            natives={
                name: replace(native, prior=native.prior * size.of(native.unit))
                for name, native in kind.natives.items()
            },
        )
        for kind in KINDS.values()
    )
