"""Scans of the return map: what they rule out, no other method finds."""

import numpy as np
import pytest
from named import named
from samples import sampled

import gaitopt as go
from gaitopt import Cycle
from gaitopt.errors import ProblemError
from gaitopt.runs.grid import Axis, Grid
from gaitopt.runs.sweep import SweepPlan
from gaitopt.search.candidates import SearchJob, find_candidates
from gaitopt.search.find import with_open_modes
from gaitopt.search.scan import _may_vanish, _zeros, possible_gaits, scanned
from gaitopt.search.solve import solve
from gaitopt.workers.jobs import Workers


def test_a_defect_may_vanish_next_to_its_zeros_and_folds_and_nowhere_else():
    x = np.linspace(-1, 1, 41)
    for defect in (x - 0.013, (x - 0.013) ** 2, np.where(x < 0.5, x - 0.51, np.nan)):
        assert _may_vanish(defect[:, None]).any()
    for defect in (x + 3, 0.1 + (x - 0.013) ** 2, np.where(x < 0.5, x - 1, np.nan), np.full_like(x, np.nan)):
        assert not _may_vanish(defect[:, None]).any()
    alone = np.where(np.arange(41) == 7, 5.0, np.nan)
    assert _may_vanish(alone[:, None]).any()  # nothing says how it varies


def test_a_plane_defect_vanishes_where_both_of_its_parts_do():
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21), indexing="ij")
    assert _may_vanish(np.stack([x - 0.2, y + 0.3], axis=-1)).any()
    assert not _may_vanish(np.stack([x - 0.2, 3 + y], axis=-1)).any()


def test_zeros_are_those_of_the_interpolation_in_every_simplex():
    x = np.linspace(0, 1, 5)
    (zero,) = _zeros(x[None], (x - 0.3)[:, None])
    assert zero == pytest.approx([0.3])
    axes = np.array([x, 2 * x - 1])
    a, b = np.meshgrid(*axes, indexing="ij")
    linear = np.stack([a + b - 0.4, a - 2 * b + 0.1], axis=-1)
    (zero,) = _zeros(axes, linear)
    assert zero == pytest.approx([0.7 / 3, 0.5 / 3])
    (corner,) = _zeros(axes, np.stack([a - 0.5, b], axis=-1))  # a sample, which is a corner of six triangles
    assert corner == pytest.approx([0.5, 0.0], abs=1e-12)
    assert not [*_zeros(axes, np.where(a[..., None] > 0.3, linear, np.nan))]


SCANNED = (
    "crawler",
    "hopper",
    "rimless-wheel-slip",
    "rimless-wheel-stick",
    "slip-run",
    "slip-walk",
    "slip-walk-stable",
)


def test_every_section_of_one_or_two_coordinates_is_scanned():
    """All others have more coordinates than a grid can cover, or belong to a design."""
    for name in go.problem_names():
        problem = go.load_problem(name)
        assert scanned(problem) == (len(problem.section_names) <= 2 and not problem.is_design) == (name in SCANNED)
    assert scanned(go.load_problem("slip-run").replace({"gait.phases": "auto"}))
    assert not scanned(go.load_problem("crawler").replace({"gait": {"phases": "auto", "section": "clock"}}))


@pytest.mark.parametrize("name", sampled(SCANNED, 3))
def test_the_known_gait_is_among_what_the_scan_finds(name):
    gait = named(name)
    section, (possible, starts) = gait.problem.section, possible_gaits(gait.problem)
    assert possible
    place, unit = gait.state[section.indices], gait.dynamics.state_units[section.indices]
    found = [np.array([start[key] for key in section.names]) for start in starts]
    assert min(np.abs((other - place) / unit).max() for other in found) < 0.02


def test_a_scan_of_open_modes_includes_slipping_impacts_and_cycles_of_two_steps():
    gait = named("rimless-wheel-slip")
    for steps in (1, 2):
        problem = gait.problem.replace({"gait": {"phases": "auto", "steps": steps}})
        possible, starts = possible_gaits(problem)
        assert possible
        rate = gait.to_record()["state"]["dtheta"]
        assert min(abs(start["dtheta"] - rate) + abs(start["dx"]) for start in starts) < 0.1


CHANGES = {
    "crawler": {
        "walker.stiffness": 0.7, "walker.damping": 0.7, "walker.rest": 0.5, "walker.slope": 0.7,
        "walker.front_mass": 0.5, "friction.rear": 0.5, "friction.front": 0.5,
    },
    "slip-run": {"walker.stiffness": 0.4, "walker.attack": 0.15, "walker.energy": 0.15},
}  # fmt: skip
"""Largest change of the logarithm of a parameter."""


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_no_gait_is_ruled_out_at_200_random_parameters(name):
    """Where a scan finds no gait, the walks of ``find`` lead to none with this section either."""
    original, rng, ruled_out = go.load_problem(name), np.random.default_rng(1), 0
    original = original if original.walker.contacts else original.replace({"gait.phases": "auto"})
    for number in range(200):
        changed = {
            key: original.parameters[key] * np.exp(rng.uniform(-most, most)) for key, most in CHANGES[name].items()
        }
        try:
            problem = original.replace(changed).from_guess()
        except ProblemError:  # no state of the section has the coordinates of the guess
            continue
        if possible_gaits(problem)[0]:
            continue
        ruled_out += 1
        job = SearchJob(problem=with_open_modes(problem), method="simulation", number=0, seed=number, within={})
        cycles = [Cycle.from_record(candidate) for candidate in find_candidates(job)["candidates"]]
        section = problem.section
        assert not any(section.holds(cycle.phases[-1], cycle.impact) for cycle in cycles), changed
    assert ruled_out > 0


def runner_sweep(folder, attacks, stiffnesses):
    grid = Grid(
        (
            Axis(key="walker.attack", lower=np.radians(58), upper=np.radians(78), count=attacks),
            Axis(key="walker.stiffness", lower=8, upper=40, count=stiffnesses),
        )
    )
    return SweepPlan(problem=go.load_problem("slip-run"), grid=grid, folder=folder)


@pytest.mark.slow
def test_no_place_is_reported_empty_at_which_solve_finds_a_gait(tmp_path):
    """The gaits of the runner fill a narrow band over its angle of attack and its stiffness."""
    plan = runner_sweep(tmp_path, 21, 9)
    swept = plan.complete(Workers(count=1))
    missed = list[dict[str, float]]()
    for record, job in zip(swept.records, plan.jobs, strict=True):
        for problem in (job.argument, job.argument.from_guess()):
            if record["status"] != "converged" and solve(problem).converged:
                missed.append(record["at"])
    assert not missed
    found = [record for record in swept.records if record["status"] == "converged"]
    assert all(record["verification"]["passed"] for record in found)
    assert any(record["start"] == "scan" for record in swept.records if record["status"] != "converged")


def test_a_sweep_counts_the_gaits_of_a_place(tmp_path):
    """At 68 deg and a stiffness of 20 the runner has a stable and an unstable gait of the same energy."""
    swept = go.sweep("slip-run", {"walker.attack": ("68deg", "69deg", 2)}, workers=1, output=tmp_path, progress=False)
    assert swept.records[0]["gaits"] == 2
    assert swept.to_record()["several"] >= 1
    problem = go.load_problem("slip-run")
    _, starts = possible_gaits(problem)
    guesses = [problem.replace({"walker.attack": "68deg", "gait.guess.state.dtheta": s["dtheta"]}) for s in starts]
    rates = [solve(guess).to_record()["state"]["dtheta"] for guess in guesses]
    assert len(rates) == 2
    assert np.ptp(rates) > 0.01
    assert go.load_run(swept.folder).records[0]["gaits"] == 2


def test_a_closer_look_rules_out_what_nearly_has_a_gait_and_separates_two_gaits():
    """On either side of the fold of the runner's gaits the defect is small along a large part of the section."""
    place = go.load_problem("slip-run").replace({"walker.stiffness": 19.43})
    assert possible_gaits(place.replace({"walker.attack": "67.3deg"})) == (False, [])
    possible, starts = possible_gaits(place.replace({"walker.attack": "67.375deg"}))
    assert possible
    assert len(starts) == 2
