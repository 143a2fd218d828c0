"""Compile the kernels once, before several processes want them at the same time.

Processes that each compile a part of the kernels differ in what is inlined where, and with it in
the last digits; what one process has compiled is read from the disk by all the others.
"""

from __future__ import annotations

import sys
import tempfile

from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path

if __name__ == '__main__':
    with tempfile.TemporaryDirectory() as folder:
        loaded = str(share_path('bags/lab_day/loaded.mcap'))
        demo = str(share_path('bags/camera_demo'))
        model = str(share_path('config/lab_arm.yaml'))
        commands = (
            ['replay', loaded, '--model', model, '--output', f'{folder}/replay.mcap', '--json'],
            ['track', demo, '--output', f'{folder}/track.mcap', '--json'],
        )
        sys.exit(max(main(command) for command in commands))
