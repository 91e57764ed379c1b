"""The nonlinear program of a gait: the equations of multiple shooting with the friction complementarity.

    min f(x, p)      s.t.  F(x, p) = 0,  margins(x, p) >= 0,  durations >= 0,      x = (nodes, durations, ...)

The same program is solved by ``ipopt`` and handed to users by ``gaitopt.nlp``. Without unknown parameters f = 0, and F
has as many rows as x; with some, it is the smoothed problem of ``gaitopt.design``.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pickle import PicklingError
from typing import Any, Self

import numpy as np
from casadi import DM, MX, Function, Sparsity, mtimes, sum1, vec

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.building import building, built_once
from gaitopt.callbacks import Stop, Valued
from gaitopt.display import Plotted, counted
from gaitopt.errors import UnknownNameError
from gaitopt.gait.gait import Cause, Gait, Status, describe_causes
from gaitopt.model.buffered import NumericFunction
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.problem.problem import Problem
from gaitopt.requests import IPOPT_ITERATIONS
from gaitopt.solver.assembly import solved_gait
from gaitopt.solver.diagnosis import largest_residual, rejection_reason, status_without_gait
from gaitopt.solver.ipopt import TOLERANCE, Block, Ipopt, Program
from gaitopt.solver.newton import Solution, polish, refine
from gaitopt.solver.rollout import reordered
from gaitopt.solver.shooting import Label, MultipleShooting
from gaitopt.threads import Uncompared, cached_property

SHORTEST_PERIOD_FOUND = 0.1
"""Shortest period of a gait relative to the guess. If both feet stay together, a period of zero solves all
equations."""
LARGEST_RESIDUAL = 1e-5
"""Newton's method may refine a point to a gait only if it violates no equality by more than this, in natural units.
Otherwise it might lead to a different gait."""
LARGEST_CONSTRAINT_VIOLATION = 1e-6
"""A constraint of the problem that is violated by more, relative to the larger of its bound and one, is not met."""
EXTERNAL = "external"
"""Method that is stated for a gait that gaitopt did not find itself."""
TIME = "time"
"""Name of the times of the nodes among the quantities of a point."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NonlinearProgram(Plotted, Program, ABC):
    """The nonlinear program of a problem, in SI units, for any solver of CasADi, see ``gaitopt.nlp``::

        solver = casadi.nlpsol("solver", "ipopt", nlp.casadi())
        end = solver(**nlp.arguments())
        gait = nlp.gait(end["x"])

    ``x, p, f, g`` are expressions; ``x0, p0, lbx, ubx, lbg, ubg`` are numbers; ``x_labels`` and ``g_labels`` state the
    name, mode, phase, node and unit of every entry. Equalities have equal bounds.

    Attributes
    ----------
    problem : the problem whose gait is sought.
    """

    problem: Problem

    @property
    @abstractmethod
    def system(self) -> HybridSystem:
        """The system whose parameters are p."""

    @property
    @abstractmethod
    def free(self) -> tuple[str, ...]:
        """Dotted keys of the parameters that are unknowns."""

    @property
    @abstractmethod
    def n_nodes(self) -> int:
        """Number of nodes, at which the states are unknowns."""

    @abstractmethod
    def node_times(self, durations: Array) -> Array:
        """Times of the nodes since the last impact, affine in the durations of the phases, shape (n_nodes,) [s]."""

    @abstractmethod
    def _gait(self, problem: Problem, point: Array, p: Array) -> Gait:
        """The gait of a problem at a point."""

    def __reduce__(self) -> tuple[Any, ...]:
        reason = "a nonlinear program holds expressions of CasADi, which no other process can read"
        raise PicklingError(f"{reason}: send its problem, nlp.problem, and call gaitopt.nlp there")

    def __copy__(self) -> Self:
        return self  # it never changes

    def __deepcopy__(self, memo: object) -> Self:
        return self

    def __repr__(self) -> str:
        n, m = self.x.numel(), self.g.numel()
        sizes = f"{counted(n, 'unknown')}, {counted(m, 'constraint')}, {counted(self.n_nodes, 'node')}"
        return f"<NonlinearProgram {self.problem.name}: {sizes}>"

    @property
    def p_labels(self) -> tuple[str, ...]:
        """Dotted keys of the parameters p; the values of those that are unknowns are ignored."""
        return self.system.parameters

    @cached_property
    def _rows(self) -> dict[str, list[int]]:
        """Numbers of the entries of x by the name in their labels."""
        rows: dict[str, list[int]] = {}
        for row, label in enumerate(self.x_labels):
            rows.setdefault(label.name, []).append(row)
        return rows

    def unpack(self, w: Any) -> dict[str, Any]:
        """The quantities of a point by name, in SI units; expressions if the point is ``x``.

        Parameters
        ----------
        w : shape (n,) - a point, or ``x`` itself.

        Returns
        -------
        quantities : ``time`` since the last impact, and every state, at the nodes, shape (n_nodes,); ``duration`` of
            the phases, (n_phases,); and of a design every freed parameter and extremum, (1,).
        """
        point = w if isinstance(w, MX) else self._checked(w)
        quantities = {name: point[rows] for name, rows in self._rows.items()}
        n_phases = len(self._rows["duration"])
        origin, *units = map(self.node_times, np.vstack([np.zeros(n_phases), np.eye(n_phases)]))
        moved = mtimes(DM(np.transpose(units) - origin[:, None]), quantities["duration"])
        return {TIME: origin + (moved if isinstance(w, MX) else np.asarray(moved).ravel()), **quantities}

    def pack(self, quantities: Mapping[str, Any]) -> Array:
        """The inverse of ``unpack``: missing quantities are taken from ``x0``, and times are ignored.

        Raises
        ------
        UnknownNameError
            If there is no such quantity.
        """
        point = self.x0.copy()
        for name, values in quantities.items():
            if name != TIME:
                if name not in self._rows:
                    raise UnknownNameError(f"no quantity of {self.problem.name} is {name}; there are {[*self._rows]}")
                point[self._rows[name]] = np.asarray(values, dtype=float).ravel()
        return point

    @overflow_allowed()
    def gait(self, w: Any, p: Array | None = None) -> Gait:
        """The gait at a solution, which Newton's method refines to rounding at fixed free parameters.

        Parameters
        ----------
        w : shape (n,) - a point that satisfies the constraints to the tolerance of a solver.
        p : shape (n_p,) - the parameters with which it was solved, if not ``p0``.

        Returns
        -------
        gait : the gait, not yet verified. Its status is ``not_converged`` if the point does not solve the
            program, ``infeasible`` if its motion violates a margin or is impossible otherwise; its message says which
            condition does not hold, and when.

        Raises
        ------
        ValueError
            If ``w`` or ``p`` have another size or are no numbers, or ``p`` is not finite.
        """
        values = self.p0 if p is None else _numbers(p, "p")
        if values.size != self.p0.size:
            raise ValueError(f"p has {values.size} entries instead of {self.p0.size}; p_labels names them")
        if not np.isfinite(values).all():
            k = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ValueError(f"p: {self.p_labels[k]} is {values[k]}, which is not a finite number")
        moved = zip(self.p_labels, values.tolist(), self.p0.tolist(), strict=True)
        changed = {key: new for key, new, old in moved if new != old and key not in self.free}
        problem, point = self.problem.replace(changed) if changed else self.problem, _numbers(w, "a point")
        unknown = np.flatnonzero(~np.isfinite(point))
        if unknown.size:
            row, named = int(unknown[0]), point.size == self.x0.size
            label = self.x_labels[row] if named else Label(name=f"entry {row}" if point.size > 1 else "it")
            message = f"the point is not finite: {label.name} is {point[row]}"
            message += "" if label.node is None else f" at node {label.node}"
            message += f", and {unknown.size - 1} more" if unknown.size > 1 else ""
            return Gait(
                problem=problem,
                dynamics=Dynamics(self.system, values),
                status=Status.NOT_CONVERGED,
                message=message,
                solver={"method": EXTERNAL},
                causes=(Cause(what="point", description=message),),
            )
        return self._gait(problem, self._checked(point), values)

    def _violated_bound(self, point: Array, p: Array) -> Cause | None:
        """The bound of a constraint or of a freed parameter that is violated most; None if all are met."""
        names = {*self.problem.constraints, *self.free}
        if not names:
            return None
        values = np.append(point, np.asarray(self._constraints(point, p)))
        lower, upper = np.append(self.lbx, self.lbg), np.append(self.ubx, self.ubg)
        outside = np.maximum(lower - values, values - upper)
        outside[[label.name not in names for label in (*self.x_labels, *self.g_labels)]] = 0.0
        row = int(np.argmax(outside))
        label, bound = (*self.x_labels, *self.g_labels)[row], float(np.clip(values[row], lower[row], upper[row]))
        if not outside[row] > LARGEST_CONSTRAINT_VIOLATION * max(1.0, abs(bound)):
            return None
        side = "at least" if values[row] < bound else "at most"
        text = f"{label.name} is {values[row]:.6g}, must be {side} {bound:.6g}"
        return Cause(what=label.name, description=text, needed=bound, available=float(values[row]))

    @cached_property
    @building
    def _constraints(self) -> Function:
        return Function("constraints", [self.x, self.p], [self.g])

    def _checked(self, w: Any) -> Array:
        point = _numbers(w, "a point")
        if point.size != self.x0.size:
            raise ValueError(f"a point has {self.x0.size} entries, not {point.size}; x_labels names them")
        return point


def _numbers(values: Any, what: str) -> Array:
    """Values that a user passes, as an array, shape (n,)."""
    try:
        return np.array(values, dtype=float).ravel()
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} is an array of numbers, not {type(values).__name__}: {error}") from error


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ShootingProgram(NonlinearProgram):
    """The program of multiple shooting.

    Attributes
    ----------
    equations : the equations of the gait, with their mesh.
    radius : the function in Python that bounds the spectral radius of a design, if it is needed. The program must live
        as long as a solver that calls this function. It has no second derivatives: a solver must approximate the
        Hessian.
    """

    equations: MultipleShooting
    radius: Function | None = None

    @property
    def system(self) -> HybridSystem:
        """The system whose parameters are p."""
        return self.equations.system

    @property
    def free(self) -> tuple[str, ...]:
        """Dotted keys of the parameters that are unknowns."""
        return self.equations.free

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return self.equations.n_nodes

    def node_times(self, durations: Array) -> Array:
        """Times of the nodes since the last impact, shape (n_nodes,) [s]."""
        return self.equations.mesh.node_times(durations)

    def _gait(self, problem: Problem, point: Array, p: Array) -> Gait:
        at, solver = Solution(self.equations, point[: self.equations.w.numel()], p), {"method": EXTERNAL}
        if not at.size <= LARGEST_RESIDUAL:
            return failed_gait(problem, at, (largest_residual(at),), solver)
        violated = self._violated_bound(point, p)
        if violated is not None:
            return failed_gait(problem, at, (violated,), solver)
        if (at.durations > 0).all() and not at.in_order:
            remedy = (
                "a switch passes a breakpoint of the control on the way from the start to this point; state "
                f"gait.guess.durations: {[float(f'{duration:.4g}') for duration in at.durations]} and solve again"
            )
            return failed_gait(problem, at, (Cause(what="reference", description=remedy),), solver)
        gait = checked_gait(problem, at, solver)
        if not (gait.converged and problem.objective):
            return gait
        objective = sum(weight * gait.scalar(name) for name, weight in problem.objective.items())
        return replace(gait, solver={**solver, "objective": objective})


@building
def equation_slope(equations: MultipleShooting) -> Function:
    """(w, p) -> Jacobian of the equations of a gait from ``linearised``, in a tenth of the time of CasADi's Jacobian.

    It must be kept as long as a solver uses it.
    """
    pattern = equations.jacobian_pattern
    sparsity = Sparsity(*pattern.shape, pattern.pointers.tolist(), pattern.rows.tolist())

    @overflow_allowed()
    def slope(w: Array, p: Array) -> tuple[DM]:
        _, matrix = equations.linearised(w, p)
        return (DM(sparsity, matrix.data),)

    lengths = equations.w.numel(), equations.parameters.numel()
    return NumericFunction("equation_slope", lengths, (sparsity,), slope)


@building
def feasibility(problem: Problem, start: Solution, *, relaxed: bool = False) -> ShootingProgram:
    """The program of a problem without unknown parameters.

    Parameters
    ----------
    start : equations, parameters, and the motion from which a search starts.
    relaxed : leaves the margins out, and lets phases have negative durations.
    """
    equations, units = start.equations, start.units
    n, labels = equations.Z.numel(), equations.unknown_labels
    rows = [
        Block(
            name="equalities", expression=equations.equalities, lower=0.0, upper=0.0, size=units.equalities,
            labels=equations.equality_labels, slope=equation_slope(equations),
        ),
        Block(
            name="period", expression=sum1(equations.durations),
            lower=SHORTEST_PERIOD_FOUND * float(start.durations.sum()),
            size=units.unknowns[-1], labels=(Label(name="period", unit="s"),),
        ),
    ]  # fmt: skip
    if not relaxed:
        margins, meaning = equations.inequalities
        size = equations.margin_units(start.p)
        rows.append(Block(name="margins", expression=margins, lower=0.0, size=size, labels=meaning))
    return ShootingProgram(
        unknowns=(
            Block(name="nodes", expression=vec(equations.Z), size=units.unknowns[:n], labels=labels[:n]),
            Block(
                name="durations", expression=equations.durations, lower=-np.inf if relaxed else 0.0,
                size=units.unknowns[n:], labels=labels[n:],
            ),
        ),
        rows=tuple(rows),
        p=equations.parameters,
        f=MX(0),
        x0=start.w,
        p0=start.p,
        problem=problem,
        equations=equations,
    )  # fmt: skip


def solved(
    program: ShootingProgram,
    *,
    iterations: int = IPOPT_ITERATIONS,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Solution:
    """The end of IPOPT with a program of ``feasibility``, after at most ``iterations`` iterations."""
    compiled = _ipopt(program.equations, program.g.numel(), iterations, Uncompared(program))
    end = compiled.solve(program, progress=progress, should_stop=should_stop)
    return Solution(
        program.equations, end.w, program.p0, status=end.status, message=end.message, iterations=end.iterations
    )


@built_once(maxsize=16)
def _ipopt(equations: MultipleShooting, n_rows: int, iterations: int, program: Uncompared[ShootingProgram]) -> Ipopt:
    """The compiled solver of the first program with these equations and rows, with or without the margins."""
    return Ipopt(program.value, options={"tol": TOLERANCE, "max_iter": iterations})


def checked_gait(problem: Problem, solution: Solution, solver: Mapping[str, float | str]) -> Gait:
    """The gait at a solution: polished, refined until its integration error is small, and checked."""
    refined = refine(polish(solution))
    refined = reordered(refined) or refined  # on a finer mesh, a switch may be on the other side of a breakpoint
    causes = rejection_reason(refined)
    if causes:
        return failed_gait(problem, solution, causes, solver, status_without_gait(causes))
    return solved_gait(problem, refined, message=solution.message, solver=solver)


def failed_gait(
    problem: Problem,
    at: Solution,
    causes: tuple[Cause, ...],
    solver: Mapping[str, float | str],
    status: Status = Status.NOT_CONVERGED,
) -> Gait:
    """The failed attempt of a search that ended where there is no gait."""
    return Gait(
        problem=problem,
        dynamics=Dynamics(at.equations.system, at.p),
        status=status,
        message=describe_causes(causes),
        solver=solver,
        causes=causes,
    )
