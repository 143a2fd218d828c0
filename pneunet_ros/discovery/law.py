"""A law of an amplitude: the covariates it depends on, chosen by left-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.refit import Refit
from pneunet_ros.discovery.amplitude import (
    Columns,
    columns_of,
    Evidence,
    left_out_gains,
    Projection,
    Runs,
    unit_fields,
)
from pneunet_ros.discovery.covariates import CONSTANT, Covariate
from pneunet_ros.discovery.kinds import Kind
from pneunet_ros.discovery.proposed_effect import effect_class, effect_source, parameters_of
from pneunet_ros.discovery.settings import DISCOVERY, LawSettings

STEP = 1e-3  # of the prior of an amplitude: the size of unit fields


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cause:
    """A kind at a place, ready for laws.

    position (s / l), None if it has none; fields (frames, 2 targets) m per unit of amplitude, per
    run; covariates: those that its amplitude may follow; terms: names of the columns, first those
    of the covariates. A column is for the kind's prior times a covariate of size one.
    """

    kind: Kind
    position: float | None
    fields: tuple[Array, ...]
    covariates: tuple[Covariate, ...]
    terms: tuple[str, ...]
    columns: Columns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """Terms of a cause, and their gain.

    coefficients (terms,) and covariance, in units of the kind's prior per scaled covariate;
    left_out_gain: in log probability of every run predicted from the others; explained: reduction
    of chi squared; std: prior of the coefficients.
    """

    cause: Cause
    terms: tuple[str, ...]
    coefficients: Array
    covariance: Array
    left_out_gain: float
    explained: float
    std: float


def cause_of(
    fit: Refit,
    before: Sequence[Array],
    projection: Projection,
    kind: Kind,
    position: float | None,
    covariates: Sequence[Covariate],
    *,
    play: float,
) -> Cause | None:
    """Return a kind of cause at a position around a fit; None if there is no solution.

    before: points (frames, 2, targets) m of the fit itself, per run.
    """
    linearization = fit.linearization
    length = linearization.length
    by_name = {item.name: item for item in covariates}
    size = STEP * kind.prior

    def fields_with(term: str, amount: float) -> tuple[Array, ...] | None:
        parameters = parameters_of(kind, (term,), by_name)
        effect = effect_class(
            effect_source(kind, parameters, '', length=length, play=play, name=f'unit_{kind.name}')
        )
        values = {parameters[0].name: amount}
        if position is not None:
            values['position'] = position
        return unit_fields(fit, before, effect(**values), amount)

    fields = fields_with(CONSTANT, size)
    if fields is None:
        return None
    runs = range(len(fields))
    followed = [item for item in covariates if item.meaning.group in (*kind.follows, 'time')]
    if not followed:  # frames that are steady states have no past
        return None
    factors = [
        kind.prior * np.column_stack([item.scaled(which) for item in followed]) for which in runs
    ]
    columns = columns_of(projection, linearization, fields, factors).white
    names = [item.name for item in followed]
    for name, native in kind.natives.items():
        own = fields_with(name, STEP * native.prior)
        if own is None:
            continue
        factors = [np.full((len(item), 1), native.prior) for item in own]
        more = columns_of(projection, linearization, own, factors).white
        columns = tuple(np.concatenate(pair, axis=1) for pair in zip(columns, more, strict=True))
        names.append(name)
    return Cause(
        kind=kind,
        position=position,
        fields=fields,
        covariates=tuple(followed),
        terms=tuple(names),
        columns=Columns(projection, columns),
    )


def choose_law(cause: Cause, runs: Runs, settings: LawSettings = DISCOVERY.law) -> Law | None:
    """Return the terms that best predict each run from the others; None if none does.

    Forward selection: the best term, then the best additional one, while the gain is large enough.
    """
    evidence = cause.columns.left_out(runs)
    best: Law | None = None
    chosen: list[int] = []
    gain = 0.0
    while len(chosen) < settings.most_terms:
        rivals = [term for term in range(len(cause.terms)) if term not in chosen]
        if not rivals:
            break
        gains = left_out_gains(
            evidence, [[*chosen, term] for term in rivals], settings.prior_sizes
        )
        row, column = np.unravel_index(gains.argmax(), gains.shape)
        most, std, term = float(gains.max()), settings.prior_sizes[column], rivals[row]
        if most < gain + settings.least_gain:
            break
        chosen.append(term)
        gain = most
        best = law_of(cause, evidence[0], chosen, std, gain)
    return best


def law_of(
    cause: Cause, evidence: Evidence, chosen: Sequence[int], std: float, gain: float
) -> Law:
    """Return the law of these terms."""
    part = evidence.part(chosen)
    coefficients, covariance = part.estimate(std)
    return Law(
        cause=cause,
        terms=tuple(cause.terms[term] for term in chosen),
        coefficients=coefficients,
        covariance=covariance,
        left_out_gain=gain,
        explained=part.explained,
        std=std,
    )
