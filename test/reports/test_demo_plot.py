"""The picture of holds: drawn whatever the holds, without a warning."""

from __future__ import annotations

from dataclasses import replace

from matplotlib.image import imread
from pneunet_ros import load_model
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.reports.demo_plot import draw_holds
import pytest

ARM = load_model(share_path('config/paper_arm.yaml'))


def estimates(*loads: tuple[float, float, float]) -> list[ShapeEstimate]:
    """Estimate the shape at each pressure (Pa) and force (N)."""
    estimator, state, found = Estimator(arm=ARM), EstimatorState(), []
    for index, (pressure, along, across) in enumerate(loads):
        stamp = index + 1
        force = WrenchReading(
            stamp_ns=stamp, force_x=along, force_y=across, moment=0.0, frame_id='pneunet_base'
        )
        state, _ = estimator.step(state, force)
        state, outcome = estimator.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
        assert isinstance(outcome, ShapeEstimate)
        found.append(outcome)
    return found


@pytest.mark.parametrize(
    'loads',
    [
        [(31e3, 0.175, 0.07)],
        [(0.0, 0.0, 0.0)],
        [(-500.0, 0.0, 0.0)],
        [(index * 4.5e3, 0.01 * index, 0.02 * index) for index in range(15)],
    ],
    ids=['one', 'at-rest', 'below-ambient', 'fifteen'],
)
def test_holds_are_drawn(loads, tmp_path):
    path = tmp_path / 'holds.png'
    draw_holds(ARM, estimates(*loads), path, 'a title')
    picture = imread(path)
    assert picture.shape[0] > 600
    assert picture.shape[1] > 1500
    assert (picture[..., :3] < 0.9).any(axis=2).mean() > 0.005  # it is not empty


def test_the_colors_tell_the_pressures_apart(tmp_path):
    first, second = estimates((10e3, 0.0, 0.0), (50e3, 0.0, 0.0))
    draw_holds(ARM, [first, second], tmp_path / 'two.png', '')
    draw_holds(ARM, [first, first], tmp_path / 'same.png', '')
    assert (tmp_path / 'two.png').read_bytes() != (tmp_path / 'same.png').read_bytes()


def test_a_large_uncertainty_is_drawn_too(tmp_path):
    (estimate,) = estimates((31e3, 0.175, 0.07))
    wide = replace(estimate, tip_covariance=1e4 * estimate.tip_covariance)
    draw_holds(ARM, [wide], tmp_path / 'wide.svg', '')
    assert (tmp_path / 'wide.svg').read_text().startswith('<?xml')
