"""`pneunet track`: camera images -> targets, measured centerline and curvature."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from pneunet_ros.cli.table_options import add_table_options, AUTO
from pneunet_ros.cli.verb import add_json, add_model, add_overwrite, add_settings, add_topics
from pneunet_ros.recordings.file_kinds import FOLDER_RATE, NO_LENS


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'source',
        type=Path,
        metavar='REC_OR_IMAGES',
        help='an .mcap file, a rosbag2 folder, a video file, or a folder of images',
    )
    add_model(parser)
    parser.add_argument(
        '--camera',
        type=Path,
        metavar='FILE',
        help='working plane, clamp and looks of targets, YAML (default: the shipped camera.yaml)',
    )
    parser.add_argument(
        '--camera-info',
        metavar='FILE',
        help="lens, YAML as camera_calibration writes it, instead of the recording's camera_info; "
        f'`{NO_LENS}`: the images are free of distortion',
    )
    parser.add_argument(
        '--output',
        type=Path,
        metavar='OUT.mcap',
        help='write the tracker topics, and the other topics of a recording, here',
    )
    add_overwrite(parser)
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
        help='where the target at the clamp is in the image at rest, about, px (default: as the '
        'camera file says, or the left end of the row)',
    )
    parser.add_argument(
        '--estimates',
        type=Path,
        metavar='REC',
        help='draw the predicted centerlines of this recording (of `replay`) into the page '
        '(default: those beside the images, where there are)',
    )
    parser.add_argument(
        '--table', type=Path, metavar='FILE.csv', help='write a line per target and frame'
    )
    parser.add_argument(
        '--rate',
        type=float,
        metavar='HZ',
        help='frames per second of a video or a folder '
        f'(default: what the video says; {FOLDER_RATE:g} for a folder)',
    )
    add_topics(parser, 'image_raw=/my/topic')
    add_film_options(parser)
    add_json(parser)


def add_film_options(parser: ArgumentParser) -> None:
    """Add the options for a film with a table of readings."""
    group = parser.add_argument_group('a film with a table of readings')
    group.add_argument(
        '--readings',
        type=Path,
        metavar='TABLE.csv',
        help='pressures, and end forces if there are any, that were read while a video or folder '
        'of images was taken: with them, OUT.mcap is a recording for calibrate and diagnose',
    )
    group.add_argument(
        '--delay',
        metavar='S',
        help='a frame at t in the film shows the arm at t - S in the table, each counted from its '
        f'first frame or row; {AUTO}: from how motion follows pressure (default: {AUTO})',
    )
    group.add_argument(
        '--end-load',
        nargs=2,
        metavar=('FX', 'FY'),
        help='a known constant end load (base frame), where a weight hung straight down from the '
        'tip and no sensor read: N, or with a unit, as 20g',
    )
    group.add_argument(
        '--string',
        nargs=3,
        metavar=('TENSION', 'X', 'Y'),
        help='a known tension of a thread from the tip over a fixed eye or pulley at X, Y (base '
        'frame; m, or with a unit, as 300mm), where no sensor measured the load',
    )
    add_table_options(parser)
    add_settings(parser, ['judge_readings'])


def run(arguments: Namespace) -> int:
    """Track and summarize."""
    from pneunet_ros.cli.track_images import track  # a second of imports, which --help spares

    return track(arguments)
