"""The fits of a calibration one after the other, each starting where the one before has ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.held_out import Score, score
from pneunet_ros.calibration.hyperparameters import most_likely_hyperparameters, REACHES
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.moment_law_parameters import (
    MOMENT_LAW_PARAMETERS,
    MomentLawParameters,
)
from pneunet_ros.calibration.noise_estimate import NoiseEstimate
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.calibration.posterior import PosteriorState
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import Inputs
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

    def parameters(
        self, hyperparameters: Hyperparameters, law: MomentLawParameters | None
    ) -> Parameters:
        """Return the unknowns of a fit."""
        return Parameters(
            frame=self.frame,
            pressure=self.rows,
            arclength=self.knots,
            hyperparameters=hyperparameters,
            law=law,
        )

    def law(self, kind: str, stiffness: float) -> MomentLawParameters:
        """Return the unknowns of a moment law around a stiffness (N m^2)."""
        return MOMENT_LAW_PARAMETERS[kind](
            stiffness=stiffness,
            low=self.low,
            high=self.high,
            length=self.frame.length,
            weight=self.frame.weight,
        )

    def fitted(
        self,
        stage: str,
        parameters: Parameters,
        runs: Sequence[RecordingData],
        start: Array | None,
        most: int | None = None,
    ) -> Fit:
        """Fit, and say how far it is; most: so many frames of every run."""
        chosen = [run if most is None else run.thinned(most) for run in runs]
        return fit(
            parameters,
            chosen,
            self.noise.noise,
            self.frame.target_arclength,
            start,
            on_progress=lambda step, cost: self.each(stage, step, 0),
        )

    def first_experiment(self, unloaded: Sequence[RecordingData]) -> tuple[Fit, Hyperparameters]:
        """Fit kappa_p0 to the unloaded recordings, as smooth as the data say."""
        wide, reaches = wide_smoothness(self.frame.length), REACHES
        if self.uniform:
            wide, reaches = replace(wide, reach=CONSTANT), (CONSTANT,)
        first = self.fitted(
            'kappa_p0, search', self.parameters(wide, None), unloaded, None, FIRST_FRAMES
        )
        hyperparameters, _ = most_likely_hyperparameters(first, reaches)
        parameters = self.parameters(hyperparameters, None)
        return self.fitted('kappa_p0', parameters, unloaded, first.values), hyperparameters

    def stiffness(
        self,
        unloaded: Sequence[RecordingData],
        loaded: Sequence[RecordingData],
        free: Fit,
        hyperparameters: Hyperparameters,
    ) -> float:
        """Return the one stiffness EI (N m^2) that explains the loads best, to begin with."""
        guess = FIRST_STIFFNESS_SHARE * self.frame.weight * self.frame.length**2
        law = self.law('linear', guess)
        start = np.concatenate([free.values, law.mean])
        runs = [*unloaded, *loaded]
        parameters = self.parameters(hyperparameters, law)
        return float(self.fitted('stiffness', parameters, runs, start, FIRST_FRAMES).values[-1])

    def joint(
        self,
        unloaded: Sequence[RecordingData],
        loaded: Sequence[RecordingData],
        free: Fit,
        hyperparameters: Hyperparameters,
        law: MomentLawParameters,
        most: int | None = None,
    ) -> Fit:
        """Fit kappa_p0 and the moment law to all recordings."""
        runs, parameters = [*unloaded, *loaded], self.parameters(hyperparameters, law)
        start = np.concatenate([free.values, law.mean])
        if most is None:
            first = self.fitted('moment law, search', parameters, runs, start, FIRST_FRAMES)
            start = first.values
        return self.fitted('moment law', parameters, runs, start, most)

    def compared(
        self,
        unloaded: Sequence[RecordingData],
        loaded: Sequence[RecordingData],
        free: Fit,
        hyperparameters: Hyperparameters,
        law: MomentLawParameters,
    ) -> tuple[LawScore, ...]:
        """Fit every moment law without each loaded recording in turn, and score it on that one."""
        stiffness = law.stiffness
        results = []
        for kind in MOMENT_LAW_PARAMETERS:
            scores = []
            for which, left_out in enumerate(loaded):
                others = [*loaded[:which], *loaded[which + 1 :]]
                trial = self.law(kind, stiffness)
                fitted = self.joint(
                    unloaded, others, free, hyperparameters, trial, COMPARED_FRAMES
                )
                scores.append(score(fitted.arm, left_out))
            results.append(LawScore(kind=kind, scores=tuple(scores)))
        return tuple(results)


def continued(
    stage: Stages, runs: Sequence[RecordingData], kind: str, earlier: PosteriorState, loaded: bool
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
        law = MOMENT_LAW_PARAMETERS[kind](
            stiffness=earlier.stiffness or guess,
            low=earlier.low,
            high=earlier.high,
            length=stage.frame.length,
            weight=stage.frame.weight,
        )
    parameters = Parameters(
        frame=stage.frame,
        pressure=earlier.pressure,
        arclength=earlier.arclength,
        hyperparameters=wide_smoothness(stage.frame.length),
        law=law,
        known=earlier.known(),
    )
    return stage.fitted('all that is new', parameters, runs, parameters.mean)


def wide_smoothness(length: float) -> Hyperparameters:
    """Return what may be believed of kappa_p0 of any arm of this length (m)."""
    return Hyperparameters(amplitude=5.0 / length, deviation=0.5 / length, reach=0.18)


def pressure_span(all_inputs: Sequence[Inputs]) -> tuple[float, float]:
    """Return the lowest and highest chamber pressure (Pa), rounded to what a sensor tells."""
    pressures = np.concatenate([inputs.pressure for inputs in all_inputs])
    low, high = np.quantile(pressures, [0.002, 0.998])
    return float(np.floor(low / 100.0) * 100.0), float(np.ceil(high / 100.0) * 100.0)
