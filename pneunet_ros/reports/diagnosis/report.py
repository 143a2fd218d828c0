"""The report of a diagnosis: one HTML page that needs nothing else, and its pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.reports.calibration.figure_data import Each
from pneunet_ros.reports.calibration.tables import flat
from pneunet_ros.reports.diagnosis.error_figures import gap, gap_sentence, shapes
from pneunet_ros.reports.diagnosis.evidence_figures import evidence, hidden
from pneunet_ros.reports.diagnosis.localization_figures import maps, shares
from pneunet_ros.reports.diagnosis.loop_figures import loops
from pneunet_ros.reports.diagnosis.tables import (
    added_effects,
    adequacy_table,
    alike_table,
    ANSWERS,
    detectable_table,
    effect_table,
    evidence_table,
    gap_table,
    shift_table,
    unseen_sentence,
    where_table,
    where_text,
)
from pneunet_ros.reports.page import rendered
from pneunet_ros.reports.style import Picture

TEMPLATE = 'diagnosis_report.html.jinja'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pictures:
    """The pictures of a diagnosis, by the part of the page in which they stand."""

    gap: tuple[Picture, ...]
    where: tuple[Picture, ...]
    evidence: tuple[Picture, ...]
    hidden: tuple[Picture, ...]

    @property
    def all(self) -> tuple[Picture, ...]:
        """All of them, in the order of the page."""
        return (*self.gap, *self.where, *self.evidence, *self.hidden)


def diagnosis_figures(
    diagnosis: Diagnosis,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    each: Each,
) -> Pictures:
    """Draw all pictures that there is something for; `each` is told how far it is."""
    draws: list[tuple[str, Callable[[], Picture | None]]] = [
        ('gap', lambda: gap(diagnosis)),
        ('gap', lambda: shapes(diagnosis, training, held_out)),
        ('where', lambda: maps(diagnosis) if diagnosis.heat_maps else None),
        ('where', lambda: shares(diagnosis) if diagnosis.where else None),
        ('where', lambda: loops(diagnosis)),
        ('evidence', lambda: evidence(diagnosis)),
        ('hidden', lambda: hidden(diagnosis) if added_effects(diagnosis) else None),
    ]
    found: dict[str, list[Picture]] = {part: [] for part, _ in draws}
    for count, (part, draw) in enumerate(draws):
        each('pictures', count, len(draws))
        drawn = draw()
        if drawn is not None:
            found[part].append(drawn)
    each('pictures', len(draws), len(draws))
    return Pictures(**{part: tuple(some) for part, some in found.items()})


def report_page(diagnosis: Diagnosis, pictures: Pictures, provenance: Mapping[str, Any]) -> str:
    """Return the page, pictures inside."""
    return rendered(
        TEMPLATE,
        diagnosis=diagnosis,
        arm=diagnosis.before.arm,
        added=added_effects(diagnosis),
        meaning=ANSWERS[diagnosis.answer],
        gap_sentence=gap_sentence(diagnosis),
        where_text=where_text(diagnosis),
        unseen=unseen_sentence(diagnosis),
        pictures=pictures,
        gap=gap_table(diagnosis),
        adequacy=adequacy_table(diagnosis),
        where=where_table(diagnosis),
        effects=effect_table(diagnosis),
        evidence=evidence_table(diagnosis),
        alike=alike_table(diagnosis),
        shift=shift_table(diagnosis),
        detectable=detectable_table(diagnosis),
        provenance=flat(provenance),
    )
