"""One NLP for many parameter values finds the gaits that are found by building it anew."""

import numpy as np
import pytest
from named import named

from gaitopt import Family, Status, load_problem, solve, verify


@pytest.mark.parametrize(
    ("name", "key", "values"),
    [
        ("compass-passive-a", "friction", (0.142, 0.15, 0.145)),
        ("compass-torque-impact-slip", "control.hip", (0.121, 0.123)),
        ("rimless-wheel-slip", "walker.slope", (0.228, 0.23)),
    ],
)
def test_family_finds_the_gaits_of_its_members(name, key, values):
    problem = load_problem(name)
    family = Family(solve(problem))
    for value in values:
        member = problem.replace({key: value})
        followed, direct = family.solve(member), solve(member)
        assert followed.converged
        np.testing.assert_allclose(followed.state, direct.state, rtol=0, atol=1e-10)
        np.testing.assert_allclose(np.abs(followed.multipliers), np.abs(direct.multipliers), rtol=0, atol=1e-7)


def test_member_that_violates_a_margin_is_no_gait_and_the_family_goes_on():
    """With so much friction the foot would not slip; the equations of the slipping phases alone have a solution."""
    problem = load_problem("compass-passive-a")
    family = Family(named("compass-passive-a"))
    followed = family.solve(problem.replace({"friction": 0.3}))
    assert followed.status is not Status.CONVERGED
    assert followed.message
    assert verify(family.solve(problem.replace({"friction": 0.15}))).passed
    with pytest.raises(ValueError, match="compass-passive-stick differs from compass-passive-a in more than parameter"):
        family.solve(load_problem("compass-passive-stick"))
    with pytest.raises(ValueError, match="a family begins with a converged gait"):
        Family(solve(load_problem("rimless-wheel-stick").replace({"friction": 0.5})))
