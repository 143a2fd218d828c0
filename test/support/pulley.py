"""Recordings of a tip that is pulled, by a constant force or by a string over a pulley."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.outside_effects import LabPulley
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData

from support.lab_run import run_of

PRESSURES = (5e3, 5e3, 25e3, 25e3, 45e3, 45e3, 60e3, 60e3)  # Pa


def pulled(tension: float, eye: float | None, seed: int, seconds: float = 20.0) -> RecordingData:
    """Return a recording without a force sensor: the tip is pulled by so many N along E1.

    eye: how far (m) beyond the tip of the straight arm the pulley is; None: always along E1.
    """
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    share = tuple(np.linspace(0.0, 1.0, len(PRESSURES)).tolist())
    protocol = Corners(
        duration=seconds,
        share=share,
        pressure=PRESSURES,
        force_x=(tension,) * len(share),
        force_y=(0.0,) * len(share),
    )
    effects = () if eye is None else (LabPulley(eye_x=scenario.arm.reach + eye),)
    scenario = replace(
        scenario, name=f'pulled by {tension:g} N', seed=seed, protocol=protocol, effects=effects
    )
    return run_of(simulate(scenario)).without_load()
