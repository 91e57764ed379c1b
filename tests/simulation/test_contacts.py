"""Motions of walkers with several contacts: closed forms, identities, named endings."""

import csv
import io
from collections import Counter
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from casadi import cos, sin, vertcat
from contact_walkers import ContactCase, Frame, dynamics_of, frame, heel_toe
from named import named
from scipy.optimize import linprog
from scipy.special import ellipk, ellipkinc

from gaitopt import Contact, Mode
from gaitopt.errors import ProblemError
from gaitopt.gait import curves
from gaitopt.gait.gait import trajectory_header, trajectory_rows
from gaitopt.gait.measures import contact_record, measure, observe
from gaitopt.model.transitions import Ending
from gaitopt.simulation.contact_resolver import ContactResolver
from gaitopt.simulation.engine import is_installed
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.store.formats import Table, csv_text
from gaitopt.verification.walk import simulate

BLOCK = {"half": 0.25, "height": 1.0}
BLOCK_ANGLE = np.arctan2(BLOCK["half"], BLOCK["height"])
STICKING_IMPACT = 3 * BLOCK["half"] * BLOCK["height"] / (BLOCK["half"] ** 2 + 4 * BLOCK["height"] ** 2)
HEEL_STRIKES = {  # friction, and the state (theta1, theta2, dtheta1, dtheta2) of its gait
    0.3: (-0.294967154, -0.317064605, 1.156405185, -0.343932281),
    0.265: (-0.294921134, -0.317018937, 1.156372288, -0.344130861),
}


def tilted(case: ContactCase, theta: float, corner: str) -> np.ndarray:
    """A block at rest on one corner."""
    q = np.array([theta, 0.0, 0.0])
    q[1:] -= case.points[corner].position(q)
    return case.state(q, np.zeros(3))


def on_heel(case: ContactCase, values: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates of a compass that stands on its heel without a slip."""
    q = np.array([*values[:2], 0.0, 0.0])
    q[2:] -= case.points["heel"].position(q)
    dq = np.array([*values[2:], 0.0, 0.0])
    dq[2:] -= case.points["heel"].velocity(q, dq)
    return q, dq


def words(mode: Mode) -> list[str]:
    return [f"{name} {mode.contacts[name]}" for name in mode.touching]


@pytest.mark.parametrize("start", [0.3, 0.6, 0.9])
def test_a_block_rocks_in_the_time_of_the_elliptic_integral_and_keeps_the_rates_of_its_ratio(start: float) -> None:
    case = frame(**BLOCK)
    theta0 = start * BLOCK_ANGLE
    step = Simulator(case.dynamics(1.0), max_switches=1).step(tilted(case, theta0, "right"), dense=True).step
    fall, rise = step.arcs[:2]
    assert [words(arc.mode) for arc in (fall, rise)] == [["right stick"], ["left stick"]]
    assert fall.end == pytest.approx(quarter_period(theta0), rel=1e-11)
    before, after = fall.states[-1][3], rise.states[0][3]
    assert after / before == pytest.approx(1 - 1.5 * np.sin(BLOCK_ANGLE) ** 2, rel=1e-11)


def test_the_impact_of_a_block_slips_below_the_friction_of_its_closed_form() -> None:
    case = frame(**BLOCK)
    state = tilted(case, 0.5 * BLOCK_ANGLE, "right")
    modes = {}
    for friction in (STICKING_IMPACT * (1 - 1e-9), STICKING_IMPACT * (1 + 1e-9)):
        step = Simulator(case.dynamics(friction), max_switches=1).step(state).step
        assert step.arcs[0].mode.contacts["right"] == "stick"
        modes[friction] = step.arcs[1].mode.contacts["left"]
    assert [*modes.values()] == ["slip_backward", "stick"]


def quarter_period(theta: float) -> float:
    """Time in which a block falls from rest at this angle to its base [s]."""
    p = np.sqrt(3 * 9.81 / (4 * np.hypot(*BLOCK.values())))
    k = np.cos((BLOCK_ANGLE - theta) / 2)
    return float((ellipk(k**2) - ellipkinc(np.arcsin(np.cos(BLOCK_ANGLE / 2) / k), k**2)) / p)


@pytest.mark.parametrize("engine", ["scipy", pytest.param("heyoka", marks=pytest.mark.slow)])
def test_the_impacts_of_a_rocking_block_accumulate_at_the_time_of_its_closed_form(engine: str) -> None:
    """Each impact leaves 1 - 3/2 sin^2(alpha) of the rate; the block then rises to an angle and falls from it."""
    if engine == "heyoka" and not is_installed():
        pytest.skip("heyoka is not installed")
    case, theta = frame(**BLOCK), 0.5 * BLOCK_ANGLE
    expected = quarter_period(theta)
    while theta > 1e-14:
        lost = (1 - 1.5 * np.sin(BLOCK_ANGLE) ** 2) ** 2
        # 1 - cos(alpha - theta) = the cosine rule of energy, with the fall of the centre of mass
        fallen = lost * 2 * np.sin(theta / 2) * np.sin(BLOCK_ANGLE - theta / 2)
        theta = BLOCK_ANGLE - np.arccos(np.cos(BLOCK_ANGLE) + fallen)
        expected += 2 * quarter_period(theta)
    start = tilted(case, 0.5 * BLOCK_ANGLE, "right")
    outcome = Simulator(case.dynamics(1.0), stepper_class(engine), max_switches=400).step(start)
    assert outcome.ending == Ending.IMPACTS_ACCUMULATE
    assert outcome.message.startswith(f"impacts accumulate at {expected:.6g} s")
    energies = [case.oracle.energy(*coordinates(case, arc.states[0])) for arc in outcome.step.arcs]
    assert all(later < before for before, later in pairwise(energies))
    early = Simulator(case.dynamics(1.0), stepper_class(engine)).step(start)  # extrapolated from the first impacts
    assert early.ending == Ending.IMPACTS_ACCUMULATE
    assert float(early.message.split()[3]) == pytest.approx(expected, rel=1e-3)


def coordinates(case: ContactCase, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n = len(case.walker.shape)
    order = [*range(n), n + 1, n]
    return state[: n + 2][order], state[n + 2 :][order]


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.99, 1.01, 1.5])
def test_a_frame_at_rest_stays_as_long_as_some_split_of_its_forces_lies_in_both_cones(ratio: float) -> None:
    """On a slope the load shifts to the lower foot; each foot has friction of its own."""
    friction = {"left": 0.6, "right": 0.2}
    for slope in (0.1, 0.3):
        half, height = 0.5, 0.4
        # moments about the centre of mass: (N_right - N_left) half = T height, with T the weight's part along the slope
        share = (1 + np.tan(slope) * height / half) / 2
        holds = (1 - share) * friction["left"] + share * friction["right"]
        scaled = {name: value * np.tan(slope) / (holds * ratio) for name, value in friction.items()}
        outcome = Simulator(frame(half, height, slope=slope).dynamics(scaled)).step(np.array([0, height, 0, 0, 0, 0]))
        first = outcome.step.arcs[0].mode
        assert first.sticks is (ratio < 1)
        assert first.touching == ("left", "right")


class Doubled(Frame):
    """A frame of which one foot is two contacts in one place."""

    model = "doubled"
    contacts = ("left", "left_too", "right")

    @classmethod
    def mechanism(cls, q, p):
        stated = super().mechanism(q, p)
        feet = {name: stated.contacts[name.removesuffix("_too")] for name in cls.contacts}
        return replace(stated, contacts=feet)


@pytest.mark.parametrize(("slope", "mu"), [(0.1, 0.5), (0.3, 0.35), (-0.2, 1.5), (0.1, np.tan(0.1))])
def test_undetermined_forces_have_bounds_in_place_of_values(slope: float, mu: float) -> None:
    """A frame at rest: the normal forces follow from moments, and both tangential ones hold the weight's part."""
    half, height = 0.3, 0.5
    start = np.array([0.0, height, 0.0, 0.0, 0.0, 0.0])
    step = Simulator(frame(half, height, slope=slope).dynamics(mu)).step(start, dense=True).step
    along, down = 9.81 * np.sin(slope), 9.81 * np.cos(slope)
    normal = {name: (down + side * along * height / half) / 2 for name, side in (("left", -1), ("right", 1))}
    record = contact_record([step])
    assert record["undetermined"] == ["left", "right"]
    assert record["contacts"]["left"]["required_friction"] is None
    assert {*record["undetermined_bounds"]} == {"f_t.left", "f_t.right"}
    for name, other in (("left", "right"), ("right", "left")):
        low = max(-mu * normal[name], -along - mu * normal[other])
        high = min(mu * normal[name], -along + mu * normal[other])
        assert record["undetermined_bounds"][f"f_t.{name}"] == pytest.approx([low, high], rel=1e-7, abs=1e-7)
    header = trajectory_header(step.arcs[0].dynamics.system)
    for row in trajectory_rows([step]):
        cells = dict(zip(header, row, strict=True))
        assert np.isnan([cells["f_t.left"], cells["f_t.right"]]).all()
        assert [cells["f_n.left"], cells["f_n.right"]] == pytest.approx([*normal.values()], rel=1e-12)
    first = next(csv.DictReader(io.StringIO(csv_text(Table(header=header, rows=trajectory_rows([step]))))))
    assert [first[f"f_t.{name}"] for name in normal] == ["", ""]


def test_bounds_of_three_shared_contacts_are_those_of_linear_programming() -> None:
    """Two contacts in one place and a third: two shares, one of them of the normal forces."""
    doubled = Doubled(**dict(frame(0.3, 0.5, slope=0.2).walker))
    friction = {"left": 0.6, "left_too": 0.3, "right": 0.5}
    start = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    step = Simulator(dynamics_of(doubled, friction)).step(start, dense=True).step
    # unknown f_t, f_n of the three; moments about the centre of mass, forces along and across the slope
    arms = {"left": -0.3, "left_too": -0.3, "right": 0.3}
    balance = np.array([[1, 0] * 3, [0, 1] * 3, [v for arm in arms.values() for v in (-0.5, -arm)]])
    load = np.array([-9.81 * np.sin(0.2), 9.81 * np.cos(0.2), 0.0])
    cones = np.zeros((6, 6))
    for k, mu in enumerate(friction.values()):
        cones[2 * k, 2 * k : 2 * k + 2], cones[2 * k + 1, 2 * k : 2 * k + 2] = [1, -mu], [-1, -mu]
    bounds = contact_record([step])["undetermined_bounds"]
    names = [f"{force}.{name}" for name in arms for force in ("f_t", "f_n")]
    assert {*bounds} == {name for name in names if name != "f_n.right"}
    for name, (low, high) in bounds.items():
        for sign, expected in ((1, low), (-1, high)):
            cost = sign * np.eye(6)[names.index(name)]
            found = linprog(cost, A_ub=cones, b_ub=np.zeros(6), A_eq=balance, b_eq=load, bounds=(None, None))
            assert sign * found.fun == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("friction", [(0.2, 0.4), (0.4, 0.2)])
def test_of_two_contacts_in_one_place_that_with_more_friction_takes_the_load(friction: tuple[float, float]) -> None:
    """They stick as one contact with the larger friction; where they slip, the shares of the impulse decide."""
    single = frame(0.3, 0.5)
    doubled = Doubled(**dict(single.walker))
    both = dict(zip(("left", "left_too"), friction, strict=True))
    falls = np.array([-0.2, 1.0, 0.0, 0.0, 0.0, 0.0])  # the left foot comes first; alone it needs 0.258
    needed = {"left": 0.25, "left_too": 0.26} if friction[0] < friction[1] else {"left": 0.26, "left_too": 0.25}
    for values in (both, needed):
        one = Simulator(single.dynamics(max(values.values()))).step(falls)
        two = Simulator(dynamics_of(doubled, {**values, "right": max(values.values())})).step(falls)
        for ours, theirs in zip(one.step.arcs[:2], two.step.arcs[:2], strict=True):
            assert theirs.states[-1] == pytest.approx(ours.states[-1], rel=1e-9, abs=1e-9)
    lower = Simulator(dynamics_of(doubled, {"left": 0.2, "left_too": 0.25, "right": 0.4})).step(falls)
    assert lower.ending == Ending.UNDETERMINED
    assert "the impulses do not determine the impact" in lower.message
    slides = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 1.0])
    sliding = Simulator(dynamics_of(doubled, {"left": 0.2, "left_too": 0.4, "right": 0.2})).step(slides)
    assert sliding.ending == Ending.UNDETERMINED
    assert "contacts of different friction slip together" in sliding.message


class Pushed(Frame):
    """A frame under any force and torque."""

    model = "pushed"

    along: float
    down: float
    torque: float

    @classmethod
    def mechanism(cls, q, p):
        gravity = vertcat(p.along, -p.down)
        return replace(super().mechanism(q, p), gravity=gravity, potential=-p.torque * q.theta)


def accelerations(walker: Pushed, friction: dict[str, float]) -> tuple[list[np.ndarray], float]:
    """All consistent accelerations (theta, x, y) of a frame of mass 1 at rest, and how close the nearest edge is.

    Every combination that moves is solved, also where the apparent mass of its feet is negative (Painleve); the frame
    rests if some split of the tangential forces is in both cones.
    """
    load = np.array([walker.torque, walker.along, -walker.down])
    inverse, h = np.diag([1 / walker.inertia, 1, 1]), walker.height
    # rows of a foot aside of the centre by b: its tangential and normal velocity per rate of theta, x, y
    feet = {"left": -walker.half, "right": walker.half}
    rows = {name: np.array([[-h, 1, 0], [-b, 0, 1]]) for name, b in feet.items()}
    found, nearest = [], np.inf
    for words in product(("off", "stick", 1, -1), repeat=2):
        touching = {name: word for name, word in zip(feet, words, strict=True) if word != "off"}
        if len(touching) == 2 and "stick" in touching.values():
            continue  # one sticking foot and another one on the ground: the frame rests
        held = [rows[n][[0, 1] if word == "stick" else [1]] for n, word in touching.items()]
        pushes = [
            rows[n].T if w == "stick" else (rows[n][1:] - w * friction[n] * rows[n][:1]).T for n, w in touching.items()
        ]
        J, W = np.vstack([np.zeros((0, 3)), *held]), np.hstack([np.zeros((3, 0)), *pushes])
        forces = np.linalg.solve(J @ inverse @ W, -J @ inverse @ load)
        a, margins, at = inverse @ (load + W @ forces), [], 0
        for n in feet:
            word, moved = touching.get(n, "off"), rows[n] @ a
            if word == "off":
                margins.append(moved[1])
            elif word == "stick":
                f_t, f_n = forces[at : at + 2]
                margins += [f_n, friction[n] * f_n - abs(f_t)]
                at += 2
            else:
                margins += [forces[at], word * moved[0]]
                at += 1
        nearest = min(nearest, abs(min(margins)))
        if min(margins) > 0:
            found.append(a)
    left, right = (walker.down + side * (walker.torque + h * walker.along) / walker.half for side in (-1, 1))
    reach = friction["left"] * left / 2 + friction["right"] * right / 2 - abs(walker.along)
    nearest = min(nearest, *np.abs([left, right, reach]))
    return [*found, *([np.zeros(3)] if min(left, right, reach) > 0 else [])], nearest


def test_forces_and_torques_for_which_several_motions_are_consistent_end_with_their_names() -> None:
    rng, counts = np.random.default_rng(0), Counter[int]()
    for _ in range(250):
        half, height, inertia = rng.uniform([0.05, 0.05, 0.005], [1, 1, 0.3])
        along, down, torque = rng.normal(size=3) * [20, 20, 10]
        friction = dict(zip(("left", "right"), rng.uniform(0.1, 4, 2), strict=True))
        walker = Pushed(
            half=half, height=height, mass=1.0, inertia=inertia, gravity=1.0, slope=0.0, along=along, down=down,
            torque=torque,
        )  # fmt: skip
        expected, nearest = accelerations(walker, friction)
        if nearest < 1e-6:
            continue
        resolver = ContactResolver(dynamics_of(walker, friction))
        state = np.array([0, height, 0, 0, 0, 0])
        start, _ = resolver.start(state, anywhere=True)
        chosen = resolver.mode_at_rest(resolver.system.transitions.at_rest(start), 0.0, state, 0)
        counts[len(expected)] += 1
        if len(expected) == 1:
            assert isinstance(chosen, Mode)
            flow = dynamics_of(walker, friction).system.flow(chosen)
            dz = np.asarray(flow(0, np.array([0, height, 0, 0, 0, 0]), dynamics_of(walker, friction).p, [])).ravel()
            assert dz[[3, 5, 4]] == pytest.approx(expected[0], rel=1e-9, abs=1e-9)
        else:
            assert chosen.ending == Ending.CONTACT_AMBIGUOUS
            assert chosen.reason.count(" and ") == len(expected) - 1  # all are listed
    assert {*counts} == {1, 3}  # from rest, solutions of either sign of the determinant come in pairs
    assert counts[1] > 200
    assert counts[3] > 2


class Rod(Frame):
    """A rod whose lower end touches the ground; ``half`` has no meaning."""

    model = "rod"
    contacts = ("tip",)

    @classmethod
    def mechanism(cls, q, p):
        tip = vertcat(q.x, q.y) - p.height * vertcat(sin(q.theta), cos(q.theta))
        return replace(super().mechanism(q, p), contacts={"tip": Contact(position=tip)})


@pytest.mark.parametrize("rate", [0.0, 3.0, 6.0])
@pytest.mark.parametrize("friction", [0.5, 1.2, 3.0])
def test_a_sliding_rod_slides_lifts_off_or_ends_with_the_name_of_its_paradox(friction: float, rate: float) -> None:
    """Painleve's rod drags its tip ahead of its centre; f_n p = -a with p = 1/m - l^2 s (mu c - s) / I."""
    length, inertia, lean = 1.0, 1 / 12, 0.5
    s, c = np.sin(lean), np.cos(lean)
    p, a = 1 - length**2 * s * (friction * c - s) / inertia, -9.81 + length * c * rate**2
    # the tip slides forward at 1 m/s and stays at height zero
    state = np.array([-lean, length * c, 0.0, rate, length * s * rate, 1.0 + length * c * rate])
    rod = Rod(half=1.0, height=length, mass=1.0, inertia=inertia, gravity=9.81, slope=0.0)
    outcome = Simulator(dynamics_of(rod, friction), max_switches=1).step(state)
    if p > 0:
        assert outcome.step.arcs[0].mode.brief == ("slip_forward" if a < 0 else "flight").replace("slip", "tip slip")
    elif a > 0:
        assert outcome.ending == Ending.CONTACT_AMBIGUOUS
        assert "tip slip_forward and flight" in outcome.message
    else:
        assert outcome.ending == Ending.PAINLEVE
        frictionless = 1 + length**2 * s**2 / inertia
        assert f"regularity is not positive: tip slip_forward {p / frictionless:.4g}" in outcome.message


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
@pytest.mark.parametrize(("half", "height"), [(0.3, 1.0), (0.2, 0.7), (0.5, 0.4)])
def test_a_frame_whose_friction_is_exactly_that_of_its_proportions_slides_on_both_feet(half, height, engine):
    """The force of the rear foot is zero, up to the sign of its rounding: by the rule for ties it stays."""
    if engine == "heyoka" and not is_installed():
        pytest.skip("heyoka is not installed")
    for velocity in (1.0, -1.0):
        state = np.array([0.0, height, 0.0, 0.0, 0.0, velocity])
        step = Simulator(frame(half, height).dynamics(half / height), stepper_class(engine)).step(state).step
        slip = str(Mode.slip(velocity))
        assert [words(arc.mode) for arc in step.arcs] == [
            [f"left {slip}", f"right {slip}"],
            ["left stick", "right stick"],
        ]
        assert step.arcs[0].end == pytest.approx(abs(velocity) * height / (half * 9.81), rel=1e-12)


@pytest.mark.parametrize("slope", [0.1, 0.3, -0.2])
def test_a_frame_whose_friction_is_exactly_that_of_the_slope_rests(slope: float) -> None:
    outcome = Simulator(frame(0.5, 0.4, slope=slope).dynamics(abs(np.tan(slope)))).step(np.array([0, 0.4, 0, 0, 0, 0]))
    assert outcome.ending == Ending.NO_TOUCHDOWN
    assert [arc.mode.sticks for arc in outcome.step.arcs] == [True]


@pytest.mark.parametrize("above", [0.0, 1e-14, -1e-14, 1e-10])
def test_a_contact_that_starts_on_the_ground_and_comes_down_strikes_it(above: float) -> None:
    """Rate and velocity after the impact follow from those of a block that is dropped a little higher."""
    case = frame(**BLOCK)
    falls = np.array([0.1, 0.0, 0.0, 0.0, -1.0, 0.3])
    falls[1] = above - case.points["right"].position(np.array([0.1, 0.0, 0.0]))[1]
    higher = falls + np.array([0, 1e-5, 0, 0, 0, 0])
    one, other = (Simulator(case.dynamics(0.5), max_switches=2).step(state).step.arcs for state in (falls, higher))
    assert one[0].struck is other[1].struck
    assert one[0].start == 0.0
    assert one[0].states[0][3:] == pytest.approx(other[1].states[0][3:], abs=1e-4)
    assert Simulator(case.dynamics(0.5), max_switches=2).step(falls).step.landings[0] is one[0].struck


def test_a_state_below_the_ground_is_refused_with_contact_and_height() -> None:
    case = frame(**BLOCK)
    simulator = Simulator(case.dynamics(0.5))
    state = np.array([0.0, BLOCK["height"] - 0.001, 0.0, 0.0, 0.0, 0.0])
    outcome = simulator.step(state)
    assert outcome.step is None
    assert outcome.message.startswith("left is 0.001 m below the ground at the start")
    with pytest.raises(ProblemError, match=r"state: left is 0\.001 m below the ground at the start"):
        simulator.check_start(state)
    gait = named("heel-toe")
    whole = dict(zip(gait.system.state_names, gait.state.tolist(), strict=True))
    with pytest.raises(ProblemError, match=r"state: heel is 0\.03 m below the ground at the start"):
        simulate(gait, {**whole, "y": whole["y"] - 0.03})


@pytest.mark.parametrize("factors", [(2.0, 1.0, 1.0), (1.0, 3.0, 1.0), (1.0, 1.0, 0.5), (7.0, 0.2, 4.0)])
def test_a_compass_with_feet_moves_alike_in_other_units(factors: tuple[float, float, float]) -> None:
    mass, length, time = factors
    case = heel_toe()
    sizes = {"leg_length", "leg_com", "heel", "toe"}
    changed = {name: value * length for name, value in case.walker if name in sizes}
    changed |= {name: value * mass for name, value in case.walker if name.endswith("mass")}
    changed["gravity"] = case.walker.gravity * length / time**2
    q, dq = on_heel(case, HEEL_STRIKES[0.265])
    unit = np.array([1, 1, length, length])
    one = Simulator(case.dynamics(0.265)).step(case.state(q, dq)).step
    other = Simulator(heel_toe(**changed).dynamics(0.265)).step(case.state(q * unit, dq * unit / time)).step
    assert [arc.mode for arc in other.arcs] == [arc.mode for arc in one.arcs]
    assert [arc.end / time for arc in other.arcs] == pytest.approx([arc.end for arc in one.arcs], rel=1e-12)
    scale = np.concatenate([unit, unit / time])
    assert other.impact.state / scale == pytest.approx(one.impact.state, rel=1e-12, abs=1e-12)


@pytest.mark.skipif(not is_installed(), reason="needs pip install '.[heyoka]'")
@pytest.mark.parametrize(
    ("factors", "ending"),
    [
        pytest.param((1.354, 1.009, 1.381), Ending.FALL, marks=pytest.mark.slow),
        ((1.265, 0.889, 1.162), Ending.FALL),
        ((0.55, 0.84, 0.56), Ending.SCUFFING),  # the swing foot is 46 um below the ground where it begins to count
    ],
)
def test_engines_end_a_fall_alike(factors: tuple[float, float, float], ending: Ending) -> None:
    """A leg turns through postures in which entries of the mass matrix vanish: no pivot may be one of them."""
    gait = named("heel-toe")
    section = gait.system.section(gait.cycle)
    start = section.lift(gait.state[section.indices] * factors, gait.p, gait.state)
    trajectories = [Simulator(gait.dynamics, stepper_class(engine)).run(start, 2) for engine in ("scipy", "heyoka")]
    assert [trajectory.ending for trajectory in trajectories] == [ending, ending]


def test_measures_of_a_step_over_heel_and_toe_are_those_of_its_contacts() -> None:
    """Friction needed, and the distance that heel and toe slide, against forces and positions written by hand."""
    case = heel_toe()
    state = case.state(*on_heel(case, HEEL_STRIKES[0.265]))
    step = Simulator(case.dynamics(0.265)).step(state, dense=True).step
    measured = measure([step])
    ratios, slipped, energies = [], 0.0, []
    for arc in step.arcs:
        (name,) = arc.mode.touching
        ends = [case.points[name].position(coordinates(case, z)[0])[0] for z in arc.states[[0, -1]]]
        slipped += abs(ends[1] - ends[0])
        work = 0.0
        for z, t in zip(arc.states, arc.times, strict=True):
            q, dq = coordinates(case, z)
            ddq = np.asarray(arc.dynamics.system.flow(arc.mode)(t, z, arc.dynamics.p, [])).ravel()[4:][[0, 1, 3, 2]]
            residual = case.oracle.M(q) @ ddq + case.oracle.B(q, dq) + case.oracle.G(q)
            force = residual[-2:]  # the base point moves along with every contact
            assert case.points[name].jacobian(q).T @ force == pytest.approx(residual, abs=1e-8)
            ratios += [abs(force[0] / force[1])] if arc.mode.sticks else []
        energies.append([case.oracle.energy(*coordinates(case, z)) for z in arc.states[[0, -1]]])
        observed = observe(arc)
        power = np.sum(observed.force[:, ::2] * observed.slip, axis=1)
        work = curves.integral(power, arc.duration)
        assert energies[-1][1] - energies[-1][0] == pytest.approx(work, abs=1e-9)
    assert measured["required_friction"] == pytest.approx(max(ratios), rel=1e-6)
    assert measured["slip_distance"] == pytest.approx(slipped, rel=1e-9)
    assert trajectory_header(case.dynamics(0.265).system)[-8:] == tuple(
        f"{force}.{name}" for name in case.walker.contacts for force in ("f_t", "f_n")
    )
