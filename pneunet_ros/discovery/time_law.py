"""An amplitude that depends on time alone: periodic or aperiodic.

No measured quantity predicts the phase, so a left-out recording is expected to oscillate with the
common period but unknown phase: sine and cosine of every recording have a common prior. An
aperiodic amplitude is a Gaussian process over the time of every recording, with a common size and
correlation time (Ornstein-Uhlenbeck, which is rough enough for switching).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import itertools
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.discovery.amplitude import Evidence, log_gains, PerRunColumns, Runs
from pneunet_ros.discovery.covariates import CONSTANT, Covariate, ELAPSED
from pneunet_ros.discovery.settings import LAW, PERIOD_COST
import scipy

CORRELATION_TIMES = 6  # to try, from the shortest period to the longest
DIRECTIONS = 24  # principal components of an aperiodic amplitude in a recording
MODULATIONS = ('1', 'p')  # constant amplitude, or one that grows with the pressure
PERIODS = 160  # to try, evenly spaced in frequency


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swing:
    """An oscillation: its period (s) and error, the modulation of its amplitude, and its gain.

    periodic: if False, `period` is the correlation time, and size_std NaN. size and size_std: rms
    amplitude over the runs, in units of the kind's prior, at the largest modulation; factors
    (frames, n): columns of each run, such as sine and cosine.
    """

    period: float
    period_std: float
    modulation: str
    size: float
    size_std: float
    left_out_gain: float
    factors: Sequence[Array]
    std: float
    periodic: bool = True

    @property
    def form(self) -> str:
        """Its description in words."""
        if not self.periodic:
            return 'varies without a period'
        grows = '' if self.modulation == CONSTANT else ', times the pressure'
        return f'sine with a phase of its own in every recording{grows}'


def find_swing(
    frames: PerRunColumns, covariates: Mapping[str, Covariate], prior: float, runs: Runs
) -> Swing | None:
    """Return the most probable swing of an amplitude in some runs; None if there is none.

    prior: of the amplitude. A law in time needs several recordings.
    """
    if ELAPSED not in covariates or len(runs) < LAW.fewest_runs:
        return None
    seconds = covariates[ELAPSED].values
    frame_evidence = frames.evidence(runs)
    best: tuple[float, float, str, list[Array], float] | None = None
    periods = possible_periods(seconds)
    for modulation in [name for name in MODULATIONS if name in covariates and periods.size]:
        size_of = covariates[modulation].scaled
        sizes = [prior * np.abs(size_of(which)) for which in range(len(seconds))]
        swings = swing_evidence(frame_evidence, seconds, sizes, periods)
        gains = log_gains(swings.score, swings.information, LAW.prior_sizes)
        index, column = np.unravel_index(int(gains.argmax()), gains.shape)
        if best is None or gains.max() > best[0]:
            std = LAW.prior_sizes[column]
            best = float(gains.max()), float(periods[index]), modulation, sizes, std
    priors = prior * np.asarray(LAW.prior_sizes)
    free = log_gains(frame_evidence.score, frame_evidence.information, priors).max()
    # A periodic law must explain more than a separate amplitude in every frame.
    if best is None or best[0] < max(free, 0.0) + PERIOD_COST:
        return None
    _, period, modulation, sizes, std = best
    period, period_std = refine_period(frame_evidence, seconds, sizes, period, std, periods)
    factors = [wave[:, 0] for wave in waves_of(seconds, sizes, np.array([period]))]
    combined = frames.combined(factors)
    coefficients, covariance = combined.evidence(runs).estimate(std)
    run_columns = np.r_[tuple(combined.of_run[which] for which in runs)]
    size = float(np.sqrt(np.sum(coefficients[run_columns] ** 2) / len(runs)))
    slope = coefficients[run_columns] / (len(runs) * size)
    return Swing(
        period=period,
        period_std=period_std,
        modulation=modulation,
        size=size,
        size_std=float(np.sqrt(slope @ covariance[np.ix_(run_columns, run_columns)] @ slope)),
        left_out_gain=combined.left_out_gain(runs, std) - PERIOD_COST,
        factors=factors,
        std=std,
    )


Courses = Mapping[float, Sequence[Array]]  # per correlation time (s): a root (frames, n) per run


def aperiodic_courses(seconds: Sequence[Array]) -> Courses:
    """Return courses without a period; seconds (frames,) of every run."""
    periods = possible_periods(seconds)
    if not periods.size:
        return {}
    times = np.geomspace(float(periods[0]), float(periods[-1]), CORRELATION_TIMES).tolist()
    return {time: aperiodic_roots(seconds, time) for time in times}


def find_aperiodic(
    frames: PerRunColumns, courses: Courses, prior: float, runs: Runs
) -> Swing | None:
    """Return an aperiodic amplitude; None if there is no evidence for one.

    prior: of the amplitude.
    """
    if not courses or len(runs) < LAW.fewest_runs:
        return None
    priors = prior * np.asarray(LAW.prior_sizes)
    combined = {time: frames.combined(roots) for time, roots in courses.items()}
    evidence = {time: item.evidence(runs) for time, item in combined.items()}
    gains = {
        time: log_gains(item.score, item.information, priors) for time, item in evidence.items()
    }
    time = max(gains, key=lambda item: float(gains[item].max()))
    gain, index = float(gains[time].max()), int(gains[time].argmax())
    if gain <= 0.0:
        return None
    std, roots = LAW.prior_sizes[index], courses[time]
    coefficients = evidence[time].estimate(prior * std)[0]
    of_run = combined[time].of_run
    course = np.concatenate([roots[which] @ coefficients[of_run[which]] for which in runs])
    return Swing(
        period=time,
        period_std=0.5 * time,
        modulation=CONSTANT,
        size=float(np.sqrt(np.mean(course**2))) / prior,
        size_std=math.nan,
        left_out_gain=combined[time].left_out_gain(runs, prior * std) - LAW.least_gain,
        factors=[prior * root for root in roots],
        std=std,
        periodic=False,
    )


def aperiodic_roots(seconds: Sequence[Array], time: float) -> list[Array]:
    """Return a root (frames, n) of the covariance exp(-|t - t'| / time) for every run.

    All runs have equally many columns: the directions of largest variance.
    """
    count = min(DIRECTIONS, *(item.size for item in seconds))
    roots = []
    for item in seconds:
        covariance = np.exp(-np.abs(item[:, None] - item[None]) / time)
        variances, axes = scipy.linalg.eigh(
            covariance, subset_by_index=(item.size - count, item.size - 1)
        )
        roots.append((axes * np.sqrt(np.maximum(variances, 0.0)))[:, ::-1])
    return roots


def possible_periods(seconds: Sequence[Array]) -> Array:
    """Return candidate periods (s): above two frames, up to a few per longest recording."""
    steps = np.concatenate([np.diff(item) for item in seconds if item.size > 1])
    steps = steps[steps > 0.0]
    longest = max(float(np.ptp(item)) for item in seconds)
    if not steps.size or longest <= 0.0:
        return np.zeros(0)
    shortest = 2.2 * float(np.median(steps))
    if LAW.fewest_cycles * shortest >= longest:
        return np.zeros(0)
    frequencies = np.linspace(LAW.fewest_cycles / longest, 1.0 / shortest, PERIODS)
    return np.asarray(1.0 / frequencies)


def waves_of(seconds: Sequence[Array], sizes: Sequence[Array], periods: Array) -> list[Array]:
    """Return sine and cosine times sizes (frames,) per run, (frames, periods, 2)."""
    waves = []
    for time, size in zip(seconds, sizes, strict=True):
        angle = 2.0 * np.pi * time[:, None] / periods
        waves.append(size[:, None, None] * np.stack([np.sin(angle), np.cos(angle)], axis=2))
    return waves


def swing_evidence(
    frame_evidence: Evidence, seconds: Sequence[Array], sizes: Sequence[Array], periods: Array
) -> Evidence:
    """Return the evidence for waves of every run at many periods, (periods, 2 runs), etc."""
    ends = np.cumsum([0, *(item.size for item in seconds)])
    run_frames = [slice(*pair) for pair in itertools.pairwise(ends.tolist())]
    waves = waves_of(seconds, sizes, periods)
    columns, runs = 2 * len(waves), range(len(waves))
    score = np.empty((periods.size, columns))
    information = np.empty((periods.size, columns, columns))
    for which in runs:
        columns_of_run = slice(2 * which, 2 * which + 2)
        wave = waves[which]
        score[:, columns_of_run] = np.einsum(
            'fpi,f->pi', wave, frame_evidence.score[run_frames[which]]
        )
        with_all = frame_evidence.information[:, run_frames[which]] @ wave.reshape(len(wave), -1)
        with_all = with_all.reshape(-1, *wave.shape[1:])
        for other in runs:
            rows = slice(2 * other, 2 * other + 2)
            information[:, rows, columns_of_run] = np.einsum(
                'fpi,fpj->pij', waves[other], with_all[run_frames[other]]
            )
    return Evidence(score=score, information=information)


def refine_period(
    frame_evidence: Evidence,
    seconds: Sequence[Array],
    sizes: Sequence[Array],
    period: float,
    std: float,
    periods: Array,
) -> tuple[float, float]:
    """Return the most probable period (s) near one, and its standard error."""
    spacing = abs(1.0 / periods[1] - 1.0 / periods[0])
    frequencies = 1.0 / period + spacing * np.linspace(-1.0, 1.0, 41)
    swings = swing_evidence(frame_evidence, seconds, sizes, 1.0 / frequencies)
    gains = log_gains(swings.score, swings.information, [std])[:, 0]
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    mean = float(weights @ frequencies)
    spread = float(np.sqrt(weights @ (frequencies - mean) ** 2))
    spread = max(spread, 0.025 * spacing)
    return 1.0 / mean, spread / mean**2
