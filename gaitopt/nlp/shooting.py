"""Natural units (``mechanics.scales``) of the unknowns and equations of a transcription, and what its margins say.

The seam between the equations of a periodic gait and what solves, refines and examines them.

One shooting interval: an explicit Runge-Kutta step of order 8, written out in symbols.

    k_i = f(t + c_i h, z + h sum_j a_ij k_j),        z_next = z + h sum_i b_i k_i

The tableau is that of Dormand and Prince (DOP853, 12 stages, 3 more for states inside the step).
The flow has no repeated subexpressions; looking for more among its stages takes longer than it saves.

What joins the arcs of a cycle: the event that ends every phase, the resets of impacts, periodicity.

    events       v_t = 0 where a slip ends, mu f_n +- f_t = 0 where a stick ends, guard = 0 at touchdown
    resets       z_start = impact(z_end)    at every impact; of a foot, with x counted from the new stance foot

A slip that starts at rest is also at rest after no time at all; its event is divided by that zero, which leaves the
real end and keeps the equations regular where the slip comes into being. None of this depends on the intervals.

The steps of all shooting intervals as numbers: what they begin with, where they lead, how far the nodes are off.

The inequalities of a transcription: margins at every node, at the onset of slip, at take-off, and of the impacts.

Jacobian of the equalities, the steps differentiated stage by stage.

    K_i = f(t + c_i h, z_i),     z_i = z + h sum_j a_ij K_j
    dK_i = f_z dz_i + f_t dt_i + f_p dp,     dz_i = dz + h sum_j a_ij dK_j + dh sum_j a_ij K_j

f and its derivatives at all stages are one compiled function; what follows is linear algebra on all intervals at once.
Some five times as fast as differentiating the step in symbols.

Multiple shooting of one periodic cycle of steps with fixed mode sequences.

Unknowns w = (nodes z_0 .. z_K, phase durations, freed parameters). Equalities, as many as nodes and durations:

    defects      z_{k+1} = step(z_k)    on every interval; in stick with v_t = 0
    conditions   events, resets and periodicity, see ``conditions``

As expressions of CasADi they serve IPOPT; as numbers they are evaluated by functions of one step and of one cycle,
which every layout shares.

Friction complementarity: the mode sets one factor of each pair to zero (the force's factor in slip is eliminated
by eq. (5)); the other factor stays an inequality at every node, except where an event already makes it zero.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple, Protocol, Self

import numpy as np
from casadi import MX, SX, Function, cse, densify, horzcat, jacobian, repmat, sum1, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.gait.curves import points
from gaitopt.integration import A_INSIDE, C_INSIDE, N_STAGES, A, B, C, D, combined
from gaitopt.model.buffered import BufferedFunction, BufferedMap, buffered, buffered_map
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.margins import ending_margin, margin, margin_names, margin_unit
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.units import Scales
from gaitopt.nlp.layout import ArcLayout, Layout
from gaitopt.nlp.sparse import Pattern, SparseMatrix


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """What one row of the inequalities says: the margin's name, and the phase and node where it is taken.

    ``phase`` and ``node`` are None for an impact, ``step`` is the index of its step.
    """

    name: str
    phase: int | None = None
    node: int | None = None
    step: int = 0

    def unit(self, scales: Scales) -> float:
        """Natural unit of the row."""
        return margin_unit(self.name, scales)


@dataclass(frozen=True, slots=True, kw_only=True)
class Units:
    """Natural units (``mechanics.scales``) in which unknowns and equations are of order one.

    Attributes
    ----------
    unknowns : ndarray, shape (n_w,) - of nodes and durations; freed parameters have one.
    equalities : ndarray - of the rows of ``Transcription.equalities``.
    """

    unknowns: Array
    equalities: Array


class Unknowns(NamedTuple):
    """The parts of a vector w: nodes (n_z, K + 1), durations (n_phases,) and freed parameters."""

    nodes: Array
    durations: Array
    freed: Array


class Transcription(Protocol):
    """A gait as square equations and margins of unknowns w, with parameters p; see ``MultipleShooting``."""

    system: HybridSystem
    layout: Layout
    free: tuple[str, ...]
    n_nodes: int
    n_phases: int
    w: MX
    parameters: MX

    @property
    def equalities(self) -> MX:
        """What is zero at a gait, in terms of ``w`` and ``parameters``; shape (n,)."""

    @property
    def inequalities(self) -> tuple[MX, tuple[Label, ...]]:
        """Margins that must not be negative, and what each one says."""

    def on(self, layout: Layout) -> Self:
        """The same equations on another layout."""

    def pack(self, nodes: Array, durations: Array, freed: Array | tuple[float, ...] = ()) -> Array:
        """The vector w from nodes (n_z, K + 1), durations (n_phases,) and freed parameters."""

    def unpack(self, w: Array) -> Unknowns:
        """What a vector w consists of."""

    def dynamics(self, p: Array, freed: Array, phase: int = 0) -> Dynamics:
        """The system at its parameters with the freed ones put in, in the step of a phase."""

    def units(self, p: Array) -> Units:
        """Natural units of unknowns and equalities."""

    def margin_units(self, p: Array) -> Array:
        """Natural units of the inequalities."""

    def violation(self, w: Array, p: Array) -> Array:
        """Values of the equalities."""

    def linearised(self, w: Array, p: Array) -> tuple[Array, SparseMatrix]:
        """Values of the equalities, and their derivative in all unknowns; shape (n, n + n_free)."""

    def margin_values(self, w: Array, p: Array) -> Array:
        """Values of the inequalities."""

    def halved_defects(self, w: Array, p: Array) -> Array:
        """By how much a finer integration would change the equalities."""

    def node_times(self, w: Array) -> Array:
        """Time since impact of every node; shape (K + 1,) [s]."""

    def sample(self, w: Array, p: Array, index: int, count: int) -> tuple[Array, Array]:
        """Times (count,) and states (count, n_z) at the Chebyshev points of one arc."""

    def states_at(self, w: Array, p: Array, index: int, fractions: Array) -> Array:
        """States (m, n_z) at fractions of one arc."""


ORDER = 8
LOBATTO_POINTS = (1 + np.array([-1.0, -np.sqrt(3 / 7), 0.0, np.sqrt(3 / 7), 1.0])) / 2
LOBATTO_WEIGHTS = np.array([9, 49, 64, 49, 9]) / 180
"""Quadrature on [0, 1] with both ends and positive weights, of the same order as the steps."""


@lru_cache(maxsize=64)
def shooting_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + h.

    In stick the slip velocity is the factor that the mode sets to zero: it is zero at every node, not integrated.
    """
    z, t, h, p, r = _symbols(system)
    z_next = _end(mode, z, h, _stages(system, mode, z, t, h, p, r))
    return Function(f"step_{mode.key}", [z, t, h, p, r], [z_next])


@lru_cache(maxsize=64)
def sampled_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + c h for the Lobatto points c; shape (n_z, n_points).

    Inside the step by the continuous extension of order 7: y = z + s (F_0 + (1 - s) (F_1 + s (F_2 + ...))).
    """
    z, t, h, p, r = _symbols(system)
    stages = _stages(system, mode, z, t, h, p, r)
    z_next = _end(mode, z, h, stages)
    stages.append(system.flow(mode)(t + h, z_next, p, r))
    for a, c in zip(A_INSIDE, C_INSIDE, strict=True):
        stages.append(system.flow(mode)(t + c * h, z + h * combined(a, stages), p, r))
    first, last, move = stages[0], stages[N_STAGES], z_next - z
    series = [move, h * first - move, 2 * move - h * (last + first), *(h * combined(d, stages) for d in D)]
    samples = [z, *(z + _extension(series, float(c)) for c in LOBATTO_POINTS[1:-1]), z_next]
    return Function(f"sampled_step_{mode.key}", [z, t, h, p, r], [horzcat(*samples)])


def integrate_to(system: HybridSystem, mode: Mode, z: Array, times: Array, p: Array, r: Array) -> Array:
    """States (n, n_z) at ascending times (n,) from ``z`` at the first, one shooting step between each two."""
    step = shooting_step(system, mode)
    states = [z]
    for start, end in pairwise(times):
        states.append(np.asarray(step(states[-1], start, end - start, p, r)).ravel())
    return np.array(states)


def _symbols(system: HybridSystem) -> tuple[SX, SX, SX, SX, SX]:
    z, t, h = SX.sym("z", system.n_z), SX.sym("t"), SX.sym("h")
    return z, t, h, SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)


def _stages(system: HybridSystem, mode: Mode, z: SX, t: SX, h: SX, p: SX, r: SX) -> list[SX]:
    flow, stages = system.flow(mode), list[SX]()
    for a, c in zip(A, C, strict=True):
        stages.append(flow(t + c * h, z + h * combined(a, stages), p, r))
    return stages


def _end(mode: Mode, z: SX, h: SX, stages: list[SX]) -> SX:
    z_next = z + h * combined(B, stages)
    return vertcat(z_next[:-1], 0) if mode.sticks else z_next


def _extension(series: list[SX], s: float) -> SX:
    """F_0 s + F_1 s (1 - s) + F_2 s^2 (1 - s) + ..., from the innermost bracket outwards."""
    value = SX(0)
    for k in reversed(range(len(series))):
        value = (value + series[k]) * (s if k % 2 == 0 else 1 - s)
    return value


@lru_cache(maxsize=64)
def conditions(system: HybridSystem, cycle: Cycle, segments: tuple[int, ...], free: tuple[str, ...]) -> Function:
    """(ends, starts, durations, freed, p) -> events of all phases, then resets; shape (n_phases + n_z n_resets,).

    Parameters
    ----------
    segments : of the control, at the end of every phase.
    free : dotted keys of the parameters that are unknowns; their values in ``p`` are ignored.

    Returns
    -------
    function : of the states at the end of every phase, shape (n_z, n_phases), and after every reset, (n_z, n_resets).
    """
    ends, starts = SX.sym("ends", system.n_z, len(cycle.phases)), SX.sym("starts", system.n_z, len(cycle.resets))
    durations, freed = SX.sym("durations", len(cycle.phases)), SX.sym("freed", len(free))
    p = SX.sym("p", len(system.parameters))
    full = vertcat(*(freed[free.index(key)] if key in free else p[k] for k, key in enumerate(system.parameters)))
    standing = [system.walker.standing(full, system.walker.side(step)) for step in range(len(cycle.steps))]
    rows = []
    for phase, (mode, name, order) in enumerate(endings(system, cycle)):
        step = cycle.step_of(phase)
        time = sum1(durations[cycle.first_phases[step] : phase + 1])
        margins = system.margins(mode)(time, ends[:, phase], standing[step], system.data(segments[phase]))
        rows.append(margins[margin_names(mode).index(name)] / durations[phase] ** order)
    for k, (phase, impact) in enumerate(cycle.resets):
        z_plus = system.impact(impact)(z=ends[:, phase], p=standing[cycle.step_of(phase)])["z_plus"]
        if not impact.locked:  # counted from the new stance foot
            z_plus[system.n_shape] = 0
        rows.append(starts[:, k] - z_plus)
    return Function("conditions", [ends, starts, durations, freed, p], [densify(vertcat(*rows))])


@lru_cache(maxsize=64)
def differentiated(system: HybridSystem, cycle: Cycle, segments: tuple[int, ...], free: tuple[str, ...]) -> Function:
    """The same with a second output: the sparse Jacobian by (ends, starts, durations, freed), in columns."""
    function = conditions(system, cycle, segments, free)
    inputs = function.sx_in()
    (values,) = function.call(inputs)
    return Function("differentiated", inputs, [values, jacobian(values, vertcat(*map(vec, inputs[:-1])))])


def endings(system: HybridSystem, cycle: Cycle) -> Iterator[tuple[Mode, str, int]]:
    """Mode of every phase, the margin that ends it, and the order of the zero that this margin starts from."""
    jump = system.friction.two_coefficients
    for phase, mode in enumerate(cycle.phases):
        name = ending_margin(mode, cycle.after(phase))
        yield mode, name, cycle.onset_order(phase, jump=jump) if name == "slip_velocity" else 0


class Intervals(NamedTuple):
    """What the steps of one arc begin with, as arguments of ``shooting_step``.

    Attributes
    ----------
    nodes : ndarray, shape (m, n_z).
    times : ndarray, shape (m, 1) - at which they start [s].
    length : of each [s].
    p, data : all parameters, as the leg stands, and the segment data of the control.
    """

    nodes: Array
    times: Array
    length: float
    p: Array
    data: Array


def intervals(t: "MultipleShooting", w: Array, p: Array) -> Iterator[Intervals]:
    """Those of every arc at unknowns ``w`` and parameters ``p``."""
    nodes, durations, freed = t.unpack(w)
    layout = t.layout
    for arc, first, (start, end) in zip(layout.arcs, layout.first_nodes, layout.arc_times(durations), strict=True):
        length = (end - start) / arc.intervals
        times = start + length * np.arange(arc.intervals, dtype=float)[:, None]
        own = t.values(p, freed, arc.phase)
        yield Intervals(nodes.T[first : first + arc.intervals], times, length, own, t.system.data(arc.segment))


def stepped(t: "MultipleShooting", w: Array, p: Array, parts: int) -> Array:
    """Where the steps lead, each in some equal parts; shape (intervals, n_z)."""
    ends = []
    for step, (state, times, length, own, data) in zip(t.steps, intervals(t, w, p), strict=True):
        for k in range(parts):
            (state,) = step(state, times + k * length / parts, length / parts, own, data)
        ends.append(state.copy())
    return np.concatenate(ends)


def defects(t: "MultipleShooting", w: Array, ends: Array) -> Array:
    """By how much the nodes differ from the states (intervals, n_z) that the steps lead to; shape (n_z intervals,)."""
    return np.asarray((t.unpack(w).nodes.T[t.layout.end_nodes] - ends).ravel())


def joints(t: "MultipleShooting", w: Array) -> tuple[Array, Array, Array, Array]:
    """What ``conditions`` takes: states at the ends of phases and after resets, durations and freed parameters."""
    nodes, durations, freed = t.unpack(w)
    ends, starts = (nodes.T[at].ravel() for at in t.layout.joints)
    return ends, starts, durations, freed


GROUND_FORCES = ("normal_force", "cone_forward", "cone_backward")
"""Margins that are zero where the spring of a massless leg has its full length: at landing and take-off."""


def inequalities(t: "MultipleShooting") -> Iterator[tuple[MX, list[Label]]]:
    """Blocks of margins that must not be negative, and what every row says."""
    yield from _node_margins(t)
    for row, label in (*_unloaded_margins(t), *_onset_margins(t), *impact_margins(t)):
        yield row, [label]


def _node_margins(t: "MultipleShooting") -> Iterator[tuple[MX, list[Label]]]:
    """Inequality factors of every arc at its nodes, without those that an event makes zero."""

    def columns(i: int) -> list[MX]:
        arc, Z, start, h = t.arc(i)
        times = start + h * MX(np.arange(arc.intervals + 1)).T
        return [times, Z, *t.constants(arc, arc.intervals + 1)]

    for i, margins in enumerate(t.map_arcs(t.system.margins, columns)):
        arc, first, names = t.layout.arcs[i], t.layout.first_nodes[i], margin_names(t.layout.arcs[i].mode)
        places = [
            (row, k, name)
            for row, name in enumerate(names)
            for k in range(arc.intervals + 1)
            if name != "upright" and not margin(name).rises and not is_zero_by_event(t, i, k, name)
        ]
        rows = vec(margins)[[row + k * len(names) for row, k, _ in places]]
        yield rows, [Label(name=name, phase=arc.phase, node=first + k) for _, k, name in places]


def _unloaded_margins(t: "MultipleShooting") -> Iterator[tuple[MX, Label]]:
    """Rates of the ground's forces where a massless leg lands and takes off; the forces are zero there."""
    for i, (arc, first) in enumerate(zip(t.layout.arcs, t.layout.first_nodes, strict=True)):
        for k, sign in ((0, 1), (arc.intervals, -1)):
            if not _unloaded(t, i, k):
                continue
            _, Z, start, h = t.arc(i)
            data = t.system.data(arc.segment)
            _, rates = t.system.events(arc.mode)(start + k * h, Z[:, k], t.p, data)
            for name in GROUND_FORCES:
                rate = rates[margin_names(arc.mode).index(name)]
                yield sign * rate, Label(name=name, phase=arc.phase, node=first + k)


def _unloaded(t: "MultipleShooting", index: int, k: int) -> bool:
    """Whether node ``k`` of an arc is the landing or the take-off of a massless leg."""
    arc, cycle = t.layout.arcs[index], t.layout.cycle
    if not t.system.walker.massless_feet or arc.mode.flies:
        return False
    after = cycle.after(arc.phase)
    lands = k == 0 and arc.start is None and arc.phase in cycle.first_phases
    return lands or (k == arc.intervals and arc.end is None and after is not None and after.flies)


def is_zero_by_event(t: "MultipleShooting", index: int, k: int, name: str) -> bool:
    """Whether an event makes a margin zero at node ``k`` of an arc."""
    arc, cycle = t.layout.arcs[index], t.layout.cycle
    if k == 0 and arc.start is None and name == "slip_velocity":
        return cycle.onset_order(arc.phase) > 0
    if name in GROUND_FORCES and _unloaded(t, index, k):
        return True
    after = cycle.after(arc.phase)
    return k == arc.intervals and arc.end is None and after is not None and name == ending_margin(arc.mode, after)


def _onset_margins(t: "MultipleShooting") -> Iterator[tuple[MX, Label]]:
    """Force beyond the static cone where a slip starts from rest; one coefficient leaves no doubt about it."""
    if not t.system.friction.two_coefficients:
        return
    for i, (arc, first) in enumerate(zip(t.layout.arcs, t.layout.first_nodes, strict=True)):
        if arc.start is None and t.layout.cycle.starts_from_rest(arc.phase):
            _, Z, start, _ = t.arc(i)
            data = t.system.data(arc.segment)
            margins = t.system.margins(Mode.STICK)(start, Z[:, 0], t.standing(arc.phase), data)
            cone = margins[margin_names(Mode.STICK).index(ending_margin(Mode.STICK, arc.mode))]
            yield -cone, Label(name="onset", phase=arc.phase, node=first)


def impact_margins(t: "MultipleShooting") -> Iterator[tuple[MX, Label]]:
    """Margins of the impacts."""
    for (phase, mode), node in zip(t.layout.cycle.resets, t.layout.reset_nodes, strict=True):
        values = t.system.impact_margins(mode)(t.Z[:, node], t.standing(phase))
        place = {"phase": phase, "node": node} if mode.locked else {"step": t.layout.cycle.step_of(phase)}
        for row, name in enumerate(t.system.impact_margin_names(mode)):
            yield values[row], Label(name=name, **place)


@lru_cache(maxsize=64)
def stage_derivatives(system: HybridSystem, mode: Mode, free: tuple[str, ...]) -> Function:
    """(z, t, h, p, r) -> for every stage f and its derivatives by z, t and the freed parameters, in columns."""
    n_z = system.n_z
    z, t, h = SX.sym("z", n_z), SX.sym("t"), SX.sym("h")
    p, r = SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)
    by = vertcat(z, t, *(p[system.parameters.index(name)] for name in free))
    f = system.flow(mode)(t, z, p, r)
    both = Function("flow_and_derivatives", [z, t, p, r], cse([f, jacobian(f, by)]))
    stages: list[SX] = []
    columns: list[SX] = []
    for a, c in zip(A, C, strict=True):
        at = z + h * combined(a, stages)
        rate, derivative = both(at, t + float(c) * h, p, r)
        stages.append(rate)
        columns += [rate, derivative]
    return Function(f"stage_derivatives_{mode.key}", [z, t, h, p, r], [densify(horzcat(*columns))])


class ShootingJacobian:
    """Sparse Jacobian of a transcription's equalities.

    Parameters
    ----------
    transcription : whose rows and columns they are.
    """

    def __init__(self, transcription: "MultipleShooting") -> None:
        self._t = transcription
        self._n_z, self._n = transcription.system.n_z, transcription.layout.intervals
        ends = np.cumsum([arc.intervals for arc in transcription.layout.arcs])
        self._intervals = [
            slice(int(end) - a.intervals, int(end)) for end, a in zip(ends, transcription.layout.arcs, strict=True)
        ]
        self._by_duration()

    def linearised(self, w: Array, p: Array) -> tuple[Array, SparseMatrix]:
        """Values of the equalities, and d equalities / d w."""
        ends, *steps = self._steps(w, p)
        last, by_joints = self._joints(*joints(self._t, w), p)
        data = np.concatenate([np.ones(self._n * self._n_z), *steps, by_joints])
        residual = np.concatenate([defects(self._t, w, ends), last])
        return residual, SparseMatrix(pattern=self._pattern, data=data[self._order])

    @cached_property
    def _joints(self) -> BufferedFunction:
        """Events, resets and periodicity with the entries of their Jacobian."""
        return BufferedFunction(differentiated(*self._t.joined), nonzeros=True)

    def _by_duration(self) -> None:
        """Derivatives of start and length of every interval by the durations; both are linear in them."""
        t = self._t
        times, lengths = (np.zeros((self._n, t.n_phases)) for _ in range(2))
        zero = np.array(t.layout.arc_times(np.zeros(t.n_phases)))
        for phase in range(t.n_phases):
            spans = np.array(t.layout.arc_times(np.eye(t.n_phases)[phase])) - zero
            for arc, at, (start, end) in zip(t.layout.arcs, self._intervals, spans, strict=True):
                lengths[at, phase] = (end - start) / arc.intervals
                times[at, phase] = start + np.arange(arc.intervals) * (end - start) / arc.intervals
        self._times, self._lengths = times, lengths
        self._index()

    def _index(self) -> None:
        """Where the entries go, in the order in which ``jacobian`` makes them."""
        n_z, n, t = self._n_z, self._n, self._t
        n_w, n_tail = t.w.numel(), t.n_phases + len(t.free)
        row = np.arange(n * n_z)
        block = row.reshape(n, n_z, 1)
        starts = n_z * t.layout.start_nodes
        after = (n_z * t.layout.end_nodes[:, None] + np.arange(n_z)).ravel()
        own = (
            np.broadcast_to(block, (n, n_z, n_z)),
            np.broadcast_to(starts[:, None, None] + np.arange(n_z), (n, n_z, n_z)),
        )
        rest = (
            np.broadcast_to(block, (n, n_z, n_tail)),
            np.broadcast_to(n_w - n_tail + np.arange(n_tail), (n, n_z, n_tail)),
        )
        sparsity = differentiated(*t.joined).sparsity_out(1)
        at_nodes = n_z * np.concatenate(t.layout.joints)[:, None] + np.arange(n_z)
        joint_columns = np.concatenate([at_nodes.ravel(), np.arange(n_w - n_tail, n_w)])
        rows = np.concatenate([row, own[0].ravel(), rest[0].ravel(), n * n_z + np.array(sparsity.row(), dtype=int)])
        columns = np.concatenate([after, own[1].ravel(), rest[1].ravel(), joint_columns[sparsity.get_col()]])
        self._order = np.lexsort((rows, columns))
        pointers = np.searchsorted(columns[self._order], np.arange(n_w + 1))
        self._pattern = Pattern(shape=(n * n_z + sparsity.size1(), n_w), pointers=pointers, rows=rows[self._order])

    @cached_property
    def _stages(self) -> list[BufferedMap]:
        """Those of every arc."""
        t = self._t
        return [
            buffered_map(stage_derivatives(t.system, arc.mode, t.standing_names(arc.phase)), arc.intervals)
            for arc in t.layout.arcs
        ]

    def _steps(self, w: Array, p: Array) -> tuple[Array, Array, Array]:
        """Ends of all steps, and minus their derivatives by their own nodes, and by durations and freed parameters."""
        t, n_z = self._t, self._n_z
        stages = np.empty((N_STAGES, self._n, n_z, n_z + 2 + len(t.free)))
        starts, lengths = np.empty((self._n, n_z)), np.empty(self._n)
        for at, values, (nodes, times, length, own, data) in zip(
            self._intervals, self._stages, intervals(t, w, p), strict=True
        ):
            starts[at], lengths[at] = nodes, length
            stages[:, at] = _by_stage(values(nodes, times, length, own, data)[0], n_z)
        ends, step = _varied(starts, stages, lengths)
        for arc, at in zip(t.layout.arcs, self._intervals, strict=True):
            if arc.mode.sticks:
                ends[at, -1], step[at, -1] = 0.0, 0.0
        step = -step
        by_durations = (
            step[:, :, n_z, None] * self._times[:, None, :] + step[:, :, n_z + 1, None] * self._lengths[:, None, :]
        )
        by_rest = np.concatenate([by_durations, step[:, :, n_z + 2 :]], axis=2)
        return ends, step[:, :, :n_z].ravel(), by_rest.ravel()


@lru_cache(maxsize=32)
def shooting_jacobian(transcription: "MultipleShooting") -> ShootingJacobian:
    """The Jacobian of a transcription, kept."""
    return ShootingJacobian(transcription)


def _varied(nodes: Array, stages: Array, lengths: Array) -> tuple[Array, Array]:
    """Ends of all steps (K, n_z), and their derivatives by (z, t, h, freed parameters), (K, n_z, n_z + 2 + n_free).

    What a stage moves the state by is h K_i; of it dK_i is multiplied by h, and K_i stands in the column of h.

    Parameters
    ----------
    nodes, lengths : where the steps start, shape (K, n_z), and how long they are, shape (K,) [s].
    stages : rates, and behind them their derivatives by all but h, shape (12, K, n_z, n_z + 2 + n_free).
    """
    rates, derivatives = stages[..., 0], stages[..., 1:] * lengths[:, None, None]
    n, n_z, n_in = derivatives.shape[1:]
    base = np.zeros((n, n_in, n_in + 1))
    base[:, : n_z + 1, : n_z + 1] = np.eye(n_z + 1)
    base[:, n_z + 1 :, n_z + 2 :] = np.eye(n_in - n_z - 1)
    moved = np.empty((N_STAGES, n, n_z, n_in + 1))
    flat = moved.reshape(N_STAGES, -1)
    for i, (a, c) in enumerate(zip(A, C, strict=True)):
        inner = base.copy()
        inner[:, n_z, n_z + 1] = c
        inner[:, :n_z] += (a[:i] @ flat[:i]).reshape(n, n_z, -1)
        np.matmul(derivatives[i], inner, out=moved[i])
        moved[i, :, :, n_z + 1] += rates[i]
    ends = nodes + lengths[:, None] * np.tensordot(B, rates, 1)
    return ends, np.asarray(base[:, :n_z] + (B @ flat).reshape(n, n_z, -1))


def step_derivatives(
    system: HybridSystem,
    mode: Mode,
    free: tuple[str, ...],
    nodes: Array,
    times: Array,
    lengths: Array,
    p: Array,
    r: Array,
) -> Array:
    """Derivatives of K steps by (z, t, h, freed parameters); shape (K, n_z, n_z + 2 + n_free).

    Parameters
    ----------
    nodes, times, lengths : where the steps start, shape (n_z, K) and (K,), and how long they are, shape (K,) [s].
    p, r : all parameters, and the segment data of the control.
    """
    values = buffered_map(stage_derivatives(system, mode, free), times.size)
    (stages,) = values(nodes.T, times[:, None], lengths[:, None], p, r)
    _, by = _varied(nodes.T, _by_stage(stages, system.n_z), lengths)
    if mode.sticks:
        by[:, -1] = 0.0
    return by


def _by_stage(values: Array, n_z: int) -> Array:
    """f and its derivatives at all stages of K steps, shape (12, K, n_z, n_z + 2 + n_free), from their columns."""
    return values.reshape(len(values), N_STAGES, -1, n_z).transpose(1, 0, 3, 2)


class MultipleShooting:
    """The equations of one step as CasADi expressions of ``w`` and the parameters.

    Parameters
    ----------
    system : walker, control and ground.
    layout : arcs and intervals.
    free : dotted keys of the parameters that are unknowns.
    """

    def __init__(self, system: HybridSystem, layout: Layout, free: tuple[str, ...] = ()) -> None:
        self.system, self.layout, self.free = system, layout, free
        self.n_nodes = layout.n_nodes
        self.n_phases = len(layout.cycle.phases)
        self.Z = MX.sym("Z", system.n_z, self.n_nodes)
        self.durations = MX.sym("d", self.n_phases)
        self.freed = MX.sym("v", len(free))
        self.parameters = MX.sym("p", len(system.parameters))
        entries = [
            self.freed[free.index(name)] if name in free else self.parameters[i]
            for i, name in enumerate(system.parameters)
        ]
        self.p = vertcat(*entries) if free else self.parameters
        self.w = vertcat(vec(self.Z), self.durations, self.freed)
        self._units: tuple[bytes, Units] | None = None
        self._sampled: tuple[bytes, dict[tuple[int, int], tuple[Array, Array]]] = (b"", {})
        self._switches: list[tuple[MX, MX]] = []
        for j in range(self.n_phases):
            start = MX(0) if j in layout.cycle.first_phases else self._switches[-1][1]
            self._switches.append((start, start + self.durations[j]))

    def on(self, layout: Layout) -> "MultipleShooting":
        """The same equations on another layout."""
        return transcribe(self.system, layout, self.free)

    def pack(self, nodes: Array, durations: Array, freed: Array | tuple[float, ...] = ()) -> Array:
        """The vector w from nodes (n_z, K + 1), durations (n_phases,) and freed parameters."""
        return np.concatenate([nodes.ravel(order="F"), durations, np.asarray(freed, dtype=float)])

    def unpack(self, w: Array) -> Unknowns:
        """What a vector w consists of."""
        n = self.system.n_z * self.n_nodes
        nodes = w[:n].reshape((self.system.n_z, self.n_nodes), order="F")
        return Unknowns(nodes, w[n : n + self.n_phases], w[n + self.n_phases :])

    def dynamics(self, p: Array, freed: Array, phase: int = 0) -> Dynamics:
        """The system at its parameters with the freed ones put in, in the step of a phase."""
        return _dynamics(self.system, self.values(p, freed, phase).tobytes())

    def values(self, p: Array, freed: Array, phase: int) -> Array:
        """All parameters, the freed ones put in, as the leg of a phase stands."""
        if self.free:
            p = p.copy()
            p[[self.system.parameters.index(name) for name in self.free]] = freed
        walker = self.system.walker
        return np.asarray(walker.standing(p, walker.side(self.layout.cycle.step_of(phase))))

    def standing_names(self, phase: int) -> tuple[str, ...]:
        """Dotted keys under which the freed parameters stand in the parameter vector of a phase."""
        walker, names = self.system.walker, self.system.parameters
        if not walker.side(self.layout.cycle.step_of(phase)):
            return self.free
        return tuple(names[walker.place(names.index(name))] for name in self.free)

    @cached_property
    def equalities(self) -> MX:
        """Defects, events, resets, periodicity; shape (n_z n_nodes + n_phases,)."""
        joints = [self.Z[:, nodes] for nodes in self.layout.joints]
        last = conditions(*self.joined)(*joints, self.durations, self.freed, self.parameters)
        return vertcat(self._defects(), last)

    @property
    def joined(self) -> tuple[HybridSystem, Cycle, tuple[int, ...], tuple[str, ...]]:
        """What ``conditions`` takes."""
        segments = {arc.phase: arc.segment for arc in self.layout.arcs}
        return self.system, self.layout.cycle, tuple(segments.values()), self.free

    @cached_property
    def inequalities(self) -> tuple[MX, tuple[Label, ...]]:
        """Margins that must not be negative, and what each one says."""
        rows = list(inequalities(self))
        return vertcat(*(block for block, _ in rows)), tuple(label for _, labels in rows for label in labels)

    def units(self, p: Array) -> Units:
        """Natural units of unknowns, equalities and margins for the walker at parameters ``p``, shape (n_p,)."""
        known = p.tobytes()
        last = self._units  # read once: another thread may replace it
        if last is None or last[0] != known:
            last = self._units = known, self._units_at(_dynamics(self.system, known))
        return last[1]

    def _units_at(self, dynamics: Dynamics) -> Units:
        scales, state = dynamics.scales, dynamics.state_units
        nodes = np.tile(state, self.n_nodes)
        events = [
            margin_unit(name, scales) / scales.time**order for _, name, order in endings(self.system, self.layout.cycle)
        ]
        return Units(
            unknowns=self.pack(nodes, np.full(self.n_phases, scales.time), np.ones(len(self.free))),
            equalities=np.concatenate(
                [np.tile(state, self.layout.intervals), events, np.tile(state, len(self.layout.cycle.resets))]
            ),
        )

    def margin_units(self, p: Array) -> Array:
        """Natural units of the inequalities."""
        scales = _dynamics(self.system, p.tobytes()).scales
        return np.array([label.unit(scales) for label in self.inequalities[1]])

    def violation(self, w: Array, p: Array) -> Array:
        """Values of the equalities, shape (n_z n_nodes + n_phases,)."""
        return np.concatenate([defects(self, w, stepped(self, w, p, 1)), *self._conditions(*joints(self, w), p)])

    @cached_property
    def _conditions(self) -> BufferedFunction:
        return buffered(conditions(*self.joined))

    def linearised(self, w: Array, p: Array) -> tuple[Array, SparseMatrix]:
        """Values of the equalities, and their derivative in all unknowns; shape (n, n + n_free)."""
        return shooting_jacobian(self).linearised(w, p)

    def halved_defects(self, w: Array, p: Array) -> Array:
        """The defects when every interval is integrated in two halves."""
        return defects(self, w, stepped(self, w, p, 2))

    def margin_values(self, w: Array, p: Array) -> Array:
        """Values of the inequalities."""
        return self._margin_values(w, p)[0].copy()

    @cached_property
    def _margin_values(self) -> BufferedFunction:
        return BufferedFunction(Function("margins", [self.w, self.parameters], [self.inequalities[0]]))

    @cached_property
    def steps(self) -> list[BufferedMap]:
        """The steps of all intervals of every arc."""
        return [buffered_map(shooting_step(self.system, arc.mode), arc.intervals) for arc in self.layout.arcs]

    def node_times(self, w: Array) -> Array:
        """Time since impact of every node; shape (K + 1,) [s]."""
        return self.layout.node_times(self.unpack(w).durations)

    def sample(self, w: Array, p: Array, index: int, count: int) -> tuple[Array, Array]:
        """Times (count,) and states (count, n_z) at the Chebyshev points of one arc.

        Those of the last solution are kept: what examines it and what assembles its gait read the same ones.
        """
        solution = w.tobytes() + p.tobytes()
        last = self._sampled  # read once: another thread may replace it
        if last[0] != solution:
            last = self._sampled = (solution, {})
        samples = last[1]
        if (index, count) not in samples:
            start, end = self.layout.arc_times(self.unpack(w).durations)[index]
            fractions = (points(count) + 1) / 2
            times = start + (end - start) * fractions
            times[-1] = end  # to the last bit, where the next arc starts
            samples[index, count] = (times, self.states_at(w, p, index, fractions))
        times, states = samples[index, count]
        return times.copy(), states.copy()

    def states_at(self, w: Array, p: Array, index: int, fractions: Array) -> Array:
        """States (m, n_z) at fractions of one arc, each by one partial shooting step from the node before it."""
        nodes, durations, freed = self.unpack(w)
        arc, first = self.layout.arcs[index], self.layout.first_nodes[index]
        start, end = self.layout.arc_times(durations)[index]
        h, places = (end - start) / arc.intervals, fractions * arc.intervals
        k = np.minimum(places.astype(int), arc.intervals - 1)
        step = buffered_map(shooting_step(self.system, arc.mode), fractions.size)
        own, data = self.values(p, freed, arc.phase), self.system.data(arc.segment)
        (states,) = step(nodes.T[first + k], (start + k * h)[:, None], ((places - k) * h)[:, None], own, data)
        return states.copy()

    def arc(self, index: int) -> tuple[ArcLayout, MX, MX, MX]:
        """Layout, nodes, start time and interval length of one arc."""
        arc = self.layout.arcs[index]
        start = self._switches[arc.phase][0] if arc.start is None else MX(arc.start)
        end = self._switches[arc.phase][1] if arc.end is None else MX(arc.end)
        first = self.layout.first_nodes[index]
        return arc, self.Z[:, first : first + arc.intervals + 1], start, (end - start) / arc.intervals

    def map_arcs(self, function: Callable[[Mode], Function], columns: Callable[[int], list[MX]]) -> list[MX]:
        """Apply ``function(mode)`` to the columns of all arcs, with one map per mode; results in order of arcs."""
        results: dict[int, MX] = {}
        for mode in dict.fromkeys(arc.mode for arc in self.layout.arcs):
            indices = [i for i, arc in enumerate(self.layout.arcs) if arc.mode is mode]
            inputs = [columns(i) for i in indices]
            widths = [group[0].shape[1] for group in inputs]
            stacked = [horzcat(*group) for group in zip(*inputs, strict=True)]
            values = function(mode).map(sum(widths))(*stacked)
            each = values.size2() // sum(widths)
            for i, end, width in zip(indices, np.cumsum(widths), widths, strict=True):
                results[i] = values[:, each * (int(end) - width) : each * int(end)]
        return [results[i] for i in range(len(self.layout.arcs))]

    def standing(self, phase: int) -> MX:
        """The parameters in a phase, as its leg stands."""
        walker = self.system.walker
        return walker.standing(self.p, walker.side(self.layout.cycle.step_of(phase)))

    def constants(self, arc: ArcLayout, width: int) -> list[MX]:
        """Parameters and segment data of an arc, repeated."""
        return [repmat(self.standing(arc.phase), 1, width), repmat(MX(self.system.data(arc.segment)), 1, width)]

    def _defects(self) -> MX:
        def columns(i: int) -> list[MX]:
            arc, Z, start, h = self.arc(i)
            times = start + h * MX(np.arange(arc.intervals)).T
            return [Z[:, :-1], times, repmat(h, 1, arc.intervals), *self.constants(arc, arc.intervals)]

        steps = self.map_arcs(lambda mode: shooting_step(self.system, mode), columns)
        ends = horzcat(*(self.arc(i)[1][:, 1:] for i in range(len(self.layout.arcs))))
        return vec(ends - horzcat(*steps))


@lru_cache(maxsize=64)
def _dynamics(system: HybridSystem, p: bytes) -> Dynamics:
    """The system at its parameters; an examination of one solution reads it many times."""
    return Dynamics(system, np.frombuffer(p))


@lru_cache(maxsize=32)
def transcribe(system: HybridSystem, layout: Layout, free: tuple[str, ...] = ()) -> MultipleShooting:
    """The transcription of a layout, kept because sweeps and searches use the same ones repeatedly."""
    return MultipleShooting(system, layout, free)
