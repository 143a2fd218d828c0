"""The verdict on a calibration: how well, how sure, what next, in words."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.reports.calibration.verdict import (
    bending_stiffness,
    Files,
    larger_under_load,
    stiffness_text,
    stiffness_with_error,
    verdict_of,
)
from pneunet_ros.reports.settings import REPORT_SETTINGS
import pytest
from support.small_calibration import calibration


def test_a_model_as_good_as_the_noise_is_to_be_tested():
    verdict = verdict_of(calibration())
    assert 'as good as the noise' in verdict.fit
    assert 'mm rms per coordinate' in verdict.fit
    assert 'near the clamp' in verdict.certainty
    assert 'N m^2' in verdict.certainty
    assert verdict.command.startswith('pneunet replay')
    named = verdict_of(calibration(), files=Files(model='my arm/model.yaml'))
    assert named.command == "pneunet replay FRESH.mcap --model 'my arm/model.yaml'"


def test_a_model_that_misses_something_is_to_be_diagnosed():
    found = calibration()
    poor = replace(found, joint=replace(found.joint, chi_squared=9.0 * found.joint.dof))
    verdict = verdict_of(poor)
    assert 'does not fit' in verdict.fit
    assert 'worse than the noise: 3 times it' in verdict.fit
    assert verdict.command.startswith('pneunet diagnose')
    assert '--model m.yaml' in verdict_of(poor, files=Files(model='m.yaml')).command


def test_a_model_better_than_its_noise_says_that_the_noise_is_too_large():
    found = calibration()
    good = replace(found, joint=replace(found.joint, chi_squared=0.16 * found.joint.dof))
    verdict = verdict_of(good)
    assert verdict.fit.startswith('The model fits')
    assert 'better than the noise that was assumed: 0.4 times it' in verdict.fit
    assert 'too large' in verdict.fit


def test_a_load_that_only_its_noise_explains_is_not_sure():
    found = calibration()
    larger = larger_under_load(found.joint)
    assert 0.5 < larger < REPORT_SETTINGS.hidden_under_load
    strict = replace(REPORT_SETTINGS, hidden_under_load=0.9 * larger)
    verdict = verdict_of(found, strict)
    assert verdict.fit.startswith('Not sure: ')
    assert f'left {larger:.2g} times what unloaded ones are' in verdict.fit


def test_without_load_stiffness_was_not_measured():
    found = calibration()
    free = replace(found.joint, runs=[item for item in found.joint.runs if not item.run.loaded])
    verdict = verdict_of(replace(found, joint=free))
    assert 'not measured' in verdict.certainty
    assert '--loaded LOADED.mcap --arm ARM.yaml' in verdict.command


def test_a_fit_that_did_not_settle_gives_no_model():
    found = calibration()
    lost = replace(found, joint=replace(found.joint, converged=False, status='too few frames'))
    verdict = verdict_of(lost, files=Files(arm='finger.yaml'))
    assert verdict.fit.startswith('No model')
    assert verdict.command.startswith('pneunet check')
    assert verdict.command.endswith(' --model finger.yaml')
    assert 'one clock and the force is that on the arm' in verdict_of(lost).next_step


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
