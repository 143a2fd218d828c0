"""Tuning constants of the fusion of readings and targets."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import check_settings, setting, tuning
from pneunet_ros.core.units import quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionSettings:
    """Settings of random walks, gating and publishing."""

    target_timeout: float = quantity(
        0.5,
        unit='s',
        meaning='age of the last frame above which estimates are predictions only',
        bounds=(1e-3, 3600.0),
    )
    noise_period: float = tuning(
        0.12,
        'time between readings above which the load changes as much as noise; invented',
        unit='s',
        source='sweep',
    )
    fewest_readings: int = tuning(
        8, 'force readings needed to estimate their noise: six second differences', source='sweep'
    )
    noise_ratio: float = tuning(
        2.0,
        'estimated noise above which it replaces that of the model; invented',
        unit='noise of the model',
        source='sweep',
    )
    fewest_targets: int = tuning(3, 'targets seen in a frame that is used', source='sweep')
    small_gain: float = tuning(
        0.05,
        'gain below which a step ends the search or is rejected: along a curved valley, steps '
        'gain next to nothing for long',
        unit='chi squared',
        source='sweep',
    )
    target_gate: float = tuning(
        25.0,
        'misfit of a target to all others above which it is left out',
        unit='chi squared',
        source='sweep',
    )
    most_left_out: float = tuning(
        0.3, 'largest share of the targets seen that the gate may leave out', source='sweep'
    )
    determined: float = quantity(
        0.06,
        unit='-',
        meaning='largest std of a component of the force that is published, of the force scale',
        bounds=(1e-4, 1.0),
    )
    flat: float = tuning(
        2.0,
        'change of targets within which an undetermined force may be held at its prior',
        unit='sigma',
        source='sweep',
    )
    largest_tip_std: float = quantity(
        3e-3,
        unit='m',
        meaning='standard deviation of the tip above which no prediction is published',
        bounds=(1e-5, 1.0),
    )
    delay_std: float = quantity(
        0.0,
        unit='s',
        meaning='std of the time between frames and pressure, beyond the delay of the model, for '
        'one without motion; 0: both are stamped by one clock',
        bounds=(0.0, 1.0),
    )
    free_tip: bool = setting(False, 'no load ever acts at the tip: no force sensor is needed')
    odds_against: float = tuning(
        5.0,
        'prior log odds against a cause of error',
        unit='nats',
        source='convention: one in 150',
    )
    bound: float = tuning(
        8.0,
        'log odds against a hypothesis, relative to the best, above which it is dropped',
        unit='nats',
        source='convention: one in 3000; tried: with 5 a frozen pressure is taken for a '
        'contact, with 20 the tests of the fusion take several times as long',
    )
    most_hypotheses: int = tuning(4, 'largest number of hypotheses', source='sweep')
    contact_score: float = tuning(
        9.0,
        'linearized gain by a contact above which it is searched for',
        unit='chi squared',
        source='sweep',
    )
    contact_least: float = tuning(
        0.012,
        'smallest contact force that is published: a model error looks like less',
        unit='of the force scale',
        source='sweep',
    )

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)


FUSION = FusionSettings()
