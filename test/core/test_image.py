"""Images: what can be read, where its pixels lie, and what it says where it cannot be read."""

from __future__ import annotations

import cv2
import numpy as np
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.image import ENCODINGS, Image
import pytest
from support.refusals import refused

FIELDS = {'stamp_ns': 0, 'frame_id': '', 'width': 3, 'height': 2, 'step': 3, 'encoding': 'mono8'}


SHAPE = 8, 12
BAYER = {'rggb': 'RG', 'bggr': 'BG', 'gbrg': 'GB', 'grbg': 'GR'}
SMOOTH = np.add.outer(10 * np.arange(SHAPE[0]), 8 * np.arange(SHAPE[1])).astype(np.uint8)


def image_of(rows, encoding, padding=0, after=b'', big_endian=False):
    """Return an image of SHAPE whose rows (height, values) are longer by `padding` bytes."""
    if big_endian:
        rows = rows.astype(rows.dtype.newbyteorder('>'))
    rows = np.ascontiguousarray(rows).view(np.uint8)
    padded = np.full((len(rows), rows.shape[1] + padding), 99, np.uint8)
    padded[:, : rows.shape[1]] = rows
    return Image(
        stamp_ns=0,
        frame_id='camera',
        width=SHAPE[1],
        height=SHAPE[0],
        step=padded.shape[1],
        encoding=encoding,
        data=padded.tobytes() + after,
        big_endian=big_endian,
    )


def stored(grey, encoding):
    """Return a grey picture as a camera of this encoding stores it: rows, and what follows them.

    Written from the definitions of sensor_msgs/image_encodings.hpp and of fourcc.org.
    """
    depth = np.uint16 if encoding.endswith('16') or encoding.startswith('16') else np.uint8
    grey = grey.astype(depth)
    height, width = grey.shape
    if encoding in ('yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv'):
        first = encoding in ('yuv422_yuy2', 'yuyv')
        chroma = np.full_like(grey, 77)
        pair = (grey, chroma) if first else (chroma, grey)
        return np.stack(pair, axis=2).reshape(height, -1), b''
    if encoding in ('nv12', 'nv21', 'nv24'):
        return grey, bytes(height * width * (2 if encoding == 'nv24' else 1))
    channels = {'rgb': 3, 'bgr': 3, 'C3': 3, 'rgba': 4, 'bgra': 4, 'C4': 4}
    count = channels.get(encoding.rstrip('168'), channels.get(encoding[-2:], 1))
    return np.repeat(grey[:, :, None], count, axis=2).reshape(height, -1), b''


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize('padding', [0, 6])
def test_brightness_is_read_from_every_encoding(encoding, padding):
    rows, after = stored(SMOOTH, encoding)
    if encoding.startswith('bayer'):  # as all colors are alike, a ramp is interpolated exactly
        grey = image_of(rows, encoding, padding, after).grey()[1:-1, 1:-1]
        assert np.abs(grey.astype(int) - SMOOTH[1:-1, 1:-1]).max() <= 1
    else:
        assert np.array_equal(image_of(rows, encoding, padding, after).grey(), SMOOTH)


@pytest.mark.parametrize('encoding', [name for name, it in ENCODINGS.items() if it.deep])
def test_the_larger_byte_may_come_first(encoding):
    rows, _ = stored(16 * SMOOTH.astype(np.uint16), encoding)
    little = image_of(rows, encoding).grey()
    assert np.array_equal(image_of(rows, encoding, 4, big_endian=True).grey(), little)
    assert np.ptp(little) > 100


@pytest.mark.parametrize('bits', [8, 10, 12, 14, 16])
def test_deep_pictures_are_scaled_by_the_bits_that_are_used(bits):
    levels = np.full(SHAPE, 2**bits - 1, np.uint16)
    levels[0, 0] = 2 ** (bits - 1)
    grey = image_of(levels, 'mono16').grey()
    assert (grey[0, 0], grey[0, 1]) == (128, 255)


@pytest.mark.parametrize('encoding', ['mono16', 'rgb16', 'bayer_rggb16'])
def test_a_hot_pixel_does_not_decide_how_many_bits_are_in_use(encoding):
    rows, _ = stored(4 * SMOOTH.astype(np.uint16), encoding)
    rows[4, 4] = 65535
    image = image_of(rows, encoding)
    assert image.bits_used == 10
    away = np.ones(SHAPE, np.bool_)
    away[2:7, :7] = away[[0, -1]] = away[:, [0, -1]] = False
    assert np.abs(image.grey()[away].astype(int) - SMOOTH[away]).max() <= 1
    assert image.grey().max() == 255
    assert image.with_bits(12).grey()[6, 9] == pytest.approx(SMOOTH[6, 9] / 4, abs=0.5)


def test_colors_are_where_the_encoding_says():
    bgr = np.random.default_rng(1).integers(0, 256, (*SHAPE, 3), np.uint8)
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    for code, encodings in (
        (None, ('bgr8', '8UC3')), (cv2.COLOR_BGR2RGB, ('rgb8',)),
        (cv2.COLOR_BGR2RGBA, ('rgba8',)), (cv2.COLOR_BGR2BGRA, ('bgra8', '8UC4')),
    ):  # fmt: skip
        pixels = bgr if code is None else cv2.cvtColor(bgr, code)
        for encoding in encodings:
            assert np.array_equal(image_of(pixels.reshape(8, -1), encoding, 2).grey(), grey)


@pytest.mark.parametrize('pattern', BAYER)
@pytest.mark.parametrize('bits', [8, 16])
def test_the_colors_of_a_bayer_pattern_are_weighed(pattern, bits):
    colors = {'r': 200, 'g': 100, 'b': 40}
    cells = np.array([[colors[it] for it in pattern[:2]], [colors[it] for it in pattern[2:]]])
    mosaic = np.tile(cells, (SHAPE[0] // 2, SHAPE[1] // 2)).astype(f'u{bits // 8}')
    grey = image_of(mosaic, f'bayer_{pattern}{bits}').grey()
    assert np.abs(grey[2:-2, 2:-2] - (0.299 * 200 + 0.587 * 100 + 0.114 * 40)).max() <= 1.0


RED, GREY = (200, 20, 30), (97, 97, 97)  # of nearly the same brightness


@pytest.mark.parametrize('encoding', ['rgb8', 'bgr8', 'bgra8', 'rgba16', 'bayer_grbg8', 'yuyv'])
def test_a_color_is_told_from_a_grey_of_its_brightness(encoding):
    rgb = np.full((*SHAPE, 3), GREY, np.uint8)
    rgb[:, 6:] = RED
    if encoding == 'yuyv':  # by the definition of BT.601, limited range
        r, g, b = rgb.transpose(2, 0, 1) / 255.0
        y = 16.0 + 65.481 * r + 128.553 * g + 24.966 * b
        cb = 128.0 - 37.797 * r - 74.203 * g + 112.0 * b
        cr = 128.0 + 112.0 * r - 93.786 * g - 18.214 * b
        rows = np.empty((*SHAPE, 2))
        rows[:, :, 0], rows[:, 0::2, 1], rows[:, 1::2, 1] = y, cb[:, 0::2], cr[:, 0::2]
        rows = np.rint(rows).astype(np.uint8)
    elif encoding.startswith('bayer'):
        rows = rgb[:, :, 1].copy()
        rows[0::2, 1::2], rows[1::2, 0::2] = rgb[0::2, 1::2, 0], rgb[1::2, 0::2, 2]
    else:
        planes = dict(zip('rgba', (*rgb.transpose(2, 0, 1), np.full(SHAPE, 255)), strict=True))
        rows = np.stack([planes[it] for it in encoding.rstrip('168')], axis=2)
        rows = (rows.astype(np.uint16) * 257) if encoding.endswith('16') else rows.astype(np.uint8)
    image = image_of(rows.reshape(SHAPE[0], -1), encoding, 4)
    near = image.closeness(RED).grey()
    assert near[2:-2, 8:-2].min() > 225
    assert near[2:-2, 2:4].max() < 20


@pytest.mark.parametrize('encoding', ['mono8', '16UC1', 'nv12'])
def test_brightness_has_no_colors(encoding):
    rows, after = stored(SMOOTH, encoding)
    image = image_of(rows, encoding, 0, after)
    assert not image.has_colors
    with refused(MessageError, 'no_colors'):
        image.closeness(RED)


def test_the_last_row_needs_no_padding():
    fields = {**FIELDS, 'step': 8}
    assert Image(data=bytes(range(11)), **fields).grey()[1, 2] == 10
    with refused(MessageError, 'cut_off'):
        Image(data=bytes(range(10)), **fields)


def test_an_array_that_is_given_becomes_read_only():
    data = np.zeros(6, np.uint8)
    assert not Image(data=data, **FIELDS).data.flags.writeable


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ({'encoding': '32FC1'}, 'supported are mono8, 8UC1, rgb8'),
        ({'width': 0}, 'each side must be 1 to'),
        ({'height': 20_000}, 'each side must be 1 to'),
        ({'step': 2}, 'needs rows of 3 bytes, but its step is 2'),
        ({'encoding': 'mono16'}, 'needs rows of 6 bytes, but its step is 3'),
        ({'encoding': 'yuyv'}, 'needs rows of 6 bytes, but its step is 3'),
    ],
)
def test_what_cannot_be_read_is_said(change, sentence):
    with pytest.raises(MessageError, match=sentence):
        Image(data=bytes(6), **{**FIELDS, **change})


def test_half_a_pair_of_pixels_has_no_color():
    fields = {'width': 5, 'height': 3, 'step': 10, 'encoding': 'yuv422'}
    image = Image(stamp_ns=1, frame_id='camera', data=np.zeros(30, np.uint8), **fields)
    assert not image.has_colors and image.grey().shape == (3, 5)
    with refused(MessageError, 'no_colors'):
        image.closeness((255.0, 0.0, 0.0))
