"""Links: a walker as a tree, and what follows from it."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from casadi import SX, Function, cos, jacobian, vertcat
from numpy.typing import NDArray

import gaitopt as go
from gaitopt import Body, Link, Mechanism, Walker, check_walker, equations_of_motion
from gaitopt.errors import ProblemError
from gaitopt.model import checks
from gaitopt.model.declaration import state_picture
from gaitopt.model.lagrangian import parameter_namespace
from gaitopt.model.mechanism import inclined, polar
from gaitopt.model.units import Positive
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rabbit import Rabbit
from gaitopt.model.walkers.torso import DrivenTorso, TorsoWalker


def compass(q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
    """Three point masses; touchdown when both legs have the same angle."""
    foot = vertcat(q.x, q.y)
    hip = foot + polar(p.leg_length, q.theta1)
    return Mechanism(
        bodies=(
            Body(mass=p.leg_mass, position=foot + polar(p.leg_com, q.theta1)),
            Body(mass=p.hip_mass, position=hip),
            Body(mass=p.leg_mass, position=hip - polar(p.leg_length - p.leg_com, -q.theta2)),
        ),
        gravity=inclined(p.gravity, p.slope),
        swing_foot=hip - polar(p.leg_length, -q.theta2),
        touchdown=q.theta1 - q.theta2,
        upright=cos(q.theta1),
        relabel=vertcat(-q.theta2, -q.theta1),
        motors=(q.theta1, q.theta1 + q.theta2),
    )


def torso(q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
    """Two point masses and a rigid body."""
    foot = vertcat(q.x, q.y)
    hip = foot + polar(p.leg_length, q.theta1)
    return Mechanism(
        bodies=(
            Body(mass=p.leg_mass, position=foot + polar(p.leg_com, q.theta1)),
            Body(mass=p.leg_mass, position=hip - polar(p.leg_length - p.leg_com, -q.theta2)),
            Body(mass=p.torso_mass, position=hip + polar(p.torso_com, q.torso), inertia=p.torso_inertia, angle=q.torso),
        ),
        gravity=inclined(p.gravity, p.slope),
        swing_foot=hip - polar(p.leg_length, -q.theta2),
        touchdown=q.theta1 - q.theta2,
        upright=cos(q.theta1) * cos(q.torso),
        relabel=vertcat(-q.theta2, -q.theta1, q.torso),
        motors=(q.torso - q.theta1,),
    )


def driven_torso(q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
    """The mechanism of the torso, with another motor."""
    return replace(torso(q, p), motors=(q.torso - q.theta1, q.torso + q.theta2))


BY_HAND = {CompassBiped: compass, TorsoWalker: torso, DrivenTorso: driven_torso}


def symbols(walker: type[Walker]) -> tuple[SX, SimpleNamespace, SX, SimpleNamespace]:
    """Coordinates and parameters of a walker, as columns and by name."""
    q, p = SX.sym("q", len(walker.shape) + 2), SX.sym("p", len(walker.model_fields))
    names = (*walker.shape, "x", "y")
    return q, SimpleNamespace(**{name: q[k] for k, name in enumerate(names)}), p, parameter_namespace(walker, p)


def random_points(walker: type[Walker], count: int = 20) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Random coordinates and parameters."""
    random, n, m = np.random.default_rng(5), len(walker.shape) + 2, len(walker.model_fields)
    return [(random.uniform(-1, 1, n), random.uniform(0.2, 2.0, m)) for _ in range(count)]


@pytest.mark.parametrize("walker", BY_HAND)
def test_the_mechanism_of_the_links_is_the_one_written_by_hand(walker: type[Walker]) -> None:
    """Mass matrix, weight, swing foot, relabelling, motors and touchdown agree, and the sign of ``upright``."""
    q, by_name, p, parameters = symbols(walker)

    def properties(mechanism: Mechanism) -> list[SX]:
        places = [vertcat(body.position, SX(body.angle)) for body in mechanism.bodies]
        weights = [vertcat(SX(body.mass), SX(body.mass), SX(body.inertia)) for body in mechanism.bodies]
        J, w = jacobian(vertcat(*places), q), vertcat(*weights)
        moment = sum((SX(body.mass) * body.position for body in mechanism.bodies), SX.zeros(2))
        parts = (mechanism.swing_foot, mechanism.relabel, *mechanism.motors, mechanism.gravity, mechanism.touchdown)
        return [J.T @ (J * (w @ SX.ones(1, q.numel()))), moment, *parts, mechanism.upright]

    derived, stated = walker.mechanism(by_name, parameters), BY_HAND[walker](by_name, parameters)
    pairs = list(zip(properties(stated), properties(derived), strict=True))
    function = Function("both", [q, p], [part for pair in pairs for part in pair])
    for at, values in random_points(walker):
        entries = [np.asarray(value) for value in function([*at[:-1], 0.0], values)]  # the stance foot is on the ground
        for by_hand, follows in zip(entries[:-2:2], entries[1:-2:2], strict=True):
            np.testing.assert_allclose(follows, by_hand, atol=1e-12, rtol=1e-12)
        assert np.sign(entries[-2]) == np.sign(entries[-1])
    assert set(derived.stops) == set(stated.stops)


def rabbit_matrix(q: NDArray[Any], p: Rabbit) -> NDArray[Any]:
    """Mass matrix of RABBIT in (torso, stance thigh, stance shin, swing thigh, swing shin, x, y), by hand.

    With e = (sin, cos) of a lean and its derivative e' = (cos, -sin), a point at distances l_k along the links has the
    velocity sum l_k e'_k dphi_k.
    """
    along = {
        "stance_shin": [0, 0, p.shin_length - p.shin_com, 0, 0],
        "stance_thigh": [0, p.thigh_length - p.thigh_com, p.shin_length, 0, 0],
        "torso": [p.torso_com, p.thigh_length, p.shin_length, 0, 0],
        "swing_thigh": [0, p.thigh_length, p.shin_length, -p.thigh_com, 0],
        "swing_shin": [0, p.thigh_length, p.shin_length, -p.thigh_length, -p.shin_com],
    }
    M = np.zeros((7, 7))
    for name, distances in along.items():
        kind = name.rpartition("_")[2]
        J = np.vstack([np.array(distances) * np.cos(q[:5]), -np.array(distances) * np.sin(q[:5])])
        J = np.hstack([J, np.eye(2)])
        M += getattr(p, f"{kind}_mass") * J.T @ J
        k = Rabbit.shape.index(name)
        M[k, k] += getattr(p, f"{kind}_inertia")
    for one, other in ((1, 0), (2, 1), (3, 0), (4, 3)):
        d = np.eye(7)[one] - np.eye(7)[other]
        M += p.rotor_inertia * np.outer(d, d)
    return M


@pytest.mark.parametrize("rotor_inertia", [0.0, 0.83])
def test_rabbit_has_the_mass_matrix_that_is_derived_by_hand(rotor_inertia: float) -> None:
    walker = Rabbit(rotor_inertia=rotor_inertia, thigh_length=0.43)
    eom = equations_of_motion(Rabbit)
    function = Function("M", [eom.z, eom.p], [eom.M, eom.mechanism.swing_foot, eom.E])
    p = [float(value) for _, value in walker]
    for at, _ in random_points(Rabbit):
        state = [*at[:5], at[5], *np.zeros(6)]
        M, foot, E = (np.asarray(value) for value in function(state, p))
        np.testing.assert_allclose(M, rabbit_matrix(at, walker), atol=1e-13)
        _, thigh, shin, swing_thigh, swing_shin = at[:5]
        height = 0.43 * np.cos(thigh) + 0.4 * np.cos(shin) - 0.43 * np.cos(swing_thigh) - 0.4 * np.cos(swing_shin)
        assert foot[1] == pytest.approx(height, abs=1e-14)
        np.testing.assert_array_equal(
            E.T[:, :5], [[-1, 1, 0, 0, 0], [0, -1, 1, 0, 0], [-1, 0, 0, 1, 0], [0, 0, 0, -1, 1]]
        )


def test_the_rotors_turn_with_the_joints_and_weigh_nothing() -> None:
    eom = equations_of_motion(Rabbit)
    weight = Function("weight", [eom.p], [eom.mass])
    light, heavy = ([float(v) for _, v in Rabbit(rotor_inertia=inertia)] for inertia in (0.0, 0.83))
    assert float(weight(light)) == float(weight(heavy)) == pytest.approx(32.0)


def test_rabbit_swaps_its_legs_by_a_permutation() -> None:
    eom = equations_of_motion(Rabbit)
    swapped = Function("relabel", [eom.z], [eom.mechanism.relabel])([1, 2, 3, 4, 5, *np.zeros(7)])
    np.testing.assert_array_equal(np.asarray(swapped).ravel(), [1, 4, 5, 2, 3])
    check_walker(Rabbit())


def test_the_drawing_of_a_tree_ends_at_its_feet_and_at_the_head() -> None:
    q, by_name, p, parameters = symbols(Rabbit)
    lines, contact = state_picture(Rabbit, by_name, parameters)
    ends = Function("ends", [q, p], [vertcat(*(line[-1] for line in lines)), contact])
    drawn, touching = ends(np.zeros(7), [float(value) for _, value in Rabbit()])
    heights = sorted(np.asarray(drawn).ravel()[1::2].round(12))
    assert heights == [0.0, 0.0, 0.4, 0.4, pytest.approx(0.8 + 0.63)]
    np.testing.assert_array_equal(np.asarray(touching).ravel(), [0, 0])


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
        ({"swing_leg": {"parent": "body"}}, "links has the roots none, but must be one tree"),
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
    class Wrong(CompassBiped):
        model = "wrong"
        changed: ClassVar[dict[str, Any]] = {}

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            return compass(q, p)

        @classmethod
        def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
            stance, *others = super().links(q, p)
            return replace(stance, **cls.changed), *others

    numbers = dict(go.load_problem("compass-passive-a").walker)
    check_walker(Wrong, numbers)
    Wrong.changed = changes
    for cached in (checks._fault, checks._links_pairs):
        cached.cache_clear()
    with pytest.raises(ProblemError) as refusal:
        check_walker(Wrong, numbers)
    words = rf"Wrong: links and mechanism contradict each other: the {what} differs, at theta1 = \S+, theta2 = \S+"
    assert re.fullmatch(words, str(refusal.value))


def test_a_class_that_redefines_the_mechanism_alone_has_no_links() -> None:
    class Changed(CompassBiped):
        model = "changed"

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            mechanism = super().mechanism(q, p)
            legs = [replace(body, mass=2 * body.mass) for body in mechanism.bodies]
            return replace(mechanism, bodies=tuple(legs))

    check_walker(Changed, dict(go.load_problem("compass-passive-a").walker))
