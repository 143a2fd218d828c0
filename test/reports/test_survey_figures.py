"""The figures of a survey: what stands over a panel."""

from __future__ import annotations

from pneunet_ros.calibration.fleet import ArmNumber
from pneunet_ros.reports.survey.figures import title_of
import pytest


@pytest.mark.parametrize(
    ('name', 'meaning', 'unit', 'title'),
    [
        ('turning', 'turning angle at 30.03 kPa', 'rad', 'turning angle at 30.03 kPa\n(rad)'),
        ('a_lag.time', 'a_lag.time', 's', 'a lag time (s)'),
        ('gain.share', 'gain.share', '-', 'gain share'),
    ],
)
def test_a_panel_says_its_number(name, meaning, unit, title):
    assert title_of(ArmNumber(name=name, meaning=meaning, unit=unit)) == title
