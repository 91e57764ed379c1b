"""A gait in the coordinates of an engine: energy, feet, rates and torques are those of the gait."""

from dataclasses import replace

import numpy as np
import pytest
from casadi import vertcat
from named import named
from samples import sampled

import gaitopt as go
from gaitopt.engines.plant import Reference
from gaitopt.errors import ProblemError
from gaitopt.gait.measures import observe
from gaitopt.model.mechanism import Body, polar
from gaitopt.model.walkers.compass_biped import CompassBiped

NAMES = ("compass-passive-a", "compass-unequal", "torso-passive", "round-feet-passive", "compass-pd-impact-slip")
NAMES += ("torso-upright", "rimless-wheel-slip")


@pytest.mark.parametrize("name", sampled(NAMES, 3))
def test_energy_feet_and_rates_are_those_of_the_gait(name):
    gait, h = named(name), 1e-6
    reference = Reference(gait)
    x = gait.system.n_shape
    for t in (0.1, 0.3, 0.5):
        slope = (reference.coordinates(t + h)[0] - reference.coordinates(t - h)[0]) / (2 * h)
        assert slope == pytest.approx(reference.coordinates(t)[1], abs=1e-8)
    for t in np.linspace(0, 1.04 * gait.period, 17):
        (q, v), (step, local), z = reference.coordinates(t), reference.step_at(t), reference.state(t)
        stance, swing = reference.stance(step), 1 - reference.stance(step)
        arc = replace(reference.arc(step, local), times=np.array([local]), states=z[None])
        seen = observe(arc)
        place, velocity = reference.tree.foot(stance, q, v)
        assert place[1] == pytest.approx(0, abs=1e-12)
        assert velocity == pytest.approx([z[-1], 0], abs=1e-12)
        if step == 0 or not reference.turn:  # a wheel has two of its spokes
            assert reference.tree.foot(swing, q, v)[0][1] == pytest.approx(seen.swing_foot[0, 1], abs=1e-12)
        walked = reference.tree.mass * reference.tree.gravity[0] * (place[0] - z[x])  # energy counts from the foot
        assert reference.energy(step, q, v) + walked == pytest.approx(seen.energy[0], abs=1e-9)
        back = reference.shape_state(step, q, v)
        assert back[:x] == pytest.approx(z[:x], abs=1e-12)


def test_the_power_of_the_torques_is_that_of_the_motors():
    """The forces on an engine's coordinates do the work of the gait's motors."""
    gait = go.solve("compass-pd-impact-slip", progress=False)
    reference = Reference(gait)
    for t in (0.01, 0.1, 0.3, 0.6):
        q, v = reference.coordinates(t)
        arc = reference.arc(*reference.step_at(t))
        power = observe(replace(arc, times=np.array([t]), states=reference.state(t)[None])).power.sum()
        assert reference.torques(0, t, q, v) @ v == pytest.approx(power, abs=1e-9)


def test_springs_and_dampers_lose_the_energy_of_the_gait():
    gait = go.solve("torso-passive", progress=False)
    reference, h = Reference(gait), 1e-5
    for t in (0.1, 0.3, 0.5):
        q, v = reference.coordinates(t)
        arc = reference.arc(*reference.step_at(t))
        loss = observe(replace(arc, times=np.array([t]), states=reference.state(t)[None])).loss[0]
        states = [reference.coordinates(t + side * h) for side in (-1, 1)]
        springs = [reference.energy(0, *state) - reference.tree.energy(*state) for state in states]
        rate = (springs[1] - springs[0]) / (2 * h)
        assert reference.torques(0, t, q, v) @ v == pytest.approx(-loss - rate, rel=1e-6)


def test_the_contact_of_a_foot_is_off_while_it_scuffs():
    gait = go.solve("compass-passive-a", progress=False)
    reference = Reference(gait)
    ((first, last),) = reference.windows
    heights = [reference.tree.foot(1, *reference.coordinates(t))[0][1] for t in np.linspace(first, last, 200)]
    assert min(heights) < 0
    assert heights[0] > 0 < heights[-1]
    assert reference.touching(0, 0.0) == (True, False)
    assert reference.touching(0, last) == (True, True)
    assert reference.touching(1, 0.5 * first) == (True, True)
    assert reference.touching(1, 0.5 * (first + last)) == (False, True)


class Bare(CompassBiped):
    """A compass whose mechanism is its own, so that the links of the compass do not describe it."""

    model = "bare_compass"

    @classmethod
    def mechanism(cls, q, p):
        """The mechanism of the compass."""
        return super().mechanism(q, p)


class Spinning(Bare):
    """A compass with a wheel at its hip, which turns like no leg."""

    model = "spinning_compass"

    @classmethod
    def mechanism(cls, q, p):
        """The mechanism of the compass, and the wheel."""
        bare = super().mechanism(q, p)
        hip = vertcat(q.x, q.y) + polar(p.leg_length, q.theta1)
        wheel = Body(mass=0.1, position=hip, inertia=0.001, angle=q.theta1 - q.theta2)
        return replace(bare, bodies=(*bare.bodies, wheel))


def variant(cls):
    """The sticking compass as a walker of another class."""
    text = go.load_problem("compass-passive-stick").text.replace("compass_biped", cls.model)
    return go.solve(go.parse_problem(text, walkers=[cls]), progress=False)


def test_a_walker_without_links_is_the_tree_of_its_rigid_parts():
    bare, linked = Reference(variant(Bare)), Reference(go.solve("compass-passive-stick", progress=False))
    assert bare.windows == linked.windows
    for t in (0.1, 0.7, 0.8):
        (q, v), (own_q, own_v), (step, local) = linked.coordinates(t), bare.coordinates(t), bare.step_at(t)
        assert bare.energy(step, own_q, own_v) == pytest.approx(linked.energy(step, q, v), abs=1e-9)
        for foot in range(2):
            for own, other in zip(bare.tree.foot(foot, own_q, own_v), linked.tree.foot(foot, q, v), strict=True):
                assert own == pytest.approx(other, abs=1e-9)
        assert bare.touching(step, local) == linked.touching(step, local)


FRICTIONLESS = go.load_problem("compass-passive-b").replace({"impact_law": "frictionless"})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: named("compass-passive-static-kinetic"), "-static-kinetic: .*static friction above kinetic"),
        (lambda: named("slip-run"), "slip-run: .*flight and massless feet"),
        (lambda: named("kneed-passive"), "kneed-passive: .*joint stops"),
        (lambda: named("compass-push-off"), "compass-push-off: .*a push-off"),
        (lambda: named("bounding"), "bounding: .*massless feet"),
        (lambda: go.solve(FRICTIONLESS, progress=False), "slipping impact without friction"),
        (lambda: variant(Spinning), "a body of a spinning_compass does not turn with its link"),
    ],
)
def test_what_the_adapters_have_no_law_for_is_refused_by_name(make, words):
    gait = make()
    assert gait.converged
    with pytest.raises(ProblemError, match=words):
        Reference(gait)


def test_the_wheel_turns_by_a_spoke_where_its_next_foot_stands():
    gait = go.solve("rimless-wheel-stick", progress=False)
    reference = Reference(gait)
    assert reference.turn == pytest.approx(2 * np.pi / gait.problem.walker.spokes, abs=1e-12)
    before, after = (reference.coordinates(gait.period + side * 1e-9)[0] for side in (-1, 1))
    assert before == pytest.approx(after, abs=1e-8)
    assert Reference(go.solve("compass-unequal", progress=False)).turn == 0


NAMED = ("crawler", "heel-toe", *(pytest.param(name, marks=pytest.mark.slow) for name in ("inchworm", "flat-foot")))


@pytest.mark.parametrize("name", NAMED)
def test_a_walker_with_several_contacts_is_a_tree_of_hinges_or_slides(name):
    """Energies, places of the contacts and rates are those of the gait, also after the feet have swapped roles."""
    gait = go.solve(name, progress=False)
    reference, system, h = Reference(gait), gait.system, 1e-6
    tree, names, x = reference.tree, system.walker.landing_points(), system.state_names.index("x")
    assert tree.slides is (name == "crawler")
    assert len(tree.bodies) == {"flat-foot": 4}.get(name, 2)
    assert tree.mass == pytest.approx(float(system.weight(gait.p)) / gait.problem.walker.gravity, rel=1e-12)
    for t in np.array([0.1, 0.45, 0.8, 1.1]) * gait.period:
        (q, v), (step, local), z = reference.coordinates(t), reference.step_at(t), reference.state(t)
        arc = reference.arc(step, local)
        back = reference.shape_state(step, q, v)
        assert np.delete(back - z, x) == pytest.approx(np.zeros(z.size - 1), abs=1e-12)
        energy = system.observation(arc.mode)(local, z, gait.p, system.data(arc.segment))[4]
        walked = tree.mass * tree.gravity[0] * (back[x] - z[x])  # energy counts from where the foot landed
        assert reference.energy(step, q, v) + walked == pytest.approx(float(energy), abs=1e-11)
        ahead, behind = (reference.coordinates(t + side * h)[0] for side in (1, -1))
        assert (ahead - behind) / (2 * h) == pytest.approx(v, abs=1e-6)
        heights, velocities, _ = system.contact_points(z, gait.p)
        for foot in range(len(names)):
            k = names.index(reference.contact(step, foot))
            place, velocity = tree.foot(foot, q, v)
            assert place[1] == pytest.approx(float(heights[k]), abs=1e-12)
            assert velocity == pytest.approx(np.asarray(velocities).ravel()[2 * k : 2 * k + 2], abs=1e-12)
    before, after = (reference.coordinates(gait.period + side * 1e-9)[0] for side in (-1, 1))
    assert before == pytest.approx(after, abs=1e-7)
    if reference.clock:
        once = reference.coordinates(gait.period + 0.1)[0] - reference.coordinates(0.1)[0]
        assert once[0] == pytest.approx(gait.measures["step_length"], abs=1e-12)
        assert once[1:] == pytest.approx(0 * once[1:], abs=1e-12)


def test_the_contacts_of_a_foot_are_off_together_while_it_scuffs():
    reference = Reference(go.solve("heel-toe", progress=False))
    ((first, last),) = reference.windows
    between, later = (first + last) / 2, (last + reference.starts[-1]) / 2
    assert reference.touching(0, 0.5 * first) == (True, True, False, False)  # they have just left the ground
    assert reference.touching(0, between) == (True, True, False, False)
    assert reference.touching(0, later) == (True, True, True, True)
    assert reference.touching(1, 0.5 * first) == (True, True, True, True)
    assert reference.touching(1, between) == (False, False, True, True)
    assert [reference.contact(1, foot) for foot in reference.lands(1)] == ["swing_heel", "swing_toe"]
    heights = [reference.tree.foot(foot, *reference.coordinates(t))[0][1] for foot in (2, 3) for t in (first, last)]
    assert min(heights) > 0
