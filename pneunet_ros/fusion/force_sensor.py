"""Is the force sensor off: an offset that nobody tared, a gain that is not 1.

A sensor that is off by a few millinewtons drags force and shape along, with intervals as narrow as
its noise, and what does not fit is taken for a contact. So offset and gain are unknowns of the
fusion. At first they are known to be small, and all that the targets say of them is gathered. Once
they surely say that the sensor is off, the fusion begins anew with offset and gain free. Whether
it is the sensor that is off or the model that is too stiff, nobody can know: the shape follows the
targets, and the interval of the force holds both answers.

Source: score test, Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948), of a prior that is narrow.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.fusion.belief import Belief, GAIN, OFFSET, Unknowns
from pneunet_ros.fusion.settings import FusionSettings

DISAGREES = (
    'force sensor and targets disagree: tare the sensor and reset, or run pneunet diagnose; the '
    'interval of the force holds what both say'
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceSensorError:
    """What the force sensor reads too much, if the model is right.

    offset (2,) N of F1 and F2 and its std; gain beyond 1, a share of the force, and its std.
    """

    offset: Array
    offset_std: Array
    gain: float
    gain_std: float

    def at(self, force: Array) -> Array:
        """Return what it reads too much (2,) N at a force (2,) N."""
        return self.offset + self.gain * force

    @property
    def words(self) -> str:
        """Say it in numbers."""
        pairs = zip(self.offset.tolist(), self.offset_std.tolist(), strict=True)
        off = ', '.join(f'{value:.4f} +- {std:.4f}' for value, std in pairs)
        return f'offset {off} N, gain {1.0 + self.gain:.3f} +- {self.gain_std:.3f}'

    @property
    def numbers(self) -> dict[str, list[float] | float]:
        """Say it to a program: offset and its std (N), gain (1 is right) and its std."""
        return {
            'offset': self.offset.tolist(),
            'offset_std': self.offset_std.tolist(),
            'gain': 1.0 + self.gain,
            'gain_std': self.gain_std,
        }


def force_sensor_error(belief: Belief) -> ForceSensorError:
    """Return what a belief says of a force sensor that is off."""
    return ForceSensorError(
        offset=frozen_array(belief.mean[OFFSET]),
        offset_std=frozen_array([belief.std(one) for one in range(OFFSET.start, OFFSET.stop)]),
        gain=float(belief.mean[GAIN]),
        gain_std=belief.std(GAIN),
    )


def is_off(unknowns: Unknowns, settings: FusionSettings, belief: Belief) -> bool:
    """Whether frames have surely said that a sensor taken for one in order is off."""
    tolerance = settings.force_tolerance
    limits = (tolerance * unknowns.force_scale, tolerance * unknowns.force_scale, tolerance)
    for which, limit in zip(range(OFFSET.start, GAIN + 1), limits, strict=True):
        prior, mean = float(unknowns.std[which]), abs(float(belief.mean[which]))
        told = 1.0 - (belief.std(which) / prior) ** 2
        if told <= (prior / limit) ** 2:
            continue  # too little: a straight arm tells hardly anything, and that is not linear
        # What they say by themselves is mean / told, of which the std is prior / sqrt(told).
        if mean / told > limit and mean > settings.force_doubt * prior * math.sqrt(told):
            return True
    return False
