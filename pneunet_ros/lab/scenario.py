"""A scenario of the virtual lab: arm, effects, protocol, sensors and camera."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, quantity
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_effect import LabEffect, RichEffect, RICHNESS
from pneunet_ros.lab.lab_effects import LabInertia
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.outside_effects import ALL_EFFECTS
from pneunet_ros.lab.protocols import Protocol
from pneunet_ros.lab.sensors import LabNoise, Rates

Changes = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Detail:
    """Resolution of the truth: elements and stations, whole numbers."""

    elements: float = quantity(448.0, unit='-', meaning='elements of the chain', bounds=(8.0, 1e5))
    stations: float = quantity(
        113.0, unit='-', meaning='stations of the ground truth', bounds=(2.0, 1e5)
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, 'detail', RequestError)
        for name in ('elements', 'stations'):
            if not float(getattr(self, name)).is_integer():
                raise RequestError(
                    f'detail.{name} = {getattr(self, name)} is not a whole number',
                    reason='not_a_number',
                )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """Complete definition of a recording of the virtual lab, which is reproducible.

    `seed` determines the noise of this recording; the arm has its own seed for its parameters and
    painted targets. `richness` applies to effects that are added later. `start` (s): beginning of
    the recording in lab time. With `motion` the arm has mass and is simulated by MuJoCo; without
    it the arm is always in equilibrium.
    """

    name: str
    seed: int = 0
    start: float = quantity(
        0.0, unit='s', meaning=('lab time at which the recording begins'), bounds=(0.0, 1e8)
    )
    arm: LabArm
    effects: tuple[LabEffect, ...] = ()
    richness: float = field(default=0.0, metadata=RICHNESS.metadata)
    protocol: Protocol
    noise: LabNoise = field(default_factory=LabNoise)
    rates: Rates = field(default_factory=Rates)
    detail: Detail = field(default_factory=Detail)
    motion: LabMotion | None = None

    def __post_init__(self) -> None:
        """Check consistency, and sort the effects in the order of their table."""
        check_quantities(self, 'scenario', RequestError)
        names = [effect.name for effect in self.effects]
        if len(set(names)) < len(names):
            raise RequestError(
                f'an effect is given twice: {", ".join(names)}', reason='given_twice'
            )
        order = list(ALL_EFFECTS)
        effects = sorted(self.effects, key=lambda effect: order.index(effect.name))
        object.__setattr__(self, 'effects', tuple(effects))

    @property
    def effective_motion(self) -> LabMotion | None:
        """The motion, overridden by the nonzero numbers of the effect `inertia`."""
        for effect in self.effects:
            if isinstance(effect, LabInertia) and (effect.tip_mass or effect.damping_time):
                known = self.motion or LabMotion(damping_time=0.0)
                return dataclasses.replace(
                    known,
                    tip_mass=effect.tip_mass or known.tip_mass,
                    damping_time=effect.damping_time or known.damping_time,
                )
        return self.motion

    def with_effects(self, changes: Changes) -> Scenario:
        """Return this scenario with parameters of effects changed; missing effects are added."""
        effects = {effect.name: effect for effect in self.effects}
        for name, parameters in changes.items():
            known = effects.get(name)
            given = dataclasses.asdict(known) if known is not None else {}
            effects[name] = lab_effect(name, given | dict(parameters), self.richness)
        return dataclasses.replace(self, effects=tuple(effects.values()))


def lab_effect(name: str, parameters: Mapping[str, float], richness: float = 0.0) -> LabEffect:
    """Return an effect by its name; RequestError lists the known names and parameters.

    richness: of a rich effect whose parameters do not state one.
    """
    if name not in ALL_EFFECTS:
        raise RequestError(
            f'unknown effect {name}; known effects: {", ".join(ALL_EFFECTS)}', reason='unknown_key'
        )
    kind = ALL_EFFECTS[name]
    known = [item.name for item in dataclasses.fields(kind)]
    for parameter in parameters:
        if parameter not in known:
            raise RequestError(
                f'effects.{name} has no parameter {parameter}; it has {", ".join(known)}',
                reason='unknown_key',
            )
    rich = {'richness': richness} if issubclass(kind, RichEffect) else {}
    return kind(**(rich | dict(parameters)))


def describe(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as plain numbers, texts and lists, with infinity as text for JSON."""
    protocol = as_plain(scenario.protocol)
    return {
        **{name: as_plain(getattr(scenario, name)) for name in ('name', 'seed', 'start', 'arm')},
        'effects': {effect.name: as_plain(effect) for effect in scenario.effects},
        'protocol': {'kind': scenario.protocol.kind, **protocol},
        **{name: as_plain(getattr(scenario, name)) for name in ('noise', 'rates', 'detail')},
        **({} if scenario.motion is None else {'motion': as_plain(scenario.motion)}),
    }


def as_plain(value: Any) -> Any:
    """Convert a dataclass, an array, a tuple or a number to JSON values."""
    if dataclasses.is_dataclass(value):
        return {
            item.name: as_plain(getattr(value, item.name)) for item in dataclasses.fields(value)
        }
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return [as_plain(item) for item in value]
    return str(value) if isinstance(value, float) and math.isinf(value) else value
