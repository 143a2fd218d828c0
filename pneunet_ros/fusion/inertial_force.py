"""Evidence for a mass, from the forces that frames of an arm without mass seem to need.

An arm that swings bends as one without mass under its load less an inertial force, the mass times
the acceleration of the tip. If the forces that fit the frames change less from frame to frame once
this is added, the arm has mass. Both courses are random walks of an unknown rate.

A load on a massless arm that goes up and down smoothly, up to 1.4 times as fast as the first mode,
looks like this too; but arms have mass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between
from pneunet_ros.measurement.inference.adequacy import chi_square_limit

FRAMES = 4  # of two accelerations, one after the other: second differences
# Of the first mode from frame to frame, at most: the ends of a ramp of the load, whose changes are
# smoother with any mass, count four times as much against it then; convention.
RADIANS = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipInFrame:
    """The last target in a frame, and the force at the tip.

    place (2,) m and its variance m^2; force (2,) N and its variances.
    """

    stamp_ns: int
    place: Array
    place_variance: float
    force: Array
    force_variance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InertialForce:
    """The evidence of all frames so far for a mass.

    mass (kg): force at the tip per acceleration of the last target, in the first mode; frequency
    (rad/s) of this mode; rates (n,) N/sqrt(s): possible random walks of the load; evidence (2, n):
    log likelihoods of the force changes, without and with the mass; tips: in the last frames.
    """

    mass: float
    frequency: float
    rates: Array
    evidence: Array
    tips: tuple[TipInFrame, ...] = ()

    @property
    def log_odds(self) -> float:
        """Log odds (nats) of the mass, without its prior."""
        without, with_mass = np.logaddexp.reduce(self.evidence, axis=1)
        return float(with_mass - without)

    def swing_at_rest(self) -> tuple[float, float] | None:
        """Return what one sigma (m, m/s) of a swing may have been in the last frame but one.

        The tip has not moved: a deviation from equilibrium would have accelerated it. None if it
        has moved in these frames, or they are too rare to tell.
        """
        tips = self.tips
        if len(tips) < FRAMES or any(map(has_moved, tips[:-1], tips[1:])):
            return None
        *_, earlier, later = tips
        seconds = seconds_between(earlier.stamp_ns, later.stamp_ns)
        if seconds * self.frequency > RADIANS:
            return None
        std = math.sqrt(earlier.place_variance + later.place_variance)
        return 2.0 * std / (self.frequency * seconds) ** 2, std / seconds

    def after(self, tip: TipInFrame, *, is_free: bool) -> InertialForce:
        """Return the evidence after a further frame; is_free: whether its force is not read."""
        tips = (*self.tips[1 - FRAMES :], tip)
        stamps = np.array([one.stamp_ns for one in tips])
        seconds = np.diff(stamps) / NANOSECONDS_PER_SECOND
        if seconds.size and (seconds <= 0.0).any():
            return replace(self, tips=(tip,))
        if not is_free or len(tips) < FRAMES or seconds.max() * self.frequency > RADIANS:
            return replace(self, tips=tips)
        evidence = self.evidence + self.log_likelihoods(tips, seconds)
        return replace(self, tips=tips, evidence=freeze(evidence))

    def log_likelihoods(self, tips: tuple[TipInFrame, ...], seconds: Array) -> Array:
        """Return those of the change of force between the two frames in the middle, (2, rates).

        The same if the tip rests: noise of its places would speak against a mass. seconds (3,)
        from frame to frame.
        """
        _, earlier, later, _ = tips
        places = np.array([one.place for one in tips])
        velocities = np.diff(np.eye(FRAMES), axis=0) / seconds[:, None]
        between = 0.5 * (seconds[1:] + seconds[:-1])
        (by_place,) = np.diff(np.diff(velocities, axis=0) / between[:, None], axis=0)
        rests = not any(map(has_moved, tips[:-1], tips[1:]))
        inertial = np.zeros(2) if rests else self.mass * (by_place @ places)
        moved = self.mass**2 * float(by_place**2 @ [one.place_variance for one in tips])
        change = later.force - earlier.force
        noise = earlier.force_variance + later.force_variance + moved
        variance = self.rates[:, None] ** 2 * seconds[1] + noise
        return np.array([log_density(one, variance) for one in (change, change + inertial)])


def has_moved(earlier: TipInFrame, later: TipInFrame) -> bool:
    """Whether the tip has moved between two frames by more than noise."""
    moved = later.place - earlier.place
    variance = earlier.place_variance + later.place_variance
    return float(moved @ moved) > moved.size * variance * chi_square_limit(moved.size)


def log_density(change: Array, variance: Array) -> Array:
    """Return log densities (rates,) of a change (2,) N of these variances (rates, 2), but pi."""
    return np.asarray(-0.5 * np.sum(np.log(variance) + change**2 / variance, axis=1))
