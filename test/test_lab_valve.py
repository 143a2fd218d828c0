"""The valve of the virtual lab against its differential equation."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.valve import Valve
import pytest


@pytest.mark.parametrize(('start', 'command'), [(0.0, 3e4), (5e4, 1e4), (2e4, 2e4)])
@pytest.mark.parametrize(('time_constant', 'rate_limit'), [(0.1, 1e5), (0.3, 2e4), (0.05, 1e9)])
def test_the_pressure_follows_its_equation(start, command, time_constant, rate_limit):
    valve = Valve(time_constant=time_constant, rate_limit=rate_limit)
    seconds = np.linspace(0.0, 3.0, 30_001)
    pressure = valve.pressure(start, command, seconds)
    expected, now = [start], start
    for step in np.diff(seconds):
        now += step * np.clip((command - now) / time_constant, -rate_limit, rate_limit)
        expected.append(now)
    assert pressure[0] == start
    assert pressure == pytest.approx(np.array(expected), abs=30.0)
    assert np.all(np.abs(pressure - command) <= abs(start - command))


def test_it_does_not_matter_in_how_many_steps():
    valve = Valve(time_constant=0.2, rate_limit=3e4)
    whole = valve.pressure(0.0, 4e4, np.array([1.7]))[-1]
    first = valve.pressure(0.0, 4e4, np.array([0.4]))[-1]
    assert valve.pressure(first, 4e4, np.array([1.3]))[-1] == pytest.approx(whole, abs=1e-9)


def test_without_a_time_constant_the_supply_alone_is_the_limit():
    valve = Valve(time_constant=0.0, rate_limit=1e4)
    pressure = valve.pressure(1e4, 0.0, np.array([0.0, 0.5, 1.0, 2.0]))
    assert pressure.tolist() == [1e4, 5e3, 0.0, 0.0]


def test_an_impossible_valve_is_refused():
    with pytest.raises(RequestError, match=r'valve\.rate_limit'):
        Valve(rate_limit=0.0)
