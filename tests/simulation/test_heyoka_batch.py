"""Thousands of states at once are what each of them would be by itself."""

import sys

import numpy as np
import pytest

pytest.importorskip("heyoka")

from contact_walkers import frame
from named import named

from gaitopt import Control, Mode, load_problem, return_map
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Ending
from gaitopt.search.starts import on_ground
from gaitopt.simulation.heyoka_batch import BatchSimulator
from gaitopt.simulation.heyoka_stepper import HeyokaStepper
from gaitopt.simulation.outcomes import ENDINGS, max_phases, phase_code, phase_names, stack_outcomes
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import build_system


class Cut(Control):
    """No torques, and breakpoints without a jump."""

    type = "cut"

    times: tuple[float, ...]

    @property
    def breakpoints(self):
        return self.times

    def torques(self, now):
        return {}


FIELDS = ("states", "endings", "times", "step_lengths", "phases", "impacts")


def wild_states(problem, count, seed=1):
    """Section coordinates around the guess, wild enough for slips, reversals, falls, lift-off and refused impacts."""
    rng = np.random.default_rng(seed)
    names = problem.walker.section_names(slipping=True)
    centre = np.array([problem.guess.state[name] for name in names])
    xi = centre * (1 + rng.uniform(-0.5, 0.5, (count, len(names)))) + rng.uniform(-0.1, 0.1, (count, len(names)))
    xi[: count // 2, -1] = 0
    return xi


@pytest.fixture(scope="module", params=["compass-passive-a", "rimless-wheel-slip", "compass-torque-impact-slip"])
def mapped(request):
    problem = load_problem(request.param)
    xi = wild_states(problem, 150)
    return problem, xi, return_map(problem, xi, engine="heyoka")


def test_states_in_a_batch_of_many_sequences_walk_as_they_do_alone(mapped):
    problem, xi, batch = mapped
    system = build_system(problem)
    p = system.values(problem.parameters)
    simulator = Simulator(Dynamics(system, p), HeyokaStepper)
    indices = system.section(Mode.SLIP_FORWARD).indices
    assert len(set(batch.outcomes)) > 1
    assert len(set(batch.phases.tolist())) > 3
    for k, row in enumerate(xi):
        alone = simulator.step(simulator.dynamics.lift(row))
        assert batch.outcomes[k] == alone.ending
        assert batch.sequence(k) == (tuple(mode for mode, _ in alone.step.phases) if alone.step else ())
        if alone.ending is Ending.COMPLETED:
            np.testing.assert_allclose(batch.states[k], alone.step.impact.state[indices], rtol=0, atol=1e-12)
            np.testing.assert_allclose(batch.times[k], alone.step.period, rtol=0, atol=1e-12)
            np.testing.assert_allclose(batch.step_lengths[k], alone.step.impact.step_length, rtol=0, atol=1e-12)


def test_results_depend_neither_on_order_nor_on_number(mapped):
    problem, xi, batch = mapped
    order = np.random.default_rng(2).permutation(len(xi))
    shuffled, few = return_map(problem, xi[order], engine="heyoka"), return_map(problem, xi[:11], engine="heyoka")
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(shuffled, name), getattr(batch, name)[order])
        np.testing.assert_array_equal(getattr(few, name), getattr(batch, name)[:11])


@pytest.mark.parametrize(
    ("name", "changes", "spread", "met"),
    [
        pytest.param(
            "compass-unequal", {"friction": 0.19}, (0.01, 0.05, 0.05, 0.03), {"slip_forward", "slip_backward"},
            marks=pytest.mark.slow,
        ),
        ("compass-push-off", {"friction": 0.205}, (0.01, 0.05, 0.05), {Ending.PUSH_SLIPS}),
        pytest.param(
            "compass-passive-static-kinetic", {}, (0.03, 0.15, 0.1, 0.05), {"slip_forward", "slip_backward"},
            marks=pytest.mark.slow,
        ),
        ("kneed-passive", {"friction": 0.25}, (0.02, 0.1, 0.1, 0.03), {"slip_forward, knee locked"}),
        ("hopper", {}, (0.8,), {"flight, leg locked, thrust on"}),
        ("slip-run-foot", {}, (0.02, 0.03, 0.02), {"flight, leg locked"}),
    ],
)  # fmt: skip
def test_engines_map_alike_around_gaits_of_every_kind(name, changes, spread, met):
    gait, rng = named(name), np.random.default_rng(3)
    section = gait.system.section(gait.cycle.impact if len(spread) == 3 else Mode.SLIP_FORWARD).indices
    xi = gait.state[section[: len(spread)]] + np.array(spread) * rng.standard_normal((60, len(spread)))
    xi[::2, 3:] = 0  # every other foot sticks
    problem = gait.problem.replace(changes)
    scipy, heyoka = (return_map(problem, xi, engine=engine) for engine in ("scipy", "heyoka"))
    for field in ("endings", "phases", "impacts"):
        np.testing.assert_array_equal(getattr(scipy, field), getattr(heyoka, field))
    np.testing.assert_allclose(scipy.states, heyoka.states, rtol=0, atol=1e-9)
    assert scipy.completed.sum() > 10
    assert met <= {*scipy.outcomes, *(str(mode) for row in range(60) for mode in scipy.sequence(row))}


@pytest.mark.parametrize(
    ("name", "count"),
    [("crawler", 40), *(pytest.param(name, 25, marks=pytest.mark.slow) for name in ("heel-toe", "bounding"))],
)
def test_walkers_with_several_contacts_are_mapped_alike(name, count):
    gait, rng = named(name), np.random.default_rng(3)
    spread = gait.dynamics.state_units * np.repeat([0.01, 0.05], gait.system.n_z // 2)
    changes = rng.uniform(-1, 1, (count, gait.system.n_z)) * spread
    states = np.array([on_ground(gait.dynamics, gait.state, change) for change in changes])
    states = states[np.isfinite(states).all(axis=1)]
    simulator, order = BatchSimulator(gait.dynamics), rng.permutation(len(states))
    batch, shuffled = simulator.step(states), simulator.step(states[order])
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(shuffled, field), getattr(batch, field)[order])
    for stepper in (HeyokaStepper, ScipyStepper):
        simulator = Simulator(gait.dynamics, stepper)
        alone = stack_outcomes([simulator.step(state) for state in states], states, gait.system)
        for field in ("endings", "phases", "impacts"):
            np.testing.assert_array_equal(getattr(alone, field), getattr(batch, field))
        np.testing.assert_allclose(alone.states, batch.states, rtol=0, atol=1e-9)
        np.testing.assert_allclose(alone.times, batch.times, rtol=0, atol=1e-9)
    assert batch.completed.any()


@pytest.mark.slow
def test_impacts_of_rocking_blocks_accumulate_in_a_batch_too():
    case, angles = frame(half=0.25, height=1.0), np.array([0.5, 0.2]) * np.arctan2(0.25, 1.0)
    dynamics, places = case.dynamics(1.0), [np.array([theta, 0.0, 0.0]) for theta in angles]
    states = np.array([case.state(q - [0.0, *case.points["right"].position(q)], np.zeros(3)) for q in places])
    batch, alone = BatchSimulator(dynamics).step(states), Simulator(dynamics, HeyokaStepper)
    outcomes = [alone.step(state) for state in states]
    assert [ENDINGS[code] for code in batch.endings] == [outcome.ending for outcome in outcomes]
    assert ENDINGS[batch.endings[0]] is Ending.IMPACTS_ACCUMULATE
    np.testing.assert_allclose(batch.times, [outcome.step.period for outcome in outcomes], rtol=0, atol=1e-10)


def test_processes_map_alike_with_code_that_is_optimised_as_in_commands(monkeypatch):
    monkeypatch.setattr(sys.modules["gaitopt.simulation.heyoka_code"], "OPTIMISATION", 3)
    monkeypatch.setattr(sys.modules["gaitopt.verification.step_map"], "CHUNK", 150)
    problem = load_problem("rimless-wheel-slip").replace({"friction": 0.37})  # for which nothing is compiled yet
    xi = wild_states(problem, 400)
    one, two = return_map(problem, xi, engine="heyoka"), return_map(problem, xi, engine="heyoka", workers=2)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("max_switches", [0, 1, 2])
def test_batch_counts_switches_as_the_simulator_does(max_switches):
    problem = load_problem("compass-passive-a")
    system = build_system(problem)
    p = system.values(problem.parameters)
    states = np.array([Dynamics(system, p).lift(row) for row in wild_states(problem, 30)])
    alone = Simulator(Dynamics(system, p), HeyokaStepper, max_switches=max_switches)
    batch = BatchSimulator(Dynamics(system, p), max_switches=max_switches).step(states)
    endings = [alone.step(state).ending for state in states]
    assert [ENDINGS[code] for code in batch.endings] == endings
    assert Ending.CHATTERING in endings


@pytest.mark.parametrize(
    ("name", "factor", "ending"),
    [
        ("compass-passive-stick", 1.0, Ending.COMPLETED),
        ("kneed-passive", 1.0, Ending.COMPLETED),
        ("kneed-passive", 1.5, Ending.SCUFFING),
    ],
)
def test_touchdown_strike_and_scuffing_at_a_breakpoint_are_not_missed(name, factor, ending):
    """Their margins rise first; in the arc after the breakpoint they would not be armed."""
    gait = named(name)
    plain = Simulator(Dynamics(HybridSystem(gait.system.walker, NoControl()), gait.p))
    start = gait.state.copy()
    start[4] *= factor
    outcome = plain.step(start)
    assert outcome.ending is ending
    event, after = outcome.step.arcs[0].end, outcome.step.period
    for difference in (-1e-13, 0.0, 1e-13):
        dynamics = Dynamics(HybridSystem(gait.system.walker, Cut(times=(0.9 * event, event + difference))), gait.p)
        for stepper in (ScipyStepper, HeyokaStepper):
            cut = Simulator(dynamics, stepper).step(start)
            assert cut.ending is ending
            assert [mode for mode, _ in cut.step.phases] == [mode for mode, _ in outcome.step.phases]
            assert cut.step.period == pytest.approx(after, abs=1e-11)
        steps = BatchSimulator(dynamics).step(np.tile(start, (2, 1)))
        assert {ENDINGS[code] for code in steps.endings} == {ending}
        np.testing.assert_allclose(steps.times, after, rtol=0, atol=1e-11)


def test_state_that_is_not_finite_is_named_and_no_states_are_no_steps():
    assert return_map(load_problem("compass-passive-a"), np.zeros((0, 3)), engine="heyoka").states.shape == (0, 4)
    states = np.zeros((4, 3))
    states[2, 1] = np.nan
    with pytest.raises(ValueError, match="row 2 is not"):
        return_map(load_problem("compass-passive-a"), states)


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
@pytest.mark.parametrize("lost", [[0], [7], [0, 19]])
def test_motion_that_becomes_infinite_leaves_the_other_lanes_alone(lost):
    problem = load_problem("compass-passive-b")
    names = problem.walker.section_names(slipping=True)
    xi = np.tile([problem.guess.state[name] for name in names], (20, 1))
    xi[:, 1] *= np.linspace(0.99, 1.01, 20)
    alone, others = return_map(problem, xi, engine="heyoka"), np.setdiff1d(np.arange(20), lost)
    xi[lost, 1:] = 1e160
    together = return_map(problem, xi, engine="heyoka")
    assert {*together.outcomes[lost]} == {Ending.NUMERICAL}
    assert set(alone.outcomes) == {Ending.COMPLETED}
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(together, name)[others], getattr(alone, name)[others])


def test_motions_that_become_infinite_in_finite_time_end():
    """Where the decoupling matrix of the law is singular, heyoka takes steps of no length, which it does not count."""
    problem = load_problem("compass-virtual-constraint").replace({"control.model": "actual"})
    largest = np.array([0.4, 1.5, 1.5, 1.2])
    starts = np.random.default_rng([0, 0]).uniform(-largest, largest, (120, 4))
    outcomes = [*return_map(problem, starts, engine="heyoka").outcomes]
    assert 0 < outcomes.count(Ending.NUMERICAL) < 100


@pytest.mark.parametrize("engine", ["heyoka", "scipy"])
def test_massless_foot_that_begins_with_a_slip_ends_there(engine):
    problem = load_problem("slip-run")
    outcomes = return_map(problem, np.array([[1.1, 0.0], [1.1, 0.1], [1.1, -0.1]]), engine=engine).outcomes
    assert tuple(outcomes) == (Ending.COMPLETED, Ending.PAINLEVE, Ending.PAINLEVE)


def test_phases_of_a_code_are_those_it_was_made_of():
    modes = [Mode.SLIP_FORWARD, Mode.STICK, Mode.SLIP_BACKWARD, Mode.STICK]
    assert phase_names(phase_code(modes, CONTACTS), CONTACTS) == tuple(modes)
    assert phase_code([Mode.STICK, Mode.SLIP_FORWARD] * max_phases(CONTACTS), CONTACTS) == 0
