"""Output of verbs when readings contradict the declared unit, sign or frame."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from pneunet_ros.cli import verb
from pneunet_ros.offline.judge import Verdicts


def refuse_readings(arguments: Namespace, path: Path, verdicts: Verdicts) -> int:
    """Print the likely meaning of the readings and the command to type; return the exit code.

    In that case, nothing is estimated or written.
    """
    sentence = f'{path}: {verdicts.strangeness}'
    if verdicts.doubted:
        sentence = (
            f'{path}: {verdicts.findings}. Type: pneunet {arguments.verb} {path} '
            f'{verdicts.options} (or --no-judge-readings if the readings are right)'
        )
    summary: dict[str, Any] = {
        'recording': path,
        'output': None,
        'estimates': 0,
        'verdicts': verdicts.summary,
        'sentences': [sentence],
    }
    if arguments.json:
        verb.print_json(summary)
    else:
        console = verb.output_console()
        console.print(sentence)
        console.print('Nothing was estimated and nothing was written.')
    return verb.NEGATIVE
