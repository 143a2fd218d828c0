"""Archives of arrays: what was declared is read, and nothing else."""

from __future__ import annotations

import numpy as np
from pneunet_ros.files.npz import ArchiveError, Declared, read_arrays
import pytest
from support.refusals import refused

DECLARED = {
    'time': Declared(axes=('frames',), increasing=True),
    'x': Declared(axes=('frames', 'stations')),
    'count': Declared(kind='integer'),
    'kind': Declared(kind='text'),
    'covariance': Declared(axes=('n', 'n'), definite='positive'),
    'information': Declared(axes=('n', 'n'), definite='semi', required=False),
}
WHOLE = {
    'time': np.array([0.0, 1.0, 2.0]),
    'x': np.zeros((3, 2)),
    'count': np.array(4),
    'kind': np.array('linear'),
    'covariance': np.diag([1e-20, 1.0, 1e12]),
    'information': np.diag([0.0, 1.0, 1e12]),
}


def test_arrays_as_declared_are_read(tmp_path):
    path = tmp_path / 'a.npz'
    np.savez(path, **WHOLE, other=np.array('is left alone'))
    found = read_arrays(path, DECLARED)
    assert found.keys() == WHOLE.keys()
    assert (found['count'], found['kind']) == (4, 'linear')
    assert found['x'].dtype == np.float64
    with pytest.raises(ValueError, match='read-only'):
        found['x'][0] = 1.0


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('time', np.array([0.0, 2.0, 2.0]), 'not_increasing'),
        ('time', np.array([0.0, np.nan, 2.0]), 'not_finite'),
        ('time', np.array([0.0, 1.0]), 'wrong_shape'),
        ('time', np.array(0.0), 'wrong_shape'),
        ('x', np.full((3, 2), 1e31), 'not_finite'),
        ('x', np.zeros((3, 2), complex), 'wrong_kind'),
        ('count', np.array(4.0), 'wrong_kind'),
        ('count', np.array(2**64 - 1, np.uint64), 'too_large'),
        ('kind', np.array(['a']), 'wrong_shape'),
        ('covariance', np.ones((3, 3)), 'not_definite'),
        ('covariance', np.diag([1.0, 0.0, 1.0]), 'not_definite'),
        ('covariance', np.eye(3) + np.eye(3, k=1), 'not_symmetric'),
        ('information', -np.eye(3), 'not_definite'),
        ('information', np.eye(2), 'wrong_shape'),
    ],
)
def test_what_is_not_as_declared_is_refused(tmp_path, name, value, reason):
    np.savez(tmp_path / 'a.npz', **WHOLE | {name: value})
    with refused(ArchiveError, reason):
        read_arrays(tmp_path / 'a.npz', DECLARED)


def test_a_missing_array_is_refused_unless_it_may_be(tmp_path):
    path = tmp_path / 'a.npz'
    np.savez(path, **{name: value for name, value in WHOLE.items() if name != 'information'})
    assert 'information' not in read_arrays(path, DECLARED)
    np.savez(path, **{name: value for name, value in WHOLE.items() if name != 'x'})
    with refused(ArchiveError, 'missing'):
        read_arrays(path, DECLARED)


def test_a_matrix_of_tiny_variances_is_judged_without_a_warning(tmp_path):
    path = tmp_path / 'tiny.npz'
    np.savez(path, m=np.diag([1e-300, 1e-300]))
    entries = {'m': Declared(axes=('a', 'a'), definite='positive')}
    with np.errstate(divide='raise'):
        assert read_arrays(path, entries)['m'].shape == (2, 2)
