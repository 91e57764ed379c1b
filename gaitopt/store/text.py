"""Records and tables as text: JSON and CSV with every digit, and nothing that a strict reader refuses."""

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MODE_COLUMN = "mode"
"""The one column of a trajectory that holds words."""

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
    """The same, indented, as a file of its own."""
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
        If it is anything else; the message says where.
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
    """The rows of a table; a cell of more characters than the reader takes is a ValueError."""
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
    """The same in the types that JSON knows; arrays and NumPy scalars included."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value
