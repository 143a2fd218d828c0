"""The out-of-plane part of an end wrench, which a planar model ignores."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.model.arm import Arm

TINY = 1e-300  # no limit, for sensors without noise
NOISE = 4.0  # sigma of a sensor: smallest limit
STOP = 3.0  # times the limit of a warning is an error, as documented for out_of_plane_limit


@dataclass(frozen=True, slots=True, kw_only=True)
class OutOfPlane:
    """The out-of-plane component that is largest relative to its limit.

    component: Fz, Mx or My; value and limit in N or N m; warns, stops: whether it exceeds the
    limit for a warning, or for an estimate.
    """

    component: str
    value: float
    limit: float
    warns: bool
    stops: bool

    @property
    def note(self) -> str:
        """Return the warning without numbers."""
        return f'{self.component} of the end wrench is beyond out_of_plane_limit'

    @property
    def sentence(self) -> str:
        """Return the warning with value and limit."""
        unit = 'N' if self.component == 'Fz' else 'N m'
        return (
            f'{self.component} of the end wrench is {self.value:.3g} {unit} out of the plane '
            f'of the model, more than three times the limit of {self.limit:.3g} {unit} '
            '(out_of_plane_limit)'
        )


def out_of_plane(arm: Arm, settings: EstimatorSettings, wrench: WrenchReading) -> OutOfPlane:
    """Return the out-of-plane part of an end wrench, relative to its limit.

    The limit is a share of the largest force in the domain of the arm, and of the largest moment,
    but at least the noise. Without a domain, the weight of the arm is used as the force.
    """
    if arm.domain is None:
        force, moment = arm.weight, arm.weight * arm.length
    else:
        force, moment = arm.domain.largest_force, arm.domain.largest_moment(arm.length)
    share, sensors = settings.out_of_plane_limit, arm.sensors
    largest_force = max(share * force, NOISE * sensors.force_std)
    largest_moment = max(share * moment, NOISE * sensors.moment_std)
    parts = (
        ('Fz', wrench.force_z, largest_force),
        ('Mx', wrench.moment_x, largest_moment),
        ('My', wrench.moment_y, largest_moment),
    )
    component, value, limit = max(parts, key=lambda part: abs(part[1]) / max(part[2], TINY))
    return OutOfPlane(
        component=component,
        value=value,
        limit=limit,
        warns=abs(value) > limit,
        stops=abs(value) > STOP * limit,
    )
