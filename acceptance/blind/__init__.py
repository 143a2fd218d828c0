"""Blind trials: recordings with a hidden effect, made, diagnosed and scored apart."""

from pathlib import Path
import sys

sys.path.append(str(Path(__file__).resolve().parents[2] / 'test'))  # for `support`
