"""What few numbers are enough for: the tip alone, its heading alone, poses in another frame."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.checks.left_out_levels import monotone_interpolation
from pneunet_ros.calibration.first_curvature import tip_turns
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.usable_frames import with_tips
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.tip_frame import find_base, in_base_frame
from pneunet_ros.model.starting_arm import has_invented_stiffness, starting_arm
from pneunet_ros.offline.calibration_files import described_arm, load_knowledge, save_knowledge
from pneunet_ros.reports.calibration.verdict import verdict_of
import pytest
from support.refusals import reasons, refused

LENGTH = 0.12
LEVELS = np.repeat(np.linspace(0.0, 60e3, 7), 4)
TURN = 1.6 * (LEVELS / 60e3) * (0.85 + 0.15 * LEVELS / 60e3)
STD = 1e-4  # m, of a tip


def poses(stretch=0.0):
    """Poses (frames, 3) of the tip of arcs, in the base frame; stretch: at the highest level."""
    half = 0.5 * TURN
    length = LENGTH * (1.0 + stretch * LEVELS / 60e3)
    tip = length * np.sinc(half / np.pi) * np.exp(1j * half)
    dice = np.random.default_rng(11)  # the same whatever was drawn before
    noise = STD * dice.normal(size=(2, LEVELS.size))
    heading = TURN + 0.004 * dice.normal(size=LEVELS.size)
    return np.column_stack([tip.real + noise[0], tip.imag + noise[1], heading])


def moved(pose, x, y, angle):
    """Return poses as a camera sees them that has the clamp at (x, y, angle)."""
    tip = (pose[:, 0] + 1j * pose[:, 1]) * np.exp(1j * angle) + x + 1j * y
    return np.column_stack([tip.real, tip.imag, pose[:, 2] + angle])


def recorded(pose, frame='pneunet_base'):
    stamps = 10**9 * np.arange(1, LEVELS.size + 1)
    nothing = np.full((LEVELS.size, ARM.target_arclength.size), np.nan)
    return RecordingData(
        name='few.mcap',
        reading_stamp_ns=stamps,
        pressure=LEVELS,
        stamp_ns=stamps,
        reading=np.arange(LEVELS.size),
        loaded=False,
        force=np.zeros((LEVELS.size, 2)),
        moment=np.zeros(LEVELS.size),
        x=nothing,
        y=nothing,
        tip_pose=pose,
        tip_frame=frame,
        static=True,
    )


ARM = starting_arm(
    name='few', length=LENGTH, weight=0.17, largest_pressure=60e3, places=np.array([0.0, 0.06])
)


@pytest.fixture(scope='module')
def by_angle():
    pose = poses()
    pose[:, :2] = np.nan
    return calibrate([recorded(pose)], [], ARM)


def test_the_angle_of_the_tip_alone_gives_a_constant_curvature(by_angle):
    assert by_angle.joint.converged
    table = by_angle.arm.intrinsic_curvature
    assert np.all(np.ptp(table.curvature, axis=1) < 1e-9)
    middle = np.array([np.interp(30e3, table.pressure, row) for row in table.curvature.T])
    assert middle == pytest.approx(1.6 * 0.5 * 0.925 / LENGTH, rel=0.02)
    assert verdict_of(by_angle).fits
    assert by_angle.left_out.is_angle
    assert by_angle.left_out.model < math.radians(1.5)


def test_without_a_load_the_stiffness_stays_invented(by_angle):
    assert has_invented_stiffness(described_arm(by_angle, 'few', ARM, {}))
    measured = replace(ARM, sources={'moment_law': 'measured'})
    assert not has_invented_stiffness(described_arm(by_angle, 'few', measured, {}))


def test_headings_of_several_tables_are_unwrapped_together():
    """Table by table, the one that begins beyond half a turn was read a turn off."""
    pose = np.full((LEVELS.size, 3), np.nan)
    turn = TURN * np.radians(300.0) / TURN[-1]
    pose[:, 2] = np.angle(np.exp(1j * turn))  # as a quaternion holds it
    whole = recorded(pose)
    beyond = np.flatnonzero(LEVELS > 35e3)  # the lowest heading there is 194 degrees
    turns, known = tip_turns(
        [whole.subset(beyond), whole.subset(np.flatnonzero(LEVELS < 35e3))], ARM
    )
    assert known.all()
    assert np.sort(turns) == pytest.approx(turn)


def test_a_left_out_pressure_is_in_the_error_bars(by_angle):
    more = by_angle.left_out.excess
    if by_angle.left_out.changed <= 1.0:
        assert not more.any()
    added = by_angle.joint.covariance - more @ more.T
    assert np.linalg.eigvalsh(added).min() > -1e-9


def test_error_bars_that_were_widened_stay_so_where_a_calibration_goes_on():
    pose = poses()
    pose[:, :2] = np.nan
    pose[len(pose) // 2, 2] += 0.2  # rad: one level contradicts the others
    found = calibrate([recorded(pose)], [], ARM)
    more = found.left_out.excess
    assert more.any()
    kept = found.posterior.covariance[: len(more), : len(more)]
    assert np.linalg.eigvalsh(kept - more @ more.T).min() > 0.0


@pytest.fixture(scope='module', params=[0.0, 0.15])
def by_tip(request):
    pose = poses(request.param)
    pose[:, 2] = np.nan
    return request.param, calibrate([recorded(pose)], [], ARM)


def test_an_elongation_is_in_the_model_where_the_tip_shows_one(by_tip):
    stretch, found = by_tip
    fit, parameters = found.joint, found.joint.parameters
    assert parameters.elongates is (stretch > 0.0)
    assert bool(found.arm.effects) is (stretch > 0.0)
    assert verdict_of(found).fits
    assert found.left_out.better == ''
    own = slice(parameters.cells, parameters.before_law)
    top = np.array([60e3, 60e3**2])
    strain, std = top @ fit.values[own], np.sqrt(top @ fit.covariance[own, own] @ top)
    assert abs(strain - stretch) < 4.0 * std
    assert 0.0 < std < 0.04  # an arm that bends unevenly looks alike
    named = [name for name in found.arm.covariance.quantities if name.startswith('effects.')]
    assert len(named) == (2 if stretch else 0)


def test_an_elongation_stays_where_a_calibration_goes_on(by_tip, tmp_path):
    stretch, found = by_tip
    model = tmp_path / 'few.yaml'
    save_knowledge(found.posterior, model, overwrite=False)
    known = load_knowledge(model)
    assert known.elongates is (stretch > 0.0)
    pose = poses(stretch)
    pose[:, 2] = np.nan
    again = calibrate([recorded(pose)], [], found.arm, earlier=known)
    assert len(again.arm.effects) == len(found.arm.effects)
    own = slice(found.joint.parameters.cells, None)
    assert again.joint.values[own] == pytest.approx(found.joint.values[own], rel=0.1, abs=1e-9)


def test_a_diagnosis_names_the_elongation_that_a_calibration_found(by_tip):
    stretch, found = by_tip
    pose = poses(stretch)
    pose[:, 2] = np.nan
    answer = diagnose(found.arm, [recorded(pose)], [])
    names = [effect.name for effect in answer.effects]
    assert names == (['pressure_elongation'] if stretch else [])


def test_a_heading_without_a_place_chooses_no_elongation(by_angle):
    assert by_angle.joint.parameters.elongates is None
    assert not by_angle.arm.effects


@pytest.mark.parametrize('with_heading', [True, False])
def test_the_clamp_is_found_in_the_frame_of_motion_capture(with_heading):
    pose = moved(poses(), 1.2, -0.4, 0.7)
    if not with_heading:
        pose[:, 2] = np.nan
    found = find_base(pose, ARM)
    assert abs(found.x - 1.2) < 2e-3
    assert abs(found.y + 0.4) < 2e-3
    assert abs(found.angle - 0.7) < 0.03


def test_the_error_of_the_clamp_holds_an_arm_that_bends_unevenly():
    """The paper's arm bends more at its clamp: the arcs turn by 0.28 rad and move by 9 mm."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    tips = np.array([solve(arm, level).tip for level in np.linspace(0.0, 60e3, 12)])
    found = find_base(np.repeat(tips, 8, axis=0), arm)
    for error, std in ((found.x, found.std_x), (found.y, found.std_y)):
        assert abs(error) < 2.0 * std < 0.3 * arm.length
    assert abs(found.angle) < 2.0 * found.std_angle < 0.6


def test_a_left_out_tip_is_predicted_where_its_marker_sits():
    """A marker 5 mm beside the neutral line, which the fit finds: no error of the model."""
    pose = poses()
    beside = 5e-3j * np.exp(1j * TURN)
    pose[:, 0] += beside.real
    pose[:, 1] += beside.imag
    row = replace(ARM, target_arclength=np.linspace(0.0, 0.9 * LENGTH, 4))
    run = replace(recorded(pose), **dict.fromkeys('xy', np.full((LEVELS.size, 4), np.nan)))
    found = calibrate([run], [], row).left_out
    assert found.model < 1e-3


def test_poses_of_another_frame_are_moved_and_said():
    truth = poses()
    for run in (recorded(moved(truth, 1.2, -0.4, 0.7)), recorded(truth, frame='mocap')):
        (same,), notes = in_base_frame([run], ARM)
        assert reasons(notes) == ['base_found']
        assert same.tip_pose[:, :2] == pytest.approx(truth[:, :2], abs=5e-4)
        assert same.tip_frame == 'pneunet_base'
    kept, said = in_base_frame([recorded(truth)], ARM)
    assert (kept[0].tip_pose == truth).all()
    assert said == ()


@pytest.mark.parametrize('distance', [1.3 * LENGTH, 3.0])
def test_one_stray_pose_moves_no_other(distance):
    pose = poses()
    pose[5, :2] = distance, 0.0
    (run,), notes = in_base_frame([recorded(pose)], ARM)
    assert reasons(notes) == ['out_of_reach']
    assert (run.tip_pose == np.delete(pose, 5, axis=0)).all()
    seen = np.zeros((LEVELS.size, 2))
    pose[:, 0] = 3.0
    (run,), notes = in_base_frame([replace(recorded(pose), x=seen, y=seen)], ARM)
    assert run.tip_pose is None
    assert reasons(notes) == ['out_of_reach']


@pytest.mark.parametrize('place', [(-0.05, 0.075, 0.0), (0.05, -0.025, 1.0)])
def test_poses_of_another_frame_are_moved_if_only_some_are_out_of_reach(place):
    """Of 28 poses, 12 and 4 were left out as strays, and the others kept where they were."""
    (same,), notes = in_base_frame([recorded(moved(poses(), *place))], ARM)
    assert reasons(notes) == ['base_found']
    assert same.tip_pose[:, :2] == pytest.approx(poses()[:, :2], abs=5e-4)


def test_one_stray_pose_hides_no_clamp():
    pose = moved(poses(), 1.2, -0.4, 0.7)
    pose[5, :2] = 3.0, 0.0
    (run,), notes = in_base_frame([recorded(pose)], ARM)
    assert reasons(notes) == ['out_of_reach', 'base_found']
    assert run.tip_pose[:, :2] == pytest.approx(np.delete(poses(), 5, axis=0)[:, :2], abs=5e-4)


def test_each_frame_of_motion_capture_has_a_clamp_of_its_own():
    truth = poses()
    places = {'day_1': (1.2, -0.4, 0.7), 'day_2': (1.0, 0.1, 0.2)}
    days = [recorded(moved(truth, *place), day) for day, place in places.items()]
    same, notes = in_base_frame(days, ARM)
    assert reasons(notes) == ['base_found', 'base_found']
    for run in same:
        assert run.tip_pose[:, :2] == pytest.approx(truth[:, :2], abs=5e-4)


def test_poses_of_another_frame_beside_targets_are_left_out():
    seen = np.zeros((LEVELS.size, 2))
    both = replace(recorded(poses(), 'mocap'), x=seen, y=seen)
    (alone,), notes = in_base_frame([both], ARM)
    assert alone.tip_pose is None
    assert reasons(notes) == ['other_frame']


def test_a_heading_that_was_not_measured_hides_no_turn_past_half_a_circle():
    pose = moved(poses(), 0.0, 0.0, 2.24)
    pose[:, 2] = np.angle(np.exp(1j * pose[:, 2]))
    beyond = int(np.argmax(pose[:, 2] < 0.0))
    pose[beyond - 1 : beyond + 1, 2] = np.nan
    assert find_base(pose, ARM).angle == pytest.approx(2.24, abs=0.03)


def test_the_error_of_the_clamp_is_in_the_model():
    """It was said and then forgotten: the heading was 200 standard errors beside the truth."""
    (run,), _ = in_base_frame([recorded(moved(poses(), 1.2, -0.4, 0.7))], ARM)
    found = calibrate([run], [], ARM)
    assert run.base_turn_std > 0.01
    model = found.arm.covariance
    turn = model.factor[model.quantities.index('arm.clamp_angle')]
    assert turn @ turn == pytest.approx(run.base_turn_std**2, rel=1e-4)
    settings = EstimatorSettings(wrench_required=False)
    estimator = Estimator(arm=found.arm, settings=settings)
    _, estimate = estimator.step(EstimatorState(), PressureReading(stamp_ns=1, pressure=30e3))
    assert math.sqrt(estimate.tip_covariance[2, 2]) > 0.9 * run.base_turn_std
    assert (
        'arm.clamp_angle' not in calibrate([recorded(poses())], [], ARM).arm.covariance.quantities
    )


def test_poses_that_do_not_show_the_clamp_are_refused():
    still = moved(np.repeat(poses()[:1], LEVELS.size, axis=0), 1.2, 0.0, 0.0)
    still[:, 2] = np.nan
    with refused(RecordingError, 'wrong_frame'):
        in_base_frame([recorded(still)], ARM)


def test_a_diagnosis_takes_the_tip_for_a_target_where_no_other_was_seen():
    run = recorded(poses())
    model, (changed,), held_out, notes = with_tips(ARM, [run], [])
    assert model.target_arclength.tolist() == [0.0, 0.06, LENGTH]
    assert changed.x[:, -1] == pytest.approx(run.tip_pose[:, 0])
    assert changed.tip_pose is None
    assert held_out == []
    assert 'heading_unused' in reasons(notes)
    plain = recorded(poses()).without_tip_pose()
    assert with_tips(ARM, [plain], [])[1:] == ([plain], [], ())


def test_a_diagnosis_of_headings_alone_is_refused():
    pose = poses()
    pose[:, :2] = np.nan
    with refused(RecordingError, 'heading_only'):
        with_tips(ARM, [recorded(pose)], [])


@pytest.mark.parametrize('size', [1.0, 1.0 / 1024.0, 1024.0])
def test_pressures_of_any_size_are_interpolated_alike(size):
    """A finger for 500 Pa has as many levels as one for 500 kPa."""
    levels = np.repeat(np.linspace(0.0, 50e3, 6), 3)
    noise = np.tile([-20.0, 0.0, 20.0], 6)
    at = np.linspace(0.0, 50e3, 21)
    expected = monotone_interpolation(levels + noise, levels**2, at)
    found = monotone_interpolation(size * (levels + noise), levels**2, size * at)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.ptp(found) > 1e9
