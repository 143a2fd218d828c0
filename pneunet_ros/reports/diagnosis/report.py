"""The report of a diagnosis: one self-contained HTML page, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import shlex
from typing import Any

from pneunet_ros.diagnosis.result import CLEAR, Diagnosis, UnsettledDiagnosis
from pneunet_ros.discovery.result import Discovery, NOTHING_SEARCHED
from pneunet_ros.reports.calibration.tables import flat
from pneunet_ros.reports.calibration.verdict import bending_stiffness, stiffness_text
from pneunet_ros.reports.diagnosis.error_figures import discovered_sentence
from pneunet_ros.reports.diagnosis.first_screen import (
    error_sentence,
    evidence_bars,
    missing_sentence,
)
from pneunet_ros.reports.diagnosis.tables import (
    added_effects,
    adequacy_table,
    ANSWERS,
    detectable_table,
    effect_table,
    error_table,
    evidence_table,
    shift_table,
    similarity_table,
    undetectable_sentence,
    where_table,
    where_text,
)
from pneunet_ros.reports.figure import Pictures, render_page

TEMPLATE = 'diagnosis_report.html.jinja'
UNSETTLED = 'unsettled_report.html.jinja'
SIMILAR_COSINE = 0.5  # from it a table lists two effects as similar


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """Command-line arguments that the page repeats; unknown ones are placeholders (MODEL.yaml).

    notes: on the recordings; model: file of the diagnosed model; recordings: files of all
    recordings; folder: output folder of the page and its files.
    """

    notes: tuple[str, ...] = ()
    model: str = 'MODEL.yaml'
    recordings: tuple[str, ...] = ()
    folder: str = 'DIR'


NOTHING_GIVEN = Given()


def report_page(
    diagnosis: Diagnosis,
    pictures: Pictures,
    provenance: Mapping[str, Any],
    discovery: Discovery = NOTHING_SEARCHED,
    given: Given = NOTHING_GIVEN,
) -> str:
    """Return the page with embedded figures."""
    next_step, command = next_steps(diagnosis, discovery, given)
    return render_page(
        TEMPLATE,
        diagnosis=diagnosis,
        discovery=discovery,
        discovered_error=(
            discovered_sentence(diagnosis, discovery) if discovery.evaluation else ''
        ),
        stiffness=stiffness_change(diagnosis),
        next_step=next_step,
        command=command,
        replay_discovered=replay_discovered(given),
        notes=(*given.notes, *diagnosis.notes),
        arm=diagnosis.before.arm,
        added=added_effects(diagnosis),
        meaning=ANSWERS[diagnosis.answer],
        missing=missing_sentence(diagnosis),
        bars=evidence_bars(diagnosis, discovery),
        error_sentence=error_sentence(diagnosis),
        where_text=where_text(diagnosis),
        undetectable=undetectable_sentence(diagnosis),
        pictures=pictures,
        error=error_table(diagnosis, discovery),
        adequacy=adequacy_table(diagnosis),
        where=where_table(diagnosis),
        effects=effect_table(diagnosis),
        evidence=evidence_table(diagnosis),
        similar=similarity_table(diagnosis, SIMILAR_COSINE),
        shift=shift_table(diagnosis),
        detectable=detectable_table(diagnosis),
        provenance=flat(provenance),
    )


def unsettled_page(
    diagnosis: UnsettledDiagnosis,
    name: str,
    provenance: Mapping[str, Any],
    given: Given = NOTHING_GIVEN,
) -> str:
    """Return the page of a diagnosis without numbers; name: of the model."""
    names = shlex.join(given.recordings) or 'REC...'
    return render_page(
        UNSETTLED,
        diagnosis=diagnosis,
        name=name,
        notes=(*given.notes, *diagnosis.notes),
        command=f'pneunet check {names} --model {shlex.quote(given.model)}',
        provenance=flat(provenance),
    )


def stiffness_change(diagnosis: Diagnosis) -> str:
    """Describe the bending stiffness, before and after an effect was added."""
    before, after = diagnosis.before.fit, diagnosis.after.fit
    found = bending_stiffness(after)
    if not found:
        return 'not measured: no training recording is under load'
    if not added_effects(diagnosis):
        return stiffness_text(bending_stiffness(before))
    return f'{stiffness_text(found)}; before: {stiffness_text(bending_stiffness(before))}'


def replay_discovered(given: Given) -> str:
    """Return the command that tests the model with the discovered law."""
    model, effects = f'{given.folder}/model_discovered.yaml', f'{given.folder}/effects'
    return f'pneunet replay FRESH.mcap {shlex.join(["--model", model, "--effects-path", effects])}'


def next_steps(
    diagnosis: Diagnosis, discovery: Discovery, given: Given = NOTHING_GIVEN
) -> tuple[str, str]:
    """Return the next step and its command."""
    if any(law.effect_file for law in discovery.found):
        step = 'Test the discovered law on a recording that it has not seen.'
        return f'{step} {diagnosis.proposal}'.rstrip(), replay_discovered(given)
    if diagnosis.answer in CLEAR and not diagnosis.proposal:
        step = 'Test the model of this folder on a recording that it has not seen.'
        model = shlex.quote(f'{given.folder}/model.yaml')
        return step, f'pneunet replay FRESH.mcap --model {model}'
    step = diagnosis.proposal or 'Make more recordings, and diagnose again.'
    if diagnosis.answer == 'unobservable' and not diagnosis.proposal:
        step = 'Paint more targets along the arm, and record again.'
    model = shlex.quote(given.model)
    names = shlex.join(item.run.name for item in diagnosis.before.fit.runs)
    return step, (
        f'pneunet diagnose --model {model} --train {names} NEW.mcap --heldout FRESH.mcap '
        '--output NEW_DIR'
    )
