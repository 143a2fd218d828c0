"""The bench of the fusion: reaches its goals with right sigmas, and can say no."""

from __future__ import annotations

from types import SimpleNamespace

import fusion as bench
import numpy as np
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.fusion import Fusion
import pytest
import rigs
from rigs import force_error
from support.lab_run import true_model

RECORDINGS, INSTANTS = 6, 400


def rows(tip=5e-5, share=0.01, sure=1.0, seed=3):
    """Return what a rig gave per way: errors of these sizes, sigmas `sure` times too small."""
    random = np.random.default_rng(seed)

    def drawn(way):
        found = np.zeros((RECORDINGS, INSTANTS, len(bench.COLUMNS)))
        error = random.standard_normal((RECORDINGS, INSTANTS, 2, 2))
        nees = sure**2 * np.sum(error**2, axis=-1)
        values = {
            'tip': tip * np.hypot(*error[:, :, 0].T).T,
            'tip_nees': nees[..., 0],
            'share': share * np.abs(error[:, :, 1, 0]),
            'sigma': share / sure,
            'force_nees': nees[..., 1],
            'components': 2.0,
            'pressed': 1.0,
            'mode': 1.0,
            'predicted_alone': 8e-4,
            'camera_alone': 4e-4,
        }
        for name, value in values.items():
            found[..., bench.COLUMNS.index(name)] = value
        return found

    return {way: drawn(way) for way in bench.WAYS}


def test_errors_of_their_sigmas_reach_the_goals_and_others_miss_them():
    assert bench.summary_of([rows()])['missed'] == []
    sure = bench.summary_of([rows(sure=1.5)])['missed']
    assert any('tip_covered' in sentence for sentence in sure)
    assert any('force_nees' in sentence for sentence in sure)
    coarse = bench.summary_of([rows(tip=3e-4, share=0.045)])['missed']
    assert any('no wrench: tip_rms' in sentence for sentence in coarse)
    assert any('no wrench: sure_rms' in sentence for sentence in coarse)
    assert any('no wrench: worst_of_better' in sentence for sentence in coarse)


def test_silence_misses_the_goals_of_every_way():
    for way in bench.WAYS:
        found = rows()
        found[way][:, 40:] = np.nan
        found[way][:, 40:, bench.COLUMNS.index('mode')] = 0.0  # one is due
        missed = bench.summary_of([found])['missed']
        assert f'{way}: estimates = 0.1, wanted 0.95 to 1' in missed
        assert any(f'{way}: mode_right' in one for one in missed) == ('lost' in way)


def test_an_estimate_is_due_where_its_sensors_are_heard():
    mode, pressure = bench.Mode, PressureReading(stamp_ns=1, pressure=1e3)
    frame, wrench = bench.sightings_of(1, *np.zeros((2, 23))), bench.wrench_of(1, np.zeros(4))
    assert bench.is_due({mode.FUSED}, [pressure])
    assert not bench.is_due({mode.FUSED}, [frame, wrench])
    assert bench.is_due({mode.CAMERA_ONLY}, [frame])
    assert bench.is_due({mode.PREDICTION}, [wrench, pressure])
    assert not bench.is_due({mode.PREDICTION}, [pressure])
    assert not bench.is_due({mode.FUSED, mode.PREDICTION}, [frame, wrench, pressure])


def test_a_force_of_one_component_is_judged_by_that_one():
    random, covariance = np.random.default_rng(4), np.array([[4e-6, 1e-6], [1e-6, 9e-6]])
    errors = random.multivariate_normal(np.zeros(2), covariance, 4000)
    for shown in ([True, True], [False, True], [True, False]):
        hidden = ~np.array(shown)
        told = covariance.copy()
        told[hidden], told[:, hidden] = np.nan, np.nan
        found = []
        for error in errors:
            fused = SimpleNamespace(force=np.where(hidden, np.nan, -error), force_covariance=told)
            found.append(force_error(fused, np.zeros(2)))
        off, nees, components = np.array(found).T
        assert components == pytest.approx(sum(shown))
        assert np.array_equal(off, np.hypot(*np.where(hidden, 0.0, errors).T))
        assert np.mean(nees) == pytest.approx(2.0, abs=0.1)
        assert np.mean(nees <= bench.IN_95) == pytest.approx(0.95, abs=0.01)
    nothing = SimpleNamespace(force=np.full(2, np.nan), force_covariance=np.full((2, 2), np.nan))
    assert np.isnan(force_error(nothing, np.zeros(2))[1])
    far = SimpleNamespace(force=np.array([np.nan, 1.0]), force_covariance=told)
    told[1, 1] = 1e-6
    assert np.isfinite(force_error(far, np.zeros(2))[1])


def test_a_tip_counts_where_it_is_ambiguous():
    found = rows()['no wrench']
    found[:, :200, bench.COLUMNS.index('ambiguous')] = 1.0
    found[:, :200, bench.COLUMNS.index('tip_nees')] = 100.0
    numbers = bench.numbers_of(found)
    assert numbers['ambiguous'] == 0.5 and numbers['tip_covered'] < 0.5
    assert numbers['largest_tip_nees'] == 100.0


def test_the_worst_recording_is_that_of_those_with_a_force_whatever_their_order():
    found = rows(sure=1.5)['wrench']
    found[0, :, bench.COLUMNS.index('force_nees')] = np.nan
    for order in (slice(None), slice(None, None, -1)):
        numbers = bench.numbers_of(found[order])
        assert 0.5 < numbers['worst_force'] < 0.9
        assert numbers['without_force'] == 1


@pytest.mark.parametrize(('said', 'folder'), [('1a2b3c4d', '1a2b3c4d'), ('1a2b3c4d-dirty', None)])
def test_rows_are_kept_by_commit_and_of_changed_files_not_at_all(monkeypatch, said, folder):
    found = SimpleNamespace(stdout=f'{said}\n')
    monkeypatch.setattr(rigs.subprocess, 'run', lambda *_, **__: found)
    if folder is None:
        with pytest.raises(SystemExit, match='commit'):
            rigs.commit()
    else:
        assert rigs.commit() == folder


def test_a_recording_gives_an_estimate_at_nearly_every_frame():
    recording = bench.recording_of(77, 0)
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    assert recording.scenario.arm.length == scenario.arm.length
    fused = bench.fuse(
        Fusion(arm=true_model(recording.scenario)), recording, bench.WAYS['no wrench'], 77
    )
    numbers = bench.numbers_of(fused[None])
    assert numbers['estimates'] > 0.98
    assert numbers['sure_rms'] < 0.05
    assert numbers['tip_rms'] < 2e-4
    assert 0.0 < numbers['worst_of_better'] < 0.8
