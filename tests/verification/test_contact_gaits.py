"""Gaits of walkers with several contacts, by both methods."""

import json

import numpy as np
import pytest
from contact_problems import TEXTS, WALKERS, contact_gait, contact_problem

from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.problem.problem import restore_problem
from gaitopt.search.solve import solve
from gaitopt.simulation.simulator import Simulator
from gaitopt.store.gaits import integrated_steps
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.verify import verify

EXPECTED = {  # section coordinates, period and multipliers, found by walking and by shooting, which agree in all digits
    "heel-toe": ([-0.294967156, 1.156405186, -0.343932278], 0.744402419, [-0.37499689 + 0.29997763j, 0.1904152]),
    "heel-toe-slip": ([-0.294921132, 1.156372293, -0.344130863], 0.744440373, [-0.38740964 + 0.28791092j, 0.18988346]),
    "heel-toe-slip-strike": (
        [-0.293749257, 1.131353829, -0.356492282, 0.030032698],
        0.745424,
        [-2.83737609, 0.220403232, 0.0123616811, 0],
    ),
    # back foot 0.10336958 behind, velocity at -0.33568428 rad; Geyer, Seyfarth, Blickhan (2006)
    "slip-walk": ([-0.103369584, -0.395032455], 0.17576282 + 0.23402285, [1.43126171, 0.53609219]),
}


@pytest.mark.parametrize("name", TEXTS)
def test_both_methods_find_the_gait_and_its_multipliers(name: str) -> None:
    gait = contact_gait(name)
    section, period, multipliers = EXPECTED[name]
    assert gait.state[gait.system.section(gait.problem.cycle).indices] == pytest.approx(section, rel=1e-7)
    assert gait.period == pytest.approx(period, rel=1e-6)
    real = [m for m in gait.multipliers if m.imag >= 0]
    assert np.array(real) == pytest.approx(np.array(multipliers), abs=1e-7)
    checked = verify(gait)
    assert checked.passed, [claim.words for claim in checked.claims if not claim.passed]
    assert checked.figure("multipliers") < 1e-9


@pytest.mark.parametrize("name", TEXTS)
def test_a_record_holds_the_gait(name: str) -> None:
    gait = contact_gait(name)
    record = json.loads(json.dumps(gait.to_record()))
    (step,) = integrated_steps(gait.dynamics, record)
    assert step.sequence == gait.cycle.steps[0]
    assert step.impact.state == pytest.approx(gait.state, abs=1e-9)
    again = restore_problem(json.loads(json.dumps(gait.problem.resolved())), walkers=WALKERS)
    assert again.with_gait(record).cycle == gait.cycle
    assert solve(again.with_gait(record)).state == pytest.approx(gait.state, abs=1e-11)


@pytest.mark.parametrize("name", TEXTS)
def test_two_cycles_are_one_map_squared(name: str) -> None:
    gait = contact_gait(name)
    section = gait.system.section(gait.problem.cycle)
    maps = [ReturnMap(Simulator(gait.dynamics), section, n, gait.state) for n in (1, 2)]
    one, two = (each.jacobian(each(gait.state[section.indices]).steps) for each in maps)
    assert two == pytest.approx(one @ one, abs=1e-7 * (1 + np.abs(one).max()))
    assert multiplier_distance(floquet_multipliers(two), gait.multipliers**2) < 1e-7


def test_more_friction_changes_nothing_where_all_contacts_stick() -> None:
    gait = contact_gait("heel-toe")
    more = solve(gait.problem.replace({"friction": 0.6}))
    assert more.state == pytest.approx(gait.state, abs=1e-13)
    assert more.multipliers == pytest.approx(gait.multipliers, abs=1e-11)


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
