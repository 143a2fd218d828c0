"""Real sets are read whatever the frame of their tracker, and absent ones are passed by."""

from __future__ import annotations

import numpy as np
import pytest
import real_sets as bench

TURN = np.linalg.qr(np.array([[0.3, -1.0, 0.4], [1.0, 0.2, 0.1], [0.2, 0.5, 1.0]]))[0]


@pytest.fixture
def arc(tmp_path):
    """Write a set of which the truth is known: an arc of the assumed length, in any frame."""
    pressure, turning = np.linspace(11.5, 13.0, 13), np.linspace(1e-6, 1.2, 13)
    (one, *_) = bench.SETS
    along = one.length * np.sin(turning) / turning
    across = one.length * (1.0 - np.cos(turning)) / turning
    place = np.column_stack([along, across, 0.0 * along]) @ TURN + [1.0, 2.0, 3.0]
    rows = ['Time,Actual PSI,X Position,Y Position,Z Position']
    for value, (x, y, z) in zip(pressure, 1e3 * place, strict=True):
        rows.append(f'22:12:01,{value:.4f},{x:.6f},{y:.6f},{z:.6f}')
    (tmp_path / one.file).write_text('\n'.join(rows))
    return tmp_path, turning


def test_a_set_in_any_frame_is_the_tip_of_an_arc(arc):
    folder, turning = arc
    (found,) = bench.actuators_in(folder)
    assert found.pressure[0] == 0.0
    truth = np.column_stack([np.sin(turning) / turning, (1.0 - np.cos(turning)) / turning])
    apart = np.hypot(*(found.tip / bench.LENGTH - truth).T)
    assert np.max(apart) < 0.02


def test_what_is_not_there_is_passed_by(tmp_path):
    assert bench.actuators_in(tmp_path) == []


def test_a_recording_that_cannot_be_calibrated_is_a_row_that_says_why(tmp_path):
    path = tmp_path / 'still.csv'
    rows = (f'{0.05 * row:.2f};{0.01 * (row % 2):.2f};20.0' for row in range(200))
    path.write_text('\n'.join(['time;angle;pressure', *rows]))
    (row,) = bench.measured_angles([bench.read_angles(path)])
    assert not row['answered']
    assert 'pressure' in row['says']
