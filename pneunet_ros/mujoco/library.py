"""Import of the optional library MuJoCo."""

from __future__ import annotations

from types import ModuleType

from pneunet_ros.core.errors import RequestError


def load_mujoco() -> ModuleType:
    """Return the module `mujoco`; RequestError names the install command if it is missing."""
    try:
        import mujoco
    except ImportError as error:
        raise RequestError(
            f"MuJoCo is not installed ({error}): use pip install 'pneunet_ros[mujoco]', or pip "
            "install '.[mujoco]' in a checkout",
            reason='not_installed',
        ) from None
    module: ModuleType = mujoco
    return module
