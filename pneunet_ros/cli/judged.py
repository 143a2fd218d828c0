"""What verbs print where readings are almost surely not what they are declared to be."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from pneunet_ros.cli.verb import NEGATIVE, output_console, print_json
from pneunet_ros.measurement.pressure_judge import PressureVerdict
from pneunet_ros.offline.judge import verdict_summary


def refuse_readings(arguments: Namespace, path: Path, verdict: PressureVerdict) -> int:
    """Print what the readings of a recording most likely are, and what to type; return the code.

    Nothing is estimated and nothing is written then.
    """
    sentence = (
        f'{path}: the pressure is {verdict.finding}. Type: pneunet {arguments.verb} {path} '
        f'{verdict.options} (--no-judge-readings if the readings are right)'
    )
    summary: dict[str, Any] = {
        'recording': path,
        'output': None,
        'estimates': 0,
        'pressure_verdict': verdict_summary(verdict),
        'sentences': [sentence],
    }
    if arguments.json:
        print_json(summary)
    else:
        console = output_console()
        console.print(sentence)
        console.print('Nothing was estimated and nothing was written.')
    return NEGATIVE
