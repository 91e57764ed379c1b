"""From the candidates of a search to gaits: each solved with its mode sequence, verified, and counted once."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np

from gaitopt.display import Reported
from gaitopt.gait import Gait, Status
from gaitopt.mechanics import Mode
from gaitopt.nlp.ipopt import Progress
from gaitopt.problem import Problem
from gaitopt.search.candidates import SAME, Record
from gaitopt.study.solve import solve_sequence
from gaitopt.study.verify import verify
from gaitopt.workers.jobs import FailedJob

ATTEMPTS = 3
"""Candidates of one gait from which it is solved before they are given up."""
SAME_GAIT = 1e-6
"""Gaits of one mode sequence whose states differ by less than this part of their size are one."""


@dataclass(frozen=True, kw_only=True)
class Gaits(Reported, Sequence[Gait]):
    """The gaits that a search has found, stable ones first.

    Attributes
    ----------
    problem : what was asked.
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
    progress: Progress | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gaits:
    """The gaits behind the candidates of all parts of a search.

    Parameters
    ----------
    known : gaits that need not be solved again.
    progress, should_stop : of the solver, see ``solve``.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` said so.
    """
    done = [part for part in parts if not isinstance(part, FailedJob)]
    candidates = [candidate for part in done for candidate in part["candidates"]]
    groups = list(_grouped(problem, [c for c in candidates if _is_wanted(problem, c)]))
    listed: list[tuple[Gait, list[str]]] = []
    rejected = []
    for group in groups:
        starts = [candidate["start"] for candidate in group]
        gait = next((gait for gait in known if _same(problem, gait.to_record(), group[0])), None)
        gait = gait or _solved(problem, group[:ATTEMPTS], progress, should_stop)
        same = next((entry for entry in listed if _same_gait(entry[0], gait)), None)
        if not gait.converged or not (gait.verification or {}).get("passed"):
            words = gait.message if not gait.converged else "the simulator does not confirm it"
            rejected.append({"sequence": str(gait.problem.cycle), "reason": words, "starts": starts})
        elif same is not None:
            same[1].extend(starts)
        else:
            listed.append((gait, starts))
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
    steps = candidate.get("steps") or [candidate]
    names = problem.walker.section_names(slipping=steps[-1]["impact"] != Mode.STICK)
    guess = {
        "state": {name: candidate["state"][name] for name in names},
        "durations": [phase["duration"] for step in steps for phase in step["phases"]],
    }
    sequences = [
        {"phases": [Mode.from_record(phase).data for phase in step["phases"]], "impact": step["impact"]}
        for step in steps
    ]
    cycle = sequences[0] if len(sequences) == 1 else {"steps": sequences}
    changes: dict[str, object] = {"gait": {**cycle, "guess": guess}}
    for key, free in problem.free.items():
        if key in candidate["parameters"]:
            value = float(np.clip(candidate["parameters"][key], free.lower, free.upper))
            changes[key] = {"free": [free.lower, free.upper], "guess": value}
    return problem.replace(changes)


def _solved(
    problem: Problem, candidates: Sequence[Record], progress: Progress | None, should_stop: Callable[[], bool] | None
) -> Gait:
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


def _is_wanted(problem: Problem, candidate: Record) -> bool:
    impact = getattr(problem.modes, "impact", None)
    short = len(candidate["steps"]) <= getattr(problem.modes, "steps", 1)
    return short and (impact is None or impact in [step["impact"] for step in candidate["steps"]])


def _grouped(problem: Problem, candidates: list[Record]) -> Iterator[list[Record]]:
    """Candidates of the same gait together; of a design, those of the same mode sequence."""
    groups: list[list[Record]] = []
    for candidate in candidates:
        group = next((g for g in groups if _same(problem, g[0], candidate)), None)
        groups.append([candidate]) if group is None else group.append(candidate)
    yield from groups


def _same(problem: Problem, first: Record, second: Record) -> bool:
    if problem.free or problem.objective:  # a design finds its own motion
        return _sequence(first) == _sequence(second)
    return _sequence(first) == _sequence(second) and _near(first["state"], second["state"], SAME)


def _sequence(record: Mapping[str, Any]) -> tuple[Any, ...]:
    steps = record.get("steps") or [record]
    return tuple((step["impact"], *(Mode.from_record(phase) for phase in step["phases"])) for step in steps)


def _near(first: Mapping[str, float], second: Mapping[str, float], part: float) -> bool:
    a, b = (np.array(list(state.values())) for state in (first, second))
    return bool(np.abs(a - b).max() < part * np.abs(a).max())


def _same_gait(known: Gait, gait: Gait) -> bool:
    if not gait.converged:
        return False
    first, second = known.to_record(), gait.to_record()
    return _sequence(first) == _sequence(second) and _near(first["state"], second["state"], SAME_GAIT)


def _rank(gait: Gait) -> tuple[bool, float, float]:
    """Stable gaits first; then the better objective, then the smaller spectral radius."""
    return not is_stable(gait), float(gait.solver.get("objective", 0.0)), gait.spectral_radius or 0.0


def is_stable(gait: Gait) -> bool:
    """Whether all multipliers lie within the unit circle."""
    return (gait.spectral_radius or 0.0) < 1
