"""The available experiments: 20 to 40 s each, in shares of the safe set."""

from __future__ import annotations

from collections.abc import Iterator

from pneunet_ros.diagnosis.experiment_design import Experiment

# It leaves the upper pressures to later ones: what a first loading does is seen but once.
BEGINNING = Experiment(
    words='without a load, a fast step up and down, then slow ramps, to 60 % of the pressure',
    corners=(
        (0, 0, 0, 0), (2, 0, 0, 0), (2.6, 0.55, 0, 0), (10, 0.55, 0, 0), (10.6, 0.2, 0, 0),
        (17, 0.2, 0, 0), (26, 0.6, 0, 0), (29, 0.6, 0, 0), (38, 0, 0, 0), (40, 0, 0, 0),
    ),
)  # fmt: skip
DIRECTIONS = (
    ((1.0, 0.0), 'along the arm at rest (E1)'),
    ((0.0, 1.0), 'across the arm at rest (E2)'),
    ((0.7, 0.7), 'between E1 and E2'),
    ((0.7, -0.7), 'between E1 and -E2'),
)
LEVELS = ((0.15, 0.85), (0.4, 1.0), (0.0, 0.6))  # of the pressure range, at which forces are swept


def experiments() -> Iterator[Experiment]:
    """Yield possible recordings of 20 to 40 s, in shares of the safe set."""
    yield Experiment(
        words='without a load, steps of pressure up and down with holds of 6 s',
        corners=(
            (0, 0, 0, 0), (2, 0, 0, 0), (2.5, 0.5, 0, 0), (8.5, 0.5, 0, 0), (9, 1, 0, 0),
            (15, 1, 0, 0), (15.5, 0.5, 0, 0), (21.5, 0.5, 0, 0), (22, 0, 0, 0), (28, 0, 0, 0),
        ),
    )  # fmt: skip
    yield Experiment(
        words='without a load, pressure repeatedly up and down, first in 2 s, then in 6 s',
        corners=tuple(
            (time, 0.9 * (index % 2) + 0.05, 0, 0)
            for index, time in enumerate((0, 1, 2, 3, 4, 5, 6, 9, 12, 15, 18, 21, 24))
        ),
    )
    for (x, y), words in DIRECTIONS:
        for low, high in LEVELS:
            yield Experiment(
                words=f'a force {words}, swept up and down at {100 * low:.0f} % and '
                f'{100 * high:.0f} % of the pressure',
                corners=(
                    (0, low, 0, 0), (7, low, x, y), (14, low, 0, 0), (16, high, 0, 0),
                    (23, high, x, y), (30, high, 0, 0),
                ),
            )  # fmt: skip
        yield Experiment(
            words=f'a constant force {words}, ramps to half and to full pressure, each twice',
            corners=(
                (0, 0, x, y), (5, 0.5, x, y), (10, 0, x, y), (15, 0.5, x, y), (20, 0, x, y),
                (25, 1, x, y), (30, 0, x, y), (35, 1, x, y), (40, 0, x, y),
            ),
        )  # fmt: skip
