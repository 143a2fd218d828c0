"""Evidence for a mass from forces: of a mass on a spring, and of the spring alone."""

from __future__ import annotations

import numpy as np
from pneunet_ros.fusion.inertial_force import InertialForce, TipInFrame
import pytest

MASS, STIFFNESS, SECONDS = 0.004, 0.25, 0.03  # 1.3 Hz, frames at 33 Hz
FREQUENCY = np.sqrt(STIFFNESS / MASS)
PLACE_STD, FORCE_STD = 2e-5, 2e-4


def evidence_of(place, force, seconds=SECONDS, *, is_free=True) -> InertialForce:
    """Return the evidence of frames of a tip at places (frames,) m under forces (frames,) N."""
    random, rates = np.random.default_rng(5), np.geomspace(5e-4, 0.3, 6)
    found = InertialForce(
        mass=MASS, frequency=FREQUENCY, rates=rates, evidence=np.zeros((2, rates.size))
    )
    for which, (one, pull) in enumerate(zip(place, force, strict=True)):
        tip = TipInFrame(
            stamp_ns=round(1e9 * seconds * which),
            place=np.array([0.1, one]) + PLACE_STD * random.standard_normal(2),
            place_variance=PLACE_STD**2,
            force=np.array([0.0, pull]) + FORCE_STD * random.standard_normal(2),
            force_variance=np.full(2, FORCE_STD**2),
        )
        found = found.after(tip, is_free=is_free)
    return found


def swing(frames: int, seconds: float = SECONDS) -> np.ndarray:
    """Return the deviation (frames,) m of a mass that swings on its spring."""
    return 0.03 * np.cos(FREQUENCY * seconds * np.arange(frames))


def test_a_swing_shows_its_mass():
    """Without mass, the spring needs the inertial force as a load."""
    place = swing(30)
    assert evidence_of(place, STIFFNESS * place).log_odds > 20.0


@pytest.mark.parametrize('rise', [0.05, 0.2, 0.45])
def test_a_spring_without_mass_shows_none(rise):
    """It follows a load that rises and falls within a time (s)."""
    time = SECONDS * np.arange(100) % 1.2
    load = 0.02 * np.clip(np.minimum(time, 1.2 - time) / rise, 0.0, 1.0)
    assert evidence_of(load / STIFFNESS, load).log_odds < 0.0


def test_an_arm_that_pressure_moves_without_a_load_has_no_mass():
    assert evidence_of(swing(30), np.zeros(30)).log_odds < -20.0


def test_an_arm_at_rest_says_nothing():
    assert evidence_of(np.zeros(200), np.zeros(200)).log_odds == 0.0


def test_rare_frames_and_forces_that_are_read_say_nothing():
    place = swing(30, 3.0 * SECONDS)
    assert evidence_of(place, STIFFNESS * place, 3.0 * SECONDS).log_odds == 0.0
    place = swing(30)
    assert evidence_of(place, STIFFNESS * place, is_free=False).log_odds == 0.0


def test_frames_that_go_back_in_time_begin_anew():
    known = evidence_of(np.zeros(5), np.zeros(5))
    again = known.after(known.tips[0], is_free=True)
    assert len(again.tips) == 1
    assert again.log_odds == known.log_odds


def test_a_tip_that_stays_bounds_its_swing():
    """What would have moved it by one sigma since the last frame."""
    deviation, velocity = evidence_of(np.zeros(5), np.zeros(5)).swing_at_rest()
    std = np.sqrt(2.0) * PLACE_STD
    assert velocity == pytest.approx(std / SECONDS)
    assert 0.5 * FREQUENCY**2 * deviation * SECONDS**2 == pytest.approx(std)
    for frames in range(4, 40):  # turning points too
        assert evidence_of(swing(frames), np.zeros(frames)).swing_at_rest() is None
    assert evidence_of(np.zeros(5), np.zeros(5), 3.0 * SECONDS).swing_at_rest() is None
    assert evidence_of(np.zeros(3), np.zeros(3)).swing_at_rest() is None
