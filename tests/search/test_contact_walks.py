"""Searches for gaits of walkers with several contacts, whose modes are open."""

import json

import pytest
from contact_problems import contact_gait, contact_problem

import gaitopt as go
from gaitopt.problem.statement import problem_data
from gaitopt.search.find import SearchPlan, search
from gaitopt.search.solve import solve
from gaitopt.verification.verify import verify
from gaitopt.workers.jobs import ResumableJobs, Workers

RUN = {
    "walker.stiffness": 20000, "walker.attack": "68deg", "walker.energy": 1730, "gait.guess.state.dy": -0.7,
    "gait.phases": "auto",
}  # fmt: skip


def searched(problem, **plan):
    return search(SearchPlan(problem=problem, **plan), ResumableJobs(workers=Workers(count=1)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_springy_legs_walk_in_two_gaits_of_one_mode_sequence(seed: int) -> None:
    """Geyer, Seyfarth and Blickhan (2006): one of them is stable."""
    found = searched(contact_problem("slip-walk").replace({"gait.phases": "auto"}), seed=seed)
    assert len(found) == 2
    for gait, name in zip(found, ("slip-walk-stable", "slip-walk"), strict=True):
        assert gait.cycle == contact_gait(name).cycle
        assert gait.multipliers == pytest.approx(contact_gait(name).multipliers, abs=1e-8)


def test_the_legs_that_walk_also_run_in_two_gaits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spring-mass running: a short flight is stable, a long one unstable. Blickhan (1989), Geyer (2006)."""
    monkeypatch.setattr("gaitopt.search.candidates.MAX_POINTS", 4)  # walks find both
    problem = contact_problem("slip-walk").replace(RUN)
    short, long = searched(problem, starts=250)
    both_land = {"gait.impact": {"front": "stick", "back": "stick"}}  # but one leg lands
    assert not searched(problem.replace(both_land), starts=250)
    assert short.spectral_radius < 1 < long.spectral_radius
    assert short.period < long.period
    for gait in (short, long):
        assert [mode.brief for mode in gait.cycle.phases] == ["front stick", "flight"]
        assert verify(gait).passed


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heel-toe-slip", "crawler"])
def test_walks_from_around_the_guess_find_its_gait(name: str) -> None:
    (found,) = searched(contact_problem(name).replace({"gait.phases": "auto"}), starts=250)
    assert found.cycle.untimed == contact_gait(name).cycle.untimed
    assert found.state == pytest.approx(contact_gait(name).state, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heel-toe", "crawler", "inchworm"])
def test_gaits_are_found_without_a_guess(name: str) -> None:
    """Walks start in random postures, with the lowest contact at rest on the ground."""
    data = problem_data(contact_problem(name))
    section = {"section": data["gait"]["section"]} if "section" in data["gait"] else {}
    found = searched(go.parse_problem(json.dumps(data | {"gait": {"phases": "auto", **section}})), starts=1)
    assert contact_gait(name).period in [pytest.approx(each.period, rel=1e-9) for each in found]


@pytest.mark.slow
def test_explain_names_the_contact_that_needs_more_friction_and_where_it_has_enough() -> None:
    why = go.explain(contact_problem("heel-toe").replace({"friction": 0.27}), starts=250, progress=False)
    assert not why.exists
    cause = why.causes[0].to_record()
    assert (cause["what"], cause["phase"]) == ("friction", 1)
    assert cause["needed"] == pytest.approx(0.27483760771, abs=1e-10)
    assert "heel needs friction" in cause["words"]
    assert [mode.brief for mode in why.instead[0].cycle.phases] == ["heel slip_forward", "heel stick", "toe stick"]
    (friction,) = [nearest for nearest in why.nearest if nearest.parameter == "friction"]
    assert friction.value == pytest.approx(0.27483760771, abs=1e-9)


@pytest.mark.parametrize(
    ("changed", "period", "radius"),
    [({"walker.toe": 0.1}, 0.801939, 1.99354), ({"walker.toe": 0.2, "walker.heel": 0.06}, 0.900628, 2.07138)],
)
def test_a_gait_follows_the_contacts_of_its_walker_when_they_move(changed, period: float, radius: float) -> None:
    """The posture of the guess follows from its section and the places of heel and toe: it is no change of its own."""
    problem = contact_problem("heel-toe").replace(changed)
    gait = solve(problem)
    assert "followed from the gait of the problem's file" in gait.message
    assert gait.period == pytest.approx(period, abs=1e-6)
    assert gait.spectral_radius == pytest.approx(radius, abs=1e-5)
    assert verify(gait).passed
    assert go.explain(problem, progress=False).exists
    moved = problem.replace({"gait.guess.state.dtheta1": 1.2})
    assert moved.followed_from is None
