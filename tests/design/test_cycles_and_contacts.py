"""Designs of walkers with several contacts and of cycles with several steps: closed forms and other gaits."""

from math import cos, exp, pi, sin, sqrt
from typing import Any

import pytest
from named import named

import gaitopt as go
from gaitopt.design.neighbourhood import neighbourhood
from gaitopt.errors import ProblemError

FREE: dict[str, Any] = {
    "control.first.drive": {"free": [1, 8], "guess": 5.4},
    "control.second.drive": {"free": [-8, -1], "guess": -4.6},
}
"""Forces of the crawler's motor in the two halves of its period."""
ADVANCE, SUPPORT = 0.12, 0.2
"""Stated step length of the crawler [m], and time for which both of its masses rest [s]."""


def slide(mass: float, stiffness: float = 20.0, damping: float = 1.5) -> tuple[float, float]:
    """Time in which a mass of the crawler slides, half an oscillation; and by how much it has decayed then."""
    decay = damping / (2 * mass)
    time = pi / sqrt(stiffness / mass - decay**2)
    return time, exp(-decay * time)


def advance(forces: float) -> tuple[float, float]:
    """Step length of the crawler and its derivative in either force, from the sum of the sizes of both.

    The gaps at the two rests are r_1 - c_1 = -e_1 (r_2 - c_1) and r_2 - c_2 = -e_2 (r_1 - c_2), with the equilibria c.
    """
    rear, front, k, g, slope = 1.0, 1.5, 20.0, 9.81, 0.1
    (_, e_1), (_, e_2) = slide(front), slide(rear)
    gain = (1 + e_1) * (1 + e_2) / (1 - e_1 * e_2) / k
    friction = g * cos(slope) * (0.4 * front + 0.6 * rear)
    return gain * (forces - friction + g * sin(slope) * (front + rear)), gain


@pytest.fixture(scope="module")
def crawler() -> go.Gait:
    """Least effort for a stated step length."""
    problem = go.load_problem("crawler").replace(
        FREE | {"objective": "torque_squared", "constraints": {"step_length": ADVANCE}}
    )
    return go.solve(problem)


def test_least_effort_of_the_crawler_is_equal_in_both_halves(crawler: go.Gait) -> None:
    """Its step length depends on the sum of both forces alone."""
    first, second = (crawler.freed[key] for key in FREE)
    assert first == pytest.approx(-second, rel=1e-12)
    assert advance(first - second)[0] == pytest.approx(ADVANCE, rel=1e-11)
    found = go.sensitivity(crawler)
    for key, sign in zip(FREE, (1, -1), strict=True):
        assert sign * found.of("step_length", key) == pytest.approx(advance(10.0)[1], rel=1e-11)


def test_least_double_support_makes_the_spring_stiffer() -> None:
    """A stiffer spring needs more force for the same step, but the mass that slides rests earlier."""
    free = FREE | {"walker.stiffness": {"free": [15, 60], "guess": 20.0}}
    constraints = {"step_length": 0.1, "phases.1.duration": {"min": SUPPORT}}
    gait = go.solve(
        go.load_problem("crawler").replace(free | {"objective": "torque_squared", "constraints": constraints})
    )
    assert gait.scalar("phases.1.duration") == pytest.approx(SUPPORT, abs=1e-10)
    assert slide(1.5, gait.freed["walker.stiffness"])[0] == pytest.approx(1.0 - SUPPORT, abs=1e-10)


@pytest.mark.slow
def test_double_support_that_no_force_brings_about_is_infeasible() -> None:
    """How long a mass slides does not depend on the forces; a motion without any slide would be no gait."""
    changes = FREE | {"objective": "torque_squared", "constraints": {"phases.1.duration": {"min": 0.3}}}
    gait = go.solve(go.load_problem("crawler").replace(changes))
    assert gait.status == "infeasible"
    assert gait.causes[0].available == pytest.approx(1.0 - slide(1.5)[0], abs=1e-6)


TORQUES = {
    "control": {"type": "constant_torque", "ankle": {"free": [-5, 5], "guess": 0.45},
                "hip": {"free": [-5, 5], "guess": 0.12}},
    "walker.slope": 0, "friction": 0.25, "objective": "cost_of_transport", "constraints": {"speed": 0.4},
}  # fmt: skip
START = {"theta1": -0.0887, "dtheta1": 0.5055, "dtheta2": -0.4817}


def legs(other: float, **changes: Any) -> go.Gait:
    """Constant torques that walk with a second leg of another mass, over two steps."""
    guess = {"gait.guess.state": START, "walker.other_leg_mass": other}
    return go.solve(go.load_problem("compass-unequal").replace(TORQUES | guess | changes))


@pytest.mark.slow
def test_curves_designed_over_two_steps_are_those_of_one() -> None:
    """Fourteen control points, slips, and a bound on the multipliers, which are squared."""
    one = named("compass-pd-designed")
    step = {"phases": ["slip_forward", "stick"], "impact": "slip_forward"}
    start = {"theta1": -0.075, "dtheta1": 0.266, "dtheta2": -0.432, "dx": 0.257}
    gait = {"steps": [step, step], "guess": {"state": start}}
    bounds = {"constraints.step_length": {"min": 0.622}, "constraints.spectral_radius": {"max": 0.25}}
    two = go.solve(go.load_problem("compass-pd-designed").replace({"gait": gait} | bounds))
    assert two.solver["objective"] == pytest.approx(one.solver["objective"], rel=1e-9)
    assert two.spectral_radius == pytest.approx((one.spectral_radius or 0.0) ** 2, rel=1e-5)


@pytest.fixture(scope="module")
def unequal() -> go.Gait:
    return legs(4.4)


@pytest.mark.parametrize("directions", [0, pytest.param(10, marks=pytest.mark.slow)])
def test_designs_are_walked_by_the_simulator_and_have_no_better_neighbours(
    unequal: go.Gait, crawler: go.Gait, directions: int
) -> None:
    for design in (unequal, crawler):
        assert go.verify(design).passed
        if directions:
            near = neighbourhood(design, directions=directions)
            assert near.feasible > near.tried / 2
            assert near.optimal


@pytest.mark.slow
def test_spectral_radius_of_two_unequal_steps_is_bounded() -> None:
    gait = legs(4.4, constraints={"speed": 0.4, "spectral_radius": {"max": 0.5}})
    assert gait.spectral_radius == pytest.approx(0.5, abs=1e-9)
    assert go.verify(gait).passed


@pytest.mark.parametrize(
    ("problem", "objective", "words"),
    [("compass-unequal", "foot_clearance", "the least of several largest heights"),
     ("crawler", "foot_clearance", "not defined without a swing foot"),
     ("crawler", "phases.4.duration", "did you mean phases.3.duration")],
)  # fmt: skip
def test_what_a_cycle_does_not_have_is_no_objective(problem: str, objective: str, words: str) -> None:
    changes = {"friction.rear": FRICTION} if problem == "crawler" else {"friction": FRICTION}
    with pytest.raises(ProblemError, match=words):
        go.load_problem(problem).replace(changes | {"objective": objective})


FRICTION = {"free": [0.1, 0.6], "guess": 0.6}


SHORTEST_STEPS = {
    "compass-passive-a": ("walker.slope", "walker.leg_length"),
    "compass-passive-static-kinetic": ("walker.slope", "walker.leg_length"),
    "compass-passive-two-step": ("walker.slope", "walker.leg_length"),
    "compass-push-off": ("walker.hip_mass", "walker.leg_length"),
    "compass-unequal": ("walker.slope", "walker.leg_length"),
    "compass-virtual-constraint-slip": ("walker.hip_mass", "walker.leg_length"),
    "kneed-passive": ("walker.slope", "walker.thigh_length"),
    "round-feet-passive": ("walker.slope", "walker.leg_length"),
    "heel-toe-impact-slip": ("walker.slope", "walker.leg_length"),
    "flat-foot": ("walker.slope", "walker.leg_length"),
    "hopper": ("walker.stiffness", "walker.leg_length"),
    "slip-run": ("walker.stiffness", "walker.mass"),
    "slip-run-foot": ("walker.slope", "walker.body_mass"),
    "slip-walk-stable": ("walker.stiffness", "walker.mass"),
    "bounding-overlap": ("walker.stiffness", "walker.mass"),
    "crawler": ("walker.slope", "walker.rear_mass"),
    "inchworm": ("walker.slope", "walker.link_length"),
}
"""Gaits of every structure, with parameters that are freed by 3 % either way."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORTEST_STEPS)
def test_every_structure_can_be_designed(name: str) -> None:
    """Stops, switches, flight, massless and round feet, push-offs, several contacts and steps, clocks and sections."""
    problem = go.load_problem(name)
    at = {key: problem.parameters[key] for key in SHORTEST_STEPS[name]}
    free = {key: {"free": [0.97 * value, 1.03 * value], "guess": value} for key, value in at.items()}
    best = go.solve(problem.replace(free | {"objective": "period"}))
    assert best.solver["kkt"] < 1e-6
    assert best.scalar("period") <= go.solve(problem).scalar("period") + 1e-12
    assert go.verify(best).passed
