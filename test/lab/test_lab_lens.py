"""The lens of the virtual lab against OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np
from pneunet_ros.core.errors import CameraError
from pneunet_ros.lab.pictures.lens import Camera, overhead_camera
import pytest
from support.refusals import refused

PLUMB_BOB = (-0.31, 0.12, 0.0015, -0.0008, -0.02)
RATIONAL = (0.6, -0.2, 0.001, -0.0007, 0.03, 0.9, -0.1, 0.02)


@pytest.mark.parametrize(
    ('model', 'distortion'),
    [
        ('plumb_bob', ()),
        ('plumb_bob', PLUMB_BOB[:4]),
        ('plumb_bob', PLUMB_BOB),
        ('rational_polynomial', RATIONAL),
    ],
)
def test_points_appear_where_opencv_projects_them(model, distortion):
    camera = overhead_camera(
        width=640,
        height=480,
        focal_px=600.0,
        scale=0.00027,
        middle=(0.05, 0.03),
        distortion=distortion,
        model=model,
        roll=0.5,
        tilt=(0.3, -0.2),
    )
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-0.02, 0.13, 6), [-0.02, 0.0, 0.09]))
    points = np.stack([x, y, np.zeros(x.size)], axis=1)
    rotation = camera.rotation.T
    expected, _ = cv2.projectPoints(
        points,
        cv2.Rodrigues(np.ascontiguousarray(rotation))[0],
        -rotation @ camera.position,
        np.array(camera.matrix),
        np.array(distortion) if distortion else None,
    )
    u, v = camera.project(x, y)
    assert np.ptp(u) > 300
    np.testing.assert_allclose(np.stack([u, v], axis=1), expected[:, 0], atol=1e-9)


def test_an_overhead_camera_has_x_to_the_right_and_y_up_at_the_scale():
    camera = overhead_camera(
        width=640, height=480, focal_px=600.0, scale=0.0003, middle=(0.05, 0.02)
    )
    u, v = camera.project(np.array([0.05, 0.08, 0.05]), np.array([0.02, 0.02, 0.05]))
    np.testing.assert_allclose(u - u[0], [0.0, 100.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(v - v[0], [0.0, 0.0, -100.0], atol=1e-9)


def test_a_turned_camera_still_looks_at_the_middle():
    camera = overhead_camera(
        width=640,
        height=480,
        focal_px=600.0,
        scale=0.0003,
        middle=(0.05, 0.02),
        roll=1.0,
        tilt=(0.4, 0.2),
    )
    u, v = camera.project(np.array([0.05]), np.array([0.02]))
    np.testing.assert_allclose([u[0], v[0]], camera.matrix[:2, 2], atol=1e-9)
    np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)


def test_what_is_behind_the_camera_is_not_seen():
    camera = overhead_camera(
        width=640, height=480, focal_px=600.0, scale=0.0003, middle=(0.0, 0.0), tilt=(1.2, 0.0)
    )
    _, v = camera.project(np.zeros(2), np.array([1.0, -1.0]))
    assert np.isnan(v).sum() == 1


@pytest.mark.parametrize(('model', 'count'), [('fisheye', 4), ('plumb_bob', 8)])
def test_unknown_lenses_are_refused(model, count):
    with refused(CameraError, 'unknown_kind'):
        Camera(
            width=640,
            height=480,
            matrix=np.eye(3),
            distortion=np.zeros(count),
            model=model,
            position=np.zeros(3),
            rotation=np.eye(3),
        )
