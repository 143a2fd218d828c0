"""Images of the virtual lab hold what their truth says, by plain sums over pixels."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from pneunet_ros.core.errors import MessageError, RequestError
from pneunet_ros.core.image import ENCODINGS
from pneunet_ros.lab.pictures.lens import overhead_camera
from pneunet_ros.lab.pictures.renderer import draw_dots, Renderer, Truth
from pneunet_ros.lab.pictures.scene import (
    Body,
    Dots,
    FrameState,
    Glint,
    Label,
    Light,
    Occluder,
    Scene,
    Spot,
)
import pytest
from support.camera_images import as_image, bar, hand
from support.refusals import refused

SCALE = 0.00027
BARREL = (-0.3, 0.1, 0.002, -0.001, 0.0)
RADIUS = 4.0 * SCALE


def camera(distortion=BARREL, tilt=(0.0, 0.0), roll=0.0):
    return overhead_camera(
        width=640,
        height=480,
        focal_px=620.0,
        scale=SCALE,
        middle=(0.05, 0.03),
        distortion=distortion,
        tilt=tilt,
        roll=roll,
    )


STRAIGHT = camera(distortion=())
MIDDLE = STRAIGHT.matrix[:2, 2]


def dark(lens=STRAIGHT, **changes):
    """Return a scene without anything in it."""
    return Scene(**({'camera': lens, 'background': 0.0, 'texture': 0.0, 'noise': 0.0} | changes))


def at_pixel(u, v, **others):
    """Return dots whose centers appear at these pixels of the camera STRAIGHT."""
    x = 0.05 + SCALE * (np.atleast_1d(u) - MIDDLE[0])
    y = 0.03 - SCALE * (np.atleast_1d(v) - MIDDLE[1])
    return Dots(**({'x': x, 'y': y, 'radius': RADIUS} | others))


def scattered(count=40, radius=RADIUS, seed=0):
    """Return dots that are well apart, all over the image."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-0.02, 0.12, 8), np.linspace(-0.02, 0.08, 5))
    places = np.stack([x.ravel(), y.ravel()]) + rng.uniform(-0.002, 0.002, (2, count))
    return Dots(x=places[0], y=places[1], radius=radius, grey=250.0)


def moments(picture, u, v, reach):
    """Sum, mean column and mean row of the pixels around (u, v)."""
    left, top = int(u) - reach, int(v) - reach
    window = np.asarray(picture[top : top + 2 * reach + 1, left : left + 2 * reach + 1], float)
    rows, columns = np.mgrid[: window.shape[0], : window.shape[1]]
    total = window.sum()
    return total, left + (window * columns).sum() / total, top + (window * rows).sum() / total


def whole(truth, margin=14):
    """Return which dots lie in the image with some room around."""
    inside = (truth.u > margin) & (truth.u < 640 - margin)
    return np.flatnonzero(inside & (truth.v > margin) & (truth.v < 480 - margin))


# Pixels are squares of some width, so that sums over those of a sharp small dot miss its centroid
# by some thousandths of a pixel, however exact they are. Optics take this away.
@pytest.mark.parametrize(
    ('radius_px', 'blur', 'error'), [(4.0, 0.0, 0.007), (8.0, 0.0, 0.003), (4.0, 0.5, 0.0015)]
)
@pytest.mark.parametrize(
    'lens', [STRAIGHT, camera(), camera(roll=0.4)], ids=['pinhole', 'barrel', 'rolled']
)
def test_centroid_and_area_of_a_dot_are_the_truth(lens, radius_px, blur, error):
    picture = np.zeros((480, 640), np.float32)
    truth = draw_dots(picture, lens, scattered(radius=radius_px * SCALE), blur)
    chosen = whole(truth)
    assert chosen.size > 25
    errors = []
    for index in chosen:
        total, u, v = moments(picture, truth.u[index], truth.v[index], 13)
        errors.append([u - truth.centroid_u[index], v - truth.centroid_v[index]])
        assert total / 250.0 == pytest.approx(truth.area[index], rel=0.003)
        assert truth.visible[index] == pytest.approx(1.0, abs=1e-9)
    assert np.abs(errors).max() < error
    assert np.sqrt(np.mean(np.square(errors))) < 0.003


def disc_points(x, y, radius, count):
    """Return points (2, n) spread evenly over a disc."""
    rings = np.sqrt((np.arange(count) + 0.5) / count)
    spokes = np.exp(2j * np.pi * (np.arange(2 * count) + 0.3) / (2 * count))
    spread = (radius * rings[:, None] * spokes).ravel()
    return np.stack([x + spread.real, y + spread.imag])


def image_of(lens, points, step=1e-7):
    """Return pixels (2, n) of points of the plane, and how large the lens makes it there."""
    x, y = points
    here = np.stack(lens.project(x, y))
    right = (np.stack(lens.project(x + step, y)) - here) / step
    up = (np.stack(lens.project(x, y + step)) - here) / step
    return here, np.abs(right[0] * up[1] - right[1] * up[0])


@pytest.mark.parametrize('lens', [camera(), camera(tilt=(0.5, -0.3))], ids=['barrel', 'tilted'])
def test_every_pixel_gets_the_share_that_many_points_of_the_disc_put_into_it(lens):
    x, y, radius = 0.011, -0.0032, 6.0 * SCALE
    picture = np.zeros((480, 640), np.float32)
    draw_dots(picture, lens, Dots(x=np.array([x]), y=np.array([y]), radius=radius, grey=1.0))
    points = disc_points(x, y, radius, 500)
    (u, v), scale = image_of(lens, points)
    weight = scale * np.pi * radius**2 / scale.size
    place = np.rint(v).astype(int) * 640 + np.rint(u).astype(int)
    counted = np.bincount(place, weight, minlength=picture.size).reshape(picture.shape)
    assert 60 < counted.sum() < 130
    np.testing.assert_allclose(picture, counted, atol=0.012)


@pytest.mark.parametrize('radius_px', [2.5, 8.0, 15.0])
def test_large_and_small_dots_are_true_under_tilt(radius_px):
    picture = np.zeros((480, 640), np.float32)
    lens = camera(tilt=(0.3, -0.2))
    truth = draw_dots(picture, lens, scattered(radius=radius_px * SCALE), 0.5)
    chosen = whole(truth, 30)
    assert chosen.size > 10
    for index in chosen:
        _, u, v = moments(picture, truth.u[index], truth.v[index], int(1.5 * radius_px) + 3)
        assert u == pytest.approx(truth.centroid_u[index], abs=0.005)
        assert v == pytest.approx(truth.centroid_v[index], abs=0.005)


def test_the_centroid_is_not_the_image_of_the_center_where_the_lens_bends():
    lens = camera(tilt=(0.3, 0.0))
    dots = scattered(radius=12.0 * SCALE)
    truth = draw_dots(np.zeros((480, 640), np.float32), lens, dots)
    u, v = lens.project(dots.x, dots.y)
    np.testing.assert_allclose(np.stack([truth.u, truth.v]), np.stack([u, v]), atol=1e-12)
    assert np.hypot(truth.centroid_u - u, truth.centroid_v - v).max() > 0.05
    # The mean over the disc, each point of it weighed by how large the lens makes it there.
    for index in (0, 20, 39):
        pixels, scale = image_of(
            lens, disc_points(dots.x[index], dots.y[index], dots.radius[index], 60)
        )
        expected = [truth.centroid_u[index], truth.centroid_v[index]]
        np.testing.assert_allclose(pixels @ scale / scale.sum(), expected, atol=0.001)


def test_the_image_of_a_dot_is_as_opencv_sees_its_outline():
    lens = camera(tilt=(0.3, -0.2), roll=0.3)
    truth = draw_dots(np.zeros((480, 640), np.float32), lens, scattered(radius=10.0 * SCALE))
    angles = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    dots = scattered(radius=10.0 * SCALE)
    for index in (0, 17, 39):
        outline = np.stack(
            lens.project(
                dots.x[index] + dots.radius[index] * np.cos(angles),
                dots.y[index] + dots.radius[index] * np.sin(angles),
            ),
            axis=1,
        )
        found = cv2.moments(outline.astype(np.float32))
        assert truth.area[index] == pytest.approx(found['m00'], rel=1e-3)
        assert truth.centroid_u[index] == pytest.approx(found['m10'] / found['m00'], abs=0.01)
        assert truth.centroid_v[index] == pytest.approx(found['m01'] / found['m00'], abs=0.01)


def test_a_moving_dot_is_smeared_around_where_it_is_amid_the_exposure():
    motion = np.array([[9.0 * SCALE, -4.0 * SCALE]])
    still, moved = (
        Renderer(dark(blur=0.5)).render(moment, np.random.default_rng(0))
        for moment in (
            FrameState(dots=at_pixel(300.3, 200.6)),
            FrameState(dots=at_pixel(300.3, 200.6, motion=motion)),
        )
    )
    for name in Truth.__slots__:
        np.testing.assert_array_equal(getattr(still[1], name), getattr(moved[1], name))
    total_still, _, _ = moments(still[0], 300, 200, 20)
    total, u, v = moments(moved[0], 300, 200, 20)
    assert (u, v) == pytest.approx((300.3, 200.6), abs=0.01)
    assert total == pytest.approx(total_still, rel=0.01)
    rows, columns = np.nonzero(moved[0] > 20)
    assert columns.max() - columns.min() > 12
    assert np.polyfit(columns, rows, 1)[0] > 0.2  # y up is v down


def test_what_an_occluder_hides_is_not_visible():
    edge = Occluder(corners=np.array([[300.5, 0.0], [640.0, 0.0], [640, 480], [300.5, 480]]))
    dots = at_pixel([280.0, 299.0, 300.5, 302.0, 330.0], 200.0 + 20.0 * np.arange(5))
    picture, truth = Renderer(dark()).render(
        FrameState(dots=dots, occluders=(edge,)), np.random.default_rng(0)
    )
    # The part of a disc left of a line at distance d from its center.
    d = np.clip((300.5 - np.array([280.0, 299.0, 300.5, 302.0, 330.0])) / 4.0, -1.0, 1.0)
    expected = 0.5 + (np.arcsin(d) + d * np.sqrt(1.0 - d**2)) / np.pi
    np.testing.assert_allclose(truth.visible, expected, atol=0.03)
    assert picture[280, 330] == 62
    assert picture[200, 280] == 225


def test_an_occluder_hides_a_dot_in_the_picture_as_much_as_in_the_truth():
    dots = at_pixel([200.4], [150.2], radius=8.0 * SCALE)
    black = bar(204.0, 155.0, 60.0, 9.0, 0.6, grey=0.0)
    render = Renderer(dark(blur=0.6)).render
    free, _ = render(FrameState(dots=dots), np.random.default_rng(0))
    covered, truth = render(FrameState(dots=dots, occluders=(black,)), np.random.default_rng(0))
    assert 0.3 < truth.visible[0] < 0.7
    assert covered.sum() / free.sum() == pytest.approx(truth.visible[0], abs=0.02)


def test_the_border_of_the_image_cuts_dots():
    picture, truth = Renderer(dark(blur=0.0)).render(
        FrameState(
            dots=at_pixel([-0.5, 639.5, 300.0, -30.0, 5000.0], [200.0, 479.5, -3.5, 9.0, 9.0])
        ),
        np.random.default_rng(0),
    )
    outside = 0.5 - (np.arcsin(0.75) + 0.75 * np.sqrt(1 - 0.75**2)) / np.pi
    np.testing.assert_allclose(truth.visible, [0.5, 0.25, outside, 0.0, 0.0], atol=0.01)
    assert truth.u == pytest.approx([-0.5, 639.5, 300.0, -30.0, 5000.0])
    assert picture[200, 0] == 225


def test_glare_hides_and_saturates():
    scene = dark(glints=(Glint(u=100.0, v=100.0, major=20.0, minor=20.0),))
    picture, truth = Renderer(scene).render(
        FrameState(dots=at_pixel([100.0, 300.0], [100.0, 100.0])), np.random.default_rng(0)
    )
    np.testing.assert_array_equal(truth.visible, [0.0, 1.0])
    assert picture[100, 100] == picture[100, 105] == 255
    assert picture[100, 150] == 0


def test_a_dot_without_radius_is_gone():
    picture, truth = Renderer(dark()).render(
        FrameState(dots=at_pixel([100.0, 200.0], [100.0, 100.0], radius=np.array([0.0, RADIUS]))),
        np.random.default_rng(0),
    )
    assert np.isnan(truth.x[0]) and np.isnan(truth.centroid_u[0]) and truth.visible[0] == 0.0
    assert truth.u[1] == pytest.approx(200.0) and truth.visible[1] == pytest.approx(1.0)
    assert not picture[80:120, 80:120].any()


def test_an_image_without_dots_is_no_failure():
    nothing = Dots(x=np.zeros(0), y=np.zeros(0))
    picture, truth = Renderer(dark()).render(FrameState(dots=nothing), np.random.default_rng(0))
    assert truth.u.size == 0
    assert not picture.any()


def test_noise_is_white_and_of_the_sigma_asked_for():
    render = Renderer(dark(background=120.0, noise=3.0)).render
    rng = np.random.default_rng(4)
    empty = FrameState(dots=at_pixel([], []))
    first, second = (render(empty, rng)[0].astype(float) - 120.0 for _ in range(2))
    rounded = np.sqrt(3.0**2 + 1.0 / 12.0)
    for noise in (first, second):
        assert noise.std() == pytest.approx(rounded, rel=0.01)
        assert noise.mean() == pytest.approx(0.0, abs=0.03)
        assert np.mean(noise[:, 1:] * noise[:, :-1]) == pytest.approx(0.0, abs=0.06)
    assert np.mean(first * second) == pytest.approx(0.0, abs=0.06)


def test_light_is_uneven_as_asked():
    scene = dark(background=100.0, light=Light(gradient_u=0.4, gradient_v=-0.2, vignette=0.5))
    picture, _ = Renderer(scene).render(
        FrameState(dots=at_pixel([], [])), np.random.default_rng(0)
    )
    assert picture[240, 320] == pytest.approx(100, abs=1)
    assert picture[240, 639] == pytest.approx(100 * 1.2 * 0.75, abs=1)
    assert picture[479, 320] == pytest.approx(100 * 0.9 * 0.75, abs=1)
    assert picture[0, 0] == pytest.approx(100 * 0.8 * 1.1 * 0.5, abs=2)


def crowded():
    """Return a scene with everything, and a moment in it."""
    s = np.linspace(0.0, 0.112, 57)
    arc = {'x': 0.08 * np.sin(s / 0.08), 'y': 0.08 * (1.0 - np.cos(s / 0.08))}
    scene = Scene(
        camera=camera(),
        light=Light(gradient_u=0.2, vignette=0.3),
        labels=(Label(u=500.0, v=420.0, angle=0.1),),
        spots=(Spot(u=50.0, v=50.0), Spot(u=600.0, v=90.0, major=8.0, minor=3.0, angle=0.5)),
        decoys=Dots(x=np.array([0.0, 0.005, 0.01]), y=np.full(3, 0.08)),
        glints=(Glint(u=300.0, v=400.0),),
    )
    moment = FrameState(
        dots=Dots(x=arc['x'][::4], y=arc['y'][::4]),
        body=Body(theta=s / 0.08, **arc),
        occluders=hand(450.0, 150.0, 120.0, 2.0),
    )
    return scene, moment


def test_the_seed_decides_everything():
    scene, moment = crowded()
    first, again, other = (
        Renderer(scene).render(moment, np.random.default_rng(seed)) for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first[0], again[0])
    assert np.any(first[0] != other[0])
    for name in Truth.__slots__:
        np.testing.assert_array_equal(getattr(first[1], name), getattr(other[1], name))
    textured = Renderer(dataclasses.replace(scene, seed=2, noise=0.0))
    assert np.any(textured.render(moment, np.random.default_rng(7))[0] != first[0])


def test_rendering_leaves_no_trace_in_the_next_image():
    scene, moment = crowded()
    renderer = Renderer(scene)
    before, truth = renderer.render(moment, np.random.default_rng(7))
    renderer.render(
        FrameState(dots=at_pixel([10.0], [10.0]), occluders=hand(300.0, 200.0, 300.0, 0.0)),
        np.random.default_rng(3),
    )
    after, _ = renderer.render(moment, np.random.default_rng(7))
    np.testing.assert_array_equal(before, after)
    assert 0 < np.count_nonzero(truth.visible < 0.6) < truth.visible.size


def test_all_that_distracts_is_in_the_picture():
    scene, moment = crowded()
    picture, truth = Renderer(scene).render(moment, np.random.default_rng(7))
    assert picture[420, 500 - 40] > 130  # label
    assert picture[50, 50] > 120  # spot
    u, v = scene.camera.project(scene.decoys.x, scene.decoys.y)
    for column, row in zip(np.rint(u).astype(int), np.rint(v).astype(int), strict=True):
        assert picture[row, column] > 130
    assert picture[400, 300] == pytest.approx(255, abs=10)  # glint
    chosen = truth.visible > 0.99
    around = picture[
        np.rint(truth.v[chosen]).astype(int) + 8, np.rint(truth.u[chosen]).astype(int)
    ]
    assert chosen.sum() > 5
    assert np.median(around) < 70  # the arm is dark


@pytest.mark.parametrize('encoding', ['mono8', 'rgb8', 'bgr8', 'rgba8', 'bgra8'])
@pytest.mark.parametrize('padding', [0, 13])
def test_images_of_every_encoding_are_as_grey_as_the_picture(encoding, padding):
    picture = np.random.default_rng(0).integers(0, 256, (20, 31)).astype(np.uint8)
    image = as_image(picture, stamp_ns=5, encoding=encoding, padding=padding)
    assert image.step == 31 * ENCODINGS[encoding].channels + padding
    assert image.data.size == 20 * image.step
    np.testing.assert_array_equal(image.grey(), picture)


def test_tinted_images_have_their_colors_in_their_channels():
    picture = np.full((4, 5), 200, np.uint8)
    tint = (0.5, 1.0, 1.2)
    for encoding, expected in (
        ('rgb8', [100, 200, 240]),
        ('bgr8', [240, 200, 100]),
        ('rgba8', [100, 200, 240, 255]),
        ('bgra8', [240, 200, 100, 255]),
    ):
        image = as_image(picture, stamp_ns=0, encoding=encoding, padding=3, tint=tint)
        size = len(expected)
        pixel = image.data.reshape(4, -1)[2, 3 * size : 4 * size]
        np.testing.assert_array_equal(pixel, expected)


def test_misuse_is_refused():
    with refused(MessageError, 'wrong_shape'):
        as_image(np.zeros((4, 4), np.uint8), stamp_ns=0, encoding='mono16')
    with refused(RequestError, 'wrong_shape'):
        Occluder(corners=np.zeros((2, 2)))
    with refused(RequestError, 'wrong_shape'):
        Dots(x=np.zeros(3), y=np.zeros(2))
