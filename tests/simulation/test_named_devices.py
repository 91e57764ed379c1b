"""Stops, switches, flight and frictionless impacts of walkers with named contacts.

A walker that stands on one foot at a time and the same walker with named contacts are one walker: they move alike.
"""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from casadi import SX, vertcat

import gaitopt as go
from gaitopt.model.mechanism import Contact, Mechanism
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker

FEET = ("foot_1", "foot_2")


def with_feet(stated: Mechanism, q: SimpleNamespace, counts: SX) -> Mechanism:
    """A mechanism whose feet are contacts; the swing foot passes through the ground while ``counts`` is negative."""
    points = Contact(position=vertcat(q.x, q.y)), Contact(position=stated.swing_foot, counts=counts)
    return replace(stated, contacts=dict(zip(FEET, points, strict=True)))


class NamedKneed(KneedWalker):
    """The kneed walker with its feet as named contacts."""

    model = "named_kneed"
    contacts = FEET
    landing_contacts = FEET[1:]
    exchanged_contacts = dict([FEET])  # noqa: RUF012

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return with_feet(super().mechanism(q, p), q, q.theta1 + q.theta2 - 0.02)


class NamedHopper(Hopper):
    """The hopper with its foot as a named contact."""

    model = "named_hopper"
    flies = False
    contacts = ("toe",)
    landing_contacts = ("toe",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The foot."""
        return replace(super().mechanism(q, p), contacts={"toe": Contact(position=vertcat(q.x, q.y))})


class NamedCompass(CompassBiped):
    """The compass with its feet as named contacts."""

    model = "named_compass"
    contacts = FEET
    landing_contacts = FEET[1:]
    exchanged_contacts = dict([FEET])  # noqa: RUF012

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return with_feet(super().mechanism(q, p), q, q.theta1 - 0.04)


KNEED = """
name: named-kneed
walker: {model: named_kneed, thigh_length: 0.5, thigh_mass: 0.5, thigh_com: 0.175, shank_length: 0.5, shank_mass: 0.05,
  shank_com: 0.375, hip_mass: 0.5, gravity: 9.8, slope: 0.05036851690374748}
friction: 1.0
gait:
  phases: [{mode: {foot_1: stick}, knee: free}, {mode: {foot_1: stick}, knee: locked}]
  impact: {foot_1: stick}
  guess:
    state: {theta1: -0.24, theta2: -0.24, theta3: -0.24, dtheta1: 1.1, dtheta2: -0.05}
"""
HOPPER = """
name: named-hopper
walker: {model: named_hopper, leg_length: 1.0, body_mass: 8.0, foot_mass: 2.0, stiffness: 4000.0, thrust: 200.0,
  gravity: 9.81}
friction: 0.5
gait:
  phases:
    - {mode: {toe: stick}, leg: free, thrust: off}
    - {mode: {toe: stick}, leg: free, thrust: on}
    - {mode: {}, leg: locked, thrust: on}
  impact: {toe: stick}
  guess:
    state: {dshortening: 3.0}
"""


@pytest.mark.parametrize(
    ("text", "walker", "name"),
    [(KNEED, NamedKneed, "kneed-passive"), (HOPPER, NamedHopper, "hopper")],
)
def test_a_walker_with_stops_and_switches_moves_the_same_with_named_contacts(text, walker, name):
    named, one_foot = go.solve(go.parse_problem(text, walkers=[walker])), go.solve(name)
    assert named.status == "converged"
    assert named.period == pytest.approx(one_foot.period, rel=1e-11)
    assert go.verify(named).passed
    assert named.spectral_radius == pytest.approx(one_foot.spectral_radius, rel=1e-9, abs=1e-11)


FRICTIONLESS = """
name: named-compass
walker: {model: named_compass, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 1 deg}
friction: 0.14
impact_law: frictionless
gait:
  phases: [{foot_1: slip_forward}, {foot_1: stick}]
  impact: {foot_1: slip_forward}
  guess:
    state: {theta1: -0.079, theta2: -0.079, dtheta1: 0.044, dtheta2: -0.432, dx: 0.634}
"""


def test_a_frictionless_impact_of_a_named_contact_is_that_of_a_foot():
    named = go.solve(go.parse_problem(FRICTIONLESS, walkers=[NamedCompass]))
    one_foot = go.solve(go.load_problem("compass-passive-b").replace({"impact_law": "frictionless"}))
    assert named.status == one_foot.status == "converged"
    assert named.period == pytest.approx(one_foot.period, rel=1e-11)
    assert go.verify(named).passed
    assert named.steps[0].impact.impulse[2] == 0
    assert named.spectral_radius == pytest.approx(one_foot.spectral_radius, rel=1e-9)


def test_drag_of_named_contacts_is_that_of_a_foot():
    law = "{static: 0.16, kinetic: 0.14, viscous: 0.3}"
    text = FRICTIONLESS.replace("friction: 0.14", f"friction: {law}").replace("impact_law: frictionless\n", "")
    named = go.solve(go.parse_problem(text, walkers=[NamedCompass]))
    changes = {"friction": {"static": 0.16, "kinetic": 0.14, "viscous": 0.3}}
    one_foot = go.solve(go.load_problem("compass-passive-b").replace(changes))
    assert named.status == one_foot.status == "converged", (named.message, one_foot.message)
    assert named.period == pytest.approx(one_foot.period, rel=1e-11)
    assert go.verify(named).passed


def test_a_stop_ends_the_motion_of_contacts_where_its_gap_closes():
    """A walk of named contacts was once completed with a stop at -0.094 m."""
    gait = go.solve(go.parse_problem(KNEED, walkers=[NamedKneed]))
    walk = go.simulate(gait, steps=3)
    assert walk.completed
    for step in walk.trajectory.steps:
        for arc in step.arcs:
            names = list(gait.system.state_names)
            gap = arc.states[:, names.index("theta2")] - arc.states[:, names.index("theta3")]
            assert gap.min() > -1e-12
            assert arc.mode.free or abs(gap).max() < 1e-12
