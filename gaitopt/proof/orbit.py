"""The equations of a periodic orbit, Krawczyk's test for them, and the derivative of the return map.

    F(u) = (y_(k+1) - phi(y_k, f_k T),  event(y_end),  y_first - reset(y_end before)),      u = (nodes y_k, durations T)

The nodes y_k are the states between the steps of the integration and at both ends of every arc; phi is the flow, and a
step takes the fixed fraction f_k of the duration T of its arc. An event is a margin of the mode, or the time to a
breakpoint or to the end of a period of the control law. A reset is an impact, a foot that comes to rest, or the
identity. A zero of F is a periodic orbit. Every step starts from a node with its own box, so that no enclosure grows
along the motion.

The motion keeps the heights of contacts on the ground, the velocities of contacts that stick, and the gaps of locked
stops, c(y) = 0. At the start of the cycle the conditions c(y_first) = 0 of the section therefore replace those
equations y_first = reset(y_end before) that belong to the coordinates for which the section is solved. The replaced
equations follow: both states satisfy c and agree in the other coordinates, and the derivative of c in the solved ones
is regular (``require_section``).

Krawczyk's operator for deviations w from centre + tilt s, with an approximate inverse C of F_u, is

    K(s) = -C(s) F(centre + tilt s) + (1 - C(s) F_u(s)) w

If K lies in the interior of the box of w for every s in [-1, 1], F has exactly one zero in that box for every s, and
the zero lies in K. With dF/ds = g + g' s, F(centre + tilt s) = F(centre) + g s + g' s^2 / 2 by the mean value theorem.

References
----------
R. Krawczyk (1969), Newton-Algorithmen zur Bestimmung von Nullstellen mit Fehlerschranken, Computing 4, 187-201.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, reduce

import numpy as np
from casadi import SX, Function, cse, densify, jacobian, vertcat
from flint import acb, acb_mat, arb, arb_mat

from gaitopt.arrays import Array
from gaitopt.building import building
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN, Section, section_of
from gaitopt.model.system import HybridSystem
from gaitopt.proof.arithmetic import (
    UNIT,
    BallFunction,
    Matrix,
    NotProved,
    Number,
    Tilted,
    at,
    hull,
    matrix,
    matrix_entries,
    matrix_from_columns,
)
from gaitopt.proof.law import ExactLaw
from gaitopt.proof.taylor import PhaseSpace, TaylorStep, VectorField, expand, taylor_coefficients
from gaitopt.threads import cached_property

UNIT_SQUARED = arb(0.5, 0.5)
"""s^2 for s in [-1, 1]."""
SPLIT = [arb(2 * k + 1 - 16, 1) / 16 for k in range(16)]
"""16 subintervals of [-1, 1]; along a family the multipliers are enclosed on each of them."""
MOST_NARROWINGS, LARGEST_WIDTH_RATIO = 50, 0.9
"""The enclosure of F_u^-1 kick is narrowed at most this often, and only while its width shrinks to at most this
fraction of the last one."""


@dataclass(frozen=True, slots=True)
class OrbitArc:
    """A smooth arc of the orbit: one mode on one segment of the control law.

    Attributes
    ----------
    segment : number of the segment of the control law.
    phase : number of the phase in the mode sequence.
    event : the margin whose zero ends the arc; ``breakpoint``, or ``clock`` for the end of the law's period.
    zeros : the margins that are zero at the end of the arc: its event, and all forces of a massless foot that leaves.
    ends_phase : whether the phase ends with the arc; otherwise a breakpoint divides the phase.
    fractions : lengths of the integration steps relative to the duration, without that of the last step.
    """

    mode: Mode
    segment: int
    phase: int
    event: str
    zeros: tuple[str, ...]
    ends_phase: bool
    fractions: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class TiltedBox:
    """Unknowns u in centre + tilt s + deviation, where s in [-1, 1] runs along the interval of a parameter."""

    centre: Sequence[arb]
    tilt: Sequence[arb]
    deviation: Sequence[arb]

    @property
    def hull(self) -> list[arb]:
        """All u, for every s."""
        return self.at(UNIT)

    @property
    def tilted(self) -> list[Tilted]:
        """All u as functions of s."""
        return [Tilted(u + w, v) for u, v, w in zip(self.centre, self.tilt, self.deviation, strict=True)]

    def at(self, s: arb) -> list[arb]:
        """All u for the values in the ball ``s``."""
        return [u + s * v + w for u, v, w in zip(self.centre, self.tilt, self.deviation, strict=True)]


@dataclass(frozen=True, slots=True)
class CycleEnclosure:
    """An enclosure of one cycle from every point of a box.

    Attributes
    ----------
    residual : F at the centre, in groups of equations by their first row.
    blocks : dF/du on the box without the unit matrix of the nodes, as (first row, first column, values).
    steps : steps of the integration of every arc.
    starts, ends : boxes of the state y at the start and end of every arc.
    """

    residual: dict[int, list[arb]] = field(default_factory=dict)
    blocks: list[tuple[int, int, Matrix]] = field(default_factory=list)
    steps: list[list[TaylorStep]] = field(default_factory=list)
    starts: list[list[arb]] = field(default_factory=list)
    ends: list[list[arb]] = field(default_factory=list)


class Orbit:
    """The equations F(u) = 0 of the periodic orbits with one mode sequence.

    Parameters
    ----------
    law : breakpoints and segment data of the control law in balls.
    p : parameters in balls.
    varied : index of the varying parameter; None if none varies.
    interval : middle and half length of the interval of the varying parameter; empty if none varies.
    arcs : the arcs of one cycle, in order of time.
    order : order of the Taylor series.

    Attributes
    ----------
    n : number of unknowns of a node.
    nodes : first entry in u of every node, by arc.
    durations : entry in u of the duration of every arc.
    size : number of unknowns, and index of the column that holds the derivative in the parameter.
    """

    def __init__(
        self,
        system: HybridSystem,
        law: ExactLaw,
        p: Sequence[arb],
        varied: int | None,
        interval: Sequence[arb],
        sequence: Cycle,
        arcs: Sequence[OrbitArc],
        order: int,
    ) -> None:
        self.system, self.law, self.p = system, law, list(p)
        self.varied, self.interval = varied, tuple(interval)
        self.sequence, self.arcs, self.n = sequence, tuple(arcs), system.n_z + 1
        self.order = order
        spaces = [PhaseSpace(system, varied, step) for step in range(system.legs)]
        self._spaces = [sequence.per_phase(spaces)[arc.phase] for arc in arcs]
        self.nodes: list[list[int]] = []
        for arc in arcs:
            first = self.nodes[-1][-1] + self.n if self.nodes else 0
            self.nodes.append([first + self.n * k for k in range(len(arc.fractions) + 2)])
        first = self.nodes[-1][-1] + self.n
        self.durations = list(range(first, first + len(arcs)))
        self.size = first + len(arcs)
        self._fields: dict[tuple[Mode, int, PhaseSpace], VectorField] = {}

    def name(self, entry: int) -> str:
        """The name of an unknown, for messages."""
        if entry in self.durations:
            return f"the duration of arc {self.durations.index(entry) + 1}"
        names = (*self.system.state_names, "the time")
        j = next(j for j, nodes in enumerate(self.nodes) if entry < nodes[-1] + self.n)
        node, state = divmod(entry - self.nodes[j][0], self.n)
        return f"{names[state]} at node {node + 1} of arc {j + 1}"

    @cached_property
    def units(self) -> Array:
        """Natural unit of every entry of a state y, including the time. They only scale and need not be exact."""
        middle = np.array([float(value.mid()) for value in self.p])
        dynamics = Dynamics(self.system, middle)
        return np.append(dynamics.state_units, dynamics.scales.time)

    @property
    def unit_of_unknowns(self) -> Array:
        """Natural unit of every unknown, shape (size,)."""
        arcs = len(self.durations)
        return np.append(np.tile(self.units, (self.size - arcs) // self.n), np.full(arcs, self.units[-1]))

    @property
    def is_long(self) -> bool:
        """Whether a parameter varies by more than its rounding."""
        return bool(self.interval) and not self.interval[1].is_zero()

    def field(self, mode: Mode, j: int) -> VectorField:
        """The vector field of a mode with the leg and control law of arc ``j``."""
        key = (mode, self.arcs[j].segment, self._spaces[j])
        if key not in self._fields:
            data = self.law.data[self.arcs[j].segment]
            self._fields[key] = VectorField(self._spaces[j], mode, self.p, data, self.units.tolist())
        return self._fields[key]

    def arcs_of(self, step: int) -> list[int]:
        """Indices of the arcs of a step."""
        return [j for j, arc in enumerate(self.arcs) if self.sequence.step_of(arc.phase) == step]

    def phase_durations(self, durations: Sequence[arb]) -> tuple[arb, ...]:
        """Durations of the phases from those of the arcs."""
        pairs = list(zip(self.arcs, durations, strict=True))
        return tuple(sum((T for arc, T in pairs if arc.phase == k), arb(0)) for k in range(len(self.sequence.phases)))

    def centre_at_node(self, centre: Sequence[arb], entry: int) -> list[arb]:
        """The state y at the centre of the node that starts at ``entry``."""
        return [*centre[entry : entry + self.n], *self.interval[:1]]

    def state_at_node(self, u: Sequence[Number], entry: int) -> list[Number]:
        """The states y of the node that starts at ``entry``, from all unknowns ``u``."""
        return [*u[entry : entry + self.n], *([Tilted(*self.interval)] if self.is_long else self.interval[:1])]

    def enclose(self, box: TiltedBox) -> CycleEnclosure:
        """Enclose F at the centre of a box, and its derivative on the whole box.

        Raises
        ------
        NotProved
            If a step of the integration cannot be validated.
        """
        cycle, centre, u = CycleEnclosure(), box.centre, box.tilted if self.is_long else box.hull
        for j, (arc, duration, nodes) in enumerate(zip(self.arcs, self.durations, self.nodes, strict=True)):
            field, steps = self.field(arc.mode, j), list[TaylorStep]()
            fractions = [*map(arb, arc.fractions)]
            for start, end, fraction in zip(nodes, nodes[1:], [*fractions, 1 - sum(fractions, arb(0))], strict=False):
                step = expand(field, self.state_at_node(u, start), fraction * u[duration], self.order)
                # the motion from the centre stays in the box of the step, whose remainder therefore covers it too
                from_centre = taylor_coefficients(field, self.centre_at_node(centre, start), self.order)
                y_end = step.end_of(from_centre, fraction * centre[duration])[: self.n]
                cycle.residual[end] = [y - phi for y, phi in zip(centre[end:], y_end, strict=False)]
                self._add(cycle, end, start, -step.variation())
                # d phi / dT = F(phi) fraction
                rates = [-rate * fraction for rate in field.rate(step.end)[0][: self.n]]
                cycle.blocks.append((end, duration, matrix(1, rates)))
                steps.append(step)
            last, first = nodes[-1], self.nodes[(j + 1) % len(self.arcs)][0]
            event, after, *_ = self._event_and_reset(j)(self.centre_at_node(centre, last))
            _, _, event_gradient, reset_jacobian, *_ = self._event_and_reset(j)(self.state_at_node(u, last))
            cycle.residual[duration] = event
            cycle.residual[first] = [y - z for y, z in zip(centre[first : first + self.n], after, strict=True)]
            if first == self.nodes[0][0] and self.solved:
                conditions, _ = self.conditions(self.centre_at_node(centre, first))
                _, slopes = self.conditions(self.state_at_node(u, first))
                cycle.residual[first] = [a + b for a, b in zip(cycle.residual[first], conditions, strict=True)]
                self._add(cycle, first, first, matrix_from_columns(self.n, slopes))
            self._add(cycle, duration, last, matrix_from_columns(1, event_gradient))
            self._add(cycle, first, last, -matrix_from_columns(self.n, reset_jacobian))
            cycle.steps.append(steps)
            cycle.starts.append(list(map(hull, self.state_at_node(u, nodes[0]))))
            cycle.ends.append(list(map(hull, self.state_at_node(u, last))))
        return cycle

    def _add(self, cycle: CycleEnclosure, row: int, column: int, values: Matrix) -> None:
        """Add a derivative in the states y of a node: the columns of the node, and that of the varying parameter."""
        entries, n = matrix_entries(values), self.n + len(self.interval[:1])
        rows = [entries[k : k + n] for k in range(0, len(entries), n)][: self.n]
        cycle.blocks.append((row, column, matrix(self.n, [value for values in rows for value in values[: self.n]])))
        if self.interval:
            cycle.blocks.append((row, self.size, matrix(1, [values[-1] for values in rows])))

    @lru_cache(maxsize=256)  # noqa: B019 - as long as the equations
    def _event_and_reset(self, j: int) -> BallFunction:
        """y -> event of arc ``j``, state from which the next arc starts, derivatives of both, ``solved`` of the reset.

        The entries ``solved`` of the state at the start of the cycle are zero; ``conditions`` determines them.
        """
        arc, law = self.arcs[j], self.law
        time = law.period if arc.event == CLOCK else law.breakpoints[arc.segment] if arc.event == BREAKPOINT else None
        constants = [self.p, law.data[arc.segment], [arb(0) if time is None else time]]
        return BallFunction(self._event_and_reset_function(j), constants)

    @building
    def _event_and_reset_function(self, j: int) -> Function:
        """(y, p, r, breakpoint) -> the outputs of ``_event_and_reset``."""
        arc, following, space = self.arcs[j], (j + 1) % len(self.arcs), self._spaces[j]
        system, n_z, (y, p, values) = self.system, self.system.n_z, space.symbols()
        r, time = SX.sym("r", system.n_r), SX.sym("breakpoint")
        after, returned = y[: self.n], SX(0, 1)
        if arc.event in (BREAKPOINT, CLOCK):
            event = y[n_z] - time
        else:
            index = system.transitions.margin_names(arc.mode).index(arc.event)
            event = system.margins(arc.mode)(y[n_z], y[:n_z], values, r)[index]
        if arc.event == BREAKPOINT:
            after[n_z] = time
        elif arc.event == "slip_velocity":
            after[n_z - 1] = 0
        # the impact of a stop that locks in flight has no margins
        struck = system.transitions.struck(self.sequence, arc.phase) if arc.ends_phase else None
        if struck is not None:
            after[:n_z] = system.impact(struck, arc.mode, ends_step=self.ends_step(j))(y[:n_z], values)[0]
        if self.ends_step(j):
            after[n_z], after[system.n_shape] = 0, 0
        landing = self.landing_section(j)
        if landing is not None and landing.is_explicit:
            xi, x = after[landing.indices.tolist()], after[system.n_shape]
            full = vertcat(xi, SX.zeros(system.lift.size1_in(0) - xi.numel()))
            after[:n_z] = system.lift(full, self._spaces[following].parameters(y, p))
            after[system.n_shape] = x
        elif following == 0:
            returned = after[self.solved]
            after[self.solved] = 0
        outputs = cse([event, after, jacobian(event, y), jacobian(after, y), returned])
        return Function("event_and_reset", [y, p, r, time], outputs)

    def step(self, j: int) -> int:
        """Index of the step of arc ``j``."""
        return self.sequence.step_of(self.arcs[j].phase)

    def ends_step(self, j: int) -> bool:
        """Whether a step ends with arc ``j``."""
        return self.arcs[j].ends_phase and self.sequence.after(self.arcs[j].phase) is None

    def swaps(self, j: int) -> bool:
        """Whether the feet swap roles at the end of arc ``j``."""
        arc = self.arcs[j]
        row = self.system.transitions.ending(self.sequence, arc.phase) if arc.ends_phase else None
        return row is not None and row.reset is not None and row.reset.swaps

    def swing(self, j: int) -> list[int]:
        """Indices of the arcs from a swap of the feet to the next one, which ends arc ``j``."""
        indices = [j % len(self.arcs)]
        while not self.swaps(indices[0] - 1):
            indices.insert(0, (indices[0] - 1) % len(self.arcs))
        return indices

    def landing_section(self, j: int) -> Section | None:
        """The states just after the landing that ends arc ``j``, of a walker that then stands on this foot alone."""
        after = self.sequence.reset_after(self.arcs[j].phase)
        if after is None or not (self.swaps(j) and self.system.walker.stands_on_one()):
            return None
        return section_of(self.system.walker, self.arcs[j].mode, after, TOUCHDOWN)

    def struck(self, j: int) -> Mode | None:
        """The impact that ends arc ``j``, with the names that the contacts have before it; None without an impact."""
        arc = self.arcs[j]
        struck = self.system.transitions.struck(self.sequence, arc.phase) if arc.ends_phase else None
        return struck if struck is not None and self.system.transitions.of_impact(struck, arc.mode) else None

    @cached_property
    def section(self) -> Section:
        """The section of the cycle."""
        return self.system.section(self.sequence)

    @cached_property
    def solved(self) -> list[int]:
        """Entries of the state at the start of the cycle for which the section is solved; none if it is explicit."""
        return [*self.section.solved]

    @cached_property
    @building
    def conditions(self) -> BallFunction:
        """y at the start of the cycle -> c - y in the entries ``solved``, zero in the others, and its derivative."""
        y, p, values = self._spaces[0].symbols()
        c = SX.zeros(self.n)
        c[self.solved] = self.section.conditions(y[: self.system.n_z], self._of_walker(values)) - y[self.solved]
        return BallFunction(Function("conditions", [y, p], cse([c, jacobian(c, y)])), [self.p])

    def _of_walker(self, values: SX) -> SX:
        return values[: len(self.system.walker.model_fields)]

    def require_section(self, cycle: CycleEnclosure) -> None:
        """Require that the conditions determine the solved entries between the first state and the reset of the last.

        Raises
        ------
        NotProved
            If their derivative may be singular.
        """
        *_, returned = self._event_and_reset(len(self.arcs) - 1)(cycle.ends[-1])
        y = list(cycle.starts[0])
        for k, value in zip(self.solved, returned, strict=True):
            y[k] = y[k].union(value)
        slopes = matrix_from_columns(self.n, self.conditions(y)[1])
        square = [slopes[i, k] + int(i == k) for i in self.solved for k in self.solved]
        try:
            arb_mat(len(self.solved), len(self.solved), square).inv()
        except ZeroDivisionError as failure:
            raise NotProved("the derivative of the conditions of the section may be singular") from failure

    @cached_property
    @building
    def kick(self) -> BallFunction:
        """y at the start of the cycle -> derivative of the right-hand side in the section coordinates."""
        y, p, values = self._spaces[0].symbols()
        slope = SX.zeros(self.n, len(self.section.names))
        if self.section.is_explicit:
            xi = y[self.section.every_step.indices.tolist()]
            slope[: self.system.n_z, :] = self.system.lift_jacobian(xi, values)[:, : slope.shape[1]]
        else:
            for column, k in enumerate(self.section.indices.tolist()):
                slope[k, column] = 1
        return BallFunction(Function("kick", [y, p], [densify(slope)]), [self.p])

    @lru_cache(maxsize=64)  # noqa: B019 - as long as the equations
    @building
    def impact(self, struck: Mode, j: int) -> BallFunction:
        """y at the end of arc ``j`` -> margins of an impact, state after it, ``counts``, work of the push.

        Parameters
        ----------
        struck : mode just after the impact, with the names that the contacts have before it.
        """
        (y, p, values), system, before = self._spaces[j].symbols(), self.system, self.arcs[j].mode
        z = y[: system.n_z]
        _, _, counts = system.contact_points(z, values)
        margins = system.impact_margins(struck, before)(z, values)
        z_plus = system.impact(struck, before, ends_step=self.ends_step(j))(z, values)[0]
        outputs = [margins, z_plus, counts, system.push(before)(z, values)[1]]
        return BallFunction(Function(f"impact_{struck.key}", [y, p], cse(outputs)), [self.p])


@dataclass(frozen=True, slots=True)
class Preconditioner:
    """An approximate inverse C of F_u, and an enclosure of E = C F_u - 1.

    Attributes
    ----------
    C : the approximate inverse at s = 0, shape (size, size).
    slope : derivative of C in s, of the same shape; None if no parameter varies.
    E : the columns of E, in groups by their first column.
    """

    C: np.ndarray
    slope: np.ndarray | None
    E: dict[int, Matrix]

    def columns(self, first: int, count: int) -> Matrix:
        """Columns of C."""
        value = exact_matrix(self.C[:, first : first + count])
        return value if self.slope is None else Tilted(value, exact_matrix(self.slope[:, first : first + count]))

    def error_times(self, values: Matrix) -> Matrix:
        """E times a matrix."""
        count = hull(values).ncols()
        entries, total = matrix_entries(values), arb_mat(self.C.shape[0], count)
        for first, block in self.E.items():
            total += block * matrix(count, entries[first * count : (first + hull(block).ncols()) * count])
        return total


def exact_matrix(values: np.ndarray) -> arb_mat:
    """A matrix of doubles, without rounding."""
    rows, columns = values.shape
    return arb_mat(rows, columns, values.ravel().tolist())


def midpoint_jacobian(orbit: Orbit, cycle: CycleEnclosure, s: int = 0) -> np.ndarray:
    """The middle of dF/du at s in doubles, with dF/dmu as the last column; shape (size, size + 1)."""
    result = np.eye(orbit.size, orbit.size + 1)
    result[orbit.durations, orbit.durations] = 0.0
    for row, first, values in cycle.blocks:
        block = np.array([[float(value.mid()) for value in entries] for entries in at(values, arb(s)).tolist()])
        result[row : row + block.shape[0], first : first + block.shape[1]] += block
    return result


def precondition(orbit: Orbit, cycle: CycleEnclosure) -> Preconditioner:
    """Invert the middle of F_u in doubles, and enclose the error E on the box.

    Raises
    ------
    NotProved
        If the middle of F_u is singular.
    """
    F_u, slope = midpoint_jacobian(orbit, cycle)[:, :-1], None
    try:
        C = np.linalg.inv(F_u)
    except np.linalg.LinAlgError as failure:
        raise NotProved("the derivative of the equations of the orbit is singular") from failure
    if orbit.is_long:
        slope = -C @ (midpoint_jacobian(orbit, cycle, 1)[:, :-1] - F_u) @ C
    inverse, identity = Preconditioner(C, slope, {}), np.eye(orbit.size)
    for first in (entry for nodes in orbit.nodes for entry in nodes):
        inverse.E[first] = inverse.columns(first, orbit.n) - exact_matrix(identity[:, first : first + orbit.n])
    for first in orbit.durations:
        inverse.E[first] = -exact_matrix(identity[:, first : first + 1])
    for row, first, values in cycle.blocks:
        if first < orbit.size:
            inverse.E[first] += inverse.columns(row, hull(values).nrows()) * values
    return inverse


def krawczyk(orbit: Orbit, box: TiltedBox, line: CycleEnclosure, inverse: Preconditioner) -> TiltedBox:
    """The image K of a box, as a box with the same centre.

    Parameters
    ----------
    line : enclosure of F and its derivative on the line centre + tilt s, or on the whole box.
    inverse : the preconditioner, with E enclosed on the whole box.
    """
    image = -inverse.error_times(matrix(1, box.deviation))
    for row, values in line.residual.items():
        image -= inverse.columns(row, len(values)) * matrix(1, values)
    image = hull(image)
    if not orbit.is_long:
        return TiltedBox(box.centre, box.tilt, image.entries())
    change: list[Number] = [arb(0) if k in orbit.durations else v for k, v in enumerate(box.tilt)]  # dF/ds
    du_ds = [*box.tilt, orbit.interval[1]]
    for row, first, values in line.blocks:
        product = values * matrix(1, du_ds[first : first + hull(values).ncols()])
        for k, value in enumerate(matrix_entries(product), start=row):
            change[k] = change[k] + value
    drift = Tilted(arb_mat(orbit.size, 1), arb_mat(orbit.size, 1))
    for first, block in inverse.E.items():
        g = matrix(1, change[first : first + hull(block).ncols()])
        g = Tilted(g.value, g.slope / 2) if isinstance(g, Tilted) else g
        drift += inverse.columns(first, hull(g).nrows()) * g
    tilt = [v - d for v, d in zip(box.tilt, drift.value.entries(), strict=True)]
    return TiltedBox(box.centre, tilt, (image - drift.slope * UNIT_SQUARED).entries())


def deviations(box: TiltedBox, image: TiltedBox) -> list[arb]:
    """The deviations of ``image`` from the centre and tilt of ``box``."""
    return [(d - v) * UNIT + w for v, d, w in zip(box.tilt, image.tilt, image.deviation, strict=True)]


def require_contraction(orbit: Orbit, box: TiltedBox, image: TiltedBox) -> None:
    """Require that the image K of a box lies in its interior.

    Raises
    ------
    NotProved
        If K leaves the interior; the message names the unknown that moves farthest out of the box.
    """
    moves = deviations(box, image)
    outside = [k for k, (w, move) in enumerate(zip(box.deviation, moves, strict=True)) if not w.contains_interior(move)]
    if outside:
        k = max(outside, key=lambda k: float(moves[k].abs_upper()) / max(float(box.deviation[k].rad()), 1e-300))
        bounds = f"{moves[k].str(5)}, out of {box.deviation[k].str(3)}"
        raise NotProved(f"Krawczyk's operator moves {orbit.name(k)} by {bounds}")


def return_map(orbit: Orbit, box: TiltedBox, cycle: CycleEnclosure, inverse: Preconditioner) -> Matrix:
    """Derivative DP of the return map on the section after the last impact, in natural units, shape (n_xi, n_xi).

    A kick added to the section coordinates at the start of the cycle moves the periodic orbit by H = (1 - DP)^-1 there,
    and all unknowns by X = F_u^-1 kick. With Y = C kick, X = Y - E X. As |E| w < w is proved for the half widths w,
    |X| <= w max(|Y| / w) / (1 - max(|E| w / w)). Iterating X = Y - E X narrows this bound.

    Raises
    ------
    NotProved
        If the bounds are too wide.
    """
    section = orbit.section.indices.tolist()
    n_xi, w = len(section), [arb(value.rad()) for value in box.deviation]
    Y = inverse.columns(0, orbit.n) * matrix_from_columns(orbit.n, orbit.kick(cycle.starts[0])[0])
    contraction = _weighted_norm(hull(inverse.error_times(matrix(1, [arb(0, r) for r in w]))).entries(), w)
    if not contraction < 1:
        raise NotProved(f"the derivative of the return map cannot be enclosed: {contraction.str(5)} is not below 1")
    rows = hull(Y).tolist()
    sizes = [_weighted_norm([row[k] for row in rows], w) / (1 - contraction) for k in range(n_xi)]
    X: Matrix = arb_mat([[arb(0, (r * size).upper()) for size in sizes] for r in w])
    for _ in range(MOST_NARROWINGS):
        width = _width(X)
        X = Y - inverse.error_times(X)
        if not _width(X) < LARGEST_WIDTH_RATIO * width:
            break
    entries = matrix_entries(X)
    H = matrix(n_xi, [entries[k * n_xi + i] for k in section for i in range(n_xi)])
    try:
        DP = exact_matrix(np.eye(n_xi)) - H.inv()
    except ZeroDivisionError as failure:
        raise NotProved("the derivative of the return map cannot be enclosed: a multiplier may be one") from failure
    scales = np.exp2(np.round(np.log2(orbit.units[section])))  # powers of two have exact inverses
    return exact_matrix(np.diag(1 / scales)) * DP * exact_matrix(np.diag(scales))


def _width(X: Matrix) -> float:
    return max(float(x.rad()) for x in hull(X).entries())


def _weighted_norm(values: Sequence[arb], w: Sequence[arb]) -> arb:
    """An upper bound of max(|value| / w)."""
    return max(arb((value.abs_upper() / r).upper()) for value, r in zip(values, w, strict=True))


def multipliers(derivatives: Sequence[arb_mat]) -> tuple[acb, ...]:
    """Eigenvalues of DP over all subintervals of a box, largest modulus first.

    Raises
    ------
    NotProved
        If the bounds of DP are too wide.
    """
    sorted_eigenvalues = (
        sorted(eigenvalues(matrix), key=lambda m: (-float(m.abs_upper()), -float(m.real), -float(m.imag)))
        for matrix in derivatives
    )
    return union_of_multipliers(sorted_eigenvalues)


def union_of_multipliers(multipliers: Iterable[Sequence[acb]]) -> tuple[acb, ...]:
    """Bounds of every multiplier over all boxes."""
    return tuple(map(complex_union, zip(*multipliers, strict=True)))


def complex_union(values: Iterable[acb]) -> acb:
    """A complex box around complex boxes."""
    boxes = list(values)
    return acb(reduce(arb.union, (box.real for box in boxes)), reduce(arb.union, (box.imag for box in boxes)))


def eigenvalues(matrix: arb_mat) -> list[acb]:
    """Enclosed eigenvalues: Gershgorin's discs in the basis of approximate eigenvectors.

    Overlapping discs are merged, and the union stands for each of them.

    Raises
    ------
    NotProved
        If the approximate eigenvectors are not independent.
    """
    n = matrix.nrows()
    try:
        _, vectors = np.linalg.eig(np.array([[float(value.mid()) for value in row] for row in matrix.tolist()]))
        V = acb_mat([[acb(complex(value)) for value in row] for row in vectors])
        A = V.inv() * acb_mat(matrix) * V
    except (ZeroDivisionError, np.linalg.LinAlgError) as failure:
        raise NotProved("the multipliers cannot be enclosed: the eigenvectors are not independent") from failure
    radii = [arb(0, sum((abs(A[i, j]) for j in range(n) if j != i), arb(0)).upper()) for i in range(n)]
    discs = [A[i, i] + acb(radius, radius) for i, radius in enumerate(radii)]
    for _ in range(n):
        discs = [complex_union(other for other in discs if other.overlaps(disc)) for disc in discs]
    return discs
