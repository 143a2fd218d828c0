"""Baselines: textbook methods on the same blind recordings.

All start from the calibrated model of the diagnosis, base frozen, noise taken as white:

- `staged`: the residual regressed on each effect, the best by BIC;
- `stepwise`: forward by BIC, as many as lower it, no gate;
- `pysindy`: the modes of the residual as sparse functions of p, F, direction (PySINDy), the effect
  whose answer is nearest to what they explain;
- `gaussian_process`: the residual as a Gaussian process of p, F, direction and s; names nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import time
import warnings

import numpy as np
from pneunet_ros.diagnosis.result import Diagnosis

from blind.responses import Candidate, prepared, Table
from blind.scoring import Row
from blind.trials import Trial

MOST_STEPS = 5  # effects of the stepwise search
MODES = 3  # of the residual
THRESHOLD = 0.1  # of PySINDy, in standard deviations of a mode
POINTS = 400  # that the Gaussian process learns from
SEED = 5

Found = tuple[list[str], np.ndarray]  # names, and the correction of the held-out rows


def baselines_of(trial: Trial, diagnosis: Diagnosis) -> Row:
    """Return for every method the names it says, strongest first, and what it leaves held out."""
    learned, held, candidates = prepared(trial, diagnosis)
    methods: dict[str, Callable[[Table, Table, Sequence[Candidate]], Found]] = {
        'staged': staged,
        'stepwise': stepwise,
        'pysindy': pysindy,
        'gaussian_process': gaussian_process,
    }
    row: Row = {}
    for name, method in methods.items():
        started = time.perf_counter()
        try:
            names, correction = method(learned, held, candidates)
        except ImportError as error:
            row[name] = {'names': None, 'absent': str(error)}
            continue
        row[name] = {
            'names': names,
            'held_out': held.rms(correction),
            'seconds': time.perf_counter() - started,
        }
    return row


def regressed(table: Table, chosen: Sequence[Candidate]) -> tuple[float, np.ndarray]:
    """Return BIC and coefficients of the residual on the columns of some candidates."""
    count = table.residual.size
    if not chosen:
        return count * float(np.log(np.mean(table.residual**2))), np.zeros(0)
    columns = np.concatenate([item.training for item in chosen], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    found, *_ = np.linalg.lstsq(columns / scale, table.residual, rcond=1e-10)
    left = table.residual - columns @ (found / scale)
    bic = count * float(np.log(np.mean(left**2))) + found.size * float(np.log(count))
    return bic, found / scale


def corrected(held: Table, chosen: Sequence[Candidate], coefficients: np.ndarray) -> np.ndarray:
    """Return the correction of the held-out rows."""
    if not chosen:
        return np.zeros(held.residual.size)
    return np.concatenate([item.held_out for item in chosen], axis=1) @ coefficients


def staged(learned: Table, held: Table, candidates: Sequence[Candidate]) -> Found:
    """Take the one effect of least BIC, none where none lowers it."""
    best = min([[], *([item] for item in candidates)], key=lambda one: regressed(learned, one)[0])
    correction = corrected(held, best, regressed(learned, best)[1])
    return [item.name for item in best], correction


def stepwise(learned: Table, held: Table, candidates: Sequence[Candidate]) -> Found:
    """Add the effect that lowers BIC most, while one does."""
    chosen: list[Candidate] = []
    bic, coefficients = regressed(learned, chosen)
    while len(chosen) < MOST_STEPS:
        names = {item.name for item in chosen}
        trials = [[*chosen, item] for item in candidates if item.name not in names]
        best = min(trials, key=lambda one: regressed(learned, one)[0])
        if regressed(learned, best)[0] >= bic:
            break
        chosen = best
        bic, coefficients = regressed(learned, chosen)
    return [item.name for item in chosen], corrected(held, chosen, coefficients)


def pysindy(learned: Table, held: Table, candidates: Sequence[Candidate]) -> Found:
    """Find sparse functions of the causes for modes of the residual, then the nearest effect."""
    import pysindy as ps

    maps, causes = zip(*(as_frames(table) for table in (learned, held)), strict=True)
    _, _, rows = np.linalg.svd(maps[0], full_matrices=False)
    modes = rows[:MODES]
    scores = maps[0] @ modes.T
    spread = scores.std(axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # of a library that calls names of its own deprecated
        library = ps.PolynomialLibrary(degree=2).fit(causes[0])
        features = [np.asarray(library.transform(one)) for one in causes]
        optimizer = ps.STLSQ(threshold=THRESHOLD).fit(features[0], scores / spread)
    explained = [(one @ optimizer.coef_.T * spread) @ modes for one in features]
    if not np.any(optimizer.coef_[:, 1:]):
        return [], np.zeros(held.residual.size)
    wanted = as_rows(learned, explained[0])

    def nearness(item: Candidate) -> float:
        basis, _ = np.linalg.qr(item.training)
        return float(np.linalg.norm(basis.T @ wanted) / np.linalg.norm(wanted))

    return [max(candidates, key=nearness).name], as_rows(held, explained[1])


def as_frames(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals (frames, 2 targets), 0 where not seen, and the causes of frames."""
    maps, causes, start = [], [], 0
    for mask in table.mask:
        count = int(mask.sum())
        values, each = np.zeros(mask.shape), np.zeros((len(mask), 4))
        values[mask] = table.residual[start : start + count]
        each[np.nonzero(mask)[0]] = table.causes[start : start + count, :4]
        maps.append(values.reshape(len(mask), -1))
        causes.append(each)
        start += count
    return np.concatenate(maps), np.concatenate(causes)


def as_rows(table: Table, maps: np.ndarray) -> np.ndarray:
    """Return values (frames, 2 targets) as rows of a table."""
    return maps[np.concatenate([mask.reshape(len(mask), -1) for mask in table.mask])]


def gaussian_process(learned: Table, held: Table, candidates: Sequence[Candidate]) -> Found:
    """Predict each coordinate of the residual from its causes."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, RBF, WhiteKernel

    correction = np.zeros(held.residual.size)
    random = np.random.default_rng(SEED)
    for coordinate in (0, 1):
        rows = np.flatnonzero(learned.coordinate == coordinate)
        some = random.choice(rows, min(POINTS, rows.size), replace=False)
        kernel = ConstantKernel() * RBF(np.ones(learned.causes.shape[1])) + WhiteKernel(0.1)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of hyperparameters at their bounds
            model = GaussianProcessRegressor(kernel, normalize_y=True, random_state=SEED)
            model.fit(learned.causes[some], 1e3 * learned.residual[some])
        there = held.coordinate == coordinate
        correction[there] = 1e-3 * model.predict(held.causes[there])
    return [], correction
