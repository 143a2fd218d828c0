"""The tests of the acceptance scripts: beside them, with what tests share and without a window."""

from __future__ import annotations

import os
from pathlib import Path
import sys

os.environ['MPLBACKEND'] = 'Agg'
sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
