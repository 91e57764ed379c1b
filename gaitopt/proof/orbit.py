"""A cycle of steps as equations for its section states and the durations of its arcs, enclosed with derivatives.

    u = (xi_1, ..., xi_n, T_1, ..., T_m),      F(u) = (event_1, ..., event_m, P_1 - xi_2, ..., P_n - xi_1)

xi_i are the section coordinates at the start of step i, P_i those after the impact that ends it, T_j the duration of
arc j and event_j the quantity whose zero ends it: a margin of its mode, or the time to a breakpoint of the control.
A zero of F is a periodic gait, and the derivative of its return map is the product over its steps of

    DP = P_xi - P_T (event_T)^-1 event_xi

the durations follow from the events, and saltation with them. In a family all of this depends on a parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from casadi import SX, Function, cse, jacobian, vertcat
from flint import arb, arb_mat

from gaitopt.mechanics import Cycle, HybridSystem, Mode, margin_names
from gaitopt.proof.box import Box, identity
from gaitopt.proof.bundle import Bundle, carry
from gaitopt.proof.field import Field
from gaitopt.proof.graph import Graph
from gaitopt.proof.parametric import Parametric, at, hull, matrix, scattered
from gaitopt.proof.taylor import Expansion

BREAKPOINT = "breakpoint"


@dataclass(frozen=True, slots=True)
class Arc:
    """A smooth piece of the step: one mode on one segment of the control.

    Attributes
    ----------
    phase : its number in the mode sequence.
    event : the margin whose zero ends it, or ``breakpoint``.
    steps : lengths of the steps of its integration [s] but for the last one, which ends with the arc.
    """

    mode: Mode
    segment: int
    phase: int
    event: str
    steps: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Impact:
    """An impact as balls; see ``mechanics.impact``."""

    z_plus: list[Any]
    impulse: list[Any]
    slip_velocity: Any
    lift_velocity: Any
    painleve: Any


@dataclass(frozen=True, slots=True)
class Passage:
    """One cycle from every point of a box.

    Attributes
    ----------
    residual, arrived : the two parts of F at the centre of the box.
    events, arrivals : derivatives of the events and of (P_1, ..., P_n) in w, row by row.
    expansions : of every arc, step by step.
    starts, ends : boxes of the state where every arc starts and ends.
    """

    residual: list[Any] = field(default_factory=list)
    arrived: list[Any] = field(default_factory=list)
    events: list[list[Any]] = field(default_factory=list)
    arrivals: list[list[Any]] = field(default_factory=list)
    expansions: list[list[Expansion]] = field(default_factory=list)
    starts: list[list[Any]] = field(default_factory=list)
    ends: list[list[Any]] = field(default_factory=list)


class Orbit:
    """The equations of one mode sequence.

    Parameters
    ----------
    p : parameters in balls; one of them may vary.
    sequence : of the modes.
    arcs : in order of time.
    """

    def __init__(self, system: HybridSystem, p: Sequence[Any], sequence: Cycle, arcs: Sequence[Arc]) -> None:
        self.system, self.p, self.sequence, self.arcs = system, list(p), sequence, tuple(arcs)
        impacts = sequence.impacts
        self.sections = [[int(k) for k in system.section(impacts[step - 1])] for step in range(len(impacts))]
        self.n_xi, self.n_arcs = sum(map(len, self.sections)), len(arcs)
        self.names = (
            *(f"{system.state_names[k]} of step {step + 1}" for step, xi in enumerate(self.sections) for k in xi),
            *(f"T{j + 1}" for j in range(len(arcs))),
        )
        self._fields: dict[tuple[Mode, int], Field] = {}
        self._impacts: dict[Mode, Graph] = {}

    def field(self, mode: Mode, segment: int) -> Field:
        """The vector field of a mode on a segment of the control."""
        if (mode, segment) not in self._fields:
            data = [arb(float(value)) for value in self.system.data(segment)]
            self._fields[mode, segment] = Field(self.system, mode, self.p, data)
        return self._fields[mode, segment]

    def arcs_of(self, step: int) -> list[int]:
        """Indices of the arcs of a step."""
        return [j for j, arc in enumerate(self.arcs) if self.sequence.step_of(arc.phase) == step]

    def impact(self, mode: Mode, y: Sequence[Any]) -> Impact:
        """The impact in state ``y`` after which the foot is in ``mode``."""
        z_plus, impulse, (slip,), (lift,), (painleve,), _ = self._impact(mode)(y)
        return Impact(z_plus, impulse, slip, lift, painleve)

    def traverse(self, box: Box) -> Passage:
        """Follow the cycle from every u in a box.

        Raises
        ------
        NotProved
            If a step of the integration cannot be verified.
        """
        passage = Passage()
        for step, impact in enumerate(self.sequence.impacts):
            bundle = self._begin(step, box)
            for j in self.arcs_of(step):
                self._follow(j, bundle, box, passage)
            after = self.impact(impact, bundle.centre).z_plus
            n_z, n = self.system.n_z, self.system.n_z + 1
            slopes = by_columns(self._impact(impact)(bundle.box)[5], n_z, n) * bundle.slope
            for k, entry in zip(self.sections[self._next(step)], self._xi(self._next(step)), strict=True):
                passage.arrived.append(after[k] - box.centre[entry])
                passage.arrivals.append(row(slopes, k))
        return passage

    def phase_durations(self, durations: Sequence[arb]) -> tuple[arb, ...]:
        """Durations of the phases from those of the arcs."""
        phases = range(len(self.sequence.phases))
        pairs = list(zip(self.arcs, durations, strict=True))
        return tuple(sum((T for arc, T in pairs if arc.phase == phase), arb(0)) for phase in phases)

    def residual(self, passage: Passage) -> Any:
        """F at the centre of the box, shape (n_w, 1)."""
        return matrix(len(self.names), 1, [*passage.residual, *passage.arrived])

    def slope(self, passage: Passage) -> Any:
        """dF/dw on the box, shape (n_w, n_w)."""
        departures = [entry for step in range(len(self.sections)) for entry in self._xi(self._next(step))]
        rows = [*map(list, passage.events), *map(list, passage.arrivals)]
        for values, entry in zip(rows[self.n_arcs :], departures, strict=True):
            values[entry] = values[entry] - 1
        return from_rows(rows)

    def return_maps(self, passage: Passage, parts: int) -> list[arb_mat]:
        """Derivatives of the return map, shape (n_xi_1, n_xi_1); for parts of the interval of the parameter."""
        events, arrivals = from_rows(passage.events), from_rows(passage.arrivals)
        if not isinstance(arrivals, Parametric):
            return [self._return_map(hull(events), arrivals)]
        half = arb(1) / parts
        middles = [half * (2 * k + 1) - 1 for k in range(parts)]
        spans = [middle + arb(0, half.upper()) for middle in middles]
        return [self._return_map(at(events, span), at(arrivals, span)) for span in spans]

    def _return_map(self, events: arb_mat, arrivals: arb_mat) -> arb_mat:
        total, row = identity(len(self.sections[0])), 0
        for step in range(len(self.sections)):
            xi, arcs = self._xi(step), self.arcs_of(step)
            rows = range(row, row + len(self._xi(self._next(step))))
            durations = [self.n_xi + j for j in arcs]
            times = part(events, arcs, durations).solve(part(events, arcs, xi))
            total = (part(arrivals, rows, xi) - part(arrivals, rows, durations) * times) * total
            row = rows.stop
        return total

    def _next(self, step: int) -> int:
        return (step + 1) % len(self.sections)

    def _xi(self, step: int) -> list[int]:
        """Entries of u that are the section coordinates at the start of a step."""
        before = sum(map(len, self.sections[:step]))
        return list(range(before, before + len(self.sections[step])))

    def _begin(self, step: int, box: Box) -> Bundle:
        """The motions just after the impact before a step."""
        entries, n_x = self._xi(step), self.system.lift.size1_in(0)
        at_rest = [arb(0)] * (n_x - len(entries))
        y = self._lift([*(box.centre[entry] for entry in entries), *at_rest])[0]
        columns = [int(entry == k) for entry in [*entries, *([None] * len(at_rest))] for k in range(len(self.names))]
        jacobian = self._lift([*(box.whole[entry] for entry in entries), *at_rest])[1]
        slope = by_columns(jacobian, len(y), n_x) * arb_mat(n_x, len(self.names), columns)
        return Bundle(box.column, y, slope)

    def _follow(self, j: int, bundle: Bundle, box: Box, passage: Passage) -> None:
        """Carry the motions along arc ``j`` and to its event."""
        arc, entry, n = self.arcs[j], self.n_xi + j, self.system.n_z + 1
        flow = self.field(arc.mode, arc.segment)
        passage.starts.append(bundle.box)
        passage.expansions.append(carry(flow, bundle, arc.steps, box.centre[entry], box.whole[entry]))
        rates = matrix(n, 1, flow.rate(passage.expansions[-1][-1].end)[0])
        bundle.slope += rates * arb_mat(1, len(self.names), [int(k == entry) for k in range(len(self.names))])
        passage.ends.append(bundle.box)
        passage.residual.append(self._event(arc, flow, bundle.centre))
        passage.events.append(row(self._event_gradient(arc, flow, bundle.box) * bundle.slope, 0))
        self._reset(arc, bundle)

    def _event(self, arc: Arc, flow: Field, y: list[Any]) -> Any:
        if arc.event == BREAKPOINT:
            return y[self.system.n_z] - arb(self.system.control.breakpoints[arc.segment])
        return flow.margins(y)[0][margin_names(arc.mode).index(arc.event)]

    def _event_gradient(self, arc: Arc, flow: Field, y: list[Any]) -> Any:
        """Derivative of the event in y, shape (1, n)."""
        if arc.event == BREAKPOINT:
            return arb_mat([[int(k == self.system.n_z) for k in range(flow.n)]])
        names = margin_names(arc.mode)
        gradients = flow.margin_gradients(y)[0]
        return matrix(1, flow.n, gradients[names.index(arc.event) :: len(names)])

    def _reset(self, arc: Arc, bundle: Bundle) -> None:
        """What is known exactly where F is zero: a foot that comes to rest, and the time of a breakpoint."""
        n_z = self.system.n_z
        if arc.event == "slip_velocity":
            bundle.fix(n_z - 1, arb(0))
        if arc.event == BREAKPOINT:
            bundle.fix(n_z, arb(self.system.control.breakpoints[arc.segment]))

    @cached_property
    def _lift(self) -> Graph:
        """xi with dx -> the state y at the start of a step, and its derivative."""
        xi, p = SX.sym("x", self.system.lift.size1_in(0)), SX.sym("p", len(self.p))
        y = vertcat(self.system.lift(xi, p), 0)
        return Graph(Function("lift", [xi, p], cse([y, jacobian(y, xi)])), [self.p])

    def _impact(self, mode: Mode) -> Graph:
        """y -> the impact, and the derivative of z_plus."""
        if mode not in self._impacts:
            y, p = SX.sym("y", self.system.n_z + 1), SX.sym("p", len(self.p))
            result = self.system.impact(mode)(y[: self.system.n_z], p)
            outputs = cse([*result, jacobian(result[0], y)])
            self._impacts[mode] = Graph(Function(f"impact_{mode.key}", [y, p], outputs), [self.p])
        return self._impacts[mode]


def by_columns(entries: Sequence[Any], rows: int, columns: int) -> Any:
    """The matrix of an output of a graph, whose columns come one after the other."""
    return matrix(rows, columns, [entries[i + rows * j] for i in range(rows) for j in range(columns)])


def from_rows(rows: Sequence[Sequence[Any]]) -> Any:
    """A matrix from its rows."""
    return matrix(len(rows), len(rows[0]), [value for values in rows for value in values])


def row(values: Any, i: int) -> list[Any]:
    """One row of a matrix."""
    return scattered(values, lambda m: [m[i, j] for j in range(m.ncols())])


def part(matrix: arb_mat, rows: Sequence[int], columns: Sequence[int]) -> arb_mat:
    """Some rows and columns."""
    return arb_mat([[matrix[i, j] for j in columns] for i in rows])
