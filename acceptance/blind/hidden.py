"""The hidden effect of a trial, with random kind and size.

Sizes go geometrically from hardly visible to strong. All numbers are invented: the weakest lie
from a little below to about three times what makes a calibrated fit worse by 25 in chi^2 on the
recordings of `designs.FULL`, the strongest move the tip by millimeters.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

SIZES = 6
RICHNESS = 0.3, 1.0
MIDDLE = 0.056  # m: half of the length of the arm of the lab
MISMATCH = 0.003  # of the curvature, in every trial


@dataclass(frozen=True, slots=True, kw_only=True)
class Hideable:
    """An effect of the library: its main parameter, from the weakest to the strongest.

    `signed`: either sign may be drawn. `neutral` is added to what is drawn.
    """

    parameter: str
    weakest: float
    strongest: float
    signed: bool = True
    neutral: float = 0.0

    def strength(self, value: float) -> float:
        """Return how strong a value of the parameter is: 0 does nothing."""
        return 1.0 / abs(value) if math.isinf(self.neutral) else abs(value - self.neutral)

    def drawn(self, step: int, random: np.random.Generator) -> float:
        """Return the value at a step of SIZES, 0 the weakest."""
        ratio = self.strongest / self.weakest
        size = self.weakest * ratio ** (step / (SIZES - 1.0))
        sign = float(random.choice([-1.0, 1.0])) if self.signed else 1.0
        return size if math.isinf(self.neutral) else self.neutral + sign * size


HIDEABLE = {
    'force_misalignment': Hideable(parameter='angle', weakest=0.0015, strongest=0.1),
    'pressure_lag': Hideable(
        parameter='time_constant', weakest=0.004, strongest=0.4, signed=False
    ),
    'hysteresis': Hideable(parameter='width', weakest=60.0, strongest=3000.0, signed=False),
    'creep': Hideable(parameter='amplitude', weakest=0.003, strongest=0.2, signed=False),
    'softening': Hideable(parameter='loss', weakest=0.01, strongest=0.3, signed=False),
    'stiffening': Hideable(parameter='coefficient', weakest=2e-5, strongest=4e-4, signed=False),
    'extensibility': Hideable(
        parameter='axial_stiffness', weakest=1000.0, strongest=10.0, signed=False, neutral=math.inf
    ),
    'pressure_elongation': Hideable(
        parameter='strain_per_pascal', weakest=8e-9, strongest=1e-6, signed=False
    ),
    'gravity': Hideable(parameter='weight_y', weakest=0.004, strongest=0.8),
    'clamp_compliance': Hideable(
        parameter='compliance', weakest=1.0, strongest=20.0, signed=False
    ),
    'load_offset': Hideable(parameter='offset', weakest=2e-4, strongest=0.008),
    'camera_scale': Hideable(parameter='factor', weakest=0.001, strongest=0.03, neutral=1.0),
    'camera_rotation': Hideable(parameter='angle', weakest=0.0015, strongest=0.04),
    'camera_delay': Hideable(parameter='delay', weakest=0.004, strongest=0.2),
}
CONFUSABLE = (
    ('camera_rotation', 'force_misalignment'),
    ('force_misalignment', 'load_offset'),
    ('hysteresis', 'pressure_lag'),
    ('hysteresis', 'creep'),
    ('camera_delay', 'pressure_lag'),
)
NEWER = 'contact', 'lens_distortion', 'camera_tilt'  # in a block of their own: seeds stay
NEED_LOADS = 'extensibility', 'stiffening', 'softening', 'load_offset', 'force_misalignment'

Parameters = dict[str, float]


def hidden_effect(name: str, step: int, random: np.random.Generator) -> Parameters:
    """Return the parameters of an effect of the library at a step of its sizes."""
    kind = HIDEABLE[name]
    parameters = {kind.parameter: kind.drawn(step, random), 'richness': random.uniform(*RICHNESS)}
    if name == 'creep':
        parameters['time_constant'] = float(np.exp(random.uniform(np.log(3.0), np.log(20.0))))
    if name == 'gravity':  # the plane of the arm stands nearly upright, E1 nearly level
        parameters['weight_x'] = parameters['weight_y'] * random.uniform(-0.3, 0.3)
    if name == 'pressure_elongation':
        linear = parameters['strain_per_pascal']
        parameters['strain_per_pascal_squared'] = linear * random.uniform(0.0, 5e-6)
    return parameters


def outside_effect(name: str, random: np.random.Generator) -> Parameters:
    """Return the parameters of an effect outside the library, or newer, that is well visible."""
    sign = float(random.choice([-1.0, 1.0]))
    if name == 'lens_distortion':
        # About the middle of the straight arm; 0.6 to 3 % at its ends.
        return {'radial': sign * between(0.006, 0.03, random) / MIDDLE**2, 'middle_x': MIDDLE}
    if name == 'touching_peg':
        return {
            'stiffness': between(100.0, 400.0, random),
            'place': random.uniform(0.4, 0.7),
            'height': random.uniform(0.012, 0.02),
        }
    if name == 'weak_chamber':
        return {
            'rigidity_loss': random.uniform(0.6, 0.88),
            'curvature_dip': between(6.0, 15.0, random),
            'place': random.uniform(0.25, 0.75),
            'width': random.uniform(0.03, 0.05),
        }
    if name == 'periodic_disturbance':
        return {'amplitude': between(0.03, 0.12, random), 'period': between(1.3, 9.0, random)}
    if name == 'contact':
        return {
            'force': sign * between(0.01, 0.06, random),
            'arclength': random.uniform(0.3, 0.95),
        }
    if name == 'camera_tilt':
        turn = random.uniform(0.0, 2.0 * math.pi)
        size = between(0.1, 0.8, random)
        return {'tilt_x': size * math.cos(turn), 'tilt_y': size * math.sin(turn)}
    assert name == 'slipping_base', name
    turn, size = random.uniform(0.0, 2.0 * math.pi), between(5e-4, 3e-3, random)
    return {
        'slip_x': size * math.cos(turn),
        'slip_y': size * math.sin(turn),
        'moment': random.uniform(0.25, 0.75),
    }


def between(low: float, high: float, random: np.random.Generator) -> float:
    """Return a number between two, their logarithms being equally likely."""
    return float(np.exp(random.uniform(math.log(low), math.log(high))))
