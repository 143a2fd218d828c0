"""The paper's two experiments: recordings without and with end load -> a model with error bars.

Experiment 1 gives kappa_p0(p, s) from unloaded recordings alone; experiment 2 the moment law from
loaded ones. The last fit takes all recordings together, through the equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.arm import Arm
from pneunet_ros.calibration.fit import Fit, fit
from pneunet_ros.calibration.held_out import Score, score
from pneunet_ros.calibration.law_unknowns import LAW_UNKNOWNS, LawUnknowns
from pneunet_ros.calibration.low_rank import low_rank
from pneunet_ros.calibration.noise_estimate import estimated_noise, NoiseEstimate
from pneunet_ros.calibration.plausible import check_runs
from pneunet_ros.calibration.prior_smoothness import likeliest_smoothness
from pneunet_ros.calibration.unknowns import Smoothness, Unknowns
from pneunet_ros.errors import RequestError
from pneunet_ros.moment_law import PiecewiseLinearLaw
from pneunet_ros.run import Run
from pneunet_ros.shape import Array

KNOTS = 11  # of kappa_p0 along the arm
ROW_DISTANCE = 8000.0  # Pa between rows of kappa_p0, about
MOST_ROWS, FEWEST_ROWS = 10, 2
FIRST_FRAMES = 40  # of every run, for the search before the fit to all frames
COMPARED_FRAMES = 60  # of every run, where moment laws are compared
FIRST_STIFFNESS_SHARE = 0.05  # alpha, where the search for the stiffness begins

Progress = Callable[[str, int, int], None]  # stage, how far, of how much


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawScore:
    """A moment law on recordings that were left out of its fit, one score per loaded recording."""

    kind: str
    scores: tuple[Score, ...]

    @property
    def rms(self) -> float:
        """Root mean square over the recordings (m)."""
        return float(np.sqrt(np.mean([item.rms**2 for item in self.scores])))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """What came out: the arm, the fits behind it, the noise, and how the moment laws compare.

    free is the fit of experiment 1; joint that of all recordings (the same where there is no
    loaded one). captured is the share of the shape's variance that the model file's covariance of
    few columns has. notes are sentences on what the data could not determine.
    """

    arm: Arm
    noise: NoiseEstimate
    smoothness: Smoothness
    free: Fit
    joint: Fit
    laws: tuple[LawScore, ...]
    captured: float
    notes: tuple[str, ...]


def calibrate(
    unloaded: Sequence[Run],
    loaded: Sequence[Run],
    frame: Arm,
    *,
    kind: str = PiecewiseLinearLaw.kind,
    compare: bool = True,
    each: Progress = lambda stage, done, total: None,
) -> Calibration:
    """Calibrate; `frame` gives length, weight, clamp, targets, effects and what cannot be found.

    kind: the moment law to fit. compare: fit the other laws too, each time without one of the
    loaded recordings. Raises RequestError and RecordingError where the recordings do not fit the
    experiments.
    """
    if kind not in LAW_UNKNOWNS:
        raise RequestError(f'the moment law must be one of {", ".join(LAW_UNKNOWNS)}, not {kind}')
    check_runs(unloaded, loaded, frame)
    runs = [*unloaded, *loaded]
    noise = estimated_noise(runs, frame.target_arclength, frame.sensors)
    frame = replace(frame, sensors=noise.noise, covariance=None)
    low, high = pressure_span(runs)
    stage = Stages(frame, noise, low, high, each)
    free, smoothness = stage.first_experiment(unloaded)
    joint = free
    laws: tuple[LawScore, ...] = ()
    if loaded:
        law = stage.law(kind, stage.stiffness(unloaded, loaded, free, smoothness))
        joint = stage.joint(unloaded, loaded, free, smoothness, law)
        if compare and len(loaded) > 1:
            laws = stage.compared(unloaded, loaded, free, smoothness, law)
    covariance, captured = low_rank(joint)
    arm = replace(joint.arm, covariance=covariance)
    return Calibration(
        arm=arm,
        noise=noise,
        smoothness=smoothness,
        free=free,
        joint=joint,
        laws=laws,
        captured=captured,
        notes=tuple(undetermined(joint)),
    )


def pressure_span(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the lowest and highest pressure (Pa) at a frame, rounded to what a sensor tells."""
    pressures = np.concatenate([run.frame_pressure for run in runs])
    low, high = np.quantile(pressures, [0.002, 0.998])
    return float(np.floor(low / 100.0) * 100.0), float(np.ceil(high / 100.0) * 100.0)


class Stages:
    """The fits one after the other, each starting where the one before has ended."""

    def __init__(
        self, frame: Arm, noise: NoiseEstimate, low: float, high: float, each: Progress
    ) -> None:
        self.frame, self.noise, self.low, self.high, self.each = frame, noise, low, high, each
        count = round((high - low) / ROW_DISTANCE) + 1
        self.rows = np.linspace(low, high, min(max(count, FEWEST_ROWS), MOST_ROWS))

    def unknowns(self, smoothness: Smoothness, law: LawUnknowns | None) -> Unknowns:
        """Return the unknowns of a fit."""
        return Unknowns(
            frame=self.frame,
            pressure=self.rows,
            arclength=np.linspace(0.0, 1.0, KNOTS),
            smoothness=smoothness,
            law=law,
        )

    def law(self, kind: str, stiffness: float) -> LawUnknowns:
        """Return the unknowns of a moment law around a stiffness (N m^2)."""
        return LAW_UNKNOWNS[kind](
            stiffness=stiffness,
            low=self.low,
            high=self.high,
            length=self.frame.length,
            weight=self.frame.weight,
        )

    def fitted(
        self,
        stage: str,
        unknowns: Unknowns,
        runs: Sequence[Run],
        start: Array | None,
        most: int | None = None,
    ) -> Fit:
        """Fit, and say how far it is; most: so many frames of every run."""
        chosen = [run if most is None else run.thinned(most) for run in runs]
        return fit(
            unknowns,
            chosen,
            self.noise.noise,
            self.frame.target_arclength,
            start,
            each=lambda step, cost: self.each(stage, step, 0),
        )

    def first_experiment(self, unloaded: Sequence[Run]) -> tuple[Fit, Smoothness]:
        """Fit kappa_p0 to the unloaded recordings, as smooth as the data say."""
        wide = Smoothness(
            amplitude=5.0 / self.frame.length, deviation=0.5 / self.frame.length, reach=0.18
        )
        first = self.fitted(
            'kappa_p0, search', self.unknowns(wide, None), unloaded, None, FIRST_FRAMES
        )
        smoothness, _ = likeliest_smoothness(first)
        unknowns = self.unknowns(smoothness, None)
        return self.fitted('kappa_p0', unknowns, unloaded, first.values), smoothness

    def stiffness(
        self, unloaded: Sequence[Run], loaded: Sequence[Run], free: Fit, smoothness: Smoothness
    ) -> float:
        """Return the one stiffness EI (N m^2) that explains the loads best, to begin with."""
        guess = FIRST_STIFFNESS_SHARE * self.frame.weight * self.frame.length**2
        law = self.law('linear', guess)
        start = np.concatenate([free.values, law.mean])
        runs = [*unloaded, *loaded]
        unknowns = self.unknowns(smoothness, law)
        return float(self.fitted('stiffness', unknowns, runs, start, FIRST_FRAMES).values[-1])

    def joint(
        self,
        unloaded: Sequence[Run],
        loaded: Sequence[Run],
        free: Fit,
        smoothness: Smoothness,
        law: LawUnknowns,
        most: int | None = None,
    ) -> Fit:
        """Fit kappa_p0 and the moment law to all recordings."""
        runs, unknowns = [*unloaded, *loaded], self.unknowns(smoothness, law)
        start = np.concatenate([free.values, law.mean])
        if most is None:
            first = self.fitted('moment law, search', unknowns, runs, start, FIRST_FRAMES)
            start = first.values
        return self.fitted('moment law', unknowns, runs, start, most)

    def compared(
        self,
        unloaded: Sequence[Run],
        loaded: Sequence[Run],
        free: Fit,
        smoothness: Smoothness,
        law: LawUnknowns,
    ) -> tuple[LawScore, ...]:
        """Fit every moment law without each loaded recording in turn, and score it on that one."""
        stiffness = law.stiffness
        results = []
        for kind in LAW_UNKNOWNS:
            scores = []
            for which, left_out in enumerate(loaded):
                others = [*loaded[:which], *loaded[which + 1 :]]
                trial = self.law(kind, stiffness)
                fitted = self.joint(unloaded, others, free, smoothness, trial, COMPARED_FRAMES)
                scores.append(score(fitted.arm, left_out))
            results.append(LawScore(kind=kind, scores=tuple(scores)))
        return tuple(results)


WELL_KNOWN = 0.5  # of the standard deviation before the recordings: more was not determined
CONFOUNDED = 0.95  # correlation


def undetermined(fit: Fit) -> list[str]:
    """Return sentences on quantities that stayed at their prior and on pairs that go together."""
    notes = []
    names, change = fit.unknowns.quantities()
    after = change @ fit.covariance @ change.T
    before = change @ fit.unknowns.prior @ change.T
    std = np.sqrt(np.diag(after))
    kept = [
        name
        for name, now, then in zip(names, std, np.sqrt(np.diag(before)), strict=True)
        if now > WELL_KNOWN * then
    ]
    if kept:
        notes.append(
            f'{len(kept)} of {len(names)} quantities are hardly determined by these recordings '
            f'and stay near their prior, with its width: {", ".join(kept)}'
        )
    laws = [place for place, name in enumerate(names) if name.startswith('moment_law.')]
    correlation = after / np.outer(std, std)
    pairs = [
        (names[i], names[j], correlation[i, j])
        for i in laws
        for j in laws
        if i < j and abs(correlation[i, j]) > CONFOUNDED and not same_quantity(names[i], names[j])
    ]
    for one, other, value in pairs:
        notes.append(f'{one} and {other} cannot be told apart here (correlation {value:.3f})')
    if not fit.converged:
        notes.append(f'the fit has not converged: {fit.status}')
    return notes


def same_quantity(one: str, other: str) -> bool:
    """Whether two names are one quantity at two pressures."""
    first, second = one.split('.'), other.split('.')
    return first[:2] == second[:2] and first[3:] == second[3:]
