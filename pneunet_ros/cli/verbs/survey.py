"""`pneunet survey`: check, calibrate and diagnose every arm of a fleet; one page for all arms."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.cli.provenance import versions
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.executor import open_executor
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.core.progress import ignore_progress
from pneunet_ros.core.share import share_path
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.files.json_text import json_text
from pneunet_ros.files.model_file import load_model
from pneunet_ros.messages.readings import SENSORS
from pneunet_ros.offline.survey import (
    arm_key,
    FleetArm,
    folders_left_out,
    read_fleet,
    sentence_of,
    SurveyFolder,
    work_on_fleet,
)
from rich.console import Console
from rich.progress import Progress

if TYPE_CHECKING:
    from pneunet_ros.calibration.fleet import Fleet
    from pneunet_ros.cli.survey_arm import SurveyRequest
    from pneunet_ros.reports.survey.survey_data import SurveyData, SurveyedArm


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        'To resume an interrupted survey, give the same command again. Exit codes: 0 all arms '
        'are done; 1 an arm failed (its row gives the reason); 2 invalid request or file. Files: '
        'survey.html, survey.json, and in arms/NAME the files of `calibrate` and `diagnose`.'
    )
    parser.add_argument(
        'source',
        type=Path,
        metavar='FOLDER|TABLE',
        help='a folder with one folder per arm; the names of its recordings, or of the folders '
        'that contain them, begin with unloaded, loaded or heldout; arm.yaml is in the '
        'folder of the arm, or in FOLDER for all arms. Or a CSV table with one row per arm: '
        'name, arm, unloaded, loaded, heldout',
    )
    parser.add_argument(
        '--output',
        type=Path,
        required=True,
        metavar='DIR',
        help='write into this folder; arms already finished in it are kept',
    )
    parser.add_argument(
        '--arm',
        type=Path,
        metavar='FILE',
        help="arm file for arms that have none (default: the shipped model of the paper's arm)",
    )
    verb.add_static(parser)
    verb.add_seed(parser, 'random seed of the simulated data that set the thresholds (default: 0)')
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        '--workers',
        type=int,
        metavar='N',
        help='number of arms to process at the same time (default: one per core)',
    )
    where.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='run on the Dask cluster of this scheduler; its workers need the same version of '
        'this package, and the recordings under the same paths',
    )
    verb.add_overwrite(parser)
    verb.add_effects_path(parser)
    verb.add_topics(parser)
    verb.add_settings(parser, verb.SENSOR_SETTINGS)


def run(arguments: Namespace) -> int:
    """Process the remaining arms, and write the page."""
    from pneunet_ros.cli.survey_arm import SurveyRequest
    from pneunet_ros.reports.survey.report import REPLACEABLE

    started = time.perf_counter()
    arm = resolve_links(arguments.arm or share_path(verb.PAPER_ARM))
    fleet = read_fleet(resolve_links(arguments.source), arm)
    verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS])
    request = SurveyRequest(
        static=arguments.static,
        topic=tuple(arguments.topic),
        sensors={name: getattr(arguments, name) for name in verb.SENSOR_SETTINGS},
        seed=arguments.seed,
        effects_path=''
        if arguments.effects_path is None
        else str(resolve_links(arguments.effects_path)),
    )
    folder = SurveyFolder(path=arguments.output, overwrite=arguments.overwrite)
    folder.check(REPLACEABLE)
    with verb.progress_bar(shown=not arguments.json) as bar:
        survey = Survey(folder=folder, request=request, bar=bar)
        rows = survey.rows_of(fleet, arguments.workers, arguments.scheduler)
        data = survey.data_of(str(arguments.source), fleet, rows)
        provenance = {'seed': arguments.seed, 'versions': versions(), 'request': asdict(request)}
        content = survey.write(data, provenance)
    content |= {'output': arguments.output, 'kept': survey.kept}
    content |= {'seconds': time.perf_counter() - started}
    verb.present(arguments, content, lambda console: show(data, content, console))
    return verb.NEGATIVE if any(item.failed for item in data.arms) else verb.DONE


@dataclass(slots=True, kw_only=True)
class Survey:
    """A survey in progress; kept: number of arms finished in an earlier run."""

    folder: SurveyFolder
    request: SurveyRequest
    bar: Progress
    kept: int = 0

    def rows_of(
        self, fleet: Sequence[FleetArm], workers: int | None, scheduler: str | None
    ) -> dict[str, dict[str, Any]]:
        """Return the row of every arm by name, whether finished before or now."""
        from pneunet_ros.cli.survey_arm import SurveyWork
        from pneunet_ros.offline.calibration_files import check_distinct, file_hash

        decided = asdict(self.request) | {'versions': versions()}
        if self.request.effects_path:
            files = sorted(Path(self.request.effects_path).glob('*.py'))
            decided['effects'] = {file.name: file_hash(file) for file in files}
        rows: dict[str, dict[str, Any]] = {}
        jobs: dict[str, dict[str, Any]] = {}
        for arm in self.bar.track(fleet, description='reading the arms'):
            try:
                key, inputs = arm_key(arm, decided)
                check_distinct(inputs)
            except PneunetError as error:
                rows[arm.name] = row_of(arm, {}, failed=sentence_of(error))
                continue
            kept = self.folder.finished_row(arm.name, key)
            if kept is None:
                jobs[arm.name] = {'key': key, 'inputs': inputs}
            else:
                rows[arm.name] = kept
                self.kept += 1
        pending = [arm for arm in fleet if arm.name in jobs]
        concurrency = len(pending) if scheduler else workers or os.cpu_count() or 1
        task = self.bar.add_task('arms', total=len(fleet), completed=len(fleet) - len(pending))
        for arm, outcome in work_on_fleet(
            pending,
            SurveyWork(request=self.request),
            lambda: open_executor(workers=workers, scheduler=scheduler),
            concurrency,
        ):
            rows[arm.name] = self.keep(arm, outcome, jobs[arm.name])
            self.bar.update(task, advance=1, description=f'arms, {arm.name} is done')
        return rows

    def keep(
        self, arm: FleetArm, outcome: Mapping[str, bytes] | Exception, job: dict[str, Any]
    ) -> dict[str, Any]:
        """Store the results of an arm, and return its row.

        Failures of the process, such as a worker that died, are not stored, so that the arm is
        processed again.
        """
        from pneunet_ros.cli.survey_arm import FOUND

        if isinstance(outcome, PneunetError):
            row = row_of(arm, job, failed=sentence_of(outcome))
            self.folder.write(arm.name, {}, row)
            return row
        if isinstance(outcome, Exception):
            return row_of(arm, job, failed=sentence_of(outcome))
        files = dict(outcome)
        found = json.loads(files.pop(FOUND))
        row = row_of(arm, job, found=found)
        self.folder.write(arm.name, files, row)
        return row

    def data_of(
        self, source: str, fleet: Sequence[FleetArm], rows: Mapping[str, Mapping[str, Any]]
    ) -> SurveyData:
        """Return the arms with their models, and the comparison of the models."""
        from pneunet_ros.reports.survey.survey_data import SurveyData, SurveyedArm

        arms = []
        for item in fleet:
            row, folder = rows[item.name], self.folder.folder(item.name)
            found = row['found']
            arms.append(
                SurveyedArm(
                    name=item.name,
                    folder=folder.relative_to(self.folder.path).as_posix(),
                    failed=row['failed'],
                    found=found,
                    arm=load_model(folder / found['model']) if found else None,
                    recordings=tuple(map(str, item.recordings)),
                    arm_file=str(item.arm),
                )
            )
        return SurveyData(
            source=source,
            arms=tuple(arms),
            fleet=compare(arms, self.request.seed),
            output=str(self.folder.path),
            left_out=folders_left_out(Path(source), fleet),
        )

    def write(self, data: SurveyData, provenance: Mapping[str, Any]) -> dict[str, Any]:
        """Write the page, its figures and the JSON; return the content of the JSON."""
        from pneunet_ros.reports.figure import draw_figures
        from pneunet_ros.reports.survey.report import (
            FIGURES,
            NUMBERS,
            PAGE,
            survey_content,
            survey_page,
        )

        pictures = draw_figures(FIGURES, data, ignore_progress)
        content = survey_content(data, provenance)
        files = {
            PAGE: survey_page(data, pictures, provenance).encode(),
            NUMBERS: json_text(content, indent=1).encode(),
        } | {item.file: item.png for part in pictures.values() for item in part}
        for name, text in files.items():
            with atomic_output(self.folder.path / name, overwrite=True) as path:
                path.write_bytes(text)
        return content


def row_of(
    arm: FleetArm,
    job: Mapping[str, Any],
    *,
    failed: str = '',
    found: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the row of an arm: its inputs and results."""
    return {'name': arm.name, **job, 'failed': failed, 'found': dict(found or {})}


def compare(arms: Sequence[SurveyedArm], seed: int) -> Fleet:
    """Compare the arms that have a model."""
    from pneunet_ros.calibration.fleet import arm_numbers, compare_arms, compared_pressure

    known = {item.name: (item.arm, item.found['loaded']) for item in arms if item.arm is not None}
    models = {name: arm for name, (arm, _) in known.items() if arm is not None}
    pressure = compared_pressure(list(models.values())) if models else np.nan
    numbers = {
        name: arm_numbers(arm, pressure, loaded=known[name][1]) for name, arm in models.items()
    }
    return compare_arms(numbers, pressure, seed=seed)


def show(data: SurveyData, content: Mapping[str, Any], console: Console) -> None:
    """Print the results of a survey."""
    from pneunet_ros.reports.survey.report import arm_row, NUMBERS, PAGE, survey_sentences

    rows: list[Sequence[str]] = []
    for item in data.arms:
        if item.failed:
            rows.append((item.name, 'failed'))
            continue
        row = arm_row(item, data)
        name = f'{item.name} (outlier)' if row['odd'] else item.name
        rows.append((name, row['finding'], row['before'], row['after'], row['distance']))
    title = f'{len(data.arms)} arms, {content["kept"]} of them done before'
    columns = ('arm', 'missing', 'before (mm)', 'after (mm)', 'p as alike')
    print_rows(console, title, columns, rows, numbers=range(2, 5))
    for sentence in survey_sentences(data):
        console.print(sentence)
    for name in (PAGE, NUMBERS):
        console.print(f'wrote {content["output"] / name}')
