"""The walker that moves is the real one: legs keep their length, feet stand on the ground, slopes lean as they do."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from casadi import SX, vertcat
from named import named
from pictured import SEQUENCES, TORSO, gait
from pydantic import TypeAdapter
from samples import sampled

from gaitopt.model.mechanism import polar
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.show import film as films
from gaitopt.show.motion import motion_of
from gaitopt.show.pages import animation_page

WALKERS = (*SEQUENCES, TORSO)
LEGS = {"compass-passive-a": [1.6, 1.6], "kneed-passive": [1.0, 0.5, 0.5]}
"""Lengths of lines of the drawing [m]."""


def drawing(name):
    motion = motion_of(gait(name) if name in WALKERS else named(name))
    arcs = motion.steps[0].arcs
    return motion, np.vstack([arc.states for arc in arcs]), films.skeleton(arcs)


def unpack(packed, name):
    low, step, text = packed["columns"][name]
    if not text:
        return np.full(packed["rows"], low)
    lower, upper = np.frombuffer(base64.b64decode(text), dtype=np.uint8).reshape(2, -1).astype(int)
    return low + step * (lower + 256 * upper)


def lengths(drawn):
    return [np.linalg.norm(drawn.points[:, a] - drawn.points[:, b], axis=1) for a, b in drawn.legs]


@pytest.mark.parametrize("name", [*WALKERS, "kneed-passive"])
def test_legs_keep_their_length_and_a_step_begins_and_ends_with_the_feet_on_the_leaning_ground(name):
    motion, states, drawn = drawing(name)
    for length in lengths(drawn):
        np.testing.assert_allclose(length, length[0], rtol=1e-9)
    if name in LEGS:
        assert [length[0] for length in lengths(drawn)] == pytest.approx(LEGS[name])
    x = motion.state_index("x")
    np.testing.assert_allclose(drawn.points[:, 0], np.column_stack([states[:, x], np.zeros(len(states))]), atol=1e-12)
    landing = drawn.points[-1, 1]
    assert landing[1] == pytest.approx(0, abs=1e-9)
    assert landing[0] == pytest.approx(motion.steps[-1].impact.step_length)
    assert films.slope(motion) == pytest.approx(motion.steps[0].arcs[0].dynamics.parameter("walker.slope"), abs=1e-12)


def test_arcs_touch_the_ground_where_it_acts():
    _, states, drawn = drawing("round-feet-passive")
    contact = drawn.points[:, drawn.contacts[0]]
    assert contact[:, 1] == pytest.approx(0, abs=1e-12)
    assert contact[:, 0] == pytest.approx(states[:, 2] + 0.2 * states[:, 0], abs=1e-12)
    arcs = drawn.points[:, [b for _, b in drawn.legs[2:]]]
    assert -1e-9 < arcs[0, :, 1].min() < 1e-3
    assert films.film(motion_of(named("round-feet-passive")))["contacts"][0]["point"] == drawn.contacts[0]


def test_springs_of_telescopic_legs_are_zigzags_whose_length_changes():
    _, _, drawn = drawing("telescopic-passive")
    stance, swing, *coils = lengths(drawn)
    assert stance == pytest.approx(0.5)
    assert swing == pytest.approx(0.5)
    of_stance, of_swing = np.split(np.array(coils), 2)
    assert np.ptp(of_stance, axis=1).max() < 1e-12
    assert np.ptp(of_swing, axis=1).max() > 1e-3


def test_masses_of_legs_that_differ_are_drawn_where_they_are():
    unequal = named("compass-unequal")
    moved = unequal.problem.replace({"walker.leg_com": 0.7})
    distances = []
    for dynamics in unequal.dynamics.at(moved.parameters).steps:
        points = films.skeleton([replace(unequal.arcs[0], dynamics=dynamics)]).points[0]
        distances.append([np.linalg.norm(points[2] - points[0]), np.linalg.norm(points[4] - points[1])])
    assert distances == [pytest.approx([0.7, 0.8]), pytest.approx([0.8, 0.7])]


@pytest.mark.parametrize(
    ("name", "sides"),
    [
        ("torso-passive", (0, 1, None)),
        ("heel-toe", (0,) * 4 + (1,) * 4),
        ("telescopic-passive", ()),
        ("rabbit-hzd", (None, 0, 0, 1, 1)),
    ],
)
def test_the_lines_of_a_walker_know_the_leg_to_which_they_belong(name, sides):
    _, _, drawn = drawing(name)
    assert sorted(drawn.sides, key=str) == sorted(sides, key=str)
    if name == "torso-passive":
        assert drawn.points[:, drawn.contacts[0]] == pytest.approx(drawn.points[:, 0])
    for side in (0, 1) if name == "rabbit-hzd" else ():
        ends = [drawn.points[:, b] for (_, b), each in zip(drawn.legs, drawn.sides, strict=True) if each == side]
        assert any(np.allclose(end, drawn.points[:, side], atol=1e-12) for end in ends)


def test_a_wheel_has_all_its_spokes():
    _, _, drawn = drawing("rimless-wheel-slip")
    assert len(drawn.legs) == 10
    hub = drawn.points[:, 2]
    ends = drawn.points[:, [b for _, b in drawn.legs]] - hub[:, None]
    angles = np.sort(np.unwrap(np.sort(np.arctan2(ends[..., 0], ends[..., 1]), axis=1)), axis=1)
    np.testing.assert_allclose(np.diff(angles, axis=1), 2 * np.pi / 10, rtol=1e-9)


def test_a_walker_of_ones_own_is_drawn_from_its_bodies_and_says_what_is_not_rigid():
    _, _, drawn = drawing(TORSO)
    assert drawn.legs == ((0, 2), (1, 3))  # each foot with its leg's mass
    tied = {index for pair in (*drawn.legs, *drawn.ties) for index in pair}
    assert tied == set(range(drawn.points.shape[1]))
    assert sum(share for _, share in drawn.discs) == pytest.approx(1)


def test_a_walker_is_drawn_by_the_lines_that_it_states(monkeypatch):
    def arc(cls, q, p):
        return (tuple(vertcat(q.x, 0) + polar(0.1, q.theta1 + angle) for angle in (-1, 0, 1)), (SX([0, 0]), SX([1, 0])))

    monkeypatch.setattr(CompassBiped, "outline", classmethod(arc))
    films._mechanism.cache_clear()
    try:
        _, _, drawn = drawing("compass-passive-a")
    finally:
        films._mechanism.cache_clear()
    assert drawn.legs == ((5, 6), (6, 7), (8, 9))
    np.testing.assert_allclose(np.linalg.norm(drawn.points[:, 6] - drawn.points[:, 0], axis=1), 0.1)


def test_columns_come_back_to_a_part_of_their_range_and_constants_exactly():
    values = np.sin(np.linspace(0, 3, 50)) * 7 - 2
    packed = films.pack({"sine": values, "still": np.full(50, 0.25)})
    np.testing.assert_allclose(unpack(packed, "sine"), values, atol=0.6 * np.ptp(values) / films.CODES)
    assert packed["columns"]["still"][1:] == (0.0, "")
    np.testing.assert_array_equal(unpack(packed, "still"), 0.25)


@pytest.mark.parametrize("name", sampled([*WALKERS, "crawler", "bounding", "heel-toe"], 2))
def test_a_film_is_what_its_type_states_with_forces_within_the_cone_in_one_small_file(name):
    motion = motion_of(gait(name))
    shown = json.loads(json.dumps(films.film(motion)))
    TypeAdapter(films.FilmRecord).validate_json(json.dumps(shown), strict=True)
    for record, kind in ((shown, films.FilmRecord), (shown["frames"], films.PackedRecord)):
        assert record.keys() == kind.__annotations__.keys()
    for kind, records in ((films.FilmPhaseRecord, shown["phases"]), (films.FilmContactRecord, shown["contacts"])):
        assert all(kind.__required_keys__ <= record.keys() <= kind.__annotations__.keys() for record in records)
    for k, contact in enumerate(shown["contacts"]):
        tangential, normal = (unpack(shown["frames"], f"{force}{k}") for force in ("f_t", "f_n"))
        rounding = np.ptp(tangential) / films.CODES + contact["friction"] * np.ptp(normal) / films.CODES
        assert (np.abs(tangential) <= contact["friction"] * normal + rounding).all()
    page = animation_page(motion, gait(name).problem.about)
    assert len(page) < 40_000
    assert not re.search(r"https?:|//\w+\.|@import|url\(|src=", page)
    data = re.search(r'<script type="application/json" id="film">(.*?)</script>', page, re.DOTALL)[1]
    assert json.loads(data)["name"] == gait(name).problem.name


@pytest.mark.slow
def test_a_film_says_whose_share_of_a_force_is_undetermined():
    flat = gait("flat-foot")
    shown = films.film(motion_of(flat))
    names = [contact["name"] for contact in shown["contacts"]]
    marked = {
        name for phase in shown["phases"] for name, shares in zip(names, phase["undetermined"], strict=True) if shares
    }
    assert marked == {*flat.to_record()["undetermined"]} != set()
    assert not any(any(phase["undetermined"]) for phase in films.film(motion_of(gait("compass-passive-a")))["phases"])


def test_phases_of_the_film_cover_the_step():
    shown = films.film(motion_of(gait("compass-passive-a")))
    assert [phase["mode"] for phase in shown["phases"]] == ["slip_forward", "stick", "slip_backward"]
    assert [phase["first"] for phase in shown["phases"][1:]] == [phase["last"] + 1 for phase in shown["phases"][:-1]]
    assert shown["phases"][-1]["end"] == shown["period"]
    assert shown["phases"][-1]["last"] == shown["frames"]["rows"] - 1
