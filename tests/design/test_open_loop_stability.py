"""The bound on the multipliers of open-loop optima: against multiple shooting, central differences and designs."""

import numpy as np
import pytest
from named import solved
from open_loop import COMPASS, solved_by_casadi
from samples import sampled

import gaitopt as go
from gaitopt.design.neighbourhood import neighbourhood
from gaitopt.design.open_loop import OpenLoopOptimum, finished, optimise
from gaitopt.design.stability import CircleRows, ReturnMap
from gaitopt.systems import build_system

BOUNDED = {"constraints.spectral_radius": {"max": 0.85}}


def compass(*, order="constant", friction="0.12", intervals=3, **changes):
    text = COMPASS.replace("intervals: 1, order: constant", f"intervals: {intervals}, order: {order}")
    text = text.replace("friction: 0.12", f"friction: {friction}").replace("cost_of_transport", "torque_squared")
    return go.parse_problem(text.replace("speed: 0.4", "speed: 0.4, state.dx: {min: 0.05}")).replace(changes)


@pytest.mark.parametrize(
    ("order", "friction"), sampled([("linear", "{free: [0.1, 0.12], guess: 0.11}"), ("constant", "0.12")], 2)
)
def test_the_return_map_of_a_collocation_is_that_of_the_gait(order, friction):
    problem = compass(order=order, friction=friction, **{"constraints.spectral_radius": {"max": 5}})
    optimum = optimise(problem, build_system(problem))
    assert isinstance(optimum, OpenLoopOptimum)
    x, p = optimum.x, optimum.collocation.dynamics.p
    returned, rng = ReturnMap(optimum.collocation), np.random.default_rng(1)
    V, M, adjoint = returned.response(x, p)
    gait = finished(optimum, build_system(optimum.problem))
    np.testing.assert_allclose(
        np.sort(np.abs(np.linalg.eigvals(M))), np.sort(np.abs(gait.multipliers)), atol=1e-8 * np.abs(M).max()
    )

    # derivatives against central differences, along all unknowns and along the motion
    G, direction, step = rng.normal(size=M.shape), 1e-2 * rng.normal(size=x.size), 1e-5
    M1, M0 = (returned.response(x + sign * step * direction, p)[1] for sign in (1, -1))
    slope = returned.gradient(x, p, V, adjoint(G), G)
    assert slope @ direction == pytest.approx(np.vdot(G, M1 - M0) / (2 * step), rel=1e-6)
    circle, weights = CircleRows(optimum.collocation, 0.9), np.array([1.0, -2.0, 0.5])
    tangents, curvature = returned.along_motion(x, p), circle.curvature(x, p, weights)
    along, step = tangents @ rng.normal(size=returned.controls.size), 1e-4
    ends = [[row.value for row in circle.at(x + k * step * along, p).rows] for k in (1, 0, -1)]
    second = np.array([1, -2, 1]) @ np.array(ends) @ weights / step**2
    assert along[returned.controls] @ curvature @ along[returned.controls] == pytest.approx(second, rel=1e-3)


def test_an_optimum_is_as_stable_as_its_bound():
    gait = solved(compass(**BOUNDED))
    assert gait.spectral_radius == pytest.approx(0.85, abs=1e-6)
    assert go.verify(gait).passed
    assert gait.problem.origin.constraints["spectral_radius"].maximum == 0.85


@pytest.mark.slow
def test_stability_costs_torque():
    free = go.solve(compass(), progress=False)
    assert free.spectral_radius > 0.9
    assert solved(compass(**BOUNDED)).scalar("torque_squared") > free.scalar("torque_squared")


@pytest.mark.slow
@pytest.mark.parametrize("bound", [{}, BOUNDED])
def test_no_better_neighbour_of_an_optimum_on_several_intervals_is_found(bound):
    searched = neighbourhood(go.solve(compass(**bound), progress=False), directions=10)
    assert searched.optimal, searched.summary


@pytest.mark.slow
@pytest.mark.parametrize(("objective", "radius"), [("cost_of_transport", 0.91), ("torque_squared", 0.895)])
def test_one_constant_interval_is_the_stable_design_with_constant_torques(objective, radius):
    constraints = {"speed": 0.4, "state.dx": {"min": 0.03}, "spectral_radius": {"max": radius}}
    changes = {"objective": objective, "constraints": constraints}
    design = go.solve(go.load_problem("compass-torque-stable-slip-cheap").replace(changes), progress=False)
    gait = solved(compass(friction="{free: [0.1, 0.2], guess: 0.16}", intervals=1, **changes))
    assert gait.spectral_radius == pytest.approx(radius, abs=1e-6)
    assert gait.scalar(objective) == pytest.approx(design.scalar(objective), rel=1e-6)
    assert gait.freed["friction"] == pytest.approx(design.freed["friction"], abs=1e-5)


@pytest.mark.slow
def test_a_bound_that_is_not_met_is_named_with_the_best_value():
    gait = go.solve(compass(intervals=1, **{"constraints.spectral_radius": {"max": 0.5}}), progress=False)
    assert not gait.converged
    assert "spectral_radius <= 0.5 was not met: best reached" in gait.message


@pytest.mark.slow
def test_the_bound_is_a_part_of_the_program_for_users():
    nlp = go.nlp(compass(**BOUNDED))
    assert [label.name for label in nlp.g_labels].count("spectral_radius") == 3
    gait = nlp.gait(solved_by_casadi(nlp))
    assert gait.converged, gait.message
    assert gait.spectral_radius == pytest.approx(0.85, abs=1e-6)
