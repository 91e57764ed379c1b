"""The gaits and families of the paper, by short names, and the readings of the text that differ from ours.

The named problems of the catalogue are the gaits as we read the paper; everything else is one of them with a few values
changed.

Gaits and families of gaits: taken from their run folders, or computed, verified and stored there.

Torques that make a walker on level ground copy the joint angles of a walk down a slope, as in Fig. 10.

The slope enters the equations of motion (2) only through G, and the contact force only the rows of x and y, so that

    E_s u = G_s(q; level) - G_s(q; slope)             rows s of the shape coordinates

What the parts of the reproduction show: gaits, and families over friction, by their short names.

What figures and table need, computed by all cores while finished figures are drawn; it is kept in run folders.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import lru_cache
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from casadi import Function

from gaitopt.api.stored import save
from gaitopt.arrays import Array
from gaitopt.branches.request import Request
from gaitopt.errors import SolveError
from gaitopt.gait.branch import TERMINAL
from gaitopt.gait.curves import integral
from gaitopt.gait.gait import Gait
from gaitopt.model.lagrangian import equations_of_motion
from gaitopt.problem.problem import Problem, load_problem
from gaitopt.runs.branch import BranchRun
from gaitopt.runs.results import restore_gait
from gaitopt.search.solve import solve
from gaitopt.store.run import GAIT_FILE, RESULTS, Run
from gaitopt.verification.verify import verify
from gaitopt.workers.jobs import Job, Workers, key_of, run_jobs

Records = list[dict[str, Any]]


class Archive:
    """What has been computed, by problem; nothing is computed twice.

    Parameters
    ----------
    results : folder of the run folders.
    narrate : called with a description of what is computed next.
    should_stop : polled while computing.
    """

    def __init__(
        self,
        results: Path = RESULTS,
        *,
        narrate: Callable[[str], None] = lambda words: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.results, self.narrate, self.should_stop = results, narrate, should_stop
        self._gaits: dict[str, Gait] = {}
        self._families: dict[Path, Records] = {}

    def gait(self, problem: Problem) -> Gait:
        """The verified gait of a problem.

        Raises
        ------
        SolveError
            If there is none, or the forward simulation refutes it.
        StorageError
            If its run folder is broken or taken, or cannot be written.
        """
        if problem.digest not in self._gaits:
            run = self._gait_run(problem)
            stored = run.path(GAIT_FILE).is_file()
            self._gaits[problem.digest] = restore_gait(run.folder) if stored else self._solved(problem)
        return self._gaits[problem.digest]

    def has_gait(self, problem: Problem) -> bool:
        """Whether that gait is kept."""
        return problem.digest in self._gaits or self._gait_run(problem).path(GAIT_FILE).is_file()

    def _gait_run(self, problem: Problem) -> Run:
        """The run folder of a problem's gait, which may not exist yet."""
        run = Run.of(problem, results=self.results)
        run.check(problem)
        return run

    def family(self, problem: Problem, parameter: str, to: Sequence[float]) -> Records:
        """Records of the family of a problem's gait, continued in a parameter towards each value of ``to``."""
        run = self._run(problem, parameter, to)
        if run.folder not in self._families:
            if not _is_complete(run):
                self._continue(run)
            self._families[run.folder] = run.stored()
        return self._families[run.folder]

    def has_family(self, problem: Problem, parameter: str, to: Sequence[float]) -> bool:
        """Whether that family is kept as a whole."""
        return _is_complete(self._run(problem, parameter, to))

    def _run(self, problem: Problem, parameter: str, to: Sequence[float]) -> BranchRun:
        run = BranchRun(problem=problem, request=Request(parameter=parameter, to=tuple(to)))
        return replace(run, output=self.results / run.folder.name)

    def _solved(self, problem: Problem) -> Gait:
        self.narrate(f"solving {problem.name}{_changes(problem)}")
        gait = solve(problem, should_stop=self.should_stop)
        if self.should_stop():
            raise KeyboardInterrupt
        if not gait.steps:
            raise SolveError(f"{problem.name} is {gait.status}: {gait.message}")
        verification = verify(gait)
        if not verification.passed:
            raise SolveError(f"{problem.name}: the forward simulation refutes the gait; see gaitopt verify")
        gait = gait.verified(verification.to_record())
        save(gait, Run.of(problem, results=self.results).folder)
        return gait

    def _continue(self, run: BranchRun) -> None:
        """Walk along a family, from where an earlier walk was stopped."""
        gait = self.gait(run.problem)
        targets = " and ".join(f"{value:g}" for value in run.request.to)
        self.narrate(f"continuing {run.problem.name}{_changes(run.problem)} in {run.request.parameter} to {targets}")
        with run.run.writing(run.problem):
            _, to_come = run.walk(gait, should_stop=self.should_stop)
            deque(to_come, maxlen=0)


def _is_complete(run: BranchRun) -> bool:
    """Whether the walks towards all targets have come to an end."""
    return sum(record.get("type") in TERMINAL for record in run.stored()) >= len(run.request.to)


def _changes(problem: Problem) -> str:
    """What distinguishes problems of one name in the narration."""
    return f" (friction {problem.friction_data}, {problem.impact_law} impact)"


def copied_torques(gait: Gait) -> list[tuple[Array, Array]]:
    """Times (m,) [s] and torques (m, n_u) [N m] on every arc of a gait of a walker with as many motors as angles."""
    walker = gait.problem.walker
    equations = equations_of_motion(type(walker))
    shape = gait.system.n_shape
    terms = Function("terms", [equations.z, equations.p], [equations.G[:shape], equations.E[:shape, :]])
    fields = {name: getattr(walker, name) for name in type(walker).model_fields}
    sloping, level = list(fields.values()), list({**fields, "slope": 0.0}.values())

    def torque(z: Array) -> Array:
        (there, E), (here, _) = terms(z, sloping), terms(z, level)
        return np.linalg.solve(np.asarray(E), np.asarray(here - there)).ravel()

    return [(arc.times, np.array([torque(z) for z in arc.states])) for arc in gait.arcs]


def mean_torques(gait: Gait) -> Array:
    """Their means over the step; shape (n_u,) [N m]."""
    sums = [
        [integral(column, float(times[-1] - times[0])) for column in torques.T]
        for times, torques in copied_torques(gait)
    ]
    return np.asarray(np.sum(sums, axis=0) / gait.period)


FRICTIONLESS: Mapping[str, Any] = MappingProxyType({"impact_law": "frictionless"})
PRINTED_TORQUES: Mapping[str, tuple[float, float]] = MappingProxyType({"I": (-2.73, 0.54), "II": (-0.69, 0.12)})
"""tau1 and tau2 as printed [N m]."""
HALF_DIGIT = 0.005
"""By which the printed torques may be off [N m]."""
CORNERS = tuple(product((-1, 1), repeat=2))


def torques_here(tau1: float, tau2: float) -> dict[str, float]:
    """Printed torques in the sign convention of gaitopt (see ``docs/conventions.md``)."""
    return {"control.ankle": -tau1 - 2 * tau2, "control.hip": tau2}


SOURCES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "wheel": ("rimless-wheel-stick", {}),
    "wheel slipping": ("rimless-wheel-slip", {}),
    "passive": ("compass-passive-stick", {}),
    "passive, leg as printed": (
        "compass-passive-stick",
        {
            "walker.leg_length": 0.8,
            "walker.leg_com": 0.5,
            "friction": 1.0,
            "gait.guess.state.theta1": -0.15,
            "gait.guess.state.dtheta1": 0.996,
            "gait.guess.state.dtheta2": -0.43,
        },
    ),
    "A": ("compass-passive-a", {}),
    "B": ("compass-passive-b", {}),
    "B, frictionless impact": ("compass-passive-b", FRICTIONLESS),
    "I": ("compass-torque-stick", {}),
    "II": ("compass-torque-impact-slip", {}),
    "II, frictionless impact": ("compass-torque-impact-slip", FRICTIONLESS),
    "III": ("compass-pd-impact-slip", {}),
    **{
        f"III, {end}": ("compass-pd-impact-slip", {"control.reference.beyond_end": end})
        for end in ("linear", "hold", "off")
    },
}
"""Problem and changes of every gait that a figure or a number needs."""

FAMILIES: Mapping[str, tuple[float, ...]] = {
    "II, frictionless impact": (0.1, 0.3),
    "B, frictionless impact": (0.1, 0.35),
    "passive": (0.1,),
    "I": (0.09,),
    "II": (0.1, 0.3),
    "wheel": (0.1,),
    "B": (0.1, 0.35),
    "III": (0.05, 0.5),
}
"""Coefficients of friction towards which these gaits are continued; the longest families are the last."""
ROUNDED = ("I", "II, frictionless impact")
"""Gaits of torques that are printed rounded."""


@lru_cache
def problem_of(name: str) -> Problem:
    """The problem behind a short name."""
    source, changes = SOURCES[name]
    problem = load_problem(source)
    return problem.replace(changes) if changes else problem


def gait_of(archive: Archive, name: str) -> Gait:
    """The gait with a short name."""
    return archive.gait(problem_of(name))


def has_gait(archive: Archive, name: str) -> bool:
    """Whether that gait is kept already."""
    return archive.has_gait(problem_of(name))


def family_of(archive: Archive, name: str) -> Records:
    """The family over the coefficient of friction that starts at the gait with a short name."""
    return archive.family(problem_of(name), "friction", FAMILIES[name])


def has_family(archive: Archive, name: str) -> bool:
    """Whether that family is kept already."""
    return archive.has_family(problem_of(name), "friction", FAMILIES[name])


def rounded_torques(archive: Archive, name: str) -> list[Gait]:
    """Gait I or II for the four corners of the torques that round to the printed ones."""
    tau1, tau2 = PRINTED_TORQUES[name.partition(",")[0]]
    corners = [torques_here(tau1 + a * HALF_DIGIT, tau2 + b * HALF_DIGIT) for a, b in CORNERS]
    return [archive.gait(problem_of(name).replace(corner)) for corner in corners]


TABLE = "table"
"""The part that is not a figure."""
CONTROLLED = {
    "I": "I, constant torques",
    "II": "II, weak torques",
    "II, frictionless impact": "II, frictionless impact",
    "III": "III, PD law",
}
SHOWN: Mapping[str, Mapping[str, str]] = {
    "fig2": {"wheel": "no slip, μ = 1", "wheel slipping": "stick-slip, μ = 0.4"},
    "fig3": {"wheel": "no slip"},
    "fig4": {"wheel": "wheel"},
    "fig6": {"passive": "no slip"},
    "fig7": {"passive": "passive", "I": "gait I"},
    "fig8": {"A": "A", "B": "B"},
    "fig8-frictionless": {"A": "A", "B, frictionless impact": "B, frictionless impact"},
    "fig9": {
        "passive": "sticking impact (A)",
        "B": "slipping impact (B)",
        "B, frictionless impact": "B, frictionless impact",
    },
    "fig10": {"passive": "passive", "I": "gait I"},
    "fig11": CONTROLLED,
    "fig12": CONTROLLED,
}
"""Gaits in each figure, and what they are called there."""
OVER_FRICTION = ("fig4", "fig9", "fig11", "fig12")
"""Figures of the families that start at their gaits."""


class Kind(StrEnum):
    """What is computed from a gait's problem."""

    FAMILY = "family"
    ROUNDED = "rounded torques"
    GAIT = "gait"


Need = tuple[Kind, str]
"""A kind, and the short name of a gait."""
EVERYTHING: Sequence[Need] = (
    *((Kind.FAMILY, name) for name in reversed(tuple(FAMILIES))),
    *((Kind.ROUNDED, name) for name in ROUNDED),
    *((Kind.GAIT, name) for name in SOURCES),
)
"""In the order in which it is computed: the longest first, and families before their gaits, which they contain."""


COSTS = {Kind.FAMILY: 3, Kind.ROUNDED: 1, Kind.GAIT: 1}
"""Processor time, in that of one figure."""
CLOSED_LOOP = 3
"""So many times as long take the gaits that track a reference."""


def cost(need: Need) -> int:
    """What a need costs, roughly, in figures."""
    kind, name = need
    return COSTS[kind] * (CLOSED_LOOP if name.startswith("III") else 1)


def needs(parts: Sequence[str]) -> dict[str, set[Need]]:
    """What parts need, the same problem only once."""
    stated = {part: _stated(part) for part in parts}
    every = set().union(*stated.values())
    first: dict[str, Need] = {}
    for need in EVERYTHING:
        if need in every:
            first.setdefault(_identity(need), need)
    return {part: {first[_identity(need)] for need in own} for part, own in stated.items()}


def is_kept(archive: Archive, need: Need) -> bool:
    """Whether there is nothing to compute."""
    kind, name = need
    return kind is not Kind.ROUNDED and (has_family if kind is Kind.FAMILY else has_gait)(archive, name)


def compute(archive: Archive, need: Need) -> None:
    """Compute what is not kept yet, and keep it."""
    kind, name = need
    if kind is Kind.FAMILY:
        family_of(archive, name)
    elif kind is Kind.ROUNDED:
        rounded_torques(archive, name)
    else:
        gait_of(archive, name)


def _stated(part: str) -> set[Need]:
    if part == TABLE:
        return set(EVERYTHING)
    return {(Kind.FAMILY if part in OVER_FRICTION else Kind.GAIT, name) for name in SHOWN[part]}


def _identity(need: Need) -> str:
    kind, name = need
    return f"{kind} {name}" if kind is Kind.ROUNDED else problem_of(name).digest


def prepared(archive: Archive, needed: Sequence[Need], workers: Workers) -> Iterator[Need]:
    """Compute what is not kept yet, and hand over each need when it is met.

    One that fails in another process is left to whoever needs it.
    """
    missing = [need for need in needed if not is_kept(archive, need)]
    yield from (need for need in needed if need not in missing)
    count, results = min(workers.count, len(missing)), str(archive.results.resolve())
    if count < 2:
        for need in missing:
            compute(archive, need)
            yield need
        return
    archive.narrate(f"computing {len(missing)} gaits and families in {count} processes")
    jobs = {key_of([*need, results]): need for need in missing}
    every = [Job(key=key, argument=(*need, results)) for key, need in jobs.items()]
    for key, _ in run_jobs(_compute, every, Workers(count=count), should_stop=archive.should_stop):
        yield jobs[key]
    if archive.should_stop():
        raise KeyboardInterrupt


def _compute(argument: tuple[str, str, str], parent: object) -> None:
    kind, name, results = argument
    compute(Archive(Path(results)), (Kind(kind), name))
