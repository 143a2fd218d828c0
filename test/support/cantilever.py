"""A cantilever by shooting with scipy: a truth that shares nothing with the solver."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import cos, sin

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


@dataclass(frozen=True, kw_only=True)
class Cantilever:
    """Length m, EI N m^2, kappa0 1/m, weight N/m (downwards), EA N, rigid cap m."""

    length: float
    stiffness: float
    curvature: float = 0.0
    weight: float = 0.0
    axial_stiffness: float = np.inf
    cap: float = 0.0

    def shape(self, force, moment=0.0, places=None) -> np.ndarray:
        """Return x, y (m) and theta (rad) at places (m), else at the tip, (3, places)."""
        places = np.array([self.length + self.cap] if places is None else places, np.float64)
        return self.solved(tuple(map(float, force)), float(moment), tuple(places.tolist())).copy()

    @cache  # noqa: B019, of a few truths that several tests bend alike
    def solved(self, force, moment, places) -> np.ndarray:
        """Return the shape at these places."""
        places = np.array(places)

        def slopes(s, state):
            _, _, theta, bending = state
            n1, n2 = force[0], force[1] - self.weight * (self.length - s)
            cosine, sine = cos(theta), sin(theta)
            stretch = 1.0 + (n1 * cosine + n2 * sine) / self.axial_stiffness
            across = cosine * n2 - sine * n1
            return [
                cosine * stretch,
                sine * stretch,
                self.curvature + bending / self.stiffness,
                -stretch * across,
            ]

        def integrated(start, at=None):
            return solve_ivp(
                slopes,
                (0.0, self.length),
                [0.0, 0.0, 0.0, start],
                rtol=1e-11,
                atol=1e-13,
                t_eval=at,
            ).y

        def gap(start):
            _, _, theta, bending = integrated(start)[:, -1]
            across = np.cos(theta) * force[1] - np.sin(theta) * force[0]
            return bending - moment - self.cap * across

        most = (np.hypot(*force) + self.weight * self.length) * (self.length + self.cap)
        most += abs(moment) + 1e-9
        root = brentq(gap, -most, most, xtol=1e-15)
        soft = np.minimum(places, self.length)
        grid, which = np.unique(np.append(soft, self.length), return_inverse=True)
        x, y, theta = integrated(root, grid)[:3][:, which[:-1]]
        beyond = places - soft
        return np.array([x + beyond * np.cos(theta), y + beyond * np.sin(theta), theta])
