"""Records one per line, each durable once appended; a line cut off by a crash is dropped on reading."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gaitopt.errors import StorageError
from gaitopt.store.files import make_folder, reason, sync_folder
from gaitopt.store.text import json_text


class LineWriter:
    """Appends records to a JSON-lines file, as a context manager.

    A file that exists is continued; a torn last line in it is cut off first.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: FileIO
        self._end = 0

    def __enter__(self) -> Self:
        make_folder(self._path.parent)
        self._end = max((end for _, end in _whole_lines(self._path)), default=0) if self._path.exists() else 0
        try:
            self._file = self._path.open("ab", buffering=0)
            self._file.truncate(self._end)
            sync_folder(self._path.parent)
        except OSError as error:
            raise StorageError(f"cannot write {self._path}: {reason(error)}") from error
        return self

    def append(self, record: Mapping[str, Any]) -> None:
        """Append a record; when this returns, it is on the disk.

        Raises
        ------
        StorageError
            If the disk is full; the records before it are kept.
        """
        line = json_text(record).encode() + b"\n"
        try:
            rest = memoryview(line)
            while rest:  # a raw file may take less than it is given
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            with suppress(OSError):  # a torn line is dropped on reading anyway
                self._file.truncate(self._end)
            raise StorageError(
                f"cannot append to {self._path}: {reason(error)}; all records before this one are kept"
            ) from error
        self._end += len(line)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Read the records of a JSON-lines file in order, one at a time.

    Raises
    ------
    StorageError
        If a line before the last is not a JSON object; the message names it.
    """
    return (record for record, _ in _whole_lines(path))


def _whole_lines(path: Path) -> Iterator[tuple[dict[str, Any], int]]:
    """Each record with the position of its end; a last line that is torn ends the iteration."""
    try:
        with path.open("rb") as file:
            end, size = 0, path.stat().st_size
            for number, line in enumerate(file, start=1):
                end += len(line)
                record = _record(line)
                if record is not None:
                    yield record, end
                elif end < size:
                    raise StorageError(f"{path}:{number}: not a JSON object; the file is broken and was left alone")
    except OSError as error:
        raise StorageError(f"cannot read {path}: {reason(error)}") from error


def _record(line: bytes) -> dict[str, Any] | None:
    if not line.endswith(b"\n"):
        return None
    try:
        record = json.loads(line)
    except ValueError:
        return None
    return record if isinstance(record, dict) else None
