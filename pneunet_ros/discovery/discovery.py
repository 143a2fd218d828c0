"""Discovery of a law, in words and as an executable effect, for an unexplained misfit.

There is no search if the residuals are consistent with noise. A law is reported only if, with
it, one half of the recordings predicts the other, and if held-out recordings do not contradict it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.diagnosis.conclusion import evaluate, withdraw_name
from pneunet_ros.diagnosis.confirmation import Confirmer, error_increase
from pneunet_ros.diagnosis.evaluation import removed_share
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.result import Estimated
from pneunet_ros.diagnosis.scores.lack_of_fit import is_adequate, TestedProblem, worst_test
from pneunet_ros.diagnosis.selection import evidence_margin, Record, Trial
from pneunet_ros.discovery.amplitude import Runs
from pneunet_ros.discovery.covariates import ELAPSED
from pneunet_ros.discovery.joint_fit import JointFits, Proposal
from pneunet_ros.discovery.law import Law
from pneunet_ros.discovery.library_words import is_equivalent_to, LIBRARY_WORDS
from pneunet_ros.discovery.proposed_effect import effect_name, LAW_ERROR
from pneunet_ros.discovery.result import (
    AmplitudeSeries,
    CauseMap,
    Discovered,
    Discovery,
    NOTHING_SEARCHED,
    TermOfLaw,
    TimeLaw,
)
from pneunet_ros.discovery.search import Search, Suspect
from pneunet_ros.discovery.sentence import drift_sentence, law_sentence, swing_sentence
from pneunet_ros.discovery.settings import (
    CONFIRMATION,
    FINALISTS,
    GRID,
    LAW,
    LEAST_SHARE,
    LEVEL,
    REFINEMENTS,
    WORTH_A_FIT,
)
import scipy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finding:
    """A suspect with its joint fit, if there is one, and the shares that they explain.

    gain: in log probability of every training recording predicted from the others.
    """

    suspect: Suspect
    proposal: Proposal | None
    gain: float
    share: float

    @property
    def explains(self) -> bool:
        """Whether the excess of its joint fit is acceptable for a law."""
        return self.proposal is not None and self.proposal.trial.record.adequate

    @property
    def is_unpredictable(self) -> bool:
        """Whether no measured quantity predicts the amplitude."""
        return self.proposal is None and self.suspect.is_unpredictable


def discover(
    investigation: Investigation | UnsettledInvestigation,
    *,
    on_progress: OnProgress = ignore_progress,
) -> Discovery:
    """Search for a law of the model error that no effect of the library explains.

    Args:
        investigation: a diagnosis with its fits.
        on_progress: called with the task, its progress, and its total (0 = unknown).

    Returns:
        Confirmed laws, at most one with its rivals; none if the answer is `none` or
        `unobservable`, or if named effects leave only noise and no law explains the recordings
        better.
    """
    if isinstance(investigation, UnsettledInvestigation):
        return NOTHING_SEARCHED
    overruling = overrule(investigation, on_progress)
    if overruling.overruling is not None:
        return overruling
    base = starting_point(investigation)
    if base is None:
        return overruling
    on_progress('causes outside the library', 0, 0)
    fits = joint_fits(investigation, base)
    discovery, best = look_for_law(investigation, fits, fits.search.suspects(), on_progress)
    if base is investigation.base:  # the residual of a named effect is aperiodic anyway
        discovery = consider_aperiodic(fits, discovery, best)
    if best is not None and not discovery.found:
        objection = untestable_law(investigation, base, best)
        if objection:
            discovery = replace(discovery, overruling=withdraw_name(investigation, objection))
    return replace(discovery, notes=(*overruling.notes, *discovery.notes))


def joint_fits(investigation: Investigation, base: Trial) -> JointFits:
    """Return the joint fits of laws on top of a model, and the search around it."""
    return JointFits(
        selection=investigation.selection,
        first=investigation.base,
        base=base,
        search=Search(base.refit),
    )


def untestable_law(investigation: Investigation, named: Trial, best: Finding) -> str:
    """Return the objection to a name if a law predicts recordings far better.

    With several recordings, a split test shows whether the law holds, with or without the name.
    With few recordings, a split is impossible, and the name may only be the nearest approximation
    to the law.
    """
    count = investigation.selection.linearization.training
    if named is investigation.base or best.proposal is None or count >= CONFIRMATION.fewest_runs:
        return ''
    law = best.proposal.trial.record
    if not predicts_better(law, named.record):
        return ''
    return (
        f'together with {best.suspect.kind.name} it predicts each training recording from the '
        f'others better (log probability higher by {law.evidence:.0f}, compared with '
        f'{named.record.evidence:.0f} for it alone), and {count} training recordings cannot '
        'confirm either'
    )


def overrule(investigation: Investigation, on_progress: OnProgress) -> Discovery:
    """Return a law that predicts recordings better than the named effects.

    A name is the effect of the library that explains most. If the missing effect is not in the
    library, the residuals of the nearest effect may still be consistent with noise. If such a law
    cannot be confirmed, the name is kept, with a note.
    """
    diagnosis, first, trial = investigation.diagnosis, investigation.base, investigation.trial
    if diagnosis.answer not in ('named', 'inseparable'):
        return NOTHING_SEARCHED
    names = (*trial.names, *diagnosis.alternatives)
    if not {*names} <= {*LIBRARY_WORDS}:
        return NOTHING_SEARCHED  # a user effect: a law may be equivalent to it
    on_progress('causes outside the library, in place of the name', 0, 0)
    fits, named = joint_fits(investigation, first), trial.record
    suspects = fits.search.suspects()
    if not any(
        item.left_out_gain > WORTH_A_FIT * named.evidence
        and item.law is not None
        and not is_equivalent_to(item.kind.name, item.law.terms, names)
        for item in suspects
    ):
        return NOTHING_SEARCHED
    discovery, best = look_for_law(investigation, fits, suspects, on_progress)
    if best is None or best.proposal is None:
        return NOTHING_SEARCHED
    law, kind = best.proposal, best.suspect.kind.name
    if is_equivalent_to(kind, law.terms, names) or not predicts_better(law.trial.record, named):
        return NOTHING_SEARCHED
    if not discovery.found:
        found_text = (
            f'a law of another kind explains more than {" + ".join(trial.names)}, unconfirmed'
        )
        return Discovery(searched=True, notes=(f'{found_text}: {"; ".join(discovery.notes)}',))
    objection = (
        f'a law of another kind ({kind}) predicts each training recording from the others better, '
        f'by {best.gain:.0f} in log probability where this has {named.evidence:.0f}'
    )
    return replace(discovery, overruling=withdraw_name(investigation, objection))


def predicts_better(law: Record, named: Record) -> bool:
    """Whether a law may replace a name: it meets the same requirements by a wide margin.

    Held-out recordings must not be predicted worse.
    """
    least = named.evidence + max(
        CONFIRMATION.overrules, CONFIRMATION.beside_named * named.evidence
    )
    if law.outside_prior or law.evidence < least:
        return False
    return law.predicted >= named.predicted - LAW.least_gain


def look_for_law(
    investigation: Investigation,
    fits: JointFits,
    suspects: Sequence[Suspect],
    on_progress: OnProgress,
) -> tuple[Discovery, Finding | None]:
    """Return the law for the residuals of a model, and its finding.

    The law is None if recordings do not confirm it, the finding if no kind predicts any recording.
    """
    selection, search, diagnosis = fits.selection, fits.search, investigation.diagnosis
    unconfirmed = Discovery(searched=True, causes=cause_map(search, fits.base))
    if not suspects:
        notes = ('no kind of cause that was tried predicts left-out recordings',)
        return replace(unconfirmed, notes=notes), None
    findings = fit_finalists(fits, suspects, on_progress)
    best = simplify_law(max(findings, key=lambda item: (item.explains, item.gain)), fits)
    objections = objections_to(best, fits)
    unconfirmed = replace(unconfirmed, amplitudes=amplitude_series(search, best))
    evaluation = closed = None
    if best.proposal is not None and not objections:
        on_progress('evaluation of the discovered law', 0, 0)
        runs = selection.linearization.runs
        evaluation = evaluate(best.proposal.trial, runs, investigation.recordings)
        closed = removed_share(diagnosis.before.rms, evaluation.rms, diagnosis.noise_floor)
        pair = diagnosis.before.held_out_scores, evaluation.held_out_scores
        rises = error_increase(*pair)
        objections = (rises,) if rises else ()
    if objections:
        kind = best.suspect.kind.name
        notes = (f'the closest cause is {kind}; no law is given: {"; ".join(objections)}',)
        return replace(unconfirmed, notes=notes), best
    tied = equivalent_kinds(best, findings, suspects)
    found = (describe(best, tied, search),)
    return replace(unconfirmed, found=found, evaluation=evaluation, closed=closed), best


def consider_aperiodic(fits: JointFits, law: Discovery, best: Finding | None) -> Discovery:
    """Return the confirmed aperiodic course in time, if there is one, or else the law.

    It replaces an unconfirmed law, and a law in time that explains less, because a law in time
    predicts nothing either.
    """
    if law.found and best is not None and not best.is_unpredictable:
        return law
    search = fits.search
    suspects = search.aperiodic_suspects()
    if not suspects or (law.found and best is not None and suspects[0].left_out_gain <= best.gain):
        return law
    findings = [finding_of(item, None, fits) for item in suspects]
    if objections_to(findings[0], fits):
        return law
    tied = equivalent_kinds(findings[0], findings, suspects)
    return Discovery(
        searched=True,
        found=(describe(findings[0], tied, search),),
        causes=law.causes,
        amplitudes=amplitude_series(search, findings[0]),
    )


def starting_point(investigation: Investigation) -> Trial | None:
    """Return the model to which a law is added; None if there is no model error."""
    match investigation.diagnosis.answer:
        case 'unknown':
            return investigation.base
        case 'named' | 'inseparable':
            trial = investigation.trial
            return None if is_adequate(trial.record.tests) else trial
    return None


def fit_finalists(
    fits: JointFits, suspects: Sequence[Suspect], on_progress: OnProgress
) -> list[Finding]:
    """Fit the best suspects jointly if a model can follow them, and evaluate them.

    If the excess of all finalists is too large for a law, the calibration has absorbed so much
    that the ranking is unreliable; more suspects are then fitted, also as constants.
    """
    findings = []
    for index, suspect in enumerate(suspects[:FINALISTS]):
        on_progress(f'joint fit of {suspect.kind.name}', index, FINALISTS)
        law = measured_terms(suspect)
        proposal = None if law is None else fits.propose(law)
        finding = finding_of(suspect, proposal, fits)
        if suspect.is_unpredictable and not finding.explains:
            finding = finding_of(suspect, None, fits)
        findings.append(finding)
    if findings[0].is_unpredictable or any(item.explains for item in findings):
        return findings
    extended = []
    for index, suspect in enumerate(suspects[: CONFIRMATION.more_finalists]):
        on_progress(f'joint fit of {suspect.kind.name}', index, CONFIRMATION.more_finalists)
        known = findings[index] if index < len(findings) else finding_of(suspect, None, fits)
        if known.is_unpredictable:
            extended.append(known)
            continue
        proposals = [known.proposal, fits.propose_constant(suspect.kind)]
        if index >= len(findings) and suspect.law is not None:
            proposals[0] = fits.propose(suspect.law)
        fitted = [item for item in proposals if item is not None]
        best = max(fitted, key=lambda item: item.evidence, default=None)
        extended.append(finding_of(suspect, best, fits))
    return extended


def measured_terms(suspect: Suspect) -> Law | None:
    """Return the law of a suspect without its terms in time; None if no term remains.

    A drift in addition to a predictable law must be small, because the joint fit cannot follow it.
    """
    law = suspect.law
    kept = [] if law is None else [i for i, term in enumerate(law.terms) if term != ELAPSED]
    if law is None or not kept:
        return None
    return replace(
        law, terms=tuple(law.terms[i] for i in kept), coefficients=law.coefficients[kept]
    )


def finding_of(suspect: Suspect, proposal: Proposal | None, fits: JointFits) -> Finding:
    """Return the finding of a suspect, with its joint fit if it has one."""
    base, gain = fits.base, suspect.left_out_gain
    explained = suspect_gain(suspect, fits.search)
    share = min(1.0, explained / max(excess_of(base), explained))
    if proposal is not None:
        gain = proposal.evidence - base.record.evidence
        share = 1.0 - proposal.trial.record.excess / max(base.record.excess, 1e-12)
    return Finding(suspect=suspect, proposal=proposal, gain=gain, share=share)


def simplify_law(finding: Finding, fits: JointFits) -> Finding:
    """Drop unnecessary terms of a finding's law; reduce it to a constant if a constant fits."""
    if finding.proposal is None:
        return finding
    shorter = fits.remove_unnecessary_terms(finding.proposal)
    if len(shorter.terms) > 1:
        constant = fits.propose_constant(finding.suspect.kind)
        margin = LAW.least_gain * (len(shorter.terms) - 1)
        if constant is not None and constant.evidence > shorter.evidence - margin:
            shorter = fits.remove_unnecessary_terms(constant)
    return finding_of(finding.suspect, shorter, fits)


def excess_of(base: Trial) -> float:
    """Return the excess of chi squared over its mean, or of a test over clean data."""
    runs = base.refit.linearization.training
    squares = sum(base.record.run_chi_squared[:runs]) - sum(base.record.coordinates[:runs])
    return max(float(squares), base.record.excess)


def suspect_gain(suspect: Suspect, search: Search) -> float:
    """Return the reduction of chi squared by the law of a suspect."""
    if suspect.law is not None:
        return suspect.law.explained
    assert suspect.swing is not None
    if not suspect.swing.periodic:  # a separate amplitude in every frame also explains noise
        return 2.0 * suspect.swing.left_out_gain
    combined = search.frame_columns(suspect.cause).combined(suspect.swing.factors)
    return combined.evidence(search.runs).explained


def cause_map(search: Search, base: Trial) -> CauseMap:
    """Return the share explained by every kind with its best law, by position."""
    grid = np.linspace(0.0, 1.0, GRID)
    share, total = np.full((len(search.kinds), grid.size), np.nan), excess_of(base)
    for row, kind in enumerate(search.kinds):
        for index, position in enumerate(search.positions(kind)):
            law = search.law(kind, position, search.runs)
            explained = 0.0 if law is None else law.explained
            cells = slice(None) if position is None else slice(index, index + 1)
            share[row, cells] = explained
    return CauseMap(
        kinds=tuple(kind.name for kind in search.kinds),
        positions=grid,
        share=share / max(total, float(np.nanmax(share))),
    )


def objections_to(finding: Finding, fits: JointFits) -> tuple[str, ...]:
    """Return the objections to the law of a finding."""
    base, found = fits.base, []
    count = len(fits.search.runs)
    if count < CONFIRMATION.fewest_runs:
        found.append(f'{count} training recordings cannot confirm it')
    elif (p_value := split_p_value(finding.suspect, fits.search, fits.selection.seed)) > LEVEL:
        found.append(
            'the law of either half of the recordings does not predict the other (p-value '
            f'{p_value:.2g})'
        )
    if finding.share < LEAST_SHARE:
        found.append(f'it explains {max(finding.share, 0.0):.0%} of the remaining misfit')
    if base is not fits.first and finding.gain < CONFIRMATION.beside_named * base.record.evidence:
        found.append('it may be the law error of the named effect')
    if finding.proposal is not None:
        if not finding.explains:
            worst = worst_test(finding.proposal.trial.record.tests)
            found.append(
                f'its residuals are too large for a law (p-value {worst.p_value:.1g} of '
                f'{worst.name})'
            )
        confirmer = Confirmer.of(fits.selection, fits.first.record)
        found += confirmer.held_out_objections(finding.proposal.trial.record)
        found += confirmer.nonuniform_arm(finding.proposal.trial.record)
    return tuple(found)


def split_p_value(suspect: Suspect, search: Search, seed: int) -> float:
    """Return the p-value of a split test, in which one half predicts the other.

    Position, terms and coefficients are from one half. The other half is fitted independently,
    because a base fitted to both halves would have common errors. 1 if neither half has a law.
    """
    runs = search.runs
    halves = runs[::2], runs[1::2]
    values = [
        predicted_p_value(suspect, search, chosen, tested, seed)
        for chosen, tested in (halves, halves[::-1])
        if chosen and tested
    ]
    return min(1.0, 2.0 * min(values, default=1.0))


def predicted_p_value(
    suspect: Suspect, search: Search, chosen: Runs, tested: Runs, seed: int
) -> float:
    """Return the p-value of predictions of runs by the law of others."""
    linearization = search.linearization
    if suspect.swing is not None:
        swing = search.swing(suspect.cause, chosen, periodic=suspect.swing.periodic)
        if swing is None:
            return 1.0
        white = block_columns(search.white(suspect.cause.fields, swing.factors), tested)
    else:
        law = search.best_law(suspect.kind, chosen)
        if law is None:
            return 1.0
        places = [law.cause.terms.index(term) for term in law.terms]
        white = [
            (law.cause.columns.white[which][:, places] @ law.coefficients)[:, None]
            for which in tested
        ]
    blocks = [linearization.blocks[which] for which in tested]
    gaussian = search.fit.gaussian.subset(tested)
    problem = TestedProblem.of(gaussian, blocks, linearization.size)
    name = f'split {suspect.kind.name}'
    return problem.test(name, range(len(tested)), white, seed).p_value


def block_columns(white: Sequence[Array], runs: Runs) -> list[Array]:
    """Return block-diagonal columns (rows, n) per run: zero for all other runs."""
    parts = [white[which] for which in runs]
    rows = np.cumsum([len(part) for part in parts])
    return np.split(scipy.linalg.block_diag(*parts), rows[:-1])


def equivalent_kinds(
    best: Finding, findings: Sequence[Finding], suspects: Sequence[Suspect]
) -> tuple[str, ...]:
    """Return the other kinds that explain equally much, by joint fits or by left-out gain."""
    margin = max(LAW.least_gain, evidence_margin(best.gain))
    fitted = {item.suspect.kind.name: item.gain for item in findings}
    linear = best.suspect.left_out_gain
    tied = [
        item.kind.name
        for item in suspects
        if item is not best.suspect
        and (
            best.gain - fitted[item.kind.name]
            if item.kind.name in fitted
            else linear - item.left_out_gain
        )
        < margin
    ]
    return tuple(tied)


def describe(finding: Finding, tied: Sequence[str], search: Search) -> Discovered:
    """Return a finding in the format of diagnosis.json."""
    suspect, proposal, swing = finding.suspect, finding.proposal, finding.suspect.swing
    kind, location = suspect.kind, location_of(finding)
    size, time_law, source = dict[str, Estimated](), None, None
    terms: tuple[TermOfLaw, ...] = ()
    if proposal is not None:
        terms = fitted_terms(proposal)
        size = {
            item.function: Estimated(value=item.coefficient, std=item.std, unit=item.unit)
            for item in terms
        }
        sentence = law_sentence(kind, location, terms, tied)
        source = search.source(kind, proposal.parameters, sentence)
    elif swing is not None:
        size['amplitude'] = Estimated(
            value=swing.size * kind.prior, std=swing.size_std * kind.prior, unit=kind.unit
        )
        name = 'period' if swing.periodic else 'correlation_time'
        period = Estimated(value=swing.period, std=swing.period_std, unit='s')
        time_law = TimeLaw(form=swing.form, parameters={name: period})
        sentence = swing_sentence(kind, location, swing, tied)
    else:
        terms = linear_terms(suspect)
        time_law = TimeLaw(
            form='grows with the time since the start of a recording', parameters={}
        )
        sentence = drift_sentence(kind, location, terms, tied)
    return Discovered(
        kind=kind.name,
        location=location,
        size=size,
        covariates=terms,
        time_law=time_law,
        share=finding.share,
        left_out_gain=finding.gain,
        tied_with=tuple(tied),
        sentence=sentence,
        effect_file=None if source is None else f'effects/{effect_name(kind)}.py',
        source=source,
    )


def location_of(finding: Finding) -> Estimated | None:
    """Return the position (s / l) of a finding, None if it has none."""
    proposal, kind = finding.proposal, finding.suspect.kind
    position = finding.suspect.cause.position if proposal is None else proposal.position
    if position is None or kind.positions is None:
        return None
    if proposal is not None:
        return Estimated(value=position, std=float(proposal.stds[-1]) * position, unit='-')
    step = (kind.positions[1] - kind.positions[0]) / (GRID - 1)
    return Estimated(value=position, std=step * 0.5**REFINEMENTS, unit='-')


def fitted_terms(proposal: Proposal) -> tuple[TermOfLaw, ...]:
    """Return the terms of a law that was fitted jointly."""
    return tuple(
        TermOfLaw(
            name=item.term,
            function=item.name,
            coefficient=float(number),
            std=float(np.hypot(std, LAW_ERROR * number)),
            unit=item.unit,
        )
        for item, number, std in zip(
            proposal.parameters, proposal.numbers, proposal.stds, strict=False
        )
    )


def linear_terms(suspect: Suspect) -> tuple[TermOfLaw, ...]:
    """Return the terms of a law that was not fitted jointly."""
    law = suspect.law
    assert law is not None
    stds = np.sqrt(np.diag(law.covariance))
    scales = {item.name: item for item in suspect.cause.covariates}
    terms = []
    for name, coefficient, std in zip(law.terms, law.coefficients, stds, strict=True):
        native = suspect.kind.natives.get(name)
        size = native.prior if native else suspect.kind.prior / scales[name].scale
        unit = native.unit if native else f'{suspect.kind.unit} per {scales[name].meaning.unit}'
        terms.append(
            TermOfLaw(
                name=name,
                function=name,
                coefficient=float(coefficient * size),
                std=float(np.hypot(std, LAW_ERROR * coefficient) * size),
                unit=unit,
            )
        )
    return tuple(terms)


def amplitude_series(search: Search, finding: Finding) -> tuple[AmplitudeSeries, ...]:
    """Return the amplitude of a finding in every training frame, free and by its law."""
    suspect, kind = finding.suspect, finding.suspect.kind
    frames = search.frame_columns(suspect.cause)
    value, covariance = frames.evidence(search.runs).estimate(kind.prior)
    std = np.sqrt(np.diag(covariance))
    law = law_amplitude(suspect, search)
    series = []
    for which, run_frames in enumerate(frames.of_run):
        run = search.linearization.runs[which]
        series.append(
            AmplitudeSeries(
                recording=run.name,
                unit=kind.unit,
                seconds=np.asarray((run.stamp_ns - run.stamp_ns[0]) / 1e9),
                value=value[run_frames],
                std=std[run_frames],
                law=law[run_frames],
            )
        )
    return tuple(series)


def law_amplitude(suspect: Suspect, search: Search) -> Array:
    """Return the amplitude (all frames,) by the law of a suspect, without its native terms."""
    if suspect.swing is not None:
        swing, combined = suspect.swing, search.frame_columns(suspect.cause)
        combined = combined.combined(swing.factors)
        size = combined.evidence(search.runs).estimate(swing.std)[0]
        pairs = zip(swing.factors, combined.of_run, strict=True)
        return np.concatenate([factor @ size[run_columns] for factor, run_columns in pairs])
    law = suspect.law
    assert law is not None
    scales = {item.name: item for item in suspect.cause.covariates}
    parts = [
        np.concatenate(
            [
                coefficient * suspect.kind.prior * scales[name].scaled(which)
                for which in search.runs
            ]
        )
        for name, coefficient in zip(law.terms, law.coefficients, strict=True)
        if name in scales
    ]
    total = sum(len(item) for item in suspect.cause.fields)
    return np.asarray(sum(parts, np.zeros(total)))
