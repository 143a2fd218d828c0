"""`pneunet simulate`: a recording of a scenario in the virtual lab, with its ground truth."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
import dataclasses
from pathlib import Path
import time
from typing import Any

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_facts
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.files.scenario_file import changes_of, FOLDER, load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.scenario import describe, Scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.recordings.lab_files import memory_after, message_count, truth_file, write_lab
from rich.console import Console


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'scenario',
        metavar='SCENARIO',
        help='a scenario file, YAML, or the name of a shipped one: unloaded_ramp, '
        'unloaded_staircase, dead_weights, force_sweeps, strings, random_mix, ringing',
    )
    verb.add_output(
        parser,
        'REC',
        'write the recording here, an .mcap file or a rosbag2 folder, and the ground truth next '
        'to it: x.truth.npz for x.mcap',
    )
    verb.add_seed(
        parser, 'random seed of the noise of this recording, not of the arm', default=None
    )
    verb.add_seed(
        parser,
        'random seed of another arm of the same type: parameters up to 15 %% off, targets '
        'repainted (0: the arm of the scenario)',
        '--arm-seed',
        default=None,
    )
    parser.add_argument(
        '--effect',
        action='append',
        default=[],
        metavar='NAME.PARAMETER=VALUE',
        help='set a parameter of an effect, e.g. gravity.weight_y=-1.5, or its `richness`; may '
        'be repeated',
    )
    parser.add_argument(
        '--after',
        type=Path,
        metavar='REC',
        help='start with the loading history of this earlier recording of the lab (default: an '
        'unconditioned arm at rest)',
    )
    parser.add_argument(
        '--engine',
        choices=('chain', 'mujoco'),
        help='chain: the arm is always in equilibrium; mujoco: it has mass, and MuJoCo simulates '
        'its motion; with both, the base moves as described by the block `motion` of the '
        'scenario (default: mujoco if there is such a block)',
    )


def run(arguments: Namespace) -> int:
    """Simulate and write."""
    file, after = scenario_file(arguments.scenario), arguments.after
    scenario = load_scenario(file)
    if arguments.arm_seed is not None:
        scenario = dataclasses.replace(scenario, arm=vary_arm(scenario.arm, arguments.arm_seed))
    if arguments.seed is not None:
        scenario = dataclasses.replace(scenario, seed=arguments.seed)
    scenario = scenario.with_effects(changes_of(arguments.effect))
    if arguments.engine == 'mujoco' or (arguments.engine and scenario.effective_motion):
        inertia = float(arguments.engine == 'mujoco')
        motion = dataclasses.replace(scenario.effective_motion or LabMotion(), inertia=inertia)
        scenario = dataclasses.replace(scenario, motion=motion)
    memory = None if after is None else memory_after(after)
    started = time.perf_counter()
    recording = simulate(scenario, memory)
    seconds = time.perf_counter() - started
    with verb.progress_bar(shown=not arguments.json) as bar:
        task = bar.add_task('writing', total=message_count(recording))
        truth = write_lab(
            recording,
            arguments.output,
            overwrite=arguments.overwrite,
            on_progress=lambda: bar.advance(task),
            inputs=[file] if after is None else [file, after, truth_file(after)],
        )
    summary = summary_of(recording) | {
        'output': arguments.output,
        'truth': truth,
        'seconds': seconds,
    }
    content = summary | {'scenario': describe(scenario)}
    verb.present(arguments, content, lambda console: show(scenario, summary, console))
    return verb.DONE


def scenario_file(name: str) -> Path:
    """Return the file of a scenario, given as a path or the name of a shipped one."""
    path = Path(name)
    if path.is_file() or path.suffix:
        return path
    if name not in shipped_names():
        raise RequestError(
            f'{name} is neither a scenario file nor a shipped scenario; shipped are '
            f'{", ".join(shipped_names())}',
            reason='not_found',
        )
    return share_path(f'{FOLDER}/{name}.yaml')


def shipped_names() -> list[str]:
    """Return the names of the shipped scenarios, without the arm file that they share."""
    return sorted(
        file.stem for file in share_path(FOLDER).glob('*.yaml') if file.stem != 'lab_arm'
    )


def summary_of(recording: LabRecording) -> dict[str, Any]:
    """Return the summary of a recording."""
    truth, seen = recording.truth, np.isfinite(recording.x)
    tip = np.hypot(np.ptp(truth.x[:, -1]), np.ptp(truth.y[:, -1]))
    return {
        'name': recording.scenario.name,
        'arm': recording.scenario.arm.name,
        'loaded': recording.loaded,
        'duration': recording.memory.time - recording.scenario.start,
        'frames': recording.stamp_ns.size,
        'pressure_readings': recording.reading_stamp_ns.size,
        'wrench_readings': recording.wrench_stamp_ns.size,
        'targets': seen.shape[1],
        'seen': float(seen.mean()),
        'pressure_range': [truth.pressure.min(), truth.pressure.max()],
        'force_range': [truth.force.min(axis=0), truth.force.max(axis=0)],
        'tip_travel': float(tip),
    }


def show(scenario: Scenario, summary: dict[str, Any], console: Console) -> None:
    """Print the summary for people."""
    low, high = (kilopascals(value) for value in summary['pressure_range'])
    (low_x, low_y), (high_x, high_y) = summary['force_range']
    force = f'F1 {low_x:.3f} to {high_x:.3f} N, F2 {low_y:.3f} to {high_y:.3f} N'
    readings = f'{summary["pressure_readings"]} of pressure'
    if summary['loaded']:
        readings += f', {summary["wrench_readings"]} of end wrench'
    facts = {
        'protocol': f'{scenario.protocol.kind}, {summary["duration"]:g} s',
        'effects': ', '.join(effect_texts(scenario)) or 'none',
        'pressure': f'{low:z.1f} to {high:z.1f} kPa',
        'end force': force if summary['loaded'] else 'none: unloaded',
        'frames': f'{summary["frames"]} with {summary["targets"]} targets',
        'targets seen': f'{100.0 * summary["seen"]:.1f} %',
        'readings': readings,
        'tip travels over': f'{millimeters(summary["tip_travel"]):.1f} mm',
        'seeds': f'noise {scenario.seed}, arm {scenario.arm.seed}',
        'took': f'{summary["seconds"]:.2f} s',
    }
    print_facts(console, f'{summary["name"]} on {summary["arm"]}', facts)
    for name in ('output', 'truth'):
        console.print(f'wrote {summary[name]}')


def effect_texts(scenario: Scenario) -> list[str]:
    """Return a text per effect, with its parameters that are not neutral."""
    texts = []
    for effect in scenario.effects:
        set_ = [
            f'{item.name}={getattr(effect, item.name):g}'
            for item in dataclasses.fields(effect)
            if getattr(effect, item.name) != item.default
        ]
        texts.append(f'{effect.name} ({", ".join(set_)})')
    return texts
