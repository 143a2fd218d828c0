"""Majidi's law: the modulus is fitted, the section is that of the arm that is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.moment_law_parameters import MajidiParameters, PAPER_SECTION
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.moment_law import MajidiLaw
from pneunet_ros.offline.calibration_files import described_arm
import pytest
from support.example_arms import paper_arm
from support.made_datasets import HARDLY_ANY, made
from support.small_calibration import calibration

OWN = MajidiLaw(modulus=3e6, width=0.02, thickness=0.0035, height=0.010, t1=0.0015, t2=0.006)
KNOTS = np.linspace(0.0, 1.0, 5)


def parameters(given: Arm) -> MajidiParameters:
    """Return what is fitted of Majidi's law for an arm."""
    return MajidiParameters(
        stiffness=1.5e-4,
        low=0.0,
        high=60e3,
        length=given.length,
        weight=given.weight,
        given=given.moment_law,
    )


def own_arm() -> Arm:
    """Return an arm with Majidi's law and a section of its own."""
    return replace(paper_arm(), moment_law=OWN, covariance=None)


def calibrated(given: Arm) -> Calibration:
    """Return a calibration in which Majidi's law was fitted for an arm."""
    found = calibration(with_load=False)
    known = replace(found.joint.parameters, law=parameters(given))
    return replace(found, joint=replace(found.joint, parameters=known))


def test_the_section_is_that_of_the_arm():
    law = parameters(own_arm()).law(np.array([2e6]))
    assert law == replace(OWN, modulus=2e6)
    assert law != parameters(paper_arm()).law(np.array([2e6]))


def test_an_arm_without_a_section_has_the_papers():
    assert parameters(paper_arm()).law(np.array([2e6])) == MajidiLaw(modulus=2e6, **PAPER_SECTION)


def test_the_modulus_of_an_arm_with_another_section_is_found():
    rows = np.linspace(0.0, 60e3, 3)
    # A curvature that these knots can have exactly.
    arm = own_arm()
    table = np.array([arm.intrinsic_curvature.at(float(row), KNOTS) for row in rows])
    known = Parameters(
        frame=arm,
        pressure=rows,
        arclength=KNOTS,
        hyperparameters=Hyperparameters(amplitude=40.0, std=4.0, length_scale=0.3),
        law=parameters(arm),
    )
    true = known.arm(np.append(table.ravel(), OWN.modulus))
    up = np.linspace(0.0, 1.0, 12)
    pull = np.column_stack([0.1 + 0.1 * up, 0.05 + 0.1 * up])
    runs = [made(true, 60e3 * up), made(true, 60e3 * up, pull, start=20)]
    found = fit(known, runs, HARDLY_ANY, arm.target_arclength)
    assert found.converged
    assert found.arm.moment_law.modulus == pytest.approx(OWN.modulus, rel=2e-3)


def test_the_file_says_where_the_section_comes_from():
    known = replace(own_arm(), name='mine', sources={'moment_law.width': 'caliper'})
    sources = described_arm(calibrated(known), 'new', known, {}).sources
    assert sources['moment_law.modulus'].startswith('fitted to')
    assert sources['moment_law.width'] == 'caliper'
    assert sources['moment_law.height'] == 'as in mine'
    assert 'moment_law' not in sources
    other = paper_arm()
    sources = described_arm(calibrated(other), 'new', other, {}).sources
    assert all(sources[f'moment_law.{key}'].startswith('assumed') for key in PAPER_SECTION)
