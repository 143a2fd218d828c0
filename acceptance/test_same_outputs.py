"""Whether outputs are called the same: what became no number is not."""

from __future__ import annotations

import pytest
import same_outputs as bench


@pytest.mark.parametrize(
    ('old', 'new', 'same'),
    [
        ('1.0', '1.0', True),
        ('NaN', 'NaN', True),
        ('1.0', 'NaN', False),
        ('0.0', 'NaN', False),
        ('1.0', 'Infinity', False),
        ('Infinity', '-Infinity', False),
        ('1.0', 'null', False),
        ('null', '1.0', False),
        ('"as it was"', '"better said"', True),
    ],
)
def test_a_number_that_is_none_any_more_is_another_output(tmp_path, old, new, same):
    for name, value in (('before', old), ('after', new)):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'one.json').write_text(f'{{"values": [{value}, 2.0]}}')
    assert bench.compare(tmp_path / 'before', tmp_path / 'after', 1e-9) is same


def test_a_difference_is_relative_to_the_largest_of_its_array():
    assert bench.difference(1e-9, 2e-9, 1.0) == pytest.approx(1e-9)
    assert bench.difference(1.0, 2.0, 0.0) == 0.5
