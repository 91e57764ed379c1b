"""Random gaits of all walkers: none is refused whose return map, differenced here by itself, has its multipliers."""

from collections.abc import Iterator
from itertools import islice, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import differences
from samples import sampled

import gaitopt as go
from gaitopt import Gait
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.model.transitions import Ending
from gaitopt.simulation.simulator import Simulator

Array = NDArray[np.float64]

DESIGNS = {
    "compass-pd-designed": 4, "compass-pd-slippery": 2, "compass-torque-robust": 2, "compass-pd-robust": 1,
    "rabbit-hzd-feedback": 1, "rabbit-optimal": 2,
}  # fmt: skip
"""Curves are designed anew for each gait, which takes long; farther away their constraints cannot be met."""
LONG = (
    "rabbit-hzd", "rabbit-tracked", "crawler", "heel-toe", "heel-toe-slip", "heel-toe-impact-slip",
    "compass-passive-static-kinetic", "compass-pd-impact-slip", "compass-torque-stable-slip",
)  # fmt: skip
RARE = {"compass-virtual-constraint-slip": 5, "inchworm": 3, "bounding-overlap": 3, "rabbit-hzd-slip": 2}
"""Numbers of variants of gaits of which most have another mode sequence."""
COUNTS = dict.fromkeys(go.problem_names(), 20) | dict.fromkeys(LONG, 10) | DESIGNS | RARE
"""Gaits of each named problem that are judged."""
PROBLEMS = tuple(COUNTS)
SLIPPERY = {
    "compass-passive-a": ((0.05, 0.17), 40), "compass-passive-b": ((0.03, 0.2), 40),
    "compass-torque-slip": ((0.05, 0.2), 40),
}  # fmt: skip
"""Ranges of friction down to which the families reach, with radii up to some hundreds, and how many are judged."""
TRIES = 120
"""Problems that are tried for these gaits at most: some have none."""
ABOUT_THE_RETURN_MAP = {"multipliers", "perturbation"}
STEPS = (3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7)
SAME_MULTIPLIERS = 1e-5


def variants(name: str, seed: int) -> Iterator[go.Problem]:
    """The named problem with about half of its numbers changed at random by 2, 10 or 30 %; designs by 0.3 or 1 %."""
    random = np.random.default_rng([seed, PROBLEMS.index(name)])
    problem = go.load_problem(name)
    while True:
        scale = random.choice([0.003, 0.01] if name in DESIGNS else [0.02, 0.1, 0.3])
        changes = {
            key: value * float(np.exp(scale * random.uniform(-1, 1)))
            for key, value in problem.parameters.items()
            if key not in problem.free and key != "walker.spokes" and value and random.random() < 0.6
        }
        try:
            yield problem.replace(changes)
        except ProblemError:  # outside of what the walker allows
            continue


def slippery_variants(name: str, seed: int) -> Iterator[go.Problem]:
    random, problem = np.random.default_rng([seed, PROBLEMS.index(name)]), go.load_problem(name)
    slopes = (0.01, 0.05) if "passive" in name else (0, 0)
    while True:
        yield problem.replace(
            {"friction": random.uniform(*SLIPPERY[name][0]), "walker.slope": float(random.uniform(*slopes))}
        )


def gaits(problems: Iterator[go.Problem]) -> Iterator[Gait]:
    """Gaits of up to ``TRIES`` problems."""
    for problem in islice(problems, TRIES):
        try:
            gait = go.solve(problem.from_guess(), progress=False)
        except SolveError:  # a reference that is not a gait
            continue
        if gait.converged:
            yield gait


def differenced_multipliers(gait: Gait) -> NDArray[np.complex128] | None:
    """Multipliers from five-point differences of the simulated cycle, at the step sizes whose results agree best."""
    simulator, impact = Simulator(gait.dynamics), gait.problem.cycle.impact
    section = gait.system.section(impact).indices
    unit, xi = gait.dynamics.state_units[section], gait.state[section]

    def returned(deviation: Array) -> Array:
        walk = simulator.run(gait.dynamics.lift(xi + deviation * unit), steps=len(gait.steps))
        if walk.ending is not Ending.COMPLETED or walk.steps[-1].final_impact.mode.sticks is not impact.sticks:
            return np.full(xi.size, np.nan)
        return walk.section_states[-1][section] / unit

    found = [differences(returned, np.zeros(xi.size), h) for h in STEPS]
    changes = [np.abs(one - other).max() for one, other in pairwise(found)]
    if np.isnan(changes).all():
        return None
    return floquet_multipliers(found[int(np.nanargmin(changes)) + 1])


def judged(gait: Gait) -> bool:
    """Whether a gait is right: all claims hold, or those that do not are about a return map that differs from its own.

    Raises
    ------
    AssertionError
        If a gait is refused for its return map although the map, differenced here, has the gait's multipliers.
    """
    failed = [claim for claim in go.verify(gait).claims if not claim.passed]
    if not {claim.name for claim in failed} <= ABOUT_THE_RETURN_MAP:
        return False
    if not failed:
        return True
    multipliers = differenced_multipliers(gait)
    same = (
        multipliers is not None and multiplier_distance(multipliers, gait.multipliers, relative=True) < SAME_MULTIPLIERS
    )
    assert not same, f"{gait!r} at {gait.dynamics.parameters}: {[claim.summary for claim in failed]}"
    return False


def count_judged(problems: Iterator[go.Problem], count: int) -> int:
    """Number of gaits that were judged, at most ``count``; none of them is refused."""
    return sum(1 for _ in islice(filter(judged, gaits(problems)), count))


@pytest.mark.parametrize("name", sampled(["rimless-wheel-slip", "hopper", "compass-push-off"], 2))
def test_some_random_gaits_are_not_refused(name: str) -> None:
    assert count_judged(variants(name, seed=1), 3) == 3


@pytest.mark.parametrize("name", ["compass-passive-a", "compass-passive-b", "rimless-wheel-slip", "compass-push-off"])
def test_differences_see_wrong_multipliers(name: str) -> None:
    """The judge of the other tests would notice a multiplier that is wrong."""
    gait = go.solve(go.load_problem(name))
    multipliers = differenced_multipliers(gait)
    assert multiplier_distance(multipliers, gait.multipliers, relative=True) < SAME_MULTIPLIERS / 100


def test_at_least_500_gaits_of_all_walkers_are_judged() -> None:
    assert COUNTS.keys() == {*go.problem_names()}
    assert min(COUNTS.values()) > 0
    assert sum(COUNTS.values()) + sum(count for _, count in SLIPPERY.values()) >= 500


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), COUNTS.items())
def test_no_random_gait_is_refused(name: str, count: int) -> None:
    assert count_judged(variants(name, seed=2), count) == count


@pytest.mark.slow
@pytest.mark.parametrize("name", SLIPPERY)
def test_no_random_gait_on_slippery_ground_is_refused(name: str) -> None:
    count = SLIPPERY[name][1]
    assert count_judged(slippery_variants(name, seed=2), count) == count
