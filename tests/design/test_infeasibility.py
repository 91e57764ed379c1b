"""A failed design names the constraint that cannot be met, how far the search got, and what pressed against it."""

from types import SimpleNamespace

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt import Status
from gaitopt.design.smoothed import LARGEST_VIOLATION, SMALLEST_MULTIPLIER, conflicts

BOUND = ("control.ankle", 0.8)


def elastic(constraints, reached, *, at_bound=0.0, against=0.0, margin=0.0):
    """What is known of a design whose scalars an elastic search has brought to ``reached``."""
    problem = go.load_problem("compass-torque-efficient").replace({"constraints": constraints})
    blocks = [SimpleNamespace(name="margins", lower=np.zeros(2), upper=np.full(2, np.inf))] + [
        SimpleNamespace(name=name, lower=np.array([span.minimum]), upper=np.array([span.maximum]))
        for name, span in problem.constraints.items()
    ]
    multipliers = [np.array([0.0, margin]), *([np.array([against])] * len(problem.constraints))]
    searched = SimpleNamespace(
        names=tuple(reached),
        values=lambda w: np.array(list(reached.values())),
        active_bounds=lambda result: {BOUND[0]: (at_bound, BOUND[1])},
        block_multipliers=lambda result: list(zip(blocks, multipliers, strict=True)),
        margin_text=lambda row: f"row {row} of the margins",
    )
    return problem, searched


def solved(status=Status.CONVERGED):
    return SimpleNamespace(status=status, w=np.zeros(1))


SPEED = {"speed": {"min": 0.8}}


def test_constraints_that_are_met_up_to_rounding_or_in_a_search_that_failed_conflict_with_nothing():
    assert conflicts(*elastic(SPEED, {"speed": 0.8 - LARGEST_VIOLATION / 2}), solved()) == ()
    assert conflicts(*elastic(SPEED, {"speed": 0.5}), solved(Status.NOT_CONVERGED)) == ()


@pytest.mark.parametrize(
    ("span", "reached", "words", "needed"),
    [
        ({"min": 0.8}, 0.7, "speed >= 0.8", 0.8),
        ({"max": 0.4}, 0.5, "speed <= 0.4", 0.4),
        ({"min": 0.8, "max": 0.8}, 0.7, "speed = 0.8", 0.8),
        ({"min": 0.4, "max": 0.4}, 0.5, "speed = 0.4", 0.4),
    ],
)
def test_a_missed_bound_is_named_with_what_was_reached(span, reached, words, needed):
    (cause,) = conflicts(*elastic({"speed": span}, {"speed": reached}), solved())
    assert (cause.what, cause.needed, cause.available) == ("speed", needed, reached)
    assert f"{words} cannot be met by these phases near the start: best reached {reached:g}" in cause.description


def test_what_presses_against_the_search_is_named_and_what_does_not_is_not():
    limits = {**SPEED, "peak_torque": {"max": 2.0}}
    reached = {"speed": 0.7, "peak_torque": 2.0}
    (cause,) = conflicts(*elastic(limits, reached, at_bound=1.0, against=0.1, margin=-1.0), solved())
    obstacles = "control.ankle <= 0.8, row 1 of the margins, peak_torque <= 2"
    assert f"speed >= 0.8 conflicts with {obstacles}: best reached 0.7" in cause.description
    (calm,) = conflicts(
        *elastic(limits, reached, at_bound=SMALLEST_MULTIPLIER / 2, against=SMALLEST_MULTIPLIER / 2), solved()
    )
    assert "conflicts with" not in calm.description
    (below,) = conflicts(*elastic(SPEED, {"speed": 0.7}, at_bound=-1.0), solved())
    assert "conflicts with control.ankle >= 0.8" in below.description


@pytest.mark.parametrize(
    ("name", "module", "label"),
    [
        ("compass-torque-efficient", "smoothed", "phase 1"),
        pytest.param("rabbit-optimal", "open_loop", "clearance at node", marks=pytest.mark.slow),
    ],
)
def test_a_search_that_runs_out_of_iterations_says_what_limits_it(monkeypatch, name, module, label):
    monkeypatch.setattr(f"gaitopt.design.{module}.MAX_ITERATIONS", 6)
    gait = go.solve(name, progress=False)
    assert gait.status == "not_converged"
    assert "the iterations ran out: largest violation" in gait.message
    assert label in gait.message.partition("presses most on")[2]
    assert "residual of the optimality conditions" in gait.message


def test_a_search_that_runs_out_next_to_a_gait_still_ends_at_the_optimum(monkeypatch):
    optimum = named("compass-torque-efficient")
    monkeypatch.setattr("gaitopt.design.smoothed.MAX_ITERATIONS", 9)
    gait = go.solve("compass-torque-efficient", progress=False)
    assert gait.solver["iterations"] == 9 + 2  # the last two of sequential quadratic programming
    assert gait.freed == pytest.approx(optimum.freed, abs=1e-10)
