"""The report of a diagnosis: one HTML page that needs nothing else, and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pneunet_ros.core.unit_system import SI, UnitSystem
from pneunet_ros.diagnosis.result import CLEAR, Diagnosis, UnsettledDiagnosis
from pneunet_ros.discovery.result import Discovery, NOTHING_SEARCHED
from pneunet_ros.reports.calibration.tables import flat
from pneunet_ros.reports.calibration.verdict import bending_stiffness, stiffness_text
from pneunet_ros.reports.diagnosis.error_figures import discovered_sentence, error_sentence
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
from pneunet_ros.reports.figure import Pictures, units_note
from pneunet_ros.reports.page import render_page
from pneunet_ros.reports.settings import REPORT_SETTINGS

TEMPLATE = 'diagnosis_report.html.jinja'
UNSETTLED = 'unsettled_report.html.jinja'


def report_page(
    diagnosis: Diagnosis,
    pictures: Pictures,
    provenance: Mapping[str, Any],
    units: UnitSystem = SI,
    discovery: Discovery = NOTHING_SEARCHED,
) -> str:
    """Return the page, pictures inside."""
    next_step, command = next_steps(diagnosis, discovery)
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
        arm=diagnosis.before.arm,
        added=added_effects(diagnosis),
        meaning=ANSWERS[diagnosis.answer],
        error_sentence=error_sentence(diagnosis),
        where_text=where_text(diagnosis),
        undetectable=undetectable_sentence(diagnosis),
        pictures=pictures,
        error=error_table(diagnosis, discovery),
        adequacy=adequacy_table(diagnosis),
        where=where_table(diagnosis),
        effects=effect_table(diagnosis),
        evidence=evidence_table(diagnosis),
        similar=similarity_table(diagnosis, REPORT_SETTINGS.similar_cosine),
        shift=shift_table(diagnosis),
        detectable=detectable_table(diagnosis),
        units_note=units_note(units),
        provenance=flat(provenance),
    )


def unsettled_page(diagnosis: UnsettledDiagnosis, name: str, provenance: Mapping[str, Any]) -> str:
    """Return the page of a diagnosis that has no number; name: of the model."""
    recordings = ' '.join(str(item['file']) for item in provenance.get('inputs', ()))
    return render_page(
        UNSETTLED,
        diagnosis=diagnosis,
        name=name,
        recordings=recordings or 'REC...',
        provenance=flat(provenance),
    )


def stiffness_change(diagnosis: Diagnosis) -> str:
    """Say the bending stiffness, before and after where an effect was added."""
    before, after = diagnosis.before.fit, diagnosis.after.fit
    found = bending_stiffness(after)
    if not found:
        return 'not measured: no training recording is under load'
    if not added_effects(diagnosis):
        return stiffness_text(bending_stiffness(before))
    return f'{stiffness_text(found)}; before: {stiffness_text(bending_stiffness(before))}'


def next_steps(diagnosis: Diagnosis, discovery: Discovery) -> tuple[str, str]:
    """Return what to do next, and the command to type."""
    if any(law.effect_file for law in discovery.found):
        step = 'Test the discovered law on a recording that it has not seen.'
        return (
            f'{step} {diagnosis.proposal}'.rstrip(),
            'pneunet replay FRESH.mcap --model DIR/model_discovered.yaml --effects-path '
            'DIR/effects',
        )
    if diagnosis.answer in CLEAR and not diagnosis.proposal:
        step = 'Test the model of this folder on a recording that it has not seen.'
        return step, 'pneunet replay FRESH.mcap --model DIR/model.yaml'
    step = diagnosis.proposal or 'Record more, and ask again.'
    names = ' '.join(item.run.name for item in diagnosis.before.fit.runs)
    return step, (
        f'pneunet diagnose --model MODEL.yaml --train {names} NEW.mcap --heldout FRESH.mcap '
        '--output DIR'
    )
