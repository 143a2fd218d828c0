"""What acted in recordings: the same history as the estimator goes through, reading by reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.force_misalignment import ForceMisalignment
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.softening import Softening
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.solver.columns import THETA, X, Y
import pytest
from support.example_arms import paper_arm
from support.made_datasets import in_two, made, PERIOD

EFFECTS = (
    PressureGain(gain=0.97),
    ForceMisalignment(angle=0.05),
    PressureLag(time_constant=0.3),
    Hysteresis(width=3e3),
    Creep(amplitude=0.2, time_constant=1.5),
    Softening(loss=0.2),
)
UP_AND_DOWN = np.concatenate([np.linspace(0, 6e4, 12), np.linspace(55e3, 1e4, 10)])
FORCE = np.stack([np.linspace(0.1, 0.2, 22), np.linspace(0.0, 0.15, 22)], axis=1)


def test_history_is_that_of_the_estimator():
    arm = paper_arm(EFFECTS)
    run = made(arm, UP_AND_DOWN, FORCE)
    # every third reading has no frame: the history must go through it all the same
    kept = np.arange(22) % 3 > 0
    run = replace(
        run,
        stamp_ns=run.stamp_ns[kept],
        reading=run.reading[kept],
        **{name: getattr(run, name)[kept] for name in ('force', 'moment', 'x', 'y')},
    )
    (inputs,) = inputs_of(arm, [run])
    series = ForwardModel(np.linspace(0, arm.length, 57))
    assert series.solve(arm, inputs).all()

    estimator = Estimator(
        arm=arm, settings=EstimatorSettings(stations=57, wrench_timeout=10.0, input_timeout=10.0)
    )
    state, frame = EstimatorState(), 0
    for reading, stamp in enumerate(run.reading_stamp_ns.tolist()):
        if kept[reading]:
            force_x, force_y = FORCE[reading].tolist()
            wrench = WrenchReading(
                stamp_ns=stamp, force_x=force_x, force_y=force_y, moment=0.0,
                frame_id='pneunet_base',
            )  # fmt: skip
            state, _ = estimator.step(state, wrench)
        pressure = PressureReading(stamp_ns=stamp, pressure=float(run.pressure[reading]))
        state, estimate = estimator.step(state, pressure)
        if not kept[reading]:
            continue
        assert isinstance(estimate, ShapeEstimate)
        assert inputs.pressure[frame] == pytest.approx(estimate.chamber_pressure, abs=1e-9)
        for field, name in ((X, 'x'), (Y, 'y'), (THETA, 'theta')):
            wanted = getattr(estimate.shape, name)
            assert series.fields[frame, field] == pytest.approx(wanted, abs=1e-7)
        frame += 1
    assert frame == 14


def test_history_goes_on_from_run_to_run_in_the_order_of_their_stamps():
    arm = paper_arm((Hysteresis(width=3e3), Softening(loss=0.2)))
    whole = made(arm, UP_AND_DOWN)
    first, second = in_two(whole)
    (together,) = inputs_of(arm, [whole])
    later, earlier = inputs_of(arm, [second, first])
    assert np.array_equal(np.concatenate([earlier.pressure, later.pressure]), together.pressure)
    for place in range(2):
        both = np.concatenate([earlier.histories[place], later.histories[place]])
        assert np.array_equal(both, together.histories[place])
    (alone,) = inputs_of(arm, [second])
    assert not np.array_equal(alone.histories[1], later.histories[1])


def test_runs_whose_stamps_overlap_have_no_past_in_whatever_order_they_are_given():
    """Tables whose time starts at zero: which was the earlier one, nobody knows."""
    arm = paper_arm((Hysteresis(width=3e3), Softening(loss=0.2)))
    up, down = made(arm, UP_AND_DOWN[:12]), made(arm, UP_AND_DOWN[12:])
    (alone,) = inputs_of(arm, [down])
    for runs in ([up, down], [down, up]):
        found = inputs_of(arm, runs)[runs.index(down)]
        assert np.array_equal(found.pressure, alone.pressure)
        assert np.array_equal(found.histories[1], alone.histories[1])


def test_a_run_within_a_longer_one_has_no_past_whatever_ended_before_it():
    arm = paper_arm((Softening(loss=0.2),))
    whole = made(arm, UP_AND_DOWN)
    first, second = (whole.subset(np.arange(4) + start) for start in (3, 12))
    inner = [
        replace(
            run, reading_stamp_ns=run.stamp_ns, pressure=run.frame_pressure, reading=np.arange(4)
        )
        for run in (first, second)
    ]
    (alone,) = inputs_of(arm, inner[1:])
    assert np.array_equal(inputs_of(arm, [whole, *inner])[2].histories[0], alone.histories[0])


def test_readings_alone_where_no_effect_has_a_history():
    arm = paper_arm((PressureGain(gain=0.97), ForceMisalignment(angle=0.05)))
    run = made(arm, UP_AND_DOWN, FORCE)
    (inputs,) = inputs_of(arm, [run])
    assert inputs.histories is None
    assert inputs.pressure == pytest.approx(0.97 * UP_AND_DOWN)
    turn = np.array([[np.cos(0.05), -np.sin(0.05)], [np.sin(0.05), np.cos(0.05)]])
    assert inputs.loads[:, :2] == pytest.approx(FORCE @ turn.T)
    assert run.stamp_ns[1] - run.stamp_ns[0] == PERIOD


def test_rows_of_the_table_weigh_as_kappa_does():
    arm = paper_arm((Creep(amplitude=0.3, time_constant=1.0),))
    (inputs,) = inputs_of(arm, [made(arm, UP_AND_DOWN)])
    weights = inputs.row_weights(arm)
    assert weights.sum(axis=1) == pytest.approx(1.0)
    series = ForwardModel(arm.length * arm.intrinsic_curvature.arclength)
    assert series.solve(arm, inputs).all()
    wanted = weights @ arm.intrinsic_curvature.curvature
    assert series.fields[:, 4] == pytest.approx(wanted, abs=1e-9)


def test_static_frames_have_no_past():
    arm = paper_arm(EFFECTS)
    moving = made(arm, UP_AND_DOWN, FORCE)
    static = replace(moving, static=True)
    backwards = replace(
        static, **{name: getattr(static, name)[::-1] for name in ('pressure', 'force', 'moment')}
    )
    whole, turned, after = inputs_of(arm, [static, backwards, moving])
    np.testing.assert_array_equal(whole.pressure, turned.pressure[::-1])
    np.testing.assert_array_equal(whole.loads, turned.loads[::-1])
    for history, other in zip(whole.histories, turned.histories, strict=True):
        np.testing.assert_array_equal(history, other[::-1])
    # Rested at a pressure, the line is through and the play in its middle.
    np.testing.assert_allclose(whole.pressure, 0.97 * UP_AND_DOWN, rtol=1e-12)
    # And nothing of them is remembered.
    (alone,) = inputs_of(arm, [moving])
    np.testing.assert_array_equal(after.pressure, alone.pressure)
    assert not np.allclose(after.pressure, whole.pressure, rtol=1e-3)


def stamped_later(run, seconds):
    """Return the run with the stamps of its frames later, each with the reading nearest to it."""
    late = round(seconds * 1e9)
    stamps = run.stamp_ns + late
    nearest = np.abs(run.reading_stamp_ns[:, None] - stamps).argmin(axis=0)
    return replace(run, stamp_ns=stamps, reading=nearest)


@pytest.mark.parametrize('effects', [(), EFFECTS], ids=['base', 'with a past'])
def test_a_delay_gives_late_frames_what_acted_when_they_were_taken(effects):
    run = made(paper_arm(), UP_AND_DOWN, np.tile([0.1, 0.05], (22, 1)))
    kept = np.arange(4, 18)
    cut = {name: getattr(run, name)[kept] for name in ('stamp_ns', 'reading', 'force', 'moment')}
    run = replace(run, **cut, x=run.x[kept], y=run.y[kept])
    for periods in (1, -2):  # the frames of which carry the stamp of another reading
        delay = periods * PERIOD * 1e-9
        late = stamped_later(run, delay)
        wanted, found = (
            inputs_of(paper_arm(more), [given])[0]
            for more, given in ((effects, run), ((*effects, CameraDelay(delay=delay)), late))
        )
        np.testing.assert_allclose(found.pressure, wanted.pressure, rtol=1e-12)
        np.testing.assert_allclose(found.loads, wanted.loads, rtol=1e-12)
        for one, other in zip(found.histories or (), wanted.histories or (), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ('late', 'shown'),
    [(0.4, 0.4), (-0.3, -0.3), (0.05, 0.0)],
    ids=['after', 'before', 'triggered'],
)
def test_a_frame_between_two_readings_has_what_lies_between_them(late: float, shown: float):
    """Only where all frames are as near to readings as the jitter of stamps are they triggered."""
    arm, made_run = paper_arm(), made(paper_arm(), UP_AND_DOWN, FORCE)
    inner = np.arange(1, 21)
    cut = {name: getattr(made_run, name)[inner] for name in ('force', 'moment', 'x', 'y')}
    run = replace(
        made_run,
        **cut,
        reading=inner,
        stamp_ns=made_run.stamp_ns[inner] + round(late * PERIOD),
        wrench_stamp_ns=made_run.stamp_ns,
        wrench=made_run.load,
    )
    (inputs,) = inputs_of(arm, [run])
    at, places = np.arange(22.0), inner + shown
    np.testing.assert_allclose(inputs.pressure, np.interp(places, at, UP_AND_DOWN), rtol=1e-6)
    for axis in (0, 1):
        wanted = np.interp(places, at, FORCE[:, axis])
        np.testing.assert_allclose(inputs.loads[:, axis], wanted, rtol=1e-6, atol=1e-12)
    # What was put between readings once is not moved again.
    once = run.at_instants(0.0)
    assert once.at_instants(0.0).frame_pressure.tolist() == once.frame_pressure.tolist()


def test_between_readings_a_delayed_frame_is_on_the_line():
    arm, run = paper_arm(), made(paper_arm(), UP_AND_DOWN, FORCE)
    (inputs,) = inputs_of(paper_arm((CameraDelay(delay=0.25e-9 * PERIOD),)), [run])
    between = 0.75 * UP_AND_DOWN[1:] + 0.25 * UP_AND_DOWN[:-1]
    np.testing.assert_allclose(inputs.pressure, [UP_AND_DOWN[0], *between], rtol=1e-6)
    between = 0.75 * FORCE[1:] + 0.25 * FORCE[:-1]
    np.testing.assert_allclose(inputs.loads[1:, :2], between, rtol=1e-6)
    # A delay of zero is no delay, to the last bit, and static frames have no time.
    (bare,), (neutral,) = inputs_of(arm, [run]), inputs_of(paper_arm((CameraDelay(),)), [run])
    assert same_values(bare, neutral)
    still = replace(run, static=True)
    (rested,) = inputs_of(paper_arm((CameraDelay(delay=1.0),)), [still])
    np.testing.assert_array_equal(rested.pressure, UP_AND_DOWN)
