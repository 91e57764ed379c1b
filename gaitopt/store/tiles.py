"""Parts of a large result, each a file of arrays that appears whole; what is there after a crash need not be redone."""

import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.errors import StorageError
from gaitopt.store.files import read_bytes, write_whole

TILE_FILE = "tile-{:06d}.npz"
BROKEN = (OSError, ValueError, KeyError, EOFError, NotImplementedError, TypeError, zipfile.BadZipFile, zlib.error)
"""What NumPy and zipfile raise on damaged archives."""


def write_tile(folder: Path, number: int, arrays: Mapping[str, Any]) -> None:
    """Write the arrays of one tile."""
    packed = BytesIO()
    np.savez_compressed(packed, **arrays)
    write_whole(folder / TILE_FILE.format(number), packed.getvalue())


def has_tile(folder: Path, number: int) -> bool:
    """Whether a tile is there; if so, it is whole."""
    return (folder / TILE_FILE.format(number)).is_file()


def read_tile(folder: Path, number: int) -> dict[str, Any]:
    """Read the arrays of one tile."""
    path = folder / TILE_FILE.format(number)
    try:
        with np.load(BytesIO(read_bytes(path)), allow_pickle=False) as arrays:
            return dict(arrays)
    except BROKEN as error:
        raise StorageError(f"{path} is broken ({error}): delete it, and its states are walked again") from error
