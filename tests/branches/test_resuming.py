"""A walk taken up again is the same walk: killed after any line, it writes the same records as without the kill."""

import copy
import json
from dataclasses import replace
from functools import cache
from itertools import islice
from math import radians

import pytest
from named import named, steep

from gaitopt.branches import continuation as continuer
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.errors import StorageError
from gaitopt.store.branch import resumable, stored_continuations
from gaitopt.verification.verify import Outcome, confirm

SLOPE = "walker.slope"


# Changes of modes in both directions, two targets, a doubled family, both halves of a crossing curve, and switches of
# the control that pass a touchdown or a breakpoint.
BRANCHES = {
    "slip": (lambda: named("compass-torque-slip"), Request(parameter="friction", to=(0.2,))),
    "stick": (lambda: named("compass-torque-stick"), Request(parameter="friction", to=(0.1,))),
    "wheel": (lambda: named("rimless-wheel-stick"), Request(parameter="friction", to=(0.8, 1.1))),
    "doubled": (
        lambda: steep("compass-passive-stick"),
        Request(parameter=SLOPE, to=(radians(5.5),), max_points=6, verify_every=2, follow={"doublings": 1}),
    ),
    "pd": (lambda: named("compass-pd-impact-slip"), Request(parameter="friction", to=(0.1, 0.3), max_points=12)),
}


def walked(name, done=(), **changes):
    """The records of a branch that are not ``done``, one by one, as they are on a disk."""
    start, request = BRANCHES[name]
    request = replace(request, **changes)
    stored = stored_continuations(request.first_gait(start()), request.parameter, done)
    for record in follow_family(start(), request, done=stored):
        yield json.loads(json.dumps(record.to_record()))


@cache
def whole(name):
    return list(walked(name))


def check_cut(name, lines, following=None):
    """What comes after a kill, up to ``following`` records of it, is what came without."""
    kept = resumable(whole(name)[:lines], BRANCHES[name][1].exhausted)
    assert kept == whole(name)[: len(kept)]
    again = list(islice(walked(name, kept), following))
    assert again == whole(name)[len(kept) :][:following]


@pytest.mark.parametrize("lines", [1, 8, 9, 50])
def test_a_branch_killed_next_to_a_change_of_modes_goes_on_as_without_the_kill(lines):
    kinds = [record.get("type") for record in whole("slip")]
    assert kinds.index("mode_change") == 7  # 8 and 9 lines: before and after the first gait of the next sequence
    check_cut("slip", lines, following=12)


@pytest.mark.slow
@pytest.mark.parametrize("name", BRANCHES)
def test_a_branch_killed_after_any_line_goes_on_as_without_the_kill(name):
    assert len(whole(name)) > 12
    for lines in range(1, len(whole(name)) + 1):
        check_cut(name, lines)


@pytest.mark.slow
def test_a_branch_goes_on_where_more_points_are_allowed_and_is_the_same():
    first = list(walked("wheel", max_points=5))
    ends = [record for record in first if record.get("type") == "end"]
    assert [(end["open"], end["reason"]) for end in ends] == [(True, "paused at the limit of 5 points")] * 2
    request = BRANCHES["wheel"][1]
    assert resumable(first, replace(request, max_points=5).exhausted) == first
    kept = resumable(first, request.exhausted)
    assert kept == [record for record in first if record["record"] == "point"]
    assert len(kept) == 10
    joined = [*kept, *walked("wheel", kept)]
    one, other = ([r for r in records if r["record"] == "point"] for records in (joined, whole("wheel")))
    assert sorted(r["value"] for r in one) == sorted(r["value"] for r in other)
    ends = [record for record in joined if record.get("type") == "end"]
    assert [(end["value"], end.get("bound"), end.get("open")) for end in ends] == [(0.8, True, None), (1.1, True, None)]
    assert resumable(joined, request.exhausted) == joined


def test_a_branch_that_was_out_of_time_goes_on_and_is_the_same():
    """It goes on where a slip has just appeared: with a duration near zero a small residual is a large error of it."""
    request = BRANCHES["stick"][1]
    first = list(walked("stick", max_seconds=0.0))
    assert [record["record"] for record in first] == ["point", "special"]
    assert first[-1]["open"]
    assert "limit of 0 s" in first[-1]["reason"]
    kept = resumable(first, request.exhausted)
    assert [*kept, *islice(walked("stick", kept), 5)] == whole("stick")[:6]
    specials = [record for record in whole("stick") if record["record"] == "special"]
    assert [special["type"] for special in specials] == ["mode_change", "mode_change", "neimark_sacker", "end"]
    assert specials[-1]["bound"]


@pytest.mark.slow
def test_every_point_is_as_precise_as_its_confirmation_demands():
    request = replace(BRANCHES["stick"][1], to=(0.145,), verify_every=1)
    records = [record.to_record() for record in follow_family(named("compass-torque-stick"), request)]
    points = [record for record in records if record["record"] == "point"]
    assert {len(point["phases"]) for point in points} == {1, 2, 3}
    for point in points:
        times = next(c for c in point["verification"]["claims"] if c["name"] == "switching times")
        assert times["figure"] < 5e-11  # of 1e-9 that are allowed


def test_a_point_that_the_simulator_refutes_is_solved_again_before_the_branch_ends(monkeypatch):
    """The simulator is made to refute every gait on the first mesh, or beyond a friction every gait."""

    def branch(refuted):
        seen = []

        def doubtful(gait):
            check = confirm(gait)
            wrong = refuted(gait)
            seen.append(wrong)
            failed = {"passed": False, "outcome": Outcome.FAILS}
            claims = [replace(c, **failed) if wrong and c.name == "period" else c for c in check.claims]
            return replace(check, claims=tuple(claims))

        monkeypatch.setattr(continuer, "confirm", doubtful)
        start, _ = BRANCHES["wheel"]
        request = Request(parameter="friction", to=(0.97,), verify_every=2)
        return seen, list(follow_family(start(), request))

    first = sum(named("rimless-wheel-stick").shooting.intervals)
    seen, records = branch(lambda gait: sum(gait.shooting.intervals) == first)
    assert seen[:2] == [True, False]
    assert records[0].gait.verification["passed"]
    assert sum(records[0].gait.shooting.intervals) == 2 * first
    assert records[-1].bound
    _, (end,) = branch(lambda gait: True)
    assert (end.type, end.branch, end.gait.verification["passed"]) == ("end", 0, False)
    seen, records = branch(lambda gait: gait.dynamics.parameter("friction") < 0.99)
    assert seen.count(True) == 3  # on its mesh, on a finer one, and from the fixed point of the simulator
    assert records[-1].type == "end"
    assert not records[-1].gait.verification["passed"]


DAMAGES = {
    "a point without its step length": lambda point: point.pop("length"),
    "a length of nothing": lambda point: point.update(length=0.0),
    "a value that is not that of the unknowns": lambda point: point.update(value=0.97),
    "no state": lambda point: point.pop("state"),
    "a walk that is a list": lambda point: point.update(walk=[1]),
    "one unknown less": lambda point: point["walk"]["unknowns"].pop(0),
    "an unknown that is not a number": lambda point: point["walk"]["unknowns"].__setitem__(3, None),
    "another unknown": lambda point: point["walk"]["unknowns"].__setitem__(1, 0.1),
    "a short tangent": lambda point: point["walk"].update(direction=[1.0]),
    "a tangent beyond all floats": lambda point: point["walk"].update(direction=[10**400]),
    "no arcs": lambda point: point["walk"].update(arcs=[]),
    "a phase that is not there": lambda point: point["walk"].update(arcs=[[9, 0, None, None, 14]]),
    "a segment that is not there": lambda point: point["walk"]["arcs"][0].__setitem__(1, 7),
    "too many intervals": lambda point: point["walk"].update(arcs=[[0, 0, None, None, 10**9]]),
    "a short metric": lambda point: point["walk"].update(metric=[1.0]),
    "an origin out of range": lambda point: point["walk"].update(origin=-1e9),
    "more earlier points than are there": lambda point: point["walk"].update(earlier=10**6),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_record_is_refused_by_name_and_not_continued(damage):
    done = copy.deepcopy(whole("wheel")[:4])
    DAMAGES[damage](done[-1])
    with pytest.raises(StorageError, match="branch 0 cannot be resumed from its point 3: "):
        list(islice(walked("wheel", done), 1))
