"""Search over all kinds of cause around a fit, each at its best position with its best law."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.refit import Refit
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.discovery.amplitude import Columns, PerRunColumns, Projection, Runs
from pneunet_ros.discovery.covariates import CONSTANT, covariates_of, ELAPSED
from pneunet_ros.discovery.kinds import Kind, kinds_of
from pneunet_ros.discovery.law import Cause, choose_law, Law
from pneunet_ros.discovery.proposed_effect import (
    effect_class,
    effect_source,
    Parameter,
    parameter_of,
    POSITION,
)
from pneunet_ros.discovery.settings import GRID, REFINEMENTS
from pneunet_ros.discovery.time_law import (
    aperiodic_courses,
    Courses,
    find_aperiodic,
    find_swing,
    Swing,
)

STEP = 1e-3  # of the prior of an amplitude: difference step of unit fields
Found = TypeVar('Found', Law, 'Suspect')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Suspect:
    """A kind at its best position: the law that predicts left-out recordings best, or a swing."""

    cause: Cause
    law: Law | None
    swing: Swing | None

    @property
    def kind(self) -> Kind:
        """The kind."""
        return self.cause.kind

    @property
    def is_unpredictable(self) -> bool:
        """Whether no measured quantity predicts it."""
        return self.law is None or ELAPSED in self.law.terms

    @property
    def left_out_gain(self) -> float:
        """In log probability of every recording predicted from the others."""
        if self.swing is not None:
            return self.swing.left_out_gain
        return 0.0 if self.law is None else self.law.left_out_gain


class Search:
    """Kinds of cause around a fit to training runs."""

    def __init__(self, fit: Refit) -> None:
        self.fit = fit
        self.linearization = fit.linearization
        self.projection = Projection(fit.gaussian)
        self.covariates = {item.name: item for item in covariates_of(self.linearization)}
        self.size = self.linearization.point.arm.size
        self.kinds = kinds_of(self.size)
        low, high = self.linearization.point.arm.table_range
        self.play = LINEARIZATION.unloading * (high - low)
        self.causes: dict[tuple[str, float | None], Cause | None] = {}
        self.frames: dict[tuple[str, float | None], PerRunColumns] = {}

    @property
    def runs(self) -> Runs:
        """All runs of the fit."""
        return tuple(range(len(self.linearization.blocks)))

    def positions(self, kind: Kind) -> list[float | None]:
        """Return the positions (s / l) of a kind to try first."""
        if kind.positions is None:
            return [None]
        return list(np.linspace(*kind.positions, GRID).tolist())

    def parameters(self, kind: Kind, terms: Sequence[str]) -> tuple[Parameter, ...]:
        """Return the parameters of an effect of a kind with these terms."""
        return tuple(parameter_of(kind, term, self.covariates) for term in terms)

    def source(
        self, kind: Kind, parameters: Sequence[Parameter], sentence: str = '', name: str = ''
    ) -> str:
        """Return the text of the file of an effect of a kind."""
        length = self.linearization.length
        return effect_source(kind, parameters, sentence, length=length, play=self.play, name=name)

    def cause(self, kind: Kind, position: float | None) -> Cause | None:
        """Return a kind at a position (cached); None if the arm has no shape with it."""
        key = kind.name, position
        if key not in self.causes:
            self.causes[key] = self.make_cause(kind, position)
        return self.causes[key]

    def make_cause(self, kind: Kind, position: float | None) -> Cause | None:
        """Return a kind at a position, with the columns of its terms."""
        fields = self.unit_fields(kind, position, CONSTANT, STEP * kind.prior)
        groups = {*kind.follows, 'time'}
        followed = [item for item in self.covariates.values() if item.meaning.group in groups]
        if fields is None or not followed:  # steady states have no history
            return None
        factors = [
            kind.prior * np.column_stack([item.scaled(which) for item in followed])
            for which in self.runs
        ]
        columns, names = [self.white(fields, factors)], [item.name for item in followed]
        for name, native in kind.natives.items():
            native_fields = self.unit_fields(kind, position, name, STEP * native.prior)
            if native_fields is not None:
                factors = [np.full((len(item), 1), native.prior) for item in native_fields]
                columns.append(self.white(native_fields, factors))
                names.append(name)
        white = tuple(np.concatenate(run, axis=1) for run in zip(*columns, strict=True))
        return Cause(
            kind=kind,
            position=position,
            fields=fields,
            covariates=tuple(followed),
            terms=tuple(names),
            columns=Columns(self.projection, white),
        )

    def unit_fields(
        self, kind: Kind, position: float | None, term: str, amount: float
    ) -> tuple[Array, ...] | None:
        """Return the derivatives of points (frames, 2 targets) m by a term, per run.

        amount: step of the difference. None if the arm has no shape with this effect.
        """
        (parameter,) = parameters = self.parameters(kind, [term])
        effect = effect_class(self.source(kind, parameters, name=f'unit_{kind.name}'))
        values = {parameter.name: amount} | ({} if position is None else {POSITION: position})
        point, before = self.fit.point, self.points
        arm = replace(point, effects=(*point.effects, effect(**values))).arm
        after = self.linearization.points(arm, range(len(self.runs)))
        if before is None or after is None:
            return None
        return tuple(
            np.nan_to_num(with_it - without).reshape(len(without), -1) / amount
            for with_it, without in zip(after, before, strict=True)
        )

    def white(self, fields: Sequence[Array], factors: Sequence[Array]) -> list[Array]:
        """Return fields (frames, 2 targets) m times factors (frames, n) per run, whitened."""
        return [
            block.white(field[:, :, None] * factor[:, None, :])
            for block, field, factor in zip(
                self.linearization.blocks, fields, factors, strict=True
            )
        ]

    @cached_property
    def points(self) -> list[Array] | None:
        """Points (frames, 2, targets) m of the fit in all runs; None if there is no solution."""
        return self.linearization.points(self.fit.point.arm, range(len(self.runs)))

    def frame_columns(self, cause: Cause) -> PerRunColumns:
        """Return the columns of a cause with an amplitude of its own in every frame (cached)."""
        key = cause.kind.name, cause.position
        if key not in self.frames:
            self.frames[key] = PerRunColumns.of_frames(
                self.projection, self.linearization, cause.fields
            )
        return self.frames[key]

    @cached_property
    def courses(self) -> Courses:
        """Aperiodic courses in time; steady states have none."""
        elapsed = self.covariates.get(ELAPSED)
        return {} if elapsed is None else aperiodic_courses(elapsed.values)

    def law(self, kind: Kind, position: float | None, runs: Runs) -> Law | None:
        """Return the law of a kind at a place in some of the runs; None if there is none."""
        cause = self.cause(kind, position)
        return None if cause is None else choose_law(cause, runs)

    def best_law(self, kind: Kind, runs: Runs) -> Law | None:
        """Return the law of a kind at its best position."""
        return self.at_best_position(kind, lambda position: self.law(kind, position, runs))

    def at_best_position(
        self, kind: Kind, found_at: Callable[[float | None], Found | None]
    ) -> Found | None:
        """Return the result at the best position of a kind, after refining the position."""
        tried = [(found_at(position), position) for position in self.positions(kind)]
        known = [(item, position) for item, position in tried if item is not None]
        if not known:
            return None
        best, position = max(known, key=lambda pair: pair[0].left_out_gain)
        if position is None or kind.positions is None:
            return best
        low, high = kind.positions
        step = (high - low) / (GRID - 1)
        for _ in range(REFINEMENTS):
            step *= 0.5
            for other in (position - step, position + step):
                found = found_at(other) if low <= other <= high else None
                if found is not None and found.left_out_gain > best.left_out_gain:
                    best, position = found, other
        return best

    def swing(self, cause: Cause, runs: Runs, *, periodic: bool) -> Swing | None:
        """Return the most probable course in time of the amplitude of a cause in some runs."""
        frames, prior = self.frame_columns(cause), cause.kind.prior
        if periodic:
            return find_swing(frames, self.covariates, prior, runs)
        return find_aperiodic(frames, self.courses, prior, runs)

    def aperiodic_suspects(self) -> list[Suspect]:
        """Return the kinds with an aperiodic course, best first.

        Each is at its best position. If a kind has a law in measured quantities, this law
        describes it better.
        """
        return rank_suspects(
            self.at_best_position(kind, partial(self.swung, kind, periodic=False))
            for kind in self.kinds
        )

    def swung(self, kind: Kind, position: float | None, *, periodic: bool) -> Suspect | None:
        """Return a kind at a position with its most probable course in time, if it has one."""
        cause = self.cause(kind, position)
        swing = None if cause is None else self.swing(cause, self.runs, periodic=periodic)
        if cause is None or swing is None:
            return None
        return Suspect(cause=cause, law=None, swing=swing)

    def suspects(self) -> list[Suspect]:
        """Return all kinds with a law or a swing, best first."""
        return rank_suspects(self.suspect(kind) for kind in self.kinds)

    def suspect(self, kind: Kind) -> Suspect | None:
        """Return a kind with its best prediction of left-out recordings; None if it has none."""
        law = self.best_law(kind, self.runs)
        swung = self.at_best_position(kind, partial(self.swung, kind, periodic=True))
        least = 0.0 if law is None else law.left_out_gain
        if swung is not None and swung.left_out_gain > least:
            return swung
        return None if law is None else Suspect(cause=law.cause, law=law, swing=None)


def rank_suspects(suspects: Iterable[Suspect | None]) -> list[Suspect]:
    """Return the suspects that predict left-out recordings, best first."""
    known = [item for item in suspects if item is not None and item.left_out_gain > 0.0]
    return sorted(known, key=lambda item: -item.left_out_gain)
