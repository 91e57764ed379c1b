"""First guess of a cycle: the motion from a state, integrated along the given mode sequences.

    dz/dt = f_mode(t, z)      until the margin that ends the phase falls through zero

If it falls because the torques jump at a breakpoint of the control, the phase ends there and is timed.
The sequence is imposed, not tested. If a switch does not happen, the phase ends where its margin is closest to zero
within the time of a step; if touchdown does not happen, it ends after the time of a step at the initial rates.

The ends of phases are sought on a grid, from the values of the margins, and not as the simulator locates its events,
from their rates. A guess needs no rates, an end that does not happen needs the grid anyway, and the simulator remains
an independent check. Both agree to 3e-13 natural units of time on every named problem.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from casadi import Function

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.building import built_once
from gaitopt.gait.gait import Gait
from gaitopt.integration import CompiledStep, Integration, StepSizeError, bracketed_root
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import LANDINGS
from gaitopt.problem.problem import Problem
from gaitopt.requests import INTERVALS
from gaitopt.solver.interval import ORDER, shooting_step
from gaitopt.solver.mesh import Mesh, mesh_of, nearest
from gaitopt.solver.newton import MAX_INTERVALS, Solution, polish, refine
from gaitopt.solver.shooting import transcribe

RTOL, ATOL = 1e-8, 1e-10
"""Tolerances of the integration, sufficient for a guess. The absolute one is in natural units."""
POINTS_PER_STEP = 8
"""Points of every integrator step at which the end of a phase is sought."""
POINTS_PER_CALL = 64
"""Number of points at which margins are evaluated in one call. It is fixed, because each number needs a function of its
own, which would have to be built."""
ROUNDING_OF_MARGINS = 1e-12
"""A margin below this, in natural units, is zero up to rounding and cannot yet fall through zero."""
STABLE_STEP = 5.0
"""Largest product of an interval and the fastest mode of the linearised flow. Up to 5.9 the explicit step damps every
mode that the flow damps. Above that it magnifies stiff modes from interval to interval."""
FIRST_ERROR = 1e-5
"""Largest error of one interval of a first mesh in natural units. It is small enough that the search from a guess next
to a gait starts next to that gait."""
FINE_ERROR = 1e-9
"""Largest error of one interval of a finer mesh, which is tried if the first one may have moved a guess off its gait.
The motion itself is not known to more digits."""
MOST_MESHES = 6
"""Largest number of meshes for one motion: one for a stable step, and those that the measured errors require."""
FIRST_STEP = 2.5e-5
"""First step of the integrator in natural units; each step is at most ten times the previous one."""
FIRST_STEP_FROM_REST = 2.5e-7
"""The first step where the foot begins to slip: the first slip of a light foot may end after 1e-6."""
TIME_TOLERANCE = 1e-12
"""Tolerance of the end of a phase, in natural units of time."""
MAX_STEP_TIME = 50.0
"""Longest step in natural units of time, 20 s for legs of 1.6 m; no walker needs longer."""
MOST_STEPS = 20_000
"""Largest number of integrator steps in one phase: the longest phase takes some hundreds, under a stiff control some
thousands."""
SMALLEST_JUMP = 1e-9
"""Smallest jump of a margin at a breakpoint, in natural units, that ends a phase. If torques only have a kink there,
the margin jumps by rounding."""
NEAR_BREAKPOINT = 0.05
"""A phase of a given duration may end at a breakpoint instead that is no farther from its end than this fraction
of a cycle."""
ROUNDING = 1e-12
"""Relative difference of two times that rounding may cause."""
CUT_OFF_PHASE = 0.05
"""Fraction of a step that a phase without a known end lasts if no time is left for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseMotion:
    """The motion in one phase. One step from the integration point before a time leads to the state at that time.

    Attributes
    ----------
    step : (z, t, h, p, r) -> z at t + h.
    p : parameters, shape (n_p,).
    times, states, data : times (m,), states (m, n_z) and segment data of the control (m, n_r) at those points. With
        a single point the state is constant.
    """

    step: Function
    p: Array
    times: Array
    states: Array
    data: Array

    @property
    def end(self) -> float:
        """Time since the impact at which the motion ends [s]."""
        return float(self.times[-1])

    def __call__(self, times: Array) -> Array:
        """States at the given times; shape (n_z, n)."""
        if self.times.size == 1:
            return np.repeat(self.states.T, times.size, axis=1)
        k = np.maximum(np.searchsorted(self.times[:-1], times, side="right") - 1, 0)
        step, starts = buffered_map(self.step, times.size), self.times[k]
        (states,) = step(self.states[k], starts[:, None], (times - starts)[:, None], self.p, self.data[k])
        return states.T.copy()


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """The motion along a cycle; called with a phase and times since the last impact, it gives the states.

    Attributes
    ----------
    dynamics : dynamics of the walker.
    cycle : mode sequence of the motion, with the phases that are timed.
    durations : durations of the phases [s].
    motions : motion in each phase.
    endless : the first phase whose event did not happen; None if all events did.
    """

    dynamics: Dynamics
    cycle: Cycle
    durations: tuple[float, ...]
    motions: tuple[PhaseMotion, ...]
    endless: int | None = None

    @property
    def period(self) -> float:
        """Duration of the whole cycle [s]; zero if the walker falls at once."""
        return float(sum(self.durations))

    def __call__(self, phase: int, times: Array) -> Array:
        """States in one phase at times since impact, shape (n_z, n); after a fall the last state."""
        motion = self.motions[phase]
        return motion(np.minimum(times, motion.end))

    @overflow_allowed()
    def on_mesh(
        self,
        free: tuple[str, ...] = (),
        intervals: Sequence[int] = (),
        *,
        error: float = FIRST_ERROR,
        per_step: int = INTERVALS,
    ) -> Solution:
        """The motion on a mesh of shooting intervals: equations, unknowns and parameters with which a search starts.

        The intervals are short enough for a stable step and a small error, both measured along the motion.

        Parameters
        ----------
        free : dotted keys of the parameters that are unknowns.
        intervals : number of intervals of every arc; it is ignored if there is another number of arcs.
        error : largest error of one interval in natural units.
        per_step : number of intervals of a step in the first mesh.
        """
        mesh = mesh_of(self.cycle, self.durations, self.dynamics.system.control.breakpoints, per_step)
        mesh = mesh.refined(intervals) if len(intervals) == len(mesh.arcs) else mesh
        for _ in range(MOST_MESHES):
            first, moved = self._sampled(mesh, free)
            counts = self._needed_intervals(first, moved, error)
            if counts == [arc.intervals for arc in mesh.arcs] or sum(counts) > MAX_INTERVALS:
                break
            mesh = mesh.refined(counts)
        return first

    def _needed_intervals(self, at: Solution, moved: Array, allowed: float) -> list[int]:
        """Number of intervals of every arc that a stable step needs or, if it is stable, that a small error needs.

        Parameters
        ----------
        at, moved : results of ``_sampled``.
        allowed : largest error of a step, which is its distance from the motion on which it starts.
        """
        equations, mesh, n_z = at.equations, at.equations.mesh, at.equations.system.n_z
        (starts, lengths), nodes = mesh.interval_times(at.durations), equations.unpack(at.w).nodes.T
        stepped = nodes[mesh.start_nodes + 1] - at.residual[: mesh.intervals * n_z].reshape(-1, n_z)
        stiffness = equations.fastest_modes(at.w, at.p) * lengths / STABLE_STEP  # of the derivatives of the residual
        errors = (np.abs(stepped - moved) / self.dynamics.state_units).max(axis=1)
        counts = [arc.intervals for arc in mesh.arcs]
        if stiffness.max() <= 1 and errors.max() <= allowed:
            return counts
        for k, (arc, here) in enumerate(zip(mesh.arcs, mesh.arc_intervals, strict=True)):
            known = (starts + lengths)[here] <= self.motions[arc.phase].end * (1 + ROUNDING)  # not after a fall
            unstable, error = (values[here][known & np.isfinite(values[here])] for values in (stiffness, errors))
            growth = float(unstable.max(initial=0.0))
            if growth <= 1:
                growth = (float(error.max(initial=0.0)) / allowed) ** (1 / (ORDER + 1))
            counts[k] = max(arc.intervals, ceil(arc.intervals * growth))
        return counts

    def _sampled(self, mesh: Mesh, free: tuple[str, ...]) -> tuple[Solution, Array]:
        """The motion at the nodes of a mesh, and at the end of every interval in its own phase, (intervals, n_z)."""
        durations, system = np.array(self.durations), self.dynamics.system
        nodes, moved = np.empty((system.n_z, mesh.n_nodes)), np.empty((mesh.intervals, system.n_z))
        arcs = zip(mesh.arcs, mesh.arc_nodes, mesh.arc_intervals, mesh.arc_times(self.durations), strict=True)
        for arc, at, here, (begin, end) in arcs:
            states = self(arc.phase, np.linspace(begin, end, len(at)))
            nodes[:, at.start : at.stop], moved[here] = states, states[:, 1:].T
        equations = transcribe(system, mesh, free)
        freed = [self.dynamics.parameter(key) for key in free]
        return Solution(equations, equations.pack(nodes, durations, freed), self.dynamics.p), moved


def guessed_motion(problem: Problem, dynamics: Dynamics) -> Rollout:
    """The motion from a problem's guess."""
    state = np.array([problem.guess.state[name] for name in dynamics.system.state_names])
    return roll_out(dynamics, problem.cycle, state, problem.guess.durations)


def retraced(gait: Gait, times: int = 1) -> Rollout:
    """The motion of a known gait, repeated ``times``: every search that begins at a gait has this guess.

    Each step starts from its known state, so that errors of one step do not grow in the next ones.
    """
    durations = [duration for _, duration in gait.phases]
    states = np.array([step.arcs[0].states[0] for step in gait.steps])
    cycle = Cycle(gait.cycle.steps * times)
    return roll_out(gait.dynamics, cycle, np.tile(states, (times, 1)), durations * times)


def rolled_again(solution: Solution) -> Rollout:
    """The motion from the first node of a solution with the durations of its phases.

    Its mesh has the order of arcs that these durations demand: see ``Solution.in_order``. A switch that has left its
    breakpoint is sought again.
    """
    equations, (nodes, durations, freed) = solution.equations, solution.equations.unpack(solution.w)
    cycle, misplaced = equations.mesh.cycle, solution.misplaced
    cycle = cycle.with_timed({*cycle.timed} - {*misplaced})
    known = [None if phase in misplaced else length for phase, length in enumerate(durations.tolist())]
    return roll_out(equations.dynamics(solution.p, freed), cycle, nodes[:, 0], known)


def reordered(refined: Solution) -> Solution | None:
    """The same refined motion, its arcs cut anew if a switch has passed or left a breakpoint; None if it is lost.

    Its first mesh is fine, because the error of a coarse one may move the switch back. A motion with a phase that has
    vanished has no order, and is returned unchanged.
    """
    if not (refined.durations > 0).all() or refined.in_order:
        return refined
    again = refine(polish(rolled_again(refined).on_mesh(refined.equations.free, error=FINE_ERROR)))
    return again if again.in_order else None


@overflow_allowed()
def roll_out(
    dynamics: Dynamics,
    cycle: Cycle,
    state: Array,
    durations: Sequence[float | None] | Array | None = None,
    longest: float | None = None,
) -> Rollout:
    """Integrate along ``cycle`` from ``state`` just after an impact; phases end at events unless durations are given.

    Parameters
    ----------
    state : state at the start of the first step, shape (n_z,), or of the first k steps, shape (k, n_z), without which
        errors of one step would grow in the next ones if durations are given.
    durations : durations of the phases [s], None where a phase ends at its event; a phase that is timed in ``cycle``
        ends at the nearest breakpoint.
    longest : time after the impact by which phases end at the latest [s]; ``MAX_STEP_TIME`` by default.
    """
    scales, table = dynamics.scales, dynamics.system.transitions
    longest, first_step = longest or MAX_STEP_TIME * scales.time, FIRST_STEP * scales.time
    starts, breakpoints = np.atleast_2d(state), dynamics.system.control.breakpoints
    time, z, per_phase = 0.0, starts[0].copy(), cycle.per_phase(dynamics.acting(starts[0]).steps)
    known = [None] * len(cycle.phases) if durations is None else durations
    given = [None if length is None else float(length) for length in known]
    near = NEAR_BREAKPOINT * sum(length or 0.0 for length in given)
    lengths, motions, endless, timed = list[float](), list[PhaseMotion](), list[int](), list[int]()
    for phase, mode in enumerate(cycle.phases):
        impact, step = cycle.impact_before(phase) if phase > 0 else None, cycle.step_of(phase)
        if impact is not None:
            start_given = phase in cycle.first_phases and step < len(starts)
            ends_step, struck = phase in cycle.first_phases, table.struck(cycle, phase - 1) or impact
            before = cycle.phases[phase - 1]
            landed = per_phase[phase - 1].after_impact
            z = starts[step].copy() if start_given else landed(struck, z, before, ends_step=ends_step)
            time = 0.0 if ends_step else time
        elif phase > 0 and cycle.stop_together(phase - 1):
            joined = buffered(dynamics.system.stopped_together(cycle.phases[phase - 1], mode))
            segment = bisect_right(breakpoints, time)
            z = joined(time, z, per_phase[phase].p, dynamics.system.data(segment))[0].copy()
        z = np.nan_to_num(z)  # a motion that has broken down
        if mode.fixes_x:
            z[-1] = 0.0
        flow = _ModeFlow(per_phase[phase], cycle, phase)
        duration = given[phase]
        if duration is None:
            motion = flow.integrate(time, z, max(longest - time, first_step), until_end=True)
            end, jumps = flow.end(motion)
            if end is None:
                endless.append(phase)
                end = flow.lost_end(motion, transit_time(dynamics, cycle, starts[0]))
            duration = end - time
        else:
            end = time + duration
            jump = nearest(breakpoints, end) if phase in cycle.timed else flow.jump(time, z, end + near)
            jumps = jump is not None
            if jump is not None:
                following = given[phase + 1]
                if following is not None:  # the next phase still ends at the same time
                    given[phase + 1] = max(following + end - jump, following / 2)
                duration, end = jump - time, jump
            motion = flow.integrate(time, z, duration, until_end=False)
        lengths.append(duration)
        motions.append(motion)
        timed += [phase] if jumps else []
        time = end if jumps else time + duration
        z = motion(np.array([min(time, motion.end)]))[:, 0]
    return Rollout(
        dynamics=dynamics,
        cycle=cycle.with_timed(timed),
        durations=tuple(lengths),
        motions=tuple(motions),
        endless=next(iter(endless), None),
    )


def step_of_shape(dynamics: Dynamics, cycle: Cycle, state: Array) -> Array:
    """Change of the shape from that of ``state``, just after an impact, to the one that the last impact maps back.

    Relabelling is affine, s_plus = A s_minus + b, so that A and b follow from any one state.
    """
    system, n = dynamics.system, len(dynamics.system.walker.shape)
    struck, last = system.walker.swapped(cycle.impact), cycle.phases[-1]
    mapped = dynamics.after_impact(struck, state, last)[:n]
    A = np.asarray(system.reset_jacobian(struck, last)(state, dynamics.p))[:n, :n]
    return np.asarray(np.linalg.solve(A, state[:n] - mapped))


def transit_time(dynamics: Dynamics, cycle: Cycle, state: Array) -> float:
    """Duration of a step [s] at the rates of ``state``, until a joint has covered its entry of ``step_of_shape``.

    The duration is the natural unit of time if no joint moves, if massless feet are placed anew, and if no landing ends
    the cycle.
    """
    system, time = dynamics.system, dynamics.scales.time
    if system.walker.weightless() or system.cycle_end != TOUCHDOWN:
        return time
    travel = np.abs(step_of_shape(dynamics, cycle, state))
    rates = np.abs(state[system.n_shape + 1 :])[: travel.size]
    if not np.isfinite(travel).all():
        return MAX_STEP_TIME * time
    moving = (travel > 0) & (rates > 0)
    return float(np.min(travel[moving] / rates[moving], initial=MAX_STEP_TIME * time)) if moving.any() else time


class _ModeFlow:
    """The flow of one mode across the breakpoints of the control, with the margin that ends its phase."""

    def __init__(self, dynamics: Dynamics, cycle: Cycle, phase: int) -> None:
        system, self._p, self._scales = dynamics.system, dynamics.p, dynamics.scales
        mode, after = cycle.phases[phase], cycle.after(phase)
        table, self._mode = system.transitions, mode
        names, self._units = table.margin_names(mode), dynamics.margin_units(mode)
        guard = table.between(mode, after, table.struck(cycle, phase)).guard
        self._until = system.control.period if guard == CLOCK else None
        self._upright = names.index("upright")
        # the clearance while a stop is free; a walker with several contacts has no landing that must come last
        self._touchdown = next((row for row, name in enumerate(names) if name in LANDINGS), None)
        self._ending = None if guard == CLOCK else names.index(guard)
        continuous = cycle.reset_after(phase) is None
        self._may_jump = continuous and after in table.at_breakpoint(mode).candidates
        self._breakpoints = system.control.breakpoints
        self._data = [system.data(k) for k in range(len(self._breakpoints) + 1)]
        self._within, self._margins = shooting_step(system.shared, mode), buffered(system.margins(mode))
        self._many_margins = buffered_map(system.margins(mode), POINTS_PER_CALL)
        point = _rate_and_margins(system.shared, mode)
        self._point = buffered(point)
        self._step = CompiledStep(system.flow(mode), point, rtol=RTOL, atol=ATOL * dynamics.state_units)

    def integrate(self, time: float, z: Array, duration: float, *, until_end: bool) -> PhaseMotion:
        """The motion until ``duration`` is over, the walker falls or, if ``until_end``, the event has happened.

        A motion that breaks down at once has a single point; the solver judges it. If touchdown precedes the event that
        should end the phase, the motion continues, because ``lost_end`` cuts it off elsewhere.
        """
        end, points = max(time, time + duration), [(time, z)]
        margins, waiting = self._margins_at(time, z), until_end
        armed = margins > ROUNDING_OF_MARGINS
        while points[-1][0] < end and len(points) < MOST_STEPS:
            integration = self._begin(*points[-1], end)
            while not integration.finished and len(points) < MOST_STEPS:
                try:
                    integration.advance()
                except StepSizeError:
                    return self._motion(points)
                points.append((integration.t, integration.y))
                upright, margins = margins[self._upright] >= 0, integration.outputs[0] / self._units
                fallen = armed & (margins <= 0)
                if upright and margins[self._upright] <= 0:  # the walker has fallen at the last point
                    motion = self._motion(points)
                    fall = self._root(motion, points[-2][0], points[-1][0], self._upright)
                    return self._motion([*points[:-1], (fall, motion(np.array([fall]))[:, 0])])
                if waiting and self._ending is not None and fallen[self._ending]:
                    return self._motion(points)
                waiting = waiting and not (self._touchdown is not None and fallen[self._touchdown])
                armed |= margins > ROUNDING_OF_MARGINS
        return self._motion(points)

    def end(self, motion: PhaseMotion) -> tuple[float | None, bool]:
        """Time since impact at which the phase ends, and whether its margin jumps there because the torques do.

        The time is None if the event does not happen before touchdown.
        """
        if self._ending is None:
            assert self._until is not None
            return max(self._until, float(motion.times[0])), False
        times, margins = self._along(motion)
        if self._touchdown is None:
            end, landing = self._first_fall(motion, times, margins, self._ending), None
            return self._with_jump(motion, end)
        landing = self._first_fall(motion, times, margins, self._touchdown)
        if self._ending == self._touchdown:
            return landing, False
        end = self._first_fall(motion, times, margins, self._ending)
        if end is None or (landing is not None and landing < end):
            return None, False
        return self._with_jump(motion, end)

    def _with_jump(self, motion: PhaseMotion, end: float | None) -> tuple[float | None, bool]:
        """The end of a phase at its event, or at an earlier jump of the torques that ends it."""
        jump = None if end is None else self._first_jump(motion, end)
        return (end, False) if jump is None else (jump, True)

    def jump(self, time: float, z: Array, latest: float) -> float | None:
        """The breakpoint up to ``latest`` at which the phase ends because the torques jump; None if there is none."""
        if not (self._may_jump and any(time < b <= latest for b in self._breakpoints)):
            return None
        return self._first_jump(self.integrate(time, z, latest - time, until_end=False), latest)

    def lost_end(self, motion: PhaseMotion, transit: float) -> float:
        """Time since impact at which a phase without an event is cut off."""
        lost, start = transit, float(motion.times[0])
        if self._ending is not None and self._ending != self._touchdown:
            times, margins = self._along(motion)
            within = times <= start + transit
            lost = float(times[within][np.argmin(np.abs(margins[within, self._ending]))])
        return max(lost, start + CUT_OFF_PHASE * transit)

    def _begin(self, time: float, z: Array, end: float) -> Integration:
        """An integration to ``end`` or to the next breakpoint of the control, whichever comes first."""
        segment = bisect_right(self._breakpoints, time)
        bound = min([end, *self._breakpoints[segment : segment + 1]])
        self._step.load(self._p, self._data[segment])
        slides = self._mode.direction and abs(z[-1]) > ROUNDING_OF_MARGINS * self._scales.speed
        from_rest = self._mode.slips and not slides
        first_step = FIRST_STEP_FROM_REST if from_rest else FIRST_STEP
        rate = self._point(time, z, self._p, self._data[segment])[0].copy()
        return Integration(self._step, time, z, rate, bound, min(first_step * self._scales.time, bound - time))

    def _motion(self, points: Sequence[tuple[float, Array]]) -> PhaseMotion:
        times, states = zip(*points, strict=True)
        data = [self._data[bisect_right(self._breakpoints, time)] for time in times]
        return PhaseMotion(
            step=self._within, p=self._p, times=np.array(times), states=np.array(states), data=np.array(data)
        )

    def _along(self, motion: PhaseMotion) -> tuple[Array, Array]:
        """Times on a grid, and all margins there in natural units, shape (n, n_margins).

        A breakpoint of the control occurs twice, with the margins before and after it.
        """
        steps = np.linspace(motion.times[:-1], motion.times[1:], POINTS_PER_STEP, endpoint=False).ravel(order="F")
        times = np.append(steps, motion.end)
        passed = slice(*np.searchsorted(self._breakpoints, times[[0, -1]], side="right"))
        inserted = np.searchsorted(times, self._breakpoints[passed])
        times = np.insert(times, inserted, self._breakpoints[passed])
        segments = np.searchsorted(self._breakpoints, times, side="right")
        segments[inserted + np.arange(inserted.size)] -= 1
        states, margins = motion(times).T, np.empty((times.size, self._units.size))
        data = np.array(self._data)[segments]
        for start in range(0, times.size, POINTS_PER_CALL):
            rows = np.minimum(
                np.arange(start, start + POINTS_PER_CALL), times.size - 1
            )  # the last point fills the call
            (values,) = self._many_margins(times[rows, None], states[rows], self._p, data[rows])
            margins[rows] = values
        return times, margins / self._units

    def _first_fall(self, motion: PhaseMotion, times: Array, margins: Array, row: int) -> float | None:
        """First time at which a margin falls through zero after it was positive; None if it does not."""
        values = margins[:, row]
        falls = np.flatnonzero((values[:-1] > ROUNDING_OF_MARGINS) & (values[1:] <= 0))
        return self._root(motion, times[falls[0]], times[falls[0] + 1], row) if falls.size else None

    def _root(self, motion: PhaseMotion, before: float, after: float, row: int) -> float:
        """Time at which a margin is zero, between two times on one segment of the control.

        At a breakpoint, which ``_along`` lists twice, both times are the same.
        """
        segment = bisect_right(self._breakpoints, before)
        if before == after:
            return before

        def margin(time: float) -> float:
            return float(self._margins_at(time, motion(np.array([time]))[:, 0], segment)[row])

        return bracketed_root(margin, before, after, TIME_TOLERANCE * self._scales.time)

    def _first_jump(self, motion: PhaseMotion, latest: float) -> float | None:
        """The first breakpoint up to ``latest`` at which a jump of the torques carries the last margin below zero."""
        for k, b in enumerate(self._breakpoints if self._may_jump else ()):
            if motion.times[0] < b <= min(latest, motion.end):
                z = motion(np.array([b]))[:, 0]
                before, after = (self._margins_at(b, z, segment)[self._ending] for segment in (k, k + 1))
                if before > ROUNDING_OF_MARGINS and after < -ROUNDING_OF_MARGINS and before - after > SMALLEST_JUMP:
                    return float(b)
        return None

    def _margins_at(self, time: float, z: Array, segment: int | None = None) -> Array:
        """All margins at a state, in natural units."""
        data = self._data[bisect_right(self._breakpoints, time) if segment is None else segment]
        (margins,) = self._margins(time, z, self._p, data)
        return np.asarray(margins / self._units)


@built_once(maxsize=64)
def _rate_and_margins(system: HybridSystem, mode: Mode) -> Function:
    flow, margins = system.flow(mode), system.margins(mode)
    inputs = flow.sx_in()
    return Function("rate_and_margins", inputs, [flow(*inputs), margins(*inputs)])
