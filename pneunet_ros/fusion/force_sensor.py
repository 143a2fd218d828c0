"""Is the force sensor off: an offset that nobody tared, a gain that is not 1.

A sensor that is off by a few millinewtons drags force and shape along, with intervals as narrow as
its noise, and what does not fit is taken for a contact. So offset and gain are unknowns of the
fusion. At first they are known to be small, and all that the targets say of them is gathered. Once
they surely say that the sensor is off, the fusion begins anew with offset and gain free. Whether
it is the sensor that is off or the model that is too stiff, nobody can know: the shape follows the
targets, and the interval of the force holds both answers.

A contact along the arm, too, looks like a sensor that is off. So contacts are told apart from a
tip force only once the targets have confirmed the sensor, without a contact.

Source: score test, Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948), of a prior that is narrow.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.fusion.belief import Belief, GAIN, OFFSET, Unknowns
from pneunet_ros.fusion.settings import FusionSettings

DISAGREES = (
    'force sensor and targets disagree: tare the sensor and reset, or run pneunet diagnose; the '
    'interval of the force holds what both say'
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceSensorError:
    """What the force sensor reads, if the model is right: offset + gain F.

    offset (2,) N of F1 and F2 and its std; gain, 1 where it is right, and its std.
    """

    offset: Array
    offset_std: Array
    gain: float
    gain_std: float

    def at(self, force: Array) -> Array:
        """Return what it reads too much (2,) N at a force (2,) N."""
        return self.offset + (self.gain - 1.0) * force

    @property
    def words(self) -> str:
        """Say it in numbers."""
        pairs = zip(self.offset.tolist(), self.offset_std.tolist(), strict=True)
        off = ', '.join(f'{value:.4f} +- {std:.4f}' for value, std in pairs)
        return f'offset {off} N, gain {self.gain:.3f} +- {self.gain_std:.3f}'

    @property
    def numbers(self) -> dict[str, list[float] | float]:
        """Say it to a program: offset and its std (N), gain (1 is right) and its std."""
        return {
            'offset': self.offset.tolist(),
            'offset_std': self.offset_std.tolist(),
            'gain': self.gain,
            'gain_std': self.gain_std,
        }


def force_sensor_error(belief: Belief) -> ForceSensorError:
    """Return what a belief says of a force sensor that is off.

    The unknowns are of the reading: F = (1 - GAIN) reading - OFFSET.
    """
    share = 1.0 - float(belief.mean[GAIN])
    std = np.array([belief.std(one) for one in range(OFFSET.start, OFFSET.stop)])
    return ForceSensorError(
        offset=freeze(belief.mean[OFFSET] / share),
        offset_std=freeze(std / abs(share)),
        gain=1.0 / share,
        gain_std=belief.std(GAIN) / share**2,
    )


class Verdict(Enum):
    """What frames have said so far of a sensor that is taken for one in order."""

    OPEN = 'too little is known'
    IN_ORDER = 'confirmed, offset and gain'
    OFF = 'off'


def verdict_on(unknowns: Unknowns, settings: FusionSettings, belief: Belief) -> Verdict:
    """Return what frames have said so far of a sensor that is taken for one in order."""
    tolerance = settings.sensor_tolerance
    limits = (tolerance * unknowns.force_scale, tolerance * unknowns.force_scale, tolerance)
    verdict = Verdict.IN_ORDER
    for which, limit in zip(range(OFFSET.start, GAIN + 1), limits, strict=True):
        prior, mean = float(unknowns.std[which]), abs(float(belief.mean[which]))
        # What frames say by themselves is mean / share, of which the std is prior / sqrt(share).
        share = 1.0 - (belief.std(which) / prior) ** 2 if prior > 0.0 else 0.0
        if prior >= limit * math.sqrt(max(share, 0.0)):
            verdict = Verdict.OPEN  # a straight arm tells hardly anything, and that is not linear
        elif mean > max(limit * share, settings.sensor_off * prior * math.sqrt(share)):
            return Verdict.OFF
    return verdict
