"""Configuration of the virtual arm from its parameters, accepted or rejected as a whole."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from pneunet_ros import __version__
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.settings import check_settings, setting
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import quantity
from pneunet_ros.files.scenario_file import changes_of, load_lab
from pneunet_ros.lab.live import LiveLab, Valve
from pneunet_ros.lab.scenario import describe
from pneunet_ros.lab.sensors import noiseless
from pneunet_ros.nodes.parameters import ParameterTable

SHIPPED_ARM = 'scenarios/lab_arm.yaml'


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualArmSettings:
    """Settings of the simulated arm and its sensors."""

    scenario_file: str = setting(
        '', f'file of a lab arm, or of a scenario with one; empty: the shipped {SHIPPED_ARM}'
    )
    effects: str = setting(
        '',
        (
            'hidden effects in addition to those in the file: NAME.PARAMETER=VALUE, separated '
            'by spaces'
        ),
    )
    seed: int = setting(0, 'random seed of the noise', bounds=(0, 2**31 - 1))
    noise: bool = setting(True, 'add sensor noise, and small errors of the painted targets')
    rate: float = quantity(
        100.0, unit='Hz', meaning='rate of pressure and end_wrench', bounds=(1.0, 1000.0)
    )
    frame_rate: float = quantity(
        10.0, unit='Hz', meaning='rate of targets or images', bounds=(0.1, 100.0)
    )
    camera: str = setting(
        'targets',
        ('output of the camera: targets, as from a tracker; images, for the tracker; or none'),
        ('targets', 'images', 'none'),
    )
    swing_period: float = quantity(
        0.0,
        unit='s',
        meaning=(
            'period of inflating and deflating until the first command; 0: the arm stays at rest'
        ),
        bounds=(0.0, 1e4),
    )
    frame_id: str = setting(BASE_FRAME, 'frame of end_wrench, targets and true_tip, at the clamp')

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)
        if not self.frame_id:
            raise RequestError('frame_id must not be empty', reason='empty')

    @property
    def path(self) -> Path:
        """Path of the file of the arm or scenario."""
        return Path(self.scenario_file) if self.scenario_file else share_path(SHIPPED_ARM)


PARAMETERS = ParameterTable(
    owners=(VirtualArmSettings, Valve),
    read_only=frozenset({'seed', 'rate', 'frame_rate', 'camera', 'frame_id'}),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualArmConfiguration:
    """A live lab with the settings of its node."""

    node: VirtualArmSettings
    lab: LiveLab

    @property
    def model(self) -> str:
        """Name of the arm."""
        return f'{self.lab.scenario.arm.name}, virtual'

    def info(self) -> str:
        """Return the content of the topic lab_info: the truth."""
        about = describe(self.lab.scenario)
        described = {name: about[name] for name in ('arm', 'effects', 'noise', 'seed')}
        return json.dumps({'file': str(self.node.path), **described, 'version': __version__})


def configured_virtual_arm(
    values: Mapping[str, Any], current: VirtualArmConfiguration | None
) -> VirtualArmConfiguration:
    """Build the configuration from all parameter values.

    Keeps the arm of `current` if the scenario file has not changed. Raises PneunetError for
    invalid values.
    """
    node, valve = PARAMETERS.settings(values)
    scenario = load_lab(node.path)
    arm, noise = scenario.arm, scenario.noise
    if current is not None and node.scenario_file == current.node.scenario_file:
        arm = current.lab.scenario.arm
    if not node.noise:
        noise = noiseless()
    scenario = dataclasses.replace(scenario, arm=arm, noise=noise, seed=node.seed)
    scenario = scenario.with_effects(changes_of(node.effects.split()))
    return VirtualArmConfiguration(node=node, lab=LiveLab(scenario=scenario, valve=valve))
