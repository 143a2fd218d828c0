"""The virtual lab beside calibration and diagnosis: its recordings as runs, its arm as a model."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from pneunet_ros.core.units import quantities, STANDARD_GRAVITY
from pneunet_ros.effects import EFFECTS
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from pneunet_ros.model.uncertainty import SensorNoise

# The sensors that the lab has: all but the one that measures the heading of the tip.
LAB_SENSORS = tuple(
    item.name for item in fields(SensorNoise) if not item.name.startswith(('heading_', 'row_'))
)
KNOTS = 41  # of the true model's splines, which are then within 1e-6 m of the truth at the tip


def nearest_stamps(stamp_ns: np.ndarray, wanted_ns: np.ndarray) -> np.ndarray:
    """Return the index of the nearest of increasing stamps to each one wanted."""
    after = np.clip(np.searchsorted(stamp_ns, wanted_ns), 1, stamp_ns.size - 1)
    return after - (wanted_ns - stamp_ns[after - 1] <= stamp_ns[after] - wanted_ns)


def readings_at_frames(recording: LabRecording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest pressure reading of each frame, and its force (n, 2) and moment (n,)."""
    reading = nearest_stamps(recording.reading_stamp_ns, recording.stamp_ns)
    if not recording.loaded:
        return reading, np.zeros((reading.size, 2)), np.zeros(reading.size)
    wrench = nearest_stamps(recording.wrench_stamp_ns, recording.stamp_ns)
    return reading, recording.wrench_force[wrench], recording.wrench_moment[wrench]


def run_of(recording: LabRecording) -> RecordingData:
    """Return the run in a recording of the virtual lab; frames without any target are left out."""
    kept = np.isfinite(recording.x).any(axis=1)
    reading, force, moment = (column[kept] for column in readings_at_frames(recording))
    return RecordingData(
        name=recording.scenario.name,
        reading_stamp_ns=recording.reading_stamp_ns,
        pressure=recording.pressure,
        stamp_ns=recording.stamp_ns[kept],
        reading=reading,
        loaded=recording.loaded,
        force=force,
        moment=moment,
        x=recording.x[kept],
        y=recording.y[kept],
        wrench_stamp_ns=recording.wrench_stamp_ns if recording.loaded else None,
        wrench=np.column_stack([recording.wrench_force, recording.wrench_moment])
        if recording.loaded
        else None,
        **({} if not recording.imu.size else gravity_of(recording, recording.stamp_ns[kept])),
    )


def gravity_of(recording: LabRecording, stamp_ns: np.ndarray) -> dict[str, np.ndarray]:
    """Return gravity as the accelerometer of a recording tells it, at frames and at its own."""
    read = -recording.imu[:, :2] / STANDARD_GRAVITY
    at_frames = [np.interp(stamp_ns, recording.imu_stamp_ns, column) for column in read.T]
    return {
        'gravity': np.column_stack(at_frames),
        'gravity_stamp_ns': recording.imu_stamp_ns,
        'gravity_read': read,
    }


def true_model(scenario: Scenario) -> Arm:
    """Return the model that knows the truth of a scenario, to score calibrated ones against.

    It has the arm's curvature and law, its effects as far as they are plain, and the noise of the
    sensors; of effects outside the model's library, and of where targets were painted by mistake,
    it does not know.
    """
    arm, noise = scenario.arm, scenario.noise
    arclength = np.linspace(0.0, 1.0, KNOTS)
    effects = []
    for effect in scenario.effects:
        kind = EFFECTS.get(effect.name)
        if kind is None:
            continue
        values = {item.name: getattr(effect, item.name) for item in quantities(kind)}
        effects.append(kind(**values))
    return Arm(
        name=f'{arm.name}, the truth',
        length=arm.length,
        weight=arm.weight,
        tip_cap=arm.tip_cap,
        clamp_angle=arm.clamp_angle,
        target_arclength=arm.targets,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=arm.curvature_pressure,
            arclength=arclength,
            curvature=arm.intrinsic_curvature(arclength * arm.length),
        ),
        moment_law=PiecewiseLinearLaw(
            pressure=arm.law_pressure,
            split=arm.split,
            rigidity=arm.rigidity,
            moment_offset=np.zeros_like(arm.rigidity),
        ),
        effects=tuple(effects),
        sensors=SensorNoise(**{name: getattr(noise, name) for name in LAB_SENSORS}),
    )
