"""Content of the latched topic `model_info`: the model in use, as one JSON object."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pneunet_ros import __version__
from pneunet_ros.files.model_file import model_hash
from pneunet_ros.model.arm import Arm


def model_info(arm: Arm, file: Path, **others: Any) -> str:
    """Return the JSON text for an arm from a file, with further entries."""
    about = {'name': arm.name, 'hash': model_hash(arm), 'file': str(file), 'length': arm.length}
    return json.dumps({**about, **others, 'version': __version__})
