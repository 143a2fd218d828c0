"""Halve and double every tuning constant, and list the figures that change.

    python acceptance/sweep.py ROOM... [--output FILE.csv] [--only Class.field ...]
        [--figures NAME ...] [--within SECONDS]

FIGURES are small sets that take seconds: shapes, replays, fused recordings with a cause of error,
calibrations, sealed trials, composed films. All is imported and compiled once; a number is changed
where its class keeps the default and in all instances that are there, and what was cached is
forgotten. It is asked in all sets that read it, the fastest first, until a figure moves. A row of
the table: number, default, and what moved when it was halved and doubled (the figures that moved
most, relative to their size; `nothing` where none moved by more than MOVES; NOT_READ where no set
reads it, so that the sweep says nothing). A whole number of one halves to zero and is left alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
import csv
from dataclasses import dataclass, fields, is_dataclass, replace
import functools
import gc
import importlib
import inspect
import io
import json
import math
from pathlib import Path
import pkgutil
import sys
import tempfile
import time
from typing import Any

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
import pneunet_ros
from pneunet_ros import load_model, save_model, solve, solve_tip
from pneunet_ros.cli.main import main as pneunet
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.share import share_path

CHECKOUT = Path(__file__).resolve().parent.parent
sys.path.append(str(CHECKOUT / 'test'))
KEPT = Path(tempfile.mkdtemp(prefix='pneunet_sweep_'))  # what is simulated or calibrated
MOVES = 1e-3  # relative change of a figure that counts; what rounds differently is not told
SHOWN = 2  # figures that are named
NOT_READ = 'not read'
Figures = dict[str, float | str]
ECHOED = ('fewest', 'most', 'sure')  # the number itself, in what a verb prints
UNSTABLE = (
    'time',
    'version',
    'sha256',
    'seconds',
    'created',
    'file',
    'took',
    'settings',
    'per_s',
    'output',
    'knowledge',
    'knowledge',
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A field made by `tuning`, and the class that owns it."""

    owner: type
    name: str
    default: Any

    @property
    def room(self) -> str:
        return self.owner.__module__.split('.')[1]

    def __str__(self) -> str:
        return f'{self.owner.__name__}.{self.name}'

    def times(self, factor: float) -> Any:
        """Return the default times a factor; None where that is the same or means nothing."""
        changed = scaled(self.default, factor)
        return None if changed == self.default else changed


def scaled(value: Any, factor: float) -> Any:
    """Return a number, or all numbers of nested tuples, times a factor."""
    if isinstance(value, tuple):
        return tuple(scaled(item, factor) for item in value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return value
    if isinstance(value, int):
        return max(1, math.ceil(value * factor)) if value > 0 else value
    return value * factor


def numbers_of(rooms: list[str]) -> list[Number]:
    """Return all numbers that decide of rooms, in the order of their modules."""
    for module in pkgutil.walk_packages(pneunet_ros.__path__, 'pneunet_ros.'):
        if not module.name.startswith('pneunet_ros.nodes') and '__main__' not in module.name:
            importlib.import_module(module.name)
    found: dict[tuple[str, str], Number] = {}
    modules = [one for name, one in sys.modules.items() if name.startswith('pneunet_ros.')]
    for owner in {value for one in modules for value in vars(one).values()
                  if isinstance(value, type) and is_dataclass(value)}:  # fmt: skip
        declared = inspect.get_annotations(owner)
        for item in fields(owner) if owner.__module__.startswith('pneunet_ros.') else ():
            if item.name in declared and 'used_unit' in item.metadata:
                number = Number(owner=owner, name=item.name, default=item.default)
                found[owner.__module__, str(number)] = number
    return [one for _, one in sorted(found.items()) if one.room in rooms]


@contextlib.contextmanager
def changed(number: Number, value: Any) -> Iterator[None]:
    """Let a number have another value, in its class and in all instances with the default."""
    classes = [number.owner, *subclasses(number.owner)]
    set_defaults(classes, number.name, value)
    holders = [
        one
        for one in gc.get_objects()
        if type(one) in classes and getattr(one, number.name) == number.default
    ]
    for one in holders:
        object.__setattr__(one, number.name, value)
    forget()
    try:
        yield
    finally:
        set_defaults(classes, number.name, number.default)
        for one in holders:
            object.__setattr__(one, number.name, number.default)
        forget()


def subclasses(owner: type) -> list[type]:
    """Return all classes that inherit the fields of one."""
    return [one for direct in owner.__subclasses__() for one in (direct, *subclasses(direct))]


def set_defaults(classes: list[type], name: str, value: Any) -> None:
    """Let instances that are made from now on have a value."""
    for one in classes:
        defaults = one.__init__.__kwdefaults__
        if defaults is not None and name in defaults:
            defaults[name] = value


class CountedField:
    """A field of a class with slots that notes who reads it."""

    def __init__(self, number: Number, field: Any, read: set[str]) -> None:
        self.number, self.field, self.read = number, field, read

    def __get__(self, one: Any, owner: type | None = None) -> Any:
        """Note a reader, but not the constructor, `replace`, or a list of settings."""
        code = sys._getframe(1).f_code
        listed = code.co_filename.endswith('core/settings.py') or code.co_name == 'replace'
        if not listed and code.co_filename != '<string>':
            self.read.add(str(self.number))
        return self.field.__get__(one, owner)

    def __set__(self, one: Any, value: Any) -> None:
        """Set the field."""
        self.field.__set__(one, value)


@contextlib.contextmanager
def counted(numbers: list[Number]) -> Iterator[set[str]]:
    """Yield the names of those numbers that are read meanwhile."""
    read: set[str] = set()
    kept = [(one, vars(one.owner)[one.name]) for one in numbers]
    for one, field in kept:
        setattr(one.owner, one.name, CountedField(one, field, read))
    try:
        yield read
    finally:
        for one, field in kept:
            setattr(one.owner, one.name, field)


def forget() -> None:
    """Empty all caches of the package: they know what followed from other numbers."""
    for one in gc.get_objects():
        if isinstance(one, functools._lru_cache_wrapper) and one.__module__.startswith(
            ('pneunet_ros.model', 'pneunet_ros.measurement', 'pneunet_ros.vision',
             'pneunet_ros.fusion', 'pneunet_ros.estimation', 'pneunet_ros.calibration',
             'pneunet_ros.diagnosis', 'pneunet_ros.discovery')
        ):  # fmt: skip
            one.cache_clear()


def leaves(content: Any, path: str = '') -> Iterator[tuple[str, float | str]]:
    """Yield (dotted path, number or word) of nested content."""
    if is_dataclass(content):
        content = {item.name: getattr(content, item.name) for item in fields(content)}
    if isinstance(content, Mapping):
        for key, value in content.items():
            if key not in ECHOED and not any(word in str(key) for word in UNSTABLE):
                yield from leaves(value, f'{path}.{key}' if path else str(key))
    elif isinstance(content, (list, tuple)):
        for place, value in enumerate(content):
            yield from leaves(value, f'{path}.{place}')
    elif isinstance(content, (bool, str)) or content is None:
        yield path, str(content)
    else:
        yield path, float(content)


def verb(*words: str) -> Figures:
    """Return all that a verb prints as JSON, and its exit code."""
    printed, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(errors):
        try:
            code = pneunet([*words, '--json'])
        except SystemExit as end:
            code = end.code
    text = printed.getvalue()
    found: Figures = {'exit code': str(code), 'error': errors.getvalue()[-200:] if code else ''}
    try:
        return found | dict(leaves(json.loads(text))) if text else found
    except json.JSONDecodeError:
        return found


def named(name: str, figures: Figures) -> Figures:
    """Return figures with a name before theirs."""
    return {f'{name} {key}': value for key, value in figures.items()}


def shapes() -> Figures:
    """Solve easy and hard rods, tips to forces, and ask the model where it knows nothing."""
    found: Figures = {}
    for model in ('paper_arm', 'lab_arm'):
        arm = load_model(share_path(f'config/{model}.yaml'))
        for load in ((0.0, 0.0), (0.175, 0.07), (-0.4, 0.02), (4.0, 3.0)):
            for pressure in (0.0, 60e3):
                shape = solve(arm, pressure=pressure, force=load)
                key = f'{model} {pressure:g} {load}'
                found[f'{key} status'] = str(shape.status)
                found |= {f'{key} tip.{axis}': float(v) for axis, v in enumerate(shape.tip)}
        for tip in ((0.1035, 0.0395), (0.08, 0.06)):
            try:
                force = solve_tip(arm, pressure=31e3, tip=tip).force
                found |= {f'{model} {tip} force.{axis}': float(v) for axis, v in enumerate(force)}
            except PneunetError as error:
                found[f'{model} {tip} error'] = str(error)
        path = f'config/{model}.yaml'
        low, high = arm.pressure_range
        for share, force in ((1.01, 0.1), (1.04, 0.1), (1.08, 0.1), (0.5, 0.36), (0.5, 0.6)):
            pressure = low + share * (high - low)
            load = ('--force', str(force), str(0.6 * force))
            words = ('predict', '--pressure', str(pressure), *load, '--model', path)
            found |= named(f'{model} {share:g} of the range, {force:g} N:', verb(*words))
    return found


def simulated(name: str, *words: str) -> str:
    """Return a recording of the virtual lab, made once."""
    path = KEPT / f'{name}.mcap'
    if not path.exists():
        KEPT.mkdir(exist_ok=True)
        verb('simulate', *words, '--output', str(path))
    return str(path)


def replays() -> Figures:
    """Replay what is shipped, and a recording of an arm that creeps, and check them."""
    crept = simulated(
        'crept', 'random_mix', '--seed', '5', '--effect', 'creep.amplitude=0.3',
        '--effect', 'creep.time_constant=6',
    )  # fmt: skip
    found: Figures = {}
    for name, path, model in (
        ('held out', 'bags/lab_day/heldout.mcap', 'lab_arm'),
        ('other model', 'bags/lab_day/loaded.mcap', 'paper_arm'),
        ('creep', crept, 'lab_arm'),
    ):
        with tempfile.TemporaryDirectory() as folder:
            output = ('--output', f'{folder}/o.mcap')
            found |= named(name, verb('replay', path, '--model', f'config/{model}.yaml', *output))
        found |= named(f'check {name}', verb('check', path))
    return found


def delays() -> Figures:
    """Estimate the delay of films whose pressure steps, ramps, repeats itself, or rests."""
    sys.path.append(str(CHECKOUT / 'test' / 'estimation'))
    from pneunet_ros.estimation.clock_delay import estimate_delay
    import test_clock_delay as films_of

    found: Figures = {}
    for seed, name in enumerate(('steps', 'ramps', 'triangles', 'one_ramp', 'rest'), 3):
        series, delay = films_of.filmed(getattr(films_of, name), seed)
        known = estimate_delay(*series)
        off = known.delay - delay
        found |= {f'{name} off': off, f'{name} std': known.std}
        found[f'{name} known'] = str(not known.trouble)
    return found


@functools.cache
def rig() -> Any:
    """Return the calibrated model of a rig, made once."""
    path = KEPT / 'rig.yaml'
    if not path.exists():
        from rigs import model_of

        KEPT.mkdir(exist_ok=True)
        save_model(model_of(5000), path)
    return load_model(path)


CAUSES = (('nothing wrong', 3.0), ('table tilted by 10 degrees', 2.0))


@functools.cache
def rig_recording(name: str, seconds: float) -> Any:
    """Return a recording of the rig with a cause of error, made once."""
    import everyday_causes

    return everyday_causes.recording_of(5000, 0, name, seconds)


def fusions() -> Figures:
    """Fuse recordings of a rig with a cause of error each, with and without a force sensor."""
    import everyday_causes
    from pneunet_ros.fusion.fusion import Fusion

    found: Figures = {}
    fusion = Fusion(arm=rig())
    for name, seconds in CAUSES:
        recording = rig_recording(name, seconds)
        for wrench in (False, True) if name == 'nothing wrong' else (False,):
            rows, said = everyday_causes.fuse(fusion, recording, name, 500_000, wrench=wrench)
            found |= fused(f'{name}{", force sensor" if wrench else ""}', rows, said)
    return found


def fused(key: str, rows: Any, said: list[tuple[str, ...]]) -> Figures:
    """Return what a fusion came to: NUMBERS of readings, and what was said at each."""
    import everyday_causes

    numbers = everyday_causes.numbers_of(rows[None])
    found: Figures = {f'{key}: {what}': value for what, value in numbers.items()}
    for text in everyday_causes.shares_of(said):
        if text:
            share, _, sentence = text.partition(' ')
            found[f'{key}: says {sentence}'] = float(share)
    return found


FAILS, WORKS = 1.5, 3.5  # s, from when to when something is wrong


@functools.cache
def moving_recording(pushed: bool) -> Any:
    """Return five seconds of the rig with ten frames each; something pushes the arm, or not."""
    from pneunet_ros.files.scenario_file import load_scenario
    from pneunet_ros.lab.lab_arm import vary_arm
    from pneunet_ros.lab.protocols import RandomMix
    from pneunet_ros.lab.sensors import Rates
    from pneunet_ros.lab.simulation import simulate

    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    push = {'force': -0.03, 'place': 0.6, 'begins': FAILS, 'ends': WORKS, 'ramp': 0.1}
    return simulate(
        replace(
            scenario,
            seed=7,
            arm=vary_arm(scenario.arm, 5000),
            noise=replace(scenario.noise, jitter_std=0.0, occlusions=0.0),
            rates=Rates(pressure=10.0, wrench=10.0, frames=10.0),
            protocol=RandomMix(duration=5.0, rest=0.4, seed=7.0, lowest=15e3, top=55e3),
        ).with_effects({'push': push} if pushed else {})
    )


def failing(fault: str, wrench: bool) -> Figures:
    """Fuse a recording in which something fails for a while, or pushes the arm."""
    from everyday_causes import CONTACT, NUMBERS, row_of
    from pneunet_ros.core.readings import PressureReading
    from pneunet_ros.fusion.estimate import FusedEstimate
    from pneunet_ros.fusion.fusion import Fusion
    from pneunet_ros.fusion.state import FusionState
    from rigs import read_sensors, sightings_of, wrench_of

    recording = moving_recording(fault == 'push')
    truth, read = recording.truth, read_sensors(recording, np.random.default_rng(13))
    x, y = recording.x.copy(), recording.y.copy()
    wrong = (truth.time > FAILS) & (truth.time < WORKS)
    first = int(np.flatnonzero(wrong)[0])
    if fault == 'force sensor hangs':
        read[wrong, :3] = read[first, :3]
    elif fault == 'force sensor off':
        read[wrong, 0] += 0.03
    elif fault == 'pressure hangs':
        read[wrong, 3] = read[first, 3]
    elif fault == 'frames repeat':
        x[wrong], y[wrong] = x[first], y[first]
    elif fault == 'camera pushed':
        x[wrong] += 3e-3
    elif fault == 'targets hidden':
        x[wrong, :-5] = y[wrong, :-5] = np.nan
        x[wrong, -3] += 3e-3
    fusion, state = Fusion(arm=rig()), FusionState()
    rows, said = np.full((truth.time.size, len(NUMBERS)), np.nan), []
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        if wrench:
            state, _ = fusion.step(state, wrench_of(stamp, read[instant]))
        state, _ = fusion.step(state, sightings_of(stamp, x[instant], y[instant]))
        reading = PressureReading(stamp_ns=stamp, pressure=float(read[instant, 3]))
        state, outcome = fusion.step(state, reading)
        sentences: tuple[str, ...] = ()
        if isinstance(outcome, FusedEstimate):
            tip = np.array([truth.x[instant, -1], truth.y[instant, -1]])
            rows[instant] = row_of(outcome, tip, truth.force[instant])
            sentences = (*outcome.estimate.warnings, *(CONTACT,) * (outcome.contact is not None))
        said.append(sentences)
    return fused(f'{fault}{", force sensor" if wrench else ""}', rows, said)


PUSHES = (('push', False), ('push', True))
FAULTS = (
    ('force sensor hangs', True),
    ('force sensor off', True),
    ('pressure hangs', False),
    ('frames repeat', False),
    ('camera pushed', False),
    ('targets hidden', False),
)


def pushes() -> Figures:
    """Fuse recordings of a rig that something pushes, with and without a force sensor."""
    return {key: value for fault in PUSHES for key, value in failing(*fault).items()}


def failures() -> Figures:
    """Fuse recordings of a rig in which a sensor fails."""
    return {key: value for fault in FAULTS for key, value in failing(*fault).items()}


def fused_file() -> Figures:
    """Fuse what is shipped, as a verb does."""
    with tempfile.TemporaryDirectory() as folder:
        words = ('--fuse', '--model', 'config/lab_arm.yaml', '--output', f'{folder}/o.mcap')
        return named('fuse held out', verb('replay', 'bags/lab_day/heldout.mcap', *words))


def checks() -> Figures:
    """Return what judges of recordings say."""
    found: Figures = {}
    for path in ('bags/lab_day/loaded.mcap', 'bags/lab_day/heldout.mcap'):
        found |= named(f'check {path}', verb('check', path, '--model', 'config/lab_arm.yaml'))
    return found


def calibrations() -> Figures:
    """Calibrate the shipped day in the lab, and an arm that creeps."""
    found: Figures = {}
    day = [f'bags/lab_day/{name}.mcap' for name in ('unloaded', 'loaded')]
    for name, (free, loaded) in (('lab day', day),):
        with tempfile.TemporaryDirectory() as folder:
            words = ('--unloaded', free, '--loaded', loaded, '--output', f'{folder}/m.yaml')
            found |= named(name, verb('calibrate', *words))
    return found


@functools.cache
def calibration_cases() -> dict[str, Any]:
    """Return calibrations of few targets, of arms that a model lacks, of recordings that disagree.

    Each: recordings without and with a load, the arm, and a moment law if not the default.
    """
    from pneunet_ros.effects.hysteresis import Hysteresis
    from support.example_arms import paper_arm
    from support.made_datasets import experiments, made, USUAL

    frames = 24
    arm = replace(paper_arm(), covariance=None, sensors=USUAL)
    free, loaded = experiments(arm, USUAL, frames=frames)
    few = replace(
        arm,
        target_arclength=arm.length * np.array([0.0, 0.35, 0.7, 1.0]),
        sensors=replace(USUAL, placement_std=0.0, registration_std=0.0, drift_std=0.0),
    )
    pulls = np.column_stack([np.linspace(0.05, 0.2, 30), np.linspace(0.0, 0.1, 30)])
    up = np.linspace(0.0, 6e4, 30)
    loop = np.concatenate([up, up[::-1]])

    def strange(factor: float, course: Any, *effects: Any) -> Any:
        """Return an unloaded recording of an arm that bends less."""
        model = paper_arm(effects)
        table = model.intrinsic_curvature
        model = replace(
            model, intrinsic_curvature=replace(table, curvature=factor * table.curvature)
        )
        return made(model, course, noise=USUAL, start=1000, name=f'bends {factor:g}')

    def scaled(factor: float) -> list[Any]:
        """Return the loaded recordings, one of them with other heights."""
        return [loaded[0], replace(loaded[1], y=factor * loaded[1].y), loaded[2]]

    loud = replace(USUAL, pressure_std=1500.0)
    weak = replace(USUAL, force_std=4e-3)
    play = Hysteresis(width=2e3)
    louder, loud_pulls = experiments(arm, loud, frames=frames)
    return {
        'two arms': ([free[0], strange(0.93, up[::-1])], [], arm),
        'two arms in loops': ([strange(1.0, loop), strange(0.96, loop)], [], arm),
        'two arms with play': ([strange(1.0, loop, play), strange(0.85, loop, play)], [], arm),
        'few targets': (
            [made(few, np.repeat(np.linspace(0.0, 6e4, 5), 6), noise=USUAL)],
            [made(few, np.full(30, 3e4), pulls, noise=USUAL, seed=1)],
            few,
        ),
        'a recording off': (free, scaled(1.06), arm),
        'a recording a little off': (free, scaled(1.012), arm),
        'a frame off': (free, [loaded[0], frame_off(loaded[1], 4e-3), loaded[2]], arm),
        'a frame of each off': (
            *([frame_off(run, 2.2e-3) for run in runs] for runs in (free, loaded)),
            arm,
        ),
        'loud pressure': (louder[:1], loud_pulls, replace(arm, sensors=loud)),
        'loud force': (free, experiments(arm, weak, frames=frames)[1], replace(arm, sensors=weak)),
        'few loaded frames': (free, [loaded[0]], arm),
        'one stiffness': (free, loaded, arm, 'linear'),
        'a glued patch': (*glued(), arm),
        'at rest': (at_levels(arm), loaded, arm),
    }


CALIBRATIONS = (
    'two arms', 'two arms in loops', 'two arms with play', 'few targets', 'a recording off',
    'a recording a little off', 'a frame off', 'a frame of each off', 'loud pressure',
    'loud force', 'few loaded frames', 'one stiffness', 'a glued patch', 'at rest',
)  # fmt: skip


def calibration_of(case: str) -> Callable[[], Figures]:
    """Return the figures of a calibration."""

    def figures() -> Figures:
        return named(case, calibrated(*calibration_cases()[case]))

    figures.__name__ = case.replace(' ', '_')
    return figures


def calibrated(free: Any, loaded: Any, arm: Any, kind: str | None = None) -> Figures:
    """Return what a calibration from made recordings comes to, or why it is refused."""
    from pneunet_ros.calibration.calibration import calibrate
    from pneunet_ros.reports.calibration.verdict import verdict_of

    try:
        found = calibrate(free, loaded, arm, kind=kind, compare=False)
    except PneunetError as error:
        return {'refused': str(error.reason)}
    figures: Figures = {f'note {one.reason}': 'there' for one in found.notes}
    figures['verdict'] = str(verdict_of(found).fit.reason)
    columns = found.arm.covariance.columns() if found.arm.covariance is not None else ()
    sizes = [abs(size) for column in columns for size in column.values()]
    for pressure in (0.0, 3e4, 6e4) if found.arm.pressure_range[1] > 0.0 else (0.0,):
        tip = solve(found.arm, pressure=pressure, force=(0.1, 0.05)).tip
        figures |= {f'{pressure:g} tip.{axis}': float(v) for axis, v in enumerate(tip)}
    return figures | {'covariance': float(np.sum(sizes)), 'columns': float(len(columns))}


def frame_off(run: Any, off: float) -> Any:
    """Return a recording of which a frame shows the targets elsewhere, by so much (m)."""
    y = run.y.copy()
    y[5] += off
    return replace(run, y=y)


def glued() -> tuple[list[Any], list[Any]]:
    """Return recordings without and with a load of an arm that a patch makes stiffer."""
    runs = unnamed_trial('glued_patch', 0, (6, 0, 24)).training
    return [run for run in runs if not run.loaded], [run for run in runs if run.loaded]


def at_levels(arm: Any) -> list[Any]:
    """Return recordings that rest at pressures, with errors that neighboring targets share."""
    from support.made_datasets import made, USUAL

    levels = np.repeat(np.linspace(0.0, 6e4, 6), 8)
    runs = [made(arm, course, noise=USUAL, seed=seed) for seed, course in
            enumerate((levels, levels[::-1]))]  # fmt: skip
    random = np.random.default_rng(5)
    shared = [np.convolve(random.standard_normal(arm.target_arclength.size + 2), (0.4, 0.5, 0.4),
                          'valid') for _ in levels]  # fmt: skip
    return [replace(run, y=run.y + 1e-4 * np.array(shared)) for run in runs]


def headings() -> Figures:
    """Calibrate from measured headings of the tip."""
    sys.path.append(str(CHECKOUT / 'test' / 'calibration'))
    import test_tip_pose as poses

    both, alone = (0.0, 0.15), (0.0, 0.3)
    unstated = replace(poses.frame(), sensors=replace(poses.SENSORS, heading_std=0.0))
    return named('pose', calibrated([], [poses.posed(both)], unstated)) | named(
        'heading', calibrated([], [poses.posed(alone, position=False)], poses.frame(alone))
    )


# Recordings to learn from, held out, and frames of each.
SMALL = 4, 1, 24
# Nothing hidden, seen by few frames; one effect, two, and one that no recording tests.
TRIALS = (
    ('nothing', 1_000_003, SMALL),
    ('nothing', 1_000_003, (3, 0, 12)),
    ('nothing', 1_000_003, (6, 2, 128)),
    ('single', 1_000_004, (3, 1, 24)),
    ('single', 1_000_040, SMALL),
    ('pairs', 1_000_001, SMALL),
    ('outside', 1_000_001, SMALL),
    ('pairs', 1_000_002, SMALL),
)
# Causes without an effect in the library, or with the effects that could take their place.
LAWS = (('swelling', (4, 1, 16), True), ('smooth_play', (4, 1, 16), True))


def cut(trial: Any, training: int, held_out: int, frames: int) -> Any:
    """Return a trial of fewer and shorter recordings."""
    return replace(
        trial,
        training=tuple(run.thin(frames) for run in trial.training[:training]),
        held_out=tuple(run.thin(frames) for run in trial.held_out[:held_out]),
    )


@functools.cache
def trial(block: str, seed: int, size: tuple[int, int, int]) -> Any:
    """Return what a sealed trial gives a diagnosis, made once."""
    from blind.trials import made

    return cut(made(block, seed)[1], *size)


@functools.cache
def unnamed_trial(name: str, step: int, size: tuple[int, int, int]) -> Any:
    """Return recordings with a cause that the library does not have, made once."""
    from blind.trials import recorded
    from discovery_trials import label_of
    from unnamed.causes import add_causes

    add_causes()
    return cut(recorded(label_of('causes', name, step, 47_001, 5))[1], *size)


def diagnosed(trial: Any, withheld: tuple[str, ...] = ()) -> Figures:
    """Return what a diagnosis of a trial says, and a discovery after it, as the verb does."""
    from pneunet_ros.diagnosis.diagnosis import investigate
    from pneunet_ros.diagnosis.result import Diagnosis
    from pneunet_ros.diagnosis.settings import DEFAULTS
    from pneunet_ros.discovery.discovery import discover

    settings = replace(DEFAULTS, withheld=withheld)
    try:
        found = investigate(trial.frame, trial.training, trial.held_out, settings=settings)
    except PneunetError as error:
        return {'refused': str(error.reason)}
    law = discover(found)
    diagnosis = found.overruled(law.overruling).diagnosis
    content: dict[str, Any] = {'answer': diagnosis.answer, 'law': figures_of_law(law)}
    if isinstance(diagnosis, Diagnosis):
        content |= {
            name: getattr(diagnosis, name)
            for name in ('effects', 'alternatives', 'where', 'noise_floor', 'closed',
                         'adequacy_before', 'adequacy_after', 'adequacy_same', 'detectable',
                         'shift', 'evidence', 'proposal')
        } | {
            'cosines': {' '.join(pair): value for pair, value in diagnosis.cosines.items()},
            'before': diagnosis.before.rms,
            'after': diagnosis.after.rms,
            'heat': [float(np.nansum(one.before)) for one in diagnosis.heat_maps],
        }  # fmt: skip
    notes = {f'note {getattr(one, "reason", one)}': 'there' for one in diagnosis.notes}
    return dict(leaves(content)) | notes


def figures_of_law(found: Any) -> dict[str, Any]:
    """Return the numbers of a discovery."""
    return {
        'searched': found.searched,
        'found': found.found,
        'closed': found.closed,
        'overrules': found.overruling is not None,
        'causes': None if found.causes is None else float(np.nansum(found.causes.share)),
        'amplitude': [float(one.law @ one.law) for one in found.amplitudes],
        'notes': [str(one)[:40] for one in found.notes],
    }


def diagnosis_of(block: str, seed: int, size: tuple[int, int, int]) -> Callable[[], Figures]:
    """Return the figures of a sealed trial."""

    def figures() -> Figures:
        return diagnosed(trial(block, seed, size))

    figures.__name__ = f'{block}_{seed % 1000}_{size[2]}'
    return figures


def law_of(name: str, size: tuple[int, int, int], withholds: bool) -> Callable[[], Figures]:
    """Return the figures of a cause without an effect."""

    def figures() -> Figures:
        from unnamed.causes import CAUSES

        given = unnamed_trial(name, 4, size)
        return diagnosed(given, CAUSES[name].withheld if withholds else ())

    figures.__name__ = f'{name}_{size[0]}'
    return figures


def exploration() -> Figures:
    """Let an exploration choose recordings of an arm whose camera is turned."""
    from explore_trials import SAFE
    from pneunet_ros.exploration.exploration import explore
    from pneunet_ros.exploration.settings import EXPLORATION
    from pneunet_ros.files.scenario_file import load_scenario
    from pneunet_ros.lab.scenario import Detail
    from pneunet_ros.lab.sensors import Rates
    from pneunet_ros.offline.simulated_arm import SimulatedArm
    from pneunet_ros.recordings.dataset_reader import read_run

    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    scenario = replace(
        scenario,
        rates=Rates(pressure=16.0, wrench=16.0, frames=2.0),
        detail=Detail(elements=112.0),
    ).with_effects({'camera_rotation': {'angle': 0.02}})
    arm = SimulatedArm(scenario=scenario)
    frame = replace(
        load_model(share_path('config/paper_arm.yaml')), target_arclength=scenario.arm.targets
    )
    found: Figures = {}
    with tempfile.TemporaryDirectory() as place:

        def record(experiment: Any, safe: Any, number: int) -> Any:
            path = Path(place) / f'recording_{number + 1:02d}.mcap'
            arm.record(experiment, safe, path)
            return read_run(path, frame.target_arclength.size)[0]

        settings = replace(EXPLORATION, recordings=3)
        for number, step in enumerate(explore(frame, record, SAFE, settings=settings)):
            content = {
                'words': step.choice.experiment.words[:40],
                'rate': step.choice.rate,
                'rivals': dict(step.rivals),
                'predicted': step.predicted,
                'effects': () if step.diagnosis is None else step.diagnosis.effects,
            }
            found |= named(str(number), dict(leaves(content)))
    return found


FILMS = (('coffee', 'bright', ('hand', 'blur')), ('china', 'dark', ('jpeg', 'uneven')))
RESTING, FOLLOWED = 6, 10  # frames


@functools.cache
def film(name: str, polarity: str, disturbances: tuple[str, ...]) -> tuple[Any, Any, Any]:
    """Return a composed film, its frames, and a tracker's state after the rest, made once."""
    from pneunet_ros.vision.tracker import TrackerState
    from support.composed_pictures import Composer, Composition
    from support.tracked_films import lens_of_films

    composition = Composition(
        photograph=name,
        polarity=polarity,
        disturbances=frozenset(disturbances),
        frames=RESTING + FOLLOWED,
        resting=RESTING,
        seed=3,
    )
    frames = list(Composer(composition))
    tracker = tracker_of(composition)
    state, _ = tracker.step(TrackerState(), lens_of_films())
    return composition, frames, followed(tracker, state, frames[:RESTING])[0]


def tracker_of(composition: Any) -> Any:
    """Return a new tracker of a film."""
    from pneunet_ros.vision.camera.camera_settings import CameraSettings
    from pneunet_ros.vision.tracker import Tracker
    from support.tracked_films import arm_of

    return Tracker(arm_of(load_model(share_path('config/paper_arm.yaml')), composition),
                   CameraSettings())  # fmt: skip


def followed(tracker: Any, state: Any, frames: list[Any]) -> tuple[Any, list[Any]]:
    """Return the state of a tracker after frames, and what it made of each."""
    from support.tracked_films import image_of

    outcomes = []
    for frame in frames:
        state, outcome = tracker.step(state, image_of(frame))
        outcomes.append(outcome)
    return state, outcomes


def rows_found() -> Figures:
    """Find the row of a composed film that rests, and of a plain one."""
    from pneunet_ros.vision.tracker import TrackerState
    from support.tracked_films import lens_of_films

    composition, frames, _ = film(*FILMS[0])
    tracker = tracker_of(composition)
    state, _ = tracker.step(TrackerState(), lens_of_films())
    outcomes = followed(tracker, state, frames[: RESTING + 1])[1]
    found: Figures = {
        f'frame {place} {what}': float(np.nan_to_num(values).sum())
        for place, outcome in enumerate(outcomes)
        for what, values in (('u', outcome.sightings.u), ('v', outcome.sightings.v))
    }
    found |= {f'frame {place} reason': str(one.reason) for place, one in enumerate(outcomes)}
    with tempfile.TemporaryDirectory() as folder:
        words = ('track', 'bags/camera_demo', '--output', f'{folder}/o.mcap')
        return found | named('camera demo', verb(*words))


def films() -> Figures:
    """Follow the row of composed films from the rest on."""
    from support.tracked_films import Score

    found: Figures = {}
    for one in FILMS:
        composition, frames, state = film(*one)
        tracker = tracker_of(composition)
        score = Score()
        length = 0.112 / ((composition.targets - 1) * composition.spacing)
        for frame, outcome in zip(
            frames[RESTING:], followed(tracker, state, frames[RESTING:])[1], strict=True
        ):
            score.count(outcome, frame, length)
        found |= named(' '.join((one[0], *one[2])), dict(leaves(score.numbers())))
    return found


# Few dots painted by hand, before brick and before print; dots that are smeared and hidden.
PAINTED = (('painted', 0, 0, 6), ('cluttered', 9, 0, 6))
SMEARED = (('coffee', 'dark', ('hand', 'uneven')), ('grass', 'bright', ('hand', 'blur', 'uneven')))
LOST_EVERY = 7  # frames, after which the row is sought again


@functools.cache
def painted_film(kind: str, number: int, first: int, after: int) -> tuple[Any, list[Any]]:
    """Return the composition of a film of acceptance/painted_dots.py, and some of its frames."""
    import painted_dots

    composer = getattr(painted_dots, kind)(number, after)
    return composer.composition, [composer.frame(place) for place in range(first, after)]


@functools.cache
def smeared_film(name: str, polarity: str, disturbances: tuple[str, ...]) -> tuple[Any, list[Any]]:
    """Return the composition of a film in which dots are smeared, hidden or uneven, and frames."""
    from support.composed_pictures import Composer, Composition

    composition = Composition(
        photograph=name,
        polarity=polarity,
        disturbances=frozenset(disturbances),
        frames=24,
        resting=RESTING,
        seed=4,
    )
    return composition, list(Composer(composition))


def hard_films() -> Figures:
    """Find and follow the row of films in clutter, and of films with smeared and hidden dots."""
    from dataclasses import replace

    from pneunet_ros.vision.tracker import TrackerState
    from support.tracked_films import lens_of_films, Score

    found: Figures = {}
    asked = [(painted_film(*one), ' '.join(map(str, one[:2]))) for one in PAINTED]
    asked += [(smeared_film(*one), ' '.join((one[0], *one[2]))) for one in SMEARED]
    for (composition, frames), name in asked:
        tracker, score = tracker_of(composition), Score()
        state, _ = tracker.step(TrackerState(), lens_of_films())
        length = 0.112 / ((composition.targets - 1) * composition.spacing)
        for place, frame in enumerate(frames):
            if place % LOST_EVERY == LOST_EVERY - 1:
                state = replace(state, row=None)
            state, (outcome,) = followed(tracker, state, [frame])
            score.count(outcome, frame, length)
            found[f'{name} {place} reason'] = str(outcome.reason)
        found |= named(name, dict(leaves(score.numbers())))
    return found


def moved_cameras() -> Figures:
    """Say how far a camera may move, in px along and across a row, that is followed."""
    from dataclasses import replace

    composition, frames, state = film(*FILMS[0])
    tracker, frame, found = tracker_of(composition), frames[RESTING], {}
    for way in ((2, 0), (3, 0), (5, 0), (7, 0), (0, 5), (0, 10), (0, 17), (0, 25), (0, 35)):
        moved_on = np.roll(frame.picture, way, axis=(1, 0))
        _, (outcome,) = followed(tracker, state, [replace(frame, picture=moved_on)])
        found[f'moved by {way} reason'] = str(outcome.reason)
        found[f'moved by {way} seen'] = float(outcome.sightings.seen)
    return found


def curves() -> Figures:
    """Return the smooth curves through the targets of a film."""
    composition, frames, state = film(*FILMS[0])
    outcomes = followed(tracker_of(composition), state, frames[RESTING:])[1]
    return {
        f'{place} {what} {station}': float(value)
        for place, one in enumerate(outcomes)
        for what in ('curvature', 'std_curvature')
        for station, value in enumerate(getattr(one.curve, what))
    }


ROOMS = (
    'solver', 'model', 'estimation', 'measurement', 'fusion', 'calibration', 'reports',
    'diagnosis', 'discovery', 'exploration', 'vision',
)  # fmt: skip
FIGURES: tuple[Callable[[], Figures], ...] = (
    shapes, replays, delays, checks, calibrations,
    *(calibration_of(one) for one in CALIBRATIONS), headings,
    pushes, failures, fusions, fused_file,
    *(diagnosis_of(*one) for one in TRIALS), *(law_of(*one) for one in LAWS), exploration,
    films, hard_films, moved_cameras, rows_found, curves,
)  # fmt: skip


def attempted(figures: Callable[[], Figures]) -> Figures:
    """Return the figures, or what broke off: a number that cannot be changed so far."""
    try:
        return figures()
    except Exception as error:
        return {'breaks off': f'{type(error).__name__}: {error}'[:120]}


def moved(before: Figures, after: Figures) -> str:
    """Return the figures that moved most, in words; `nothing` where none did."""
    found: list[tuple[float, str]] = []
    sizes = sizes_of(before)
    for name in dict.fromkeys([*before, *after]):
        old, new = before.get(name, 'none'), after.get(name, 'none')
        if isinstance(old, float) and isinstance(new, float):
            if old == new or (math.isnan(old) and math.isnan(new)):
                continue
            size = max(sizes.get(array_of(name), 0.0), abs(old))
            far = abs(new - old) / size if size and math.isfinite(new - old) else 1.0
            found.append((far, f'{name} {old:.3g} -> {new:.3g}'))
        elif old != new and not (is_prose(old) and is_prose(new)):
            found.append((2.0, f'{name} {str(old)[:40]} -> {str(new)[:40]}'))
    found.sort(key=lambda item: -item[0])
    told = [text for far, text in found if far > MOVES]
    if not told:
        return 'nothing' if not found else f'nothing above {found[0][0]:.0e}'
    more = f' and {len(told) - SHOWN} more' if len(told) > SHOWN else ''
    return '; '.join(told[:SHOWN]) + more


def is_prose(value: float | str) -> bool:
    """Whether a value is a sentence with numbers in it, which others say as numbers."""
    return isinstance(value, str) and len(value) > 40


def array_of(name: str) -> str:
    """Return the array that a figure stands in."""
    head, _, last = name.rpartition('.')
    return head if last.isdecimal() else name


def sizes_of(figures: Figures) -> dict[str, float]:
    """Return the largest number of each array."""
    sizes: dict[str, float] = {}
    for name, value in figures.items():
        if isinstance(value, float) and math.isfinite(value):
            sizes[array_of(name)] = max(sizes.get(array_of(name), 0.0), abs(value))
    return sizes


def swept(number: Number, sets: list[FigureSet], within: float) -> list[str]:
    """Return the row of a number: what moves where it is halved, and where it is doubled.

    within (s): of the sets that are asked, at least one.
    """
    row = [number.room, str(number), repr(number.default)]
    asked: list[FigureSet] = []
    for one in sets:
        taken = sum(other.seconds for other in asked) + one.seconds
        if str(number) in one.read and (not asked or taken < within):
            asked.append(one)
    for factor in (0.5, 2.0):
        value = number.times(factor)
        told = NOT_READ if value is not None else 'not a number'
        for one in asked if value is not None else ():
            before = one.before()
            with changed(number, value):
                told = moved(before, attempted(one.figures))
            if not told.startswith('nothing'):
                break
        row.append(told)
    return row


class FigureSet:
    """A set of figures, the numbers that it reads, and how long it takes."""

    def __init__(self, figures: Callable[[], Figures], numbers: list[Number]) -> None:
        self.figures, self.known = figures, None
        forget()
        begun = time.process_time()
        with counted(numbers) as self.read:
            attempted(figures)
        self.seconds = time.process_time() - begun
        print(f'{figures.__name__}: {len(self.read)} numbers, {self.seconds:.1f} s of CPU',
              file=sys.stderr, flush=True)  # fmt: skip

    def before(self) -> Figures:
        """Return the figures as they are; says what is not the same twice."""
        if self.known is None:
            self.known = attempted(self.figures)
            noise = moved(self.known, attempted(self.figures))
            print(f'{self.figures.__name__}: {len(self.known)} figures, twice: {noise} moved',
                  file=sys.stderr, flush=True)  # fmt: skip
        return self.known


def main(words: list[str] | None = None) -> int:
    """Sweep rooms, and write a row for every number as soon as it is known."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('room', nargs='+', choices=ROOMS)
    command.add_argument('--only', nargs='+', default=(), help='Class.field')
    command.add_argument(
        '--figures', nargs='+', default=(), help='figure sets to compute (default: all)'
    )
    command.add_argument(
        '--within', type=float, default=math.inf, help='time limit (s) of the sets for a constant'
    )
    command.add_argument('--output', type=Path, default=CHECKOUT / 'acceptance' / 'sweep.csv')
    asked = command.parse_args(words)
    kept: dict[tuple[str, str], list[str]] = {}
    if asked.output.exists():
        with asked.output.open(encoding='utf-8', newline='') as known:
            kept = {(row[0], row[1]): row for row in list(csv.reader(known))[1:]}
    there = {(one.room, str(one)) for one in numbers_of(list(ROOMS))}
    kept = {number: row for number, row in kept.items() if number in there}
    numbers = [one for one in numbers_of(asked.room) if not asked.only or str(one) in asked.only]
    sets = [
        FigureSet(one, numbers)
        for one in FIGURES
        if not asked.figures or one.__name__ in asked.figures
    ]
    sets.sort(key=lambda one: one.seconds)
    for number in sorted(numbers, key=lambda one: place_in(asked.only, one)):
        row = swept(number, sets, asked.within)
        kept[row[0], row[1]] = row
        print(*row, sep=' | ', file=sys.stderr, flush=True)
        write(asked.output, list(kept.values()))
    return 0


def place_in(asked: Sequence[str], number: Number) -> int:
    """Return where a number was asked for."""
    return asked.index(str(number)) if str(number) in asked else 0


def write(path: Path, rows: list[list[str]]) -> None:
    """Write the table."""
    with path.open('w', encoding='utf-8', newline='') as table:
        writer = csv.writer(table, lineterminator='\n')
        writer.writerow(['room', 'number', 'default', 'halved', 'doubled'])
        writer.writerows(sorted(rows))


if __name__ == '__main__':
    sys.exit(main())
