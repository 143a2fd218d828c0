"""A string pulls the tip to its eye: in one solve, in recordings, and by every verb."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.cli.experiments import by_recording
from pneunet_ros.cli.main import main
from pneunet_ros.cli.quantity_option import string_of
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.frames import rotate
from pneunet_ros.core.readings import unseen_targets
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.force_misalignment import ForceMisalignment
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.outside_effects import LabPulley
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.string_load import tips_of, with_string
from pneunet_ros.messages.readings import SENSORS
from pneunet_ros.model.equilibrium import tip_jacobian
from pneunet_ros.model.string import solve_string, String, tip_amplification
from pneunet_ros.offline.film import FilmedRun, record_film
from pneunet_ros.offline.film import with_string as film_with_string
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.tables.reading_table import ReadingTable
from pneunet_ros.vision.tracker import Tracking
import pytest
from support.lab_run import true_model
from support.refusals import reasons, refused

EYE = (0.412, 0.0)  # 0.3 m beyond the tip of the straight arm


@pytest.fixture(scope='module')
def arm():
    """Return the paper's arm."""
    return load_model(share_path('config/paper_arm.yaml'))


@pytest.mark.parametrize('pressure', [0.0, 20e3, 60e3])
@pytest.mark.parametrize('tension', [0.02, 0.2, 0.8])
def test_the_force_points_from_the_tip_to_the_eye(arm, pressure, tension):
    string = String(tension=tension, x=EYE[0], y=0.05)
    shape = solve_string(arm, pressure, string)
    assert shape.converged
    way = np.array([string.x, string.y]) - shape.tip[:2]
    assert np.array(shape.force) == pytest.approx(tension * way / np.hypot(*way), abs=1e-9)
    again = solve(arm, pressure, shape.force, start=shape)
    assert again.tip == pytest.approx(shape.tip, abs=1e-9)


def test_a_string_pulls_truly_whatever_a_sensor_reads(arm):
    turned = dataclasses.replace(
        arm, effects=(ForceMisalignment(angle=0.5), PressureGain(gain=1.1)), covariance=None
    )
    string = String(tension=0.2, x=0.4, y=0.1)
    shape = solve_string(turned, 40e3, string)
    assert shape.tip == pytest.approx(solve_string(arm, 44e3, string).tip, abs=1e-9)
    shape = solve_string(turned, 40e3, string, (0.02, 0.01))
    read = np.array(shape.force) - string.pull(np.array(shape.tip[:2]))
    assert read == pytest.approx(rotate(0.5, 0.02, 0.01), abs=1e-9)


def test_a_known_load_of_a_recording_is_no_reading(arm):
    string = String(tension=0.1, x=EYE[0], y=EYE[1])
    run, _ = with_string(run_with(arm, [solve_string(arm, 20e3, string)]), arm, string)
    turned = dataclasses.replace(arm, effects=(ForceMisalignment(angle=0.5),), covariance=None)
    (known,) = inputs_of(turned, [run])
    assert known.loads == pytest.approx(run.load)
    (read,) = inputs_of(turned, [dataclasses.replace(run, load_known=False)])
    assert read.loads[0, :2] == pytest.approx(rotate(0.5, *run.force[0]))


def test_far_away_it_is_a_constant_force(arm):
    string = String(tension=0.1, x=1e6, y=0.0)
    assert solve_string(arm, 40e3, string).tip == pytest.approx(
        solve(arm, 40e3, (0.1, 0.0)).tip, abs=1e-6
    )


def test_its_jacobian_is_that_of_the_arm_with_its_string(arm):
    string, pressure, step = String(tension=0.1, x=EYE[0], y=EYE[1]), 40e3, 10.0
    shape = solve_string(arm, pressure, string)
    jacobian = tip_jacobian(arm, shape)
    found = tip_amplification(string, np.array(shape.tip), jacobian) @ jacobian
    sides = [solve_string(arm, pressure + sign * step, string).tip for sign in (-1.0, 1.0)]
    assert found[:, 0] == pytest.approx((np.array(sides[1]) - sides[0]) / (2 * step), rel=1e-5)
    force = 1e-4
    sides = [solve_string(arm, pressure, string, (0.0, sign * force)).tip for sign in (-1.0, 1.0)]
    assert found[:, 2] == pytest.approx((np.array(sides[1]) - sides[0]) / (2 * force), rel=1e-4)


@pytest.mark.parametrize('numbers', [(0.0, 0.4, 0.0), (-0.1, 0.4, 0.0), (0.1, np.nan, 0.0)])
def test_what_is_no_string_is_refused(numbers):
    tension, x, y = numbers
    with pytest.raises(RequestError):
        String(tension=tension, x=x, y=y)


def test_a_force_that_is_no_pair_is_refused(arm):
    with refused(RequestError, 'not_finite'):
        solve_string(arm, 1e4, String(tension=0.1, x=0.0, y=0.1), (0.1,))


def test_an_eye_on_the_arm_is_refused(arm):
    with refused(RequestError, 'out_of_bounds'):
        solve_string(arm, 0.0, String(tension=0.05, x=0.056, y=0.0))
    with refused(RequestError, 'no_equilibrium'):
        solve_string(arm, 40e3, String(tension=0.1, x=0.09, y=0.06))


def run_with(arm, shapes) -> RecordingData:
    """Return a recording of shapes at their targets."""
    x, y = (
        np.array(
            [np.interp(arm.target_arclength, one.arclength, getattr(one, name)) for one in shapes]
        )
        for name in 'xy'
    )
    stamps = np.arange(1, 1 + len(shapes)) * 10**8
    zeros = np.zeros(len(shapes))
    return RecordingData(
        name='pulled', reading_stamp_ns=stamps, pressure=[one.pressure for one in shapes],
        stamp_ns=stamps, reading=np.arange(len(shapes)), loaded=False,
        force=np.zeros((len(shapes), 2)), moment=zeros, x=x, y=y,
    )  # fmt: skip


def test_frames_have_the_force_from_their_tip(arm):
    string = String(tension=0.1, x=EYE[0], y=EYE[1])
    shapes = [solve_string(arm, p, string) for p in (0.0, 20e3, 40e3, 60e3)]
    run = run_with(arm, shapes)
    found, unseen = with_string(run, arm, string)
    assert unseen == 0 and found.load_known
    assert found.force == pytest.approx(np.array([one.force for one in shapes]), abs=3e-5)
    x, y = np.array(run.x), np.array(run.y)
    x[1, -1] = y[1, -1] = np.nan
    found, unseen = with_string(dataclasses.replace(run, x=x, y=y), arm, string)
    assert unseen == 1 and len(found.stamp_ns) == 3
    x[:, -1] = y[:, -1] = np.nan
    with refused(RecordingError, 'no_tip'):
        with_string(dataclasses.replace(run, x=x, y=y), arm, string)
    with refused(RequestError, 'out_of_bounds'):
        with_string(run, arm, String(tension=0.1, x=float(x[2, 10]), y=float(y[2, 10])))


def seen_points(arm, shape) -> np.ndarray:
    """Return the targets of a shape, (1, 2, targets)."""
    places = arm.target_arclength
    return np.array([[np.interp(places, shape.arclength, part) for part in (shape.x, shape.y)]])


def test_a_tip_beyond_the_last_target_is_on_the_curve(arm):
    few = dataclasses.replace(arm, target_arclength=[0.0, 0.03, 0.06, 0.09, 0.1], covariance=None)
    shape = solve(few, 50e3, stations=113)
    assert tips_of(seen_points(few, shape), few)[0] == pytest.approx(shape.tip[:2], abs=5e-4)
    for places in ([], [0.0, 0.06]):
        fewer = dataclasses.replace(few, target_arclength=np.array(places))
        assert np.isnan(tips_of(seen_points(fewer, shape), fewer)).all()


@pytest.mark.parametrize('cap', [0.0, 0.01, 0.03, 0.05])
@pytest.mark.parametrize('beyond', [(), (0.3,), (0.3, 0.6)])
def test_a_tip_is_straight_beyond_the_soft_end(arm, cap, beyond):
    places = np.append(arm.target_arclength, arm.length + cap * np.array(beyond[: bool(cap) * 2]))
    capped = dataclasses.replace(arm, tip_cap=cap, target_arclength=places, covariance=None)
    shape = solve(capped, 50e3, (0.05, 0.05), stations=2001)
    points = seen_points(capped, shape)
    noise = np.random.default_rng(1).normal(size=(500, *points.shape[1:]))
    noisy = points + arm.sensors.target_std * noise
    noisy[::2, :, -5] = np.nan
    error = tips_of(noisy, capped) - shape.tip[:2]
    assert np.abs(error.mean(axis=0)).max() < 6e-4
    assert error.std(axis=0).max() < 2e-3
    noisy[:, :, -2] = np.nan
    assert np.isnan(tips_of(noisy, capped)).all()


def test_predict_and_what_does_not_go_with_a_string(capsys):
    assert main(['predict', '--pressure', '40kPa', '--string', '10g', '412mm', '0', '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert np.hypot(*found['force']) == pytest.approx(0.0980665, rel=1e-9)
    assert found['force'][1] < 0.0
    for options in (['--tip', '0.1', '0.02'], ['--string', '-10g', '412mm', '0']):
        asked = ['predict', '--pressure', '40kPa', '--string', '10g', '412mm', '0', *options]
        assert main(asked) != 0


@pytest.mark.parametrize(
    ('load', 'known'), [('--string 10g 412mm 0', False), ('--force 0 0', True)]
)
def test_predict_gives_a_curvature_no_error_that_is_not_that_of_a_string(capsys, load, known):
    assert main(['predict', '--pressure', '40kPa', *load.split()]) == 0
    (row,) = (line for line in capsys.readouterr().out.splitlines() if 'largest' in line)
    assert bool(row.split('│')[3].strip()) == known


def test_the_lab_pulls_as_the_model_does():
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    pulley = LabPulley(eye_x=scenario.arm.reach + 0.3, eye_y=0.02)
    protocol = dataclasses.replace(
        load_scenario(share_path('scenarios/dead_weights.yaml')).protocol, duration=20.0, angle=0.0
    )
    scenario = dataclasses.replace(scenario, protocol=protocol, effects=(pulley,))
    truth = simulate(scenario).truth
    arm = true_model(dataclasses.replace(scenario, effects=()))
    for frame in (60, 120, 199):
        tension = float(np.hypot(*truth.force[frame]))
        string = String(tension=tension, x=pulley.eye_x, y=pulley.eye_y)
        shape = solve_string(arm, float(truth.pressure[frame]), string)
        assert np.array(shape.force) == pytest.approx(truth.force[frame], abs=1e-5)
        tip = truth.x[frame, -1], truth.y[frame, -1]
        assert shape.tip[:2] == pytest.approx(tip, abs=2e-5)


def test_strings_of_recordings_are_read_and_wrong_ones_refused():
    paths = [Path('a.mcap'), Path('b.mcap')]
    found = by_recording('--string', [('a.mcap', '20g', '412mm', '0')], paths, string_of)
    (one,) = found.values()
    assert (one.tension, one.x, one.y) == pytest.approx((0.02 * 9.80665, 0.412, 0.0))
    for given in (
        [('c.mcap', '20g', '0.4', '0')],
        [('a.mcap', '20g', '0.4', '0'), ('a.mcap', '20g', '0.4', '0')],
        [('a.mcap', '20mm', '0.4', '0')],
        [('a.mcap', '0', '0.4', '0')],
    ):
        with pytest.raises(RequestError):
            by_recording('--string', given, paths, string_of)


def pulled_film(arm, shapes, hidden=()):
    """Return a film of these shapes, the tip hidden in some of them, with a row per frame."""
    run = run_with(arm, shapes)
    seen_x = run.x.copy()
    seen_x[list(hidden), -1] = np.nan
    targets = arm.target_arclength.size
    trackings = tuple(
        Tracking(
            sightings=dataclasses.replace(unseen_targets(int(stamp), targets), x=x, y=y),
            curve=None,
        )
        for stamp, x, y in zip(run.stamp_ns, seen_x, run.y, strict=True)
    )
    values = {
        sensor.name: np.full((len(shapes), *sensor.row_shape(0)), np.nan) for sensor in SENSORS
    }
    values['pressure'] = run.pressure[:, None]
    table = ReadingTable(stamp_ns=run.stamp_ns, values=values)
    return FilmedRun(trackings=trackings, table=table)


def test_a_film_knows_no_load_while_the_tip_is_hidden(arm):
    string = String(tension=0.1, x=EYE[0], y=EYE[1])
    shapes = [solve_string(arm, p, string) for p in (0.0, 0.0, 0.0, 60e3, 60e3)]
    found = film_with_string(pulled_film(arm, shapes, hidden=(1, 2)), string, arm)
    load = found.table.values['end_wrench'][:, :2]
    assert np.isfinite(load).all(axis=1).tolist() == [True, False, False, True, True]
    kept = [0, 3, 4]
    assert load[kept] == pytest.approx(np.array([shapes[i].force for i in kept]), abs=3e-5)


def test_what_a_film_makes_of_a_string_is_no_reading(arm, tmp_path):
    string = String(tension=0.1, x=EYE[0], y=EYE[1])
    shapes = [solve_string(arm, p, string) for p in (0.0, 20e3, 40e3, 60e3)]
    targets = arm.target_arclength.size
    film = film_with_string(pulled_film(arm, shapes), string, arm)
    path = tmp_path / 'pulled.mcap'
    with write_recording(path, overwrite=False) as writer:
        record_film(writer, film)
    names = {topic.name for topic in open_recording(path).topics}
    assert '/pneunet/string_wrench' in names
    assert '/pneunet/end_wrench' not in names
    found, sentences = read_run(path, targets)
    assert found.loaded and found.load_known
    assert found.force == pytest.approx(np.array([one.force for one in shapes]), abs=3e-5)
    assert 'known_load' in reasons(sentences)
    alone = EstimatorSettings(wrench_required=False)
    assert not read_run(path, targets, settings=alone)[0].loaded
