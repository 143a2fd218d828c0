"""The process of a node: clean shutdown by signals, and one sentence for a user error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import gc
import re
import sys
from typing import Any

from pneunet_ros.core.errors import PneunetError, RequestError
from pneunet_ros.core.printable import printable
from pneunet_ros.nodes.params_file import missed_node, params_files
from pneunet_ros.nodes.prompt_executor import PromptExecutor
from pneunet_ros.nodes.signals import end_at_signal, ignore_signals, refuse_signals, signal_came
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.signals import install_signal_handlers, SignalHandlerOptions
from rclpy.utilities import remove_ros_args

DONE, WRONG_REQUEST = 0, 2


def run(make_nodes: Iterable[Callable[[], Any]], usage: str, arguments: list[str]) -> int:
    """Make nodes, and run them in one thread until a signal arrives.

    make_nodes: functions that each make one node or several. arguments: the command line including
    the name of the program; returns the exit code. A user error (PneunetError) prints one sentence
    on stderr and gives exit code 2.
    """
    nodes: list[Any] = []
    end_at_signal()
    try:
        if {'-h', '--help'} & set(arguments[1:]):
            print(usage)
            return DONE
        _start_ros(arguments)
        executor = PromptExecutor()
        for make_node in make_nodes:
            made = make_node()
            for node in made if isinstance(made, Iterator) else (made,):
                nodes.append(node)
                executor.add_node(node)
                _warn_of_missed_parameters(node, arguments)
        # Objects created so far are permanent: exclude them from later garbage collections.
        gc.collect()
        gc.freeze()
        # Only now: the handlers of rclpy shut ROS down from another thread, which must not happen
        # during the construction of a node.
        install_signal_handlers()
        if not signal_came():  # a signal during a callback of LLVM is lost
            executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        if signal_came():
            return DONE  # ROS raises an error for whatever the signal interrupted
        if not isinstance(error, PneunetError):
            raise
        print(printable(str(error)), file=sys.stderr)
        return WRONG_REQUEST
    finally:
        ignore_signals()
        for node in nodes:
            node.destroy_node()
        gc.collect()  # destroy a partly constructed node before ROS shuts down
        rclpy.try_shutdown()
        refuse_signals()
    return DONE


def _warn_of_missed_parameters(node: Any, arguments: list[str]) -> None:
    """Warn about parameter files that name this node only in another namespace."""
    for path in params_files(arguments):
        sentence = missed_node(path, node.get_fully_qualified_name())
        if sentence:
            node.get_logger().warning(printable(sentence))


def _start_ros(arguments: list[str]) -> None:
    """Initialize ROS; RequestError for invalid arguments."""
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        # Errors of rcl end with the source lines that they passed through.
        reason = re.sub(r'failed to initialize rcl: |, at /\S+:\d+', '', str(error))
        raise RequestError(f'invalid ROS arguments: {reason}', reason='usage') from error
    unknown = remove_ros_args(arguments)[1:]
    if unknown:
        raise RequestError(
            f'unknown argument {unknown[0]}: parameters and names are given after --ros-args',
            reason='usage',
        )
