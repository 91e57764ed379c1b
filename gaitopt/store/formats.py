"""Text of the files of a run folder: JSON, CSV and typed records, and the checksums that notice a change.

Floats are written with enough digits that reading gives back every bit. A checksum consists of the SHA-256 of a file
and of a short code of every line, the last 16 bits of CRC-32(line), which locates a change.
"""

import csv
import hashlib
import io
import json
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

from gaitopt.errors import StorageError
from gaitopt.gait.records import STATES, differing, first_fault
from gaitopt.model.units import parse_number

Parsed = TypeVar("Parsed")
Model = TypeVar("Model")
_adapter = lru_cache(TypeAdapter)


def validated(
    model: type[Model], record: Any, path: Path, line: int | None = None, *, states: Sequence[str] | None = None
) -> Model:
    """The validated record of a file: a dataclass ``model``, or the record itself for a type of ``gait.records``.

    Parameters
    ----------
    states : names that every state of the record must have.

    Raises
    ------
    StorageError
        If the record does not match the type; the message names file, line and key.
    """
    try:
        value = _adapter(model).validate_python(record, context={STATES: states})  # type: ignore[arg-type]
    except ValidationError as error:
        raise damaged(path, first_fault(error), line) from error
    # the record, unlike the validated copy, has all digits and the entries of later versions
    return cast(Model, record if isinstance(value, dict) else value)


def damaged(path: Path, fault: str, line: int | None = None) -> StorageError:
    """The error for a file whose content is not the one that was written."""
    location = path if line is None else f"{path}:{line}"
    return StorageError(f"{location} {fault}; the run is damaged and was not changed")


MODE_COLUMN = "mode"
"""The column of a trajectory that holds text."""

Cell = float | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows under a header; all cells are numbers except those under ``mode``."""

    header: tuple[str, ...]
    rows: Iterable[Sequence[Cell]]


def json_text(record: Mapping[str, Any], *, indent: int | None = None) -> str:
    """The JSON of a record in ASCII, with all digits of floats; NaN and infinities become null."""
    return json.dumps(_plain(record), indent=indent, allow_nan=False)


def json_file(record: Mapping[str, Any]) -> str:
    """The text of a JSON file, indented for readers."""
    return json_text(record, indent=2) + "\n"


def csv_text(table: Table) -> str:
    """The CSV of a table, with all digits of floats; NaN and infinities become empty cells."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.header)
    writer.writerows(
        ["" if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in row] for row in table.rows
    )
    return text.getvalue()


def parse_object(text: str) -> dict[str, Any]:
    """Parse a text that is exactly one JSON object.

    Raises
    ------
    ValueError
        If the text is anything else; the message says what and where.
    """

    def refuse_constant(name: str) -> None:
        raise ValueError(f"{name} is not a JSON number")

    try:
        record = json.loads(text, parse_constant=refuse_constant)
    except RecursionError as error:
        raise ValueError("not JSON (nested too deeply)") from error
    except ValueError as error:
        raise ValueError(f"not JSON ({error})") from error
    if not isinstance(record, dict):
        raise ValueError("not a JSON object")
    return record


def parse_csv(text: str) -> Table:
    """Parse the output of ``csv_text``; an empty cell is NaN.

    Raises
    ------
    ValueError
        If a row is cut off or a cell is not a number; the message names its line.
    """
    reader = csv.reader(io.StringIO(text))
    header = tuple(next(cell_rows(reader), ()))
    texts = [name == MODE_COLUMN for name in header]
    rows: list[tuple[Cell, ...]] = []
    for row in cell_rows(reader):
        if len(row) != len(header):
            raise ValueError(f"line {reader.line_num} has {len(row)} cells where the header has {len(header)}")
        try:
            rows.append(tuple(cell if is_text else parse_cell(cell) for cell, is_text in zip(row, texts, strict=True)))
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
        If the cell is not a finite number.
    """
    number = parse_number(cell or "nan")
    if cell and not math.isfinite(number):
        raise ValueError(f"{cell!r} is not a finite number")
    return number


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


def parsed(parse: Callable[[str], Parsed], content: bytes, path: Path) -> Parsed:
    """The content of a file as ``parse`` returns it.

    Raises
    ------
    StorageError
        If the content is not text, or ``parse`` raises a ValueError; the message names the file.
    """
    try:
        return parse(content.decode("utf-8"))
    except ValueError as error:  # includes UnicodeDecodeError
        raise StorageError(f"{path}: {reason(error)}; the run is damaged and was not changed") from error


def reason(error: OSError | ValueError) -> str:
    """The reason that the operating system or a parser gives."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    return getattr(error, "strerror", None) or str(error)


def check_agrees(path: Path, record: Mapping[str, Any], true: Mapping[str, Any], source: str) -> None:
    """Refuse a record that differs from the ``true`` one, which ``source`` determines."""
    key = differing(record, true)
    if key:
        raise damaged(path, f"{key}: is not what {source} gives")


TEXTS = (".csv", ".json", ".yaml")
"""Suffixes of text files that are written whole."""
RECORDS = ".jsonl"
"""Suffix of files of records, which grow; each line has its own checksum."""
CODE_DIGITS = 4
"""Number of hexadecimal digits in the code of a line."""
MOST_CODES = 20_000
"""Largest number of lines of a file that have a code; each code makes the manifest longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSum:
    """Checksums of a file.

    Attributes
    ----------
    sha256 : the SHA-256 of its first ``size`` bytes; only a file of records may have more bytes.
    lines : number of its lines; 0 if it is not a text.
    codes : the codes of its lines, one after the other.
    """

    sha256: str
    size: int
    lines: int
    codes: str


def file_sum(path: Path, content: bytes) -> FileSum:
    """The checksum of a file that holds ``content``."""
    lines = content.splitlines(keepends=True) if path.suffix in (*TEXTS, RECORDS) else []
    codes = "".join(map(_code, lines[:MOST_CODES])) if path.suffix in TEXTS else ""
    return FileSum(sha256=hashlib.sha256(content).hexdigest(), size=len(content), lines=len(lines), codes=codes)


def check_content(path: Path, content: bytes, known: FileSum) -> None:
    """Refuse a file whose content has changed since it was written; with line codes, name the first changed line."""
    if hashlib.sha256(content).hexdigest() == known.sha256:
        return
    location = f"{path}"
    if known.codes:
        codes = [_code(line) for line in content.splitlines(keepends=True)]
        written = [known.codes[k : k + CODE_DIGITS] for k in range(0, len(known.codes), CODE_DIGITS)]
        same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(codes, written, strict=False)))
        location = f"{path}:{same + 1}"
    raise StorageError(f"{location}: altered since it was written (SHA-256 differs); the run was not changed")


def _code(line: bytes) -> str:
    return f"{zlib.crc32(line):08x}"[-CODE_DIGITS:]
