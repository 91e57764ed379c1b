"""Where Newton's method fails, IPOPT takes the family up again."""

import pytest
from named import named

from gaitopt import continuation
from gaitopt.branches.curve import CurvePoint


@pytest.fixture(scope="module")
def wheel():
    return named("rimless-wheel-slip")


def test_branch_goes_on_past_a_place_where_newton_fails(wheel, monkeypatch):
    step = CurvePoint.step

    def failing(self, length):
        found = step(self, length)
        crosses = found is not None and min(found.value, self.value) < 0.45 < max(found.value, self.value)
        return None if crosses else found

    monkeypatch.setattr(CurvePoint, "step", failing)
    branch = continuation(wheel, "friction", 0.5)
    assert branch.special("end")[0].value == pytest.approx(0.5)
    assert {point.branch for point in branch} == {0}
    monkeypatch.undo()
    whole = continuation(wheel, "friction", 0.5)
    assert branch[-1].gait.state == pytest.approx(whole[-1].gait.state, abs=1e-9)


def test_branch_ends_with_a_reason_where_ipopt_fails_too(wheel, monkeypatch):
    step = CurvePoint.step
    monkeypatch.setattr(CurvePoint, "step", lambda self, length: None if self.value > 0.42 else step(self, length))
    monkeypatch.setattr("gaitopt.branches.continuation.RESCUE_DISTANCES", ())
    branch = continuation(wheel, "friction", 0.5)
    assert "IPOPT" in branch.special("end")[0].reason
    assert branch.special("end")[0].status == "guess"
