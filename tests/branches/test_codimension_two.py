"""Normal forms and test functions of codimension-two points on explicit maps, whose coefficients are known."""

import numpy as np
import pytest

from gaitopt.branches.codimension_two import (
    DEGENERATE,
    curve_tests,
    degeneracy,
    is_zero,
    other_kappa,
    others_are_complex,
)
from gaitopt.branches.normal_forms import LocalMap, coefficients, stability_loss

BASIS = np.random.default_rng(3).standard_normal((5, 5))
"""Mixes the coordinates, so that no test function sees a normal form in its own coordinates."""


def local_map(linear, quadratic=None, cubic=None):
    """x -> L x + Q(x, x) + K(x, x, x) with a block-diagonal linear part, in other coordinates.

    Parameters
    ----------
    linear : square blocks and numbers on the diagonal.
    quadratic, cubic : functions of x.
    """
    blocks = [np.atleast_2d(block) for block in linear]
    n = sum(len(block) for block in blocks)
    L, place = np.zeros((n, n)), 0
    for block in blocks:
        L[place : place + len(block), place : place + len(block)] = block
        place += len(block)
    T = np.linalg.qr(BASIS[:n, :n])[0]  # lengths stay what they are

    def taylor(directions, order):
        x = directions @ T
        terms = [x @ L.T, np.zeros_like(x), np.zeros_like(x)]
        for k, function in ((1, quadratic), (2, cubic)):
            if function is not None:
                terms[k] = np.array([function(each) for each in x])
        return np.array(terms[:order]) @ T.T

    return LocalMap(T @ L @ T.T, taylor, np.arange(n))


def first(value, n):
    """A vector with one entry."""
    return np.eye(n)[0] * value


def rotation(theta, radius=1.0):
    return radius * np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])


def test_coefficient_of_a_fold_is_that_of_its_square():
    local = local_map([1.0, 0.3], lambda x: first(0.7 * x[0] ** 2, 2))
    assert abs(coefficients(local, "fold")["b"]) == pytest.approx(0.7, rel=1e-12)


def test_coefficient_of_a_flip_has_the_terms_of_second_and_third_order():
    """x -> -x + a x^2 + b x^3 has c = a^2 + b; the second iterate of the logistic map is stable."""
    a, b = 0.6, -1.3
    local = local_map([-1.0, 0.2], lambda x: first(a * x[0] ** 2, 2), lambda x: first(b * x[0] ** 3, 2))
    assert coefficients(local, "period_doubling")["c"] == pytest.approx(a**2 + b, rel=1e-12)
    multipliers = np.array([-1.0, 0.2])
    assert stability_loss({"c": a**2 + b}, multipliers).startswith("a hard loss of stability, the doubled gait is unst")
    assert stability_loss({"c": a**2 + b}, np.array([-1.0, 1.8])) == "the gait is unstable on both sides"
    logistic = local_map([-1.0], lambda x: -3 * x**2)
    assert coefficients(logistic, "period_doubling")["c"] == pytest.approx(9.0, rel=1e-12)
    assert stability_loss({"c": 9.0}, multipliers).startswith("a soft loss")
    assert not stability_loss({"c": None}, multipliers)
    assert not stability_loss({"b": 1.0}, multipliers)


def test_coefficient_of_a_flip_has_the_detour_through_the_other_coordinate():
    """(x, y) -> (-x + x y, y / 2 + x^2): y = 2 x^2 on the manifold, so that c = 2."""
    local = local_map([-1.0, 0.5], lambda x: np.array([x[0] * x[1], x[0] ** 2]))
    assert coefficients(local, "period_doubling")["c"] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("d", [-0.4 + 0.3j, 0.25 - 1.0j])
def test_coefficient_of_a_torus_is_that_of_its_cubic_term(d):
    """z -> e^(i theta) z (1 + d |z|^2); |q| = 1 makes z = (x + i y) / sqrt(2) of it, twice as long."""
    theta = 1.1

    def cubic(x):
        z = x[0] + 1j * x[1]
        image = np.exp(1j * theta) * d * z * abs(z) ** 2
        return np.array([image.real, image.imag, 0.0])

    found = coefficients(local_map([rotation(theta), 0.4], None, cubic), "neimark_sacker", np.cos(theta))
    assert found["re_d"] == pytest.approx(2 * d.real, rel=1e-11)
    assert found["im_d"] == pytest.approx(2 * d.imag, rel=1e-11)
    loss = stability_loss(found, np.array([np.exp(1j * theta), np.exp(-1j * theta), 0.4]))
    assert (
        loss
        == f"a {'soft' if d.real < 0 else 'hard'} loss of stability, the torus is {'' if d.real < 0 else 'un'}stable"
    )


def test_coefficient_of_a_torus_with_quadratic_terms_is_that_of_the_delayed_logistic_map():
    """(x, y) -> (r x (1 - y), x) at r = 2, Kuznetsov, example 4.3; the radius of its torus says how much."""
    r, fixed = 2.0, 0.5
    A = np.array([[r * (1 - fixed), -r * fixed], [1.0, 0.0]])
    local = LocalMap(
        A,
        lambda v, order: np.array([v @ A.T, np.column_stack([-r * v[:, 0] * v[:, 1], 0 * v[:, 0]]), 0 * v])[:order],
        np.arange(2),
    )
    d = coefficients(local, "neimark_sacker", 0.5)["re_d"]
    assert d < 0
    above = 2.002  # |multiplier|^2 is r (1 - 1 / r) = r - 1, so that |z|^2 = -(|multiplier| - 1) / Re d
    x = np.array([0.51, 0.5])
    radii = []
    p, q, _ = local.critical("neimark_sacker", 0.5)
    p = p / np.conj(p.conj() @ q)
    for k in range(60_000):
        x = np.array([above * x[0] * (1 - x[1]), x[0]])
        if k > 40_000:
            radii.append(abs(p.conj() @ (x - (1 - 1 / above))) ** 2)
    assert np.mean(radii) == pytest.approx(-(np.sqrt(above - 1) - 1) / d, rel=0.03)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_strong_resonance_leaves_no_coefficient_and_changes_a_sign(n):
    theta = 2 * np.pi / n
    tests = [
        curve_tests(local_map([rotation(theta + side), 0.3]), "neimark_sacker", np.cos(theta)) for side in (-0.2, 0.2)
    ]
    values = [each[f"resonance_1_{n}"] for each in tests]
    if n > 2:
        assert values[0] * values[1] < 0
        assert coefficients(local_map([rotation(theta), 0.3]), "neimark_sacker", np.cos(theta)) == {
            "re_d": None,
            "im_d": None,
        }
    else:  # the pair turns round at 1 and -1, and meets there
        met = curve_tests(local_map([rotation(theta), 0.3]), "neimark_sacker", np.cos(theta))
        assert met[f"resonance_1_{n}"] == pytest.approx(0.0, abs=1e-7)
    others = {f"resonance_1_{k}" for k in (1, 2, 3, 4)} - {f"resonance_1_{n}"}
    assert all(tests[0][name] * tests[1][name] > 0 for name in others)


DOUBLE = {
    "resonance_1_1": ("fold", lambda e: [np.array([[1.0, 1.0], [0.0, 1.0 + e]]), 0.3]),
    "resonance_1_2": ("period_doubling", lambda e: [np.array([[-1.0, 1.0], [0.0, -1.0 + e]]), 0.3]),
    "fold_flip": ("fold", lambda e: [1.0, -1.0 + e, 0.3]),
    "fold_neimark_sacker": ("fold", lambda e: [1.0, rotation(1.2, 1 + e), 0.3]),
    "flip_neimark_sacker": ("period_doubling", lambda e: [-1.0, rotation(1.2, 1 + e), 0.3]),
    "double_neimark_sacker": ("neimark_sacker", lambda e: [rotation(0.7), rotation(2.0, 1 + e), 0.3]),
    "margin_period_doubling": ("margin", lambda e: [-1.0 + e, 0.4, 0.3]),
    "margin_fold": ("margin", lambda e: [1.0 + e, 0.4, 0.3]),
    "margin_neimark_sacker": ("margin", lambda e: [rotation(1.2, 1 + e), 0.3]),
}
"""Points where two conditions meet: the kind of curve, and the linear part on both sides of the point."""


@pytest.mark.parametrize("name", DOUBLE)
def test_where_two_conditions_meet_one_function_changes_its_sign(name):
    kind, linear = DOUBLE[name]
    kappa = np.cos(0.7)
    sides = [curve_tests(local_map(linear(e)), kind, kappa) for e in (-1e-2, 1e-2)]
    changed = {key for key in sides[0] if sides[0][key] * sides[1][key] < 0}
    assert changed == {name}
    at = curve_tests(local_map(linear(0.0)), kind, kappa)[name]
    assert is_zero(at, *(side[name] for side in sides))


def test_the_other_pair_has_its_own_angle_and_a_neutral_saddle_is_none():
    local = local_map([1.0, rotation(1.2), 0.3])
    assert others_are_complex(local, "fold", 0.0)
    assert other_kappa(local, "fold", 0.0) == pytest.approx(np.cos(1.2))
    assert other_kappa(local_map([rotation(0.7), rotation(2.0)]), "neimark_sacker", np.cos(0.7)) == pytest.approx(
        np.cos(2)
    )
    assert not others_are_complex(local_map([1.0, 4.0, 0.25]), "fold", 0.0)


def test_a_fold_on_the_neimark_sacker_curve_is_that_of_another_multiplier():
    sides = [curve_tests(local_map([rotation(0.7), 1.0 + e]), "neimark_sacker", np.cos(0.7)) for e in (-0.1, 0.1)]
    assert sides[0]["fold_neimark_sacker"] * sides[1]["fold_neimark_sacker"] < 0


@pytest.mark.parametrize(
    ("name", "kind", "linear", "quadratic", "cubic"),
    [
        ("cusp", "fold", [1.0, 0.3], lambda e: lambda x: first(e * x[0] ** 2, 2), lambda e: None),
        ("generalised_flip", "period_doubling", [-1.0, 0.3], lambda e: None, lambda e: lambda x: first(e * x[0] ** 3, 2)),  # noqa: E501
        (
            "chenciner", "neimark_sacker", [rotation(1.1), 0.3], lambda e: None,
            lambda e: lambda x: np.append(e * (x[0] ** 2 + x[1] ** 2) * rotation(1.1) @ x[:2], 0.0),
        ),
    ],
)  # fmt: skip
def test_degenerate_bifurcations_are_where_their_coefficient_changes_its_sign(name, kind, linear, quadratic, cubic):
    """The cubic coefficient, or that of a fold along the same eigenvector."""
    assert DEGENERATE[kind] == name
    values = [degeneracy(local_map(linear, quadratic(e), cubic(e)), kind, np.cos(1.1)) for e in (-0.1, 0.1, 0.0)]
    assert values[0] * values[1] < 0
    assert values[2] == pytest.approx(0.0, abs=1e-12)


def test_a_pole_is_no_zero():
    assert is_zero(1e-9, -0.5, 0.4)
    assert not is_zero(0.3, -0.5, 0.4)
