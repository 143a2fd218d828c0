"""Accuracy of force and tip from pressure and targets, with and without a force sensor.

    python acceptance/fusion.py [--quick] [--json] [--rigs N] [--recordings N] [--first N]
                                [--keep FOLDER] [--long WAY] [--true-arm] [--workers N]

A rig is an arm of the virtual lab (parameters up to 15 % off); `calibrate` makes its model from
six recordings. Then the camera is put up anew, and pressure and load go through random mixes: 10
frames a second, readings at the instants of the frames and between two. The dots are those of the
calibration, but for `other targets`, where they are painted anew for each recording.
The truth is that of the lab, which shares no solver with the model. `at frames` is the estimate at
the stamp of a frame, `between` that half a period later, when the arm may have moved on. NEES: e^T
P^-1 e of two coordinates, on average 2 where the covariance is right. A force is determined where
one of its components is, and judged by those that are; shares of it ask for both. Where an
estimate is due and none comes, no mode is right. With
`--true-arm` the fusion knows the arm and its dots exactly: what no calibration can better. Exit
code 1 where a goal is missed.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from calibration import true_model
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.estimate import FusedEstimate, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_effects import LabCreep, LabEffect, LabHysteresis
from pneunet_ros.lab.lab_recording import LabRecording, LabTruth
from pneunet_ros.lab.protocols import RandomMix
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import ModelCovariance, PlacementKnown
from pneunet_ros.vision.smoother import smoother_for
from rich.console import Console
from rich.table import Table
from rigs import (
    ANSWERED,
    force_error,
    missed_goals,
    model_of,
    read_sensors,
    rig_command,
    run_bench,
    sightings_of,
    WORST,
    wrench_of,
)
from scipy.stats import chi2

RATE = 20.0  # Hz, of readings; every second instant is a frame
PERIOD = 2.0 / RATE  # s, of frames
IN_95 = float(chi2.ppf(0.95, 2))
BEYOND = 4.0**2  # 4 sigma; of 10 000 errors of two coordinates 3 lie further
LONG, PARTS = 1800.0, 6  # s; parts of a long recording that are looked at one by one
LONG_RATE = 5.0  # Hz; the lab keeps no more of half an hour
LIGHT = 0.02  # N, below which a share of the force means nothing
SURE = 0.05  # of the force: sigma of one that counts
PRESSED = 10e3  # Pa
EXACT = 1e-9  # one sigma of what is known
Intervals = tuple[tuple[float, float], ...]
COLUMNS = (
    'tip', 'tip_nees', 'share', 'sigma', 'force_nees', 'components', 'pressed', 'ambiguous', 'age',
    'mode', 'astray', 'withheld', 'predicted_alone', 'camera_alone',
)  # fmt: skip


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """What is there in a way to fuse: sensors, targets, and physics that the model lacks.

    hidden: targets that are not seen; lacking: of the arm; top (Pa), aside (N): the largest
    pressure, and force across the straight arm; lost: each sensor for some seconds in turn;
    painted_anew: the targets, after the calibration. untared (N): what the force sensor reads in
    both components where nothing pulls; gain: of the sensor.
    """

    wrench: bool = False
    hidden: str = ''
    lacking: tuple[LabEffect, ...] = ()
    top: float = 62e3
    aside: float = 0.22
    lost: bool = False
    painted_anew: bool = False
    untared: float = 0.0
    gain: float = 1.0


CREEP = (LabCreep(amplitude=0.15, time_constant=60.0),)
HYSTERESIS = (LabHysteresis(width=4e3),)
WAYS = {
    'no wrench': Way(),
    'wrench': Way(wrench=True),
    'base hidden': Way(hidden='base'),
    'half hidden': Way(hidden='half'),
    'tip hidden': Way(hidden='tip'),
    'creep, no wrench': Way(lacking=CREEP),
    'creep, wrench': Way(lacking=CREEP, wrench=True),
    'hysteresis, no wrench': Way(lacking=HYSTERESIS),
    'hysteresis, wrench': Way(lacking=HYSTERESIS, wrench=True),
    'straight': Way(top=5e3, aside=0.01),
    'other targets, no wrench': Way(painted_anew=True),
    'other targets, wrench': Way(wrench=True, painted_anew=True),
    'wrench not tared, 5 mN': Way(wrench=True, untared=5e-3),
    'wrench not tared, 20 mN': Way(wrench=True, untared=20e-3),
    'wrench not tared, -20 mN': Way(wrench=True, untared=-20e-3),
    'wrench with a gain of 0.8': Way(wrench=True, gain=0.8),
    'wrench of a sensor that is dead': Way(wrench=True, gain=0.0),
    'wrench of the wrong sign': Way(wrench=True, gain=-1.0),
    'lost and back': Way(wrench=True, lost=True),
    'lost, no wrench': Way(lost=True),
}
# s, in which a sensor is lost, and those of them in which the wrench is as well
LOST = {'targets': ((8.0, 11.0), (24.0, 25.0)), 'pressure': ((14.0, 18.0),)}
NO_WRENCH = ((20.0, 30.0),)
GOALS = {
    **{(name, 'estimates'): (ANSWERED, 1.0) for name in WAYS},
    ('no wrench', 'sure_rms'): (0.0, 0.035),
    ('no wrench', 'median'): (0.0, 0.04),
    ('no wrench', 'tip_rms'): (0.0, 0.16e-3),
    ('no wrench', 'force_covered'): (0.93, 0.97),
    ('no wrench', 'tip_covered'): (0.93, 0.97),
    ('no wrench', 'worst_force'): (WORST, 1.0),
    ('no wrench', 'worst_tip'): (WORST, 1.0),
    ('no wrench', 'force_nees'): (1.6, 2.6),
    ('no wrench', 'worst_of_better'): (0.0, 0.5),
    ('wrench', 'worst_of_better'): (0.0, 0.5),
    ('no wrench', 'tip_nees'): (1.6, 2.6),
    ('wrench', 'tip_rms'): (0.0, 0.11e-3),
    ('wrench', 'tip_covered'): (0.93, 0.97),
    ('wrench', 'force_covered'): (0.93, 0.97),
    ('wrench', 'worst_tip'): (WORST, 1.0),
    ('wrench', 'tip_nees'): (1.6, 2.6),
    **{
        (f'other targets, {which}', 'tip_covered'): (0.93, 1.0)
        for which in ('no wrench', 'wrench')
    },
    ('half hidden', 'tip_covered'): (0.93, 1.0),
    ('half hidden', 'tip_rms'): (0.0, 0.25e-3),
    ('base hidden', 'tip_covered'): (0.93, 1.0),
    ('base hidden', 'tip_rms'): (0.0, 0.25e-3),
    ('tip hidden', 'tip_covered'): (0.93, 1.0),
    **{
        (f'{lacking}, {which}', what): limits
        for lacking in ('creep', 'hysteresis')
        for which, what, limits in (
            ('no wrench', 'force_covered', (0.85, 1.0)),
            ('wrench', 'force_covered', (0.92, 1.0)),
            ('wrench', 'tip_covered', (0.92, 1.0)),
            ('wrench', 'tip_rms', (0.0, 0.11e-3)),
        )
    },
    **{
        (name, what): limits
        for name, way in WAYS.items()
        if way.untared or way.gain != 1.0
        for what, limits in (('tip_rms', (0.0, 0.16e-3)), ('tip_covered', (0.92, 1.0)))
    },
    ('straight', 'withheld'): (0.99, 1.0),
    ('lost and back', 'mode_right'): (1.0, 1.0),
    ('lost and back', 'beyond_4_sigma'): (0.0, 1e-3),
    ('lost, no wrench', 'mode_right'): (1.0, 1.0),
    ('lost, no wrench', 'beyond_4_sigma'): (0.0, 1e-3),
}


def recording_of(
    seed: int, which: int, way: Way = WAYS['no wrench'], duration: float = 40.0, rate: float = RATE
) -> LabRecording:
    """Return one of the recordings of a rig, with dots and camera of its own."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    arm = vary_arm(scenario.arm, seed)
    if way.painted_anew:
        arm = dataclasses.replace(arm, seed=100 * seed + which)
    return simulate(
        dataclasses.replace(
            scenario,
            name=f'fusion {which}',
            seed=seed,
            arm=arm,
            effects=way.lacking,
            protocol=RandomMix(
                duration=duration,
                seed=float(100 * seed + which),
                lowest=2e3,
                top=way.top,
                force_y=(0.0, way.aside),
            ),
            noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
            rates=Rates(pressure=rate, wrench=rate, frames=rate),
        )
    )


def hide(way: Way, x: Array, random: np.random.Generator) -> Array:
    """Return x of the targets, NaN where this way does not see them."""
    half, x = x.size // 2, x.copy()
    if way.hidden == 'base':
        x[:half] = np.nan
    elif way.hidden == 'tip':
        x[-half:] = np.nan
    elif way.hidden == 'half':
        x[random.permutation(x.size)[:half]] = np.nan
    return x


def is_lost(way: Way, when: Intervals, time: float) -> bool:
    """Whether a sensor is not there at a time (s)."""
    return way.lost and any(begin <= time < end for begin, end in when)


def right_modes(way: Way, time: float, fusion: Fusion) -> set[Mode]:
    """Return the modes that are right at a time (s): within a period of a change, both."""
    found = set()
    for instant in (time - PERIOD, time, time + PERIOD):
        targets, pressure = (
            max([instant - begin for begin, end in LOST[name] if begin <= instant < end] or [0.0])
            for name in ('targets', 'pressure')
        )
        mode = Mode.FUSED
        if way.lost and targets > fusion.settings.target_timeout:
            mode = Mode.PREDICTION
        elif way.lost and pressure > fusion.sensors.input_timeout:
            mode = Mode.CAMERA_ONLY
        found.add(mode)
    return found


def fuse(fusion: Fusion, recording: LabRecording, way: Way, seed: int) -> Array:
    """Fuse a recording in one way, and compare with the truth: COLUMNS, a row per instant."""
    truth, random = recording.truth, np.random.default_rng([seed, 13])
    read = read_sensors(recording, random)
    state, rows = FusionState(), np.full((truth.time.size, len(COLUMNS)), np.nan)
    alone = Alone(fusion.arm)
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        time, pressure, events = float(truth.time[instant]), float(read[instant, 3]), []
        if way.wrench and not is_lost(way, NO_WRENCH, time):
            wrench = read[instant].copy()
            wrench[:2] = way.gain * wrench[:2] + way.untared
            events.append(wrench_of(stamp, wrench))
        if instant % 2 == 0 and not is_lost(way, LOST['targets'], time):
            x = hide(way, recording.x[instant], random)
            y = np.where(np.isfinite(x), recording.y[instant], np.nan)
            events.append(sightings_of(stamp, x, y))
        if not is_lost(way, LOST['pressure'], time):
            events.append(PressureReading(stamp_ns=stamp, pressure=pressure))
        place = np.array([truth.x[instant, -1], truth.y[instant, -1]])
        missed_alone, right = alone.missed(events, place), right_modes(way, time, fusion)
        if is_due(right, events):
            rows[instant, COLUMNS.index('mode')] = 0.0
        for event in events:
            state, fused = fusion.step(state, event)
            if isinstance(fused, FusedEstimate):
                row = row_of(fused, place, truth.force[instant], pressure)
                first = first_force(state, fusion.model.unknowns, fused, truth, instant)
                rows[instant] = [*row, float(fused.mode in right), *first, *missed_alone]
    return rows


def is_due(right: set[Mode], events: list) -> bool:
    """Whether readings ask for an estimate: they are those of the one mode that is right."""
    there = {type(event) for event in events}
    if right == {Mode.PREDICTION}:  # of a force that nobody reads there is none
        return {PressureReading, WrenchReading} <= there
    needed = TargetSightings if right == {Mode.CAMERA_ONLY} else PressureReading
    return len(right) == 1 and needed in there


class Alone:
    """What prediction and camera say of the tip, each alone.

    The prediction is that of the estimator, without a wrench that of a free arm; the camera's is
    the measured centerline, led on from the last target by its heading and curvature.
    """

    def __init__(self, arm: Arm) -> None:
        sensors = EstimatorSettings(wrench_required=False)
        self.estimator, self.state = Estimator(arm=arm, settings=sensors), EstimatorState()
        self.smoother, self.length = smoother_for(arm), arm.reach

    def missed(self, events: list, tip: Array) -> tuple[float, float]:
        """Return by how much (m) both miss the true tip (2,) m, NaN where they say nothing."""
        predicted = camera = math.nan
        for event in events:
            if isinstance(event, TargetSightings):
                camera = distance(self.seen_tip(event), tip)
                continue
            self.state, estimate = self.estimator.step(self.state, event)
            if isinstance(estimate, ShapeEstimate):
                predicted = distance(estimate.shape.tip[:2], tip)
        return predicted, camera

    def seen_tip(self, sightings: TargetSightings) -> Sequence[float]:
        """Return the tip (2,) m by the camera alone."""
        curve = self.smoother.smooth(sightings)
        if curve is None:
            return math.nan, math.nan
        left = self.length - float(curve.arclength[-1])
        heading = float(curve.theta[-1] + 0.5 * left * curve.curvature[-1])
        x, y = float(curve.x[-1]), float(curve.y[-1])
        return x + left * math.cos(heading), y + left * math.sin(heading)


def distance(place: Sequence[float], other: Array) -> float:
    """Return how far (m) two places are apart."""
    return float(np.hypot(*(np.array(place) - other)))


def first_force(
    state: FusionState, unknowns: Unknowns, fused: FusedEstimate, truth: LabTruth, instant: int
) -> list[float]:
    """Return whether the belief of F1 is off by more than half of it, and whether F1 is NaN."""
    true = float(truth.force[instant, 0])
    if state.belief is None or abs(true) < LIGHT:
        return [math.nan, math.nan]
    off = abs(float(state.belief.mean[unknowns.at(TipForce).start]) - true)
    return [float(off > 0.5 * abs(true)), float(math.isnan(fused.force[0]))]


def row_of(fused: FusedEstimate, tip: Array, force: Array, pressure: float) -> list[float]:
    """Return the first of COLUMNS: an estimate beside the true tip (2,) m and force (2,) N."""
    missed = tip - np.array(fused.estimate.shape.tip[:2])
    covariance = fused.estimate.tip_covariance[:2, :2]
    off, force_nees, components = force_error(fused, force)
    share = sigma = math.nan
    size = float(np.hypot(*force))
    if components == 2 and size > LIGHT:
        share = off / size
        sigma = math.sqrt(float(np.trace(fused.force_covariance))) / size
    return [
        float(np.hypot(*missed)),
        float(missed @ np.linalg.solve(covariance, missed)),
        share,
        sigma,
        force_nees,
        float(components),
        float(pressure > PRESSED and size > LIGHT),
        float(fused.ambiguous),
        math.nan if fused.target_age is None else fused.target_age,
    ]


def long_run(seed: int, name: str) -> Array:
    """Fuse half an hour of a rig in one way: (PARTS, instants, COLUMNS)."""
    way = WAYS[name]
    recording = recording_of(seed, 0, way, duration=LONG, rate=LONG_RATE)
    rows = fuse(Fusion(arm=model_of(seed)), recording, way, 100 * seed)
    return rows[: len(rows) // PARTS * PARTS].reshape(PARTS, -1, len(COLUMNS))


def true_arm(seed: int) -> Arm:
    """Return the arm of a rig as it is, with the places where its targets are painted."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    scenario = dataclasses.replace(scenario, arm=vary_arm(scenario.arm, seed))
    arm, painted = true_model(scenario), recording_of(seed, 0).truth.placement.T.ravel()
    known = ModelCovariance(
        quantities=('moment_law.rigidity.0.0',),
        factor=np.full((1, 1), EXACT),
        placement=PlacementKnown(
            mean=painted, std=np.full(painted.size, EXACT), factor=np.zeros((painted.size, 1))
        ),
    )
    return dataclasses.replace(arm, covariance=known)


def try_model(seed: int, recordings: int) -> dict[str, Array]:
    """Fuse recordings of a rig by a model of it."""
    return try_arm(model_of(seed), seed, recordings)


def try_truth(seed: int, recordings: int) -> dict[str, Array]:
    """Fuse recordings of a rig by the arm as it is."""
    return try_arm(true_arm(seed), seed, recordings)


def try_arm(arm: Arm, seed: int, recordings: int) -> dict[str, Array]:
    """Fuse recordings of a rig by an arm."""
    fusion = Fusion(arm=arm)
    rows: dict[str, list[Array]] = {name: [] for name in WAYS}
    for which in range(recordings):
        recordings_of: dict[tuple, LabRecording] = {}
        for name, way in WAYS.items():
            kind = way.lacking, way.top, way.aside, way.painted_anew
            if kind not in recordings_of:
                recordings_of[kind] = recording_of(seed, which, way)
            rows[name].append(fuse(fusion, recordings_of[kind], way, 100 * seed + which))
    return {name: np.array(found) for name, found in rows.items()}


def summary_of(rigs: list[dict[str, Array]]) -> dict:
    """Return what each way came to, and which goals are missed."""
    ways = {way: numbers_of(np.concatenate([rig[way] for rig in rigs])) for way in WAYS}
    return {'ways': ways, 'missed': missed_goals(ways, GOALS)}


def part_numbers(rows: Array) -> dict:
    """Return the numbers of each part of a long recording."""
    minutes = LONG / PARTS / 60.0
    return {
        f'{place * minutes:g} to {(place + 1) * minutes:g} min': numbers_of(part[None])
        for place, part in enumerate(rows)
    }


def numbers_of(rows: Array) -> dict:
    """Return the numbers of one way: rows (recordings, instants, COLUMNS)."""
    frames, between = rows[:, ::2], rows[:, 1::2]
    due = np.isfinite(rows[..., COLUMNS.index('mode')])
    column = {name: frames[..., place] for place, name in enumerate(COLUMNS)}
    tip_nees, force_nees = column['tip_nees'], column['force_nees']
    sure = column['sigma'] < SURE
    pressed = (column['pressed'] > 0.0) & np.isfinite(column['share'])
    later = between[..., COLUMNS.index('tip')], between[..., COLUMNS.index('tip_nees')]
    withheld = rows[..., COLUMNS.index('withheld')][rows[..., COLUMNS.index('astray')] > 0.0]
    both = rows[..., [COLUMNS.index('tip_nees'), COLUMNS.index('force_nees')]]
    late = rows[rows[..., COLUMNS.index('age')] > FUSION.target_timeout]
    return {
        'estimates': float(np.isfinite(rows[due][:, COLUMNS.index('tip')]).mean()),
        'ambiguous': float(np.nanmean(column['ambiguous'])),
        'determined': float(np.isfinite(force_nees).mean()),
        'both': float((column['components'] == 2.0).mean()),
        'sure': float(sure.mean()),
        'sure_rms': rms(column['share'][sure]),
        'median': float(np.median(column['share'][pressed])) if pressed.any() else math.nan,
        'force_covered': covered(force_nees),
        'worst_force': worst(force_nees),
        'without_force': int((~known(force_nees)).all(axis=1).sum()),
        'force_nees': float(np.nanmean(force_nees)),
        'tip_rms': rms(column['tip'][known(column['tip'])]),
        'tip_covered': covered(tip_nees),
        'worst_tip': worst(tip_nees),
        'tip_nees': float(np.nanmean(tip_nees)),
        'largest_tip_nees': float(np.nanmax(tip_nees)),
        'worst_of_better': worst_of_better(frames),
        'between_tip_median': float(np.nanmedian(later[0])),
        'between_tip_covered': covered(later[1]),
        'withheld': float(np.mean(withheld)) if withheld.size else 1.0,
        'mode_right': float(np.nanmean(rows[..., COLUMNS.index('mode')])),
        'beyond_4_sigma': float(np.mean(both[known(both)] > BEYOND)),
        'predicted': len(late),
        'predicted_tip_rms': rms(late[:, 0]),
        'predicted_tip_covered': covered(late[:, COLUMNS.index('tip_nees')]),
    }


def worst_of_better(frames: Array) -> float:
    """Return the tip error as a share of that of the better of prediction and camera alone.

    rms of a recording, the largest share of all of them.
    """
    errors = frames[..., [COLUMNS.index(n) for n in ('tip', 'predicted_alone', 'camera_alone')]]
    tip, *alone = np.sqrt(np.nanmean(errors**2, axis=1)).T
    return float(np.max(tip / np.fmin(*alone)))


def rms(values: Array) -> float:
    """Return the root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def covered(nees: Array) -> float:
    """Return the share of known ones within the 95 % ellipse."""
    found = nees[known(nees)]
    return float(np.mean(found <= IN_95)) if found.size else math.nan


def worst(nees: Array) -> float:
    """Return the least covered of recordings (recordings, instants) with anything known."""
    return float(np.fmin.reduce([covered(one) for one in nees]))


def known(values: Array) -> Array:
    """Return where there are values."""
    return np.isfinite(values)


def show(summary: dict, title: str) -> None:
    """Print for people."""
    table = Table(title=title)
    shown = (
        ('way', None, ''),
        ('estimates', 'estimates', '.3f'),
        ('force: rms where sigma < 5 %', 'sure_rms', '.2%'),
        ('median, p > 10 kPa', 'median', '.2%'),
        ('determined', 'determined', '.3f'),
        ('both components', 'both', '.3f'),
        ('covered', 'force_covered', '.3f'),
        ('worst recording', 'worst_force', '.3f'),
        ('recordings without any', 'without_force', '.0f'),
        ('NEES', 'force_nees', '.2f'),
        ('tip: rms mm', 'tip_rms', '.3f'),
        ('covered', 'tip_covered', '.3f'),
        ('worst recording', 'worst_tip', '.3f'),
        ('NEES', 'tip_nees', '.2f'),
        ('of the better of prediction and camera, worst', 'worst_of_better', '.2f'),
        ('ambiguous', 'ambiguous', '.3f'),
        ('F1 astray and withheld', 'withheld', '.3f'),
        ('right mode', 'mode_right', '.4f'),
        ('beyond 4 sigma', 'beyond_4_sigma', '.5f'),
        ('between: tip median mm', 'between_tip_median', '.3f'),
        ('covered', 'between_tip_covered', '.3f'),
        ('predicted', 'predicted', '.0f'),
        ('tip: rms mm', 'predicted_tip_rms', '.3f'),
        ('covered', 'predicted_tip_covered', '.3f'),
    )
    for heading, _, _ in shown:
        table.add_column(heading)
    for way, numbers in summary['ways'].items():
        cells = [way]
        for _, name, form in shown[1:]:
            value = numbers[name] * (1e3 if name.endswith(('tip_rms', 'tip_median')) else 1.0)
            cells.append(format(value, form))
        table.add_row(*cells)
    console = Console(width=250)
    console.print(table)
    if 'missed' in summary:
        console.print('\n'.join(summary['missed'] or ['all goals reached']))


def main() -> int:
    """Run and print."""
    command = rig_command(__doc__.splitlines()[0], recordings=20)
    either = command.add_mutually_exclusive_group()
    either.add_argument(
        '--true-arm', action='store_true', help='use the true arm instead of a calibrated model'
    )
    either.add_argument('--long', choices=list(WAYS), help='half an hour in one way, by parts')
    arguments = command.parse_args()
    if arguments.long:
        rows = long_run(arguments.first, arguments.long)
        show({'ways': part_numbers(rows)}, f'Half an hour: {arguments.long}')
        return 0
    if arguments.true_arm:
        return run_bench('fusion_true', arguments, try_truth, summary_of, show)
    return run_bench('fusion', arguments, try_model, summary_of, show)


if __name__ == '__main__':
    sys.exit(main())
