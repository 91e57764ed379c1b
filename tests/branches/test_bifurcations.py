"""Test functions of special points, on multipliers that are known."""

import numpy as np
import pytest

from gaitopt.branches import monitors as bifurcations


def values(*multipliers: complex) -> dict[str, float]:
    return bifurcations.test_functions(np.array(multipliers, dtype=complex), 0.3)


def test_a_period_doubling_changes_the_sign_of_its_function_alone() -> None:
    before, after = values(-0.99, 0.4, 0.1), values(-1.01, 0.4, 0.1)
    assert list(bifurcations.bifurcations_between(before, after)) == ["period_doubling"]


def test_a_complex_pair_that_leaves_the_circle_is_a_neimark_sacker_point() -> None:
    pair = np.exp(1.1j)
    before, after = (values(r * pair, r * pair.conjugate(), 0.2) for r in (0.99, 1.01))
    assert list(bifurcations.bifurcations_between(before, after)) == ["neimark_sacker"]
    assert bifurcations.is_bifurcation("neimark_sacker", np.array([pair, pair.conjugate(), 0.2]))


@pytest.mark.parametrize("third", [0.2, 0.3 + 0.1j])
def test_a_neutral_saddle_is_none(third: complex) -> None:
    rest = [third] if isinstance(third, float) else [third, third.conjugate()]
    assert not bifurcations.is_bifurcation("neimark_sacker", np.array([2.0, 0.5, *rest], dtype=complex))


MAPS = {
    "fold": (lambda x: 2 * x, lambda x: 1 - 2 * x),
    "transcritical": (lambda x: 1.0, lambda x: 1 - x),
    "pitchfork, handle": (lambda x: 1.0, lambda x: 1 + x),
    "pitchfork, prongs": (lambda x: 2 * x, lambda x: 1 - 2 * x**2),
}
"""Derivative of the parameter m and multiplier, along fixed points of x + m - x^2 (over x, m = x^2), of x + m x - x^2
(x = m, over m) and of x + m x - x^3 (x = 0 over m, and m = x^2 over x)."""


@pytest.mark.parametrize("name", MAPS)
def test_folds_and_branch_points_of_normal_forms_are_told_apart(name: str) -> None:
    slope, multiplier = MAPS[name]
    before, after = (bifurcations.test_functions(np.array([multiplier(x), 0.3 + 0j]), slope(x)) for x in (-0.1, 0.1))
    kind = "fold" if name == "fold" else "branch_point"
    test = "unit" if slope(-0.1) * slope(0.1) > 0 else "slope"
    assert bifurcations.bifurcations_between(before, after) == {kind: test}


def test_a_single_multiplier_has_no_pair() -> None:
    assert values(0.7)["neimark_sacker"] == 1.0


@pytest.mark.parametrize(("kind", "critical"), [("period_doubling", -1.0), ("fold", 1.0), ("branch_point", 1.0)])
def test_a_multiplier_that_passes_through_infinity_is_no_bifurcation(kind, critical):
    assert bifurcations.is_bifurcation(kind, np.array([critical * (1 + 1e-9), 0.2]))
    assert not bifurcations.is_bifurcation(kind, np.array([-3e12, 0.2]))
