"""The tracker on rendered images: who is who, what is refused and why, and where targets are."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.image import pixel_image
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.settings import settings_changed, settings_used
from pneunet_ros.core.share import share_path
from pneunet_ros.core.stamps import StampGate
from pneunet_ros.lab.pictures.renderer import Renderer
from pneunet_ros.lab.pictures.scene import Dots, FrameState, Scene
from pneunet_ros.vision.beam_search import BeamSearchSettings
from pneunet_ros.vision.camera.camera_settings import (
    CameraSettings,
    CurvedRestPlane,
    FixedBand,
    HomographyPlane,
    PosePlane,
    RestPlane,
    Shutter,
)
from pneunet_ros.vision.curvature_prior import PriorSettings
from pneunet_ros.vision.dots.areas import BlobSettings
from pneunet_ros.vision.dots.ellipse_fit import EllipseSettings
from pneunet_ros.vision.gating import GatingSettings
from pneunet_ros.vision.rest_plane import TURN
from pneunet_ros.vision.rows.row import LONGEST_PREDICTION
from pneunet_ros.vision.settings import RowTrackerSettings, VisionSettings
from pneunet_ros.vision.smoother import SmootherSettings
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking
import pytest
from scipy.spatial.transform import Rotation
from support.camera_images import as_image, CHANNELS
from support.moving_arm import motion_of
from support.refusals import refused
from support.rendered_frames import FRAME_NS, lens_of, plain_camera, Score, View

ARM = load_model(share_path('config/paper_arm.yaml'))
TARGETS = ARM.target_arclength.size
REST = CameraSettings().rest_frames
SECOND = 1_000_000_000


class Film:
    """An arm before a plain camera at given pressures, and a tracker that watches."""

    def __init__(self, settings=None, camera=None, scene=None, noise=2.0, arm=ARM):
        self.camera = plain_camera() if camera is None else camera
        scene = Scene(camera=self.camera, noise=noise) if scene is None else scene
        self.renderer = Renderer(scene)
        self.motion = motion_of(arm, (0.0, 50e3))
        self.rng = np.random.default_rng(11)
        self.tracker = Tracker(arm, CameraSettings() if settings is None else settings)
        self.lens = lens_of(self.camera)
        self.state, _ = self.tracker.step(TrackerState(), self.lens)
        self.stamp_ns = SECOND

    def picture(self, pressure=0.0):
        """Return a picture and its truth."""
        return self.renderer.render(self.motion.frame_state(pressure), self.rng)

    def show(self, grey, **changes):
        """Show a picture to the tracker as the next frame."""
        return self.show_image(as_image(np.ascontiguousarray(grey), stamp_ns=0, **changes))

    def show_image(self, image):
        """Show an image to the tracker as the next frame."""
        self.stamp_ns += FRAME_NS
        image = replace(image, stamp_ns=self.stamp_ns)
        self.state, outcome = self.tracker.step(self.state, image)
        return outcome

    def rest(self):
        """Let the tracker learn scale and base frame; return the last outcome and its truth."""
        for _ in range(REST):
            grey, truth = self.picture()
            outcome = self.show(grey)
        return outcome, truth

    def inflate(self, pressure, steps=12):
        """Go to a pressure, step by step."""
        for share in np.linspace(0.0, 1.0, steps):
            grey, truth = self.picture(share * pressure)
            outcome = self.show(grey)
        return outcome, truth


@pytest.fixture(scope='module')
def watching():
    """Return a film of which the tracker has seen the rest, and what it looked like then."""
    film = Film()
    film.rest()
    film.inflate(25e3)
    return film


def nothing_seen(outcome):
    return isinstance(outcome, Tracking) and outcome.sightings.seen == 0 and outcome.curve is None


def test_scale_and_base_frame_come_from_the_arm_at_rest():
    film = Film()
    for frame in range(1, REST):
        outcome = film.show(film.picture()[0])
        assert outcome.reason == 'resting'
        assert f'{frame} of {REST}' in outcome.sentence
        assert nothing_seen(outcome)
    grey, truth = film.picture()
    outcome = film.show(grey)
    assert outcome.reason == ''
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 5e-5


@pytest.mark.parametrize('name', ['bright', 'dark'])
def test_what_shows_a_row_decides_whether_targets_are_bright_or_dark(name):
    film = Film()
    seen = [film.picture()[0] for _ in range(REST)]
    shown = seen if name == 'bright' else [255 - grey for grey in seen]
    for grey in shown[:-1]:
        assert film.show(grey).reason == 'resting'
        assert film.state.polarity is None
        assert film.state.leading == name
    assert film.show(shown[-1]).sightings.seen == TARGETS
    assert film.state.polarity.name == name
    other = 'dark' if name == 'bright' else 'bright'
    evidence = film.state.polarity.evidence
    assert (f'{name}: {TARGETS} ' in evidence, f'{other}: ' in evidence) == (True, True)
    assert 'so far' not in evidence  # it is told as long as the node runs
    assert film.tracker.reset(film.state).polarity is None


def test_a_bright_and_a_dark_row_in_one_picture_are_no_answer():
    film = Film()
    grey, truth = film.picture()
    middle = round(truth.v[0])
    band = grey[middle - 40 : middle + 40]
    both = grey.copy()
    both[5:85] = 255 - band
    outcome = film.show(both)
    assert outcome.reason == 'several_rows' and 'polarity' in outcome.sentence
    for polarity, there in (('bright', middle), ('dark', 45)):
        sure = Film(CameraSettings(polarity=polarity))
        for _ in range(REST):
            outcome = sure.show(both)
        assert outcome.sightings.v[0] == pytest.approx(there, abs=2.0)


@pytest.mark.parametrize('seed', [1, 2])
def test_who_is_who_among_things_that_are_no_targets(seed):
    view = View(ARM, seed, 70)
    clamp_pixel = view.clamp_pixel if seed % 2 else None
    tracker = Tracker(ARM, CameraSettings(clamp_pixel=clamp_pixel))
    state, _ = tracker.step(TrackerState(), view.lens)
    score = Score()
    for number, (image, truth) in enumerate(view):
        if number == 45:
            state = replace(state, row=None)  # found again from nothing in a single frame
        state, outcome = tracker.step(state, image)
        if number >= REST - 1:
            score.count(outcome.sightings, truth)
    assert score.swapped == 0
    assert score.false == 0
    assert score.found >= 0.97 * score.visible
    assert score.rms_px < 0.1


def test_the_curve_goes_through_the_targets(watching):
    outcome, truth = watching.inflate(25e3, steps=2)
    curve = outcome.curve
    assert curve.rms < 3e-5
    assert curve.arclength[0] == 0.0
    assert curve.arclength[-1] <= ARM.target_arclength[-1]
    assert curve.x[-1] == pytest.approx(
        np.interp(curve.arclength[-1], ARM.target_arclength, truth.x), abs=2e-4
    )
    assert np.all(curve.std_curvature > 0.0)


def oblique():
    return plain_camera(roll=0.1, tilt=(0.25, -0.2))


def posed(camera):
    """Return the plane of a camera whose pose is known."""
    quaternion = tuple(Rotation.from_matrix(camera.rotation).as_quat().tolist())
    return PosePlane(position=tuple(camera.position.tolist()), quaternion=quaternion)


def test_a_plane_known_by_points_needs_no_rest():
    camera = oblique()
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.06], [0.0, 0.06], [0.05, 0.03]])
    pixels = np.column_stack(camera.project(points[:, 0], points[:, 1]))
    film = Film(CameraSettings(plane=HomographyPlane(pixels=pixels, points=points)), camera)
    grey, truth = film.picture(20e3)
    outcome = film.show(grey)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 1e-4
    assert film.tracker.reset(film.state).plane is not None


def test_a_camera_with_a_known_pose_needs_no_rest():
    camera = oblique()
    film = Film(CameraSettings(plane=posed(camera)), camera)
    grey, truth = film.picture(20e3)
    outcome = film.show(grey)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 1e-4


@pytest.mark.parametrize('tilt', [(0.78, 0.0), (0.0, 0.78)])
def test_a_dot_seen_obliquely_is_where_its_center_is_not_where_that_of_its_outline_is(tilt):
    camera = plain_camera(1280, 960, tilt=tilt)
    film = Film(CameraSettings(plane=posed(camera)), camera, noise=0.0)
    moment = film.motion.frame_state(20e3, radius=0.0015)
    grey, truth = film.renderer.render(moment, film.rng)
    found = film.show(grey).sightings
    off = np.column_stack([found.x - truth.x, found.y - truth.y])
    assert np.abs(off.mean(axis=0)).max() < 1e-6  # 8e-6 of outlines
    assert np.abs(off[:-1]).max() < 2e-6
    pixels = np.column_stack([found.u - truth.u, found.v - truth.v])
    assert np.abs(pixels.mean(axis=0)).max() > 0.03


def test_a_lens_that_bends_the_outline_of_a_dot_does_not_move_its_center():
    """Those of large dots, 13 px in radius here, went to the middle of the image by up to 3 um."""
    camera = plain_camera(1280, 960)
    film = Film(CameraSettings(plane=posed(camera)), camera, noise=0.0)
    grey, truth = film.renderer.render(film.motion.frame_state(20e3, radius=0.0018), film.rng)
    found = film.show(grey).sightings
    off = np.column_stack([found.x - truth.x, found.y - truth.y])
    assert np.abs(off[:-1]).max() < 5e-7  # the last one is cut off


def test_points_that_do_not_fit_the_lens_are_an_error_of_every_image():
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.06], [0.0, 0.06]])
    pixels = np.array([[1.0, 1.0], [5e4, 1.0], [5e4, 400.0], [1.0, 400.0]])
    film = Film(CameraSettings(plane=HomographyPlane(pixels=pixels, points=points)))
    outcome = film.show(film.picture()[0])
    assert isinstance(outcome, Refusal)
    assert outcome.reason == 'no_plane'
    assert outcome.error
    assert 'plane.pixels' in outcome.sentence


@pytest.mark.parametrize('encoding', CHANNELS)
def test_every_encoding_gives_the_same_targets(encoding):
    """Rows have padding; the channels of a color image differ."""
    film = Film()
    pictures = [film.picture() for _ in range(REST)]
    for grey, _ in pictures:
        outcome = film.show(grey, encoding=encoding, padding=13, tint=(1.0, 0.97, 0.94))
    truth = pictures[-1][1]
    off = np.hypot(outcome.sightings.u - truth.centroid_u, outcome.sightings.v - truth.centroid_v)
    assert off.max() < 0.3


def test_deep_images_keep_their_depth_whatever_single_pixels_or_glints_say():
    """Of 12 bits, 10 are in use: whatever takes more for a moment changes nothing."""
    film = Film()

    def show(frame):
        deep = 5 * film.picture()[0].astype(np.uint16) // 2
        deep[5, 5] = 4095 if frame % 2 else 0
        deep[:9, 9:18] = 1030 if frame > REST and frame % 2 else 0
        return film.show_image(pixel_image(deep, 0, 'camera'))

    for frame in range(1, 2 * REST):
        outcome = show(frame)
        assert outcome.reason == ('resting' if frame < REST else '')


def test_a_fixed_band_finds_the_same_targets():
    film = Film(CameraSettings(grey_band=FixedBand(low=140.0)))
    outcome, truth = film.rest()
    assert outcome.sightings.seen == TARGETS
    off = np.hypot(outcome.sightings.u - truth.centroid_u, outcome.sightings.v - truth.centroid_v)
    assert off.max() < 0.3


def spots(grey):
    """Return 200 bright spots where the arm has been."""
    rng = np.random.default_rng(5)
    picture = np.full_like(grey, 60)
    for u, v in rng.uniform([5, 5], [635, 475], (200, 2)):
        center = (round(16 * u), round(16 * v))
        cv2.circle(picture, center, round(16 * rng.uniform(2.5, 4.5)), 220, -1, cv2.LINE_AA, 4)
    return picture


SPOILED = {
    'black': np.zeros_like,
    'white': lambda grey: np.full_like(grey, 255),
    'grey': lambda grey: np.full_like(grey, 128),
    'noise': lambda grey: np.random.default_rng(1).integers(0, 256, grey.shape, np.uint8),
    'saturated': lambda grey: np.clip(8.0 * grey, 0, 255).astype(np.uint8),
    'blurred': lambda grey: cv2.GaussianBlur(grey, (0, 0), 12.0),
    'turned by 180 degrees': lambda grey: grey[::-1, ::-1],
    'turned by 17 degrees': lambda grey: cv2.warpAffine(
        grey, cv2.getRotationMatrix2D((320, 240), 17.0, 1.0), (640, 480)
    ),
    'mirrored': lambda grey: grey[:, ::-1],
    'upside down': lambda grey: grey[::-1],
    'shifted': lambda grey: np.roll(grey, 40, axis=1),
    'smaller': lambda grey: cv2.copyMakeBorder(
        cv2.resize(grey, (320, 240)), 120, 120, 160, 160, cv2.BORDER_REPLICATE
    ),
    '200 spots': spots,
    'stripes': lambda grey: np.where(np.arange(640) // 8 % 2, 255, 0) * np.ones_like(grey),
}


@pytest.mark.parametrize('name', SPOILED)
def test_a_spoiled_frame_shows_nothing_and_says_why(watching, name):
    spoiled = SPOILED[name]
    before = watching.state
    grey, _ = watching.picture(25e3)
    outcome = watching.show(spoiled(grey).astype(np.uint8))
    assert nothing_seen(outcome), (name, outcome.sightings.seen)
    assert outcome.reason
    assert outcome.sentence
    assert (
        watching.state.unexplained[outcome.reason] == before.unexplained.get(outcome.reason, 0) + 1
    )
    # The next good one is explained again.
    grey, truth = watching.picture(25e3)
    outcome = watching.show(grey)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 2e-4


@pytest.mark.parametrize('name', ['black', 'white', 'saturated', 'blurred', 'noise'])
def test_a_spoiled_frame_is_no_arm_at_rest(name):
    film = Film()
    outcome = film.show(SPOILED[name](film.picture()[0]))
    assert nothing_seen(outcome)
    assert outcome.reason not in ('', 'resting')


def test_the_same_picture_gives_the_same_answer():
    film = Film()
    grey, _ = film.picture()
    outcomes = [film.show(grey) for _ in range(REST + 3)]
    assert [outcome.reason for outcome in outcomes] == (REST - 1) * ['resting'] + 4 * ['']
    seen = outcomes[REST - 1].sightings
    for outcome in outcomes[REST:]:
        assert outcome.sightings.u == pytest.approx(seen.u, abs=5e-3)
        assert outcome.sightings.v == pytest.approx(seen.v, abs=5e-3)


def test_a_row_at_rest_is_followed_even_if_every_other_dot_is_twice_as_wide():
    film = Film()
    x = ARM.target_arclength
    radius = np.where(np.arange(TARGETS) % 2, 0.0018, 0.0008)
    dots = Dots(x=x, y=np.zeros(TARGETS), radius=radius)
    grey, _ = film.renderer.render(FrameState(dots=dots), film.rng)
    outcomes = [film.show(grey) for _ in range(REST + 1)]
    assert [it.reason for it in outcomes] == (REST - 1) * ['resting'] + ['', '']
    assert outcomes[-1].sightings.seen == TARGETS


def test_a_hidden_target_or_a_bad_frame_does_not_begin_the_rest_anew():
    film = Film()
    for frame in range(REST):
        grey, truth = film.picture()
        covered = grey.copy()
        for target in (9, TARGETS - 1) if frame in (1, 3) else ():
            u, v = round(float(truth.u[target])), round(float(truth.v[target]))
            covered[v - 8 : v + 9, u - 8 : u + 9] = 45
        assert film.show(np.zeros_like(grey)).reason == 'no_areas'
        outcome = film.show(covered)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 5e-5


def test_a_rest_without_the_last_target_says_so():
    film = Film()
    for _ in range(2):
        grey, truth = film.picture()
        u, v = round(float(truth.u[-1])), round(float(truth.v[-1]))
        grey[v - 8 : v + 9, u - 8 : u + 9] = 45
        outcome = film.show(grey)
    assert outcome.reason == 'no_row'
    assert outcome.row == TARGETS - 1


def test_a_last_target_that_is_never_seen_whole_is_looked_for_in_each_frame_of_the_rest():
    """Before something as bright as itself it is no area of its own; its neighbors tell."""
    film = Film()
    for _ in range(REST):
        grey, truth = film.picture()
        u, v = round(float(truth.u[-1])), round(float(truth.v[-1]))
        grey[v - 20 : v + 21, u + 3 : u + 25] = 210
        outcome = film.show(grey)
    assert np.array_equal(film.state.rest.places[0].seen, np.full(TARGETS, REST))
    assert outcome.sightings.seen == TARGETS
    assert outcome.sightings.u[-1] == pytest.approx(truth.u[-1], abs=0.15)
    assert outcome.sightings.v[-1] == pytest.approx(truth.v[-1], abs=0.15)


def test_an_arm_that_is_bent_at_rest_is_tracked_where_the_camera_file_says_so():
    film = Film(CameraSettings(plane=CurvedRestPlane()))
    for _ in range(REST):
        grey, truth = film.picture(15e3)
        outcome = film.show(grey)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 1e-3
    outcome, truth = film.inflate(25e3)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 1e-3


@pytest.mark.parametrize(('method', 'pressure'), [(RestPlane(), 0.0), (CurvedRestPlane(), 15e3)])
def test_an_arm_turned_in_its_clamp_rests_at_that_angle_to_the_base_frame(method, pressure):
    arm = replace(ARM, clamp_angle=0.3)
    film = Film(CameraSettings(plane=method), arm=arm)
    for _ in range(REST):
        grey, truth = film.picture(pressure)
        outcome = film.show(grey)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 1e-3
    outcome, truth = film.inflate(25e3)
    assert outcome.sightings.seen == TARGETS
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 1e-3


def test_three_targets_are_tracked_without_a_curve():
    arm = replace(ARM, target_arclength=np.array([0.0, 0.055, 0.11]))
    film = Film()
    film.tracker = Tracker(arm, CameraSettings())
    motion = motion_of(arm, (0.0, 50e3))
    for pressure in [0.0] * REST + np.linspace(0.0, 20e3, 12).tolist():
        grey, truth = film.renderer.render(motion.frame_state(pressure), film.rng)
        outcome = film.show(grey)
    assert outcome.sightings.seen == 3
    assert outcome.curve is None
    assert np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y).max() < 2e-4


def test_a_mirrored_arm_does_not_begin_at_clamp_pixel():
    film = Film()
    u, v = film.camera.project(*film.motion.targets(0.0))
    film.tracker = Tracker(ARM, CameraSettings(clamp_pixel=(float(u[0]), float(v[0]))))
    outcome = film.show(film.picture()[0][:, ::-1])
    assert nothing_seen(outcome)
    assert outcome.reason == 'wrong_clamp'


def test_a_bent_arm_is_not_at_rest():
    film = Film()
    outcome = film.show(film.picture(15e3)[0])
    assert outcome.reason == 'not_straight'
    assert nothing_seen(outcome)


def test_a_hidden_target_is_missing_and_comes_back(watching):
    grey, truth = watching.picture(25e3)
    u, v = round(float(truth.u[9])), round(float(truth.v[9]))
    covered = grey.copy()
    covered[v - 8 : v + 9, u - 8 : u + 9] = 45
    outcome = watching.show(covered)
    assert np.flatnonzero(np.isnan(outcome.sightings.x)).tolist() == [9]
    outcome = watching.show(grey)
    assert outcome.sightings.seen == TARGETS


@pytest.mark.parametrize('share', [0.35, 0.5, 0.8])
def test_a_target_covered_in_part_is_missing_or_where_its_center_is(watching, share):
    """Where little is covered, its neighbors tell where the center of the whole is."""
    grey, truth = watching.picture(25e3)
    u, v = float(truth.u[14]), round(float(truth.v[14]))
    edge = round(u - 4.0 + 8.0 * share)
    grey[v - 9 : v + 10, round(u) - 12 : edge] = 45
    outcome = watching.show(grey)
    off = np.hypot(
        outcome.sightings.u[14] - truth.centroid_u[14],
        outcome.sightings.v[14] - truth.centroid_v[14],
    )
    assert np.isnan(off) or (share < 0.5 and off < 0.3)
    assert outcome.sightings.seen >= TARGETS - 2


def test_a_lost_row_is_searched_everywhere_only_now_and_then(watching):
    grey, _ = watching.picture(25e3)
    blank = np.full_like(grey, 45)
    searched = []
    for _ in range(7):
        assert watching.show(blank).reason == 'no_areas'
        searched.append(watching.state.searched_ns == watching.stamp_ns)
    pause = LONGEST_PREDICTION
    assert 3 * FRAME_NS < 1e9 * pause < 4 * FRAME_NS
    assert searched == [True, False, False, False, True, False, False]
    watching.show(blank)
    assert watching.show(grey).sightings.seen == TARGETS  # where it was


@pytest.mark.parametrize('spacings', [1, -1])
def test_a_camera_that_was_knocked_by_a_spacing_shows_no_row(spacings):
    """Each target stands where its neighbor was, except at the ends."""
    film = Film()
    outcome, _ = film.rest()
    spacing = np.diff(outcome.sightings.u).mean()
    for pressure in np.linspace(0.0, 1e3, 4):
        grey, _ = film.picture(pressure)
        assert film.show(grey).sightings.seen == TARGETS
    for _ in range(6):
        knocked = np.roll(film.picture(1e3)[0], round(spacings * spacing), axis=1)
        assert film.show(knocked).reason == 'no_row'
    assert film.show(film.picture(1e3)[0]).sightings.seen == TARGETS


def test_a_camera_that_creeps_until_the_last_target_leaves_its_view_shows_no_row():
    """What is seen is the row of a spacing farther, without the target at the clamp."""
    film, width = Film(), 548
    film.state, _ = film.tracker.step(TrackerState(), replace(film.lens, width=width))

    def crept(pixels):
        return film.show(np.roll(film.picture(1e3)[0], pixels, axis=1)[:, :width])

    for _ in range(REST):
        outcome = crept(0)
    spacing = np.diff(outcome.sightings.u).mean()
    assert outcome.sightings.u[-1] + spacing > width
    for pixels in range(2, round(2.2 * spacing), 2):
        outcome = crept(pixels)
        assert outcome.reason == 'no_row' or pixels < 0.5 * spacing
    assert crept(0).sightings.seen == TARGETS


@pytest.mark.parametrize('pressure', [0.0, 1e3, 2e3, 3e3])
def test_the_bow_of_a_row_at_rest_tells_how_far_the_base_frame_is_turned(pressure):
    film = Film()
    assert np.isnan(film.state.rest.bow)
    for _ in range(REST):
        tracking = film.show(film.picture(pressure)[0])
    assert tracking.sightings.seen == TARGETS
    x, y = film.motion.targets(pressure)
    turned = np.arctan2(y[-1] - y[0], x[-1] - x[0])  # the chord is along x of the tracker
    assert abs(turned) == pytest.approx(TURN * film.state.rest.bow, rel=0.15, abs=1e-3)


@pytest.fixture(scope='module', params=[0.025, -0.025])
def seen_row_by_row(request):
    """Return a rolling shutter, pictures of a moving arm by it, and the pressure in time."""

    def pressure(seconds):
        return 25e3 * (1.0 - np.cos(3.0 * max(seconds, 0.0)))

    shutter = Shutter(readout=request.param)
    drawn, pictures = Film(), []
    height, width = drawn.lens.height, drawn.lens.width
    for frame in range(1, 16):
        picture = np.empty((height, width), np.uint8)
        for rows in np.array_split(np.arange(height), 60):
            read = rows.mean() if shutter.readout > 0.0 else height - 1 - rows.mean()
            seconds = frame * FRAME_NS / SECOND + 0.025 * read / (height - 1)
            picture[rows] = drawn.picture(pressure(float(seconds)))[0][rows]
        pictures.append(picture)
    return shutter, pictures, pressure


def test_targets_seen_row_by_row_are_where_they_were_at_the_stamp(seen_row_by_row):
    """A rolling shutter sees those of a moving arm at times of their own."""
    shutter, pictures, pressure = seen_row_by_row
    off, claimed = {}, []
    for name, settings in (('told', CameraSettings(shutter=shutter)), ('not', CameraSettings())):
        film = Film(settings)
        film.rest()
        errors = []
        for frame, picture in enumerate(pictures, 1):
            outcome = film.show(picture)
            assert outcome.sightings.seen >= TARGETS - 2
            x, y = film.motion.targets(pressure(frame * FRAME_NS / SECOND))
            error = np.hypot(outcome.sightings.x - x, outcome.sightings.y - y)
            errors.append(np.nanmax(error))
            if name == 'told' and frame > 2:
                claimed.append(np.nanmax(error / outcome.sightings.std))
        off[name] = max(errors[2:])
    assert off['told'] < 0.2 * off['not'] > 1e-4
    assert np.median(claimed) < 2.5


def test_a_row_found_again_does_not_claim_to_be_where_it_was_at_the_stamp(seen_row_by_row):
    """Its velocity is not known then, only that it can be followed."""
    shutter, pictures, pressure = seen_row_by_row
    film = Film(CameraSettings(shutter=shutter))
    film.rest()
    for picture in (*pictures[:11], np.zeros_like(pictures[11]), pictures[12]):
        outcome = film.show(picture)
    x, y = film.motion.targets(pressure(13 * FRAME_NS / SECOND))
    error = np.hypot(outcome.sightings.x - x, outcome.sightings.y - y)
    assert outcome.sightings.seen >= TARGETS - 2
    assert np.nanmax(error) > 5e-4
    assert np.nanmax(error / outcome.sightings.std) < 3.0


def test_targets_that_leave_the_image_are_missing():
    camera = plain_camera(middle=(0.02, 0.04), scale=0.10 / 640)
    film = Film(camera=camera)
    points = np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.05], [0.0, 0.05]])
    pixels = np.column_stack(camera.project(points[:, 0], points[:, 1]))
    plane = HomographyPlane(pixels=pixels, points=points)
    film.tracker = Tracker(ARM, CameraSettings(plane=plane))
    film.state, _ = film.tracker.step(TrackerState(), film.lens)
    for pressure in np.linspace(20e3, 50e3, 20):
        grey, truth = film.picture(pressure)
        outcome = film.show(grey)
        seen = np.isfinite(outcome.sightings.x)
        assert not outcome.reason
        assert not np.any(seen & (truth.visible < 0.5))
        off = np.hypot(outcome.sightings.x - truth.x, outcome.sightings.y - truth.y)
        assert np.nanmax(off) < 2e-4
    assert np.count_nonzero(truth.visible > 0.99) - 2 <= outcome.sightings.seen < TARGETS


def test_no_camera_info_is_an_error():
    film = Film()
    film.state = TrackerState()
    outcome = film.show(film.picture()[0])
    assert isinstance(outcome, Refusal)
    assert outcome.reason == 'no_camera_info'
    assert outcome.error and outcome.awaits_others
    assert film.state.rejected == {'no_camera_info': 1}


def test_an_image_of_another_size_is_an_error(watching):
    grey, _ = watching.picture(25e3)
    outcome = watching.show(grey[:-2])
    assert isinstance(outcome, Refusal)
    assert outcome.reason == 'wrong_size'
    assert outcome.error and not outcome.awaits_others
    assert '640 x 478' in outcome.sentence
    assert '640 x 480' in outcome.sentence


def test_stamps_that_cannot_follow_are_dropped(watching):
    grey, _ = watching.picture(25e3)
    watching.show(grey)
    last = watching.stamp_ns
    for back_ns, reason in ((0, 'duplicate'), (FRAME_NS // 2, 'older'), (last, 'no_stamp')):
        watching.stamp_ns = last - back_ns - FRAME_NS
        frames = watching.state.frames
        outcome = watching.show(grey)
        assert isinstance(outcome, Refusal)
        assert outcome.reason == reason
        assert not outcome.error
        assert watching.state.frames == frames
    watching.stamp_ns = last


def test_time_that_jumps_back_starts_anew():
    film = Film()
    film.rest()
    film.stamp_ns -= 5 * SECOND
    film.stamp_ns = max(film.stamp_ns, SECOND // 2 - FRAME_NS)
    film.state = replace(film.state, stamps=StampGate(last_ns=film.stamp_ns + 3 * SECOND))
    outcome = film.show(film.picture()[0])
    assert outcome.reason == 'resting'
    assert film.state.resets == 1
    assert film.state.lens is not None


def test_one_image_that_is_stamped_ahead_does_not_cost_the_plane():
    film = Film()
    film.rest()
    film.inflate(25e3)
    plane, in_time = film.state.plane, film.stamp_ns
    film.stamp_ns += 3 * SECOND
    film.show(film.picture(25e3)[0])
    film.stamp_ns = in_time + FRAME_NS
    outcome = film.show(film.picture(25e3)[0])
    assert outcome.sightings.seen == TARGETS
    assert 'in the future' in outcome.warning
    assert film.state.plane is plane
    assert (film.state.resets, dict(film.state.rejected)) == (0, {'ahead': 1})
    assert not film.show(film.picture(25e3)[0]).warning


def test_the_same_camera_info_again_changes_nothing_and_another_starts_anew():
    film = Film()
    film.rest()
    state, outcome = film.tracker.step(film.state, lens_of(film.camera))
    assert outcome is None
    assert state is film.state
    other = replace(lens_of(film.camera), distortion=np.array([-0.2, 0.05, 0.0, 0.0]))
    state, _ = film.tracker.step(film.state, other)
    assert state.plane is None
    assert state.lens is other
    assert state.frames == film.state.frames


def test_a_step_is_pure(watching):
    grey, _ = watching.picture(25e3)
    image = as_image(grey, stamp_ns=watching.stamp_ns + FRAME_NS)
    one = watching.tracker.step(watching.state, image)
    two = watching.tracker.step(watching.state, image)
    assert same_values(one[1], two[1])
    assert same_values(one[0], two[0])


@pytest.mark.parametrize('count', [0, 2])
def test_an_arm_with_fewer_targets_than_three_cannot_be_tracked(count):
    arm = replace(ARM, target_arclength=np.linspace(0.0, 0.11, count))
    with refused(ModelError, 'too_few_targets'):
        Tracker(arm, CameraSettings())


def test_a_row_of_other_dots_beside_the_arm_is_no_arm():
    camera = plain_camera()
    decoys = Dots(x=0.005 * np.arange(20), y=np.full(20, -0.03))
    film = Film(scene=Scene(camera=camera, decoys=decoys, noise=2.0), camera=camera)
    outcome, truth = film.rest()
    assert outcome.sightings.seen == TARGETS
    assert np.abs(outcome.sightings.u - truth.centroid_u).max() < 0.5


BLIND = {
    'blobs': BlobSettings(speck=60),
    'ellipse': EllipseSettings(knows=0.0),
    'beam_search': BeamSearchSettings(across_std=-1.0),
    'gating': GatingSettings(largest_loss=1.5),
    'row_tracker': RowTrackerSettings(off_along=-1.0),
}


@pytest.mark.parametrize(
    ('part', 'known'),
    [
        *((part, False) for part in BLIND),
        *((part, True) for part in ('ellipse', 'gating', 'row_tracker')),
    ],
)
def test_each_setting_reaches_the_step_it_belongs_to(watching, part, known):
    tracker = Tracker(ARM, CameraSettings(), VisionSettings(**{part: BLIND[part]}))
    image = as_image(watching.picture(25e3)[0], stamp_ns=watching.stamp_ns + FRAME_NS)
    state = watching.state if known else replace(watching.state, row=None)
    assert watching.tracker.step(state, image)[1].sightings.seen == TARGETS
    assert nothing_seen(tracker.step(state, image)[1])


def test_settings_of_following_and_curve_reach_them(watching):
    grey, _ = watching.picture(25e3)
    image = as_image(grey, stamp_ns=watching.stamp_ns + FRAME_NS)
    vision = VisionSettings(
        ellipse=EllipseSettings(tilt_std=0.1),
        smoother=SmootherSettings(least_std=1e-2),
        prior=PriorSettings(smoother=3.0),
    )
    tracker = Tracker(ARM, CameraSettings(), vision)
    usual = watching.tracker.step(watching.state, image)[1]
    other = tracker.step(watching.state, image)[1]
    assert other.sightings.seen == usual.sightings.seen
    assert not np.array_equal(other.sightings.u, usual.sightings.u)
    assert other.curve.std_curvature.max() > 1.5 * usual.curve.std_curvature.max()
    length = watching.tracker.smoother.priors[-1].length_scale
    longer = tracker.smoother.priors[-1].length_scale
    assert longer == pytest.approx(3.0 / PriorSettings().smoother * length)


def test_what_the_settings_were_can_be_said():
    assert settings_changed(*VisionSettings().parts) == {}
    vision = VisionSettings(gating=GatingSettings(largest_loss=0.6))
    assert settings_changed(*vision.parts) == {'GatingSettings.largest_loss': 0.6}
    assert settings_used(*vision.parts)['BeamSearchSettings.seen'] == BeamSearchSettings().seen


@pytest.mark.parametrize('apart_ns', [1, 100_000])
def test_images_stamped_at_almost_the_same_time_are_no_long_exposure(apart_ns):
    """A driver that stamps images when they arrive may get two of them at once."""
    film = Film()
    film.rest()
    film.inflate(25e3, steps=6)
    film.stamp_ns += apart_ns - FRAME_NS
    outcome = film.show(film.picture(30e3)[0])
    assert outcome.sightings.seen == TARGETS


@pytest.mark.parametrize(('high', 'seen'), [(255, TARGETS), (254, 0)])
def test_a_fixed_band_to_255_takes_saturated_dots(high, seen):
    film = Film(CameraSettings(grey_band=FixedBand(low=120, high=high)))
    grey, _ = film.picture()
    bright = np.where(grey > 120, 255, grey).astype(np.uint8)
    for _ in range(REST):
        outcome = film.show(bright)
    assert outcome.sightings.seen == seen
