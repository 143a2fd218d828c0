"""Configuration of the tests of the acceptance scripts: shared test support, no display."""

from __future__ import annotations

import os
from pathlib import Path
import sys

os.environ['MPLBACKEND'] = 'Agg'
sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
