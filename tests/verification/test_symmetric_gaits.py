"""Symmetric walkers: slips of several contacts end, or begin, at exactly one instant, and rounding parts them."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from contact_problems import SLED, Sled, settled
from named import named, solved
from orbit_files import changed, differing, written

import gaitopt as go
from gaitopt import Gait, Mode, Problem, Status
from gaitopt.model.buffered import buffered
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.problem.statement import problem_data
from gaitopt.systems import problem_dynamics

ALTERNATING = "{type: alternating, cycle: 2, first: {pull: 4.5, push: -4.5}, second: {pull: -4.5, push: 4.5}}"
PHASES = """
  section: clock
  phases:
    - {rear: slip_forward, middle: slip_backward, front: slip_forward}
    - {rear: stick, middle: slip_backward, front: stick}
    - {rear: stick, middle: stick, front: stick}
    - {rear: slip_backward, middle: slip_forward, front: slip_backward}
    - {rear: stick, middle: slip_forward, front: stick}
    - {rear: stick, middle: stick, front: stick}
  guess:
    state: {ahead: 0.22, behind: 0.78}
    durations: [0.3, 0.18, 0.52, 0.3, 0.18, 0.52]
"""


def problem_of(masses: tuple[float, float, float]) -> Problem:
    """A sled of three masses, pulled and pushed alike in both halves of the cycle, with its phases in the file."""
    text, _, _ = (SLED % (*masses, 20, ALTERNATING)).partition("  section: clock")
    return go.parse_problem(text + PHASES, walkers=[Sled])


def test_contacts_that_stop_at_one_instant_are_stated_in_a_file_solved_and_verified() -> None:
    gait = solved(problem_of((1.0, 1.0, 1.0)))
    durations = np.array([duration for _, duration in gait.phases])
    assert durations[:3] == pytest.approx(durations[3:], abs=1e-12)
    for arc in gait.steps[0].arcs:  # the outer masses mirror each other
        velocities = dict(zip(arc.mode.contacts, arc.mode.directions.values(), strict=True))
        assert velocities["rear"] == velocities["front"]
    check = go.verify(gait)
    assert check.passed, [claim.summary for claim in check.claims if not claim.passed]
    assert check.figure("perturbation") < 1e-6  # walks that are not symmetric, in which one stops before the other
    unequal = go.solve(problem_of((1.0, 1.0, 1.00001)))
    assert unequal.status is Status.INFEASIBLE
    assert "where rear comes to rest, front has the velocity -8.9" in unequal.message
    assert "state the phase in between" in unequal.message


def test_the_orbit_file_of_contacts_that_stop_at_one_instant_is_recomputed() -> None:
    data = written(go.solve(problem_of((1.0, 1.0, 1.0)), progress=False))
    assert differing(data) == []
    for arc in data["evaluation"]["arcs"]:
        if arc["reset"] == "slips end together":  # the second slip then goes on, of which nothing tells
            arc["reset"] = None
    assert differing(data) == ["multipliers"]


class SplitCrawler(Crawler):
    """A crawler whose rear touches the ground with two contacts at one point."""

    model = "split_crawler"
    contacts = ("rear", "twin", "front")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> go.Mechanism:
        stated = super().mechanism(q, p)
        rear, front = stated.contacts.values()
        return replace(stated, contacts={"rear": rear, "twin": rear, "front": front})


def split() -> Gait:
    """The gait of a crawler whose rear contact is split in two."""
    data = problem_data(go.load_problem("crawler"))
    data["walker"]["model"], data["friction"] = "split_crawler", data["friction"] | {"twin": 0.6}
    data["gait"]["phases"] = [phase | {"twin": phase["rear"]} for phase in data["gait"]["phases"]]
    del data["gait"]["impact"]
    return solved(go.parse_problem(json.dumps(data), walkers=[SplitCrawler]))


def test_an_orbit_file_has_no_value_of_undetermined_forces() -> None:
    data = written(split())
    assert differing(data) == []
    column = data["orbit"]["samples"]["columns"].index("f_n.twin")
    assert {row[column] for row in data["orbit"]["samples"]["rows"]} == {None}
    assert "samples" in differing(changed(data, f"orbit/samples/rows/3/{column}", lambda _: 1.0))


def test_a_contact_that_is_split_in_two_has_the_gait_of_one() -> None:
    gait, whole = split(), named("crawler")
    assert gait.scalar("step_length") == pytest.approx(whole.scalar("step_length"), abs=1e-13)
    assert gait.multipliers == pytest.approx(whole.multipliers, abs=1e-10)
    assert go.verify(gait).passed


def test_two_slips_that_end_together_may_be_put_in_either_order() -> None:
    """The state just after both is one function of that before, and its derivative that of the two events in turn."""
    dynamics = problem_dynamics(problem_of((1.0, 1.3, 0.7)))
    system, p, r = dynamics.system, dynamics.p, dynamics.system.data(0)
    both, rear, front, after = (
        Mode.of_contacts({"rear": first, "middle": "slip_backward", "front": last})
        for first in ("slip_forward", "stick")
        for last in ("slip_forward", "stick")
    )
    rear, front = front, rear
    z = np.array([0.5, 0.5, 0, 0, 0, 0, 0.2, 0.2, 0, 0, 0, -0.2])  # rear and front at rest, the middle slips

    def event(mode: Mode, then: Mode, contact: str) -> np.ndarray:
        row = system.transitions.margin_names(mode).index(f"slip_velocity.{contact}")
        flow, gradients, rates = (value.copy() for value in buffered(system.linearized(mode))(0.3, z, p, r))
        (following,) = buffered(system.flow(then))(0.3, z, p, r)
        return np.eye(z.size) + np.outer(following - flow, gradients.reshape(z.size, -1)[:, row]) / rates[row]

    one = event(rear, after, "front") @ event(both, rear, "rear")
    other = event(front, after, "rear") @ event(both, front, "front")
    assert one == pytest.approx(other, abs=1e-12)
    shift = buffered(system.stopped_together_jacobian(both, after))(0.3, z, p, r)[0]
    assert shift.reshape(z.size, -1, order="F") @ event(both, rear, "rear") == pytest.approx(one, abs=1e-12)


@pytest.mark.slow
def test_a_symmetric_sled_goes_on_where_both_halves_of_its_cycle_change_at_once() -> None:
    problem = problem_of((1.0, 1.0, 1.0))
    branch = go.continuation(settled(problem.replace({"friction": 0.4}), 40), "friction", to=0.15)
    assert branch.specials[-1].reason == "reached friction = 0.15"
    for friction in (0.3187, 0.315, 0.15):
        alone = settled(problem.replace({"friction": friction}), 40)
        assert go.verify(alone).passed
        if friction == 0.15:
            last = branch.points[-1].gait
            assert last.cycle == alone.cycle
            assert last.state == pytest.approx(alone.state, abs=1e-9)
