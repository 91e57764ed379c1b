"""A cycle of steps as equations for its section states and the durations of its arcs, enclosed with derivatives.

    u = (xi_1, ..., xi_n, T_1, ..., T_m),      F(u) = (event_1, ..., event_m, P_1 - xi_2, ..., P_n - xi_1)

xi_i are the section coordinates at the start of step i, P_i those after the impact that ends it, T_j the duration of
arc j and event_j the quantity whose zero ends it: a margin of its mode, or the time to a breakpoint of the control.
A zero of F is a periodic gait, and the derivative of its return map is the product over its steps of

    DP = P_xi - P_T (event_T)^-1 event_xi

the durations follow from the events, and saltation with them. A parameter s that varies is a last entry of u.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from casadi import SX, Function, cse, jacobian, vertcat
from flint import arb, arb_mat

from gaitopt.mechanics import Cycle, HybridSystem, Mode, margin_names
from gaitopt.proof.box import Box, identity, vector
from gaitopt.proof.bundle import Bundle, carry
from gaitopt.proof.field import Field, with_entry
from gaitopt.proof.graph import Graph
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

    z_plus: list[arb]
    impulse: list[arb]
    slip_velocity: arb
    lift_velocity: arb
    painleve: arb


@dataclass(frozen=True, slots=True)
class Passage:
    """One cycle from every point of a box.

    Attributes
    ----------
    residual : of the events, and of the sections, at the centre of the box; together F.
    events, arrivals : derivatives of the events and of (P_1, ..., P_n) with respect to v, on the box.
    expansions : of every arc, step by step.
    starts, ends : boxes of the state where every arc starts and ends.
    """

    residual: tuple[list[arb], list[arb]] = field(default_factory=lambda: ([], []))
    events: list[list[arb]] = field(default_factory=list)
    arrivals: list[list[arb]] = field(default_factory=list)
    expansions: list[list[Expansion]] = field(default_factory=list)
    starts: list[list[arb]] = field(default_factory=list)
    ends: list[list[arb]] = field(default_factory=list)

    @property
    def flat_residual(self) -> list[arb]:
        """F at the centre of the box."""
        return [*self.residual[0], *self.residual[1]]


class Orbit:
    """The equations of one mode sequence.

    Parameters
    ----------
    p : parameters in balls.
    sequence : of the modes.
    arcs : in order of time.
    varied : index in ``p`` of the parameter that varies along a family, if one does.
    """

    def __init__(
        self, system: HybridSystem, p: Sequence[arb], sequence: Cycle, arcs: Sequence[Arc], varied: int | None = None
    ) -> None:
        self.system, self.p, self.sequence, self.arcs, self.varied = system, list(p), sequence, tuple(arcs), varied
        impacts = sequence.impacts
        self.sections = [[int(k) for k in system.section(impacts[step - 1])] for step in range(len(impacts))]
        self.n_xi, self.n_arcs = sum(map(len, self.sections)), len(arcs)
        self.names = (
            *(f"{system.state_names[k]} of step {step + 1}" for step, xi in enumerate(self.sections) for k in xi),
            *(f"T{j + 1}" for j in range(len(arcs))),
            *(() if varied is None else (system.parameters[varied],)),
        )
        self._fields: dict[tuple[Mode, int], Field] = {}
        self._impacts: dict[Mode, Graph] = {}

    def on(self, box: Box | None, arcs: Sequence[Arc]) -> "Orbit":
        """The same equations with other steps of the integration, for the values of the parameter in a box."""
        orbit = copy(self)
        orbit.p, orbit.arcs = list(self.p), tuple(arcs)
        if box is not None and self.varied is not None:
            orbit.p[self.varied] = box.hull[-1]
        return orbit

    def field(self, mode: Mode, segment: int) -> Field:
        """The vector field of a mode on a segment of the control."""
        if (mode, segment) not in self._fields:
            data = [arb(float(value)) for value in self.system.data(segment)]
            self._fields[mode, segment] = Field(self.system, mode, self.p, data, self.varied)
        return self._fields[mode, segment]

    def arcs_of(self, step: int) -> list[int]:
        """Indices of the arcs of a step."""
        return [j for j, arc in enumerate(self.arcs) if self.sequence.step_of(arc.phase) == step]

    def phase_durations(self, durations: Sequence[arb]) -> tuple[arb, ...]:
        """Durations of the phases from those of the arcs."""
        phases = range(len(self.sequence.phases))
        pairs = list(zip(self.arcs, durations, strict=True))
        return tuple(sum((T for arc, T in pairs if arc.phase == phase), arb(0)) for phase in phases)

    def impact(self, mode: Mode, y: Sequence[arb]) -> Impact:
        """The impact in state ``y`` after which the foot is in ``mode``."""
        z_plus, impulse, (slip,), (lift,), (painleve,), _ = self._impact(mode)(y)
        return Impact([arb(value) for value in z_plus], impulse, arb(slip), arb(lift), arb(painleve))

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
            slopes = matrix(self._impact(impact)(bundle.hull)[5], self.system.n_z) * bundle.slope
            for k, entry in zip(self.sections[self._next(step)], self._xi(self._next(step)), strict=True):
                passage.residual[1].append(after[k] - box.centre[entry])
                passage.arrivals.append(_row(slopes, k))
        return passage

    def slope(self, passage: Passage, box: Box) -> arb_mat:
        """dF/dv on the box, shape (n_x, n_v)."""
        departures = [entry for step in range(len(self.sections)) for entry in self._xi(self._next(step))]
        rows = zip(passage.arrivals, (_row(box.frame, entry) for entry in departures), strict=True)
        return arb_mat(passage.events + [[a - b for a, b in zip(*pair, strict=True)] for pair in rows])

    def return_map(self, passage: Passage, box: Box) -> arb_mat:
        """Derivative of the return map at a fixed value of the parameter, shape (n_xi_1, n_xi_1)."""
        events, arrivals = arb_mat(passage.events) * box.inverse, arb_mat(passage.arrivals) * box.inverse
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
        at_rest = [arb(0)] * (self.system.lift.size1_in(0) - len(self.sections[step]))
        last = range(self.n_xi + self.n_arcs, len(box.centre))

        def variables(u: Sequence[arb]) -> list[arb]:
            return [*(u[entry] for entry in self._xi(step)), *at_rest, *(u[entry] for entry in last)]

        y = [arb(value) for value in self._lift(variables(box.centre))[0]]
        columns = arb_mat([variables(list(column)) for column in box.frame.transpose().tolist()])
        slopes = matrix(self._lift(variables(box.hull))[1], len(y)) * columns.transpose()
        return Bundle(vector([d.union(arb(0)) for d in box.deviation]), y, slopes)

    def _follow(self, j: int, bundle: Bundle, box: Box, passage: Passage) -> None:
        """Carry the motions along arc ``j`` and to its event."""
        arc, entry = self.arcs[j], self.n_xi + j
        flow = self.field(arc.mode, arc.segment)
        passage.starts.append(bundle.hull)
        passage.expansions.append(carry(flow, bundle, arc.steps, box.centre[entry], box.hull[entry]))
        rates = vector([arb(rate) for rate in flow.rate(passage.expansions[-1][-1].end)[0]])
        bundle.slope += rates * arb_mat([_row(box.frame, entry)])
        passage.ends.append(bundle.hull)
        passage.residual[0].append(self._event(arc, flow, bundle.centre))
        passage.events.append(_row(self._event_gradient(arc, flow, bundle.hull) * bundle.slope, 0))
        self._reset(arc, bundle)

    def _event(self, arc: Arc, flow: Field, y: list[arb]) -> arb:
        if arc.event == BREAKPOINT:
            return y[self.system.n_z] - arb(self.system.control.breakpoints[arc.segment])
        return arb(flow.margins(y)[0][margin_names(arc.mode).index(arc.event)])

    def _event_gradient(self, arc: Arc, flow: Field, y: list[arb]) -> arb_mat:
        """Derivative of the event in y, shape (1, n)."""
        if arc.event == BREAKPOINT:
            return arb_mat([[int(k == self.system.n_z) for k in range(flow.n)]])
        names = margin_names(arc.mode)
        return arb_mat([_row(matrix(flow.margin_gradients(y)[0], len(names)), names.index(arc.event))])

    def _reset(self, arc: Arc, bundle: Bundle) -> None:
        """What is known exactly where F is zero: a foot that comes to rest, and the time of a breakpoint."""
        n_z = self.system.n_z
        if arc.event == "slip_velocity":
            bundle.fix(n_z - 1, arb(0))
        if arc.event == BREAKPOINT:
            bundle.fix(n_z, arb(self.system.control.breakpoints[arc.segment]))

    @cached_property
    def _lift(self) -> Graph:
        """(xi with dx, s) -> the state y at the start of a step, and its derivative."""
        n_xi = self.system.lift.size1_in(0)
        x, p = SX.sym("x", n_xi + int(self.varied is not None)), SX.sym("p", len(self.p))
        xi, s = x[:n_xi], x[n_xi:]
        y = vertcat(self.system.lift(xi, with_entry(p, self.varied, s)), 0, s)
        return Graph(Function("lift", [x, p], cse([y, jacobian(y, x)])), [self.p])

    def _impact(self, mode: Mode) -> Graph:
        """y -> the impact, and the derivative of z_plus."""
        if mode not in self._impacts:
            n_z = self.system.n_z
            y, p = SX.sym("y", n_z + 1 + int(self.varied is not None)), SX.sym("p", len(self.p))
            result = self.system.impact(mode)(y[:n_z], with_entry(p, self.varied, y[n_z + 1 :]))
            outputs = cse([*result, jacobian(result[0], y)])
            self._impacts[mode] = Graph(Function(f"impact_{mode.key}", [y, p], outputs), [self.p])
        return self._impacts[mode]


def matrix(entries: Sequence[Any], rows: int) -> arb_mat:
    """The matrix of an output of a graph, whose columns come one after the other."""
    return arb_mat(len(entries) // rows, rows, [arb(value) for value in entries]).transpose()


def part(matrix: arb_mat, rows: Sequence[int], columns: Sequence[int]) -> arb_mat:
    """Some rows and columns."""
    return arb_mat([[matrix[i, j] for j in columns] for i in rows])


def _row(matrix: arb_mat, i: int) -> list[arb]:
    return [matrix[i, j] for j in range(matrix.ncols())]
