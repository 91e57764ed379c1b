"""Files that survive a crash: whole files appear whole or not at all, and files of records lose no line.

A whole file is written in its folder under a random name, synced, and then renamed. No link is followed; a link planted
under the name of a file is replaced.

A file of records grows line by line, and each line is durable once it is appended; a last line that a crash cut off is
ignored. Every line ends with a checksum that is chained to the one before it, crc_k = CRC-32(line_k, crc_(k-1)). It
shows whether a line was altered, removed, added or moved.
"""

import hashlib
import os
import re
import secrets
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gaitopt.errors import StorageError
from gaitopt.store.formats import FileSum, json_text, parse_object, parsed, reason

FOLDER_ATTEMPTS = 3
"""Number of attempts to make a folder, because another process may just be removing its parents."""
TEMPORARY_SUFFIX = ".tmp"
MOST_LISTED = 12
"""Largest number of other files that an error message names."""
TEMPORARY_NAME = re.compile(r"\..+\.(?P<pid>\d+)-[0-9a-f]{16}\.tmp")
"""Name of the temporary file of a process; those of killed processes are leftovers."""
NO_LINK = os.O_NOFOLLOW | os.O_CLOEXEC if os.name == "posix" else os.O_BINARY  # type: ignore[attr-defined]
"""Flags with which every file is opened for writing: no link is followed, no child process inherits it."""


def write_whole(path: Path, content: str | bytes) -> None:
    """Write ``content`` to ``path``; a reader finds the old file or the new one, even after a crash.

    Raises
    ------
    StorageError
        If the disk is full or the folder cannot be written; what was there before is unchanged.
    """
    temporary = _temporary(path)
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_LINK, 0o666)
        try:
            write_all(descriptor, content.encode() if isinstance(content, str) else content)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        temporary.replace(path)
        sync_folder(path.parent)
    except (OSError, ValueError) as error:
        names = sorted(other.name for other in path.parent.glob("[!.]*")) if path.parent.is_dir() else []
        listed = [*names[:MOST_LISTED], *([f"{len(names) - MOST_LISTED:,} more"] if len(names) > MOST_LISTED else [])]
        others = f"kept whole in {path.parent}: {', '.join(listed)}" if names else "nothing was written"
        raise StorageError(f"cannot write {path}: {reason(error)}; {others}") from error
    finally:
        with suppress(OSError, ValueError):  # a disk that refused to write may refuse to delete
            temporary.unlink(missing_ok=True)


def _temporary(path: Path) -> Path:
    """A new name in the folder of a file, for its content until it is complete."""
    return path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")


def write_all(descriptor: int, content: bytes) -> None:
    """Write all bytes; one call of the system may write only some of them."""
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def make_folder(folder: Path, *, parents: bool = True) -> list[Path]:
    """Make ``folder`` and its parents, durably; returns those that did not exist, the deepest first.

    Raises
    ------
    StorageError
        If the folder cannot be made, or if its parent does not exist and ``parents`` is False.
    """
    for attempt in range(FOLDER_ATTEMPTS):
        try:
            missing = list(takewhile(lambda path: not path.is_dir(), (folder, *folder.parents)))
            for path in reversed(missing if parents else missing[:1]):
                path.mkdir(exist_ok=True)
                sync_folder(path.parent)
        except FileNotFoundError as error:  # another process has just removed a parent in which nothing was written
            if not parents or attempt == FOLDER_ATTEMPTS - 1:
                raise StorageError(f"cannot make the folder {folder}: {reason(error)}; nothing was written") from error
        except (OSError, ValueError) as error:
            raise StorageError(f"cannot make the folder {folder}: {reason(error)}; nothing was written") from error
        else:
            break
    return missing


def entries(folder: Path) -> list[Path]:
    """Paths of all files in a folder; empty if the folder does not exist."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
    except OSError as error:
        message = f"cannot use {folder} as a run folder: {reason(error)}; choose another"
        raise StorageError(message).concerning("output") from error


def clear_leftovers(*folders: Path) -> None:
    """Remove the temporary files of killed processes; those of running processes stay."""
    for folder in folders:
        with suppress(OSError):  # leftovers that cannot be listed or removed do no harm
            for path in folder.iterdir():
                matched = TEMPORARY_NAME.fullmatch(path.name)
                if matched:
                    import psutil  # its import takes as long as writing a run, and it is rarely needed

                    pid = int(matched["pid"])
                    if pid == os.getpid() or not psutil.pid_exists(pid):
                        path.unlink(missing_ok=True)


def read_bytes(path: Path) -> bytes:
    """Read a file."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise StorageError(f"{path} is missing; the run is damaged and was not changed") from error
    except OSError as error:
        raise StorageError(f"cannot read {path}: {reason(error)}; the run is damaged and was not changed") from error


def sync_folder(folder: Path) -> None:
    """Make new names in ``folder`` survive a power cut (POSIX; other systems have no such call)."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_file(path: Path) -> None:
    """Refuse a file that cannot be written, before anything is computed for it; folders above it may be missing.

    Raises
    ------
    StorageError
        If the path is a folder, if the name is impossible, or if ``check_writable`` refuses it.
    """
    if path.is_dir():
        remedy = f"name a file in it, such as {path / 'walk'}{path.suffix}"
        raise StorageError(f"cannot write {path}: it is a folder; {remedy}").concerning("output")
    try:
        _temporary(path).lstat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:  # too long, or with a null character
        raise StorageError(f"cannot write {path}: {reason(error)}; choose another name").concerning("output") from error
    check_writable(path)


def check_writable(path: Path) -> None:
    """Refuse a file or folder that cannot be made, before anything is computed for it.

    Raises
    ------
    StorageError
        If the nearest existing path above it is not a folder, or may not be written.
    """
    try:
        existing = next(each for each in (path.absolute(), *path.absolute().parents) if each.exists())
    except OSError as error:
        raise StorageError(f"cannot write {path}: {reason(error)}; choose another").concerning("output") from error
    folder = existing.parent if existing == path.absolute() and existing.is_file() else existing
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise StorageError(f"cannot write {path}: {folder} is not writable; choose another place").concerning("output")


LINE = re.compile(rb'(\{.*), "crc": "([0-9a-f]{8})"\}\n')
"""A line: a record whose last key is the checksum."""


def lines_text(records: Iterable[Mapping[str, Any]]) -> str:
    """The text of a file of records."""
    lines, crc = [], 0
    for record in records:
        line, crc = _sealed_line(record, crc)
        lines.append(line)
    return "".join(lines)


class LineWriter:
    """A context manager that appends records to a JSON-lines file. Its user must hold the lock of the folder.

    If the file exists, it is continued after its last complete line.

    Attributes
    ----------
    records : the records that the file contained when it was opened.
    """

    def __init__(self, path: Path, known: FileSum | None = None) -> None:
        self._path, self._known = path, known
        self.records = list[dict[str, Any]]()
        self._file = -1
        self._end = self._crc = 0

    def __enter__(self) -> Self:
        if self._known is not None or self._path.exists():
            for record, end, crc in _whole_lines(self._path, self._known):
                self.records.append(record)
                self._end, self._crc = end, crc
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_APPEND | os.O_CREAT | NO_LINK, 0o666)
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
            still_exists = os.path.samestat(os.fstat(self._file), self._path.lstat())
        except FileNotFoundError:
            still_exists = False
        except OSError as error:
            with suppress(OSError):  # a torn line is dropped on reading anyway
                os.ftruncate(self._file, self._end)
            raise StorageError(
                f"cannot append to {self._path}: {reason(error)}; all records before this one are kept"
            ) from error
        if not still_exists:
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
    known : the checksum of the file in the manifest, if it has one; the file may have grown since.
    """
    return (record for record, _, _ in _whole_lines(path, known))


def _whole_lines(path: Path, known: FileSum | None) -> Iterator[tuple[dict[str, Any], int, int]]:
    """Record, position of the end [bytes] and checksum of every complete line; a line without a newline was cut off."""
    try:
        with path.open("rb") as file:
            end = crc = count = 0
            whole = hashlib.sha256()
            for line in file:
                if not line.endswith(b"\n"):
                    break
                count += 1
                end += len(line)
                matched = LINE.fullmatch(line)
                body = matched[1] + b"}" if matched else line
                crc = zlib.crc32(body, crc)
                if matched is None or f"{crc:08x}".encode() != matched[2]:
                    raise StorageError(
                        f"{path}:{count}: altered, or not in its place (the checksum of the line differs)"
                    )
                whole.update(line)
                if known is not None and count == known.lines and whole.hexdigest() != known.sha256:
                    raise StorageError(f"{path}:{count}: altered since it was written; the run was not changed")
                yield parsed(parse_object, body, Path(f"{path}:{count}")), end, crc
    except OSError as error:
        raise StorageError(f"cannot read {path}: {reason(error)}") from error
    if known is not None and count < known.lines:  # a crash cuts none of the lines that the manifest counts
        raise StorageError(
            f"{path}:{count + 1}: missing or cut off, {known.lines} lines were written; the run was not changed"
        )


def _sealed_line(record: Mapping[str, Any], before: int) -> tuple[str, int]:
    body = json_text(record)
    crc = zlib.crc32(body.encode(), before)
    return f'{body[:-1]}, "crc": "{crc:08x}"}}\n', crc
