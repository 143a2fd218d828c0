"""Targets to centerline: against curves that are known, with noise that is known."""

from __future__ import annotations

import dataclasses
from functools import cache
import json
import subprocess
import sys

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import CameraError, RequestError
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.starting_arm import starting_arm
from pneunet_ros.vision.curvature_prior import learn_priors
from pneunet_ros.vision.smoother import MeasuredCurve, Smoother, smoother_for
import pytest
from support.example_arms import LENGTH, PAPER_ARM, paper_arm, rebuilt, TABLE_1
from support.refusals import refused

TARGETS = paper_arm().target_arclength
STATIONS = np.linspace(0.0, LENGTH, 57)
FINE = np.linspace(0.0, LENGTH, 561)  # targets and stations among them
UNLOADED = tuple((pressure, (0.0, 0.0)) for pressure in np.linspace(5e3, 66e3, 8).tolist())
NOISES = (6e-6, 20e-6, 60e-6)  # m: 0.03, 0.1, 0.3 px of 0.2 mm


@cache
def smoother() -> Smoother:
    return smoother_for(paper_arm())


def sightings(x, y, std=1e-6) -> TargetSightings:
    nothing = np.full(len(x), np.nan)
    return TargetSightings(
        stamp_ns=7, x=x, y=y, std=np.broadcast_to(std, len(x)), u=nothing, v=nothing,
        area=nothing, major=nothing, minor=nothing, angle=nothing,
    )  # fmt: skip


def bent(curvature, arclength=TARGETS, stretch=1.0):
    """(n, 2) points of a curve of this curvature (per unstretched length), from the origin."""
    s = np.linspace(0.0, LENGTH, 20001)
    kappa = curvature(s) + 0.0 * s
    theta = np.append(0.0, np.cumsum(0.5 * np.diff(s) * (kappa[1:] + kappa[:-1])))
    tangent = stretch * np.exp(1j * theta)
    z = np.append(0.0, np.cumsum(0.5 * np.diff(s) * (tangent[1:] + tangent[:-1])))
    return np.column_stack([np.interp(arclength, s, z.real), np.interp(arclength, s, z.imag)])


def turned(points, angle, shift=(0.0, 0.0)):
    cosine, sine = np.cos(angle), np.sin(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + shift


def seen(points, targets, std=1e-6) -> TargetSightings:
    """Sightings of these targets alone."""
    hidden = np.full_like(points, np.nan)
    hidden[targets] = points[targets]
    return sightings(hidden[:, 0], hidden[:, 1], std)


@cache
def model_shapes(loads):
    """Points of targets and curvature at stations for (pressure, force) of the shipped arm."""
    shapes = []
    for pressure, force in loads:
        shape = solve(paper_arm(), pressure, force, stations=FINE.size)
        points = np.column_stack([np.interp(TARGETS, FINE, a) for a in (shape.x, shape.y)])
        shapes.append((points, np.interp(STATIONS, FINE, shape.curvature)))
    return shapes


def clothoids():
    """Points and curvature of curves whose curvature is linear in arclength."""
    ends = ((5, 5), (25, 25), (0, 20), (20, 0), (5, 30), (-10, 10))
    laws = [lambda s, a=a, b=b: a + (b - a) * s / LENGTH for a, b in ends]
    return [(bent(law), law(STATIONS)) for law in laws]


def errors(smooth: Smoother, shapes, noise, repeats=15, claimed=None):
    """Error of curvature, and the same by its standard deviation, over shapes and noise."""
    random = np.random.default_rng(3)
    errors, scores = [], []
    for points, curvature in shapes:
        for _ in range(repeats):
            noisy = points + noise * random.normal(size=points.shape)
            curve = smooth.smooth(sightings(noisy[:, 0], noisy[:, 1], claimed or noise))
            error = curve.curvature - curvature[np.isin(STATIONS, curve.arclength)]
            errors.append(error)
            scores.append(error / curve.std_curvature)
    return np.array(errors), np.array(scores)


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


FRAME = bent(lambda s: 300.0 * s).T + 2e-5 * np.random.default_rng(2).normal(size=(2, 23))
LOADED = tuple((row.pressure, row.force) for row in TABLE_1[1:])


@pytest.mark.parametrize('angle', [0.0, 0.4, -2.0, 3.1])
def test_a_straight_line_stays_straight(angle):
    curve = smoother().smooth(sightings(*turned(bent(np.zeros_like), angle).T))
    np.testing.assert_allclose(curve.curvature, 0.0, atol=1e-9)
    np.testing.assert_allclose(curve.theta, angle, atol=1e-12)
    np.testing.assert_allclose(curve.x, curve.arclength * np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(curve.y, curve.arclength * np.sin(angle), atol=1e-12)
    assert curve.rms < 1e-12
    assert np.all(curve.std_curvature > 0.0)


@pytest.mark.parametrize('stretch', [1.0, 1.05])
@pytest.mark.parametrize('kappa', [-30.0, 5.0, 20.0, 35.0])
def test_an_arc_is_an_arc_of_eq_1(kappa, stretch):
    points = bent(lambda s: kappa + 0.0 * s, stretch=stretch)
    curve = smoother().smooth(sightings(*points.T))
    np.testing.assert_allclose(curve.curvature, kappa / stretch, rtol=6e-3)
    np.testing.assert_allclose(curve.theta, kappa * curve.arclength, atol=2e-4 * abs(kappa))
    expected = bent(lambda s: kappa + 0.0 * s, curve.arclength, stretch)
    np.testing.assert_allclose(np.column_stack([curve.x, curve.y]), expected, atol=5e-6)
    assert curve.rms < 2e-6


def test_arrays_are_frozen_and_stand_at_the_stations():
    curve = smoother().smooth(sightings(*bent(lambda s: 100.0 * s).T))
    assert curve.stamp_ns == 7
    np.testing.assert_array_equal(curve.arclength, STATIONS[:-1])
    for name in ('arclength', 'x', 'y', 'theta', 'curvature', 'std_curvature'):
        values = getattr(curve, name)
        assert values.shape == curve.arclength.shape
        assert not values.flags.writeable


def test_the_curve_does_not_depend_on_where_the_camera_stands():
    points = bent(lambda s: 20.0 * np.cos(30.0 * s))
    points += 4e-5 * np.random.default_rng(1).normal(size=points.shape)
    here = smoother().smooth(sightings(*points.T, 4e-5))
    there = smoother().smooth(sightings(*turned(points, 1.1, (0.3, -0.2)).T, 4e-5))
    np.testing.assert_allclose(there.curvature, here.curvature, atol=1e-8)
    np.testing.assert_allclose(there.std_curvature, here.std_curvature, rtol=1e-9)
    np.testing.assert_allclose(there.theta, here.theta + 1.1, atol=1e-10)
    moved = turned(np.column_stack([here.x, here.y]), 1.1, (0.3, -0.2))
    np.testing.assert_allclose(np.column_stack([there.x, there.y]), moved, atol=1e-12)
    assert there.rms == pytest.approx(here.rms)


@pytest.mark.parametrize('shift', [0.0, 0.003])
def test_the_curve_lies_amid_the_targets_whichever_of_them_are_seen(shift):
    """A camera may stand elsewhere than thought, and a first target moves if it is not a clamp."""
    arm = rebuilt(paper_arm(), target_arclength=TARGETS[:-1] + shift)
    points = turned(bent(lambda s: 10.0 + 0.0 * s, arm.target_arclength), 0.2, (0.01, 0.02))
    for first in (0, 1):
        curve = smoother_for(arm).smooth(seen(points, np.arange(first, 22)))
        there = turned(bent(lambda s: 10.0 + 0.0 * s, curve.arclength), 0.2, (0.01, 0.02))
        np.testing.assert_allclose(np.column_stack([curve.x, curve.y]), there, atol=1e-7)


@pytest.mark.parametrize('start', [3.0, -3.0])
def test_theta_runs_on_beyond_half_a_turn(start):
    points = turned(bent(lambda s: np.sign(start) * 35.0 + 0.0 * s), start)
    curve = smoother().smooth(sightings(*points.T))
    assert curve.theta[0] == pytest.approx(start, abs=1e-3)
    assert curve.theta[-1] == pytest.approx(start + np.sign(start) * 35.0 * 0.11, abs=1e-2)
    assert np.all(np.abs(np.diff(curve.theta)) < 0.1)


@pytest.mark.parametrize(
    ('shapes', 'limits'),
    [
        (clothoids(), (0.085, 0.2, 0.45)),
        (model_shapes(UNLOADED), (0.13, 0.28, 0.58)),
        (model_shapes(LOADED), (0.28, 0.46, 0.92)),
    ],
    ids=['clothoids', 'unloaded', 'loaded'],
)
def test_curvature_is_as_exact_as_promised(shapes, limits):
    for noise, limit in zip(NOISES, limits, strict=True):
        assert rms(errors(smoother(), shapes, noise)[0]) < limit


@pytest.mark.parametrize('noise', NOISES)
def test_the_standard_deviation_covers_the_error(noise):
    scores = errors(smoother(), model_shapes(UNLOADED + LOADED), noise)[1]
    assert 0.8 < rms(scores) < 1.2
    assert np.mean(np.abs(scores) < 2.0) > 0.88


def test_a_target_on_the_rigid_cap_says_nothing_of_the_curvature():
    """The arm ends with its largest curvature, and goes straight on."""
    places = np.append(TARGETS, [LENGTH + 0.004, LENGTH + 0.010])
    arm = rebuilt(paper_arm(), tip_cap=0.012, target_arclength=places)
    points = bent(lambda s: 250.0 * s)
    end = turned(np.column_stack([places[23:] - LENGTH, [0.0, 0.0]]), 125.0 * LENGTH**2)
    points = np.vstack([points, end + bent(lambda s: 250.0 * s, [LENGTH])])
    smooth, random, scores = smoother_for(arm), np.random.default_rng(6), []
    for _ in range(15):
        noisy = points + 2e-5 * random.normal(size=points.shape)
        curve = smooth.smooth(sightings(*noisy.T, 2e-5))
        scores.append(((curve.curvature - 250.0 * curve.arclength) / curve.std_curvature)[-8:])
    assert curve.arclength[-1] <= LENGTH
    assert rms(scores) < 1.5


def test_noise_that_detection_does_not_know_is_found():
    shapes = model_shapes(UNLOADED + LOADED)
    wrong, scores = errors(smoother(), shapes, 60e-6, claimed=6e-6)
    assert rms(wrong) < 1.15 * rms(errors(smoother(), shapes, 60e-6)[0])
    assert 0.8 < rms(scores) < 1.3


@pytest.mark.parametrize('ratio', [1.0, 3.0, 10.0, 30.0])
def test_a_tip_that_is_less_accurate_and_says_so_is_worth_less(ratio):
    """A blurred or half hidden tip dot must not bend the end of the line."""
    random = np.random.default_rng(5)
    std = np.append(np.full(22, 1e-5), ratio * 1e-5)
    wrong, scores = [], []
    for points, curvature in model_shapes(UNLOADED + LOADED):
        for _ in range(15):
            noisy = points + std[:, None] * random.normal(size=points.shape)
            curve = smoother().smooth(sightings(noisy[:, 0], noisy[:, 1], std))
            error = (curve.curvature - curvature[:-1])[-5:]
            wrong.append(error)
            scores.append(error / curve.std_curvature[-5:])
    assert rms(wrong) < 0.9  # 1/m; with a ratio of 1 it is 0.44, without the tip 0.83
    assert np.mean(np.abs(scores) < 2.0) > 0.9


def test_painted_places_count_as_noise():
    points = bent(lambda s: 100.0 * s)
    noisy = sightings(*points.T, 6e-6)
    rough = dataclasses.replace(smoother(), placement_std=1e-4).smooth(noisy)
    assert np.all(rough.std_curvature > 2.0 * smoother().smooth(noisy).std_curvature)


def test_the_break_is_followed_where_the_model_has_one():
    shapes = model_shapes(LOADED)
    plain = dataclasses.replace(smoother(), priors=smoother().priors[::2])
    near = (STATIONS[:-1] > 0.006) & (STATIONS[:-1] < 0.022)
    broken = rms(errors(smoother(), shapes, 6e-6)[0][:, near])
    assert broken < 0.85 * rms(errors(plain, shapes, 6e-6)[0][:, near])


def test_an_arm_without_break_has_a_prior_without():
    arm = rebuilt(paper_arm(), moment_law=LinearLaw(bending_stiffness=2e-4))
    assert [prior.splits.size for prior in learn_priors(arm)] == [0, 0]
    free, broken, *_ = smoother().priors
    assert free.splits.size == 0
    np.testing.assert_allclose(broken.splits, LENGTH * np.linspace(0.10, 0.15, 5))
    nowhere = dataclasses.replace(broken, splits=[])
    place = np.array([0.005, 0.05])
    added = broken.covariance(place, place) - nowhere.covariance(place, place)
    np.testing.assert_allclose(added, [[broken.break_std**2, 0.0], [0.0, 0.0]], atol=1e-12)


def test_learning_gives_the_same_every_time():
    again = learn_priors(paper_arm())
    assert all(same_values(one, two) for one, two in zip(smoother().priors, again, strict=True))


def test_missing_targets_widen_the_standard_deviation():
    points, curvature = model_shapes(UNLOADED)[-1]
    whole = smoother().smooth(sightings(*points.T, 2e-5))
    gap = np.r_[0:8, 13:23]
    curve = smoother().smooth(seen(points, gap, 2e-5))
    inside = (curve.arclength > TARGETS[8]) & (curve.arclength < TARGETS[12])
    assert np.all(curve.std_curvature[inside] > 1.3 * whole.std_curvature[inside])
    error = np.abs(curve.curvature - curvature[:-1])
    assert np.all(error < 4.0 * curve.std_curvature)


def test_nothing_is_said_beyond_the_targets_seen():
    points = bent(lambda s: 15.0 + 0.0 * s)
    curve = smoother().smooth(seen(points, np.arange(3, 15)))
    assert TARGETS[3] <= curve.arclength[0] < TARGETS[3] + 0.002
    assert TARGETS[14] - 0.002 < curve.arclength[-1] <= TARGETS[14]


def test_any_set_of_four_or_more_gives_a_curve():
    random = np.random.default_rng(5)
    shapes = model_shapes(UNLOADED + LOADED)
    scores = []
    for trial in range(300):
        points, curvature = shapes[trial % len(shapes)]
        noisy = points + 2e-5 * random.normal(size=points.shape)
        targets = np.sort(random.choice(23, random.integers(4, 23), replace=False))
        curve = smoother().smooth(seen(noisy, targets, 2e-5))
        assert isinstance(curve, MeasuredCurve)
        error = curve.curvature - np.interp(curve.arclength, STATIONS, curvature)
        scores.append(error / curve.std_curvature)
    assert 0.6 < rms(np.concatenate(scores)) < 1.4


@pytest.mark.parametrize('count', [0, 1, 3])
def test_fewer_than_four_targets_give_no_curve(count):
    points = bent(lambda s: 15.0 + 0.0 * s)
    assert smoother().smooth(seen(points, np.arange(count))) is None


def test_targets_at_one_place_give_no_curve():
    points = bent(lambda s: 15.0 + 0.0 * s)
    points[7] = points[6]
    assert smoother().smooth(sightings(*points.T)) is None


def test_a_target_with_half_a_place_is_not_seen():
    points = bent(lambda s: 15.0 + 0.0 * s)
    half = points.copy()
    half[5, 1] = np.nan
    expected = smoother().smooth(seen(points, np.delete(np.arange(23), 5)))
    assert same_values(smoother().smooth(sightings(*half.T)), expected)


@pytest.mark.parametrize('std', [np.nan, 0.0])
def test_a_standard_deviation_that_is_not_known_is_found(std):
    points = bent(lambda s: 15.0 + 0.0 * s)
    points += 2e-5 * np.random.default_rng(2).normal(size=points.shape)
    unknown = smoother().smooth(sightings(*points.T, std))
    known = smoother().smooth(sightings(*points.T, 2e-5))
    np.testing.assert_allclose(unknown.std_curvature, known.std_curvature, rtol=0.4)


def test_what_is_kept_for_a_set_of_targets_changes_nothing():
    points = bent(lambda s: 300.0 * s)
    points += 2e-5 * np.random.default_rng(2).normal(size=points.shape)
    targets = np.r_[0:9, 11:23]
    fresh = dataclasses.replace(smoother())
    first = fresh.smooth(seen(points, targets))
    fresh.smooth(sightings(*points.T))
    again = fresh.smooth(seen(points, targets))
    assert same_values(first, again)
    assert fresh.operator.cache_info().currsize == 2
    assert fresh.operator.cache_info().maxsize < 1000


def test_targets_need_not_be_equally_spaced():
    places = np.sort(np.random.default_rng(4).uniform(0.0, LENGTH, 26))
    arm = rebuilt(paper_arm(), target_arclength=places)
    points = bent(lambda s: 25.0 * np.sin(25.0 * s), places)
    curve = smoother_for(arm, stations=30).smooth(sightings(*turned(points, 0.3).T))
    assert curve.arclength.size == np.count_nonzero(
        (arm.length * np.arange(30) / 29 > places[0])
        & (arm.length * np.arange(30) / 29 < places[-1])
    )
    error = curve.curvature - 25.0 * np.sin(25.0 * curve.arclength)
    assert rms(error) < 0.1


WITHOUT_NUMBA = f"""
import json
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.vision.smoother import smoother_for
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.kernels.jit import HAVE_NUMBA

assert not HAVE_NUMBA
x, y = np.array({FRAME.tolist()!r})
n, std = np.full(x.size, np.nan), np.full(x.size, 2e-5)
curve = smoother_for(load_model({str(PAPER_ARM)!r})).smooth(TargetSightings(
    stamp_ns=0, x=x, y=y, std=std, u=n, v=n, area=n, major=n, minor=n, angle=n
))
print(json.dumps([curve.y.tolist(), curve.curvature.tolist(), curve.std_curvature.tolist()]))
"""


def test_without_numba_the_curve_is_the_same(foreign_environment):
    root = str(PAPER_ARM.parent.parent)
    environment = {**foreign_environment, 'PYTHONPATH': root, 'PNEUNET_NO_NUMBA': '1'}
    command = [sys.executable, '-W', 'error', '-c', WITHOUT_NUMBA]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    y, curvature, std = json.loads(done.stdout)
    curve = smoother().smooth(sightings(*FRAME, 2e-5))
    # The priors are found by a search, which ends where rounding lets it.
    np.testing.assert_allclose(y, curve.y, atol=1e-6)
    np.testing.assert_allclose(curvature, curve.curvature, atol=2e-2)
    np.testing.assert_allclose(std, curve.std_curvature, rtol=2e-2)


def test_too_few_targets_in_the_model_are_refused():
    arm: Arm = rebuilt(paper_arm(), target_arclength=TARGETS[:3])
    with refused(CameraError, 'too_few_targets'):
        smoother_for(arm)


def test_sightings_of_another_arm_are_refused():
    with refused(RequestError, 'wrong_targets'):
        smoother().smooth(sightings(np.arange(5.0), np.zeros(5)))


def test_an_arm_under_vacuum_has_the_priors_of_its_mirror_image():
    places = 0.01 * np.arange(12)
    pressed, sucked = (
        learn_priors(starting_arm('finger', 0.112, 0.1667, places, pressure))
        for pressure in (60e3, -60e3)
    )
    for one, other in zip(sucked, pressed, strict=True):
        assert one.std == pytest.approx(other.std, rel=1e-6)
        assert one.length_scale == pytest.approx(other.length_scale, rel=1e-6)
