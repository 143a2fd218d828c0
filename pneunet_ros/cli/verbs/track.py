"""`pneunet track`: camera images -> targets, measured centerline and curvature."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from pneunet_ros.cli import verb
from pneunet_ros.cli.table_options import add_table_options, AUTO
from pneunet_ros.recordings.file_kinds import FOLDER_RATE, NO_LENS


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'source',
        type=Path,
        metavar='REC_OR_IMAGES',
        help='an .mcap file, a rosbag2 folder, a video file, or a folder of images',
    )
    verb.add_model(parser)
    parser.add_argument(
        '--camera',
        type=Path,
        metavar='FILE',
        help='camera file, YAML: working plane, clamp and appearance of the targets (default: the '
        'shipped camera.yaml)',
    )
    parser.add_argument(
        '--camera-info',
        metavar='FILE',
        help='lens calibration, YAML as written by camera_calibration, instead of the '
        f"recording's camera_info; `{NO_LENS}`: the images have no distortion",
    )
    parser.add_argument(
        '--output',
        type=Path,
        metavar='OUT.mcap',
        help='write the tracker topics, and the other topics of a recording, here',
    )
    verb.add_overwrite(parser)
    parser.add_argument(
        '--with-images', action='store_true', help='copy the images of a recording, too'
    )
    parser.add_argument(
        '--preview',
        type=Path,
        metavar='FILE',
        help='draw the overlay: some frames and plots (.png), or a page to scrub through, with a '
        'verdict (.html)',
    )
    parser.add_argument(
        '--clamp-pixel',
        type=float,
        nargs=2,
        metavar=('U', 'V'),
        help='approximate pixel of the target at the clamp, in the image at rest (default: from '
        'the camera file, or else the left end of the row)',
    )
    parser.add_argument(
        '--estimates',
        type=Path,
        metavar='REC',
        help=(
            'draw the predicted centerlines of this recording (from `replay`) on the page '
            '(default: those recorded with the images, if any)'
        ),
    )
    parser.add_argument(
        '--table',
        type=Path,
        metavar='FILE.csv',
        help='write a table with one row per target and frame',
    )
    parser.add_argument(
        '--rate',
        type=float,
        metavar='HZ',
        help='frames per second of a video or a folder (default: as stated in the video; '
        f'{FOLDER_RATE:g} for a folder)',
    )
    verb.add_topics(parser, 'image_raw=/my/topic')
    add_film_options(parser)


def add_film_options(parser: ArgumentParser) -> None:
    """Add the options for a film with a table of readings."""
    group = parser.add_argument_group('a film with a table of readings')
    group.add_argument(
        '--readings',
        type=Path,
        metavar='TABLE.csv',
        help='pressures, and end forces if any, that were read while the video or the images '
        'were taken; OUT.mcap is then a recording for calibrate and diagnose',
    )
    group.add_argument(
        '--delay',
        metavar='S',
        help='a frame at t in the film shows the arm at t - S in the table, each counted from '
        f'its first frame or row; {AUTO}: estimated from how the motion follows the '
        f'pressure (default: {AUTO})',
    )
    group.add_argument(
        '--end-load',
        nargs=2,
        metavar=('FX', 'FY'),
        help='a known constant end load (base frame), such as a weight that hung straight down '
        'from the tip, if no sensor measured it: N, or with a unit, e.g. 20g',
    )
    group.add_argument(
        '--string',
        nargs=3,
        metavar=('TENSION', 'X', 'Y'),
        help='a known tension of a thread from the tip over a fixed eye or pulley at X, Y (base '
        'frame; m, or with a unit, e.g. 300mm), if no sensor measured the load',
    )
    add_table_options(parser)
    verb.add_settings(parser, ['judge_readings'])


def run(arguments: Namespace) -> int:
    """Track the images and summarize."""
    from pneunet_ros.cli.track_images import track  # imports of a second, not for --help

    return track(arguments)
