"""Blind trials: recordings with a hidden effect, simulated, diagnosed and scored separately."""

from pathlib import Path
import sys

sys.path.append(str(Path(__file__).resolve().parents[2] / 'test'))  # for `support`
