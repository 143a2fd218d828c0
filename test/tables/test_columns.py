"""What columns of tables are by their names, and by the units below these."""

from __future__ import annotations

from pneunet_ros.tables.columns import likely_name, names_absolute, standard_name, with_unit
import pytest


@pytest.mark.parametrize(
    ('written', 'known', 'absolute'),
    [
        ('P abs [kPa]', 'pressure_kpa', True),
        ('psia', 'pressure_psi', True),
        ('bar(a)', 'pressure_bar', True),
        ('psig', 'pressure_psi', False),
        ('P [kgf/cm2]', 'pressure_at', False),
    ],
)
def test_a_pressure_is_known_by_its_unit_and_reference(written, known, absolute):
    assert (standard_name(written), names_absolute(written)) == (known, absolute)


@pytest.mark.parametrize(
    ('written', 'likely'),
    [
        ('P_a [kPa]', 'pressure_kpa'),  # of a chamber, or absolute
        ('a_bar', 'pressure_bar'),
        ('Druck [bar]', 'pressure_bar'),
        ('P abs [psig]', 'pressure_psi'),  # contradicts itself
        ('Pressure at valve (kPa)', 'pressure_kpa'),
        ('pressure_at_tip_kpa', 'pressure_kpa'),
        ('Pressure bar sensor [psi]', 'pressure_psi'),
        ('angle_deg', 'tip_heading_deg'),  # and not the angle of a string
        ('bending angle [deg]', 'tip_heading_deg'),
    ],
)
def test_a_name_that_may_be_another_pressure_is_asked_about(written, likely):
    assert standard_name(written) == written
    assert not names_absolute(written)
    assert likely_name(written) == likely


@pytest.mark.parametrize(
    ('name', 'below', 'whole'),
    [
        ('pressure', '[kPa]', 'pressure [kPa]'),
        ('pressure', 'bar(a)', 'pressure [bar(a)]'),
        ('pressure_bar', 'bar', 'pressure_bar'),
        ('pressure_bar', 'bar(a)', 'pressure_bar a'),
        ('pressure', 'kgf/cm2', 'pressure [kgf/cm2]'),
    ],
)
def test_a_unit_below_a_name_keeps_its_reference(name, below, whole):
    assert with_unit(name, below) == whole
    assert names_absolute(whole) == below.endswith('(a)')
