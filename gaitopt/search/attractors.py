"""Attractors of walks: cycles, tori and chaos, found by walking from many states, with their Lyapunov exponents.

    lambda = lim (1/n) log |DP^n v|          for a cycle of m steps: log(largest |multiplier|) / m

lambda is the largest exponent per step: negative for a stable cycle, zero on a torus and at a bifurcation, positive for
chaos. The variational equations and the saltation at every event propagate the deviation v along the walk.

References
----------
Benettin, Galgani, Giorgilli & Strelcyn (1980), Meccanica 15, 9-20.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.callbacks import Stop
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import StepMap

MOST_TRANSIENTS = 4
"""Largest number of transients that a walk may need until it repeats itself; near a bifurcation it settles slowly."""
AVERAGED_CYCLES = 400
"""The exponent of a motion without a period is averaged over at least this many cycles, to some hundredths."""
REPEAT_DISTANCE, SAME_DISTANCE = 1e-6, 1e-3
"""Largest distances, in natural units, between states of one walk that count as repeated, and between states of two
walks that count as equal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor(ReadOnlyArrays):
    """A motion that some walks settle on.

    Attributes
    ----------
    states : ndarray, shape (n, n_xi) - section coordinates after the impacts of a cycle, or after all recorded steps of
        a motion that does not repeat itself.
    period_steps : number of steps of the cycle; None if the motion does not repeat itself.
    lyapunov : largest Lyapunov exponent per step.
    starts : number of walks that settle on it.
    """

    states: Array
    period_steps: int | None
    lyapunov: float
    starts: int


def settled(
    mapped: StepMap, xi: Array, *, transient: int, keep: int, should_stop: Stop = None
) -> tuple[list[Attractor], dict[str, int]]:
    """The attractors of walks from given states, and how many of the other walks have which ending.

    Parameters
    ----------
    mapped : the return map.
    xi : ndarray, shape (n, n_xi) - section coordinates with ``dx``.
    transient, keep : numbers of cycles that are discarded first, and that are recorded after them.
    """
    dynamics, endings, found = mapped.dynamics, Counter[str](), list[Attractor]()
    units = dynamics.state_units[dynamics.system.section(Mode.SLIP_FORWARD).indices]
    per_cycle, walking = dynamics.system.walker.steps_per_cycle(), np.asarray(xi, dtype=float)
    for attempt in range(MOST_TRANSIENTS):
        path = np.empty((keep + 1, len(walking), len(units)))
        alive, states = np.arange(len(walking)), walking
        for step in range(-transient, keep + 1):
            if step >= 0:
                path[step, alive] = states
            if not alive.size or step == keep:
                break
            if should_stop is not None and should_stop():
                raise KeyboardInterrupt
            outcomes = mapped(states)
            endings.update(str(name) for name in outcomes.outcomes[~outcomes.completed])
            alive, states = alive[outcomes.completed], outcomes.states[outcomes.completed]
        remaining = list[int]()
        for walk in alive.tolist():
            orbit = path[:, walk] / units
            period = _period(orbit, REPEAT_DISTANCE)
            if period is not None and _closest(orbit[-period:]) < SAME_DISTANCE:  # still approaching a shorter cycle
                period = None
            if attempt == MOST_TRANSIENTS - 1 and period is None:
                period = _period(orbit, SAME_DISTANCE)
                cycle = None if period is None else _slow_cycle(dynamics, orbit, period)
                if cycle is not None:
                    orbit, period = cycle, len(cycle)
            if period is None and attempt < MOST_TRANSIENTS - 1:
                remaining.append(walk)
                continue
            orbit = orbit[-(period or keep) :]
            same = next((k for k, run in enumerate(found) if _same(run, orbit * units, period, per_cycle, units)), None)
            if same is not None:
                found[same] = replace(found[same], starts=found[same].starts + 1)
                continue
            length = (period or max(keep, AVERAGED_CYCLES)) * per_cycle
            rate = lyapunov(dynamics, orbit[-1] * units, length, cyclic=period is not None)
            steps = None if period is None else period * per_cycle
            found.append(Attractor(states=orbit * units, period_steps=steps, lyapunov=rate, starts=1))
        walking = path[-1, remaining]
        if not len(walking):
            break
    return found, dict(endings)


def lyapunov(dynamics: Dynamics, xi: Array, steps: int, *, cyclic: bool) -> float:
    """Largest Lyapunov exponent per step of the walk from section coordinates; -inf if all deviations vanish.

    Parameters
    ----------
    xi : ndarray, shape (n_xi,) - section coordinates with ``dx``.
    steps : number of steps over which the exponent is averaged; for a cycle, its number of steps gives the exact value.
    cyclic : whether the walk is a cycle.
    """
    mode = Mode.STICK if xi[-1] == 0 else Mode.SLIP_FORWARD if xi[-1] > 0 else Mode.SLIP_BACKWARD
    simulator = Simulator(dynamics)
    mapped = ReturnMap(simulator, mode, steps)
    outcome = mapped(xi if mode.slips else xi[:-1])
    complete = [step for step in outcome.steps if step.impact is not None]
    if cyclic and outcome.xi is not None:
        radius = float(np.abs(np.linalg.eigvals(mapped.jacobian(complete))).max(initial=0.0))
        return float(np.log(radius)) / steps if radius > 0 else -np.inf
    unit, total = dynamics.state_units[:, None], 0.0
    deviation = mapped.section.tangent(complete[0].arcs[0].states[0], dynamics.p)
    for number, step in enumerate(complete):
        turn = number % len(simulator.per_step)
        deviation = mapped.propagated([step], deviation, simulator.per_step[turn:])
        # an orthonormal basis in natural units, whose first direction grows the most
        basis, triangle = np.linalg.qr(deviation / unit)
        growth = abs(triangle[0, 0])
        if not 0 < growth < np.inf:
            return -np.inf if growth == 0 else np.nan
        total, deviation = total + float(np.log(growth)), basis * unit
    return total / len(complete)


def _period(orbit: Array, tolerance: float) -> int | None:
    """Number of cycles after which an orbit repeats itself, at most half of its length; None if it does not."""
    for period in range(1, len(orbit) // 2 + 1):
        if np.abs(orbit[period:] - orbit[:-period]).max() < tolerance:
            return period
    return None


def _slow_cycle(dynamics: Dynamics, orbit: Array, period: int) -> Array | None:
    """The stable cycle that an orbit, in natural units, still approaches while it seems to repeat itself.

    If an orbit spirals into a cycle and one turn takes a whole number of cycles, it seems to have the period of a turn.
    Newton's method finds the cycle in the middle of the spiral; None if it finds no stable cycle.
    """
    units = dynamics.state_units[dynamics.system.section(Mode.SLIP_FORWARD).indices]
    slips = orbit[-1, -1] != 0
    mode = Mode.STICK if not slips else Mode.slip(orbit[-1, -1])
    n, per_cycle = orbit.shape[1] - (not slips), dynamics.system.walker.steps_per_cycle()
    mapped = ReturnMap(Simulator(dynamics), mode, period * per_cycle)
    point = mapped.fixed_point(orbit[-period:].mean(axis=0)[:n] * units[:n])
    if not point.converged or point.jacobian is None or np.abs(np.linalg.eigvals(point.jacobian)).max(initial=0.0) >= 1:
        return None
    states = [step.final_impact.state for step in point.cycle.steps[per_cycle - 1 :: per_cycle]]
    cycle = np.array(states)[:, dynamics.system.section(Mode.SLIP_FORWARD).indices] / units
    width = np.ptp(orbit, axis=0)
    if not np.all((orbit.min(axis=0) - width <= cycle) & (cycle <= orbit.max(axis=0) + width)):
        return None
    return cycle[-(_period(np.vstack([cycle, cycle]), REPEAT_DISTANCE) or period) :]


def _closest(states: Array) -> float:
    """Smallest distance between two states of a cycle; infinite for a single state."""
    apart = np.abs(states[:, None] - states[None]).max(axis=2)
    return float(apart[~np.eye(len(states), dtype=bool)].min(initial=np.inf))


def _same(run: Attractor, states: Array, period: int | None, per_cycle: int, units: Array) -> bool:
    """Whether an orbit is that of ``run``; orbits that do not repeat themselves are equal if their ranges overlap."""
    if run.period_steps != (None if period is None else period * per_cycle):
        return False
    if period is None:
        return bool(np.all((run.states.min(0) <= states.max(0)) & (states.min(0) <= run.states.max(0))))
    shifted = (np.roll(states, k, axis=0) for k in range(len(states)))
    return min(float(np.abs((run.states - other) / units).max()) for other in shifted) < SAME_DISTANCE
