"""Frames of which nobody read pressure or load are left out, and no other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.diagnosis.usable_frames import exclude_unknown_readings
from pneunet_ros.effects.softening import Softening
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import inputs_of
from support.example_arms import paper_arm
from support.refusals import refused

MILLISECOND = 1_000_000
READ = 500 * MILLISECOND


def recording(pressure: list[float], force: list[float] | None = None) -> RecordingData:
    """Return readings every half a second, and a frame every 125 ms, the first with a reading."""
    arm = paper_arm()
    stamps = READ * np.arange(1, len(pressure) + 1)
    shown = np.arange(stamps[0], stamps[-1] + READ, READ // 4)
    nearest = np.minimum((shown - stamps[0] + READ // 2) // READ, len(pressure) - 1)
    wrench = None
    if force is not None:
        wrench = np.column_stack([force, np.zeros((len(force), 2))])
    points = np.zeros((shown.size, arm.target_arclength.size))
    return RecordingData(
        name='made',
        reading_stamp_ns=stamps,
        pressure=np.array(pressure),
        stamp_ns=shown,
        reading=nearest,
        loaded=force is not None,
        force=np.zeros((shown.size, 2)) if wrench is None else wrench[nearest, :2],
        moment=np.zeros(shown.size),
        x=points,
        y=points,
        wrench_stamp_ns=None if wrench is None else stamps,
        wrench=wrench,
    )


def kept(run: RecordingData) -> list[float]:
    """Return the frames that are kept, in periods of the readings."""
    (group,), _ = exclude_unknown_readings(paper_arm(), [run])
    return ((group[0].stamp_ns - READ) / READ).tolist() if group else []


def test_frames_between_two_readings_go_where_the_pressure_jumped():
    still = recording([20e3] * 6)
    assert kept(still) == [0.25 * quarter for quarter in range(21)]  # not beyond the last reading
    ramp = recording([10e3, 10e3, 10e3, 14e3, 18e3, 22e3, 26e3])
    assert {3.25, 3.5, 4.75, 5.0} <= {*kept(ramp)}
    step = kept(recording([20e3, 20e3, 20e3, 50e3, 50e3, 50e3]))
    assert not {2.25, 2.5, 2.75} & {*step}
    assert {0.5, 1.0, 2.0, 3.0, 4.0} <= {*step}


def test_frames_go_where_the_load_jumped_and_what_stays_is_said():
    run = recording([20e3] * 6, [0.1, 0.1, 0.1, 0.2, 0.2, 0.2])
    (group,), notes = exclude_unknown_readings(paper_arm(), [run])
    left = len(run.stamp_ns) - len(group[0].stamp_ns)
    assert left == 6  # three in between, three behind the last reading
    assert [note.reason for note in notes] == ['between_readings']
    assert notes[0].startswith(f'{left} of {len(run.stamp_ns)} ')


def test_frames_taken_with_a_reading_and_steady_states_and_those_of_no_pressure_stay():
    step = recording([20e3, 20e3, 20e3, 50e3, 50e3, 50e3])
    triggered = step.subset(np.arange(0, 24, 4))
    without = replace(recording([0.0] * 6), pressurized=False)
    for run in (triggered, replace(step, static=True), without):
        (group,), notes = exclude_unknown_readings(paper_arm(), [run])
        assert group == [run]
        assert not notes


def test_too_little_that_was_read_is_refused():
    free = recording([20e3] * 6)
    restless = recording([20e3] * 8, [0.0, 0.0, 0.2, 0.1, 0.3, 0.0, 0.2, 0.1])
    between = restless.subset(np.array([1, 2, 9, 10, 11, 13, 14, 15]))
    with refused(RecordingError, 'between_readings'):
        exclude_unknown_readings(paper_arm(), [free, between])
    (_, held_out), (note,) = exclude_unknown_readings(
        paper_arm(), [free], [replace(between, name='short')]
    )
    assert held_out == []
    assert 'short' in note


def test_the_arm_remembers_the_pressures_of_a_recording_that_is_left_out():
    """It softened at a pressure between whose readings alone there were frames."""
    free, later, step = (recording(one) for one in ([20e3] * 6, [20e3] * 6, [20e3, 60e3, 20e3]))
    between = step.subset(np.array([1, 2, 3, 5, 6, 7, 9, 10]))
    after = 100 * READ * np.arange(3)
    free, between, later = runs = [
        replace(run, stamp_ns=run.stamp_ns + ns, reading_stamp_ns=run.reading_stamp_ns + ns)
        for run, ns in zip((free, between, later), after, strict=True)
    ]
    arm = paper_arm((Softening(loss=0.3),))
    (kept,), _ = exclude_unknown_readings(arm, runs)
    assert len(kept) == 2
    known, alone = (inputs_of(arm, some)[-1].histories[0][0] for some in (runs, [free, later]))
    left = inputs_of(arm, kept)[-1].histories[0][0]
    assert np.array_equal(left, known) and not np.array_equal(left, alone)


def test_noise_larger_than_the_arm_file_says_is_no_change():
    noise, random = paper_arm().sensors, np.random.default_rng(4)
    pressure = 20e3 + 5.0 * noise.pressure_std * random.standard_normal(200)
    force = 0.1 + 5.0 * noise.force_std * random.standard_normal(200)
    pressure[100:] += 30e3
    run = recording(pressure.tolist(), force.tolist())
    (group,), _ = exclude_unknown_readings(paper_arm(), [run])
    left = set(run.stamp_ns.tolist()) - set(group[0].stamp_ns.tolist())
    assert {100 * READ + place * READ // 4 for place in (1, 2, 3)} < left
    assert len(left) < 0.05 * len(run.stamp_ns)
