"""Phases that end at a breakpoint of the control, where the torques jump: equations, searches and multipliers."""

from dataclasses import replace

import jumping
import numpy as np
import pytest
from jumping import AT_ALL, AT_ONCE, PUSH, SLIPPING, problem, pushed, staircase

from gaitopt import Cycle, Family, Mode, verify
from gaitopt.model.cycle import BREAKPOINT
from gaitopt.requests import Engine
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.following import follow
from gaitopt.solver.newton import polish
from gaitopt.solver.program import checked_gait
from gaitopt.solver.rollout import retraced, roll_out, rolled_again
from gaitopt.solver.solve import solve_gait

BEFORE, AT, AFTER = 0.165, 0.167, 0.175
"""Frictions with which the foot slips at the breakpoint, again, and only during the push."""


@pytest.mark.parametrize(("friction", "timed"), [(BEFORE, (0,)), (AT, (0,)), (AFTER, ()), (0.2, ())])
def test_the_solver_recognises_a_switch_at_a_breakpoint(friction, timed):
    gait = jumping.gait(friction, *(SLIPPING if friction < AT_ALL else ("stick",)))
    assert gait.timed == gait.cycle.timed == timed
    if timed:
        assert gait.phases[0] == (Mode.STICK, pytest.approx(PUSH[0], abs=1e-14))
    assert gait.problem.cycle.timed == ()


@pytest.mark.parametrize("engine", [Engine.SCIPY, Engine.HEYOKA])
@pytest.mark.parametrize("friction", [BEFORE, AFTER])
def test_both_engines_confirm_the_gait_and_its_multipliers(engine, friction):
    """Among the claims: multipliers by saltation and by implicit differentiation, and differences of walks."""
    verification = verify(jumping.gait(friction, *SLIPPING), engine=engine)
    assert verification.passed, verification.to_record()
    assert verification.figure("multipliers") < 1e-11


def test_the_end_of_a_timed_phase_is_a_time_and_its_margins_are_required_on_both_sides():
    at = solution_of(jumping.gait(BEFORE, *SLIPPING))
    equations = at.equations
    (row,) = [label for label in equations.equality_labels if label.name == BREAKPOINT]
    assert row.phase == 0
    margins = dict(zip(equations.inequalities[1], equations.margin_values(at.w, at.p), strict=True))
    last = equations.mesh.last_nodes[0]
    before = {label.name: value for label, value in margins.items() if (label.phase, label.node) == (0, last)}
    after = {label.name: value for label, value in margins.items() if (label.phase, label.node) == (1, last)}
    assert min(before[name] for name in ("cone_forward", "cone_backward", "normal_force")) > 0
    assert after["onset"] > 0
    assert after["normal_force"] > 0
    weight = at.equations.dynamics(at.p, np.zeros(0)).scales.force
    assert equations.jumps(at.w, at.p)[0] == pytest.approx((before["cone_backward"] / weight, -after["onset"] / weight))


def test_a_timed_phase_that_ends_elsewhere_is_noticed_and_moved():
    """The equations of a timed phase also have solutions where the foot would not slip at the breakpoint."""
    gait = jumping.gait(AFTER, *SLIPPING)
    cycle = gait.problem.cycle.with_timed((0,))
    rolled = roll_out(gait.dynamics, cycle, gait.state, [PUSH[0], 0.02, gait.period - PUSH[0] - 0.02])
    wrong = rolled.on_mesh()
    assert wrong.misplaced == (0,)
    assert not wrong.in_order
    again = rolled_again(wrong)
    assert again.cycle.timed == ()
    assert again.durations[0] == pytest.approx(gait.phases[0][1], abs=1e-6)


@pytest.mark.parametrize("beyond", [2e-9, -2e-9])
def test_a_search_that_ends_on_the_wrong_side_of_a_breakpoint_has_the_gait_of_the_other_side(beyond):
    """The landing is so close to the breakpoint that the error of a search decides which one comes first."""
    whole = jumping.gait(0.2, "stick")
    system = staircase((*PUSH, whole.period + beyond), -1, 12, -1, -1)
    dynamics = replace(whole.dynamics, system=system)
    searched = roll_out(dynamics, whole.cycle, whole.state, [whole.period + 50 * beyond]).on_mesh()
    assert searched.in_order
    assert not polish(searched).in_order
    gait = checked_gait(whole.problem, searched, {})
    assert gait.converged, gait.message
    assert gait.period == pytest.approx(whole.period, abs=1e-11)


@pytest.mark.parametrize(("friction", "first"), [(BEFORE, 0.595), (BEFORE, 0.6), (BEFORE, 0.61), (AFTER, 0.61)])
def test_durations_of_a_guess_that_miss_the_breakpoint_lead_to_the_same_gait(friction, first):
    gait = jumping.gait(friction, *SLIPPING)
    state = dict(zip(gait.system.state_names, gait.state.tolist(), strict=True))
    guessed = gait.problem.with_modes(gait.problem.cycle, state, [first, 0.63 - first, gait.period - 0.63])
    found = solve_gait(guessed, pushed())
    assert found.converged
    assert found.timed == gait.timed
    np.testing.assert_allclose(found.state, gait.state, atol=1e-12)


@pytest.mark.parametrize(("start", "goal"), [(0.177, 0.165), (0.165, 0.177)])
def test_a_gait_is_followed_across_the_place_where_its_switch_meets_the_breakpoint(start, goal):
    first, last = (jumping.gait(friction, *SLIPPING) for friction in (start, goal))
    family = Family(first)
    for gait in (follow(first, last.problem), family.solve(last.problem)):
        assert gait.converged, gait.message
        assert gait.timed == last.timed
        np.testing.assert_allclose(gait.state, last.state, atol=1e-11)
    for friction in np.linspace(start, goal, 5)[1:-1]:
        gait = family.solve(first.problem.replace({"friction": float(friction)}))
        assert gait.converged
        assert gait.timed == ((0,) if friction < AT_ONCE else ())


def test_a_jump_within_the_cone_changes_nothing():
    """The same torques, cut at further breakpoints where they do not jump, or where the foot holds."""
    whole = jumping.gait(0.2, "stick")
    assert whole.timed == ()
    cut = solve_gait(problem(0.2, "stick"), staircase((0.3, *PUSH), -1, -1, 12, -1))
    assert cut.timed == ()
    np.testing.assert_allclose(cut.state, whole.state, atol=1e-12)
    slipping = jumping.gait(BEFORE, *SLIPPING)
    cut = solve_gait(problem(BEFORE, *SLIPPING), staircase((0.3, *PUSH), -1, -1, 12, -1))
    assert cut.timed == slipping.timed
    np.testing.assert_allclose(cut.state, slipping.state, atol=1e-12)


def test_timed_phases_are_counted_through_all_steps():
    retracing = retraced(jumping.gait(BEFORE, *SLIPPING), 2)
    assert (retracing.cycle.timed, retracing.durations[3]) == ((0, 3), PUSH[0])
    cycle = jumping.gait(BEFORE, *SLIPPING).cycle
    twice = Cycle(cycle.steps * 2)
    assert twice.timed == (0, 3)
    assert twice.untimed.timed == ()
    assert twice.untimed.with_timed((3,)).steps[1].timed == (0,)
    assert str(cycle) == "stick (until breakpoint), slip_backward, stick; stick"
    assert [cycle.onset_order(1), cycle.untimed.onset_order(1)] == [1, 2]
