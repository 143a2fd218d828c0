"""Look at recordings in Rerun: the arm from above, the camera, the pressure.

    pip install rerun-sdk
    python examples/look_in_rerun.py FILE.mcap [FILE.mcap ...] [--save FILE.rrd]

Rerun reads the messages itself; this script only adds the frame in which to draw them. The files
are outputs of `pneunet track --with-images` and `pneunet replay` for the same run, and are shown
together.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import rerun
from rerun import blueprint

BASE_FRAME = 'pneunet_base'
ABOVE = (0.05, 0.03, 0.25)  # m, position of the viewer
LOOKED_AT = (0.05, 0.03, 0.0)  # m, the middle of an arm of some 10 cm


def draw_layout(namespace: str) -> blueprint.Blueprint:
    """Return a layout: the arm in its base frame, x to the right; camera; pressure."""
    return blueprint.Blueprint(
        blueprint.Horizontal(
            blueprint.Spatial3DView(
                name='arm',
                origin='/',
                # The recording does not contain the pose of the frame of the image.
                contents=[
                    '$origin/**',
                    f'- {namespace}/image_raw/**',
                    f'- {namespace}/camera_info',
                ],
                spatial_information=blueprint.SpatialInformation(target_frame=BASE_FRAME),
                eye_controls=blueprint.EyeControls3D(
                    position=ABOVE, look_target=LOOKED_AT, eye_up=(0.0, 1.0, 0.0)
                ),
            ),
            blueprint.Vertical(
                blueprint.Spatial2DView(name='camera', origin=f'{namespace}/image_raw/compressed'),
                blueprint.TimeSeriesView(name='pressure', origin=f'{namespace}/pressure'),
            ),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )


def main() -> None:
    """Open the viewer, or write a file for it."""
    parser = argparse.ArgumentParser(description='look at recordings of one run in Rerun')
    parser.add_argument('recordings', type=Path, nargs='+', metavar='FILE.mcap')
    parser.add_argument(
        '--namespace', default='/pneunet', help='namespace of the topics (default: /pneunet)'
    )
    parser.add_argument(
        '--save',
        type=Path,
        metavar='FILE.rrd',
        help='write this file instead of opening the viewer',
    )
    arguments = parser.parse_args()
    for recording in arguments.recordings:
        if not recording.is_file():
            parser.error(f'{recording} does not exist: give an .mcap file')
    rerun.init('pneunet', spawn=arguments.save is None)
    if arguments.save is not None:
        rerun.save(arguments.save)
    rerun.send_blueprint(draw_layout(arguments.namespace))
    for recording in arguments.recordings:
        rerun.log_file_from_path(recording)


if __name__ == '__main__':
    main()
