"""The fits of a calibration one after the other, each starting where the one before has ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.held_out import Score, score
from pneunet_ros.calibration.hyperparameters import likeliest_smoothness, REACHES
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.moment_law_parameters import LAW_UNKNOWNS, LawUnknowns
from pneunet_ros.calibration.noise_estimate import NoiseEstimate
from pneunet_ros.calibration.parameters import Smoothness, Unknowns
from pneunet_ros.calibration.posterior import Knowledge
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals
from pneunet_ros.measurement.dataset import Run
from pneunet_ros.measurement.inputs import Drive
from pneunet_ros.model.arm import Arm, EXTRAPOLATION

KNOTS = 11  # of kappa_p0 along the arm
CONSTANT = 1e3  # of the length: what is as smooth as this is the same all along
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


class Stages:
    """The fits one after the other, each starting where the one before has ended.

    uniform: kappa_p0 is the same all along the arm; that is part of the model.
    """

    def __init__(
        self,
        frame: Arm,
        noise: NoiseEstimate,
        low: float,
        high: float,
        each: Progress,
        *,
        uniform: bool = False,
    ) -> None:
        self.frame, self.noise, self.low, self.high, self.each = frame, noise, low, high, each
        self.uniform, self.knots = uniform, np.linspace(0.0, 1.0, 2 if uniform else KNOTS)
        count = round((high - low) / ROW_DISTANCE) + 1
        self.rows = np.linspace(low, high, min(max(count, FEWEST_ROWS), MOST_ROWS))

    def unknowns(self, smoothness: Smoothness, law: LawUnknowns | None) -> Unknowns:
        """Return the unknowns of a fit."""
        return Unknowns(
            frame=self.frame,
            pressure=self.rows,
            arclength=self.knots,
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
        wide, reaches = wide_smoothness(self.frame.length), REACHES
        if self.uniform:
            wide, reaches = replace(wide, reach=CONSTANT), (CONSTANT,)
        first = self.fitted(
            'kappa_p0, search', self.unknowns(wide, None), unloaded, None, FIRST_FRAMES
        )
        smoothness, _ = likeliest_smoothness(first, reaches)
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


def continued(
    stage: Stages, runs: Sequence[Run], kind: str, earlier: Knowledge, loaded: bool
) -> Fit:
    """Fit new recordings with what was known as the prior, on the tables there were."""
    beyond = EXTRAPOLATION * (earlier.high - earlier.low)
    if stage.low < earlier.low - beyond or stage.high > earlier.high + beyond:
        raise RequestError(
            f'the new recordings reach from {kilopascals(stage.low):.4g} to '
            f'{kilopascals(stage.high):.4g} kPa, and the calibration to be continued knows '
            f'{kilopascals(earlier.low):.4g} to {kilopascals(earlier.high):.4g} kPa; calibrate '
            'anew with all recordings'
        )
    if earlier.kind and earlier.kind != kind:
        raise RequestError(f'the calibration to be continued has the moment law {earlier.kind}')
    law = None
    if earlier.kind or loaded:
        guess = FIRST_STIFFNESS_SHARE * stage.frame.weight * stage.frame.length**2
        law = LAW_UNKNOWNS[kind](
            stiffness=earlier.stiffness or guess,
            low=earlier.low,
            high=earlier.high,
            length=stage.frame.length,
            weight=stage.frame.weight,
        )
    unknowns = Unknowns(
        frame=stage.frame,
        pressure=earlier.pressure,
        arclength=earlier.arclength,
        smoothness=wide_smoothness(stage.frame.length),
        law=law,
        known=earlier.known(),
    )
    return stage.fitted('all that is new', unknowns, runs, unknowns.mean)


def wide_smoothness(length: float) -> Smoothness:
    """Return what may be believed of kappa_p0 of any arm of this length (m)."""
    return Smoothness(amplitude=5.0 / length, deviation=0.5 / length, reach=0.18)


def pressure_span(drives: Sequence[Drive]) -> tuple[float, float]:
    """Return the lowest and highest chamber pressure (Pa), rounded to what a sensor tells."""
    pressures = np.concatenate([drive.pressure for drive in drives])
    low, high = np.quantile(pressures, [0.002, 0.998])
    return float(np.floor(low / 100.0) * 100.0), float(np.ceil(high / 100.0) * 100.0)
