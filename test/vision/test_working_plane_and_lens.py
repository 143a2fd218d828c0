"""Lens and working plane: against OpenCV, exact cameras, and what must not be claimed."""

from __future__ import annotations

import math

import cv2
from hypothesis import assume, example, given
from hypothesis import strategies as st
import numpy as np
from pneunet_ros.core.errors import CameraError
from pneunet_ros.vision.camera.camera_model import check_whole_image, Lens
from pneunet_ros.vision.camera.camera_settings import HomographyPlane, PosePlane
from pneunet_ros.vision.camera.working_plane import (
    Plane,
    plane_from_homography,
    plane_from_pose,
    plane_from_rest,
)
import pytest
from scipy.spatial.transform import Rotation
from support.refusals import refused

MATRIX = [[610.0, 0.0, 322.5], [0.0, 605.0, 238.0], [0.0, 0.0, 1.0]]
DISTORTIONS = {
    'none': ('plumb_bob', []),
    'four': ('plumb_bob', [-0.2, 0.05, 1e-3, -2e-3]),
    'five': ('plumb_bob', [-0.28, 0.09, -1e-3, 5e-4, -0.01]),
    'pincushion': ('plumb_bob', [0.2, 0.1, 0.0, 0.0, 0.05]),
    'barrel': ('plumb_bob', [-0.35, 0.0, 0.0, 0.0, 0.0]),
    'rational': ('rational_polynomial', [4.2, 2.1, 2e-4, -1e-4, 0.1, 4.5, 3.4, 0.55]),
    'rational, 14': ('rational_polynomial', [0.5, 0.1, 0, 0, 0.01, 0.8, 0.2, 0.03, *6 * [0]]),
}
PIXELS = np.stack(np.meshgrid(np.linspace(0, 639, 33), np.linspace(0, 479, 25)), -1).reshape(-1, 2)


def lens(distortion=(), model='plumb_bob', **changes):
    arguments = {'width': 640, 'height': 480, 'matrix': MATRIX} | changes
    return Lens(model=model, distortion=np.array(distortion, dtype=float), **arguments)


@pytest.fixture(params=DISTORTIONS)
def named(request):
    model, distortion = DISTORTIONS[request.param]
    return lens(distortion, model)


def by_opencv(camera, normalized):
    """Pixels by OpenCV, which knows nothing of ours."""
    points = np.column_stack([normalized, np.ones(len(normalized))])
    distortion = camera.distortion if camera.distortion.size else np.zeros(4)
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, distortion)
    return pixels[:, 0]


def all_nan(points):
    return bool(np.isnan(points).all())


# ---- the lens -----------------------------------------------------------------------------------


def test_distorted_points_are_those_of_opencv(named):
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.4, 0.4, 21))
    normalized = np.column_stack([x.ravel(), y.ravel()])
    assert np.abs(named.distort(normalized) - by_opencv(named, normalized)).max() < 1e-9


def test_undistorted_points_come_back_by_opencv(named):
    normalized = named.undistort(PIXELS)
    seen = np.isfinite(normalized[:, 0])
    assert seen.mean() > 0.99
    assert np.abs(by_opencv(named, normalized[seen]) - PIXELS[seen]).max() < 1e-9


def test_points_come_back_from_pixels(named):
    angle, radius = np.meshgrid(np.linspace(0, 6.28, 37), np.linspace(0, 0.97, 50))
    radius *= min(named.limit, 0.8)
    normalized = np.column_stack(
        [(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()]
    )
    assert np.abs(named.undistort(named.distort(normalized)) - normalized).max() < 1e-11


def test_strong_barrel_is_iterated_to_the_end():
    # OpenCV's five iterations leave .03 px at the edge of such an image.
    camera = lens([-0.35, 0.0, 0.0, 0.0])
    pixels = np.array([[60.0, 30.0], [600.0, 440.0], [322.5, 238.0], [150.0, 238.0]])
    assert np.abs(camera.distort(camera.undistort(pixels)) - pixels).max() < 1e-9
    assert camera.undistort(pixels)[2].tolist() == [0.0, 0.0]


def test_the_fold_of_a_barrel_is_where_its_slope_is_zero():
    assert lens([-0.35, 0, 0, 0]).limit == pytest.approx(1.0 / math.sqrt(3 * 0.35), rel=1e-9)
    assert lens([]).limit == 1e3


def test_what_never_folds_is_limited_by_how_far_out_it_leads():
    radius = lens([0.1, 0.1, 0, 0, 0.1]).limit
    assert radius * (1 + 0.1 * (radius**2 + radius**4 + radius**6)) == pytest.approx(1e3)


def test_a_pole_of_the_rational_model_is_a_limit():
    camera = lens([0, 0, 0, 0, 0, -4.0, 0, 0], 'rational_polynomial')
    assert camera.limit <= 0.5 + 1e-9
    assert all_nan(camera.distort([[0.51, 0.0], [0.0, 2.0]]))


def test_tangential_terms_alone_fold_on_one_side():
    # At (-r, 0) the slope of x + 3 p2 x^2 is 1 - 6 p2 r.
    assert lens([0, 0, 0, 0.1]).limit == pytest.approx(1.0 / 0.6, rel=1e-9)
    assert lens([0, 0, -0.06, 0.08]).limit == pytest.approx(1.0 / 0.6, rel=1e-9)


def test_a_distortion_that_nearly_folds_is_undone_on_both_sides():
    # The slope of the radius falls to 0.02 at r = 1.14 and rises again: Newton's steps overshoot.
    camera = lens([-0.5, 0.115, 0.0, 0.0])
    assert camera.limit > 5.0
    radius = np.linspace(0.0, 3.0, 500)
    normalized = np.column_stack([0.6 * radius, -0.8 * radius])
    pixels = camera.distort(normalized)
    assert np.abs(camera.undistort(pixels) - normalized).max() < 1e-9


def test_up_to_the_fold_is_seen_and_nothing_beyond():
    camera = lens([-0.35, 0.0, 0.0, 0.0])
    edge = camera.limit * (1.0 - 0.35 * camera.limit**2)
    angle = np.linspace(0.0, 6.2, 50)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    center, focal = np.array([322.5, 238.0]), np.array([610.0, 605.0])
    inside = camera.undistort(center + focal * edge * 0.9999999 * ring)
    assert np.all(np.hypot(*inside.T) < camera.limit)
    assert np.abs(camera.distort(inside) - (center + focal * edge * 0.9999999 * ring)).max() < 1e-9
    assert all_nan(camera.undistort(center + focal * edge * 1.0000001 * ring))
    assert all_nan(camera.undistort(center + focal * edge * 50.0 * ring))


def test_points_beyond_the_fold_have_no_pixel():
    camera = lens([-0.35, 0.0, 0.0, 0.0])
    normalized = np.array([[1.0, 0.0], [1.69, 0.0], [0.0, -1.6], [-3.0, 3.0], [1e300, 0.0]])
    # The formula alone would put them into the image.
    assert np.all(
        (by_opencv(camera, normalized[1:3]) > 0) & (by_opencv(camera, normalized[1:3]) < 640)
    )
    assert all_nan(camera.distort(normalized))


def test_what_is_no_number_has_no_place(named):
    bad = [[math.nan, 3.0], [3.0, math.nan], [math.inf, 0.0], [0.0, -math.inf], [1e300, 1e300]]
    assert all_nan(named.undistort(bad))
    assert all_nan(named.distort(bad))
    assert all_nan(named.scale(bad))
    assert np.isfinite(named.undistort([*bad, [320.0, 240.0]])[-1]).all()


def test_no_points_are_no_points(named):
    assert named.undistort(np.empty((0, 2))).shape == (0, 2)
    assert named.distort(np.empty((0, 2))).shape == (0, 2)


def test_given_points_are_left_alone(named):
    pixels = PIXELS.copy()
    named.undistort(pixels)
    named.scale(pixels)
    named.undistort(PIXELS[::-1].T.copy(order='F').T)
    assert np.array_equal(pixels, PIXELS)


@pytest.mark.parametrize('points', [[1.0, 2.0], [[1.0, 2.0, 3.0]], np.zeros((2, 2, 2))])
def test_points_are_pairs(points):
    with refused(CameraError, 'wrong_shape'):
        lens().undistort(points)


def test_the_scale_is_that_of_neighbors(named):
    normalized = named.undistort([[400.0, 300.0], [100.0, 90.0], [322.5, 238.0]])
    step = 1e-4
    for point, scale in zip(normalized, named.scale(normalized), strict=True):
        pixel = named.distort([point])[0]
        angle = np.linspace(0.0, np.pi, 400)
        ring = pixel + step * np.column_stack([np.cos(angle), np.sin(angle)])
        far = np.hypot(*(named.undistort(ring) - point).T).max() / step
        assert scale == pytest.approx(far, rel=1e-4)


small = st.floats(-0.5, 0.5)
tangential = st.floats(-0.02, 0.02)
place = st.floats(-1.5, 1.5)


@given(k=st.tuples(small, small, tangential, tangential, small), x=place, y=place)
def test_a_pixel_has_one_place_whatever_the_plumb_bob(k, x, y):
    one_place(lens(k), x, y)


@given(
    k=st.tuples(small, small, tangential, tangential, small, small, small, small), x=place, y=place
)
@example(k=(0, 0, 0, 0, 0.5, 0.4453125, -0.482421875, 0.044921875), x=1.5, y=0.25)  # near a pole
def test_a_pixel_has_one_place_whatever_the_polynomials(k, x, y):
    one_place(lens(k, 'rational_polynomial'), x, y)


def one_place(camera, x, y):
    """Check that a point within the fold comes back from its pixel, and one beyond has none."""
    pixel = camera.distort([[x, y]])
    if np.isnan(pixel[0, 0]):
        assert math.hypot(x, y) >= camera.limit * 0.999999
        return
    again = camera.undistort(pixel)
    assert np.abs(camera.distort(again) - pixel).max() <= 1e-9
    # Next to the fold a pixel moves little when its place moves much.
    assert np.abs(again - [[x, y]]).max() <= 1e-9 + 1e-8 * camera.scale([[x, y]])[0]


@given(
    k=st.tuples(small, small, tangential, tangential, small),
    u=st.floats(-2e3, 3e3),
    v=st.floats(-2e3, 3e3),
)
def test_an_undistorted_pixel_is_always_a_solution(k, u, v):
    camera = lens(k)
    normalized = camera.undistort([[u, v]])
    assume(np.isfinite(normalized[0, 0]))
    assert np.hypot(*normalized[0]) < camera.limit
    assert np.abs(by_opencv(camera, normalized) - [[u, v]]).max() < 1e-8


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'width': 0}, 'the width of the camera image (image_width) must be 1 to 16384 px, not 0'),
        ({'height': 480.0}, 'the height of the camera image (image_height) must be'),
        ({'height': True}, 'the height of the camera image (image_height) must be'),
        ({'matrix': np.zeros((3, 3))}, 'the camera is not calibrated'),
        ({'matrix': np.eye(2)}, 'K (camera_matrix) must be 3 x 3'),
        ({'matrix': [[600, 0, 320], [0, -600, 240], [0, 0, 1]]}, 'focal lengths'),
        ({'matrix': [[600, 0.1, 320], [0, 600, 240], [0, 0, 1]]}, 'no skew'),
        ({'matrix': [[600, 0, 320], [0, 600, 240], [0, 0, 2]]}, 'must read fx 0 cx'),
        ({'matrix': [[math.nan, 0, 320], [0, 600, 240], [0, 0, 1]]}, 'NaN or infinity'),
        ({'matrix': 'K'}, 'must be a table of numbers'),
        ({'model': 'equidistant'}, "'equidistant' is not known; known: plumb_bob, rational_poly"),
        ({'model': ['plumb_bob']}, 'is not known'),
        ({'model': '', 'distortion': [0.1, 0, 0, 0]}, "distortion_model '' is not known"),
        ({'distortion': [0.1, 0, 0]}, 'must have 0, 4, 5 numbers'),
        ({'distortion': [0.1, 0, 0, 0, 0, 0, 0, 0]}, 'not 8'),
        ({'model': 'rational_polynomial', 'distortion': [0.1, 0, 0, 0, 0]}, '0, 8, 12, 14'),
        ({'model': 'rational_polynomial', 'distortion': [*8 * [0.1], 0, 0, 0, 1e-9]}, 'zero'),
        ({'distortion': [math.inf, 0, 0, 0]}, 'NaN or infinity'),
        ({'distortion': [1e20, 0, 0, 0]}, 'beyond 1e'),
    ],
)
def test_a_camera_that_cannot_be_is_refused(changes, sentence):
    with pytest.raises(CameraError) as caught:
        lens(**changes)
    assert sentence in str(caught.value)


def test_a_camera_without_distortion_needs_no_model():
    assert lens(model='').undistort([[322.5 + 610.0, 238.0]]).tolist() == [[1.0, 0.0]]


@pytest.mark.parametrize('binning', [(0, 0), (1, 1)])
@pytest.mark.parametrize('region', [(0, 0, 0, 0), (0, 0, 640, 480)])
def test_a_whole_image_is_taken(binning, region):
    check_whole_image(lens(), binning, region)


@pytest.mark.parametrize(
    ('binning', 'region'),
    [((2, 2), (0, 0, 0, 0)), ((1, 1), (0, 0, 320, 480)), ((1, 1), (8, 0, 0, 0))],
)
def test_a_part_of_an_image_is_refused(binning, region):
    with refused(CameraError, 'not_supported'):
        check_whole_image(lens(), binning, region)


# ---- the plane ----------------------------------------------------------------------------------


def looking(direction):
    """Orientation of a camera that looks in a direction of base, with some roll."""
    forward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(forward, [0.1, 0.3, 1.0])
    right /= np.linalg.norm(right)
    return Rotation.from_matrix(np.column_stack([right, np.cross(forward, right), forward]))


POSES = {
    'square': ((0.06, 0.03, 0.5), Rotation.from_euler('x', 180, degrees=True)),
    'turned': ((0.05, 0.0, 0.4), Rotation.from_euler('zx', [200, 180], degrees=True)),
    'oblique': ((0.25, -0.25, 0.35), looking((-0.2, 0.25, -0.35))),
    'from below': ((0.05, 0.02, -0.5), Rotation.from_euler('z', 10, degrees=True)),
}
TARGETS = np.column_stack([np.linspace(0.0, 0.11, 23), 0.03 * np.sin(np.linspace(0, 3, 23))])


def pose(name):
    position, rotation = POSES[name]
    return PosePlane(position=position, quaternion=tuple(rotation.as_quat()))


def seen_by_opencv(name, points, camera=None):
    """Pixels of points of the plane by OpenCV (normalized without a camera)."""
    position, rotation = POSES[name]
    inverse = rotation.inv()
    shift = -inverse.apply(position)
    matrix = np.eye(3) if camera is None else camera.matrix
    terms = np.zeros(4) if camera is None else camera.distortion
    in_base = np.column_stack([points, np.zeros(len(points))])
    pixels, _ = cv2.projectPoints(in_base, inverse.as_rotvec(), shift, matrix, terms)
    return pixels[:, 0]


@pytest.mark.parametrize('name', POSES)
def test_the_pose_of_a_camera_gives_its_plane(name):
    plane = plane_from_pose(pose(name))
    normalized = seen_by_opencv(name, TARGETS)
    assert np.abs(plane.points(normalized) - TARGETS).max() < 1e-12
    assert np.abs(plane.normalized(TARGETS) - normalized).max() < 1e-12


@pytest.mark.parametrize('name', POSES)
@pytest.mark.parametrize('count', [4, 5, 12])
def test_points_of_the_plane_give_it_through_a_distorting_lens(name, count):
    camera = lens([-0.28, 0.09, -1e-3, 5e-4, -0.01])
    corners = np.array([[-0.01, -0.05], [0.12, -0.04], [0.11, 0.06], [0.0, 0.05]])
    more = np.random.default_rng(3).uniform([0, -0.04], [0.11, 0.05], (count - 4, 2))
    points = np.vstack([corners, more])
    pixels = seen_by_opencv(name, points, camera)
    plane = plane_from_homography(camera, HomographyPlane(pixels=pixels, points=points))
    targets = plane.points(camera.undistort(seen_by_opencv(name, TARGETS, camera)))
    assert np.abs(targets - TARGETS).max() < 1e-11
    assert np.abs(plane.normalized(TARGETS) - seen_by_opencv(name, TARGETS)).max() < 1e-10


def test_more_points_than_four_average_their_noise():
    camera = lens()
    points = np.stack(np.meshgrid(np.linspace(0, 0.12, 9), np.linspace(-0.05, 0.05, 9)), -1)
    points = points.reshape(-1, 2)
    noise = np.random.default_rng(5).normal(0.0, 0.2, points.shape)
    pixels = seen_by_opencv('oblique', points, camera) + noise
    plane = plane_from_homography(camera, HomographyPlane(pixels=pixels, points=points))
    targets = plane.points(camera.undistort(seen_by_opencv('oblique', TARGETS, camera)))
    one_pixel = np.median(plane.scale(camera.undistort(pixels))) / 610.0
    assert np.hypot(*(targets - TARGETS).T).max() < 0.2 * one_pixel


@pytest.mark.parametrize('angle', [0.0, 30.0, 90.0, 180.0, -100.0])
def test_the_arm_at_rest_gives_scale_and_frame(angle):
    # A camera that looks along -z, turned about its axis; x to the right at 0 degrees.
    rotation = Rotation.from_euler('zx', [angle, 180], degrees=True)
    expected = plane_from_pose(
        PosePlane(position=(0.04, 0.02, 0.6), quaternion=tuple(rotation.as_quat()))
    )
    first, last = expected.normalized([[0.005, 0.0], [0.11, 0.0]])
    plane = plane_from_rest(first, last, 0.005, 0.11)
    normalized = expected.normalized(TARGETS)
    assert np.abs(plane.points(normalized) - TARGETS).max() < 1e-12


def test_y_is_up_in_the_image_where_x_is_to_the_right():
    plane = plane_from_rest((-0.2, 0.1), (0.2, 0.1), 0.0, 0.1)
    assert plane.points([[-0.2, 0.1]])[0] == pytest.approx([0.0, 0.0], abs=1e-15)
    assert plane.points([[0.2, 0.1]])[0] == pytest.approx([0.1, 0.0], abs=1e-15)
    assert plane.points([[-0.2, 0.0]])[0] == pytest.approx([0.0, 0.025], abs=1e-15)


@pytest.mark.parametrize('name', POSES)
def test_the_scale_of_the_plane_is_that_of_neighbors(name):
    plane = plane_from_pose(pose(name))
    normalized = plane.normalized(TARGETS[::7])
    for point, scale in zip(normalized, plane.scale(normalized), strict=True):
        angle = np.linspace(0.0, np.pi, 400)
        ring = point + 1e-6 * np.column_stack([np.cos(angle), np.sin(angle)])
        far = np.hypot(*(plane.points(ring) - plane.points([point])).T).max() / 1e-6
        assert scale == pytest.approx(far, rel=1e-4)


def test_above_the_horizon_is_no_point_of_the_plane():
    # Level with the plane, 0.2 m above it, looking along +x: the horizon is y = 0 in the image.
    level = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    plane = plane_from_pose(
        PosePlane(position=(-0.3, 0.0, 0.2), quaternion=tuple(level.as_quat()))
    )
    assert plane.points([[0.0, 0.4]])[0] == pytest.approx([0.2, 0.0], abs=1e-12)
    above = [[0.0, 0.0], [0.0, -0.4], [0.3, -1e-9], [math.nan, 0.4], [math.inf, 1.0]]
    assert all_nan(plane.points(above))
    assert all_nan(plane.scale(above))
    assert all_nan(plane.normalized([[-0.4, 0.0], [-0.3, 0.1], [math.nan, 0.0]]))


@given(
    angles=st.tuples(st.floats(-180, 180), st.floats(-50, 50), st.floats(-50, 50)),
    distance=st.floats(0.05, 5.0),
    x=st.floats(0.0, 0.11),
    y=st.floats(-0.05, 0.05),
)
def test_there_and_back_from_any_pose(angles, distance, x, y):
    rotation = Rotation.from_euler('zyx', angles, degrees=True) * Rotation.from_euler('x', np.pi)
    position = np.array([0.05, 0.0, 0.0]) - distance * rotation.as_matrix()[:, 2]
    try:
        plane = plane_from_pose(
            PosePlane(position=tuple(position), quaternion=tuple(rotation.as_quat()))
        )
    except CameraError as error:
        assert error.reason == 'behind_camera'
        return
    normalized = plane.normalized([[x, y]])
    assume(np.isfinite(normalized[0, 0]))
    ray = rotation.apply([*normalized[0], 1.0])
    assert position + ray * (-position[2] / ray[2]) == pytest.approx([x, y, 0.0], abs=1e-9)
    assert plane.points(normalized)[0] == pytest.approx([x, y], abs=1e-9)


SQUARE = [[100.0, 100.0], [500.0, 100.0], [500.0, 400.0], [100.0, 400.0]]
CORNERS = [[0.0, 0.08], [0.12, 0.08], [0.12, 0.0], [0.0, 0.0]]
LINE = [[0.0, 0.0], [0.01, 0.02], [0.02, 0.04], [0.03, 0.06]]


@pytest.mark.parametrize(
    ('pixels', 'points', 'reason'),
    [
        ([[100, 100], [200, 200], [300, 300], [400, 400]], LINE, 'not_determined'),
        (
            [[100, 100], [200, 200], [300, 300], [400, 100]],
            [*LINE[:3], [0.05, 0]],
            'not_determined',
        ),
        (SQUARE, LINE, 'not_determined'),
        ([[100, 100], [200, 200], [300, 300], [400, 400]], CORNERS, 'not_determined'),
        ([*SQUARE[:3], SQUARE[0]], [*CORNERS[:3], CORNERS[0]], 'not_determined'),
        ([*SQUARE[:3], SQUARE[0]], CORNERS, 'not_determined'),
        ([*SQUARE[:3], SQUARE[0], SQUARE[1]], [*CORNERS[:3], *CORNERS[:2]], 'not_determined'),
        # A plane seen 89.3 degrees from square: such a plane is known to nobody.
        ([[100, 240], [500, 240], [500, 245], [100, 245]], CORNERS, 'not_determined'),
        (4 * [[320.0, 240.0]], CORNERS, 'not_determined'),
        (SQUARE, 4 * [[0.0, 0.0]], 'not_determined'),
        (SQUARE, [CORNERS[at] for at in (0, 2, 1, 3)], 'behind_camera'),
        (SQUARE, [CORNERS[at] for at in (1, 0, 2, 3)], 'behind_camera'),
        ([*SQUARE, [300.0, 250.0]], [*CORNERS, [0.1, 0.07]], 'inconsistent'),
        ([*SQUARE[:3], [5000.0, 400.0]], CORNERS, 'beyond_lens'),
    ],
)
def test_points_that_give_no_plane_are_refused(pixels, points, reason):
    known = HomographyPlane(pixels=np.array(pixels), points=np.array(points))
    with refused(CameraError, reason):
        plane_from_homography(lens([-0.3, 0.0, 0.0, 0.0]), known)


@given(
    pixels=st.lists(st.tuples(st.floats(0, 640), st.floats(0, 480)), min_size=4, max_size=6),
    data=st.data(),
)
def test_a_plane_fits_its_points_or_is_refused(pixels, data):
    coordinate = st.floats(-0.2, 0.2)
    count = len(pixels)
    points = data.draw(st.lists(st.tuples(coordinate, coordinate), min_size=count, max_size=count))
    camera = lens()
    try:
        plane = plane_from_homography(
            camera, HomographyPlane(pixels=np.array(pixels), points=np.array(points))
        )
    except CameraError:
        return
    found = plane.points(camera.undistort(pixels))
    assert np.isfinite(found).all()
    assert np.hypot(*(found - points).T).max() < 0.05 * 0.3


@pytest.mark.parametrize(
    ('position', 'quaternion', 'reason'),
    [
        ((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0), 'behind_camera'),
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 'out_of_bounds'),
        ((0.5, 0.0, 1e-6), (1.0, 0.0, 0.0, 0.0), 'out_of_bounds'),
    ],
)
def test_a_pose_that_sees_no_arm_is_refused(position, quaternion, reason):
    with refused(CameraError, reason):
        plane_from_pose(PosePlane(position=position, quaternion=quaternion))


def test_a_rounded_quaternion_gets_its_length_back():
    rounded = PosePlane(position=(0, 0, 1), quaternion=(0.707, 0.707, 0.0, 0.0))
    assert math.hypot(*rounded.quaternion) == pytest.approx(1.0, abs=1e-15)
    assert rounded.quaternion[0] == pytest.approx(math.sqrt(0.5), abs=1e-15)


@pytest.mark.parametrize('length', [0.0, 0.98, 1.02, 2.0])
def test_a_quaternion_of_another_length_is_refused(length):
    with refused(CameraError, 'no_direction'):
        PosePlane(position=(0, 0, 1), quaternion=(length, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ('first', 'last', 'arclengths', 'reason'),
    [
        ((0.1, 0.1), (0.1, 0.1), (0.0, 0.1), 'not_determined'),
        ((math.nan, 0.1), (0.1, 0.1), (0.0, 0.1), 'not_determined'),
        ((0.0, 0.1), (0.1, 0.1), (0.1, 0.1), 'wrong_order'),
        ((0.0, 0.1), (0.1, 0.1), (0.1, 0.0), 'wrong_order'),
    ],
)
def test_targets_that_give_no_scale_are_refused(first, last, arclengths, reason):
    with refused(CameraError, reason):
        plane_from_rest(first, last, *arclengths)


@pytest.mark.parametrize(
    'matrix', [np.zeros((3, 3)), np.ones((3, 3)), np.eye(2), np.full((3, 3), math.nan)]
)
def test_a_plane_has_an_inverse(matrix):
    with pytest.raises(CameraError):
        Plane(base_from_normalized=matrix)
