"""The results of a diagnosis as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.diagnosis.result import Diagnosis, UnsettledDiagnosis
from pneunet_ros.discovery.result import Discovery
from pneunet_ros.reports.diagnosis.error_figures import discovered_sentence
from pneunet_ros.reports.diagnosis.files import DISCOVERED_MODEL, MODEL, NUMBERS, PAGE
from pneunet_ros.reports.diagnosis.first_screen import error_sentence, missing_sentence
from pneunet_ros.reports.diagnosis.tables import (
    ANSWERS,
    detectable_table,
    effect_table,
    error_table,
    evidence_table,
    Table,
    undetectable_sentence,
    where_text,
)
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.text import Text


def show(
    diagnosis: Diagnosis,
    discovery: Discovery,
    left_out: Sequence[str],
    directory: Path,
    console: Console,
) -> None:
    """Print the answer, then the evidence."""
    console.print(Text(diagnosis.sentence, style='bold'))
    console.print(f'({ANSWERS[diagnosis.answer]})')
    for law in discovery.found:
        console.print(Text(f'Discovered: {law.sentence}', style='bold'))
    console.print(Text(f'Is anything missing? {missing_sentence(diagnosis)}'))
    console.print(Text(f'How sure: {diagnosis.certainty}'))
    print_texts(console, error_table(diagnosis, discovery), 'Model error')
    if diagnosis.before.held_out is None:
        console.print('no recording was held out, so the model error was not measured on new data')
    else:
        console.print(Text(error_sentence(diagnosis)))
    if discovery.evaluation is not None:
        console.print(Text(discovered_sentence(diagnosis, discovery)))
    for table, title in (
        (effect_table(diagnosis), 'Added effects'),
        (evidence_table(diagnosis), 'Evidence'),
    ):
        if table.rows:
            print_texts(console, table, title)
    console.print(Text(where_text(diagnosis)))
    if diagnosis.alternatives:
        console.print(
            f'cannot be distinguished with these data: {", ".join(diagnosis.alternatives)}'
        )
    print_texts(console, detectable_table(diagnosis), 'Detection limits of these recordings')
    console.print(undetectable_sentence(diagnosis))
    if diagnosis.proposal:
        console.print(Text(f'next recording: {diagnosis.proposal}'))
    verb.print_notes(console, (*left_out, *diagnosis.notes, *discovery.notes))
    files = [law.effect_file for law in discovery.found if law.effect_file is not None]
    for name in (PAGE, MODEL, NUMBERS, *([DISCOVERED_MODEL] if files else []), *files):
        console.print(f'wrote {directory / name}')


def show_unsettled(
    diagnosis: UnsettledDiagnosis, left_out: Sequence[str], directory: Path, console: Console
) -> None:
    """Print the reason for a missing diagnosis."""
    console.print(Text(diagnosis.sentence, style='bold'))
    verb.print_notes(console, (*left_out, *diagnosis.notes))
    for name in (PAGE, NUMBERS):
        console.print(f'wrote {directory / name}')


def print_texts(console: Console, table: Table, title: str) -> None:
    """Print a table without the meanings, which are too wide for a terminal."""
    shown = [index for index, name in enumerate(table.columns) if name != 'meaning']
    columns, *rows = ([row[index] for index in shown] for row in (table.columns, *table.rows))
    numbers = [position for position, index in enumerate(shown) if index in table.numbers]
    print_rows(console, title, columns, rows, numbers, box=SIMPLE_HEAD)
