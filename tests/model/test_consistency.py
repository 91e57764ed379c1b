"""Walkers that are not the same body before and after a swap of the feet are refused when they are loaded."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from casadi import SX, vertcat
from oracles import COMPASS, EXAMPLES, TORSO, WHEEL, TorsoCompass

import gaitopt as go
from gaitopt import Body, Mechanism, Walker, check_walker, parse_problem
from gaitopt.errors import ProblemError
from gaitopt.model.mechanism import polar
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel

Changes = Callable[[Mechanism, SimpleNamespace, SimpleNamespace], dict[str, Any]]


def altered(name: str, changes: Changes) -> type[Walker]:
    """A compass with something else in its mechanism."""

    def mechanism(cls: type[Walker], q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        compass = CompassBiped.mechanism(q, p)
        return replace(compass, **changes(compass, q, p))

    return type(
        "Altered", (CompassBiped,), {"__module__": __name__, "model": name, "mechanism": classmethod(mechanism)}
    )


def bodies(change: Callable[..., tuple[Body, ...]]) -> Changes:
    """Other bodies, from the stance leg, the hip, the swing leg and the parameters."""
    return lambda m, q, p: {"bodies": change(*m.bodies, q, p)}


def starting(name: str, posture: Callable[[SimpleNamespace], tuple[Any, ...]]) -> type[Walker]:
    """A compass with another posture after an impact."""
    attributes = {"model": name, "after_impact": classmethod(lambda cls, free, p: posture(free))}
    return type("Altered", (CompassBiped,), {"__module__": __name__, **attributes})


def unequal_distances(stance: Body, hip: Body, swing: Body, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Body, ...]:
    """The mass of one leg is at 0.3 m from the hip, that of the other at 0.5 m."""
    places = hip.position - polar(0.3, q.theta1), hip.position - polar(0.5, -q.theta2)
    return Body(mass=p.leg_mass, position=places[0]), hip, Body(mass=p.leg_mass, position=places[1])


def heavier(stance: Body, hip: Body, swing: Body, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Body, ...]:
    return replace(stance, mass=1.001 * p.leg_mass), hip, swing


def spinning(stance: Body, hip: Body, swing: Body, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Body, ...]:
    """Only one leg is a rigid body."""
    return replace(stance, inertia=0.1 * p.leg_mass, angle=q.theta1), hip, swing


REFUSED = [
    (altered("distances", bodies(unequal_distances)), "its masses jump when the feet swap roles: the body of 4 kg at"),
    (altered("masses", bodies(heavier)), "its masses jump when the feet swap roles: the body of 4.* kg at"),
    (altered("spins", bodies(spinning)), "its masses jump"),
    (altered("wrong_relabel", lambda m, q, p: {"relabel": vertcat(q.theta2, q.theta1)}), "relabel must describe the"),
    (  # the angles are right where the legs have the same one, their rates are not
        altered("right_at_touchdown_only", lambda m, q, p: {"relabel": vertcat(-q.theta1, -q.theta2)}),
        "or does not move so",
    ),
    (altered("forgetful", lambda m, q, p: {"relabel": vertcat(-q.theta2, -q.theta2)}), "relabel cannot be inverted"),
    (starting("wrong_start", lambda free: (free.theta1, -free.theta1)), "after_impact and touchdown contradict each"),
    (starting("short_start", lambda free: (free.theta1,)), "after_impact gives 1 coordinates, but shape has 2"),
    (altered("spring_on_one_leg", lambda m, q, p: {"potential": 10 * (q.theta1 - 0.1) ** 2}), "its potential energy"),
    (altered("high_foot", lambda m, q, p: {"swing_foot": m.swing_foot + SX([0, 0.01])}), "the swing foot is 0.01 m"),
    (altered("massless", lambda m, q, p: {"bodies": m.bodies[1:2]}), "nothing has inertia against theta2"),
    (
        altered("negative_mass", bodies(lambda a, hip, b, q, p: (a, replace(hip, mass=-p.hip_mass), b))),
        "a body has a mass or inertia that is negative",
    ),
]


@pytest.mark.parametrize(("walker", "words"), REFUSED, ids=[walker.model for walker, _ in REFUSED])
def test_walker_that_is_not_the_same_after_the_swap_of_the_feet_is_refused(walker: type[Walker], words: str) -> None:
    with pytest.raises(ProblemError, match=f"^Altered: .*{words}"):
        check_walker(walker, COMPASS)
    text = (go.load_problem("compass-passive-a").text or "").replace("compass_biped", walker.model)
    with pytest.raises(ProblemError, match=rf"^problem:\d+:\d+ walker: Altered: .*{words}") as caught:
        parse_problem(text, walkers=(walker,))
    assert caught.value.exit_code == 3


@pytest.mark.parametrize(
    ("walker", "numbers"),
    [
        (CompassBiped, COMPASS),
        (CompassBiped, {**COMPASS, "hip_mass": 0.0}),
        (CompassBiped, {**COMPASS, "leg_mass": 1e-9, "leg_com": 1e-9, "hip_mass": 4e6}),
        (CompassBiped, {**COMPASS, "leg_length": 1.6e-3, "leg_com": 8e-4}),
        (CompassBiped, {**COMPASS, "leg_length": 1.6e3, "leg_com": 8e2, "gravity": 9.8e9}),
        (RimlessWheel, WHEEL),
        (RimlessWheel, {**WHEEL, "inertia_ratio": 0.0}),
        (TorsoCompass, TORSO),
    ],
)
def test_walkers_of_any_proportions_and_units_pass(walker: type[Walker], numbers: dict[str, Any]) -> None:
    check_walker(walker(**numbers))
    check_walker(walker, numbers)


def test_both_legs_may_be_rigid_bodies_with_angles_of_either_sign() -> None:
    def rigid(stance: Body, hip: Body, swing: Body, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Body, ...]:
        inertia = 0.1 * p.leg_mass
        return replace(stance, inertia=inertia, angle=q.theta1), hip, replace(swing, inertia=inertia, angle=q.theta2)

    check_walker(altered("rigid", bodies(rigid)), COMPASS)


def test_examples_of_the_documentation_load() -> None:
    for path in sorted(EXAMPLES.glob("*.yaml")):
        go.load_problem(path, walkers=(TorsoCompass,))
