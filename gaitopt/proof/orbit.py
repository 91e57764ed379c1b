"""A cycle of steps as equations for its nodes and the durations of its arcs, enclosed with derivatives.

    F(u) = (y_(k+1) - phi(y_k, f_k T),  event(y_end),  y_first - reset(y_end before)),      u = (nodes y_k, durations T)

Nodes are the states between two steps of the integration, and at both ends of every arc; a step takes the fixed
fraction f_k of its arc's duration; an event is a margin of the mode or the time to a breakpoint of the control; a reset
is an impact, a foot that comes to rest, or the identity. A zero of F is a periodic gait. No enclosure passes on to the
next step, so that none grows along the motion.

Existence and uniqueness of a zero of F on a box, by Krawczyk's operator, and the derivative of the return map.

    K(s) = -C(s) F(centre + tilt s) + (1 - C(s) F_u(s)) w,        C an approximate inverse of F_u

If K lies in the interior of the box of deviations w for every s, F has exactly one zero in it for every s, and it lies
in K. With dF/ds = g + g' s, F(centre + tilt s) = F(centre) + g s + g' s^2 / 2 by the mean value theorem.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from casadi import SX, Function, cse, jacobian, vertcat
from flint import arb, arb_mat

from gaitopt.model.cycle import Cycle
from gaitopt.model.margins import margin_names
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.proof.graph import UNIT, Graph, NotProved, Tilted, at, hull, scattered
from gaitopt.proof.taylor import Field, States, Step, expand, matrix, taylor_coefficients

BREAKPOINT = "breakpoint"


@dataclass(frozen=True, slots=True)
class Arc:
    """A smooth piece of the step: one mode on one segment of the control.

    Attributes
    ----------
    phase : its number in the mode sequence.
    event : the margin whose zero ends it, or ``breakpoint``.
    fractions : of its duration that the steps of its integration take, but for the last one, which ends with the arc.
    """

    mode: Mode
    segment: int
    phase: int
    event: str
    fractions: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Box:
    """Unknowns u in centre + tilt s + deviation, s in [-1, 1] the place in the interval of a parameter."""

    centre: Sequence[arb]
    tilt: Sequence[arb]
    deviation: Sequence[arb]

    @property
    def hull(self) -> list[arb]:
        """All u."""
        return self.at(UNIT)

    @property
    def tilted(self) -> list[Tilted]:
        """All u as numbers that depend on the parameter."""
        return [Tilted(u + w, v) for u, v, w in zip(self.centre, self.tilt, self.deviation, strict=True)]

    def at(self, s: arb) -> list[arb]:
        """All u at some place."""
        return [u + s * v + w for u, v, w in zip(self.centre, self.tilt, self.deviation, strict=True)]


@dataclass(frozen=True, slots=True)
class Passage:
    """One cycle, step by step, from every point of a box.

    Attributes
    ----------
    residual : F at the centre, by the first row of a group of equations.
    blocks : dF/du on the box but for the unit matrix of the nodes, as (first row, first column, values).
    steps : of the integration, of every arc.
    starts, ends : boxes of the state where every arc starts and ends.
    """

    residual: dict[int, list[arb]] = field(default_factory=dict)
    blocks: list[tuple[int, int, Any]] = field(default_factory=list)
    steps: list[list[Step]] = field(default_factory=list)
    starts: list[list[arb]] = field(default_factory=list)
    ends: list[list[arb]] = field(default_factory=list)


class Orbit:
    """The equations of one mode sequence.

    Parameters
    ----------
    p : parameters in balls.
    varied : index of the parameter that varies, if one does.
    interval : its middle and its half length.
    sequence : of the modes.
    arcs : in order of time.
    order : of the integration.

    Attributes
    ----------
    nodes : first entry in u of every node, arc by arc.
    durations : entry in u of every arc's duration.
    size : number of unknowns; the derivatives in the parameter are one column more.
    """

    def __init__(
        self,
        system: HybridSystem,
        p: Sequence[arb],
        varied: int | None,
        interval: Sequence[arb],
        sequence: Cycle,
        arcs: Sequence[Arc],
        order: int,
    ) -> None:
        self.system, self.p, self.varied, self.interval = system, list(p), varied, tuple(interval)
        self.sequence, self.arcs, self.n = sequence, tuple(arcs), system.n_z + 1
        self.order = order
        self.nodes: list[list[int]] = []
        for arc in arcs:
            first = self.nodes[-1][-1] + self.n if self.nodes else 0
            self.nodes.append([first + self.n * k for k in range(len(arc.fractions) + 2)])
        first = self.nodes[-1][-1] + self.n
        self.durations = list(range(first, first + len(arcs)))
        self.size = first + len(arcs)
        self._fields: dict[tuple[Mode, int, int], Field] = {}

    def name(self, entry: int) -> str:
        """An unknown in words."""
        if entry in self.durations:
            return f"the duration of arc {self.durations.index(entry) + 1}"
        names = (*self.system.state_names, "the time")
        j = next(j for j, nodes in enumerate(self.nodes) if entry < nodes[-1] + self.n)
        node, state = divmod(entry - self.nodes[j][0], self.n)
        return f"{names[state]} at node {node + 1} of arc {j + 1}"

    @property
    def is_long(self) -> bool:
        """Whether a parameter varies, by more than its rounding."""
        return bool(self.interval) and not self.interval[1].is_zero()

    def side(self, j: int) -> int:
        """Which leg stands in arc ``j``."""
        return self.system.walker.side(self.sequence.step_of(self.arcs[j].phase))

    def field(self, mode: Mode, j: int) -> Field:
        """The vector field of a mode in the place of arc ``j``."""
        key = (mode, self.arcs[j].segment, self.side(j))
        if key not in self._fields:
            data = [arb(float(value)) for value in self.system.data(self.arcs[j].segment)]
            self._fields[key] = Field(self._states(j), mode, self.p, data)
        return self._fields[key]

    def arcs_of(self, step: int) -> list[int]:
        """Indices of the arcs of a step."""
        return [j for j, arc in enumerate(self.arcs) if self.sequence.step_of(arc.phase) == step]

    def phase_durations(self, durations: Sequence[arb]) -> tuple[arb, ...]:
        """Durations of the phases from those of the arcs."""
        pairs = list(zip(self.arcs, durations, strict=True))
        return tuple(sum((T for arc, T in pairs if arc.phase == k), arb(0)) for k in range(len(self.sequence.phases)))

    def middle(self, centre: Sequence[arb], entry: int) -> list[arb]:
        """The centre of a node, with the parameter that varies."""
        return [*centre[entry : entry + self.n], *self.interval[:1]]

    def node(self, u: Sequence[Any], entry: int) -> list[Any]:
        """All states of a node, with the parameter that varies."""
        return [*u[entry : entry + self.n], *([Tilted(*self.interval)] if self.is_long else self.interval[:1])]

    def fractions(self, j: int) -> list[arb]:
        """Of an arc's duration that its steps take."""
        stated = [*map(arb, self.arcs[j].fractions)]
        return [*stated, 1 - sum(stated, arb(0))]

    def traverse(self, box: Box) -> Passage:
        """Enclose F and its derivative on a box.

        Raises
        ------
        NotProved
            If a step of the integration cannot be verified.
        """
        passage, u = Passage(), box.tilted if self.is_long else box.hull
        for j in range(len(self.arcs)):
            self._follow(j, box.centre, u, passage)
            self._close(j, box.centre, u, passage)
        return passage

    def _follow(self, j: int, centre: Sequence[arb], u: Sequence[Any], passage: Passage) -> None:
        """The steps of an arc."""
        flow, entry, steps = self.field(self.arcs[j].mode, j), self.durations[j], list[Step]()
        for here, following, share in zip(self.nodes[j], self.nodes[j][1:], self.fractions(j), strict=False):
            step = expand(flow, self.node(u, here), share * u[entry], self.order)
            middle = taylor_coefficients(flow, self.middle(centre, here), self.order)
            reached = step.end_of(middle, share * centre[entry])[: self.n]
            passage.residual[following] = [y - end for y, end in zip(centre[following:], reached, strict=False)]
            rates = matrix(1, [-rate * share for rate in flow.rate(step.end)[0][: self.n]])
            self._add(passage, following, here, -step.variation())
            passage.blocks.append((following, entry, rates))
            steps.append(step)
        passage.steps.append(steps)

    def _close(self, j: int, centre: Sequence[arb], u: Sequence[Any], passage: Passage) -> None:
        """The event that ends an arc, and the reset from which the next one starts."""
        end, first = self.nodes[j][-1], self.nodes[(j + 1) % len(self.arcs)][0]
        passage.starts.append(list(map(hull, self.node(u, self.nodes[j][0]))))
        passage.ends.append(list(map(hull, self.node(u, end))))
        event, after = self._ending(j)(self.middle(centre, end))[:2]
        passage.residual[self.durations[j]] = event
        passage.residual[first] = [y - z for y, z in zip(centre[first : first + self.n], after, strict=True)]
        gradient, slope = self._ending(j)(self.node(u, end))[2:]
        self._add(passage, self.durations[j], end, by_columns(gradient, 1))
        self._add(passage, first, end, -by_columns(slope, self.n))

    def _add(self, passage: Passage, row: int, column: int, values: Any) -> None:
        """Keep derivatives in a node, and those in the parameter that varies apart."""
        entries, n = scattered(values, arb_mat.entries), self.n + len(self.interval[:1])
        rows = [entries[k : k + n] for k in range(0, len(entries), n)][: self.n]
        passage.blocks.append((row, column, matrix(self.n, [value for values in rows for value in values[: self.n]])))
        if self.interval:
            passage.blocks.append((row, self.size, matrix(1, [values[-1] for values in rows])))

    def _states(self, j: int) -> States:
        return States(self.system, self.varied, self.side(j))

    @lru_cache(maxsize=256)  # noqa: B019 - as long as the equations
    def _ending(self, j: int) -> Graph:
        """y -> event of arc ``j``, the state from which the next arc starts, and the derivatives of both."""
        arc, following, states = self.arcs[j], (j + 1) % len(self.arcs), self._states(j)
        system, n_z, (y, p, values) = self.system, self.system.n_z, states.symbols()
        r, time = SX.sym("r", system.n_r), SX.sym("breakpoint")
        after = y[: self.n]
        if arc.event == BREAKPOINT:
            event = y[n_z] - time
            after[n_z] = time
        else:
            index = margin_names(arc.mode).index(arc.event)
            event = system.margins(arc.mode)(y[n_z], y[:n_z], values, r)[index]
        if arc.event == "slip_velocity":
            after[n_z - 1] = 0
        if arc.event == "touchdown":
            impact = self.sequence.impacts[self.sequence.step_of(arc.phase)]
            xi = system.impact(impact)(y[:n_z], values)[0][self.section(impact)]
            full = vertcat(xi, SX.zeros(system.lift.size1_in(0) - xi.numel()))
            after = vertcat(system.lift(full, states.side_of(y, p, self.side(following))), 0)
        outputs = cse([event, after, jacobian(event, y), jacobian(after, y)])
        breakpoints = [*self.system.control.breakpoints, 0.0]
        data = [arb(float(value)) for value in system.data(arc.segment)]
        return Graph(
            Function("ending", [y, p, r, time], outputs), [self.p, data, [arb(float(breakpoints[arc.segment]))]]
        )

    def section(self, impact: Mode) -> list[int]:
        """Indices of the section coordinates after an impact."""
        return [int(k) for k in self.system.section(impact)]

    @cached_property
    def lift_jacobian(self) -> Graph:
        """y at the start of the cycle -> its derivative in the section coordinates (always with dx)."""
        y, p, values = self._states(0).symbols()
        xi = y[self.section(Mode.SLIP_FORWARD)]
        slope = vertcat(self.system.lift_jacobian(xi, values), SX.zeros(1, xi.numel()))
        return Graph(Function("lift_jacobian", [y, p], [slope]), [self.p])

    @lru_cache(maxsize=64)  # noqa: B019 - as long as the equations
    def impact(self, mode: Mode, j: int) -> Graph:
        """y at the end of arc ``j`` -> margins of an impact, and the state after it."""
        (y, p, values), n_z = self._states(j).symbols(), self.system.n_z
        outputs = [self.system.impact_margins(mode)(y[:n_z], values), self.system.impact(mode)(y[:n_z], values)[0]]
        return Graph(Function(f"impact_{mode.key}", [y, p], cse(outputs)), [self.p])


def by_columns(entries: Sequence[Any], rows: int) -> Any:
    """The matrix of an output of a graph, whose columns come one after the other."""
    columns = len(entries) // rows
    return matrix(columns, [entries[i + rows * j] for i in range(rows) for j in range(columns)])


SQUARE = arb(0.5, 0.5)
"""s^2."""
ROUNDS, LITTLE = 50, 0.9
"""In which the derivative of the orbit in its start is narrowed at most, and by how much in a round at least."""


@dataclass(frozen=True, slots=True)
class Defect:
    """E = C F_u - 1 by groups of columns, and C by its first columns: a value, and a slope if a parameter varies."""

    C: np.ndarray
    slope: np.ndarray | None
    columns: dict[int, Any]

    def inverse(self, first: int, count: int) -> Any:
        """Some columns of C."""
        value = exact(self.C[:, first : first + count])
        return value if self.slope is None else Tilted(value, exact(self.slope[:, first : first + count]))

    def times(self, values: Any) -> Any:
        """E times some columns."""
        columns = hull(values).ncols()
        entries, total = scattered(values, arb_mat.entries), arb_mat(self.C.shape[0], columns)
        for first, block in self.columns.items():
            total += block * matrix(columns, entries[first * columns : (first + hull(block).ncols()) * columns])
        return total


def exact(values: np.ndarray) -> arb_mat:
    """Doubles as a matrix."""
    rows, columns = values.shape
    return arb_mat(rows, columns, values.ravel().tolist())


def column(values: Sequence[Any]) -> Any:
    """A vector as a matrix."""
    return matrix(1, values)


def middle(orbit: Orbit, passage: Passage, s: int = 0) -> np.ndarray:
    """dF/du next to the middle of its enclosure at some s, and dF/dmu as the last column; shape (n, n + 1)."""
    result = np.eye(orbit.size, orbit.size + 1)
    result[orbit.durations, orbit.durations] = 0.0
    for row, first, values in passage.blocks:
        block = np.array([[float(value.mid()) for value in entries] for entries in at(values, arb(s)).tolist()])
        result[row : row + block.shape[0], first : first + block.shape[1]] += block
    return result


def preconditioned(orbit: Orbit, passage: Passage) -> Defect:
    """E on a box.

    Raises
    ------
    NotProved
        If the derivative is singular.
    """
    F_u, slope = middle(orbit, passage)[:, :-1], None
    try:
        C = np.linalg.inv(F_u)
    except np.linalg.LinAlgError as failure:
        raise NotProved("the derivative of the equations of the orbit is singular") from failure
    if orbit.is_long:
        slope = -C @ (middle(orbit, passage, 1)[:, :-1] - F_u) @ C
    defect, unit = Defect(C, slope, {}), np.eye(orbit.size)
    for first in (entry for nodes in orbit.nodes for entry in nodes):
        defect.columns[first] = defect.inverse(first, orbit.n) - exact(unit[:, first : first + orbit.n])
    for first in orbit.durations:
        defect.columns[first] = -exact(unit[:, first : first + 1])
    for row, first, values in passage.blocks:
        if first < orbit.size:
            defect.columns[first] += defect.inverse(row, hull(values).nrows()) * values
    return defect


def krawczyk(orbit: Orbit, box: Box, line: Passage, defect: Defect) -> Box:
    """K as a box about the same centre, from the motions along ``centre + tilt s`` at least."""
    start = -defect.times(column(box.deviation))
    for row, values in line.residual.items():
        start -= defect.inverse(row, len(values)) * column(values)
    start = hull(start)
    if not orbit.is_long:
        return Box(box.centre, box.tilt, start.entries())
    drift, change = Tilted(arb_mat(orbit.size, 1), arb_mat(orbit.size, 1)), _change(orbit, box, line)
    for first, block in defect.columns.items():
        g = column(change[first : first + hull(block).ncols()])
        drift += defect.inverse(first, hull(g).nrows()) * (Tilted(g.value, g.slope / 2) if isinstance(g, Tilted) else g)
    tilt = [v - d for v, d in zip(box.tilt, drift.value.entries(), strict=True)]
    return Box(box.centre, tilt, (start - drift.slope * SQUARE).entries())


def _change(orbit: Orbit, box: Box, line: Passage) -> list[Any]:
    """dF/ds = F_u tilt + F_mu half."""
    change: list[Any] = [arb(0) if k in orbit.durations else v for k, v in enumerate(box.tilt)]
    tilt = [*box.tilt, orbit.interval[1]]
    for row, first, values in line.blocks:
        moved = values * column(tilt[first : first + hull(values).ncols()])
        for k, value in enumerate(scattered(moved, arb_mat.entries), start=row):
            change[k] = change[k] + value
    return change


def deviations(box: Box, image: Box) -> list[arb]:
    """The image of a box as deviations from the box's own centre and tilt."""
    return [(d - v) * UNIT + w for v, d, w in zip(box.tilt, image.tilt, image.deviation, strict=True)]


def require_contraction(orbit: Orbit, box: Box, image: Box) -> None:
    """Check that K lies in the interior of the box.

    Raises
    ------
    NotProved
        If it does not; the unknown that leaves farthest is named.
    """
    moved = deviations(box, image)
    pairs = list(zip(box.deviation, moved, strict=True))
    outside = [k for k, (w, inside) in enumerate(pairs) if not w.contains_interior(inside)]
    if outside:
        k = max(outside, key=lambda k: float(moved[k].abs_upper()) / max(float(box.deviation[k].rad()), 1e-300))
        shown = f"{moved[k].str(5)}, out of {box.deviation[k].str(3)}"
        raise NotProved(f"Krawczyk's operator moves {orbit.name(k)} by {shown}")


def return_map(orbit: Orbit, box: Box, passage: Passage, defect: Defect) -> Any:
    """Derivative DP of the return map on the section after the last impact, shape (n_xi, n_xi).

    A kick to the start of the cycle moves the orbit that stays periodic with it by H = (1 - DP)^-1. With Y = C kick,
    X = F_u^-1 kick is Y - E X, and as |E| w < w is proved, |X| <= w max(|Y| / w) / (1 - max(|E| w / w)).
    """
    section = orbit.section(orbit.sequence.impact)
    n_xi, w = len(section), [arb(value.rad()) for value in box.deviation]
    lift = scattered(by_columns(orbit.lift_jacobian(passage.starts[0])[0], orbit.n), arb_mat.entries)
    full = len(lift) // orbit.n
    Y = defect.inverse(0, orbit.n) * matrix(n_xi, [lift[k * full + i] for k in range(orbit.n) for i in range(n_xi)])
    contraction = _largest(hull(defect.times(column([arb(0, r) for r in w]))).entries(), w)
    if not contraction < 1:
        raise NotProved(f"the derivative of the return map cannot be enclosed: {contraction.str(5)} is not below 1")
    rows = hull(Y).tolist()
    sizes = [_largest([row[k] for row in rows], w) / (1 - contraction) for k in range(n_xi)]
    X: Any = arb_mat([[arb(0, (r * size).upper()) for size in sizes] for r in w])
    for _ in range(ROUNDS):
        before, X = X, Y - defect.times(X)
        if not _width(X) < LITTLE * _width(before):
            break
    entries = scattered(X, arb_mat.entries)
    H = matrix(n_xi, [entries[k * n_xi + i] for k in section for i in range(n_xi)])
    try:
        return exact(np.eye(n_xi)) - H.inv()
    except ZeroDivisionError as failure:
        raise NotProved("the derivative of the return map cannot be enclosed: a multiplier may be one") from failure


def _width(X: Any) -> float:
    return max(float(x.rad()) for x in hull(X).entries())


def _largest(values: Sequence[arb], w: Sequence[arb]) -> arb:
    """The largest of values relative to half widths."""
    return max(arb((value.abs_upper() / r).upper()) for value, r in zip(values, w, strict=True))
