"""A diagnosis with the recording that would add most to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.diagnosis.diagnosis import investigate
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.result import Diagnosis, UnsettledDiagnosis
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings
from pneunet_ros.exploration.choice import ranked_choices
from pneunet_ros.exploration.rivals import NOTHING, rival_probabilities
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm


def diagnose(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    on_progress: OnProgress = ignore_progress,
    settings: DiagnosisSettings = DEFAULTS,
) -> Diagnosis | UnsettledDiagnosis:
    """Return the diagnosis of `investigate`, with a proposal for the next recording."""
    found = investigate(
        model, training, held_out, seed=seed, on_progress=on_progress, settings=settings
    )
    return with_proposal(found, SafeSet.of(model)).diagnosis


def with_proposal(
    found: Investigation | UnsettledInvestigation, safe: SafeSet
) -> Investigation | UnsettledInvestigation:
    """Propose the recording that would best distinguish the alternatives of a diagnosis.

    Without alternatives: that would best show the effects that no recording could show so far. If
    an arm that bends unevenly explains the recordings as well, none is proposed: more targets
    would help, not more recordings.
    """
    if isinstance(found, UnsettledInvestigation):
        return found
    diagnosis, probability = found.diagnosis, rival_probabilities(found)
    rivals = {*(item.name for item in diagnosis.effects), *diagnosis.alternatives}
    if not diagnosis.alternatives:
        limits = diagnosis.detectable.items()
        rivals = {NOTHING, *(name for name, item in limits if not item.observable)}
    mimicked = diagnosis.answer == 'unobservable' and bool(found.best.names)
    if mimicked or len(rivals) < 2:
        return found
    weights = {name: value * (name in rivals) for name, value in probability.items()}
    best = next(iter(ranked_choices(found, weights, safe)), None)
    if best is None or not best.rate > 0.0:
        return found
    words = f'{best.words[:1].upper()}{best.words[1:]}'
    proposal = f'Record next: {best.experiment.words}. {words}.'
    return replace(found, diagnosis=replace(diagnosis, proposal=proposal))
