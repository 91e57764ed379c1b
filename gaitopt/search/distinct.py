"""From the candidates of a search to gaits: each solved with its mode sequence, verified, and counted once."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar, overload

import numpy as np

from gaitopt.callbacks import Stop, Valued
from gaitopt.display import Reported
from gaitopt.gait import Gait, Status
from gaitopt.mechanics import Cycle
from gaitopt.problem import Problem, cycle_data
from gaitopt.search.candidates import SAME, Record
from gaitopt.study.system import solve_sequence
from gaitopt.study.verify import verify
from gaitopt.study.warm import free_guesses
from gaitopt.workers.jobs import FailedJob

Item = TypeVar("Item")

ATTEMPTS = 3
"""Candidates of one gait from which it is solved before they are given up."""
SAME_GAIT = 1e-6
"""Gaits of one mode sequence whose states differ by less than this part of their size are one."""


@dataclass(frozen=True, kw_only=True)
class Gaits(Reported, Sequence[Gait]):
    """The gaits of a search, stable ones first.

    Attributes
    ----------
    problem : the problem of the search.
    gaits : verified gaits.
    starts : for every gait the starts that led to it.
    searched : what was tried, and what became of it.
    """

    problem: Problem
    gaits: tuple[Gait, ...]
    starts: tuple[tuple[str, ...], ...]
    searched: Mapping[str, Any] = field(repr=False)

    def __repr__(self) -> str:
        stable = sum(is_stable(gait) for gait in self.gaits)
        return f"<Gaits of {self.problem.name}: {len(self)}, {stable} of them stable>"

    def __len__(self) -> int:
        return len(self.gaits)

    @overload
    def __getitem__(self, key: int) -> Gait: ...

    @overload
    def __getitem__(self, key: slice) -> tuple[Gait, ...]: ...

    def __getitem__(self, key: int | slice) -> Gait | tuple[Gait, ...]:
        return self.gaits[key]

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        pairs = zip(self.gaits, self.starts, strict=True)
        gaits = [{**gait.to_record(), "starts": list(starts)} for gait, starts in pairs]
        return {"problem": self.problem.name, "gaits": gaits, "searched": dict(self.searched)}


def gaits_of(
    problem: Problem,
    parts: Sequence[Record | FailedJob],
    *,
    known: Sequence[Gait] = (),
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gaits:
    """The gaits behind the candidates of all parts of a search; ``known`` ones need not be solved again."""
    done = [part for part in parts if not isinstance(part, FailedJob)]
    candidates = [candidate for part in done for candidate in part["candidates"]]
    part = np.inf if problem.free or problem.objective else SAME  # a design finds its own motion
    listed: list[tuple[Gait, list[str]]] = []
    rejected = []
    for group in grouped([c for c in candidates if _fits(problem, c)], lambda a, b: _same(a, b, part)):
        starts = [candidate["start"] for candidate in group]
        gait = next((gait for gait in known if _same(gait.to_record(), group[0], part)), None)
        gait = gait or _solved(problem, group[:ATTEMPTS], progress, should_stop)
        if not gait.converged or not (gait.verification or {}).get("passed"):
            words = gait.message if not gait.converged else "the simulator does not confirm it"
            rejected.append({"sequence": str(gait.problem.cycle), "reason": words, "starts": starts})
            continue
        record = gait.to_record()
        same = next((own for other, own in listed if _same(other.to_record(), record, SAME_GAIT)), None)
        listed.append((gait, starts)) if same is None else same.extend(starts)
    listed.sort(key=lambda entry: _rank(entry[0]))
    methods = dict.fromkeys(part["method"] for part in done)
    searched = {
        "starts": {method: sum(part["starts"] for part in done if part["method"] == method) for method in methods},
        "candidates": len(candidates),
        "rejected": rejected,
        "failed": [part.reason for part in parts if isinstance(part, FailedJob)],
        "n_steps": getattr(problem.modes, "steps", 1),
    }
    return Gaits(
        problem=problem,
        gaits=tuple(gait for gait, _ in listed),
        starts=tuple(tuple(starts) for _, starts in listed),
        searched=searched,
    )


def closed(problem: Problem, candidate: Mapping[str, Any]) -> Problem:
    """A problem with the mode sequence of a candidate or of a gait's record, and its motion as the guess."""
    cycle = Cycle.from_record(candidate)
    names = problem.walker.section_names(slipping=cycle.impact.slips)
    phases = [phase for step in candidate.get("steps", (candidate,)) for phase in step["phases"]]
    guess = {
        "state": {name: candidate["state"][name] for name in names},
        "durations": [phase["duration"] for phase in phases],
    }
    return problem.replace(
        {"gait": {**cycle_data(cycle), "guess": guess}, **free_guesses(problem, candidate.get("parameters", {}))}
    )


def _solved(problem: Problem, candidates: Sequence[Record], progress: Valued, should_stop: Stop) -> Gait:
    """The gait of the first candidate that leads to one, verified; or the last attempt."""
    for candidate in candidates:
        gait = solve_sequence(closed(problem, candidate), progress=progress, should_stop=should_stop)
        if gait.repeats_after < len(gait.steps):  # a shorter cycle, which is counted once
            record = gait.to_record()
            shorter = record | {"steps": record["steps"][: gait.repeats_after]}
            gait = solve_sequence(closed(problem, shorter), progress=progress, should_stop=should_stop)
        if gait.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if gait.converged:
            return gait.verified(verify(gait).to_record())
    return gait


def _fits(problem: Problem, candidate: Record) -> bool:
    """Whether a candidate has no more steps than the problem allows, and its impact if that is stated."""
    impact = getattr(problem.modes, "impact", None)
    short = len(candidate["steps"]) <= getattr(problem.modes, "steps", 1)
    return short and (impact is None or impact in [step["impact"] for step in candidate["steps"]])


def grouped(items: Iterable[Item], same: Callable[[Item, Item], bool]) -> list[list[Item]]:
    """The items in groups of the ``same``, as far as their first ones tell; groups in the order of those."""
    groups: list[list[Item]] = []
    for item in items:
        group = next((g for g in groups if same(g[0], item)), None)
        groups.append([item]) if group is None else group.append(item)
    return groups


def _same(first: Mapping[str, Any], second: Mapping[str, Any], part: float) -> bool:
    """Whether two records have the same mode sequence, and states that differ by less than a part of their size."""
    a, b = (np.array(list(record["state"].values())) for record in (first, second))
    near = np.abs(a - b).max() < part * np.abs(a).max()
    return bool(near) and Cycle.from_record(first) == Cycle.from_record(second)


def _rank(gait: Gait) -> tuple[bool, float, float]:
    """Stable gaits first; then the better objective, then the smaller spectral radius."""
    return not is_stable(gait), float(gait.solver.get("objective", 0.0)), gait.spectral_radius or 0.0


def is_stable(gait: Gait) -> bool:
    """Whether all multipliers lie within the unit circle."""
    return (gait.spectral_radius or 0.0) < 1
