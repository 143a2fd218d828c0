"""The available experiments: 20 to 40 s each, in shares of the safe set."""

from __future__ import annotations

from collections.abc import Iterator

from pneunet_ros.exploration.experiment_design import Experiment

# Upper pressures are left to later experiments: a first loading can be observed only once.
BEGINNING = Experiment(
    words='without a load, a fast step up and down, then slow ramps, to 60 % of the pressure',
    corners=(
        (0, 0, 0, 0), (2, 0, 0, 0), (2.6, 0.55, 0, 0), (10, 0.55, 0, 0), (10.6, 0.2, 0, 0),
        (17, 0.2, 0, 0), (26, 0.6, 0, 0), (29, 0.6, 0, 0), (38, 0, 0, 0), (40, 0, 0, 0),
    ),
)  # fmt: skip
DIRECTIONS = (  # each followed by its opposite
    ((1.0, 0.0), 'along the arm at rest (E1)'),
    ((-1.0, 0.0), 'along the arm at rest (-E1)'),
    ((0.0, 1.0), 'across the arm at rest (E2)'),
    ((0.0, -1.0), 'across the arm at rest (-E2)'),
    ((0.7, 0.7), 'between E1 and E2'),
    ((-0.7, -0.7), 'between -E1 and -E2'),
    ((0.7, -0.7), 'between E1 and -E2'),
    ((-0.7, 0.7), 'between -E1 and E2'),
)
LEVELS = ((0.15, 0.85), (0.4, 1.0), (0.0, 0.6))  # of the pressure range, at which forces are swept


def experiments(loaded: tuple[float, float] = (0.0, 1.0)) -> Iterator[Experiment]:
    """Yield possible recordings of 20 to 40 s, in shares of the safe set.

    loaded: shares of the pressure range, between which the arm may be loaded.
    """
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
    first, half, last = (min(max(share, loaded[0]), loaded[1]) for share in (0.0, 0.5, 1.0))
    for (x, y), words in DIRECTIONS:
        for level in LEVELS:
            low, high = (min(max(share, first), last) for share in level)
            yield Experiment(
                words=f'a force {words}, swept up and down at {100 * low:.0f} % and '
                f'{100 * high:.0f} % of the pressure',
                corners=(
                    (0, low, 0, 0), (7, low, x, y), (14, low, 0, 0), (16, high, 0, 0),
                    (23, high, x, y), (30, high, 0, 0),
                ),
            )  # fmt: skip
        yield Experiment(
            words=f'a constant force {words}, ramps from {100 * first:.0f} % to '
            f'{100 * half:.0f} % and to {100 * last:.0f} % of the pressure, each twice',
            corners=(
                (0, first, x, y), (5, half, x, y), (10, first, x, y), (15, half, x, y),
                (20, first, x, y), (25, last, x, y), (30, first, x, y), (35, last, x, y),
                (40, first, x, y),
            ),
        )  # fmt: skip
