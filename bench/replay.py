"""Throughput of `pneunet replay` from file to file, in readings per second of CPU.

    python bench/replay.py [--json] [--repeats N] [--recording REC] [--model MODEL]

Decoding, estimating with covariance, comparing with targets where there are any, encoding all
topics and writing them, after model and kernels are loaded, with one thread of linear algebra, as
the command has it; a reading is a message of a sensor. The peer of the same run is reading and
writing alone: what a replay without a model would take.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import statistics
import sys
import tempfile
import time

from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.core.threads import THREADS, use_one_thread
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.offline.replay import input_topics, record_steps, Step, Tally, targets_topic
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording


def replay(folder: Path, path: Path, estimator: Estimator) -> tuple[float, int, int]:
    """Seconds of CPU, readings and estimates of one replay from file to file."""
    begun = time.process_time()
    recording = open_recording(path)
    topics = input_topics(recording, estimator, {})
    targets = targets_topic(recording, estimator, {})
    tally = Tally()

    def each(step: Step) -> None:
        tally.count(step, '/pneunet/pressure')

    with write_recording(folder / 'out.mcap', overwrite=True) as writer:
        record_steps(writer, recording, estimator, topics, each, targets=targets)
    tally.agreement(estimator.arm)
    assert tally.state is not None
    return time.process_time() - begun, tally.messages, tally.state.estimates


def copy(folder: Path) -> float:
    """Seconds to read the result of a replay and write it again."""
    begun = time.process_time()
    recording = open_recording(folder / 'out.mcap')
    names = [topic.name for topic in recording.topics]
    with write_recording(folder / 'copy.mcap', overwrite=True) as writer:
        copies = {name: writer.add_copy(recording.topic(name)) for name in names}
        for message in recording.raw_messages(names):
            writer.write_raw(copies[message.topic], message.log_time_ns, message.raw)
    return time.process_time() - begun


def main() -> None:
    """Run and print."""
    if not any(name in os.environ for name in THREADS):  # begin anew, as `pneunet` begins
        use_one_thread()
        os.execv(sys.executable, [sys.executable, *sys.argv])
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--repeats', type=int, default=7, help='repeats (default: 7)')
    command.add_argument('--recording', type=Path, default=share_path('bags/table1'))
    command.add_argument('--model', type=Path, default=share_path('config/paper_arm.yaml'))
    arguments = command.parse_args()
    given = arguments.recording, Estimator(arm=load_model(arguments.model))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        replay(folder, *given)
        runs = [(*replay(folder, *given), copy(folder)) for _ in range(arguments.repeats)]
    readings = statistics.median(run[1] / run[0] for run in runs)
    estimates = statistics.median(run[2] / run[0] for run in runs)
    share = statistics.median(run[3] / run[0] for run in runs)
    result = {
        'bench': 'replay',
        'readings_per_second': readings,
        'estimates_per_second': estimates,
        'copying_alone_share': share,
        'readings': runs[0][1],
        'estimates': runs[0][2],
    }
    if arguments.json:
        print(json.dumps(result))
        return
    print(f'{readings:.0f} readings and {estimates:.0f} estimates a second of CPU, file to file')
    print(f'reading and writing the same messages alone takes {share:.0%} of that time')
    print('target: at least 3000 readings/s, 2000 where targets are compared')


if __name__ == '__main__':
    main()
