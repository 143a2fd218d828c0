"""By how much the force sensor is off: an offset that nobody tared, a gain that is not 1.

Without them a sensor that is off by a few millinewtons drags force and shape along, with intervals
as narrow as its noise, and what does not fit is taken for a contact. So both are unknowns of the
fusion, which the targets tell.
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.fusion.belief import Belief, GAIN, OFFSET, Unknowns

UNUSUAL = 2.0  # std of sensors that are in order, beyond which an error is told
SURE = 4.0  # sigma at which it is seen
DISAGREES = (
    'force sensor and targets disagree by more than such sensors err: tare it, check its gain, or '
    'run pneunet diagnose'
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceSensorError:
    """What the force sensor reads too much.

    offset (2,) N of F1 and F2 and its std; gain beyond 1, a share of the force, and its std;
    beyond: it is more than sensors in order err, and surely so.
    """

    offset: Array
    offset_std: Array
    gain: float
    gain_std: float
    beyond: bool

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


def force_sensor_error(unknowns: Unknowns, belief: Belief) -> ForceSensorError:
    """Return what a belief says of the force sensor."""
    which = (*range(OFFSET.start, OFFSET.stop), GAIN)
    std = [belief.std(one) for one in which]
    return ForceSensorError(
        offset=freeze(belief.mean[OFFSET].copy()),
        offset_std=frozen_array(std[:-1]),
        gain=float(belief.mean[GAIN]),
        gain_std=std[-1],
        beyond=any(
            abs(belief.mean[one]) > max(UNUSUAL * unknowns.std[one], SURE * now)
            for one, now in zip(which, std, strict=True)
        ),
    )
