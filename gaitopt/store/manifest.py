"""What a run folder says about itself: format, schema, versions, platform, and the hash of its problem."""

import json
import platform
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from gaitopt.errors import StorageError
from gaitopt.store.files import read_text

MANIFEST_FILE = "manifest.json"
FORMAT = "gaitopt run"
SCHEMA = 1
"""Raised whenever a reader of the previous schema would misread what is written."""
PACKAGES = ("gaitopt", "casadi", "numpy", "scipy", "pydantic", "ruamel.yaml")
"""Packages on which the numbers of a run depend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The contents of ``manifest.json``; ``hash`` is that of the resolved problem with its references."""

    problem: str
    hash: str
    versions: dict[str, str]
    platform: dict[str, str]
    format: str = FORMAT
    schema: int = SCHEMA

    def to_record(self) -> dict[str, Any]:
        """The manifest as a JSON object."""
        return asdict(self)


def new_manifest(problem: str, digest: str) -> Manifest:
    """State who writes a run of the problem named ``problem`` now; the host is not named."""
    return Manifest(
        problem=problem,
        hash=digest,
        versions=dict(_versions()),
        platform={"system": platform.system(), "machine": platform.machine()},
    )


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a run folder.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken, or was written by a newer gaitopt.
    """
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise StorageError(f"{folder} is not a run of gaitopt (it has no {MANIFEST_FILE}); it was left alone")
    try:
        record = json.loads(read_text(path))
    except ValueError as error:
        raise StorageError(f"{path} is not JSON ({error}); the run is broken and was left alone") from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise StorageError(f"{path} is not the manifest of a gaitopt run; the folder was left alone")
    schema = record.get("schema")
    if isinstance(schema, int) and schema > SCHEMA:
        raise StorageError(
            f"{folder} was written by a newer gaitopt (schema {schema}; this one reads up to {SCHEMA}); "
            "it was left alone: update gaitopt to use it"
        )
    try:
        return TypeAdapter(Manifest).validate_python(record)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise StorageError(f"{path} {key}: {first['msg']}; the run is broken and was left alone") from error


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    return (("python", platform.python_version()), *((name, version(name)) for name in PACKAGES))
