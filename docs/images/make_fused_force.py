"""Make the picture of the fusion's page: force read and force estimated over the lab day.

The model is calibrated from the first two recordings, as in the walkthrough. The fusion is given
pressure and targets alone; the force sensor is what it is compared with.
"""

from __future__ import annotations

from pathlib import Path
import tempfile

import numpy as np
from pneunet_ros.cli.main import main as pneunet
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.messages.builders import nanoseconds
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.reports.style import draw_errors, FIRST, legend, MEASURED, panels, same_height

PICTURE = Path(__file__).resolve().parent / 'fused_force.png'
DAY = {
    'unloaded': 'unloaded, for calibration',
    'loaded': 'loaded, for calibration',
    'heldout': 'held out',
}
MILLI = 1000.0


def fused(name: str, model: str, scratch: Path) -> tuple[Array, Array, Array, Array]:
    """Return stamps (ns), force (n, 2) N, its standard deviation (n, 2), and the wrench read.

    The estimates are the first ones after each frame. The last are rows of stamp (ns) and force;
    an unloaded arm has no force sensor.
    """
    recording, output = share_path(f'bags/lab_day/{name}.mcap'), scratch / f'{name}.mcap'
    words = ['replay', str(recording), '--fuse', '--no-wrench', '--model', model]
    if pneunet([*words, '--output', str(output)]) != 0:
        raise SystemExit(f'{name} was not fused')
    found = open_recording(output)
    clouds = [item.message for item in found.messages(['/pneunet/fused/end_force'])]
    stamp = np.array([nanoseconds(cloud.header.stamp) for cloud in clouds], dtype=float)
    points = np.concatenate([cloud_points(cloud) for cloud in clouds])
    force = np.column_stack([points['fx'], points['fy']])
    std = np.sqrt(np.column_stack([points['cov_xx'], points['cov_yy']]))
    source = open_recording(recording)
    frames = [
        nanoseconds(item.message.header.stamp) for item in source.messages(['/pneunet/targets'])
    ]
    after = np.unique(np.searchsorted(stamp, np.array(frames, dtype=float)))
    after = after[after < stamp.size]
    wrenches = [topic.name for topic in source.topics if topic.name.endswith('end_wrench')]
    read = [
        (nanoseconds(one.header.stamp), one.wrench.force.x, one.wrench.force.y)
        for one in (item.message for item in source.messages(wrenches))
    ]
    return stamp[after], force[after], std[after], np.array(read, dtype=float).reshape(-1, 3)


def main() -> None:
    """Calibrate, fuse and draw."""
    figure, axes = panels(len(DAY), rows=2, height=5.6)
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        model = str(scratch / 'model.yaml')
        day = {name: str(share_path(f'bags/lab_day/{name}.mcap')) for name in DAY}
        words = ['--unloaded', day['unloaded'], '--loaded', day['loaded'], '--output', model]
        if pneunet(['calibrate', *words]) != 0:
            raise SystemExit('no model')
        for column, (name, title) in enumerate(DAY.items()):
            stamp, force, std, read = fused(name, model, scratch)
            time = (stamp - stamp[0]) / NANOSECONDS_PER_SECOND
            for row in range(2):
                panel = axes[row * len(DAY) + column]
                draw_errors(
                    panel, time, MILLI * force[:, row], MILLI * std[:, row],
                    markersize=2.5, markeredgewidth=0.0,
                    color=FIRST, ecolor=f'{FIRST}55', label='estimated, with 2 sigma',
                )  # fmt: skip
                if read.size:
                    at = (read[:, 0] - stamp[0]) / NANOSECONDS_PER_SECOND
                    panel.plot(
                        at, MILLI * read[:, 1 + row], color=MEASURED, linewidth=0.8, zorder=5,
                        label='read by the force sensor',
                    )  # fmt: skip
                if row == 0:
                    panel.set_title(title, fontsize=11)
                else:
                    panel.set_xlabel('time (s)')
    for row, label in enumerate(('F1 (mN)', 'F2 (mN)')):
        rows = axes[row * len(DAY) : (row + 1) * len(DAY)]
        same_height(rows)
        rows[0].set_ylabel(label)
    legend(axes[1 + len(DAY)], loc='upper left')
    figure.savefig(PICTURE, dpi=110)


if __name__ == '__main__':
    main()
