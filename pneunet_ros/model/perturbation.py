"""Derivatives of a rod record by pressure and by the columns of the model's covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import groupby
from typing import Any, Final

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import ModelError
from pneunet_ros.effects.effect import History, Load, NOTHING, Terms
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import over_meters
from pneunet_ros.model.record import Record
from pneunet_ros.solver.columns import CLAMP_WIDTH, LOAD_X, LOAD_Y, LOADS
from pneunet_ros.solver.rod import Rods, RodTable

COLUMN_STEP = 0.01  # sigma; step of a central difference along a column of the covariance
PRESSURE_STEP = 1e-5  # of the calibrated range; step of a central difference
# Of weight and length; step of a central difference, for loads changed by effects.
LOAD_STEP = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Perturbation:
    """Small changes of a rod record, one per cause, as records on both sides.

    The first axes are side (before, after) and cause, the others those of `Rods`: length (2,
    causes), sections (2, causes, sections, 8), clamp (2, causes, 5), knots (2, causes, pieces +
    1), rotation (2, causes, pieces, 5), push (2, causes, pushes, sections), push_place (2, causes,
    pushes). distance (causes,) between the sides. by_load: whether the last three causes are F1
    and F2 (per N) and M (per N m), on which the record depends through effects. same_places:
    whether length and knots equal those of the rod on all sides.
    """

    length: Array
    sections: Array
    clamp: Array
    knots: Array
    rotation: Array
    push: Array
    push_place: Array
    distance: Array
    by_load: bool = False
    same_places: bool = False

    @classmethod
    def between(
        cls, before: Rods, after: Rods, distance: float | Array, by_load: bool = False
    ) -> Perturbation:
        """Return finite differences of records (causes,)."""
        sides, causes = (before, after), len(before.sections)
        return cls(
            length=np.array([[side.length] * causes for side in sides]),
            sections=np.array([side.sections for side in sides]),
            clamp=np.array([side.clamp for side in sides]),
            knots=np.array([[side.knots] * causes for side in sides]),
            rotation=np.array([side.rotation for side in sides]),
            push=np.array([side.push for side in sides]),
            push_place=np.array([[side.push_place] * causes for side in sides]),
            distance=np.full(causes, distance),
            by_load=by_load,
        )

    def followed_by(self, other: Perturbation) -> Perturbation:
        """Return causes with others inserted before those of the loads, which stay last."""
        if self.by_load:
            without_loads = self.without_loads()
            return without_loads.followed_by(other).followed_by(self.of_loads())
        combined: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)], axis=1)
            for name in TABLES
        }
        distance = np.concatenate([self.distance, other.distance])
        return Perturbation(
            **combined,
            distance=distance,
            by_load=other.by_load,
            same_places=self.same_places and other.same_places,
        )

    def causes(self, which: slice, by_load: bool) -> Perturbation:
        """Return some of the causes."""
        parts: dict[str, Any] = {name: getattr(self, name)[:, which] for name in TABLES}
        return Perturbation(
            **parts, distance=self.distance[which], by_load=by_load, same_places=self.same_places
        )

    def sides(self, rods: Rods) -> tuple[Rods, Rods]:
        """Return the records before and after each cause, with the pushes of `rods`."""
        before, after = (
            rods._replace(sections=self.sections[side], push=self.push[side]) for side in (0, 1)
        )
        return before, after

    def without_loads(self) -> Perturbation:
        """Return the causes except those of the loads."""
        return self.causes(slice(-LOADS), by_load=False) if self.by_load else self

    def of_loads(self) -> Perturbation:
        """Return the causes that are the loads."""
        return self.causes(slice(-LOADS, None), by_load=True)

    def pointed(self, heading: Array) -> Perturbation:
        """Return the changes with pushes along the normals of headings (pushes,) rad."""
        if not heading.size:
            return self
        sections = self.sections.copy()
        for column, normal in ((LOAD_X, -np.sin(heading)), (LOAD_Y, np.cos(heading))):
            sections[..., column] += np.einsum('scpk,p->sck', self.push, normal)
        return replace(
            self, sections=sections, push=self.push[:, :, :0], push_place=self.push_place[:, :, :0]
        )

    def moved(self, rods: Rods, amounts: Array) -> Rods:
        """Return a record (the first of `rods`) moved by amounts of each cause, (causes,).

        The load causes are omitted, because the record already includes the changes by the loads.
        """
        if not amounts.any():
            return rods
        size = amounts.size
        shares = amounts / self.distance[:size]

        def change(sides: Array) -> Array:
            before, after = sides[:, :size].reshape(2, size, -1)
            return (shares @ (after - before)).reshape(sides.shape[2:])

        length, knots, push, places = rods.length, rods.knots, rods.push, rods.push_place
        if not self.same_places:
            length, knots = length + float(change(self.length)), freeze(knots + change(self.knots))
        if places.size:
            push, places = push + change(self.push), places + change(self.push_place)
        return Rods(
            length=length,
            pressure=rods.pressure,
            sections=rods.sections + change(self.sections),
            clamp=rods.clamp + change(self.clamp),
            knots=knots,
            rotation=rods.rotation + change(self.rotation),
            push=push,
            push_place=places,
        )


TABLES = tuple(
    item.name
    for item in fields(Perturbation)
    if item.name not in ('distance', 'by_load', 'same_places')
)


class PerturbationTable:
    """An arm and its neighbors along the columns of its covariance, as one table over pressure.

    Curvature and moment law are linear in pressure between rows, so the records of all neighbors
    form one linear table over the union of their rows. Constant contributions of effects are
    included; contributions that depend on pressure or history are added at each call.

    neighbors: the arm before each column, then the arm after each; sides: the arm itself and the
    arms before each column, then the arm itself and the arms after each column. distance (1 +
    columns,) between the sides, in Pa for the pressure and in sigma for the columns; length, knots
    and same_places: as in `Perturbation`, independent of pressure. table, clamp: those of all
    sides; own: the table of the arm alone.
    """

    def __init__(self, *, arm: Arm, further: Sequence[Mapping[str, float]] = ()) -> None:
        """Stack the neighbors.

        further: columns in addition to those of the covariance, as the change of each quantity per
        unit.
        """
        self.arm: Final = arm
        known = () if arm.covariance is None else arm.covariance.columns()
        pairs = [neighbors(arm, column) for column in (*known, *further)]
        befores, afters = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
        by_cause = [[arm, *befores], [arm, *afters]]
        self.neighbors: Final = (*befores, *afters)
        self.sides: Final = (*by_cause[0], *by_cause[1])
        self.same_places: Final = all(
            side.reach == arm.reach and np.array_equal(side.knots, arm.knots)
            for side in self.sides
        )
        self.distance: Final = np.array([2.0 * pressure_step(arm), *(pair[2] for pair in pairs)])
        self.length: Final = np.array([[item.reach for item in side] for side in by_cause])
        self.knots: Final = np.array([[item.knots for item in side] for side in by_cause])
        rows = reduce(np.union1d, (side.table.pressure for side in self.sides), arm.table.pressure)
        clamp = np.zeros((len(self.sides), CLAMP_WIDTH))
        terms = [effect.terms(rows) for effect in arm.effects]
        self.changing: Final = tuple(
            place for place, item in enumerate(terms) if added_at_each_call(item)
        )
        sections, rotation = zip(
            *(
                constant_records(side, rows, self.changing, clamp[place : place + 1])
                for place, side in enumerate(self.sides)
            ),
            strict=True,
        )
        own = constant_records(arm, arm.table.pressure, self.changing, clamp[:1].copy())
        self.table: Final = RodTable(
            pressure=freeze(rows),  # kernels would be compiled again for writable arrays
            sections=freeze(np.concatenate(sections, axis=1)),
            rotation=freeze(np.concatenate(rotation, axis=1)),
        )
        self.own: Final = RodTable(
            pressure=arm.table.pressure, sections=freeze(own[0]), rotation=freeze(own[1])
        )
        self.clamp: Final = freeze(clamp)
        self.row_rotation: Final = np.array(
            [
                side.on_knots(over_meters(side.intrinsic_curvature.rotation, side.length))
                for side in self.sides
            ]
        )
        self.equal_terms: Final = group_equal_terms(self.sides, self.changing)

    def at(
        self, pressure: float, history: tuple[History, ...] | None = None, load: Load | None = None
    ) -> tuple[Rods, Perturbation]:
        """Return the rod record at a chamber pressure (Pa), and its changes.

        The causes are an instantaneous change of the pressure, per Pa, then each column of the
        covariance, per sigma, then the end load if effects depend on it. The neighbors share the
        history of the arm; the influence of parameters on the history is neglected.
        """
        arm, step = self.arm, 0.5 * float(self.distance[0])
        at = freeze(np.array([pressure]))
        sections, rotation = self.table.at(at)
        causes, count = self.distance.size, arm.table.sections.shape[1]
        sections, clamp = sections.reshape(2 * causes, count, -1), self.clamp
        gravity = gravity_of(load, 1)
        if gravity is not None:
            # The gravity of the arm is also that of its neighbors, because it was measured.
            gravity, clamp = arm.gravity.difference(gravity), clamp.copy()
            for side, one in enumerate(self.sides):
                own = slice(side, side + 1)
                one.add_gravity(sections[own], clamp[own], gravity)
            clamp = freeze(clamp)
        if not self.equal_terms:
            pressures = freeze(np.array([pressure, pressure - step, pressure + step]))
            own_sections, own_rotation = self.own.at(pressures)
            if gravity is not None:
                arm.add_gravity(own_sections, clamp[:1].copy(), gravity)
            sections = sections.reshape(2, causes, *own_sections.shape[1:])
            rotation = rotation.reshape(2, causes, *own_rotation.shape[1:])
            sections[:, 0], rotation[:, 0] = own_sections[1:], own_rotation[1:]
            rods = Rods(
                length=arm.reach,
                pressure=at,
                sections=own_sections[:1],
                clamp=clamp[:1],
                knots=arm.knots,
                rotation=own_rotation[:1],
                push=np.empty((1, 0, count)),
                push_place=np.empty(0),
            )
            return rods, Perturbation(
                length=self.length,
                sections=sections,
                clamp=clamp.reshape(2, causes, CLAMP_WIDTH),
                knots=self.knots,
                rotation=rotation,
                push=np.empty((2, causes, 0, count)),
                push_place=np.empty((2, causes, 0)),
                distance=self.distance,
                same_places=self.same_places,
            )
        every = near_records(arm, pressure, step, history, load)
        loads = None if load is None else load.row
        record = Record.without_pushes(
            sections, clamp.copy(), rotation.reshape(2 * causes, *arm.table.rotation.shape[1:])
        )
        record = join_records(
            [
                self.with_terms(record, which, side, at, history, loads)
                for which, side in self.equal_terms
            ]
        )
        change = Perturbation(
            length=self.length,
            sections=both_sides(every.sections, record.sections),
            clamp=both_sides(every.clamp, record.clamp),
            knots=self.knots,
            rotation=both_sides(every.rotation, record.rotation),
            push=both_sides(every.push, record.push),
            push_place=places_on_both_sides(every, record),
            distance=self.distance,
            same_places=self.same_places,
        )
        if arm.by_load:
            change = change.followed_by(load_change(arm, pressure, history, load))
        return every.record(0), change

    def with_terms(
        self,
        record: Record,
        which: slice,
        arm: Arm,
        at: Array,
        history: tuple[History, ...] | None,
        loads: Array | None,
    ) -> Record:
        """Return records of consecutive neighbors, including their pressure-dependent effects."""
        rows = self.row_rotation[which]
        own = Record.without_pushes(
            record.sections[which], record.clamp[which], record.rotation[which]
        )
        terms = [
            arm.without_neutral_part(arm.effects[place], arm.effects[place].terms(at))
            for place in self.changing
        ]
        terms += arm.further_terms(at, history, loads)

        def mixed(weights: Array) -> Array:
            return np.tensordot(weights, rows, axes=(0, 1))

        found = arm.add_to(terms, own, mixed)
        places = np.tile(found.push_place, (len(found.sections), 1))
        return replace(found, push_place=places)


def neighbors(arm: Arm, column: Mapping[str, float]) -> tuple[Arm, Arm, float]:
    """Return the arms displaced to both sides along a covariance column, and the step.

    column: change of each quantity by one sigma; the distance is in sigma. If a quantity would
    leave its bounds on one side, the arm itself is used there (one-sided difference). Raises
    ModelError if this happens on both sides.
    """
    sides, distance = [arm, arm], 0.0
    for side, sign in enumerate((-1.0, 1.0)):
        try:
            step = {name: sign * COLUMN_STEP * std for name, std in column.items()}
            sides[side] = arm.with_changes(step)
            distance += COLUMN_STEP
        except ModelError as error:
            reason = error
    if distance == 0.0:
        raise ModelError(
            f'covariance: a column moves a quantity out of bounds in both directions: {reason}',
            reason='out_of_bounds',
        )
    return sides[0], sides[1], distance


def constant_records(
    arm: Arm, rows: Array, changing: tuple[int, ...], clamp: Array
) -> tuple[Array, Array]:
    """Return sections and rotation of an arm at pressures (n,) Pa, with the constant effects.

    changing: effects to omit; clamp (1, 5): filled with the clamp record.
    """
    sections, rotation = arm.table.at(rows)
    clamp[:] = arm.clamp_record
    for number, effect in enumerate(arm.effects):
        if number not in changing:
            arm.add_terms(effect.terms(rows), sections, clamp)
    return sections, rotation


def both_sides(record: Array, sides: Array) -> Array:
    """Return numbers on both sides (2, 1 + columns, ...) of a pressure and of all columns.

    record (3, ...): at the pressure, before it and after it; sides (2 + 2 columns, ...), which are
    overwritten: at the pressure and before each column, then at the pressure and after each
    column.
    """
    two_sided = sides.reshape(2, len(sides) // 2, *record.shape[1:])
    two_sided[:, 0] = record[1:]
    return two_sided


def places_on_both_sides(every: Rods, records: Record) -> Array:
    """Return positions of pushes (2, 1 + columns, pushes) m; arguments as in `both_sides`."""
    places = every.push_place
    if not places.size:
        return np.empty((2, len(records.sections) // 2, 0))
    return both_sides(np.array([places] * 3), records.push_place)


def join_records(records: Sequence[Record]) -> Record:
    """Concatenate the records of consecutive neighbors."""
    return Record(
        **{
            item.name: np.concatenate([getattr(one, item.name) for one in records])
            for item in fields(Record)
        }
    )


def added_at_each_call(terms: Terms) -> bool:
    """Whether an effect depends on the pressure, or adds more than section numbers."""
    if terms.part is not None or terms.curvature is not NOTHING:
        return True
    return any(isinstance(getattr(terms, item.name), np.ndarray) for item in fields(terms))


def group_equal_terms(
    arms: tuple[Arm, ...], changing: tuple[int, ...]
) -> tuple[tuple[slice, Arm], ...]:
    """Group arms whose effects of pressure or history are equal."""
    runs: list[tuple[slice, Arm]] = []
    if not (arms and (changing or arms[0].history_dependent or arms[0].by_load)):
        return ()

    def key(arm: Arm) -> object:
        by_history = [arm.acting[place] for place in arm.history_dependent]
        by_pressure = [arm.effects[place] for place in changing]
        return by_pressure, by_history, arm.by_load, arm.scale, arm.knots.tolist()

    first = 0
    for _, group in groupby(arms, key):
        size = len(list(group))
        runs.append((slice(first, first + size), arms[first]))
        first += size
    return tuple(runs)


def pressure_step(arm: Arm) -> float:
    """Return the step of the chamber pressure, Pa."""
    low, high = arm.table_range
    return PRESSURE_STEP * (high - low)


def with_pressure_change(
    arm: Arm,
    chamber_pressure: float,
    history: tuple[History, ...] | None = None,
    load: Load | None = None,
) -> tuple[Rods, Perturbation]:
    """Return the rod record at a chamber pressure (Pa), and its instantaneous change per pascal.

    If effects depend on the end load, its changes are appended.
    """
    step = pressure_step(arm)
    every = near_records(arm, chamber_pressure, step, history, load)
    change = Perturbation.between(every.record(1), every.record(2), 2.0 * step)
    if arm.by_load:
        change = change.followed_by(load_change(arm, chamber_pressure, history, load))
    return every.record(0), change


def near_records(
    arm: Arm, pressure: float, step: float, history: tuple[History, ...] | None, load: Load | None
) -> Rods:
    """Return the rod records at a pressure (Pa) and one step before and after it."""
    loads = None if load is None or not arm.by_load else np.repeat(load.row, 3, axis=0)
    pressures = np.array([pressure, pressure - step, pressure + step])
    return arm.rods(pressures, history, loads, gravity_of(load, 3))


def gravity_of(load: Load | None, count: int) -> Array | None:
    """Return the gravity direction under a load, repeated (count, 2); None: as in the model."""
    if load is None or load.gravity is None:
        return None
    return np.tile(load.gravity, (count, 1))


def load_change(
    arm: Arm, pressure: float, history: tuple[History, ...] | None, load: Load | None
) -> Perturbation:
    """Return the changes of the rod record with F1, F2 and M through effects."""
    step = LOAD_STEP * arm.weight * np.array([1.0, 1.0, arm.length])
    known = np.zeros((1, LOADS)) if load is None else load.row
    at = np.full(LOADS, pressure)
    before, after = (
        arm.rods(at, history, known + sign * np.diag(step), gravity_of(load, LOADS))
        for sign in (-1.0, 1.0)
    )
    return Perturbation.between(before, after, 2.0 * step, by_load=True)
