"""Test functions of special points, on multipliers that are known."""

import numpy as np
import pytest

from gaitopt.families import bifurcations


def values(*multipliers: complex) -> dict[str, float]:
    return bifurcations.test_functions(np.array(multipliers, dtype=complex), 0.3)


def test_a_period_doubling_changes_the_sign_of_its_function_alone() -> None:
    before, after = values(-0.99, 0.4, 0.1), values(-1.01, 0.4, 0.1)
    assert [kind for kind in before if before[kind] * after[kind] < 0] == ["period_doubling"]


def test_a_complex_pair_that_leaves_the_circle_is_a_neimark_sacker_point() -> None:
    pair = np.exp(1.1j)
    before, after = (values(r * pair, r * pair.conjugate(), 0.2) for r in (0.99, 1.01))
    assert [kind for kind in before if before[kind] * after[kind] < 0] == ["neimark_sacker"]
    assert bifurcations.is_bifurcation("neimark_sacker", np.array([pair, pair.conjugate(), 0.2]))


@pytest.mark.parametrize("third", [0.2, 0.3 + 0.1j])
def test_a_neutral_saddle_is_none(third: complex) -> None:
    rest = [third] if isinstance(third, float) else [third, third.conjugate()]
    assert not bifurcations.is_bifurcation("neimark_sacker", np.array([2.0, 0.5, *rest], dtype=complex))


def test_a_fold_is_where_the_parameter_turns() -> None:
    assert values(0.5, 0.2)["fold"] == 0.3


def test_a_single_multiplier_has_no_pair() -> None:
    assert values(0.7)["neimark_sacker"] == 1.0
