"""Survey on a Dask cluster of two workers, one of which is killed during the run.

    python acceptance/survey_cluster.py FLEET --output DIR [OPTION OF pneunet survey ...]

Starts a cluster of two processes, runs `pneunet survey FLEET --scheduler`, and kills one worker
as soon as the first arm is written. Prints the exit code and which arms failed.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()


def survey_with_a_killed_worker(fleet: Path, output: Path, options: list[str]) -> dict:
    """Run it; return exit code, arms, arms that failed, and arms done before the kill."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host='127.0.0.1'
    ) as cluster:
        victim = next(iter(cluster.workers.values()))
        command = [sys.executable, '-m', 'pneunet_ros.cli', 'survey', str(fleet)]
        command += ['--output', str(output), '--scheduler', cluster.scheduler_address, *options]
        with subprocess.Popen(command) as running:
            while running.poll() is None and not done(output):
                time.sleep(0.2)
            before = len(done(output))
            os.kill(victim.pid, signal.SIGKILL)
            code = running.wait()
    arms = json.loads((output / 'survey.json').read_text(encoding='utf-8'))['arms']
    failed = [item['name'] for item in arms if item['failed']]
    return {'code': code, 'arms': len(arms), 'failed': failed, 'done_before_the_kill': before}


def done(output: Path) -> list[Path]:
    """Return the rows that are written."""
    return sorted(output.glob('arms/*/arm.json'))


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('fleet', type=Path)
    command.add_argument('--output', type=Path, required=True)
    arguments, options = command.parse_known_args()
    print(json.dumps(survey_with_a_killed_worker(arguments.fleet, arguments.output, options)))


if __name__ == '__main__':
    main()
