"""Fits of an arm with and without elongation to the tips of `acceptance/real_data.py`."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.errors import ModelError, RecordingError
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.uncertainty import SensorNoise
from scipy.optimize import least_squares

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data' / 'modular_stiffness.csv'
COLUMNS = ('actuator', 'pressure_as_recorded', 'tip_dx_mm', 'tip_dy_mm')
PRESSURE_UNIT = 100.0  # Pa; inferred: the table does not say, millibar is likely
LENGTH = 0.135  # m; inferred from the angles in the authors' file
ASSUMED = 'inferred, not measured: 1 unit of pressure = 100 Pa, length 135 mm'
PRESSURE_STEP = 50.0  # Pa, either side, for the direction in which a tip moves with pressure
MODELS = {  # how the curvature follows pressure, and the order of elongation in pressure
    'best_curvature': ('any', 0),
    'without': ('quadratic', 0),
    'linear': ('quadratic', 1),
    'quadratic': ('quadratic', 2),
}
# Law, weight and noise of an arm without load and without covariance matter to nothing.
LAW = LinearLaw(bending_stiffness=1e-3)
NOISE = SensorNoise(pressure_std=0.0, force_std=0.0, moment_std=0.0, target_std=0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actuator:
    """One actuator: pressure (n,) Pa, rising from 0, and tip (n, 2) m, both as inferred above."""

    name: str
    pressure: np.ndarray
    tip: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Score:
    """One model of one actuator: the arm that fits all its tips, and what is predicted.

    fitted (n, 2) m are the tips of that arm; left_out (n - 2, 2) m those at the pressures between
    the first and the last, each by an arm that was fitted without it, none for `best_curvature`.
    The errors are distances from the measured tips, % of the length.
    """

    arm: Arm
    fitted: np.ndarray
    fitted_error: np.ndarray
    left_out: np.ndarray
    left_out_error: np.ndarray

    def numbers(self) -> dict[str, float]:
        """Mean and rms of the errors, at rest not counted, and what was found."""
        curvature = self.arm.intrinsic_curvature.curvature[-1, 0]
        out = {'turning_rad': float(LENGTH * curvature)}
        for name, errors in (('fitted', self.fitted_error[1:]), ('left_out', self.left_out_error)):
            if errors.size:
                out[f'{name}_mean'] = float(np.mean(errors))
                out[f'{name}_rms'] = float(np.sqrt(np.mean(errors**2)))
        for effect in self.arm.effects:
            out['strain_per_pascal'] = effect.strain_per_pascal
            out['strain_per_pascal_squared'] = effect.strain_per_pascal_squared
        return out


def read_actuators(path: Path) -> list[Actuator]:
    """Read the table; raise RecordingError where it is absent or is another one."""
    try:
        with path.open(newline='', encoding='utf-8') as lines:
            rows = csv.DictReader(lines)
            if not set(COLUMNS) <= set(rows.fieldnames or ()):
                raise RecordingError(f'{path} must have the columns {", ".join(COLUMNS)}')
            tables: dict[str, list[list[float]]] = {}
            for row in rows:
                values = [float(row[column]) for column in COLUMNS[1:]]
                tables.setdefault(row['actuator'], []).append(values)
    except OSError as error:
        raise RecordingError(
            f'{path} cannot be read ({error.strerror}): the measurements are not part of this '
            'project; give their place with --data TABLE.csv'
        ) from error
    except (TypeError, ValueError) as error:
        raise RecordingError(f'{path}, line {rows.line_num}: {error}') from error
    actuators = []
    for name, values in tables.items():
        table = np.array(values)
        if len(table) < 3 or table[0, 0] != 0.0 or not np.all(np.diff(table[:, 0]) > 0.0):
            raise RecordingError(
                f'{path}: {name} needs three or more pressures that rise from 0, '
                f'not {table[:, 0].tolist()}'
            )
        if not np.all(np.isfinite(table)):
            raise RecordingError(f'{path}: {name} holds a value that is no finite number')
        tip = 1e-3 * table[:, 1:] + [LENGTH, 0.0]
        pressure = PRESSURE_UNIT * table[:, 0]
        actuators.append(Actuator(name=name, pressure=pressure, tip=tip))
    if not actuators:
        raise RecordingError(f'{path} holds no measurements')
    return actuators


def arm_of(actuator: Actuator, model: str, coefficients: np.ndarray) -> Arm:
    """Arm with curvature rows at the measured pressures.

    coefficients: turning angle of the whole arm (rad), a value per pressure above zero or the two
    of c1 u + c2 u^2; then strain, e1 u + e2 u^2 as far as the model goes; u is the pressure over
    the highest one.
    """
    kind, order = MODELS[model]
    share = actuator.pressure / actuator.pressure[-1]
    split = coefficients.size - order
    if kind == 'any':
        turning = np.concatenate([[0.0], coefficients[:split]])
    else:
        turning = np.stack([share, share**2], axis=1) @ coefficients[:split]
    strain = np.zeros(2)
    strain[:order] = coefficients[split:]
    per_pascal, per_pascal_squared = strain / actuator.pressure[-1] ** np.array([1, 2])
    elongation = PressureElongation(
        strain_per_pascal=float(per_pascal), strain_per_pascal_squared=float(per_pascal_squared)
    )
    return Arm(
        name=actuator.name,
        length=LENGTH,
        weight=1.0,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=actuator.pressure,
            arclength=np.array([0.0, 1.0]),
            curvature=np.repeat(turning[:, None] / LENGTH, 2, axis=1),
        ),
        moment_law=LAW,
        effects=(elongation,) if order else (),
        sensors=NOISE,
    )


def tips(arm: Arm, pressures: np.ndarray) -> np.ndarray:
    """Tips (n, 2) m of the unloaded arm; NaN where there is no solution."""
    shapes = [solve(arm, float(pressure), stations=2) for pressure in pressures]
    return np.array([(shape.x[-1], shape.y[-1]) for shape in shapes])


def fitted(actuator: Actuator, model: str, start: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Coefficients that bring the tips at some pressures (indices) closest to the measured."""

    def misses(coefficients: np.ndarray) -> np.ndarray:
        arm = arm_of(actuator, model, coefficients)
        return (tips(arm, actuator.pressure[use]) - actuator.tip[use]).ravel() / LENGTH

    found = least_squares(misses, start)
    if not found.success:
        raise ModelError(f'{actuator.name}: the model {model} found no fit: {found.message}')
    return found.x


def scored(actuator: Actuator, model: str) -> Score:
    """Fit all tips, then all but one in turn, for each one between the first and the last."""
    kind, order = MODELS[model]
    count = actuator.pressure.size
    # A circular arc turns by twice the angle under which its clamp sees its tip.
    turning = 2.0 * np.arctan2(actuator.tip[1:, 1], actuator.tip[1:, 0])
    bending = turning if kind == 'any' else np.array([turning[-1], 0.0])
    every = np.arange(1, count)  # at rest all models agree
    coefficients = fitted(actuator, model, np.concatenate([bending, np.zeros(order)]), every)
    arm = arm_of(actuator, model, coefficients)
    all_fitted = tips(arm, actuator.pressure)
    inner = range(1, count - 1) if kind != 'any' else range(0)
    left_out = np.empty((len(inner), 2))
    for row, index in enumerate(inner):
        others = fitted(actuator, model, coefficients, every[every != index])
        one = actuator.pressure[index : index + 1]
        left_out[row] = tips(arm_of(actuator, model, others), one)[0]
    return Score(
        arm=arm,
        fitted=all_fitted,
        fitted_error=missed(actuator, all_fitted, range(count)),
        left_out=left_out,
        left_out_error=missed(actuator, left_out, inner),
    )


def missed(actuator: Actuator, predicted: np.ndarray, rows: range) -> np.ndarray:
    """Distance of predicted from measured tips, % of the length; ModelError where none is."""
    if not np.all(np.isfinite(predicted)):
        raise ModelError(f'{actuator.name}: the fitted arm has no shape at a measured pressure')
    return 100.0 * np.linalg.norm(predicted - actuator.tip[list(rows)], axis=1) / LENGTH


def pressure_errors(actuator: Actuator, score: Score) -> tuple[np.ndarray, float]:
    """Errors of the pressure readings (n,) Pa that explain the tips best, and how well they do.

    The second is the share of the squared error of the tips that they take away; of errors in
    any direction they would take half.
    """
    moves = [tips(score.arm, actuator.pressure[1:] + h) for h in (-PRESSURE_STEP, PRESSURE_STEP)]
    slope = (moves[1] - moves[0]) / (2.0 * PRESSURE_STEP)
    miss = (actuator.tip - score.fitted)[1:]
    errors = np.sum(miss * slope, axis=1) / np.sum(slope**2, axis=1)
    return errors, float(np.sum((errors[:, None] * slope) ** 2) / np.sum(miss**2))
