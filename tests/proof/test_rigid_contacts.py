"""Contacts of one rigid part: identities, dependent constraints, and a crawler whose rear stands on two contacts."""

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import pytest
from casadi import SX, Function, cos, fmax, pi, sin, sqrt, vertcat
from certificates import reworded
from flint import arb

import gaitopt as go
from gaitopt import Body, Contact, Mode
from gaitopt.model.contacts import sharing_contacts
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.proof import identities
from gaitopt.proof.arithmetic import NotProved, precision
from gaitopt.proof.check import check
from gaitopt.proof.claims import _impact_margins
from gaitopt.proof.identities import (
    dependent_contacts,
    is_possible,
    require_conditions,
    require_heights,
    rigid_pairs,
    vanishes_identically,
)
from gaitopt.proof.statement import refuse_uncovered_walkers

X = SX.sym("x", 2)


@pytest.mark.parametrize(
    ("expression", "vanishes"),
    [
        (sin(X[0]) ** 2 + cos(X[0]) ** 2 - 1, True),
        (sin(X[0] - X[1]) + sin(X[1] - X[0]), True),
        ((X[0] + X[1]) ** 2 - X[0] ** 2 - 2 * X[0] * X[1] - X[1] ** 2, True),
        (1e-300 * X[0], False),
        (0.1 * 3 * X[0] - 0.3 * X[0], False),  # doubles are exact
        (cos(X[0]) - sin(X[0]), False),
        (sin(X[0]) ** 2 + cos(X[1]) ** 2 - 1, False),
        (pi * X[0] * sin(X[1]) - pi * sin(X[1]) * X[0], True),
        (pi / 2 - 1.5707963267948966 * cos(X[0] - X[0]), True),  # this double means half of pi
        (1.5707963267948968 - pi / 2 + 0 * X[0], False),
        (pi / X[0] * X[1] - X[1] / X[0] * pi, True),
        (1 / (X[0] + X[1]) - 3 / (3 * X[1] + 3 * X[0]), True),
        (1 / (X[0] + X[1]) - 1 / (X[0] + X[1] + 1e-20), False),
        # these vanish, which is not shown
        (cos(2 * X[0]) - 1 + 2 * sin(X[0]) ** 2, False),
        (X[0] * X[1] / (X[0] + X[1]) + X[1] * X[1] / (X[0] + X[1]) - X[1], False),
        (fmax(X[0], X[1]) - fmax(X[1], X[0]) + X[0] * sqrt(X[1]) - sqrt(X[1]) * X[0], False),
    ],
)
def test_an_identity_is_shown_by_exact_polynomials_or_not_at_all(expression, vanishes):
    with precision():
        assert vanishes_identically(SX(expression), X) is vanishes


class Sledge(Crawler):
    """A crawler whose rear is a rigid block that can tilt, on two contacts."""

    model = "sledge"
    shape = ("gap", "tilt", "rise")
    lengths = ("gap", "rise")
    contacts = ("heel", "toe", "front")
    apart: ClassVar[float] = 0.15

    @classmethod
    def mechanism(cls, q, p):
        """The mechanism of the crawler; the motor, the spring and the damper act at the height of the ground."""
        base, ahead = vertcat(q.x, q.y), vertcat(cos(q.tilt), -sin(q.tilt))
        block, front = vertcat(-ahead[1], ahead[0]) * 0.03, base + vertcat(q.gap, q.rise)
        places = {"heel": base - cls.apart * ahead, "toe": base + cls.apart * ahead, "front": front}
        return replace(
            super().mechanism(q, p),
            bodies=(
                Body(mass=p.rear_mass, position=base + block, inertia=0.0225 * p.rear_mass, angle=q.tilt),
                Body(mass=p.front_mass, position=front),
            ),
            upright=cos(q.tilt),
            contacts={name: Contact(position=place) for name, place in places.items()},
        )


class Split(Sledge):
    """Both contacts of the rear coincide: they share their normal forces too."""

    model = "split"
    apart: ClassVar[float] = 0.0


class Raised(Sledge):
    """Its toe lands 1 cm above the ground."""

    model = "raised"

    @classmethod
    def mechanism(cls, q, p):
        """The mechanism with another gap of the toe."""
        mechanism = super().mechanism(q, p)
        toe = mechanism.contacts["toe"].position
        return replace(mechanism, contacts={**mechanism.contacts, "toe": Contact(position=toe, gap=toe[1] - 0.01)})


class Latched(Sledge):
    """A latch can hold the distance of its parts, which both contacts hold too if they stick."""

    model = "latched"
    stops = ("latch",)

    @classmethod
    def mechanism(cls, q, p):
        return replace(super().mechanism(q, p), stops={"latch": q.gap})


class Twin(Sledge):
    """A sledge whose front can tilt on two contacts too."""

    model = "twin"
    shape = ("gap", "tilt", "rise", "pitch")
    contacts = ("heel", "toe", "front", "nose")

    @classmethod
    def mechanism(cls, q, p):
        mechanism = super().mechanism(q, p)
        nose = mechanism.contacts["front"].position + 0.1 * vertcat(cos(q.pitch), -sin(q.pitch))
        return replace(
            mechanism,
            bodies=(*mechanism.bodies, Body(mass=p.front_mass, position=nose)),
            contacts={**mechanism.contacts, "nose": Contact(position=nose)},
        )


ALL = Mode.of_contacts(dict.fromkeys(Sledge.contacts, "stick"))
SLIP, STICK = "{heel: slip_forward, toe: slip_forward, front: stick}", "{heel: stick, toe: stick, front: stick}"
TEXT = f"""
name: sledge
walker:
  {{model: sledge, rear_mass: 1, front_mass: 1.5, stiffness: 20, damping: 1.5, rest: 0.5, gravity: 9.81, slope: 0.1}}
friction: {{heel: 0.6, toe: 0.6, front: 0.4}}
control: {{type: alternating, cycle: 2.0, first: {{drive: 4.95}}, second: {{drive: -4.95}}}}
gait:
  section: clock
  phases:
    - {{heel: stick, toe: stick, front: slip_forward}}
    - {STICK}
    - {SLIP}
    - {STICK}
  guess:
    state: {{gap: 0.4469307, tilt: 0, rise: 0, y: 0}}
    durations: [0.8685, 0.1315, 0.71257, 0.28743]
"""


def test_contacts_of_one_foot_are_found_and_one_tangential_constraint_follows_from_the_other():
    names = ("flat-foot", "heel-toe", "inchworm", "slip-walk")
    walkers = {name: type(go.load_problem(name).walker) for name in names}
    with precision():
        pairs = {name: {"+".join(sorted(pair)) for pair in rigid_pairs(walker)} for name, walker in walkers.items()}
    feet, flat_foot = {"heel+toe", "swing_heel+swing_toe"}, walkers["flat-foot"]
    assert pairs == {"flat-foot": feet, "heel-toe": feet, "inchworm": set(), "slip-walk": set()}

    def flat(**changes):
        states = dict.fromkeys(("heel", "toe", "swing_heel", "swing_toe"), "stick")
        return Mode.of_contacts(states | changes)

    with precision():
        assert dependent_contacts(flat_foot, flat(swing_heel="off", swing_toe="off")) == ("toe",)
        assert dependent_contacts(flat_foot, flat(toe="off")) == ("swing_toe",)
        assert dependent_contacts(flat_foot, flat(toe="off", swing_toe="off")) == ()
        assert not is_possible(flat_foot, flat(toe="slip_forward"))
        assert is_possible(flat_foot, flat(toe="off", heel="slip_forward"))


def test_two_rigid_parts_share_no_forces_with_each_other():
    """The friction that they require is that of each part, not that of the sum of both."""
    mode = Mode.of_contacts(dict.fromkeys(Twin.contacts, "stick"))
    with precision():
        assert dependent_contacts(Twin, mode) == ("toe", "nose")
    assert sharing_contacts(Twin, mode) == (("heel", "toe"), ("front", "nose"))
    assert sharing_contacts(Twin, mode.with_states({"front": "off"})) == (("heel", "toe"), ("nose",))


def test_a_constraint_that_samples_leave_out_wrongly_is_refused(monkeypatch):
    """The checker does not believe the structure that the model has sampled."""
    true = identities.constraint_structure
    index = true(Sledge, ALL).constraints.index(("front", 0))
    changes = [
        lambda s: replace(s, dropped=(index,), kept=tuple(k for k in range(len(s.constraints)) if k != index)),
        lambda s: replace(s, dropped=(), kept=tuple(range(len(s.constraints))), nulls=s.nulls[:, :0]),
        lambda s: replace(s, nulls=-s.nulls),
        lambda s: replace(s, nulls=s.nulls + 1e-3),
    ]
    with precision():
        for change in changes:
            monkeypatch.setattr(identities, "constraint_structure", lambda *mode, change=change: change(true(*mode)))
            with pytest.raises(NotProved, match="without being one rigid part"):
                dependent_contacts(Sledge, ALL)


def test_a_condition_of_the_section_that_is_left_out_follows_from_the_others():
    problem = go.parse_problem(TEXT, walkers=[Sledge])
    section = go.solve(problem, progress=False).system.section(problem.cycle)
    assert section.left_out.numel_out(0) == 1
    with precision():
        require_conditions(Sledge, section)
        velocity_only = Function("none", [*section.left_out.sx_in()], [SX(0, 1)])
        for left_out, kept in ((section.conditions, section.conditions), (section.left_out, velocity_only)):
            with pytest.raises(NotProved, match="a condition of its section is left out"):
                require_conditions(Sledge, SimpleNamespace(left_out=left_out, conditions=kept))


def test_a_walker_whose_contact_lands_above_the_ground_is_refused():
    """The section states heights of zero, which such a landing does not lead to."""
    problem = go.parse_problem(TEXT.replace("model: sledge", "model: raised"), walkers=[Raised])
    with precision(), pytest.raises(NotProved, match="raised: the gap of toe is not its height"):
        refuse_uncovered_walkers(problem, SimpleNamespace(walker=Raised, friction=SimpleNamespace(may_drop=False)))
    require_heights(Sledge)


def test_a_stop_that_an_impact_holds_is_not_left_out_and_shared_normal_forces_are_refused():
    """The mode of an impact that ends a step states no stops; its structure is that with the stops that it holds."""
    before = Mode.of(ALL, {"latch": "locked"})
    orbit = SimpleNamespace(system=SimpleNamespace(walker=Latched), arcs=[SimpleNamespace(mode=before)])
    with precision():
        assert dependent_contacts(Latched, ALL) == ("toe",)
        with pytest.raises(NotProved, match="latch share their forces in"):
            _impact_margins(orbit, ALL, 0, [])
        with pytest.raises(NotProved, match=r"heel and toe share their forces in .*, without being one rigid"):
            dependent_contacts(Split, ALL)


@pytest.mark.slow
def test_a_crawler_on_two_contacts_advances_like_one_on_one_contact():
    """Its friction does not depend on the shares: the closed form of the crawler lies in the enclosures."""
    gait = go.solve(go.parse_problem(TEXT, walkers=[Sledge]), progress=False)
    proof, crawler = go.prove(gait, progress=False), go.solve("crawler", progress=False)
    assert proof.proved, [claim.finding for claim in proof.claims if not claim.proved]
    assert proof.stable
    with precision():
        for name in ("step_length", "work", "cost_of_transport"):
            assert abs(proof.measures[name] - arb(crawler.measures[name])) < 1e-11
        assert abs(proof.state["gap"] - arb(float(crawler.state[0]))) < 1e-12
        assert abs(proof.measures["required_friction"] - arb(gait.measures["required_friction"])) < 1e-9
    checked = check(proof.certificate, walkers=[Sledge])
    assert checked.proved

    slips = "heel: slip_forward, toe: slip_forward", "heel: slip_forward, toe: slip_backward"
    for change in (slips, ("heel: 0.6", "heel: 0.5")):
        assert not check(reworded(proof.certificate, change), walkers=[Sledge]).proved
