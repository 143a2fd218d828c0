"""Conversion to JSON: arrays as lists, paths as text, and null for non-finite numbers."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return arrays as lists, paths as text, NaN and infinity as None."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def json_text(content: Mapping[str, Any], indent: int | None = None) -> str:
    """Return a JSON object with numbers in full precision, and a newline at the end."""
    return json.dumps(plain(content), allow_nan=False, indent=indent) + '\n'
