"""All gaits at given parameters, whatever their mode sequence: candidates, each solved, verified and counted once.

Nothing is claimed about gaits that no start has led to: ``searched`` says what was tried.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, overload

import numpy as np

from gaitopt.errors import UnknownNameError
from gaitopt.gait import Gait, Status
from gaitopt.mechanics import Mode
from gaitopt.nlp.ipopt import Progress
from gaitopt.problem import Problem
from gaitopt.study.candidates import GUESSES, SAME, WALKS, Record, SearchJob, search_part
from gaitopt.study.jobs import Job, SetAside, Workers, run_jobs
from gaitopt.study.solve import solve
from gaitopt.study.system import build_system
from gaitopt.study.verify import verify

STARTS = 1000
"""Start states of the search by simulation."""
GUESSED = 8
"""Guesses of the search by complementarity."""
ATTEMPTS = 3
"""Candidates of one gait from which it is solved before they are given up."""
SAME_GAIT = 1e-6
"""Gaits of one mode sequence whose states differ by less than this part of their size are one."""

Within = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Gaits(Sequence[Gait]):
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


def find(
    problem: Problem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    within: Within | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gaits:
    """All gaits at a problem's parameters that two searches lead to, whatever their mode sequence.

    Parameters
    ----------
    problem : its phases are ignored if it has some; a guess is one of the starts. Where parameters are free, the best
        gait of every mode sequence is listed.
    starts : start states of the search by simulation.
    seed : of the samples.
    within : range of the start states by name of a section coordinate, where it is not to be the walker's default.
    workers : processes.
    progress : called with the number of finished parts of the search and their total.
    should_stop : polled; True ends the search with a KeyboardInterrupt.

    Returns
    -------
    gaits : each solved to 1e-10 and verified; stable ones first, then by spectral radius.

    Raises
    ------
    UnknownNameError
        If ``within`` names something that is no section coordinate.
    """
    asked = opened(problem)
    jobs = search_jobs(asked, starts=starts, seed=seed, within=within or {})
    parts = []
    for _, part in run_jobs(search_part, jobs, Workers(count=workers), should_stop=should_stop):
        parts.append(part)
        if progress is not None:
            progress(len(parts), len(jobs))
    if len(parts) < len(jobs):
        raise KeyboardInterrupt
    return gaits_of(asked, parts, should_stop=should_stop)


def find_best(
    problem: Problem, *, progress: Progress | None = None, should_stop: Callable[[], bool] | None = None
) -> Gait:
    """The gait that a problem with an open mode sequence asks for; see ``solve``."""
    jobs = search_jobs(problem, starts=STARTS, seed=0, within={})
    parts = [part for _, part in run_jobs(search_part, jobs, Workers(count=1), should_stop=should_stop)]
    if len(parts) < len(jobs):
        return _none(problem, Status.INTERRUPTED, "interrupted")
    return best_gait(gaits_of(problem, parts, progress=progress, should_stop=should_stop))


def best_gait(gaits: Gaits) -> Gait:
    """Of a design the gait with the best objective; otherwise a stable one, nearest to the guess if there is one."""
    problem = gaits.problem
    if not gaits:
        return _none(problem, Status.NOT_CONVERGED, f"no gait was found from {gaits.searched['starts']} starts")
    best = gaits[0]
    stable = [gait for gait in gaits if _is_stable(gait)]
    if problem.objective:
        best = min(gaits, key=lambda gait: gait.solver["objective"])
    elif problem.start is not None and stable:
        guess = np.array([problem.start.state[name] for name in best.system.state_names])
        best = min(stable, key=lambda gait: float(np.abs(gait.state - guess).max()))
    return replace(best, problem=replace(best.problem, origin=problem))


def opened(problem: Problem) -> Problem:
    """The problem with its mode sequence left open."""
    return problem if problem.is_open else problem.replace({"gait.phases": "auto"})


def search_jobs(problem: Problem, *, starts: int, seed: int, within: Within) -> list[Job]:
    """The parts of a search: so many start states in walks, and the guesses of the search by complementarity.

    Raises
    ------
    UnknownNameError
        If ``within`` names something that is no section coordinate.
    """
    names = problem.walker.section_names(slipping=True)
    unknown = [name for name in within if name not in names]
    if unknown:
        raise UnknownNameError(
            f"within {', '.join(unknown)}: not a coordinate just after an impact; use {', '.join(names)}"
        )
    counts = {"complementarity": -(-GUESSED // GUESSES), "simulation": -(-starts // WALKS)}
    parts = [
        SearchJob(problem=problem, method=method, number=number, seed=seed, within=within)
        for method, count in counts.items()
        for number in range(count)
    ]
    return [Job(key=_key(part), argument=part) for part in parts]


def gaits_of(
    problem: Problem,
    parts: Sequence[Record | SetAside],
    *,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gaits:
    """The gaits behind the candidates of all parts of a search.

    Parameters
    ----------
    progress, should_stop : of the solver, see ``solve``.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` said so.
    """
    done = [part for part in parts if not isinstance(part, SetAside)]
    candidates = [candidate for part in done for candidate in part["candidates"]]
    groups = list(_grouped(problem, [c for c in candidates if _is_wanted(problem, c)]))
    found: list[tuple[Gait, list[str]]] = []
    rejected = []
    for group in groups:
        starts = [candidate["start"] for candidate in group]
        gait = _solved(problem, group[:ATTEMPTS], progress, should_stop)
        known = next((entry for entry in found if _same_gait(entry[0], gait)), None)
        if not gait.converged or not (gait.verification or {}).get("passed"):
            words = gait.message if not gait.converged else "the simulator does not confirm it"
            rejected.append({"sequence": str(gait.problem.cycle), "reason": words, "starts": starts})
        elif known is not None:
            known[1].extend(starts)
        else:
            found.append((gait, starts))
    found.sort(key=lambda entry: _rank(entry[0]))
    methods = dict.fromkeys(part["method"] for part in done)
    searched = {
        "starts": {method: sum(part["starts"] for part in done if part["method"] == method) for method in methods},
        "candidates": len(candidates),
        "rejected": rejected,
        "n_steps": getattr(problem.modes, "steps", 1),
    }
    return Gaits(
        problem=problem,
        gaits=tuple(gait for gait, _ in found),
        starts=tuple(tuple(starts) for _, starts in found),
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
    sequences = [{"phases": [p["mode"] for p in step["phases"]], "impact": step["impact"]} for step in steps]
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
        gait = solve(closed(problem, candidate), progress=progress, should_stop=should_stop)
        if gait.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if gait.converged:
            return gait.verified(verify(gait).to_record())
    return gait


def _is_wanted(problem: Problem, candidate: Record) -> bool:
    impact = getattr(problem.modes, "impact", None)
    return impact is None or impact in [step["impact"] for step in candidate["steps"]]


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
    return tuple((step["impact"], *(phase["mode"] for phase in step["phases"])) for step in steps)


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
    return not _is_stable(gait), float(gait.solver.get("objective", 0.0)), gait.spectral_radius or 0.0


def _is_stable(gait: Gait) -> bool:
    return (gait.spectral_radius or 0.0) < 1


def _none(problem: Problem, status: Status, message: str) -> Gait:
    system = build_system(problem)
    return Gait(problem=problem, system=system, p=system.values(problem.parameters), status=status, message=message)


def _key(part: SearchJob) -> str:
    fields = {
        "problem": part.problem.digest,
        "method": part.method,
        "number": part.number,
        "seed": part.seed,
        "within": {name: list(span) for name, span in part.within.items()},
    }
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()
