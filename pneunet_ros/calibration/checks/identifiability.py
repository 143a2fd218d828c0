"""Notes on parameters that the data do not identify: unchanged from the prior, or correlated."""

from __future__ import annotations

import numpy as np
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import IDENTIFIABILITY
from pneunet_ros.core.notes import Note


def undetermined_quantities(fit: Fit) -> list[Note]:
    """Describe quantities that stayed at their prior and pairs that are correlated."""
    notes = []
    names, change = fit.parameters.quantities()
    after = change @ fit.covariance @ change.T
    before = change @ fit.parameters.prior @ change.T
    std = np.sqrt(np.diag(after))
    kept = [
        name
        for name, now, then in zip(names, std, np.sqrt(np.diag(before)), strict=True)
        if now > IDENTIFIABILITY.well_known * then
    ]
    if kept:
        notes.append(
            Note(
                f'{len(kept)} of {len(names)} quantities are barely observable in these '
                f'recordings: their values and errors are those of the prior: {", ".join(kept)}',
                reason='not_determined',
            )
        )
    laws = [index for index, name in enumerate(names) if name.startswith('moment_law.')]
    correlation = after / np.outer(std, std)
    pairs = [
        (names[i], names[j], correlation[i, j])
        for i in laws
        for j in laws
        if i < j
        and abs(correlation[i, j]) > IDENTIFIABILITY.confounded
        and not same_quantity(names[i], names[j])
    ]
    if pairs:
        one, other, value = max(pairs, key=lambda pair: abs(pair[2]))
        other_pairs = f', and neither can {len(pairs) - 1} other pairs' if len(pairs) > 1 else ''
        notes.append(
            Note(
                f'{one} and {other} cannot be distinguished with these data (correlation '
                f'{value:.3f})' + other_pairs,
                reason='not_distinguished',
            )
        )
    if not fit.converged:
        notes.append(Note(f'the fit has not converged: {fit.status}', reason='not_settled'))
    elif fit.status != 'converged':
        notes.append(
            Note(
                f'the fit has not fully converged ({fit.status}): the model does not explain '
                'these recordings. Run pneunet diagnose to find the model error',
                reason='not_quite_settled',
            )
        )
    return notes


def same_quantity(one: str, other: str) -> bool:
    """Whether two names denote the same quantity at two pressures."""
    first, second = one.split('.'), other.split('.')
    return first[:2] == second[:2] and first[3:] == second[3:]
