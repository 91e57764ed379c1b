"""Records from files as the types that they must have, or an error that names file, line and key."""

from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from gaitopt.errors import StorageError

Model = TypeVar("Model")
_adapter = lru_cache(TypeAdapter)


def validated(model: type[Model], record: Any, path: Path, line: int | None = None) -> Model:
    """The record of a file as a ``model``, which is a dataclass; what else the record holds is left out.

    Raises
    ------
    StorageError
        If it is none; the message names file, line and key.
    """
    try:
        return _adapter(model).validate_python(record)  # type: ignore[arg-type]  # mypy: types are hashable
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        place = path if line is None else f"{path}:{line}"
        raise StorageError(f"{place} {key}: {first['msg']}; the run is broken and was left alone") from error
