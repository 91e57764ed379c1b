"""A floor: friction, height and slope of one tile after the other, under the stance foot of one step after the other.

    tile n      is under the stance foot of step n; the walker already stands on tile 0
    friction    acts in the impact by which the foot lands on the tile, and while it stands on it
    height      [m] of the landing point over the nominal ground, along its normal
    slope       [rad] is added to that of the walker: it tilts tangent and normal of the contact about the landing point

A quantity that the floor does not state keeps its value in the problem. The last tile repeats without end. References
of control laws are those of the nominal floor.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gaitopt.arrays import Array
from gaitopt.display import counted
from gaitopt.errors import ArgumentError, ProblemError
from gaitopt.problem.faults import shown

Coefficients: TypeAlias = float | tuple[float, float]
"""Friction of a tile: one number, or the static and the kinetic coefficient."""
QUANTITIES = ("friction", "height", "slope")
BOUNDS: Mapping[str, tuple[float, float]] = {"friction": (0.0, 100.0), "height": (-10.0, 10.0), "slope": (-1.5, 1.5)}
"""Smallest and largest values of a tile [1, m, rad]."""
UNITS: Mapping[str, str] = {"friction": "", "height": " m", "slope": " rad"}
MOST_TILES = 10_000_000
"""Largest number of equal tiles in one entry of a text."""
LARGEST_DEVIATION = 3.0
"""A normal number that is more standard deviations away from its mean is drawn again."""
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
ENTRY = re.compile(rf"({NUMBER})\s*(deg|rad|m)?\s*(?:/\s*({NUMBER}))?\s*(?:x\s*(\d+))?")
"""One entry of the text of a floor: value, unit, kinetic coefficient and number of tiles."""
SPREAD = re.compile(rf"({NUMBER})\s*:\s*({NUMBER})|normal\(\s*({NUMBER})\s*,\s*({NUMBER})\s*\)")
"""One distribution of the text of a random floor: bounds, or mean and standard deviation."""


@dataclass(frozen=True, slots=True)
class Tile:
    """One tile.

    Attributes
    ----------
    friction : static and kinetic coefficient; None if the tile has those of the problem.
    height : height over the nominal ground [m].
    slope : angle that is added to the slope of the walker [rad].
    """

    friction: tuple[float, float] | None = None
    height: float = 0.0
    slope: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Floor:
    """Friction, height and slope of all tiles; a single number applies to every tile.

    Attributes
    ----------
    friction : coefficient of each tile, or its static and kinetic coefficient; empty if those of the problem apply.
    height : heights over the nominal ground, along its normal [m]; empty if all are zero.
    slope : angles that are added to the slope of the walker [rad]; empty if all are zero.

    Raises
    ------
    ProblemError
        If a value is not a number or out of its range, or there is no tile at all.
    """

    friction: Sequence[Coefficients] | float = ()
    height: Sequence[float] | float = ()
    slope: Sequence[float] | float = ()

    def __post_init__(self) -> None:
        for name in QUANTITIES:
            given = getattr(self, name)
            given = given.tolist() if isinstance(given, np.ndarray) else given
            if isinstance(given, str) or not isinstance(given, Iterable | Real):
                raise ProblemError(f"floor.{name}: {shown(given)} is neither a number nor a list of numbers")
            values = (given,) if isinstance(given, Real) else tuple(given)
            object.__setattr__(self, name, tuple(_checked(name, k, value) for k, value in enumerate(values)))
        if not len(self):
            raise ProblemError("floor: has no tile; give friction, height or slope of at least one")

    def __len__(self) -> int:
        """The number of tiles before the last one repeats."""
        return max(map(len, self._values))

    def tile(self, n: int) -> Tile:
        """Tile ``n``, counted from 0."""
        friction, height, slope = (values[min(n, len(values) - 1)] if values else None for values in self._values)
        pair = None if friction is None else friction if isinstance(friction, tuple) else (friction, friction)
        return Tile(pair, height or 0.0, slope or 0.0)

    @property
    def is_even(self) -> bool:
        """Whether all tiles have the height and the slope of the nominal ground."""
        return not any((*self._values[1], *self._values[2]))

    @property
    def drops(self) -> bool:
        """Whether a tile has a static coefficient of its own beside the kinetic one."""
        return any(isinstance(value, tuple) and value[0] != value[1] for value in self._values[0])

    def to_record(self) -> dict[str, list[Any]]:
        """The stated quantities as JSON lists."""
        lists = zip(QUANTITIES, self._values, strict=True)
        return {
            name: [list(value) if isinstance(value, tuple) else value for value in values]
            for name, values in lists
            if values
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Sequence[Any]]) -> "Floor":
        """The floor of a record."""
        friction = [tuple(value) if isinstance(value, list) else value for value in record.get("friction", ())]
        return cls(friction=friction, height=record.get("height", ()), slope=record.get("slope", ()))

    @classmethod
    def parse(cls, text: str) -> "Floor":
        """The floor of a text such as ``friction=0.2, 0.13x2, 0.2; height=0, 0.01``.

        ``0.13x2`` are two tiles, ``0.5/0.4`` a static and a kinetic coefficient, ``1 deg`` is an angle.

        Raises
        ------
        ProblemError
            If the text states no floor.
        """
        lists: dict[str, list[Any]] = {}
        for name, entry in _entries(text):
            known = ENTRY.fullmatch(entry)
            if known is None:
                raise ProblemError(f"floor.{name}: {entry!r} is no value; write for instance {name}=0.2, 0.13x2, 0.2")
            value, unit, kinetic, count = known.groups()
            lists.setdefault(name, []).extend([_value(name, value, unit, kinetic)] * _count(name, count))
        return cls(**lists)

    @classmethod
    def random(cls, spreads: str, tiles: int, *, seed: int = 0, walk: int = 0) -> "Floor":
        """A floor of independent random tiles, such as ``friction=0.12:0.2`` or ``height=normal(0, 0.002)``.

        Parameters
        ----------
        spreads : text of the distributions of friction, height or slope: smallest and largest value of a uniform one,
            or ``normal(mean, standard deviation)``, whose numbers beyond three standard deviations are drawn again.
        tiles : number of tiles. A longer floor begins with the same tiles.
        seed, walk : numbers that select the random stream; every walk has its own.

        Raises
        ------
        ProblemError
            If the text states no distribution, or a number is not a whole one or too small.
        """
        for name, number, smallest in (("tiles", tiles, 1), ("seed", seed, 0), ("walk", walk, 0)):
            if not isinstance(number, Integral) or number < smallest:
                raise ArgumentError(name, f"is {shown(number)}, but must be a whole number, at least {smallest}")
        return RandomFloor.parse(spreads, seed).draw(tiles, walk)

    @classmethod
    def read(cls, path: str | Path) -> "Floor":
        """The floor of a CSV file with the columns friction (or static and kinetic), height and slope.

        Raises
        ------
        ProblemError
            If the file cannot be read, or a column or a value is wrong; the message names file, line and column.
        """
        if not isinstance(path, str | Path):
            raise ArgumentError("path", f"is {shown(path)}, but must be the path of a CSV file")
        try:
            with Path(path).open(newline="", encoding="utf-8") as file:
                reader = csv.reader(file)
                rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
        except (OSError, ValueError, csv.Error) as error:
            raise ProblemError(f"{path}: the floor cannot be read: {error}") from None
        header = [name.strip() for name in rows[0][1]] if rows else []
        wrong = {*header} - {*QUANTITIES, "static", "kinetic"} or len({*header}) < len(header)
        if wrong or not header or ("static" in header) != ("kinetic" in header) or {"friction", "static"} <= {*header}:
            names = ", ".join(header) or "nothing"
            raise ProblemError(
                f"{path}: columns are friction (or static, kinetic), height and slope, but it has {names}"
            )
        lists: dict[str, list[Any]] = {name: [] for name in header}
        for line, row in rows[1:]:
            if len(row) != len(header):
                mismatch = f"has {counted(len(row), 'value')}, must have {len(header)}, one for each column"
                raise ProblemError(f"{path}, row {line}: {mismatch}")
            for name, text in zip(header, row, strict=True):
                lower, upper = BOUNDS.get(name, BOUNDS["friction"])
                try:
                    value = float(text)
                except ValueError:
                    raise ProblemError(f"{path}, row {line}, {name}: {text!r} is not a number") from None
                if not lower <= value <= upper:
                    raise ProblemError(f"{path}, row {line}, {name}: {text} is outside of {lower:g} to {upper:g}")
                lists[name].append(value)
        if "static" in lists:
            lists["friction"] = list(zip(lists.pop("static"), lists.pop("kinetic"), strict=True))
        try:
            return cls(**lists)
        except ProblemError as error:
            raise ProblemError(f"{path}: {error}") from None

    @property
    def _values(self) -> tuple[tuple[Any, ...], ...]:
        return tuple(getattr(self, name) for name in QUANTITIES)


@dataclass(frozen=True, slots=True)
class Spread:
    """A uniform distribution, or a normal one whose numbers beyond three standard deviations are drawn again.

    Attributes
    ----------
    first, second : lower and upper bound of a uniform distribution, mean and standard deviation of a normal one.
    normal : whether it is normal.
    """

    first: float
    second: float
    normal: bool = False

    def draw(self, random: np.random.Generator, count: int, lower: float) -> Array:
        """The first ``count`` numbers of a stream, none below ``lower``; more numbers begin with the same ones."""
        if not self.normal:
            return random.uniform(self.first, self.second, count)
        found, n = [np.zeros(0)], 0
        while n < count:
            normal = random.standard_normal(count)
            values = self.first + self.second * normal
            found.append(values[(np.abs(normal) <= LARGEST_DEVIATION) & (values >= lower)])
            n += found[-1].size
        return np.concatenate(found)[:count]

    def quantiles(self, shares: Array, lower: float) -> Array:
        """The numbers below which these shares of the distribution lie."""
        if not self.normal:
            return self.first + shares * (self.second - self.first)
        from scipy.special import ndtr, ndtri  # the command line reads this module, and starts without SciPy

        ends = np.array([-LARGEST_DEVIATION, LARGEST_DEVIATION])
        if self.second > 0:
            ends[0] = max(ends[0], (lower - self.first) / self.second)
        below, up_to = ndtr(ends)
        return np.asarray(self.first + self.second * ndtri(below + shares * (up_to - below)))

    def __str__(self) -> str:
        return f"normal({self.first:g}, {self.second:g})" if self.normal else f"{self.first:g}:{self.second:g}"


@dataclass(frozen=True, slots=True)
class RandomFloor:
    """Floors whose tiles are drawn independently of each other.

    Attributes
    ----------
    spreads : distributions of friction, height or slope by name.
    seed : number that selects the random streams; every walk has its own.
    """

    spreads: Mapping[str, Spread] = field(default_factory=dict)
    seed: int = 0

    @classmethod
    def parse(cls, text: str, seed: int = 0) -> "RandomFloor":
        """The floors of a text such as ``friction=0.12:0.2`` or ``friction=normal(0.15, 0.02), height=-0.002:0.002``.

        Raises
        ------
        ProblemError
            If the text states no distribution.
        """
        spreads = dict[str, Spread]()
        for name, entry in _entries(text):
            known = SPREAD.fullmatch(entry)
            if known is None or name in spreads:
                example = f"{name}=0.12:0.2 (uniform) or {name}=normal(0.15, 0.02)"
                raise ProblemError(f"random floor: {name}={entry} is no distribution; write once {example}")
            low, high, mean, deviation = (None if value is None else float(value) for value in known.groups())
            spreads[name] = _spread(name, low, high, mean, deviation)
        return cls(spreads, seed)

    def draw(self, tiles: int, walk: int = 0) -> Floor:
        """The floor of one walk."""
        return Floor(**{name: values.tolist() for name, values in self.arrays(tiles, walk).items()})

    def arrays(self, tiles: int, walk: int = 0) -> dict[str, Array]:
        """The random quantities of the tiles of one walk by name, each with shape (tiles,)."""
        return {
            name: spread.draw(np.random.default_rng([self.seed, walk, QUANTITIES.index(name)]), tiles, BOUNDS[name][0])
            for name, spread in self.spreads.items()
        }

    @property
    def is_even(self) -> bool:
        """Whether neither height nor slope is random."""
        return {*self.spreads} <= {"friction"}

    def __str__(self) -> str:
        return ", ".join(f"{name}={spread}" for name, spread in self.spreads.items())


def _spread(name: str, low: float | None, high: float | None, mean: float | None, deviation: float | None) -> Spread:
    """The distribution with these numbers, after a check of their bounds."""
    lower, upper = BOUNDS[name]
    if low is not None and high is not None:
        if not lower <= low <= high <= upper:
            requirement = f"its limits must ascend within {lower:g} to {upper:g}{UNITS[name]}"
            raise ProblemError(f"random floor: {name}={low:g}:{high:g}: {requirement}")
        return Spread(low, high)
    assert mean is not None
    assert deviation is not None
    if not lower <= mean <= upper or not 0 <= deviation <= upper:
        requirement = (
            f"mean and deviation must be within {lower:g} to {upper:g}{UNITS[name]}, the deviation not negative"
        )
        raise ProblemError(f"random floor: {name}=normal({mean:g}, {deviation:g}): {requirement}")
    return Spread(mean, deviation, normal=True)


def _entries(text: str) -> Iterator[tuple[str, str]]:
    """The entries of a text, each with its quantity; an entry without a name belongs to the quantity before it."""
    if not isinstance(text, str):
        raise ProblemError(f"floor: {shown(text)} is not a text such as friction=0.2, 0.13x2, 0.2")
    name, pieces = "", [piece.strip() for piece in re.split(r"[,;](?![^(]*\))", text)]  # not within parentheses
    if not any(pieces):
        raise ProblemError("floor: is empty; write for instance friction=0.2, 0.13x2, 0.2")
    for piece in filter(None, pieces):
        before, sign, after = piece.partition("=")
        name, entry = (before.strip(), after.strip()) if sign else (name, piece)
        if name not in QUANTITIES:
            fault = f"{name!r} is no quantity of a tile" if name else f"{piece!r} has no name"
            raise ProblemError(f"floor: {fault}; write friction=, height= or slope=, such as friction=0.2, 0.13x2, 0.2")
        yield name, entry


def _value(name: str, value: str, unit: str | None, kinetic: str | None) -> Coefficients:
    fitting = {"height": ("m",), "slope": ("deg", "rad")}.get(name, ())
    if (unit is not None and unit not in fitting) or (kinetic is not None and name != "friction"):
        raise ProblemError(f"floor.{name}: {value}{unit or f'/{kinetic}'} is no value of {name}")
    if kinetic is not None:
        return float(value), float(kinetic)
    return math.radians(float(value)) if unit == "deg" else float(value)


def _count(name: str, count: str | None) -> int:
    number = 1 if count is None else int(count)
    if not 1 <= number <= MOST_TILES:
        raise ProblemError(f"floor.{name}: x{number} tiles; give from 1 to {MOST_TILES:,}")
    return number


def _checked(name: str, k: int, value: Any) -> Any:
    """A value of tile ``k`` as a float, or as a static and a kinetic coefficient, after a check of its bounds."""
    if name == "friction" and isinstance(value, tuple | list):
        if len(value) != 2:
            raise ProblemError(f"floor.friction, tile {k}: {shown(value)} are not a static and a kinetic coefficient")
        static, kinetic = (_checked(name, k, each) for each in value)
        if static < kinetic:
            raise ProblemError(f"floor.friction, tile {k}: static {static:g} is smaller than kinetic {kinetic:g}")
        return static, kinetic
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ProblemError(f"floor.{name}, tile {k}: {shown(value)} is not a number")
    number, (lower, upper) = float(value), BOUNDS[name]
    if not lower <= number <= upper:
        raise ProblemError(f"floor.{name}, tile {k}: {number:g}{UNITS[name]} is outside of {lower:g} to {upper:g}")
    return number
