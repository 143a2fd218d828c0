"""Reference: the held-out recordings, predicted by the true arm from the same noisy readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.lab.chain import equilibrium_shape
from pneunet_ros.lab.lab_recording import LabMemory, LabRecording
from pneunet_ros.lab.sensors import regular_times
from pneunet_ros.lab.simulation import chain_of, follow_arm, read_sensors
from pneunet_ros.lab.timeline import Timeline
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm
from support.lab_run import readings_at_frames

from blind.trials import Sealed


def residual_of(run: RecordingData, points: np.ndarray) -> np.ndarray:
    """Return measured minus predicted (frames, 2, targets) m, less what registration could be."""
    error = np.stack([run.x, run.y], axis=1) - points
    return error - np.nanmean(error, axis=(0, 2), keepdims=True)


def pooled_rms(errors: Sequence[np.ndarray]) -> float | None:
    """Return the rms (m) per coordinate over runs, None where nothing was seen and solved."""
    some = np.concatenate([error[np.isfinite(error)] for error in errors])
    return float(np.sqrt(np.mean(some**2))) if some.size else None


def plain_rms(
    arm: Arm, training: Sequence[RecordingData], held_out: Sequence[RecordingData]
) -> float | None:
    """Return the rms (m) that a model leaves held out, what came before being remembered."""
    errors = []
    all_inputs = inputs_of(arm, (*training, *held_out))[len(training) :]
    for run, inputs in zip(held_out, all_inputs, strict=True):
        series = ForwardModel(arm.target_arclength)
        solved = series.solve(arm, inputs)
        errors.append(residual_of(run, np.where(solved[:, None, None], series.points, np.nan)))
    return pooled_rms(errors)


def lab_rms(sealed: Sealed, held_out: Sequence[RecordingData]) -> float | None:
    """Return the rms (m) that the lab's own arm leaves, driven by what the sensors read.

    It knows all that is hidden, however rich, and nothing of noise and of painting.
    """
    start = len(sealed.recordings) - len(held_out)
    errors = []
    for place, run in enumerate(held_out, start=start):
        recording = sealed.recordings[place]
        before = sealed.recordings[place - 1].memory
        kept = np.isfinite(recording.x).any(axis=1)  # as of `run_of`
        errors.append(residual_of(run, driven(recording, before)[kept]))
    return pooled_rms(errors)


def driven(recording: LabRecording, before: LabMemory) -> np.ndarray:
    """Return where the lab puts the targets (frames, 2, targets) m if the readings were true.

    The noise of the readings is added to the true pressures and forces.
    """
    scenario, truth = recording.scenario, recording.truth
    events = scenario.protocol.timeline()
    times = regular_times(scenario.rates.pressure, events.duration)
    pressure, force = events.pressure_at(times), events.force_at(times)
    clean_pressure, clean_force = read_sensors(scenario, pressure, force)
    if recording.loaded:
        hanging = np.abs(force).max(axis=1) > 0.0
        force = force + (recording.wrench_force - clean_force) * hanging[:, None]
    noisy = Timeline(
        time=times,
        pressure=pressure + recording.pressure - clean_pressure,
        force=force,
        loaded=recording.loaded,
    )
    course, _ = follow_arm(scenario, noisy, before)
    chain = chain_of(scenario, course, truth.time, noisy.force_at(truth.time))
    # There is no moment: all of it is noise.
    chain = replace(chain, moment=readings_at_frames(recording)[2])
    x, y, _ = equilibrium_shape(chain).points(scenario.arm.targets)
    points, share = np.stack([x, y], axis=-1), truth.time / events.duration
    for effect in scenario.effects:
        points = effect.see(scenario.arm, points, share)
    return np.moveaxis(points, -1, 1)
