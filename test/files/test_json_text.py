"""What becomes JSON: the numbers of NumPy are those of Python, and what is none is null."""

from __future__ import annotations

import json

import numpy as np
from pneunet_ros.files.json_text import json_text
import pytest


@pytest.mark.parametrize(
    ('value', 'read'),
    [
        (np.True_, True),
        (np.int64(3), 3),
        (np.float32(0.5), 0.5),
        (np.float64('nan'), None),
        (float('inf'), None),
        (np.array([[1.0, np.nan]]), [[1.0, None]]),
        ((np.str_('a'), np.bool_(0)), ['a', False]),
    ],
)
def test_numbers_of_numpy_are_those_of_python(value, read):
    found = json.loads(json_text({'value': value}))['value']
    assert found == read
    assert type(found) is type(read)
