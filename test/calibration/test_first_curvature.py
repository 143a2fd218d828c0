"""Where the search for kappa_p0 begins, and that a noisy pressure does not lead it astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.experiments import FitSequence
from pneunet_ros.calibration.first_curvature import arc_curvature, first_curvature
from pneunet_ros.calibration.noise_estimate import estimate_noise
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.simulation import simulate
import pytest
from support.example_arms import paper_arm
from support.lab_run import run_of, true_model

ARCLENGTH = np.array([0.0, 0.01, 0.04, 0.08, 0.11])
CURVATURES = np.array([-90.0, -12.0, -1e-9, 0.0, 0.3, 30.0, 105.0])  # 1/m


def arcs(curvatures):
    """Return x + i y (frames, targets) of arcs that begin along x, in pieces that are straight."""
    s = np.linspace(0.0, 1.0, 2001) * ARCLENGTH[:, None]
    heading = np.exp(1j * curvatures[:, None, None] * s)
    return np.trapezoid(heading, s, axis=-1)


def test_arcs_have_their_curvature_whatever_is_hidden():
    seen = arcs(CURVATURES)
    step = 4.0 * np.pi / ARCLENGTH.max() / 200.0
    assert arc_curvature(seen, ARCLENGTH) == pytest.approx(CURVATURES, abs=0.51 * step)
    seen[:, [2, 4]] = np.nan
    assert arc_curvature(seen[1:6], ARCLENGTH) == pytest.approx(CURVATURES[1:6], abs=0.51 * step)


@pytest.mark.parametrize('angle', [0.0, -0.5 * np.pi])
def test_it_goes_with_the_pressure_from_wherever_the_clamp_points(angle):
    arm = replace(paper_arm(), target_arclength=ARCLENGTH, clamp_angle=angle)
    pressure = np.array([1e3, 2e4, 3e4, 5e4])
    seen = arcs(6e-4 * pressure - 1.0) * np.exp(1j * angle)
    run = run_of(recorded(0.0))
    run = replace(
        run,
        pressure=pressure,
        reading_stamp_ns=run.reading_stamp_ns[:4],
        stamp_ns=run.stamp_ns[:4],
        reading=np.arange(4),
        force=np.zeros((4, 2)),
        moment=np.zeros(4),
        x=seen.real,
        y=seen.imag,
    )
    found = first_curvature([run], arm, np.array([0.0, 6e4]))
    assert found == pytest.approx([-1.0, 35.0], abs=0.5)
    few = np.array(seen)
    few[0, 1:], few[1] = np.nan, np.nan  # the target at the clamp alone, and none
    hidden = replace(run, x=few.real, y=few.imag)
    assert first_curvature([hidden], arm, np.array([0.0, 6e4])) == pytest.approx(found, abs=0.8)
    unseen = replace(run, x=np.full(few.shape, np.nan), y=np.full(few.shape, np.nan))
    assert first_curvature([unseen], arm, np.array([0.0, 6e4])).tolist() == [0.0, 0.0]
    resting = replace(run, pressure=np.full(4, 2e4))
    assert first_curvature([resting], arm, np.array([0.0, 6e4])) == pytest.approx(
        np.full(2, np.mean(6e-4 * pressure - 1.0)), abs=0.5
    )


def recorded(pressure_std: float, name: str = 'unloaded_ramp', seed: int = 700100):
    scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
    noise = replace(scenario.noise, pressure_std=pressure_std)
    arm = vary_arm(scenario.arm, 7001)
    return simulate(replace(scenario, arm=arm, noise=noise, seed=seed))


@pytest.mark.parametrize('pressure_std', [1000.0, 2000.0])
def test_a_noisy_pressure_does_not_lead_the_search_astray(pressure_std):
    """It did where it began with a straight arm: tables of 1000 1/m, and no way back."""
    names = enumerate(('unloaded_ramp', 'unloaded_staircase'))
    recordings = [recorded(pressure_std, name, 700100 + which) for which, name in names]
    true = true_model(recordings[0].scenario)
    runs = [run_of(recording) for recording in recordings]
    frame = replace(paper_arm(), target_arclength=true.target_arclength)
    noise = estimate_noise(runs, frame.target_arclength, frame.sensors)
    frame = replace(frame, sensors=replace(noise.noise, pressure_std=pressure_std))
    noise = replace(noise, noise=frame.sensors)
    found = FitSequence(frame, noise, runs, lambda *_: None).first_experiment(runs)
    assert found.converged
    assert found.chi_squared < 2.0 * found.dof  # 1e3 times as much when it was lost
    places = np.linspace(0.1, 0.9, 9)
    for pressure in (1e4, 3e4, 5e4):
        error = found.arm.intrinsic_curvature.at(pressure, places) - (
            true.intrinsic_curvature.at(pressure, places)
        )
        assert np.abs(error).max() < 2.0
