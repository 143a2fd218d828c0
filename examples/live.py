"""Run the whole stack without hardware: virtual arm, estimator, tracker and fusion.

    make live                     (Ctrl-C ends it)
    python examples/live.py --seconds 30 --effects "hysteresis.width=4000"
    make live ARGS=--ring

Every node runs in its own process, started as a user would start it. This script commands a
pressure that rises and falls, pulls at the tip, and prints every second:

- the pressure, the estimated tip, and its distance from the true tip; that of the fused tip
- the pull, and the error of the force that the fusion estimates without a force sensor
- the number of targets that the tracker sees, and their rms distance from the estimated shape
- the rates of estimates and frames

With a hidden effect, which the model does not have, the distances grow. With --ring the arm has
mass, simulated by MuJoCo, and the pressure steps: the model has `motion`, because an estimate that
assumes an arm at rest would be off by centimeters.
"""

from __future__ import annotations

import argparse
from collections import deque
from contextlib import ExitStack
from dataclasses import replace
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, WrenchStamped
import numpy as np
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model, save_model
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.model.motion import Motion
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import FluidPressure, PointCloud2

MODEL, CAMERA = share_path('config/lab_arm.yaml'), share_path('config/lab_camera.yaml')
RINGING = share_path('scenarios/ringing.yaml')
NAMESPACE = '/pneunet'
LOWEST, HIGHEST, PERIOD = 4e3, 46e3, 16.0  # Pa, Pa, s
STEP_PERIOD = 5.0  # s
PULL, PULL_PERIOD = (0.03, 0.01), 11.0  # N, s
START_TIMEOUT = 900.0  # s; the virtual arm compiles its kernels at the first start
STILL_STARTING = 30.0  # s between reminders


class Process:
    """A node in its own process, which ends with the context."""

    def __init__(self, node: str, *parameters: str) -> None:
        given = [text for parameter in parameters for text in ('-p', parameter)]
        start = [sys.executable, '-m', f'pneunet_ros.nodes.{node}', '--ros-args']
        command = [*start, '-r', f'__ns:={NAMESPACE}', *given]
        # In its own session, so that Ctrl-C does not interrupt it while it starts.
        self.node, self.process = node, subprocess.Popen(command, start_new_session=True)

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *error: object) -> None:
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()


class Watcher(Node):
    """Commands pressure and load, and compares the outputs of all nodes."""

    def __init__(self, *, steps: bool) -> None:
        super().__init__('live', namespace=NAMESPACE)
        self.steps = steps
        self.arclength = load_model(MODEL).target_arclength
        self.begun: float | None = None
        self.tip: Any = None
        self.pressure = math.nan
        self.true_tips: deque[Any] = deque(maxlen=50)
        self.shapes: deque[Any] = deque(maxlen=200)
        self.misses: list[float] = []  # mm
        self.fused_misses: list[float] = []  # mm
        self.pull = (0.0, 0.0)  # N
        self.force_misses: list[float] = []  # mN
        self.seen, self.distance = 0, math.nan
        self.estimates = self.frames = 0
        self.commands = self.create_publisher(FluidPressure, 'pressure_command', 10)
        self.loads = self.create_publisher(WrenchStamped, 'force_command', 10)
        self.create_timer(0.05, self.command)
        for kind, topic, take in (
            (FluidPressure, 'pressure', self.take_pressure),
            (PoseStamped, 'true_tip', lambda message: self.true_tips.append(message)),
            (PoseWithCovarianceStamped, 'tip', self.take_tip),
            (PoseWithCovarianceStamped, 'fused/tip', self.take_fused_tip),
            (WrenchStamped, 'fused/end_wrench', self.take_force),
            (PointCloud2, 'shape', lambda message: self.shapes.append(message)),
            (PointCloud2, 'targets', self.take_targets),
        ):
            self.create_subscription(kind, topic, take, 10)

    def command(self) -> None:
        """Command pressure and load, once estimates of both nodes and targets have arrived."""
        if self.begun is None and self.estimates and self.fused_misses and self.seen:
            self.begun = time.monotonic()
            self.begin_line()
        since = 0.0 if self.begun is None else time.monotonic() - self.begun
        part = swing(since, PERIOD)
        if self.steps:
            part = float(since % STEP_PERIOD < 0.5 * STEP_PERIOD)
        level = 0.0 if self.begun is None else LOWEST + (HIGHEST - LOWEST) * part
        self.commands.publish(FluidPressure(fluid_pressure=level))
        part = swing(since, PULL_PERIOD)
        self.pull = PULL[0] * part, PULL[1] * part
        load = WrenchStamped()
        load.header.frame_id = BASE_FRAME
        load.wrench.force.x, load.wrench.force.y = self.pull
        self.loads.publish(load)

    def take_pressure(self, message: FluidPressure) -> None:
        self.pressure = message.fluid_pressure

    def take_tip(self, message: PoseWithCovarianceStamped) -> None:
        self.tip, self.estimates = message, self.estimates + 1
        self.misses += self.miss(message)

    def take_fused_tip(self, message: PoseWithCovarianceStamped) -> None:
        self.fused_misses += self.miss(message)

    def miss(self, message: PoseWithCovarianceStamped) -> list[float]:
        """Return the distance (mm) from the true tip at the same stamp; empty if unknown."""
        return [
            1000.0 * apart(message.pose.pose, true.pose)
            for true in self.true_tips
            if true.header.stamp == message.header.stamp
        ]

    def take_force(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        if math.isfinite(force.x) and math.isfinite(force.y):
            self.force_misses.append(1000.0 * math.dist((force.x, force.y), self.pull))

    def take_targets(self, message: PointCloud2) -> None:
        self.frames += 1
        points = cloud_points(message)
        places = np.column_stack([points['x'], points['y']])[np.argsort(points['id'])]
        self.seen = int(np.isfinite(places).all(axis=1).sum())
        if not self.shapes:
            return
        stamp = seconds(message)
        shape = cloud_points(min(self.shapes, key=lambda shape: abs(seconds(shape) - stamp)))
        there = [np.interp(self.arclength, shape['s'], shape[name]) for name in ('x', 'y')]
        if self.seen:
            squares = (places - np.column_stack(there)) ** 2
            self.distance = 1000.0 * math.sqrt(np.nanmean(squares.sum(axis=1)))

    def line(self, elapsed: float) -> str:
        """Summarize the messages of this many seconds, and start the next line."""
        if self.tip is None:
            return 'waiting for estimates'
        place = self.tip.pose.pose.position
        text = (
            f'{self.pressure / 1000.0:6.1f} kPa   tip {1000.0 * place.x:6.1f} '
            f'{1000.0 * place.y:6.1f} mm   from the true one {mean(self.misses)} mm, '
            f'fused {mean(self.fused_misses)} mm   '
            f'pull {1000.0 * math.hypot(*self.pull):4.1f} mN, '
            f'force off by {mean(self.force_misses)} mN   '
            f'{self.seen:2d}/{self.arclength.size} targets, {self.distance:5.2f} mm from the shape'
            f'   {self.estimates / elapsed:5.1f} estimates/s {self.frames / elapsed:4.1f} frames/s'
        )
        self.begin_line()
        return text

    def begin_line(self) -> None:
        """Reset the statistics of a line."""
        self.estimates = self.frames = 0
        for misses in (self.misses, self.fused_misses, self.force_misses):
            misses.clear()


def swing(since: float, period: float) -> float:
    """Return a share that goes from 0 to 1 and back in a period."""
    return 0.5 * (1.0 - math.cos(2.0 * math.pi * since / period))


def mean(misses: list[float]) -> str:
    """Return the mean as text; a dash without values."""
    return f'{np.mean(misses):5.2f}' if misses else '    -'


def apart(one: Any, other: Any) -> float:
    """Return the distance between two poses (m)."""
    return math.hypot(one.position.x - other.position.x, one.position.y - other.position.y)


def seconds(message: Any) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def watch(processes: list[Process], limit: float, *, steps: bool) -> int:
    """Print a line every second; return 1 if a node ended or sent nothing, else 0."""
    watcher, executor = Watcher(steps=steps), SingleThreadedExecutor()
    executor.add_node(watcher)
    start = printed = time.monotonic()
    reminded = 0
    while True:
        executor.spin_once(timeout_sec=0.1)
        now = time.monotonic()
        for process in processes:
            if process.process.poll() is not None:
                print(f'{process.node} ended unexpectedly', file=sys.stderr)
                return 1
        if now - printed >= 1.0:
            if watcher.begun is not None:
                print(watcher.line(now - printed), flush=True)
            printed = now
        if watcher.begun is None and now - start > STILL_STARTING * (reminded + 1):
            reminded += 1
            print(f'still preparing after {now - start:.0f} s', flush=True)
        if watcher.begun is None and now - start > START_TIMEOUT:
            print('no estimates or targets received', file=sys.stderr)
            return 1
        if limit and watcher.begun is not None and now - watcher.begun > limit:
            return 0


def moving_model(folder: Path) -> Path:
    """Return a model file with the damping of the ringing arm, as from `calibrate --motion`."""
    motion = load_scenario(RINGING).motion
    assert motion is not None
    arm = replace(load_model(MODEL), motion=Motion(damping_time=motion.damping_time))
    save_model(arm, folder / 'ringing_arm.yaml')
    return folder / 'ringing_arm.yaml'


def main() -> int:
    parser = argparse.ArgumentParser(description='The whole stack without hardware.')
    parser.add_argument(
        '--seconds',
        type=float,
        default=float(os.environ.get('LIVE_SECONDS') or 0.0),
        help='end after this time (default: LIVE_SECONDS; 0: at Ctrl-C)',
    )
    parser.add_argument('--effects', default='', help='hidden effects: NAME.PARAMETER=VALUE ...')
    parser.add_argument(
        '--ring', action='store_true', help='an arm with mass under pressure steps (needs MuJoCo)'
    )
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    print(
        'starting virtual_arm, estimator, tracker and fusion; at the first start, kernels are '
        'compiled (about 20 s of CPU), for which only the virtual arm waits',
        flush=True,
    )
    try:
        with ExitStack() as stack:
            arm, model = ['camera:=images'], MODEL
            arm += [f'effects:={arguments.effects}'] * bool(arguments.effects)
            if arguments.ring:
                arm += [f'scenario_file:={RINGING}', 'rate_limit:=400000.0', 'time_constant:=0.03']
                arm += ['frame_rate:=30.0']
                model = moving_model(Path(stack.enter_context(TemporaryDirectory())))
            started = [
                stack.enter_context(Process('virtual_arm', *arm)),
                stack.enter_context(Process('estimator', f'model_file:={model}')),
                stack.enter_context(
                    Process('tracker', f'model_file:={model}', f'camera_file:={CAMERA}')
                ),
                stack.enter_context(
                    Process('fusion', f'model_file:={model}', 'use_wrench:=false')
                ),
            ]
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            return watch(started, arguments.seconds, steps=arguments.ring)
    except KeyboardInterrupt:
        return 0
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
