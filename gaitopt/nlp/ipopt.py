"""IPOPT through CasADi, with every way it can end mapped to a status and a message.

    min f(x)      s.t.  lower <= g(x) <= upper,      x = w / sizes of w,  g in its own sizes

CasADi returns a vector without an exception when IPOPT fails, and swallows Ctrl-C; both are undone here. MUMPS, which
solves IPOPT's linear systems, has global variables: only one thread at a time runs IPOPT.

A. Waechter, L. T. Biegler (2006), On the implementation of an interior-point filter line-search algorithm for
large-scale nonlinear programming, Mathematical Programming 106.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from casadi import DM, MX, Callback, Function, Sparsity, diag, jacobian, nlpsol, nlpsol_out, sum1, vertcat

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Status
from gaitopt.nlp.newton import Solution
from gaitopt.nlp.shooting import MultipleShooting

Bounds = tuple[Array, Array]
"""Lower and upper bounds."""

TOLERANCE = 1e-10
"""In natural units: well above the rounding of a Runge-Kutta step, well below the nine digits that are promised."""
NEAR_OPTIMUM = 1e-4
"""KKT residual of a smoothed problem, in the sizes of its objective and unknowns."""
HISTORY = 40
"""Secant pairs: twice as many as there are free directions in a large design."""
MAX_ITERATIONS, MAX_DESIGN_ITERATIONS = 300, 600
"""Of a search for a motion, which takes ten when it succeeds, and of a design."""

SHORTEST = 0.1
"""Shortest period of a gait relative to the guess: feet that stay together solve all equations."""

ENDINGS: dict[str, tuple[Status, str]] = {
    "Solve_Succeeded": (Status.CONVERGED, "solved"),
    "Solved_To_Acceptable_Level": (Status.NOT_CONVERGED, "stalled short of the tolerance"),
    "Feasible_Point_Found": (Status.CONVERGED, "solved"),
    "Infeasible_Problem_Detected": (Status.INFEASIBLE, "no gait with this mode sequence near the guess"),
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
"""IPOPT's endings; any other is a defect of the installation or of gaitopt and raises."""

RUNNING = threading.RLock()
"""Held while IPOPT runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IpoptResult:
    """The last iterate of IPOPT.

    Attributes
    ----------
    w : ndarray - last iterate, also after a failure.
    status, words : whether it may be trusted, and why not.
    iterations : their number.
    multipliers, bound_multipliers : ndarray - Lagrange multipliers of g and of the bounds on w.
    objective : its value.
    kkt : dual infeasibility, the residual of the optimality conditions.
    """

    w: Array
    status: Status
    words: str
    iterations: int
    multipliers: Array
    bound_multipliers: Array
    objective: float
    kkt: float


class IpoptProcess:
    """A compiled NLP of CasADi: runs one at a time, stops on request and on Ctrl-C, and raises on unknown endings.

    Parameters
    ----------
    name, nlp : as ``casadi.nlpsol`` takes them.
    casadi_options, ipopt_options : those that differ between programs.
    progress, should_stop : called at every iteration.
    """

    def __init__(
        self,
        name: str,
        nlp: dict[str, MX],
        casadi_options: dict[str, Any],
        ipopt_options: dict[str, Any],
        progress: Valued,
        should_stop: Stop,
    ) -> None:
        self._watch = _Watch(nlp["x"].numel(), nlp["g"].numel(), nlp["p"].numel(), progress, should_stop)
        options = {
            "print_time": False,
            "show_eval_warnings": False,  # a point where the motion does not exist is IPOPT's business, as is Ctrl-C
            "iteration_callback": self._watch,
            "error_on_fail": False,
            "calc_lam_p": False,
            "ipopt": {"print_level": 0, "sb": "yes", "acceptable_iter": 0, **ipopt_options},
            **casadi_options,
        }
        self._solver = nlpsol(name, "ipopt", nlp, options)

    def run(self, x: Array, p: Array, bounds_x: Bounds, bounds_g: Bounds) -> IpoptResult:
        """Solve from ``x`` at parameters ``p``; the result is in the units of the NLP.

        Raises
        ------
        RuntimeError
            If IPOPT ends in a way that only a broken installation or a bug can cause.
        """
        self._watch.begin(*bounds_g)
        with RUNNING:
            end = self._solver(x0=x, p=p, lbx=bounds_x[0], ubx=bounds_x[1], lbg=bounds_g[0], ubg=bounds_g[1])
            stats = self._solver.stats()
        if stats["return_status"] not in ENDINGS:
            raise RuntimeError(f"IPOPT ended with {stats['return_status']}")
        status, words = ENDINGS[stats["return_status"]]
        return IpoptResult(
            w=np.asarray(end["x"]).ravel(),
            status=status,
            words=words,
            iterations=int(stats["iter_count"]),
            multipliers=np.asarray(end["lam_g"]).ravel(),
            bound_multipliers=np.asarray(end["lam_x"]).ravel(),
            objective=float(end["f"]),
            kkt=float(stats["iterations"]["inf_du"][-1]) if "iterations" in stats else np.inf,  # none was begun
        )


class Ipopt:
    """One NLP in the sizes of its unknowns and rows, built once and solved as often as needed.

    Parameters
    ----------
    w, p, objective : CasADi expressions; ``objective`` None for a problem of feasibility.
    g : the constraints, in blocks of like sparsity: each block has its own Jacobian, so that a row that depends on
        everything does not make the Jacobians of the other rows dense.
    scale, objective_size : typical sizes of the unknowns, shape (n_w,), and of the objective; secants learn best where
        all are one. Sizes that depend on the parameters are given to ``solve``.
    optimality : KKT residual at which the search for an optimum ends.
    progress, should_stop : called at every iteration.
    """

    def __init__(
        self,
        *,
        w: MX,
        p: MX,
        g: MX | Sequence[MX],
        scale: Array | float = 1.0,
        objective: MX | None = None,
        objective_size: float = 1.0,
        optimality: float = NEAR_OPTIMUM,
        progress: Valued = None,
        should_stop: Stop = None,
    ) -> None:
        blocks = [g] if isinstance(g, MX) else list(g)
        self._scale = np.broadcast_to(scale, w.numel())
        x, sizes = MX.sym("x", w.numel()), MX.sym("sizes", w.numel())
        # two functions, for the gradient of one that is both would go back through the constraints too
        value = Function("value", [w, p], [MX(0) if objective is None else objective])
        constraints = Function("constraints", [w, p], [vertcat(*blocks)])
        slope = Function("slope", [w, p], [vertcat(*(jacobian(block, w) for block in blocks))])
        f, unscaled_rows = value(sizes * x, p), constraints(sizes * x, p)
        row_sizes = MX.sym("row_sizes", unscaled_rows.numel())
        rows, parameters = unscaled_rows / row_sizes, vertcat(p, sizes, row_sizes)
        scaled_slope = diag(1 / row_sizes) @ slope(sizes * x, p) @ diag(sizes)
        self._process = IpoptProcess(
            "gait",
            {"x": x, "p": parameters, "g": rows, "f": f},
            {"jac_g": Function("jac_g", [x, parameters], [rows, scaled_slope])},
            {
                "tol": TOLERANCE if objective is None else optimality,
                "constr_viol_tol": TOLERANCE,
                "bound_relax_factor": 0.0,
                "obj_scaling_factor": 1 / objective_size,
                "max_iter": MAX_ITERATIONS if objective is None else MAX_DESIGN_ITERATIONS,
                # the free directions are few, and secants learn them in fewer seconds than one exact Hessian takes
                "hessian_approximation": "limited-memory",
                "limited_memory_max_history": HISTORY,
            },
            progress,
            should_stop,
        )

    def solve(
        self, w: Array, p: Array, bounds_w: Bounds, bounds_g: Bounds, sizes: tuple[Array, Array] | None = None
    ) -> IpoptResult:
        """Solve from ``w`` for parameters ``p`` within bounds on w and g.

        ``sizes`` are typical sizes of w and g at these parameters; otherwise ``scale``, and one for every row of g.

        Raises
        ------
        RuntimeError
            If IPOPT ends in a way that only a broken installation or a bug can cause.
        """
        scale, rows = (self._scale, np.ones(bounds_g[0].size)) if sizes is None else sizes
        result = self._process.run(
            w / scale,
            np.concatenate([p, scale, rows]),
            (bounds_w[0] / scale, bounds_w[1] / scale),
            (bounds_g[0] / rows, bounds_g[1] / rows),
        )
        return replace(
            result,
            w=result.w * scale,
            multipliers=result.multipliers / rows,
            bound_multipliers=result.bound_multipliers / scale,
        )


class Feasibility:
    """The NLP of a gait for IPOPT: equalities and margins, nothing to minimise.

    The parameters are parameters of the NLP too, so that it is built once and solved for any of their values.

    Parameters
    ----------
    equations : without free parameters.
    progress, should_stop : called at every iteration.
    relaxed : leaves the margins out, and lets phases have negative durations.
    """

    def __init__(
        self,
        equations: MultipleShooting,
        *,
        progress: Valued = None,
        should_stop: Stop = None,
        relaxed: bool = False,
    ) -> None:
        self._equations, self._relaxed = equations, relaxed
        equalities, margins = equations.equalities, equations.inequalities[0]
        self._first_duration = equations.w.numel() - equations.n_phases
        period = sum1(equations.w[self._first_duration :])
        g = vertcat(equalities, period) if relaxed else vertcat(equalities, period, margins)
        self._n_equalities = equalities.numel()
        self._upper = np.where(np.arange(g.numel()) < self._n_equalities, 0.0, np.inf)
        self._ipopt = Ipopt(w=equations.w, p=equations.parameters, g=g, progress=progress, should_stop=should_stop)

    def solve(self, start: Array, p: Array) -> Solution:
        """Solve from ``start``, shape (n_w,), at parameters ``p``, shape (n_p,)."""
        equations = self._equations
        lower = np.zeros(self._upper.size)
        lower[self._n_equalities] = SHORTEST * start[self._first_duration :].sum()
        floor = np.full(start.size, -np.inf)
        floor[self._first_duration :] = -np.inf if self._relaxed else 0.0
        units = equations.units(p)
        rows = [units.equalities, units.unknowns[-1:], *([] if self._relaxed else [equations.margin_units(p)])]
        bounds_w, bounds_g = (floor, np.full(start.size, np.inf)), (lower, self._upper)
        end = self._ipopt.solve(start, p, bounds_w, bounds_g, (units.unknowns, np.concatenate(rows)))
        return Solution(equations, end.w, p, status=end.status, words=end.words, iterations=end.iterations)


class _Watch(Callback):
    """Reports every iteration, and stops IPOPT on request."""

    def __init__(self, n_w: int, n_g: int, n_p: int, progress: Valued, should_stop: Stop) -> None:
        super().__init__()
        self._sizes = {"x": n_w, "f": 1, "g": n_g, "lam_x": n_w, "lam_g": n_g, "lam_p": n_p}
        self._progress, self._should_stop = progress, should_stop
        self._iteration, self._lower, self._upper = 0, np.full(n_g, -np.inf), np.full(n_g, np.inf)
        self.construct("watch", {})

    def begin(self, lower: Array, upper: Array) -> None:
        """Count from zero; violations are of these bounds of g."""
        self._iteration, self._lower, self._upper = 0, lower, upper

    def get_n_in(self) -> int:
        """Number of inputs that CasADi passes."""
        return len(self._sizes)

    def get_n_out(self) -> int:
        """One output: nonzero stops IPOPT."""
        return 1

    def get_sparsity_in(self, i: int) -> Sparsity:
        """Shape of an input."""
        return Sparsity.dense(self._sizes[nlpsol_out(i)], 1)

    def eval(self, arg: Sequence[DM]) -> list[DM]:
        """Report an iteration; nonzero stops IPOPT."""
        try:
            if self._progress is not None:
                g = np.asarray(arg[2]).ravel()
                violation = max(np.max(self._lower - g, initial=0.0), np.max(g - self._upper, initial=0.0))
                self._progress(self._iteration, float(violation))
            self._iteration += 1
            stop = self._should_stop is not None and self._should_stop()
        except KeyboardInterrupt:  # raised here by Python, it would be lost in CasADi
            stop = True
        return [DM(float(stop))]
