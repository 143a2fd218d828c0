"""Make the picture of the page "Several arms in one process": a grasp beside its truth.

    python docs/images/make_gripper.py

The grasp is one of `acceptance/grasp.py`, in MuJoCo.
"""

from __future__ import annotations

from pathlib import Path
import sys

import matplotlib

matplotlib.use('Agg')
from matplotlib import pyplot as plt
import numpy as np

FOLDER = Path(__file__).resolve().parent
sys.path[:0] = [str(FOLDER.parents[1] / name) for name in ('acceptance', 'test')]
SEED = 1


def main() -> None:
    """Draw width and force over time."""
    from grasp import CLOSING, grasp, OPEN

    diameter, rows = grasp(SEED)
    when = np.array([row[0] for row in rows])
    force = 1e3 * np.array([row[1][1].sum() for row in rows])
    width, said = (1e3 * np.array([getattr(row[2], name) for row in rows])
                   for name in ('width', 'force'))  # fmt: skip
    touching = np.array([row[2].touching for row in rows])
    begun = when[np.argmax(touching >= 2)]
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.0), dpi=110)
    axes[0].axhline(1e3 * diameter, color='0.3', ls='--', lw=1.2, label='diameter of the cylinder')
    axes[0].plot(when, width, color='tab:blue', lw=1.6, label='gripper/state')
    axes[0].set_ylabel('width, mm')
    axes[1].plot(when, force, color='0.3', ls='--', lw=1.2, label='contact forces in MuJoCo')
    axes[1].plot(when, said, color='tab:blue', lw=1.6, label='gripper/state')
    axes[1].set_ylabel('sum of forces, mN')
    axes[0].set_ylim(bottom=36.0)
    axes[1].set_ylim(bottom=-14.0)
    for axis in axes:
        axis.axvspan(begun, when[-1], color='tab:orange', alpha=0.12, lw=0, label='seen to touch')
        axis.axvspan(OPEN, OPEN + CLOSING, ymax=0.03, color='0.5', lw=0)
        axis.text(
            OPEN + 0.5 * CLOSING, 0.045, 'pressure rises', fontsize=8, ha='center', va='bottom',
            color='0.35', transform=axis.get_xaxis_transform(),
        )  # fmt: skip
        axis.set_xlabel('time, s')
        axis.legend(
            frameon=False, fontsize=8, loc='upper right' if axis is axes[0] else 'upper left'
        )
        axis.spines[['top', 'right']].set_visible(False)
    figure.tight_layout()
    figure.savefig(FOLDER / 'gripper_grasp.png')


if __name__ == '__main__':
    main()
