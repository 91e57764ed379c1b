"""Gaits found without a mode sequence or a guess."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from named import named, verification
from rich.console import Console

from gaitopt import Status, find, load_problem, solve
from gaitopt.errors import GaitoptWarning, UnknownNameError
from gaitopt.search.candidates import SearchJob, cycle_record, find_candidates
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
from gaitopt.show.tables import print_gaits
from gaitopt.systems import problem_dynamics
from gaitopt.workers.jobs import FailedJob

SEQUENCE_A = "slip_forward, stick, slip_backward; stick"
SEQUENCE_B = "slip_forward, stick; slip_forward"


def open_problem(name, overrides=None):
    """A named problem without its sequence and its guess."""
    problem = load_problem(name).replace({"gait.phases": "auto"} | (overrides or {}))
    return replace(problem, start=None)


UPHILL = open_problem("rimless-wheel-slip", {"walker.slope": "-5deg"})


def cycles(gaits):
    return [str(gait.problem.cycle) for gait in gaits]


@pytest.fixture(scope="module")
def searches(tmp_path_factory):
    """A search at its time limit, the same search that goes on in its folder, and what the latter told on the way."""
    problem, folder, told = open_problem("rimless-wheel-slip"), tmp_path_factory.mktemp("find") / "run", []
    cut = find(problem, starts=1, seconds=0.0, output=folder, progress=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitopt.search.candidates.MAX_POINTS", 15)
        return cut, find(problem, starts=1, output=folder, found=told.append, progress=False), told


@pytest.fixture(scope="module")
def wheel(searches):
    """All gaits of the wheel on a floor of friction 0.4."""
    return searches[1]


def test_the_wheel_has_one_gait_however_many_starts_lead_to_it(wheel):
    assert cycles(wheel) == ["stick, slip_forward; stick"]
    assert len(wheel.starts[0]) > 20
    assert wheel[0].verification["passed"]
    np.testing.assert_allclose(wheel[0].state, named("rimless-wheel-slip").state, atol=1e-10)
    record = wheel.to_record()
    assert record["problem"] == "rimless-wheel-slip"
    assert record["gaits"][0].keys() >= wheel[0].to_record().keys()
    assert record["searched"]["starts"] == {"simulation": 500, "families": 2}
    assert repr(wheel) == "<Gaits of rimless-wheel-slip: 1 gait, stable, found from 502 starts; there may be more>"
    assert counted_gaits([]) == "no gait"
    assert counted_gaits([False]) == "1 gait, unstable"
    assert counted_gaits([False, False]) == "2 gaits, none of them stable"
    assert counted_gaits([True, False]) == "2 gaits, 1 of them stable"


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
    options = {"starts": 1, "output": tmp_path / "run", "progress": lambda n, total: done.append(n)}
    with pytest.raises(KeyboardInterrupt):
        find(wheel.problem, should_stop=lambda: len(done) > 2, **options)
    resumed = find(wheel.problem, **options)
    assert len(done) == 4  # one part in the first box, two families, one part in the box around the gait
    assert resumed.searched == wheel.searched
    assert [gait.state.tolist() for gait in resumed] == [gait.state.tolist() for gait in wheel]


def test_a_search_at_its_time_limit_is_not_complete_and_one_with_a_folder_goes_on(searches):
    cut, wheel, told = searches
    assert (len(cut), cut.searched["complete"], cut.searched["starts"]) == (0, False, {})
    assert wheel.searched["complete"]
    assert [len(gaits) for gaits in told] == [1]
    assert told[0][0].state.tolist() == wheel[0].state.tolist()


def test_a_box_ends_at_the_natural_limits(wheel):
    dynamics = wheel[0].dynamics
    limits = natural_limits(dynamics, wheel.problem.map_section)
    assert (box_around(wheel.problem, dynamics, limits[None] * 0.9).upper > limits).all()
    arc = wheel[0].arcs[0]
    states = np.vstack([dynamics.lift(limits * 0.9), arc.states[1:]])
    fast = replace(wheel[0], steps=(replace(wheel[0].steps[0], arcs=(replace(arc, states=states),)),))
    box = grown_box(SearchPlan(problem=wheel.problem), dynamics, start_box(wheel.problem, dynamics, {}), [fast])
    assert box.upper[0] == limits[0]


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
    gait = solve(UPHILL)
    assert gait.status is Status.NOT_CONVERGED
    assert gait.message.endswith("no gait was found from 2000 starts of simulation")  # in five boxes
    assert gait.to_record()["phases"] == []
    job = SearchJob(problem=UPHILL, method="simulation", number=3, seed=7, within={})
    part = find_candidates(job)
    assert part == find_candidates(job)  # whatever the other parts of the search do
    gaits = gaits_of(UPHILL, [part])
    assert (len(gaits), gaits.to_record()["gaits"]) == (0, [])


@pytest.mark.slow
def test_without_a_gait_the_box_is_halved():
    boxes = find(UPHILL, starts=1, progress=False).searched["boxes"]
    assert len(boxes) == MOST_BOXES
    assert boxes[-1]["dtheta"][1] == pytest.approx(boxes[0]["dtheta"][1] / 2 ** (MOST_BOXES - 1))


def test_a_candidate_that_is_no_gait_is_rejected_with_its_reason_and_a_part_that_failed_is_named():
    problem, gait = open_problem("rimless-wheel-slip"), named("rimless-wheel-slip")
    wrong = {**gait.to_record(), "start": "test"}
    wrong["steps"] = [{"phases": [{"mode": "stick", "duration": gait.period}], "impact": "stick"}]
    faster = {**wrong["state"], "dtheta": 1.01 * wrong["state"]["dtheta"]}
    twice = [wrong, {**wrong, "start": "another", "state": faster}]
    gaits = gaits_of(problem, [{"method": "simulation", "starts": 2, "candidates": twice}])
    assert len(gaits) == 0
    (rejected,) = gaits.searched["rejected"]
    assert "needs friction 0.9141" in rejected["reason"]
    assert rejected["starts"] == ["test", "another"]
    candidate = {**gait.to_record(), "steps": [gait.to_record()], "start": "test"}
    parts = [{"method": "simulation", "starts": 1, "candidates": [candidate]}, FailedJob(reason="it took 3 workers")]
    assert len(gaits_of(problem, parts)) == 1
    other = gaits_of(problem.replace({"gait.impact": "slip_forward"}), parts)  # which excludes this impact
    assert (len(other), other.searched["failed"]) == (0, ["it took 3 workers"])


def test_start_states_lie_within_the_box_that_is_given_whose_coordinates_must_be_there():
    problem = open_problem("compass-passive-a")
    box = start_box(problem, problem_dynamics(problem), {"dtheta1": (0.1, 0.2)})
    index = problem.walker.section_names(slipping=True).index("dtheta1")
    assert (box.lower[index], box.upper[index]) == (0.1, 0.2)
    with pytest.raises(UnknownNameError, match=r"within phi.*use theta1"):
        find(problem, within={"phi": (0, 1)})
    crawler = load_problem("crawler")
    dynamics, span = problem_dynamics(crawler), (0.4, 0.41)
    states = around_guess(crawler, dynamics, 5, np.random.default_rng(0), exact=False, within={"gap": span})
    heights = np.array([np.asarray(dynamics.system.contact_points(state, dynamics.p)[0]).ravel() for state in states])
    assert heights == pytest.approx(0, abs=1e-9)
    gaps = states[:, dynamics.system.state_names.index("gap")]
    assert ((span[0] <= gaps) & (gaps <= span[1])).all()
    with pytest.raises(UnknownNameError, match=r"within height: not a coordinate just after an impact; use gap"):
        find(crawler, within={"height": (0, 1)}, progress=False)


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


@pytest.fixture(scope="module")
def gait():
    return named("rimless-wheel-stick").verified(verification("rimless-wheel-stick").to_record())


def part(candidates, method="simulation"):
    return {"method": method, "starts": len(candidates), "candidates": candidates}


def test_a_gait_walked_several_times_is_the_candidate_of_one_step_that_closes_the_problem_with_its_motion(gait):
    once = cycle_record(gait.system, gait.steps, "a")
    assert cycle_record(gait.system, gait.steps * 3, "a") == once
    assert len(once["steps"]) == 1
    problem = gait.problem.with_gait(once)
    assert problem.cycle == gait.problem.cycle
    assert problem.guess.durations == pytest.approx([duration for _, duration in gait.phases])


def test_starts_that_lead_to_a_known_gait_are_counted_with_it(gait):
    candidates = [cycle_record(gait.system, gait.steps, name) for name in "ab"]
    open_problem = gait.problem.replace({"gait.phases": "auto"})
    gaits = gaits_of(open_problem, [part(candidates)], known=[gait])
    assert gaits.starts == (("a", "b"),)
    assert gaits.searched["starts"] == {"simulation": 2}


def test_a_gait_that_the_simulator_refutes_is_rejected_with_the_claims_that_do_not_hold_and_their_outcomes(gait):
    changes = {
        "period": {"figure": 2e-7, "passed": False, "outcome": "fails"},
        "multipliers": {"figure": None, "passed": False, "outcome": "not_examined", "note": "the wheel falls"},
        "perturbation": {"figure": None, "passed": False, "outcome": "no_linear_range", "note": "too bent"},
    }
    claims = [claim | changes.get(claim["name"], {}) for claim in gait.verification["claims"]]
    refuted = gait.verified({**gait.verification, "passed": False, "claims": claims})
    open_problem = gait.problem.replace({"gait.phases": "auto"})
    gaits = gaits_of(open_problem, [part([cycle_record(gait.system, gait.steps, "a")])], known=[refuted])
    assert not gaits
    (rejected,) = gaits.searched["rejected"]
    assert rejected["reason"].startswith("the simulator does not confirm it: period: fails (2e-07, limit 1e-09)")
    assert "; multipliers: not examined, the wheel falls" in rejected["reason"]
    assert rejected["reason"].endswith("; perturbation: no linear range, too bent")
    console = Console(file=StringIO(), width=1000)
    print_gaits(console, gaits.to_record())
    assert rejected["reason"] in console.file.getvalue()
