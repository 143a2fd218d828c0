"""A row of targets beside the neutral line, or of another spacing, is found by the calibration."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.calibration.target_row import target_row
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.lab.sensors import draw_placement, noiseless
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.innovation import innovation
from pneunet_ros.measurement.predicted_targets import predict_targets
import pytest
from support.refusals import reasons
from support.small_calibration import ARM, measured, NOISE, runs_of, TOP

ROWS = [(0.003, 0.0), (-0.003, -0.05)]  # offset m, relative spacing


def shifted(run: RecordingData, arm, offset: float, spacing: float) -> RecordingData:
    """Return the run with its row of targets painted elsewhere on the arm."""
    places = arm.target_arclength
    again = [
        measured(
            arm,
            run.name,
            run.pressure,
            run.force if run.loaded else None,
            np.stack([row * spacing * places, np.full(places.size, row * offset)]),
            1,
        ).points
        for row in (0.0, 1.0)
    ]
    moved = run.points + again[1] - again[0]
    return replace(run, x=moved[:, 0], y=moved[:, 1])


@cache
def calibration(offset: float, spacing: float) -> Calibration:
    free, loaded = ([shifted(run, ARM, offset, spacing) for run in runs] for runs in runs_of(ARM))
    return calibrate(free, loaded, replace(ARM, sensors=NOISE), compare=False)


@pytest.mark.lengthy
@pytest.mark.parametrize(('offset', 'spacing'), ROWS)
def test_the_row_is_found_and_the_model_is_right(offset, spacing):
    found = calibration(offset, spacing)
    row = target_row(found.joint)
    assert abs(row.offset - offset) < 4.0 * row.offset_std
    assert abs(row.spacing - spacing) < 4.0 * row.spacing_std
    assert row.offset_std < 1e-4
    assert row.spacing_std < 2e-3
    true = ARM.intrinsic_curvature.at(0.5 * TOP, np.array([0.5]))
    assert found.arm.intrinsic_curvature.at(0.5 * TOP, np.array([0.5])) == pytest.approx(
        true, rel=0.03
    )
    assert 'misfit' not in reasons(found.notes)


@pytest.mark.lengthy
def test_a_frame_of_the_same_row_is_where_the_model_predicts_it():
    offset, spacing = ROWS[0]
    model = calibration(offset, spacing).arm
    estimator = Estimator(arm=model, settings=EstimatorSettings(wrench_required=False))
    reading = PressureReading(stamp_ns=1, pressure=0.6 * TOP)
    _, estimate = estimator.step(EstimatorState(), reading)
    predicted = predict_targets(estimator.table, estimate.noise, estimate.second_order)
    (run,) = [
        shifted(measured(ARM, 'one', np.array([0.6 * TOP]), None, np.zeros((2, 23)), 3), ARM, *row)
        for row in ROWS[:1]
    ]
    nothing = np.full(23, np.nan)
    sightings = TargetSightings(
        stamp_ns=1,
        x=run.x[0],
        y=run.y[0],
        **dict.fromkeys(('std', 'u', 'v', 'area', 'major', 'minor', 'angle'), nothing),
    )
    found = innovation(predicted, sightings, model.sensors)
    assert found.chi_square < 2.0 * found.coordinates
    elsewhere = innovation(
        replace(predicted, placed=np.zeros_like(predicted.placed)), sightings, model.sensors
    )
    assert elsewhere.chi_square > 10.0 * elsewhere.coordinates


def test_the_lab_paints_the_row_where_it_is_told():
    places = np.array([0.0, 0.05, 0.1])
    noise = replace(noiseless(), row_offset=0.002, row_spacing=0.1)
    placement = draw_placement(np.random.default_rng(1), places, noise)
    np.testing.assert_allclose(placement, [[0.0, 0.002], [0.005, 0.002], [0.01, 0.002]])
