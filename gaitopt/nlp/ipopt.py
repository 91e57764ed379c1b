"""IPOPT through CasADi, with every way it can end mapped to a status in words.

CasADi returns a vector without an exception when IPOPT fails, and swallows Ctrl-C; both are undone here. MUMPS, which
solves IPOPT's linear systems, has global variables: one thread at a time runs IPOPT.

The plainest guess of a cycle: all joints move at constant rates, and the foot does not slip.

Relabelling is affine, s_plus = A s_minus + b, so that the shape just before an impact follows from that just after it.

An NLP with complementarity constraints, products <= sigma, solved by IPOPT for a falling sequence of sigma.

S. Scholtes, Convergence properties of a regularization scheme for mathematical programs with complementarity
constraints, SIAM J. Optim. 11 (2001).

A cycle of steps whose mode sequence is open: finite elements with switch detection, solved by a homotopy in IPOPT.

    f_t = -mu (2 a - 1) f_n                          a in [0, 1]
    v_t = v_forward - v_backward,                    0 <= a _|_ v_backward >= 0,    0 <= 1 - a _|_ v_forward >= 0

at the stages of Radau IIA collocation on elements of free length. The products are summed over an element and over the
velocities at its start, so that no mode can change inside an element: switches come to lie between elements. They are
held below sigma, which goes to zero. Impacts obey the same law. Static friction is that of a slip here, and a
slipping impact has Coulomb's impulse: what else a problem says, the fixed-sequence NLP and the simulator decide.

References
----------
A. Nurkanovic, M. Sperl, S. Albrecht, M. Diehl, Finite elements with switch detection for direct optimal control of
nonsmooth systems, Numerische Mathematik 156 (2024).
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
from casadi import DM, MX, Callback, Function, Sparsity, diag, jacobian, nlpsol, nlpsol_out, sum1, vertcat

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Status
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode

Progress = Callable[[int, float], None]
"""Called with the iteration and the largest violation of the constraints."""

TOLERANCE = 1e-10
"""In natural units: well above the rounding of a Runge-Kutta step, well below the nine digits that are promised."""
NEAR_OPTIMUM = 1e-4
"""KKT residual of a smoothed problem, in the sizes of its objective and unknowns."""
RUNNING = threading.RLock()
"""Held while IPOPT runs."""
HISTORY = 40
"""Secant pairs: twice as many as there are free directions in a large design."""
MAX_ITERATIONS, MAX_DESIGN_ITERATIONS = 300, 600
"""Of a search for a motion, which takes ten when it succeeds, and of a design."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class IpoptResult:
    """Where IPOPT ended.

    Attributes
    ----------
    w : ndarray - last iterate, also after a failure.
    status, words : whether it may be trusted, and why not.
    iterations : how many.
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


class Watch(Callback):
    """Reports every iteration, and stops IPOPT on request."""

    def __init__(self, n_w: int, n_g: int, n_p: int, progress: Progress | None, should_stop: Stop) -> None:
        super().__init__()
        self._sizes = {"x": n_w, "f": 1, "g": n_g, "lam_x": n_w, "lam_g": n_g, "lam_p": n_p}
        self._progress, self._should_stop = progress, should_stop
        self._iteration, self._lower, self._upper = 0, np.full(n_g, -np.inf), np.full(n_g, np.inf)
        self.construct("watch", {})

    def begin(self, lower: Array, upper: Array) -> None:
        """Count from zero; violations are of these bounds of g."""
        self._iteration, self._lower, self._upper = 0, lower, upper

    def get_n_in(self) -> int:
        """What CasADi hands over."""
        return len(self._sizes)

    def get_n_out(self) -> int:
        """Whether to stop."""
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


class Ipopt:
    """One NLP, built once and solved as often as needed.

    Parameters
    ----------
    w, p, objective : CasADi expressions; ``objective`` None for a problem of feasibility.
    g : the constraints, perhaps in blocks of like sparsity: each has a Jacobian of its own, so that a row that depends
        on
        everything does not make those of the others dense to compute.
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
        progress: Progress | None = None,
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
        self._watch = Watch(w.numel(), rows.numel(), parameters.numel(), progress, should_stop)
        options: dict[str, Any] = {
            "print_time": False,
            "show_eval_warnings": False,  # a point where the motion does not exist is IPOPT's business, as is Ctrl-C
            "iteration_callback": self._watch,
            "error_on_fail": False,
            "calc_lam_p": False,
            "jac_g": Function("jac_g", [x, parameters], [rows, scaled_slope]),
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": TOLERANCE if objective is None else optimality,
                "constr_viol_tol": TOLERANCE,
                "acceptable_iter": 0,
                "bound_relax_factor": 0.0,
                "obj_scaling_factor": 1 / objective_size,
                "max_iter": MAX_ITERATIONS if objective is None else MAX_DESIGN_ITERATIONS,
                # the free directions are few, and secants learn them in fewer seconds than one exact Hessian takes
                "hessian_approximation": "limited-memory",
                "limited_memory_max_history": HISTORY,
            },
        }
        self._solver = nlpsol("gait", "ipopt", {"x": x, "p": parameters, "g": rows, "f": f}, options)

    def solve(
        self,
        w: Array,
        p: Array,
        bounds_w: tuple[Array, Array],
        bounds_g: tuple[Array, Array],
        sizes: tuple[Array, Array] | None = None,
    ) -> IpoptResult:
        """Solve from ``w`` for parameters ``p`` within bounds on w and g.

        ``sizes`` are typical sizes of w and g at these parameters; otherwise ``scale``, and one for every row of g.

        Raises
        ------
        RuntimeError
            If IPOPT ends in a way that only a broken installation or a bug can cause.
        """
        scale, rows = (self._scale, np.ones(bounds_g[0].size)) if sizes is None else sizes
        x, lower, upper = (values / scale for values in (w, *bounds_w))
        least, greatest = (values / rows for values in bounds_g)
        self._watch.begin(least, greatest)
        parameters = np.concatenate([p, scale, rows])
        with RUNNING:
            solution = self._solver(x0=x, p=parameters, lbx=lower, ubx=upper, lbg=least, ubg=greatest)
            stats = self._solver.stats()
        if stats["return_status"] not in ENDINGS:
            raise RuntimeError(f"IPOPT ended with {stats['return_status']}")
        status, words = ENDINGS[stats["return_status"]]
        return IpoptResult(
            w=np.asarray(solution["x"]).ravel() * scale,
            status=status,
            words=words,
            iterations=int(stats["iter_count"]),
            multipliers=np.asarray(solution["lam_g"]).ravel() / rows,
            bound_multipliers=np.asarray(solution["lam_x"]).ravel() / scale,
            objective=float(solution["f"]),
            kkt=float(stats["iterations"]["inf_du"][-1]) if "iterations" in stats else np.inf,  # none was begun
        )


def swing(dynamics: Dynamics, shapes: Array, period: float) -> tuple[Array, Array]:
    """States at the two ends of each step of a cycle without slip in which all joints move at constant rates.

    Parameters
    ----------
    shapes : ndarray, shape (n_steps, n_section) - the coordinates that are free, at the start of each step.
    period : of a step [s].

    Returns
    -------
    starts, ends : ndarrays, shape (n_steps, n_z).
    """
    n = dynamics.system.n_shape
    starts = np.array([dynamics.lift(np.concatenate([shape, np.zeros(n)])) for shape in shapes])
    ends = starts.copy()
    ends[:, :n] = shapes_before(dynamics, np.roll(starts[:, :n], -1, axis=0))
    for states in (starts, ends):
        states[:, n + 1 : 2 * n + 1] = (ends[:, :n] - starts[:, :n]) / period
    return starts, ends


def shapes_before(dynamics: Dynamics, shapes: Array) -> Array:
    """The shapes just before an impact that it relabels to ``shapes``, shape (m, n_shape), as relabelling is affine."""
    n, zero = dynamics.system.n_shape, np.zeros(dynamics.system.n_z)
    b = dynamics.after_impact(Mode.STICK, zero)[:n]
    A = np.asarray(dynamics.system.impact_jacobian(Mode.STICK)(zero, dynamics.p))[:n, :n]
    return np.asarray(np.linalg.solve(A, (shapes - b).T).T)


Bounds = tuple[Array, Array]

SIGMAS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9)
"""Bounds of the products, for factors of size one."""
TOLERANCE_HOMOTOPY = 1e-8
"""A solution is a proposal, which another NLP polishes."""
MAX_ITERATIONS_HOMOTOPY = 150
"""For one sigma; a solution that exists takes about twenty."""


class Homotopy:
    """One NLP, built once and solved as often as needed.

    Parameters
    ----------
    w, p, sigma, objective, g : CasADi expressions; bounds of g may not depend on sigma.
    bounds_w, bounds_g : lower and upper bounds.
    progress, should_stop : called at every iteration.
    """

    def __init__(
        self,
        *,
        w: MX,
        p: MX,
        sigma: MX,
        g: MX,
        objective: MX,
        bounds_w: Bounds,
        bounds_g: Bounds,
        progress: Progress | None = None,
        should_stop: Stop = None,
    ) -> None:
        self._bounds_w, self._bounds_g = bounds_w, bounds_g
        parameters = vertcat(p, sigma)
        self._watch = Watch(w.numel(), g.numel(), parameters.numel(), progress, should_stop)
        options: dict[str, Any] = {
            "expand": True,
            "print_time": False,
            "show_eval_warnings": False,
            "iteration_callback": self._watch,
            "error_on_fail": False,
            "calc_lam_p": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": TOLERANCE_HOMOTOPY,
                "acceptable_iter": 0,
                "max_iter": MAX_ITERATIONS_HOMOTOPY,
                "mu_strategy": "adaptive",
            },
        }
        problem: dict[str, Any] = {"x": w, "p": parameters, "f": objective, "g": g}
        self._solver = nlpsol("homotopy", "ipopt", problem, options)

    def solve(self, w: Array, p: Array) -> tuple[Array, Status]:
        """Solve from ``w`` at parameters ``p``, shape (n_p,); the last iterate, and how it ended.

        Raises
        ------
        RuntimeError
            If IPOPT ends in a way that only a broken installation or a bug can cause.
        """
        (lower, upper), status = self._bounds_w, Status.CONVERGED
        for sigma in SIGMAS:
            self._watch.begin(*self._bounds_g)
            with RUNNING:
                solution = self._solver(
                    x0=w, p=np.append(p, sigma), lbx=lower, ubx=upper, lbg=self._bounds_g[0], ubg=self._bounds_g[1]
                )
                ending = self._solver.stats()["return_status"]
            if ending not in ENDINGS:
                raise RuntimeError(f"IPOPT ended with {ending}")
            w, (status, _) = np.asarray(solution["x"]).ravel(), ENDINGS[ending]
            if status is not Status.CONVERGED:
                break
        return w, status


Range = tuple[float, float]

ELEMENTS = 14
"""A step of three phases then has about five elements per phase."""
STAGES = np.array([(4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0])
"""Nodes of Radau IIA of order 5."""
DECIDED = 1e-3
"""a this close to 0 or 1 throughout an element is a slip."""
SHORTEST, LONGEST = 0.1, 4.0
"""Length of an element relative to the mean."""
EVEN = 1e-2
"""Weight of the unevenness of the elements, the only objective of a walker without free parameters."""
TIME_RANGE = 5.0
"""The period is within this factor of the guess."""
LANDING_RATE = 0.05
"""Least rate of the guard at touchdown in natural units: feet that stay together are no step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """Mode sequences with a motion, to about five digits.

    Attributes
    ----------
    cycle : of modes.
    durations : of the phases of every step [s].
    states : ndarray, shape (n_steps, n_z) - just after the impact before each step.
    freed : values of the free parameters by dotted key.
    """

    cycle: Cycle
    durations: tuple[tuple[float, ...], ...]
    states: Array
    freed: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Block:
    """Some unknowns: where they are in the vector, and their bounds."""

    symbol: MX
    lower: float
    upper: float


class Complementarity:
    """The NLP of a cycle of steps of a system with open modes.

    Parameters
    ----------
    dynamics : walker, control and ground; natural units follow from its parameters.
    period : typical one of a step [s]; breakpoints of the control before it are ends of elements.
    free : bounds of the parameters that are unknowns, by dotted key.
    within : bounds of the state just after the impact by name, where a design has some.
    n_steps : of the cycle.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        period: float,
        free: Mapping[str, Range] | None = None,
        within: Mapping[str, Range] | None = None,
        *,
        n_steps: int = 1,
        progress: Progress | None = None,
        should_stop: Stop = None,
    ) -> None:
        self._dynamics, self._system = dynamics, dynamics.system
        self._free, self._within = free or {}, within or {}
        self._n_steps = n_steps
        self._scales = dynamics.scales
        self._segments, self._fixed = _segments(self._system.control.breakpoints, period)
        self._blocks: dict[str, _Block] = {}
        self._rows: list[tuple[MX, float, float]] = []
        self._products: list[MX] = []
        objective = self._build()
        w = vertcat(*(block.symbol for block in self._blocks.values()))
        self._solver = Homotopy(
            w=w,
            p=vertcat(self._parameters, self._period),
            sigma=self._sigma,
            g=vertcat(*(row for row, _, _ in self._rows)),
            objective=objective,
            bounds_w=self._bounds([(b.symbol, b.lower, b.upper) for b in self._blocks.values()]),
            bounds_g=self._bounds(self._rows),
            progress=progress,
            should_stop=should_stop,
        )

    def solve(self, starts: Array, ends: Array, period: float) -> Proposal | Status:
        """The cycle near linear motions between states of shape (n_steps, n_z), each in a period [s]; or why not."""
        w, status = self._solver.solve(self._guess(starts, ends, period), np.append(self._dynamics.p, period))
        return self._read(w) if status is Status.CONVERGED else status

    def _build(self) -> MX:
        """All unknowns, constraints and products; the objective."""
        system, n = self._system, self._n_steps
        self._parameters = MX.sym("p", len(system.parameters))
        self._period, self._sigma = MX.sym("period"), MX.sym("sigma")
        freed = {key: self._unknown(key, 1, *bounds) for key, bounds in self._free.items()}
        p = vertcat(*(freed.get(key, self._parameters[i]) for i, key in enumerate(system.parameters)))
        starts = [self._unknown(f"start{s}", system.n_z) for s in range(n)]
        for name, span in self._within.items():
            self._require(starts[0][system.state_names.index(name)], *span)
        feet = [self._foot(f"impact{s}", 1) for s in range(n)]
        objective = MX(0)
        for s, (start, foot) in enumerate(zip(starts, feet, strict=True)):
            z, unevenness = self._step(s, start, foot, p)
            self._impact(z, starts[(s + 1) % n], feet[(s + 1) % n], p)
            objective += unevenness
        self._require(vertcat(*self._products) - self._sigma, -np.inf, 0.0)
        return objective

    def _step(self, s: int, z: MX, foot: tuple[MX, MX, MX], p: MX) -> tuple[MX, MX]:
        """The elements of step ``s`` from state ``z`` on, after the impact of a foot; its end, and the objective."""
        h, t, before = self._unknown(f"h{s}", ELEMENTS, 0.0), MX(0), foot[1:]
        for k, segment in enumerate(self._segments):
            z, t, before = self._element(s, k, z, t, h[k], before, p, segment)
            if k + 1 in self._fixed:
                self._require(t / self._fixed[k + 1], 1.0, 1.0)
        self._require(t / self._period, 1 / TIME_RANGE, TIME_RANGE)
        latest = (*self._system.control.breakpoints, np.inf)[segment]
        self._require(t, max(self._fixed.values(), default=0.0), latest)
        mean = t / ELEMENTS
        self._require(h - SHORTEST * mean, 0.0)
        self._require(LONGEST * mean - h, 0.0)
        return z, EVEN * sum1((h / mean - 1) ** 2)

    def _impact(self, z: MX, start: MX, foot: tuple[MX, MX, MX], p: MX) -> None:
        """The impact that leads from state ``z`` to ``start``."""
        a, forward, backward = foot
        z_plus, impulse, slip, lift = self._system.open_impact(z, 2 * a - 1, p)
        n = self._system.n_shape
        self._require(start - vertcat(z_plus[:n], 0, z_plus[n + 1 :]), 0.0, 0.0)
        self._require(slip / self._scales.speed - forward + backward, 0.0, 0.0)
        self._require(vertcat(impulse[1], lift), 0.0)
        self._products += [a * backward, (1 - a) * forward]

    def _element(
        self, s: int, k: int, z: MX, t: MX, h: MX, before: tuple[MX, MX], p: MX, segment: int
    ) -> tuple[MX, MX, tuple[MX, MX]]:
        """Collocation on an element from state ``z`` at time ``t``; state, time and foot velocities at its end."""
        system, n = self._system, STAGES.size
        data = self._system.data(segment)
        states = [self._unknown(f"z{s}.{k}.{i}", system.n_z) for i in range(n)]
        a, forward, backward = self._foot(f"foot{s}.{k}", n)
        rates: list[MX] = []
        for i, (c, stage) in enumerate(zip(STAGES, states, strict=True)):
            rate, force, guard, guard_rate = system.open_flow(t + c * h, stage, 2 * a[i] - 1, p, data)
            rates.append(rate)
            self._require(force[1], 0.0)
            self._require(stage[-1] / self._scales.speed - forward[i] + backward[i], 0.0, 0.0)
        for stage, row in zip(states, _RADAU, strict=True):
            step = sum((float(b) * rate for b, rate in zip(row, rates, strict=True)), MX(0))
            self._require(stage - z - h * step, 0.0, 0.0)
        if k == ELEMENTS - 1:
            self._require(guard, 0.0, 0.0)
            self._require(guard_rate * self._scales.time, LANDING_RATE)
        self._products += [sum1(a) * (before[1] + sum1(backward)), (n - sum1(a)) * (before[0] + sum1(forward))]
        return states[-1], t + h, (forward[-1], backward[-1])

    def _foot(self, name: str, n: int) -> tuple[MX, MX, MX]:
        """The friction multiplier a and the two parts of the slip velocity, at n stages."""
        return (
            self._unknown(f"{name}.a", n, 0.0, 1.0),
            self._unknown(f"{name}.forward", n, 0.0),
            self._unknown(f"{name}.backward", n, 0.0),
        )

    def _unknown(self, name: str, size: int, lower: float = -np.inf, upper: float = np.inf) -> MX:
        self._blocks[name] = _Block(MX.sym(name, size), lower, upper)
        return self._blocks[name].symbol

    def _require(self, row: MX, lower: float, upper: float = np.inf) -> None:
        self._rows.append((row, lower, upper))

    @staticmethod
    def _bounds(parts: Sequence[tuple[MX, float, float]]) -> tuple[Array, Array]:
        return (
            np.concatenate([np.full(symbol.numel(), lower) for symbol, lower, _ in parts]),
            np.concatenate([np.full(symbol.numel(), upper) for symbol, _, upper in parts]),
        )

    def _guess(self, starts: Array, ends: Array, period: float) -> Array:
        """Straight lines from ``starts`` to ``ends``, the foot at rest."""
        times = _times(self._fixed, period)
        h = np.diff(times)
        values = {key: np.array([self._dynamics.parameter(key)]) for key in self._free}
        for s, (start, end) in enumerate(zip(starts, ends, strict=True)):
            values |= {f"start{s}": start, f"h{s}": h, f"impact{s}.a": np.array([0.5])}
            for k in range(ELEMENTS):
                values[f"foot{s}.{k}.a"] = np.full(STAGES.size, 0.5)
                for i, c in enumerate(STAGES):
                    values[f"z{s}.{k}.{i}"] = start + (times[k] + c * h[k]) / period * (end - start)
        parts = [values.get(name, np.zeros(block.symbol.numel())) for name, block in self._blocks.items()]
        return np.concatenate(parts)

    def _read(self, w: Array) -> Proposal:
        """The mode sequences: one mode per element, like neighbours merged."""
        sizes = np.cumsum([block.symbol.numel() for block in self._blocks.values()])
        values = dict(zip(self._blocks, np.split(w, sizes[:-1]), strict=True))
        impacts = [_mode(values[f"impact{s}.a"]) for s in range(self._n_steps)]
        states = np.array([values[f"start{s}"] for s in range(self._n_steps)])
        states[[impact.sticks for impact in impacts], -1] = 0.0
        runs = [_runs(values, s, impact) for s, impact in enumerate(impacts)]
        phases, durations = zip(*(zip(*run, strict=True) for run in runs), strict=True)
        ends = [*impacts[1:], impacts[0]]
        return Proposal(
            cycle=Cycle(tuple(map(ModeSequence, phases, ends))),
            durations=durations,
            states=states,
            freed={key: float(values[key][0]) for key in self._free},
        )


def _runs(values: Mapping[str, Array], s: int, impact: Mode) -> list[tuple[Mode, float]]:
    """Phases of step ``s``, after an impact, with their durations [s]."""
    modes = [_mode(values[f"foot{s}.{k}.a"]) for k in range(ELEMENTS)]
    if impact.slips:  # even if it is too short for an element
        modes[0] = impact
    pairs = groupby(zip(modes, values[f"h{s}"].tolist(), strict=True), itemgetter(0))
    return [(mode, sum(h for _, h in run)) for mode, run in pairs]


def _segments(breakpoints: Sequence[float], period: float) -> tuple[list[int], dict[int, float]]:
    """The control's segment of every element, and the breakpoints at which elements end, by number of the next one."""
    inside = [b for b in breakpoints if 0 < b < period]
    counts = np.rint(np.array(inside) / period * ELEMENTS).astype(int)
    fixed = {int(k): b for k, b in zip(counts, inside, strict=True) if 0 < k < ELEMENTS}
    times = _times(fixed, period)
    return [int(k) for k in np.searchsorted(breakpoints, (times[1:] + times[:-1]) / 2)], fixed


def _times(fixed: dict[int, float], period: float) -> Array:
    """Ends of the elements, evenly spaced between breakpoints; shape (ELEMENTS + 1,) [s]."""
    ends = {0: 0.0, **fixed, ELEMENTS: period}
    return np.interp(np.arange(ELEMENTS + 1), list(ends), list(ends.values()))


def _radau() -> Array:
    """Coefficients of the collocation: integrals of the Lagrange polynomials on the stages; shape (n, n)."""
    powers = np.arange(STAGES.size)
    integrals = STAGES[:, None] ** (powers + 1) / (powers + 1)
    return integrals @ np.linalg.inv(np.vander(STAGES, increasing=True))


_RADAU = _radau()


def _mode(a: Array) -> Mode:
    if np.all(a > 1 - DECIDED):
        return Mode.SLIP_FORWARD
    return Mode.SLIP_BACKWARD if np.all(a < DECIDED) else Mode.STICK
