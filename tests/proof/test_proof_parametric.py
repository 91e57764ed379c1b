"""Polynomials in a parameter with balls for coefficients hold the values of what they stand for."""

import random

import pytest

flint = pytest.importorskip("flint")
from flint import arb, arb_mat, arb_series, ctx  # noqa: E402

from gaitopt.proof.parametric import Parametric, matrix, scattered, series, truncated  # noqa: E402


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(128):
        yield


def polynomial(rng, first, size=0.2, degree=3):
    return Parametric([arb(first), *(arb(rng.uniform(-size, size)) for _ in range(degree))])


OPERATIONS = {
    "sum": lambda a, b: a + b - 2,
    "difference": lambda a, b: 3 - a - b,
    "product": lambda a, b: a * b * a,
    "quotient": lambda a, b: a / b + 1 / a,
    "power": lambda a, b: a**3 - b**2,
    "square root": lambda a, b: (a + b).sqrt(),
    "exponential": lambda a, b: (a - b).exp(),
    "logarithm": lambda a, b: a.log() * b,
    "sine": lambda a, b: (a * b).sin(),
    "cosine": lambda a, b: (a / b).cos(),
}


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=OPERATIONS)
def test_every_operation_holds_the_values_at_points(operation):
    rng = random.Random(4)
    a, b = polynomial(rng, 1.3), polynomial(rng, 0.9)
    result, narrow = operation(a, b), truncated(operation(a, b), 1)
    for s in [arb(-1), arb(1), *(arb(rng.uniform(-1, 1)) for _ in range(50))]:
        exact = operation(a.at(s), b.at(s))
        assert result.at(s).overlaps(exact)
        assert narrow.at(s).overlaps(exact)
        assert result.hull.overlaps(exact)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_an_enclosure_has_the_order_of_its_degree(degree):
    """Half the interval, 2^-(degree + 1) of the width."""
    widths = []
    for half in (0.02, 0.01):
        x = Parametric([arb(1), arb(half), *[arb(0)] * (degree - 1)])
        result = x.sin() / x.exp() * x.sqrt()
        widths.append(float(result.coefficients[-1].rad()))
    assert widths[0] / widths[1] == pytest.approx(2 ** (degree + 1), rel=0.2)


def test_series_in_time_hold_the_values_at_points():
    ctx.cap = 6
    rng = random.Random(5)
    a = series([polynomial(rng, 1.1), polynomial(rng, 0.5), arb(1)], 6)
    for operation in (lambda x: x * x, lambda x: 1 / x, lambda x: x.sin(), lambda x: x.sqrt(), lambda x: x.log()):
        values = scattered(operation(a), lambda c: [c[k] for k in range(6)])
        for s in (arb(-1), arb(0.3), arb(1)):
            exact = operation(arb_series([c.mid() for c in a.at(s).coeffs()], 6))
            assert all(value.at(s).overlaps(exact[k]) for k, value in enumerate(values))


def test_matrices_keep_their_order():
    rng = random.Random(6)
    left = matrix(2, 2, [polynomial(rng, k) for k in range(4)])
    right = arb_mat(2, 2, [1, 2, 3, 5])
    s = arb(0.7)
    for product, exact in ((left * right, left.at(s) * right), (right * left, right * left.at(s))):
        assert all(
            value.at(s).overlaps(e)
            for value, e in zip(scattered(product, arb_mat.entries), exact.entries(), strict=True)
        )
    assert not (left * right).at(s).overlaps((right * left).at(s))
