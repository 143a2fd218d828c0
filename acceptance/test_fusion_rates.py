"""The bench of other rates: what is heard is what a way says, and sigmas too small fail it."""

from __future__ import annotations

import fusion_rates as bench
from fusion_rates import events_of, Way
import numpy as np
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
import pytest


@pytest.fixture(scope='module')
def recording():
    return bench.recording_of(77, 0, swing=True)


def test_what_is_heard_is_what_a_way_says(recording):
    way = Way(
        pressure=10,
        wrench=17,
        frames=5,
        late=0.2,
        pressure_step=300.0,
        force_step=5e-3,
        begins=1.0,
    )
    heard = list(events_of(recording, way, 77, wrench=True))
    kinds = {
        kind: [(instant, event) for instant, event in heard if isinstance(event, kind)]
        for kind in (PressureReading, WrenchReading, TargetSightings)
    }
    for kind, every in ((PressureReading, 10), (WrenchReading, 17), (TargetSightings, 5)):
        assert {instant % every for instant, _ in kinds[kind]} == {0}
    assert kinds[PressureReading][0][0] == 50
    assert kinds[TargetSightings][0][0] == 40  # of 0.2 s before the beginning
    for _, event in kinds[PressureReading]:
        assert event.pressure / 300.0 == pytest.approx(round(event.pressure / 300.0))
    for _, event in kinds[WrenchReading]:
        assert event.force_x / 5e-3 == pytest.approx(round(event.force_x / 5e-3))
    # A frame comes after all readings that are not later than its coming.
    frame = heard.index(kinds[TargetSightings][3])
    before = [instant for instant, event in heard[:frame] if isinstance(event, PressureReading)]
    assert before[-1] <= heard[frame][0] + 10
    assert not any(isinstance(event, WrenchReading)
                   for _, event in events_of(recording, way, 77, wrench=False))  # fmt: skip


def rig_of(**tried):
    """Return a rig whose errors are of their sigmas, but in some of the ways."""
    nees = np.sum(np.random.default_rng(5).standard_normal((4, 500, 2, 2)) ** 2, axis=-1)
    right = np.stack([1e-4 * nees[..., 0], nees[..., 0], nees[..., 1], nees[..., 1]], axis=-1)
    names = [f'{name}, {sensors}' for name in bench.WAYS for sensors in bench.SENSORS]
    return dict.fromkeys(names, right) | tried


def test_errors_of_their_sigmas_reach_the_goals_and_others_miss_them():
    way, random = 'frames 0.2 s late, no wrench', np.random.default_rng(3)
    error = random.standard_normal((4, 500, 2, 2))
    for sure in (1.0, 1.5):
        nees = sure**2 * np.sum(error**2, axis=-1)
        rows = np.stack([1e-4 * nees[..., 0], nees[..., 0], nees[..., 1], nees[..., 1]], axis=-1)
        rows[:, :20] = np.nan  # without an estimate
        rows[:, 20:140, 2:] = np.nan  # without a force
        found = bench.summary_of([rig_of(**{way: rows})])
        assert found['ways'][way]['estimates'] == pytest.approx(0.96)
        assert found['ways'][way]['determined'] == pytest.approx(0.75)
        assert len(found['missed']) == (0 if sure == 1.0 else 2)


def test_what_is_never_told_misses_the_goals():
    rows = np.full((4, 500, len(bench.COLUMNS)), np.nan)
    for way, count in (('swing, wrench', 3), ('swing, frames 0.4 s late, no wrench', 2)):
        missed = bench.summary_of([rig_of(**{way: rows})])['missed']
        assert len(missed) == count and 'estimates = 0' in missed[count - 1]


def test_a_rig_that_was_kept_without_a_way_of_the_goals_reaches_none():
    rig = rig_of()
    del rig['swing, wrench']
    with pytest.raises(KeyError):
        bench.summary_of([rig])
