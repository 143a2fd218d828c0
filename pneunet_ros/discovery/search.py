"""Search over all kinds of cause around one fit, each at its best position with its best law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.refit import Refit
from pneunet_ros.discovery.amplitude import FrameColumns, Projection, Runs
from pneunet_ros.discovery.covariates import Covariate, covariates_of, ELAPSED
from pneunet_ros.discovery.kinds import Kind, KINDS
from pneunet_ros.discovery.law import Cause, cause_of, choose_law, Law
from pneunet_ros.discovery.settings import DISCOVERY, DiscoverySettings, GRID, REFINEMENTS
from pneunet_ros.discovery.time_law import (
    Courses,
    find_swing,
    find_wandering,
    Swing,
    wandering_courses,
)


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
    def goes_by_itself(self) -> bool:
        """Whether no measured quantity predicts it."""
        if self.swing is not None:
            return True
        return self.law is not None and any(
            item.name in self.law.terms and item.meaning.group == 'time'
            for item in self.cause.covariates
        )

    @property
    def left_out_gain(self) -> float:
        """In log probability of every recording predicted from the others."""
        if self.swing is not None:
            return self.swing.left_out_gain
        return 0.0 if self.law is None else self.law.left_out_gain


class Search:
    """Kinds of cause around a fit to training runs."""

    def __init__(self, fit: Refit, settings: DiscoverySettings = DISCOVERY) -> None:
        self.fit, self.settings = fit, settings
        self.projection = Projection(fit.gaussian)
        self.covariates: tuple[Covariate, ...] = covariates_of(
            fit.linearization, settings.covariates
        )
        low, high = fit.linearization.point.arm.table_range
        self.play = settings.covariates.play * (high - low)
        self.causes: dict[tuple[str, float | None], Cause | None] = {}
        self.frames: dict[tuple[str, float | None], FrameColumns] = {}

    @property
    def runs(self) -> Runs:
        """All runs of the fit."""
        return tuple(range(len(self.fit.linearization.blocks)))

    def positions(self, kind: Kind) -> list[float | None]:
        """Return the positions (s / l) of a kind to try first."""
        if kind.positions is None:
            return [None]
        return list(np.linspace(*kind.positions, GRID).tolist())

    def cause(self, kind: Kind, position: float | None) -> Cause | None:
        """Return a kind at a position (cached)."""
        key = kind.name, position
        if key not in self.causes:
            self.causes[key] = self.make_cause(kind, position)
        return self.causes[key]

    def make_cause(self, kind: Kind, position: float | None) -> Cause | None:
        """Return a cause of a kind at a place; None if the fit has no solution."""
        before, projection = self.points, self.projection
        if before is None:
            return None
        return cause_of(
            self.fit, before, projection, kind, position, self.covariates, play=self.play
        )

    @cached_property
    def points(self) -> list[Array] | None:
        """Points (frames, 2, targets) m of the fit in all runs; None if there is no solution."""
        linearization = self.fit.linearization
        return linearization.points(self.fit.point.arm, range(len(linearization.blocks)))

    def frame_columns(self, cause: Cause) -> FrameColumns:
        """Return the frame columns of a cause (cached)."""
        key = cause.kind.name, cause.position
        if key not in self.frames:
            self.frames[key] = FrameColumns.of(
                self.projection, self.fit.linearization, cause.fields
            )
        return self.frames[key]

    @cached_property
    def courses(self) -> Courses:
        """Aperiodic courses in time; steady states have none."""
        seconds = {item.name: item.values for item in self.covariates}.get(ELAPSED)
        return {} if seconds is None else wandering_courses(seconds, self.settings.law)

    def law(self, kind: Kind, position: float | None, runs: Runs) -> Law | None:
        """Return the law of a kind at a place in some of the runs; None if there is none."""
        cause = self.cause(kind, position)
        return None if cause is None else choose_law(cause, runs, self.settings.law)

    def best_law(self, kind: Kind, runs: Runs) -> Law | None:
        """Return the law of a kind at its best position, after refining the position."""
        positions = self.positions(kind)
        laws = [(self.law(kind, position, runs), position) for position in positions]
        known = [(law, position) for law, position in laws if law is not None]
        if not known:
            return None
        best, position = max(known, key=lambda pair: pair[0].left_out_gain)
        if position is None or kind.positions is None:
            return best
        step = (kind.positions[1] - kind.positions[0]) / (len(positions) - 1)
        for _ in range(REFINEMENTS):
            step *= 0.5
            for other in (position - step, position + step):
                if not kind.positions[0] <= other <= kind.positions[1]:
                    continue
                law = self.law(kind, other, runs)
                if law is not None and law.left_out_gain > best.left_out_gain:
                    best, position = law, other
        return best

    def swing(self, cause: Cause, runs: Runs) -> Swing | None:
        """Return the most probable swing of the amplitude of a cause in some of the runs."""
        frames = self.frame_columns(cause)
        return find_swing(frames, self.covariates, cause.kind.prior, runs, self.settings.law)

    def wandering(self, cause: Cause, runs: Runs) -> Swing | None:
        """Return an aperiodic course of a cause in some of the runs."""
        frames = self.frame_columns(cause)
        return find_wandering(frames, self.courses, cause.kind.prior, runs, self.settings.law)

    def wandering_suspects(self) -> list[Suspect]:
        """Return the kinds with an aperiodic course, best first.

        Each is at its best position. A kind with a law in measured quantities is described better
        by that law.
        """
        found = []
        for kind in KINDS.values():
            best = self.wandering_at(kind, self.positions(kind))
            if best is not None and best.cause.position is not None and kind.positions is not None:
                step = (kind.positions[1] - kind.positions[0]) / (GRID - 1)
                for _ in range(REFINEMENTS):
                    step *= 0.5
                    here = best.cause.position
                    near = [place for place in (here - step, here, here + step)
                            if kind.positions[0] <= place <= kind.positions[1]]  # fmt: skip
                    best = self.wandering_at(kind, near) or best
            if best is not None and best.left_out_gain > 0.0:
                found.append(best)
        return sorted(found, key=lambda item: -item.left_out_gain)

    def wandering_at(self, kind: Kind, positions: Sequence[float | None]) -> Suspect | None:
        """Return the best position of a kind with an aperiodic amplitude; None without one."""
        causes = [self.cause(kind, position) for position in positions]
        found = [
            Suspect(cause=cause, law=None, swing=swing)
            for cause in causes
            if cause is not None and (swing := self.wandering(cause, self.runs)) is not None
        ]
        return max(found, key=lambda item: item.left_out_gain, default=None)

    def suspect(self, kind: Kind, runs: Runs) -> Suspect | None:
        """Return a kind with its best prediction of left-out recordings; None if it has none."""
        law = self.best_law(kind, runs)
        cause = self.cause(kind, self.positions(kind)[0]) if law is None else law.cause
        if cause is None:
            return None
        swing = self.swing(cause, runs)
        suspect = Suspect(cause=cause, law=law, swing=None)
        if swing is not None and swing.left_out_gain > suspect.left_out_gain:
            suspect = replace(suspect, law=None, swing=swing)
        return suspect if suspect.left_out_gain > 0.0 else None

    def suspects(self, kinds: Sequence[Kind] | None = None) -> list[Suspect]:
        """Return all kinds with a law, best first."""
        found = [self.suspect(kind, self.runs) for kind in kinds or KINDS.values()]
        known = [item for item in found if item is not None]
        return sorted(known, key=lambda item: -item.left_out_gain)
