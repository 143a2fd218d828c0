"""The numbers by which the solver decides: meshes, Newton's method, ways to a first solution.

The capitals are constants of compiled kernels. A change of one compiles the kernels anew, as this
line makes this file one of those with a core.kernels.jit import (see its `fingerprint`).
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning

ACCEPTED = 1e-10  # rad; residual that still counts as equilibrium where rounding stops Newton
FEWEST_PANELS = 6.0  # per length of the rod: the intrinsic curvature has detail of this size
NEWTON_HALVINGS = 8  # of a step that does not help
# Descent in energy (all invented): largest step, and the step that leaves the rest to Newton, rad.
LARGEST_STEP, SETTLED = 0.6, 0.02
DESCENT_ITERATIONS, DESCENT_HALVINGS = 60, 12


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """How the rod is meshed and brought to equilibrium."""

    tolerance: float = tuning(1e-13, 'residual Newton aims at', unit='rad')
    iterations: int = tuning(25, 'most Newton steps on one mesh')
    decay_per_panel: float = tuning(0.8, 'longest panel', unit='decay lengths sqrt(B/F)')
    turn_per_panel: float = tuning(0.5, 'largest rotation over a panel', unit='rad')
    finest_detail: float = tuning(1e-6, 'last Legendre term of a fine mesh', unit='of the length')
    refined: float = tuning(
        1.5, 'panels from which on a mesh was refined', unit='those of one that was not'
    )
    coarser: float = tuning(32.0, 'detail on half as many panels, at least', unit='detail')
    most_panels: int = tuning(400, 'panels of the finest mesh')
    shortest: float = tuning(0.05, 'least stretch that rest strain may leave')
    first_load_step: float = tuning(0.05, 'first step of load continuation', unit='of the load')
    least_load_step: float = tuning(
        1e-4, 'step at which continuation gives up', unit='of the load'
    )
    load_step_iterations: int = tuning(10, 'most Newton steps at one load')
    easy_iterations: int = tuning(4, 'Newton steps after which the load step grows')
    load_step_growth: float = tuning(1.5, 'growth of an easy load step')
    turned: float = tuning(
        1e-10, 'between where a push points and the normal of the arm there', unit='rad'
    )
    most_turns: int = tuning(30, 'most solves with pushes that turn with the arm')
    frame_iterations: int = tuning(12, 'most Newton steps from the frame before')
    batch_iterations: int = tuning(8, 'Newton steps of a batch')
    batch_tolerance: float = tuning(1e-11, 'sum of residuals a batch aims at', unit='rad')


SOLVER = SolverSettings()
