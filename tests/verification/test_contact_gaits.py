"""Gaits of walkers with several contacts, by both methods."""

import json

import numpy as np
import pytest
from contact_problems import NAMES, Runner, contact_gait, contact_problem, with_point_feet
from named import named
from samples import sampled

from gaitopt import load_problem, return_map, verify
from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.problem.problem import restore_problem
from gaitopt.search.solve import solve
from gaitopt.simulation.engine import is_installed
from gaitopt.simulation.simulator import Simulator
from gaitopt.store.gaits import integrated_steps
from gaitopt.systems import problem_dynamics
from gaitopt.verification.return_map import ReturnMap

EXPECTED = {  # section coordinates, period and multipliers, found by walking and by shooting, which agree in all digits
    "heel-toe": ([-0.294967156, 1.156405186, -0.343932278], 0.744402419, [-0.37499689 + 0.29997763j, 0.1904152]),
    "heel-toe-slip": ([-0.294921132, 1.156372293, -0.344130863], 0.744440373, [-0.38740964 + 0.28791092j, 0.18988346]),
    "heel-toe-impact-slip": (
        [-0.293749257, 1.131353829, -0.356492282, 0.030032698],
        0.745424,
        [-2.83737609, 0.220403232, 0.0123616811, 0],
    ),
    "crawler": ([0.446930709], 2, [0.3795758]),
    "inchworm": ([0.599175746, 0.991581372, 0.303426969], 1, [-0.00998104488, 0, 0]),
    "bounding": ([0.352261799, 3.234404229, 0], 0.35359992, [1.85327773, 0.53412445 + 0.90642523j]),
    "bounding-overlap": ([0, 0.355479216, 1.490944603], 0.328994577, [1.63575589, 0.69257727 + 0.778734998j]),
    # with springy ankles; the double support ends with the impact of the toe; also the period of 25 simulated steps
    "flat-foot": ([-0.35149678838, -0.29768378603, 1.13164660997], 0.697683924, [-0.2808198990, -0.1319750452, 0]),
    "run": ([0.934925866], 0.8712658, [0.368259]),
    # back foot 0.10336958 behind, velocity at -0.33568428 rad; Geyer, Seyfarth, Blickhan (2006)
    "slip-walk": ([-0.103369584, -0.395032455], 0.17576282 + 0.23402285, [1.43126171, 0.53609219]),
    "slip-walk-stable": ([-0.155868165, -0.433404937], 0.444532703, [0.803986278 + 0.556859152j]),
}
ALL = [*NAMES, pytest.param("flat-foot", marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", ALL)
def test_both_methods_find_the_gait_and_its_multipliers(name: str) -> None:
    gait = contact_gait(name)
    section, period, multipliers = EXPECTED[name]
    assert gait.state[gait.system.section(gait.problem.cycle).indices] == pytest.approx(section, rel=1e-7, abs=1e-12)
    assert gait.period == pytest.approx(period, rel=1e-6)
    upper = [m for m in gait.multipliers if m.imag > -1e-9]
    assert np.array(upper) == pytest.approx(np.array(multipliers), abs=1e-7)
    checked = verify(gait)
    assert checked.passed, [claim.summary for claim in checked.claims if not claim.passed]
    assert checked.figure("multipliers") < 1e-9


@pytest.mark.parametrize("name", [*sampled(NAMES, 2), pytest.param("flat-foot", marks=pytest.mark.slow)])
def test_a_record_holds_the_gait(name: str) -> None:
    gait = contact_gait(name)
    record = json.loads(json.dumps(gait.to_record()))
    (step,) = integrated_steps(gait.dynamics, record)
    assert step.sequence == gait.cycle.untimed.steps[0]
    assert step.impact.state == pytest.approx(gait.state, abs=1e-9)
    again = restore_problem(json.loads(json.dumps(gait.problem.resolved())), walkers=[Runner])
    assert again.with_gait(record).cycle == gait.cycle.untimed
    assert solve(again.with_gait(record)).state == pytest.approx(gait.state, abs=1e-11)


@pytest.mark.parametrize("name", sampled(NAMES, 3))
def test_two_cycles_are_one_map_squared(name: str) -> None:
    gait = contact_gait(name)
    section = gait.system.section(gait.problem.cycle)
    maps = [ReturnMap(Simulator(gait.dynamics), section, n, gait.state) for n in (1, 2)]
    xi = gait.state[section.indices]
    for _ in range(2):  # Newton's method to the fixed point of the simulation: the gait has an error of its own
        walk = maps[0](xi)
        xi = xi + np.linalg.lstsq(np.eye(xi.size) - maps[0].jacobian(walk.steps), walk.xi - xi, rcond=1e-6)[0]
    one, two = (each.jacobian(each(xi).steps) for each in maps)
    assert two == pytest.approx(one @ one, abs=1e-12 * (1 + np.abs(one).max() ** 2))
    assert multiplier_distance(floquet_multipliers(two), floquet_multipliers(one) ** 2) < 1e-10


def test_a_law_that_holds_contacts_acts_alike_in_a_step_whose_foot_slips() -> None:
    """RABBIT with and without named contacts: modes are chosen while the law compares which contacts it holds."""
    steps, after = [], []
    for problem in (load_problem("rabbit-hzd-slip"), with_point_feet("rabbit-hzd-slip")):
        dynamics = problem_dynamics(problem)
        names = dynamics.system.state_names
        step = Simulator(dynamics).step(np.array([problem.guess.state[name] for name in names])).step
        steps.append(step)
        after.append({name: x for name, x in zip(names, step.impact.state, strict=True) if name not in ("y", "dy")})
    plain, feet = steps
    assert [str(mode) for mode, _ in plain.phases] == ["stick", "slip_backward"]
    assert [mode.brief for mode, _ in feet.phases] == ["foot stick", "foot slip_backward"]
    assert feet.period == pytest.approx(plain.period, abs=1e-13)
    assert after[1] == pytest.approx(after[0], abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "model"), [("rabbit-hzd-slip", "stick"), ("rabbit-hzd", "actual")])
def test_a_law_that_holds_contacts_acts_alike_while_modes_are_compared(name: str, model: str) -> None:
    """RABBIT with named contacts is RABBIT, also where its foot begins to slip."""
    gait = solve(with_point_feet(name, model))
    assert gait.period == pytest.approx(named(name).period, abs=1e-12)
    assert verify(gait).passed


def test_the_energy_of_a_conservative_gait_is_its_parameter() -> None:
    gait = solve(contact_problem("slip-walk").replace({"walker.energy": 820}))
    arc = gait.arcs[0]
    values = arc.dynamics.system.observation(arc.mode)(0, gait.state, gait.p, [])
    assert float(values[4]) == pytest.approx(820, rel=1e-13)
    assert verify(gait).passed


def test_a_gait_is_refused_where_a_contact_would_need_more_friction() -> None:
    problem = contact_problem("heel-toe").replace({"friction": 0.25})
    gait = solve(problem.from_guess())
    assert not gait.converged
    assert "heel needs friction" in gait.message or "toe needs friction" in gait.message


def test_a_section_in_flight_gives_the_multiplier_of_the_one_at_touchdown() -> None:
    """The same runner as a walker that stands on one foot at a time, whose steps end with a landing."""
    apex, landing = contact_gait("run"), named("slip-run")
    assert apex.period == pytest.approx(landing.period, abs=1e-12)
    assert apex.multipliers == pytest.approx(landing.multipliers, abs=1e-11)
    assert apex.measures["step_length"] == pytest.approx(landing.measures["step_length"], abs=1e-12)


@pytest.mark.slow
@pytest.mark.skipif(not is_installed(), reason="heyoka is not installed")
@pytest.mark.parametrize("name", ["heel-toe-slip", "slip-walk", "crawler", "run"])
def test_both_engines_verify_the_gait(name: str) -> None:
    checked = verify(contact_gait(name), engine="heyoka")
    assert checked.passed, [claim.summary for claim in checked.claims if not claim.passed]


@pytest.mark.parametrize("name", ["heel-toe-slip", "slip-walk", "crawler"])
def test_the_return_map_of_many_states_is_that_of_each(name: str) -> None:
    gait = contact_gait(name)
    section = gait.system.section(gait.problem.cycle)
    xi, n = gait.state[section.indices], len(section.names)
    step = 1e-6 * gait.dynamics.state_units[section.indices] * np.eye(n)
    ahead, behind = (return_map(gait, xi + sign * step) for sign in (1, -1))
    assert ahead.completed.all()
    assert ahead.names == section.names
    assert ahead.sequence(0) == gait.cycle.phases
    derivative = (ahead.states - behind.states).T / (2 * np.diag(step))
    assert multiplier_distance(floquet_multipliers(derivative), gait.multipliers) < 1e-5
    with pytest.raises(ValueError, match="one row per state is needed, columns " + ", ".join(section.names)):
        return_map(gait, np.zeros((1, n + 1)))
