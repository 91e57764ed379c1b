"""Random steps of walkers with several contacts against slow simulators without modes and events, of first order.

A step is compared if it is away from edges of modes by a margin: the finer time step either resolves an arc, or is too
coarse for it, but nothing between. The sequences of the arcs that it resolves are the same.
"""

from collections.abc import Callable
from itertools import groupby

import numpy as np
import pytest
from contact_walkers import ContactCase, crawler, heel_toe, inchworm
from time_stepping import bounce, walk

from gaitopt import load_problem
from gaitopt.model.dynamics import Dynamics
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics

Array = np.ndarray
LASTS = 0.02
"""Least duration of an arc relative to its step, unless it lasts less than a third of this."""
STEPS = (200, 2000)
"""Time steps of the slow simulator; its error falls with their number."""
FALLS = 0.5
"""Largest error of the finer time step relative to that of the coarser one; where events lie in a step spreads it."""
FIRST_ORDER = 0.2
"""Largest geometric mean of these ratios: 1/10 at first order, and 0.32 at order 1/2."""


def slowly(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


def compared(
    dynamics: Dynamics,
    starts: Callable[[np.random.Generator], Array],
    n: int,
    stepped: Callable[..., tuple],
    *,
    lasts: float = LASTS,
    steps: tuple[int, int] = STEPS,
    massless: bool = False,
) -> None:
    """Compare n random steps; ``stepped`` gives coordinates and rates (shape, x, y) and what the contacts did."""
    rng, simulator, done, errors = np.random.default_rng(3), Simulator(dynamics), 0, []
    for _ in range(40 * n):
        z = starts(rng)
        step = simulator.step(z).step
        if step is None or step.impact is None:
            continue
        if any(lasts / 3 < arc.duration / step.period < lasts for arc in step.arcs):
            continue
        end = 0.99 * step.arcs[-1].end  # in front of the impact
        last = step.arcs[-1]
        at_end = simulator.stepper.sample(last.mode, last.segment, last.states[0], np.array([last.start, end]))[-1]
        exact, size = by_coordinate(at_end), by_coordinate(dynamics.state_units)
        if massless:  # the legs follow from the body
            walker = dynamics.system.walker
            body = [k for k, name in enumerate(2 * (*walker.shape, "x", "y")) if name not in walker.lengths]
            exact, size = exact[body], size[body]
        for count in steps:
            q, v, history = stepped(z, end, count)
            errors.append(np.abs((np.concatenate([q, v]) - exact) / size).max())
        assert errors[-1] < 0.01
        resolved = [
            arc.mode.touching if massless else tuple(arc.mode.contacts.values())
            for arc in step.arcs
            if arc.duration > lasts * step.period
        ]
        runs = ((word, len([*times])) for word, times in groupby(history))
        lasting = [word for word, length in runs if length > lasts * count * 2 / 3]
        assert [word for word, _ in groupby(lasting)] == [word for word, _ in groupby(resolved)]
        done += 1
        if done == n:
            break
    assert done == n
    coarse, fine = np.array(errors).reshape(-1, 2).T
    assert np.all(fine < FALLS * coarse), fine / coarse
    assert np.exp(np.log(fine / coarse).mean()) < (FIRST_ORDER if n > 1 else FALLS), fine / coarse


def by_coordinate(z: Array) -> Array:
    """A state (shape, y, x, rates) as (shape, x, y) and rates."""
    n = len(z) // 2
    order = [*range(n - 2), n - 1, n - 2]
    return np.concatenate([z[:n][order], z[n:][order]])


def rigid(case: ContactCase, friction: dict[str, float], **options) -> Callable[..., tuple]:
    def stepped(z: Array, end: float, count: int) -> tuple:
        start = by_coordinate(z)
        n = len(start) // 2
        return walk(case.oracle, case.points, friction, (start[:n], start[n:]), end, count, **options)

    return stepped


@pytest.mark.parametrize(("friction", "n"), [(0.3, 1), slowly(0.3, 4), slowly(0.26, 4)])
def test_random_steps_over_heel_and_toe(friction: float, n: int) -> None:
    case = heel_toe()

    def starts(rng: np.random.Generator) -> Array:
        q = np.array([-0.295, -0.317, 0, 0]) + np.array([0.02, 0.02, 0, 0]) * rng.uniform(-1, 1, 4)
        dq = np.array([1.156, -0.344, 0, 0]) + np.array([0.1, 0.1, 0, 0]) * rng.uniform(-1, 1, 4)
        q[3] -= case.points["heel"].position(q)[1]
        dq[2:] -= case.points["heel"].velocity(q, dq)
        return case.state(q, dq)

    def counts(name: str, q: Array) -> bool:
        return not name.startswith("swing") or q[0] > 0.05

    stepped = rigid(case, dict.fromkeys(case.points, friction), counts=counts)
    compared(case.dynamics(friction), starts, n, stepped, steps=(100, 1000))


@pytest.mark.parametrize("n", [1, slowly(5)])
def test_random_steps_of_a_crawler(n: int) -> None:
    dynamics = problem_dynamics(load_problem("crawler"))
    c = load_problem("crawler").walker

    def starts(rng: np.random.Generator) -> Array:
        return np.array([rng.uniform(0.3, 0.6), 0, 0, 0, rng.uniform(-0.5, 0.5), 0, 0, rng.uniform(-0.3, 0.3)])

    def force(t: float, q: Array, v: Array) -> Array:
        drive = 4.95 if t < 1 else -4.95
        return np.array([drive - c.stiffness * (q[0] - c.rest) - c.damping * v[0], 0, 0, 0])

    compared(dynamics, starts, n, rigid(crawler(c), {"rear": 0.6, "front": 0.4}, force=force))


@pytest.mark.slow
def test_random_steps_of_an_inchworm() -> None:
    """Phases of one or two thousandths of the period remain unresolved."""
    dynamics = problem_dynamics(load_problem("inchworm"))
    walker = load_problem("inchworm").walker

    def starts(rng: np.random.Generator) -> Array:
        angle, rate, slip = rng.uniform([0.55, -1, -0.3], [0.65, 1, 0.3])
        y, dy = walker.link_length * np.array([np.cos(angle), -np.sin(angle) * rate])
        return np.array([angle, angle, y, 0, rate, rate, dy, slip])

    def force(t: float, q: Array, v: Array) -> Array:
        error = 1.2 + 0.3 * np.sin(2 * np.pi * t) - q[0] - q[1]
        torque = 30 * error + 0.6 * (0.6 * np.pi * np.cos(2 * np.pi * t) - v[0] - v[1])
        return np.array([torque, torque, 0, 0])

    friction = {"rear": 0.5, "front": 0.4}
    compared(dynamics, starts, 3, rigid(inchworm(walker), friction, force=force), lasts=0.006, steps=(400, 4000))


@pytest.mark.parametrize("n", [2, slowly(10)])
def test_random_steps_of_spring_mass_walking(n: int) -> None:
    """Its feet have no mass, so that friction moves nothing: they hold, or the motion ends."""
    dynamics = problem_dynamics(load_problem("slip-walk"))
    w, usual = load_problem("slip-walk").walker, load_problem("slip-walk").guess.state
    placed = w.leg_length * np.array([np.cos(w.attack), -np.sin(w.attack)])

    def starts(rng: np.random.Generator) -> Array:
        back, dy, dx = np.array([usual[name] for name in ("back_x", "dy", "dx")]) * rng.uniform(0.9, 1.1, 3)
        return np.array([*placed, back, placed[1], -placed[1], 0, -dx, -dy, -dx, -dy, dy, dx])

    def stepped(z: Array, end: float, count: int) -> tuple:
        body = np.array([0, z[4], 0]), np.array([z[-1], z[-2], 0])
        feet = {"front": np.array([placed[0], 0]), "back": np.array([z[2], 0])}
        angle = np.pi / 2 - w.attack
        legs = w.leg_length, w.stiffness, {"front": angle, "back": angle}
        q, v, history = bounce(w.mass, 1.0, {"front": 0.0, "back": 0.0}, legs, (*body, feet), end, count)
        return q[:2], v[:2], history

    compared(dynamics, starts, n, stepped, steps=(500, 5000), massless=True)


@pytest.mark.parametrize("name", ["bounding", "bounding-overlap"])
def test_random_bounds(name: str) -> None:
    problem = load_problem(name)
    dynamics, w = problem_dynamics(problem), problem.walker
    names, angles = dynamics.system.state_names, {"front": w.front_angle, "back": w.back_angle}
    usual = np.array([problem.guess.state[key] for key in names])

    def starts(rng: np.random.Generator) -> Array:
        return usual * (1 + 0.02 * rng.uniform(-1, 1, len(names)))

    def stepped(z: Array, end: float, count: int) -> tuple:
        at = dict(zip(names, z, strict=True))
        body = np.array([0, at["y"], at["pitch"]]), np.array([at["dx"], at["dy"], at["dpitch"]])
        legs, hips = (w.leg_length, w.stiffness, angles), {"front": w.hip, "back": -w.hip}
        q, v, history = bounce(w.mass, w.inertia, hips, legs, (*body, {}), end, count)
        return q[[2, 0, 1]], v[[2, 0, 1]], history

    compared(dynamics, starts, 3, stepped, steps=(500, 5000), massless=True)
