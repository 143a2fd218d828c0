"""Response of points to small effects around a calibrated arm, by finite differences of solves.

What the methods that are compared with the diagnosis work with: residuals of the calibrated model
on all recordings, and beside them a column for every effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.effects import EFFECTS
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm

from blind.hidden import HIDEABLE
from blind.reference import residual_of
from blind.trials import Trial

TAKEN = 3.0  # times the weakest size that is hidden: still small, well above the solver's error
# Beside the main parameters: times at which creep is tried, second parameters, what calibration
# swallows.
CREEP_TIMES = (4.0, 12.0)  # s
SECOND = {
    'gravity': {'weight_x': 0.15},
    'pressure_elongation': {'strain_per_pascal_squared': 1e-12},
}
SWALLOWED = {'pressure_gain': {'gain': 1.01}, 'pressure_offset': {'offset': 300.0}}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """An effect as columns (rows, k), one set for the training, one for the held-out rows."""

    name: str
    training: np.ndarray
    held_out: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Residuals (rows,) m, and causes (rows, 5) of each: p, F1, F2 (scaled), direction, s / l.

    Rows are (frame, coordinate, target) where seen, runs one after the other; run (rows,) says
    which, coordinate (rows,) 0 or 1.
    """

    residual: np.ndarray
    causes: np.ndarray
    run: np.ndarray
    coordinate: np.ndarray
    mask: tuple[np.ndarray, ...]

    def rms(self, correction: np.ndarray) -> float:
        """Return the rms (m) with a correction (rows,) taken off, registration removed."""
        left = self.residual - correction
        for which in np.unique(self.run):
            for coordinate in (0, 1):
                some = (self.run == which) & (self.coordinate == coordinate)
                left[some] -= left[some].mean()
        return float(np.sqrt(np.mean(left**2)))


def small_effects() -> list[tuple[str, list[Mapping[str, float]]]]:
    """Return the candidates: a name, and for each of its columns the parameters."""
    found: list[tuple[str, list[Mapping[str, float]]]] = []
    for name, kind in HIDEABLE.items():
        infinite = math.isinf(kind.neutral)
        size = kind.weakest / TAKEN if infinite else kind.neutral + TAKEN * kind.weakest
        main = {kind.parameter: size}
        if name == 'creep':
            found += [(name, [main | {'time_constant': time}]) for time in CREEP_TIMES]
        else:
            found.append((name, [main, *([SECOND[name]] if name in SECOND else [])]))
    return found + [(name, [values]) for name, values in SWALLOWED.items()]


def prepared(trial: Trial, diagnosis: Diagnosis) -> tuple[Table, Table, list[Candidate]]:
    """Return the table to learn from, the held-out one, and all candidates."""
    arm, fitted = diagnosis.before.arm, diagnosis.before.fit.runs
    training = [item.run for item in fitted]
    runs = [*training, *trial.held_out]
    points = claimed(arm, runs)
    residuals = [item.residual for item in fitted]
    residuals += [
        residual_of(run, claim)
        for run, claim in zip(trial.held_out, points[len(training) :], strict=True)
    ]
    parts = slice(0, len(training)), slice(len(training), None)
    tables = [table_of(arm, runs[part], residuals[part]) for part in parts]
    candidates = []
    for name, columns in small_effects():
        moved = []
        for values in columns:
            changed = replace(arm, effects=(*arm.effects, EFFECTS[name](**values)))
            moved.append(
                [
                    after - before
                    for after, before in zip(claimed(changed, runs), points, strict=True)
                ]
            )
        flat = [
            np.column_stack([picked(table, one[part]) for one in moved])
            for table, part in zip(tables, parts, strict=True)
        ]
        candidates.append(Candidate(name=name, training=flat[0], held_out=flat[1]))
    return tables[0], tables[1], candidates


def claimed(arm: Arm, runs: list[RecordingData]) -> list[np.ndarray]:
    """Return where an arm puts the targets in every run, (frames, 2, targets) m each."""
    points = []
    for inputs in inputs_of(arm, runs):
        series = ForwardModel(arm.target_arclength)
        solved = series.solve(arm, inputs)
        points.append(np.where(solved[:, None, None], series.points, np.nan))
    return points


def table_of(arm: Arm, runs: list[RecordingData], residuals: list[np.ndarray]) -> Table:
    """Put the residuals of runs and their causes into rows."""
    causes, which, coordinate = [], [], []
    masks = tuple(np.isfinite(residual) for residual in residuals)
    for place, (run, mask) in enumerate(zip(runs, masks, strict=True)):
        pressure = run.frame_pressure
        direction = np.sign(np.gradient(pressure)) * (np.abs(np.gradient(pressure)) > 300.0)
        frame, axis, target = np.nonzero(mask)
        scaled = np.column_stack([pressure / 6e4, run.force / arm.weight, direction])
        causes.append(
            np.column_stack([scaled[frame], (arm.target_arclength / arm.length)[target]])
        )
        which.append(np.full(frame.size, place))
        coordinate.append(axis)
    values = [residual[mask] for residual, mask in zip(residuals, masks, strict=True)]
    return Table(
        residual=np.concatenate(values),
        causes=np.concatenate(causes),
        run=np.concatenate(which),
        coordinate=np.concatenate(coordinate),
        mask=masks,
    )


def picked(table: Table, fields: list[np.ndarray]) -> np.ndarray:
    """Return fields (frames, 2, targets) per run as rows of a table; 0 where there is none.

    Registration, constant in every run, is taken off.
    """
    rows = []
    for field, mask in zip(fields, table.mask, strict=True):
        field = np.nan_to_num(field - np.nanmean(field, axis=(0, 2), keepdims=True))
        rows.append(field[mask])
    return np.concatenate(rows)
