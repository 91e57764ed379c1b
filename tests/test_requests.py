"""Requests: what a verb takes is stated once, checked where it is made, and names stored work as it always has."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import typer

import gaitopt as go
from gaitopt import requests
from gaitopt.branches.request import Request
from gaitopt.cli.main import app
from gaitopt.errors import ArgumentError, UnknownNameError
from gaitopt.requests import Engine, Method, entries
from gaitopt.runs.attractors import AttractorsPlan
from gaitopt.runs.basin import BasinPlan
from gaitopt.runs.branch import BranchPlan
from gaitopt.runs.grid import Grid, axis_of
from gaitopt.runs.jobs import problem_job
from gaitopt.runs.multistart import StartsPlan
from gaitopt.runs.sweep import SweepPlan
from gaitopt.search.find import SearchPlan, with_open_modes

VERBS = {
    "solve": (requests.SolveRequest, "solve"),
    "multistart": (requests.StartsRequest, "solve"),
    "simulate": (requests.SimulateRequest, "simulate"),
    "verify": (requests.VerifyRequest, "verify"),
    "find": (requests.FindRequest, "find"),
    "explain": (requests.ExplainRequest, "explain"),
    "continuation": (requests.ContinueRequest, "continue"),
    "continuation_records": (requests.ContinueRequest, "continue"),
    "trace": (requests.TraceRequest, "trace"),
    "trace_records": (requests.TraceRequest, "trace"),
    "sweep": (requests.SweepRequest, "sweep"),
    "atlas": (requests.AtlasRequest, "atlas"),
    "attractors": (requests.AttractorsRequest, "attractors"),
    "robustness": (requests.RobustnessRequest, "robustness"),
    "basin": (requests.BasinRequest, "basin"),
    "prove": (requests.ProveRequest, "prove"),
    "replay": (requests.ReplayRequest, "replay"),
    "stabilise": (requests.StabiliseRequest, "stabilise"),
}
"""The request of every function of the library, and the command with its options."""
FOLDER = Path("nowhere")


def stated_requests() -> set[type]:
    """All requests of verbs."""
    return {kind for kind in vars(requests).values() if inspect.isclass(kind) and kind.__name__.endswith("Request")}


@pytest.mark.parametrize("verb", VERBS)
def test_signatures_have_the_defaults_of_the_request_docstrings_its_fields_and_commands_its_options(verb):
    request, command = VERBS[verb]
    commands = {each.name: each.callback for each in app.registered_commands}
    call, options = (inspect.signature(each).parameters for each in (getattr(go, verb), commands[command]))
    parser = typer.main.get_command(app).commands[command]
    helps = " ".join(getattr(option, "help", None) or "" for option in parser.params)
    for name, entry in entries(request).items():
        assert name in call, f"gaitopt.{verb} lacks {name}"
        assert entry.about.help in helps, f"gaitopt {command} does not show {name}"
        stated = re.search(rf"^    .*\b{name}\b.* : ", getattr(go, verb).__doc__, re.M)
        assert verb.endswith("_records") or stated
        if call[name].default is not inspect.Parameter.empty:
            assert (call[name].default or None) == (entry.default or None), f"{verb}({name})"
        if name in options and options[name].default is not inspect.Parameter.empty:
            assert (options[name].default or None) == (entry.default or None), f"gaitopt {command}: {name}"


def test_every_request_belongs_to_a_verb():
    used = {request for request, _ in VERBS.values()}
    assert stated_requests() == used | {
        requests.FloorRequest,
        requests.UntilRequest,
        requests.WorkersRequest,
        requests.Request,
        requests.SearchRequest,
    }


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: requests.FindRequest(starts=0), "starts is 0, but must be a whole number, from 1 to 1,000,000"),
        (lambda: requests.FindRequest(starts=2.5), "starts is 2.5, but must be a whole number, from 1 to 1,000,000"),
        (lambda: requests.FindRequest(starts="9"), "starts is '9', but must be a whole number, from 1 to 1,000,000"),
        (lambda: requests.FindRequest(seed=True), "seed is True, but must be a whole number, at least 0"),
        (lambda: requests.SweepRequest(warm=1), "warm is 1, but must be True or False"),
        (lambda: requests.StartsRequest(spread=np.nan), "spread is nan, but must be a finite number, from 0.0 to 0.99"),
        (lambda: requests.ReplayRequest(time_steps=(1e-3, 0.0)), "must be a finite number, from 1e-06 to 0.1 s"),
        (lambda: requests.ReplayRequest(time_steps=()), "time_steps is empty"),
        (
            lambda: requests.ContinueRequest(parameter="friction", to=(np.inf,)),
            "to is inf, but must be a finite number",
        ),
        (lambda: go.solve("compass-passive-a", intervals=1), "intervals is 1, but must be a whole number, from 2 to"),
        (lambda: go.solve("compass-pd-designed", newton_steps=20), "newton_steps limits the search from a guessed"),
        (
            lambda: requests.VerifyRequest(tolerance=1.0),
            "tolerance is 1.0, but must be a finite number, from 1e-13 to 0.0001",
        ),
        (
            lambda: requests.SimulateRequest(longest_step=0),
            "longest_step is 0, but must be a finite number, from 1e-06 to",
        ),
        (lambda: requests.WorkersRequest(workers=0), "workers is 0, but must be a whole number, from 1 to 1,024"),
        (lambda: go.find("rimless-wheel-slip", starts=0), "starts is 0"),
        (lambda: go.find("rimless-wheel-slip", workers=0), "workers is 0"),
        (lambda: go.multistart("rimless-wheel-slip", 2, spread=3.0), "spread is 3.0"),
        (lambda: go.basin("compass-passive-a", {"theta1": (-0.2, -0.1, 3)}, steps=0), "steps is 0"),
    ],
)
def test_a_wrong_value_is_named_with_what_it_must_be(make, words):
    with pytest.raises(ArgumentError) as caught:
        make()
    assert words in str(caught.value)


def test_a_word_that_is_no_choice_is_answered_with_the_choices():
    with pytest.raises(UnknownNameError, match="no engine is called 'euler'; use auto, scipy, heyoka"):
        requests.BasinRequest(engine="euler")


def test_numbers_of_numpy_and_words_become_plain_values():
    request = requests.AttractorsRequest(starts=np.int64(3), engine="scipy")
    assert (type(request.starts), request.engine) == (int, Engine.SCIPY)
    assert requests.ContinueRequest(parameter="friction", to=(1,)).to == (1.0,)


def test_limits_that_are_not_the_defaults_act_and_are_recorded():
    gait = go.solve("compass-passive-a", intervals=30, newton_steps=20)
    assert {name: gait.solver.get(name) for name in ("intervals", "newton_steps", "ipopt_iterations")} == {
        "intervals": 30, "newton_steps": 20, "ipopt_iterations": None
    }  # fmt: skip
    usual = go.solve("compass-passive-a")
    assert {*usual.solver} == {"method", "iterations", "seconds"}
    assert gait.state == pytest.approx(usual.state, abs=1e-12)
    few = go.solve("compass-passive-a", method="newton", newton_steps=1)
    assert (few.status, few.solver["iterations"]) == (go.Status.NOT_CONVERGED, 1)
    strict = go.verify(usual, tolerance=1e-13)
    assert {claim.name: claim.tolerance for claim in strict.claims}["period"] == pytest.approx(1e-13)
    assert go.verify(usual).passed
    assert not strict.passed  # two methods do not agree to the last digit
    walk = go.simulate("compass-passive-a", longest_step=0.3)
    assert "no touchdown within 0.3 s" in walk.trajectory.message
    assert walk.to_record()["longest_step"] == 0.3


def test_only_what_differs_from_the_defaults_identifies_a_request():
    assert requests.FindRequest().identity == []
    assert requests.FindRequest(starts=5, method="newton").identity == [["starts", 5], "newton"]
    assert requests.SweepRequest().identity == [False]
    assert requests.ContinueRequest(parameter="friction", to=(1.0,), max_points=3).identity == [
        ["parameter", "friction"],
        ["to", (1.0,)],
    ]


@pytest.mark.parametrize(
    ("how", "part", "key"),
    [
        ({}, "sweep-d6bb2e69", "00edd125b602"),
        ({"warm": True}, "sweep-e7a666c6", "68ace5c8f2d8"),
        ({"from_guess": True}, "sweep-13221330", "12c7aa8e4ee6"),
        ({"method": Method.IPOPT}, "sweep-ffa7ecaf", "31f2c8ec096d"),
        ({"warm": True, "from_guess": True, "method": Method.NEWTON}, "sweep-0facec04", "d5d7e8adfa41"),
    ],
)
def test_stored_sweeps_keep_their_names(how, part, key):
    """The names are those that version 0.2 gave."""
    grid = Grid((axis_of("friction", 0.1, 0.3, 3),))
    plan = SweepPlan(problem=go.load_problem("rimless-wheel-slip"), grid=grid, folder=FOLDER, **how)
    assert (plan.run.subfolder, plan.jobs[1].key[:12]) == (part, key)


def test_stored_attractors_keep_their_names():
    def plan(**how):
        axis = axis_of("walker.slope", "1 deg", "2 deg", 3)
        problem = go.load_problem("compass-passive-a")
        return AttractorsPlan(problem=problem, axis=axis, folder=FOLDER, engine="scipy", **how)

    assert (plan().run.subfolder, plan().jobs[1].key[:12]) == ("attractors-039ebd4b", "b963b63615e4")
    assert plan(starts=3, transient=20, keep=8, seed=5).run.subfolder != "attractors-039ebd4b"


def test_stored_basins_searches_and_starts_keep_their_names():
    problem = go.load_problem("compass-passive-a")
    grid = Grid((axis_of("theta1", "-12 deg", "-6 deg", 5),))
    plan = BasinPlan.around(problem, grid, requests.BasinRequest(engine=Engine.SCIPY), FOLDER)
    assert plan.run.subfolder == "basin-8d87ccfb"
    unknown = with_open_modes(problem)
    for how, simulation, families in (
        ({}, "23e27139afef", "1592f0e64dbb"),
        ({"seed": 3, "starts": 5}, "0dc8357fd360", "74bb441eaada"),
        ({"within": {"dtheta1": (0.0, 1.0)}}, "901a6e0a367c", "9e384b5ed143"),
        ({"method": Method.IPOPT}, "23e27139afef", "378aa2fd3951"),
    ):
        search = SearchPlan(problem=unknown, **how)
        assert search.job(unknown, "simulation", 0).key.startswith(simulation)
        assert search.job(problem, "families", 1, "friction").key.startswith(families)
    starts = StartsPlan(problem=problem, starts=3, seed=1, spread=0.2, folder=FOLDER)
    assert [problem_job(start).key[:12] for start in starts.sampled()] == [
        "68abd7defd4b", "83e165b1049f", "4a93e7ae00d7",
    ]  # fmt: skip


def test_the_first_line_of_a_branch_has_the_keys_that_it_has_had():
    request = Request(parameter="friction", to=(0.2, 0.4), lower=0.1, follow={"doublings": 1, "branch_points": 0})
    plan = BranchPlan(problem=go.load_problem("rimless-wheel-slip"), request=request, start_type="branch_point")
    assert plan.head == {
        "record": "continuation", "parameter": "friction", "to": [0.2, 0.4], "lower": 0.1, "upper": None,
        "max_points": 2000, "max_seconds": None, "verify_every": 10, "doublings": 1, "start": "branch_point",
    }  # fmt: skip
