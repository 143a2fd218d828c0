"""The numbers by which a calibration decides, each with its meaning and source."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuned


@dataclass(frozen=True, slots=True, kw_only=True)
class MapEstimationSettings:
    """When the search for the most probable parameters ends."""

    most_steps: int = tuned(25, 'Gauss-Newton steps at most')
    small_step: float = tuned(0.05, 'size of all that is fitted that ends it', unit='sigma')
    nearly: float = tuned(10.0, 'left where no step helps any more: still a model', unit='sigma')
    most_halvings: int = tuned(8, 'of a step, until it lowers the cost')


@dataclass(frozen=True, slots=True, kw_only=True)
class TipForceSettings:
    """When the search for an end force ends, and when that force is determined."""

    most_steps: int = tuned(30, 'Gauss-Newton steps at most')
    small_step: float = tuned(1e-4, 'step that ends the search', unit='sigma of the force')
    largest_step: float = tuned(0.1, 'of a component in one step', unit='N')
    smallest_normal: float = tuned(1e-4, 'of a force not determined at all', unit='1/N^2')
    largest_sigma: float = tuned(10.0, 'what is less certain is not determined', unit='N')


MAP_ESTIMATION = MapEstimationSettings()
TIP_FORCE = TipForceSettings()
