"""A finger as a MuJoCo model: a chain of hinges with pressure-dependent springs."""

from pneunet_ros.mujoco.finger import Finger

__all__ = ['Finger']
