"""Both engines walk the same steps; extended precision says how many digits each of them has."""

import re
from functools import partial

import numpy as np
import pytest

pytest.importorskip("heyoka")

from named import named

from gaitopt import Mode, load_problem, problem_names
from gaitopt.errors import UnknownNameError
from gaitopt.model.dynamics import Dynamics
from gaitopt.problem.source import find_problem
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.heyoka_stepper import HeyokaStepper
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import build_system
from gaitopt.verification.return_map import ReturnMap

AGREEMENT = 1e-10
DESIGN = re.compile(r"^(objective|constraints):|free:", re.MULTILINE)
DESIGNS = [name for name in problem_names() if DESIGN.search(find_problem(name).read_text())]  # loading takes a second
GAITS = [name for name in problem_names() if name not in DESIGNS]
EXTENDED = ("rimless-wheel-slip", "compass-unequal", "hopper", "crawler")
"""Gaits whose integrators compile quickly in extended precision."""
QUICK = (
    *("compass-passive-a", "compass-passive-static-kinetic", "compass-shaped", "compass-unequal", "compass-push-off"),
    *("rimless-wheel-slip", "kneed-passive", "slip-run-foot", "hopper", "crawler", "bounding", "heel-toe-slip"),
)
"""One gait for every kind of phase, impact, control and leg."""


@pytest.fixture(
    scope="module", params=[pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in GAITS]
)
def gait(request):
    return named(request.param)


def walk(gait, stepper):
    return Simulator(gait.dynamics, stepper).run(gait.state)


def assert_same(first, second):
    """Two steps are one and the same."""
    assert phases(first) == phases(second)
    assert first.impact.mode is second.impact.mode
    assert max(abs(a.end - b.end) for a, b in zip(first.arcs, second.arcs, strict=True)) < AGREEMENT
    assert np.abs(first.impact.state - second.impact.state).max() < AGREEMENT


def phases(step):
    return tuple(mode for mode, _ in step.phases)


def test_engines_agree_on_every_named_gait(gait):
    ours, theirs = (walk(gait, kind) for kind in (HeyokaStepper, ScipyStepper))
    (first,), (second,) = ours.steps, theirs.steps
    assert_same(first, second)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "compass-torque-efficient" else pytest.mark.slow) for name in DESIGNS],
)
def test_engines_agree_on_every_named_design_at_its_guess(name):
    """The free numbers have the guesses of the file: a step need not be a gait to be simulated, or varied."""
    problem = load_problem(name)
    system = build_system(problem)
    p = system.values(problem.parameters)
    state = np.array([problem.guess.state[key] for key in system.state_names])
    simulators = [Simulator(Dynamics(system, p), kind) for kind in (HeyokaStepper, ScipyStepper)]
    steps = [simulator.step(state).step for simulator in simulators]
    assert_same(*steps)
    maps = [ReturnMap(simulator, steps[0].impact.mode) for simulator in simulators]
    jacobians = [mapped.jacobian([step]) for mapped, step in zip(maps, steps, strict=True)]
    np.testing.assert_allclose(*jacobians, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in EXTENDED else pytest.mark.slow) for name in GAITS]
)
def test_extended_precision_confirms_thirteen_digits_of_heyoka(name):
    gait = named(name)
    double, extended = (walk(gait, partial(HeyokaStepper, precision=kind)).steps[0] for kind in (float, np.longdouble))
    assert abs(double.period - extended.period) < 1e-14
    assert np.abs(double.impact.state - extended.impact.state).max() < 1e-13


@pytest.mark.slow
def test_derivative_of_the_return_map_is_that_of_the_other_engine(gait):
    section, jacobians = gait.system.section(gait.problem.cycle), []
    for kind in (HeyokaStepper, ScipyStepper):
        simulator = Simulator(gait.dynamics, kind)
        steps = simulator.run(gait.state).steps
        jacobians.append(ReturnMap(simulator, section, 1, gait.state).jacobian(steps))
    np.testing.assert_allclose(*jacobians, rtol=1e-8, atol=1e-9)


def test_slip_that_begins_and_ends_within_one_series_is_found():
    """If a series begins with an exact zero, heyoka itself overlooks its next root."""
    problem = load_problem("compass-passive-a")
    system = build_system(problem)
    p = system.values(problem.parameters)
    state = Dynamics(system, p).lift(np.array([-0.12585876, 0.84786029, -0.37412777]))
    step = Simulator(Dynamics(system, p), HeyokaStepper).step(state).step
    assert phases(step)[:2] == (Mode.SLIP_FORWARD, Mode.STICK)
    assert step.arcs[0].duration < 0.03


def test_auto_compiles_for_many_steps_only_and_an_engine_that_is_not_there_is_named(monkeypatch):
    assert stepper_class("auto") is ScipyStepper
    assert stepper_class("auto", steps=10**5) is HeyokaStepper
    with pytest.raises(UnknownNameError, match="no engine is called 'euler'; use auto, scipy, heyoka"):
        choose_engine("euler")
    monkeypatch.setattr("gaitopt.simulation.engine.find_spec", lambda name: None)
    with pytest.raises(UnknownNameError, match=r"not installed: pip install 'gaitopt\[fast\]'"):
        choose_engine("heyoka")
    assert choose_engine("auto", steps=10**6) == "scipy"
