"""Tables and numbers as a person likes to read them, in a terminal of any width."""

import math
from collections.abc import Iterable, Sequence
from typing import Literal

from rich import box
from rich.console import Console
from rich.table import Table

GAP = 3
"""Columns between two cells."""
NEGLIGIBLE = 1e-12
"""Shown as zero: rounding, in any unit that occurs here."""


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    widths: Sequence[int] | None = None,
) -> Table:
    """A plain table; the columns at ``numbers`` are right-aligned, and words wrap in a narrow terminal."""
    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    cells = [tuple(row) for row in rows]
    for index, (column, *own) in enumerate(zip(columns, *cells, strict=True)):  # no word is broken or lost
        justify: Literal["right", "left"] = "right" if index in numbers else "left"
        least = max(map(_longest_word, (column, *own)))
        fixed = None if widths is None else widths[index]
        grid.add_column(column, justify=justify, overflow="fold", min_width=least, width=fixed)
    for row in cells:
        grid.add_row(*row)
    return grid


def section(
    console: Console,
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
) -> None:
    """Print a table under its title."""
    console.print(f"\n{title}", style="bold")
    print_table(console, columns, rows, numbers=numbers)


def print_table(
    console: Console, columns: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = ()
) -> None:
    """Print a table; where its words do not fit side by side, every row as a block of lines instead."""
    cells = [tuple(row) for row in rows]
    widths = _widths(list(zip(columns, *cells, strict=True)), console.width - GAP * (len(columns) - 1))
    if widths is not None:
        console.print(table(columns, cells, numbers=numbers, widths=widths))
        return
    for row in cells:
        console.print(row[0], style="bold", soft_wrap=False, overflow="fold")
        for column, cell in list(zip(columns, row, strict=True))[1:]:
            if cell:
                console.print(f"  {column}: {cell}" if column else f"  {cell}", overflow="fold")


def _widths(columns: Sequence[tuple[str, ...]], room: int) -> list[int] | None:
    """Widths of columns, the widest narrowed until all fit into ``room``; None where their words do not."""
    least = [max(map(_longest_word, column)) for column in columns]
    widths = [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]
    if sum(least) > room:
        return None
    while sum(widths) > room:
        widths[max((k for k, width in enumerate(widths) if width > least[k]), key=widths.__getitem__)] -= 1
    return widths


def _longest_word(text: str) -> int:
    return max((len(word) for word in text.split()), default=0)


def number(value: float | None) -> str:
    """Six digits for the eye; the JSON has them all."""
    if value is None:
        return "-"
    return f"{0.0 if abs(value) < NEGLIGIBLE else value:.6g}"


def with_degrees(value: float, unit: str) -> str:
    """The unit, and for an angle the value in degrees behind it."""
    return f"{unit} ({math.degrees(value):.5g} deg)" if unit == "rad" else unit
