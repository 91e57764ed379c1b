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
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.model.modes import Mode
from gaitopt.model.section import Section, section_of
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import StepMap

MOST_TRANSIENTS = 4
"""Largest number of transients that a walk may need until it repeats itself; near a bifurcation it settles slowly."""
AVERAGED_CYCLES = 400
"""Smallest number of cycles over which the exponent of a motion without a period is averaged, to some hundredths."""
REPEAT_DISTANCE, SAME_DISTANCE = 1e-6, 1e-3
"""Largest distances, in natural units, between states of one walk that count as repeated, and between states of two
walks that count as equal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor(ReadOnlyArrays):
    """A motion that some walks settle on.

    Attributes
    ----------
    states : ndarray, shape (n, n_xi) - section coordinates after the impacts of a cycle, or after all recorded steps of
        a motion that does not repeat itself. They are whole states if the class of the walker states no section.
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
    """The attractors of walks from given states, and the numbers of the other walks by their ending.

    Parameters
    ----------
    mapped : the return map.
    xi : ndarray, shape (n, n_xi) - section coordinates with ``dx``, or whole states.
    transient, keep : numbers of cycles that are discarded first, and that are recorded after them.
    """
    dynamics, endings, found = mapped.dynamics, Counter[str](), list[Attractor]()
    walk_on, walking = mapped.closed(np.asarray(xi, dtype=float))
    units = dynamics.state_units[mapped.indices] if mapped.is_stated else dynamics.state_units
    per_cycle = dynamics.steps_per_cycle
    for attempt in range(MOST_TRANSIENTS):
        path = np.empty((keep + 1, len(walking), len(units)))
        alive, states = np.arange(len(walking)), walking
        for step in range(-transient, keep + 1):
            if step >= 0:
                path[step, alive] = states
            if not alive.size or step == keep:
                break
            raise_if_stopped(should_stop)
            outcomes = walk_on(states)
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
                cycle = None if period is None else _slow_cycle(mapped, orbit * units, period)
                if cycle is not None:
                    orbit, period = cycle / units, len(cycle)
            if period is None and attempt < MOST_TRANSIENTS - 1:
                remaining.append(walk)
                continue
            orbit = orbit[-(period or keep) :]
            same = next((k for k, run in enumerate(found) if _same(run, orbit * units, period, per_cycle, units)), None)
            if same is not None:
                found[same] = replace(found[same], starts=found[same].starts + 1)
                continue
            length = (period or max(keep, AVERAGED_CYCLES)) * per_cycle
            rate = lyapunov(mapped, orbit[-1] * units, length, cyclic=period is not None)
            steps = None if period is None else period * per_cycle
            found.append(Attractor(states=orbit * units, period_steps=steps, lyapunov=rate, starts=1))
        walking = path[-1, remaining]
        if not len(walking):
            break
    return found, dict(endings)


def lyapunov(mapped: StepMap, point: Array, steps: int, *, cyclic: bool) -> float:
    """Largest Lyapunov exponent per step of the walk from a point of an orbit; -inf if all deviations vanish.

    Parameters
    ----------
    point : ndarray, shape (n_xi,) - section coordinates with ``dx``, or a whole state.
    steps : number of steps over which the exponent is averaged; for a cycle, its number of steps gives the exact value.
    cyclic : whether the walk is a cycle.
    """
    dynamics, simulator = mapped.dynamics, Simulator(mapped.dynamics)
    on_section = _on_section(mapped, simulator, point)
    if on_section is None:
        return np.nan
    section, z = on_section
    returns = ReturnMap(simulator, section, steps, z)
    outcome = returns(z[section.indices])
    complete = [step for step in outcome.steps if step.impact is not None]
    if cyclic and outcome.xi is not None:
        radius = float(np.abs(np.linalg.eigvals(returns.jacobian(complete))).max(initial=0.0))
        return float(np.log(radius)) / steps if radius > 0 else -np.inf
    unit, total = dynamics.state_units[:, None], 0.0
    deviation = section.tangent(complete[0].arcs[0].states[0], dynamics.p)
    for number, step in enumerate(complete):
        turn = number % len(simulator.per_step)
        deviation = returns.propagated([step], deviation, simulator.per_step[turn:])
        # an orthonormal basis in natural units, whose first direction grows the most
        basis, triangle = np.linalg.qr(deviation / unit)
        growth = abs(triangle[0, 0])
        if not 0 < growth < np.inf:
            return -np.inf if growth == 0 else np.nan
        total, deviation = total + float(np.log(growth)), basis * unit
    return total / len(complete)


def _on_section(mapped: StepMap, simulator: Simulator, point: Array) -> tuple[Section, Array] | None:
    """The section on which a point of an orbit lies, and the whole state there; None if the walk ends.

    If the sections depend on the contacts, the point is replaced by the one after a cycle of the walker.
    """
    system = simulator.system
    if mapped.is_stated:
        section = system.section(Mode.slip(point[-1]) if point[-1] else Mode.STICK)
        return section, section.lift(point[: section.indices.size], mapped.dynamics.p)
    last = simulator.run(point, steps=mapped.dynamics.steps_per_cycle).steps[-1]
    if last.impact is None:
        return None
    return section_of(system.walker, last.arcs[-1].mode, last.impact.mode, system.cycle_end), last.impact.state


def _period(orbit: Array, tolerance: float) -> int | None:
    """Number of cycles after which an orbit repeats itself, at most half of its length; None if it does not."""
    for period in range(1, len(orbit) // 2 + 1):
        if np.abs(orbit[period:] - orbit[:-period]).max() < tolerance:
            return period
    return None


def _slow_cycle(mapped: StepMap, orbit: Array, period: int) -> Array | None:
    """The stable cycle that an orbit still approaches while it seems to repeat itself.

    If an orbit spirals into a cycle and one turn takes a whole number of cycles, it seems to have the period of a turn.
    Newton's method finds the cycle in the middle of the spiral; None if it finds no stable cycle.
    """
    simulator, per_cycle = Simulator(mapped.dynamics), mapped.dynamics.steps_per_cycle
    on_section = _on_section(mapped, simulator, orbit[-1])
    if on_section is None:
        return None
    section, near = on_section
    middle = near.copy()
    middle[mapped.indices if mapped.is_stated else slice(None)] = orbit[-period:].mean(axis=0)
    point = ReturnMap(simulator, section, period * per_cycle, near).fixed_point(middle[section.indices])
    if not point.converged or point.jacobian is None or np.abs(np.linalg.eigvals(point.jacobian)).max(initial=0.0) >= 1:
        return None
    states = np.array([step.final_impact.state for step in point.cycle.steps[per_cycle - 1 :: per_cycle]])
    cycle, width = states[:, mapped.indices] if mapped.is_stated else states, np.ptp(orbit, axis=0)
    if not np.all((orbit.min(axis=0) - width <= cycle) & (cycle <= orbit.max(axis=0) + width)):
        return None
    units = mapped.dynamics.state_units[mapped.indices] if mapped.is_stated else mapped.dynamics.state_units
    return cycle[-(_period(np.vstack([cycle, cycle]) / units, REPEAT_DISTANCE) or period) :]


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
