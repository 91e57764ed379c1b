"""Multiple shooting: integrator, equations, solver, diagnosis; Newton's method alone, near a gait and far from one."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gaitopt as go
from gaitopt import Mode, Status, load_problem
from gaitopt.errors import SolveError
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.solver.assembly import assemble_steps
from gaitopt.solver.diagnosis import violations
from gaitopt.solver.interval import ORDER, integrate_to, shooting_step
from gaitopt.solver.mesh import mesh_of
from gaitopt.solver.newton import LONGEST_FIRST_STEP, Solution, integration_error, polish, solve_nearby
from gaitopt.solver.rollout import roll_out
from gaitopt.solver.shooting import MultipleShooting
from gaitopt.solver.solve import solve_gait
from gaitopt.systems import build_system

STATE = np.array([-0.1408, -0.1408, 0.0, 0.7102, -0.5168, 0.3])
PARAMETERS = np.array([1.6, 4.0, 0.8, 2.0, 9.8, np.deg2rad(1.0), 0.14])


@pytest.fixture(scope="module")
def compass() -> HybridSystem:
    return HybridSystem(CompassBiped, NoControl())


def passive(name, **overrides):
    problem = load_problem(name)
    problem = problem.replace(overrides) if overrides else problem
    return problem, HybridSystem(type(problem.walker), NoControl(), problem.impact_law)


@pytest.mark.parametrize("mode", CONTACTS)
def test_shooting_step_has_the_order_of_its_tableau(compass, mode):
    step = shooting_step(compass, mode)

    def error(h):
        exact = integrate_to(compass, mode, STATE, np.linspace(0, h, 33), PARAMETERS, np.zeros(0))[-1]
        return np.abs(np.asarray(step(STATE, 0, h, PARAMETERS, [])).ravel() - exact)[:-1].max()

    assert np.log2(error(0.3) / error(0.15)) > ORDER + 0.5


def test_breakpoints_cut_phases_into_arcs():
    sequence = load_problem("compass-passive-a").cycle
    mesh = mesh_of(sequence, [0.1, 0.6, 0.05], [0.3, 0.72])
    assert [(arc.phase, arc.segment) for arc in mesh.arcs] == [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2)]
    assert mesh.arc_times(np.array([0.1, 0.6, 0.05]))[2] == (0.3, pytest.approx(0.7))
    assert mesh.in_order(np.array([0.1, 0.61, 0.04]), [0.3, 0.72])
    assert not mesh.in_order(np.array([0.1, 0.1, 0.05]), [0.3, 0.72])
    outlasting = mesh_of(load_problem("compass-passive-stick").cycle, [0.6], [0.7])
    assert [outlasting.in_order(np.array([duration]), [0.7]) for duration in (0.65, 0.75)] == [True, False]


def test_rollout_finds_the_durations_that_a_solved_gait_has():
    problem, system = passive("compass-passive-a")
    gait = solve_gait(problem, system)
    rolled = roll_out(Dynamics(system, gait.p), problem.cycle, gait.state)
    assert np.allclose(rolled.durations, [duration for _, duration in gait.phases], atol=1e-6)


def test_error_estimate_is_the_error():
    problem, system = passive("compass-passive-stick")
    gait = solve_gait(problem, system)
    coarse = MultipleShooting(system, mesh_of(problem.cycle, [gait.period], []).refined([5]))
    fractions = np.linspace(gait.shooting.times[0], gait.shooting.times[-1], 6)
    start = coarse.pack(integrate_to(system, Mode.STICK, gait.state, fractions, gait.p, np.zeros(0)).T, [fractions[-1]])
    at = polish(Solution(coarse, start, gait.p))
    nodes, durations = integration_error(at)
    actual = gait.period - coarse.unpack(at.w)[1][0]
    assert abs(actual) > 1e-9
    assert durations[0] == pytest.approx(actual, rel=0.05)
    assert nodes[0, 0] == pytest.approx(gait.state[0] - at.w[0], rel=0.05)


@pytest.mark.parametrize("name", ["compass-passive-stick", "compass-passive-a", "compass-passive-two-step"])
def test_solution_is_right_to_its_promise(name):
    problem, system = passive(name)
    gait = solve_gait(problem, system)
    assert gait.shooting.residual < 1e-13
    assert gait.shooting.errors.max() < 1e-12


@pytest.mark.parametrize(
    ("name", "overrides", "words"),
    [
        ("compass-passive-stick", {"friction": 0.14}, r"phase 1 \(stick\), t = 0\.\d+ s: needs friction 0\.174\d?,"),
        ("rimless-wheel-slip", {"friction": 0.2}, r"impact: needs friction 0\.\d+, has 0\.2"),
        pytest.param("compass-passive-a", {"friction": 0.2}, "phase", marks=pytest.mark.slow),
    ],
)
def test_failure_says_what_hurts_in_physical_words(name, overrides, words):
    problem, system = passive(name, **overrides)
    gait = solve_gait(problem, system)
    assert gait.status in (Status.INFEASIBLE, Status.NOT_CONVERGED)
    with pytest.raises(SolveError, match="so there is no motion"):
        _ = gait.state
    assert not gait.steps
    assert re.search(words, gait.message), gait.message


def test_progress_reports_every_iteration():
    problem, system = passive("compass-passive-a")
    seen = []
    solve_gait(problem, system, progress=lambda iteration, violation: seen.append((iteration, violation)))
    assert [iteration for iteration, _ in seen] == list(range(len(seen)))
    assert seen[-1][1] < 1e-9 < seen[0][1]


def test_a_phase_that_vanishes_never_has_a_negative_duration():
    problem, system = passive("compass-passive-a")
    gait = solve_gait(problem, system)
    mesh = mesh_of(problem.cycle, [duration for _, duration in gait.phases], ())
    equations = MultipleShooting(system, mesh)
    nodes = np.repeat(gait.state[:, None], mesh.n_nodes, axis=1)
    for duration in (-1.5e-17, -1e-4):
        at = Solution(equations, equations.pack(nodes, np.array([duration, 0.6, 0.1])), gait.p)
        first = assemble_steps(at)[0].phases[0][1]
        assert first == (0 if duration > -1e-10 else pytest.approx(duration))
        assert any("duration is -0.0001 s" in cause.words for cause in violations(at)) == (first < 0)


def prepared(name):
    problem = go.load_problem(name)
    system = build_system(problem)
    p = system.values(problem.parameters)
    state = np.array([problem.guess.state[key] for key in system.state_names])
    return roll_out(Dynamics(system, p), problem.cycle, state).on_mesh()


def test_solution_is_within_twice_the_longest_first_step():
    start = prepared("compass-passive-a")
    found = solve_nearby(start)
    assert found.converged
    assert np.abs((found.w - start.w) / start.units.unknowns).max() <= 2 * LONGEST_FIRST_STEP
    assert found.size < 1e-12


@pytest.mark.parametrize("scale", [0.3, 3.0, 1e3])
def test_start_that_is_not_near_a_gait_is_left_to_ipopt(scale):
    start = prepared("compass-passive-a")
    away = np.random.default_rng(3).normal(scale=scale, size=start.w.size)
    assert not solve_nearby(replace(start, w=start.w + away)).converged
