"""A diagnosis as files: `diagnosis.json`, the augmented `model.yaml`, and the report.

If a law was discovered, the file of the proposed effect and a model with it are added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.calibration.calibration import domain_of
from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.core.settings import settings_changed, settings_used
from pneunet_ros.core.units import quantities
from pneunet_ros.diagnosis.result import Diagnosis, Evaluation, Misfit, UnsettledDiagnosis
from pneunet_ros.diagnosis.settings import FIXED
from pneunet_ros.discovery.proposed_effect import PREFIX
from pneunet_ros.discovery.result import Discovered, Discovery, NOTHING_SEARCHED
from pneunet_ros.discovery.settings import FIXED as FIXED_IN_DISCOVERY
from pneunet_ros.files.json_text import json_text, plain
from pneunet_ros.files.model_file import save_model
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.diagnosis.figures import FIGURES
from pneunet_ros.reports.diagnosis.report import Given, NOTHING_GIVEN, report_page, unsettled_page
from pneunet_ros.reports.figure import draw_figures

NUMBERS, MODEL, PAGE = 'diagnosis.json', 'model.yaml', 'report.html'
DISCOVERED_MODEL, EFFECTS_FOLDER = 'model_discovered.yaml', 'effects'
# All files of an earlier diagnosis.
REPLACEABLE = (
    NUMBERS,
    MODEL,
    PAGE,
    DISCOVERED_MODEL,
    'figure_*.png',
    f'{EFFECTS_FOLDER}/proposed_*.py',
    f'{EFFECTS_FOLDER}/__pycache__',
)


def write_diagnosis(
    diagnosis: Diagnosis | UnsettledDiagnosis,
    folder: Path,
    *,
    frame: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    provenance: Mapping[str, Any],
    discovery: Discovery = NOTHING_SEARCHED,
    given: Given = NOTHING_GIVEN,
    on_progress: OnProgress = ignore_progress,
) -> dict[str, Any]:
    """Write all files of a diagnosis into a new folder; return the content of its JSON.

    frame: the given model; training, held_out: the runs as given to the diagnosis; provenance:
    `inputs` (file, sha256 and role of each) and `versions`; discovery: discovered laws outside the
    library; given: notes and names for the page. The folder must not exist;
    `files.atomic.atomic_output` writes it atomically.
    """
    folder.mkdir()
    origin = {**provenance, 'seed': diagnosis.seed}
    if isinstance(diagnosis, UnsettledDiagnosis):
        return write_unsettled(diagnosis, folder, frame, origin, given)
    data = FigureData(
        diagnosis=diagnosis, training=training, held_out=held_out, discovery=discovery
    )
    pictures = draw_figures(FIGURES, data, on_progress)
    for item in itertools.chain(*pictures.values()):
        (folder / item.file).write_bytes(item.png)
    page = report_page(diagnosis, pictures, origin, discovery, given)
    (folder / PAGE).write_text(page, encoding='utf-8')
    save_model(diagnosed_arm(diagnosis, diagnosis.after, frame, origin), folder / MODEL)
    if discovery.evaluation is not None:
        write_discovered(discovery, diagnosis, folder, frame, origin)
    content = diagnosis_content(diagnosis, provenance, discovery)
    (folder / NUMBERS).write_text(json_text(content, indent=1), encoding='utf-8')
    return content


def write_discovered(
    discovery: Discovery,
    diagnosis: Diagnosis,
    folder: Path,
    frame: Arm,
    provenance: Mapping[str, Any],
) -> None:
    """Write the files of the proposed effects, and the model with the first of them."""
    assert discovery.evaluation is not None
    (folder / EFFECTS_FOLDER).mkdir()
    for law in discovery.found:
        if law.source is not None and law.effect_file is not None:
            (folder / law.effect_file).write_text(law.source, encoding='utf-8')
    arm = diagnosed_arm(diagnosis, discovery.evaluation, frame, provenance)
    save_model(arm, folder / DISCOVERED_MODEL)


def write_unsettled(
    diagnosis: UnsettledDiagnosis,
    folder: Path,
    frame: Arm,
    provenance: Mapping[str, Any],
    given: Given,
) -> dict[str, Any]:
    """Write the page and the JSON of a diagnosis without numbers and without a model."""
    page = unsettled_page(diagnosis, frame.name, provenance, given)
    (folder / PAGE).write_text(page, encoding='utf-8')
    content: dict[str, Any] = plain(
        {
            'answer': diagnosis.answer,
            'sentence': diagnosis.sentence,
            'effects': [],
            'alternatives': [],
            'where': [],
            'gap': dict.fromkeys(
                ('training', 'heldout', 'noise_floor_m', 'closed', 'closed_discovered')
            ),
            'adequacy': dict.fromkeys(('before', 'after')),
            'detectable': {},
            'parameter_shift': {},
            'discovered': [],
            'notes': diagnosis.notes,
            **provenance,
            **final_content(diagnosis),
        }
    )
    (folder / NUMBERS).write_text(json_text(content, indent=1), encoding='utf-8')
    return content


def discovered_content(law: Discovered) -> dict[str, Any]:
    """Return a discovered law with the keys of the contract."""
    content = asdict(law)
    del content['source']
    return content


def final_content(diagnosis: Diagnosis | UnsettledDiagnosis) -> dict[str, Any]:
    """Return the last keys of every JSON of a diagnosis."""
    used = settings_used(diagnosis.settings, *FIXED, *FIXED_IN_DISCOVERY)
    settings = {'used': used, 'not_default': settings_changed(diagnosis.settings)}
    return {'seed': diagnosis.seed, 'settings': settings}


def diagnosis_content(
    diagnosis: Diagnosis, provenance: Mapping[str, Any], discovery: Discovery = NOTHING_SEARCHED
) -> dict[str, Any]:
    """Return the content of `diagnosis.json`; see docs/diagnosis.md."""
    before, after, found = diagnosis.before, diagnosis.after, discovery.evaluation
    content = {
        'answer': diagnosis.answer,
        'sentence': diagnosis.sentence,
        'certainty': diagnosis.certainty,
        'effects': [asdict(effect) for effect in diagnosis.effects],
        'alternatives': diagnosis.alternatives,
        'where': [
            {
                'axis': item.axis,
                'from': item.start,
                'to': item.stop,
                'share': item.share,
                'seen': item.seen,
                'p_value': item.p_value,
                'sentence': item.sentence,
            }
            for item in diagnosis.where
        ],
        'where_sentence': diagnosis.where_sentence,
        'gap': {
            'training': misfits_content(
                before.training, after.training, None if found is None else found.training
            ),
            'heldout': misfits_content(
                before.held_out, after.held_out, None if found is None else found.held_out
            ),
            'noise_floor_m': diagnosis.noise_floor,
            'closed': diagnosis.closed,
            'closed_discovered': discovery.closed,
        },
        'noise_floor_std_m': diagnosis.noise_floor_std,
        'adequacy': {
            'before': asdict(diagnosis.adequacy_before),
            'after': asdict(diagnosis.adequacy_after),
            'same': asdict(diagnosis.adequacy_same),
        },
        'detectable': {name: asdict(item) for name, item in diagnosis.detectable.items()},
        'parameter_shift': {name: asdict(item) for name, item in diagnosis.shift.items()},
        'evidence': [asdict(item) for item in diagnosis.evidence],
        'cosines': [
            {'effects': pair, 'cosine': value} for pair, value in diagnosis.cosines.items()
        ],
        'proposal': diagnosis.proposal,
        'discovered': [discovered_content(item) for item in discovery.found],
        'notes': (*diagnosis.notes, *discovery.notes),
        **provenance,
        **final_content(diagnosis),
    }
    plain_content: dict[str, Any] = plain(content)
    return plain_content


def misfits_content(
    before: Misfit | None, after: Misfit | None, discovered: Misfit | None
) -> dict[str, Any] | None:
    """Return the model errors of all models with the keys of the contract."""
    if before is None or after is None:
        return None
    columns = {'before': before, 'after': after}
    if discovered is not None:
        columns['discovered'] = discovered
    return {
        when: {'rms_m': item.rms, 'p95_m': item.p95, 'chi2_per_dof': item.chi_squared}
        for when, item in columns.items()
    }


def diagnosed_arm(
    diagnosis: Diagnosis, evaluated: Evaluation, frame: Arm, provenance: Mapping[str, Any]
) -> Arm:
    """Return an augmented arm with its sources and valid range."""
    arm, runs = evaluated.arm, [item.run for item in evaluated.fit.runs]
    known = {effect.name for effect in frame.effects}
    added = [effect.name for effect in arm.effects if effect.name not in known]
    jointly = f', jointly with {", ".join(added)}' if added else ''
    fitted = f'refitted by a diagnosis to {len(runs)} recordings{jointly}'
    sources = dict(frame.sources) | {'intrinsic_curvature': fitted}
    if any(run.loaded for run in runs):
        sources['moment_law'] = fitted
    for effect in arm.effects:
        if effect.name in added:
            names = [f'effects.{effect.name}.{item.name}' for item in quantities(effect)]
            proposed = effect.name.startswith(PREFIX)
            sources |= dict.fromkeys(names, 'discovered' if proposed else 'diagnosed')
    about = {
        'source': f'pneunet diagnose {provenance["versions"]["pneunet_ros"]}',
        'answer': diagnosis.answer,
        'added': added,
        'settings': settings_changed(diagnosis.settings),
        'valid': valid_range(runs),
        **provenance,
    }
    return replace(
        arm,
        name='+'.join([frame.name, *added]),
        domain=domain_of(evaluated.fit),
        sources=sources,
        provenance=plain(about),
    )


def valid_range(runs: Sequence[RecordingData]) -> dict[str, list[float]]:
    """Return the ranges of the training recordings: pressure (Pa), force (N), moment (N m)."""
    spans = {
        'pressure': np.concatenate([run.frame_pressure for run in runs]),
        'force_x': np.concatenate([run.force[:, 0] for run in runs]),
        'force_y': np.concatenate([run.force[:, 1] for run in runs]),
        'moment': np.concatenate([run.moment for run in runs]),
    }
    return {name: [float(values.min()), float(values.max())] for name, values in spans.items()}
