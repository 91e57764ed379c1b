"""A design: the gait that minimises an objective over freed parameters v and meets constraints.

    min over (w, v) of f(w, v)      s.t.  F(w, v) = 0,      margins(w, v) >= 0,      lo <= c(w, v) <= hi

w are the nodes and durations, and F the equations of the step. The search starts from a known gait, or from the motion
rolled out from the guess. IPOPT first solves the smoothed problem over w and v (``smoothed``). It starts again from its
solution if that lies on the boundary of its trust region, or if a switch has passed a breakpoint of the control. Then
sequential quadratic programming in v only solves the exact problem (``exact``, ``sqp``). It is repeated on finer meshes
until the gait is resolved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, Valued
from gaitopt.design.exact import SMALL, WORST, Evaluation, ExactProblem, freed_sizes
from gaitopt.design.smoothed import SmoothedProblem, conflicts
from gaitopt.design.spectral_radius import RADIUS
from gaitopt.design.sqp import LARGEST_VIOLATION, SearchResult, kkt_residual, optimise
from gaitopt.gait.gait import Cause, Gait, Status, best_point, describe_causes
from gaitopt.gait.measures import exceeded_limits
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import kind
from gaitopt.problem.problem import Problem
from gaitopt.solver.assembly import assemble_gait
from gaitopt.solver.diagnosis import rejection_reason, status_without_gait
from gaitopt.solver.ipopt import what_limits
from gaitopt.solver.newton import Solution, polish, refine
from gaitopt.solver.program import ShootingProgram
from gaitopt.solver.rollout import guessed_motion, retraced, rolled_again
from gaitopt.solver.solve import free_parameters

MAX_ROUNDS = 12
"""Largest number of searches of the smoothed problem, each from the solution of the one before."""
NEXT_TO_GAIT = 1e-6
"""Largest residual of the equations, in natural units, at which the exact search may begin although IPOPT failed."""
MAX_MESHES = 3
"""Largest number of searches of the exact problem, each on the mesh that the optimum of the one before needs."""
COALESCENCE = 1e-3
"""Distance of two multipliers, relative to their modulus, below which rounding changes them by its root."""
AT_THE_EDGE = 1e-8
"""An optimum is at the edge of an impact that would stick if the margin, in natural units, is smaller: ``clearance`` is
a hundredth of it."""
SMALLEST_GAIN = 1e-9
"""Smallest relative difference of two objectives by which one design over scenarios is better than another one."""
CREDITED_COST = 1.2
"""Ratio of absolute to net cost above which the message says that the design profits from negative work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """A margin of a mode sequence at which an optimum over scenarios lies, although it would improve beyond it.

    Attributes
    ----------
    scenario : index of the gait.
    key, change : freed parameter that crosses the margin fastest, and its typical size with the sign that crosses.
    """

    scenario: int
    key: str
    change: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioOptimum:
    """The end of a search over scenarios.

    Attributes
    ----------
    own : the gait of the first scenario, whose freed parameters are those of all.
    objective : value of the objective.
    violation : largest violation of a constraint.
    shortcoming : why it is not an optimum, or why there is no gait in the first scenario; None for an optimum with a
        gait. In other scenarios a phase may vanish, which is the end of their mode sequences.
    edges : margins that limit it.
    """

    own: Gait
    objective: float
    violation: float
    shortcoming: str | None
    edges: tuple[Edge, ...]

    @property
    def feasible(self) -> bool:
        """Whether all constraints are met."""
        return self.violation < LARGEST_VIOLATION

    def is_better(self, other: "ScenarioOptimum") -> bool:
        """Whether it violates less than another one, or has a smaller objective if both are feasible."""
        if not (self.feasible and other.feasible):
            return self.violation < other.violation
        return self.objective < other.objective - SMALLEST_GAIN * max(abs(other.objective), SMALL)


def design_gait(
    problem: Problem,
    system: HybridSystem,
    first: Gait,
    *,
    exact_only: bool = False,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gait:
    """The best gait over the freed parameters of ``problem``; for other arguments see ``systems.solve_sequence``.

    Parameters
    ----------
    first : a gait of the same system with the same mode sequence, at which the design starts. If it is a failed
        attempt, the design starts from the guess.
    exact_only : whether to solve the exact problem without the smoothed one; ``first`` must then be a gait.
    """
    design = _Design(problem, system, progress, should_stop)
    return design.run_exact(first) if exact_only else design.run(first)


def design_program(problem: Problem, system: HybridSystem, first: Gait) -> ShootingProgram:
    """The program that IPOPT solves first in ``design_gait``."""
    design = _Design(problem, system, None, None)
    return design.smoothed(design.start(first)).program


def design_scenarios(
    problem: Problem,
    gaits: Sequence[Gait],
    shares: Sequence[float],
    *,
    worst: bool = False,
    progress: Valued = None,
    should_stop: Stop = None,
) -> ScenarioOptimum | None:
    """The best gaits of several scenarios, which share the values of all freed parameters; None if a gait is lost.

    Parameters
    ----------
    problem : the problem that states objective and constraints, which every gait has to meet.
    gaits : converged gaits of one system with equal freed parameters, such as on floors of different friction. The
        problem of each has its own mode sequence.
    shares : weight of each gait in the objective.
    worst : whether the largest objective of all gaits is minimised instead.
    """
    design = _Design(problem, gaits[0].system, progress, should_stop)
    return design.run_scenarios(gaits, shares, worst=worst)


class _Design:
    """The searches of one design."""

    def __init__(self, problem: Problem, system: HybridSystem, progress: Valued, should_stop: Stop) -> None:
        self._problem, self._progress, self._should_stop = problem, progress, should_stop
        free = free_parameters(problem, system)
        self._free, self._bounds = tuple(free), np.array(list(free.values())).T
        self._dynamics = Dynamics.of(system, problem.parameters)

    def run(self, first: Gait) -> Gait:
        """Solve the smoothed problem until its solution stays in the trust region, and then the exact one."""
        begin = start = self.start(first)
        iterations = 0
        for _ in range(MAX_ROUNDS):
            smoothed = self.smoothed(start)
            result = smoothed.solve()
            iterations += result.iterations
            solver = {"iterations": float(iterations), "kkt": result.kkt, "objective": result.objective}
            at = smoothed.motion(result.w)
            if result.status is Status.INTERRUPTED:
                return self._failed(result.status, result.message, solver, at=at)
            # where the iterations ran out next to a gait, the exact search may finish
            solved, near, gait = result.status is Status.CONVERGED, at.size <= NEXT_TO_GAIT, None
            if (solved or near) and at.in_order and not smoothed.hits_trust_region(result.w):
                gait = self._optimum(at, iterations)
                if gait.status in (Status.CONVERGED, Status.INTERRUPTED):
                    return gait
            elif solved:
                start = rolled_again(at).on_mesh(self._free)
                continue
            # constraints that no gait meets may be met where a motion degenerates, which is no gait
            causes = self._conflicts(start) or (() if start is begin else self._conflicts(begin))
            if causes:
                conflicts = "\n".join(cause.description for cause in causes)
                return self._failed(Status.INFEASIBLE, conflicts, solver, causes, at=at)
            if gait is not None and solved:
                return gait
            limits = what_limits(smoothed.program.unknowns, smoothed.program.rows, result)
            return self._failed(result.status, f"{result.message}: {limits}", solver, at=at)
        return self._failed(Status.NOT_CONVERGED, "the search does not converge", solver, at=at)

    def start(self, first: Gait) -> Solution:
        """The motion with which a search begins."""
        rolled = retraced(first) if first.steps else guessed_motion(self._problem, self._dynamics)
        return rolled.on_mesh(self._free)

    def run_exact(self, first: Gait) -> Gait:
        """Solve the exact problem from a gait."""
        if not first.converged:
            return self._failed(first.status, first.message, first.solver, first.causes)
        return self._optimum(self.start(first), 0)

    def smoothed(self, start: Solution, *, elastic: bool = False) -> SmoothedProblem:
        """The smoothed problem around a motion."""
        return SmoothedProblem(
            self._problem,
            start,
            bounds=self._bounds,
            elastic=elastic,
            progress=self._progress,
            should_stop=self._should_stop,
        )

    def _conflicts(self, start: Solution) -> tuple[Cause, ...]:
        """The constraints that cannot be met, by repeated elastic searches from the start."""
        if not self._problem.constraints:
            return ()
        for _ in range(MAX_ROUNDS):
            elastic = self.smoothed(start, elastic=True)
            result = elastic.solve()
            if result.status is not Status.CONVERGED or not elastic.hits_trust_region(result.w):
                break
            start = rolled_again(elastic.motion(result.w)).on_mesh(self._free)
        return conflicts(self._problem, elastic, result)

    def _optimum(self, start: Solution, iterations: int) -> Gait:
        """The optimum of the exact problem. If the fast search fails, a cautious one follows."""
        gait = self._exact(start, iterations)
        if gait.status in (Status.CONVERGED, Status.INTERRUPTED):
            return gait
        return self._exact(start, int(gait.solver.get("iterations", iterations)), cautious=True)

    def _exact(self, smoothed: Solution, iterations: int, *, cautious: bool = False) -> Gait:
        """The optimum of the exact problem next to that of the smoothed one; for ``cautious`` see ``optimise``."""
        exact, refined = ExactProblem(self._problem, self._free, self._bounds), refine(polish(smoothed))
        found = self._searched(exact, (refined,), cautious=cautious)
        if found is None:
            lost = rejection_reason(refined)
            message = describe_causes(lost) or "the gait is not found on a finer mesh"
            return self._failed(status_without_gait(lost), message, {}, lost, at=refined)
        (optimum, (refined,)), solution = found, found[0].evaluation.scenarios[0].solution
        iterations += optimum.iterations
        solver = {"iterations": float(iterations), "kkt": optimum.kkt, "objective": optimum.evaluation.objective}
        if optimum.interrupted:
            return self._failed(Status.INTERRUPTED, "interrupted", solver, at=solution)
        causes = rejection_reason(refined)
        if causes or optimum.shortcoming:
            message = describe_causes(causes) or str(optimum.shortcoming)
            return self._failed(status_without_gait(causes), message, solver, causes, at=refined)
        gait = assemble_gait(self._problem, refined, message="", solver=solver)
        edge = [c for c in optimum.evaluation.constraints if kind(c.name) == "impact_onset" and c.value < AT_THE_EDGE]
        return replace(gait, message=_message(gait, at_onset=bool(edge)))

    def _searched(
        self, exact: ExactProblem, refined: tuple[Solution, ...], *, cautious: bool = False
    ) -> tuple[SearchResult, tuple[Solution, ...]] | None:
        """The optimum on meshes fine enough for it, and its gaits; None if one is not found on a finer mesh."""
        iterations = 0
        for _ in range(MAX_MESHES):
            start = exact.evaluate(refined)
            if start is None:
                return None
            sizes, progress, should_stop = self._sizes(start), self._progress, self._should_stop
            optimum = optimise(exact, start, sizes, cautious=cautious, progress=progress, should_stop=should_stop)
            iterations += optimum.iterations
            solutions = [gait.solution for gait in optimum.evaluation.scenarios]
            refined = tuple(map(refine, solutions))
            same = all(fine.equations is coarse.equations for fine, coarse in zip(refined, solutions, strict=True))
            if same or optimum.interrupted:
                break
        return replace(optimum, iterations=iterations), refined

    def run_scenarios(self, gaits: Sequence[Gait], shares: Sequence[float], *, worst: bool) -> ScenarioOptimum | None:
        """The optimum over several scenarios; see ``design_scenarios``."""
        exact = ExactProblem(self._problem, self._free, self._bounds, shares, worst=worst)
        starts, iterations = tuple(refine(polish(self.start(gait))) for gait in gaits), 0
        best: ScenarioOptimum | None = None
        for cautious in (False, True):
            found = self._searched(exact, starts, cautious=cautious)
            if found is None or not np.isfinite(found[1][0].errors).all():
                continue
            optimum, refined = found
            iterations += optimum.iterations
            solver = {"iterations": float(iterations), "kkt": optimum.kkt, "objective": optimum.evaluation.objective}
            lost = describe_causes(rejection_reason(refined[0])) or None
            shortcoming = "interrupted" if optimum.interrupted else optimum.shortcoming or lost
            result = ScenarioOptimum(
                own=assemble_gait(gaits[0].problem, refined[0], message="solved", solver=solver),
                objective=optimum.evaluation.objective,
                violation=optimum.evaluation.violation,
                shortcoming=shortcoming,
                edges=self._edges(optimum.evaluation),
            )
            best = result if best is None or result.is_better(best) else best
            if not optimum.shortcoming or optimum.interrupted:
                break
        return best

    def _sizes(self, at: Evaluation) -> Array:
        """Typical sizes of the freed parameters and the levels, shape (n_u,)."""
        freed, levels = np.split(at.u, [len(self._free)])
        return np.concatenate([freed_sizes(freed, self._bounds), np.maximum(np.abs(levels), SMALL)])

    def _edges(self, at: Evaluation) -> tuple[Edge, ...]:
        """The margins that an optimum would cross if the mode sequences of its scenarios allowed it."""
        n, sizes = len(self._free), self._sizes(at)
        weights, edges = kkt_residual(at, sizes)[1], list[Edge]()
        of_problem = {*self._problem.constraints, *self._problem.objective, *self._free, WORST}
        for constraint in at.constraints:
            if constraint.name not in of_problem and weights.get(constraint.key, 0.0) > 0:
                slopes = constraint.gradient[:n] * sizes[:n]
                steepest = int(np.abs(slopes).argmax())
                change = -float(np.sign(slopes[steepest])) * float(sizes[steepest])
                edges.append(Edge(scenario=constraint.scenario, key=self._free[steepest], change=change))
        return tuple(edges)

    def _failed(
        self,
        status: Status,
        message: str,
        solver: Mapping[str, float | str],
        causes: tuple[Cause, ...] = (),
        *,
        at: Solution | None = None,
    ) -> Gait:
        """A failed design, which records the point at which the search ended."""
        best = None
        if at is not None and np.isfinite(at.w).all():
            nodes, durations, freed = at.equations.unpack(at.w)
            best = best_point(self._problem, nodes[:, 0], durations, dict(zip(self._free, freed.tolist(), strict=True)))
        return Gait(
            problem=self._problem,
            dynamics=self._dynamics,
            status=status,
            message=message,
            solver=solver,
            causes=causes,
            best=best,
        )


def _message(gait: Gait, *, at_onset: bool) -> str:
    """``solved``, with warnings about the cost, the spectral radius, and an impact that is about to stick."""
    sentences, problem = ["solved"], gait.problem
    if at_onset:
        sentences.append("beyond the optimum, friction suffices for an impact that sticks, which takes precedence")
    net, absolute = gait.measures["cost_of_transport"], gait.measures["absolute_cost_of_transport"]
    names = {*problem.objective, *problem.constraints}
    by_net = bool({"cost_of_transport", "work"} & names)
    if by_net and net is not None and absolute is not None and absolute > CREDITED_COST * abs(net):
        sentences.append(f"the net cost {net:.4g} credits negative work, the absolute cost is {absolute:.4g}")
    if RADIUS in names:
        distances = np.sort(np.abs(gait.multipliers - gait.multipliers[0]))
        if distances.size > 1 and distances[1] < COALESCENCE * abs(gait.multipliers[0]):
            sentences.append(
                "multipliers at the radius coalesce, where it is not a Lipschitz function of the parameters"
            )
    if gait.stable is False:
        remedy = f"constrain {RADIUS}: {{max: 0.95}} for a stable gait"
        sentences.append(f"the optimum is unstable, its spectral radius is {gait.scalar(RADIUS):.4g}: {remedy}")
    return "; ".join([*sentences, *exceeded_limits(gait.steps)])
