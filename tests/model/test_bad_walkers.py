"""Classes of walkers that are wrong in some way, made by machine and by hand: each is refused with one sentence."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import pytest
from casadi import DM, MX, SX, cos, fabs, if_else, sqrt, vertcat
from oracles import COMPASS, EXAMPLES, TORSO, WHEEL, TorsoCompass
from pydantic import Field, field_validator
from samples import sampled

import gaitopt as go
from gaitopt import Body, Damper, Mechanism, Walker, check_walker, parse_problem
from gaitopt.errors import ProblemError
from gaitopt.model.control import NoControl
from gaitopt.model.mechanism import polar
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import MARGINS
from gaitopt.model.units import Positive
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.model.walkers.push_off import PushOffCompass
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.model.walkers.slip_runner import SlipRunner
from gaitopt.model.walkers.unequal_compass import UnequalCompass

PROBLEMS = {
    CompassBiped: "compass-torque-stick",
    Hopper: "hopper",
    KneedWalker: "kneed-passive",
    PushOffCompass: "compass-push-off",
    HeelToe: "heel-toe",
    SlipRunner: "slip-run",
    UnequalCompass: "compass-unequal",
}
NAN = float("nan")
LIAR = SX.sym("liar")


class Unprintable:
    def __repr__(self) -> str:
        raise RuntimeError("no text")


def altered(base: type[Walker], attributes: dict[str, Any]) -> type[Walker]:
    """A class that differs from ``base`` by some attributes, annotated ones included."""
    own = {"__module__": __name__, "__qualname__": "Bad", "model": f"bad_{base.model}"}
    return type("Bad", (base,), own | attributes)


def text_of(name: str) -> str:
    """A named problem whose walker is a class that ``altered`` returns."""
    return (go.load_problem(name).text or "").replace("model: ", "model: bad_")


def returning(value: Any) -> classmethod:
    return classmethod(lambda cls, *arguments: value)


def with_parts(base: type[Walker], **parts: Any) -> type[Walker]:
    """A class whose mechanism has other entries; those that can be called are functions of mechanism, q and p."""

    def mechanism(cls: type[Walker], q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        good = base.__dict__["mechanism"].__func__(cls, q, p)
        return replace(good, **{name: part(good, q, p) if callable(part) else part for name, part in parts.items()})

    return altered(base, {"mechanism": classmethod(mechanism)})


def body_with(**parts: Any) -> Callable[[Mechanism, Any, Any], tuple[Body, ...]]:
    return lambda m, q, p: (replace(m.bodies[0], **parts), *m.bodies[1:])


def refusal(walker: Any, base: type[Walker] = CompassBiped) -> str:
    """What is said where a problem with this walker is loaded; the line that is about it."""
    text = text_of(PROBLEMS[base])
    with pytest.raises(ProblemError) as caught:
        parse_problem(text, walkers=[walker])
    assert caught.value.exit_code == 3
    return next(line for line in str(caught.value).splitlines() if "Bad" in line or "walker." in line)


# ---------------------------------------------------------------------------------------------------------- by machine
SCALARS = ("touchdown", "upright", "potential")
VECTORS = ("gravity", "swing_foot", "relabel")
STRANGE = {
    "none": None,
    "text": "1.0",
    "true": True,
    "list": [1.0, 2.0],
    "tuple": (SX(1), SX(2)),
    "complex": 1j,
    "3-vector": SX([1, 2, 3]),
    "row": SX([[1, 2]]),
    "matrix": SX.eye(2),
    "empty": SX(0, 1),
    "foreign": vertcat(LIAR, LIAR),
    "mx": MX.sym("mx", 2),
    "function": np.sin,
    "object": Unprintable(),
    "texts": np.array(["a", "b"]),
    "nan": SX([NAN, NAN]),
}


@pytest.mark.parametrize(("part", "kind"), sampled(product((*SCALARS, *VECTORS), STRANGE)))
def test_an_entry_of_a_mechanism_that_is_no_expression_of_its_shape_is_named(part: str, kind: str) -> None:
    value = STRANGE[kind]
    if part in SCALARS and kind in ("foreign", "nan"):
        value = value[0]
    line = refusal(with_parts(CompassBiped, **{part: lambda m, q, p: value}))
    assert "Bad: " in line
    assert f"Mechanism.{part}" in line or "the swing foot does not move along" in line


@pytest.mark.parametrize(
    ("part", "kind"), sampled(product(("mass", "position", "inertia", "angle"), sorted({*STRANGE} - {"matrix"})), 4)
)
def test_an_entry_of_a_body_that_is_no_expression_of_its_shape_is_named(part: str, kind: str) -> None:
    value = STRANGE[kind]
    if part != "position" and kind in ("foreign", "nan"):
        value = value[0]
    line = refusal(with_parts(CompassBiped, bodies=body_with(**{part: value})))
    assert "Bad: " in line
    assert f"Mechanism.bodies[0].{part}" in line or "body 0 does not move along" in line or "inertia that is" in line


RETURNS = {
    "none": None,
    "text": "ab",
    "number": 3,
    "expression": SX(2, 1),
    "of texts": ("a", "b"),
    "of none": (None, None),
    "of vectors": (SX(3, 1), SX(3, 1)),
    "of foreign symbols": (LIAR, LIAR),
    "too long": (0.0,) * 7,
    "empty": (),
    "of not numbers": (NAN, NAN),
    "infinite": (float("inf"), 0.0),
}
METHODS = ("after_impact", "rates_after_impact", "landing", "outline", "contact", "mechanism")


ALLOWED = {("outline", "empty"), ("contact", "expression"), ("section_rates", "none"), ("tracked", "twice")}
"""What is strange only for other methods and attributes."""


@pytest.mark.parametrize(("method", "kind"), sampled(sorted({*product(METHODS, RETURNS)} - ALLOWED), 4))
def test_a_method_that_returns_something_else_is_named(method: str, kind: str) -> None:
    base = SlipRunner if method == "landing" else CompassBiped
    line = refusal(altered(base, {method: returning(RETURNS[kind])}), base)
    assert "Bad: " in line
    assert method in line


RAISES = {
    "exit": lambda: sys.exit(3),
    "error": lambda: 1 / 0,
    "assertion": lambda: [][0],
    "casadi": lambda: SX.sym("a", 2) + SX.sym("b", 3),
    "recursion": lambda: (f := lambda g: g(g))(f),
    "textless": lambda: (_ for _ in ()).throw(type("Textless", (Exception,), {"__str__": lambda self: 1 / 0})()),
}


@pytest.mark.parametrize(("method", "kind"), sampled(product(METHODS, RAISES)))
def test_a_method_that_raises_or_ends_the_process_is_named(method: str, kind: str) -> None:
    base = SlipRunner if method == "landing" else CompassBiped
    line = refusal(altered(base, {method: classmethod(lambda cls, *arguments: RAISES[kind]())}), base)
    assert f"Bad: {method} raises " in line


@pytest.mark.parametrize("method", METHODS)
def test_a_method_without_classmethod_or_with_other_arguments_is_named(method: str) -> None:
    base = SlipRunner if method == "landing" else CompassBiped
    line = refusal(altered(base, {method: lambda cls, *arguments: None}), base)
    assert f"{method} must be a class method" in line
    line = refusal(altered(base, {method: classmethod(lambda cls: None)}), base)
    assert f"{method} raises TypeError" in line


LISTS = ("shape", "section", "section_rates", "stops", "open_in_impact", "switches", "lengths", "actuators", "tracked")
BAD_LISTS = {
    "none": None,
    "text": "theta1",
    "list": ["theta1"],
    "number": 2,
    "of numbers": (1, 2),
    "of none": (None,),
    "twice": ("theta1", "theta1"),
    "unknown": ("theta9",),
    "spaced": ("the ta",),
    "empty name": ("",),
    "not ascii": ("θ",),
    "underscores": ("a__b",),
}


@pytest.mark.parametrize(("name", "kind"), sampled(sorted({*product(LISTS, BAD_LISTS)} - ALLOWED)))
def test_a_class_attribute_that_is_no_tuple_of_known_names_is_named(name: str, kind: str) -> None:
    line = refusal(altered(CompassBiped, {name: BAD_LISTS[kind]}))
    assert "Bad: " in line
    assert name in line or "not a shape coordinate" in line


# ------------------------------------------------------------------------------------------------------------- by hand
def fields(**annotations: Any) -> dict[str, Any]:
    """Further parameters; a pair is an annotation and a default."""
    pairs = {name: value if isinstance(value, tuple) else (value,) for name, value in annotations.items()}
    values = {name: pair[1] for name, pair in pairs.items() if len(pair) > 1}
    return {"__annotations__": {name: pair[0] for name, pair in pairs.items()}, **values}


def raising_validator() -> dict[str, Any]:
    def check(cls: type[Walker], value: float) -> float:
        sys.exit(7)

    return {"leave": field_validator("leg_mass")(classmethod(check))}


def undefined_beyond(m: Mechanism, q: SimpleNamespace, p: SimpleNamespace) -> SX:
    return m.upright + 1e-9 * sqrt(0.1 - q.theta1)


BY_HAND: dict[str, tuple[type[Walker], dict[str, Any] | type[Walker], str]] = {
    "model none": (CompassBiped, {"model": None}, "model is None"),
    "model spaced": (CompassBiped, {"model": "a b"}, "model is 'a b'"),
    "model annotated": (CompassBiped, fields(shape=(tuple, ("theta1", "theta2"))), "shape has an annotation of a type"),
    "largest angle zero": (CompassBiped, {"largest_angle": 0}, "largest_angle is 0,"),
    "largest angle nan": (CompassBiped, {"largest_angle": NAN}, "largest_angle is nan,"),
    "largest angle large": (CompassBiped, {"largest_angle": 4.0}, "at most pi"),
    "largest angle text": (CompassBiped, {"largest_angle": "1"}, "largest_angle is '1'"),
    "flies a word": (CompassBiped, {"flies": "no"}, "flies is 'no', but must be True or False"),
    "pushes a number": (CompassBiped, {"pushes": 1}, "pushes is 1, but must be True or False"),
    "pushes without push": (CompassBiped, {"pushes": True}, "pushes is True, but Mechanism.push is missing"),
    "push without pushes": (PushOffCompass, {"pushes": False}, "pushes is False, but Mechanism.push is given"),
    "massless feet with contacts": (
        HeelToe,
        {"massless_feet": True, "landing": returning(((0, 0), (0, 0)))},
        "massless_feet is True, but has no effect on a walker with contacts: name the",
    ),
    "massless feet": (CompassBiped, {"massless_feet": True}, "its bodies cannot move on as they did when a foot lands"),
    "column as shape": (CompassBiped, {"shape": ("t", "theta2")}, "shape names t, which is another column"),
    "actuator as shape": (CompassBiped, {"actuators": ("theta1", "hip")}, "actuators names theta1, which is a coord"),
    "foot as shape": (CompassBiped, {"shape": ("theta1", "x")}, "shape names x or y"),
    "rate as shape": (CompassBiped, {"shape": ("theta", "dtheta"), "section": ("theta",)}, "dtheta would be both"),
    "no shape": (CompassBiped, {"shape": (), "section": ()}, "shape is empty"),
    "tracked too short": (CompassBiped, {"tracked": ("theta1",)}, "tracked has 1 entry, but actuators has 2"),
    "one more actuator": (CompassBiped, {"actuators": ("a", "b", "c"), "tracked": ("theta1",) * 3}, "motors has 2"),
    "actuator called type": (CompassBiped, {"actuators": ("type", "hip")}, "type has another meaning"),
    **{
        f"{group} called {m}": (KneedWalker, {group: (m,)}, f"{m} has another meaning")
        for group in ("stops", "sections")
        for m in MARGINS
    },
    "stop and section": (KneedWalker, {"sections": ("knee",)}, "knee is named by both stops and sections"),
    "stop and switch": (KneedWalker, {"switches": ("knee",)}, "knee is named by both stops and switches"),
    "unknown stop opens": (KneedWalker, {"open_in_impact": ("hip",)}, "open_in_impact names hip, which is not a stop"),
    "stops not declared": (KneedWalker, {"stops": ()}, "Mechanism.stops has knee, but stops are ()"),
    "state names": (CompassBiped, {"state_names": returning(("a",))}, "state_names must not be overridden"),
    "exchanged list": (UnequalCompass, {"exchanged": ["leg_mass"]}, "exchanged is ['leg_mass'], but must be a mapping"),
    "exchanged unknown": (UnequalCompass, {"exchanged": {"leg_mass": "arm"}}, "exchanged names arm"),
    "exchanged forgotten": (UnequalCompass, {"exchanged": {}}, "its masses jump when the feet swap roles"),
    "exchanged with itself": (UnequalCompass, {"exchanged": {"leg_mass": "leg_mass"}}, "exchanged names leg_mass"),
    "exchanged numbers": (UnequalCompass, {"exchanged": {1: 2}}, "exchanged is {1: 2}"),
    "field text": (CompassBiped, fields(name=(str, "a")), "the parameter name is of type str"),
    "field bool": (CompassBiped, fields(heavy=(bool, True)), "the parameter heavy is of type bool"),
    "field any": (CompassBiped, fields(thing=(Any, 1.0)), "the parameter thing is of type Any"),
    "field default nan": (CompassBiped, fields(extra=(float, NAN)), "the parameter extra is nan"),
    "field default huge": (CompassBiped, fields(extra=(int, 10**400)), "the parameter extra is"),
    "field default negative": (CompassBiped, fields(extra=(Positive, -1.0)), "must be greater than 0"),
    "field default text": (CompassBiped, fields(extra=(float, "a")), "extra"),
    "field alias": (CompassBiped, fields(extra=(float, Field(1.0, alias="other"))), "the parameter extra has an alias"),
    "field excluded": (CompassBiped, fields(extra=(float, Field(1.0, exclude=True))), "extra is excluded"),
    "extra keys": (CompassBiped, {"model_config": {"extra": "allow"}}, "model_config must keep"),
    "not frozen": (CompassBiped, {"model_config": {"frozen": False}}, "model_config must keep"),
    "validator exits": (CompassBiped, raising_validator(), "reading its parameters raises SystemExit: 7"),
    "after impact nan somewhere": (
        CompassBiped,
        {"after_impact": classmethod(lambda cls, free, p: (free.theta1, if_else(free.theta1 > 0.2, NAN, free.theta1)))},
        "after_impact gives theta2 = nan at theta1 = 0.2",
    ),
    "outline nan": (
        CompassBiped,
        {"outline": classmethod(lambda cls, q, p: ((vertcat(q.x, q.y), vertcat(NAN, q.y)),))},
        "line 0 of outline is nan",
    ),
    "outline of one point": (
        CompassBiped,
        {"outline": classmethod(lambda cls, q, p: ((vertcat(q.x, q.y),),))},
        "at least two points",
    ),
    "outline of 3-vectors": (CompassBiped, {"outline": returning(((SX(3, 1), SX(3, 1)),))}, "outline, line 0, point"),
    "start off the section": (
        CompassBiped,
        {"after_impact": classmethod(lambda cls, free, p: (free.theta1, -free.theta1))},
        "after_impact and touchdown contradict each",
    ),
    "short start": (
        CompassBiped,
        {"after_impact": classmethod(lambda cls, free, p: (free.theta1,))},
        "after_impact gives 1 coordinates, but shape has 2",
    ),
    "contact nan": (CompassBiped, {"contact": returning(SX([NAN, 0]))}, "contact is nan"),
}
BY_PARTS: dict[str, tuple[type[Walker], dict[str, Any], str]] = {
    "body adrift": (CompassBiped, {"bodies": body_with(position=vertcat(1, 1))}, "body 0 does not move along with"),
    "bodies empty": (CompassBiped, {"bodies": ()}, "Mechanism.bodies is empty"),
    "bodies of numbers": (CompassBiped, {"bodies": (1, 2)}, "must be a tuple of Body(...)"),
    "one body": (CompassBiped, {"bodies": lambda m, q, p: m.bodies[0]}, "a tuple of Body(...)"),
    "dampers of springs": (CompassBiped, {"dampers": ("soft",)}, "a tuple of Damper(...)"),
    "damper across none": (CompassBiped, {"dampers": (Damper(coefficient=1.0, across=None),)}, "[0].across is None"),
    "damper of nan": (
        CompassBiped,
        {"dampers": lambda m, q, p: (Damper(coefficient=NAN, across=q.theta1),)},
        "Mechanism.dampers[0].coefficient is nan",
    ),
    "damper that drives": (
        CompassBiped,
        {"dampers": lambda m, q, p: (Damper(coefficient=-0.1, across=q.theta1),)},
        "dampers give energy",
    ),
    "motors none": (CompassBiped, {"motors": None}, "Mechanism.motors is None"),
    "motors of texts": (CompassBiped, {"motors": ("a", "b")}, "Mechanism.motors[0] is 'a'"),
    "stops a tuple": (KneedWalker, {"stops": ("knee",)}, "must be a mapping from names"),
    "gap none": (KneedWalker, {"stops": {"knee": None}}, "Mechanism.stops['knee'] is None"),
    "gap not affine": (KneedWalker, {"stops": lambda m, q, p: {"knee": q.theta2**2}}, "must be affine"),
    "switch no function": (Hopper, {"switches": {"thrust": SX(1)}}, "must be a function of the rates"),
    "switch raises": (Hopper, {"switches": lambda m, q, p: {"thrust": lambda dq: dq.nothing}}, "raises AttributeError"),
    "switch a vector": (Hopper, {"switches": lambda m, q, p: {"thrust": lambda dq: SX(2, 1)}}, "has shape (2, 1)"),
    "switch foreign": (Hopper, {"switches": lambda m, q, p: {"thrust": lambda dq: LIAR}}, "contains liar"),
    "energy in no state": (Hopper, {"potential_while": lambda m, q, p: {"knee free": SX(1)}}, "allowed: contact, leg"),
    "push a number": (PushOffCompass, {"push": 1.0}, "Mechanism.push has shape (1, 1)"),
    "mass of the posture": (
        CompassBiped,
        {"bodies": lambda m, q, p: (replace(m.bodies[0], mass=1 + q.theta1**2), *m.bodies[1:])},
        "Mechanism.bodies[0].mass must be a function of the parameters alone",
    ),
    "gravity of the posture": (CompassBiped, {"gravity": lambda m, q, p: vertcat(q.theta1, -9.8)}, "of the parameters"),
    "spring to the ground": (CompassBiped, {"potential": lambda m, q, p: q.x**2}, "potential must be a function of"),
    "guard of the place": (CompassBiped, {"touchdown": lambda m, q, p: q.x - 1}, "but not of x"),
    "guard constant": (CompassBiped, {"touchdown": 0.0}, "Mechanism.touchdown must depend on"),
    "upright nan somewhere": (CompassBiped, {"upright": undefined_beyond}, "Mechanism.upright is nan at theta1 = "),
    "upright negative": (CompassBiped, {"upright": lambda m, q, p: -cos(q.theta1)}, "upright is -0.9"),
    "upright infinite slope": (
        CompassBiped,
        {"upright": lambda m, q, p: 1 + sqrt(fabs(q.theta1 - q.theta2))},
        "the derivative of Mechanism.upright is",
    ),
    "no gravity": (CompassBiped, {"gravity": DM([0, 0])}, "its length, mass or gravity is zero"),
}
BY_PARTS |= {  # walkers that are not the same body before and after a swap of the feet
    "legs of other lengths": (
        CompassBiped,
        {"bodies": lambda m, q, p: (
            Body(mass=p.leg_mass, position=m.bodies[1].position - polar(0.3, q.theta1)), m.bodies[1],
            Body(mass=p.leg_mass, position=m.bodies[1].position - polar(0.5, -q.theta2)),
        )},
        "its masses jump when the feet swap roles: the body of 4 kg at",
    ),
    "legs of other masses": (
        CompassBiped,
        {"bodies": lambda m, q, p: (replace(m.bodies[0], mass=1.001 * p.leg_mass), *m.bodies[1:])},
        "its masses jump when the feet swap roles: the body of 4.0",
    ),
    "only one leg is a rigid body": (
        CompassBiped,
        {"bodies": lambda m, q, p: (replace(m.bodies[0], inertia=0.1 * p.leg_mass, angle=q.theta1), *m.bodies[1:])},
        "its masses jump",
    ),
    "wrong relabel": (CompassBiped, {"relabel": lambda m, q, p: vertcat(q.theta2, q.theta1)}, "relabel must describe"),
    # the angles are right where the legs have the same one, their rates are not
    "right at touchdown only": (
        CompassBiped, {"relabel": lambda m, q, p: vertcat(-q.theta1, -q.theta2)}, "or does not move so"
    ),
    "forgetful": (
        CompassBiped, {"relabel": lambda m, q, p: vertcat(-q.theta2, -q.theta2)}, "relabel cannot be inverted"
    ),
    "spring on one leg": (CompassBiped, {"potential": lambda m, q, p: (q.theta1 - 0.1) ** 2}, "its potential energy"),
    "high foot": (
        CompassBiped, {"swing_foot": lambda m, q, p: m.swing_foot + SX([0, 0.01])}, "the swing foot is 0.01 m"
    ),
    "massless": (CompassBiped, {"bodies": lambda m, q, p: m.bodies[1:2]}, "nothing has inertia against theta2"),
    "negative mass": (
        CompassBiped,
        {"bodies": lambda m, q, p: (m.bodies[0], replace(m.bodies[1], mass=-p.hip_mass), m.bodies[2])},
        "a body has a mass or inertia that is negative",
    ),
}  # fmt: skip
PUSHES: dict[str, tuple[Any, Any, str]] = {
    "all": (True, vertcat(0, 1), "pushes is True, but must be a tuple of those contacts with a mass"),
    "unknown": (("ankle",), {"ankle": vertcat(0, 1)}, "possible: heel, toe, swing_heel, swing_toe"),
    "no mapping": (("toe",), vertcat(0, 1), "must be a mapping from the names of pushes, ('toe',)"),
    "none": (("toe",), None, "pushes is ('toe',), but Mechanism.push is missing"),
    "a number": (("toe",), {"toe": SX(1)}, "Mechanism.push['toe'] has shape (1, 1), but must be a column of 2"),
}
BY_HAND |= {
    f"push of contacts: {name}": (
        HeelToe,
        altered(with_parts(HeelToe, push=push), {"model": "bad_heel_toe", "pushes": pushes}),
        words,
    )
    for name, (pushes, push, words) in PUSHES.items()
}
BY_HAND |= {name: (base, with_parts(base, **parts), words) for name, (base, parts, words) in BY_PARTS.items()}


@pytest.mark.filterwarnings("ignore:Field name:UserWarning")  # of pydantic, as the class is made
@pytest.mark.parametrize("case", BY_HAND)
def test_a_class_that_is_wrong_in_another_way_is_refused(case: str) -> None:
    base, change, words = BY_HAND[case]
    line = refusal(change if isinstance(change, type) else altered(base, change), base)
    assert words in line


@pytest.mark.parametrize("walkers", [None, CompassBiped, "compass", [None], [3], [CompassBiped, "x"], [Walker]])
def test_what_is_no_list_of_classes_is_refused(walkers: Any) -> None:
    with pytest.raises(ProblemError, match=r"walker"):
        go.load_problem("compass-passive-a", walkers=walkers)


def test_two_classes_with_one_name_are_refused() -> None:
    pair = [altered(CompassBiped, {"model": "twin"}) for _ in range(2)]
    with pytest.raises(ProblemError, match="Bad and Bad are both called 'twin'"):
        go.load_problem("compass-passive-a", walkers=pair)


def test_a_class_that_is_used_without_a_problem_is_refused_as_well() -> None:
    walker = with_parts(CompassBiped, relabel=[1, 2])
    with pytest.raises(ProblemError, match=r"Mechanism\.relabel is \[1, 2\]"):
        HybridSystem(walker, NoControl())
    with pytest.raises(ProblemError, match="largest_angle"):
        check_walker(altered(CompassBiped, {"largest_angle": -1}), {})


def rigid_legs(m: Mechanism, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Body, ...]:
    """Both legs are rigid bodies, with angles of either sign."""
    (stance, hip, swing), inertia = m.bodies, 0.1 * p.leg_mass
    return replace(stance, inertia=inertia, angle=q.theta1), hip, replace(swing, inertia=inertia, angle=q.theta2)


def good_classes() -> Iterator[type[Walker]]:
    yield altered(CompassBiped, {})
    yield with_parts(CompassBiped, potential=0, bodies=lambda m, q, p: [*m.bodies], motors=lambda m, q, p: [*m.motors])
    yield with_parts(CompassBiped, gravity=lambda m, q, p: DM([0.2, -9.8]))
    yield with_parts(CompassBiped, gravity=np.array([0.2, -9.8]))
    yield altered(CompassBiped, {"outline": returning([]), "largest_angle": 1})
    yield with_parts(CompassBiped, bodies=rigid_legs)
    yield altered(CompassBiped, fields(extra=(Annotated[float, Field(ge=0)], 1.0), count=(int, 3)))


@pytest.mark.parametrize("walker", [*good_classes()])
def test_rigid_legs_pass_and_numbers_and_lists_are_as_good_as_expressions_and_tuples(walker: type[Walker]) -> None:
    problem = parse_problem(text_of("compass-passive-a"), walkers=[walker])
    assert isinstance(problem.walker, walker)


def test_a_start_that_is_not_a_number_is_refused_with_its_name() -> None:
    problem = go.load_problem("slip-run")
    with pytest.raises(ProblemError, match=r"would start with dshortening = nan"):
        problem.replace({"gait.guess.state": {"dtheta": -30.0}})


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


def test_examples_of_the_documentation_load() -> None:
    for path in sorted(EXAMPLES.glob("*.yaml")):
        go.load_problem(path, walkers=(TorsoCompass,))
