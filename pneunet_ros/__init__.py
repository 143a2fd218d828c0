"""pneunet_ros: where a pneu-net arm is, from pressure and end force, by a calibrated rod model.

>>> from pneunet_ros import load_model, solve, solve_tip
"""

from __future__ import annotations

from pneunet_ros.files.model_file import load_model, save_model
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.inverse import solve_tip

__all__ = ['load_model', 'save_model', 'solve', 'solve_tip']
__version__ = '0.1.0'
