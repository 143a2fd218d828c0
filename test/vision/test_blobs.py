"""Areas that stand out: where they are to a hundredth of a pixel, and what is no area at all."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from pneunet_ros.core.image import Image
from pneunet_ros.vision.camera.camera_settings import AdaptiveBand, AreaLimits, FixedBand
from pneunet_ros.vision.dots.areas import _round_ones
from pneunet_ros.vision.dots.blobs import Appearance, Blobs, blobs_at, find_blobs, nearest_blobs
from pneunet_ros.vision.dots.centroid import axes_of, BLUR, MAJOR, MINOR, outlines, SMEAR, STD
import pytest
from support.center_bound import center_bound, draw_dot

BAND, LIMITS = AdaptiveBand(), AreaLimits()


def image_of(grey, padding=0):
    grey = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    rows = np.pad(grey, ((0, 0), (0, padding)), constant_values=255)
    return Image(
        stamp_ns=0,
        frame_id='camera',
        width=grey.shape[1],
        height=grey.shape[0],
        step=rows.shape[1],
        encoding='mono8',
        data=rows.tobytes(),
    )


def nearest(image, around, reach=10.0, band=BAND, limits=LIMITS):
    around = np.atleast_2d(np.asarray(around, float))
    appearance = Appearance(band=band, limits=limits)
    return Blobs(nearest_blobs(image, around, reach, 20.0, appearance).T)


def found_in(image, band=BAND, limits=LIMITS):
    return find_blobs(image, Appearance(band=band, limits=limits))


def measured(picture, around, reach=10.0, band=BAND, limits=LIMITS, **layout):
    return nearest(image_of(picture, **layout), around, reach, band, limits)


def statistics(radius, noise, phases=10, repeats=24, **look):
    """Return errors of the center (n, 2) of many noisy dots, and their areas."""
    random = np.random.default_rng(7)
    side = int(2 * radius + 26)
    places = side // 2 + random.uniform(-0.5, 0.5, (phases, 2))
    dots = [np.tile(draw_dot((side, side), place, radius, **look), repeats) for place in places]
    picture = np.vstack(dots)
    picture += noise * random.standard_normal(picture.shape)
    centers = places[:, None] + side * np.array(
        [[[column, row] for column in range(repeats)] for row in range(phases)]
    )
    centers = centers.reshape(-1, 2)
    around = np.rint(centers) + random.integers(-3, 4, centers.shape)
    areas = measured(picture, around)
    return np.column_stack([areas.u, areas.v]) - centers, areas


@pytest.mark.parametrize('blur', [0.0, 0.7, 1.0])
@pytest.mark.parametrize('noise', [2.0, 4.0, 8.0])
@pytest.mark.parametrize('radius', [3.0, 4.0, 5.0, 8.0])
def test_a_center_is_nearly_as_good_as_it_can_be(radius, noise, blur):
    errors, areas = statistics(radius, noise, blur=blur)
    rms = np.sqrt(np.mean(errors**2))
    # No optics draw an edge without any blur: the model is of one that is a pixel wide.
    sharp = blur == 0.0
    assert rms < (2.3 if sharp else 1.5) * center_bound(radius, noise, blur=blur)
    assert 0.8 < np.sqrt(np.mean(areas.std**2)) / rms < (1.6 if sharp else 1.4)
    assert np.abs(errors.mean(0)).max() < 0.005 + 3 * rms / np.sqrt(len(errors))


@pytest.mark.parametrize(
    'look',
    [
        {'aspect': np.cos(np.radians(40)), 'angle': 0.6},
        {'streak': 2.0, 'blur': 0.5},
        {'slope': (0.8, -0.5)},
        {'amplitude': 260.0, 'blur': 0.7},
        {'amplitude': 60.0, 'background': 120.0},
    ],
    ids=['tilted', 'moving', 'uneven light', 'saturated', 'pale'],
)
def test_looks_do_not_matter_much(look):
    errors, areas = statistics(5.0, 4.0, **look)
    rms = np.sqrt(np.mean(errors**2))
    bound = center_bound(5.0, 4.0, amplitude=min(look.get('amplitude', 160.0), 215.0))
    assert rms < 3.0 * bound
    assert 0.75 < np.sqrt(np.mean(areas.std**2)) / rms < 1.45
    assert np.abs(errors.mean(0)).max() < 0.005


def test_the_place_within_a_pixel_does_not_matter():
    for u in np.linspace(-0.5, 0.5, 11):
        center = np.array([20 + u, 20 + 0.3 * u])
        for blur, most in ((0.0, 0.011), (0.7, 0.003)):
            areas = measured(draw_dot((41, 41), center, 4.0, blur=blur), [(20, 20)])
            assert areas.u[0] == pytest.approx(center[0], abs=most)
            assert areas.v[0] == pytest.approx(center[1], abs=most)


@pytest.mark.parametrize('angle', [0.0, 0.5, -1.2])
def test_area_and_axes_are_those_of_the_ellipse(angle):
    picture = draw_dot((41, 41), (20.2, 19.7), 6.0, aspect=0.7, angle=angle)
    areas = measured(picture, [(20, 20)])
    assert areas.area[0] == pytest.approx(np.pi * 36 * 0.7, rel=0.01)
    assert areas.major[0] == pytest.approx(12.0, abs=0.1)
    assert areas.minor[0] == pytest.approx(8.4, abs=0.1)
    assert areas.angle[0] == pytest.approx(angle, abs=0.02)
    assert areas.contrast[0] == pytest.approx(160.0, abs=3.0)


def test_bytes_behind_the_rows_do_not_matter():
    picture = draw_dot((41, 43), (20.2, 19.7), 4.0)
    plain = measured(picture, [(20, 20)])
    assert np.array_equal(measured(picture, [(20, 20)], padding=7).u, plain.u)
    found = found_in(image_of(picture, 7))
    assert np.allclose(found.table, plain.table, atol=1e-3)


def test_colors_are_weighed_as_opencv_does():
    picture = np.random.default_rng(3).integers(0, 60, (41, 41, 3), np.uint8)
    picture[15:25, 15:25] += np.array([30, 150, 90], np.uint8)
    color = Image(
        stamp_ns=0,
        frame_id='',
        width=41,
        height=41,
        step=123,
        encoding='rgb8',
        data=picture.tobytes(),
    )
    around = np.array([[20.0, 20.0]])
    from_color = nearest(color, around, 5.0)
    from_grey = measured(color.grey(), around, 5.0)
    assert np.array_equal(from_color.table, from_grey.table)
    assert np.isfinite(from_grey.u[0])


@cache
def small_dot(u, v, radius):
    return draw_dot((25, 25), (12 + u, 12 + v), radius, blur=0.6, background=0.0)


def dots(shape, centers, radius=5.0, noise=3.0, background=40.0):
    picture = np.full(shape, background)
    for u, v in centers:
        left, upper = round(u) - 12, round(v) - 12
        dot = small_dot(u - round(u), v - round(v), radius)
        picture[upper : upper + 25, left : left + 25] += dot
    return picture + noise * np.random.default_rng(5).standard_normal(shape)


CENTERS = np.array([(20.3, 30.1), (45.6, 31.4), (70.2, 34.9), (95.7, 40.2)])


def test_found_and_measured_are_the_same():
    picture = dots((70, 120), CENTERS)
    found = found_in(image_of(picture))
    near = measured(picture, CENTERS)
    assert len(found) == 4
    order = np.argsort(found.u)
    assert np.allclose(found.table[:3, order], near.table[:3], atol=0.003, rtol=0.005)
    assert np.allclose(near.u, CENTERS[:, 0], atol=0.05)


def test_the_nearest_area_is_taken():
    picture = dots((70, 120), CENTERS)
    areas = measured(picture, [(34.0, 31.0), (32.0, 31.0), (33.0, 31.0)], reach=15.0)
    assert np.allclose(areas.u, [45.6, 20.3, 45.6], atol=0.05)
    beyond = measured(picture, [(33.0, 31.0), (20.0, 40.6), (20.0, 39.6)], reach=10.0)
    assert np.array_equal(np.isfinite(beyond.u), [False, False, True])


def test_a_fixed_band_bounds_what_is_white():
    picture = draw_dot((41, 41), (20.2, 19.7), 4.0)
    expected = measured(picture, [(20, 20)])
    for low, high, white in (
        (100, 255, True),
        (195, 255, True),
        (205, 255, False),
        (50, 190, False),
    ):
        areas = measured(picture, [(20, 20)], band=FixedBand(low=low, high=high))
        assert np.isfinite(areas.u[0]) == white
        if white:
            assert areas.u[0] == pytest.approx(expected.u[0], abs=0.002)


def test_what_is_no_whole_area_within_the_limits_is_nan():
    empty = np.full((60, 60), 40.0)
    assert np.isnan(measured(empty, [(20, 20), (-50, 5), (np.nan, 3), (59, 59)]).table).all()
    at_border = draw_dot((41, 41), (3.0, 20.0), 5.0)
    assert np.isnan(measured(at_border, [(3, 20)]).u[0])
    with_glint = draw_dot((60, 60), (30.0, 30.0), 5.0)
    with_glint[:, 32:40] = 230.0
    assert np.isnan(measured(with_glint, [(30, 30)]).u[0])
    small = draw_dot((41, 41), (20.0, 20.0), 1.5)
    assert np.isnan(measured(small, [(20, 20)]).u[0])
    large = draw_dot((41, 41), (20.0, 20.0), 8.0)
    assert np.isnan(measured(large, [(20, 20)], limits=AreaLimits(largest=150.0)).u[0])
    long = draw_dot((41, 41), (20.0, 20.0), 8.0, aspect=0.45)
    assert np.isnan(measured(long, [(20, 20)], limits=AreaLimits(elongation=2.0)).u[0])


def test_other_white_nearby_does_not_matter():
    picture = draw_dot((60, 60), (30.3, 29.8), 5.0)
    expected = measured(picture, [(30, 30)])
    picture[:, 38:46] = 230.0
    picture[22:24, 26:28] = 255.0
    areas = measured(picture, [(30, 30)])
    assert areas.u[0] == pytest.approx(expected.u[0], abs=0.01)
    assert areas.area[0] == pytest.approx(expected.area[0], rel=0.01)


@pytest.mark.parametrize('behind', [80.0, 92.0])
def test_the_background_of_a_dot_is_the_dark_arm_it_is_on(behind):
    centers = CENTERS[:3] * [1.0, 0.0] + [0.0, 35.3]
    picture = dots((70, 95), centers, noise=0.0, background=behind)
    picture[25:46] -= behind - 45.0
    picture += 3.0 * np.random.default_rng(6).standard_normal(picture.shape)
    found = found_in(image_of(picture))
    near = measured(picture, centers)
    assert len(found) == 3
    for areas in (found, near):
        order = np.argsort(areas.u)
        assert np.allclose(areas.u[order], centers[:, 0], atol=0.06)
        assert np.allclose(areas.v[order], centers[:, 1], atol=0.06)
        assert np.allclose(areas.contrast, 160.0, atol=8.0)


def test_small_dark_holes_are_closed():
    picture = draw_dot((41, 41), (20.3, 19.8), 7.0)
    whole = measured(picture, [(20, 20)])
    picture[18:21, 18:22] = 40.0
    closed = measured(picture, [(20, 20)])
    assert closed.area[0] == pytest.approx(whole.area[0], rel=0.01)
    assert closed.u[0] == pytest.approx(whole.u[0], abs=0.01)
    assert np.isnan(measured(picture, [(20, 20)], limits=AreaLimits(hole=1.0)).u[0])


def test_a_half_covered_dot_shows_in_its_area():
    picture = draw_dot((41, 41), (20.0, 20.0), 6.0)
    picture[:, :20] = 40.0
    areas = measured(picture, [(22, 20)])
    assert areas.area[0] == pytest.approx(np.pi * 18 + 6, rel=0.15)
    assert areas.major[0] / areas.minor[0] > 1.5


@pytest.mark.parametrize('side', [(1, 1), (3, 200), (480, 640)])
@pytest.mark.parametrize('level', [0, 128, 255])
def test_plain_frames_hold_nothing(side, level):
    picture = np.full(side, level)
    for band in (BAND, FixedBand()):
        assert len(found_in(image_of(picture), band)) == 0
        assert np.isnan(measured(picture, [(0, 0), (300, 200)], band=band).u).all()


def test_strange_frames_do_no_harm():
    random = np.random.default_rng(2)
    for picture in (
        random.integers(0, 256, (480, 640)),
        255 * random.integers(0, 2, (480, 640)),
        255 * (np.indices((480, 640)).sum(0) % 2),
        255 * (np.arange(640) // 3 % 2) * np.ones((480, 1)),
        np.kron(random.integers(0, 2, (48, 64)) * 255, np.ones((10, 10))),
    ):
        for band in (BAND, FixedBand()):
            areas = found_in(image_of(picture), band)
            assert np.isfinite(areas.table).all()
            assert (areas.area <= LIMITS.largest).all()
            assert (areas.major <= LIMITS.elongation * areas.minor).all()
            around = random.uniform(-20, 700, (50, 2))
            near = measured(picture, around, reach=20.0, band=band)
            distance = np.hypot(near.u - around[:, 0], near.v - around[:, 1])
            assert not (distance > 20.0).any()


def test_of_too_many_spots_those_that_stand_out_most_are_measured(monkeypatch):
    column, row = np.meshgrid(np.arange(20), np.arange(10))
    centers = np.column_stack([20 + 30 * column.ravel(), 20 + 30 * row.ravel()])
    found = found_in(image_of(dots((320, 620), centers)))
    assert len(found) == 200
    dim = dots((320, 620), centers, noise=1.0) * np.where(np.arange(620) < 305, 1.0, 0.5)
    monkeypatch.setattr('pneunet_ros.vision.dots.blobs.MOST_AREAS', 100)
    most = find_blobs(image_of(dim), Appearance(band=BAND, limits=LIMITS))
    assert len(most) == 100 and most.u.max() < 305


def cut_dot(center, radius, cut, beyond, noise=2.0, seed=0):
    """Return a dot on a dark arm that ends `cut` radii right of its center, before `beyond`."""
    fine = 8
    u = (np.arange(41 * fine) + 0.5) / fine - 0.5 - center[0]
    v = ((np.arange(41 * fine) + 0.5) / fine - 0.5 - center[1])[:, None]
    picture = np.where((np.hypot(u, v) <= radius), 220.0, 45.0)
    picture = np.where(u + 0.0 * v > cut * radius, beyond, picture)
    picture = picture.reshape(41, fine, 41, fine).mean((1, 3))
    random = np.random.default_rng(seed)
    return cv2.GaussianBlur(picture, (0, 0), 0.7) + noise * random.standard_normal((41, 41))


@pytest.mark.parametrize('beyond', [20.0, 120.0, 190.0, 250.0])
def test_a_target_cut_off_by_the_end_of_the_arm_is_where_its_center_would_be(beyond):
    whole = measured(draw_dot((41, 41), (20.0, 20.0), 5.0, blur=0.7), [(20, 20)]).table.T
    errors, claims = [], []
    for seed in range(20):
        center = 20.0 + np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
        image = image_of(cut_dot(center, 5.0, 0.7, beyond, seed=seed))
        stds = (np.array([0.0015]), 0.1, np.array([0.15]))
        still = np.zeros((1, 2))
        tied = outlines(center[None] + 0.3, axes_of(whole), whole[:, BLUR], still, stds)
        (row,) = blobs_at(image, tied, Appearance(band=BAND, limits=LIMITS))
        errors.append(row[:2] - center)
        claims.append(row[STD])
    rms = np.sqrt(np.mean(np.square(errors)))
    assert rms < 0.06
    assert np.abs(np.mean(errors, axis=0)).max() < 0.05
    assert np.sqrt(np.mean(np.square(claims))) > 0.6 * rms


def test_a_background_that_differs_all_around_does_not_move_a_dot():
    random = np.random.default_rng(4)
    errors, claims = [], []
    pixel = np.arange(-20, 21)
    for angle in np.arange(0.0, 6.0, 0.5):
        center = 20.0 + random.uniform(-0.5, 0.5, 2)
        dot = draw_dot((41, 41), center, 5.0, amplitude=1.0, background=0.0, blur=0.7)
        side = np.cos(angle) * pixel + np.sin(angle) * pixel[:, None]
        behind = cv2.GaussianBlur(np.where(side > 0.0, 150.0, 40.0), (0, 0), 0.7)
        picture = behind + dot * (225.0 - behind) + 2.0 * random.standard_normal((41, 41))
        row = measured(picture, [(20, 20)])
        errors.append([row.u[0] - center[0], row.v[0] - center[1]])
        claims.append(row.std[0])
    assert np.abs(errors).max() < 0.1
    assert np.sqrt(np.mean(np.square(errors))) < np.sqrt(np.mean(np.square(claims)))


def test_a_hairline_is_no_hole_of_a_dot():
    radius, appearance = 5.0, Appearance(band=BAND, limits=LIMITS)
    spread = 0.25 * radius**2
    dot = [np.pi * radius**2, 40.0, 30.0, spread, 0.0, spread]
    hairline = [-40.0, *[np.nan] * 5]  # a contour there and back again
    found = _round_ones(np.array([dot, hairline]), appearance)
    assert found.tolist() == [dot]


def test_dark_dots_are_found_in_the_inverted_image():
    picture = dots((70, 120), CENTERS)
    dark = image_of(255.0 - np.clip(np.rint(picture), 0, 255), padding=5)
    assert np.array_equal(found_in(dark.inverted()).table, found_in(image_of(picture)).table)


def test_a_blurred_frame_gives_dim_dots_or_none():
    picture = dots((70, 120), CENTERS, noise=1.0)
    strong = draw_dot((70, 70), (35.2, 34.6), 5.0, blur=4.0)
    assert len(found_in(image_of(strong))) == 1
    for u in np.linspace(34.5, 35.5, 11):
        shifted = draw_dot((70, 70), (u, 34.6), 5.0, blur=4.0)
        assert measured(shifted, [(35, 35)]).u[0] == pytest.approx(u, abs=0.06)
    assert len(found_in(image_of(0.1 * picture))) == 0


@pytest.mark.parametrize('way', [(3.0, 0.0), (0.0, -8.0), (9.0, 7.0)])
def test_a_target_that_moves_is_where_it_is_in_the_middle_of_the_exposure(way):
    """Its size stays that of the target, and its way is measured, forward or backward."""
    times = (np.arange(16) + 0.5) / 16 - 0.5  # steps of less than the blur
    errors, claims = [], []
    for seed in range(8):
        random = np.random.default_rng(seed)
        center = 30.0 + random.uniform(-0.5, 0.5, 2)
        moments = center + times[:, None] * np.array(way)
        picture = draw_dot((61, 61), moments, 5.0, blur=0.7)
        image = image_of(picture + 2.0 * random.standard_normal((61, 61)))
        stds = (np.array([0.3]), 0.3, np.array([3.0]))
        guess = outlines(
            center[None] + 0.5,
            np.array([[5.5, 0.0, 5.5]]),
            np.array([0.9]),
            0.7 * np.array([way]),
            stds,
        )
        (row,) = blobs_at(image, guess, Appearance(band=BAND, limits=LIMITS))
        errors.append(row[:2] - center)
        claims.append(row[STD])
        assert row[SMEAR] == pytest.approx(way, abs=0.5)
        assert row[[MAJOR, MINOR]] == pytest.approx([10.0, 10.0], abs=1.0)
    rms = np.sqrt(np.mean(np.square(errors)))
    assert rms < 0.06
    assert rms < 1.3 * np.sqrt(np.mean(np.square(claims)))


def test_a_fit_does_not_depend_on_what_is_fitted_beside_it():
    random = np.random.default_rng(1)
    places = 20.0 + 40.0 * np.array([[column, row] for column in range(30) for row in range(20)])
    picture = np.tile(draw_dot((40, 40), (20.0, 20.0), 5.0, blur=0.7), (20, 30))
    image = image_of(picture + 3.0 * random.standard_normal(picture.shape))
    one = np.ones(len(places))
    smear = np.where(np.arange(len(places))[:, None] % 3 == 0, [2.0, 1.0], [0.0, 0.0])
    starts = outlines(
        places + 0.4, np.tile([5.2, 0.0, 5.2], (len(places), 1)), one, smear, (0.3 * one, 0.3, one)
    )
    appearance = Appearance(band=BAND, limits=LIMITS)
    together = blobs_at(image, starts, appearance)
    assert np.isfinite(together).all()
    for which in (0, 1, 299, 598, 599):
        alone = blobs_at(image, starts[[which]], appearance)
        assert alone[0] == pytest.approx(together[which], abs=1e-9, rel=1e-9)
