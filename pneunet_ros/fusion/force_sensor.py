"""Is the force sensor off: not tared, another gain, a swapped axis, a dead cable.

A sensor that is off by a few millinewtons drags force and shape along, with intervals as narrow as
its noise, and what does not fit is taken for a contact. So offset and gain are unknowns of the
fusion, known to be small, and all that the targets say of them is gathered. Once they surely say
that the sensor is off, the fusion begins anew without it, as there are many ways to be off.
Whether the sensor is wrong or the model too stiff nobody can know: while it reads, the interval of
the force holds both answers.

A contact along the arm, too, looks like a sensor that is off. So contacts are told apart from a
tip force only once the targets have confirmed the sensor, without a contact; till then the errors
of an estimate hold both answers. A sensor that breaks afterwards is told by frames that even a
contact hardly explains, and the targets alone do.

Source: score test, Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948), of a prior that is narrow;
cumulative sum, Page, Biometrika 41 (1954), of what fits better without the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
import math

from pneunet_ros.core.arrays import Array
from pneunet_ros.fusion.belief import Belief, told_by_frames
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.measurement.blocks.force_sensor import ForceSensor
from pneunet_ros.measurement.blocks.unknowns import Unknowns

DISAGREES = (
    'force sensor and targets disagree, and the sensor is not used: check its sign, axes and '
    'cable, the pressure, and that the camera was not turned; tare it with nothing at the arm and '
    'reset, or run pneunet diagnose'
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceSensorFault:
    """What a force sensor that is off reads, beside what the targets say: (2,) N of F1 and F2.

    reading: NaN while none is fresh; targets and targets_std: NaN where not determined.
    """

    reading: Array
    targets: Array
    targets_std: Array

    @property
    def words(self) -> str:
        """Say it in numbers."""
        read = ', '.join(f'{value:.4f}' for value in self.reading.tolist())
        pairs = zip(self.targets.tolist(), self.targets_std.tolist(), strict=True)
        said = ', '.join(f'{value:.4f} ± {std:.4f}' for value, std in pairs)
        return f'not used: it reads ({read}) N, the targets say ({said}) N'

    @property
    def numbers(self) -> dict[str, list[float | None]]:
        """Say it to a program, in N."""
        return {
            name: [value if math.isfinite(value) else None for value in values.tolist()]
            for name, values in (
                ('reading', self.reading),
                ('targets', self.targets),
                ('targets_std', self.targets_std),
            )
        }


class Verdict(Enum):
    """What frames have said so far of a sensor that is taken for one in order."""

    OPEN = 'too little is known'
    IN_ORDER = 'confirmed, offset and gain'
    OFF = 'off'


def verdict_on(unknowns: Unknowns, settings: FusionSettings, belief: Belief) -> Verdict:
    """Return what frames have said so far of a sensor that is taken for one in order."""
    tolerance, scale = settings.sensor_tolerance, unknowns.block(ForceSensor).scale
    limits = (tolerance * scale, tolerance * scale, tolerance)
    verdict, where = Verdict.IN_ORDER, unknowns.at(ForceSensor)
    for which, limit in zip(range(where.start, where.stop), limits, strict=True):
        value, std = told_by_frames(unknowns, belief, which)
        if std >= limit:
            verdict = Verdict.OPEN  # a straight arm tells hardly anything, and that is not linear
        elif abs(value) > max(limit, settings.sure * std):
            return Verdict.OFF
    return verdict


def sensor_score(unknowns: Unknowns, belief: Belief) -> float:
    """Return by how many sigma frames say that the sensor is off."""
    where = unknowns.at(ForceSensor)
    errors = [told_by_frames(unknowns, belief, which) for which in range(where.start, where.stop)]
    return max(abs(value) / std for value, std in errors)


def doubt_after(settings: FusionSettings, doubt: float, gain: float) -> float:
    """Return the cumulative sum of doubts after a frame that fits better by a gain without it."""
    least, most = settings.sensor_gain
    return max(doubt + min(gain, most) - least, 0.0)
