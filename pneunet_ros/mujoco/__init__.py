"""A finger as a MuJoCo model: a chain of hinges with springs that follow the pressure."""

from pneunet_ros.mujoco.finger import Finger

__all__ = ['Finger']
