"""Walkers that are not the same body before and after a swap of the feet are refused when they are loaded."""

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


class Altered(CompassBiped):
    """A compass with something else in its mechanism."""

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {}

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        compass = super().mechanism(q, p)
        return replace(compass, **cls.changes(q, p, compass))


class UnequalDistances(Altered):
    """The mass of one leg is at 0.3 m from the hip, that of the other at 0.5 m."""

    model = "unequal_distances"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        hip = compass.bodies[1].position
        stance = Body(mass=p.leg_mass, position=hip - polar(0.3, q.theta1))
        swing = Body(mass=p.leg_mass, position=hip - polar(0.5, -q.theta2))
        return {"bodies": (stance, compass.bodies[1], swing)}


class UnequalMasses(Altered):
    model = "unequal_masses"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        stance, hip, swing = compass.bodies
        return {"bodies": (replace(stance, mass=1.001 * p.leg_mass), hip, swing)}


class SpinningLeg(Altered):
    """Only one leg is a rigid body."""

    model = "spinning_leg"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        stance, hip, swing = compass.bodies
        return {"bodies": (replace(stance, inertia=0.1 * p.leg_mass, angle=q.theta1), hip, swing)}


class WrongRelabel(Altered):
    model = "wrong_relabel"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {"relabel": vertcat(q.theta2, q.theta1)}


class RightAtTouchdownOnly(Altered):
    """The angles are right where the legs have the same one, their rates are not."""

    model = "right_at_touchdown_only"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {"relabel": vertcat(-q.theta1, -q.theta2)}


class Forgetful(Altered):
    model = "forgetful"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {"relabel": vertcat(-q.theta2, -q.theta2)}


class SpringOnOneLeg(Altered):
    model = "spring_on_one_leg"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {"potential": 10 * (q.theta1 - 0.1) ** 2}


class HighFoot(Altered):
    model = "high_foot"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {"swing_foot": compass.swing_foot + SX([0, 0.01])}


class Massless(Altered):
    model = "massless"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        return {"bodies": compass.bodies[1:2]}


class WrongStart(CompassBiped):
    model = "wrong_start"

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (free.theta1, -free.theta1)


class ShortStart(CompassBiped):
    model = "short_start"

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (free.theta1,)


class NegativeMass(Altered):
    model = "negative_mass"

    @classmethod
    def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
        stance, hip, swing = compass.bodies
        return {"bodies": (stance, replace(hip, mass=-p.hip_mass), swing)}


@pytest.mark.parametrize(
    ("walker", "words"),
    [
        (UnequalDistances, "its masses jump when the feet swap roles: the body of 4 kg at"),
        (UnequalMasses, "its masses jump when the feet swap roles: the body of 4.* kg at"),
        (SpinningLeg, "its masses jump"),
        (WrongRelabel, "relabel must describe the same posture"),
        (RightAtTouchdownOnly, "or does not move so"),
        (Forgetful, "relabel cannot be inverted"),
        (WrongStart, "after_impact and touchdown contradict each other: a step would begin in the posture theta1 = "),
        (ShortStart, "after_impact gives 1 coordinates, but shape has 2"),
        (SpringOnOneLeg, "its potential energy jumps from .*: springs must be the same"),
        (HighFoot, "the swing foot is 0.01 m above the ground where touchdown is zero"),
        (Massless, "nothing has inertia against theta2"),
        (NegativeMass, "a body has a mass or inertia that is negative"),
    ],
)
def test_walker_that_is_not_the_same_after_the_swap_of_the_feet_is_refused(walker: type[Walker], words: str) -> None:
    with pytest.raises(ProblemError, match=f"^{walker.__name__}: .*{words}"):
        check_walker(walker, COMPASS)
    text = (go.load_problem("compass-passive-a").text or "").replace("compass_biped", walker.model)
    with pytest.raises(ProblemError, match=rf"^problem:\d+:\d+ walker: {walker.__name__}: .*{words}") as caught:
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
    class Rigid(Altered):
        @classmethod
        def changes(cls, q: SimpleNamespace, p: SimpleNamespace, compass: Mechanism) -> dict[str, Any]:
            stance, hip, swing = compass.bodies
            legs = [
                replace(body, inertia=0.1 * p.leg_mass, angle=angle)
                for body, angle in ((stance, q.theta1), (swing, q.theta2))
            ]
            return {"bodies": (legs[0], hip, legs[1])}

    check_walker(Rigid, COMPASS)


def test_examples_of_the_documentation_load() -> None:
    for path in sorted(EXAMPLES.glob("*.yaml")):
        go.load_problem(path, walkers=(TorsoCompass,))
