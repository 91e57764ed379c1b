"""Nonlinear programs, and IPOPT through CasADi with every way it can end mapped to a status and a message.

    min f(w, p)      s.t.  lower <= w <= upper,  lower <= g(w, p) <= upper,      w and g divided by their typical sizes

A program is stated in blocks of unknowns and rows, each an expression with its name, bounds, sizes and labels.

When IPOPT fails, CasADi returns a vector without an exception, and it swallows Ctrl-C; this module reports both. MUMPS,
which solves IPOPT's linear systems, has global variables: only one thread at a time runs IPOPT.

A. Waechter, L. T. Biegler (2006), On the implementation of an interior-point filter line-search algorithm for
large-scale nonlinear programming, Mathematical Programming 106.
"""

import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import MX, Function, Sparsity, diag, horzcat, jacobian, nlpsol, nlpsol_out, vertcat

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.building import BUILDING, Freed, building
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Status
from gaitopt.model.buffered import NumericFunction
from gaitopt.requests import IPOPT_ITERATIONS
from gaitopt.solver.shooting import Label
from gaitopt.threads import cached_property

TOLERANCE = 1e-10
"""Tolerance in natural units: well above the rounding of a Runge-Kutta step, well below the nine promised digits."""
MAX_ITERATIONS = IPOPT_ITERATIONS
"""Largest number of iterations of IPOPT for a design."""
SECANT_PAIRS = 40
"""Number of secant pairs: twice as many as there are free directions in a large design."""
THREADS = "OPENBLAS_NUM_THREADS"
"""The variable from which OpenBLAS reads its number of threads."""
COMMON_OPTIONS: dict[str, Any] = {"print_level": 0, "sb": "yes", "acceptable_iter": 0}
SECANT_OPTIONS: dict[str, Any] = {
    "constr_viol_tol": TOLERANCE,
    "bound_relax_factor": 0.0,
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": SECANT_PAIRS,
}
"""Options for a search without an exact Hessian. There are few free directions: secants approximate the Hessian in less
time than one exact Hessian takes."""

ENDINGS: dict[str, tuple[Status, str]] = {
    "Solve_Succeeded": (Status.CONVERGED, "solved"),
    "Solved_To_Acceptable_Level": (Status.NOT_CONVERGED, "stalled short of the tolerance"),
    "Feasible_Point_Found": (Status.CONVERGED, "solved"),
    "Infeasible_Problem_Detected": (Status.INFEASIBLE, "no gait was found with this mode sequence near the guess"),
    "Search_Direction_Becomes_Too_Small": (Status.NOT_CONVERGED, "stalled: the steps became too small"),
    "Diverging_Iterates": (Status.NOT_CONVERGED, "the iterates diverge"),
    "User_Requested_Stop": (Status.INTERRUPTED, "interrupted"),
    "Maximum_Iterations_Exceeded": (Status.NOT_CONVERGED, "no convergence, the iterations ran out"),
    "Maximum_CpuTime_Exceeded": (Status.NOT_CONVERGED, "out of processor time"),
    "Maximum_WallTime_Exceeded": (Status.NOT_CONVERGED, "out of time"),
    "Restoration_Failed": (Status.INFEASIBLE, "no point that satisfies the constraints was found near the guess"),
    "Error_In_Step_Computation": (Status.NOT_CONVERGED, "the linear system of a step could not be solved"),
    "Not_Enough_Degrees_Of_Freedom": (Status.INFEASIBLE, "more equations than unknowns"),
    "Invalid_Number_Detected": (Status.NOT_CONVERGED, "the motion became infinite or undefined"),
    "NonIpopt_Exception_Thrown": (Status.INTERRUPTED, "interrupted"),
}
"""Status and message for every way in which IPOPT may end. Any other ending is a defect of the installation or of
gaitopt and raises an error."""

PROGRESS_ITERATIONS = 10
"""Number of last iterations in which the change of the objective shows whether a search still makes progress."""
RUNNING = threading.RLock()
"""The lock that a thread holds while IPOPT runs, and while a solver is freed: MUMPS then frees its memory."""
FREED_SOLVERS = Freed(RUNNING, BUILDING)
"""Solvers that are no longer needed and will be freed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Unknowns or rows of a nonlinear program that belong together: lower <= expression <= upper.

    Attributes
    ----------
    name : name of the block.
    expression : MX, shape (n, 1).
    lower, upper : bounds, as one number for all entries or ndarray, shape (n,).
    size : typical size, likewise.
    labels : the meaning of each entry; empty if it is not needed.
    slope : (first unknowns, p) -> Jacobian of rows; CasADi differentiates the expression by default.
    """

    name: str
    expression: MX
    lower: Array | float = -np.inf
    upper: Array | float = np.inf
    size: Array | float = 1.0
    labels: tuple[Label, ...] = ()
    slope: Function | None = None

    def jacobian(self, x: MX, p: MX) -> MX:
        """Derivative by all unknowns of the program."""
        if self.slope is None:
            return jacobian(self.expression, x)
        known = self.slope(x[: self.slope.size1_in(0)], p)
        return horzcat(known, MX(known.shape[0], x.numel() - known.shape[1]))


@dataclass(frozen=True, eq=False, kw_only=True)
class Program(ReadOnlyArrays):
    """A nonlinear program, min f(x, p) subject to lbx <= x <= ubx and lbg <= g(x, p) <= ubg, with a start.

    Attributes
    ----------
    unknowns, rows : blocks of x and of g. Each block of rows has its own Jacobian, so that a row that depends on all
        unknowns does not make the Jacobians of the other rows dense.
    p, f : MX - parameters and objective; if the objective is 0, any feasible point is a solution.
    x0, p0 : ndarrays - start, and values of the parameters.
    """

    unknowns: tuple[Block, ...]
    rows: tuple[Block, ...]
    p: MX
    f: MX
    x0: Array
    p0: Array

    @cached_property
    @building
    def x(self) -> MX:
        """The unknowns, shape (n, 1): a vector of symbols."""
        return vertcat(*(block.expression for block in self.unknowns))

    @cached_property
    @building
    def g(self) -> MX:
        """The constraints, shape (m, 1)."""
        return vertcat(*(block.expression for block in self.rows))

    @property
    def lbx(self) -> Array:
        """Lower bounds of x, shape (n,)."""
        return _entries(self.unknowns, "lower")

    @property
    def ubx(self) -> Array:
        """Upper bounds of x, shape (n,)."""
        return _entries(self.unknowns, "upper")

    @property
    def lbg(self) -> Array:
        """Lower bounds of g, shape (m,)."""
        return _entries(self.rows, "lower")

    @property
    def ubg(self) -> Array:
        """Upper bounds of g, shape (m,)."""
        return _entries(self.rows, "upper")

    @property
    def x_sizes(self) -> Array:
        """Typical sizes of the unknowns, by which gaitopt divides them, shape (n,)."""
        return _entries(self.unknowns, "size")

    @property
    def g_sizes(self) -> Array:
        """Typical sizes of the constraints, likewise; shape (m,)."""
        return _entries(self.rows, "size")

    @property
    def x_labels(self) -> tuple[Label, ...]:
        """Meaning of every entry of x."""
        return tuple(label for block in self.unknowns for label in block.labels)

    @property
    def g_labels(self) -> tuple[Label, ...]:
        """Meaning of every entry of g."""
        return tuple(label for block in self.rows for label in block.labels)

    def casadi(self) -> dict[str, MX]:
        """``{"x": x, "p": p, "f": f, "g": g}``, the argument of ``casadi.nlpsol``."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}

    def arguments(self) -> dict[str, Array]:
        """Start, parameters and bounds, with which a solver of CasADi is called: ``solver(**nlp.arguments())``."""
        bounds = {"lbx": self.lbx, "ubx": self.ubx, "lbg": self.lbg, "ubg": self.ubg}
        return {"x0": self.x0, "p": self.p0, **bounds}


@dataclass(frozen=True, slots=True, kw_only=True)
class IpoptResult:
    """The last iterate of IPOPT.

    Attributes
    ----------
    w : ndarray - last iterate, also after a failure.
    status, message : how the search ended, and a sentence that says so.
    iterations : number of iterations.
    multipliers, bound_multipliers : ndarray - Lagrange multipliers of g and of the bounds on w.
    objective : value of the objective.
    kkt : dual infeasibility, the residual of the optimality conditions.
    rows : ndarray - values of g.
    progress : change of the objective in the last ``PROGRESS_ITERATIONS`` iterations.
    """

    w: Array
    status: Status
    message: str
    iterations: int
    multipliers: Array
    bound_multipliers: Array
    objective: float
    kkt: float
    rows: Array
    progress: float


def what_limits(unknowns: Sequence[Block], rows: Sequence[Block], result: IpoptResult) -> str:
    """A text on what keeps a search from its optimum when its iterations have run out.

    It states the largest violation, the inequality with the largest multiplier, the residual of the optimality
    conditions, and how much the objective still changed.

    Parameters
    ----------
    unknowns, rows : blocks of the program, with labels.
    """
    values, multipliers = (result.w, result.rows), (result.bound_multipliers, result.multipliers)
    worst, pressing = (0.0, ""), (0.0, "")
    for value, blocks, pressure in zip(values, (unknowns, rows), multipliers, strict=True):
        lower, upper, unit = (_entries(blocks, name) for name in ("lower", "upper", "size"))
        labels = [label for block in blocks for label in block.labels]
        violation = np.maximum(lower - value, value - upper) / unit
        weights = np.where(lower < upper, np.abs(pressure) * unit, 0.0)
        for k, found in ((int(np.argmax(each)), each) for each in (violation, weights) if each.size):
            label = str(labels[k])
            if found is violation:
                worst = max(worst, (float(found[k]), label))
            else:
                side = lower[k] if pressure[k] < 0 else upper[k]
                pressing = max(pressing, (float(found[k]), f"{label}, bound {side:.4g}"))
    violated = f"largest violation {worst[0]:.1e}" + (f" ({worst[1]})" if worst[0] > 0 else "")
    limit = f"; the optimum presses most on {pressing[1]}" if pressing[0] > 0 else ""
    residual = f"; residual of the optimality conditions {result.kkt:.1e}"
    progress = f"the objective changed by {result.progress:.1e} in the last {PROGRESS_ITERATIONS} iterations"
    return f"{violated}{limit}{residual}; {progress}"


class Ipopt:
    """A nonlinear program compiled for IPOPT: built once, solved as often as needed, one run at a time.

    Parameters
    ----------
    program : expressions, and the numbers from which ``solve`` starts unless others are given.
    options : options of IPOPT, besides the common ones.
    exact : whether to use the exact Hessian instead of secants. Secants need unknowns and rows of the order of one.
    derivatives : functions ``grad_f, jac_g, hess_lag`` of x and p for the exact Hessian; CasADi builds them by default.
    """

    @building
    def __init__(
        self,
        program: Program,
        *,
        options: dict[str, Any],
        exact: bool = False,
        derivatives: Mapping[str, Function] | None = None,
    ) -> None:
        w, g, f, parameters = program.x, program.g, program.f, program.p
        if exact:
            plugin_options: dict[str, Any] = {"expand": True} if derivatives is None else dict(derivatives)
            nlp = {"x": w, "p": parameters, "f": f, "g": g}
        else:
            x, sizes, row_sizes = MX.sym("x", w.numel()), MX.sym("sizes", w.numel()), MX.sym("row_sizes", g.numel())
            # two functions, because the gradient of a single one would also differentiate the constraints
            value = Function("value", [w, parameters], [f])
            constraints = Function("constraints", [w, parameters], [g])
            slopes = [block.jacobian(w, parameters) for block in program.rows]
            slope = Function("slope", [w, parameters], [vertcat(*slopes)])
            scaled = constraints(sizes * x, parameters) / row_sizes
            scaled_slope = diag(1 / row_sizes) @ slope(sizes * x, parameters) @ diag(sizes)
            p = vertcat(parameters, sizes, row_sizes)
            nlp = {"x": x, "p": p, "f": value(sizes * x, parameters), "g": scaled}
            plugin_options = {"jac_g": Function("jac_g", [x, p], [scaled, scaled_slope])}
        self._program, self._exact = program, exact
        self._watch = _Watch(w.numel(), g.numel(), nlp["p"].numel())
        FREED_SOLVERS.free()
        with _one_thread():
            solver = nlpsol(
                "gait",
                "ipopt",
                nlp,
                {
                    "print_time": False,
                    "show_eval_warnings": False,  # IPOPT deals with points where the motion does not exist
                    "iteration_callback": self._watch,
                    "error_on_fail": False,
                    "calc_lam_p": False,
                    "ipopt": COMMON_OPTIONS | ({} if exact else SECANT_OPTIONS) | options,
                    **plugin_options,
                },
            )
        self._solver = FREED_SOLVERS.watch(solver)

    def solve(
        self,
        program: Program | None = None,
        *,
        multipliers: tuple[Array, Array] | None = None,
        progress: Valued = None,
        should_stop: Stop = None,
    ) -> IpoptResult:
        """Solve from the start of the program, or of another one with the same expressions.

        If the Hessian is exact, the typical sizes of unknowns and rows are not used.

        Parameters
        ----------
        multipliers : multipliers of the bounds and of the rows at the start, for a warm start with an exact Hessian.
        progress, should_stop : called at every iteration.

        Raises
        ------
        RuntimeError
            If IPOPT ends in a way that only a broken installation or a bug can cause.
        """
        given = self._program if program is None else program
        x_unit, g_unit, parameters = given.x_sizes, given.g_sizes, given.p0
        if self._exact:
            x_unit, g_unit = np.ones(x_unit.size), np.ones(g_unit.size)
        else:
            parameters = np.concatenate([given.p0, x_unit, g_unit])
        lbx, ubx, lbg, ubg = given.lbx / x_unit, given.ubx / x_unit, given.lbg / g_unit, given.ubg / g_unit
        with RUNNING:
            FREED_SOLVERS.free()
            self._watch.begin(lbg, ubg, progress, should_stop)
            known = {} if multipliers is None else dict(zip(("lam_x0", "lam_g0"), multipliers, strict=True))
            end = self._solver(x0=given.x0 / x_unit, p=parameters, lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg, **known)
            stats = self._solver.stats()
        if stats["return_status"] not in ENDINGS:
            raise RuntimeError(f"IPOPT ended with {stats['return_status']}")
        status, message = ENDINGS[stats["return_status"]]
        objectives = stats["iterations"]["obj"][-PROGRESS_ITERATIONS - 1 :] if "iterations" in stats else []
        return IpoptResult(
            w=np.asarray(end["x"]).ravel() * x_unit,
            status=status,
            message=message,
            iterations=int(stats["iter_count"]),
            multipliers=np.asarray(end["lam_g"]).ravel() / g_unit,
            bound_multipliers=np.asarray(end["lam_x"]).ravel() / x_unit,
            objective=float(end["f"]),
            kkt=float(stats["iterations"]["inf_du"][-1]) if "iterations" in stats else np.inf,  # none was begun
            rows=np.asarray(end["g"]).ravel() * g_unit,
            progress=float(np.ptp(objectives)) if objectives else 0.0,
        )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenBLAS have one thread when it is loaded, with the first solver, unless the environment states a number.

    Matrices this small have no use for one thread per core, which all wait actively for a tenth of a second. With one
    thread the results do not depend on the number of cores.
    """
    stated = THREADS in os.environ
    os.environ.setdefault(THREADS, "1")
    try:
        yield
    finally:
        if not stated:
            del os.environ[THREADS]


def _entries(blocks: Sequence[Block], name: str) -> Array:
    """The values of an attribute for all entries of some blocks."""
    return np.concatenate([np.broadcast_to(getattr(block, name), block.expression.numel()) for block in blocks])


class _Watch(NumericFunction):
    """Reports every iteration, and stops IPOPT on request."""

    def __init__(self, n_w: int, n_g: int, n_p: int) -> None:
        sizes = {"x": n_w, "f": 1, "g": n_g, "lam_x": n_w, "lam_g": n_g, "lam_p": n_p}
        lengths = [sizes[nlpsol_out(i)] for i in range(len(sizes))]
        super().__init__("watch", lengths, [Sparsity.dense(1, 1)], self._report)
        self.begin(np.full(n_g, -np.inf), np.full(n_g, np.inf), None, None)

    def begin(self, lower: Array, upper: Array, progress: Valued, should_stop: Stop) -> None:
        """Count iterations from zero; violations are those of these bounds of g."""
        self._iteration, self._lower, self._upper = 0, lower, upper
        self._progress, self._should_stop = progress, should_stop

    def _report(self, x: Array, f: Array, g: Array, *multipliers: Array) -> list[float]:
        """Report an iteration; a value other than zero stops IPOPT."""
        try:
            if self._progress is not None:
                violation = max(np.max(self._lower - g, initial=0.0), np.max(g - self._upper, initial=0.0))
                self._progress(self._iteration, float(violation))
            self._iteration += 1
            stop = self._should_stop is not None and self._should_stop()
        except KeyboardInterrupt:  # CasADi would swallow it
            stop = True
        return [float(stop)]
