"""Friction as a part of its own: two coefficients and drag, in mechanics, NLP, simulator and continuation."""

import numpy as np
import pytest
from foot_impacts import foot_impact

import gaitopt as go
from gaitopt import ImpactLaw, Mode
from gaitopt.errors import ProblemError
from gaitopt.gait.trajectory import ImpactRecord
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import STATIC_KINETIC
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.simulation.contact_resolver import ContactResolver
from gaitopt.simulation.simulator import Simulator
from tests.oracles import CASES

STATIC, KINETIC, VISCOUS = 0.15, 0.12, 20.0
HELD_AT = 0.157128894462
"""Static friction that holds the foot after the impact of the named gait, kinetic friction being 0.12."""


@pytest.fixture(scope="module")
def gait():
    return go.solve(go.load_problem("compass-passive-static-kinetic"))


def two_coefficients(static=STATIC, kinetic=KINETIC, viscous=0.0):
    case = CASES["compass_biped"]
    system = HybridSystem(type(case.walker), NoControl(), ImpactLaw.COULOMB, STATIC_KINETIC)
    return system, np.append(case.numbers, [static, kinetic, viscous]), case.states()


@pytest.mark.parametrize("mode", [Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD])
def test_a_slip_feels_kinetic_friction_and_drag_and_its_impact_has_no_drag(mode):
    system, p, states = two_coefficients(viscous=VISCOUS)
    for z in states:
        f_t, f_n = np.asarray(system.observation(mode)(0, z, p, [])[0]).ravel()
        assert f_t == pytest.approx(-mode.direction * KINETIC * f_n - VISCOUS * z[-1], rel=1e-12)
        f_t, f_n = np.asarray(foot_impact(system, mode)(z, p)[1]).ravel()
        assert f_t == pytest.approx(-mode.direction * KINETIC * f_n, rel=1e-12)


def test_a_sticking_foot_is_held_by_static_friction():
    system, p, states = two_coefficients()
    for z in states:
        f_t, f_n = np.asarray(system.observation(Mode.STICK)(0, z, p, [])[0]).ravel()
        margins = np.asarray(system.margins(Mode.STICK)(0, z, p, [])).ravel()
        np.testing.assert_allclose(margins[3:], [STATIC * f_n + f_t, STATIC * f_n - f_t], rtol=1e-12)


def test_equal_coefficients_are_one_coefficient():
    problem = go.load_problem("compass-passive-a")
    one, two = (go.solve(problem.replace({"friction": f})) for f in (0.14, {"static": 0.14, "kinetic": 0.14}))
    np.testing.assert_allclose(two.state, one.state, atol=1e-12)
    np.testing.assert_allclose(two.multipliers, one.multipliers, atol=1e-12)


def test_the_named_gait_is_confirmed_though_friction_drops_at_the_onset_of_slip(gait):
    check = go.verify(gait)
    assert check.passed, check
    assert check.figure("multipliers") < 1e-9
    backward = gait.arcs[-1]
    data = gait.system.control.data(backward.segment)
    stick, slip = (gait.system.flow(mode)(0, backward.states[0], gait.p, data) for mode in (Mode.STICK, backward.mode))
    assert abs(float(stick[-1] - slip[-1])) > 0.1  # the acceleration of the foot jumps there [m/s^2]


def test_an_impact_sticks_where_sticking_and_slipping_are_both_consistent():
    system = HybridSystem(CompassBiped, NoControl(), ImpactLaw.COULOMB, STATIC_KINETIC)
    walker = go.load_problem("compass-passive-a").walker
    numbers = [value for _, value in walker]
    z = np.array([0.14, 0.14, 0.0, 0.55, -0.6, 0.0])
    stick = np.asarray(foot_impact(system, Mode.STICK)(z, [*numbers, 1, 1, 0])[1]).ravel()
    ratio = abs(stick[0]) / stick[1]

    def impact(static, kinetic):
        record = ContactResolver(Dynamics(system, np.array([*numbers, static, kinetic, 0]))).impact(
            Mode.STICK, system.transitions.of(Mode.STICK)["touchdown"], z
        )
        assert isinstance(record, ImpactRecord)
        return record.mode

    assert impact(1.1 * ratio, 0.9 * ratio) is Mode.STICK
    assert impact(0.95 * ratio, 0.9 * ratio) is not Mode.STICK
    assert impact(1.1 * ratio, 1.05 * ratio) is Mode.STICK


def guess_of(gait, durations):
    """A gait as the first guess of a problem."""
    names = gait.system.walker.section_names(slipping=False)
    state = {f"gait.guess.state.{name}": float(gait.state[gait.system.state_names.index(name)]) for name in names}
    return {**state, "gait.guess.durations": durations}


@pytest.fixture(scope="module")
def nearly_held(gait):
    """The gait that slips at the start of its step only, with hardly less static friction than would hold it."""
    phases = {"gait.phases": ["slip_forward", "stick"], "friction.static": 0.157}
    return go.solve(gait.problem.replace({**phases, **guess_of(gait, [0.1484, 0.6087])}))


def test_the_nlp_refuses_a_slip_that_static_friction_would_hold(nearly_held):
    durations = [duration for _, duration in nearly_held.phases]
    changes = {**guess_of(nearly_held, durations), "friction.static": 0.1575}
    refused = go.solve(nearly_held.problem.replace(changes))
    assert not refused.converged
    assert "static friction holds the foot" in refused.message


def test_a_slip_that_slows_down_by_drag_loses_energy_to_it():
    gait = go.solve(go.load_problem("compass-passive-static-kinetic").replace({"friction.viscous": VISCOUS}))
    check = go.verify(gait)
    assert check.passed, check
    assert check.figure("energy balance") < 1e-11


def test_a_family_ends_by_name_where_the_return_map_jumps(nearly_held):
    (end,) = go.continuation(nearly_held, "friction.static", 0.16).specials
    assert (end.type, end.status) == ("end", "converged")
    assert "the return map jumps" in end.reason
    assert end.value == pytest.approx(HELD_AT, abs=1e-11)
    for static, first in ((HELD_AT - 1e-9, Mode.SLIP_FORWARD), (HELD_AT + 1e-9, Mode.STICK)):
        p = end.gait.p.copy()
        p[end.gait.system.parameters.index("friction.static")] = static
        step = Simulator(Dynamics(end.gait.system, p)).step(end.gait.state).step
        assert step.phases[0][0] is first


def test_kinetic_friction_is_followed_up_to_static_friction_and_no_further(gait):
    end = go.continuation(gait, "friction.kinetic", 0.2).specials[-1]
    assert (end.type, end.status, end.reason) == ("end", "converged", "reached friction.kinetic = 0.15")


@pytest.mark.slow
def test_one_coefficient_becomes_two_where_one_of_them_is_varied():
    gait = go.solve(go.load_problem("compass-passive-a"))
    points = go.continuation(gait, "friction.static", 0.141).points
    assert points[-1].gait.to_record()["friction"] == {"static": pytest.approx(0.141), "kinetic": 0.14, "viscous": 0}
    again = go.continuation(points[0].gait, "friction", 0.141).points
    assert again[-1].gait.to_record()["friction"] == pytest.approx(0.141)


def test_friction_moves_both_coefficients_only_where_they_are_equal(gait):
    problem = gait.problem
    equal = problem.replace({"friction": {"static": 0.2, "kinetic": 0.2}})
    assert equal.replace({"friction": 0.3}).friction_data == {"static": 0.3, "kinetic": 0.3, "viscous": 0}
    with pytest.raises(ProblemError, match=r"friction: there are two coefficients, .* set friction\.static or"):
        problem.replace({"friction": 0.3})
    with pytest.raises(ProblemError, match=r"vary friction\.static, friction\.kinetic"):
        go.continuation(gait, "friction", 0.2)


def test_a_free_coefficient_is_found(gait):
    free = {"friction.kinetic": {"free": [0.1, 0.14], "guess": 0.12}}
    period = {"constraints": {"period": gait.measures["period"] - 1e-4}}
    design = go.solve(go.load_problem("compass-passive-static-kinetic").replace(free | period))
    assert design.converged, design.message
    assert 0.1 < design.freed["friction.kinetic"] < 0.14
    assert design.measures["period"] == pytest.approx(gait.measures["period"] - 1e-4, abs=1e-9)


@pytest.mark.slow
def test_a_frictionless_impact_slips_only_where_sticking_needs_more_friction_than_there_is():
    problem = go.load_problem("compass-torque-impact-slip").replace({"impact_law": "frictionless"})
    branch = go.continuation(go.solve(problem), "friction", 0.3)
    end = branch.specials[-1]
    assert (end.type, end.status) == ("end", "converged")
    assert end.reason.startswith("static friction holds the impact: it can no longer slip, and the return map jumps")
    assert end.gait.measures["impulse_ratio"] == pytest.approx(end.value, rel=1e-9)
    for factor, mode in ((1 - 1e-6, Mode.SLIP_FORWARD), (1 + 1e-6, Mode.STICK)):
        dynamics = end.gait.dynamics.at({"friction": factor * end.value})
        assert Simulator(dynamics).step(end.gait.state).step.impact.mode is mode
    assert go.verify(branch.points[-1].gait).passed
    beyond = go.solve(problem.replace({"friction": 0.29}))
    assert (beyond.status, "impact_onset" in [cause.what for cause in beyond.causes]) == ("infeasible", True)
