"""A stiffness that varies along the arm, which chi squared does not show, and one that does not.

The truth is an elastica of its own: a chain of bent elements of least energy.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.calibration.checks.stiffness_variation import describe_variation, MOST_NEES
from pneunet_ros.calibration.moment_law_parameters import MajidiParameters, MOMENT_LAW_PARAMETERS
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.reports.calibration.verdict import verdict_of
import pytest
from scipy.linalg import solve_banded
from support.refusals import reasons

LENGTH, STIFFNESS, HIGHEST = 0.1, 2e-4, 50e3
TARGETS = np.linspace(0.0, LENGTH, 21)
ELEMENTS, FRAMES = 200, 100
NOISE = SensorNoise(
    pressure_std=60.0, force_std=2e-4, moment_std=1e-5, target_std=1e-4, placement_std=5e-5
)


def elastica(bent, stiffness, force, turned):
    """Return angles (elements,) rad at the middles of elements of an arm of least energy.

    bent (elements,) 1/m without a load; stiffness (elements,) N m^2; from angles nearby.
    """
    step = LENGTH / ELEMENTS
    springs = np.append(stiffness[0] * 2.0, 0.5 * (stiffness[1:] + stiffness[:-1])) / step
    rest = np.append(0.5 * bent[0], 0.5 * (bent[1:] + bent[:-1])) * step
    for _ in range(60):
        moment = springs * (np.diff(turned, prepend=0.0) - rest)
        along, across = np.cos(turned), np.sin(turned)
        uphill = moment - np.append(moment[1:], 0.0)
        uphill -= step * (force[1] * along - force[0] * across)
        bands = np.zeros((3, ELEMENTS))
        bands[1] = springs + np.append(springs[1:], 0.0)
        bands[1] += step * (force[0] * along + force[1] * across)
        bands[0, 1:] = bands[2, :-1] = -springs[1:]
        change = solve_banded((1, 1), bands, uphill)
        turned = turned - np.clip(change, -0.2, 0.2)
        if np.abs(change).max() < 1e-11:
            return turned
    raise AssertionError('no equilibrium')


def recording(name, seed, taper, pressure, force) -> tuple[RecordingData, np.ndarray]:
    """Return what is recorded of an arm of which EI falls by a share, and its true tips."""
    random, middles = np.random.default_rng(seed), (np.arange(ELEMENTS) + 0.5) / ELEMENTS
    stiffness = STIFFNESS * (1.0 - taper * middles)
    painted = 5e-5 * np.random.default_rng(1).standard_normal((2, TARGETS.size))
    turned, points, tips = np.zeros(ELEMENTS), [], []
    for now, acting in zip(pressure, force, strict=True):
        bent = 20.0 * now / HIGHEST * (1.0 - 0.3 * middles)
        turned = elastica(bent, stiffness, acting, turned)
        along = np.stack([np.cos(turned), np.sin(turned)])
        line = np.pad(np.cumsum(along, axis=1) * LENGTH / ELEMENTS, ((0, 0), (1, 0)))
        at = np.linspace(0.0, LENGTH, ELEMENTS + 1)
        true = np.stack([np.interp(TARGETS, at, part) for part in line])
        angle = np.interp(TARGETS, LENGTH * middles, turned)
        placed = (
            np.cos(angle) * painted
            + np.stack([-1.0, 1.0])[:, None] * np.sin(angle) * painted[::-1]
        )
        points.append(true + placed + 1e-4 * random.standard_normal(true.shape))
        tips.append(true[:, -1])
    stamps = 10**9 + 10**8 * np.arange(pressure.size)
    points, loaded = np.array(points), bool(np.any(force))
    read = force + 2e-4 * random.standard_normal(force.shape) * loaded
    return RecordingData(
        name=name,
        reading_stamp_ns=stamps,
        pressure=pressure + 60.0 * random.standard_normal(pressure.size),
        stamp_ns=stamps,
        reading=np.arange(pressure.size),
        loaded=loaded,
        force=read,
        moment=np.zeros(pressure.size),
        x=points[:, 0],
        y=points[:, 1],
    ), np.array(tips)


@cache
def calibrated(taper: float) -> Calibration:
    """Return the calibration of an arm from three recordings."""
    time = np.linspace(0.0, 1.0, FRAMES)
    swing = 0.5 * HIGHEST * (1.0 - np.cos(2.0 * np.pi * time))
    turn = 2.0 * np.pi * 3.0 * time
    sweep = 0.05 * np.column_stack([0.5 + 0.5 * np.cos(turn), np.sin(turn)])
    strings = np.column_stack([0.10 - 0.04 * time, 0.10 * swing / HIGHEST + 0.002])
    free, _ = recording('free', 3, taper, swing, np.zeros((FRAMES, 2)))
    loaded = [
        recording('sweep', 4, taper, 0.9 * swing + 1e3, sweep)[0],
        recording('strings', 5, taper, swing, strings)[0],
    ]
    frame = Arm(
        name='chain',
        length=LENGTH,
        weight=0.15,
        target_arclength=TARGETS,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0, HIGHEST], arclength=[0.0, 0.5, 1.0], curvature=np.zeros((2, 3))
        ),
        moment_law=LinearLaw(bending_stiffness=1e-4),
        sensors=NOISE,
    )
    return calibrate([free], loaded, frame, compare=False)


def test_a_stiffness_that_falls_along_the_arm_is_seen_where_chi_squared_is_noise():
    found = calibrated(0.5)
    joint, variation = found.joint, found.variation
    assert joint.chi_squared / joint.dof < 1.1
    assert variation.matters
    # ln EI falls evenly by ln 2, and so, but for its mean, does what is found.
    true = np.log(1.0 - 0.5 * np.linspace(0.0, 1.0, variation.factors.size))
    error = np.log(variation.factors) - true
    assert np.std(error) < 0.1
    verdict = verdict_of(found)
    assert not verdict.fits
    assert verdict.fit.reason == 'uneven_stiffness'
    assert verdict.command.split()[:2] == ['pneunet', 'diagnose']
    assert reasons(found.notes).count('uneven_stiffness') == 1


def test_what_is_written_holds_the_tips_of_such_an_arm():
    found = calibrated(0.5)
    variation, joint = found.variation, found.joint
    tips, most = variation.tips, MOST_NEES
    assert tips.nees() > most
    further = tips.jacobian @ joint.covariance @ tips.jacobian.transpose(0, 2, 1) - tips.covariance
    assert tips.nees(further) == pytest.approx(most, rel=0.05)
    written = found.arm.covariance
    rows = [place for place, name in enumerate(written.quantities) if 'rigidity' in name]
    sure = calibrated(0.0).arm.covariance
    stds = [np.linalg.norm(item.factor[rows], axis=1).max() for item in (written, sure)]
    assert stds[0] > 1.5 * stds[1]


def test_what_is_guessed_is_told_from_what_is_known():
    found = calibrated(0.5)
    written, law = found.arm.covariance, found.joint.parameters.law
    assert written.guessed == law.sections
    known, guess = np.split(written.factor, [-law.sections], axis=1)
    curvature = [name.startswith('intrinsic') for name in written.quantities]
    assert np.any(known[curvature]) and not np.any(guess[curvature])
    assert not np.any(written.placement.factor[:, -law.sections :])
    # Both together are what the fit says, as far as few columns can.
    names, change = found.joint.parameters.quantities()
    full = np.diag(change @ found.joint.covariance @ change.T)
    rows = [place for place, name in enumerate(names) if 'rigidity' in name]
    assert np.sum(written.factor[rows] ** 2, axis=1) == pytest.approx(full[rows], rel=0.4)
    assert calibrated(0.0).arm.covariance.guessed == 0


def test_an_even_stiffness_is_not_called_uneven():
    found = calibrated(0.0)
    variation = found.variation
    assert not variation.matters
    assert variation.statistic < 40.0
    assert variation.tips.nees() < 0.3
    assert describe_variation(found.joint, variation, law_given=False) == []
    assert verdict_of(found).fits


def test_without_loads_nothing_is_asked():
    time = np.linspace(0.0, 1.0, FRAMES)
    swing = 0.5 * HIGHEST * (1.0 - np.cos(2.0 * np.pi * time))
    free, _ = recording('free', 3, 0.5, swing, np.zeros((FRAMES, 2)))
    frame = replace(calibrated(0.0).arm, covariance=None, domain=None)
    assert calibrate([free], [], frame).variation is None


@pytest.mark.parametrize('kind', MOMENT_LAW_PARAMETERS)
def test_a_section_is_scaled_by_its_parameters(kind):
    law = MOMENT_LAW_PARAMETERS[kind](
        stiffness=STIFFNESS, low=0.0, high=HIGHEST, length=LENGTH, weight=0.15
    )
    pressure = np.array([10e3, 40e3])
    rigidity = [
        law.law(values).sections(pressure, LENGTH, 0.15)[:, :, 1]
        for values in (
            law.mean,
            *(law.mean + 0.01 * column for column in law.scalings(law.mean).T),
        )
    ]
    for section in range(law.sections):
        expected = rigidity[0].copy()
        expected[:, section] *= 1.01
        # Of Majidi's law a part does not go with the modulus.
        rtol = 0.003 if kind == MajidiParameters.kind else 1e-12
        np.testing.assert_allclose(rigidity[1 + section], expected, rtol=rtol)
