"""The report of a calibration: one self-contained HTML page, and its figures as PNG."""

from __future__ import annotations

from collections.abc import Mapping
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.reports.calibration.figures import calibration_figures
from pneunet_ros.reports.calibration.tables import (
    curvature_table,
    flat,
    law_rows,
    noise_rows,
    number_rows,
    Row,
)
from pneunet_ros.reports.calibration.verdict import Files, residual_rms, UNKNOWN_FILES, verdict_of
from pneunet_ros.reports.figure import Pictures, render_page

PAGE = 'index.html'
TEMPLATE = 'calibration_report.html.jinja'
REPLACEABLE = (PAGE, 'figure_*.png')  # all files of an earlier report


def write_report(
    calibration: Calibration,
    directory: str | Path,
    *,
    provenance: Mapping[str, Any],
    overwrite: bool = False,
    files: Files = UNKNOWN_FILES,
    on_progress: OnProgress = ignore_progress,
) -> Path:
    """Write the report of a calibration into a folder, and return the path of its page.

    The folder is written atomically. provenance: nested information on the inputs, shown
    unchanged; files: of the next command. Raises RecordingError if the folder exists (without
    `overwrite`), contains anything other than an earlier report, or cannot be written.
    """
    with atomic_output(directory, overwrite=overwrite, replaceable=REPLACEABLE) as folder:
        folder.mkdir()
        pictures = calibration_figures(calibration, on_progress)
        for item in itertools.chain(*pictures.values()):
            (folder / item.file).write_bytes(item.png)
        page = report_page(calibration, pictures, provenance, files)
        (folder / PAGE).write_text(page, encoding='utf-8')
    return Path(directory) / PAGE


def report_page(
    calibration: Calibration,
    pictures: Pictures,
    provenance: Mapping[str, Any],
    files: Files = UNKNOWN_FILES,
) -> str:
    """Return the page with embedded figures."""
    rows = number_rows(calibration)
    return render_page(
        TEMPLATE,
        arm=calibration.arm,
        verdict=verdict_of(calibration, files=files),
        summary=summary(calibration, rows),
        notes=calibration.notes,
        pictures=pictures,
        law=law_rows(rows),
        curvature=curvature_table(calibration, rows),
        noise=noise_rows(calibration),
        provenance=flat(provenance),
    )


def summary(calibration: Calibration, rows: tuple[Row, ...]) -> list[tuple[str, str]]:
    """Return the most important results as pairs of question and answer."""
    fit, free, arm = calibration.joint, calibration.free, calibration.arm
    runs = [item.run for item in fit.runs]
    loaded = sum(run.loaded for run in runs)
    frames = sum(len(run.stamp_ns) for run in runs)
    low, high = (kilopascals(value) for value in arm.pressure_range)
    missing = sum(int(np.count_nonzero(~item.solved)) for item in fit.runs)
    summary_rows = [
        ('Recordings', f'{len(runs) - loaded} unloaded, {loaded} loaded; {frames} frames'),
        ('Pressures', f'{low:z.1f} to {high:z.1f} kPa'),
        *([] if arm.domain is None else [('The model is calibrated for', arm.domain.words)]),
        ('Moment law', f'{arm.moment_law.kind}'),
        ('Fit', f'{fit.status} after {fit.steps} steps'),
        ('Chi squared per coordinate', f'{fit.chi_squared / fit.dof:.3f}; 1 is expected'),
        ('Residual', f'{millimeters(residual_rms(fit)):.3f} mm rms per coordinate'),
        ('Numbers determined', f'{sum(row.determined for row in rows)} of {len(rows)}'),
        (
            'Covariance in the model file',
            f"has {100.0 * calibration.explained_variance:.1f} % of the shape's variance",
        ),
    ]
    if loaded:
        first = f'{free.status}, chi squared per coordinate {free.chi_squared / free.dof:.3f}'
        summary_rows.insert(4, ('Fit of the unloaded recordings alone', first))
    if missing:
        summary_rows.append(
            ('Frames without an equilibrium', f'{missing} of {frames}, not counted')
        )
    if calibration.laws:
        best = min(calibration.laws, key=lambda item: item.rank)
        summary_rows.append(
            ('Best on left-out recordings', f'{best.kind}, {millimeters(best.rms):.3f} mm rms')
        )
    return summary_rows
