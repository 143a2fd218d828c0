"""The arm: length, curvature, moment law and effects, combined into a rod record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import dataclasses
from dataclasses import dataclass, field
import math
from types import MappingProxyType
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array, table_array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import check_quantities, quantity, STANDARD_GRAVITY
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.arm_size import ArmSize, PAPER_FORCE, PAPER_LENGTH, PAPER_PRESSURE
from pneunet_ros.effects.effect import (
    Effect,
    History,
    Load,
    Loads,
    NO_TERMS,
    NOTHING,
    Part,
    PressureScale,
    Terms,
)
from pneunet_ros.model.domain import DOMAIN, Domain, load_hull, LoadHull
from pneunet_ros.model.gravity import Gravity
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import MomentLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.parameter_path import Move, move_numbers, unknown_quantity
from pneunet_ros.model.record import (
    add_curvature,
    add_parts,
    cut_knots,
    cut_rotation,
    ends_of,
    Record,
)
from pneunet_ros.model.uncertainty import ModelCovariance, SensorNoise
from pneunet_ros.solver.columns import (
    CLAMP_ANGLE,
    CLAMP_WIDTH,
    END_LOAD_MOMENT,
    END_X,
    END_Y,
    FORCE_X,
    FORCE_Y,
    LOAD_X,
    LOAD_Y,
    LOADS,
    MOMENT_OFFSET,
    RIGIDITY,
    ROTATION_WIDTH,
    SECTION_WIDTH,
    START,
)
from pneunet_ros.solver.rod import Rods, RodTable

EXTRAPOLATION = DOMAIN.pressure_margin  # of the calibrated range, beyond either end
SEEN_STEP = 1e-5  # of the reach: step of central differences of the effects of the camera
# Inversion of the effects of the camera: remaining error (of the reach, near rounding), and
# largest number of Newton steps; the search converges in a few or not at all.
UNSEEN, UNSEEN_STEPS = 1e-12, 50
RIGID = 1e9  # times as stiff as the section before: the cap
# Blocks of the model file whose numbers can be perturbed.
MOVABLE = ('intrinsic_curvature', 'moment_law', 'effects', 'sensors', 'gravity', 'motion')
ONE_PRESSURE = 100.0  # Pa, on either side of the only row of a table: the noise of a sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """A pneu-net arm as a rod: the content of a model file.

    `target_arclength` (targets,) m: position of every target; `effects`: in the order of the table
    of effects; `sources`: source of each number. `domain`: range of the calibration; `load_hull`:
    convex hull of its loads, None if unknown. `table_range` (Pa) is the common range of intrinsic
    curvature and moment law, `pressure_range` (Pa) its part within the domain. `gravity`:
    direction of the weight; `motion`: None without inertia; `inertia`: `motion`, or the inertia of
    an effect. `sensing`, `seeing` and `acting` are the effects on readings, the effects on seen
    points, and the effects with a history; `history_dependent` are the indices in `acting` of
    effects whose history changes the rod; `by_load`: effects that depend on the end load and are
    not neutral. `parted`: names of effects that act on a part of the arm, without neutral ones
    unless these are listed in `divided` or in the covariance; curved_ends (m): ends of the parts
    with their own curvature.
    """

    name: str
    length: float = quantity(unit='m', meaning='length of the material line', bounds=(1e-4, 10.0))
    weight: float = quantity(unit='N', meaning='mg, the scale of forces', bounds=(1e-6, 1e4))
    tip_cap: float = quantity(
        0.0, unit='m', meaning='length of the rigid part beyond the soft end', bounds=(0.0, 10.0)
    )
    clamp_angle: float = quantity(0.0, unit='rad', meaning='theta(0)', bounds=(-7.0, 7.0))
    target_arclength: Array = field(default_factory=lambda: np.zeros(0))
    intrinsic_curvature: IntrinsicCurvature
    moment_law: MomentLaw
    effects: tuple[Effect, ...] = ()
    sensors: SensorNoise
    covariance: ModelCovariance | None = None
    domain: Domain | None = None
    gravity: Gravity = field(default_factory=Gravity)
    motion: Motion | None = None
    divided: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    sensing: tuple[Effect, ...] = field(init=False, repr=False)
    seeing: tuple[Effect, ...] = field(init=False, repr=False)
    acting: tuple[Effect, ...] = field(init=False, repr=False)
    history_dependent: tuple[int, ...] = field(init=False, repr=False)
    by_load: tuple[Effect, ...] = field(init=False, repr=False)
    parted: tuple[str, ...] = field(init=False, repr=False)
    curved_ends: Array = field(init=False, repr=False)
    scale: PressureScale = field(init=False, repr=False)
    knots: Array = field(init=False, repr=False)
    table: RodTable = field(init=False, repr=False)
    table_range: tuple[float, float] = field(init=False, repr=False)
    pressure_range: tuple[float, float] = field(init=False, repr=False)
    load_hull: LoadHull | None = field(init=False, repr=False)
    inertia: Motion | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the numbers, and sort the effects in the order of the table."""
        check_quantities(self, 'arm')
        object.__setattr__(self, 'target_arclength', self._checked_targets())
        object.__setattr__(self, 'inertia', self._inertia())
        self._sort_effects()
        object.__setattr__(self, 'sources', MappingProxyType(dict(self.sources)))
        object.__setattr__(self, 'provenance', MappingProxyType(dict(self.provenance)))
        low, high = self.moment_law.pressure_range
        rows = self.intrinsic_curvature.pressure
        low, high = max(low, float(rows[0])), min(high, float(rows[-1]))
        if low == high:  # tables with one row: the model is known at one pressure only
            low, high = low - ONE_PRESSURE, high + ONE_PRESSURE
        scale = PressureScale(rows=tuple(rows.tolist()), top=high, std=self.sensors.pressure_std)
        object.__setattr__(self, 'scale', scale)
        self._divide(low)
        knots = cut_knots(self.own_knots, self.curved_ends)
        object.__setattr__(self, 'knots', frozen_array(knots))
        object.__setattr__(self, 'table_range', (low, high))
        if not low < high:
            raise ModelError(
                'intrinsic_curvature and moment_law have no pressure in common; '
                'their pressure tables must overlap',
                reason='no_common_pressure',
            )
        self._take_domain()
        object.__setattr__(self, 'table', self.build_table())
        self._check_covariance()

    def _checked_targets(self) -> Array:
        """Return the positions of the targets; ModelError if they are not along the arm."""
        targets = table_array(self.target_arclength, 'arm.target_arclength', 1)
        inside = targets.size == 0 or (
            targets[0] >= 0.0 and targets[-1] <= self.reach * (1 + 1e-9)
        )
        if not inside or not np.all(np.diff(targets) > 0.0):
            raise ModelError(
                'arm.target_arclength must increase, from 0 or more to at most the length '
                f'{self.length} m' + (f' and the cap of {self.tip_cap} m' if self.tip_cap else ''),
                reason='not_increasing',
            )
        return targets

    def _sort_effects(self) -> None:
        """Sort the effects in the order of the table, and by the part of the model they act on."""
        names = [effect.name for effect in self.effects]
        if len(set(names)) != len(names):
            raise ModelError(f'an effect is given twice: {", ".join(names)}', reason='given_twice')
        order = list(EFFECTS)
        effects = tuple(
            sorted(
                self.effects,
                key=lambda effect: (
                    order.index(effect.name) if effect.name in order else len(order)
                ),
            )
        )
        object.__setattr__(self, 'effects', effects)
        for place, method in (('sensing', 'sense'), ('seeing', 'see'), ('acting', 'actuate')):
            acting_there = tuple(item for item in effects if item.implements(method))
            object.__setattr__(self, place, acting_there)
        dependent = [i for i, item in enumerate(self.acting) if item.implements('history_terms')]
        object.__setattr__(self, 'history_dependent', tuple(dependent))

    def _check_covariance(self) -> None:
        """Reject a covariance of quantities or targets that the arm does not have."""
        if self.covariance is None:
            return
        self.with_changes(dict.fromkeys(self.covariance.quantities, 0.0))  # the parts must exist
        if 'arm.tip_cap' in self.covariance.quantities and not self.tip_cap:
            raise ModelError(
                'covariance: arm.tip_cap is uncertain, but the arm has no cap: state its '
                'length, or remove the quantity',
                reason='missing',
            )
        placement, targets = self.covariance.placement, self.target_arclength.size
        if placement is not None and placement.mean.size != 2 * targets:
            raise ModelError(
                f'covariance.placement is for {placement.mean.size // 2} targets, but the '
                f'arm has {targets}: remove it if other targets were painted',
                reason='wrong_shape',
            )

    def _inertia(self) -> Motion | None:
        """Return the inertia of the arm: the block `motion`, or an effect that is not neutral."""
        for effect in self.effects:
            numbers = effect.motion()
            if numbers is None:
                continue
            if self.motion is not None:
                raise ModelError(
                    f'the arm has `motion` and the effect {effect.name}, which are two names of '
                    'the same mass and damping: remove one of them',
                    reason='given_twice',
                )
            return Motion(tip_mass=numbers[0], damping_time=numbers[1])
        return self.motion

    def with_motion(self, motion: Motion) -> Arm:
        """Return the arm with this inertia, which replaces that of a block or an effect."""
        effects = tuple(effect for effect in self.effects if effect.motion() is None)
        return dataclasses.replace(self, motion=motion, effects=effects)

    def _divide(self, pressure: float) -> None:
        """Find the effects on parts of the arm, at any pressure, and through the end load."""
        at, parts, names = np.array([pressure]), list[Part](), list[str]()
        by_load = list[Effect]()
        uncertain = set() if self.covariance is None else set(self.covariance.quantities)
        in_columns = {name.split('.')[1] for name in uncertain if name.startswith('effects.')}
        counted = {*self.divided, *in_columns}
        for effect in self.effects:
            if effect.is_neutral and effect.name not in counted:
                continue
            every = [effect.terms(at), effect.load_terms(loads_of(at, None))]
            if effect.implements('history_terms'):
                history = np.asarray(effect.initial(pressure, self.scale))
                every.append(effect.history_terms(history, self.scale))
            for terms in every:
                if terms.part is not None:
                    names.append(effect.name)
                    parts += [terms.part] * (terms.curvature is not NOTHING)
            by_load += [effect] * effect.implements('load_terms')
        object.__setattr__(self, 'by_load', tuple(by_load))
        object.__setattr__(self, 'parted', tuple(dict.fromkeys(names)))
        object.__setattr__(self, 'curved_ends', frozen_array(ends_of(parts, self.length)))

    def _take_domain(self) -> None:
        """Precompute the domain, or use a default."""
        low, high = self.table_range
        hull = None
        if self.domain is not None:
            low, high = max(low, self.domain.pressure[0]), min(high, self.domain.pressure[1])
            hull = load_hull(self.domain.end_load, self.domain.pressure, self.length)
            if not low <= high:
                raise ModelError(
                    'domain.pressure has no pressure in common with the tables of '
                    'intrinsic_curvature and moment_law',
                    reason='no_common_pressure',
                )
        object.__setattr__(self, 'pressure_range', (low, high))
        object.__setattr__(self, 'load_hull', hull)

    @property
    def reach(self) -> float:
        """Length (m) along the arm from clamp to tip, including the rigid cap."""
        return self.length + self.tip_cap

    @property
    def force_scale(self) -> float:
        """The largest end force of the calibration (N), or the weight if there is none."""
        largest = 0.0 if self.domain is None else self.domain.largest_force
        return largest if largest > 0.0 else self.weight

    @property
    def size(self) -> ArmSize:
        """Length, bending stiffness / length^2 and highest pressure relative to the paper's arm.

        The stiffness is that at the lowest pressure of the tables.
        """
        ends = [end for end in self.table_range if math.isfinite(end)] or [0.0]
        most = max(map(abs, ends))
        return ArmSize(
            length=self.length / PAPER_LENGTH,
            force=abs(self.mean_stiffness(ends[0])) / self.length**2 / PAPER_FORCE,
            pressure=most / PAPER_PRESSURE if most > 0.0 else 1.0,
        )

    def mean_stiffness(self, pressure: float) -> float:
        """Return the bending stiffness (N m^2) of the whole arm: its sections in series."""
        known = np.clip([pressure], *self.moment_law.pressure_range)
        (sections,) = self.moment_law.sections(known, self.length, self.weight)
        lengths = np.diff([*sections[:, 0], self.length])
        return float(self.length / np.sum(lengths / sections[:, 1]))

    @property
    def clamp_record(self) -> Array:
        """Clamp, and weight of the tip mass, as (5,) of the record of a rod."""
        clamp = np.zeros(CLAMP_WIDTH)
        clamp[CLAMP_ANGLE] = self.clamp_angle
        if self.inertia is not None:
            weight = self.inertia.tip_mass * STANDARD_GRAVITY
            clamp[END_X], clamp[END_Y] = weight * self.gravity.x, weight * self.gravity.y
        return clamp

    def add_terms(self, terms: Terms, sections: Array, clamp: Array) -> None:
        """Add the terms of an effect to rod records; the cap stays rigid and unloaded."""
        soft = sections[:, : sections.shape[1] - 1] if self.tip_cap else sections
        terms.add_to(soft, clamp)

    @property
    def own_knots(self) -> Array:
        """Knots (m) of the intrinsic curvature, and the tip of the cap."""
        knots = self.length * self.intrinsic_curvature.arclength
        return np.append(knots, self.reach) if self.tip_cap else knots

    def add_gravity(self, sections: Array, clamp: Array, change: Array) -> None:
        """Add to rod records the weight for a gravity direction other than that of the arm.

        change (n, 2): difference of gravity, in g.
        """
        soft = sections[:, : sections.shape[1] - 1] if self.tip_cap else sections
        for part, column, end in ((0, LOAD_X, END_X), (1, LOAD_Y, END_Y)):
            soft[:, :, column] += self.weight / self.length * change[:, part, None]
            if self.inertia is not None:
                clamp[:, end] += self.inertia.tip_mass * STANDARD_GRAVITY * change[:, part]

    def on_knots(self, rotation: Array) -> Array:
        """Return rotation (..., pieces, 5) of the soft part on all knots; the cap is straight."""
        knots = self.own_knots
        if self.tip_cap:
            cap = np.zeros_like(rotation[..., :1, :])
            width = knots[-2] - knots[-3]
            cap[..., 0, 0] = rotation[..., -1, :] @ width ** np.arange(float(ROTATION_WIDTH))
            rotation = np.concatenate([rotation, cap], axis=-2)
        return cut_rotation(rotation, knots, self.curved_ends)

    def beyond_range(self, pressure: float) -> float:
        """Return the distance of a pressure from the calibrated range, relative to it; 0 inside.

        A distance explained by sensor noise counts as inside.
        """
        low, high = self.pressure_range
        outside = max(low - pressure, pressure - high, 0.0)
        if outside <= DOMAIN.pressure_noise * self.sensors.pressure_std:
            return 0.0
        return outside / (high - low) if high > low else math.inf

    def sense(self, load: Load) -> Load:
        """Return the true load that corresponds to readings of pressure and wrench."""
        for effect in self.sensing:
            load = effect.sense(load)
        return load

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the measured positions of points at true x, y (m, base frame)."""
        for effect in self.seeing:
            x, y = effect.see(x, y)
        return x, y

    def see_moves(self, x: Array, y: Array, dx: Array, dy: Array) -> tuple[Array, Array]:
        """Return the measured small displacements (dx, dy) of points at true x, y (m)."""
        if not self.seeing:
            return dx, dy
        (xx, xy), (yx, yy) = self.seen_slopes(x, y)
        return xx * dx + xy * dy, yx * dx + yy * dy

    def seen_slopes(self, x: Array, y: Array) -> Array:
        """Return d(measured x, y) / d(true x, y), (2, 2, ...), at points (m)."""
        step = SEEN_STEP * self.reach
        by_x = np.subtract(self.see(x + step, y), self.see(x - step, y))
        by_y = np.subtract(self.see(x, y + step), self.see(x, y - step))
        return np.asarray(np.stack([by_x, by_y], axis=1) / (2.0 * step))

    def true_points(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the true positions (m) of points measured at x, y (m): the inverse of `see`.

        NaN where none is found.
        """
        if not self.seeing:
            return x, y
        true_x, true_y, exact = x, y, np.zeros(0, dtype=np.bool_)
        with np.errstate(all='ignore'):  # of points that diverge
            for _ in range(UNSEEN_STEPS):
                off_x, off_y = np.subtract((x, y), self.see(true_x, true_y))
                size = np.hypot(off_x, off_y)
                exact = size <= UNSEEN * self.reach
                if np.all(exact | ~np.isfinite(size)):
                    break
                (xx, xy), (yx, yy) = self.seen_slopes(true_x, true_y)
                area = xx * yy - xy * yx
                true_x = true_x + (yy * off_x - xy * off_y) / area
                true_y = true_y + (xx * off_y - yx * off_x) / area
        return np.where(exact, true_x, np.nan), np.where(exact, true_y, np.nan)

    @property
    def frame_delay(self) -> float:
        """Delay (s) of the stamp of a frame."""
        return sum(effect.frame_delay for effect in self.effects)

    def initial_history(self, pressure: float) -> tuple[History, ...]:
        """Return the history of an arm at rest at a pressure (Pa), one tuple per acting effect."""
        return tuple(effect.initial(pressure, self.scale) for effect in self.acting)

    def actuate(
        self, history: tuple[History, ...], seconds: float, pressure: float
    ) -> tuple[tuple[History, ...], float]:
        """Return history and chamber pressure (Pa), `seconds` after the given history."""
        following = []
        for effect, state in zip(self.acting, history, strict=True):
            state, pressure = effect.actuate(state, seconds, pressure, self.scale)
            following.append(state)
        return tuple(following), pressure

    def in_play(self, history: tuple[History, ...]) -> bool:
        """Whether a small pressure change at the sensor does not reach the chamber (dead band)."""
        return any(
            effect.in_play(state) for effect, state in zip(self.acting, history, strict=True)
        )

    def terms(
        self,
        pressure: Array,
        history: tuple[History, ...] | tuple[Array, ...] | None,
        loads: Array | None = None,
    ) -> Iterator[Terms]:
        """Yield the terms of every effect; arguments as in `rods`."""
        for effect in self.effects:
            yield self.without_neutral_part(effect, effect.terms(pressure))
        yield from self.further_terms(pressure, history, loads)

    def effects_follow_pressure(
        self,
        pressure: Array,
        step: float,
        history: tuple[History, ...] | tuple[Array, ...] | None,
        loads: Array | None = None,
    ) -> bool:
        """Whether the terms of effects depend on the pressure; arguments as in `terms`."""
        sides = [self.terms(pressure + side * step, history, loads) for side in (-1.0, 1.0)]
        return any(below.differs(above) for below, above in zip(*sides, strict=True))

    def further_terms(
        self,
        pressure: Array,
        history: tuple[History, ...] | tuple[Array, ...] | None,
        loads: Array | None,
    ) -> Iterator[Terms]:
        """Yield the terms of effects that depend on the end load or the history."""
        for effect in self.by_load:
            added = effect.load_terms(loads_of(pressure, loads))
            yield self.without_neutral_part(effect, added)
        for place in () if history is None else self.history_dependent:
            assert history is not None
            effect = self.acting[place]
            added = effect.history_terms(np.asarray(history[place]), self.scale)
            yield self.without_neutral_part(effect, added)

    def without_neutral_part(self, effect: Effect, terms: Terms) -> Terms:
        """Return the terms of an effect, without neutral parts, which would split sections."""
        return terms if terms.part is None or effect.name in self.parted else NO_TERMS

    def add_to(
        self, every: Sequence[Terms], record: Record, mixed_rotation: Callable[[Array], Array]
    ) -> Record:
        """Add the terms of effects to a record, which may be overwritten.

        mixed_rotation: returns the rotation (n, pieces, 5) for weights of the rows.
        """
        if not every:
            return record
        rotation = record.rotation
        for terms in every:
            if terms.part is None:
                self.add_terms(terms, record.sections, record.clamp)
            if terms.row_weights is not None:
                rotation = terms.mix_rows(rotation, mixed_rotation(terms.row_weights))
        for terms in every:
            if terms.curvature is not NOTHING:
                rotation = add_curvature(rotation, self.knots, terms, self.length)
        record = dataclasses.replace(record, rotation=rotation)
        return add_parts(record, every, self.length, self.reach)

    def build_table(self) -> RodTable:
        """Return all pressures with a row of curvature or law, and the rod records there.

        The first and last row are at the limits of extrapolation. Beyond its own range, the law is
        constant, because an extrapolated rigidity may pass through zero, and l1 may leave the arm;
        the limits of this range are rows, too.
        """
        law, (low, high) = self.moment_law, self.table_range
        margin = EXTRAPOLATION * (high - low)
        ends = np.array([low - margin, high + margin])
        laws = np.append(law.table_pressures, law.pressure_range)
        rows = np.union1d(self.intrinsic_curvature.pressure, laws)
        rows = np.union1d(rows[(rows > ends[0]) & (rows < ends[1])], ends)
        known = np.clip(rows, *law.pressure_range)
        base = law.sections(known, self.length, self.weight)
        soft = base.shape[1]
        sections = np.zeros((rows.size, soft + bool(self.tip_cap), SECTION_WIDTH))
        sections[:, :soft, : MOMENT_OFFSET + 1] = base
        sections[:, :soft, LOAD_X] = self.weight / self.length * self.gravity.x
        sections[:, :soft, LOAD_Y] = self.weight / self.length * self.gravity.y
        if self.tip_cap:
            sections[:, soft, START] = self.length
            sections[:, soft, RIGIDITY] = RIGID * base[:, -1, RIGIDITY]
        rotation = self.on_knots(self.intrinsic_curvature.rotation_of(rows, self.length))
        return RodTable(
            pressure=frozen_array(rows),
            sections=frozen_array(sections),
            rotation=frozen_array(rotation),
        )

    def rods(
        self,
        pressure: Array,
        history: tuple[History, ...] | tuple[Array, ...] | None = None,
        loads: Array | None = None,
        gravity: Array | None = None,
    ) -> Rods:
        """Return the rod record at each of these chamber pressures (n,) Pa.

        history: from `actuate`, for all pressures, or an array (n, numbers) per acting effect with
        one history per pressure. None: an arm settled at each pressure. loads (n, 3): true F1, F2
        (N), M (N m), for effects that depend on them; None: no load. gravity (n, 2): along x and
        y, in g; None: as in the model.
        """
        pressure = frozen_array(pressure)  # kernels would be compiled again for writable arrays
        sections, rotation = self.table.at(pressure)
        clamp = np.tile(self.clamp_record, (pressure.size, 1))
        if gravity is not None:
            self.add_gravity(sections, clamp, self.gravity.difference(gravity))
        record = Record.without_pushes(sections, clamp, rotation)

        def mixed(weights: Array) -> Array:
            return self.on_knots(self.intrinsic_curvature.mixed_rotation(weights, self.length))

        record = self.add_to(list(self.terms(pressure, history, loads)), record, mixed)
        return Rods(
            length=self.reach,
            pressure=pressure,
            sections=record.sections,
            clamp=record.clamp,
            knots=self.knots,
            rotation=record.rotation,
            push=record.push,
            push_place=record.push_place,
        )

    def with_changes(self, changes: Mapping[str, float]) -> Arm:
        """Return this arm with changed quantities of the model file; ModelError for unknown ones.

        changes: dotted path, such as `moment_law.rigidity.0.1` or `arm.length`, to an amount in
        SI.
        """
        moves = []
        for name, amount in changes.items():
            first, *rest = name.split('.')
            if (
                first == 'arm'
                and rest
                and rest[0] in ('length', 'weight', 'tip_cap', 'clamp_angle')
            ):
                moves.append(Move(path=tuple(rest), amount=amount, name=name))
            elif first in MOVABLE:
                moves.append(Move(path=(first, *rest), amount=amount, name=name))
            else:
                raise ModelError(unknown_quantity(name), reason='unknown_quantity')
        base = dataclasses.replace(self, covariance=None, divided=self.parted)
        arm: Arm = move_numbers(base, moves)
        return arm


def loads_of(pressure: Array, loads: Array | None) -> Loads:
    """Return pressures (n,) and loads (n, 3) in the form for effects; None: no load."""
    known = np.zeros((pressure.size, LOADS)) if loads is None else loads
    return Loads(
        pressure=pressure,
        force_x=known[:, FORCE_X],
        force_y=known[:, FORCE_Y],
        moment=known[:, END_LOAD_MOMENT],
    )
