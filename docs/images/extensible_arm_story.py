"""The numbers of docs/extensible_arm.md: an arm that stretches, calibrated as if it did not.

The recordings are those of the shipped scenarios; that of Table 1, `strings`, is held out. Beside
it a second arm of which all is the same, but which does not stretch: what goes wrong with it is
conditioning alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import functools
import math
from pathlib import Path
import sys

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.tip_force import end_forces
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.diagnosis.result import Diagnosis, Estimated
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_effects import LabExtensibility
from pneunet_ros.lab.protocols import Strings
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.painted_targets import in_plane, paint
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from pneunet_ros.solver.columns import CURVATURE, THETA

# What the tests share knows the truth of the virtual lab as a model.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'test'))
from support.lab_run import run_of, true_model

STIFFNESS = 25.0  # N, EA of the lab arm; invented
RICHNESS = 1.0  # it stretches as rubber does, which no effect of the model knows
UNLOADED = ('unloaded_ramp', 'unloaded_staircase')
LOADED = ('dead_weights', 'force_sweeps', 'random_mix')
HELD_OUT = 'strings'
AT_ROW = 300.0  # Pa, from the pressure of a row
FEWEST_FOUND = 0.5  # of the frames of a row, for a force to count as found
Z_95 = 1.96
NAN = float('nan')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """Recordings of one lab arm: training ones and the one held out, with its true forces.

    force (frames, 2) N; rows (15,) Pa: pressures of Table 1.
    """

    scenario: Scenario
    unloaded: tuple[RecordingData, ...]
    loaded: tuple[RecordingData, ...]
    held_out: RecordingData
    force: Array
    rows: Array

    @property
    def training(self) -> tuple[RecordingData, ...]:
        """All training recordings."""
        return (*self.unloaded, *self.loaded)

    def by_row(self, values: Array) -> Array:
        """Return medians (rows, ...) of values (frames, ...) in each row of Table 1."""
        pressure = self.held_out.frame_pressure
        out = []
        for row in self.rows:
            some = values[np.abs(pressure - row) < AT_ROW]
            found = np.isfinite(some).reshape(len(some), -1).all(axis=1)
            enough = found.mean() >= FEWEST_FOUND
            out.append(
                np.median(some[found], axis=0) if enough else np.full(values.shape[1:], np.nan)
            )
        return np.array(out)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forces:
    """End forces found in the rows of Table 1 and their standard errors, (rows, 2) N."""

    force: Array
    sigma: Array

    def over(self, true: Array, component: int = 0) -> Array:
        """Return by which share of the true force a component is too large, NaN of none."""
        force = np.where(true[:, component] > 0.0, true[:, component], np.nan)
        return np.asarray(self.force[:, component] / force - 1.0)

    def covered(self, true: Array) -> Array:
        """Return where the 95 % interval holds the true force, (rows, 2)."""
        return np.asarray(np.abs(self.force - true) <= Z_95 * self.sigma)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Story:
    """All that the page tells. true (rows, 2) N; forces: from the tip alone and all targets.

    placed: as after, with the dots where the fit found them to be painted; without_stretch: from
    the tip by the true arm less its stretch; control: from the tip of the arm that does not
    stretch, by its own calibration.
    """

    recorded: Recorded
    calibration: Calibration
    diagnosis: Diagnosis
    true: Array
    tip: Forces
    all_targets: Forces
    tip_after: Forces
    after: Forces
    placed: Forces
    without_stretch: Forces
    control: Forces

    @property
    def stiffness(self) -> Estimated:
        """The stiffness that was found; NaN where extensibility is not named."""
        for effect in self.diagnosis.effects:
            if effect.name == LabExtensibility.name:
                return effect.parameters['axial_stiffness']
        return Estimated(value=NAN, std=NAN, unit='N')


def recorded(stiffness: float) -> Recorded:
    """Record a lab arm of an axial stiffness (N), infinite for one that does not stretch."""
    effects = ()
    if math.isfinite(stiffness):
        effects = (LabExtensibility(axial_stiffness=stiffness, richness=RICHNESS),)
    runs = {}
    for name in (*UNLOADED, *LOADED, HELD_OUT):
        scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
        recording = simulate(replace(scenario, effects=effects))
        runs[name] = run_of(recording)
    protocol = recording.scenario.protocol
    assert isinstance(protocol, Strings)
    kept = np.isfinite(recording.x).any(axis=1)
    return Recorded(
        scenario=recording.scenario,
        unloaded=tuple(runs[name] for name in UNLOADED),
        loaded=tuple(runs[name] for name in LOADED),
        held_out=runs[HELD_OUT],
        force=recording.truth.force[kept],
        rows=np.asarray(protocol.pressures),
    )


def calibrated(recordings: Recorded) -> Calibration:
    """Calibrate as inextensible; the frame knows length, weight and targets."""
    frame = load_model(share_path('config/paper_arm.yaml'))
    return calibrate(recordings.unloaded, recordings.loaded, frame, compare=False)


def forces(arm: Arm, recordings: Recorded, *, tip_only: bool) -> Forces:
    """Find the end forces of the recording held out, row by row."""
    found = end_forces(arm, recordings.held_out, tip_only=tip_only)
    by_row = recordings.by_row(np.concatenate([found.force, found.sigma], axis=1))
    return Forces(force=by_row[:, :2], sigma=by_row[:, 2:])


def placed(fit: Fit, recordings: Recorded) -> Recorded:
    """Return the recordings with the placement of the targets taken off the one held out."""
    run, arm = recordings.held_out, fit.arm
    series = ForwardModel(arm.target_arclength)
    series.solve(arm, inputs_of(arm, [run])[0])
    fields = series.fields
    moved = in_plane(paint(fields[:, THETA], fields[:, CURVATURE], fit.placement).displacement)
    run = replace(run, x=run.x - moved[:, 0], y=run.y - moved[:, 1])
    return replace(recordings, held_out=run)


@functools.cache
def told() -> Story:
    """Record, calibrate, find forces, diagnose, and find forces again."""
    arm = recorded(STIFFNESS)
    before = calibrated(arm)
    found = diagnose(before.arm, arm.training, [arm.held_out])
    rigid = recorded(math.inf)
    after, true = found.after.arm, replace(true_model(arm.scenario), effects=())
    return Story(
        recorded=arm,
        calibration=before,
        diagnosis=found,
        true=arm.by_row(arm.force),
        tip=forces(before.arm, arm, tip_only=True),
        all_targets=forces(before.arm, arm, tip_only=False),
        tip_after=forces(after, arm, tip_only=True),
        after=forces(after, arm, tip_only=False),
        placed=forces(after, placed(found.after.fit, arm), tip_only=False),
        without_stretch=forces(true, arm, tip_only=True),
        control=forces(calibrated(rigid).arm, rigid, tip_only=True),
    )


def lines(story: Story) -> list[str]:
    """Return the numbers as the page shows them."""
    stiffness, found = story.stiffness, story.diagnosis
    before, after = found.before.held_out, found.after.held_out
    assert before is not None
    assert after is not None
    out = [
        f'diagnosis: {found.answer}, axial stiffness {stiffness.value:.1f} +- '
        f'{stiffness.std:.1f} N, true {STIFFNESS:.1f}',
        f'model error on Table 1: {millimeters(before.rms):.2f} to '
        f'{millimeters(after.rms):.2f} mm rms, noise alone {millimeters(found.noise_floor):.2f}',
        '',
        'p kPa   true F1   F2    tip, inextensible     all, inextensible     all, extensible',
    ]
    columns = (story.tip, story.all_targets, story.after)
    for row, pressure in enumerate(story.recorded.rows):
        words = [f'{kilopascals(float(pressure)):5.1f}  ']
        words.append(' '.join(f'{value:6.3f}' for value in story.true[row]) + '   ')
        for item in columns:
            force, sigma = item.force[row], item.sigma[row]
            if np.isfinite(force).all():
                words.append(f'{force[0]:6.3f} +- {sigma[0]:.3f} {force[1]:6.3f} ')
            else:
                words.append('     -           -    ')
        out.append(' '.join(words).rstrip())
    return [*out, '', *sentences(story), '', *biased_parameters(story)]


def sentences(story: Story) -> list[str]:
    """Return what the rows come to."""
    out = []
    for name, item in (
        ('tip, inextensible', story.tip),
        ('tip, inextensible, the true kappa_p0 and law', story.without_stretch),
        ('all targets, inextensible', story.all_targets),
        ('tip, extensible', story.tip_after),
        ('all targets, extensible', story.after),
        ('all targets, extensible, dots where they are', story.placed),
    ):
        known = np.isfinite(item.force).all(axis=1)
        over, second = item.over(story.true)[known], item.over(story.true, 1)[known]
        inside = item.covered(story.true)[known].sum(axis=0)
        out.append(
            f'{name}: found in {known.sum()} of {known.size} rows; F1 too large by '
            f'{np.median(over):.1%} (median; {over.min():.1%} to {over.max():.1%}), F2 by '
            f'{np.nanmedian(second):.1%}; within their intervals in {inside[0]} and {inside[1]}'
        )
    known = np.isfinite(story.control.force).all(axis=1)
    over = story.control.over(story.true)[known]
    inside = story.control.covered(story.true)[known, 0].sum()
    share = story.control.sigma[known, 0] / story.true[known, 0]
    out.append(
        f'tip of an arm that does not stretch: found in {known.sum()} of {known.size} rows; F1 '
        f'too large by {np.median(over):.1%} (median); F1 within its interval in {inside}; '
        f'sigma {share.min():.1%} to {share.max():.1%} of F1'
    )
    return out


def biased_parameters(story: Story) -> list[str]:
    """Return the parameters biased by the missing effect, beside the truth: alpha2."""
    lab, after = story.recorded.scenario.arm, story.diagnosis.after.arm.moment_law
    assert isinstance(after, PiecewiseLinearLaw)
    out = []
    for name, shift in story.diagnosis.shift.items():
        match name.split('.'):
            case ['moment_law', 'rigidity', row, '1']:
                pressure = float(after.pressure[int(row)])
            case _:
                continue
        true = float(np.interp(pressure, lab.law_pressure, lab.rigidity[:, 1]))
        out.append(
            f'alpha2 at {kilopascals(pressure):4.1f} kPa: {shift.before:.4f} before, '
            f'{shift.after:.4f} +- {shift.std:.4f} after, true {true:.4f}'
        )
    return sorted(out)
