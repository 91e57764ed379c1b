"""Links: a walker as a tree, and what follows from it."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from casadi import SX, Function

import gaitopt as go
from gaitopt import Link, Mechanism, Walker, check_walker, equations_of_motion
from gaitopt.errors import ProblemError
from gaitopt.model.declaration import state_picture
from gaitopt.model.units import Positive
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rabbit import Rabbit


def test_the_rotors_turn_with_the_joints_and_weigh_nothing() -> None:
    eom = equations_of_motion(Rabbit)
    function = Function("M", [eom.z, eom.p], [eom.M, eom.mass])
    light, heavy = ([float(v) for _, v in Rabbit(rotor_inertia=inertia)] for inertia in (0.0, 0.83))
    hips, knees = ((1, 0), (3, 0)), ((2, 1), (4, 3))
    turns = np.array([np.eye(7)[one] - np.eye(7)[other] for one, other in (*hips, *knees)])
    for z in np.random.default_rng(5).uniform(-1, 1, (5, 12)):
        (M, mass), (geared, same) = (function(z, p) for p in (light, heavy))
        np.testing.assert_allclose(np.asarray(geared - M), 0.83 * turns.T @ turns, atol=1e-13)
        assert float(mass) == float(same) == pytest.approx(32.0)


def test_the_drawing_of_a_tree_ends_at_its_feet_and_at_the_head() -> None:
    q = SimpleNamespace(**dict.fromkeys((*Rabbit.shape, "x", "y"), SX(0)))
    lines, contact = state_picture(Rabbit, q, SimpleNamespace(**dict(Rabbit())))
    heights = sorted(round(float(line[-1][1]), 12) for line in lines)
    assert heights == [0.0, 0.0, 0.4, 0.4, pytest.approx(0.8 + 0.63)]
    assert [float(x) for x in contact.elements()] == [0, 0]


class TwoLegs(Walker):
    """A compass of links alone; what the tests change in its links is in ``changes``."""

    model = "two_legs"
    shape = ("stance", "swing")
    posture: ClassVar = {"stance": -0.2, "swing": 0.2}
    actuators = ("hip",)
    tracked = ("swing",)
    changes: ClassVar[dict[str, dict[str, Any]]] = {}

    leg_length: Positive = 1.0
    gravity: Positive = 9.81

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """Two legs that hang on one hip."""
        leg: dict[str, Any] = {"tip": (0, -p.leg_length), "com": (0, -0.4), "mass": 2.0, "inertia": 0.1, "foot": True}
        links = (
            Link(name="body", parent="stance_leg", angle=q.stance, mass=5.0),
            Link(name="stance_leg", parent="swing_leg", joint="hip", angle=q.stance, **leg),
            Link(name="swing_leg", angle=q.swing, **leg),
        )
        return tuple(replace(link, **cls.changes.get(link.name, {})) for link in links)


def test_straight_legs_land_where_their_leans_are_opposite_and_walk_as_a_compass() -> None:
    """Three mechanisms in one: links with one sign of the angles, and the compass with two."""
    check_walker(TwoLegs())
    assert TwoLegs.section == ("stance",)
    text = """
name: two-legs
walker: {model: two_legs}
friction: 1
gait: {phases: [stick], impact: stick, guess: {state: {stance: -0.2, dstance: 1.2, dswing: 1.0}}}
"""
    problem = go.parse_problem(text, walkers=[TwoLegs])
    assert problem.guess.state["swing"] == pytest.approx(0.2)
    eom = equations_of_motion(TwoLegs)
    guard = Function("guard", [eom.z], [eom.mechanism.touchdown])
    assert float(guard([-0.3, 0.1, *np.zeros(4)])) == pytest.approx(-0.2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"swing_leg": {"foot": False}}, "links has the feet stance_leg, but must have two"),
        ({"swing_leg": {"name": "stance_leg"}}, "links names stance_leg twice"),
        ({"body": {"joint": "body"}}, "body is the name of a link and of a joint: rename one"),
        ({"stance_leg": {"parent": None, "joint": ""}}, "links has the roots stance_leg, swing_leg, but must be one"),
        ({"swing_leg": {"joint": "ground"}}, "the link swing_leg has the joint ground, but no parent"),
        ({"body": {"parent": "head"}}, "the link body has the parent 'head', which is not a link"),
        ({"body": {"parent": "body"}}, "the link body is its own ancestor: links must form a tree"),
        ({"body": {"name": "my body"}}, "links has the name 'my body', but must have a name of ASCII letters"),
        ({"body": {"mass": SX.sym("m")}}, "mass of the link body contains m, which is not a symbol that was"),
        ({"body": {"com": (0, 0, 0)}}, r"com of the link body is \(0, 0, 0\), but must be a column of 2"),
        ({"stance_leg": {"zero": float("nan")}}, "zero of the link stance_leg is nan, but must be a number"),
        ({"stance_leg": {"range": (1.0, 0.0)}}, r"range of the link stance_leg is \(1.0, 0.0\), but must be"),
        ({"stance_leg": {"joint": "knee"}}, r"actuators names hip, which is not a joint of its links \(knee\)"),
        ({"swing_leg": {"mass": 3.0}}, "its masses jump when the feet swap roles"),
    ],
)
def test_links_that_are_no_tree_or_no_walker_are_refused_in_a_sentence(changes: Any, words: str) -> None:
    class Changed(TwoLegs):
        pass

    Changed.changes = changes
    with pytest.raises(ProblemError, match=words):
        check_walker(Changed, {"leg_length": 1.0, "gravity": 9.81})


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"mass": 4 * (1 + 1e-10)}, "mass matrix"),
        ({"inertia": 1e-9}, "mass matrix"),
        ({"com": (1e-10, -0.8)}, "mass matrix"),
        ({"tip": (0, -1.6 - 1e-9)}, "mass matrix"),  # the links are placed on the foot
        ({"joint": "hip", "sign": -1}, "angle of a motor that has the name of a joint"),
    ],
)
def test_links_that_contradict_the_mechanism_are_refused(changes: dict[str, Any], what: str) -> None:
    class Right(CompassBiped):
        model = "right"
        changed: ClassVar[dict[str, Any]] = {}

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            return CompassBiped.mechanism(q, p)

        @classmethod
        def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
            stance, *others = super().links(q, p)
            return replace(stance, **cls.changed), *others

    class Wrong(Right):
        model, changed = "wrong", changes

    numbers = dict(go.load_problem("compass-passive-a").walker)
    check_walker(Right, numbers)
    with pytest.raises(ProblemError) as refusal:
        check_walker(Wrong, numbers)
    words = rf"Wrong: links and mechanism contradict each other: the {what} differs, at theta1 = \S+, theta2 = \S+"
    assert re.fullmatch(words, str(refusal.value))


def test_links_and_a_mechanism_that_is_written_in_another_way_agree() -> None:
    class Restated(CompassBiped):
        model = "restated"

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            mechanism = CompassBiped.mechanism(q, p)
            thirds = [replace(body, position=body.position / 3 + 2 * body.position / 3) for body in mechanism.bodies]
            return replace(mechanism, bodies=tuple(thirds))

        @classmethod
        def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
            return super().links(q, p)

    check_walker(Restated, dict(go.load_problem("compass-passive-a").walker))


def test_a_class_that_redefines_the_mechanism_alone_has_no_links() -> None:
    class Changed(CompassBiped):
        model = "changed"

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            mechanism = super().mechanism(q, p)
            legs = [replace(body, mass=2 * body.mass) for body in mechanism.bodies]
            return replace(mechanism, bodies=tuple(legs))

    check_walker(Changed, dict(go.load_problem("compass-passive-a").walker))
