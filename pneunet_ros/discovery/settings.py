"""Tuning constants of a discovery.

`acceptance/discovery_trials.py` tested all of them together.
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning

GRID = 9  # positions tried along the arm, before the best is refined
REFINEMENTS = 3  # halvings of the distance between positions
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
MOST_TERMS = 3  # of a law
IDLE = 3.0  # std of a term that may be omitted
PERIOD_COST = 5.0  # log probability gained by chance in the search over periods
HELD = 4  # positions at which a constant cause is fitted before its position is free
LEVEL = 1e-4  # p-value of the law of one half of the recordings in the other half
FINALISTS = 3  # kinds that are fitted jointly
WORTH_A_FIT = 0.8  # of the evidence for a name: gain of a law, before a joint fit, to overrule it
LEAST_SHARE = 0.3  # of the remaining misfit explained by a law
ROUNDS = 2  # fits of a law to the residuals of the previous one


@dataclass(frozen=True, slots=True, kw_only=True)
class LawSettings:
    """Settings of the forward selection of terms."""

    least_gain: float = tuning(
        4.0,
        'smallest gain of an additional term in left-out recordings, and between two kinds',
        unit='log probability',
        source='sweep',
    )
    prior_sizes: tuple[float, ...] = tuning(
        (0.01, 0.1, 1.0),
        'candidates for the prior std of coefficients',
        unit='prior of the kind',
        source='sweep',
    )
    fewest_cycles: float = tuning(
        2.5, 'smallest number of periods in the longest recording', source='sweep'
    )
    fewest_runs: int = tuning(
        3,
        'smallest number of recordings for a law in time: half of those for a split test',
        source='tried: with 4 six recordings give no law in time, as no half shows one',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LawConfirmationSettings:
    """Settings of the tests that a law must pass to be reported."""

    more_finalists: int = tuning(
        6, 'number of kinds fitted jointly if no finalist passes', source='invented'
    )
    beside_named: float = tuning(
        0.1,
        'smallest gain of a law in addition to a named effect, or instead of a name',
        unit='evidence of the name',
        source='invented',
    )
    overrules: float = tuning(
        10.0,
        'smallest advantage in prediction of a law over a name',
        unit='log probability',
        source='invented',
    )
    fewest_runs: int = tuning(
        4,
        'smallest number of training recordings for a split test of a law; with fewer, a '
        'name gives way to the law',
        source='sweep',
    )


LAW, CONFIRMATION = LawSettings(), LawConfirmationSettings()
FIXED = LAW, CONFIRMATION  # the same in every discovery
