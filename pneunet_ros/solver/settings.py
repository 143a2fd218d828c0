"""Tuning constants of the solver: meshes, Newton's method, cold starts.

Names in capitals are constants of compiled kernels. Changing one recompiles the kernels, because
this line makes this file one of those with a core.kernels.jit import (see its `fingerprint`).
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning

ACCEPTED = 1e-10  # rad; residual that still counts as equilibrium where rounding stops Newton
FEWEST_PANELS = 6.0  # per length of the rod: the intrinsic curvature has detail of this size
NEWTON_HALVINGS = 8  # of a step without improvement
# Descent in energy (all invented): largest step, and the step below which Newton's method takes
# over, rad.
LARGEST_STEP, SETTLED = 0.6, 0.02
DESCENT_ITERATIONS, DESCENT_HALVINGS = 60, 12
# Largest number of Newton steps on one mesh: convergence is quadratic, or fails.
NEWTON_ITERATIONS = 25
DETAIL_DEGREE = 5  # of the Legendre term that measures the detail, see `resolution`
MOST_PANELS = 400  # of a mesh: ends the halving of panels where rounding prevents convergence
TURNED = 1e-10  # rad, between a push and the normal of the arm: as exact as ACCEPTED
FRAME_ITERATIONS = 12  # largest number of Newton steps from a neighbor, before a new start
# No figure of acceptance/sweep.py moves when this is halved or doubled.
SHORTEST = 0.05  # smallest stretch allowed under rest strain and load


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """Settings of the mesh and of Newton's method for the rod."""

    tolerance: float = tuning(
        1e-13,
        "residual at which Newton's method stops",
        unit='rad',
        source='convention: rounding of float64; sweep: no figure by more than 6e-17',
    )
    decay_per_panel: float = tuning(
        0.8, 'longest panel', unit='decay lengths sqrt(B/F)', source='sweep'
    )
    turn_per_panel: float = tuning(
        0.5, 'largest rotation over a panel', unit='rad', source='sweep'
    )
    finest_detail: float = tuning(
        1e-6,
        'last Legendre term of a fine mesh',
        unit='of the length',
        source='sweep: halved and doubled: no figure by more than 3e-8',
    )
    # The smallest ratio of the detail on half as many panels, by its degree.
    coarser: float = 2.0**DETAIL_DEGREE


SOLVER = SolverSettings()
