"""Records from files as the types that they must have, or an error that names file, line and key."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from gaitopt.errors import StorageError
from gaitopt.gait.records import STATES

Model = TypeVar("Model")
_adapter = lru_cache(TypeAdapter)
LONGEST_KEY = 200
"""Characters of the key that an error names."""


def validated(
    model: type[Model], record: Any, path: Path, line: int | None = None, *, states: Sequence[str] | None = None
) -> Model:
    """The record of a file as a ``model``, a dataclass or a type of ``gait.records``; other entries are left out.

    Parameters
    ----------
    states : names that every state of the record must have.

    Raises
    ------
    StorageError
        If it is none; the message names file, line and key.
    """
    try:
        return _adapter(model).validate_python(record, context={STATES: states})  # type: ignore[arg-type]
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])[:LONGEST_KEY]
        raise damaged(path, f"{key}: {first['msg']}" if key else first["msg"], line) from error


def damaged(path: Path, words: str, line: int | None = None) -> StorageError:
    """The error of a file whose content is not what was written, in words."""
    place = path if line is None else f"{path}:{line}"
    return StorageError(f"{place} {words}; the run is broken and was left alone")
