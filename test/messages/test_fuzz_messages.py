"""Messages with any values in their fields: what they say, or a MessageError; nothing else."""

from __future__ import annotations

import array
from types import SimpleNamespace
from typing import Any

from hypothesis import strategies as st
import numpy as np
from pneunet_ros.core.errors import CameraError, MessageError
from pneunet_ros.core.image import ENCODINGS, Image
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.readings import (
    decode_pressure,
    decode_targets,
    decode_wrench,
    targets_message,
)
from pneunet_ros.messages.tracker import decode_camera_info, decode_compressed_image, decode_image
from pneunet_ros.recordings.message_store import deserialize, jazzy, ROSBAGS_TYPES, serialize
from pneunet_ros.vision.camera.camera_model import Lens
import pytest
from support.fuzzing import AMOUNTS, answer, damaged_bytes, fuzz

ODD = (
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.text(max_size=4)
    | st.binary(max_size=9)
    | st.lists(st.floats(), max_size=9)
    | st.sampled_from(
        [np.float32(1.5), np.array([1.0, 2.0]), np.array(3), array.array('B', [1]), {}, ()]
    )
)
SMALL = st.integers(-1, 70) | st.sampled_from([2**31 - 1, 2**32 - 1, 16_384, 16_385])


def message(**fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Draw a message in which each field is as given, or odd, or not there."""
    return st.fixed_dictionaries(
        {}, optional={name: st.one_of(*[values] * 6, ODD) for name, values in fields.items()}
    ).map(lambda found: SimpleNamespace(**found)) | st.fixed_dictionaries(
        {name: st.one_of(*[values] * 12, ODD) for name, values in fields.items()}
    ).map(lambda found: SimpleNamespace(**found))


FRAMES = st.sampled_from(['pneunet_base', 'camera', ''])
STAMPS = message(sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
HEADERS = message(stamp=STAMPS, frame_id=FRAMES)
VECTORS = message(x=st.floats(), y=st.floats(), z=st.floats())
DATA = st.binary(max_size=300) | st.binary(max_size=300).map(
    lambda raw: np.frombuffer(raw, np.uint8)
)
DATA |= st.binary(max_size=300).map(lambda raw: array.array('B', raw))
POINT_FIELDS = message(
    name=st.sampled_from(['x', 'y', 'z', 'id', 'std', 'u', 'é', '']),
    offset=st.integers(-5, 90) | st.sampled_from([2**32 - 1]),
    datatype=st.integers(0, 9),
    count=st.sampled_from([1, 1, 1, 0, 2]),
)
MESSAGES: dict[str, tuple[Any, type, st.SearchStrategy[Any]]] = {
    'pressure': (
        decode_pressure,
        PressureReading,
        message(header=HEADERS, fluid_pressure=st.floats(), variance=st.floats()),
    ),
    'end_wrench': (
        decode_wrench,
        WrenchReading,
        message(header=HEADERS, wrench=message(force=VECTORS, torque=VECTORS)),
    ),
    'image': (
        decode_image,
        Image,
        message(
            header=HEADERS,
            width=SMALL,
            height=SMALL,
            step=SMALL,
            encoding=st.sampled_from([*ENCODINGS, 'mono16', '']),
            data=DATA,
        ),
    ),
    'compressed': (decode_compressed_image, Image, message(header=HEADERS, data=DATA)),
    'camera_info': (
        decode_camera_info,
        Lens,
        message(
            width=SMALL,
            height=SMALL,
            distortion_model=st.sampled_from(
                ['plumb_bob', 'rational_polynomial', 'equidistant', '']
            ),
            k=st.lists(st.floats(0.0, 900.0), min_size=9, max_size=9)
            | st.just([500.0, 0.0, 32.0, 0.0, 500.0, 24.0, 0.0, 0.0, 1.0]),
            d=st.lists(st.floats(-1e3, 1e3) | st.floats(), max_size=14),
            binning_x=st.integers(0, 2),
            binning_y=st.integers(0, 2),
            roi=message(x_offset=SMALL, y_offset=SMALL, width=SMALL, height=SMALL),
        ),
    ),
    'targets': (
        lambda given: decode_targets(given, 'pneunet_base'),
        TargetSightings,
        message(
            header=HEADERS,
            height=st.sampled_from([0, 1, 1, 2, 2**32 - 1]),
            width=SMALL,
            fields=st.lists(POINT_FIELDS, max_size=6),
            is_bigendian=st.booleans(),
            point_step=SMALL,
            row_step=SMALL,
            data=DATA,
        ),
    ),
}


@AMOUNTS
@pytest.mark.parametrize('kind', MESSAGES)
def test_any_fields_are_read_or_refused(kind, examples):
    decode, becomes, messages = MESSAGES[kind]

    def body(given: Any) -> None:
        found = answer(decode, given)
        assert isinstance(found, (becomes, MessageError, CameraError))
        if isinstance(found, Image):
            assert found.grey().shape == (found.height, found.width)
        if isinstance(found, (PressureReading, WrenchReading, Image, TargetSightings)):
            assert isinstance(found.stamp_ns, int)

    fuzz(4 * examples, body, given=messages)


TARGETS = targets_message(
    10**9, [0.0, 0.1, np.nan], [0.0, 0.01, np.nan], 'pneunet_base', ROSBAGS_TYPES
)
SERIALIZED = {
    'targets': (serialize(TARGETS, 'sensor_msgs/msg/PointCloud2'), 'sensor_msgs/msg/PointCloud2'),
    'image': (
        serialize(
            ROSBAGS_TYPES(IMAGE_TYPE)(
                header=TARGETS.header, height=4, width=6, encoding='rgb8', is_bigendian=0, step=20,
                data=np.arange(80, dtype=np.uint8),
            ),
            IMAGE_TYPE,
        ),
        IMAGE_TYPE,
    ),
    'compressed': (
        serialize(
            ROSBAGS_TYPES(COMPRESSED_TYPE)(
                header=TARGETS.header, format='jpeg', data=np.arange(80, dtype=np.uint8)
            ),
            COMPRESSED_TYPE,
        ),
        COMPRESSED_TYPE,
    ),
}  # fmt: skip


@AMOUNTS
@pytest.mark.parametrize('kind', SERIALIZED)
def test_any_serialized_bytes_are_read_or_refused(kind, examples):
    whole, type_name = SERIALIZED[kind]
    decode, becomes, _ = MESSAGES[kind]

    def body(raw: bytes) -> None:
        found = answer(lambda: decode(deserialize(raw, type_name, jazzy())))
        assert isinstance(found, (becomes, MessageError))

    fuzz(4 * examples, body, raw=damaged_bytes(whole))


@AMOUNTS
def test_every_layout_of_an_image_is_read_as_it_stands(examples):
    """All encodings, odd steps, and data that is longer than needed or a byte too short."""

    def body(encoding: str, width: int, height: int, more: int, behind: int) -> None:
        layout = ENCODINGS[encoding]
        row = width * layout.channels * (1 + layout.deep)
        step = row + more
        needed = step * (height - 1) + row
        given = np.random.default_rng(1).integers(0, 256, needed + behind, np.uint8)
        fields = {'width': width, 'height': height, 'step': step, 'encoding': encoding}
        fields['is_bigendian'] = more % 2
        heading = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2), frame_id='camera')
        image = answer(decode_image, SimpleNamespace(header=heading, data=given, **fields))
        assert image.grey().shape == (height, width)
        if layout.channels == 1 and not layout.deep and 'bayer' not in encoding:
            assert image.grey()[-1, -1] == given[needed - 1]
        short = SimpleNamespace(header=heading, data=given[: needed - 1], **fields)
        assert answer(decode_image, short).reason == 'cut_off'

    fuzz(
        examples,
        body,
        encoding=st.sampled_from(sorted(ENCODINGS)),
        width=st.integers(1, 9),
        height=st.integers(1, 9),
        more=st.integers(0, 7),
        behind=st.integers(0, 5),
    )
