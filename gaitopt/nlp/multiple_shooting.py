"""Multiple shooting of one periodic cycle of steps with fixed mode sequences.

Unknowns w = (nodes z_0 .. z_K, phase durations, freed parameters). Equalities, as many as nodes and durations:

    defects      z_{k+1} = step(z_k)    on every interval; in stick with v_t = 0
    conditions   events, resets and periodicity, see ``conditions``

As expressions of CasADi they serve IPOPT; as numbers they are evaluated by functions of one step and of one cycle,
which every layout shares.

Friction complementarity: the mode sets one factor of each pair to zero (the force's factor in slip is eliminated
by eq. (5)); the other factor stays an inequality at every node, except where an event already makes it zero.
"""

from collections.abc import Callable
from functools import cached_property, lru_cache

import numpy as np
from casadi import MX, Function, horzcat, repmat, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.gait.curves import points
from gaitopt.mechanics import Cycle, Dynamics, HybridSystem, Mode, margin_unit
from gaitopt.mechanics.buffered import BufferedFunction, BufferedMap, buffered, buffered_map
from gaitopt.nlp.conditions import conditions, endings
from gaitopt.nlp.inequalities import inequalities
from gaitopt.nlp.integrator import shooting_step
from gaitopt.nlp.layout import ArcLayout, Layout
from gaitopt.nlp.shooting_jacobian import shooting_jacobian
from gaitopt.nlp.shooting_steps import defects, joints, stepped
from gaitopt.nlp.sparse import SparseMatrix
from gaitopt.nlp.transcription import Unknowns
from gaitopt.nlp.units import Label, Units


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
