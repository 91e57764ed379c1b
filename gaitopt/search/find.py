"""All gaits at given parameters, of any mode sequence: candidates are solved, verified, and listed once.

The search may miss gaits; ``searched`` of the result says what was tried and what was rejected.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import takewhile
from typing import Any, TypeVar, overload

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, Valued
from gaitopt.display import Reported, counted
from gaitopt.errors import UnknownNameError
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.records import CandidateRecord, SearchRecord
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import has_stated_sections
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import OpenSequence
from gaitopt.requests import Method, SearchRequest
from gaitopt.search.candidate import SAME
from gaitopt.search.candidates import SearchJob, find_candidates, walks_of
from gaitopt.search.starts import StartBox, Within, box_around, guess_of, natural_limits, section_near, start_box
from gaitopt.systems import problem_dynamics, solve_sequence
from gaitopt.verification.verify import recorded_claims, verify
from gaitopt.workers.jobs import FailedJob, Job, ResumableJobs, Workers, key_of

Item = TypeVar("Item")

MOST_ATTEMPTS = 3
"""Largest number of candidates from which one gait is solved."""
MOST_BOXES = 5
"""Largest number of boxes of start states; usually the second one contains all gaits far from its walls."""
GROWN_BOX_SHARE = 4
"""A box around gaits gets this fraction of the start states of the first box, because most walks from it continue."""
NEAR_WALL = 0.1
"""A state is near the wall of a box if its distance from the wall, relative to the width, is below this."""
SAME_GAIT = 1e-6
"""Two gaits of one mode sequence are the same if the relative difference of their states is below this."""


@dataclass(frozen=True, kw_only=True)
class Gaits(Reported, Sequence[Gait]):
    """The gaits of a search, stable ones first.

    Attributes
    ----------
    problem : the problem of the search.
    gaits : verified gaits.
    starts : for every gait, the starts that led to it.
    searched : a record of the search: the number of ``starts`` by method, the ``boxes`` of start states, ``warnings``
        about gaits near the wall of the last box, the number of ``candidates``, those ``rejected`` with reasons, jobs
        that ``failed``, ``n_steps`` of the longest cycle, and whether the search is ``complete``.
    """

    problem: Problem
    gaits: tuple[Gait, ...]
    starts: tuple[tuple[str, ...], ...]
    searched: Mapping[str, Any] = field(repr=False)

    def __repr__(self) -> str:
        starts = counted(sum(self.searched["starts"].values()), "start")
        gaits = counted_gaits([is_stable(gait) for gait in self.gaits])
        return f"<Gaits of {self.problem.name}: {gaits}, found from {starts}; there may be more>"

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
    results: Sequence[SearchRecord | FailedJob],
    *,
    known: Sequence[Gait] = (),
    method: Method = Method.AUTO,
    solved: dict[tuple[int, ...], Gait] | None = None,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gaits:
    """The gaits of the candidates of all jobs of a search.

    Candidates with more steps than the problem allows, or without the impact that it requires, are skipped.

    Parameters
    ----------
    results : results of the jobs.
    known : verified gaits, which are not solved again.
    method : method that solves the candidates.
    solved : gaits and failed solves of earlier calls, by the identities of their candidates; new ones are added.
    """
    solved = {} if solved is None else solved
    finished = [result for result in results if not isinstance(result, FailedJob)]
    candidates = [candidate for result in finished for candidate in result["candidates"]]
    tolerance = np.inf if problem.free or problem.objective else SAME  # designs of one mode sequence reach one optimum
    listed: list[tuple[Gait, list[str]]] = []
    rejected = dict[tuple[str, str], list[str]]()
    most, impact = longest_cycle(problem), required_impact(problem)
    fitting = [
        candidate
        for candidate in candidates
        if len(candidate["steps"]) <= most
        and (impact is None or impact.words in [step["impact"] for step in candidate["steps"]])
    ]
    for group in grouped(fitting, lambda a, b: _same(a, b, tolerance)):
        starts = [candidate["start"] for candidate in group]
        gait = next((gait for gait in known if _same(gait.to_record(), group[0], tolerance)), None)
        if gait is None:
            ids = tuple(map(id, group[:MOST_ATTEMPTS]))
            before = (solved[ids[:n]] for n in range(1, len(ids) + 1) if ids[:n] in solved)
            gait = next((attempt for attempt in before if attempt.converged), solved.get(ids))
            if gait is None:
                gait = solved[ids] = _solved(problem, group[:MOST_ATTEMPTS], method, progress, should_stop)
        claims = [] if gait.verification is None else recorded_claims(gait.verification)
        refuted = [claim.summary for claim in claims if not claim.passed]
        if not gait.converged or refuted:
            reason = f"the simulator does not confirm it: {'; '.join(refuted)}" if gait.converged else gait.message
            rejected.setdefault((str(gait.problem.cycle), reason), []).extend(starts)
            continue
        record = gait.to_record()
        known_starts = next((s for other, s in listed if _same(other.to_record(), record, SAME_GAIT)), None)
        if known_starts is None:
            listed.append((gait, starts))
        else:
            known_starts.extend(starts)

    def rank(entry: tuple[Gait, list[str]]) -> tuple[bool, float, float]:
        gait, _ = entry
        return not is_stable(gait), float(gait.solver.get("objective", 0.0)), gait.spectral_radius or 0.0

    listed.sort(key=rank)  # stable gaits first
    searched_starts = Counter[str]()
    for result in finished:
        searched_starts[result["method"]] += result["starts"]
    searched = {
        "starts": dict(searched_starts),
        "candidates": len(candidates),
        "rejected": [{"sequence": cycle, "reason": why, "starts": starts} for (cycle, why), starts in rejected.items()],
        "failed": [result.reason for result in results if isinstance(result, FailedJob)],
        "n_steps": most,
        "boxes": [],
        "warnings": [],
        "complete": True,
    }
    return Gaits(
        problem=problem,
        gaits=tuple(gait for gait, _ in listed),
        starts=tuple(tuple(starts) for _, starts in listed),
        searched=searched,
    )


def _solved(
    problem: Problem, candidates: Sequence[CandidateRecord], method: Method, progress: Valued, should_stop: Stop
) -> Gait:
    """The verified gait of the first candidate that converges, or the last failed solve."""
    for candidate in candidates:
        guessed = problem.with_gait(candidate)
        gait = solve_sequence(guessed, method=method, progress=progress, should_stop=should_stop)
        if gait.repeats_after < len(gait.steps):  # the gait repeats a shorter cycle
            record: dict[str, Any] = {**gait.to_record()}
            record["steps"] = record["steps"][: gait.repeats_after]
            shorter = problem.with_gait(record)
            gait = solve_sequence(shorter, method=method, progress=progress, should_stop=should_stop)
        if gait.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if gait.converged:
            return gait.verified(verify(gait).to_record())
    return gait


def grouped(items: Iterable[Item], same: Callable[[Item, Item], bool]) -> list[list[Item]]:
    """Items in groups; an item joins the first group whose first item is the same according to ``same``."""
    groups: list[list[Item]] = []
    for item in items:
        group = next((g for g in groups if same(g[0], item)), None)
        groups.append([item]) if group is None else group.append(item)
    return groups


def _same(first: Mapping[str, Any], second: Mapping[str, Any], tolerance: float) -> bool:
    """Whether two records have the same mode sequence, and states that agree within a relative tolerance."""
    a, b = (np.array(list(record["state"].values())) for record in (first, second))
    near = np.abs(a - b).max() < tolerance * np.abs(a).max()
    return bool(near) and Cycle.from_record(first).untimed == Cycle.from_record(second).untimed


def is_stable(gait: Gait) -> bool:
    """Whether all multipliers lie within the unit circle."""
    return (gait.spectral_radius or 0.0) < 1


def counted_gaits(stable: Sequence[bool]) -> str:
    """A text with the number of gaits, and of the stable ones among them."""
    if len(stable) < 2:
        return f"1 gait, {'stable' if stable[0] else 'unstable'}" if stable else "no gait"
    return f"{len(stable)} gaits, {'none' if not any(stable) else sum(stable)} of them stable"


def required_impact(problem: Problem) -> Mode | None:
    """The mode just after some impact of the cycle that a problem with an open mode sequence asks for, if any."""
    return problem.modes.impact if isinstance(problem.modes, OpenSequence) else None


def longest_cycle(problem: Problem) -> int:
    """Largest number of steps of a cycle for a problem with an open mode sequence."""
    return getattr(problem.modes, "steps", 1)


@dataclass(frozen=True, kw_only=True)
class SearchPlan(SearchRequest):
    """A search for the gaits of a problem with an open mode sequence."""

    problem: Problem

    def check(self) -> None:
        """Refuse ranges of start states that do not fit the walker.

        Raises
        ------
        ProblemError, UnknownNameError
            If ``within`` has a key that is not a section coordinate, or there is no guess around which it lies.
        """
        if not self.within:
            return
        section, dynamics = self.problem.section, problem_dynamics(self.problem)
        if section is None or not section.stated:
            section = section_near(dynamics, guess_of(self.problem, dynamics))
        names = () if section is None else section.every_step.names
        unknown = [name for name in self.within if name not in names]
        if unknown:
            raise UnknownNameError(
                f"within {', '.join(unknown)}: not a coordinate just after an impact; use {', '.join(names)}"
            )

    def job(
        self, problem: Problem, method: str, number: int, parameter: str = "", *, within: Within | None = None
    ) -> Job:
        """A job of the search, by default in the box of the first round; its key is the same in every run."""
        search_job = SearchJob(
            problem=problem,
            method=method,
            number=number,
            seed=self.seed,
            within=self.within if within is None else within,
            parameter=parameter,
            n_steps=longest_cycle(self.problem),
            solver=self.method if method == "families" else Method.AUTO,
        )
        identity = {entry.name: getattr(search_job, entry.name) for entry in fields(search_job)}
        if search_job.solver is Method.AUTO:
            del identity["solver"]  # the keys of earlier versions do not contain a method
        return Job(
            key=key_of(identity | {"problem": problem.digest, "within": dict(search_job.within)}), argument=search_job
        )


def find_best(
    problem: Problem, *, method: Method = Method.AUTO, progress: Valued = None, should_stop: Stop = None
) -> Gait:
    """The gait that ``solve`` returns for a problem with an open mode sequence."""
    jobs = ResumableJobs(workers=Workers(count=1), should_stop=should_stop)
    try:
        gaits = search(SearchPlan(problem=problem, method=method), jobs, progress=progress)
    except KeyboardInterrupt:
        return _none(problem, Status.INTERRUPTED, "interrupted")
    return best_gait(gaits)


def search(
    plan: SearchPlan, jobs: ResumableJobs, *, found: Callable[[Gaits], None] | None = None, progress: Valued = None
) -> Gaits:
    """The gaits to which walks lead, and further gaits on their families.

    Further walks start in a box around the known gaits, until the box contains all gaits and none of them lies near its
    wall. If there is no gait, the box is halved, because steps become smaller with the slope.

    Parameters
    ----------
    jobs : does the jobs of the search. Its ``should_stop`` ends the search with a KeyboardInterrupt; its ``limit`` ends
        it with the gaits of the finished jobs.
    found : called with the known gaits whenever there are more.
    progress : called by the solver.
    """
    plan.check()
    solved, results, gaits = dict[tuple[int, ...], Gait](), list[SearchRecord | FailedJob](), gaits_of(plan.problem, [])
    list_gaits = partial(
        gaits_of, plan.problem, method=plan.method, solved=solved, progress=progress, should_stop=jobs.should_stop
    )

    def complete(pending: Sequence[Job]) -> list[SearchRecord | FailedJob]:
        """Do some jobs; the gaits of finished jobs are solved in the order of the jobs."""
        count = len(gaits)

        def finished(done: int, total: int) -> None:
            nonlocal count
            if jobs.progress is not None:
                jobs.progress(done, total)
            if found is not None:
                known = [jobs.results[job.key] for job in takewhile(lambda job: job.key in jobs.results, pending)]
                so_far = list_gaits([*results, *known], known=gaits)
                if len(so_far) > count:
                    count = len(so_far)
                    found(so_far)

        return replace(jobs, progress=finished).complete(find_candidates, pending, len(pending))

    problem, dynamics, walks = plan.problem, problem_dynamics(plan.problem), -(-plan.starts // walks_of(plan.problem))
    has_box = has_stated_sections(type(problem.walker), problem.cycle_end)
    boxes = [start_box(problem, dynamics, plan.within)] if has_box else []
    pending = [plan.job(problem, "simulation", number) for number in range(walks)]
    n_followed, n_jobs = 0, 0
    while True:
        n_jobs += len(pending)
        results += complete(pending)
        before = [gait.to_record() for gait in gaits]
        gaits = list_gaits(results, known=gaits)
        new = [gait for gait in gaits if not any(_same(gait.to_record(), known, SAME_GAIT) for known in before)]
        families = family_jobs(plan, new, n_followed)
        if families:
            n_followed, n_jobs = n_followed + len(new), n_jobs + len(families)
            results += complete(families)
            gaits = list_gaits(results, known=gaits)
        if not has_box:  # starts lie around a guess
            return replace(gaits, searched={**gaits.searched, "complete": len(results) == n_jobs})
        box = grown_box(plan, dynamics, boxes[-1], gaits)
        if len(boxes) == MOST_BOXES or box.ranges == boxes[-1].ranges or len(results) < n_jobs:
            break
        first = walks + (len(boxes) - 1) * (grown := -(-walks // GROWN_BOX_SHARE))
        pending = [plan.job(problem, "simulation", number, within=box.ranges) for number in range(first, first + grown)]
        boxes.append(box)
    stated = {
        "boxes": [box.ranges for box in boxes],
        "warnings": near_walls(plan, dynamics, boxes[-1], gaits),
        "complete": len(results) == n_jobs,
    }
    return replace(gaits, searched={**gaits.searched, **stated})


def grown_box(plan: SearchPlan, dynamics: Dynamics, box: StartBox, gaits: Sequence[Gait]) -> StartBox:
    """The next box of start states; ranges that the user has given, and boxes of designs, do not change."""
    if plan.problem.free or plan.problem.objective:
        return box
    limits = natural_limits(dynamics, dynamics.system.section(Mode.SLIP_FORWARD))
    lower, upper = box.lower / 2, box.upper / 2
    if gaits:
        around = box_around(plan.problem, dynamics, _section_states(gaits))
        lower, upper = np.maximum(around.lower, -limits), np.minimum(around.upper, limits)
    fixed = np.array([name in plan.within for name in box.names]) | (lower >= upper)  # all gaits beyond the limit
    return replace(box, lower=np.where(fixed, box.lower, lower), upper=np.where(fixed, box.upper, upper), default=False)


def _section_states(gaits: Iterable[Gait]) -> Array:
    """Section coordinates of gaits at the start of every step; if the legs differ, of every second step."""
    return np.array(
        [
            step.arcs[0].states[0][gait.system.section(Mode.SLIP_FORWARD).indices]
            for gait in gaits
            for step in gait.steps[:: gait.dynamics.steps_per_cycle]
        ]
    )


def near_walls(plan: SearchPlan, dynamics: Dynamics, box: StartBox, gaits: Sequence[Gait]) -> list[str]:
    """One sentence for each coordinate in which gaits lie near the wall of a box or outside of it."""
    if not gaits:
        return []
    around, sentences = box_around(plan.problem, dynamics, _section_states(gaits)), list[str]()
    for k, name in enumerate(box.names):
        lower, upper = box.ranges[name]
        values = [_section_states([gait])[:, k] for gait in gaits]
        distances = [min((value - lower).min(), (upper - value).min()) / (upper - lower) for value in values]
        near = [str(number) for number, distance in enumerate(distances) if distance < NEAR_WALL]
        if near:
            relation = "outside of" if min(distances) < 0 else "near the wall of"
            whose = f"{'gait' if len(near) == 1 else 'gaits'} {', '.join(near)}"
            wider = f"{min(lower, around.lower[k]):.6g}:{max(upper, around.upper[k]):.6g}"
            sentences.append(
                f"start states had {name} in {lower:.6g}:{upper:.6g}, and {name} of {whose} is {relation} this range; "
                f"search within {name}={wider} too, where more gaits may exist"
            )
    return sentences


def best_gait(gaits: Gaits) -> Gait:
    """For a design, the gait with the best objective; otherwise the stable gait nearest to the guess."""
    problem = gaits.problem
    if not gaits:
        starts = ", ".join(f"{counted(n, 'start')} of {method}" for method, n in gaits.searched["starts"].items())
        return _none(problem, Status.NOT_CONVERGED, f"no gait was found from {starts}")
    best = gaits[0]
    stable = [gait for gait in gaits if is_stable(gait)]
    if problem.objective:
        best = min(gaits, key=lambda gait: float(gait.solver["objective"]))
    elif problem.start is not None and stable:
        guess = np.array([problem.start.state[name] for name in best.system.state_names])
        best = min(stable, key=lambda gait: float(np.abs(gait.state - guess).max()))
    return replace(best, problem=replace(best.problem, origin=problem))


def with_open_modes(problem: Problem) -> Problem:
    """The problem with an open mode sequence, without a guess that is a step length or postures, not a state."""
    if problem.is_open:
        return problem
    guess: dict[str, object] = {} if problem.guess.first is None else {"gait.guess": None}
    return problem.replace({"gait.phases": "auto"} | guess)


def family_jobs(plan: SearchPlan, gaits: Iterable[Gait], first: int = 0) -> list[Job]:
    """The jobs that follow families in friction and slope, numbered from ``first``; none for designs."""
    if plan.problem.free or plan.problem.objective:
        return []
    values = plan.problem.parameters
    varied = [key for key in values if key.partition(".")[0] == "friction" or key == "walker.slope"]
    return [
        plan.job(plan.problem.with_gait(gait.to_record()), "families", number, parameter)
        for number, gait in enumerate(gaits, start=first)
        for parameter in varied
        if values[parameter]
    ]


def _none(problem: Problem, status: Status, message: str) -> Gait:
    return Gait(problem=problem, dynamics=problem_dynamics(problem), status=status, message=message)
