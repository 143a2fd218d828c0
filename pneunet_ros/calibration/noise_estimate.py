"""Sensor noise estimated from the recordings themselves, without model residuals.

White noise is estimated from second differences in time, which cancel smooth motion; position and
drift of the camera from the target at the clamp, which does not move with the arm; placement of
the targets from their distance to a smooth curve while the arm is straightest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from statistics import NormalDist

import numpy as np
from pneunet_ros.calibration.settings import NOISE_ESTIMATE
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import match_stamps
from pneunet_ros.measurement.dataset import RecordingData, SIGMA_OF_MEDIAN
from pneunet_ros.measurement.errors.rounding_error import rounding_std
from pneunet_ros.measurement.row_order import AT_CLAMP
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import END_LOAD_MOMENT

MEDIAN_OF_TWO = math.log(2.0)  # median of half the sum of two squared normal variables
NORMAL = NormalDist()
QUARTILE = NORMAL.inv_cdf(0.625)  # lower quartile of the size of a normal variable, over its std
CLIPPED = 3.0  # a difference beyond this many sigma is a change; convention
# Share of the variance of normal variables within that.
LEFT_OF_VARIANCE = 1.0 - 2.0 * CLIPPED * NORMAL.pdf(CLIPPED) / (2.0 * NORMAL.cdf(CLIPPED) - 1.0)
MOST_CLIPPINGS = 30  # usually five suffice
RESTS = 3.0  # sigma of a pressure reading; a smaller change between frames means rest
REPEATED = (
    'successive positions and headings differ by less, as in a lossy film or with a tracker that '
    'repeats resting targets'
)
ASSUMED = 'assumed; these recordings do not determine it'
# Sensor noise stated in an arm file, and its unit.
STATED = (('pressure_std', 'Pa'), ('force_std', 'N'), ('moment_std', 'N m'), ('target_std', 'm'))
# Readings whose steps (resolution) may be coarser than their noise, and their unit.
STEPPED = (('pressure', 'Pa'), ('force', 'N'), ('moment', 'N m'))
SMALLEST = 1e-9  # smallest estimated standard deviation
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
# Smallest noise of targets (arm lengths): a lossy video repeats targets at rest, without noise.
# Measured: 5e-6 for a video with 4e-5; rounded up.
LEAST_TARGET = 1e-4
FEWEST_TARGETS = 8  # for a placement
FREEDOM = 3  # targets in excess of the coefficients of the polynomial, at least
FEWEST_LEVELS = 12  # of readings with visible steps
CORRELATED = 0.3  # correlation of neighbors at rest from which their noise counts as common
REPEATS = 0.2  # share of readings in steps that repeat the last one
OFF_GRID = 0.1  # of a step: decimals are rounded
ON_GRID = 0.9  # share of the levels


# Standard deviation by its name in `SensorNoise`, None if undetermined, and its source.
Found = dict[str, tuple[float | None, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseEstimate:
    """The estimated noise, with the source of each standard deviation.

    notes: sentences on unusual noise.
    """

    noise: SensorNoise
    sources: Mapping[str, str]
    notes: tuple[Note, ...] = ()


def estimate_noise(
    runs: Sequence[RecordingData], arclength: Array, assumed: SensorNoise
) -> NoiseEstimate:
    """Estimate all standard deviations; undetermined ones keep the `assumed` value.

    arclength (targets,) m of the targets. Runs of a few frames and static runs are not used,
    because they show no motion in time. A load of exactly zero is not a reading. Target and camera
    positions are never treated as exact, even if `assumed` is zero.
    """
    assumed = with_uncertain_positions(assumed, arclength)
    headings = [run.heading for run in runs if run.heading is not None]
    if headings and assumed.heading_std == 0.0:
        assumed = replace(assumed, heading_std=NOISE_ESTIMATE.heading)
    runs = [run for run in runs if carries_time(run)]
    readings = readings_of(runs)
    found: Found = {
        f'{name}_std': (
            second_differences(resting_series(series)),
            f'second differences of {name} readings in time',
        )
        for name, series in readings.items()
    }
    white, source = noise_of_targets(runs, arclength, assumed.target_std)
    found['target_std'] = None if source == ASSUMED else white, source
    heading = found['heading_std'][0]
    if heading is not None and heading < LEAST_TARGET:
        words = f'{LEAST_TARGET:g} rad, as for two targets one length apart'
        found['heading_std'] = LEAST_TARGET, f'{words}: {REPEATED}'
    # Differences of a fast pressure show its changes, not its noise: it is never constant.
    pressure_std = min(found['pressure_std'][0] or np.inf, assumed.pressure_std)
    # One sensor reads both components of a force.
    forces = [load[:, :END_LOAD_MOMENT].T.ravel() for load in loads_of(runs)]
    notes = include_steps(found, readings | {'force': forces}, assumed)
    notes += include_correlation(found, *correlation_at_rest(runs, pressure_std))
    found['placement_std'] = (
        placement(runs, arclength, white, assumed.placement_std),
        'distance of targets from a smooth curve while the arm is straightest',
    )
    registration, drift = camera_stds(runs, arclength, white)
    found['registration_std'] = (
        registration,
        'motion of the target at the clamp, between recordings',
    )
    found['drift_std'] = drift, 'motion of the target at the clamp, within recordings'
    if not headings:
        del found['heading_std']
    sources = {name: ASSUMED if std is None else why for name, (std, why) in found.items()}
    estimated = {
        name: float(f'{max(std, SMALLEST):.3g}')
        for name, (std, _) in found.items()
        if std is not None
    }
    noise = replace(assumed, **estimated)
    notes += differing_noise(noise, assumed, sources)
    return NoiseEstimate(noise=noise, sources=sources, notes=tuple(notes))


def include_steps(
    found: Found, readings: Mapping[str, Sequence[Array]], assumed: SensorNoise
) -> list[Note]:
    """Add the quantization of readings in coarse steps to the estimate, with a note."""
    notes = []
    for name, unit in STEPPED:
        step, key = resolution_of(readings[name]), f'{name}_std'
        coarse, sentence = with_step(found[key][0], getattr(assumed, key), step, unit)
        if not sentence:
            continue
        found[key] = coarse, sentence
        notes.append(
            Note(
                f'the {name} is read in steps of {step:.3g} {unit}, coarser than its noise: its '
                f'variance includes step^2/12, and {key} is {coarse:.3g} {unit}. A constant '
                f'{name} has the same error in all frames; a finer sensor or converter would '
                'give more information',
                reason='coarse_steps',
            )
        )
    return notes


def include_correlation(found: Found, alike: float, correlation: float) -> list[Note]:
    """Inflate the noise of targets for their correlation at rest, with a note.

    alike: number of neighboring targets with a common error.
    """
    white, source = found['target_std']
    if not alike > 1.0 or white is None:
        return []
    factor = math.sqrt(alike)
    found['target_std'] = (
        factor * white,
        f'{source}, times {factor:.2g}: neighboring targets are correlated',
    )
    return [
        Note(
            'while the arm rests, the errors of neighboring targets are correlated '
            f'({correlation:.2f}), as with hot air, a curved window or lossy video. The noise '
            f'of each target is set to {factor:.2g} times the measured noise',
            reason='alike_neighbors',
        )
    ]


def carries_time(run: RecordingData) -> bool:
    """Whether a recording is a time series long enough to show noise or memory."""
    return not run.static and len(run.stamp_ns) >= NOISE_ESTIMATE.fewest


def readings_of(runs: Sequence[RecordingData]) -> dict[str, list[Array]]:
    """Return the series of readings (values,) of every sensor in some recordings.

    A load component that is always zero was not measured.
    """
    components = [column for load in loads_of(runs) for column in enumerate(load.T)]
    measured = [(index, values) for index, values in components if np.any(values)]
    headings = [run.heading for run in runs if run.heading is not None]
    return {
        'pressure': [run.pressure for run in runs],
        'force': [values for index, values in measured if index < END_LOAD_MOMENT],
        'moment': [values for index, values in measured if index == END_LOAD_MOMENT],
        'heading': [np.unwrap(values[np.isfinite(values)]) for values in headings],
    }


def with_noise_of_readings(stated: SensorNoise, runs: Sequence[RecordingData]) -> SensorNoise:
    """Return the noise with pressure and load increased to the scatter of the readings."""
    larger = {}
    for name, series in readings_of([run for run in runs if carries_time(run)]).items():
        key = f'{name}_std'
        found = second_differences(resting_series(series))
        if name != 'heading' and found is not None and found > getattr(stated, key):
            larger[key] = found
    return replace(stated, **larger)


def with_uncertain_positions(assumed: SensorNoise, arclength: Array) -> SensorNoise:
    """Return the noise with uncertain positions of targets and camera.

    Many arm files state 0, with which the stiffness would be wrong by many standard errors.
    """
    length = float(arclength[-1]) if arclength.size else 0.0
    return replace(
        assumed,
        placement_std=assumed.placement_std or NOISE_ESTIMATE.placement * length,
        registration_std=assumed.registration_std or NOISE_ESTIMATE.registration * length,
        drift_std=assumed.drift_std or NOISE_ESTIMATE.placement * length,
    )


def differing_noise(
    noise: SensorNoise, assumed: SensorNoise, sources: Mapping[str, str]
) -> list[Note]:
    """Describe where the estimated noise differs from the assumed noise, and which one is used."""
    differing = []
    for name, unit in STATED:
        found, stated = getattr(noise, name), getattr(assumed, name)
        if sources.get(name, ASSUMED) == ASSUMED or stated <= 0.0:
            continue
        if not 1.0 / NOISE_ESTIMATE.differs < found / stated < NOISE_ESTIMATE.differs:
            differing.append(f'{name} {found:.3g} {unit} instead of {stated:.3g} {unit}')
    if not differing:
        return []
    return [
        Note(
            'the noise of these recordings differs from that in the arm file: '
            f'{"; ".join(differing)}. The measured values were used and are written to the model',
            reason='other_noise',
        )
    ]


def resolution_of(series: Sequence[Array]) -> float:
    """Return the resolution of a sensor from its readings (values,); 0 if they are not on a grid.

    Readings of a sensor coarser than its noise are often equal, and differ by whole steps.
    """
    steps = [step for values in series if (step := grid_step(values)) > 0.0]
    return float(np.median(steps)) if 2 * len(steps) > len(series) else 0.0


def grid_step(values: Array) -> float:
    """Return the grid spacing of values (values,); 0 if there is none."""
    levels = np.unique(values)
    if levels.size < FEWEST_LEVELS or not np.any(values[1:] == values[:-1]):
        return 0.0
    if float(np.mean(values[1:] == values[:-1])) < REPEATS:
        return 0.0
    gaps = np.diff(levels)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    on_grid = np.abs(gaps / step - np.round(gaps / step)) < OFF_GRID
    return step if np.mean(on_grid) >= ON_GRID else 0.0


def with_step(
    white: float | None, assumed: float, step: float, unit: str
) -> tuple[float | None, str]:
    """Return a standard deviation including quantization, and its source.

    white: noise of the readings, None if unknown; assumed: used in that case. Noise larger than a
    step already includes the quantization, so nothing is added and the sentence is empty.
    """
    noise = min(assumed, 0.5 * step) if white is None else white
    if step == 0.0 or noise >= step:
        return white, ''
    source = 'assumed noise below it' if white is None else 'second differences in time'
    total = math.hypot(noise, rounding_std(step))
    return total, f'steps of {step:.3g} {unit} in which it is read, and {source}'


def loads_of(runs: Sequence[RecordingData]) -> list[Array]:
    """Return the loads (n, 3) that were read in each loaded recording."""
    return [load_readings(run) for run in runs if run.loaded and not run.load_known]


def load_readings(run: RecordingData) -> Array:
    """Return F1, F2 (N) and M (N m) of all loaded frames, (n, 3).

    Of frames with the same reading, only the first is used, because repeated values carry no noise
    information.
    """
    load = np.column_stack([run.force, run.moment])
    if run.wrench_stamp_ns is not None:
        nearest, _ = match_stamps(run.stamp_ns, run.wrench_stamp_ns, 0.0)
        load = load[np.diff(nearest, prepend=-1) != 0]
    return load[np.any(load != 0.0, axis=1)]


def resting_series(series: Sequence[Array]) -> list[Array]:
    """Return the series that show noise, excluding slow ones, whose changes are motion."""
    stds = [second_differences([values]) or 0.0 for values in series]
    least = min((std for std in stds if std > 0.0), default=0.0)
    return [
        values
        for values, std in zip(series, stds, strict=True)
        if std <= NOISE_ESTIMATE.differs * least
    ]


def second_differences(series: Sequence[Array]) -> float | None:
    """Return the standard deviation of white noise on smooth series, each (values,) in time.

    None for too few values, or if most values lie exactly on straight lines (a set point, or a
    sensor coarser than its noise).
    """
    differences = np.concatenate([np.zeros(0), *(np.diff(values, 2) for values in series)])
    differences = differences[np.isfinite(differences)]
    if differences.size < NOISE_ESTIMATE.fewest:
        return None
    return clipped_std(differences) / math.sqrt(6.0) or None


def clipped_std(values: Array) -> float:
    """Return the standard deviation of white noise among values (n,), by three-sigma clipping.

    Up to three quarters of the values may be true changes: the iteration starts from the lower
    quartile, and takes the rms of the values within three sigma. 0 if most values are zero.
    """
    sizes = np.abs(values)
    std, low = SIGMA_OF_MEDIAN * float(np.median(sizes)), float(np.quantile(sizes, 0.25))
    if low > 0.0:
        std = min(std, low / QUARTILE)
    for _ in range(MOST_CLIPPINGS):
        inside = sizes[sizes <= CLIPPED * std]
        before, std = std, float(np.sqrt(np.mean(inside**2) / LEFT_OF_VARIANCE))
        if std == before:
            break
    return std


def noise_of_targets(
    runs: Sequence[RecordingData], arclength: Array, assumed: float
) -> tuple[float, str]:
    """Return the standard deviation (m) of white noise of targets with rounding, and its source.

    arclength (targets,) m; assumed (m): used if the recordings do not determine it. The noise is
    at least `LEAST_TARGET` times the length.
    """
    least = LEAST_TARGET * (float(arclength[-1]) if arclength.size else 0.0)
    white, source = target_noise(runs), 'second differences of target positions in time'
    if white is not None and white < least:
        white, source = least, f'{LEAST_TARGET:g} of the length: {REPEATED}'
    columns = [column for run in runs for values in (run.x, run.y) for column in values.T]
    step = resolution_of([column[np.isfinite(column)] for column in columns])
    coarse, sentence = with_step(white, assumed, step, 'm')
    if sentence:
        white, source = coarse, sentence
    return (max(assumed, least), ASSUMED) if white is None else (white, source)


def target_noise(runs: Sequence[RecordingData]) -> float | None:
    """Return the standard deviation of white noise of targets during smooth motion.

    White noise averages out over the targets of a frame, but a change of motion does not. Frames
    are selected by their mean, which is then subtracted, so that the selection does not bias the
    noise.
    """
    series = [values for run in runs for values in (run.x, run.y)]
    first = second_differences([column for values in series for column in values.T])
    if first is None:
        return None
    even = []
    for values in series:
        differences = np.diff(values, 2, axis=0)
        count = np.maximum(np.isfinite(differences).sum(axis=1), 1)
        common = np.nansum(differences, axis=1) / count
        steady = (np.abs(common) < NOISE_ESTIMATE.even * first * np.sqrt(6.0 / count)) & (
            count > 1
        )
        enlarged = np.sqrt(count / np.maximum(count - 1, 1))
        even.append(((differences - common[:, None]) * enlarged[:, None])[steady])
    residuals = np.concatenate([values[np.isfinite(values)] for values in even])
    if residuals.size < NOISE_ESTIMATE.fewest:
        return first
    return clipped_std(residuals) / math.sqrt(6.0)


def correlation_at_rest(runs: Sequence[RecordingData], pressure_std: float) -> tuple[float, float]:
    """Return the number of targets with a common error at rest, and the correlation of neighbors.

    The number is 1 if the errors are independent, or if the arm rests in too few frames (motion is
    correlated too). All frames have equal weight, so that a few frames with undetected motion do
    not matter. The common motion of all targets is attributed to the camera and subtracted.
    """
    rest = [resting_differences(run, pressure_std) for run in runs if not run.loaded]
    rest = [values for values in rest if values.shape[-1] >= NOISE_ESTIMATE.many_targets]
    if not rest or sum(len(values) for values in rest) < NOISE_ESTIMATE.fewest:
        return 1.0, 0.0
    errors = np.concatenate(rest)
    errors = errors - errors.mean(axis=1, keepdims=True)
    size = np.sqrt(np.mean(errors**2, axis=1, keepdims=True))
    errors = errors[size[:, 0] > 0.0] / size[size[:, 0] > 0.0]
    if not errors.size:
        return 1.0, 0.0
    lags = range(1, errors.shape[1] // 2)
    correlation = [float(np.mean(errors[:, k:] * errors[:, :-k])) for k in lags]
    if correlation[0] < CORRELATED:
        return 1.0, correlation[0]
    positive = itertools.takewhile(lambda value: value > 0.0, correlation)
    return 1.0 + 2.0 * sum(positive), correlation[0]


def resting_differences(run: RecordingData, pressure_std: float) -> Array:
    """Return second differences in time of targets (n, targets) m while the pressure rests.

    For x and y, over triples of successive frames in which all targets are seen.
    """
    change = np.abs(np.diff(run.frame_pressure)) < RESTS * pressure_std
    resting = change[1:] & change[:-1]
    differences = np.concatenate(
        [np.diff(values, 2, axis=0)[resting] for values in (run.x, run.y)]
    )
    return np.asarray(differences[np.isfinite(differences).all(axis=1)])


def placement(
    runs: Sequence[RecordingData], arclength: Array, white: float, assumed: float
) -> float | None:
    """Return the standard deviation of the painted positions, per coordinate (m).

    The variance beyond the white noise may be zero by chance: the result is at least its own
    standard error. Because a few targets may lie on a smooth curve by chance, the result for few
    targets is at least `assumed` (m). None if unknown.
    """
    free = [run.points for run in runs if not run.loaded]
    if not free:
        return None
    frames = np.concatenate(free)
    often = 2 * np.isfinite(frames[:, 0]).sum(axis=0) > len(frames)
    arclength, frames = arclength[often], frames[:, :, often]
    complete = frames[np.all(np.isfinite(frames), axis=(1, 2))]
    if arclength.size < FEWEST_TARGETS or len(complete) < NOISE_ESTIMATE.fewest:
        return None
    chord = np.hypot(*(complete[:, :, -1] - complete[:, :, 0]).T)
    count = NOISE_ESTIMATE.fewest
    mean = complete[np.argsort(-chord)[:count]].mean(axis=0)
    freedom = placement_freedom(arclength.size)
    degree = arclength.size - freedom // 2 - 1
    smooth = np.polynomial.chebyshev.chebvander(2.0 * arclength / arclength[-1] - 1.0, degree)
    coefficients, *_ = np.linalg.lstsq(smooth, mean.T, rcond=None)
    residual = mean.T - smooth @ coefficients
    variance = np.sum(residual**2) / freedom
    found = float(np.sqrt(max(variance - white**2 / count, variance * np.sqrt(2.0 / freedom))))
    return found if arclength.size >= NOISE_ESTIMATE.many_targets else max(found, assumed)


def placement_freedom(targets: int) -> int:
    """Return the number of values from which the placement of so many targets is estimated."""
    return 2 * max(targets - NOISE_ESTIMATE.smooth_degree - 1, FREEDOM)


def camera_stds(
    runs: Sequence[RecordingData], arclength: Array, white: float
) -> tuple[float | None, float | None]:
    """Return the scatter of the camera position between runs and its drift within a run (m).

    Both are estimated from few values, whose variance beyond the white noise may be zero by
    chance: the result is at least its own standard error.
    """
    if arclength.size == 0 or arclength[0] > AT_CLAMP * arclength[-1]:
        return None, None
    means_of_runs, squared_steps, white_squares = [], [], []
    for run in runs:
        positions = np.column_stack([run.x[:, 0], run.y[:, 0]])
        positions = positions[np.isfinite(positions[:, 0])]
        if len(positions) < NOISE_ESTIMATE.fewest:
            continue
        means_of_runs.append(positions.mean(axis=0))
        blocks = np.array_split(positions, NOISE_ESTIMATE.blocks)
        means = np.array([block.mean(axis=0) for block in blocks])
        squared_steps.append(np.diff(means, axis=0) ** 2)
        white_squares.append(2.0 * white**2 * NOISE_ESTIMATE.blocks / len(positions))
    if not squared_steps:
        return None, None
    # Means of neighboring blocks of a random walk differ by 2/3 of its variance over a block. The
    # median over the squares of both coordinates: a single slip of the base is not drift.
    steps = np.concatenate([item.sum(axis=1) for item in squared_steps])
    square = 0.5 * float(np.median(steps)) / MEDIAN_OF_TWO
    error = square / (MEDIAN_OF_TWO * math.sqrt(steps.size))
    drift = math.sqrt(
        max(square - float(np.mean(white_squares)), error) * 1.5 * NOISE_ESTIMATE.blocks
    )
    if len(means_of_runs) < 3:
        return None, drift
    # The mean over a run of a walk that starts at zero has a third of the variance of its end.
    spread = float(np.var(means_of_runs, axis=0, ddof=1).mean())
    error = spread / math.sqrt(len(means_of_runs) - 1)
    return math.sqrt(max(spread - drift**2 / 3.0, error)), drift
