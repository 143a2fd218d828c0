"""The clock of a camera beside that of the readings: films whose lost frames nobody counted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration import calibration
from pneunet_ros.calibration.camera_clock import (
    camera_clocks,
    CameraClock,
    combined_clock,
    correct_stamps,
    seconds_after,
)
from pneunet_ros.calibration.noise_estimate import NoiseEstimate
from pneunet_ros.calibration.result import Fit
import pytest
from support.lab_designs import base, noise

pytestmark = pytest.mark.lengthy


def drifting(which: int, late: float, rate: float) -> tuple[Fit, CameraClock]:
    """Return the fit to recordings of which one is stamped late (s), and its clock."""
    fit = base()
    run = fit.runs[which].run
    middle_ns = int(run.stamp_ns[0] + run.stamp_ns[-1]) // 2
    clock = CameraClock(name=run.name, middle_ns=middle_ns, delay=late, rate=rate, rate_std=1e-4)
    runs = list(fit.runs)
    # Stamped late is corrected by what stamps it early.
    runs[which] = replace(
        runs[which], run=correct_stamps(run, replace(clock, delay=-late, rate=-rate))
    )
    return replace(fit, runs=tuple(runs)), clock


def test_clocks_that_are_right_are_no_finding():
    assert camera_clocks(base(), noise()) == {}


@pytest.mark.parametrize(('late', 'rate'), [(0.0, 2e-3), (0.02, -3e-3)])
def test_a_clock_that_goes_slow_is_found_beside_the_others(late, rate):
    fit, clock = drifting(0, late, rate)
    found = camera_clocks(fit, noise())
    assert list(found) == [clock.name]
    one = found[clock.name]
    assert one.rate == pytest.approx(rate, abs=4.0 * one.rate_std)
    assert one.rate_std < 0.5 * abs(rate)
    assert one.delay == pytest.approx(late, abs=0.01)
    assert one.evidence > 1.0
    assert ('lost' in one.sentence) == (rate < 0.0)


def test_a_delay_is_said_without_a_minus():
    clock = CameraClock(name='film', middle_ns=0, delay=-0.132, rate=-1e-2, rate_std=2e-4)
    assert 'stamped 132 ms early)' in clock.sentence
    assert 'stamped 132 ms late)' in replace(clock, delay=0.132).sentence


def test_a_clock_that_is_late_alone_is_left_to_a_diagnosis():
    assert camera_clocks(drifting(0, 0.03, 0.0)[0], noise()) == {}


def test_corrected_stamps_are_those_of_the_readings():
    fit, clock = drifting(0, 0.02, -3e-3)
    run, wrong = base().runs[0].run, fit.runs[0].run
    again = correct_stamps(wrong, clock)
    assert np.abs(again.stamp_ns - run.stamp_ns).max() < 5e-3 * np.ptp(
        wrong.stamp_ns - run.stamp_ns
    )
    assert np.abs(again.reading - run.reading).max() <= 1
    assert correct_stamps(wrong, None) is wrong
    later = replace(clock, middle_ns=clock.middle_ns + 10**9, delay=0.001, rate=1e-3)
    both = combined_clock(clock, later)
    assert both.rate == pytest.approx(clock.rate + 1e-3)
    time = seconds_after(run, clock.middle_ns)
    apart = clock.delay + clock.rate * time + 0.001 + 1e-3 * (time - 1.0)
    assert both.delay + both.rate * time == pytest.approx(apart)


@pytest.mark.parametrize('rate, is_wrong', [(5e-4, False), (-2e-4, False), (-2e-3, True)])
def test_a_clock_is_wrong_where_that_of_a_crystal_would_not_be(rate, is_wrong):
    clock = CameraClock(name='film', middle_ns=0, delay=0.0, rate=rate, rate_std=1e-4)
    assert (clock.evidence > 0.0) == is_wrong


@dataclass(frozen=True)
class Found:
    """What `calibrate` looks at in a calibration by some stamps."""

    joint: Fit
    delay: float
    noise: NoiseEstimate
    motion: None = None
    notes: tuple[str, ...] = ()


@pytest.mark.parametrize(
    'gains, lost, misfit, corrected',
    [
        ((20.0, 30.0), 0, 1.0, 2),
        ((20.0, 3.0), 0, 1.0, 1),
        ((-50.0,), 0, 1.0, 0),
        ((20.0,), 2000, 1.0, 0),
        ((6.0,), 0, 1.4, 0),
        ((8.0,), 0, 1.4, 1),
        ((40.0,), 0, 1.7, 0),  # hysteresis: better than before, but not by the noise alone
        ((40.0, 40.0), 0, (5.0, 1.7, 1.0), 2),
    ],
)
def test_stamps_are_corrected_where_that_makes_the_fit_as_good_as_the_noise(
    monkeypatch, gains, lost, misfit, corrected
):
    fit, clock = drifting(0, 0.02, -3e-3)
    runs, evidence = [item.run for item in fit.runs], fit.log_evidence
    evidences = np.concatenate([[evidence], evidence + np.cumsum(gains)])
    misfits = np.broadcast_to(misfit, evidences.shape)
    fits = [
        replace(
            fit,
            log_evidence=float(value),
            dof=fit.dof - lost * (which > 0),
            chi_squared=float(misfits[which]) * fit.dof,
            converged=True,
        )
        for which, value in enumerate(evidences)
    ]
    monkeypatch.setattr(
        calibration,
        'calibrate_as_stamped',
        lambda unloaded, loaded, frame, **_: Found(
            joint=fits.pop(0),
            delay=float(np.mean(unloaded[0].stamp_ns - runs[0].stamp_ns)),
            noise=NoiseEstimate(noise=noise(), sources={}),
        ),
    )
    monkeypatch.setattr(
        calibration, 'camera_clocks', lambda *_: {clock.name: clock} if fits else {}
    )
    found = calibration.calibrate(runs, [], fit.arm)
    assert [note.reason for note in found.notes] == ['other_clock'] * (corrected > 0)
    assert found.delay == pytest.approx(-0.02e9 * corrected, abs=1e6)  # ns
