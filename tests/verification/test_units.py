"""Units do not matter: the same walk with other metres, seconds and kilograms has the same dimensionless results."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from named import named, solved
from rescaled import dimensionless, rescaled

import gaitopt as go

AGREEMENT = 1e-9
UNITS = ((1e-3, 1e-3, 1e3), (1e3, 670.0, 1.0), (1.0, 1e-3, 1e-3), (0.25, 0.5, 2.0))
"""Factors of length, time and mass; with the last ones a small heavy walker walks under the same gravity."""
ALL_UNITS = tuple(product((1e-3, 1.0, 1e3), (1e-3, 1.0, 30.0, 670.0), (1e-3, 1e3)))


@cache
def family(units: tuple[float, float, float]) -> go.Branch:
    """Through a change of the mode sequence and the beginning of what follows."""
    problem = go.load_problem("compass-passive-stick").replace({"friction": 0.1755})
    return go.continuation(go.solve(rescaled(problem, units)), "friction", to=0.17, max_points=12, verify_every=5)


@pytest.mark.parametrize(
    ("name", "units"),
    [
        *product(("rimless-wheel-slip", "compass-passive-a"), UNITS),
        *(
            pytest.param(name, units, marks=pytest.mark.slow)
            for name, units in product(("rimless-wheel-slip", "compass-torque-impact-slip"), ALL_UNITS)
        ),
    ],
)
def test_gaits_do_not_depend_on_units(name: str, units: tuple[float, float, float]) -> None:
    gait = solved(rescaled(named(name).problem, units))
    np.testing.assert_allclose(dimensionless(gait), dimensionless(named(name)), rtol=0, atol=AGREEMENT)
    assert [claim for claim in go.verify(gait).claims if not claim.passed] == []


@pytest.mark.parametrize("units", [UNITS[0], pytest.param(UNITS[1], marks=pytest.mark.slow)])
def test_families_do_not_depend_on_units(units: tuple[float, float, float]) -> None:
    ours, theirs = family((1.0, 1.0, 1.0)), family(units)
    assert [special.type for special in theirs.specials] == [special.type for special in ours.specials]
    assert [special.type for special in ours.specials] == ["mode_change", "end"]
    for first, second in zip(ours.specials, theirs.specials, strict=True):
        assert second.value == pytest.approx(first.value, rel=0, abs=AGREEMENT)
        assert second.status == first.status == "converged"
    assert theirs.values == pytest.approx(ours.values, rel=0, abs=AGREEMENT)


@pytest.mark.parametrize("foot_mass", [1e-3, 1e-6, 1e-9])
def test_garcias_walker_of_ever_lighter_feet_is_solved_and_verified(foot_mass: float) -> None:
    """Garcia, Chatterjee, Ruina & Coleman (1998): a point mass at the hip, feet of vanishing mass."""
    numbers = {"leg_length": 1.0, "leg_mass": foot_mass, "leg_com": 1e-9, "hip_mass": 1.0, "gravity": 1.0}
    problem = go.load_problem("compass-passive-stick").replace(
        {
            **{f"walker.{name}": value for name, value in numbers.items()},
            "walker.slope": 0.009,
            "friction": 1.0,
            "gait.guess.state": {"theta1": -0.2003, "dtheta1": 0.1998, "dtheta2": -0.0158},
        }
    )
    gait = solved(problem)
    assert [claim for claim in go.verify(gait).claims if not claim.passed] == []
    assert gait.state[0] == pytest.approx(-0.200310900544287, abs=2 * foot_mass + 1e-4)
