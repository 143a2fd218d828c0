"""`pneunet explore`: record, diagnose, and choose the next recording until an effect is named."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
import sys
import time
from typing import TYPE_CHECKING

from pneunet_ros.cli import verb
from pneunet_ros.cli.quantity_option import quantity_type
from pneunet_ros.core.errors import ModelError, RecordingError, RequestError
from pneunet_ros.core.settings import settings_used
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import kilopascals
from pneunet_ros.exploration.settings import EXPLORATION, ExplorationSettings
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.files.json_text import json_text
from rich.console import Console

if TYPE_CHECKING:
    from pneunet_ros.discovery.result import Discovery
    from pneunet_ros.exploration.experiment_design import Experiment
    from pneunet_ros.exploration.exploration import Round
    from pneunet_ros.exploration.safe_set import SafeSet
    from pneunet_ros.lab.scenario import Scenario
    from pneunet_ros.measurement.dataset import RecordingData
    from pneunet_ros.model.arm import Arm
    from pneunet_ros.reports.diagnosis.report import Given

LAB_MODEL = 'config/lab_arm.yaml'
PAGE, NUMBERS, DIAGNOSIS = 'exploration.html', 'exploration.json', 'diagnosis'
WriteRecording = Callable[['Experiment', 'SafeSet', Path], None]


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        'Exit codes: 0 a new recording confirmed the name, or the answer is "none" and these '
        'recordings would have shown every effect; 1 no such answer within the budget, or a '
        'discovered law replaced the last name; 2 invalid request or file. Files: '
        'recording_NN.mcap, exploration.html and exploration.json after every recording, and at '
        'the end diagnosis/, as written by `diagnose`.'
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        '--simulated',
        metavar='SCENARIO|MODEL',
        help='record in the virtual lab, with the arm of a scenario file or shipped scenario, or '
        'with the arm and effects of a model file',
    )
    source.add_argument(
        '--live',
        action='store_true',
        help='command a live arm, such as the virtual arm, through the topics pressure_command '
        'and force_command; if no node subscribes to force_command, print the load to apply '
        'by hand and wait; Ctrl-C vents the arm',
    )
    source.add_argument(
        '--by-hand',
        action='store_true',
        help='print the pressures and loads to apply by hand, and wait for the recording',
    )
    parser.add_argument(
        '--effect',
        action='append',
        default=[],
        metavar='NAME.PARAMETER=VALUE',
        help='hide an effect in the simulated arm; may be repeated',
    )
    parser.add_argument(
        '--namespace',
        default=None,
        metavar='NAME',
        help='namespace of the topics of a live arm (default: /pneunet)',
    )
    verb.add_seed(parser, 'simulate another arm of the same type', '--arm-seed')
    parser.add_argument(
        '--model',
        type=Path,
        metavar='MODEL.yaml',
        help='the model to be diagnosed (default: that of the shipped arm of the virtual lab)',
    )
    parser.add_argument(
        '--output', type=Path, required=True, metavar='DIR', help='a new folder for all files'
    )
    parser.add_argument(
        '--recordings',
        type=int,
        default=EXPLORATION.recordings,
        metavar='N',
        help=f'largest number of recordings (default: {EXPLORATION.recordings})',
    )
    parser.add_argument(
        '--pressure',
        type=quantity_type('pressure'),
        nargs=2,
        metavar=('LOW', 'HIGH'),
        help='safe range of gauge pressure: Pa, or with a unit, e.g. 60kPa (default: the '
        'calibrated range of the model)',
    )
    parser.add_argument(
        '--largest-force',
        type=quantity_type('force'),
        metavar='N',
        help='largest safe force at the free end: N, or with a unit, e.g. 200mN (default: the '
        'largest of the calibration)',
    )
    verb.add_seed(parser, 'random seed of noise and thresholds (default: 0)')
    verb.add_effects_path(parser)


def run(arguments: Namespace) -> int:
    """Explore, reporting after every recording."""
    from pneunet_ros.discovery.discovery import discover
    from pneunet_ros.exploration.exploration import explore, is_clear
    from pneunet_ros.exploration.proposal import with_proposal
    from pneunet_ros.files.model_file import load_model
    from pneunet_ros.reports.diagnosis.report import Given
    from pneunet_ros.reports.exploration.report import exploration_content, safe_sentence

    started = time.perf_counter()
    if arguments.recordings < 1:
        raise RequestError(
            f'--recordings must be 1 or more, not {arguments.recordings}', reason='out_of_bounds'
        )
    model = load_model(arguments.model or share_path(LAB_MODEL))
    safe = safe_set(arguments, model)
    write = writer_of(arguments, model)
    folder: Path = arguments.output
    if folder.exists():
        raise RecordingError(f'{folder} exists already: choose another name', reason='exists')
    folder.mkdir(parents=True)
    console = Console(stderr=True, quiet=True) if arguments.json else verb.output_console()
    console.print(f'within {safe_sentence(safe)}')
    recorder = Recorder(write=write, model=model, folder=folder, console=console)
    settings = replace(EXPLORATION, recordings=arguments.recordings)
    provenance = provenance_of(model, arguments.seed, settings)
    rounds: list[Round] = []
    with verb.progress_bar(shown=not (arguments.json or arguments.by_hand)) as bar:
        on_progress = verb.progress_of(bar, 'exploring')
        for item in explore(
            model,
            recorder.record,
            safe,
            seed=arguments.seed,
            on_progress=on_progress,
            settings=settings,
        ):
            rounds.append(item)
            write_round(rounds, safe, provenance, folder)
            show_round(rounds, console)
        discovery = discover(rounds[-1].investigation, on_progress=on_progress)
        if discovery.overruling is not None:
            rounds[-1] = rounds[-1].overruled(discovery.overruling)
            write_round(rounds, safe, provenance, folder)
            show_round(rounds, console)
        proposed = with_proposal(rounds[-1].investigation, safe)
        rounds[-1] = replace(rounds[-1], investigation=proposed)
        given = Given(
            notes=tuple(recorder.notes),
            model=str(arguments.model or share_path(LAB_MODEL)),
            folder=str(folder / DIAGNOSIS),
        )
        write_end(rounds[-1], discovery, model, provenance, given)
    if arguments.json:
        content = exploration_content(rounds, safe, provenance)
        verb.print_json(content | {'output': folder, 'seconds': time.perf_counter() - started})
    else:
        show_end(rounds, discovery, given, folder, console)
    return verb.DONE if is_clear(rounds) else verb.NEGATIVE


@dataclass(slots=True, kw_only=True, eq=False)
class Recorder:
    """Records experiments into a folder, and reads the recordings; notes: on excluded readings."""

    write: WriteRecording
    model: Arm
    folder: Path
    console: Console
    notes: list[str] = field(default_factory=list)

    def record(self, experiment: Experiment, limits: SafeSet, number: int) -> RecordingData:
        """Return the recording of an experiment, with the load if there is one."""
        from pneunet_ros.messages.readings import END_WRENCH
        from pneunet_ros.recordings.dataset_reader import read_run

        path = self.folder / f'recording_{number + 1:02d}.mcap'
        self.write(experiment, limits, path)
        targets, gravity = self.model.target_arclength.size, self.model.gravity
        data, sentences = read_run(path, targets, gravity=gravity)
        self.notes.extend(f'{path.name}: {sentence}' for sentence in sentences)
        for sentence in sentences:
            self.console.print(f'note: {path.name}: {sentence}')
        if not experiment.loaded:
            return data.without_load()
        if not data.loaded:
            raise RecordingError(
                f'{path}: the load is missing: a recording under load needs {END_WRENCH.name}, '
                'the force at every time, from a sensor or entered by hand',
                reason='not_loaded',
            )
        return data


def provenance_of(model: Arm, seed: int, settings: ExplorationSettings) -> dict[str, object]:
    """Return the provenance of the answer besides the recordings."""
    from pneunet_ros.cli.provenance import versions
    from pneunet_ros.files.model_file import model_hash

    return {
        'model': {'name': model.name, 'content_sha256': model_hash(model)},
        'seed': seed,
        'versions': versions(),
        'settings': settings_used(settings),
    }


def safe_set(arguments: Namespace, model: Arm) -> SafeSet:
    """Return the safe set of the arm: the requested range within the calibrated one."""
    from pneunet_ros.exploration.safe_set import SafeSet

    known = SafeSet.of(model)
    low, high = arguments.pressure or (known.low, known.high)
    if low == high and known.low < known.high:
        raise RequestError(
            f'--pressure {low:g} {high:g}: the second pressure must be larger',
            reason='out_of_bounds',
        )
    if low < known.low or high > known.high:
        raise RequestError(
            f'--pressure {low:g} {high:g}: the model is calibrated from {known.low:g} to '
            f'{known.high:g} Pa only',
            reason='out_of_range',
        )
    force = known.force if arguments.largest_force is None else arguments.largest_force
    if force > known.force:
        raise RequestError(
            f'--largest-force {force:g}: the model is calibrated up to {known.force:.3g} N only; '
            'calibrate it with larger loads first',
            reason='out_of_range',
        )
    return replace(known, low=low, high=high, force=force)


def writer_of(arguments: Namespace, model: Arm) -> WriteRecording:
    """Return the recorder for the chosen kind of arm: live, simulated, or recorded by hand."""
    from pneunet_ros.offline.live_arm import NAMESPACE, recorder_of
    from pneunet_ros.offline.simulated_arm import SimulatedArm

    if arguments.simulated is not None:
        return SimulatedArm(scenario=simulated_scenario(arguments, model)).record
    if arguments.effect or arguments.arm_seed:
        raise RequestError('--effect and --arm-seed require --simulated', reason='exclusive')
    if arguments.live:
        return recorder_of(arguments.namespace or NAMESPACE)
    if arguments.namespace is not None:
        raise RequestError('--namespace requires --live', reason='exclusive')
    return wait_for_recording


def simulated_scenario(arguments: Namespace, model: Arm) -> Scenario:
    """Return the arm to record, including its hidden effects."""
    from pneunet_ros.cli.verbs.simulate import scenario_file
    from pneunet_ros.files.model_file import load_model
    from pneunet_ros.files.scenario_file import changes_of, load_scenario
    from pneunet_ros.lab.lab_arm import vary_arm
    from pneunet_ros.offline.simulated_arm import scenario_of_model

    try:
        scenario = load_scenario(scenario_file(arguments.simulated))
    except RequestError as first:
        try:
            scenario = scenario_of_model(load_model(arguments.simulated))
        except ModelError:
            raise first from None
    if arguments.arm_seed:
        scenario = replace(scenario, arm=vary_arm(scenario.arm, arguments.arm_seed))
    scenario = replace(scenario, seed=arguments.seed)
    if scenario.arm.targets.size != model.target_arclength.size:
        raise RequestError(
            f'the simulated arm has {scenario.arm.targets.size} targets, but the model has '
            f'{model.target_arclength.size}: give the model of this arm with --model',
            reason='wrong_targets',
        )
    return scenario.with_effects(changes_of(arguments.effect))


def wait_for_recording(experiment: Experiment, safe: SafeSet, path: Path) -> None:
    """Describe the experiment on stderr, and wait for its recording."""
    from pneunet_ros.messages.readings import END_WRENCH

    ask = partial(print, file=sys.stderr, flush=True)
    ask(f'\nRecord next, {experiment.seconds:g} s: {experiment.words}.')
    ask('  s      kPa    F1 (N)  F2 (N)')
    for seconds, pressure, x, y in safe.corners(experiment).tolist():
        ask(f'  {seconds:5.1f}  {kilopascals(pressure):z5.1f}  {x:6.3f}  {y:6.3f}')
    if experiment.loaded:
        ask(f'The recording needs {END_WRENCH.name}: the force at every time.')
    while not path.exists():
        ask(f'Save it as {path}, then press Enter (Ctrl-C quits): ', end='')
        if not sys.stdin.readline():
            raise RequestError(
                f'{path} does not exist, and there is no terminal on which to ask',
                reason='not_found',
            )


def write_round(
    rounds: list[Round], safe: SafeSet, provenance: dict[str, object], folder: Path
) -> None:
    """Write the page, figure and results after a round."""
    from pneunet_ros.reports.exploration.report import (
        exploration_content,
        exploration_page,
        gap_picture,
    )

    files = {
        PAGE: exploration_page(rounds, safe, provenance).encode(),
        NUMBERS: json_text(exploration_content(rounds, safe, provenance), indent=1).encode(),
        'figure_gap.png': gap_picture(rounds).png,
    }
    for name, content in files.items():
        with atomic_output(folder / name, overwrite=True) as path:
            path.write_bytes(content)


def show_round(rounds: list[Round], console: Console) -> None:
    """Print the result of a round."""
    from pneunet_ros.reports.exploration.report import round_row

    row = round_row(len(rounds), rounds[-1])
    console.print(f'{row["number"]}. {row["recorded"]} ({row["why"]})')
    parts = [row['answer']]
    if rounds[-1].diagnosis is not None:
        parts.append(f'model error {row["before"]} -> {row["after"]} mm rms')
    if rounds[-1].predicted is not None:
        parts.append(f'{row["predicted"]} mm in the new recording, predicted before it was made')
    if rounds[-1].rivals:
        parts.append(f'most probable: {row["rivals"]}')
    console.print(f'   {"; ".join(parts)}')


def show_end(
    rounds: list[Round], discovery: Discovery, given: Given, folder: Path, console: Console
) -> None:
    """Print the answer, the next step, and the files."""
    from pneunet_ros.diagnosis.result import Diagnosis
    from pneunet_ros.reports.diagnosis.report import next_steps
    from pneunet_ros.reports.exploration.report import last_sentence

    console.print(last_sentence(rounds))
    last = rounds[-1].investigation.diagnosis
    if isinstance(last, Diagnosis):
        for sentence in next_steps(last, discovery, given):
            console.print(sentence)
    for name in (PAGE, NUMBERS, f'{DIAGNOSIS}/report.html'):
        if (folder / name).exists():
            console.print(f'wrote {folder / name}')


def write_end(
    last: Round, discovery: Discovery, model: Arm, provenance: dict[str, object], given: Given
) -> None:
    """Write the last diagnosis, if there is one, as `diagnose` does."""
    from pneunet_ros.offline.calibration_files import inputs_of
    from pneunet_ros.reports.diagnosis.files import write_diagnosis

    if last.diagnosis is None:
        return
    training = list(last.investigation.recordings[0])
    paths = [Path(item.name) for item in training]
    about = {**provenance, 'inputs': inputs_of([('training', paths)])}
    about.pop('settings')
    about.pop('seed')
    with atomic_output(given.folder) as path:
        write_diagnosis(
            last.diagnosis,
            path,
            frame=model,
            training=training,
            held_out=[],
            provenance=about,
            discovery=discovery,
            given=given,
        )
