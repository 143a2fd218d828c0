"""The gap between a model and recordings, in meters, and the floor that noise puts under it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pneunet_ros.arm import Arm
from pneunet_ros.calibration.drive import drives_of
from pneunet_ros.calibration.held_out import Score, score
from pneunet_ros.diagnosis.answer import Misfit
from pneunet_ros.diagnosis.design import Design
from pneunet_ros.diagnosis.linear import Linear
from pneunet_ros.run import Run
from pneunet_ros.shape import Array


def scores(arm: Arm, runs: Sequence[Run]) -> tuple[Score, ...]:
    """Score every run; what the arm remembers is carried on from run to run by their stamps."""
    pairs = zip(runs, drives_of(arm, runs), strict=True)
    return tuple(score(arm, run, drive) for run, drive in pairs)


def misfit(found: Sequence[Score], linear: Linear, which: range, design: Design) -> Misfit:
    """Return what scores of runs come to; chi squared is that of the linear problem's runs."""
    squares = np.concatenate([item.error[np.isfinite(item.error)] ** 2 for item in found])
    apart = np.concatenate([distances(item.error) for item in found])
    residual = linear.best_residuals()
    chi = sum(float(residual[place] @ residual[place]) for place in which)
    count = sum(2 * int(design.blocks[place].run.seen.sum()) for place in which)
    return Misfit(
        rms=float(np.sqrt(squares.mean())) if squares.size else float('nan'),
        p95=float(np.percentile(apart, 95.0)) if apart.size else float('nan'),
        chi_squared=chi / max(count, 1),
    )


def distances(error: Array) -> Array:
    """Return the length of errors (frames, 2, targets) where they are known."""
    apart = np.hypot(error[:, 0], error[:, 1]).ravel()
    return apart[np.isfinite(apart)]


def noise_floor(design: Design, which: range) -> float:
    """Return the rms (m) that a perfect model would have: white noise, placement, readings."""
    noise, squares, count = design.noise, 0.0, 0
    for place in which:
        block = design.blocks[place]
        whitening = block.whitening
        seen = 2 * int(block.run.seen.sum())
        # Of readings and drift: what whitening takes off, back in meters.
        sizes = 1.0 / (1.0 - whitening.shrink) ** 2 - 1.0
        squares += noise.target_std**2 * float(sizes.sum())
        squares += seen * (noise.target_std**2 + noise.placement_std**2)
        count += seen
    return float(np.sqrt(squares / max(count, 1)))


def closed(before: float, after: float, floor: float) -> float | None:
    """Return the share of the removable gap that is closed; None where there was none."""
    removable = before**2 - floor**2
    if removable <= 0.0:
        return None
    return 1.0 - (after**2 - floor**2) / removable
