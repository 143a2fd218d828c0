"""When a law may take the place of a name."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.diagnosis.selection import Record
from pneunet_ros.discovery.discovery import predicts_better
from pneunet_ros.discovery.settings import DISCOVERY
import pytest

LIMITS = DISCOVERY.confirmation
NAME = Record(
    names=('gravity',), dof=2, evidence=50.0, gain=110.0, tests=(), adequate=True,
    plausible=True,
    predicted=-2500.0,
)  # fmt: skip
LAW = replace(NAME, names=('proposed_push',), evidence=70.0, predicted=-2490.0)


@pytest.mark.parametrize(
    ('law', 'better'),
    [
        ({}, True),
        ({'evidence': 59.0}, False),
        ({'evidence': 61.0}, True),
        ({'predicted': -2503.0}, True),
        ({'predicted': -2505.0}, False),
        ({'outside_prior': ('push = 9 N lies outside its prior range',)}, False),
    ],
)
def test_a_law_meets_what_a_name_has_to_meet_by_far_better(law, better):
    assert predicts_better(replace(LAW, **law), NAME, LIMITS) is better


def test_beside_a_strong_effect_a_tenth_counts():
    strong = replace(NAME, evidence=1000.0)
    assert not predicts_better(replace(LAW, evidence=1080.0), strong, LIMITS)
    assert predicts_better(replace(LAW, evidence=1120.0), strong, LIMITS)
