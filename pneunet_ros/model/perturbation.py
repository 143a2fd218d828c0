"""How the record of a rod changes with pressure and along the columns of a model's covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import reduce
from itertools import groupby

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.effects.effect import History, Terms
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import over_meters
from pneunet_ros.model.neighbors import DEFAULTS, DifferenceSettings, neighbors
from pneunet_ros.solver.columns import CLAMP_ANGLE, CLAMP_WIDTH
from pneunet_ros.solver.rod import Rods, RodTable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Perturbation:
    """Small changes of the record of a rod, one per cause: the records on both sides of it.

    The first axes are side (before, after) and cause, the others those of `Rods`: length (2,
    causes), sections (2, causes, sections, 8), clamp (2, causes, 3), knots (2, causes, pieces +
    1), rotation (2, causes, pieces, 5). distance (causes,): how far the sides are apart.
    """

    length: Array
    sections: Array
    clamp: Array
    knots: Array
    rotation: Array
    distance: Array

    @classmethod
    def between(cls, before: Rods, after: Rods, distance: float) -> Perturbation:
        """Return the change from one record to another."""
        sides = (before, after)
        return cls(
            length=np.array([[side.length] for side in sides]),
            sections=np.array([side.sections[:1] for side in sides]),
            clamp=np.array([side.clamp[:1] for side in sides]),
            knots=np.array([[side.knots] for side in sides]),
            rotation=np.array([side.rotation[:1] for side in sides]),
            distance=np.array([distance]),
        )

    def moved(self, rods: Rods, amounts: Array) -> Rods:
        """Return a record (the first of `rods`) moved by so much of each cause, (causes,)."""
        if not amounts.any():
            return rods
        shares = amounts / self.distance

        def change(sides: Array) -> Array:
            between = sides[1] - sides[0]
            return np.asarray(
                (shares @ between.reshape(shares.size, -1)).reshape(between.shape[1:])
            )

        return Rods(
            length=rods.length + float(change(self.length)),
            pressure=rods.pressure,
            sections=rods.sections + change(self.sections),
            clamp=rods.clamp + change(self.clamp),
            knots=freeze(rods.knots + change(self.knots)),
            rotation=rods.rotation + change(self.rotation),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PerturbationTable:
    """An arm and its neighbors along the columns of its covariance, as one table over pressure.

    Curvature and moment law are linear in pressure between rows, so the records of all neighbors
    are one linear table on the rows of them all. It holds what effects add at every pressure
    alike; what they add by pressure or history is added at each call.

    further: columns after those of the covariance, which no calibration knows: by how much each
    quantity moves in one unit; neighbors: the arm before each column, then the arm after each;
    distance (1 + columns,): how far the sides are apart, of the pressure in Pa, then of the
    columns in sigma.
    """

    arm: Arm
    settings: DifferenceSettings = DEFAULTS
    further: tuple[Mapping[str, float], ...] = ()
    neighbors: tuple[Arm, ...] = field(init=False, repr=False)
    distance: Array = field(init=False, repr=False)
    length: Array = field(init=False, repr=False)
    knots: Array = field(init=False, repr=False)
    clamp: Array = field(init=False, repr=False)
    table: RodTable = field(init=False, repr=False)
    row_rotation: Array = field(init=False, repr=False)
    changing: tuple[int, ...] = field(init=False, repr=False)
    alike: tuple[tuple[slice, Arm], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Stack the neighbors."""
        arm = self.arm
        known = () if arm.covariance is None else arm.covariance.columns()
        columns = (*known, *self.further)
        pairs = [neighbors(arm, column, self.settings) for column in columns]
        befores, afters = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
        sides = tuple(befores + afters)
        by_cause = [[arm, *befores], [arm, *afters]]
        distance = [2.0 * pressure_step(arm, self.settings), *(pair[2] for pair in pairs)]
        rows = reduce(np.union1d, (side.table.pressure for side in sides), arm.table.pressure)
        clamp = np.zeros((len(sides), CLAMP_WIDTH))
        terms = [effect.terms(rows) for effect in arm.effects]
        changing = tuple(place for place, item in enumerate(terms) if depends_on_pressure(item))
        sections, rotation = [], []
        for place, side in enumerate(sides):
            records = side.table.at(rows)
            clamp[place, CLAMP_ANGLE] = side.clamp_angle
            for number, effect in enumerate(side.effects):
                if number not in changing:
                    side.add_terms(effect.terms(rows), records[0], clamp[place : place + 1])
            sections.append(records[0])
            rotation.append(records[1])
        stacked = RodTable(
            pressure=rows,
            sections=np.concatenate(sections or [arm.table.sections[:, :0]], axis=1),
            rotation=np.concatenate(rotation or [arm.table.rotation[:, :0]], axis=1),
        )
        values = {
            'neighbors': sides,
            'distance': np.array(distance),
            'length': np.array([[item.reach for item in side] for side in by_cause]),
            'knots': np.array([[item.knots for item in side] for side in by_cause]),
            'clamp': clamp,
            'table': stacked,
            'row_rotation': np.array(
                [
                    side.with_cap(over_meters(side.intrinsic_curvature.rotation, side.length))
                    for side in sides
                ]
            ),
            'changing': changing,
            'alike': group_equal_terms(sides, changing),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def at(
        self, pressure: float, history: tuple[History, ...] | None = None
    ) -> tuple[Rods, Perturbation]:
        """Return the record of the rod at a chamber pressure (Pa), and its changes.

        The causes are a sudden change of the pressure, per Pa, then each column of the covariance,
        per sigma. The neighbors have the arm's own history: what other parameters would have made
        of it is left out.
        """
        step = 0.5 * float(self.distance[0])
        rods = self.arm.rods(np.array([pressure, pressure - step, pressure + step]), history)
        count = self.distance.size
        sections, clamp, rotation = (
            part[1:, None] for part in (rods.sections, rods.clamp, rods.rotation)
        )
        if count > 1:
            records = self.neighbor_records(pressure, history, sections.shape[2])
            sections, clamp, rotation = (
                np.concatenate([part, of_columns.reshape(2, count - 1, *part.shape[2:])], axis=1)
                for part, of_columns in zip((sections, clamp, rotation), records, strict=True)
            )
        change = Perturbation(
            length=self.length,
            sections=sections,
            clamp=clamp,
            knots=self.knots,
            rotation=rotation,
            distance=self.distance,
        )
        return rods.record(0), change

    def neighbor_records(
        self, pressure: float, history: tuple[History, ...] | None, kinds: int
    ) -> tuple[Array, Array, Array]:
        """Return sections, clamp and rotation of all neighbors at one pressure (Pa)."""
        at = np.array([pressure])
        sections, rotation = self.table.at(at)
        sections = sections.reshape(len(self.neighbors), kinds, -1)
        rotation = rotation.reshape(len(self.neighbors), *self.arm.table.rotation.shape[1:])
        clamp = self.clamp.copy()
        for which, arm in self.alike:
            terms = [arm.effects[place].terms(at) for place in self.changing]
            for item in (*terms, *arm.history_terms(history)):
                arm.add_terms(item, sections[which], clamp[which])
                if item.row_weights is not None:
                    mixture = np.tensordot(item.row_weights, self.row_rotation[which], axes=(0, 1))
                    rotation[which] = item.mix_rows(rotation[which], mixture)
        return sections, clamp, rotation


def depends_on_pressure(terms: Terms) -> bool:
    """Whether what an effect adds depends on the pressure."""
    return any(isinstance(getattr(terms, item.name), np.ndarray) for item in fields(terms))


def group_equal_terms(
    arms: tuple[Arm, ...], changing: tuple[int, ...]
) -> tuple[tuple[slice, Arm], ...]:
    """Return runs of arms in which effects by pressure or history are the same."""
    runs: list[tuple[slice, Arm]] = []
    if not (arms and (changing or arms[0].history_dependent)):
        return ()

    def key(arm: Arm) -> object:
        by_history = [arm.acting[place] for place in arm.history_dependent]
        return [arm.effects[place] for place in changing], by_history, arm.scale

    first = 0
    for _, group in groupby(arms, key):
        size = len(list(group))
        runs.append((slice(first, first + size), arms[first]))
        first += size
    return tuple(runs)


def pressure_step(arm: Arm, settings: DifferenceSettings) -> float:
    """Return the step of the chamber pressure, Pa."""
    low, high = arm.table_range
    return settings.pressure_step * (high - low)


def with_pressure_change(
    arm: Arm,
    chamber_pressure: float,
    history: tuple[History, ...] | None = None,
    settings: DifferenceSettings = DEFAULTS,
) -> tuple[Rods, Perturbation]:
    """Return the record of the rod at a chamber pressure (Pa), its change per sudden pascal."""
    step = pressure_step(arm, settings)
    pressures = [chamber_pressure, chamber_pressure - step, chamber_pressure + step]
    rods = arm.rods(np.array(pressures), history)
    return rods.record(0), Perturbation.between(rods.record(1), rods.record(2), 2.0 * step)
