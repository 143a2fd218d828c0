"""The verdict on a calibration: how well, how sure, what next, in words."""

from __future__ import annotations

from dataclasses import replace
import shlex

import numpy as np
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.reports.calibration.verdict import (
    bending_stiffness,
    Files,
    loaded_residual_ratio,
    stiffness_text,
    stiffness_with_error,
    verdict_of,
)
from pneunet_ros.reports.settings import REPORT_SETTINGS
import pytest
from support.small_calibration import calibration


def test_a_model_as_good_as_the_noise_is_to_be_tested():
    verdict = verdict_of(calibration())
    assert verdict.fit.reason == 'fits'
    assert 'N m^2' in verdict.certainty
    assert verdict.command.split()[1] == 'replay'
    named = verdict_of(calibration(), files=Files(model='my arm/model.yaml'))
    assert shlex.split(named.command)[-2:] == ['--model', 'my arm/model.yaml']


def test_a_model_that_misses_something_is_to_be_diagnosed():
    found = calibration()
    poor = replace(found, joint=replace(found.joint, chi_squared=9.0 * found.joint.dof))
    verdict = verdict_of(poor)
    assert (verdict.fit.reason, '(3 times' in verdict.fit) == ('misfit', True)
    assert 'is missing, or the noise is correlated' in verdict.fit
    assert verdict.command.split()[1] == 'diagnose'
    assert '--model m.yaml' in verdict_of(poor, files=Files(model='m.yaml')).command


def test_a_model_better_than_its_noise_says_that_the_noise_is_too_large():
    found = calibration()
    good = replace(found, joint=replace(found.joint, chi_squared=0.16 * found.joint.dof))
    verdict = verdict_of(good)
    assert verdict.fits
    assert (verdict.fit.reason, '(0.4 times' in verdict.fit) == ('better_than_noise', True)


def test_a_load_that_only_its_noise_explains_is_not_sure():
    found = calibration()
    larger = loaded_residual_ratio(found.joint)
    assert 0.5 < larger < REPORT_SETTINGS.hidden_under_load
    more = 1.1 * REPORT_SETTINGS.hidden_under_load / larger - 1.0
    runs = [
        replace(item, disturbance=item.disturbance - more * item.residual * item.run.loaded)
        for item in found.joint.runs
    ]
    verdict = verdict_of(replace(found, joint=replace(found.joint, runs=runs)))
    assert (verdict.fit.reason, ' 6.6 times' in verdict.fit) == ('unsure', True)


def test_without_load_stiffness_was_not_measured():
    found = calibration()
    free = replace(found.joint, runs=[item for item in found.joint.runs if not item.run.loaded])
    verdict = verdict_of(replace(found, joint=free))
    assert 'N m^2' not in verdict.certainty
    assert '--loaded' in verdict.command


def test_a_fit_that_did_not_settle_gives_no_model():
    found = calibration()
    lost = replace(found, joint=replace(found.joint, converged=False, status='too few frames'))
    verdict = verdict_of(lost, files=Files(arm='finger.yaml'))
    assert (verdict.fits, verdict.fit.reason) == (False, 'not_settled')
    assert verdict.command.split()[1] == 'check'
    assert verdict.command.split()[-2:] == ['--model', 'finger.yaml']


@pytest.mark.parametrize(
    ('value', 'std', 'text'),
    [
        (9.31e-4, 2.1e-6, '(9.310 ± 0.021)e-4 N m^2'),
        (5.0e-4, 0.0, '(5.0 ± 0.0)e-4 N m^2'),
        (-2.5e-4, 1e-4, '(-2.5 ± 1.0)e-4 N m^2'),
        (0.0, 0.1, '(0.00 ± 0.10)e0 N m^2'),
    ],
)
def test_a_stiffness_stands_with_its_error(value, std, text):
    assert stiffness_with_error(value, std) == text


def test_a_pressure_that_is_a_little_below_zero_is_shown_as_zero():
    (item, *_) = bending_stiffness(calibration().joint)
    assert stiffness_text([replace(item, pressure=-30.0)]).endswith(', at 0 kPa')


def test_a_single_stiffness_is_said_at_no_pressure():
    joint = calibration().joint
    given, law = joint.arm, joint.parameters.law
    single = MOMENT_LAW_PARAMETERS['linear'](
        stiffness=1.3e-4, low=law.low, high=law.high, length=given.length, weight=given.weight
    )
    table = joint.values.size - law.mean.size
    linear = replace(
        joint,
        parameters=replace(joint.parameters, law=single),
        values=np.append(joint.values[:table], 1.3e-4),
        covariance=np.diag(np.append(np.zeros(table), 1e-12)),
    )
    (item,) = bending_stiffness(linear)
    assert (item.pressure, item.std) == (None, pytest.approx(1e-6))
    assert stiffness_text([item]).startswith('(1.3000 ± 0.0100)e-4 N m^2, one number for all')
    assert 'kPa' not in stiffness_text([item])
    still = [
        replace(one, run=replace(one.run, pressure=np.full_like(one.run.pressure, 30e3)))
        for one in linear.runs
    ]
    (beam,) = bending_stiffness(replace(linear, runs=still))
    assert stiffness_text([beam]).endswith(' kPa')
