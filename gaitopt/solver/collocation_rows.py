"""Unknowns and rows of a direct collocation, and their program: all that does not depend on the numbers of a problem.

    sum_k C_kj z_k = h f(t_j, z_j, u_j, p)           defects, j = 1 .. d
    int f dt = sum_j h B_j f_j                       integrals
    z_i = sum_k L_k(c_i) z_k                         states at extra points

Problems that differ in parameters and bounds alone have one program, whose functions, and whose solver, are built once.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from casadi import Function
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_array

from gaitopt.arrays import Array
from gaitopt.building import BUILT, built_once
from gaitopt.model.buffered import BufferedFunction
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop, Order
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import margin, margin_unit
from gaitopt.model.units import Scales
from gaitopt.problem.scalars import CLEARANCE, SCALARS, phase_of
from gaitopt.solver.collocation_elements import (
    IMPULSE,
    POWER,
    Goals,
    PointKey,
    impact_function,
    point_function,
    scalars_function,
)
from gaitopt.solver.collocation_mesh import CollocationMesh, Point, basis, points_of
from gaitopt.solver.elements import Elements, assembled
from gaitopt.solver.ipopt import Ipopt, Program
from gaitopt.solver.shooting import Label
from gaitopt.threads import cached_property

SMALLEST_MARGIN = 1e-7
"""Lower bound of margins in natural units. It exceeds the error of the collocation, but none of a measurement."""
EVENT, DURATION = "event", "duration of the law"
"""Names of the rows that end phases, and of the row that gives the control law its duration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """All that determines a program; problems with an equal structure share it.

    Attributes
    ----------
    system, mesh, goals : system, points and scalars of the program.
    free : dotted keys of the freed parameters.
    scales : natural units, in which margins are no smaller than ``SMALLEST_MARGIN``.
    timed : whether the duration of the law is an unknown of its own.
    """

    system: HybridSystem
    mesh: CollocationMesh
    goals: Goals
    free: tuple[str, ...]
    scales: Scales
    timed: bool


_Limits: TypeAlias = list[tuple[int, str, float, float]]
"""For each group of rows their number, their name, and their lower and upper bound."""


class _Rows:
    """The rows of g while they are collected: bounds, names, and entries of the linear part."""

    def __init__(self) -> None:
        self.lower, self.upper, self.names = list[float](), list[float](), list[str]()
        self.at, self.labels = Label(name=""), list[Label]()  # label of the next rows, and labels of all rows
        self._entries = list[tuple[Array, ...]]()

    def new(self, count: int, name: str, low: float = 0.0, high: float = 0.0) -> list[int]:
        """The indices of ``count`` new rows."""
        first = len(self.lower)
        self.lower += [low] * count
        self.upper += [high] * count
        self.names += [name] * count
        self.labels += [self.at] * count
        return [*range(first, first + count)]

    def linear(self, rows: ArrayLike, columns: ArrayLike, values: ArrayLike) -> None:
        """Add entries of the linear part, whose rows, columns and values are broadcast to one shape."""
        self._entries.append(np.broadcast_arrays(rows, columns, values))

    def matrix(self, n_x: int) -> csc_array:
        """The linear part."""
        rows, columns, values = (
            np.concatenate([entry.ravel() for entry in each]) for each in zip(*self._entries, strict=True)
        )
        return csc_array(coo_array((values, (rows, columns)), shape=(len(self.lower), n_x)))


class Transcription:
    """The program of one structure. It is made by ``transcription``, which builds it once.

    Attributes
    ----------
    structure : the structure that it was made for.
    points : the points of the mesh.
    slices : slices of the unknowns, by name of the block.
    n_x : number of unknowns.
    n_powers : number of unknowns that bound |power| at a collocation point.
    program : functions of unknowns and parameters.
    values : (x, p) -> rows.
    lbg, ubg : bounds of the rows; a row that has a range in the problem has no bounds here.
    row_names, row_labels : names of the rows, and labels with their phases and nodes.
    """

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        self._system, self._mesh, self._goals = structure.system, structure.mesh, structure.goals
        law = structure.system.control
        self._law = law if isinstance(law, OpenLoop) else None
        self.points = points_of(structure.mesh)
        self.n_powers = len(self._system.walker.actuators) if self._goals.bounds_power else 0
        sizes = {
            "states": self._system.n_z * self.points.n_states,
            "values": 0 if self._law is None else len(self._law.values) * self._law.count,
            "durations": len(self._mesh.cycle.phases),
            "law_duration": int(structure.timed),
            "freed": len(structure.free),
            "extrema": len(self._goals.extrema),
            "integrals": len(self._goals.rates),
            "lengths": 2,  # distance, work of the push
            "powers": self.n_powers * sum(pt.dynamic for pt in self.points.all),
        }
        ends = np.cumsum([0, *sizes.values()])
        self.slices = {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
        self.n_x = int(ends[-1])
        rows = _Rows()
        elements = self._elements(rows)
        self.lbg, self.ubg, self.row_names = np.array(rows.lower), np.array(rows.upper), tuple(rows.names)
        self.row_labels = tuple(rows.labels)
        self.program = assembled(elements, rows.matrix(self.n_x), len(self._system.parameters))
        inputs = [self.program.x, self.program.p]
        self.values = BufferedFunction(BUILT.watch(Function("rows", inputs, [self.program.g])))
        self._solvers = dict[tuple[tuple[str, Any], ...], Ipopt]()

    def columns(self, name: str) -> NDArray[np.intp]:
        """Numbers of the unknowns of a block."""
        return np.arange(self.slices[name].start, self.slices[name].stop)

    def column_of(self, name: str) -> int | None:
        """Index of the unknown with a name of the problem; None if the name is not that of an unknown."""
        if name.startswith("state."):
            return self._system.state_names.index(name.removeprefix("state."))
        phase = phase_of(name)
        if phase is not None:
            return int(self.columns("durations")[phase])
        if name in self.structure.free:
            return int(self.columns("freed")[self.structure.free.index(name)])
        if self._law is not None and name.startswith("control."):
            _, motor, k = name.split(".")
            return self.slices["values"].start + [*self._law.values].index(motor) * self._law.count + int(k)
        return None

    def value_columns(self, segment: int) -> list[int]:
        """Indices of the torque values at both ends of an interval of the law, motor by motor."""
        if self._law is None:
            return []
        ends = 2 if self._law.order is Order.LINEAR else 1
        first = self.slices["values"].start
        return [first + j * self._law.count + segment + k for j in range(len(self._law.values)) for k in range(ends)]

    @property
    def tail(self) -> list[int]:
        """Indices of the unknowns on which every point depends."""
        return [k for name in ("durations", "law_duration", "freed", "extrema") for k in self.columns(name).tolist()]

    def constants(self, points: Sequence[Point], weights: Array) -> Array:
        """Constants of points that have these weights in integrals; one row for each point."""
        intervals = [self._mesh.intervals[pt.interval] for pt in points]
        starts, ends = (np.array([getattr(each, name) for each in intervals]) for name in ("start", "end"))
        step_ends = np.array([self._step_ends[each.phase] for each in intervals])
        fractions, lengths = np.array([[pt.fraction] for pt in points]), ends - starts
        segments = np.array([[each.segment] for each in intervals])
        arch = np.full(segments.shape, self._goals.arch)
        data = [np.zeros(0) if self._law else self._system.data(each.segment) for each in intervals]
        times = starts + fractions * lengths
        return np.hstack([times, lengths, step_ends, segments, weights[:, None], arch, np.array(data)])

    @cached_property
    def _step_ends(self) -> Array:
        """The end of the step of each phase, affine in the durations and T; shape (n_phases, n_phases + 2)."""
        steps = [*map(self._mesh.cycle.step_of, range(len(self._mesh.cycle.phases)))]
        return np.array([[0.0, *(float(other == step) for other in steps), 0.0] for step in steps])

    @cached_property
    def variants(self) -> tuple[tuple[Mode, int], ...]:
        """The mode of each phase, and the entry of ``HybridSystem.step_parameters`` that its step uses."""
        cycle, legs = self._mesh.cycle, self._system.legs
        return tuple((mode, cycle.step_of(phase) % legs) for phase, mode in enumerate(cycle.phases))

    def point_function(self, variant: tuple[Mode, int], *, dynamic: bool) -> Function:
        """The function of the collocation points, or of the other points, of one of the ``variants``."""
        structure, cycle = self.structure, self._mesh.cycle
        return point_function(
            PointKey(
                system=self._system.shared,
                mode=variant[0],
                leg=variant[1],
                n_phases=len(cycle.phases),
                n_steps=len(cycle.steps),
                free=structure.free,
                goals=self._goals,
                dynamic=dynamic,
                timed=structure.timed,
            )
        )

    def solver(self, program: Program, options: dict[str, Any]) -> Ipopt:
        """IPOPT for a program of this structure, built once for the options."""
        key = tuple(sorted(options.items()))
        if key not in self._solvers:
            self._solvers[key] = Ipopt(program, options=options, exact=True, derivatives=self.program.derivatives)
        return self._solvers[key]

    def margin_bounds(self, name: str, pt: Point) -> tuple[float, float]:
        """Bounds of a margin at a point."""
        cycle, phase, table = self._mesh.cycle, self._mesh.intervals[pt.interval].phase, self._system.transitions
        starts, ends = self._ends(pt)
        if ends and name == table.ending(cycle, phase).guard:
            return 0.0, 0.0
        if margin(name).rises or table.is_zero_by_event(cycle, phase, name, starts=starts, ends=ends):
            return -np.inf, np.inf
        return SMALLEST_MARGIN * margin_unit(name, self.structure.scales), np.inf

    # ---- the rows

    def _elements(self, rows: _Rows) -> list[Elements]:
        """The rows of all points, impacts and scalars."""
        goals, cycle = self._goals, self._mesh.cycle
        integrals = rows.new(len(goals.rates), "integral")
        rows.linear(integrals, self.columns("integrals"), 1.0)
        lengths = rows.new(2, "lengths")
        rows.linear(lengths, self.columns("lengths"), 1.0)
        kinds = tuple(dict.fromkeys(self.variants))
        elements = [self._points_of(rows, integrals, kind, dynamic) for kind in kinds for dynamic in (True, False)]
        resets = ((phase, cycle.reset_after(phase)) for phase in range(len(cycle.phases)))
        elements += [self._impact_element(rows, lengths, phase, after) for phase, after in resets if after is not None]
        elements.append(self._scalar_element(rows))
        for phase in range(len(cycle.phases)):
            if self._system.transitions.ending(cycle, phase).guard == CLOCK:
                rows.at = Label(name="", mode=cycle.phases[phase], phase=phase, node=self.points.phase_ends[phase])
                clock = self._system.control.period
                assert clock is not None  # the reader of problems requires it
                rows.linear(rows.new(1, EVENT, clock, clock)[0], self.columns("durations"), 1.0)
                rows.at = Label(name="")
        for name in goals.constrained:
            column = self.column_of(name)
            if column is not None:
                rows.linear(rows.new(1, name, -np.inf, np.inf)[0], column, 1.0)
        if self.structure.timed:
            period = rows.new(1, DURATION)
            rows.linear(period, self.columns("durations"), 1.0)
            rows.linear(period, self.columns("law_duration"), -float(len(cycle.steps)))
        self._rate_rows(rows)
        return [each for each in elements if each is not None]

    def _points_of(
        self, rows: _Rows, integrals: list[int], variant: tuple[Mode, int], dynamic: bool
    ) -> Elements | None:
        """The elements of the points of one of the ``variants``: its collocation points, or its other points."""
        mesh, (mode, _), n = self._mesh, variant, self._system.n_z
        mine = [pt for pt in self.points.all if pt.dynamic is dynamic]
        mine = [pt for pt in mine if self.variants[mesh.intervals[pt.interval].phase] == variant]
        if not mine:
            return None
        n_powers, tail, limits = self.n_powers if dynamic else 0, self.tail, dict[tuple[int, bool, bool], _Limits]()
        columns, g_rows, defining, interpolated = list[list[int]](), list[list[int]](), list[list[int]](), list[Point]()
        for pt in mine:
            interval = mesh.intervals[pt.interval]
            of_point = [*range(n * pt.state, n * pt.state + n), *self.value_columns(interval.segment)]
            if n_powers:
                j = pt.state - self.points.inner[pt.interval]
                first = self.slices["powers"].start + n_powers * (pt.interval * mesh.degree + j)
                of_point += range(first, first + n_powers)
            columns.append(of_point + tail)
            rows.at = Label(name="", mode=mode, phase=interval.phase, node=pt.state)
            own = list[int]()
            if dynamic:
                defining.append(own := rows.new(n, "defect"))
            elif pt.fraction > 0.0:
                defining.append(rows.new(n, "interpolation"))
                interpolated.append(pt)
            ends = interval.phase, *self._ends(pt)
            if ends not in limits:
                limits[ends] = list(self._limits(mode, pt))
            of_limits = [number for limit in limits[ends] for number in rows.new(*limit)]
            of_limits += rows.new(2 * n_powers, POWER, 0.0, np.inf)
            g_rows.append([*own, *of_limits, *(integrals if dynamic else [])])
        rows.at = Label(name="")

        weights = np.zeros(len(mine))
        # states at collocation points have derivatives, those at extra points are interpolated
        if dynamic:
            states = [self.points.of_interval(pt.interval) for pt in mine]
            at = [pt.state - self.points.inner[pt.interval] for pt in mine]
            weights = self.points.B[at]
            self._combined(rows, defining, states, self.points.C[:, at].T)
        elif interpolated:
            states = [[pt.state, *self.points.of_interval(pt.interval)] for pt in interpolated]
            between = basis(mesh.degree, np.array([pt.fraction for pt in interpolated]))
            self._combined(rows, defining, states, np.hstack([np.ones((len(states), 1)), -between]))
        return Elements(
            function=self.point_function(variant, dynamic=dynamic),
            columns=np.array(columns),
            rows=np.array(g_rows),
            constants=self.constants(mine, weights),
        )

    def _limits(self, mode: Mode, pt: Point) -> Iterator[tuple[int, str, float, float]]:
        """Number, name and bounds of the rows that limit a point; ranges of the problem have no bounds yet."""
        for name in self._system.transitions.margin_names(mode):
            low, high = self.margin_bounds(name, pt)
            yield 1, EVENT if low == high else name, low, high
        for name in self._goals.paths:
            phase, (starts, ends) = self._mesh.intervals[pt.interval].phase, self._ends(pt)
            first, last = phase in self._mesh.cycle.first_phases, self._mesh.cycle.after(phase) is None
            at_end = (starts and first) or (ends and last)
            yield 1, name, 0.0 if name == CLEARANCE and not at_end else -np.inf, np.inf
        for name, each in self._goals.of_points(self._system.walker, mode):
            yield each * len(SCALARS[name].signs), name, 0.0, np.inf

    def _ends(self, pt: Point) -> tuple[bool, bool]:
        """Whether a point is the start, and whether it is the end, of its phase."""
        phase = self._mesh.intervals[pt.interval].phase
        starts = pt.state == self.points.phase_starts[phase] and pt.fraction == 0.0
        return starts, pt.state == self.points.phase_ends[phase]

    def _combined(self, rows: _Rows, own: ArrayLike, states: ArrayLike, weights: Array) -> None:
        """Add weighted sums of m states to K groups of n_z rows, shapes (K, n_z), (K, m) and (K, m)."""
        n = self._system.n_z
        columns = n * np.asarray(states)[:, :, None] + np.arange(n)
        rows.linear(np.asarray(own)[:, None, :], columns, weights[:, :, None])

    def _impact_element(self, rows: _Rows, lengths: list[int], phase: int, impact: Mode) -> Elements:
        """An impact: the state after it, the lengths of the step, and its margins."""
        system, cycle, n = self._system, self._mesh.cycle, self._system.n_z
        ends_step, after = cycle.after(phase) is None, (phase + 1) % len(cycle.phases)
        ratio = IMPULSE in self._goals.extrema and ends_step and system.cycle_end == TOUCHDOWN
        start, end = self.points.phase_starts[after], self.points.phase_ends[phase]
        rows.at = Label(name="", mode=impact, phase=after, node=start)
        own = rows.new(n, "reset")
        self._combined(rows, [own], [[start]], np.ones((1, 1)))
        rows.at = Label(name="", mode=impact)
        own += lengths
        struck, before = system.transitions.struck(cycle, phase), cycle.phases[phase]
        assert struck is not None
        for name in system.transitions.impact_margin_names(struck, before):
            own += rows.new(1, name, 0.0, np.inf)
        columns = [*range(n * end, n * end + n), *self.columns("freed").tolist()]
        if ratio:
            own += rows.new(2, IMPULSE, 0.0, np.inf)
            columns.append(self.slices["extrema"].start + self._goals.extrema.index(IMPULSE))
        rows.at = Label(name="")
        leg = self.variants[phase][1]
        function = impact_function(system.shared, (struck, before), ends_step, leg, self.structure.free, ratio)
        return Elements(
            function=function, columns=np.array([columns]), rows=np.array([own]), constants=np.zeros((1, 0))
        )

    def _scalar_element(self, rows: _Rows) -> Elements:
        """The objective, and the scalars that have formulas."""
        goals, free, own = self._goals, self.structure.free, list[int]()
        for name in goals.formulas:
            own += rows.new(1, name, -np.inf, np.inf)
        blocks = ("durations", "freed", "integrals", "lengths", "extrema")
        states = tuple(name for name, _ in goals.objective if name not in SCALARS and name not in free)
        direct = [column for column in map(self.column_of, states) if column is not None]
        columns = np.concatenate([*(self.columns(name) for name in blocks), np.array(direct, dtype=np.intp)])
        return Elements(
            function=scalars_function(self._system.shared, len(self._mesh.cycle.phases), free, goals, states),
            columns=columns[None, :],
            rows=np.array(own, dtype=np.intp).reshape(1, -1),
            constants=np.zeros((1, 0)),
        )

    def _rate_rows(self, rows: _Rows) -> None:
        """Add the rows that limit the rates of the torques: |c_(k+1) - c_k| <= rate T / N."""
        law = self._law
        if law is None:
            return
        for name, rate in law.rates.items():
            for k in range(law.intervals):
                first = self.slices["values"].start + [*law.values].index(name) * law.count + k
                for row, sign in zip(rows.new(2, f"control.rates.{name}", 0.0, np.inf), (1.0, -1.0), strict=True):
                    rows.linear(row, [first, first + 1], [sign, -sign])
                    rows.linear(row, self.columns("durations"), rate / law.intervals / len(self._mesh.cycle.steps))


@built_once(maxsize=16)
def transcription(structure: Structure) -> Transcription:
    """The program of a structure."""
    return Transcription(structure)
