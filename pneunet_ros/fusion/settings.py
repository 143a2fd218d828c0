"""Tuning constants of the fusion of readings and targets."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionSettings:
    """Settings of random walks, gating and publishing."""

    force_gate: float = tuning(
        6.0, 'innovation of a wrench that resets the force of the belief', unit='chi squared'
    )
    target_timeout: float = tuning(
        0.5, 'age of the last frame above which estimates are predictions only', unit='s'
    )
    coarsest: float = tuning(
        0.05, 'largest quantization step', unit='of the range, or of the force scale'
    )
    noise_readings: int = tuning(60, 'latest force readings for estimating their noise; invented')
    noise_period: float = tuning(
        0.12,
        'time between readings above which the load changes as much as noise; invented',
        unit='s',
    )
    fewest_readings: int = tuning(
        8, 'force readings needed to estimate their noise: six second differences'
    )
    noise_ratio: float = tuning(
        2.0,
        'estimated noise above which it replaces that of the model; invented',
        unit='noise of the model',
        source='sweep',
    )
    usual_gap: float = tuning(
        1.5,
        'longest gap between pressure readings to interpolate across; invented',
        unit='gap before',
    )
    most_ahead: float = tuning(
        0.1, 'lead of a frame over its pressure that triggers a note', unit='s'
    )
    frozen: float = tuning(
        7.0,
        'change of pressure above which a bit-identical frame counts as a copy; invented',
        unit='sigma',
    )
    turn_tolerance: float = tuning(
        0.002, 'turn below which a camera is never taken for moved; invented', unit='rad'
    )
    still_readings: int = tuning(
        5, 'identical pressure readings after which the sensor is tested for being frozen'
    )
    still_frames: int = tuning(5, 'one test per so many frames: an idle sensor may clip at zero')
    most_model_error: float = tuning(
        0.05,
        'size of the model error beyond which the pressure is not used; invented',
        unit='of the range',
    )
    fewest_targets: int = tuning(3, 'targets seen in a frame that is used')
    small_gain: float = tuning(
        0.05,
        'gain below which a step ends the search or is rejected: along a curved valley, steps '
        'gain next to nothing for long',
        unit='chi squared',
    )
    linear: float = tuning(
        0.015,
        'std of the force below which the last step of the search is not checked',
        unit='of the scale',
    )
    target_gate: float = tuning(
        25.0, 'misfit of a target to all others above which it is left out', unit='chi squared'
    )
    most_left_out: float = tuning(
        0.3, 'largest share of the targets seen that the gate may leave out', source='sweep'
    )
    frame_gate: float = tuning(
        4.0, 'NIS above which a frame is not used', unit='limit of the NIS of noise'
    )
    frames_lost: int = tuning(3, 'consecutive unused frames after which a belief may be reset')
    restart_frames: int = tuning(6, 'frames over which the cold starts are tried, once a round')
    starts_followed: int = tuning(
        3, 'cold starts, the best of a round, from which the search begins: one a frame'
    )
    rival: float = tuning(
        9.0, 'cost above the best within which another solution counts', unit='chi squared'
    )
    apart: float = tuning(
        16.0, 'distance of two forces that are two solutions', unit='chi squared'
    )
    determined: float = tuning(
        0.06,
        'largest std of a component of the force that is published',
        unit='of the scale',
        source='sweep',
    )
    flat: float = tuning(
        2.0,
        'change of targets within which an undetermined force may be held at its prior',
        unit='sigma',
    )
    largest_tip_std: float = tuning(
        3e-3, 'std of the tip above which no prediction is published', unit='m'
    )
    free_tip: bool = tuning(False, 'no load ever acts at the tip: no force sensor is needed')
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
    most_hypotheses: int = tuning(4, 'largest number of hypotheses')
    contact_score: float = tuning(
        9.0, 'linearized gain by a contact above which it is searched for', unit='chi squared'
    )
    contact_gone: float = tuning(
        25.0, 'score of a contact force below which it may have ended', unit='chi squared'
    )
    contact_apart: float = tuning(
        0.05, 'distance of two places that are two contacts', unit='of the length'
    )
    contact_least: float = tuning(
        0.012,
        'smallest contact force that is published: a model error looks like less',
        unit='of the force scale',
    )


FUSION = FusionSettings()
