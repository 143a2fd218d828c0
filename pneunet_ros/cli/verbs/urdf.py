"""`pneunet urdf`: the arm as a chain of links, for robot_state_publisher."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from pneunet_ros.cli import verb
from pneunet_ros.core.errors import RequestError
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.messages.link_chain import link_ends, urdf
from pneunet_ros.messages.markers import TIP_FRAME
from pneunet_ros.model.equilibrium import station_arclength

DEFAULTS = EstimatorSettings()


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    verb.add_model(parser)
    parser.add_argument(
        '--stations',
        type=int,
        default=DEFAULTS.stations,
        metavar='N',
        help='number of stations of the estimator whose joint_states move the chain (default: '
        '%(default)s)',
    )
    parser.add_argument(
        '--frame-id',
        default=DEFAULTS.frame_id,
        metavar='FRAME',
        help='link at the clamp (default: %(default)s)',
    )
    verb.add_output(parser, 'FILE', 'URDF file to write')


def run(arguments: Namespace) -> int:
    """Write the URDF."""
    arm = verb.model_of(arguments)
    if not 2 <= arguments.stations <= 2000:
        raise RequestError('--stations must lie between 2 and 2000', reason='out_of_bounds')
    arclength = station_arclength(arm.reach, arguments.stations)
    text = urdf(arm.name, arclength, arguments.frame_id, TIP_FRAME)
    inputs = [] if arguments.model is None else [arguments.model]
    with atomic_output(
        arguments.output, overwrite=arguments.overwrite, inputs=inputs
    ) as temporary:
        temporary.write_text(text, encoding='utf-8')
    links = link_ends(arguments.stations).size - 1
    content = {'output': arguments.output, 'model': arm.name, 'links': links}
    sentence = f'wrote {arguments.output}: {arm.name} as a chain of {links} links'
    verb.present(arguments, content, lambda console: console.print(sentence))
    return verb.DONE
