"""Motion of an arm: tip mass and damping, in addition to the mass of the arm, weight / g."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.units import check_quantities, quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Inertia and damping of an arm; the mass of the arm itself follows from `arm.weight`.

    Damping is of the Kelvin-Voigt type: M = B (kappa - kappa0 + damping_time kappa').
    """

    tip_mass: float = quantity(
        0.0,
        unit='kg',
        meaning=('mass at the free end, in addition to that of the arm'),
        bounds=(0.0, 1e3),
    )
    damping_time: float = quantity(
        0.0, unit='s', meaning='damping over stiffness (Kelvin-Voigt)', bounds=(0.0, 1e3)
    )
    mass_error: float = quantity(
        0.0,
        unit='-',
        meaning='relative standard deviation of the moving mass, in addition to the covariance',
        bounds=(0.0, 10.0),
    )
    damping_error: float = quantity(
        0.0,
        unit='-',
        meaning='relative standard deviation of damping_time, in addition to the covariance',
        bounds=(0.0, 10.0),
    )

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_quantities(self, 'motion')
