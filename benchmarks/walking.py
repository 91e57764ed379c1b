"""Walking steps, multipliers and gaits: the plain way, the engines, and batches."""

import time
from functools import partial

import numpy as np
from plain import PlainCompass
from reuse import solve_anew
from timing import Row, compared, watched_memory

from gaitopt import load_problem, return_map, solve
from gaitopt.gait.gait import Gait
from gaitopt.model.modes import Mode
from gaitopt.requests import Engine
from gaitopt.simulation.heyoka_stepper import HeyokaStepper
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import step_map

ENGINES = {"scipy": ScipyStepper, "heyoka": HeyokaStepper}

BATCH = 8192
SPREAD = 0.02
"""Relative spread of a batch around the gait, so that every state walks a step of the same kind."""


def plain_walker(gait: Gait) -> PlainCompass:
    """The same walker without gaitopt."""
    walker = gait.problem.walker
    names = ("leg_length", "leg_mass", "leg_com", "hip_mass", "gravity", "slope")
    return PlainCompass(**{name: getattr(walker, name) for name in names}, friction=gait.problem.friction)


def step_rows(gait: Gait, plain: PlainCompass) -> list[Row]:
    """One stick-slip step with all its events; how far the period is off by extended precision."""
    exact = Simulator(gait.dynamics, partial(HeyokaStepper, precision=np.longdouble)).step(gait.state).step.period
    error = abs(plain.step(gait.state)[1] - exact)
    ways = {"plain: solve_ivp, NumPy": (lambda: plain.step(gait.state), f"period off by {error:.0e} s")}
    for name, kind in ENGINES.items():
        simulator = Simulator(gait.dynamics, kind)
        error = abs(simulator.step(gait.state).step.period - exact)
        ways[name] = (partial(simulator.step, gait.state), f"period off by {error:.0e} s")
    xi = near(gait, BATCH)
    rounded = step_map(gait.problem, tuple(gait.p.tolist()), Engine.HEYOKA)
    found = compared("a stick-slip step", ways)
    (_, batch) = compared(
        "", {"": next(iter(ways.values())), "heyoka, batch on one core": (partial(rounded, xi), "")}, each=1
    )
    seconds = batch.seconds / BATCH
    note = f"{BATCH} states around the gait"
    return [
        *found,
        Row(what=found[0].what, way=batch.way, seconds=seconds, ratio=found[0].seconds / seconds, note=note),
    ]


def near(gait: Gait, count: int) -> np.ndarray:
    """Section coordinates spread around a gait."""
    xi = gait.state[gait.system.section(Mode.SLIP_FORWARD)]
    return xi * (1 + np.random.default_rng(1).uniform(-SPREAD, SPREAD, (count, xi.size)))


def multiplier_rows(gait: Gait, plain: PlainCompass) -> list[Row]:
    """Floquet multipliers of a gait: central differences against the variational equations, their step included."""
    xi = gait.state[gait.system.section(gait.problem.cycle.impact)]
    ways = {"plain: central differences": (lambda: plain.multipliers(xi), "")}
    for name, kind in ENGINES.items():
        simulator = Simulator(gait.dynamics, kind)
        returns = ReturnMap(simulator, gait.problem.cycle.impact)

        def multipliers(returns: ReturnMap = returns) -> np.ndarray:
            return np.linalg.eigvals(returns.jacobian(returns(xi).steps))

        ways[name] = (multipliers, "variational equations")
    return compared("multipliers of a gait", ways)


def gait_rows(gait: Gait, plain: PlainCompass) -> list[Row]:
    """A gait from its guess: fsolve on the simulated step against Newton's method on the shooting equations."""
    problem = gait.problem
    guess = np.array([problem.guess.state[name] for name in problem.walker.section_names(slipping=False)])
    ways = {
        "plain: fsolve": (lambda: plain.gait(guess), "the state alone"),
        "gaitopt.solve, mesh new": (lambda: solve_anew(problem), "with error estimate and multipliers"),
        "gaitopt.solve, mesh known": (lambda: solve(problem), ""),
    }
    return compared("a gait from its guess", ways, rounds=2)


def million_rows(gait: Gait, count: int, workers: int) -> list[Row]:
    """One step of each of many states of a basin, anywhere on a grid around the gait."""
    problem = gait.problem
    rng = np.random.default_rng(2)
    centre = gait.state[gait.system.section(Mode.STICK)]
    xi = centre * (1 + rng.uniform(-0.5, 0.5, (count, centre.size)))
    return_map(problem, xi[:64], engine="heyoka")
    with watched_memory() as memory:
        began = time.perf_counter()
        returned = return_map(problem, xi, engine="heyoka", workers=workers)
        seconds = time.perf_counter() - began
    note = f"{returned.completed.mean():.0%} completed their step; at most {memory.together / 1e9:.2f} GB in all"
    way = f"heyoka, batch, {workers} worker{'s, their start included' if workers > 1 else ''}"
    return [Row(what=f"{count:,} states of a basin, one step each", way=way, seconds=seconds, note=note)]


def rows(count: int, workers: int) -> list[Row]:
    """All of them."""
    gait = solve(load_problem("compass-passive-a"))
    plain = plain_walker(gait)
    found = [*step_rows(gait, plain), *multiplier_rows(gait, plain), *gait_rows(gait, plain)]
    return [*found, *million_rows(gait, count // 10, 1), *million_rows(gait, count, workers)]
