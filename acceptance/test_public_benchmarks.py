"""What a linear oscillator lacks is named by the evidence code of discovery, on one seed each."""

from __future__ import annotations

from public_benchmarks import one_trial, SYSTEMS
import pytest


@pytest.mark.parametrize('system', SYSTEMS, ids=[item.name for item in SYSTEMS])
def test_what_is_missing_is_named(system):
    row = one_trial(system, 101 if system.right else 102)
    assert row['named'] == system.right
    if system.right:
        assert row['held_out'] > 1e4
        assert row['rms_after'] < 0.1 * row['rms']
