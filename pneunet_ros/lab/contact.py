"""A lab arm that leans against a peg: how hard, so that energy is least with the peg's in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.chain import Chain, Lying, lying

SETTLED = 1e-10  # m, between how far the peg is pushed in and what its push says
MOST_STEPS = 60


def leaning(chain: Chain, start: Array | None = None) -> Lying:
    """Return the chain in equilibrium as `lying` does, with the push of its peg where it touches.

    The peg acts on the joint nearest to its place, along -y. RequestError where no push balances.
    """
    free, peg = lying(chain, start), chain.peg
    if peg is None or peg.stiffness <= 0.0:
        return free
    joint = round(min(peg.place, chain.length) / chain.element)
    before = np.arange(chain.rest.shape[1])[:, None] < joint
    gap = free.y[:, joint] - peg.height
    touching = gap > 0.0
    if not touching.any():
        return free
    # The less the arm gives way, the harder the push, up to that of an arm that does not at all.
    low, high = np.zeros(gap.size), peg.stiffness * np.maximum(gap, 0.0)
    bending = 3.0 * chain.rigidity.min(axis=1) / max(peg.place, chain.element) ** 3
    push = np.where(touching, np.maximum(gap, 0.0) / (1.0 / peg.stiffness + 1.0 / bending), 0.0)
    tried, left = np.zeros(gap.size), np.where(touching, gap, 0.0)
    for _ in range(MOST_STEPS):
        pushed = replace(chain, line=chain.line - push[:, None, None] * before * [0.0, 1.0])
        shape = lying(pushed, start)
        beyond = shape.y[:, joint] - peg.height - push / peg.stiffness
        beyond = np.where(touching, beyond, 0.0)
        if np.abs(beyond).max() < SETTLED:
            return shape
        low, high = np.where(beyond > 0.0, push, low), np.where(beyond < 0.0, push, high)
        change = np.where(left == beyond, np.inf, left - beyond)
        step = beyond * (push - tried) / change
        tried, left = push, beyond
        wanted = push + step
        within = (wanted > low) & (wanted < high) & (np.abs(beyond) >= SETTLED)
        halved = np.minimum(0.5 * (low + high), 2.0 * low + push)
        push = np.where(within, wanted, np.where(np.abs(beyond) < SETTLED, push, halved))
    frame = int(np.argmax(np.abs(beyond)))
    raise RequestError(
        f'the lab arm finds no equilibrium at its peg in frame {frame}: use a softer peg or '
        'another place'
    )
