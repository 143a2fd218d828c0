"""Several nodes in one process and one thread, to save memory and startup time.

A busy node delays the others. If an estimate must not wait for an image, start the nodes in
separate processes.
"""

from __future__ import annotations

import sys

from pneunet_ros.nodes.start import NODES, start

DEFAULT = ('estimator', 'tracker')
USAGE = """usage: pneunet-stack [virtual_arm] [estimator] [tracker] [fusion] [--ros-args ...]

Runs nodes in one process, by default estimator and tracker. A parameter on the command line goes
to all of them (nodes that do not have it report this); a file of parameters names the nodes:

  pneunet-stack --ros-args -p model_file:=/path/to/model.yaml
  pneunet-stack virtual_arm estimator --ros-args --params-file my_stack.yaml
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the named nodes until a signal arrives; the console script `pneunet-stack`."""
    arguments = sys.argv if arguments is None else arguments
    end = arguments.index('--ros-args') if '--ros-args' in arguments else len(arguments)
    named = [name for name in NODES if name in arguments[1:end]] or DEFAULT
    unknown = [argument for argument in arguments[1:end] if argument not in NODES]
    return start(*named, usage=USAGE, arguments=[arguments[0], *unknown, *arguments[end:]])


if __name__ == '__main__':
    sys.exit(main())
