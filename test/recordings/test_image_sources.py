"""Recordings, videos and folders give the same images in one form; what is wrong is said."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from pneunet_ros.core.errors import CameraError, MessageError, RecordingError, RequestError
from pneunet_ros.core.image import Image
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.tracker import CAMERA_INFO_TYPE
from pneunet_ros.recordings.images.image_folder import picture_files
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.recordings.images.image_stream import stamp_at
from pneunet_ros.recordings.images.matroska import is_cut, is_matroska, MAGIC, SEGMENT
from pneunet_ros.vision.camera.camera_model import Lens
import pytest
from support.films import (
    COMPRESSED,
    compressed_message,
    encoded,
    film,
    IMAGE,
    image_message,
    INFO,
    info_message,
    PERIOD_NS,
    RATE,
    stamp_of,
    write_camera_info,
    write_folder,
    write_messages,
)
from support.refusals import refused
from support.variable_rate import stretch_frames

WIDTH, HEIGHT = 64, 48
NONE = SourceRequest(camera_info='none', rate=RATE)
DURATION = b'\x44\x89\x88'  # of a Matroska: its name, and that it has eight bytes


def noise(seed: int, width: int = WIDTH, height: int = HEIGHT):
    """Return a picture (height, width) unlike any other."""
    return np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)


PICTURES = [noise(seed) for seed in range(12)]


def read(path, request=NONE):
    return list(open_images(path, request).read(()))


def images(items) -> list[Image]:
    return [item.reading for item in items if isinstance(item.reading, Image)]


def video(path, pictures=PICTURES):
    """Write a video without loss, of the size of these pictures."""
    height, width = pictures[0].shape
    code = cv2.VideoWriter.fourcc(*'FFV1')
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, RATE, (width, height))
    for picture in pictures:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


# All of them


@pytest.fixture(scope='module')
def sources(tmp_path_factory):
    """Return the same pictures in every form that loses nothing."""
    folder = tmp_path_factory.mktemp('sources')
    return {
        'raw': write_messages(folder / 'raw.mcap', film(PICTURES, info=False)),
        'compressed': write_messages(
            folder / 'compressed.mcap', film([encoded(one) for one in PICTURES], info=False)
        ),
        'rosbag2': write_messages(folder / 'rosbag2', film(PICTURES, info=False)),
        'png': write_folder(folder / 'png', PICTURES),
        'bmp': write_folder(folder / 'bmp', PICTURES, '.bmp'),
        'tif': write_folder(folder / 'tif', PICTURES, '.tif'),
        'video': video(folder / 'film.avi'),
        'mkv': video(folder / 'film.MKV'),
    }


@pytest.mark.parametrize(
    'form', ['raw', 'compressed', 'rosbag2', 'png', 'bmp', 'tif', 'video', 'mkv']
)
def test_every_source_gives_the_same_images_after_a_lens(sources, form):
    request = NONE if form in ('png', 'bmp', 'tif') else SourceRequest(camera_info='none')
    stream = open_images(sources[form], request)
    items = list(stream.read(()))
    assert isinstance(items[0].reading, Lens)
    assert (items[0].reading.width, items[0].reading.height) == (WIDTH, HEIGHT)
    assert items[0].reading.distortion.size == 0
    assert [item.topic == stream.image_topic for item in items] == [False] + [True] * 12
    found = images(items)
    assert [image.stamp_ns for image in found] == [stamp_of(index) for index in range(12)]
    assert [item.log_time_ns for item in items[1:]] == [image.stamp_ns for image in found]
    for image, picture in zip(found, PICTURES, strict=True):
        np.testing.assert_array_equal(image.grey(), picture)
    assert (stream.frames, stream.namespace) == (12, '/pneunet')
    assert len(list(stream.read(()))) == len(items)  # it can be read again


# Folders


def test_a_folder_is_read_as_a_person_counts(tmp_path):
    names = ['b2.png', 'a10.png', 'a2.PNG', 'a2b.jpg', 'a1.png', '.hidden.png', 'note.txt']
    for name in names:
        (tmp_path / name).write_bytes(b'')
    found = [file.name for file in picture_files(tmp_path)]
    assert found == ['a1.png', 'a2.PNG', 'a2b.jpg', 'a10.png', 'b2.png']


def test_the_rate_of_a_folder_is_30_unless_given(tmp_path):
    folder = write_folder(tmp_path / 'f', PICTURES[:4])
    stamps = [image.stamp_ns for image in images(read(folder, SourceRequest(camera_info='none')))]
    assert stamps == [1, 33_333_334, 66_666_668, 100_000_001]
    stamps = [
        image.stamp_ns
        for image in images(read(folder, SourceRequest(camera_info='none', rate=1.0)))
    ]
    assert stamps == [1, 1_000_000_001, 2_000_000_001, 3_000_000_001]


@pytest.mark.parametrize(
    'spoiled', [b'', b'no image', encoded(PICTURES[3])[:900]], ids=['empty', 'text', 'cut-off']
)
@pytest.mark.parametrize('suffix', ['.png', '.jpg', '.bmp', '.tif'])
def test_an_image_that_cannot_be_read_is_one_refused_frame(tmp_path, spoiled, suffix, capfd):
    folder = write_folder(tmp_path / 'f', PICTURES)
    (folder / 'frame3.png').unlink()
    (folder / f'frame3{suffix}').write_bytes(spoiled)
    items = read(folder)
    assert len(images(items)) == 11
    bad = items[4]  # after the lens
    assert isinstance(bad.reading, MessageError)
    assert f'frame3{suffix}' in str(bad.reading)
    assert bad.log_time_ns == stamp_of(3)
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize('suffix', ['.jpg', '.bmp', '.tif'])
def test_an_image_cut_off_is_refused_in_silence(tmp_path, suffix, capfd):
    folder = write_folder(tmp_path / 'f', PICTURES[:2], suffix)
    file = folder / f'frame1{suffix}'
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    items = read(folder)
    assert len(images(items)) == 1
    assert isinstance(items[2].reading, MessageError)
    assert capfd.readouterr() == ('', '')


@pytest.mark.skipif(cv2.__version__ < '5', reason='OpenCV 4.6 decodes it without a word')
def test_a_damaged_tiff_is_not_taken_for_an_image(tmp_path, capfd):
    picture = noise(1, 320, 240)
    folder = write_folder(tmp_path / 'f', [picture], '.tif')
    whole = encoded(picture, '.tif')
    (folder / 'frame1.tif').write_bytes(whole[:300] + b'\xff\xff' + whole[302:])
    reading = read(folder)[2].reading
    assert isinstance(reading, MessageError)
    assert 'damaged' in str(reading)
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize('suffix', ['.tif', '.png'])
def test_an_image_may_have_16_bits_but_no_fractions(tmp_path, suffix):
    folder = write_folder(tmp_path / 'f', PICTURES[:1])
    (folder / f'frame1{suffix}').write_bytes(encoded(PICTURES[1].astype(np.uint16) * 257, suffix))
    (folder / 'frame2.tif').write_bytes(encoded(PICTURES[1].astype(np.float32), '.tif'))
    deep, fractions = (item.reading for item in read(folder)[2:4])
    assert np.array_equal(deep.grey(), PICTURES[1])
    assert isinstance(fractions, MessageError)
    assert 'float32' in str(fractions)


def test_films_and_pictures_of_a_turned_phone_are_upright(tmp_path):
    """A phone notes how it was held: in the EXIF of a jpeg, in the track header of an mp4."""
    stored = np.full((48, 96), 30, np.uint8)
    stored[:16, :16] = 220  # top left; held upright, top right
    jpeg = encoded(stored, '.jpg')
    tiff = b'II*\0\x08\0\0\0' + struct.pack('<HHHIII', 1, 0x112, 3, 1, 6, 0)
    exif = b'\xff\xe1' + struct.pack('>H', len(tiff) + 8) + b'Exif\0\0' + tiff
    folder = write_folder(tmp_path / 'f', [])
    (folder / 'frame0.jpg').write_bytes(jpeg[:2] + exif + jpeg[2:])
    path = tmp_path / 'film.mp4'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'mp4v'), RATE, (96, 48))
    writer.write(cv2.cvtColor(stored, cv2.COLOR_GRAY2BGR))
    writer.release()
    content = bytearray(path.read_bytes())
    struct.pack_into('>4i', content, content.index(b'tkhd') + 44, 0, 1 << 16, 0, -1 << 16)
    path.write_bytes(content)
    for source in (folder, path):
        (image,) = images(read(source))
        assert image.grey().shape == (96, 48)
        assert image.grey()[8, 40] > 180 > 60 > image.grey()[8, 8]


@pytest.mark.parametrize('name', ['camera_info.yaml', 'ost.yaml'])
def test_a_folder_may_hold_its_lens(tmp_path, name):
    folder = write_folder(tmp_path / 'f', PICTURES)
    write_camera_info(folder / name)
    stream = open_images(folder, SourceRequest())
    assert stream.lens_source == str(folder / name)
    lens = next(stream.read(())).reading
    assert lens.matrix[0, 0] == pytest.approx(600.0)
    other = write_camera_info(tmp_path / 'other.yaml', width=WIDTH)
    chosen = open_images(folder, SourceRequest(camera_info=str(other)))
    assert next(chosen.read(())).reading.width == WIDTH


@pytest.mark.parametrize('name', ['folder', 'film.avi'])
def test_without_a_lens_it_is_said_how_to_give_one(tmp_path, name):
    path = tmp_path / name
    if path.suffix:
        video(path)
    else:
        write_folder(path, PICTURES)
    with refused(RequestError, 'no_camera_info') as caught:
        open_images(path, SourceRequest())
    assert '--camera-info' in str(caught.value)
    assert str(path) in str(caught.value)


def test_an_empty_folder_holds_nothing(tmp_path):
    with refused(RecordingError, 'no_images'):
        open_images(tmp_path, NONE)


@pytest.mark.parametrize('rate', [0.0, -1.0, float('nan'), float('inf')])
def test_a_rate_must_be_one(tmp_path, rate):
    folder = write_folder(tmp_path / 'f', PICTURES[:1])
    for path in (folder, video(tmp_path / 'film.avi')):
        with refused(RequestError, 'out_of_bounds'):
            open_images(path, SourceRequest(camera_info='none', rate=rate))


def test_stamps_do_not_drift():
    assert stamp_at(0, 30.0) == 1
    assert stamp_at(3_000_000, 29.97) == 1 + round(3_000_000 / 29.97 * 1e9)


# Videos


def test_the_rate_of_a_video_can_be_another_than_it_says(tmp_path):
    path = video(tmp_path / 'slow.avi')
    stamps = [
        image.stamp_ns
        for image in images(read(path, SourceRequest(camera_info='none', rate=500.0)))
    ]
    assert stamps == [1 + 2_000_000 * index for index in range(12)]


@pytest.mark.parametrize('content', [b'', b'hello'])
def test_what_is_no_video_is_an_error_that_names_it(tmp_path, content, capfd):
    path = tmp_path / 'film.mp4'
    path.write_bytes(content)
    with refused(RecordingError, 'damaged'):
        open_images(path, NONE)
    with refused(RecordingError, 'not_found'):
        open_images(tmp_path / 'absent.mp4', NONE)
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize('name', ['film.avi', 'film.mkv'])
def test_a_video_that_breaks_off_gives_what_there_is_and_says_so(tmp_path, capfd, name):
    path = video(tmp_path / name, [noise(seed, 320, 240) for seed in range(40)])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    items = read(path)
    assert 5 < len(images(items)) < 35
    assert items[-1].reading.reason == 'cut_off'
    assert str(path) in str(items[-1].reading)
    assert items[-1].topic == '/pneunet/image_raw'
    assert capfd.readouterr() == ('', '')


def test_a_matroska_of_variable_rate_is_whole_though_its_duration_promises_more(tmp_path):
    path = video(tmp_path / 'film.mkv')
    before, mark, after = path.read_bytes().partition(DURATION)
    (seconds,) = struct.unpack('>d', after[:8])
    path.write_bytes(before + mark + struct.pack('>d', 2.0 * seconds) + after[8:])
    assert open_images(path, NONE).frames == 2 * len(PICTURES)
    assert [type(item.reading) for item in read(path)[1:]] == [Image] * len(PICTURES)


@pytest.mark.parametrize(
    ('content', 'cut'),
    [
        (MAGIC + b'\x80' + SEGMENT + b'\x82ab', False),
        (MAGIC + b'\x80' + SEGMENT + b'\x83ab', True),
        (MAGIC + b'\x81x' + SEGMENT + b'\x40\x03ab', True),
        (MAGIC + b'\x80' + SEGMENT + b'\xff', False),  # it says no size
        (MAGIC + b'\x80' + SEGMENT + b'\x40', False),
        (MAGIC + b'\x80other', False),
        (MAGIC + b'\x00', False),
        (MAGIC, False),
    ],
)
def test_a_matroska_is_cut_where_its_segment_is_longer_than_the_file(tmp_path, content, cut):
    path = tmp_path / 'film.mkv'
    path.write_bytes(content)
    assert is_matroska(path)
    assert is_cut(path) == cut


# Recordings


def test_camera_info_comes_before_the_image_of_its_log_time(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(PICTURES[:3]))
    stream = open_images(path, SourceRequest())
    assert stream.lens_source == INFO
    items = list(stream.read(()))
    assert [item.topic for item in items] == 3 * [INFO, IMAGE]
    assert all(isinstance(item.reading, Lens) for item in items[::2])


def test_a_changed_camera_info_is_another_lens(tmp_path):
    messages = film(PICTURES[:4])
    for place in (7, 10):
        topic, kind, log_time_ns, info = messages[place]
        info.d = np.array([-0.2, 0.0, 0.0, 0.0, 0.0])
        messages[place] = topic, kind, log_time_ns, info
    path = write_messages(tmp_path / 'in.mcap', messages)
    lenses = [item.reading for item in read(path, SourceRequest()) if item.topic == INFO]
    assert [lens.distortion[0] for lens in lenses] == [0.0, 0.0, -0.2, -0.2]
    assert lenses[0] is lenses[1]


def test_other_topics_pass_by_where_they_are_asked_for(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(PICTURES[:3]))
    stream = open_images(path, SourceRequest())
    items = list(stream.read(['/pneunet/pressure', IMAGE, INFO]))
    assert [item.topic for item in items] == 3 * [INFO, IMAGE, '/pneunet/pressure']
    assert [item.reading is None for item in items] == 3 * [False, False, True]
    assert all(item.raw for item in items)


def test_a_given_lens_stands_in_for_recorded_ones(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(PICTURES[:3]))
    given = write_camera_info(tmp_path / 'given.yaml', width=123)
    stream = open_images(path, SourceRequest(camera_info=str(given)))
    items = list(stream.read([INFO]))
    lenses = [item for item in items if isinstance(item.reading, Lens)]
    assert [item.reading.width for item in lenses] == [123]
    assert [item.topic for item in items] == ['', IMAGE, INFO, IMAGE, INFO, IMAGE, INFO]


def test_a_recording_without_camera_info_says_how_to_give_one(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(PICTURES[:3], info=False))
    with refused(RecordingError, 'no_camera_info'):
        open_images(path, SourceRequest())


def test_the_camera_info_beside_the_images_is_taken(tmp_path):
    messages = []
    for name in ('left', 'right'):
        stamp = stamp_of(0)
        messages += [
            (f'/{name}/image_raw', IMAGE_TYPE, stamp, image_message(stamp, PICTURES[0])),
            (f'/{name}/camera_info', CAMERA_INFO_TYPE, stamp, info_message(stamp)),
        ]
    path = write_messages(tmp_path / 'in.mcap', messages)
    with refused(RecordingError, 'ambiguous_topic'):
        open_images(path, SourceRequest())
    request = SourceRequest(topics={'image_raw': '/right/image_raw'})
    stream = open_images(path, request)
    assert (stream.lens_source, stream.namespace) == ('/right/camera_info', '/right')
    chosen = SourceRequest(topics={**request.topics, 'camera_info': '/left/camera_info'})
    assert open_images(path, chosen).lens_source == '/left/camera_info'


def test_raw_and_compressed_images_of_one_camera_are_two_candidates(tmp_path):
    both = [*film(PICTURES[:2]), *film([encoded(PICTURES[0])], info=False)]
    path = write_messages(tmp_path / 'in.mcap', both)
    with refused(RecordingError, 'ambiguous_topic'):
        open_images(path, SourceRequest())
    stream = open_images(path, SourceRequest(topics={'image_raw': COMPRESSED}))
    assert (stream.image_topic, stream.frames, stream.namespace) == (COMPRESSED, 1, '/pneunet')


@pytest.mark.parametrize('kind', ['raw', 'compressed'])
def test_a_topic_of_another_name_can_be_of_either_type(tmp_path, kind):
    shown = PICTURES[:2] if kind == 'raw' else [encoded(one) for one in PICTURES[:2]]
    path = write_messages(tmp_path / 'in.mcap', film(shown, topic='/my/view'))
    with refused(RecordingError, 'no_topic'):
        open_images(path, SourceRequest())
    stream = open_images(path, SourceRequest(topics={'image_raw': '/my/view'}))
    assert (stream.namespace, stream.lens_source) == ('/my', INFO)
    assert len(images(stream.read(()))) == 2
    with refused(RecordingError, 'wrong_type'):
        open_images(path, SourceRequest(topics={'image_raw': INFO}))
    with refused(RecordingError, 'no_topic'):
        open_images(path, SourceRequest(topics={'image_raw': '/absent'}))


def test_messages_that_cannot_be_read_are_items_that_say_so(tmp_path):
    messages = film([encoded(one) for one in PICTURES[:4]])
    messages[3] = (*messages[3][:3], compressed_message(stamp_of(1), encoded(PICTURES[1])[:700]))
    info = info_message(stamp_of(2))
    info.k = np.zeros(9)  # as drivers do without a calibration
    messages[7] = (*messages[7][:3], info)
    path = write_messages(tmp_path / 'in.mcap', messages)
    items = read(path, SourceRequest())
    assert len(items) == 8
    assert len(images(items)) == 3
    assert isinstance(items[3].reading, MessageError)
    assert isinstance(items[4].reading, CameraError)
    assert (items[3].topic, items[4].topic) == (COMPRESSED, INFO)


def test_a_recording_that_is_cut_off_is_read_as_far_as_it_goes(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film([noise(i, 320, 240) for i in range(40)]))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    stream = open_images(path, SourceRequest())
    assert 3 < len(images(stream.read(()))) < 37
    assert any('ends' in sentence for sentence in stream.recording.sentences)


def test_a_video_of_variable_rate_has_the_times_that_are_in_it(tmp_path):
    path = tmp_path / 'phone.mp4'
    code = cv2.VideoWriter.fourcc(*'mp4v')
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, RATE, (WIDTH, HEIGHT))
    for picture in PICTURES:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    shares = [0.5, 1.75, 0.75, 1.0] * (len(PICTURES) // 4)
    stretch_frames(path, shares)
    stream = open_images(path, SourceRequest(camera_info='none'))
    stamps = [image.stamp_ns for image in images(stream.read(()))]
    before = np.concatenate([[0.0], np.cumsum(shares[:-1])])
    np.testing.assert_allclose(np.array(stamps) - 1, before * PERIOD_NS, atol=2e4)
    counted = open_images(path, SourceRequest(camera_info='none', rate=10.0))
    assert np.diff([image.stamp_ns for image in images(counted.read(()))]).tolist() == [10**8] * 11


def test_what_does_not_go_together_is_refused(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(PICTURES[:1]))
    folder = write_folder(tmp_path / 'f', PICTURES[:1])
    with refused(RequestError, 'other_source'):
        open_images(path, NONE)
    with refused(RequestError, 'exclusive'):
        open_images(path, SourceRequest(camera_info='none', topics={'camera_info': INFO}))
    with refused(RequestError, 'other_source'):
        open_images(folder, SourceRequest(camera_info='none', topics={'image_raw': IMAGE}))
    with refused(CameraError, 'not_found'):
        open_images(folder, SourceRequest(camera_info='absent.yaml'))
    with refused(RecordingError, 'not_found'):
        open_images(tmp_path / 'absent', NONE)
    text = tmp_path / 'text.txt'
    text.write_text('hello')
    with refused(RecordingError, 'wrong_kind'):
        open_images(text, SourceRequest())


def test_stamps_of_the_film_are_those_of_its_rate():
    assert PERIOD_NS == 1e9 / RATE
    assert stamp_of(7) == stamp_at(7, RATE)
