"""Families whose switches meet and leave breakpoints of the control, where the torques jump."""

import json
from functools import cache

import jumping
import numpy as np
import pytest
from jumping import AT_ALL, AT_ONCE, SLIPPING, problem, staircase
from pydantic import TypeAdapter

from gaitopt import verify
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.monitors import monitor_values
from gaitopt.branches.request import Request
from gaitopt.errors import StorageError
from gaitopt.gait.branch import BranchPoint, SpecialPoint, branch_table, collected
from gaitopt.gait.records import CheckedPoint
from gaitopt.gait.trace import MonitorKey
from gaitopt.model.cycle import BREAKPOINT
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.simulation.simulator import Simulator
from gaitopt.solver.solve import solve_gait
from gaitopt.store.branch import resumable, stored_continuations
from gaitopt.store.gaits import branch_point, special_point
from gaitopt.verification.verify import confirm


class Polygon(jumping.Staircase):
    """Torques of the ankle that are linear between the levels at the breakpoints, where they have kinks."""

    type = "polygon_of_the_ankle"

    def torques(self, now):
        return {"ankle": now.r[0] + now.r[1] * now.t}

    def data(self, segment):
        times, levels = (0.0, *self.times, 9.0), (self.levels[0], *self.levels, self.levels[-1])
        slope = (levels[segment + 1] - levels[segment]) / (times[segment + 1] - times[segment])
        return np.array([levels[segment] - slope * times[segment], slope])


def family(gait, to, largest_length=0.1):
    """The records of a family in friction in long steps, every point confirmed by the simulator."""
    request = Request(parameter="friction", to=(to,), verify_every=1, largest_length=largest_length)
    return list(follow_family(gait, request))


@cache
def short():
    """A family that leaves its breakpoint."""
    return tuple(family(jumping.gait(0.1665, *SLIPPING), 0.169))


def specials(records):
    return [record for record in records if isinstance(record, SpecialPoint)]


def points(records):
    return [record for record in records if isinstance(record, BranchPoint)]


def sequences(special):
    return str(special.before), str(special.after)


STICK, LATER, AT = (
    "stick; stick",
    "stick, slip_backward, stick; stick",
    "stick (until breakpoint), slip_backward, stick; stick",
)


def test_a_switch_that_meets_a_breakpoint_is_a_special_point_in_both_directions():
    down = family(jumping.gait(0.2, "stick"), 0.164)
    up = family(points(down)[-1].gait, 0.19)
    first, second, end = specials(down)
    assert (first.type, second.type, end.type) == ("mode_change", "mode_change", "end")
    assert end.reason == "reached friction = 0.164"
    assert [sequences(first), sequences(second)] == [(STICK, LATER), (LATER, AT)]
    assert [sequences(special) for special in specials(up)[:2]] == [(AT, LATER), (LATER, STICK)]
    for special, value in ((first, AT_ALL), (second, AT_ONCE), *zip(specials(up)[:2], (AT_ONCE, AT_ALL), strict=True)):
        assert special.status == "converged"
        assert special.value == pytest.approx(value, abs=2e-9)
    assert all(point.gait.verification["passed"] for point in points([*down, *up]))
    assert all((point.gait.timed == (0,)) == (point.value < AT_ONCE) for point in points([*down, *up]))
    there, back = second.gait, specials(up)[0].gait
    np.testing.assert_allclose(there.state, back.state, atol=1e-9)


@cache
def kinked():
    """The compass whose ankle torque has a kink at 0.597 s."""
    return HybridSystem(CompassBiped, Polygon(times=(0.55, 0.597, 0.6, 0.66), levels=(-1.0, 11.0, 12.0, -1.0)))


def onsets(records):
    """When the foot of each gait begins to slip backward."""
    slips = [point.gait.phases for point in points(records) if len(point.gait.phases) == 4]
    return [phases[0][1] + phases[1][1] for phases in slips]


@pytest.mark.parametrize(
    ("start", "to", "changes"),
    [
        (problem(0.17248, "slip_forward", "stick", "slip_backward", "stick"), 0.1724, 0),
        pytest.param(problem(0.185, "stick"), 0.168, 2, marks=pytest.mark.slow),
    ],
)
def test_a_switch_passes_a_kink_of_the_torques_without_a_special_point(start, to, changes):
    """Away from the breakpoint the torques of its two sides differ, as they do at a jump."""
    down = family(solve_gait(start, kinked()), to)
    assert [special.type for special in specials(down)] == ["mode_change"] * changes + ["end"]
    assert specials(down)[-1].reason == f"reached friction = {to}"
    assert onsets(down)[-1] < 0.597 < onsets(down)[0]
    assert all(point.gait.verification["passed"] for point in points(down))


def test_the_simulator_slips_at_the_breakpoint_on_one_side_of_the_special_point_alone():
    """An independent check of its place."""
    for friction, at_once in ((AT_ONCE - 1e-7, True), (AT_ONCE + 1e-7, False)):
        gait = solve_gait(problem(friction, *SLIPPING), jumping.pushed())
        assert confirm(gait).passed
        _, end = Simulator(gait.dynamics).run(gait.state).steps[0].phases[0]
        assert (end == jumping.PUSH[0]) == at_once
        assert end == pytest.approx(jumping.PUSH[0], abs=1e-6)


@pytest.mark.slow
def test_a_foot_that_would_slip_before_the_jump_leaves_the_breakpoint_earlier():
    """Two pushes one after the other: with less friction the first one is enough."""
    system = staircase((0.58, 0.6, 0.62), -1.8, 12.6, 13.2, -1.8)
    start = solve_gait(problem(0.3, "stick", theta1=-0.13, dtheta1=0.64, dtheta2=-0.42), system)
    down = family(start, 0.153)
    up = family(points(down)[-1].gait, 0.3)
    *changes, _ = specials(down)
    *again, end = specials(up)
    expected = [(STICK, LATER), (LATER, AT), (AT, LATER)]
    assert [sequences(special) for special in changes] == expected
    assert [sequences(special) for special in again] == [pair[::-1] for pair in expected[::-1]]
    assert [special.value for special in changes] == pytest.approx([each.value for each in again[::-1]], abs=1e-9)
    assert [special.type for special in (*again, end)] == ["mode_change"] * 3 + ["end"]
    assert {special.status for special in specials([*down, *up])} == {"converged"}


@pytest.mark.slow
def test_a_slip_that_a_jump_starts_may_begin_with_no_duration_at_all():
    """During a push backward at 0.4 s the ratio of the forces falls, so that the foot slips at once or never."""
    system = staircase((0.4, 0.42), 0, -20, 0)
    start = solve_gait(problem(0.2, "stick"), system)
    down = family(start, 0.165)
    up = family(points(down)[-1].gait, 0.2)
    assert sequences(specials(down)[0]) == ("stick; stick", "stick (until breakpoint), slip_forward, stick; stick")
    assert sequences(specials(up)[0]) == sequences(specials(down)[0])[::-1]
    assert specials(up)[0].value == pytest.approx(specials(down)[0].value, abs=1e-10)
    assert verify(points(down)[-1].gait).passed


def test_monitors_tell_how_far_a_switch_is_from_the_breakpoint():
    """The torque does not jump at the second of three breakpoints."""
    jumps_later = solve_gait(problem(0.176, *SLIPPING), staircase((0.6, 0.61, 0.62), -1, 12, 12, -1))
    for gait in (jumping.gait(0.169, *SLIPPING), jumps_later):
        distance, later = min(abs(gait.phases[0][1] - b) for b in jumping.PUSH), monitor_values(gait)
        assert later[MonitorKey(BREAKPOINT, 0)].value == pytest.approx(distance / gait.period)
        assert MonitorKey("onset", 1) not in later
    at = monitor_values(jumping.gait(0.1665, *SLIPPING))
    assert MonitorKey(BREAKPOINT, 0) not in at
    assert at[MonitorKey("onset", 1)].value > 0
    assert at[MonitorKey("cone_backward", 0)].value > 0.1


def test_records_tell_which_phases_end_at_a_breakpoint_and_are_read_back():
    gait, records = jumping.gait(0.1665, *SLIPPING), short()
    first, change = records[0], specials(records)[0]
    record = json.loads(json.dumps(first.to_record()))
    assert [phase.get("until") for phase in record["phases"]] == [BREAKPOINT, None, None]
    TypeAdapter(CheckedPoint).validate_python(record)
    read = branch_point(gait, "friction", record)
    assert read.gait.timed == (0,)
    assert read.gait.arcs[0].end == jumping.PUSH[0]
    np.testing.assert_allclose(read.gait.arcs[-1].states[-1], first.gait.arcs[-1].states[-1], atol=1e-9)
    special = json.loads(json.dumps(change.to_record()))
    assert special["from"]["phases"][0] == {"mode": "stick", "until": BREAKPOINT}
    assert special["to"]["phases"] == list(SLIPPING)
    assert special_point(gait, "friction", special).before == gait.cycle
    assert len(branch_table([record, special])[1]) == 2
    branch = collected("friction", records)
    assert len(branch.special("mode_change")) == 1
    assert np.isfinite(branch.column("period")).all()
    record["phases"][0]["until"] = "touchdown"
    with pytest.raises(ValueError, match="breakpoint"):
        TypeAdapter(CheckedPoint).validate_python(record)


@pytest.mark.slow
def test_an_interrupted_family_goes_on_with_its_timed_phases():
    gait, request = jumping.gait(0.1655, *SLIPPING), Request(parameter="friction", to=(0.1675,), verify_every=0)
    whole = [record.to_record() for record in follow_family(gait, request)]
    assert len(whole) > 8
    done = json.loads(json.dumps(whole[:5]))
    stored = stored_continuations(gait, "friction", resumable(done, request.exhausted))
    rest = [record.to_record() for record in follow_family(gait, request, done=stored)]
    assert [record["value"] for record in rest] == [record["value"] for record in whole[5:]]
    done[-1]["phases"][0].pop("until")  # as if the switch were at the edge of the cone
    with pytest.raises(StorageError, match="not a gait with these phases"):
        stored_continuations(gait, "friction", resumable(done, request.exhausted))


def test_a_phase_that_a_breakpoint_cuts_into_short_arcs_is_a_short_phase(monkeypatch):
    """Just below the friction at which it slips at all, the foot slips shortly before and after the end of the push."""
    gait = jumping.gait(AT_ALL - 1e-4, *SLIPPING)
    parts = [
        arc.duration / gait.period for arc, phase in zip(gait.arcs, gait.steps[0].arc_phases, strict=True) if phase
    ]
    longest, whole = max(parts[:2]), sum(parts[:2])
    assert longest < whole
    monkeypatch.setattr("gaitopt.branches.monitors.SHORT_ARC", (longest + whole) / 2)
    assert [key.kind for key in monitor_values(gait) if key.phase == 1] == ["duration"]
