"""The size of errors, estimated from frames: empirical Bayes of a variance component on a grid.

For a size L, the innovation of a frame has the covariance S + L^2 H D H^T, where S covers all
other errors; a single fit gives the likelihood of every L.

Source: noise of a Kalman filter from its innovations: Mehra, IEEE Trans. Automatic Control 15
(1970).
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from scipy.linalg.lapack import dsyev

MOST_CERTAIN = 1.0 - 1e-9  # largest share of an innovation due to one error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorGrowth:
    """Random walk of errors of unknown size since the last frame.

    size: the assumed size; grown (errors,): one sigma of the changes for a size of 1; seconds:
    elapsed time.
    """

    size: float
    grown: Array
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SizeGrid:
    """Grid of error sizes, with weights updated by every frame.

    sizes (sizes,); fall: exponent of the prior, by which larger sizes are less likely; time (s):
    forgetting time of the frames. first (sizes,): log weights before any frame.
    """

    sizes: tuple[float, ...]
    fall: float
    time: float
    first: Array = field(init=False)
    squares: Array = field(init=False)

    def __post_init__(self) -> None:
        """Compute the prior weights and the squared sizes."""
        sizes = np.array(self.sizes)
        object.__setattr__(self, 'first', freeze(-self.fall * np.log(sizes)))
        object.__setattr__(self, 'squares', freeze(np.square(sizes)))

    def size_of(self, log_weights: Array) -> float:
        """Return the rms size under the posterior weights."""
        weights = np.exp(log_weights - log_weights.max())
        return math.sqrt(float(weights @ self.squares / weights.sum()))

    def after(
        self, log_weights: Array, growth: ErrorGrowth, information: tuple[Array, Array]
    ) -> Array:
        """Return the log weights after a frame.

        information: H^T S^-1 v (errors,) and H^T S^-1 H (errors, errors) of the changes for a size
        of 1; S includes the assumed size.
        """
        score, precision = information
        assumed = growth.size
        share, axes, _ = dsyev(assumed**2 * precision, lower=1)
        scores, precise = [], []
        for one, projection in zip(share.tolist(), (score @ axes).tolist(), strict=True):
            without = 1.0 / (1.0 - min(max(one, 0.0), MOST_CERTAIN))  # of S without these errors
            scores.append((without * projection) ** 2)
            precise.append(without * one / assumed**2)
        likelihood = np.array(
            [
                0.5
                * sum(
                    size**2 * squared / (1.0 + size**2 * known) - math.log1p(size**2 * known)
                    for squared, known in zip(scores, precise, strict=True)
                )
                for size in self.sizes
            ]
        )
        kept = math.exp(-growth.seconds / self.time)
        after = kept * log_weights + (1.0 - kept) * self.first + likelihood
        return freeze(after - after.max())
