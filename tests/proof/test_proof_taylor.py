"""The validated integrator encloses closed forms, and every motion that starts in its box."""

import math
import random

import numpy as np
import pytest
from casadi import SX, Function, fabs, jacobian, sign, sin, vertcat
from flint import acb, arb, arb_mat, arb_series, ctx

from gaitopt import Mode, load_problem
from gaitopt.model.control import NoControl
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.proof import taylor
from gaitopt.proof.arithmetic import (
    BINARY,
    PRECISION,
    UNARY,
    BallFunction,
    NotProved,
    Refuted,
    Tilted,
    assemble,
    entries_of,
    exact_constant,
    hull,
)
from gaitopt.proof.claims import POSITIVE, TOUCHDOWN, check_pattern, sign_intervals
from gaitopt.proof.taylor import PhaseSpace, VectorField, expand, taylor_coefficients

ORDER = 20
UNITS = [1.0, 1.0, 1.6, 2.5, 2.5, 4.0, 0.4]
"""Typical sizes of the coordinates of the compass and of the time."""


class Plane:
    """A vector field of two states in the terms of ``VectorField``."""

    mode, n, units, added_widths = Mode.STICK, 2, [1.0, 1.0], [1e-7, 1e-7]

    def __init__(self, acceleration):
        y = SX.sym("y", 2)
        rate = vertcat(y[1], acceleration(y[0]))
        self.rate = BallFunction(Function("rate", [y], [rate]), [])
        self.jacobian = BallFunction(Function("jacobian", [y], [jacobian(rate, y)]), [])


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(PRECISION):
        yield


def oscillator():
    return Plane(lambda q: -q)


def travel(field, start, duration, steps=40):
    """The motion from the middle of a box, the box at the end, and the variation."""
    h = duration / steps
    y, middle, phi = list(start), [value.mid() for value in start], None
    for _ in range(steps):
        step = expand(field, y, h, ORDER)
        variation = step.variation()
        point = [value.mid() for value in middle]
        rest = variation * arb_mat([[value - p] for value, p in zip(middle, point, strict=True)])
        reached = step.end_of(taylor_coefficients(field, point, ORDER), h)
        middle, y = [value + r for value, r in zip(reached, rest.entries(), strict=True)], step.end
        phi = variation if phi is None else variation * phi
    return middle, y, phi


def test_an_oscillation_lies_in_its_enclosure():
    t = arb(2)
    (q, v), _, phi = travel(oscillator(), [arb(1), arb(0)], t)
    assert q.overlaps(t.cos())
    assert v.overlaps(-t.sin())
    assert max(float(q.rad()), float(v.rad())) < 1e-18
    turn = [[t.cos(), t.sin()], [-t.sin(), t.cos()]]
    assert all(phi[i, j].overlaps(turn[i][j]) and phi[i, j].rad() < 1e-15 for i in range(2) for j in range(2))


def test_a_pendulum_falls_in_a_quarter_of_its_period():
    start = arb("2.5")
    modulus = (start / 2).sin() ** 2
    quarter = acb(modulus).elliptic_k().real
    (q, v), _, _ = travel(Plane(lambda q: -sin(q)), [start, arb(0)], quarter, steps=60)
    assert q.contains(0)
    assert v.overlaps(-2 * modulus.sqrt())
    assert float(q.rad()) < 1e-15


def test_ten_thousand_motions_end_in_the_box():
    """Oscillations that start in a box, in sixty digits, end in its enclosure."""
    rng = random.Random(1)
    _, box, _ = travel(oscillator(), [arb(1, 1e-3), arb(0, 1e-3)], arb(1), steps=10)
    with ctx.workprec(200):
        for _ in range(10_000):
            q, v = 1 + arb(rng.uniform(-1e-3, 1e-3)), arb(rng.uniform(-1e-3, 1e-3))
            end = q * arb(1).cos() + v * arb(1).sin(), v * arb(1).cos() - q * arb(1).sin()
            assert all(outer.contains(inner) for outer, inner in zip(box, end, strict=True))


def test_a_spoiled_remainder_is_noticed(monkeypatch):
    evaluate = taylor.evaluate
    monkeypatch.setattr(taylor, "evaluate", lambda c, t: evaluate(c[:6], t))
    (q, _), _, _ = travel(oscillator(), [arb(1), arb(0)], arb(2))
    assert not q.overlaps(arb(2).cos())


@pytest.mark.parametrize("count", [20, pytest.param(10_000, marks=pytest.mark.slow)])
def test_motions_of_a_stiff_slip_end_in_the_box(count):
    """Motions of the slipping compass that start in a box, in sixty digits, end in its enclosure."""
    system = HybridSystem(CompassBiped, NoControl())
    p = [arb(float(value)) for value in system.values(load_problem("compass-passive-a").parameters)]
    field = VectorField(PhaseSpace(system, None), Mode.SLIP_BACKWARD, p, [], UNITS)
    start = [arb(value) for value in (0.14, 0.16, 0.0, 0.68, -0.46, -0.01, 0.0)]
    end = expand(field, [value + arb(0, 1e-6) for value in start], arb(0.002), ORDER).end
    rng = random.Random(2)
    with ctx.workprec(200):
        for _ in range(count):
            point = [value + rng.uniform(-1e-6, 1e-6) for value in start]
            series = taylor.taylor_coefficients(field, point, 18)
            reached = [taylor.evaluate(c, arb(0.002)) for c in series]
            assert all(outer.contains(inner.mid()) for outer, inner in zip(end, reached, strict=True))


def test_a_box_that_the_motion_leaves_is_noticed(monkeypatch):
    """A remainder at the start of a step alone is not one of all its times."""
    monkeypatch.setattr(taylor, "confine", lambda field, start, h: list(start))
    (q, _), _, _ = travel(oscillator(), [arb(1), arb(0)], arb(2), steps=2)
    assert not q.overlaps(arb(2).cos())


@pytest.mark.parametrize("mode", CONTACTS)
def test_the_graph_of_a_flow_has_the_values_of_casadi(mode):
    system = HybridSystem(CompassBiped, NoControl())
    p = system.values(load_problem("compass-passive-a").parameters)
    rng = np.random.default_rng(3)
    field = VectorField(PhaseSpace(system, None), mode, [arb(float(value)) for value in p], [], UNITS)
    for z in 0.3 * rng.normal(size=(5, system.n_z)):
        balls = field.rate([*(arb(float(value)) for value in z), arb(0)])[0]
        expected = np.asarray(system.flow(mode)(0, z, p, [])).ravel()
        assert np.allclose([float(ball) for ball in balls[:-1]], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("operation", [*UNARY, *BINARY])
def test_every_operation_has_the_value_of_casadi(operation):
    x = SX.sym("x", 2)
    point = (1.25, 1.5) if "acosh" in str(SX.unary(operation, x[0]) if operation in UNARY else "") else (0.25, 0.75)
    value = SX.unary(operation, x[0]) if operation in UNARY else SX.binary(operation, x[0], x[1])
    f = Function("f", [x], [value])
    assert float(BallFunction(f, [])([arb(v) for v in point])[0][0]) == pytest.approx(float(f(point)), rel=1e-14)


def test_a_kink_is_refused():
    x = SX.sym("x")
    with pytest.raises(ValueError, match=r"kink: CasADi's operation .* is not analytic"):
        BallFunction(Function("kink", [x], [sign(x)]), [])
    absolute = BallFunction(Function("absolute", [x], [fabs(x)]), [])
    assert absolute([arb_series([arb(-2), 1])])[0][0].coeffs() == [2, -1]
    with pytest.raises(NotProved, match="a maximum may change"):
        absolute([arb_series([arb(0, 1), 1])])


def test_constants_stand_for_multiples_of_pi_or_for_themselves():
    assert exact_constant(math.pi / 10).overlaps(arb.pi() / 10)
    assert not exact_constant(math.pi / 10).is_exact()
    for value in (0.5, 3.0, 0.1, -2.25):
        assert exact_constant(value).is_exact()
        assert float(exact_constant(value)) == value


def test_a_step_without_a_box_for_the_motion_or_a_flow_that_is_not_defined_there_is_refused():
    singular = Plane(lambda q: 1 / q)
    for field, start, h, words in (
        (Plane(lambda q: q**2), [arb(1), arb(1)], 9, "no box is shown to hold the motion for"),
        (oscillator(), [arb(1), arb(0)], 0, "a step of"),
        (singular, [arb(0, 0.1), arb(0)], 0.1, "no box is shown to hold"),
    ):
        with pytest.raises(NotProved, match=words):
            expand(field, start, arb(h), ORDER)
    with pytest.raises(NotProved, match="a divisor may be zero"):
        taylor.taylor_coefficients(singular, [arb(0), arb(0)], 3)


def line(value, rate):
    """value + rate t as a function on a step."""
    return [arb(value), arb(rate)]


def test_what_is_negative_beyond_the_end_of_an_arc_refutes_nothing():
    """The length of the last step is only enclosed."""
    length = arb(1, 1e-3)
    steps = [(line(-1, 0), length), (line(1, 0), length), (line(1, -1), length)]
    assert check_pattern("touchdown", list(sign_intervals(steps)), TOUCHDOWN) == "n1 p1 d1"
    grazing = list(sign_intervals([(line(1, -1), length)], monotone=False))
    with pytest.raises(NotProved) as failure:
        check_pattern("margin", grazing, POSITIVE)
    assert not isinstance(failure.value, Refuted)
    falling = list(sign_intervals([(line(1, 0), length), (line(0.5, -1), length)], monotone=False))
    with pytest.raises(Refuted, match=r"between 1\.50001 and 1\.5005 s of the arc: .* is false"):
        check_pattern("margin", falling, POSITIVE)


def test_a_series_that_has_lost_terms_is_refused():
    """sin(t) / t of a series in t has one term less; a zero in its place would be wrong."""
    y = SX.sym("y", 2)
    quotient = BallFunction(Function("quotient", [y], [sin(y[0]) / y[0]]), [])
    with pytest.raises(NotProved, match="has 4 terms instead of 5"):
        taylor.compose(quotient, [[arb(0), arb(1), arb(0), arb(0), arb(0)]] * 2)
    right = taylor.compose(quotient, [[arb(1), arb(1), arb(0), arb(0), arb(0)]] * 2)
    assert right[0][0].overlaps(arb(1).sin())


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
        exact = operation(a.value + a.slope * s, b.value + b.slope * s)
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
