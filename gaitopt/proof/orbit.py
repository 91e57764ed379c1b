"""One step of a walker as equations for its section state and the durations of its arcs, enclosed with derivatives.

    x = (xi, T_1, ..., T_m),      F(x) = (event_1, ..., event_m, xi_plus - xi)

xi are the section coordinates just after an impact, T_j the duration of arc j and event_j the quantity whose zero ends
it: a margin of its mode, or the time left to a breakpoint of the control. A zero of F is a periodic gait, and

    DP = P_xi - P_T (event_T)^-1 event_xi,       P = xi_plus

is the derivative of its return map: the durations follow from the events, and saltation with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from casadi import SX, Function, cse, jacobian
from flint import arb, arb_mat

from gaitopt.mechanics import CONTACTS, HybridSystem, Mode, margin_names
from gaitopt.proof.bundle import Bundle, carry, identity
from gaitopt.proof.field import Field
from gaitopt.proof.graph import Graph
from gaitopt.proof.taylor import Expansion, Step

BREAKPOINT = "breakpoint"


@dataclass(frozen=True, slots=True)
class Arc:
    """A smooth piece of the step: one mode on one segment of the control.

    Attributes
    ----------
    phase : its number in the mode sequence.
    event : the margin whose zero ends it, or ``breakpoint``.
    steps : what its integration is verified with.
    """

    mode: Mode
    segment: int
    phase: int
    event: str
    steps: tuple[Step, ...]


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
    """One step from every x of a box.

    Attributes
    ----------
    residual : F at the centre of the box, shape (n_x,).
    slope : F' on the box, shape (n_x, n_x).
    expansions : of every arc, step by step.
    starts, ends : boxes of the state (z, t) where every arc starts and ends; the last one ends at the impact.
    """

    residual: list[arb]
    slope: arb_mat
    expansions: list[list[Expansion]]
    starts: list[list[arb]]
    ends: list[list[arb]]


class Orbit:
    """The equations of one mode sequence.

    Parameters
    ----------
    p : parameters in balls.
    arcs : in order of time.
    impact : mode of the impact that ends the step.
    """

    def __init__(self, system: HybridSystem, p: Sequence[arb], arcs: Sequence[Arc], impact: Mode) -> None:
        self.system, self.p, self.arcs, self.impact_mode = system, list(p), tuple(arcs), impact
        self.section = [int(k) for k in system.section(impact)]
        self.unknowns = (*(system.state_names[k] for k in self.section), *(f"T{j + 1}" for j in range(len(arcs))))
        self._fields: dict[tuple[Mode, int], Field] = {}

    def field(self, mode: Mode, segment: int) -> Field:
        """The vector field of a mode on a segment of the control."""
        if (mode, segment) not in self._fields:
            data = [arb(float(value)) for value in self.system.data(segment)]
            self._fields[mode, segment] = Field(self.system, mode, self.p, data)
        return self._fields[mode, segment]

    def start(self, xi: Sequence[arb]) -> list[arb]:
        """State (z, t) just after the impact."""
        return [arb(value) for value in self._lift(self._full(xi))[0]] + [arb(0)]

    def impact(self, mode: Mode, z: Sequence[arb]) -> Impact:
        """The impact in state ``z`` after which the foot is in ``mode``."""
        z_plus, impulse, (slip,), (lift,), (painleve,) = self._impacts[mode](list(z))[:5]
        return Impact(z_plus, impulse, arb(slip), arb(lift), arb(painleve))

    def traverse(self, centre: Sequence[arb], deviation: Sequence[arb]) -> Passage:
        """Follow the step from every x in the box ``centre + deviation``.

        Raises
        ------
        NotProved
            If a step of the integration cannot be verified.
        """
        n_xi = len(self.section)
        xi = list(centre[:n_xi])
        box = [value + spread for value, spread in zip(centre, deviation, strict=True)]
        bundle = Bundle(list(deviation), self.start(xi), self._start_slope(box[:n_xi], len(box)))
        passage = Passage([], arb_mat(0, 0), [], [], [])
        rows: list[list[arb]] = []
        for j, arc in enumerate(self.arcs):
            passage.starts.append(bundle.hull)
            field = self.field(arc.mode, arc.segment)
            passage.expansions.append(carry(field, bundle, arc.steps, centre[n_xi + j], box[n_xi + j]))
            for i, rate in enumerate(field.rate(passage.expansions[-1][-1].end)[0]):
                bundle.slope[i, n_xi + j] = arb(rate)
            passage.ends.append(bundle.hull)
            passage.residual.append(self._event(arc, field, bundle.centre))
            rows.append(self._event_row(arc, field, bundle))
            self._reset(arc, bundle)
        after = self.impact(self.impact_mode, bundle.centre[:-1]).z_plus
        passage.residual.extend(after[k] - xi[i] for i, k in enumerate(self.section))
        return replace(passage, slope=arb_mat(rows + self._impact_rows(bundle)))

    def return_map(self, passage: Passage) -> arb_mat:
        """Derivative DP of the return map, shape (n_xi, n_xi)."""
        n_xi, m = len(self.section), len(self.arcs)
        slope = passage.slope
        events_xi, events_T = _block(slope, 0, m, 0, n_xi), _block(slope, 0, m, n_xi, m)
        P_xi = _block(slope, m, n_xi, 0, n_xi) + identity(n_xi)
        return P_xi - _block(slope, m, n_xi, n_xi, m) * events_T.solve(events_xi)

    def _event(self, arc: Arc, field: Field, y: list[arb]) -> arb:
        if arc.event == BREAKPOINT:
            return y[-1] - arb(self.system.control.breakpoints[arc.segment])
        return arb(field.margins(y)[0][margin_names(arc.mode).index(arc.event)])

    def _event_row(self, arc: Arc, field: Field, bundle: Bundle) -> list[arb]:
        """Derivative of the event in x."""
        D = bundle.slope
        n, columns = D.nrows(), D.ncols()
        if arc.event == BREAKPOINT:
            return [D[n - 1, j] for j in range(columns)]
        names = margin_names(arc.mode)
        gradient = field.margin_gradients(bundle.hull)[0][names.index(arc.event) :: len(names)]
        return [sum((arb(g) * D[i, j] for i, g in enumerate(gradient)), arb(0)) for j in range(columns)]

    def _reset(self, arc: Arc, bundle: Bundle) -> None:
        """What is known exactly where F is zero: a foot that comes to rest, and the time of a breakpoint."""
        n = len(bundle.centre)
        if arc.event == "slip_velocity":
            bundle.fix(n - 2, arb(0))
        if arc.event == BREAKPOINT:
            bundle.fix(n - 1, arb(self.system.control.breakpoints[arc.segment]))

    def _impact_rows(self, bundle: Bundle) -> list[list[arb]]:
        """Derivative of xi_plus - xi in x."""
        D, size = bundle.slope, self.system.n_z
        slopes = self._impacts[self.impact_mode](bundle.hull[:-1])[5]
        rows = []
        for i, k in enumerate(self.section):
            row = [sum((arb(slopes[k + size * n]) * D[n, j] for n in range(size)), arb(0)) for j in range(D.ncols())]
            row[i] -= 1
            rows.append(row)
        return rows

    def _full(self, xi: Sequence[arb]) -> list[arb]:
        """Section coordinates with dx, which is zero after a sticking impact."""
        return [*xi, arb(0)] if self.impact_mode.sticks else list(xi)

    def _start_slope(self, xi: Sequence[arb], columns: int) -> arb_mat:
        slopes = self._lift(self._full(xi))[1]
        n_z = self.system.n_z
        D = arb_mat(n_z + 1, columns)
        for i in range(n_z):
            for j in range(len(xi)):
                D[i, j] = arb(slopes[i + n_z * j])
        return D

    @cached_property
    def _lift(self) -> Graph:
        xi, p = SX.sym("xi", self.system.lift.size1_in(0)), SX.sym("p", len(self.p))
        z = self.system.lift(xi, p)
        return Graph(Function("lift", [xi, p], cse([z, jacobian(z, xi)])), [self.p])

    @cached_property
    def _impacts(self) -> dict[Mode, Graph]:
        z, p = SX.sym("z", self.system.n_z), SX.sym("p", len(self.p))
        graphs = {}
        for mode in CONTACTS:
            result = self.system.impact(mode)(z, p)
            outputs = cse([*result, jacobian(result[0], z)])
            graphs[mode] = Graph(Function(f"impact_{mode.key}", [z, p], outputs), [self.p])
        return graphs


def _block(matrix: arb_mat, row: int, rows: int, column: int, columns: int) -> arb_mat:
    return arb_mat([[matrix[row + i, column + j] for j in range(columns)] for i in range(rows)])
