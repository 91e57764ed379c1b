"""Problems whose mode sequence is to be found."""

import re

import pytest
from named import named

from gaitopt import Cycle, load_problem, parse_problem, solve
from gaitopt.errors import ProblemError
from gaitopt.problem.problem import restore_problem
from gaitopt.problem.statement import OpenSequence

WHEEL = """
name: wheel
walker: {model: rimless_wheel, spokes: 10, radius: 1, mass: 1, inertia_ratio: 0.3, gravity: 1, slope: 13 deg}
friction: 0.4
gait: {phases: auto%s}
"""


def opened(keys=""):
    return parse_problem(WHEEL % keys)


def test_phases_auto_leaves_sequence_and_guess_open_and_impact_steps_and_guess_may_be_given():
    problem = opened()
    assert problem.is_open
    assert problem.modes == OpenSequence(impact=None, steps=1)
    assert problem.start is None
    for what in ("cycle", "guess"):
        with pytest.raises(ProblemError, match="mode sequence is open"):
            getattr(problem, what)
    problem = opened(", impact: slip_forward, steps: 2, guess: {state: {dtheta: 0.7, dx: 0.1}}")
    assert problem.modes == OpenSequence(impact="slip_forward", steps=2)
    assert problem.guess.state["dx"] == 0.1


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (", impact: skid", "gait.impact: 'skid' is not one of the choices"),
        (", steps: 0", "gait.steps: 0 must be at least 1"),
        (", guess: {state: {dtheta: 0.7}, durations: [1]}", "durations: the phases are open"),
        (", guess: {state: {dx: 0.1}}", "gait.guess.state.dtheta: is missing"),
        (", phase: stick", "gait.phase: unknown key"),
    ],
)
def test_a_fault_is_named(keys, words):
    with pytest.raises(ProblemError, match=re.escape(words)):
        opened(keys)


@pytest.mark.parametrize("keys", ["", ", impact: stick, steps: 3", ", guess: {state: {dtheta: 0.7, dx: -0.2}}"])
def test_the_resolved_problem_reads_as_the_same_problem(keys):
    problem = opened(keys)
    assert restore_problem(problem.resolved()).digest == problem.digest


def test_the_sequence_counts_for_the_digest_and_an_override_opens_and_closes_it():
    assert len({opened(keys).digest for keys in ("", ", impact: stick", ", steps: 2")}) == 3
    known = load_problem("compass-passive-b")
    problem = known.replace({"gait.phases": "auto"})
    assert problem.modes == OpenSequence()
    assert problem.guess.state == known.guess.state
    closed = problem.replace({"gait.phases": ["slip_forward", "stick"], "gait.impact": "slip_forward"})
    assert closed.cycle == known.cycle


def test_a_known_gait_gives_guess_and_modes():
    problem, record = load_problem("compass-passive-a"), named("compass-passive-a").to_record()
    guess = problem.with_guess(record).guess
    assert guess.durations == tuple(phase["duration"] for phase in record["phases"])
    assert guess.state["theta1"] == record["state"]["theta1"]
    other = record | {"impact": "slip_forward", "phases": record["phases"][:1]}
    assert problem.with_guess(other).guess.durations == problem.guess.durations  # those of other phases do not apply
    unknown = problem.replace({"gait.phases": "auto"})
    assert unknown.with_gait(record).cycle == problem.cycle
    twice = Cycle(problem.cycle.steps * 2)
    assert unknown.with_modes(twice, record["state"]).cycle == twice


def test_a_gait_may_stand_for_its_record_but_what_is_no_gait_of_the_walker_is_no_guess():
    gait, problem = named("compass-passive-a"), load_problem("compass-passive-a")
    free = problem.replace({"walker.slope": {"free": [0.01, 0.03], "guess": 0.02}, "objective": "speed"})
    assert problem.with_guess(gait) == problem.with_guess(gait.to_record())
    assert free.with_guess(gait).free["walker.slope"].guess == gait.dynamics.parameters["walker.slope"]
    assert problem.with_gait(gait) == problem.with_gait(gait.to_record())
    with pytest.raises(ProblemError, match="rimless-wheel-stick has no theta1: it is a gait of another walker than"):
        problem.with_guess(named("rimless-wheel-stick"))
    failed = solve(load_problem("rimless-wheel-stick").replace({"friction": 0.5}).from_guess(), progress=False)
    with pytest.raises(ProblemError, match="rimless-wheel-stick is infeasible: it has no motion from which"):
        problem.with_guess(failed)
    with pytest.raises(ProblemError, match="expected a gait or its record, not a float"):
        problem.with_guess(1.0)
