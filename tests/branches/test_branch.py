"""A branch as a list of gaits: indices, slices, columns, special points."""

import json

import numpy as np
import pytest

import gaitopt as go
from gaitopt import Branch, continuation


@pytest.fixture(scope="module")
def branch() -> Branch:
    gait = go.solve(go.load_problem("rimless-wheel-stick").replace({"friction": 0.916}))
    return continuation(gait, "friction", 0.913, verify_every=0)


def test_points_come_in_the_order_in_which_they_were_found_and_columns_are_their_scalars(branch: Branch) -> None:
    assert len(branch) == len(branch.points) == branch.values.size
    assert [point.value for point in branch] == branch.values.tolist()
    assert branch[0].value == 0.916
    assert branch[-1].value == pytest.approx(0.913, abs=1e-15)
    assert np.all(np.diff(branch.values) < 0)
    for name in ("spectral_radius", "period", "state.theta"):
        assert branch.column(name) == pytest.approx([point.gait.scalar(name) for point in branch])
    with pytest.raises(KeyError):
        branch.column("colour")


def test_a_slice_is_a_branch_with_the_special_points_of_its_branches(branch: Branch) -> None:
    assert branch[:3].values.tolist() == branch.values[:3].tolist()
    assert len(branch.branch(0)) + len(branch.branch(1)) == len(branch)
    assert {special.branch for special in branch.branch(1).specials} == {1}
    assert branch[:0].specials == ()


def test_special_points_join_branches_that_exist(branch: Branch) -> None:
    (change,) = branch.special("mode_change")
    assert (change.branch, change.next) == (0, (1,))
    assert branch.branch(1).points
    assert branch.branch(0)[-1].gait.problem.cycle == change.before
    assert branch.branch(1)[0].gait.problem.cycle == change.after


def test_records_are_json(branch: Branch) -> None:
    for record in (*branch.points, *branch.specials):
        again = json.loads(json.dumps(record.to_record(), allow_nan=False))
        assert again["value"] == record.value
    assert {"branch", "index", "tangent", "multipliers", "phases", "state"} <= branch[0].to_record().keys()
    assert {"type", "status", "from", "to", "next"} <= branch.special("mode_change")[0].to_record().keys()
