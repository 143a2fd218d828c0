"""Behavior of fusion and calibration under everyday disturbances, one per row, and without any.

    python acceptance/everyday_causes.py [--quick] [--json] [--rigs N] [--recordings N] [--first N]
                                         [--keep FOLDER] [--workers N]

A rig is an arm of the virtual lab, its model calibrated from six recordings in which nothing is
wrong. Then one everyday cause comes. Frames at 27 Hz arrive 25 ms late, the pressure is read at
80 Hz, there is no force sensor. Causes in which the arm moves are simulated by MuJoCo, the others
by the lab's own chain. Tip and force: how often the truth lies in the stated 95 %, at every
reading of the pressure, pooled and in the worst recording. A force of which one component alone is
published is judged by that one; withheld: share of readings that publish neither. Said: what the
estimates warn of, by share of readings; contacts that are not there count as said, and one that
is ambiguous, and so not published, as an ambiguous force. Exit code 1 where a goal is missed:
readings with an estimate, the worst recordings, and where nothing is wrong causes and contacts
that are named, in sum in 1 % of the readings at most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import dataclasses
from dataclasses import dataclass
from functools import partial
import math
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import ImuReading, PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, STANDARD_GRAVITY
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.belief import FRAME_TIMES, MIRRORED, MOTION
from pneunet_ros.fusion.belief_estimate import SETUP_PROBLEMS
from pneunet_ros.fusion.causes import CAUSES as NAMED
from pneunet_ros.fusion.causes import TARGETS
from pneunet_ros.fusion.causes import TILT as TILTED
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import RandomMix
from pneunet_ros.lab.scenario import Changes
from pneunet_ros.lab.sensors import LabNoise, Rates
from pneunet_ros.lab.simulation import simulate
from rigs import (
    ANSWERED,
    force_error,
    model_of,
    read_sensors,
    rig_command,
    run_bench,
    sightings_of,
    WORST,
    wrench_of,
)
from scipy.stats import chi2

RATE = 80.0  # Hz, of readings
EVERY = 3  # readings from frame to frame
LATE = 2  # readings from the instant of a frame to its arrival
SECONDS, QUICK_SECONDS = 20.0, 8.0
QUICK = 'one rig, one recording of 8 s'
IN_95 = float(chi2.ppf(0.95, 2))
CONTACT, AMBIGUOUS = 'a contact along the arm', 'an ambiguous force'
NOTHING = 'nothing wrong', 'nothing wrong, unloaded'
ACCUSED = 0.01  # of the readings, in sum, where nothing is wrong
WRONG, MOST_WRONG = 0.03, 0.05  # share of readings that a wrong cause is named in, of recordings
# Of a reading: errors (m, N) and NEES of tip and force, and how many components there are of it.
NUMBERS = ('tip', 'tip_nees', 'force', 'force_nees', 'components')
SENTENCES = 24  # that are kept apart


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A cause of error, and by whom it is simulated.

    ramp (s): of pressure and load; loaded: something pulls at the tip. effects, motion: of the
    scenario. seen: what a recording's frames become. ripple (Pa): of the reading alone. imu: an
    accelerometer is read at the base. loses: whether the film has lost frames, and is stamped k /
    fps; late (s): stamps of frames, behind their exposure; behind (s): readings of the pressure,
    behind the chamber; delay_std (s): what the fusion is told of that. right:
    names of causes of the fusion that are right.
    """

    ramp: float = 0.6
    loaded: bool = True
    changes: Changes = dataclasses.field(default_factory=dict)
    motion: LabMotion | None = None
    seen: Callable[[LabRecording, np.random.Generator], LabRecording] | None = None
    ripple: float = 0.0
    imu: bool = False
    loses: bool = False
    late: float = 0.0
    behind: float = 0.0
    delay_std: float = 0.0
    right: tuple[str, ...] = ()


def beside(recording: LabRecording, off: float = 3e-3) -> LabRecording:
    """Paint the dots beside the neutral line (m), on the left of the arm."""
    theta = heading_at(recording)
    return moved(recording, -off * np.sin(theta), off * np.cos(theta))


def closer(recording: LabRecording, share: float = 0.95) -> LabRecording:
    """Paint the dots closer to each other than the arm file says."""
    places, line = recording.scenario.arm.targets, recording.truth.arclength
    way = [
        np.array([np.interp(share * places, line, row) - np.interp(places, line, row)
                  for row in values])
        for values in (recording.truth.x, recording.truth.y)
    ]  # fmt: skip
    return moved(recording, *way)


def rolling(recording: LabRecording, readout: float = 33e-3, height: float = 0.16) -> LabRecording:
    """Read the rows of a picture of so many m one after the other, from the top down."""
    truth, when = recording.truth, recording.truth.time
    late = readout * np.clip(0.5 - truth.target_y / height, 0.0, 1.0)
    way = []
    for values in (truth.target_x, truth.target_y):
        columns = [
            np.interp(when + late[:, dot], when, values[:, dot]) - values[:, dot]
            for dot in range(values.shape[1])
        ]
        way.append(np.column_stack(columns))
    return moved(recording, *way)


def heading_at(recording: LabRecording) -> Array:
    """Return the heading (frames, targets) rad of the arm at its targets."""
    truth, places = recording.truth, recording.scenario.arm.targets
    return np.array([np.interp(places, truth.arclength, row) for row in truth.theta])


def moved(recording: LabRecording, x: Array, y: Array) -> LabRecording:
    """Return a recording whose targets are seen elsewhere by x, y (frames, targets) m."""
    return dataclasses.replace(recording, x=recording.x + x, y=recording.y + y)


def lost(recording: LabRecording, random: np.random.Generator, share: float = 0.03) -> Array:
    """Return which frames a film has that has lost some of them."""
    frames = np.arange(0, recording.stamp_ns.size, EVERY)
    return frames[random.uniform(size=frames.size) >= share]


TILT = math.sin(math.radians(10.0))
ONE_FRAME = EVERY / RATE
STEPS = LabMotion(damping_time=0.03)
CAUSES = {
    'nothing wrong': Cause(),
    'nothing wrong, unloaded': Cause(loaded=False),
    'the arm has mass, slow ramps': Cause(ramp=2.0, motion=STEPS, right=(MOTION,)),
    'the arm has mass, steps': Cause(ramp=0.1, motion=STEPS, right=(MOTION,)),
    'the arm has mass, steps, unloaded': Cause(
        ramp=0.1, loaded=False, motion=STEPS, right=(MOTION,)
    ),
    'table tilted by 10 degrees': Cause(
        changes={'gravity': {'weight_y': -TILT}},  # of mg / l, see `recording_of`
        right=(TILTED,),
    ),
    'dots 3 mm beside the neutral line': Cause(seen=lambda one, _: beside(one), right=(TARGETS,)),
    'dots 5 % closer': Cause(seen=lambda one, _: closer(one), right=(TARGETS,)),
    'friction: a play of 4 kPa': Cause(changes={'hysteresis': {'width': 4e3}}),
    'mirrored image': Cause(
        seen=lambda one, _: dataclasses.replace(one, y=-one.y), right=(MIRRORED,)
    ),
    '3 % lost frames, stamped k / fps': Cause(loses=True, right=(FRAME_TIMES,)),
    '3 % lost frames, and delay_std of a frame': Cause(
        loses=True, delay_std=ONE_FRAME, right=(FRAME_TIMES,)
    ),
    'frames stamped 0.15 s late': Cause(late=0.15, right=(FRAME_TIMES,)),
    'frames stamped 0.15 s late, and delay_std': Cause(
        late=0.15, delay_std=ONE_FRAME, right=(FRAME_TIMES,)
    ),
    'pressure read 0.15 s late': Cause(behind=0.15, right=(FRAME_TIMES,)),
    'pressure read 0.15 s late, and delay_std': Cause(
        behind=0.15, delay_std=ONE_FRAME, right=(FRAME_TIMES,)
    ),
    'nothing wrong, but delay_std': Cause(delay_std=ONE_FRAME),
    'rolling shutter of 33 ms, steps': Cause(
        ramp=0.1, seen=lambda one, _: rolling(one), right=(FRAME_TIMES,)
    ),
    'rolling shutter and mass, steps': Cause(
        ramp=0.1, motion=STEPS, seen=lambda one, _: rolling(one), right=(FRAME_TIMES, MOTION)
    ),
    '2.5 kPa of valve ripple at 27 Hz': Cause(ripple=2.5e3),
}


def recording_of(seed: int, which: int, name: str, seconds: float = SECONDS) -> LabRecording:
    """Return a recording of a rig with one cause, and a camera put up anew."""
    cause = CAUSES[name]
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    arm = vary_arm(scenario.arm, seed)
    pull = {} if cause.loaded else {'force_x': (0.0, 0.0), 'force_y': (0.0, 0.0)}
    changes = {effect: dict(values) for effect, values in cause.changes.items()}
    if 'gravity' in changes:
        changes['gravity']['weight_y'] *= arm.weight / arm.length
    scenario = dataclasses.replace(
        scenario,
        name=f'causes {which}',
        seed=seed,
        arm=arm,
        protocol=RandomMix(
            duration=seconds,
            seed=float(100 * seed + which),
            lowest=2e3,
            top=60e3,
            ramp=cause.ramp,
            **pull,
        ),
        noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
        rates=Rates(pressure=RATE, wrench=RATE, frames=RATE),
        motion=cause.motion,
    ).with_effects(changes)
    recording = simulate(scenario)
    random = np.random.default_rng([seed, which, 29])
    return recording if cause.seen is None else cause.seen(recording, random)


def readings_of(
    recording: LabRecording, name: str, seed: int, *, wrench: bool = False
) -> Iterator[list]:
    """Yield what arrives at every reading of the pressure, which is last.

    name: of the cause; wrench: whether there is a force sensor, read with the pressure.
    """
    random, gyro = (np.random.default_rng([seed, stream]) for stream in (13, 31))
    read, time = read_sensors(recording, random), recording.truth.time
    read[:, 3] += CAUSES[name].ripple * np.sin(2.0 * np.pi * 27.0 * time)
    read[:, 3] = np.interp(time - CAUSES[name].behind, time, read[:, 3])
    frames = np.arange(0, time.size, EVERY)
    stamps = recording.stamp_ns[frames] + round(NANOSECONDS_PER_SECOND * CAUSES[name].late)
    if CAUSES[name].loses:
        frames = lost(recording, random)
        period = round(NANOSECONDS_PER_SECOND * EVERY / RATE)
        stamps = recording.stamp_ns[0] + period * np.arange(frames.size)
    arrivals = np.searchsorted(recording.stamp_ns, stamps) + LATE  # in the order of the stamps
    arriving = dict(zip(arrivals.tolist(), zip(frames, stamps, strict=True), strict=True))
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        events: list = []
        if instant in arriving:
            frame, stamped = arriving[instant]
            events.append(sightings_of(int(stamped), recording.x[frame], recording.y[frame]))
        if CAUSES[name].imu:
            force, rate = (
                read[instant]
                for read in (recording.motion.specific_force, recording.motion.base_rate)
            )
            turning = (0.0, 0.0, float(rate + LabNoise().gyro_std * gyro.standard_normal()))
            reading = imu_of(stamp, force, random)
            noise = LabNoise().imu_std ** 2
            events.append(dataclasses.replace(reading, rate=turning, variance=noise))
        if wrench:
            events.append(wrench_of(stamp, read[instant]))
        events.append(PressureReading(stamp_ns=stamp, pressure=float(read[instant, 3])))
        yield events


def imu_of(stamp_ns: int, force: Array, random: np.random.Generator) -> ImuReading:
    """Return what an accelerometer reads of a specific force (2,) m/s^2 in the plane."""
    x, y = (force + LabNoise().imu_std * random.standard_normal(2)).tolist()
    beyond = math.sqrt(max(STANDARD_GRAVITY**2 - x**2 - y**2, 0.0))
    return ImuReading(stamp_ns=stamp_ns, x=x, y=y, z=beyond, frame_id=BASE_FRAME)


def fuse(
    fusion: Fusion, recording: LabRecording, name: str, seed: int, *, wrench: bool = False
) -> tuple[Array, list]:
    """Return NUMBERS of every reading, and what was said at each."""
    settings = dataclasses.replace(fusion.settings, delay_std=CAUSES[name].delay_std)
    fusion = dataclasses.replace(fusion, settings=settings)
    truth, state = recording.truth, FusionState()
    rows, said = np.full((truth.time.size, len(NUMBERS)), np.nan), []
    for instant, events in enumerate(readings_of(recording, name, seed, wrench=wrench)):
        sentences: tuple[str, ...] = ()
        for event in events:
            state, fused = fusion.step(state, event)
            if isinstance(fused, FusedEstimate):
                # Without the pressure it is of the last frame, as its stamp says.
                shown = int(np.abs(recording.stamp_ns - fused.estimate.stamp_ns).argmin())
                tip = np.array([truth.x[shown, -1], truth.y[shown, -1]])
                rows[instant] = row_of(fused, tip, truth.force[shown])
                sentences = tuple(fused.estimate.warnings)
                if fused.contact is not None:
                    sentences += (AMBIGUOUS if fused.contact.ambiguous else CONTACT,)
        said.append(sentences)
    return rows, said


def row_of(fused: FusedEstimate, tip: Array, force: Array) -> list[float]:
    """Return NUMBERS of an estimate beside the true tip (2,) m and force (2,) N."""
    missed = tip - np.array(fused.estimate.shape.tip[:2])
    covariance = fused.estimate.tip_covariance[:2, :2]
    return [
        float(np.hypot(*missed)),
        float(missed @ np.linalg.solve(covariance, missed)),
        *force_error(fused, force),
    ]


def try_model(seed: int, recordings: int, seconds: float = SECONDS) -> dict[str, Array]:
    """Fuse recordings of a rig with each cause by the model of it: NUMBERS, and what was said."""
    fusion = Fusion(arm=model_of(seed))
    found: dict[str, Array] = {}
    for name in CAUSES:
        every, spoken = [], []
        for which in range(recordings):
            recording = recording_of(seed, which, name, seconds)
            rows, said = fuse(fusion, recording, name, 100 * seed + which)
            every.append(rows)
            spoken.append(shares_of(said))
        found[name] = np.array(every)
        found[f'{name}: said'] = np.array(spoken)
    return found


def shares_of(said: list) -> Array:
    """Return sentences with the share of readings at which each was said, most often first."""
    counts: dict[str, int] = {}
    for sentences in said:
        for sentence in set(sentences):
            kind = kind_of(sentence)
            counts[kind] = counts.get(kind, 0) + 1
    found = sorted(counts.items(), key=lambda item: -item[1])[:SENTENCES]
    rows = [f'{count / len(said):.6f} {sentence}' for sentence, count in found]
    return np.array(rows + [''] * (SENTENCES - len(rows)), dtype='U200')


def kind_of(sentence: str) -> str:
    """Return a sentence without its details."""
    return sentence.split(':')[0].split(';')[0]


ACCUSATIONS = {CONTACT, *map(kind_of, SETUP_PROBLEMS)}  # the others say what an estimate is worth


def numbers_of(rows: Array) -> dict[str, float]:
    """Return the numbers of one cause: rows (recordings, readings, NUMBERS)."""
    column = {name: rows[..., place] for place, name in enumerate(NUMBERS)}

    def covered(nees: Array) -> float:
        known = nees[np.isfinite(nees)]
        return float((known <= IN_95).mean()) if known.size else math.nan

    def rms(values: Array) -> float:
        known = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(known**2))) if known.size else math.nan

    return {
        'tip_rms': rms(column['tip']),
        'tip_covered': covered(column['tip_nees']),
        'force_rms': rms(column['force']),
        'force_covered': covered(column['force_nees']),
        'one_component': float((column['components'] == 1.0).mean()),
        'withheld': 1.0 - float(np.isfinite(column['force_nees']).mean()),
        'estimates': float(np.isfinite(column['tip']).mean()),
    }


def mean_shares(rigs: list[dict[str, Array]], name: str) -> dict[str, float]:
    """Return the mean share of readings at which each sentence was said."""
    recordings = [row for rig in rigs for row in rig[f'{name}: said']]
    shares: dict[str, float] = {}
    for row in recordings:
        for text in row[row != ''].tolist():
            share, _, sentence = text.partition(' ')
            shares[sentence] = shares.get(sentence, 0.0) + float(share) / len(recordings)
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def worst_of(recordings: Array) -> dict[str, float]:
    """Return the least share of a recording that is covered, by number."""
    every = [numbers_of(rows[None]) for rows in recordings]
    worst = {}
    for name in ('tip_covered', 'force_covered'):
        known = [one[name] for one in every if math.isfinite(one[name])]
        worst[f'{name}_worst'] = min(known, default=math.nan)
    return worst


def wrongly_named(rigs: list[dict[str, Array]], name: str) -> int:
    """Return in how many recordings a cause is named for long that is not there."""
    kinds = {one.name: kind_of(one.sentence) for one in NAMED}
    wrong = ACCUSATIONS - {kinds[right] for right in CAUSES[name].right}
    every = (row for rig in rigs for row in rig[f'{name}: said'])
    return sum(
        any(
            text.partition(' ')[2] in wrong and float(text.partition(' ')[0]) > WRONG
            for text in row.tolist()
        )
        for row in every
    )


def summary_of(rigs: list[dict[str, Array]]) -> dict:
    """Return what each cause came to."""
    causes = {}
    for name in CAUSES:
        rows = np.concatenate([rig[name] for rig in rigs])
        causes[name] = {**numbers_of(rows), **worst_of(rows), 'said': mean_shares(rigs, name)}
    accused = {
        name: sum(share for text, share in causes[name]['said'].items() if text in ACCUSATIONS)
        for name in NOTHING
    }
    missed = [f'{name}: {share:.3f} of causes and contacts, in sum, wanted 0.010 at most'
              for name, share in accused.items() if share > ACCUSED]  # fmt: skip
    lowest = {'estimates': ANSWERED, 'tip_covered_worst': WORST, 'force_covered_worst': WORST}
    missed += [f'{name}: {what} = {one[what]:.3f}, wanted {low:g} at least'
               for name, one in causes.items() for what, low in lowest.items()
               if one[what] < low]  # fmt: skip
    wrong = {name: wrongly_named(rigs, name) for name in CAUSES}
    share = sum(wrong.values()) / sum(len(rig[name]) for rig in rigs for name in CAUSES)
    if share > MOST_WRONG:
        missed.append(f'wrong causes: {share:.3f} of recordings, wanted {MOST_WRONG:g} at most')
    return {'causes': causes, 'wrong': wrong, 'missed': missed}


def show(summary: dict, title: str) -> None:
    """Print the table as markdown; in brackets the worst recording."""
    print(f'{title}\n')
    print(
        '| cause | tip rms | covered | force rms | covered | one component | withheld '
        '| said, share of readings |'
    )
    print('|---|---|---|---|---|---|---|---|')
    for name, one in summary['causes'].items():
        said = '; '.join(f'{share:.2f} {text}' for text, share in one['said'].items()
                         if share >= 0.005)  # fmt: skip
        tip, force = (
            f'{one[covered]:.2f} ({one[f"{covered}_worst"]:.2f})'
            for covered in ('tip_covered', 'force_covered')
        )
        print(
            f'| {name} | {1e3 * one["tip_rms"]:.2f} mm | {tip} | '
            f'{1e3 * one["force_rms"]:.1f} mN | {force} | '
            f'{one["one_component"]:.2f} | {one["withheld"]:.2f} | {said or "nothing"} |'
        )
    wrong = ', '.join(f'{name}: {count}' for name, count in summary['wrong'].items() if count)
    print(f'recordings with a wrong cause: {wrong or "none"}')
    print('\n'.join(summary['missed'] or ['all goals reached']))


def main() -> int:
    """Run and print."""
    command = rig_command(__doc__.splitlines()[0], recordings=5, quick=QUICK)
    arguments, attempt, name = command.parse_args(), try_model, 'everyday_causes'
    if arguments.quick:
        name = f'{name}_quick'  # shorter recordings: rows that are kept are others
        arguments.quick, arguments.rigs, arguments.recordings = False, 1, 1
        attempt = partial(try_model, seconds=QUICK_SECONDS)
    return run_bench(name, arguments, attempt, summary_of, show)


if __name__ == '__main__':
    sys.exit(main())
