"""A family of gaits along a parameter: its points, its special points, and cascades of period doublings.

The distances of period doublings shrink by a ratio that converges,

    ratio_k = (p_k - p_{k-1}) / (p_{k+1} - p_k)  ->  4.669...

References
----------
M. J. Feigenbaum (1978), Quantitative universality for a class of nonlinear transformations.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar, cast, overload

import numpy as np
from pydantic import TypeAdapter, ValidationError

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.display import Reported, counted
from gaitopt.gait.frames import columns_of, data_frame, data_set
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import (
    BranchRecord,
    ContinuationStateRecord,
    PointRecord,
    SpecialRecord,
    first_fault,
    special_gait,
)
from gaitopt.model.cycle import Cycle
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import Ending
from gaitopt.problem.scalars import unit_of
from gaitopt.problem.statement import cycle_data

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


R = TypeVar("R")
TERMINAL = ("end", "vanishing", str(Ending.LIFT_OFF), str(Ending.PAINLEVE))
"""Types of special points at which a family ends."""
_PLACE = ("branch", "index", "value")
_STATE = TypeAdapter(ContinuationStateRecord)


@dataclass(frozen=True, slots=True, kw_only=True)
class ContinuationState(ReadOnlyArrays):
    """State of a continuation at a point. Together with the gait it resumes the continuation without losing a bit.

    Attributes
    ----------
    unknowns : ndarray, shape (n_w,) - the solution: nodes, durations and parameter, in SI.
    direction : ndarray, shape (n_w,) - tangent of the branch.
    arcs : phase, segment of the control, start, end and number of intervals of every arc. Start and end are the times
        [s] of breakpoints, or None if the arc starts (ends) with its phase.
    origin : value of the parameter at which the natural units of the equations are taken.
    metric : ndarray, shape (n_z + 2,) - scales of arclength: sizes of the states, the period [s], and the span of the
        parameter.
    earlier : number of points before this one that the extrapolation to the next point uses.
    others : like ``origin``, the values of all other parameters of a curve in two parameters; empty on a branch.
    """

    unknowns: Array
    direction: Array
    arcs: tuple[tuple[int, int, float | None, float | None, int], ...]
    origin: float
    metric: Array
    earlier: int
    others: tuple[float, ...] = ()

    @staticmethod
    def from_record(record: ContinuationStateRecord) -> "ContinuationState":
        """The state from the record that ``to_record`` has written, with all its bits.

        Raises
        ------
        ValueError
            If an entry is missing or of another type.
        """
        try:
            _STATE.validate_python(record)
        except ValidationError as error:
            raise ValueError(f"walk: {first_fault(error)}") from error
        return ContinuationState(
            unknowns=np.array(record["unknowns"], dtype=float),
            direction=np.array(record["direction"], dtype=float),
            arcs=tuple((k, segment, start, end, n) for k, segment, start, end, n in record["arcs"]),
            origin=record["origin"],
            metric=np.array(record["metric"], dtype=float),
            earlier=record["earlier"],
            others=tuple(record.get("others", ())),
        )

    def to_record(self) -> ContinuationStateRecord:
        """One JSON object, with enough digits for every bit."""
        record: ContinuationStateRecord = {
            "unknowns": self.unknowns.tolist(),
            "direction": self.direction.tolist(),
            "arcs": list(self.arcs),
            "origin": self.origin,
            "metric": self.metric.tolist(),
            "earlier": self.earlier,
        }
        if self.others:
            record["others"] = list(self.others)
        return record


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchPoint(ReadOnlyArrays):
    """One gait of a family.

    Attributes
    ----------
    branch : number of the branch; it changes with the mode sequence.
    index : number of the point within its branch.
    value : value of the parameter.
    gait : the gait with its motion.
    tangent : ndarray - unit tangent of the branch in scaled section coordinates, durations and parameter.
    length : arclength to the next trial point.
    walk : state of the continuation at this point; None if an earlier version wrote the file.
    """

    branch: int
    index: int
    value: float
    gait: Gait
    tangent: Array
    length: float
    walk: ContinuationState | None = None

    def __repr__(self) -> str:
        return f"<BranchPoint {self.branch}.{self.index} at {self.value:.9g}: {self.gait!r}>"

    def to_record(self) -> PointRecord:
        """One JSON object: the keys of a gait, and its branch, index and value."""
        record = {
            "record": "point",
            "branch": self.branch,
            "index": self.index,
            "value": self.value,
            **self.gait.to_record(),
            "tangent": self.tangent.tolist(),
            "length": self.length,
            "walk": None if self.walk is None else self.walk.to_record(),
        }
        return cast(PointRecord, record)


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecialPoint(ReadOnlyArrays):
    """A special point of a family: a fold, a bifurcation, a change of modes, or an end.

    Attributes
    ----------
    branch : number of its branch.
    type : ``fold``, ``branch_point``, ``period_doubling``, ``neimark_sacker``, ``mode_change``, ``impact_change``, or
        one of ``TERMINAL``.
    value : value of the parameter.
    status : ``converged`` if located to machine precision, ``guess`` if only bracketed.
    reason : an explanation, if any.
    before, after : mode sequences on both sides of a change.
    contact : the named contact, or the group of contacts, whose event it is; empty for other events.
    next : numbers of the branches that continue from here.
    bound : whether this end is a bound of the request; the family itself continues beyond it.
    open : whether the continuation would proceed with more points or more time.
    gait : the gait at this point; None if there is no gait.
    tangent : ndarray - direction of the branch in section coordinates, durations and parameter, in SI; None if
        unknown.
    parameter : dotted key of the parameter.
    coefficients : coefficients of the normal form of a bifurcation: ``b`` for a fold, ``c`` for a period doubling,
        ``re_d`` and ``im_d`` for a Neimark-Sacker point; None at a strong resonance.
    """

    branch: int
    type: str
    value: float
    status: str
    reason: str = ""
    before: Cycle | None = None
    after: Cycle | None = None
    contact: str = ""
    next: tuple[int, ...] = ()
    bound: bool = False
    open: bool = False
    gait: Gait | None = None
    tangent: Array | None = None
    parameter: str = ""
    coefficients: Mapping[str, float | None] = field(default_factory=dict)

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"<SpecialPoint {self.type} at {self.value:.9g} (branch {self.branch}, {self.status}){reason}>"

    def to_record(self) -> SpecialRecord:
        """One JSON object with the keys of the command line."""
        record: dict[str, Any] = {
            "record": "special",
            "branch": self.branch,
            "type": self.type,
            "value": self.value,
            "status": self.status,
            "reason": self.reason,
            "next": list(self.next),
        }
        record |= {"contact": self.contact} if self.contact else {}
        record |= {name: True for name, holds in (("bound", self.bound), ("open", self.open)) if holds}
        for key, cycle in (("from", self.before), ("to", self.after)):
            if cycle is not None:
                record[key] = cycle_data(cycle)
        record |= {"coefficients": dict(self.coefficients)} if self.coefficients else {}
        record["tangent"] = None if self.tangent is None else self.tangent.tolist()
        record["gait"] = {} if self.gait is None else self.gait.to_record()
        return cast(SpecialRecord, record)


@dataclass(frozen=True, kw_only=True)
class Branch(Reported):
    """A family of gaits along a parameter: its points and its special points, in the order of the continuation.

    Each point has a gait. Consecutive points of the same mode sequence have the same branch number; at a special point
    a branch ends or others begin. Index and slice it like a list of points. ``values`` and ``column(name)`` are arrays
    to plot, ``branch(number)`` is one branch of the family, and ``special(type)`` lists special points of a type, from
    which ``gaitopt.continuation`` follows other branches.

    Attributes
    ----------
    parameter : dotted key of the parameter.
    points, specials : points and special points in the order of the continuation.
    """

    parameter: str
    points: tuple[BranchPoint, ...] = ()
    specials: tuple[SpecialPoint, ...] = ()

    def __repr__(self) -> str:
        if not self.points:
            return f"<Branch over {self.parameter}: no points>"
        low, high = self.values.min(), self.values.max()
        counts = f"{counted(len(self), 'point')}, {counted(len(self.specials), 'special point')}"
        return (
            f"<Branch {self.points[0].gait.problem.name} over {self.parameter} from {low:.6g} to {high:.6g}: {counts}>"
        )

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[BranchPoint]:
        return iter(self.points)

    @overload
    def __getitem__(self, key: int) -> BranchPoint: ...

    @overload
    def __getitem__(self, key: slice) -> "Branch": ...

    def __getitem__(self, key: int | slice) -> "BranchPoint | Branch":
        if not isinstance(key, slice):
            return self.points[key]
        points = self.points[key]
        branches = {point.branch for point in points}
        specials = tuple(special for special in self.specials if special.branch in branches)
        return Branch(parameter=self.parameter, points=points, specials=specials)

    @property
    def values(self) -> Array:
        """Value of the parameter at every point; shape (n,)."""
        return np.array([point.value for point in self.points])

    def column(self, name: str) -> Array:
        """A scalar of the gait at every point, NaN where it is not defined; shape (n,).

        Raises
        ------
        KeyError
            If gaits have no such scalar.
        """
        return np.array([point.gait.scalar(name) for point in self.points], dtype=float)

    def branch(self, number: int) -> "Branch":
        """The points and special points with one branch number."""
        points = tuple(point for point in self.points if point.branch == number)
        specials = tuple(special for special in self.specials if special.branch == number)
        return Branch(parameter=self.parameter, points=points, specials=specials)

    def special(self, kind: str) -> tuple[SpecialPoint, ...]:
        """All special points of one type."""
        return tuple(special for special in self.specials if special.type == kind)

    def to_records(self) -> list[BranchRecord]:
        """The JSON objects of all points, then of all special points."""
        return [*(point.to_record() for point in self.points), *(special.to_record() for special in self.specials)]

    def to_frame(self) -> "DataFrame":
        """Points and special points as a pandas data frame: the columns of ``branch.csv``.

        Units are in ``attrs["units"]``.
        """
        header, rows = branch_table(self.to_records())
        return data_frame(header, rows, self._units(header), parameter=self.parameter)

    def to_xarray(self) -> "Dataset":
        """The points as an xarray dataset over ``point``, with units as attributes.

        ``multiplier_re`` and ``multiplier_im`` have the further dimension ``multiplier``; gaits with fewer multipliers
        are filled up with NaN.
        """
        header, rows = branch_table(self.to_records())
        columns = columns_of(header, rows[: len(self.points)])
        variables: dict[str, tuple[Sequence[str], Any]] = {
            name: (("point",), values) for name, values in columns.items() if name != "type"
        }
        most = max((point.gait.multipliers.size for point in self.points), default=0)
        multipliers = np.full((len(self.points), most), np.nan + 1j * np.nan)
        for row, point in zip(multipliers, self.points, strict=True):
            row[: point.gait.multipliers.size] = point.gait.multipliers
        for name, values in (("multiplier_re", multipliers.real), ("multiplier_im", multipliers.imag)):
            variables[name] = (("point", "multiplier"), values)
        coordinates = {name: variables.pop(name) for name in _PLACE}
        return data_set(variables, coordinates, self._units(header), parameter=self.parameter)

    def _units(self, header: Sequence[str]) -> dict[str, str]:
        problem = self.points[0].gait.problem if self.points else None
        return {name: unit_of(name, problem) for name in header} | {"value": unit_of(self.parameter, problem)}


def collected(parameter: str, records: Sequence[BranchPoint | SpecialPoint]) -> Branch:
    """The branch made of points and special points in the order in which they were computed."""
    points = tuple(record for record in records if isinstance(record, BranchPoint))
    specials = tuple(record for record in records if isinstance(record, SpecialPoint))
    return Branch(parameter=parameter, points=points, specials=specials)


def ends_by_request(record: Mapping[str, Any]) -> bool:
    """Whether a special point ends the continuation only because of its request, not because the family ends."""
    return bool(record.get("bound") or record.get("open"))


def branch_table(records: Sequence[BranchRecord]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of the table of a branch: points and special points in the order of their records."""
    first = next(record for record in records if record["record"] == "point")
    scalars = [key for key, value in first.items() if isinstance(value, int | float) and key not in _PLACE]
    header = [*_PLACE, "type", "phases", "impact", *(f"state.{name}" for name in first["state"]), *scalars]
    rows = list[list[Any]]()
    for record in records:
        gait = record if record["record"] == "point" else special_gait(record)
        row: dict[str, Any] = {**(gait or {}), **record, "phases": ""}
        row["type"] = "point" if record["record"] == "point" else record["type"]
        if gait is not None:
            row |= {f"state.{name}": value for name, value in gait["state"].items()}
            row["phases"] = (", " if first.get("contacts") else " ").join(
                Mode.from_record(phase).brief for phase in gait["phases"]
            )
        rows.append([row.get(column) for column in header])
    return header, rows


@dataclass(frozen=True, slots=True, kw_only=True)
class Cascade:
    """A chain of period doublings: each one lies on the family that begins at the one before.

    Attributes
    ----------
    n_steps : number of steps of the cycle at each doubling, before its period doubles.
    values : value of the parameter at each doubling.
    """

    n_steps: tuple[int, ...]
    values: tuple[float, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ratio of each distance between neighbouring doublings to the next distance."""
        distances = [later - earlier for earlier, later in pairwise(self.values)]
        return tuple(first / second for first, second in pairwise(distances))

    def __str__(self) -> str:
        doublings = [
            f"{n} -> {2 * n} steps at {value:.10g}" for n, value in zip(self.n_steps, self.values, strict=True)
        ]
        ratios = [f"{ratio:.5g}" for ratio in self.ratios]
        return ", ".join(doublings) + (f"; ratios of the distances {', '.join(ratios)}" if ratios else "")


def split_after(records: Iterable[R], is_end: Callable[[R], bool]) -> Iterator[list[R]]:
    """The records of each walk along a branch or curve, up to its end; the last walk may be unfinished."""
    walk = list[R]()
    for record in records:
        walk.append(record)
        if is_end(record):
            yield walk
            walk = []
    if walk:
        yield walk


def cascades(records: Iterable[Mapping[str, Any]]) -> list[Cascade]:
    """All chains of two or more doublings; each chain follows the first doubling of every family.

    Parameters
    ----------
    records : records of points and special points; only the keys ``record``, ``type``, ``branch``, ``next``, ``value``
        and ``n_steps`` are needed.
    """
    steps, doublings, changes = dict[int, int](), list[Mapping[str, Any]](), dict[int, list[int]]()
    for record in records:
        if record["record"] == "point":
            steps[record["branch"]] = record["n_steps"]
        elif record["type"] == "period_doubling":
            doublings.append(record)
        elif record["type"] in ("mode_change", "impact_change"):
            changes.setdefault(record["branch"], []).extend(record["next"])

    def family(doubling: Mapping[str, Any]) -> list[int]:
        """Branches that begin at a doubling, and those that continue them through changes of the mode sequence."""
        branches = list(doubling["next"])
        for branch in branches:  # the list grows during the loop
            branches += [number for number in changes.get(branch, ()) if number not in branches]
        return branches

    def chain(doubling: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
        """A doubling, the first doubling of the family that begins there, and so on."""
        following: Mapping[str, Any] | None = doubling
        while following is not None:
            yield following
            branches = family(following)
            following = next((later for later in doublings if later["branch"] in branches), None)

    begun = {branch for doubling in doublings for branch in family(doubling)}
    chains = [list(chain(doubling)) for doubling in doublings if doubling["branch"] not in begun]
    return [
        Cascade(n_steps=tuple(steps[d["branch"]] for d in doubled), values=tuple(d["value"] for d in doubled))
        for doubled in chains
        if len(doubled) > 1
    ]
