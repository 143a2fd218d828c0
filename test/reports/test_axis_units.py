"""Axes in other units: round numbers of the new unit, at the places of what was drawn."""

from __future__ import annotations

from matplotlib.figure import Figure
import numpy as np
from pneunet_ros.core.unit_system import dimensionless, SHOWN_SI, SI
from pneunet_ros.reports.axis_units import DRAWN, use_units
import pytest

LENGTH, WEIGHT = 0.112, 0.17
UNITS = dimensionless(LENGTH, WEIGHT)


def drawn(xlabel, ylabel, span=(0.0, 100.0)):
    figure = Figure()
    axes = figure.subplots()
    axes.plot(span, span)
    axes.set(xlabel=xlabel, ylabel=ylabel, xlim=span, ylim=span)
    return figure, axes


def test_ticks_say_the_new_unit_at_the_same_places():
    figure, axes = drawn('x (mm)', 'moment (mN m)')
    use_units(figure, UNITS)
    figure.draw_without_rendering()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ('x (l)', 'moment (mg l)')
    for axis, size in ((axes.xaxis, 1e-3 / LENGTH), (axes.yaxis, 1e-3 / (WEIGHT * LENGTH))):
        said = [float(label.get_text()) for label in axis.get_ticklabels()]
        assert said == pytest.approx(size * axis.get_ticklocs(), rel=1e-3, abs=1e-9)
        steps = np.diff(said)
        mantissa = steps / 10.0 ** np.floor(np.log10(steps))
        assert set(np.round(mantissa, 6)) <= {1.0, 2.0, 2.5, 5.0}
    assert axes.get_xlim() == (0.0, 100.0)  # what is drawn stays where it is


def test_an_axis_without_such_a_unit_stays():
    figure, axes = drawn('pressure (kPa)', 'share of the misfit (%)')
    before = axes.xaxis.get_major_locator()
    use_units(figure, UNITS)
    assert axes.get_xlabel() == 'pressure (kPa)'
    assert axes.xaxis.get_major_locator() is before


def test_in_si_nothing_changes():
    figure, axes = drawn('x (mm)', 'y (mm)')
    use_units(figure, SI)
    assert axes.get_xlabel() == 'x (mm)'


@pytest.mark.parametrize('system', [SI, SHOWN_SI, UNITS], ids=['SI', 'shown', 'dimensionless'])
def test_every_unit_that_figures_are_drawn_in_has_a_kind(system):
    assert all(system.of_kind(kind) is not None for kind, _ in DRAWN.values())
    assert system.of_kind('pressure') is None


def test_the_moment_is_force_times_length():
    assert UNITS.moment.size == pytest.approx(UNITS.force.size * UNITS.length.size)
    assert UNITS.curvature.size == pytest.approx(1.0 / UNITS.length.size)
