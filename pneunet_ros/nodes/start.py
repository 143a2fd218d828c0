"""Start of nodes: signal handlers are installed before the slow imports.

Only the signal module is imported before signals are handled, so that the process ends cleanly
even if a signal arrives in the first second.
"""

from __future__ import annotations

import sys

from pneunet_ros.nodes.signals import end_at_signal, refuse_signals

WRONG = 2  # exit code
NODES = {
    'virtual_arm': 'VirtualArmNode',
    'estimator': 'EstimatorNode',
    'tracker': 'TrackerNode',
    'fusion': 'FusionNode',
    'gripper': 'gripper_nodes',
    'virtual_gripper': 'virtual_gripper_nodes',
}


def start(*names: str, usage: str = '', arguments: list[str] | None = None) -> int:
    """Run nodes in one thread until a signal arrives; returns the exit code.

    names: keys of NODES; usage: text for --help, by default that of the node; arguments: the
    command line including the name of the program, by default that of this process. If the kernels
    are not compiled, the nodes use plain Python while another process compiles them. Only the
    virtual arm compiles its kernels at startup, because with plain Python it could not keep up
    with its clock.
    """
    arguments = sys.argv if arguments is None else arguments
    end_at_signal()
    try:
        return _run(names, usage, arguments)
    except KeyboardInterrupt:
        refuse_signals()
        return 0


def _run(names: tuple[str, ...], usage: str, arguments: list[str]) -> int:
    from importlib import import_module
    from importlib.util import find_spec

    from pneunet_ros.core.kernels.cache import compile_in_background, use_plain_python
    from pneunet_ros.core.threads import use_one_thread
    from pneunet_ros.core.without_ros import GET_ROS

    use_one_thread()
    if find_spec('rclpy') is None:
        print(f'{names[0]}: ROS 2 is not available: {GET_ROS}', file=sys.stderr)
        return WRONG
    if not {'-h', '--help'} & set(arguments[1:]):
        # The loggers of ROS need rclpy, whose import takes seconds on a slow computer.
        print(f'[INFO] [{", ".join(names)}]: loading', file=sys.stderr, flush=True)
    if {'virtual_arm', 'virtual_gripper'} & set(names):
        import_module('pneunet_ros.lab.live')
    use_plain_python()
    modules = [import_module(f'pneunet_ros.nodes.{name}.node') for name in names]
    compile_in_background()
    nodes = [getattr(module, NODES[name]) for module, name in zip(modules, names, strict=True)]
    run = import_module('pneunet_ros.nodes.process').run
    code: int = run(nodes, usage or modules[0].USAGE, arguments)
    return code
