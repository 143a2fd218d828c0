"""The bench of grasps: a gripper that always or never sees a touch misses its goals."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")

import grasp as bench

FRAMES = np.arange(0.0, bench.OPEN + bench.CLOSING + bench.HELD, 1.0 / bench.FRAMES)
BEGUN = bench.OPEN + 0.5 * bench.CLOSING


def numbers(touching, first=BEGUN):
    """Return what is judged of right forces and widths, and of touches (fingers) at a time.

    first: when the first finger touches.
    """
    rows = []
    for when in FRAMES.tolist():
        force = np.full(bench.FINGERS, 0.1 if when >= BEGUN else 0.0)
        force[0] = 0.1 if when >= first else 0.0
        said = SimpleNamespace(width=0.04, force=float(force.sum()), touching=touching(when))
        rows.append((when, np.stack([force, force]), said, when + bench.LATE))
    return bench.judged(0.04, rows)


def missed(found):
    return {name for name, goal in bench.GOALS.items() if not found[name] <= goal}


def test_touches_count_from_when_they_begin():
    right = numbers(lambda when: bench.FINGERS * (when >= BEGUN))
    assert not missed(right) and right['seen_after_ms'] == pytest.approx(1e3 * bench.LATE)
    late = numbers(lambda when: bench.FINGERS * (when >= BEGUN + 0.2))
    assert missed(late) == {'seen_after_ms'}
    assert missed(numbers(lambda when: bench.FINGERS)) == {'false_touches'}
    before = numbers(lambda when: bench.FINGERS * (when >= BEGUN - 0.5), first=BEGUN - 0.5)
    assert missed(before) == {'false_touches'}
    never = numbers(lambda when: 0)
    assert never['seen_after_ms'] == math.inf and math.isnan(never['closing_width_mm'])
    assert missed(never) == {'seen_after_ms'}
