"""The equations of a periodic gait with given mode sequences, by multiple shooting.

Unknowns w = (nodes z_0 .. z_K, phase durations d, free parameters). There are as many equalities as nodes and
durations; F(w, p) = (defects, events, resets):

    continuity of states    z_{k+1} - step(z_k, t_k, h_k) = 0    on every interval, by one Runge-Kutta step
    end of a phase          guard(z_end) = 0                     v_t = 0 where a slip ends, mu f_n +- f_t = 0 where it
                                                                 begins, the swing foot on the ground at touchdown
    end of a timed phase    t_end - t_breakpoint = 0             where the torques jump, the guard falls below zero
    impact, periodicity     z_start - reset(z_end) = 0           x is counted from the new stance foot; the last reset
                                                                 leads to z_0; also where slips end together

Friction complementarity, with the slip velocity v_t = v_forward - v_backward:

    0 <= v_forward  _|_  mu f_n + f_t >= 0,      0 <= v_backward  _|_  mu f_n - f_t >= 0,      f_n > 0

The mode of a phase sets one factor of each pair to zero: a sticking foot has no velocity, and the friction law gives
the force of a slip. The other factor is a margin, which must not be negative at any node; it is left out where an event
makes it zero. At a breakpoint of the control, margins are required on both sides of the jump: at the end of a timed
phase its guard must still be positive, at the start of the next phase it must be negative. Margins of the impacts
complete the inequalities.

A slip that starts from rest also has zero velocity after no time at all. Its event is divided by that zero, so that
only the actual end remains and the equations stay regular where the slip first appears.

H. G. Bock, K. J. Plitt (1984), A multiple shooting algorithm for direct solution of optimal control problems.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from casadi import MX, SX, Function, densify, horzcat, jacobian, repmat, sum1, vec, vertcat, vertsplit
from numpy.typing import ArrayLike, NDArray

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building, built_once
from gaitopt.gait.curves import points
from gaitopt.integration import N_STAGES
from gaitopt.model.buffered import BufferedFunction, BufferedMap, buffered, buffered_map
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import contact_of, is_held, kind, margin, margin_unit, named
from gaitopt.model.units import SI, Scales
from gaitopt.problem.scalars import unit_of
from gaitopt.solver.interval import differentiated_steps, shooting_step, stage_derivatives, stages_of
from gaitopt.solver.mesh import Mesh, MeshArc
from gaitopt.solver.sparse import Pattern, SparseMatrix
from gaitopt.threads import cached_property


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """Meaning of one unknown, or of one row of the equations.

    Attributes
    ----------
    name : an unknown is a state, a ``duration``, a scalar, or the dotted key of a parameter. A row is a ``defect`` or a
        ``reset``, a scalar, or a margin, which is zero at the end of a phase and not negative elsewhere.
    mode : mode of the phase, or of the foot just after the impact; None for an entry of the whole cycle.
    phase, node : numbers of phase and node, counted from 0 through all steps; None for the impact of a step.
    step : number of the step in the cycle.
    coordinate : the coordinate that a defect or a reset compares.
    unit : SI unit as text; ``1`` if it has none.
    """

    name: str
    mode: Mode | None = None
    phase: int | None = None
    node: int | None = None
    step: int = 0
    coordinate: str = ""
    unit: str = ""

    def size(self, scales: Scales) -> float:
        """Natural unit of the row of a margin."""
        return margin_unit(self.name, scales)

    def __str__(self) -> str:
        text = f"{self.name} of {self.coordinate}" if self.coordinate else self.name
        text += "" if self.node is None else f" at node {self.node}"
        if self.phase is not None and self.mode is not None:
            text += f", phase {self.phase + 1} ({self.mode.brief})"
        elif self.mode is not None:
            text += f", impact of step {self.step + 1} ({self.mode.brief})"
        return f"{text} [{self.unit}]"


class NaturalUnits(NamedTuple):
    """Natural units in which unknowns and equations are of order one.

    Attributes
    ----------
    unknowns : ndarray, shape (n_w,) - 1 for free parameters.
    equalities : ndarray, shape (n,) - units of the rows of ``MultipleShooting.equalities``.
    """

    unknowns: Array
    equalities: Array


class Unknowns(NamedTuple):
    """The blocks of a vector w: nodes (n_z, K + 1), durations (n_phases,) and free parameters (n_free,)."""

    nodes: Array
    durations: Array
    freed: Array


class MultipleShooting:
    """The equations on one mesh: as CasADi expressions of ``w`` and ``parameters`` for IPOPT, as numbers for Newton.

    The numbers come from compiled functions of one step and of one cycle, which all meshes share.

    Parameters
    ----------
    system : walker, control and ground.
    mesh : arcs and shooting intervals.
    free : dotted keys of the parameters that are unknowns.

    Attributes
    ----------
    w, parameters : MX - unknowns and all parameters; the values of free parameters in ``parameters`` are ignored.
    Z, durations, freed : MX - the blocks of ``w``.
    p : MX - all parameters, with the free ones replaced by ``freed``.
    phase_parameters : tuple of MX - the same in every phase, as feedback from step to step has corrected them, and
        where parameters of legs that differ swap places.
    """

    @building
    def __init__(self, system: HybridSystem, mesh: Mesh, free: tuple[str, ...] = ()) -> None:
        self.system, self.mesh, self.free = system, mesh, free
        self.n_nodes, self.n_phases = mesh.n_nodes, len(mesh.cycle.phases)
        self.Z = MX.sym("Z", system.n_z, self.n_nodes)
        self.durations = MX.sym("d", self.n_phases)
        self.freed = MX.sym("v", len(free))
        self.w = vertcat(vec(self.Z), self.durations, self.freed)
        self.parameters = MX.sym("p", len(system.parameters))
        self.p = self.parameters
        if free:
            self.p = substituted(system.parameters, self.parameters, {key: self.freed[i] for i, key in enumerate(free)})
        correction = system.correction
        acting = self.p if correction is None else correction.symbolic(self.p, self.Z[:, 0])
        self.phase_parameters: tuple[MX, ...] = self.per_phase(acting)
        BUILT.watch(vars(self))
        self._units: tuple[bytes, NaturalUnits] | None = None
        self._flow_derivatives: tuple[tuple[bytes, bytes], Array] = (b"", b""), np.empty(0)
        self._samples: tuple[bytes, dict[tuple[int, int], tuple[Array, Array]]] = (b"", {})

    def pack(self, nodes: Array, durations: Array, freed: ArrayLike = ()) -> Array:
        """The vector w from nodes (n_z, K + 1), durations (n_phases,) and free parameters (n_free,)."""
        return np.concatenate([nodes.ravel(order="F"), durations, np.asarray(freed, dtype=float)])

    def unpack(self, w: Array) -> Unknowns:
        """The blocks of a vector w, as views."""
        n = self.system.n_z * self.n_nodes
        nodes = w[:n].reshape((self.system.n_z, self.n_nodes), order="F")
        return Unknowns(nodes, w[n : n + self.n_phases], w[n + self.n_phases :])

    def values(self, p: Array, freed: Array) -> Array:
        """All parameters with the free ones put in; shape (n_p,)."""
        if self.free:
            p = p.copy()
            p[[self.system.parameters.index(name) for name in self.free]] = freed
        return p

    def dynamics(self, p: Array, freed: Array) -> Dynamics:
        """The system at these parameters."""
        return _dynamics(self.system, self.values(p, freed).tobytes())

    def acting(self, w: Array, p: Array) -> Dynamics:
        """The system at the parameters that act in the cycle: feedback from step to step corrects some of them."""
        nodes, _, freed = self.unpack(w)
        return self.dynamics(p, freed).acting(nodes[:, 0])

    def acting_values(self, w: Array, p: Array) -> Array:
        """All parameters with the free ones put in, as they act in the cycle; shape (n_p,)."""
        nodes, _, freed = self.unpack(w)
        values, correction = self.values(p, freed), self.system.correction
        return values if correction is None else correction(values, nodes[:, 0])

    def per_phase(self, p: Any) -> tuple[Any, ...]:
        """The parameters of each phase from those of the first step, as numbers or symbols."""
        return self.mesh.cycle.per_phase(self.system.step_parameters(p))

    def units(self, p: Array) -> NaturalUnits:
        """Natural units of unknowns and equalities at parameters ``p``, shape (n_p,)."""
        key = p.tobytes()
        last = self._units  # read once: another thread may replace it
        if last is not None and last[0] == key:
            return last[1]
        dynamics, cycle = _dynamics(self.system, key), self.mesh.cycle
        scales, state = dynamics.scales, dynamics.state_units
        events = [margin_unit(name, scales) / scales.time**order for _, name, order in endings(self.system, cycle)]
        nodes, durations = np.tile(state, self.n_nodes), np.full(self.n_phases, scales.time)
        units = NaturalUnits(
            unknowns=self.pack(nodes, durations, np.ones(len(self.free))),
            equalities=np.concatenate([np.tile(state, self.mesh.intervals), events, np.tile(state, len(cycle.resets))]),
        )
        self._units = key, units
        return units

    def margin_units(self, p: Array) -> Array:
        """Natural units of the inequalities."""
        scales = _dynamics(self.system, p.tobytes()).scales
        return np.array([label.size(scales) for label in self.inequalities[1]])

    # ---- the meaning of unknowns and equalities

    def label(self, name: str, phase: int, node: int | None = None, *, unit: str = "", coordinate: str = "") -> Label:
        """The label of an unknown or a row in a phase; its unit is that of the margin by default."""
        return Label(
            name=name,
            mode=self.mesh.cycle.phases[phase],
            phase=phase,
            node=node,
            step=self.mesh.cycle.step_of(phase),
            coordinate=coordinate,
            unit=unit or SI[margin(name).unit],
        )

    @cached_property
    def _states(self) -> tuple[tuple[str, str], ...]:
        """Names of the states with their units."""
        lengths, n = {*self.system.walker.lengths, "x", "y"}, len(self.system.state_names) // 2
        units = ["m" if name in lengths else "rad" for name in self.system.state_names[:n]]
        return tuple(zip(self.system.state_names, (*units, *(f"{unit}/s" for unit in units)), strict=True))

    def _unit_of_joint(self, key: str) -> str:
        """Unit of a parameter whose dotted key names a joint, such as a value of its reference; ``1`` for others."""
        return next((unit for name, unit in self._states if name in key.split(".")), "1")

    @cached_property
    def unknown_labels(self) -> tuple[Label, ...]:
        """Meaning of each entry of ``w``; a node between two phases belongs to the later one."""
        phases = {node: arc.phase for arc, at in zip(self.mesh.arcs, self.mesh.arc_nodes, strict=True) for node in at}
        return (
            *(self.label(z, phases[node], node, unit=unit) for node in sorted(phases) for z, unit in self._states),
            *(self.label("duration", phase, unit="s") for phase in range(self.n_phases)),
            *(Label(name=key, unit=unit_of(key, self.system) or self._unit_of_joint(key)) for key in self.free),
        )

    @cached_property
    def equality_labels(self) -> tuple[Label, ...]:
        """Meaning of each row of the equalities."""
        mesh, cycle = self.mesh, self.mesh.cycle
        nodes = [(arc.phase, node) for arc, at in zip(mesh.arcs, mesh.arc_nodes, strict=True) for node in at[1:]]
        resets = [(phase, node) for (phase, _), node in zip(cycle.resets, mesh.joints[1], strict=True)]
        events = list[Label]()
        for phase, ((_, name, order), node) in enumerate(
            zip(endings(self.system, cycle), mesh.last_nodes, strict=True)
        ):
            unit = SI[margin(name).unit]
            events.append(self.label(name, phase, node, unit=f"{unit}^{order + 1}" if order else unit))
        return (
            *(self.label("defect", *at, unit=unit, coordinate=z) for at in nodes for z, unit in self._states),
            *events,
            *(self.label("reset", *at, unit=unit, coordinate=z) for at in resets for z, unit in self._states),
        )

    # ---- the equalities as expressions

    @cached_property
    @building
    def equalities(self) -> MX:
        """Defects, events and resets, which vanish at a gait; shape (n_z n_nodes + n_phases,)."""

        def columns(i: int) -> list[MX]:
            arc, Z, start, h = self.arc(i)
            times = start + h * MX(np.arange(arc.intervals)).T
            return [Z[:, :-1], times, repmat(h, 1, arc.intervals), *self.constants(arc, arc.intervals)]

        ends = self.map_arcs(lambda mode: shooting_step(self.system.shared, mode), columns)
        nodes = horzcat(*(self.arc(i)[1][:, 1:] for i in range(len(self.mesh.arcs))))
        phase_ends, phase_starts = (self.Z[:, at] for at in self.mesh.joints)
        joined = conditions(*self.cycle_key)(phase_ends, phase_starts, self.durations, self.freed, self.parameters)
        return vertcat(vec(nodes - horzcat(*ends)), joined)

    @property
    def cycle_key(self) -> tuple[HybridSystem, Cycle, tuple[int, ...], tuple[str, ...]]:
        """Arguments of ``conditions``."""
        segments = {arc.phase: arc.segment for arc in self.mesh.arcs}
        return self.system, self.mesh.cycle, tuple(segments.values()), self.free

    def arc(self, index: int) -> tuple[MeshArc, MX, MX, MX]:
        """Mesh, nodes, start time and interval length of one arc."""
        arc, at = self.mesh.arcs[index], self.mesh.arc_nodes[index]
        start, end = map(MX, self.mesh.arc_times(vertsplit(self.durations))[index])
        return arc, self.Z[:, at.start : at.stop], start, (end - start) / arc.intervals

    def constants(self, arc: MeshArc, width: int) -> list[MX]:
        """Parameters and segment data of an arc, repeated in ``width`` columns."""
        return [repmat(self.phase_parameters[arc.phase], 1, width), repmat(MX(self.system.data(arc.segment)), 1, width)]

    def map_arcs(self, function: Callable[[Mode], Function], columns: Callable[[int], list[MX]]) -> list[MX]:
        """Apply ``function(mode)`` to the columns of all arcs, with one map per mode; results in the order of arcs."""
        results: dict[int, MX] = {}
        for mode in dict.fromkeys(arc.mode for arc in self.mesh.arcs):
            indices = [i for i, arc in enumerate(self.mesh.arcs) if arc.mode is mode]
            inputs = [columns(i) for i in indices]
            widths = [group[0].shape[1] for group in inputs]
            stacked = [horzcat(*group) for group in zip(*inputs, strict=True)]
            values = function(mode).map(sum(widths))(*stacked)
            each = values.size2() // sum(widths)
            for i, end, width in zip(indices, np.cumsum(widths), widths, strict=True):
                results[i] = values[:, each * (int(end) - width) : each * int(end)]
        return [results[i] for i in range(len(self.mesh.arcs))]

    # ---- the inequalities as expressions

    @cached_property
    @building
    def inequalities(self) -> tuple[MX, tuple[Label, ...]]:
        """Margins that must not be negative, and the meaning of each row."""
        rows, labels = list[MX](), list[Label]()

        # every margin of a mode at the nodes of its arcs, unless an event makes it zero
        def columns(i: int) -> list[MX]:
            arc, Z, start, h = self.arc(i)
            times = start + h * MX(np.arange(arc.intervals + 1)).T
            return [times, Z, *self.constants(arc, arc.intervals + 1)]

        for i, margins in enumerate(self.map_arcs(self.system.margins, columns)):
            arc, at, names = self.mesh.arcs[i], self.mesh.arc_nodes[i], self._margin_names(i)
            rows.append(vec(margins)[[row + k * len(names) for row, k in self._required[i]]])
            labels += [self.label(names[row], arc.phase, at[k]) for row, k in self._required[i]]
        further, meaning = self._further_inequalities
        return vertcat(*rows, further), (*labels, *meaning)

    def _margin_names(self, index: int) -> tuple[str, ...]:
        return self.system.transitions.margin_names(self.mesh.arcs[index].mode)

    @cached_property
    def _required(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """Rows and nodes of the margins that must not be negative along each arc."""
        return tuple(
            tuple(
                (row, k)
                for row, name in enumerate(self._margin_names(i))
                for k in range(arc.intervals + 1)
                if is_held(name) and not self.is_zero_by_event(i, k, name)
            )
            for i, arc in enumerate(self.mesh.arcs)
        )

    @cached_property
    @building
    def _further_inequalities(self) -> tuple[MX, tuple[Label, ...]]:
        """Rows of the inequalities that belong to the ends of arcs and to the impacts, and their meaning."""
        system, table, mesh = self.system, self.system.transitions, self.mesh
        arcs = list(zip(range(len(mesh.arcs)), mesh.arcs, mesh.arc_nodes, strict=True))
        rows, labels = list[MX](), list[Label]()

        # where a massless leg lands or takes off the ground forces are zero: their rates take the place of the forces
        for i, arc, at in arcs:
            for k, sign in ((0, 1), (arc.intervals, -1)):
                unloaded = [name for name in table.margin_names(arc.mode) if self._is_unloaded(i, k, name)]
                if unloaded:
                    _, Z, start, h = self.arc(i)
                    _, rates = system.events(arc.mode)(start + k * h, Z[:, k], *self.constants(arc, 1))
                    for name in unloaded:
                        rows.append(sign * rates[table.margin_names(arc.mode).index(name)])
                        unit = f"{SI[margin(name).unit]}/s"
                        labels.append(self.label(name, arc.phase, at[k], unit=unit))

        # where a slip starts from rest, the force must leave the static cone; with one friction coefficient the kinetic
        # cone says the same. After a timed phase the guard of that phase must be negative
        for i, arc, at in arcs:
            timed = arc.phase - 1 in mesh.cycle.timed
            if arc.start is not None:
                continue
            before = mesh.cycle.phases[arc.phase - 1]
            guards = [(before, table.between(before, arc.mode).guard)] if timed else []
            if system.friction.may_drop and not timed:
                guards += [table.sticking(arc.mode, name) for name in mesh.cycle.starts_from_rest(arc.phase)]
            for mode, guard in guards:
                _, Z, start, _ = self.arc(i)
                margins = system.margins(mode)(start, Z[:, 0], *self.constants(arc, 1))
                rows.append(-margins[table.margin_names(mode).index(guard)])
                what = "onset" if kind(guard).startswith("cone") else "pull"
                labels.append(self.label(named(what, guard), arc.phase, at[0]))

        for row, label in self.impact_margins:
            rows.append(row)
            labels.append(label)
        return vertcat(MX(0, 1), *rows), tuple(labels)

    @cached_property
    @building
    def impact_margins(self) -> tuple[tuple[MX, Label], ...]:
        """Margins of the impacts."""
        margins: list[tuple[MX, Label]] = []
        cycle, table = self.mesh.cycle, self.system.transitions
        for (phase, mode), node in zip(cycle.resets, self.mesh.reset_nodes, strict=True):
            struck, before = table.struck(cycle, phase), cycle.phases[phase]
            names = () if struck is None else table.impact_margin_names(struck, before)
            if struck is None or not names:
                continue
            values = self.system.impact_margins(struck, before)(self.Z[:, node], self.phase_parameters[phase])
            for row, name in enumerate(names):
                at_foot = Label(name=name, mode=mode, step=cycle.step_of(phase), unit=SI[margin(name).unit])
                within = cycle.after(phase) is not None
                margins.append((values[row], self.label(name, phase, node) if within else at_foot))
        return tuple(margins)

    def is_zero_by_event(self, index: int, k: int, name: str) -> bool:
        """Whether an event makes a margin zero at node ``k`` of an arc."""
        arc, cycle = self.mesh.arcs[index], self.mesh.cycle
        return self.system.transitions.is_zero_by_event(cycle, arc.phase, name, **self._ends(index, k))

    def _is_unloaded(self, index: int, k: int, name: str) -> bool:
        """Whether a margin is a force on a massless leg, and node ``k`` of an arc its landing or its take-off."""
        arc, cycle = self.mesh.arcs[index], self.mesh.cycle
        return self.system.transitions.is_unloaded(cycle, arc.phase, name, **self._ends(index, k))

    def _ends(self, index: int, k: int) -> dict[str, bool]:
        """Whether node ``k`` of an arc is the start of its phase, and whether it is the end of one within a step."""
        arc = self.mesh.arcs[index]
        within = self.mesh.cycle.after(arc.phase) is not None
        return {"starts": k == 0 and arc.start is None, "ends": within and k == arc.intervals and arc.end is None}

    # ---- equalities, margins and states as numbers

    def violation(self, w: Array, p: Array) -> Array:
        """Values of the equalities, shape (n_z n_nodes + n_phases,)."""
        (joined,) = self._joined(*self._joints(w), p)
        return np.concatenate([self._defects(w, self._step_ends(w, p, 1)), joined])

    def halved_defects(self, w: Array, p: Array) -> Array:
        """The defects if every interval is integrated in two halves, shape (n_z intervals,)."""
        return self._defects(w, self._step_ends(w, p, 2))

    def margin_values(self, w: Array, p: Array) -> Array:
        """Values of the inequalities, without the expressions of those along the arcs, which take longer to build."""
        nodes, durations, _ = self.unpack(w)
        per_phase, values = self.per_phase(self.acting_values(w, p)), list[Array]()
        for i, (start, end) in enumerate(self.mesh.arc_times(durations.tolist())):
            arc, at = self.mesh.arcs[i], self.mesh.arc_nodes[i]
            times = start + (end - start) / arc.intervals * np.arange(len(at))
            margins = buffered_map(self.system.margins(arc.mode), times.size)
            rows, k = np.array(self._required[i], dtype=int).reshape(-1, 2).T
            states, data = nodes[:, at.start : at.stop].T, self.system.data(arc.segment)
            values.append(margins(times[:, None], states, per_phase[arc.phase], data)[0][k, rows])
        return np.concatenate([*values, self._further(w, p)[0]])

    def jumps(self, w: Array, p: Array) -> dict[int, tuple[float, float]]:
        """The margin that ends each timed phase, before and after the torques jump, in natural units, by the phase."""
        cycle, table = self.mesh.cycle, self.system.transitions
        nodes, _, _ = self.unpack(w)
        ends = {arc.phase: (arc, at[-1]) for arc, at in zip(self.mesh.arcs, self.mesh.arc_nodes, strict=True)}
        per_phase, values = cycle.per_phase(self.acting(w, p).steps), {}
        for phase in cycle.timed:
            (arc, node), dynamics = ends[phase], per_phase[phase]
            following = table.between(arc.mode, cycle.after(phase), table.struck(cycle, phase))
            row = table.margin_names(arc.mode).index(following.guard)
            times, states = np.array([self.system.control.breakpoints[arc.segment]]), nodes[:, [node]].T
            before, after = (float(dynamics.margins(arc.mode, arc.segment + k, times, states)[0, row]) for k in (0, 1))
            unit = dynamics.margin_units(arc.mode)[row]
            values[phase] = before / unit, after / unit
        return values

    def sample(self, w: Array, p: Array, index: int, count: int) -> tuple[Array, Array]:
        """Times (count,) and states (count, n_z) at the Chebyshev points of one arc.

        The samples of the last solution are kept: its diagnosis and its gait need the same ones.
        """
        solution = w.tobytes() + p.tobytes()
        last = self._samples  # read once: another thread may replace it
        if last[0] != solution:
            last = self._samples = (solution, {})
        samples = last[1]
        if (index, count) not in samples:
            start, end = self.mesh.arc_times(self.unpack(w).durations.tolist())[index]
            fractions = (points(count) + 1) / 2
            times = start + (end - start) * fractions
            times[-1] = end  # to the last bit, where the next arc starts
            samples[index, count] = times, self.states_at(w, p, index, fractions)
        times, states = samples[index, count]
        return times.copy(), states.copy()

    def states_at(self, w: Array, p: Array, index: int, fractions: Array) -> Array:
        """States (m, n_z) at fractions of one arc, each by a partial shooting step from the node before it."""
        nodes, durations, _ = self.unpack(w)
        arc, first = self.mesh.arcs[index], self.mesh.arc_nodes[index].start
        start, end = self.mesh.arc_times(durations.tolist())[index]
        h, positions = (end - start) / arc.intervals, fractions * arc.intervals
        k = np.minimum(positions.astype(int), arc.intervals - 1)
        step = buffered_map(shooting_step(self.system.shared, arc.mode), fractions.size)
        values, data = self.per_phase(self.acting_values(w, p))[arc.phase], self.system.data(arc.segment)
        (states,) = step(nodes.T[first + k], (start + k * h)[:, None], ((positions - k) * h)[:, None], values, data)
        return states.copy()

    @cached_property
    def _joined(self) -> BufferedFunction:
        """Events and resets."""
        return buffered(conditions(*self.cycle_key))

    @cached_property
    @building
    def _further(self) -> BufferedFunction:
        function = Function("further", [self.w, self.parameters], [self._further_inequalities[0]])
        return BufferedFunction(BUILT.watch(function))

    def _defects(self, w: Array, ends: Array) -> Array:
        """Differences between the nodes and the ends of the steps that lead to them, shape (intervals, n_z)."""
        return np.asarray((self.unpack(w).nodes.T[self.mesh.start_nodes + 1] - ends).ravel())

    def _joints(self, w: Array) -> tuple[Array, Array, Array, Array]:
        """States at the ends of phases and after resets, durations and free parameters, for ``conditions``."""
        nodes, durations, freed = self.unpack(w)
        ends, starts = (nodes.T[at].ravel() for at in self.mesh.joints)
        return ends, starts, durations, freed

    def _step_ends(self, w: Array, p: Array, substeps: int) -> Array:
        """Ends of the steps on all intervals, each taken in equal substeps; shape (intervals, n_z)."""
        ends = []
        for step, (state, times, length, values, data) in zip(self._steps, self._step_starts(w, p), strict=True):
            for k in range(substeps):
                (state,) = step(state, times + k * length / substeps, length / substeps, values, data)
            ends.append(state.copy())
        return np.concatenate(ends)

    def _step_starts(self, w: Array, p: Array) -> Iterator[tuple[Array, Array, float, Array, Array]]:
        """Inputs of the m steps of every arc: nodes (m, n_z), times (m, 1), length, parameters and segment data."""
        nodes, durations, _ = self.unpack(w)
        mesh, per_phase = self.mesh, self.per_phase(self.acting_values(w, p))
        arc_times = mesh.arc_times(durations.tolist())
        for arc, at, (start, end) in zip(mesh.arcs, mesh.arc_nodes, arc_times, strict=True):
            length = (end - start) / arc.intervals
            times = start + length * np.arange(arc.intervals, dtype=float)[:, None]
            yield nodes.T[at.start : at.stop - 1], times, length, per_phase[arc.phase], self.system.data(arc.segment)

    @cached_property
    def _steps(self) -> list[BufferedMap]:
        """The steps of all intervals of every arc."""
        return [buffered_map(shooting_step(self.system.shared, arc.mode), arc.intervals) for arc in self.mesh.arcs]

    # ---- the Jacobian of the equalities

    def linearised(self, w: Array, p: Array) -> tuple[Array, SparseMatrix]:
        """Values of the equalities, and their derivative by all unknowns; shape (n, n_w)."""
        n_z, n = self.system.n_z, self.mesh.intervals
        ends, step = differentiated_steps(*self._differentiated(w, p))
        for arc, at in zip(self.mesh.arcs, self.mesh.arc_intervals, strict=True):
            if arc.mode.fixes_x:
                ends[at, -1], step[at, -1] = 0.0, 0.0
        step = -step  # a defect is the node minus the end of the step
        times_by, lengths_by = self.duration_derivatives
        by_durations = step[:, :, n_z, None] * times_by[:, None, :] + step[:, :, n_z + 1, None] * lengths_by[:, None, :]
        by_free, by_first = step[:, :, n_z + 2 :], np.empty(0)
        if self.system.correction is not None:
            of_free, of_first = self.varied_slopes(w, p)
            by_first, by_free = by_free @ of_first, by_free @ of_free
            step[0, :, :n_z] += by_first[0]
            by_first = by_first[1:].ravel()
        by_tail = np.concatenate([by_durations, by_free], axis=2)
        joined, joined_by = self._joined_derivatives(*self._joints(w), p)
        pattern, order = self._pattern_and_order
        entries = [np.ones(n * n_z), step[:, :, :n_z].ravel(), by_tail.ravel(), joined_by, by_first]
        matrix = SparseMatrix(pattern=pattern, data=np.concatenate(entries)[order])
        return np.concatenate([self._defects(w, ends), joined]), matrix

    def fastest_modes(self, w: Array, p: Array) -> Array:
        """Spectral radius of the derivative of the flow by the state at the start of each interval, (intervals,) [1/s].

        It is infinite where the derivative is not finite.
        """
        key, by_state = self._flow_derivatives  # read once: another thread may replace it
        if key != (w.tobytes(), p.tobytes()):
            by_state = self._differentiated(w, p)[1][0, :, :, 1 : 1 + self.system.n_z]
        finite = np.isfinite(by_state).all(axis=(1, 2))
        radii = np.full(finite.size, np.inf)
        radii[finite] = np.abs(np.linalg.eigvals(by_state[finite])).max(axis=1, initial=0.0)
        return radii

    def _differentiated(self, w: Array, p: Array) -> tuple[Array, Array, Array]:
        """Arguments of ``differentiated_steps``: start, stages with their derivatives, and length of every interval."""
        n_z, n = self.system.n_z, self.mesh.intervals
        stages = np.empty((N_STAGES, n, n_z, n_z + 2 + len(self.varied)))
        starts, lengths = np.empty((n, n_z)), np.empty(n)
        arcs = zip(self.mesh.arc_intervals, self._stages, self._step_starts(w, p), strict=True)
        for at, derivatives, inputs in arcs:
            stages[:, at] = stages_of(derivatives(*inputs)[0], n_z)
            starts[at], lengths[at] = inputs[0], inputs[2]
        self._flow_derivatives = (w.tobytes(), p.tobytes()), stages[0, :, :, 1 : 1 + n_z].copy()
        return starts, stages, lengths

    @cached_property
    def varied(self) -> tuple[str, ...]:
        """The free parameters, and those that feedback from step to step corrects."""
        correction = self.system.correction
        return self.free if correction is None else tuple(dict.fromkeys((*self.free, *correction.keys)))

    def varied_slopes(self, w: Array, p: Array) -> tuple[Array, Array]:
        """Derivatives of ``varied`` by the free parameters, (n, n_free), and by the first node, (n, n_z)."""
        nodes, _, freed = self.unpack(w)
        of_free, of_first = np.eye(len(self.varied), len(self.free)), np.zeros((len(self.varied), self.system.n_z))
        correction, names = self.system.correction, self.system.parameters
        if correction is not None:
            by_state, by_p = correction.slopes(self.values(p, freed), nodes[:, 0])
            rows = [self.varied.index(key) for key in correction.keys]
            of_first[rows] = by_state
            of_free[rows] = by_p[:, [names.index(name) for name in self.free]]
        return of_free, of_first

    @cached_property
    def varied_in_phases(self) -> tuple[tuple[str, ...], ...]:
        """Names of ``varied`` in every phase: free parameters may have other roles in the next step."""
        names = self.system.parameters
        roles = [dict(zip(phase.tolist(), names, strict=True)) for phase in self.per_phase(np.array(names))]
        return tuple(tuple(role[name] for name in self.varied) for role in roles)

    @cached_property
    def _stages(self) -> list[BufferedMap]:
        """Stage derivatives of all intervals of every arc."""
        functions = (
            stage_derivatives(self.system.shared, arc.mode, self.varied_in_phases[arc.phase]) for arc in self.mesh.arcs
        )
        return [buffered_map(function, arc.intervals) for function, arc in zip(functions, self.mesh.arcs, strict=True)]

    @cached_property
    def _joined_derivatives(self) -> BufferedFunction:
        """Events and resets with the entries of their Jacobian."""
        return BufferedFunction(condition_derivatives(*self.cycle_key), nonzeros=True)

    @cached_property
    def duration_derivatives(self) -> tuple[Array, Array]:
        """Derivatives of start and length of every interval by the durations, in which both are affine."""
        durations = np.vstack([np.zeros(self.n_phases), np.eye(self.n_phases)])
        origin, *units = map(self.mesh.interval_times, durations)
        times, lengths = np.transpose(np.array(units) - origin, (1, 2, 0))
        return times, lengths

    @property
    def jacobian_pattern(self) -> Pattern:
        """Pattern of the Jacobian of the equalities."""
        return self._pattern_and_order[0]

    @cached_property
    def _pattern_and_order(self) -> tuple[Pattern, NDArray[np.intp]]:
        """Pattern of the Jacobian, and the permutation that sorts the entries of ``linearised`` by columns."""
        n_z, n, mesh = self.system.n_z, self.mesh.intervals, self.mesh
        n_w, n_tail = self.w.numel(), self.n_phases + len(self.free)
        tail, row = np.arange(n_w - n_tail, n_w), np.arange(n * n_z)
        starts = n_z * mesh.start_nodes[:, None] + np.arange(n_z)  # columns of the nodes where intervals start
        joined = condition_derivatives(*self.cycle_key).sparsity_out(1)
        joint_nodes = n_z * np.concatenate(mesh.joints)[:, None] + np.arange(n_z)
        blocks = [
            (row, (starts + n_z).ravel()),
            (np.repeat(row, n_z), np.repeat(starts, n_z, axis=0).ravel()),
            (np.repeat(row, n_tail), np.tile(tail, n * n_z)),
            (n * n_z + np.array(joined.row(), dtype=int), np.append(joint_nodes.ravel(), tail)[joined.get_col()]),
        ]
        if self.system.correction is not None:  # the first node corrects parameters of all later intervals
            first = np.arange(n_z)
            blocks.append((np.repeat(row[n_z:], n_z), np.tile(first, (n - 1) * n_z)))
        rows, columns = (np.concatenate(indices) for indices in zip(*blocks, strict=True))
        order = np.lexsort((rows, columns))
        pointers = np.searchsorted(columns[order], np.arange(n_w + 1))
        return Pattern(shape=(n * n_z + joined.size1(), n_w), pointers=pointers, rows=rows[order]), order


@built_once(maxsize=32)
def transcribe(system: HybridSystem, mesh: Mesh, free: tuple[str, ...] = ()) -> MultipleShooting:
    """The equations on a mesh, kept because sweeps and searches use the same ones repeatedly."""
    return MultipleShooting(system, mesh, free)


def substituted(keys: tuple[str, ...], p: Any, freed: Mapping[str, Any]) -> Any:
    """The parameter vector ``p`` of CasADi symbols with the values of some dotted keys replaced."""
    return vertcat(*(freed[key] if key in freed else p[k] for k, key in enumerate(keys)))


def endings(system: HybridSystem, cycle: Cycle) -> Iterator[tuple[Mode, str, int]]:
    """Mode of every phase, the event that ends it, and the order of the zero from which its margin starts."""
    jump = system.friction.may_drop
    for phase, mode in enumerate(cycle.phases):
        name = system.transitions.ending(cycle, phase).guard
        slips = kind(name) == "slip_velocity"
        yield mode, name, cycle.onset_order(phase, contact_of(name), jump=jump) if slips else 0


@built_once(maxsize=64)
def conditions(system: HybridSystem, cycle: Cycle, segments: tuple[int, ...], free: tuple[str, ...]) -> Function:
    """(ends, starts, durations, freed, p) -> events of all phases, then resets; shape (n_phases + n_z n_resets,).

    Parameters
    ----------
    segments : segment of the control at the end of every phase.
    free : dotted keys of the parameters that are unknowns; their values in ``p`` are ignored.

    Returns
    -------
    function : its first arguments are the states at the end of every phase, shape (n_z, n_phases), and after every
        reset, shape (n_z, n_resets).
    """
    ends, starts = SX.sym("ends", system.n_z, len(cycle.phases)), SX.sym("starts", system.n_z, len(cycle.resets))
    durations, freed = SX.sym("durations", len(cycle.phases)), SX.sym("freed", len(free))
    p = SX.sym("p", len(system.parameters))
    full = substituted(system.parameters, p, {key: freed[i] for i, key in enumerate(free)})
    if system.correction is not None:  # the last reset leads to the first node
        full = system.correction.symbolic(full, starts[:, -1])
    per_phase = cycle.per_phase(system.step_parameters(full))
    rows, at_end = [], list[tuple[SX, SX, SX, SX]]()
    for phase, (mode, name, order) in enumerate(endings(system, cycle)):
        step = cycle.step_of(phase)
        time = sum1(durations[cycle.first_phases[step] : phase + 1])
        at_end.append((time, ends[:, phase], per_phase[phase], SX(system.data(segments[phase]))))
        if name in (BREAKPOINT, CLOCK):
            known = system.control.period if name == CLOCK else system.control.breakpoints[segments[phase]]
            assert known is not None  # the reader of problems requires it
            rows.append(time - known)
            continue
        margins = system.margins(mode)(*at_end[phase])
        rows.append(margins[system.transitions.margin_names(mode).index(name)] / durations[phase] ** order)
    for k, (phase, after) in enumerate(cycle.resets):
        struck, mode = system.transitions.struck(cycle, phase), cycle.phases[phase]
        if struck is None:
            rows.append(starts[:, k] - system.stopped_together(mode, after)(*at_end[phase]))
            continue
        reset = system.reset(struck, mode, ends_step=cycle.after(phase) is None)
        rows.append(starts[:, k] - reset(z=ends[:, phase], p=per_phase[phase])["z_plus"])
    return Function("conditions", [ends, starts, durations, freed, p], [densify(vertcat(*rows))])


@built_once(maxsize=64)
def condition_derivatives(
    system: HybridSystem, cycle: Cycle, segments: tuple[int, ...], free: tuple[str, ...]
) -> Function:
    """``conditions`` with a second output: their sparse Jacobian by (ends, starts, durations, freed), in columns."""
    function = conditions(system, cycle, segments, free)
    inputs = function.sx_in()
    (values,) = function.call(inputs)
    return Function("condition_derivatives", inputs, [values, jacobian(values, vertcat(*map(vec, inputs[:-1])))])


@lru_cache(maxsize=64)
def _dynamics(system: HybridSystem, p: bytes) -> Dynamics:
    """The system at its parameters, cached because the diagnosis of one solution needs it many times."""
    return Dynamics(system, np.frombuffer(p))
