"""First guess of a cycle: the motion rolled out from a state along the given mode sequences.

The sequence is obeyed, not tested: each phase runs until the margin that should end it falls through zero. A switch
that does not come is put where its margin is closest to zero within the time of a step, a touchdown that does not
come where the walker would be at the rates with which it started.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import OdeSolution, solve_ivp
from scipy.optimize import brentq

from gaitopt.arrays import Array
from gaitopt.mechanics import Cycle, Dynamics, Mode, ending_margin, margin_names, margin_unit
from gaitopt.mechanics.buffered import BufferedFunction
from gaitopt.nlp.layout import Layout
from gaitopt.nlp.trial import overflow_allowed

RTOL, ATOL = 1e-8, 1e-10
"""A guess needs no more; the absolute one in natural units."""
GRID = 8
"""Points per step of the integrator on which the end of a phase is looked for."""
ARMED = 1e-12
"""In natural units; a margin that starts at zero, up to rounding, is not yet positive."""
FIRST_STEP = 2.5e-5
"""In natural units; short enough not to jump over a slip that has only just come into being."""
LONGEST_STEP = 50.0
"""In natural units of time, 20 s for legs of 1.6 m: no walker takes longer over a step."""
MOST_STEPS = 3000
"""Of the integrator in one phase: the longest step takes some hundreds."""
SHORTEST_PHASE = 0.05
"""Part of a step for a phase whose end is not found, and for which no time seems to be left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """Durations of the phases [s] and the motion of each as a function of the time since the last impact.

    ``endless`` is the first phase whose end did not come, None if all did.
    """

    durations: tuple[float, ...]
    motions: tuple[OdeSolution, ...]
    endless: int | None = None

    @property
    def period(self) -> float:
        """Time of the whole cycle [s]; zero where the walker falls at once."""
        return float(sum(self.durations))

    def __call__(self, phase: int, times: Array) -> Array:
        """States in one phase at times since impact, after a fall those of the fall; shape (n_z, n)."""
        motion = self.motions[phase]
        return np.asarray(motion(np.minimum(times, motion.t_max)))

    def nodes(self, plan: Layout) -> Array:
        """States at the shooting nodes of a layout; shape (n_z, K + 1)."""
        times = plan.arc_times(np.array(self.durations))
        arcs = [
            self(arc.phase, np.linspace(begin, end, arc.intervals + 1))
            for arc, (begin, end) in zip(plan.arcs, times, strict=True)
        ]
        nodes = np.empty((arcs[0].shape[0], plan.n_nodes))
        for first, states in zip(plan.first_nodes, arcs, strict=True):
            nodes[:, first : first + states.shape[1]] = states
        return nodes


@overflow_allowed()
def roll_out(
    dynamics: Dynamics,
    cycle: Cycle,
    state: Array,
    durations: Sequence[float] | Array | None = None,
    longest: float | None = None,
) -> Rollout:
    """Follow ``cycle`` from ``state`` just after an impact; given durations are kept, missing ones are found.

    ``state`` is that of the first step, shape (n_z,), or those with which the first steps start, shape (k, n_z): where
    durations are kept, errors of one step would grow in the next ones. No phase whose end is looked for lasts beyond
    ``longest`` after the impact [s], ``LONGEST_STEP`` unless given.
    """
    scales, walker = dynamics.scales, dynamics.system.walker
    longest, first_step = longest or LONGEST_STEP * scales.time, FIRST_STEP * scales.time
    starts = np.atleast_2d(state)

    def in_step(step: int) -> Dynamics:
        return dynamics.standing(walker.side(step))

    time, z = 0.0, starts[0].copy()
    found: list[float] = []
    motions: list[OdeSolution] = []
    endless = None
    for phase, mode in enumerate(cycle.phases):
        impact = cycle.impact_before(phase) if phase > 0 else None
        if impact is not None:
            step = cycle.step_of(phase)
            known_start = phase in cycle.first_phases and step < len(starts)
            landing = in_step(cycle.step_of(phase - 1))
            z = starts[step].copy() if known_start else landing.after_impact(impact, z)
            time = time if impact.locked else 0.0
        z = np.nan_to_num(z)  # of a motion that has broken down
        if mode.sticks:
            z[-1] = 0.0
        flow = _ModeFlow(in_step(cycle.step_of(phase)), mode, cycle.after(phase))
        duration = None if durations is None else durations[phase]
        if duration is None:
            motion = flow.integrate(time, z, max(longest - time, first_step), until_end=True)
            end = flow.end(motion)
            if end is None:
                endless = phase if endless is None else endless
                end = flow.lost_end(motion, transit_time(dynamics, cycle, starts[0]))
            duration = end - time
        else:
            motion = flow.integrate(time, z, duration, until_end=False)
        found.append(duration)
        motions.append(motion)
        time += duration
        z = motion(min(time, motion.t_max))
    return Rollout(durations=tuple(found), motions=tuple(motions), endless=endless)


def transit_time(dynamics: Dynamics, cycle: Cycle, state: Array) -> float:
    """Time of a step [s] at the rates of ``state``, for the joint that would be first where an impact leads back to it.

    Where no joint has any way to go, it is the natural unit of time. Relabelling is affine, s_plus = A s_minus + b, so
    that s_minus follows from any one of its values, unless the walker itself says how its massless feet land.
    """
    system, p, time = dynamics.system, dynamics.p, dynamics.scales.time
    if system.walker.massless_feet:
        return time
    n, rates = len(system.walker.shape), np.abs(state[system.n_shape + 1 :])
    mapped = dynamics.after_impact(cycle.impact, state)[:n]
    A = np.asarray(system.impact_jacobian(cycle.impact)(state, p))[:n, :n]
    way, rates = np.abs(np.linalg.solve(A, state[:n] - mapped)), rates[:n]
    if not np.isfinite(way).all():
        return LONGEST_STEP * time
    moving = (way > 0) & (rates > 0)
    return float(np.min(way[moving] / rates[moving], initial=LONGEST_STEP * time)) if moving.any() else time


class _ModeFlow:
    """Motion in one mode at fixed parameters, across the control's breakpoints, and the margin that ends its phase."""

    def __init__(self, dynamics: Dynamics, mode: Mode, after: Mode | None) -> None:
        system = dynamics.system
        self._flow, self._margins = BufferedFunction(system.flow(mode)), BufferedFunction(system.margins(mode))
        for function in (self._flow, self._margins):
            function.inputs[2][:] = dynamics.p
        self._scales = dynamics.scales
        self._tolerances = ATOL * dynamics.state_units
        names = margin_names(mode)
        self._units = [margin_unit(name, self._scales) for name in names]
        self._upright, self._touchdown = names.index("upright"), 0  # or the clearance, while a stop is free
        self._ending = names.index(ending_margin(mode, after))
        self._breakpoints = system.control.breakpoints
        self._data = [system.data(k) for k in range(len(self._breakpoints) + 1)]

    def integrate(self, time: float, z: Array, duration: float, *, until_end: bool) -> OdeSolution:
        """The motion until ``duration`` is over, the walker falls or, ``until_end``, the phase has ended.

        A motion that breaks down at once stands still: what comes of it is seen by the solver.
        """
        end = max(time, time + duration)
        solution = solve_ivp(
            self._rate,
            (time, end),
            z,
            "DOP853",
            dense_output=True,
            events=(_Falls(self), _FarEnough(self if until_end else None)),
            rtol=RTOL,
            atol=self._tolerances,
            first_step=min(FIRST_STEP * self._scales.time, end - time) or None,
        )
        return solution.sol if solution.sol.interpolants else _still(time, end, z)

    def end(self, motion: OdeSolution) -> float | None:
        """Time since impact at which the phase ends; None if its event does not come, or only after touchdown."""
        landing = self._fall(motion, self._touchdown)
        if self._ending == self._touchdown:
            return landing
        end = self._fall(motion, self._ending)
        return None if end is None or (landing is not None and landing < end) else end

    def lost_end(self, motion: OdeSolution, transit: float) -> float:
        """Time since impact at which a phase that has no end is cut off."""
        lost = transit
        if self._ending != self._touchdown:
            times = _grid(motion)
            within = times[times <= motion.ts[0] + transit]
            lost = float(within[np.argmin(np.abs(self._along(motion, within, self._ending)))])
        return max(lost, motion.ts[0] + SHORTEST_PHASE * transit)

    def upright(self, t: float, z: Array) -> float:
        """The margin whose end is a fall."""
        return self._margin(t, z, self._upright)

    def ends(self, t: float, z: Array) -> tuple[float, float]:
        """The margin that ends the phase, and that of a touchdown which should not."""
        ending = self._margin(t, z, self._ending)
        return ending, np.inf if self._ending == self._touchdown else self._margin(t, z, self._touchdown)

    def _fall(self, motion: OdeSolution, row: int) -> float | None:
        """First time at which a margin falls through zero after having been positive, if there is one."""
        times = _grid(motion)
        values = self._along(motion, times, row)
        falls = np.flatnonzero((values[:-1] > ARMED) & (values[1:] <= 0))
        if not falls.size:
            return None
        return float(brentq(lambda t: self._margin(t, motion(t), row), times[falls[0]], times[falls[0] + 1]))

    def _along(self, motion: OdeSolution, times: Array, row: int) -> Array:
        return np.array([self._margin(t, z, row) for t, z in zip(times.tolist(), motion(times).T, strict=True)])

    def _margin(self, t: float, z: Array, row: int) -> float:
        """One margin in natural units."""
        self._evaluate(self._margins, t, z)
        return float(self._margins.outputs[0][row]) / self._units[row]

    def _rate(self, t: float, z: Array) -> Array:
        self._evaluate(self._flow, t, z)
        return self._flow.outputs[0].copy()

    def _evaluate(self, function: BufferedFunction, t: float, z: Array) -> None:
        time, state, _, data = function.inputs
        time[0], state[:], data[:] = t, z, self._data[bisect_right(self._breakpoints, t)]
        function.evaluate()


def _still(time: float, end: float, z: Array) -> OdeSolution:
    return solve_ivp(lambda t, state: np.zeros_like(state), (time, end), z, dense_output=True).sol


class _Falls:
    """Event that ends an integration where the walker falls."""

    terminal, direction = True, -1

    def __init__(self, flow: _ModeFlow) -> None:
        self._flow = flow

    def __call__(self, t: float, state: Array) -> float:
        return self._flow.upright(t, state)


class _FarEnough:
    """Event that ends an integration after too many steps, or one step after the phase of ``flow`` has ended.

    In time it falls through zero within the last step. Where touchdown comes before the event that should end the
    phase, the motion goes on: its end will be put elsewhere.
    """

    terminal, direction = True, -1

    def __init__(self, flow: _ModeFlow | None) -> None:
        self._flow, self._armed = flow, np.zeros(2, dtype=bool)
        self._left, self._before, self._end = MOST_STEPS, -np.inf, np.inf

    def __call__(self, t: float, state: Array) -> float:
        self._left -= 1
        if self._left == 0:
            self._end = (self._before + t) / 2
        elif self._left > 0 and self._flow is not None:
            margins = np.array(self._flow.ends(t, state))
            ended, landed = self._armed & (margins <= 0)
            self._armed |= margins > ARMED
            if landed:
                self._flow = None
            elif ended:
                self._left = 1
        self._before = t
        return self._end - t


def _grid(motion: OdeSolution) -> Array:
    steps = np.linspace(motion.ts[:-1], motion.ts[1:], GRID, endpoint=False).ravel(order="F")
    return np.append(steps, motion.t_max)
