"""Walkers that state the lines that draw them: knees, arcs, springs, legs that differ."""

from dataclasses import replace

import numpy as np
import pytest
from named import named

from gaitopt.show.film import film, skeleton
from gaitopt.show.motion import motion_of


def drawing(name, step=0):
    arcs = named(name).steps[step].arcs
    return np.vstack([arc.states for arc in arcs]), skeleton(arcs)


def lengths(drawn):
    return [np.linalg.norm(drawn.points[:, a] - drawn.points[:, b], axis=1) for a, b in drawn.legs]


def test_knees_bend_between_straight_bodies():
    _, drawn = drawing("kneed-passive")
    assert [length[0] for length in lengths(drawn)] == pytest.approx([1.0, 0.5, 0.5])
    for length in lengths(drawn):
        assert length == pytest.approx(length[0])


def test_arcs_touch_the_ground_where_it_acts():
    states, drawn = drawing("round-feet-passive")
    contact = drawn.points[:, drawn.contacts[0]]
    assert contact[:, 1] == pytest.approx(0, abs=1e-12)
    assert contact[:, 0] == pytest.approx(states[:, 2] + 0.2 * states[:, 0], abs=1e-12)
    arcs = drawn.points[:, [b for _, b in drawn.legs[2:]]]
    assert -1e-9 < arcs[0, :, 1].min() < 1e-3
    assert film(motion_of(named("round-feet-passive")))["contacts"][0]["point"] == drawn.contacts[0]


def test_the_foot_of_any_other_walker_is_where_the_ground_acts():
    _, drawn = drawing("torso-passive")
    assert drawn.points[:, drawn.contacts[0]] == pytest.approx(drawn.points[:, 0])


def test_springs_of_telescopic_legs_are_zigzags_whose_length_changes():
    _, drawn = drawing("telescopic-passive")
    stance, swing, *coils = lengths(drawn)
    assert stance == pytest.approx(0.5)
    assert swing == pytest.approx(0.5)
    own, other = np.split(np.array(coils), 2)
    assert np.ptp(own, axis=1).max() < 1e-12
    assert np.ptp(other, axis=1).max() > 1e-3


def test_masses_of_legs_that_differ_are_drawn_where_they_are():
    gait = named("compass-unequal")
    moved = gait.problem.replace({"walker.leg_com": 0.7})
    distances = []
    for dynamics in gait.dynamics.at(moved.parameters).steps:
        points = skeleton([replace(gait.arcs[0], dynamics=dynamics)]).points[0]
        distances.append([np.linalg.norm(points[2] - points[0]), np.linalg.norm(points[4] - points[1])])
    assert distances == [pytest.approx([0.7, 0.8]), pytest.approx([0.8, 0.7])]


def test_the_lines_of_a_tree_know_the_leg_to_which_they_belong():
    gait = named("rabbit-hzd")
    drawn = skeleton(gait.arcs)
    assert sorted(drawn.sides, key=str) == [0, 0, 1, 1, None]
    for side, foot in ((0, 0), (1, 1)):
        ends = [drawn.points[:, b] for (_, b), each in zip(drawn.legs, drawn.sides, strict=True) if each == side]
        assert any(np.allclose(end, drawn.points[:, foot], atol=1e-12) for end in ends)


@pytest.mark.parametrize(
    ("name", "sides"), [("torso-passive", (0, 1, None)), ("heel-toe", (0,) * 4 + (1,) * 4), ("telescopic-passive", ())]
)
def test_the_lines_that_change_places_in_a_step_belong_to_two_legs(name, sides):
    _, drawn = drawing(name)
    assert drawn.sides == sides
