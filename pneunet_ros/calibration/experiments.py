"""Successive fits of a calibration, each started from the previous one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration import elongation
from pneunet_ros.calibration.checks.held_out import Score, score
from pneunet_ros.calibration.checks.preconditions import same_pressure
from pneunet_ros.calibration.checks.resolution import Resolution
from pneunet_ros.calibration.first_curvature import first_curvature
from pneunet_ros.calibration.hyperparameters import most_likely_parameters, structures
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.moment_law_parameters import (
    MOMENT_LAW_PARAMETERS,
    MomentLawParameters,
)
from pneunet_ros.calibration.noise_estimate import NoiseEstimate
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters, PosteriorState
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import EXPERIMENTS, HYPERPARAMETERS, RESOLUTION
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.progress import OnProgress
from pneunet_ros.core.units import kilopascals
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.painted_targets import in_plane, paint
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw, PiecewiseLinearLaw
from pneunet_ros.solver.columns import CURVATURE, THETA
import scipy

SCANNED = 0.02  # decades; tolerance of the search for the first stiffness
SCANNED_FRAMES = 5  # frames per loaded run in that search, to save CPU
# Stiffnesses to try first, relative to the initial one.
STIFFNESS_FACTORS = (1.0, 0.1, 10.0, 0.01, 100.0, 0.001, 1e3, 1e4)
COMPARED_FRAMES = 60  # per run, for the comparison of moment laws: CPU
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
UNIFORM = 1e3  # correlation length of a constant, in lengths
FIRST_ALPHA = 0.05  # at the beginning of the search for the stiffness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawScore:
    """Scores of a moment law, one per left-out loaded recording.

    fits: those without each of these recordings.
    """

    kind: str
    scores: tuple[Score, ...]
    fits: tuple[Fit, ...] = ()

    @property
    def rms(self) -> float:
        """Root mean square over the recordings (m), of frames with an equilibrium."""
        return float(np.sqrt(np.mean([item.rms**2 for item in self.scores])))

    @property
    def missing(self) -> int:
        """Number of frames without an equilibrium."""
        return sum(round(item.missing * len(item.error)) for item in self.scores)

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key, best law first: number of missing frames, then rms."""
        return self.missing, self.rms if np.isfinite(self.rms) else np.inf


class FitSequence:
    """Successive fits, each started from the previous one.

    planned, done: number of planned fits (0 if unknown) and of finished fits. low, high (Pa):
    pressure range of the recordings. uniform: whether kappa_p0 is constant along the arm by
    definition of the model. resolution of the recordings; None: everything is fitted. shapes,
    elongates: as in `Parameters`; before the first experiment selects them, the largest
    candidates.
    """

    def __init__(
        self,
        frame: Arm,
        noise: NoiseEstimate,
        runs: Sequence[RecordingData],
        on_progress: OnProgress,
        *,
        uniform: bool = False,
        resolution: Resolution | None = None,
    ) -> None:
        """Initialize with an arm that has the fixed parameters, and with all recordings."""
        self.frame, self.noise, self.on_progress = frame, noise, on_progress
        self.planned = self.done = 0
        self.shapes = resolution.free_shapes if resolution is not None else None
        self.uniform = uniform or self.shapes == 1
        self.elongates: bool | None = None
        self.chosen = False
        pressures = np.concatenate([inputs.pressure for inputs in inputs_of(frame, runs)])
        self.knots = np.linspace(0.0, 1.0, 2 if uniform else RESOLUTION.knots)
        if resolution is not None and resolution.constant_pressure:
            self.low = self.high = float(np.median(pressures))
            self.rows = np.array([self.low])
            return
        ends = [EXPERIMENTS.outliers, 1.0 - EXPERIMENTS.outliers]
        # Many targets show an elongation and similar effects at once: `diagnose` distinguishes
        # them.
        shown = any(run.seen[:, frame.target_arclength > 0.0].any() for run in runs)
        if self.shapes is not None and shown and not elongation.has_given_elongation(frame):
            self.elongates = True
        self.low, self.high = np.quantile(pressures, ends, method='nearest').tolist()
        self.rows = np.linspace(self.low, self.high, EXPERIMENTS.rows)

    def span(self, earlier: PosteriorState | None) -> tuple[float, float]:
        """Return the range of pressure (Pa) of the moment law."""
        return (self.low, self.high) if earlier is None else (earlier.low, earlier.high)

    def check_law(self, loaded: Sequence[RecordingData]) -> None:
        """Replace a moment law that does not cover all pressures by a linear one.

        The loaded recordings then determine the linear law. Without loaded recordings, raises
        RequestError, because a law is never extrapolated.
        """
        low, high = self.frame.moment_law.pressure_range
        margin = EXTRAPOLATION * (high - low) if np.isfinite(high - low) else 0.0
        if low - margin <= self.low and self.high <= high + margin:
            return
        if not loaded:
            raise RequestError(
                f'the pressures reach from {kilopascals(self.low):.4g} to '
                f'{kilopascals(self.high):.4g} kPa, but the moment law of {self.frame.name} is '
                f'valid from {kilopascals(low):.4g} to {kilopascals(high):.4g} kPa only: record '
                'loads (--loaded), or give an --arm with a law that is valid there (such as '
                'kind: linear)',
                reason='out_of_range',
            )
        law = LinearLaw(bending_stiffness=self.first_stiffness)
        self.frame = replace(self.frame, moment_law=law)

    @property
    def wide_prior(self) -> Hyperparameters:
        """Prior of kappa_p0 for any arm of this length."""
        length = self.frame.length
        return Hyperparameters(
            amplitude=EXPERIMENTS.amplitude / length,
            std=EXPERIMENTS.std / length,
            length_scale=UNIFORM if self.uniform else EXPERIMENTS.length_scale,
        )

    @property
    def first_stiffness(self) -> float:
        """Initial EI (N m^2) of the search."""
        return FIRST_ALPHA * self.frame.weight * self.frame.length**2

    def law(
        self, kind: str, stiffness: float, span: tuple[float, float] | None = None
    ) -> MomentLawParameters:
        """Return the parameters of a moment law around a stiffness (N m^2); span (Pa)."""
        low, high = span or (self.low, self.high)
        return MOMENT_LAW_PARAMETERS[kind](
            stiffness=stiffness,
            low=low,
            high=high,
            length=self.frame.length,
            weight=self.frame.weight,
            given=self.frame.moment_law,
        )

    def fit(
        self,
        stage: str,
        runs: Sequence[RecordingData],
        hyperparameters: Hyperparameters,
        law: MomentLawParameters | None = None,
        start: Array | None = None,
        most: int | None = None,
        earlier: PosteriorState | None = None,
    ) -> Fit:
        """Fit and report progress; most: largest number of frames per run."""
        parameters = Parameters(
            frame=self.frame,
            pressure=self.rows if earlier is None else earlier.pressure,
            arclength=self.knots if earlier is None else earlier.arclength,
            hyperparameters=hyperparameters,
            law=law,
            earlier=earlier,
            shapes=self.shapes if earlier is None else earlier.shapes or None,
            elongates=self.elongates if earlier is None else earlier.elongates,
        )
        found = fit(
            parameters,
            [run if most is None else run.thin(most) for run in runs],
            self.noise.noise,
            self.frame.target_arclength,
            start,
            on_progress=lambda step, cost: self.on_progress(
                f'{stage}, step {step}', self.done, self.planned and max(self.planned, self.done)
            ),
        )
        self.done += 1
        return found

    def first_experiment(self, unloaded: Sequence[RecordingData]) -> Fit:
        """Fit kappa_p0 to the unloaded recordings, with its smoothness chosen by the evidence.

        The first fit also selects the number of values along the arm, and whether the arm
        lengthens.
        """
        frames = EXPERIMENTS.first_frames
        scales = (self.wide_prior.length_scale,) if self.uniform else HYPERPARAMETERS.length_scales
        rows = first_curvature(unloaded, self.frame, self.rows)
        start = np.repeat(rows, self.knots.size)
        if self.elongates is not None:
            start = np.append(start, np.zeros(elongation.SIZE))
        first = self.fit('kappa_p0, search', unloaded, self.wide_prior, start=start, most=frames)
        tried = [first.parameters] if self.chosen else structures(first.parameters)
        best = most_likely_parameters(first, tried, scales)
        self.shapes, self.elongates, self.chosen = best.shapes, best.elongates, True
        start = best.nearest(first.values)
        return self.fit('kappa_p0', unloaded, best.hyperparameters, start=start)

    def stiffness(self, runs: Sequence[RecordingData], free: Fit) -> float:
        """Return the uniform stiffness EI (N m^2) that best explains the loads, to start a fit."""
        likely = self.likely_stiffness(runs, free.arm, free.placement)
        law = self.law(LinearLaw.kind, likely)
        fitted = self._add_law('stiffness', runs, free, law, EXPERIMENTS.first_frames)
        found = float(fitted.values[-1])
        return found if found > 0.0 else likely  # a stiffness is positive

    def likely_stiffness(
        self, runs: Sequence[RecordingData], arm: Arm, placement: Array | None = None
    ) -> float:
        """Return the EI (N m^2) that best fits the targets, as a starting value.

        placement (2, targets) m of the targets, where known.

        Scans values a decade apart, then searches between the neighbors of the best value. The
        cost is the mean log error, so that a frame in which the arm snaps does not dominate.
        """
        runs = [run.thin(SCANNED_FRAMES) for run in runs if run.loaded]

        def error(decade: float) -> float:
            law = LinearLaw(bending_stiffness=self.first_stiffness * 10.0**decade)
            tried = replace(arm, moment_law=law, covariance=None)
            errors = np.concatenate([squared_errors(tried, run, placement) for run in runs])
            return float(np.mean(np.log(errors + self.noise.noise.target_std**2)))

        decade = min(np.log10(STIFFNESS_FACTORS).tolist(), key=error)
        refined = scipy.optimize.minimize_scalar(
            error, bounds=(decade - 1.0, decade + 1.0), options={'xatol': SCANNED}
        )
        best = decade if error(decade) <= refined.fun else float(refined.x)
        return float(self.first_stiffness * 10.0**best)

    def at_one_pressure(self, runs: Sequence[RecordingData], kind: str) -> Fit:
        """Fit rest curvature and moment law jointly; different loads separate them.

        Raises RecordingError if no recording has a load.
        """
        if not any(run.loaded for run in runs):
            raise RecordingError(
                'the pressure never changes and no recording has an end load, so neither the '
                'curvature over pressure nor the stiffness can be estimated: add a recording with '
                'a load (--loaded REC, or --end-load REC FX FY for a known weight)',
                reason='one_pressure',
            )
        straight = replace(
            self.frame,
            intrinsic_curvature=IntrinsicCurvature(
                pressure=self.rows,
                arclength=self.knots,
                curvature=np.zeros((self.rows.size, self.knots.size)),
            ),
        )
        first = self.law(LinearLaw.kind, self.likely_stiffness(runs, straight))
        search = self.fit(
            'stiffness, search', runs, self.wide_prior, first, most=EXPERIMENTS.first_frames
        )
        law = self.law(kind, float(search.values[-1]))
        start = np.concatenate([search.values[:-1], law.mean])
        return self.fit('stiffness', runs, self.wide_prior, law, start)

    def joint(
        self,
        runs: Sequence[RecordingData],
        free: Fit,
        law: MomentLawParameters,
        most: int | None = None,
    ) -> Fit:
        """Fit kappa_p0 and the moment law to all recordings; free: the fit to unloaded ones."""
        if most is not None:
            return self._add_law('moment law', runs, free, law, most)
        most = EXPERIMENTS.first_frames
        first = self._add_law('moment law, search', runs, free, law, most)
        return self.fit('moment law', runs, free.parameters.hyperparameters, law, first.values)

    def _add_law(
        self,
        stage: str,
        runs: Sequence[RecordingData],
        free: Fit,
        law: MomentLawParameters,
        most: int,
    ) -> Fit:
        start = np.concatenate([free.values, law.mean])
        return self.fit(stage, runs, free.parameters.hyperparameters, law, start, most)

    def compare_laws(
        self,
        unloaded: Sequence[RecordingData],
        loaded: Sequence[RecordingData],
        free: Fit,
        stiffness: float,
    ) -> tuple[LawScore, ...]:
        """Score each law on each loaded recording, with that recording left out of the fit."""
        results = []
        every = [*unloaded, *loaded]
        for kind in MOMENT_LAW_PARAMETERS:
            fits = self.without_each(unloaded, loaded, free, self.law(kind, stiffness))
            scores = (
                score(fit.arm, run, inputs_of(fit.arm, every)[which], fit.placement)
                for which, (fit, run) in enumerate(zip(fits, loaded, strict=True), len(unloaded))
            )
            results.append(LawScore(kind=kind, scores=tuple(scores), fits=fits))
        return tuple(results)

    def without_each(
        self,
        unloaded: Sequence[RecordingData],
        loaded: Sequence[RecordingData],
        free: Fit,
        law: MomentLawParameters,
    ) -> tuple[Fit, ...]:
        """Fit a law without each loaded recording in turn, using few frames."""
        return tuple(
            self.joint(
                [*unloaded, *loaded[:which], *loaded[which + 1 :]], free, law, COMPARED_FRAMES
            )
            for which in range(len(loaded))
        )

    def continue_from(
        self,
        earlier: PosteriorState,
        runs: Sequence[RecordingData],
        kind: str | None,
        loaded: bool,
    ) -> Fit:
        """Fit new recordings with the earlier posterior as the prior, on the earlier tables."""
        beyond = max(EXTRAPOLATION * (earlier.high - earlier.low), same_pressure(self.frame))
        if self.low < earlier.low - beyond or self.high > earlier.high + beyond:
            raise RequestError(
                f'the new recordings span {kilopascals(self.low):.4g} to '
                f'{kilopascals(self.high):.4g} kPa, but the calibration to be continued covers '
                f'{kilopascals(earlier.low):.4g} to {kilopascals(earlier.high):.4g} kPa; '
                'recalibrate with all recordings',
                reason='out_of_range',
            )
        if earlier.placement.size != 2 * self.frame.target_arclength.size:
            raise RequestError(
                f'the calibration to be continued has {earlier.placement.size // 2} targets, but '
                f'the new recordings have {self.frame.target_arclength.size} (the pose of the '
                'tip counts as one); recalibrate with all recordings',
                reason='wrong_targets',
            )
        if not earlier.is_of(self.frame):
            raise RequestError(
                'the calibration to be continued is of an arm with another length, weight or '
                'target_arclength, to which its numbers refer; recalibrate with all recordings',
                reason='other_arm',
            )
        kind = kind or earlier.kind or PiecewiseLinearLaw.kind
        if earlier.kind and earlier.kind != kind:
            raise RequestError(
                f'the calibration to be continued has another moment law, {earlier.kind}',
                reason='other_law',
            )
        law = None
        if kind is not None and (earlier.kind or loaded):
            stiffness = earlier.stiffness or self.first_stiffness
            law = self.law(kind, stiffness, (earlier.low, earlier.high))
        numbers = earlier.pressure.size * earlier.arclength.size
        if earlier.elongates is not None:
            numbers += elongation.SIZE
        if earlier.kind and law is not None:
            numbers += law.mean.size
        if earlier.values.size != numbers:
            raise RequestError(
                'the .knowledge.npz of the calibration to be continued is damaged: its tables '
                f'and moment law have {numbers} parameters, but it contains '
                f'{earlier.values.size}; recalibrate with all recordings',
                reason='damaged',
            )
        return self.fit('new recordings', runs, self.wide_prior, law, earlier=earlier)


def squared_errors(arm: Arm, run: RecordingData, placement: Array | None = None) -> Array:
    """Return the mean square error (m^2) of the targets in every frame, (frames,).

    placement (2, targets) m, along and across the arm, from a fit; if given, the mean error of all
    frames is attributed to the camera position. The error of a frame without equilibrium is set to
    the length of the arm.
    """
    model = ForwardModel(arm.target_arclength, run.points)
    (inputs,) = inputs_of(arm, [run])
    solved = model.solve(arm, inputs)
    residual = run.points - model.points
    if placement is not None:
        fields = model.fields
        residual -= in_plane(paint(fields[:, THETA], fields[:, CURVATURE], placement).displacement)
        if np.isfinite(residual[solved]).any(axis=(0, 2)).all():
            residual -= np.nanmedian(residual[solved], axis=(0, 2), keepdims=True)
    squares = np.nan_to_num(residual) ** 2
    squares[~solved] = arm.length**2
    return np.asarray(np.mean(squares, axis=(1, 2)))
