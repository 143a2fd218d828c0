"""Top of the diagnosis report: the missing effect, if any, and the improvement."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.result import Diagnosis, Misfit
from pneunet_ros.discovery.result import Discovery
from pneunet_ros.reports.diagnosis.tables import p_value_text, passes_text, rank_evidence

MOST_BARS = 6  # rows that fit on the screen of a phone


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """The evidence for one cause (nats), its bar length in percent, and the residual with it."""

    name: str
    nats: str
    length: int
    left: str


def missing_sentence(diagnosis: Diagnosis) -> str:
    """Describe the significance of the lack of fit."""
    test, chi_squared = diagnosis.adequacy_before, diagnosis.before.training.chi_squared
    values = (
        f'the worst lack-of-fit statistic is {test.statistic:.4g}, where noise alone stays below '
        f'{test.threshold:.4g} (p-value {p_value_text(test.p_value)}); chi squared per coordinate '
        f'of the training recordings is {chi_squared:.3g}'
    )
    if test.statistic > test.threshold:
        unless = ', unless the noise is underestimated' if diagnosis.answer == 'unknown' else ''
        return f'Yes{unless}: {values}.'
    seen = any(item.evidence > 0.0 for item in diagnosis.evidence)
    if diagnosis.answer == 'none' or (diagnosis.answer == 'unobservable' and not seen):
        return f'Nothing, as far as these recordings show: {values}.'
    return (
        'Yes, according to the score of single effects; the test for an arbitrary smooth error '
        f'is less sensitive: {values}.'
    )


def evidence_bars(diagnosis: Diagnosis, discovery: Discovery) -> tuple[Bar, ...]:
    """Return the causes with evidence, the strongest first; laws of a discovery among them."""
    causes = [
        (
            ' + '.join(item.effects),
            item.evidence,
            f'only noise remains: {passes_text(item, diagnosis)}',
        )
        for item in rank_evidence(diagnosis)
        if item.evidence > 0.0
    ]
    causes += [
        (f'a law: {item.kind}', item.left_out_gain, 'a proposal, not yet tested')
        for item in discovery.found
    ]
    shown = sorted(causes, key=lambda item: -item[1])[:MOST_BARS]
    return tuple(
        Bar(
            name=name,
            nats=f'{nats:.0f}' if nats >= 10.0 else f'{nats:.1f}',
            length=max(1, round(100.0 * nats / shown[0][1])),
            left=left,
        )
        for name, nats, left in shown
    )


def error_sentence(diagnosis: Diagnosis) -> str:
    """Describe the change of the model error on held-out (or training) recordings.

    Chi squared is stated first if reading noise hides the change in the rms.
    """
    before, after = diagnosis.before, diagnosis.after
    first, last, kind = before.training, after.training, 'training'
    if before.held_out is not None and after.held_out is not None:
        first, last, kind = before.held_out, after.held_out, 'held-out'
    start, end = millimeters(first.rms), millimeters(last.rms)
    missing = diagnosis.answer not in ('none', 'unobservable')
    if missing and not rms_shows(diagnosis, first, last):
        return f'On {kind} recordings {in_chi_squared(diagnosis, first, last)}.'
    if start == end:
        return (
            f'On {kind} recordings the model error is {start:.3f} mm rms, '
            f'{floor_text(diagnosis)}: nothing was added.'
        )
    return (
        f'On {kind} recordings the model error goes from {start:.3f} mm to {end:.3f} mm rms'
        f'{removed_text(diagnosis)}.'
    )


def rms_shows(diagnosis: Diagnosis, before: Misfit, after: Misfit) -> bool:
    """Whether the rms shows the missing effect: the rms fell, or exceeds the noise floor."""
    if before.rms == after.rms:
        return before.rms > diagnosis.noise_floor + diagnosis.noise_floor_std
    return before.rms - after.rms > diagnosis.noise_floor_std


def in_chi_squared(diagnosis: Diagnosis, before: Misfit, after: Misfit) -> str:
    """Return the change in chi squared, with a note that the rms cannot show it."""
    rms = f'{millimeters(before.rms):.3f} mm rms'
    if before.rms == after.rms:
        change = f'chi squared per coordinate is {before.chi_squared:.4g}'
        unchanged = f'{rms}, {floor_text(diagnosis)}; nothing was added'
    else:
        change = (
            f'chi squared per coordinate goes from {before.chi_squared:.4g} to '
            f'{after.chi_squared:.4g}'
        )
        unchanged = f'{rms} before, {millimeters(after.rms):.3f} mm after, {floor_text(diagnosis)}'
    return f'{change} (noise alone: 1). The rms error cannot show the missing effect ({unchanged})'


def removed_text(diagnosis: Diagnosis) -> str:
    """Describe the share of the reducible error that was removed; at most all of it."""
    if diagnosis.closed is None:
        return ''
    if diagnosis.closed >= 1.0:
        after = millimeters(diagnosis.after.rms)
        return f', all of the reducible error: {after:.3f} mm, {floor_text(diagnosis)}'
    removed = min(100.0 * diagnosis.closed, 99.0)
    return f', which removed {removed:.0f} % of the reducible error'


def floor_text(diagnosis: Diagnosis) -> str:
    """Describe the noise floor."""
    floor, scatter = diagnosis.noise_floor, diagnosis.noise_floor_std
    return f'noise alone {millimeters(floor):.3f} ± {millimeters(scatter):.3f} mm'
