"""Archives of arrays (npz) read as data alone: nothing is unpickled, and sizes are bounded."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
import struct
import tokenize
from typing import Any
from zipfile import BadZipFile, ZipFile
import zlib

import numpy as np
from pneunet_ros.files.regular_file import open_regular

LARGEST_ARCHIVE = 100_000_000  # bytes, unpacked

# What zipfile and numpy meet damaged bytes with; an error of zip is also a RuntimeError
# (encrypted) or a NotImplementedError (a way of packing that is not known).
DAMAGED_ARCHIVE = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    EOFError,
    OverflowError,
    MemoryError,
    SyntaxError,
    RuntimeError,
    BadZipFile,
    struct.error,
    tokenize.TokenError,
    zlib.error,
)


def read_arrays(path: Path, names: Iterable[str], optional: Iterable[str] = ()) -> dict[str, Any]:
    """Return these arrays of an archive, and the optional ones that it has.

    Raises one of DAMAGED_ARCHIVE where that cannot be.
    """
    with open_regular(path) as stream:
        with ZipFile(stream) as archive:
            if sum(item.file_size for item in archive.infolist()) > LARGEST_ARCHIVE:
                raise ValueError(f'it holds more than {LARGEST_ARCHIVE // 1_000_000} MB')
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as content:
            found = [*names, *(name for name in optional if name in content)]
            return {name: content[name] for name in found}
