"""Values and slopes in a parameter hold the values of what they stand for."""

import random

import pytest
from flint import arb, arb_mat, arb_series, ctx

from gaitopt.proof.arithmetic import Tilted, assemble, entries_of, hull


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(128):
        yield


def number(rng, value, size=0.3):
    return Tilted(arb(value), arb(rng.uniform(-size, size)))


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
    "arc tangent": lambda a, b: (a * b).atan(),
}


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=OPERATIONS)
def test_every_operation_holds_the_values_at_points(operation):
    rng = random.Random(4)
    a, b = number(rng, 1.3), number(rng, 0.9)
    result = operation(a, b)
    for s in [arb(-1), arb(1), *(arb(rng.uniform(-1, 1)) for _ in range(50))]:
        exact = operation(a.at(s), b.at(s))
        assert result.at(s).overlaps(exact)
        assert hull(result).overlaps(exact)


def test_an_enclosure_is_of_second_order():
    """Half the interval, a quarter of the width."""
    widths = []
    for half in (0.02, 0.01):
        x = Tilted(arb(1), arb(half))
        widths.append(float((x.sin() / x.exp() * x.sqrt()).slope.rad()))
    assert widths[0] / widths[1] == pytest.approx(4, rel=0.2)


def test_series_in_time_hold_the_values_at_points():
    ctx.cap = 6
    rng = random.Random(5)
    a = assemble([number(rng, 1.1), number(rng, 0.5), arb(1), *[arb(0)] * 3], lambda values: arb_series(values, 6))
    for operation in (lambda x: x * x, lambda x: 1 / x, lambda x: x.sin(), lambda x: x.sqrt(), lambda x: x.log()):
        values = entries_of(operation(a), lambda c: [c[k] for k in range(6)])
        for s in (arb(-1), arb(0.3), arb(1)):
            exact = operation(arb_series([c.mid() for c in a.at(s).coeffs()], 6))
            assert all(value.at(s).overlaps(exact[k]) for k, value in enumerate(values))


def test_matrices_keep_their_order():
    rng = random.Random(6)
    left = assemble([number(rng, k) for k in (2, 1, 1, 3)], lambda values: arb_mat(2, 2, values))
    right = arb_mat(2, 2, [1, 2, 3, 5])
    s = arb(0.7)
    for product, exact in (
        (left * right, left.at(s) * right),
        (right * left, right * left.at(s)),
        (left * left.inv(), arb_mat([[1, 0], [0, 1]])),
    ):
        values = entries_of(product, arb_mat.entries)
        assert all(value.at(s).overlaps(e) for value, e in zip(values, exact.entries(), strict=True))
    assert not (left * right).at(s).overlaps((right * left).at(s))
