"""An arm of the virtual lab on which experiments are made one after the other, as files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pneunet_ros.diagnosis.experiment_design import Experiment
from pneunet_ros.diagnosis.exploration import EXPLORATION, ExplorationSettings, SafeSet
from pneunet_ros.lab.lab_recording import LabMemory
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.recordings.lab_files import write_lab


@dataclass(slots=True, kw_only=True)
class SimulatedArm:
    """The arm of a scenario, which remembers what was done to it; its protocol is not used."""

    scenario: Scenario
    settings: ExplorationSettings = EXPLORATION
    memory: LabMemory | None = None

    def record(self, experiment: Experiment, safe: SafeSet, path: Path) -> None:
        """Write the recording of an experiment, and the truth beside it."""
        start = self.scenario.start
        if self.memory is not None:
            start = self.memory.time + self.settings.between
        scenario = replace(
            self.scenario, name=path.stem, start=start, protocol=corners_of(experiment, safe)
        )
        recording = simulate(scenario, self.memory)
        self.memory = recording.memory
        write_lab(recording, path, overwrite=False, on_progress=lambda: None)


def corners_of(experiment: Experiment, safe: SafeSet) -> Corners:
    """Return an experiment as the lab's protocol, within the safe set."""
    time, share, x, y = np.array(experiment.corners, dtype=np.float64).T
    return Corners(
        duration=experiment.seconds,
        time=tuple(time.tolist()),
        pressure=tuple((safe.low + (safe.high - safe.low) * share).tolist()),
        force_x=tuple((safe.force * x).tolist()),
        force_y=tuple((safe.force * y).tolist()),
    )
