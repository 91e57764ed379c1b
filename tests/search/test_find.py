"""Gaits found without a mode sequence or a guess."""

from dataclasses import replace

import numpy as np
import pytest

import gaitopt as go
from gaitopt import Status, find, load_problem, solve
from gaitopt.errors import GaitoptWarning, UnknownNameError
from gaitopt.search.candidates import SearchJob, find_candidates
from gaitopt.search.find import (
    MOST_BOXES,
    SearchPlan,
    counted_gaits,
    family_jobs,
    gaits_of,
    grown_box,
    near_walls,
    with_open_modes,
)
from gaitopt.search.starts import around_guess, box_around, natural_limits, start_box
from gaitopt.systems import problem_dynamics
from gaitopt.workers.jobs import FailedJob

SEQUENCE_A = "slip_forward, stick, slip_backward; stick"
SEQUENCE_B = "slip_forward, stick; slip_forward"


def open_problem(name, overrides=None):
    """A named problem without its sequence and its guess."""
    problem = load_problem(name).replace({"gait.phases": "auto"} | (overrides or {}))
    return replace(problem, start=None)


def cycles(gaits):
    return [str(gait.problem.cycle) for gait in gaits]


@pytest.fixture(scope="module")
def searches(tmp_path_factory):
    """A search at its time limit, the same search that goes on in its folder, and what the latter told on the way."""
    problem, folder, told = open_problem("rimless-wheel-slip"), tmp_path_factory.mktemp("find") / "run", []
    cut = find(problem, starts=1, seconds=0.0, output=folder, progress=False)
    return cut, find(problem, starts=1, output=folder, found=told.append, progress=False), told


@pytest.fixture(scope="module")
def wheel(searches):
    """All gaits of the wheel on a floor of friction 0.4."""
    return searches[1]


def test_the_wheel_has_one_gait_however_many_starts_lead_to_it(wheel):
    assert cycles(wheel) == ["stick, slip_forward; stick"]
    assert len(wheel.starts[0]) > 20
    assert wheel[0].verification["passed"]


def test_the_record_has_gaits_with_the_keys_of_solve_and_what_was_searched(wheel):
    gait = solve(load_problem("rimless-wheel-slip"))
    np.testing.assert_allclose(wheel[0].state, gait.state, atol=1e-10)
    record = wheel.to_record()
    assert record["problem"] == "rimless-wheel-slip"
    assert record["gaits"][0].keys() >= wheel[0].to_record().keys()
    assert record["searched"]["starts"] == {"simulation": 500, "families": 2}


def test_the_last_box_surrounds_the_gait_and_is_stated_with_two_digits(wheel):
    first, last = wheel.searched["boxes"]
    lower, upper = last["dtheta"]
    rate = wheel[0].state[wheel[0].system.state_names.index("dtheta")]
    assert lower < 0.6 * rate < 1.4 * rate < upper
    walker = wheel.problem.walker
    assert first["dtheta"] == pytest.approx(np.array([-0.6, 0.6]) * (walker.gravity / walker.radius) ** 0.5)
    assert (round(lower, 2), round(upper, 2)) == (lower, upper)
    assert wheel.searched["warnings"] == []


@pytest.mark.parametrize(("span", "place"), [((0.7, 3), "near the wall of"), ((1, 3), "outside of"), ((0.3, 1.2), "")])
def test_gaits_near_the_wall_of_a_box_or_beyond_are_named_with_a_wider_range(wheel, span, place):
    plan, dynamics = SearchPlan(problem=wheel.problem), wheel[0].dynamics
    sentences = near_walls(plan, dynamics, start_box(wheel.problem, dynamics, {"dtheta": span}), wheel)
    words = f"dtheta in {span[0]}:3, and dtheta of gait 0 is {place} this range; search within dtheta=0.38:3 too"
    assert [words in sentence for sentence in sentences] == [True] * bool(place)


@pytest.mark.slow
def test_a_range_that_is_given_stays_and_a_gait_beyond_it_is_a_warning():
    problem = open_problem("rimless-wheel-slip")
    with pytest.warns(GaitoptWarning, match="dtheta of gait 0 is outside of this range") as warned:
        gaits = find(problem, starts=1, within={"dtheta": (0.8, 1.0)}, progress=False)
    assert [box["dtheta"] for box in gaits.searched["boxes"]] == [(0.8, 1.0)] * 2
    assert gaits.to_record()["searched"]["warnings"] == [str(warning.message) for warning in warned]


@pytest.mark.slow
def test_a_search_that_resumes_has_the_boxes_and_the_gaits_of_one_without_a_stop(wheel, tmp_path):
    done = []

    def count(n, total):
        done.append(n)

    with pytest.raises(KeyboardInterrupt):
        find(wheel.problem, starts=1, output=tmp_path / "run", progress=count, should_stop=lambda: len(done) > 2)
    resumed = find(wheel.problem, starts=1, output=tmp_path / "run", progress=count)
    assert len(done) == 4  # one part in the first box, two families, one part in the box around the gait
    assert resumed.searched == wheel.searched
    assert [gait.state.tolist() for gait in resumed] == [gait.state.tolist() for gait in wheel]


def test_a_search_at_its_time_limit_is_not_complete_and_one_with_a_folder_goes_on(searches):
    cut, wheel, told = searches
    assert (len(cut), cut.searched["complete"], cut.searched["starts"]) == (0, False, {})
    assert wheel.searched["complete"]
    assert [len(gaits) for gaits in told] == [1]
    assert told[0][0].state.tolist() == wheel[0].state.tolist()


@pytest.mark.slow
def test_without_a_gait_the_box_is_halved():
    uphill = open_problem("rimless-wheel-slip", {"walker.slope": "-5deg"})
    boxes = find(uphill, starts=1, progress=False).searched["boxes"]
    assert len(boxes) == MOST_BOXES
    assert boxes[-1]["dtheta"][1] == pytest.approx(boxes[0]["dtheta"][1] / 2 ** (MOST_BOXES - 1))


def test_a_box_ends_at_the_natural_limits(wheel):
    dynamics = wheel[0].dynamics
    limits = natural_limits(dynamics, wheel.problem.map_section)
    assert (box_around(wheel.problem, dynamics, limits[None] * 0.9).upper > limits).all()
    fast = replace(wheel[0], steps=(replace(wheel[0].steps[0], arcs=(fast_arc(wheel[0], limits * 0.9),)),))
    box = grown_box(SearchPlan(problem=wheel.problem), dynamics, start_box(wheel.problem, dynamics, {}), [fast])
    assert box.upper[0] == limits[0]


def fast_arc(gait, xi):
    """The first arc of a gait, from other section coordinates."""
    arc = gait.steps[0].arcs[0]
    states = arc.states.copy()
    states[0] = gait.dynamics.lift(xi)
    return replace(arc, states=states)


def test_the_summary_says_how_many_gaits_are_stable_and_that_there_may_be_more(wheel):
    assert repr(wheel) == "<Gaits of rimless-wheel-slip: 1 gait, stable, found from 502 starts; there may be more>"
    assert counted_gaits([]) == "no gait"
    assert counted_gaits([False]) == "1 gait, unstable"
    assert counted_gaits([False, False]) == "2 gaits, none of them stable"
    assert counted_gaits([True, False]) == "2 gaits, 1 of them stable"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_garcias_walker_has_its_stable_and_its_unstable_gait(seed):
    """Garcia, Chatterjee, Ruina & Coleman (1998), slope 0.009: a stable gait and a shorter, unstable one."""
    numbers = {"leg_length": 1.0, "leg_mass": 1e-6, "leg_com": 1e-9, "hip_mass": 1.0, "gravity": 1.0, "slope": 0.009}
    garcia = open_problem("compass-passive-stick", {f"walker.{key}": value for key, value in numbers.items()})
    gaits = find(garcia.replace({"friction": 1.0}), starts=300, seed=seed, progress=False)
    assert [gait.state[0] for gait in gaits] == pytest.approx([-0.200310900544287, -0.193937369810184], abs=2e-6)
    assert [gait.period for gait in gaits] == pytest.approx([3.882, 3.096], abs=1e-3)
    assert [gait.spectral_radius < 1 for gait in gaits] == [True, False]
    assert gaits.searched["warnings"] == []


def test_a_known_sequence_is_ignored_and_a_step_length_is_no_start_of_a_search(wheel):
    """A guess of the torques and the motion of a design needs no state, but a walk begins with one."""
    assert with_open_modes(load_problem("rimless-wheel-slip")).is_open
    assert with_open_modes(wheel.problem) is wheel.problem
    phases = {"phases": ["stick"], "impact": "stick", "guess": {"step_length": 0.4, "duration": 0.7}}
    control = {"control": {"type": "open_loop", "intervals": 2}, "objective": "torque_squared"}
    problem = load_problem("compass-passive-stick").replace({"gait": phases, "friction": 0.6} | control)
    assert problem.start is not None
    assert with_open_modes(problem).start is None


def test_where_nothing_walks_nothing_is_listed_and_solve_says_what_was_tried():
    uphill = open_problem("rimless-wheel-slip", {"walker.slope": "-5deg"})
    part = find_candidates(SearchJob(problem=uphill, method="simulation", number=0, seed=0, within={}))
    gaits = gaits_of(uphill, [part])
    assert (len(gaits), gaits.to_record()["gaits"]) == (0, [])
    gait = solve(uphill)
    assert gait.status is Status.NOT_CONVERGED
    assert gait.message.endswith("no gait was found from 2000 starts of simulation")  # in five boxes
    assert gait.to_record()["phases"] == []


def test_a_candidate_that_is_no_gait_is_rejected_with_its_reason():
    problem = open_problem("rimless-wheel-slip")
    gait = solve(load_problem("rimless-wheel-slip"))
    wrong = {**gait.to_record(), "start": "test"}
    wrong["steps"] = [{"phases": [{"mode": "stick", "duration": gait.period}], "impact": "stick"}]
    faster = {**wrong["state"], "dtheta": 1.01 * wrong["state"]["dtheta"]}
    twice = [wrong, {**wrong, "start": "another", "state": faster}]
    gaits = gaits_of(problem, [{"method": "simulation", "starts": 2, "candidates": twice}])
    assert len(gaits) == 0
    (rejected,) = gaits.searched["rejected"]
    assert "needs friction 0.9141" in rejected["reason"]
    assert rejected["starts"] == ["test", "another"]


def test_a_requested_impact_excludes_the_others_and_a_part_of_the_search_that_failed_is_named(wheel):
    problem = open_problem("rimless-wheel-slip", {"gait.impact": "slip_forward"})
    candidate = {**wheel[0].to_record(), "steps": [wheel[0].to_record()], "start": "test"}
    part = {"method": "simulation", "starts": 1, "candidates": [candidate]}
    gaits = gaits_of(problem, [part, FailedJob(reason="it took 3 workers with it")])
    assert (len(gaits), gaits.searched["failed"]) == (0, ["it took 3 workers with it"])


def test_candidates_do_not_depend_on_other_parts_of_the_search():
    job = SearchJob(problem=open_problem("rimless-wheel-slip"), method="simulation", number=3, seed=7, within={})
    assert find_candidates(job) == find_candidates(job)


def test_start_states_lie_within_the_box_that_is_given_whose_coordinates_must_be_there():
    problem = open_problem("compass-passive-a")
    box = start_box(problem, problem_dynamics(problem), {"dtheta1": (0.1, 0.2)})
    index = problem.walker.section_names(slipping=True).index("dtheta1")
    assert (box.lower[index], box.upper[index]) == (0.1, 0.2)
    with pytest.raises(UnknownNameError, match=r"within phi.*use theta1"):
        find(problem, within={"phi": (0, 1)})


def test_starts_of_a_walker_with_several_contacts_lie_in_the_ranges_that_are_given():
    problem = go.load_problem("crawler")
    dynamics, spans = problem_dynamics(problem), {"gap": (0.4, 0.41)}
    states = around_guess(problem, dynamics, 5, np.random.default_rng(0), exact=False, within=spans)
    heights = np.array([np.asarray(dynamics.system.contact_points(state, dynamics.p)[0]).ravel() for state in states])
    assert heights == pytest.approx(0, abs=1e-9)
    for name, (lower, upper) in spans.items():
        column = states[:, dynamics.system.state_names.index(name)]
        assert ((lower <= column) & (column <= upper)).all()
    with pytest.raises(UnknownNameError, match=r"within height: not a coordinate just after an impact; use gap"):
        go.find(problem, within={"height": (0, 1)}, progress=False)


def test_a_closed_problem_has_the_sequence_and_the_motion_of_the_record():
    gait = solve(load_problem("compass-passive-b"))
    problem = open_problem("compass-passive-b").with_gait(gait.to_record())
    assert problem.cycle == gait.problem.cycle
    assert problem.guess.durations == tuple(duration for _, duration in gait.phases)


@pytest.mark.slow
def test_on_the_family_of_a_gait_there_are_others_to_which_no_walk_leads():
    """Between the period doubling and the fold of the limping family, two unstable ones lie beside gait B."""
    gait_b = load_problem("compass-passive-b").replace({"friction": 0.1447})
    job = {"method": "families", "number": 0, "seed": 0, "within": {}, "parameter": "friction"}
    part = find_candidates(SearchJob(problem=gait_b, n_steps=2, **job))
    limping = gaits_of(gait_b.replace({"gait": {"phases": "auto", "steps": 2}}), [part])
    assert [len(gait.steps) for gait in limping] == [2, 2]
    assert all(gait.repeats_after == 2 and gait.spectral_radius > 1 for gait in limping)
    assert len(gaits_of(gait_b.replace({"gait": {"phases": "auto"}}), [part])) == 0


def test_families_are_followed_of_gaits_but_not_of_designs(wheel):
    plan = SearchPlan(problem=wheel.problem)
    assert {job.argument.parameter for job in family_jobs(plan, wheel)} == {"friction", "walker.slope"}
    design = wheel.problem.replace({"friction": {"free": [0.3, 0.5], "guess": 0.4}, "objective": "speed"})
    assert family_jobs(SearchPlan(problem=design), wheel) == []


def test_walks_of_a_design_try_values_of_the_free_parameters_within_their_bounds():
    problem = with_open_modes(load_problem("compass-torque-efficient"))
    tried = []
    for number in (0, 17):  # where both impacts slip, and where no foot slips at all
        part = find_candidates(SearchJob(problem=problem, method="simulation", number=number, seed=0, within={}))
        tried.append({tuple(candidate["parameters"].items()) for candidate in part["candidates"]})
    assert tried[0] == {tuple((key, free.guess) for key, free in problem.free.items())}
    ((values),) = tried[1]
    assert all(free.lower <= dict(values)[key] <= free.upper != free.guess for key, free in problem.free.items())
    assert dict(values) != dict(*tried[0])


@pytest.mark.slow
def test_a_design_is_solved_with_mode_sequences_that_do_not_exist_at_its_guess():
    """The best step slips; a step without slip costs 0.4 % more."""
    gaits = find(with_open_modes(load_problem("compass-torque-efficient")), starts=500, progress=False)
    assert cycles(gaits) == ["slip_forward, stick; slip_forward", "stick; stick"]
    assert [gait.solver["objective"] for gait in gaits] == pytest.approx([0.003998, 0.004016], abs=1e-6)


@pytest.mark.slow
def test_on_a_steep_slope_there_is_a_gait_of_two_steps():
    overrides = {"friction": 0.6, "walker.slope": "5.4deg", "gait.steps": 2}
    gaits = find(open_problem("compass-passive-stick", overrides))
    assert sorted(round(gait.period, 4) for gait in gaits) == [0.6353, 0.8341, 1.6659]
    assert [len(gait.steps) for gait in gaits] == [2, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "sequence"),
    [
        (1.0, "stick; stick"),
        (0.26, "slip_forward, stick, slip_forward; stick"),
        (0.24, "slip_forward, stick, slip_forward; slip_forward"),
    ],
)
def test_the_wheel_has_one_gait_at_every_friction(friction, sequence):
    assert cycles(find(open_problem("rimless-wheel-slip", {"friction": friction}), starts=250)) == [sequence]


@pytest.mark.slow
def test_the_passive_compass_has_exactly_gaits_a_and_b_of_which_solve_takes_the_stable_one():
    gaits, gait = find(open_problem("compass-passive-a")), solve(open_problem("compass-passive-a"))
    assert cycles(gaits) == [SEQUENCE_A, SEQUENCE_B]
    assert [each.spectral_radius < 1 for each in gaits] == [True, False]
    assert str(gait.problem.cycle) == SEQUENCE_A
    assert gait.problem.digest == open_problem("compass-passive-a").digest
