"""Initial arm for a calibration: measured size and weight, placeholders for all other values."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from pneunet_ros.model.uncertainty import SensorNoise

MEASURED = 'measured with a ruler and a scale'
INVENTED = 'invented, as a starting point for the calibration'
# Placeholders until the first calibration.
TURN = 2.0  # rad, of the tip at the largest pressure
SPLIT = 0.1  # l1 / l, representative: the paper's arm
RIGIDITY = (0.085, 0.05)  # B / (mg l^2), representative: the paper's arm


def starting_arm(
    name: str, length: float, weight: float, places: Array, largest_pressure: float
) -> Arm:
    """Return an evenly bending arm of this size, with placeholder values marked as such.

    Args:
        name: that of the model.
        length: from the clamp to the free end, m.
        weight: that of the arm, N.
        places: positions of its targets along it, (targets,) m.
        largest_pressure: in use, Pa; negative for vacuum.

    Returns:
        The arm, for `calibrate --arm` and for tracking.

    Raises:
        ModelError: the numbers are not those of a valid arm.
    """
    pressure = np.array(sorted([0.0, largest_pressure]))
    curvature = np.outer(np.abs(pressure / largest_pressure), np.full(3, TURN / length))
    return Arm(
        name=name,
        length=length,
        weight=weight,
        target_arclength=places,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=pressure, arclength=np.array([0.0, 0.5, 1.0]), curvature=curvature
        ),
        moment_law=PiecewiseLinearLaw(
            pressure=pressure,
            split=np.full(2, SPLIT),
            rigidity=np.tile(RIGIDITY, (2, 1)),
            moment_offset=np.zeros((2, 2)),
        ),
        sensors=SensorNoise(pressure_std=60.0, force_std=1e-3, moment_std=1e-5, target_std=1.2e-4),
        sources={
            'arm': MEASURED,
            'intrinsic_curvature': INVENTED,
            'moment_law': INVENTED,
            'sensors': 'representative of common sensors; replace by the values of yours',
        },
        provenance={'source': 'pneunet new-arm', 'recordings': []},
    )


def has_invented_stiffness(arm: Arm) -> bool:
    """Return whether the stiffness is a placeholder, which no loaded recording has replaced."""
    return INVENTED in arm.sources.get('moment_law', '')


def even_places(length: float, targets: int, diameter: float, step: float) -> Array:
    """Return positions (targets,) m from the clamp, in whole steps (m).

    The last dot is completely on the arm.
    """
    spacing = (length - 0.5 * diameter) / (targets - 1)
    steps = np.arange(targets) * int(spacing / step + 1e-9)
    return np.round(steps * step, 9)
