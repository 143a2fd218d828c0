"""`pneunet mjcf`: the finger as a MuJoCo model."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from pneunet_ros.cli import verb
from pneunet_ros.cli.quantity_option import quantity_type
from pneunet_ros.core.errors import RequestError
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.model.hinge_chain import hinge_chain
from pneunet_ros.mujoco.hinge_chain import LINKS, mjcf

DAMPING_TIME = 0.03  # s, 10 % of critical damping at 1 Hz: zeta = pi f1 damping_time
FEWEST_LINKS, MOST_LINKS = 4, 400


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    verb.add_model(parser)
    verb.add_gravity(parser)
    parser.add_argument(
        '--links',
        type=int,
        default=LINKS,
        metavar='N',
        help='number of hinges (default: %(default)s, within 0.05 mm of `pneunet predict`)',
    )
    parser.add_argument(
        '--damping-time',
        type=quantity_type('time'),
        metavar='S',
        help='damping over stiffness of a hinge; a free decay at f1 with damping ratio zeta '
        'gives zeta / (pi f1) (default: from the model file; if it has none, '
        f'{DAMPING_TIME} s, which assumes 10 %% of critical damping at 1 Hz)',
    )
    parser.add_argument(
        '--radius',
        type=quantity_type('length'),
        metavar='M',
        help='radius of the collision capsules: half the thickness of the finger (default: a '
        'sixteenth of its length)',
    )
    verb.add_output(parser, 'FILE', 'MJCF file to write, .xml')


def run(arguments: Namespace) -> int:
    """Write the MJCF."""
    arm = verb.still_model_of(arguments)
    if not FEWEST_LINKS <= arguments.links <= MOST_LINKS:
        raise RequestError(
            f'--links must lie between {FEWEST_LINKS} and {MOST_LINKS}', reason='out_of_bounds'
        )
    known = 0.0 if arm.inertia is None else arm.inertia.damping_time
    damping_time = known or DAMPING_TIME
    if arguments.damping_time is not None:
        damping_time = arguments.damping_time
    chain = hinge_chain(
        arm, damping_time=damping_time, radius=arguments.radius, links=arguments.links
    )
    inputs = [] if arguments.model is None else [arguments.model]
    with atomic_output(
        arguments.output, overwrite=arguments.overwrite, inputs=inputs
    ) as temporary:
        temporary.write_text(mjcf(chain), encoding='utf-8')
    content = {
        'output': arguments.output,
        'model': arm.name,
        'hinges': chain.hinge.size,
        'mass': chain.mass + chain.tip_mass,
        'damping_time': chain.damping_time,
        'radius': chain.radius,
        'pressure_range': [chain.pressure[0], chain.pressure[-1]],
    }
    text = (
        f'wrote {arguments.output}: {arm.name} with {chain.hinge.size} hinges and '
        f'{1e3 * (chain.mass + chain.tip_mass):.1f} g, damping time {chain.damping_time:g} s'
    )
    verb.present(arguments, content, lambda console: console.print(text))
    return verb.DONE
