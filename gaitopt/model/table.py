"""A table of angles in a problem file: a line of names, followed by rows of numbers.

    t, theta2 [deg]
    0, -6
    0.4, 12

The first column is the argument of the curves: the time since the impact, or a phase variable. It is strictly monotone.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from math import isfinite, radians
from typing import Annotated, Any, Self

import numpy as np
from numpy.polynomial import chebyshev
from pydantic import BaseModel, ConfigDict, Field, model_validator

from gaitopt.arrays import Array
from gaitopt.display import counted
from gaitopt.model.curve import BeyondEnd, Curve, Piece, continuation
from gaitopt.model.units import parse_number

LARGEST_POINT = 1000
"""Largest size of an angle of a table, or of a control point [rad, or m]."""
MOST_ROWS = 100_000
"""Largest number of rows of a table."""
SMALLEST_STEP = 1e-6
"""Smallest step of the first column, relative to its range."""


class Table(BaseModel):
    """The name and the content of a table of angles: a line of names, followed by rows of numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    file: Annotated[str, Field(min_length=1, max_length=200, description="name of the file, for messages")]
    text: Annotated[str, Field(description="content of the file")]

    @model_validator(mode="before")
    @classmethod
    def _text_of_columns(cls, value: Any) -> Any:
        """The data of a table: its content, or that of columns of numbers by name."""
        if not isinstance(value, Mapping) or {*value} == {"file", "text"}:
            return value
        columns = {str(name): _array(column) for name, column in value.items()}
        for name, column in columns.items():
            if column.ndim != 1 or column.dtype.kind not in "iuf":
                raise ValueError(
                    f"the column {name} is not a list of numbers: give {{t: [0, 0.4, 0.8], JOINT: [0, 0.1, 0.2]}}"
                )
        if len({column.size for column in columns.values()}) > 1:
            sizes = ", ".join(f"{name}: {column.size}" for name, column in columns.items())
            raise ValueError(f"the columns differ in length ({sizes})")
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        return {"file": "table", "text": "\n".join(lines) + "\n"}

    @model_validator(mode="after")
    def _check_text(self) -> Self:
        self.columns  # noqa: B018 - raises if the content is wrong
        return self

    @property
    def columns(self) -> Mapping[str, Array]:
        """Numbers by name, shape (rows,) each, in rad and SI units; the first column is that of the phase.

        Raises
        ------
        ValueError
            With file and line of the first mistake.
        """
        return _columns(self)[0]

    @property
    def decimals(self) -> Mapping[str, tuple[str, ...]]:
        """The numbers as texts of the file, with ``deg`` if their column has this unit; for errors see ``columns``."""
        return _columns(self)[1]


def _array(column: Any) -> Array:
    try:
        return np.asarray(column)
    except ValueError:  # a list of lists of different lengths
        return np.asarray(None)


@lru_cache(maxsize=32)
def _columns(table: Table) -> tuple[dict[str, Array], dict[str, tuple[str, ...]]]:
    """Numbers and decimals of a table by the names of its columns."""
    lines = [(k, line.strip()) for k, line in enumerate(table.text.removeprefix("\ufeff").splitlines(), start=1)]
    lines = [(k, line) for k, line in lines if line and not line.startswith("#")]
    form = "a line of names such as t,theta2 (rad; or theta2 [deg]), and rows of numbers"
    if not lines:
        raise ValueError(f"{table.file} is empty: it must have {form}")
    (first, header), *rows = lines
    heads = [re.fullmatch(r"([A-Za-z]\w*)\s*(?:\[(rad|deg|s|m)\])?", word.strip()) for word in header.split(",")]
    if not all(heads):
        raise ValueError(f"{table.file}:{first}: {header[:60]!r} does not name the columns: it must have {form}")
    names, units = zip(*(head.groups() for head in heads if head), strict=True)
    if len({*names}) < len(names) or len(names) < 2:
        reason = "two columns have one name" if len(names) > 1 else "one column is not enough"
        raise ValueError(f"{table.file}:{first}: {reason}: it must have {form}")
    if not 2 <= len(rows) <= MOST_ROWS:
        number = counted(len(rows), "row of numbers", "rows of numbers")
        raise ValueError(f"{table.file} has {number}, must have from 2 to {MOST_ROWS}")
    numbers, decimals = np.empty((len(rows), len(names))), list[list[str]]()
    for n, (k, line) in enumerate(rows):
        cells = line.split(",")
        if len(cells) != len(names):
            number = counted(len(cells), "entry", "entries")
            raise ValueError(f"{table.file}:{k}: has {number}, must have {len(names)}, one for each column")
        decimals.append(
            [f"{cell.strip()} deg" if unit == "deg" else cell.strip() for cell, unit in zip(cells, units, strict=True)]
        )
        for column, cell in enumerate(cells):
            try:
                numbers[n, column] = parse_number(cell)
            except ValueError:
                raise ValueError(f"{table.file}:{k}: {cell.strip()[:40]!r} is not a number") from None
            if not (isfinite(numbers[n, column]) and abs(numbers[n, column]) <= LARGEST_POINT):
                reason = f"is not a finite number of at most {LARGEST_POINT} in size"
                raise ValueError(f"{table.file}:{k}: {names[column]} = {cell.strip()} {reason}")
    numbers[:, [unit == "deg" for unit in units]] *= radians(1)
    steps = np.diff(numbers[:, 0]) * np.sign(numbers[-1, 0] - numbers[0, 0])
    wrong = np.flatnonzero(~(steps > SMALLEST_STEP * abs(numbers[-1, 0] - numbers[0, 0])))
    if wrong.size:
        k = int(wrong[0])
        order = (
            f"{numbers[k + 1, 0]:g} after {numbers[k, 0]:g}; it must increase from row to row, or decrease throughout"
        )
        raise ValueError(f"{table.file}:{rows[k + 1][0]}: {names[0]} = {order}")
    return (
        {name: numbers[:, k] for k, name in enumerate(names)},
        dict(zip(names, map(tuple, zip(*decimals, strict=True)), strict=True)),
    )


@lru_cache(maxsize=32)
def table_curve(table: Table, degree: int | None, phase: str, beyond_end: BeyondEnd | None) -> Curve:
    """Polynomials closest to the rows of a table, or cubic splines (not-a-knot), and their continuation.

    Their coefficients are numbers, so that a proof can take their exact values.
    """
    argument, *columns = table.columns.values()
    angles, names, errors = np.array(columns), tuple(table.columns)[1:], dict[str, float]()
    if degree is None:
        from scipy.interpolate import CubicSpline  # slow to import, and most problems have no table

        spline, at = CubicSpline(argument, angles, axis=1), chebyshev.chebpts1(4)
        edges = list(pairwise(argument.tolist()))
        samples = [spline((start + end) / 2 + (end - start) / 2 * at) for start, end in edges]
        fitted = [chebyshev.chebfit(at, values.T, 3).T for values in samples]
    else:
        edges = [(float(argument[0]), float(argument[-1]))]
        s = 2 * (argument - argument[0]) / (argument[-1] - argument[0]) - 1
        fitted = [chebyshev.chebfit(s, angles.T, degree).T]
        distances = np.abs(chebyshev.chebval(s, fitted[0].T) - angles).max(axis=1)
        errors = dict(zip(names, distances.tolist(), strict=True))
    pieces = tuple(
        Piece(start=start, end=end, rows=tuple(map(tuple, rows.tolist())))
        for (start, end), rows in zip(edges, fitted, strict=True)
    )
    if beyond_end is not None:
        pieces = (*pieces, continuation(pieces[-1], pieces[-1].end, beyond_end))
    return Curve(names=names, pieces=pieces, phase=phase, beyond_end=beyond_end, fit_errors=errors)
