"""The Jacobian by variation of the steps is that of the equalities."""

import numpy as np
import pytest
from casadi import Function, jacobian
from named import named
from samples import sampled

from gaitopt.solver.assembly import solution_of


@pytest.mark.parametrize(
    ("name", "free"),
    sampled(
        [
            ("rimless-wheel-slip", ()),
            ("compass-passive-a", ("friction",)),
            ("compass-torque-impact-slip", ("control.ankle", "walker.slope")),
            ("compass-pd-impact-slip", ("control.kp", "friction")),
        ],
        3,
    ),
)
def test_it_agrees_with_that_of_the_symbols_away_from_solutions_too(name: str, free: tuple[str, ...]) -> None:
    gait = named(name)
    solution = solution_of(gait, free)
    equations, w = solution.equations, solution.w
    w *= 1 + 1e-3 * np.random.default_rng(0).uniform(-1, 1, w.size)
    derivative = jacobian(equations.equalities, equations.w)
    symbolic = np.asarray(Function("J", [equations.w, equations.parameters], [derivative])(w, gait.p))
    values, found = equations.linearised(w, gait.p)
    assert values == pytest.approx(equations.violation(w, gait.p), rel=0, abs=1e-14)
    assert found.pattern.shape == symbolic.shape
    assert found.dense(0, w.size) == pytest.approx(symbolic, rel=0, abs=1e-12 * np.abs(symbolic).max())
