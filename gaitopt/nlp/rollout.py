"""First guess of a cycle: the motion rolled out from a state along the given mode sequences.

The sequence is obeyed, not tested: each phase runs until the margin that should end it falls through zero. A switch
that does not come is put where its margin is closest to zero within the time of a step, a touchdown that does not
come where the walker would be at the rates with which it started.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import OdeSolution, solve_ivp
from scipy.optimize import brentq

from gaitopt.mechanics import Cycle, HybridSystem, Mode, ending_margin, margin_names, margin_unit
from gaitopt.nlp.layout import Layout
from gaitopt.nlp.trial import overflow_allowed

Array = NDArray[np.float64]

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
    system: HybridSystem,
    p: Array,
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
    scales = system.scales(p)
    longest, first_step = longest or LONGEST_STEP * scales.time, FIRST_STEP * scales.time
    starts = np.atleast_2d(state)
    time, z = 0.0, starts[0].copy()
    transit = transit_time(system, p, cycle, z)
    found: list[float] = []
    motions: list[OdeSolution] = []
    endless = None
    for phase, mode in enumerate(cycle.phases):
        if phase > 0 and cycle.impact_before(phase) is not None:
            time, step = 0.0, cycle.step_of(phase)
            known_start = step < len(starts)
            z = starts[step].copy() if known_start else after_impact(system, p, cycle.impacts[step - 1], z)
        z = np.nan_to_num(z)  # of a motion that has broken down
        if mode is Mode.STICK:
            z[-1] = 0.0
        known = None if durations is None else durations[phase]
        motion = _integrate(system, p, mode, time, z, max(longest - time, first_step) if known is None else known)
        duration = known
        if duration is None:
            end = _phase_end(system, p, cycle, phase, motion)
            endless = phase if end is None and endless is None else endless
            duration = (_lost_end(system, p, cycle, phase, motion, transit) if end is None else end) - time
        found.append(duration)
        motions.append(motion)
        time += duration
        z = motion(min(time, motion.t_max))
    return Rollout(durations=tuple(found), motions=tuple(motions), endless=endless)


def after_impact(system: HybridSystem, p: Array, mode: Mode, z: Array) -> Array:
    """State just after an impact in ``mode``, with x counted from the new stance foot; shape (n_z,)."""
    z_plus = np.asarray(system.impact(mode)(z, p)[0]).ravel()
    z_plus[system.n_shape] = 0.0
    return z_plus


def transit_time(system: HybridSystem, p: Array, cycle: Cycle, state: Array) -> float:
    """Time of a step [s] at the rates of ``state``, for the joint that would be first where an impact leads back to it.

    Where no joint has any way to go, it is the natural unit of time. Relabelling is affine, s_plus = A s_minus + b, so
    that s_minus follows from any one of its values.
    """
    n = system.n_shape
    mapped = np.asarray(system.impact(cycle.impact)(state, p)[0]).ravel()[:n]
    A = np.asarray(system.impact_jacobian(cycle.impact)(state, p))[:n, :n]
    way, rates = np.abs(np.linalg.solve(A, state[:n] - mapped)), np.abs(state[n + 1 : 2 * n + 1])
    time = system.scales(p).time
    if not np.isfinite(way).all():
        return LONGEST_STEP * time
    moving = (way > 0) & (rates > 0)
    return float(np.min(way[moving] / rates[moving], initial=LONGEST_STEP * time)) if moving.any() else time


def _integrate(system: HybridSystem, p: Array, mode: Mode, time: float, z: Array, duration: float) -> OdeSolution:
    """Motion in one mode across the control's breakpoints, until ``duration`` is over or the walker falls.

    A motion that breaks down at once stands still: what comes of it is seen by the solver.
    """
    flow, margins, scales = system.flow(mode), system.margins(mode), system.scales(p)
    data = [system.control.data(k) for k in range(len(system.control.breakpoints) + 1)]

    def segment(t: float) -> Array:
        return data[int(np.searchsorted(system.control.breakpoints, t, side="right"))]

    def rate(t: float, state: Array) -> Array:
        return np.asarray(flow(t, state, p, segment(t))).ravel()

    def upright(t: float, state: Array) -> float:
        return float(margins(t, state, p, segment(t))[1])

    upright.terminal, upright.direction = True, -1  # type: ignore[attr-defined]
    end = max(time, time + duration)
    solution = solve_ivp(
        rate,
        (time, end),
        z,
        "DOP853",
        dense_output=True,
        events=(upright, _StepLimit()),
        rtol=RTOL,
        atol=ATOL * system.state_scales(scales),
        first_step=min(FIRST_STEP * scales.time, end - time) or None,
    )
    return solution.sol if solution.sol.interpolants else _still(time, end, z)


def _still(time: float, end: float, z: Array) -> OdeSolution:
    return solve_ivp(lambda t, state: np.zeros_like(state), (time, end), z, dense_output=True).sol


class _StepLimit:
    """Event that ends an integration after too many steps; in time it falls through zero within the last one."""

    terminal, direction = True, -1

    def __init__(self) -> None:
        self._left, self._before, self._end = MOST_STEPS, -np.inf, np.inf

    def __call__(self, t: float, state: Array) -> float:
        self._left -= 1
        if self._left == 0:
            self._end = (self._before + t) / 2
        self._before = t
        return self._end - t


def _phase_end(system: HybridSystem, p: Array, cycle: Cycle, phase: int, motion: OdeSolution) -> float | None:
    """Time since impact at which the phase ends; None if its event does not come, or only after touchdown."""
    mode, after = cycle.phases[phase], cycle.after(phase)
    landing = _fall(_margin(system, p, mode, "touchdown", motion), motion)
    if after is None:
        return landing
    end = _fall(_margin(system, p, mode, ending_margin(mode, after), motion), motion)
    return None if end is None or (landing is not None and landing < end) else end


def _lost_end(system: HybridSystem, p: Array, cycle: Cycle, phase: int, motion: OdeSolution, transit: float) -> float:
    """Time since impact at which a phase that has no end is cut off."""
    mode, after, lost = cycle.phases[phase], cycle.after(phase), transit
    if after is not None:
        margin, times = _margin(system, p, mode, ending_margin(mode, after), motion), _grid(motion)
        within = times[times <= motion.ts[0] + transit]
        lost = float(within[np.argmin([abs(margin(t)) for t in within])])
    return max(lost, motion.ts[0] + SHORTEST_PHASE * transit)


def _fall(margin: Callable[[float], float], motion: OdeSolution) -> float | None:
    """First time at which a margin falls through zero after having been positive, if there is one."""
    times = _grid(motion)
    values = np.array([margin(t) for t in times])
    falls = np.flatnonzero((values[:-1] > ARMED) & (values[1:] <= 0))
    return float(brentq(margin, times[falls[0]], times[falls[0] + 1])) if falls.size else None


def _grid(motion: OdeSolution) -> Array:
    steps = np.linspace(motion.ts[:-1], motion.ts[1:], GRID, endpoint=False).ravel(order="F")
    return np.append(steps, motion.t_max)


def _margin(system: HybridSystem, p: Array, mode: Mode, name: str, motion: OdeSolution) -> Callable[[float], float]:
    """One margin of a mode along a motion, in natural units."""
    unit = margin_unit(name, system.scales(p))
    row, breakpoints = margin_names(mode).index(name), system.control.breakpoints

    def margin(t: float) -> float:
        data = system.control.data(int(np.searchsorted(breakpoints, t, side="right")))
        return float(system.margins(mode)(t, motion(t), p, data)[row]) / unit

    return margin
