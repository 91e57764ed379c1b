"""Rectangular grids over named quantities, LO:HI:N along each, and whether they fit on the machine."""

import math
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.errors import ArgumentError, ProblemError, StorageError, UnknownNameError
from gaitopt.model.units import parse_angle, parse_number
from gaitopt.problem.faults import nearest_keys
from gaitopt.problem.problem import Problem

Indices = NDArray[np.intp]
LONGEST_AXIS = 10**9
"""Largest number of values of an axis."""
INTEGER_TOLERANCE = 1e-9
"""A value of an axis that is this close to an integer counts as one, because equal steps are rounded."""
LARGEST_SHOWN_SIZE = 10**30
"""Largest size that a message states [bytes]."""
UNCHECKED_MEMORY = 2**24
"""Less memory than this is never checked [bytes]: the imports take more, and psutil, which knows the free memory, is
slow to import."""
JOB_BYTES_DISK = 6_000
"""Size of the record of one gait, as JSON and in a table [bytes]."""
JOB_BYTES_MEMORY = 40_000
"""Size of one problem with its record [bytes]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """Equidistant values of one key: ``count`` values from ``lower`` to ``upper``, including both.

    ``unit`` is ``deg`` if the ends were given in degrees; they are in rad here.

    Raises
    ------
    ValueError
        If the range is empty, or not finite.
    """

    key: str
    lower: float
    upper: float
    count: int
    unit: str = ""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise ValueError(f"{self.key}: {self.lower:g}:{self.upper:g} is not a finite range")
        if self.count > LONGEST_AXIS:
            raise ValueError(f"{self.key}: {self.count:.3g} values; at most {LONGEST_AXIS:,} are possible")
        if self.count < 1 or (self.count == 1) != (self.lower == self.upper):
            raise ValueError(
                f"{self.key}: {self.count} values from {self.lower:g} to {self.upper:g} are not a range; "
                "give LO:HI:N with LO unlike HI and N at least 2"
            )

    @property
    def ends(self) -> tuple[float, float]:
        """The first and the last value."""
        return self.lower, self.upper

    @property
    def values(self) -> Array:
        """The values in order; shape (count,)."""
        return np.linspace(self.lower, self.upper, self.count)

    def numbers(self, problem: Problem) -> list[float]:
        """The values, as integers if the parameter of the problem is an integer.

        Raises
        ------
        ProblemError
            If the parameter is an integer, but a value is not.
        """
        values: list[float] = self.values.tolist()
        if not isinstance(problem.parameters.get(self.key), int):
            return values
        between = next((value for value in values if abs(value - round(value)) > INTEGER_TOLERANCE), None)
        if between is not None:
            low, high = math.ceil(self.lower), math.floor(self.upper)
            remedy = f"give a step of one or more, for instance {low}:{high}:{high - low + 1}"
            raise ProblemError(f"{self}: {between:g} is not an integer: {remedy}").concerning("over")
        return [round(value) for value in values]

    def __str__(self) -> str:
        return f"{self.key}={self.lower!r}:{self.upper!r}:{self.count}"


def axis_of(key: str, lower: float | str, upper: float | str, count: int) -> Axis:
    """The axis between two ends: numbers, or texts of numbers or angles. Its unit is deg if one end is in degrees.

    Raises
    ------
    ValueError
        If an end is not a number, or the range is empty or not finite.
    """
    degrees = any(isinstance(end, str) and end.strip().endswith("deg") for end in (lower, upper))
    unit = "deg" if degrees else ""
    try:
        ends = number_or_angle(lower), number_or_angle(upper)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
    return Axis(key=key, lower=ends[0], upper=ends[1], count=count, unit=unit)


def number_or_angle(end: float | str) -> float:
    """The number in a text, or the angle in rad if the text has a unit."""
    if not isinstance(end, str):
        return float(end)
    try:
        return parse_number(end)
    except ValueError:
        pass
    try:
        return float(str(parse_angle(end)))
    except ValueError:
        raise ValueError(f"{end.strip()!r} is not a number or an angle such as 2 deg") from None


@dataclass(frozen=True, slots=True)
class Grid:
    """The product of some axes; points are numbered with the last axis running fastest.

    Raises
    ------
    ValueError
        If there is no axis, or two with the same key.
    """

    axes: tuple[Axis, ...]

    def __post_init__(self) -> None:
        keys = [axis.key for axis in self.axes]
        if not keys or len(set(keys)) < len(keys):
            raise ValueError("a grid needs at least one axis, and no key twice")

    @property
    def axis(self) -> Axis:
        """The only axis of the grid.

        Raises
        ------
        ArgumentError
            If the grid has more than one axis.
        """
        if len(self.axes) != 1:
            raise ArgumentError("over", f"has {len(self.axes)} keys, but must have one: give KEY and its range once")
        return self.axes[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(axis.count for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def points(self, numbers: Indices) -> Array:
        """Coordinates of the points with the given numbers; shape (n, n_axes)."""
        indices = np.unravel_index(numbers, self.shape)
        return np.column_stack([axis.values[index] for axis, index in zip(self.axes, indices, strict=True)])


def check_parameters(problem: Problem, *axes: Axis) -> None:
    """Refuse axes whose keys are not parameters of a problem."""
    check_known((axis.key for axis in axes), tuple(problem.parameters), f"a parameter of {problem.name}")


def check_known(keys: Iterable[str], known: Sequence[str], what: str) -> None:
    """Refuse keys of axes that are not ``known``; ``what`` says in the message what a key has to be."""
    for key in keys:
        if key not in known:
            raise UnknownNameError(f"{key}: not {what}{nearest_keys(key, known)}").concerning("over")


def at_point(problem: Problem, values: Mapping[str, float]) -> Problem:
    """The problem at a point of a grid, given by its values by dotted key."""
    try:
        return problem.replace(values)
    except ProblemError as error:
        error.concerning("over")
        raise


def check_jobs_fit(jobs: int, folder: Path, what: str = "points") -> None:
    """Refuse more problems than fit, before anything is written; raises the errors of ``check_room``."""
    check_room(jobs, folder, disk=JOB_BYTES_DISK, memory=JOB_BYTES_MEMORY, what=what)


def check_room(points: int, folder: Path, *, disk: int, memory: int, what: str = "points") -> None:
    """Refuse a number of points that does not fit on the disk or in memory, before the work starts.

    Parameters
    ----------
    points : number of points.
    folder : the folder in which they are stored; it need not exist.
    disk, memory : size of one point [bytes].
    what : what the message calls the points.

    Raises
    ------
    StorageError
        If they do not fit; the message states their size.
    """
    parent = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    room = [("on disk", disk, shutil.disk_usage(parent).free)]
    if points * memory > UNCHECKED_MEMORY:
        import psutil

        room.append(("of memory", memory, psutil.virtual_memory().available))
    for where, each, free in room:
        if points * each > free:
            from rich.filesize import decimal

            raise StorageError(
                f"{points:,} {what} need about {decimal(min(points * each, LARGEST_SHOWN_SIZE))} {where}, "
                f"but {decimal(free)} are free: choose fewer"
            )
