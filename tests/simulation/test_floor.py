"""A walk on tiles of friction, height and slope obeys the laws of the walk on level ground."""

from math import asin, cos, pi, sin, sqrt

import numpy as np
import pytest
from named import named
from refusals import refusal

import gaitopt as go
from gaitopt import Floor, load_run, simulate
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.problem.floor import RandomFloor
from gaitopt.requests import Engine
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import problem_dynamics
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.tiled_walks import TiledWalks, floor_of

TURNING = {"theta": 1, "theta1": 1, "theta2": -1}
"""How the absolute angles of a wheel and a compass change where the ground turns."""


@pytest.mark.parametrize("name", ["compass-passive-a", "compass-pd-impact-slip", "heel-toe-slip"])
def test_a_floor_of_one_friction_is_the_problem_with_this_friction(name):
    gait = named(name)
    problem = gait.problem.replace({"friction": 1.01 * gait.problem.static_friction})
    there = Simulator(problem_dynamics(problem)).run(gait.state, steps=3)
    walk = Simulator(gait.dynamics, floor=Floor(friction=1.01 * gait.problem.static_friction)).run(gait.state, steps=3)
    assert np.array_equal(walk.section_states, there.section_states)


@pytest.mark.parametrize(("name", "delta"), [("compass-passive-a", 0.002), ("rimless-wheel-slip", -0.003)])
@pytest.mark.portable
def test_tiles_along_a_steeper_plane_are_a_steeper_slope(name, delta):
    """The walker sees the same ground from a frame that is turned; its feet slip along the tiles."""
    gait, steps = named(name), 4
    nominal = gait.dynamics.at({"walker.slope": gait.dynamics.parameter("walker.slope") - delta})
    drop = gait.scalar("step_length") * sin(delta)
    floor = Floor(slope=delta, height=[-k * drop for k in range(steps + 1)])
    turned = gait.state.copy()
    for k, key in enumerate(nominal.system.state_names):
        turned[k] = turned[k] * cos(delta) if key == "dx" else turned[k] + TURNING.get(key, 0) * delta
    walk = Simulator(nominal, floor=floor).run(turned, steps=steps)
    assert walk.duration == pytest.approx(steps * gait.scalar("period"), rel=1e-11)
    assert walk.final_state == pytest.approx(turned, abs=1e-11)


@pytest.mark.parametrize("rise", [0.01, -0.02])
@pytest.mark.portable
def test_a_wheel_lands_on_a_step_at_the_angle_and_with_the_rate_of_its_closed_form(rise):
    gait = named("rimless-wheel-stick")
    p = gait.problem.walker
    a, ratio = pi / p.spokes, 1 + p.inertia_ratio
    theta, rate = gait.state[0], gait.state[2]
    landing = a - asin(rise / (2 * p.radius * sin(a)))
    energy = 2 * p.gravity / (p.radius * ratio) * (cos(theta + p.slope) - cos(landing + p.slope))
    after = sqrt(rate**2 + energy) * (cos(2 * a) + p.inertia_ratio) / ratio
    state = simulate(gait, steps=1, floor=Floor(friction=2, height=[0, rise])).trajectory.final_state
    assert (state[0], state[2]) == pytest.approx((landing - 2 * a, after), rel=1e-11)


def test_a_tilted_tile_does_no_work_but_that_of_friction():
    gait = named("compass-passive-a")
    floor = Floor(slope=[0.01, -0.02, 0.015], height=[0, 0.001, -0.001])
    walk = Simulator(gait.dynamics, floor=floor).run(gait.state, steps=2, dense=True)
    slips = 0
    for arc in (arc for step in walk.steps for arc in step.arcs if len(arc.times) > 2):
        seen = observe(arc)
        power = curves.coefficients((seen.force[:, 0] * seen.slip[:, 0])[:, None])[:, 0]
        work = arc.duration / 2 * np.polynomial.chebyshev.chebint(power, lbnd=-1)
        done = np.polynomial.chebyshev.chebval(1.0, work)
        slips += arc.mode.slips
        assert seen.energy[-1] - seen.energy[0] == pytest.approx(done, abs=1e-9)
    assert slips == 4


def test_a_foot_does_not_land_on_a_lower_tile_before_mid_swing():
    """The height of the swing foot falls below that of the tile, early in the step, where the legs are to pass."""
    walk = simulate(named("compass-passive-stick"), steps=1, floor=Floor(height=[0, -1e-4]))
    assert walk.trajectory.steps[0].period > 0.9 * named("compass-passive-stick").scalar("period")


def test_the_derivative_of_a_walk_over_tiles_is_that_of_differences():
    gait = named("compass-passive-a")
    floor = Floor(friction=[0.1402, 0.14, 0.141], height=[0, 2e-5, -1e-5, 0, 0], slope=[1e-4, -1e-4, 0])
    mapped = ReturnMap(Simulator(gait.dynamics, floor=floor), gait.steps[0].final_impact.mode, n_steps=4)
    xi, h = gait.state[mapped.section.indices], 1e-6
    exact = mapped.jacobian(mapped(xi).steps)
    for k in range(xi.size):
        step = h * np.eye(xi.size)[k]
        assert exact[:, k] == pytest.approx((mapped(xi + step).xi - mapped(xi - step).xi) / (2 * h), abs=2e-6)


def test_walks_on_floors_of_their_own_in_a_batch_are_those_of_one():
    pytest.importorskip("heyoka")
    gait, rng = named("compass-passive-a"), np.random.default_rng(5)
    ranges = {"friction": (0.13, 0.16), "height": (-5e-4, 5e-4), "slope": (-2e-3, 2e-3)}
    floors = {name: rng.uniform(*limits, (6, 5 - k)) for k, (name, limits) in enumerate(ranges.items())}
    walks = TiledWalks(gait.dynamics, np.tile(gait.state, (6, 1)), floors, Engine.HEYOKA)
    for _ in range(3):
        walks.step()
    assert walks.walking.size == 6
    for row, state in enumerate(walks.states):
        alone = Simulator(gait.dynamics, stepper_class(Engine.HEYOKA), floor=floor_of(floors, row))
        assert alone.run(gait.state, steps=3).final_state == pytest.approx(state, abs=1e-11)


@pytest.mark.slow
def test_a_contact_keeps_the_tile_on_which_it_landed():
    """The rear foot of flat-foot stays on its tile after the front one has landed."""
    walk = simulate(named("flat-foot"), steps=2, floor=Floor(friction=[0.5, 0.6, 0.7]))
    arcs = [
        {name: arc.dynamics.contact_friction[name] for name in arc.mode.touching}
        for arc in walk.trajectory.steps[1].arcs
    ]
    assert {"heel": 0.6, "swing_heel": 0.5, "swing_toe": 0.5} in arcs
    assert {"heel": 0.6, "swing_toe": 0.5} in arcs
    assert arcs[-1] == {"heel": 0.6, "toe": 0.6}
    assert walk.trajectory.steps[1].arcs[-1].dynamics.contact_friction["swing_heel"] == 0.7


def test_a_heel_and_its_toe_land_on_the_same_tile():
    walk = simulate(named("heel-toe"), steps=2, floor=Floor(friction=[0.5, 0.6, 0.7]))
    found = [(arc.mode.touching, arc.dynamics.contact_friction) for s in walk.trajectory.steps for arc in s.arcs]
    assert [{name: of[name] for name in touching} for touching, of in found] == [
        {"heel": 0.5},
        {"toe": 0.5},
        {"heel": 0.6},
        {"toe": 0.6},
    ]


def test_a_stored_walk_on_a_floor_is_read_as_it_was(tmp_path):
    floor = Floor(friction=[0.14, 0.139], height=[0, 1e-4, 0], slope=[0, 1e-3, 0])
    walk = simulate("compass-passive-a", steps=3, floor=floor, output=tmp_path / "walk")
    again = load_run(tmp_path / "walk")
    assert again.floor == floor
    assert again.trajectory.final_state == pytest.approx(walk.trajectory.final_state, abs=1e-14)
    assert again.trajectory.steps[1].arcs[0].dynamics.parameters == walk.trajectory.steps[1].arcs[0].dynamics.parameters


def test_the_text_the_table_and_the_lists_of_a_floor_agree(tmp_path):
    floor = Floor(friction=[0.2, 0.13, 0.13, (0.2, 0.15)], slope=[0, pi / 180])
    table = tmp_path / "floor.csv"
    table.write_text("static,kinetic,slope\n0.2,0.2,0\n0.13,0.13,0.017453292519943295\n"
                     "0.13,0.13,0.017453292519943295\n0.2,0.15,0.017453292519943295\n")  # fmt: skip
    assert Floor.parse("friction=0.2, 0.13x2, 0.2/0.15; slope=0, 1 deg") == floor
    assert [Floor.read(table).tile(n) for n in range(6)] == [floor.tile(n) for n in range(6)]
    assert Floor.from_record(floor.to_record()) == floor
    assert Floor(friction=np.array(0.2), height=np.zeros(2)) == Floor(friction=0.2, height=[0, 0])


def test_a_longer_random_floor_begins_as_the_shorter_one():
    floors = RandomFloor.parse("friction=normal(0.15, 0.08), height=-1:1", seed=3)
    assert floors.draw(50).tile(19) == floors.draw(20).tile(19)
    assert floors.draw(50) != floors.draw(50, walk=1)
    assert min(floors.draw(2000).friction) >= 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Floor(), "floor: has no tile"),
        (lambda: Floor(friction=[0.2, -0.1]), "floor.friction, tile 1: -0.1 is outside of 0 to 100"),
        (lambda: Floor(friction=[(0.1, 0.2)]), "static 0.1 is smaller than kinetic 0.2"),
        (lambda: Floor(height=["high"]), "floor.height, tile 0: 'high' is not a number"),
        (lambda: Floor.parse("0.2, 0.3"), "'0.2' has no name; write friction=, height= or slope="),
        (lambda: Floor.parse("friction=0.2, b"), "floor.friction: 'b' is no value"),
        (lambda: Floor.parse("height=1 deg"), "1deg is no value of height"),
        (lambda: Floor.read("nowhere.csv"), "nowhere.csv: the floor cannot be read"),
        (lambda: Floor.read(None), "path is nothing (null), but must be the path of a CSV file"),
        (lambda: Floor.read("\0.csv"), "the floor cannot be read: embedded null byte"),
        (lambda: Floor.random("friction=0.3:0.2", 3), "its limits must ascend within 0 to 100"),
        (lambda: Floor.random("friction=0.2", 3), "friction=0.2 is no distribution"),
        (lambda: Floor.random("friction=0.1:0.2", 0), "tiles is 0, but must be a whole number, at least 1"),
        (lambda: Floor.random("friction=0.1:0.2", 3, seed=-1), "seed is -1, but must be a whole number, at least 0"),
        (lambda: Floor.random(5, 3), "floor: 5 is not a text such as friction=0.2"),
        (lambda: Floor(friction="0.2"), "floor.friction: '0.2' is neither a number nor a list of numbers"),
        (lambda: Floor(height=None), "floor.height: nothing (null) is neither a number nor a list"),
        (lambda: simulate("crawler", floor=Floor(friction=0.2)), "no landing ends a step of the crawler"),
        (lambda: simulate("slip-run", floor=Floor(height=0.1)), "lands with a given energy above level ground"),
        (lambda: simulate("round-feet-passive", floor=Floor(slope=0.1)), "roll"),
        (lambda: simulate("compass-passive-a", floor=[0.2]), "floor is [0.2], but must be Floor"),
    ],
)
def test_a_wrong_floor_is_refused_with_the_reason(make, words):
    assert words in refusal(make)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("friction,height\n0.2,0\nice,0\n", "floor.csv, row 3, friction: 'ice' is not a number"),
        ("# tiles\n\nstatic,kinetic\n0.2,-0.1\n", "floor.csv, row 4, kinetic: -0.1 is outside of 0 to 100"),
        ("friction,height\n0.2\n", "floor.csv, row 2: has 1 value, must have 2, one for each column"),
        ("friction\n", "floor.csv: floor: has no tile"),
        ("ice\n0.2\n", "floor.csv: columns are friction"),
        ("", "but it has nothing"),
    ],
)
def test_a_wrong_table_is_refused_with_its_place(text, words, tmp_path):
    path = tmp_path / "floor.csv"
    path.write_text(text)
    assert words in refusal(Floor.read, path)


@pytest.mark.parametrize("name", ["compass-passive-a", "heel-toe-slip", "compass-unequal"])
@pytest.mark.parametrize("engine", ["scipy", pytest.param("heyoka", marks=pytest.mark.slow)])
def test_the_return_map_on_a_floor_is_the_walk_on_it(name, engine):
    pytest.importorskip(engine)
    gait, indices = named(name), named(name).problem.map_section.indices
    nominal, legs = gait.problem.static_friction, len(gait.dynamics.steps)
    for floor in (
        Floor(friction=[nominal, 0.995 * nominal, nominal]),
        Floor(friction=[(nominal, 0.99 * nominal)], height=[0, 1e-5], slope=[0, 1e-4]),
    ):
        mapped = go.return_map(gait, [gait.state[indices]], engine=engine, floor=floor)
        walk = simulate(gait, steps=legs, floor=floor)
        assert mapped.outcomes.tolist() == ["completed"]
        np.testing.assert_allclose(mapped.states[0], walk.trajectory.section_states[-1][indices], atol=1e-11)
        assert mapped.times[0] == pytest.approx(walk.trajectory.duration, abs=1e-11)


def test_a_walk_that_ends_as_impact_inconsistent_meets_the_ground_from_below_behind_the_stance_foot():
    """Height and place of the swing foot in closed form, before and at the end of such a walk on random friction."""
    gait = named("compass-passive-a")
    walk = simulate(gait, steps=5, floor=Floor.random("friction=0.12:0.2", 60, seed=1, walk=65))
    assert walk.trajectory.ending == "impact_inconsistent"
    assert "touches the ground from below" in walk.trajectory.message
    arc, length = walk.trajectory.steps[-1].arcs[-1], gait.dynamics.parameter("walker.leg_length")
    theta1, theta2, _, dtheta1, dtheta2, _ = arc.states.T
    height = length * (np.cos(theta1) - np.cos(theta2))
    assert (height[-5:-1] < 0).all()
    assert length * (np.sin(theta2) * dtheta2 - np.sin(theta1) * dtheta1)[-1] > 0.1
    assert 2 * length * np.sin(theta1[-1]) < -0.1  # place of the swing foot, counted from the stance foot


@pytest.mark.parametrize(
    ("name", "walks"),
    [("compass-passive-a", False), pytest.param("compass-torque-robust", True, marks=pytest.mark.slow)],
)
def test_gait_a_falls_on_a_thousand_tiles_on_which_the_robust_design_walks(name, walks):
    floor = Floor.random("friction=0.12:0.2", 1001, seed=1)
    assert len(floor) == 1001
    walk = simulate(named(name), steps=1000, floor=floor)
    assert walk.completed == walks
    assert walks or walk.trajectory.ending in ("fall", "impact_inconsistent")
