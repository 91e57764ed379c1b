"""Direct collocation of a cycle with unknown torques, or of which only the motion is unknown.

On each interval of length h the states are polynomials through z_0 and z_1 .. z_d at the Radau points c_j, with

    sum_k C_kj z_k = h f(t_j, z_j, u_j, p),      t_j = t_0 + c_j h,      j = 1 .. d;      z_d starts the next interval

Unknowns are the states at all points, durations of the phases, torque values of an ``open_loop`` law, freed parameters,
and every integral, extremum and length that objective and constraints name. The intervals of the law divide the mean
duration of a step, so that all times are affine in the durations. If multipliers are needed, the duration T of the law
is an unknown of its own, and a row says that it is that mean. The other equations are then, at fixed T, those under a
law that is fixed in time.

Margins of the modes and path constraints hold at all points, and ``Collocation.violated`` finds points between them
where they do not: an exchange method of semi-infinite programs (Hettich & Kortanek 1993).

This module has the numbers of one problem: bounds, start and search. The points are in ``collocation_mesh``, the
expressions in ``collocation_elements``, the rows in ``collocation_rows``.

References
----------
L. T. Biegler (2010), Nonlinear Programming, ch. 10.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from casadi import DM, MX, Function, Sparsity, jacobian, mtimes, triu, vertcat
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import building
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause
from gaitopt.model.buffered import buffered_map
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.section import CLOCK
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import margin
from gaitopt.model.units import SI
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import ANGLE, CLEARANCE, SCALARS, state_unit, unit_of
from gaitopt.solver.collocation_elements import POWER, SLIP, Goals
from gaitopt.solver.collocation_mesh import DEGREE, INTERVALS, ExtraPoints, Point, basis, mesh_at
from gaitopt.solver.collocation_rows import DURATION, EVENT, SMALLEST_MARGIN, Structure, transcription
from gaitopt.solver.diagnosis import vanishing_phase
from gaitopt.solver.ipopt import Block, Ipopt, IpoptResult, Program
from gaitopt.solver.mesh import mesh_of
from gaitopt.solver.newton import Solution
from gaitopt.solver.shooting import Label, transcribe

TOLERANCE = 1e-9
"""Tolerance of IPOPT."""
MAX_ITERATIONS = 200
LINEAR_OPTIONS: dict[str, Any] = {"mumps_permuting_scaling": 0}
"""Options of MUMPS, which need not permute the columns of these matrices: that takes a fifth of the time of an
iteration."""
WARM_OPTIONS: dict[str, Any] = {"mu_init": 1e-3, "warm_start_init_point": "yes"} | {
    f"warm_start_{what}": 1e-4
    for what in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
}
"""Options with which IPOPT stays near a start whose unknowns and multipliers are close to a solution."""
CLOSE_OPTIONS: dict[str, Any] = {
    "mu_init": 1e-4,
    "mu_strategy": "adaptive",
    "mu_oracle": "probing",
    "bound_mult_init_method": "mu-based",
} | dict.fromkeys(("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), 1e-7)
"""Options with which IPOPT stays near a start that is close to a solution, but whose multipliers are not known.
Mehrotra's probing of the barrier parameter takes three quarters of the iterations of Fiacco and McCormick's rule there;
it takes more if the multipliers are known or the solution is far."""
OBJECTIVE_SLOPE, MORE_ITERATIONS = 10.0, 5
"""Slope to which the objective of a search with bounds on |power| is scaled, because absolute work is small compared
with powers; and factor of the largest number of iterations, because such a search takes some 400."""
SHORTEST_PHASE = 1e-3
"""Shortest phase as a fraction of the period of the guess."""
LONGEST_PERIOD = 5.0
"""Longest period relative to that of the guess."""
STRUCTURAL = ("integral", "defect", "interpolation", "lengths", "reset", EVENT, DURATION, POWER)
"""Rows that define a motion rather than limit it."""
MOTION = ("defect", "interpolation", "reset")
"""Structural rows that compare states, all coordinates in turn."""
RATES = {"power": "work", "absolute_power": "work", "squared_torque": "torque_squared", SLIP: "slip_distance"}
"""A scalar with the unit of each integral, by the rate that is integrated."""
LENGTHS = ("m", "J")
"""Units of distance, and of the work of the push."""
UNITS = {DURATION: "s", CLOCK: "s", POWER: "W", CLEARANCE: "m"}
"""Units of those rows whose names are neither scalars nor margins."""
SAMPLES = 12
"""Number of points per interval at which margins are examined between the collocation points."""

Motion: TypeAlias = Callable[[int, Array], Array]
"""A motion: maps a phase and times (n,) since the impact to states (n, n_z)."""


class Collocation:
    """The program of one problem on one mesh.

    Parameters
    ----------
    problem : the problem, with its goals and bounds.
    system : the system of its walker and law.
    durations : durations of the phases, which determine the order of switches and breakpoints, shape (n_phases,).
    free : bounds of the freed parameters by dotted key.
    degree, intervals : number of Radau points of an interval, and smallest number of intervals.
    extra : extra points, as (interval, fraction), at which the margins must not be negative.
    timed : whether the duration of the law is an unknown of its own, which ``motion`` needs.
    """

    @building
    def __init__(
        self,
        problem: Problem,
        system: HybridSystem,
        durations: Array,
        *,
        free: Mapping[str, tuple[float, float]],
        degree: int = DEGREE,
        intervals: int = INTERVALS,
        extra: ExtraPoints = (),
        timed: bool = False,
    ) -> None:
        self.problem, self.system, self.cycle = problem, system, problem.cycle
        self.free, self.extra, self._guess = free, extra, durations
        self.dynamics = Dynamics.of(system, problem.parameters)
        self.law = system.control if isinstance(system.control, OpenLoop) else None
        mesh = mesh_at(
            problem.cycle, system.control, durations, degree=degree, count=intervals, timed=timed, extra=extra
        )
        structure = Structure(
            system=system,
            mesh=mesh,
            goals=Goals.of(problem),
            free=tuple(free),
            scales=self.dynamics.scales,
            timed=timed,
        )
        self._shared = shared = transcription(structure)
        self.mesh, self.points, self.goals = mesh, shared.points, structure.goals
        self.slices, self.n_x, self.n_states = shared.slices, shared.n_x, shared.points.n_states
        self.phase_starts, self.phase_ends = shared.points.phase_starts, shared.points.phase_ends
        self.program, self.row_names, self.row_labels = shared.program, shared.row_names, shared.row_labels
        self.lbg, self.ubg = shared.lbg.copy(), shared.ubg.copy()
        self._added: tuple[Function, ...] = ()
        names = np.array(self.row_names)
        for name, span in problem.constraints.items():
            if name != CLEARANCE and name not in self.goals.extrema:
                self.lbg[names == name], self.ubg[names == name] = span.minimum, span.maximum

    def columns(self, name: str) -> NDArray[np.intp]:
        """Indices of the unknowns of a block."""
        return self._shared.columns(name)

    @property
    def motion(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Indices of the unknowns of the motion, of the rows that define it, and of those rows of the last impact.

        There are as many rows as unknowns. The law is fixed in time for them, see ``timed``.
        """
        states = np.arange(self.system.n_z * (self.n_states - len(self.extra)))
        defining = [name in ("defect", "reset", EVENT) for name in self.row_names]
        closing = [name == "reset" and at.phase == 0 for name, at in zip(self.row_names, self.row_labels, strict=True)]
        return np.append(states, self.columns("durations")), np.flatnonzero(defining), np.flatnonzero(closing)

    @building
    def add_rows(self, name: str, rows: Function, curvature: Function, columns: NDArray[np.intp]) -> None:
        """Add rows that must not be negative and have the same name; their functions are kept with the program.

        Parameters
        ----------
        rows : (x, p) -> rows, with a Jacobian.
        curvature : (x, p, multipliers of the rows) -> Hessian in some unknowns, symmetric.
        columns : ascending indices of these unknowns.
        """
        plain, count, n = self.program, rows.numel_out(0), columns.size
        self._added = rows, curvature  # callbacks of Python must outlive the program
        self.lbg, self.ubg = np.append(self.lbg, np.zeros(count)), np.append(self.ubg, np.full(count, np.inf))
        self.row_names = (*self.row_names, *[name] * count)
        self.row_labels = (*self.row_labels, *[Label(name="")] * count)
        x, p, weight, multipliers = plain.x, plain.p, MX.sym("w"), MX.sym("l", self.lbg.size)
        g, slope = plain.derivatives["jac_g"](x, p)
        added = rows(x, p)
        chosen = DM(Sparsity.triplet(self.n_x, n, columns.tolist(), [*range(n)]), 1.0)
        bent = mtimes([chosen, curvature(x, p, multipliers[-count:]), chosen.T])
        lagrangian = plain.derivatives["hess_lag"](x, p, weight, multipliers[:-count]) + triu(bent)
        derivatives = {
            "jac_g": ([x, p], [vertcat(g, added), vertcat(slope, jacobian(added, x))], ["g", "jac_g_x"]),
            "hess_lag": ([x, p, weight, multipliers], [lagrangian], ["triu_hess_gamma_x_x"]),
        }
        self.program = replace(
            plain,
            g=vertcat(plain.g, added),
            derivatives=plain.derivatives
            | {
                key: Function(key, inputs, outputs, ["x", "p", "lam_f", "lam_g"][: len(inputs)], names)
                for key, (inputs, outputs, names) in derivatives.items()
            },
        )

    # ---- meanings

    @property
    def x_labels(self) -> tuple[Label, ...]:
        """Meaning of each unknown; a state between two phases belongs to the later one."""
        names = self.system.state_names
        intervals = self.mesh.intervals
        phases = {pt.state: intervals[pt.interval].phase for pt in self.points.all}
        phases |= {state: intervals[k].phase for k, state in enumerate(self.points.first)}
        labels = [
            Label(name=name, mode=self.cycle.phases[phases[state]], phase=phases[state], node=state, unit=unit)
            for state in range(self.n_states)
            for name, unit in zip(names, map(state_unit, names), strict=True)
        ]
        labels += [Label(name=key, unit=unit_of(key, self.system)) for key in self.value_keys]
        labels += [Label(name="duration", mode=m, phase=k, unit="s") for k, m in enumerate(self.cycle.phases)]
        labels += [Label(name=DURATION, unit="s")] * len(self.columns("law_duration"))
        units = {name: unit_of(name, self.system) or SI["one"] for name in (*self.free, *self.goals.extrema)}
        units |= {rate: unit_of(RATES[rate], self.system) for rate in self.goals.rates}
        units |= dict(zip(("distance", "push_work"), LENGTHS, strict=True))
        labels += [Label(name=name, unit=unit) for name, unit in units.items()]
        points = [pt for pt in self.points.all if pt.dynamic] if self._shared.n_powers else []
        for pt in points:
            phase = intervals[pt.interval].phase
            at = Label(name=POWER, mode=self.cycle.phases[phase], phase=phase, node=pt.state, unit="W")
            labels += [replace(at, coordinate=motor) for motor in self.system.walker.actuators]
        return tuple(labels)

    @property
    def g_labels(self) -> tuple[Label, ...]:
        """Meaning of each row, in the order of the program."""
        names, labels, run = self.system.state_names, list[Label](), 0
        for name, label in zip(self.row_names, self.row_labels, strict=True):
            coordinate = ""
            run = run + 1 if labels and name == labels[-1].name else 0
            if name == EVENT:
                name = self.system.transitions.ending(self.cycle, label.phase or 0).guard
            if name in MOTION:
                coordinate = names[run % len(names)]
                unit = state_unit(coordinate, self.system)
            elif name == "integral":
                unit = unit_of(RATES[self.goals.rates[run]], self.system)
            elif name == "lengths":
                unit = LENGTHS[run]
            elif name in UNITS:
                unit = UNITS[name]
            elif name.startswith(ANGLE):
                unit = "rad"
            elif name.startswith("control."):
                unit = unit_of(name, self.system)
            elif label.mode is not None and name not in SCALARS:
                unit = SI[margin(name).unit]
            else:
                unit = unit_of(name, self.system) or SI["one"]
            labels.append(replace(label, name=name, coordinate=coordinate, unit=unit))
        return tuple(labels)

    # ---- numbers

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of all unknowns."""
        lower, upper = np.full(self.n_x, -np.inf), np.full(self.n_x, np.inf)
        walker, largest = self.system.walker, np.full(self.system.n_z, np.inf)
        largest[[walker.shape.index(name) for name in walker.shape if name not in walker.lengths]] = (
            walker.largest_angle
        )
        upper[self.slices["states"]] = np.tile(largest, self.n_states)
        lower[self.slices["states"]] = -upper[self.slices["states"]]
        period = float(self._guess.sum())
        durations = self.slices["durations"]
        lower[durations], upper[durations] = SHORTEST_PHASE * period, LONGEST_PERIOD * period
        for k, (low, high) in zip(self.columns("freed"), self.free.values(), strict=True):
            lower[k], upper[k] = low, high
        if self.law is not None:
            spans = [self.law.spans(self.system.walker)[name] for name in self.law.values]
            lower[self.slices["values"]] = np.repeat([low for low, _ in spans], self.law.count)
            upper[self.slices["values"]] = np.repeat([high for _, high in spans], self.law.count)
        for k, name in zip(self.columns("extrema"), self.goals.extrema, strict=True):
            span = self.problem.constraints.get(name)
            if span is not None:
                lower[k], upper[k] = span.minimum, span.maximum
        return lower, upper

    @property
    def blocks(self) -> tuple[Block, Block]:
        """All unknowns, and all rows, with their bounds."""
        lower, upper = self.bounds()
        return (
            Block(name="unknowns", expression=self.program.x, lower=lower, upper=upper),
            Block(name="rows", expression=self.program.g, lower=self.lbg, upper=self.ubg),
        )

    def vanishing(self, x: Array) -> Cause | None:
        """The phase whose duration is at its lower bound, which no gait has; None if there is none."""
        durations, shortest = self.unpack(x)["durations"], SHORTEST_PHASE * float(self._guess.sum())
        phase = int(np.argmin(durations))
        return vanishing_phase(self.cycle, phase, durations[phase]) if durations[phase] < 1.01 * shortest else None

    def in_order(self, x: Array) -> bool:
        """Whether no interval has a negative length: phases and intervals of the law still end in the same order."""
        return bool((self.points.lengths(self.unpack(x)["durations"]) >= 0).all())

    def pack(self, states: Array, values: Array, durations: Array, freed: Sequence[float]) -> Array:
        """A start from states (n_states, n_z), torque values by motor and durations; other unknowns are zero or one."""
        x = np.zeros(self.n_x)
        x[self.slices["states"]] = states.ravel()
        x[self.slices["values"]] = values
        x[self.slices["durations"]] = durations
        x[self.slices["law_duration"]] = durations.sum() / len(self.cycle.steps)
        x[self.slices["freed"]] = freed
        x[self.slices["extrema"]] = 1.0
        return x

    def solve(
        self,
        motion: Motion,
        values: Array,
        durations: Array,
        freed: Sequence[float],
        *,
        progress: Valued = None,
        should_stop: Stop = None,
        again: "tuple[Collocation, IpoptResult] | None" = None,
        close: bool = False,
        max_iterations: int = MAX_ITERATIONS,
    ) -> IpoptResult:
        """IPOPT's solution from a motion.

        Parameters
        ----------
        again : the same program without the last extra points, and its solution, for a warm start.
        close : whether the motion is close to a solution.
        """
        unknowns, rows = self.blocks
        program = Program(
            unknowns=(unknowns,),
            rows=(rows,),
            p=self.program.p,
            f=self.program.f,
            x0=self.start(motion, values, durations, freed),
            p0=self.dynamics.p,
        )
        options: dict[str, Any] = {"tol": TOLERANCE, "max_iter": max_iterations, "bound_relax_factor": 0.0}
        options |= LINEAR_OPTIONS | (WARM_OPTIONS if again else CLOSE_OPTIONS if close else {})
        if self._shared.n_powers:
            options |= {
                "nlp_scaling_obj_target_gradient": OBJECTIVE_SLOPE,
                "max_iter": MORE_ITERATIONS * max_iterations,
            }
        multipliers = None if again is None else self._extended(*again)
        if self._added:
            ipopt = Ipopt(program, options=options, exact=True, derivatives=self.program.derivatives)
        else:
            ipopt = self._shared.solver(program, options)
        return ipopt.solve(program, multipliers=multipliers, progress=progress, should_stop=should_stop)

    def _extended(self, before: "Collocation", result: IpoptResult) -> tuple[Array, Array]:
        """Multipliers of bounds and rows from those of a program without the last extra points, where they are zero."""
        n, bounds, rows = self.system.n_z, np.zeros(self.n_x), np.zeros(self.lbg.size)
        kept = np.ones(self.n_x, dtype=bool)
        kept[n * before.n_states : n * self.n_states] = False
        added = np.array([at.node is not None and at.node >= before.n_states for at in self.row_labels])
        bounds[kept] = result.bound_multipliers
        rows[np.flatnonzero(~added)[: result.multipliers.size]] = result.multipliers  # rows may have been added
        return bounds, rows

    def on_mesh(self, x: Array, dynamics: Dynamics) -> Solution:
        """The motion of a solution on a mesh of multiple shooting, under the law of ``dynamics``."""
        system, durations = dynamics.system, self.unpack(x)["durations"]
        mesh = mesh_of(self.cycle, durations, system.control.breakpoints)
        nodes = np.empty((system.n_z, mesh.n_nodes))
        for arc, at, (begin, end) in zip(mesh.arcs, mesh.arc_nodes, mesh.arc_times(durations.tolist()), strict=True):
            nodes[:, at.start : at.stop] = self.states_at(x, arc.phase, np.linspace(begin, end, len(at))).T
        equations = transcribe(system, mesh)
        return Solution(equations, equations.pack(nodes, durations), dynamics.p)

    @property
    def value_keys(self) -> tuple[str, ...]:
        """Dotted keys of the torque values."""
        law = self.law
        return () if law is None else tuple(f"control.{name}.{k}" for name in law.values for k in range(law.count))

    def start(self, motion: Motion, values: Array, durations: Array, freed: Sequence[float]) -> Array:
        """A start from a motion; integrals and lengths have the values of that motion."""
        times, states = self.points.times(durations), np.empty((self.n_states, self.system.n_z))
        of_phase: dict[int, list[int]] = {}
        intervals = self.mesh.intervals
        for interval, state in zip(intervals, self.points.first, strict=True):
            of_phase.setdefault(interval.phase, []).append(state)
        for pt in self.points.all:
            of_phase.setdefault(intervals[pt.interval].phase, []).append(pt.state)
        for phase, members in of_phase.items():
            states[members] = motion(phase, times[members])
        x = self.pack(states, values, durations, freed)
        g, names, n_powers = self._rows(x), np.array(self._shared.row_names), self._shared.n_powers
        if n_powers:
            x[self.slices["powers"]] = -g[names == POWER].reshape((-1, 2, n_powers)).min(axis=1).ravel()
            g = self._rows(x)
        x[self.slices["integrals"]] -= g[names == "integral"]
        x[self.slices["lengths"]] -= g[names == "lengths"]
        for k, name in zip(self.columns("extrema"), self.goals.extrema, strict=True):
            x[k] = self._extremum(name, x)
        return x

    def _rows(self, x: Array) -> Array:
        """Values of the rows, without those of ``add_rows``."""
        return self._shared.values(x, self.dynamics.p)[0].copy()

    def _extremum(self, name: str, x: Array) -> float:
        """The smallest (or largest) value of an extremum that satisfies its rows, which are linear in it."""
        k = self.slices["extrema"].start + self.goals.extrema.index(name)
        at = np.array(self._shared.row_names) == name
        x0, x1 = x.copy(), x.copy()
        x0[k], x1[k] = 0.0, 1.0
        a, b = (self._rows(each)[at] for each in (x0, x1))
        moves = b != a
        zeros = -a[moves] / (b - a)[moves]
        return float(zeros.max() if SCALARS[name].extremum > 0 else zeros.min())

    def violated(self, x: Array, samples: int, limit: float, *, beside: int = 0) -> list[tuple[int, float]]:
        """Extra points (interval, fraction) between the others at which a margin or path constraint is violated most.

        Parameters
        ----------
        samples : number of samples between two points.
        limit : slack in natural units below which a margin is violated.
        beside : number of samples on either side that are returned too, because the smallest margin moves when a margin
            is required not to be negative there.
        """
        fractions = (np.arange(samples * self.mesh.degree) + 0.5) / (samples * self.mesh.degree)
        between, intervals = basis(self.mesh.degree, fractions), self.mesh.intervals
        slack = np.full((len(intervals), fractions.size), np.inf)
        variants = self._shared.variants
        for variant in dict.fromkeys(variants):
            mine = [k for k, interval in enumerate(intervals) if variants[interval.phase] == variant]
            y = np.vstack([self._between(x, k, between) for k in mine])
            points = [Point(interval=k, fraction=f, state=-1, dynamic=False) for k in mine for f in fractions.tolist()]
            c = self._shared.constants(points, np.zeros(len(points)))
            rows = buffered_map(self._shared.point_function(variant, dynamic=False), len(y))(y, c, self.dynamics.p)[1]
            slack[mine] = np.array(
                [
                    self._slack(variant[0], k, each.T)
                    for k, each in zip(mine, np.split(np.asarray(rows), len(mine)), strict=True)
                ]
            )
        found = list[tuple[int, float]]()
        for k, lowest in enumerate(slack.argmin(axis=1).tolist()):
            known = [f for i, f in self.extra if i == k]
            if slack[k, lowest] < limit and not np.isclose(known, fractions[lowest]).any():
                chosen = fractions[max(lowest - beside, 0) : lowest + beside + 1].tolist()
                found += [(k, f) for f in chosen if not np.isclose(known, f).any()]
        return found

    def _between(self, x: Array, interval: int, between: Array) -> Array:
        """Unknowns (n, n_y) at n points of an interval, given the values of the Lagrange polynomials there."""
        states = self.unpack(x)["states"][self.points.of_interval(interval)]
        values = self._shared.value_columns(self.mesh.intervals[interval].segment)
        rest = np.concatenate([x[values], x[self._shared.tail]])
        return np.hstack([between @ states, np.tile(rest, (len(between), 1))])

    def _slack(self, mode: Mode, interval: int, values: Array) -> Array:
        """Smallest slack of margins, path constraints and extrema at n points (n,), from their rows (n_rows, n)."""
        names, units = self.system.transitions.margin_names(mode), self.dynamics.margin_units(mode)
        slack = np.full(values.shape[1], np.inf)
        pt = Point(interval=interval, fraction=0.5, state=-1, dynamic=False)
        for row, (name, unit) in enumerate(zip(names, units, strict=True)):
            if self._shared.margin_bounds(name, pt)[0] > -np.inf:
                slack = np.minimum(slack, values[row] / unit)
        for row, name in enumerate(self.goals.paths, start=len(names)):
            span = self.problem.constraints[name]
            low, high = (0.0, np.inf) if name == CLEARANCE else (span.minimum, span.maximum)
            slack = np.minimum(slack, np.minimum(values[row] - low, high - values[row]) + SMALLEST_MARGIN)
        extrema = values[len(names) + len(self.goals.paths) :]
        return np.minimum(slack, extrema.min(axis=0) + SMALLEST_MARGIN) if extrema.size else slack

    def active(self, multipliers: Array, bound_multipliers: Array) -> list[tuple[str, float]]:
        """Names of rows and bounds with the sizes of their multipliers, relative to the largest one; largest first.

        A multiplier times its bound, or the natural unit of a margin, is the effect of a relative change of the bound.
        """
        sums = dict[str, float]()
        limits = np.where(multipliers > 0, self.ubg, self.lbg).tolist()
        for name, at, value, limit in zip(self.row_names, self.row_labels, multipliers.tolist(), limits, strict=True):
            if name not in STRUCTURAL:
                is_margin = at.mode is not None and name not in self.problem.constraints
                unit = abs(limit) / (SMALLEST_MARGIN if is_margin else 1.0) or 1.0
                sums[name] = sums.get(name, 0.0) + abs(value) * (unit if np.isfinite(unit) else 1.0)
        lower, upper = (each[self.slices["values"]] for each in self.bounds())
        pressed = bound_multipliers[self.slices["values"]]
        ends = np.where(pressed > 0, upper, lower)
        for key, value, end in zip(self.value_keys, pressed.tolist(), ends.tolist(), strict=True):
            motor = key.split(".")[1]
            stated = self.law is not None and motor in self.law.bounds
            name = f"control.bounds.{motor}" if stated else f"the effort of {motor}"
            sums[name] = sums.get(name, 0.0) + abs(value) * (abs(end) if np.isfinite(end) else 0.0)
        for key, value in zip(self.free, bound_multipliers[self.slices["freed"]].tolist(), strict=True):
            sums[key] = abs(value)
        largest = max(sums.values(), default=0.0) or 1.0
        return sorted(((name, value / largest) for name, value in sums.items()), key=lambda each: -each[1])

    def worst(self, x: Array) -> list[Cause]:
        """The limit that is violated most at a point; if none is, the largest residual of the equations of motion."""
        rows = Function("rows", [self.program.x, self.program.p], [self.program.g]) if self._added else None
        g = self._rows(x) if rows is None else np.asarray(rows(x, self.dynamics.p)).ravel()
        violation = np.maximum(self.lbg - g, g - self.ubg)
        beyond = np.where([name in STRUCTURAL for name in self.row_names], 0.0, violation)
        k = int(np.argmax(beyond if np.max(beyond) > SMALLEST_MARGIN else violation))
        name, bound = self.row_names[k], float(np.clip(g[k], self.lbg[k], self.ubg[k]))
        if not violation[k] > SMALLEST_MARGIN:
            return []
        if self.row_labels[k].mode is not None and name not in self.problem.constraints:
            bound = 0.0  # without the room for the error of the collocation
        side = "at least" if g[k] < bound else "at most"
        reason = f"{name.replace('_', ' ')} is {g[k]:.4g}, must be {side} {bound:.4g}"
        if name in STRUCTURAL:
            reason = f"{name} of the equations of motion is off by {violation[k]:.3g}"
        return [Cause(what=name, description=reason, needed=bound, available=float(g[k]))]

    def unpack(self, x: Array) -> dict[str, Array]:
        """Blocks of the unknowns by name; states have the shape (n_states, n_z)."""
        blocks = {name: x[at] for name, at in self.slices.items()}
        return {**blocks, "states": blocks["states"].reshape(self.n_states, -1)}

    def states_at(self, x: Array, phase: int, times: Array) -> Array:
        """States of the collocation polynomials in a phase at times since the impact, shape (n, n_z)."""
        blocks = self.unpack(x)
        return self.points.interpolated(blocks["states"], blocks["durations"], phase, times)
