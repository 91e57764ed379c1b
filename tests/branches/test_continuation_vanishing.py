"""Families whose gaits shrink to nothing end by that name, where it happens."""

import math

import pytest

import gaitopt as go
from gaitopt.branches.monitors import stride
from gaitopt.gait.branch import TERMINAL


def test_gait_b_vanishes_where_friction_is_the_slope() -> None:
    """With mu = tan(slope) a walker that slides forward neither gains nor loses speed."""
    near = {"theta1": -0.000599, "dtheta1": -0.14525, "dtheta2": -0.14526, "dx": 0.464827}
    problem = go.load_problem("compass-passive-b").replace({"friction": 0.0177, "gait.guess.state": near})
    branch = go.continuation(go.solve(problem), "friction", to=0.0173)
    special = branch.specials[-1]
    assert (special.type, special.status) == ("vanishing", "converged")
    assert special.type in TERMINAL
    assert special.value == pytest.approx(math.tan(math.radians(1)), rel=0, abs=1e-9)
    assert special.reason.startswith("the gait vanishes")
    assert [other.type for other in branch.specials] == ["vanishing"]


def test_stride_is_the_distance_of_the_feet_whether_they_slip_or_not() -> None:
    for name in ("compass-passive-a", "compass-passive-b"):
        gait = go.solve(go.load_problem(name))
        assert stride(gait) == pytest.approx(2 * abs(math.sin(gait.state[0])), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "to", "place"), [("compass-torque-efficient", -0.3, None), ("compass-torque-stick", -0.5, -0.07424413041)]
)
def test_family_in_the_ankle_torque_vanishes(name: str, to: float, place: float | None) -> None:
    gait = go.solve(go.load_problem(name))
    branch = go.continuation(gait, "control.ankle", to=to)
    special = branch.specials[-1]
    assert special.value == pytest.approx(special.value if place is None else place, rel=0, abs=1e-9)
    assert (special.type, special.status) == ("vanishing", "converged")
    assert stride(special.gait) < 1e-6
    assert "period_doubling" not in [other.type for other in branch.specials if abs(other.value - special.value) < 1e-6]


@pytest.mark.parametrize(("parameter", "to"), [("walker.gravity", 15.0), ("friction.front", 0.8)])
def test_crawler_whose_phases_lose_their_length_vanishes(parameter, to):
    """Beside that point the equations have a solution without a return map."""
    family = go.continuation(go.solve("crawler"), parameter, to=to, max_points=60)
    assert family.specials[-1].type == "vanishing", family.specials
