"""Closure of the legs: walkers that leave the posture after an impact to the program walk as those that state it."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import pytest
from casadi import cos, pi, vertcat
from named import named
from pydantic import Field

import gaitopt as go
from gaitopt import Mechanism, Walker, check_walker, parse_problem
from gaitopt.errors import ProblemError
from gaitopt.model.units import NonNegative, Positive, Slope
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rabbit import Rabbit
from gaitopt.problem.statement import problem_data


class ClosedCompass(Walker):
    """The compass, without a word about its posture after an impact."""

    model = "closed_compass"
    shape = ("theta1", "theta2")
    actuators = ("ankle", "hip")
    tracked = ("theta1", "theta2")
    largest_angle = pi / 2

    leg_length: Positive
    leg_mass: Positive
    leg_com: Positive
    hip_mass: NonNegative
    gravity: Positive
    slope: Annotated[Slope, Field(description="slope")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return CompassBiped.mechanism(q, p)


class CurvedCompass(ClosedCompass):
    """The same with a guard that is not linear in theta2: the closure takes several steps of Newton's method."""

    model = "curved_compass"
    posture = {"theta1": -0.2, "theta2": -0.2}  # noqa: RUF012 - a class variable of Walker

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The guard is the sine of the old one, plus its cube."""
        compass = CompassBiped.mechanism(q, p)
        return replace(compass, touchdown=compass.touchdown.sin() + compass.touchdown**3)


@pytest.mark.parametrize("walker", [ClosedCompass, CurvedCompass])
@pytest.mark.parametrize("name", ["compass-passive-a", pytest.param("compass-torque-stick", marks=pytest.mark.slow)])
def test_a_compass_without_after_impact_has_the_gait_and_the_multipliers_of_the_compass(walker, name):
    gait = named(name)
    data: dict[str, Any] = problem_data(gait.problem)
    closed = parse_problem(json.dumps(data | {"walker": data["walker"] | {"model": walker.model}}), walkers=[walker])
    assert walker.section == ("theta1",)
    found = go.solve(closed)
    assert found.converged, found.message
    np.testing.assert_allclose(found.state, gait.state, atol=1e-10)
    np.testing.assert_allclose(found.multipliers, gait.multipliers, atol=1e-10)
    assert go.verify(found).passed


class Unclosed(ClosedCompass):
    """A guard that is never zero."""

    model = "unclosed"
    posture = {"theta1": 0.3}  # noqa: RUF012 - a class variable of Walker

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Both legs differ by more than they can."""
        return replace(CompassBiped.mechanism(q, p), touchdown=cos(q.theta1 - q.theta2) - 2)


class Bent(ClosedCompass):
    """Its feet swap roles by a formula that is not affine."""

    model = "bent"

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The sine of an angle takes its place."""
        return replace(CompassBiped.mechanism(q, p), relabel=vertcat(-q.theta2, -q.theta1.sin()))


COMPASS = {"leg_length": 1.0, "leg_mass": 1.0, "leg_com": 0.5, "hip_mass": 1.0, "gravity": 9.8, "slope": 0.0}


@pytest.mark.parametrize(
    ("walker", "words"),
    [
        (Unclosed, r"Unclosed: no theta\d closes the legs at .*: touchdown is not zero in any posture near it"),
        (Bent, "Bent: relabel is not affine: define section and after_impact"),
    ],
)
def test_a_walker_whose_legs_do_not_close_is_refused_in_a_sentence(walker: type[Walker], words: str) -> None:
    with pytest.raises(ProblemError, match=words):
        check_walker(walker, COMPASS)


RABBIT = """
name: rabbit-fall
walker: {model: rabbit}
friction: 0.6
gait: {phases: [stick], impact: stick, guess: {state: {torso: 0.05, stance_thigh: -0.35, stance_shin: -0.15,
  swing_thigh: %s, dtorso: 0, dstance_thigh: 1, dstance_shin: 1, dswing_thigh: 0, dswing_shin: 0}}}
"""


def test_a_guess_puts_both_feet_of_rabbit_on_the_ground_or_is_refused_with_its_place() -> None:
    """Heights of the feet by the cosines of the leans, with the posture on the side of ``Rabbit.posture``."""
    assert Rabbit.section == ("torso", "stance_thigh", "stance_shin", "swing_thigh")
    for lean in (0.02, 0.1, 0.18):
        state = parse_problem(RABBIT % lean, walkers=[Rabbit]).guess.state
        stance, swing = (np.cos([state[f"{leg}_thigh"], state[f"{leg}_shin"]]) for leg in ("stance", "swing"))
        assert 0.4 * stance.sum() == pytest.approx(0.4 * swing.sum(), abs=1e-13)
        assert state["swing_shin"] > 0
    with pytest.raises(ProblemError, match=r"problem:5:\d+ gait.guess.state: .*no swing_shin puts both feet on the gr"):
        parse_problem(RABBIT % "1.2", walkers=[Rabbit])
