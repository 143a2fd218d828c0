"""Where the misfit is: put into one place of invented residuals, and found there."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.refit import refit
from pneunet_ros.diagnosis.localization import (
    collect_frames,
    describe_misfit,
    end_ratio,
    Frames,
    heat_maps,
    misfit_shares,
    rising_to_falling_ratio,
    target_means,
    TREND,
)
from pneunet_ros.diagnosis.result import AXES, Axis
from pneunet_ros.diagnosis.settings import LACK_OF_FIT
import pytest
from support.lab_designs import design, fitted, FRAMES, TRAINING

BINS = {'pressure': 5, 'force': 4, 'time': 4}
COUNT, TARGETS = 400, 20


def clean(seed: int = 1, lost: float = 0.0) -> Frames:
    """Return frames of noise alone, some targets not seen; every axis by itself."""
    random = np.random.default_rng(seed)
    squares = random.chisquare(2, (COUNT, TARGETS))
    squares[random.random((COUNT, TARGETS)) < lost] = np.nan
    return Frames(
        squares=squares,
        arclength=np.linspace(0.0, 1.0, TARGETS),
        axes={
            'pressure': random.uniform(0.0, 60e3, COUNT),
            'force': random.uniform(0.0, 0.2, COUNT),
            'time': random.uniform(0.0, 40.0, COUNT),
            'direction': random.choice([-1.0, 1.0, np.nan], COUNT),
        },
    )


def worse(frames: Frames, rows: npt.NDArray[np.bool_], factor: float = 6.0) -> Frames:
    """Return the same with more misfit in some frames."""
    squares = frames.squares.copy()
    squares[rows] *= factor
    return replace(frames, squares=squares)


def within(frames: Frames, axis: Axis, start: float, stop: float) -> npt.NDArray[np.bool_]:
    """Return which frames are in a stretch of an axis."""
    values: Array = frames.axes[axis]
    return (values >= start) & (values <= stop)


def test_noise_alone_is_nowhere():
    frames = clean()
    found = misfit_shares(frames)
    assert min(share.p_value for share in found) > 1e-3


@pytest.mark.parametrize(
    ('axis', 'which'), [('pressure', 2), ('pressure', 4), ('force', 0), ('force', 3), ('time', 1)]
)
def test_a_misfit_in_one_stretch_is_found_there(axis, which):
    frames = clean()
    edges = np.linspace(frames.axes[axis].min(), frames.axes[axis].max(), BINS[axis] + 1)
    found = misfit_shares(worse(frames, within(frames, axis, edges[which], edges[which + 1])))
    own = [share for share in found if share.axis == axis]
    assert len(own) == BINS[axis]
    assert (own[which].start, own[which].stop) == pytest.approx((edges[which], edges[which + 1]))
    assert own[which].share > 0.95
    assert own[which].p_value < 1e-12
    assert sum(share.seen for share in own) == pytest.approx(1.0)
    assert all(share.p_value > 1e-3 for share in own if share is not own[which])
    assert sum(share.share for share in own) == pytest.approx(1.0)


def test_a_misfit_at_the_tip_is_found_there():
    frames = clean()
    squares = frames.squares.copy()
    squares[:, -4:] *= 5.0
    found = [
        one for one in misfit_shares(replace(frames, squares=squares)) if one.axis == 'arclength'
    ]
    assert [one.start for one in found] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])
    assert [one.stop for one in found] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    assert found[-1].share > 0.95
    assert all(one.p_value > 1e-3 for one in found[:-1])


def test_a_misfit_while_the_pressure_falls():
    frames = clean()
    found = worse(frames, frames.axes['direction'] == -1.0)
    falling, rising = (one for one in misfit_shares(found) if one.axis == 'direction')
    assert (falling.start, falling.stop, rising.start) == (-1.0, -1.0, 1.0)
    assert falling.share > 0.95
    assert rising.p_value > LACK_OF_FIT.level > falling.p_value
    assert rising_to_falling_ratio(found) < 1.0 / TREND


@pytest.mark.parametrize('lost', [0.0, 0.1])
def test_the_sentence_says_what_grows_and_what_does_not(lost):
    frames = clean(lost=lost)
    force = frames.axes['force']
    squares = frames.squares * (1.0 + 400.0 * force[:, None] ** 2)
    squares[:, 15] *= 1.5
    assert describe_misfit(replace(frames, squares=squares)) == (
        'the misfit grows with the force, hardly depends on the pressure, hardly depends on time, '
        'is largest at 0.79 of the length and is the same, frame by frame, for rising and falling '
        'pressure'
    )
    less = frames.squares * (1.0 + 20.0 * np.exp(-frames.axes['pressure'][:, None] / 10e3))
    assert 'falls with the pressure' in describe_misfit(replace(frames, squares=less))


@pytest.mark.parametrize('lost', [0.0, 0.1])
def test_a_misfit_everywhere_grows_with_nothing(lost):
    frames = clean(lost=lost)
    found = worse(frames, np.ones(COUNT, dtype=bool))
    trend = TREND
    ratios = [end_ratio(found, axis) for axis in ('force', 'pressure', 'time')]
    assert all(1.0 / trend <= ratio <= trend for ratio in ratios)
    assert 1.0 / trend <= rising_to_falling_ratio(found) <= trend


def test_recordings_in_which_the_pressure_always_holds_have_no_direction():
    frames = worse(clean(), np.ones(COUNT, dtype=bool))
    frames.axes['direction'] = np.full(COUNT, np.nan)
    assert 'direction' not in describe_misfit(frames)
    assert all(one.share == 0.0 for one in misfit_shares(frames) if one.axis == 'direction')


def test_a_stretch_in_which_nothing_was_seen():
    frames = worse(clean(), np.ones(COUNT, dtype=bool))
    dark = within(frames, 'pressure', 48e3, 60e3)
    frames = worse(frames, dark, np.nan)
    assert 1.0 / TREND <= end_ratio(frames, 'pressure') <= TREND
    last = [one for one in misfit_shares(frames) if one.axis == 'pressure'][-1]
    assert last.share < 0.01


def test_a_target_that_was_never_seen_is_not_where_it_is_largest():
    frames = worse(clean(), np.ones(COUNT, dtype=bool))
    frames.squares[:, 3] = np.nan
    frames.squares[:, 8] *= 2.0
    assert int(np.nanargmax(target_means(frames.squares))) == 8


def test_heat_maps_show_before_and_after_over_every_axis():
    after = clean()
    before = worse(after, within(after, 'force', 0.15, 0.2), 9.0)
    squares = before.squares.copy()
    squares[:, 3] = np.nan
    found = {item.axis: item for item in heat_maps(replace(before, squares=squares), after)}
    assert list(found) == [axis for axis in AXES if axis != 'arclength']
    shown = found['force']
    assert shown.before.shape == (BINS['force'], TARGETS)
    seen = np.delete(shown.before, 3, axis=1)
    assert seen[-1] == pytest.approx(3.0, abs=0.6)
    assert seen[:-1] == pytest.approx(1.0, abs=0.25)
    assert shown.after == pytest.approx(1.0, abs=0.25)
    assert np.isnan(shown.before[:, 3]).all()
    assert np.isfinite(shown.after).all()


def test_residuals_of_a_fit_without_what_is_missing():
    found = fitted(hidden='load_offset')
    frames = collect_frames(found)
    assert frames.squares.shape == (FRAMES * len(TRAINING), design().runs[0].x.shape[1])
    seen = np.concatenate([run.seen for run in design('load_offset').runs[: len(TRAINING)]])
    assert np.array_equal(np.isfinite(frames.squares), seen)
    assert set(np.unique(frames.axes['direction'][:FRAMES])) >= {-1.0, 1.0}
    assert frames.axes['time'][[0, FRAMES]].tolist() == [0.0, 0.0]
    forces = np.concatenate(
        [np.hypot(*run.force.T) for run in found.linearization.runs[: len(TRAINING)]]
    )
    # What acted is on a line through the readings, which differ from it by their noise.
    assert frames.axes['force'] == pytest.approx(forces, rel=0.02, abs=1e-3)
    assert end_ratio(frames, 'force') > TREND
    known = fitted('load_offset', 'load_offset')
    left = collect_frames(known)
    assert np.nansum(left.squares) < 0.7 * np.nansum(frames.squares)
    assert np.nanmean(left.squares) == pytest.approx(2.0, abs=0.25)


def test_a_recording_of_one_frame_has_no_direction():
    """As may be left of one where the others show what no sensor read."""
    runs = [run.subset(np.arange(8)) for run in design().runs[: len(TRAINING)]]
    runs[1] = runs[1].subset(np.array([3]))
    found = refit(design().at(design().point, runs), (), np.zeros(0), 1)
    assert found is not None
    frames = collect_frames(found)
    assert len(frames.squares) == 8 * (len(TRAINING) - 1) + 1
    assert 'direction' not in frames.axes  # of eight frames the pressure goes one way
    assert frames.axes['time'][8] == 0.0


def test_under_vacuum_a_pressure_moves_by_a_share_of_the_table():
    """No run exceeds 0 Pa; the noise of a pressure that holds is no motion."""
    frames = 8
    pressure = np.array([0.0, -1.0, 0.0, -1.0, -1.0, -15e3, -30e3, -10e3])
    run = SimpleNamespace(
        stamp_ns=np.arange(frames) * 10**9, seen=np.ones((frames, 1), bool), static=False
    )
    block = SimpleNamespace(
        run=run, inputs=SimpleNamespace(pressure=pressure, loads=np.zeros((frames, 3)))
    )
    arm = SimpleNamespace(table_range=(-60e3, 0.0), target_arclength=np.array([0.1]))
    linearization = SimpleNamespace(
        mean=np.zeros(0),
        fixed=[np.zeros((0, 0))],
        blocks=[block],
        training=1,
        point=SimpleNamespace(arm=arm),
        length=0.1,
    )
    gaussian = SimpleNamespace(
        position=np.zeros(0),
        step=np.zeros(0),
        columns=[np.zeros((2 * frames, 0))],
        best_residuals=lambda: [np.zeros(2 * frames)],
    )
    found = collect_frames(SimpleNamespace(linearization=linearization, gaussian=gaussian))
    assert np.isnan(found.axes['direction'][:4]).all()
    assert found.axes['direction'][5:].tolist() == [-1.0, 1.0, 1.0]


def test_an_axis_on_which_frames_do_not_differ_is_none():
    runs = [replace(run, static=True) for run in design().runs[: len(TRAINING)]]
    free = [replace(run, loaded=False, force=0.0 * run.force, wrench=None) for run in runs]
    found = refit(design().at(design().point, free), (), np.zeros(0), 1)
    assert found is not None
    assert list(collect_frames(found).axes) == ['pressure']
