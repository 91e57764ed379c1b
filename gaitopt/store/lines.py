"""Files with one record per line: each is durable once appended, and a last line that a crash cut off is ignored.

Every line ends with a checksum that is chained to the one before it, crc_k = CRC-32(line_k, crc_(k-1)), so that a line
that was altered, removed, added or moved is noticed.
"""

import hashlib
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gaitopt.errors import StorageError
from gaitopt.store.files import (
    OWN_FILE,
    FileSum,
    json_text,
    parse_object,
    parsed,
    reason,
    sync_folder,
    write_all,
)

LINE = re.compile(rb'(\{.*), "crc": "([0-9a-f]{8})"\}\n')
"""A record and its checksum, which counts as the last key of the object."""


@dataclass(frozen=True, slots=True)
class _Line:
    """A complete line: its record, its checksum, and the position of its end [bytes]."""

    record: dict[str, Any]
    crc: int
    end: int


def lines_text(records: Iterable[Mapping[str, Any]]) -> str:
    """The text of a file of records."""
    lines, crc = [], 0
    for record in records:
        line, crc = _sealed_line(record, crc)
        lines.append(line)
    return "".join(lines)


class LineWriter:
    """Appends records to a JSON-lines file, as a context manager; only the holder of the folder's lock may do so.

    A file that exists is continued; a torn last line in it is cut off first.

    Attributes
    ----------
    records : those that the file held when it was opened.
    """

    def __init__(self, path: Path, known: FileSum | None = None) -> None:
        self._path, self._known = path, known
        self.records = list[dict[str, Any]]()
        self._file = -1
        self._end = self._crc = 0

    def __enter__(self) -> Self:
        if self._known is not None or self._path.exists():
            for line in _whole_lines(self._path, self._known):
                self.records.append(line.record)
                self._end, self._crc = line.end, line.crc
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_APPEND | os.O_CREAT | OWN_FILE, 0o666)
            os.ftruncate(self._file, self._end)
            sync_folder(self._path.parent)
        except OSError as error:
            raise StorageError(f"cannot write {self._path}: {reason(error)}") from error
        return self

    def append(self, record: Mapping[str, Any]) -> None:
        """Append a record; when this returns, it is on the disk.

        Raises
        ------
        StorageError
            If the disk is full (the records before this one are kept), or the file has been deleted.
        """
        text, crc = _sealed_line(record, self._crc)
        line = text.encode()
        try:
            write_all(self._file, line)
            os.fsync(self._file)
            there = os.path.samestat(os.fstat(self._file), self._path.lstat())
        except FileNotFoundError:
            there = False
        except OSError as error:
            with suppress(OSError):  # a torn line is dropped on reading anyway
                os.ftruncate(self._file, self._end)
            raise StorageError(
                f"cannot append to {self._path}: {reason(error)}; all records before this one are kept"
            ) from error
        if not there:
            raise StorageError(f"{self._path} was deleted or replaced while this command was writing it")
        self._end, self._crc = self._end + len(line), crc

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        os.close(self._file)


def read_lines(path: Path, known: FileSum | None = None) -> Iterator[dict[str, Any]]:
    """Read the records of a JSON-lines file in order, one at a time.

    Parameters
    ----------
    known : checksums of the file in the manifest, if it was finished; it may have grown since.
    """
    return (line.record for line in _whole_lines(path, known))


def _whole_lines(path: Path, known: FileSum | None = None) -> Iterator[_Line]:
    """All complete lines; a last line without a newline was cut off, and is left out."""
    try:
        with path.open("rb") as file:
            end = crc = count = 0
            whole = hashlib.sha256()
            for line in file:
                if not line.endswith(b"\n"):
                    break
                count += 1
                end += len(line)
                record, crc = _checked(path, count, line, crc)
                whole.update(line)
                if known is not None and count == known.lines and whole.hexdigest() != known.sha256:
                    raise StorageError(f"{path}:{count}: altered since it was written; the run was left alone")
                yield _Line(record, crc, end)
    except OSError as error:
        raise StorageError(f"cannot read {path}: {reason(error)}") from error
    if known is not None and count < known.lines:  # a crash cuts none of the lines that the manifest counts
        raise StorageError(
            f"{path}:{count + 1}: missing or cut off, {known.lines} lines were written; the run was left alone"
        )


def _checked(path: Path, number: int, line: bytes, before: int) -> tuple[dict[str, Any], int]:
    matched = LINE.fullmatch(line)
    body = matched[1] + b"}" if matched else line
    crc = zlib.crc32(body, before)
    if matched is None or f"{crc:08x}".encode() != matched[2]:
        raise StorageError(f"{path}:{number}: altered, or not in its place (the checksum of the line differs)")
    return parsed(parse_object, body, Path(f"{path}:{number}")), crc


def _sealed_line(record: Mapping[str, Any], before: int) -> tuple[str, int]:
    body = json_text(record)
    crc = zlib.crc32(body.encode(), before)
    return f'{body[:-1]}, "crc": "{crc:08x}"}}\n', crc
