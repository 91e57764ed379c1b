"""Files of a run folder on the disk: whole files, JSON and CSV, typed records, checksums, and the lock of the writer.

A file is written beside its place under a random name, synced, and renamed into its place: it appears whole or not at
all. No link is followed; a link planted under the name of a file is replaced. A checksum is the SHA-256 of the file and
a short code of every line, code(line) = the last 16 bits of CRC-32(line), which locates a change.
"""

import csv
import hashlib
import io
import json
import math
import os
import re
import secrets
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

from filelock import FileLock, Timeout
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
    """The record of a file as a ``model``, a dataclass or a type of ``gait.records``; unknown entries are dropped.

    Parameters
    ----------
    states : names that every state of the record must have.

    Raises
    ------
    StorageError
        If it does not match the type; the message names file, line and key.
    """
    try:
        return _adapter(model).validate_python(record, context={STATES: states})  # type: ignore[arg-type]
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])[:LONGEST_KEY]
        raise damaged(path, f"{key}: {first['msg']}" if key else first["msg"], line) from error


def damaged(path: Path, words: str, line: int | None = None) -> StorageError:
    """The error for a file whose content is not what was written; ``words`` say what is wrong."""
    place = path if line is None else f"{path}:{line}"
    return StorageError(f"{place} {words}; the run is broken and was left alone")


TEXTS = (".csv", ".json", ".yaml")
"""Files of lines that are written whole."""
GROWING = ".jsonl"
"""Files of lines that grow; each line has a checksum of its own."""
CODE = 4
"""Hexadecimal digits of the code of a line."""
MOST_CODES = 20_000
"""Lines that have a code; with more of them the manifest would become too large."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSum:
    """Checksums of a file.

    Attributes
    ----------
    sha256 : of its first ``size`` bytes; only a file of records may have more of them.
    lines : number of its lines; 0 where it is no text.
    codes : of its lines, one after the other.
    """

    sha256: str
    size: int
    lines: int
    codes: str


def file_sum(path: Path, content: bytes) -> FileSum:
    """The checksum of a file that holds ``content``."""
    lines = content.splitlines(keepends=True) if path.suffix in (*TEXTS, GROWING) else []
    codes = "".join(map(_code, lines[:MOST_CODES])) if path.suffix in TEXTS else ""
    return FileSum(sha256=hashlib.sha256(content).hexdigest(), size=len(content), lines=len(lines), codes=codes)


def check_content(path: Path, content: bytes, known: FileSum) -> None:
    """Refuse a file whose content has changed since it was written."""
    if hashlib.sha256(content).hexdigest() != known.sha256:
        line = _first_difference(content, known)
        place = f"{path}:{line}" if line else f"{path}"
        raise StorageError(f"{place}: altered since it was written (SHA-256 differs); the run was left alone")


def _first_difference(content: bytes, known: FileSum) -> int | None:
    """Number of the first line that has changed; None if the lines have no codes."""
    codes = [_code(line) for line in content.splitlines(keepends=True)]
    written = [known.codes[k : k + CODE] for k in range(0, len(known.codes), CODE)]
    pairs = zip(codes, written, strict=False)
    differing = next((number for number, (a, b) in enumerate(pairs, start=1) if a != b), None)
    return differing or (min(len(codes), len(written)) + 1 if written else None)


def _code(line: bytes) -> str:
    return f"{zlib.crc32(line):08x}"[-CODE:]


MODE_COLUMN = "mode"
"""The column of a trajectory that holds text."""

Cell = float | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows under a header; all cells are numbers except those under ``mode``."""

    header: tuple[str, ...]
    rows: Iterable[Sequence[Cell]]


def json_text(record: Mapping[str, Any], *, indent: int | None = None) -> str:
    """JSON of a record, in ASCII: floats to the last digit, NaN and infinities as null."""
    return json.dumps(_plain(record), indent=indent, allow_nan=False)


def json_file(record: Mapping[str, Any]) -> str:
    """The text of a JSON file: indented."""
    return json_text(record, indent=2) + "\n"


def csv_text(table: Table) -> str:
    """CSV of a table: floats to the last digit, NaN and infinities as empty cells."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.header)
    writer.writerows(
        ["" if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in row] for row in table.rows
    )
    return text.getvalue()


def parse_object(text: str) -> dict[str, Any]:
    """Parse one JSON object, strictly.

    Raises
    ------
    ValueError
        If the text is anything else; the message names the place.
    """
    try:
        record = json.loads(text, parse_constant=_refuse_constant)
    except RecursionError as error:
        raise ValueError("not JSON (nested too deeply)") from error
    except ValueError as error:
        raise ValueError(f"not JSON ({error})") from error
    if not isinstance(record, dict):
        raise ValueError("not a JSON object")
    return record


def parse_csv(text: str) -> Table:
    """Parse what ``csv_text`` wrote; an empty cell is NaN.

    Raises
    ------
    ValueError
        If a row is cut off or a cell is not a number; the message names its line.
    """
    reader = csv.reader(io.StringIO(text))
    header = tuple(next(cell_rows(reader), ()))
    words = [name == MODE_COLUMN for name in header]
    rows: list[tuple[Cell, ...]] = []
    for row in cell_rows(reader):
        if len(row) != len(header):
            raise ValueError(f"line {reader.line_num} has {len(row)} cells where the header has {len(header)}")
        try:
            rows.append(tuple(cell if word else parse_cell(cell) for cell, word in zip(row, words, strict=True)))
        except ValueError as error:
            raise ValueError(f"line {reader.line_num}: {error}") from error
    return Table(header=header, rows=tuple(rows))


def cell_rows(reader: Any) -> Iterator[Any]:
    """The rows of a table; a cell that is too long for the reader is a ValueError."""
    try:
        yield from reader
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: {error}") from error


def parse_cell(cell: str) -> float:
    """The number of a cell, NaN if it is empty.

    Raises
    ------
    ValueError
        If it is not a finite number.
    """
    number = float(cell or "nan")
    if cell and not math.isfinite(number):
        raise ValueError(f"{cell!r} is not a finite number")
    return number


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


def _plain(value: Any) -> Any:
    """The value in types that JSON knows; arrays and NumPy scalars are converted."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value


Parsed = TypeVar("Parsed")

ATTEMPTS = 3
"""At a folder whose parents another process may be removing."""
TEMPORARY_SUFFIX = ".tmp"
TEMPORARY_NAME = re.compile(r"\..+\.(?P<pid>\d+)-[0-9a-f]{16}\.tmp")
"""Of the temporary file of a process; those of killed processes are leftovers."""
OWN_FILE = os.O_NOFOLLOW | os.O_CLOEXEC if os.name == "posix" else os.O_BINARY  # type: ignore[attr-defined]
"""Flags with which every file is opened for writing."""


def write_whole(path: Path, content: str | bytes) -> None:
    """Write ``content`` to ``path``; a reader finds the old file or the new one, even after a crash.

    Raises
    ------
    StorageError
        If the disk is full or the folder cannot be written; what was there before is unchanged.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OWN_FILE, 0o666)
        try:
            write_all(descriptor, content.encode() if isinstance(content, str) else content)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        temporary.replace(path)
        sync_folder(path.parent)
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot write {path}: {reason(error)}; {_kept(path.parent)}") from error
    finally:
        with suppress(OSError, ValueError):  # a disk that refused the file may refuse this too
            temporary.unlink(missing_ok=True)


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
        If it cannot be made, or without ``parents`` if its parent does not exist.
    """
    for attempt in range(ATTEMPTS):
        try:
            missing = list(takewhile(lambda path: not path.is_dir(), (folder, *folder.parents)))
            for path in reversed(missing if parents else missing[:1]):
                path.mkdir(exist_ok=True)
                sync_folder(path.parent)
        except FileNotFoundError as error:  # another process has just removed a parent in which nothing was written
            if not parents or attempt == ATTEMPTS - 1:
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
        words = f"cannot use {folder} as a run folder: {reason(error)}; name another"
        raise StorageError(words).about("output") from error


def clear_leftovers(*folders: Path) -> None:
    """Remove the temporary files of killed processes; those of running processes stay."""
    for folder in folders:
        with suppress(OSError):  # what cannot be listed or removed does no harm
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
        raise StorageError(f"{path} is missing; the run is broken and was left alone") from error
    except OSError as error:
        raise StorageError(f"cannot read {path}: {reason(error)}; the run is broken and was left alone") from error


def sync_folder(folder: Path) -> None:
    """Make new names in ``folder`` survive a power cut (POSIX; other systems have no such call)."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def parsed(parse: Callable[[str], Parsed], content: bytes, path: Path) -> Parsed:
    """The content of a file as ``parse`` returns it.

    Raises
    ------
    StorageError
        If it is not text, or ``parse`` raises a ValueError; the message names the file.
    """
    try:
        return parse(content.decode("utf-8"))
    except ValueError as error:  # of which a UnicodeDecodeError is one
        raise StorageError(f"{path}: {reason(error)}; the run is broken and was left alone") from error


def reason(error: OSError | ValueError) -> str:
    """The reason that the operating system or a parser gives."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    return getattr(error, "strerror", None) or str(error)


def _kept(folder: Path) -> str:
    names = sorted(path.name for path in folder.glob("[!.]*")) if folder.is_dir() else []
    return f"kept whole in {folder}: {', '.join(names)}" if names else "nothing was written"


LOCK_FILE = ".lock"
WRITER_FILE = ".writer"
"""Names the process that holds the lock."""
PATIENCE, LOOK_EVERY = 5.0, 0.02
"""Time that a reader waits for another process to finish a file, and between two checks [s]."""
LOOKS = 5
"""Number of checks in a row that must find no writer, because one writer may follow another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Writer:
    """The process that writes a folder."""

    pid: int
    command: str
    since: str


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Lock an existing folder for writing, and remove the temporary files of killed writers; may be nested.

    Raises
    ------
    StorageError
        If another process holds the lock, the folder cannot be locked, or it was deleted after it was locked.
    """
    try:
        lock = FileLock(folder.resolve() / LOCK_FILE, timeout=0, is_singleton=True)
        lock.acquire()
    except Timeout as error:
        remedy = "wait for it, or name another folder"
        raise StorageError(f"{folder} is being written by {_holder(folder)}; {remedy}").about("output") from error
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot lock {folder}: {reason(error)}") from error
    outermost = lock.lock_counter == 1
    try:
        if outermost:
            clear_leftovers(folder, *(path for path in entries(folder) if path.is_dir() and not path.is_symlink()))
            since = datetime.now().astimezone().isoformat(timespec="seconds")
            writer = Writer(pid=os.getpid(), command=" ".join(sys.argv), since=since)
            write_whole(folder / WRITER_FILE, json_text(asdict(writer)) + "\n")
        elif not _is_ours(folder):
            raise StorageError(f"{folder} was deleted or replaced while this command was writing it")
        yield
    finally:
        if outermost and _is_ours(folder):
            _leave(folder)
        with suppress(OSError):  # the folder may be gone
            lock.release()


def written_elsewhere(folder: Path) -> bool:
    """Whether another running process is writing the folder now."""
    try:
        pid = _writer(folder).pid
    except StorageError:
        return False
    import psutil  # slow to import and rarely needed

    return pid != os.getpid() and psutil.pid_exists(pid)


def wait_for_writer(folder: Path, ready: Callable[[], bool]) -> None:
    """Return once ``ready()`` is true, or no other process writes the folder.

    Raises
    ------
    StorageError
        If another process still writes it after ``PATIENCE``.
    """
    deadline, alone = time.monotonic() + PATIENCE, 0
    while not ready() and alone < LOOKS:
        alone = 0 if written_elsewhere(folder) else alone + 1
        if time.monotonic() > deadline:
            raise StorageError(f"{folder} is being written by {_holder(folder)}: wait until it has finished")
        time.sleep(LOOK_EVERY)


def _writer(folder: Path) -> Writer:
    path = folder / WRITER_FILE
    return validated(Writer, parsed(parse_object, read_bytes(path), path), path)


def _is_ours(folder: Path) -> bool:
    try:
        return _writer(folder).pid == os.getpid()
    except StorageError:
        return False


def _holder(folder: Path) -> str:
    try:
        writer = _writer(folder)
    except StorageError:  # it holds the lock, but has not written its name yet
        return "another process"
    return f"process {writer.pid} ({writer.command}, since {writer.since})"


def _leave(folder: Path) -> None:
    """Remove the writer's name and the lock while it is held, and the folder if nothing was written."""
    with suppress(OSError):  # Windows does not remove open files: there the lock stays, which is harmless
        (folder / WRITER_FILE).unlink()
        (folder / LOCK_FILE).unlink()
        if not any(folder.iterdir()):
            folder.rmdir()
