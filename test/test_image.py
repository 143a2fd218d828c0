"""Images: what can be read, where its pixels lie, and what it says where it cannot be read."""

from __future__ import annotations

import cv2
import numpy as np
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.image import ENCODINGS, Image
import pytest

FIELDS = {
    'stamp_ns': 0,
    'frame_id': '',
    'width': 3,
    'height': 2,
    'step': 3,
    'encoding': 'mono8',
}


def image_of(pixels, encoding, padding=0):
    """Return an image (rows, columns, channels), with rows that are longer by `padding` bytes."""
    height, width, channels = pixels.shape
    rows = np.full((height, width * channels + padding), 99, np.uint8)
    rows[:, : width * channels] = pixels.reshape(height, -1)
    return Image(
        stamp_ns=0,
        frame_id='camera',
        width=width,
        height=height,
        step=rows.shape[1],
        encoding=encoding,
        data=rows.tobytes(),
    )


def noise(encoding, shape=(7, 11)):
    channels = len(ENCODINGS[encoding])
    return np.random.default_rng(1).integers(0, 256, (*shape, channels), np.uint8)


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize('padding', [0, 5])
def test_pixels_are_where_the_layout_puts_them(encoding, padding):
    pixels = noise(encoding)
    image = image_of(pixels, encoding, padding)
    assert np.array_equal(image.pixels, pixels)
    assert not image.pixels.flags.writeable


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_grey_is_that_of_opencv(encoding):
    pixels = noise(encoding)
    if encoding == 'mono8':
        expected = pixels[:, :, 0]
    else:
        expected = cv2.cvtColor(pixels, getattr(cv2, f'COLOR_{encoding[:-1].upper()}2GRAY'))
    assert np.array_equal(image_of(pixels, encoding, 3).grey(), expected)


def test_the_last_row_needs_no_padding():
    data = bytes(range(11))
    fields = {**FIELDS, 'step': 8}
    assert Image(data=data, **fields).pixels[1, 2, 0] == 10
    with pytest.raises(MessageError, match='cut off after 10 bytes'):
        Image(data=data[:10], **fields)


def test_an_array_that_is_given_becomes_read_only():
    data = np.zeros(6, np.uint8)
    assert not Image(data=data, **FIELDS).data.flags.writeable


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ({'encoding': 'bayer_rggb8'}, 'possible are mono8, rgb8, bgr8, rgba8, bgra8'),
        ({'width': 0}, 'sides go from 1 to'),
        ({'height': 20_000}, 'sides go from 1 to'),
        ({'step': 2}, 'needs rows of 3 bytes, but its step is 2'),
    ],
)
def test_what_cannot_be_read_is_said(change, sentence):
    with pytest.raises(MessageError, match=sentence):
        Image(data=bytes(6), **{**FIELDS, **change})
