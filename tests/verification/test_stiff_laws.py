"""Gaits under stiff control laws: every one that the simulator confirms is solved, verified and continued.

The gains kp and kd of a law are multiplied by g and the root of g, so that its damping stays. The simulator alone
follows the fixed point of its return map to the larger gains, by adaptive steps.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from named import named, solved

import gaitopt as go
from gaitopt import Cycle, Gait, Problem
from gaitopt.requests import Method
from gaitopt.simulation.simulator import Simulator
from gaitopt.solver.mesh import mesh_of
from gaitopt.solver.rollout import guessed_motion
from gaitopt.solver.solve import solve_gait
from gaitopt.systems import build_system, problem_dynamics
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.verify import confirm

LARGEST_PRODUCT = 5.9
"""Largest product at which the step of order 8 damps all that the flow damps: the half disc of its stability."""
FACTOR, SMALLEST_FACTOR = 10**0.25, 1.01
"""Factor of g from one simulated gait to the next, and its smallest value. It shrinks where the
return map has no fixed point next to the last."""


def stiffer(gait: Gait, g: float) -> dict[str, float]:
    """The gains of a gait's law times g and the root of g."""
    powers = {"kp": 1.0, "kd": 0.5}
    gains = {key: key.rpartition(".")[2] for key in gait.problem.parameters if key.startswith("control.")}
    known = gait.dynamics.parameters
    return {key: float(known[key]) * g ** powers[name] for key, name in gains.items() if name in powers}


@cache
def simulated(name: str, g: float) -> Problem:
    """The problem with gains of ``stiffer``, whose guess is the fixed point of the simulator's return map."""
    gait = named(name)
    section, state = gait.system.section(gait.problem.cycle), gait.state
    steps, gain, factor = gait.steps, 1.0, FACTOR
    while gain < g:
        stiff = min(gain * factor, g)
        return_map = ReturnMap(Simulator(gait.dynamics.at(stiffer(gait, stiff))), section, len(gait.steps), state)
        xi = state[section.indices]
        walked = return_map.damped_fixed_point(xi, np.maximum(np.abs(xi), return_map.unit / 10))
        if walked is None:
            factor = factor**0.5
            assert factor > SMALLEST_FACTOR, f"the simulator finds no gait with g = {stiff:g}"
            continue
        point = return_map.fixed_point(walked[0].arcs[0].states[0][section.indices])
        assert point.residual < 1e-10
        gain, steps, state = stiff, point.cycle.steps, point.cycle.steps[0].arcs[0].states[0]
    guess = dict(zip(gait.system.state_names, state, strict=True))
    durations = [duration for step in steps for _, duration in step.phases]
    problem = gait.problem.replace(stiffer(gait, g))
    return replace(problem.with_modes(Cycle(tuple(step.sequence for step in steps)), guess, durations), file=None)


@pytest.mark.slow
def test_first_mesh_of_a_stiff_law_takes_stable_steps():
    """Products of an interval and the fastest mode, on the first mesh and on one by lengths alone."""
    guess, first = on_first_mesh(simulated("compass-pd-impact-slip", 1000.0))
    breakpoints = first.equations.system.control.breakpoints
    second, _ = guess._sampled(mesh_of(guess.cycle, guess.durations, breakpoints), ())
    products = [
        float((at.equations.fastest_modes(at.w, at.p) * at.equations.mesh.interval_times(at.durations)[1]).max())
        for at in (first, second)
    ]
    assert products[0] < LARGEST_PRODUCT < products[1] / 2


def on_first_mesh(problem: Problem) -> tuple[Any, Any]:
    """The guess of a problem, and the same on its first mesh."""
    guess = guessed_motion(problem, problem_dynamics(problem))
    return guess, guess.on_mesh()


def test_first_mesh_of_a_passive_walker_is_that_of_its_lengths_and_the_fastest_mode_that_of_the_linearised_law():
    """Outputs of a linearising law obey y'' + kd y' + kp y = 0, here with a double root of 1000 1/s."""
    guess, at = on_first_mesh(go.load_problem("compass-passive-a"))
    assert at.equations.mesh == mesh_of(guess.cycle, guess.durations, ())
    stiff = {"control.gains.kp": 1e6, "control.gains.kd": 2e3}
    _, at = on_first_mesh(go.load_problem("compass-virtual-constraint").replace(stiff))
    assert at.equations.fastest_modes(at.w, at.p) == pytest.approx(1000, rel=0.02)


@pytest.mark.parametrize("g", [10.0, *(pytest.param(g, marks=pytest.mark.slow) for g in (100.0, 1000.0))])
def test_pd_law_with_any_gains_is_solved_from_its_fixed_point(g):
    problem = simulated("compass-pd-impact-slip", g)
    gait = solve_gait(problem, build_system(problem), method=Method.NEWTON)
    assert gait.converged, gait.message
    assert go.verify(gait).passed


@pytest.mark.parametrize("aside", [0.0, 1e-4])
def test_periodic_state_and_no_other_is_a_start_whatever_durations_are_stated(aside):
    gait = named("compass-passive-a")
    state = gait.state + aside * gait.dynamics.state_units * np.array([1, 1, 0, 1, 1, 0])
    guess = dict(zip(gait.system.state_names, state, strict=True))
    problem = gait.problem.with_modes(gait.problem.cycle, guess, [0.3, 0.1, 0.2])
    found = solve_gait(problem, gait.system, method=Method.NEWTON)
    assert found.converged is not bool(aside), found.message
    assert aside or found.state == pytest.approx(gait.state, abs=1e-10)


def test_gait_on_a_virtual_constraint_does_not_depend_on_its_gains():
    gait = named("compass-virtual-constraint")
    stiff = solved(gait.problem.replace({"control.gains.kp": 4e4, "control.gains.kd": 4e2}))
    assert stiff.state == pytest.approx(gait.state, abs=1e-9)
    assert confirm(stiff).passed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "g"),
    [
        *((name, g) for name in ("compass-virtual-constraint", "compass-virtual-constraint-slip") for g in (30.0, 1e3)),
        *(("rabbit-hzd", g) for g in (30.0, 1e3)),
        ("compass-pd-impact-slip", 1e3),
        ("rabbit-hzd-slip", 30.0),  # the simulator finds none above 37
        ("compass-table", 10.0),  # none above 11.7
        ("torso-upright", 1.6),  # none above 1.98
        *(("rabbit-tracked", g) for g in (3.0, 30.0)),
    ],
)
def test_gait_that_the_simulator_confirms_is_solved_verified_and_continued(name, g):
    problem = simulated(name, g)
    gait = solve_gait(problem, build_system(problem))
    assert gait.converged, gait.message
    check = go.verify(gait)
    assert check.passed, [claim.summary for claim in check.claims if not claim.passed]
    friction = gait.problem.friction
    family = go.continuation(gait, "friction", to=1.02 * friction, max_points=4, verify_every=1)
    assert family.points[-1].value > friction
    assert not [special for special in family.specials if special.type == "end" and "bound" in special.reason]
    assert all(point.gait.verification["passed"] for point in family.points)


@pytest.mark.slow
def test_gains_in_wrong_units_are_named_rather_than_searched():
    """Gains per degree make the law so stiff that a search on a mesh for it would take minutes."""
    gains = {"control.law": "pd", "control.gains.kp": 36 * 3283, "control.gains.kd": 12 * 3283}
    points = [-0.3, -0.38, -0.13, 1.25, 0.45, 0.4, 0.3]
    problem = go.load_problem("compass-virtual-constraint").replace(
        {"control.reference.bezier.theta2": points, **gains}
    )
    gait = solve_gait(replace(problem, file=None), build_system(problem))
    assert gait.status is go.Status.NOT_CONVERGED
    assert "too stiff for a search: its fastest mode" in gait.message
    assert "check the units of the gains" in gait.message
