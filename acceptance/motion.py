"""Accuracy for swinging, hanging and turning arms, on an independent MuJoCo arm.

    python acceptance/motion.py [--quick] [--json] [--rigs N] [--recordings N] [--first N]
                                [--keep FOLDER] [--workers N] [--part used|calibrated|gravity]

A rig is an arm of the virtual lab with its mass, moved by MuJoCo: f1 is about 1.2 Hz, the damping
a tenth of the critical one. Sensors are those of `everyday_causes.py`. Its statics are calibrated
from recordings without mass; mass and damping are fitted to one recording of steps (row `motion`,
beside the free decay of a pluck). Ways: the estimator's prediction from pressure and force sensor,
the fusion with and without a force sensor. The tip, the force and how often they lie in the stated
95 %, at every reading; contacts where none are, and what else is said. `turning`: the base turns
at up to 90 degrees/s with gravity in the plane, and an IMU on it. At the peg: how often
it is found, and its size and place. Gravity: calibrated hanging and used sideways. Calibration:
from recordings of the arm with mass, by slow ramps and by quick steps with plucks, rigidities
beside the true ones in percent and in standard errors. Exit code 1 where a goal of issue "the arm
has mass" is missed.
"""

from __future__ import annotations

import dataclasses
from functools import partial
import math
import sys
import time

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from calibration import law_values, LOADED, standard_errors, true_model, UNLOADED
from everyday_causes import (
    Cause,
    CAUSES,
    CONTACT,
    EVERY,
    fuse,
    LATE,
    mean_shares,
    NUMBERS,
    numbers_of,
    RATE,
    readings_of,
    recording_of,
    shares_of,
)
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.motion.motion_fit import fit_motion
from pneunet_ros.cli.experiments import as_measured
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import ImuReading, PressureReading, TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners, RandomMix
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.moving_arm import unloaded_modes
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.motion import Motion
from rigs import missed_goals, model_of, rig_command, run_bench
from support.lab_run import run_of

STEPS = 'the arm has mass, steps'
CAUSE_OF_STEPS = f'{STEPS}, unloaded'
TURNING = 'the arm has mass, slow ramps, its base turns'
# Quarter turns in 2 s each: at up to 1.6 rad/s, as minimum jerk has it.
TURN = LabMotion(
    gravity_x=1.0,
    turn_share=(0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
    turn_angle=(0.0, 1.6, 1.6, 0.0, 0.0, -1.6, -1.6, 0.0, 1.6, 0.0, 0.0),
)
CAUSES[TURNING] = Cause(ramp=2.0, loaded=False, motion=TURN, imu=True)
COURSES = {
    'slow ramps, loaded': 'the arm has mass, slow ramps',
    'steps, loaded': STEPS,
    'steps, unloaded': f'{STEPS}, unloaded',
    'turning, unloaded': TURNING,
}
WAYS = ('prediction', 'fused, wrench', 'fused, no wrench')
PEGS = {'peg, slow ramps': 2.0, 'peg, steps': 0.1}  # s, of the ramps
# A peg in the way of an arm that bends up to 60 kPa, and what counts as touching it.
PEG = {'peg_x': 0.08, 'peg_y': 0.04, 'peg_radius': 0.006}
TOUCHES = 8e-3  # N
PEG_NUMBERS = ('true_force', 'true_place', 'force', 'place')
# Recordings for a calibration: ramps (s), how an arm is plucked, and how long each lasts (s); the
# short ones hardly ever rest.
PLUCKS = {'push': {'force': 0.03, 'place': 0.9, 'begins': 3.0, 'ends': 4.0, 'every': 8.0}}
CALIBRATIONS = {
    'slow ramps': (2.0, {}, 20.0),
    'steps and plucks': (0.1, PLUCKS, 60.0),
    'steps and plucks, short': (0.1, PLUCKS, 20.0),
}
QUICKLY = 'used and gravity'
HANGING, SIDEWAYS = LabMotion(gravity_x=1.0), LabMotion(gravity_y=-1.0)
GRAVITY_ROWS = ('hanging, at rest', 'sideways, at rest', 'sideways, moved by MuJoCo')
MOTION_ROWS = ('fitted to steps', 'fitted to a free decay')
TRUE_MOTION = Motion(damping_time=LabMotion().damping_time)
GOALS = {
    ('turning, unloaded: prediction', 'tip_rms'): (0.0, 1e-3),
    ('turning, unloaded: prediction', 'tip_covered'): (0.90, 1.0),
    ('turning, unloaded: fused, no wrench', 'tip_rms'): (0.0, 0.3e-3),
    ('turning, unloaded: fused, no wrench', 'tip_covered'): (0.93, 0.97),
    ('sideways, at rest', 'beyond'): (0.0, 0.5e-3),
    ('fitted to a free decay', 'frequency'): (0.0, 0.02),
    ('fitted to a free decay', 'damping'): (0.0, 0.05),
    ('fitted to steps', 'damping'): (0.0, 0.05),
    ('step', 'microseconds'): (0.0, 200.0),
    ('steps, loaded: fused, no wrench', 'tip_rms'): (0.0, 0.3e-3),
    ('steps, loaded: fused, no wrench', 'tip_covered'): (0.93, 0.97),
    ('steps, loaded: fused, no wrench', 'force_covered'): (0.93, 0.97),
    ('steps, unloaded: fused, no wrench', 'tip_rms'): (0.0, 0.3e-3),
    ('steps, unloaded: fused, no wrench', 'tip_covered'): (0.93, 0.97),
    ('steps, loaded: prediction', 'tip_rms'): (0.0, 1e-3),
    ('steps, loaded: prediction', 'tip_covered'): (0.90, 1.0),
    ('steps, unloaded: prediction', 'tip_rms'): (0.0, 1e-3),
    ('steps, unloaded: prediction', 'tip_covered'): (0.90, 1.0),
    ('calibrate, steps and plucks', 'rms'): (0.0, 0.01),
    ('calibrate, steps and plucks', 'given'): (1.0, 1.0),
    **{(f'{course}: {way}', 'contacts'): (0.0, 1e-3) for course in COURSES for way in WAYS[1:]},
}


def moving_model(seed: int) -> tuple[Arm, Array]:
    """Return the model of a rig that knows motion, and the relative errors of what was fitted.

    Frequency and damping of the slowest vibration, (2 MOTION_ROWS, 2): by one recording of steps,
    and by a free decay.
    """
    arm, errors = model_of(seed), []
    true = unloaded_modes(dataclasses.replace(arm, motion=TRUE_MOTION, covariance=None))
    assert true is not None
    runs = [recording_of(seed, 91, CAUSE_OF_STEPS, 20.0), plucked(seed)]
    fits = [fit_motion(arm, [run_of(run).without_load()]) for run in runs]
    for fit in fits:
        rate = 1.0 / fit.decay_time
        errors.append([fit.hertz / true.hertz - 1.0, rate * true.decay_time - 1.0])
    return dataclasses.replace(arm, motion=fits[0].motion), np.abs(errors)


def plucked(seed: int) -> LabRecording:
    """Return 20 s of the free decay of a rig that was plucked and let go."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    held = Corners(
        duration=20.0,
        share=(0.0, 1.0),
        pressure=(20e3, 20e3),
        force_x=(0.0, 0.0),
        force_y=(0.0, 0.0),
    )
    push = {'push': {'force': 0.02, 'place': 0.9, 'begins': 0.2, 'ends': 1.0, 'every': 100.0}}
    return simulate(
        dataclasses.replace(
            scenario,
            arm=vary_arm(scenario.arm, seed),
            seed=seed,
            protocol=held,
            rates=Rates(pressure=60.0, wrench=60.0, frames=30.0),
            motion=LabMotion(),
        ).with_effects(push)
    )


def hung(seed: int) -> dict[str, Array]:
    """Calibrate a rig that hangs, and use it hanging and sideways: rows of NUMBERS."""
    frame = load_model(share_path('config/paper_arm.yaml'))
    rates, runs = Rates(pressure=50.0, wrench=50.0, frames=10.0, imu=100.0), {}
    for place, name in enumerate((*UNLOADED, *LOADED)):
        scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
        scenario = dataclasses.replace(
            scenario,
            arm=vary_arm(scenario.arm, seed),
            seed=100 * seed + place,
            protocol=dataclasses.replace(scenario.protocol, duration=60.0),
            motion=HANGING,
            rates=rates,
        )
        runs[name] = run_of(simulate(scenario))
    unloaded, loaded = ([runs[name] for name in names] for names in (UNLOADED, LOADED))
    frame = dataclasses.replace(frame, target_arclength=scenario.arm.targets)
    arm = calibrate(unloaded, loaded, as_measured(frame, runs.values()), compare=False).arm
    moving = dataclasses.replace(arm, motion=TRUE_MOTION)
    used = zip(
        GRAVITY_ROWS,
        (arm, arm, moving),
        (*(dataclasses.replace(one, inertia=0.0) for one in (HANGING, SIDEWAYS)), SIDEWAYS),
        strict=True,
    )
    return {name: predict_hung(model, seed, motion) for name, model, motion in used}


def predict_hung(arm: Arm, seed: int, motion: LabMotion) -> Array:
    """Return NUMBERS of the prediction on a recording of 20 s, gravity by the accelerometer."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    recording = simulate(
        dataclasses.replace(
            scenario,
            arm=vary_arm(scenario.arm, seed),
            seed=seed,
            protocol=dataclasses.replace(scenario.protocol, duration=20.0, ramp=2.0),
            noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
            rates=Rates(pressure=RATE, wrench=RATE, frames=RATE, imu=RATE),
            motion=motion,
        )
    )
    return predict(arm, recording, STEPS, seed, recording.imu)


def step_time(arm: Arm, seed: int) -> Array:
    """Return the time (us of CPU) of a step of the estimator, the best of ten parts, (1,)."""
    recording = recording_of(seed, 92, CAUSE_OF_STEPS, 12.0)
    estimator = Estimator(arm=arm, settings=EstimatorSettings(wrench_required=False))
    state, times = EstimatorState(), []
    readings = np.arange(recording.reading_stamp_ns.size)
    for batch in np.array_split(readings, 10):
        begun = time.process_time()
        for instant in batch.tolist():
            reading = PressureReading(
                stamp_ns=int(recording.reading_stamp_ns[instant]),
                pressure=float(recording.pressure[instant]),
            )
            state, _ = estimator.step(state, reading)
        times.append((time.process_time() - begun) / batch.size)
    return np.array([1e6 * min(times)])


def predict(
    arm: Arm, recording: LabRecording, name: str, seed: int, imu: Array | None = None
) -> Array:
    """Return NUMBERS of the estimator's prediction at every reading; of no force.

    imu (readings, 4): what an IMU reads, None: of the cause.
    """
    loaded = CAUSES[name].loaded  # otherwise there is no force sensor
    estimator = Estimator(arm=arm, settings=EstimatorSettings(wrench_required=loaded))
    state, truth = EstimatorState(), recording.truth
    rows = np.full((truth.time.size, len(NUMBERS)), np.nan)
    for instant, events in enumerate(readings_of(recording, name, seed, wrench=loaded)):
        if imu is not None:
            x, y, z, rate = imu[instant].tolist()
            stamp, turning = int(recording.stamp_ns[instant]), (0.0, 0.0, rate)
            reading = ImuReading(stamp_ns=stamp, x=x, y=y, z=z, frame_id=BASE_FRAME, rate=turning)
            events = [reading, *events]
        for event in events:
            if isinstance(event, TargetSightings):
                continue
            state, estimate = estimator.step(state, event)
            if isinstance(estimate, ShapeEstimate):
                tip = np.array([truth.x[instant, -1], truth.y[instant, -1]])
                off = tip - np.array(estimate.shape.tip[:2])
                nees = off @ np.linalg.solve(estimate.tip_covariance[:2, :2], off)
                rows[instant, :2] = np.hypot(*off), nees
    return rows


def peg_recording(seed: int, which: int, ramp: float) -> LabRecording:
    """Return an unloaded recording in which the arm runs against a peg."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    free = {'force_x': (0.0, 0.0), 'force_y': (0.0, 0.0)}
    protocol = RandomMix(
        duration=20.0, seed=float(100 * seed + which), lowest=2e3, top=60e3, ramp=ramp, **free
    )
    return simulate(
        dataclasses.replace(
            scenario,
            name=f'peg {which}',
            seed=seed,
            arm=vary_arm(scenario.arm, seed),
            protocol=protocol,
            noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
            rates=Rates(pressure=RATE, wrench=RATE, frames=RATE),
            motion=LabMotion(**PEG),
        )
    )


def touch(fusion: Fusion, recording: LabRecording, seed: int) -> Array:
    """Return PEG_NUMBERS at every reading: force along the normal (N) and place (m)."""
    truth, motion, state = recording.truth, recording.motion, FusionState()
    rows = np.full((truth.time.size, len(PEG_NUMBERS)), np.nan)
    for instant, events in enumerate(readings_of(recording, STEPS, seed)):
        place = float(motion.contact_place[instant])
        heading = np.interp(place, truth.arclength, truth.theta[instant])
        normal = np.array([-math.sin(heading), math.cos(heading)])
        size = float(motion.contact_force[instant] @ normal) if math.isfinite(place) else 0.0
        rows[instant, :2] = size, place
        for event in events:
            state, fused = fusion.step(state, event)
            contact = getattr(fused, 'contact', None)
            if contact is not None and not contact.ambiguous:
                rows[instant, 2:] = contact.force, contact.arclength
    return rows


def calibrated(seed: int, kind: str) -> Array:
    """Return errors of the rigidities: rms relative, share within 1.96 standard errors; NaN: none.

    The arm has mass in all six recordings.
    """
    ramp, effects, seconds = CALIBRATIONS[kind]
    frame = load_model(share_path('config/paper_arm.yaml'))
    runs = {}
    for place, name in enumerate((*UNLOADED, *LOADED)):
        scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
        protocol = dataclasses.replace(scenario.protocol, duration=seconds, rest=1.0)
        if name not in ('unloaded_ramp', 'force_sweeps'):
            slow = 0.5 if name == 'dead_weights' else min(ramp, 1.0)
            protocol = dataclasses.replace(protocol, ramp=slow if ramp > 1.0 else ramp)
        scenario = dataclasses.replace(
            scenario,
            arm=vary_arm(scenario.arm, seed),
            seed=100 * seed + place,
            protocol=protocol,
            motion=LabMotion(),
        ).with_effects(effects if name in UNLOADED else {})
        runs[name] = run_of(simulate(scenario))
    true = true_model(dataclasses.replace(scenario, effects=()))
    frame = dataclasses.replace(frame, target_arclength=scenario.arm.targets)
    unloaded, loaded = ([runs[name] for name in names] for names in (UNLOADED, LOADED))
    try:
        found = calibrate(unloaded, loaded, frame, compare=False)
    except PneunetError as error:
        print(f'{kind}: {error}', file=sys.stderr)
        return np.full(3, np.nan)
    off = law_values(found.arm)[:2] / law_values(true)[:2] - 1.0
    sigma = standard_errors(found)[0][:2] / law_values(true)[:2]
    within = np.abs(off) <= 1.959964 * sigma
    return np.array([np.sqrt(np.mean(off**2)), within.mean(), float(found.joint.converged)])


def try_model(seed: int, recordings: int, part: str | None) -> dict[str, Array]:
    """Try a rig: NUMBERS by course and way, PEG_NUMBERS, and calibrations; or a part of these."""
    found = try_ways(seed, recordings) if part in (None, 'used', QUICKLY) else {}
    if part in (None, 'gravity', QUICKLY):
        found |= hung(seed)
    if part in (None, 'calibrated'):
        found |= {f'calibrate, {kind}': calibrated(seed, kind) for kind in CALIBRATIONS}
    return found


def try_ways(seed: int, recordings: int) -> dict[str, Array]:
    """Use the model of a rig: NUMBERS by course and way, and PEG_NUMBERS."""
    arm, errors = moving_model(seed)
    fusion = Fusion(arm=arm)
    free_tip = Fusion(arm=arm, settings=dataclasses.replace(FUSION, free_tip=True))
    rows: dict[str, list] = {}
    for course, cause in COURSES.items():
        for which in range(recordings):
            recording, own = recording_of(seed, which, cause), 100 * seed + which
            rows.setdefault(f'{course}: {WAYS[0]}', []).append(predict(arm, recording, cause, own))
            for way, wrench in zip(WAYS[1:], (True, False), strict=True):
                if wrench and not CAUSES[cause].loaded:
                    continue  # no force sensor reads anything there
                found, said = fuse(fusion, recording, cause, own, wrench=wrench)
                rows.setdefault(f'{course}: {way}', []).append(found)
                rows.setdefault(f'{course}: {way}: said', []).append(shares_of(said))
    for peg, ramp in PEGS.items():
        for which in range(recordings):
            recording = peg_recording(seed, which, ramp)
            rows.setdefault(peg, []).append(touch(free_tip, recording, 100 * seed + which))
    found = {name: np.array(every) for name, every in rows.items()}
    return found | dict(zip(MOTION_ROWS, errors, strict=True)) | {'step': step_time(arm, seed)}


def peg_numbers(rows: Array) -> dict[str, float]:
    """Return how well the peg is found: rows (recordings, readings, PEG_NUMBERS).

    A contact that ends after the last frame that has arrived is not false, but seen late.
    """
    true, place, force, found = np.moveaxis(rows, -1, 0)
    touching, seen = np.abs(true) >= TOUCHES, np.isfinite(force)
    both, touched, lately = touching & seen, true != 0.0, true != 0.0
    for ago in range(1, LATE + EVERY):
        lately[:, ago:] |= touched[:, :-ago]
    ended = lately & ~touched
    share = np.abs(force - true)[both] / np.abs(true[both])
    return {
        'touching': float(touching.mean()),
        'found': float(seen[touching].mean()) if touching.any() else math.nan,
        'false': float(seen[~lately].mean()),
        'late': float(seen[ended].mean()) if ended.any() else math.nan,
        'size': float(np.median(share)) if both.any() else math.nan,
        'place': float(np.median(np.abs(found - place)[both])) if both.any() else math.nan,
    }


def summary_of(rigs: list[dict[str, Array]]) -> dict:
    """Return what each way came to, and which goals are missed."""
    ways, pegs, calibrations, others = {}, {}, {}, {}
    for name in rigs[0]:
        every = [rig[name] for rig in rigs]
        if name in MOTION_ROWS:
            frequency, damping = np.mean(every, axis=0)
            others[name] = {'frequency': frequency, 'damping': damping}
        elif name == 'step':
            others[name] = {'microseconds': float(np.median(every))}
        elif name in GRAVITY_ROWS:
            others[name] = numbers_of(np.array(every))
            others[name]['beyond'] = others[name]['tip_rms'] - others.get(
                GRAVITY_ROWS[0], others[name]
            )['tip_rms']  # fmt: skip
        elif name in PEGS:
            pegs[name] = peg_numbers(np.concatenate(every))
        elif name.startswith('calibrate, '):
            rms, within, converged = np.array(every).T
            calibrations[name] = {
                'rms': np.nanmean(rms) if np.isfinite(rms).any() else math.nan,
                'covered': np.nanmean(within) if np.isfinite(within).any() else math.nan,
                'models': int(np.isfinite(rms).sum()),
                'given': float(np.isfinite(rms).mean()),
                'converged': int(np.nansum(converged)),
            }
        elif not name.endswith(': said'):
            said = mean_shares(rigs, name) if f'{name}: said' in rigs[0] else {}
            contacts = said.pop(CONTACT, 0.0)
            ways[name] = {**numbers_of(np.concatenate(every)), 'contacts': contacts, 'said': said}
    numbers = ways | calibrations | others  # of the part that was tried
    missed = missed_goals(numbers, {what: GOALS[what] for what in GOALS if what[0] in numbers})
    tables = {'ways': ways, 'pegs': pegs, 'calibrations': calibrations, 'others': others}
    return {**tables, 'missed': missed}


def show(summary: dict, title: str) -> None:
    """Print tables as markdown."""
    print(f'{title}\n')
    print('| course and way | tip rms | covered | force rms | covered | withheld '
          '| false contacts | said |\n|---|---|---|---|---|---|---|---|')  # fmt: skip
    for name, one in summary['ways'].items():
        said = '; '.join(f'{s:.2f} {text}' for text, s in one['said'].items() if s >= 0.005)
        force = '- | - | -' if 'prediction' in name else (
            f'{1e3 * one["force_rms"]:.1f} mN | {one["force_covered"]:.2f} | {one["withheld"]:.2f}'
        )  # fmt: skip
        print(
            f'| {name} | {1e3 * one["tip_rms"]:.2f} mm | {one["tip_covered"]:.2f} | {force} | '
            f'{one["contacts"]:.3f} | {said or "nothing"} |'
        )
    print('\n| peg | touching | found | false | seen late | size off | place off, median |')
    print('|---|---|---|---|---|---|---|')
    for name, one in summary['pegs'].items():
        print(
            f'| {name} | {one["touching"]:.2f} | {one["found"]:.2f} | {one["false"]:.4f} | '
            f'{one["late"]:.2f} | {100 * one["size"]:.0f} % | {1e3 * one["place"]:.1f} mm |'
        )
    print('\n| calibrated hanging, by an accelerometer | tip rms | covered |\n|---|---|---|')
    for name, one in summary['others'].items():
        if name in GRAVITY_ROWS:
            print(f'| {name} | {1e3 * one["tip_rms"]:.2f} mm | {one["tip_covered"]:.2f} |')
    print('\n| motion | frequency off | damping off |\n|---|---|---|')
    for name, one in summary['others'].items():
        if name in MOTION_ROWS:
            off = (f'{100 * one[what]:.1f} %' for what in ('frequency', 'damping'))
            print(f'| {name} | {" | ".join(off)} |')
    for one in summary['others'].values():
        if 'microseconds' in one:
            print(f'\nA step of the estimator takes {one["microseconds"]:.0f} us of CPU.')
    print('\n| calibration | models | converged | rigidities off, rms | covered |')
    print('|---|---|---|---|---|')
    for name, one in summary['calibrations'].items():
        print(
            f'| {name} | {one["models"]} | {one["converged"]} | {100 * one["rms"]:.1f} % | '
            f'{one["covered"]:.2f} |'
        )
    print('\n' + '\n'.join(summary['missed'] or ['all goals reached']))


def main() -> int:
    """Run and print."""
    command = rig_command(
        __doc__.splitlines()[0], recordings=10, quick='one rig, one recording; no calibrations'
    )
    command.add_argument(
        '--part',
        choices=('used', 'calibrated', 'gravity'),
        help='only the use of a model, only calibrations, or only arms that hang (default: all)',
    )
    arguments = command.parse_args()
    if arguments.quick:
        arguments.quick, arguments.rigs, arguments.recordings = False, 1, 1
        arguments.part = arguments.part or QUICKLY
    attempt = partial(try_model, part=arguments.part)
    name = '_'.join(filter(None, ('motion', arguments.part)))  # rows of another part are others
    return run_bench(name, arguments, attempt, summary_of, show)


if __name__ == '__main__':
    sys.exit(main())
