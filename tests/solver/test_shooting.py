"""Multiple shooting: integrator, error estimate, progress and diagnosis."""

import numpy as np
import pytest

from gaitopt import Mode, load_problem
from gaitopt.model.control import NoControl
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.solver.assembly import assemble_steps
from gaitopt.solver.diagnosis import violations
from gaitopt.solver.interval import ORDER, integrate_to, shooting_step
from gaitopt.solver.mesh import mesh_of
from gaitopt.solver.newton import Solution, integration_error, polish
from gaitopt.solver.shooting import MultipleShooting
from gaitopt.solver.solve import solve_gait

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
        assert any("duration is -0.0001 s" in cause.description for cause in violations(at)) == (first < 0)
