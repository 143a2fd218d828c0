"""Changes of the record of a rod put together, for tests of how a solved rod answers."""

from __future__ import annotations

import numpy as np
from pneunet_ros.model.perturbation import Perturbation


def join_perturbations(first: Perturbation, second: Perturbation) -> Perturbation:
    """Return the causes of both."""
    return Perturbation(
        distance=np.concatenate([first.distance, second.distance]),
        **{
            name: np.concatenate([getattr(first, name), getattr(second, name)], axis=1)
            for name in ('length', 'sections', 'clamp', 'knots', 'rotation')
        },
    )
