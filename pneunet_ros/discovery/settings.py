"""Tuning constants of a discovery.

Numbers without a source are invented; `acceptance/discovery_trials.py` tested all of them
together.
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning

GRID = 9  # positions tried along the arm, before the best is refined
REFINEMENTS = 3  # halvings of the distance between positions


@dataclass(frozen=True, slots=True, kw_only=True)
class CovariateSettings:
    """Settings of the covariates of an amplitude."""

    play: float = tuning(0.02, 'full width of the usual play', unit='pressure range')


@dataclass(frozen=True, slots=True, kw_only=True)
class LawSettings:
    """Settings of the forward selection of terms."""

    most_terms: int = tuning(3, 'terms of a law')
    least_gain: float = tuning(
        4.0, 'gain of a term more in recordings left out', unit='log probability'
    )
    prior_sizes: tuple[float, ...] = tuning(
        (0.01, 0.1, 1.0), 'prior std of coefficients, the best is taken', unit='prior of the kind'
    )
    idle: float = tuning(3.0, 'size of a term that may be left out', unit='its std')
    rounds: int = tuning(2, 'rounds of fitting a law to the residuals of the last one')
    period_cost: float = tuning(
        5.0, 'gain that the search over periods finds by chance', unit='log probability'
    )
    fewest_cycles: float = tuning(2.5, 'periods in the longest recording, at least')
    fewest_runs: int = tuning(3, 'recordings for a law on time')


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSettings:
    """Settings of the search for the position of a cause."""

    held: int = tuning(4, 'places at which a constant cause is fitted before its place is free')


@dataclass(frozen=True, slots=True, kw_only=True)
class LawConfirmationSettings:
    """Settings of the tests that a law must pass to be reported."""

    level: float = tuning(
        1e-4, 'p-value of the law of one half of the recordings in the other half'
    )
    least_share: float = tuning(0.3, 'share of what is left that a law explains at least')
    tied: float = tuning(4.0, 'difference that separates two kinds', unit='log probability')
    finalists: int = tuning(3, 'kinds that are fitted jointly')
    more_finalists: int = tuning(6, 'kinds that are fitted jointly if none of those passes')
    beside_named: float = tuning(
        0.1, 'gain of a law beside a named effect, at least', unit='evidence of that effect'
    )
    worth_a_fit: float = tuning(
        0.8,
        'gain of a law, before any joint fit, that may overrule a name',
        unit='evidence of the name',
    )
    overrules: float = tuning(
        10.0, 'by how much a law must predict better than a name', unit='log probability'
    )
    fewest_runs: int = tuning(
        4, 'training recordings of which halves test a law; of less a name gives way to it'
    )
    overrules_share: float = tuning(
        0.1, 'by how much a law must predict better than a name', unit='evidence of the name'
    )


COVARIATES, LAW, PLACE = CovariateSettings(), LawSettings(), PlaceSettings()
CONFIRMATION = LawConfirmationSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoverySettings:
    """The settings of all algorithms of a discovery, as they are recorded with its result."""

    covariates: CovariateSettings = COVARIATES
    law: LawSettings = LAW
    place: PlaceSettings = PLACE
    confirmation: LawConfirmationSettings = CONFIRMATION


DISCOVERY = DiscoverySettings()
