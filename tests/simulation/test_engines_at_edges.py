"""All engines decide alike where margins are exactly zero at the start, and in whatever units."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
import pytest

pytest.importorskip("heyoka")

from numpy.typing import NDArray
from paper_walkers import HALF_ANGLE as HALF
from paper_walkers import compass_numbers as compass_parameters
from paper_walkers import compass_system as compass
from paper_walkers import wheel_numbers
from paper_walkers import wheel_system as wheel

import gaitopt as go
from gaitopt import Mode
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.simulation.events import AT_REST
from gaitopt.simulation.heyoka_batch import BatchSimulator
from gaitopt.simulation.heyoka_stepper import HeyokaStepper
from gaitopt.simulation.outcomes import ENDINGS, StepOutcomes, phase_names, stack_outcomes
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics

Array = NDArray[np.float64]
Case = tuple[HybridSystem, Array, Array]
"""A system, its parameters and a state just after an impact."""

AGREEMENT = 1e-9
wheel_parameters = partial(wheel_numbers, slope=0.2)


def level(theta: float, dtheta1: float, dtheta2: float, dx: float = 0.0) -> Array:
    """A compass with both feet on the ground."""
    return np.array([theta, theta, 0, dtheta1, dtheta2, dx])


def steps_of(system: HybridSystem, p: Array, states: Sequence[Array]) -> list[StepOutcomes]:
    """A step of every state by each of the engines."""
    starts = np.array(states)
    simulators = [Simulator(Dynamics(system, p), kind) for kind in (ScipyStepper, HeyokaStepper)]
    alone = [stack_outcomes([simulator.step(z) for z in starts], starts, system) for simulator in simulators]
    return [*alone, BatchSimulator(Dynamics(system, p)).step(starts)]


def assert_alike(cases: Iterator[Case]) -> None:
    for system, p, state in cases:
        first, *others = steps_of(system, p, [state])
        for other in others:
            for name in ("endings", "phases", "impacts"):
                assert getattr(other, name) == getattr(first, name), (p.tolist(), state.tolist())
            assert other.times == pytest.approx(first.times, abs=AGREEMENT)
            np.testing.assert_allclose(other.states, first.states, rtol=1e-7, atol=1e-7)


# states whose margins are zero at the start


def touchdowns(rng: np.random.Generator) -> Iterator[Case]:
    """The swing foot leaves the ground slowly, or not at all, and comes back soon."""
    theta, rate, apart = rng.uniform(-0.3, 0.3), rng.uniform(-1, 1), rng.uniform(0, 0.3)
    p = compass_parameters(rng.uniform(0.05, 0.6), rng.uniform(0, 0.05))
    yield compass(), p, level(theta, rate, rate + apart, rng.choice([0, rng.normal() * 0.2]))
    yield compass(), p, level(theta, rate, rng.uniform(-1, 1))


def upright(rng: np.random.Generator) -> Iterator[Case]:
    """A wheel on two spokes, which rocks back unless it is fast enough."""
    for rate, slip in ((rng.uniform(0, 0.3), 0.0), (rng.uniform(-0.3, 0.3), rng.normal() * 0.3), (0.0, 0.0)):
        yield wheel(), wheel_parameters(10 ** rng.uniform(-1, 0.5)), np.array([-HALF, 0, rate, slip])


def cones(rng: np.random.Generator) -> Iterator[Case]:
    """Exactly as much friction as sticking needs."""
    theta = rng.uniform(-0.3, 0.3)
    for system, parameters, state in (
        (wheel(), wheel_parameters, np.array([theta, 0, rng.normal() * 0.6, 0])),
        (compass(), compass_parameters, level(theta, *rng.normal(size=2) * 0.7)),
        (compass(), compass_parameters, np.array([theta, rng.uniform(-0.3, 0.3), 0, *rng.normal(size=2) * 0.7, 0])),
    ):
        f_t, f_n = np.asarray(system.observation(Mode.STICK)(0, state, parameters(1.0), [])[0]).ravel()
        yield system, parameters(abs(f_t / f_n)), state


def normal_forces(rng: np.random.Generator) -> Iterator[Case]:
    """Cases so fast that the ground bears no load, to the last bit but one."""
    theta, friction, slip = rng.uniform(-0.3, 0.3), rng.uniform(0.1, 2), rng.choice([0.0, 0.2, -0.2])
    mode = Mode.slip(slip) if slip else Mode.STICK
    for system, p, state in (
        (wheel(), wheel_parameters(friction), lambda rate: np.array([theta, 0, rate, slip])),
        (compass(), compass_parameters(friction), lambda rate: level(theta, rate, -0.3, slip)),
    ):
        for rate in root(lambda rate, s=system, p=p, z=state: margin(s, p, z(rate), mode, "normal_force")):
            yield system, p, state(rate)
            yield system, p, state(-rate)


def painleve(rng: np.random.Generator) -> Iterator[Case]:
    """Backward slip of the wheel is unique where kappa + sin^2 theta > mu sin theta cos theta."""
    theta, kappa = rng.uniform(0.1, 0.31), rng.uniform(0.02, 0.4)
    friction = (kappa + np.sin(theta) ** 2) / (np.sin(theta) * np.cos(theta))
    for slip in (-0.2, 0.0, 0.2):
        yield wheel(), wheel_parameters(friction, kappa), np.array([theta, 0, rng.normal() * 0.7, slip])


def margin(system: HybridSystem, p: Array, state: Array, mode: Mode, name: str) -> float:
    return float(system.margins(mode)(0, state, p, [])[system.transitions.margin_names(mode).index(name)])


def root(function: Callable[[float], float], low: float = 0.0, high: float = 8.0) -> tuple[float, ...]:
    """The two neighbouring numbers between which a function changes its sign, if it does."""
    if function(low) * function(high) >= 0:
        return ()
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if function(middle) * function(low) > 0 else (low, middle)
    return low, high


KINDS = (touchdowns, upright, cones, normal_forces, painleve)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("seed", "count"), [(1, 6), pytest.param(2, 200, marks=pytest.mark.slow)])
def test_engines_agree_where_a_margin_is_zero_at_the_start(kind, seed, count):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        assert_alike(kind(rng))


def without_apparent_mass(slip: float) -> Case:
    """A slip whose forces are infinite, or so large that their sign is rounding."""
    theta, kappa = 0.21807578918388987, 0.07702366005602773
    friction = (kappa + np.sin(theta) ** 2) / (np.sin(theta) * np.cos(theta))
    return wheel(), wheel_parameters(friction, kappa), np.array([theta, 0, -0.5545027287512287, slip])


FROM_BELOW = level(-0.058399222358261726, 0.12429450117764147, 0.1652383919354603, 0.12577694865077743)
QUICK = level(0.2619060950636335, 0.22159347239042088, 0.2885395491779186)
DIFFERED = {
    "a foot from below": (compass(), compass_parameters(0.14), FROM_BELOW),
    "a quick step": (compass(), compass_parameters(0.1952217719883892), QUICK),
    **{f"no apparent mass at {slip}": without_apparent_mass(slip) for slip in (-0.2, 0.0, 0.2)},
    # apparent mass and normal force of the foot go to zero together, where neither can be integrated to
    "drawn into the paradox of Painleve": (
        wheel(), wheel_numbers(0.5305289428661172, 0.049361529980451346, -0.6828688993290081, spokes=4),
        np.array([-0.45623404425261516, 0, 0.4057741448077144, 5.895348712923141]),
    ),
}  # fmt: skip
"""States on which engines did not agree once."""


@pytest.mark.parametrize("case", DIFFERED)
def test_engines_agree_on_states_where_they_did_not(case: str) -> None:
    assert_alike(iter([DIFFERED[case]]))


@pytest.mark.parametrize("slip", [9.4e-12, -9.4e-12, 2e-11])
def test_a_slip_that_ends_at_once_is_no_touchdown(slip: float) -> None:
    state = level(-0.15, 0.73, -0.5, slip)
    for steps in steps_of(compass(), compass_parameters(0.3, np.radians(2)), [state]):
        assert steps.endings[0] == 0
        assert steps.times[0] > 0.5


UNITS = [(1e3, 1.0, 1e-3), (1.0, 1e-3, 1e3), (1e3, 670.0, 1.0), (0.3, 1e2, 1e3)]


@pytest.mark.parametrize(("metre", "second", "kilogram"), UNITS)
def test_steps_are_the_same_in_other_units(metre: float, second: float, kilogram: float) -> None:
    rng = np.random.default_rng(4)
    states = [level(rng.uniform(-0.3, 0.1), *rng.uniform(-1, 1, 2), rng.choice([0, 0.3])) for _ in range(12)]
    states += [level(-0.15, 0.73 * f, -0.5 * f) for f in rng.uniform(0.8, 1.2, 12)]
    p = compass_parameters(0.14)
    scaled = p * [metre, kilogram, metre, kilogram, metre / second**2, 1, 1]
    units = np.array([1, 1, metre, 1 / second, 1 / second, metre / second])
    for ours, theirs in zip(
        steps_of(compass(), p, states), steps_of(compass(), scaled, [z * units for z in states]), strict=True
    ):
        for name in ("endings", "phases", "impacts"):
            np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
        np.testing.assert_allclose(theirs.times / second, ours.times, rtol=0, atol=AGREEMENT)
        np.testing.assert_allclose(theirs.states / units, ours.states, rtol=0, atol=AGREEMENT)
        np.testing.assert_allclose(theirs.step_lengths / metre, ours.step_lengths, rtol=0, atol=AGREEMENT)


@pytest.mark.parametrize(
    ("friction", "ankle", "hip", "theta", "rates"),
    [
        (0.6153465655286028, 70.79121698547256, -545.7733214777641, 0.16833378363628648, (1.3693, -0.94431, -0.17561)),
        (0.6220569384229458, 17.001915004904607, -1.1417184557132, 0.1538934531965863, (1.47091, 0.40447, -0.18081)),
        (0.6195421413877503, -9.297814439477257, -3.489174235101138, -0.1580670265578898, (1.03003, -0.22391, 0.41305)),
    ],
)
def test_a_slip_next_to_the_paradox_of_painleve_ends_alike(friction, ankle, hip, theta, rates):
    """DOP853 ran out of steps where the apparent mass of the foot is 1e-8 of what it is in stick."""
    values = {"friction": friction, "control.ankle": ankle, "control.hip": hip}
    dynamics = problem_dynamics(go.load_problem("compass-torque-slip").replace(values))
    states = [np.array([theta + shift, theta + shift, 0, *rates]) for shift in (0, 1e-12, -1e-12, 1e-9, -1e-9)]
    alone, taylor, batch = steps_of(dynamics.system, dynamics.p, states)
    assert "numerical" not in {ENDINGS[k] for k in alone.endings}
    assert alone.endings.tolist() == taylor.endings.tolist() == batch.endings.tolist()


@pytest.mark.parametrize(("slip", "rests"), [(0.9, True), (1.1, False)])
def test_all_engines_take_the_same_slip_for_rest(slip: float, rests: bool) -> None:
    dynamics = Dynamics(compass(), compass_parameters(0.5))
    dx = slip * AT_REST * np.sqrt(1.6 * 9.8)
    for steps in steps_of(dynamics.system, dynamics.p, [level(-0.15, 0.73, -0.5, dx)]):
        first = phase_names(int(steps.phases[0]), CONTACTS)[0]
        assert (first is Mode.STICK) is rests
