"""The page of a tracking: verdict, frames to scrub through, and a script that is the only one."""

from __future__ import annotations

from argparse import Namespace
import base64
import hashlib
import json
from pathlib import Path
import re

import cv2
import numpy as np
from pneunet_ros.cli.track_preview import given_options
from pneunet_ros.core.outcome import drop
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.shape_error import Centerlines
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.reports.tracking.page import SHOWN, TrackingPage
from pneunet_ros.reports.tracking.preview import Preview
from pneunet_ros.vision.tracker import Tracker
import pytest
from support.films import ARM, FRAMES, PERIOD_NS, place_of, stamp_of, tracked_steps
from support.html_pages import browser, opened, Page, widest

TRACKER = Tracker(ARM, load_camera(share_path('config/camera.yaml')))
RESTING, DARK = 4, 6  # frames that are averaged; the one that is dark


@pytest.fixture(scope='module')
def steps(tmp_path_factory):
    return tracked_steps(tmp_path_factory.mktemp('film') / 'in.mcap', TRACKER)


def collected(steps, estimated=None):
    targets = ARM.target_arclength.size
    page = TrackingPage(
        source='film <1>.mp4',
        model='an arm',
        target_arclength=ARM.target_arclength,
        preview=Preview(frames=len(steps), targets=targets),
        estimated=estimated,
    )
    for index, step in enumerate(steps):
        page.add(1 + index * PERIOD_NS, step.item.reading, step.outcome, step.state)
    return page


def truth(shift=0.0):
    """Return where the targets truly are in every frame, moved along y (m)."""
    away = np.array([[0.0], [shift]])
    places = [np.stack(place_of(index)) + away for index in range(FRAMES)]
    stamps = np.array([stamp_of(index) for index in range(FRAMES)])
    return Centerlines(
        topic='/shape', stamp_ns=stamps, arclength=ARM.target_arclength, points=np.array(places)
    )


def frames_of(html):
    return json.loads(re.search(r'id="frames">(.*?)</script>', html, re.DOTALL)[1])['frames']


def test_the_verdict_says_how_many_frames_and_what_next(steps):
    html = collected(steps).html('')
    assert f'{FRAMES - RESTING - 1} of {FRAMES - RESTING} ' in html
    assert '--camera' in html
    followed = collected([step for step in steps if not step.outcome.reason]).html('')
    assert '--output' in followed
    done = collected([step for step in steps if not step.outcome.reason]).html('o.mcap')
    assert 'o.mcap' in done


def test_the_command_that_is_next_names_the_arm_and_the_lens(steps):
    page = collected([step for step in steps if not step.outcome.reason])
    given = Namespace(model=Path('my arm.yaml'), camera_info='none', clamp_pixel=None)
    page.arm_options = given_options(given, 'model')
    page.image_options = given_options(given, 'camera_info', 'clamp_pixel')
    assert '--model &#39;my arm.yaml&#39;' in page.html('o.mcap')
    track = '--model &#39;my arm.yaml&#39; --camera-info none --output TRACKED.mcap'
    assert track in page.html('')


def test_every_frame_is_an_image_with_its_targets_where_they_were_found(steps):
    frames = frames_of(collected(steps).html(''))
    assert len(frames) == FRAMES
    assert 'measured' not in frames[DARK]
    for frame, step in zip(frames, steps, strict=True):
        jpeg = base64.b64decode(frame['image'].removeprefix('data:image/jpeg;base64,'))
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert image.shape == (frame['height'], frame['width'])
        if step.outcome.reason:
            continue
        scale = frame['width'] / step.item.reading.width
        found = np.array(frame['targets'], np.float64)
        assert found[:, 0] == pytest.approx(scale * step.outcome.sightings.u, abs=0.06)
        assert max(map(abs, frame['from_measured'])) < 60  # um, of a smooth curve


def test_estimates_are_drawn_with_the_distance_of_each_target(steps):
    right, beside = (frames_of(collected(steps, truth(s)).html(''))[-1] for s in (0, 1e-3))
    assert np.abs(right['from_predicted']).max() < 200  # um
    moved = np.subtract(beside['from_predicted'], right['from_predicted'])
    assert moved == pytest.approx(-1000.0, abs=80.0)  # the arm is nearly straight
    drawn = np.array([point for point in right['predicted'] if point])
    targets = np.array([point for point in right['targets'] if point])
    assert drawn == pytest.approx(targets, abs=1.0)  # px


def test_many_frames_are_thinned_evenly(steps):
    frames = frames_of(collected(10 * steps[-5:] + 10 * steps[-5:]).html(''))
    assert SHOWN // 2 <= len(frames) <= SHOWN
    times = [float(re.match(r't = ([\d.]+)', frame['text'])[1]) for frame in frames]
    assert np.ptp(np.diff(times)) == pytest.approx(0.0, abs=1e-6)


def test_only_the_script_of_the_package_may_run(steps):
    html = collected(steps).html('')
    scripts = re.findall(r'<script>(.*?)</script>', html, re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in html
    assert "default-src 'none'" in html
    assert 'film &lt;1&gt;.mp4' in html
    references = Page(html).references
    assert all(item.startswith(('data:', '#')) for item in references)


def test_the_delay_of_a_film_stands_on_the_first_screen(steps):
    followed = [step for step in steps if not step.outcome.reason]
    film = {'readings': 'a.csv', 'delay_sentence': '1.35 s ahead', 'frames_covered': 3}
    page = collected(followed)
    assert 'Delay' not in page.html('o.mcap')
    page.film = film
    html = page.html('o.mcap')
    assert f'1.35 s ahead; 3 of {len(followed)} ' in html
    page.film = film | {'frames_covered': 0}
    assert '--readings a.csv --delay S --output o.mcap' in page.html('o.mcap')


def test_without_a_script_a_frame_with_its_targets_is_there(steps):
    html = collected(steps).html('')
    (still,) = re.findall('<div id="still">(.*?)</div>', html, re.DOTALL)
    assert still.count('<circle') == ARM.target_arclength.size
    assert 'href="data:image/jpeg' in still
    assert '<div id="scrub" hidden>' in html


def test_frames_that_cannot_be_read_are_listed_with_what_is_wrong(steps):
    page = collected([step for step in steps if not step.outcome.reason])
    for index in range(3):
        refusal = drop(index, 'wrong_encoding', 'no <image>')
        page.add((100 + index) * PERIOD_NS, None, refusal, steps[-1].state)
    html = page.html('')
    lost = html[html.index('id="lost"') :]
    row = '<th scope="row">wrong_encoding</th><td class="number">3</td><td>no &lt;image&gt;</td>'
    assert row in lost
    tracked = sum(not step.outcome.reason for step in steps)
    assert f'{tracked} of {tracked + 3} frames tracked' in html


def test_nothing_tracked_and_nothing_seen_are_said(steps):
    pages = [collected(kept).html('') for kept in ([steps[DARK]], [], steps)]
    answers = {re.search(r'id="answer"[^>]*>(.*?)</', page, re.DOTALL)[1] for page in pages}
    assert len(answers) == 3


@pytest.mark.slow
@pytest.mark.skipif(browser() is None, reason='no Chromium here: apt-get install chromium')
def test_the_page_works_in_a_browser(steps, tmp_path):
    file = tmp_path / 'page.html'
    file.write_text(collected(steps, truth()).html(''), encoding='utf-8')
    assert opened(file, tmp_path) == ([], [])
    for width in (390, 1280):
        assert widest(file, tmp_path, width) == (width, [])
