"""Recordings of the virtual lab with an effect hidden, few frames of each, around a base model.

The base model is fitted once, to recordings without any effect; others begin there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import functools

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.fit.base_fit import fit_base
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis, hypothesis
from pneunet_ros.diagnosis.fit.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.fit.refit import Refit, refit
from pneunet_ros.effects import EFFECTS
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise

from support.lab_run import LAB_SENSORS, run_of

FRAMES = 24
TRAINING = ('unloaded_ramp', 'unloaded_staircase', 'strings', 'force_sweeps')
HELD_OUT = 'random_mix'
HIDDEN: Mapping[str, Mapping[str, float]] = {
    'load_offset': {'offset': 0.006},
    'extensibility': {'axial_stiffness': 20.0},
    'force_misalignment': {'angle': 0.09},
    'hysteresis': {'width': 3.5e3},
    'softening': {'loss': 0.3},
}
BETWEEN = 5.0  # s from one recording to the next


@functools.cache
def recorded(effect: str = '', day: int = 0) -> tuple[RecordingData, ...]:
    """Return the recordings of one day, the last held out; effect: the one of HIDDEN in it."""
    hidden = {effect: HIDDEN[effect]} if effect else {}
    memory, start, runs = None, 0.0, []
    for place, name in enumerate((*TRAINING, HELD_OUT)):
        scenario = load_scenario(share_path(f'scenarios/{name}.yaml')).with_effects(hidden)
        scenario = replace(scenario, seed=100 * day + place, start=start)
        recording = simulate(scenario, memory)
        memory = recording.memory
        start = memory.time + BETWEEN
        runs.append(run_of(recording))
    return tuple(runs)


@functools.cache
def frame() -> Arm:
    """Return the arm that is fitted: what is known of the lab's without any recording."""
    scenario = load_scenario(share_path('scenarios/strings.yaml'))
    return replace(
        load_model(share_path('config/paper_arm.yaml')), target_arclength=scenario.arm.targets
    )


@functools.cache
def noise() -> SensorNoise:
    """Return the noise of the lab's sensors."""
    own = load_scenario(share_path('scenarios/strings.yaml')).noise
    return SensorNoise(**{name: getattr(own, name) for name in LAB_SENSORS})


@functools.cache
def base() -> Fit:
    """Return the base model fitted to the recordings without any effect."""
    return fit_base(frame(), recorded()[: len(TRAINING)], lambda *stage: None)


@functools.cache
def design(effect: str = '', day: int = 0) -> Linearization:
    """Return the recordings of a day around the base model."""
    fit = base()
    point = LinearizationPoint(
        parameters=fit.parameters, values=fit.values, placement=fit.placement, origin=fit.origin
    )
    runs = [run.thin(FRAMES) for run in recorded(effect, day)]
    return Linearization(point, runs, len(TRAINING), noise())


def asked(name: str) -> Hypothesis:
    """Return an effect of the table as a hypothesis."""
    return hypothesis(EFFECTS[name], frame().size)


@functools.cache
def fitted(effect: str = '', hidden: str = '', day: int = 0) -> Refit:
    """Return the joint fit of an effect, none if empty, to the recordings with a hidden one."""
    items = (asked(effect),) if effect else ()
    start = items[0].starts()[0][1] if items else np.zeros(0)
    found = refit(design(hidden, day), items, start, 3)
    assert found is not None
    return found
