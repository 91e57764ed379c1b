"""Validated Taylor integration: one step of an analytic vector field, with a rigorous remainder.

If F(B) lies in V for the box B = y0 + [0, h] V, the motion stays in B (Picard), even in y0 + [0, h] F(B). With the
Taylor coefficients F_k(y) of the motion that starts at y

    y(h) = sum_{k < N} F_k(y0) h^k + F_N(B) h^N                                  (Lagrange)

The same holds for any analytic g(y) along the motion, and for the first variation Phi, whose N-th coefficient at a
later time is Phi_N(B) Phi. Everything holds for every y0 in a box, and every h in a ball.

One mode on one segment of the control as an autonomous vector field with everything that is observed along it.

    dy/dt = F(y),   y = (z, t)      or  y = (z, t, mu),  dmu/dt = 0

t, the time since the last impact, is a state like the others, so that events at fixed times and events of the state
are treated alike; and so is a parameter that varies, so that derivatives in it are derivatives in the state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

from casadi import SX, Function, cse, jacobian, sum1, vertcat
from flint import arb, arb_mat, arb_series, ctx

from gaitopt.model.margins import margin_names
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.proof.graph import Graph, NotProved, gathered, hull, scattered


@dataclass(frozen=True, slots=True)
class States:
    """The states y of a system in the steps of one side.

    Attributes
    ----------
    varied : index of the parameter that is a state, if one is.
    side : which leg stands, see ``Walker.side``.
    """

    system: HybridSystem
    varied: int | None
    side: int

    @property
    def n(self) -> int:
        """Their number."""
        return self.system.n_z + 1 + (self.varied is not None)

    def symbols(self) -> tuple[SX, SX, SX]:
        """y, p, and the parameters of this side, with the one that varies taken from y."""
        y, p = SX.sym("y", self.n), SX.sym("p", len(self.system.parameters))
        return y, p, self.side_of(y, p, self.side)

    def side_of(self, y: SX, p: SX, side: int) -> SX:
        """The parameters of a side."""
        values = vertcat(*(y[-1] if k == self.varied else p[k] for k in range(p.numel())))
        return self.system.walker.standing(values, side)


class Field:
    """The flow of a mode, its Jacobian, and its margins, force and power, in balls.

    Parameters
    ----------
    states : in which the field lives.
    p, r : parameters and segment data.
    """

    def __init__(self, states: States, mode: Mode, p: Sequence[arb], r: Sequence[arb]) -> None:
        self.mode, self.n = mode, states.n
        self._states, self._constants = states, (p, r)

    @cached_property
    def rate(self) -> Graph:
        """y -> dy/dt."""
        return self._graph("rate")

    @cached_property
    def jacobian(self) -> Graph:
        """y -> d(dy/dt)/dy, columns one after the other."""
        return self._graph("jacobian")

    @cached_property
    def margins(self) -> Graph:
        """y -> margins of the mode in the order of ``margin_names``."""
        return self._graph("margins")

    @cached_property
    def apparent_masses(self) -> Graph:
        """y -> apparent mass of the foot if it slipped forward, and if it slipped backward."""
        return self._graph("apparent_masses")

    @cached_property
    def observation(self) -> Graph:
        """y -> contact force f_t, f_n, and the power of all motors."""
        return self._graph("observation")

    def _graph(self, name: str) -> Graph:
        return Graph(_function(self._states, self.mode, name), self._constants)


@lru_cache(maxsize=256)
def _function(states: States, mode: Mode, name: str) -> Function:
    system, r = states.system, SX.sym("r", states.system.n_r)
    y, p, values = states.symbols()
    of_state = (y[system.n_z], y[: system.n_z], values, r)
    if name in ("rate", "jacobian"):
        expression = vertcat(system.flow(mode)(*of_state), 1, SX.zeros(int(states.varied is not None)))
    elif name == "margins":
        expression = system.margins(mode)(*of_state)
    elif name == "apparent_masses":
        slips = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
        expression = vertcat(*(system.margins(slip)(*of_state)[margin_names(slip).index("painleve")] for slip in slips))
    else:
        force, _, power, *_ = system.observation(mode)(*of_state)
        expression = vertcat(force, sum1(power))
    if name == "jacobian":
        expression = jacobian(expression, y)
    return Function(name, [y, p, r], cse([expression]))


PRECISION = 128
"""Bits."""
PICARD_ROUNDS = 8
"""Attempts to find a box that the motion does not leave within a step."""
WIDENING, LEAST_WIDENING = 0.05, 1e-7
"""By which rates are widened before each attempt, in their own widths and in 1 / s."""


@dataclass(frozen=True, slots=True)
class Series:
    """A function of time on [0, h] as sum_k c_k t^k, the last coefficient a ball for the remainder."""

    value: list[arb]

    @property
    def rate(self) -> list[arb]:
        """Its derivative, a series of the same kind."""
        return [k * c for k, c in enumerate(self.value)][1:]


@dataclass(frozen=True, slots=True)
class Step:
    """The motions over one step, from every point of a box.

    Attributes
    ----------
    field : the vector field.
    h : length of the step.
    start, beyond : Taylor coefficients of the motions from the box, and of motions from anywhere in B.
    """

    field: Field
    h: Any
    start: list[list[Any]]
    beyond: list[list[arb]]

    @property
    def order(self) -> int:
        """N."""
        return len(self.beyond[0]) - 1

    @property
    def end(self) -> list[Any]:
        """A box in which the motions end."""
        return self.end_of(self.start, self.h)

    def end_of(self, start: list[list[Any]], h: Any) -> list[Any]:
        """Where the motion ends whose first N coefficients are given, after a time of at most the step's length."""
        return [evaluate([*c[: self.order], b[self.order]], h) for c, b in zip(start, self.beyond, strict=True)]

    def variation(self) -> Any:
        """Derivative of the end with respect to the start, shape (n, n)."""
        n = self.field.n
        start, later = _matrices(self.field, self.start), _matrices(self.field, self.beyond)
        steepest = max(sum((abs(later[0][i, j]) for j in range(n)), arb(0)).upper() for i in range(n))
        deviation = arb(0, ((steepest * hull(self.h)).exp() - 1).upper())
        passed = arb_mat(n, n, [deviation + int(i == j) for i in range(n) for j in range(n)])
        terms = [*_variations(start, self.order - 1), _variations(later, self.order)[-1] * passed]
        return evaluate(terms, self.h)

    def along(self, graph: Graph) -> list[Series]:
        """The outputs of a graph of the state along the motions."""
        start = [list(map(hull, c)) for c in self.start]
        pairs = zip(_compose(graph, start), _compose(graph, self.beyond), strict=True)
        return [Series([*start[: self.order], later[self.order]]) for start, later in pairs]


def expand(field: Field, start: Sequence[Any], h: Any, order: int) -> Step:
    """One verified step of some order from every point of the box ``start``.

    Raises
    ------
    NotProved
        If no box is found that the motion cannot leave, or its series are not finite there.
    """
    if not hull(h) > 0:
        raise NotProved(f"{field.mode}: a step of {hull(h).str(5)} s")
    box = confine(field, list(map(hull, start)), hull(h))
    step = Step(field, h, taylor_coefficients(field, start, order + 1), taylor_coefficients(field, box, order + 1))
    if not all(hull(y).is_finite() for y in step.end):
        raise NotProved(f"{field.mode}: the series of the motion are not finite")
    return step


def confine(field: Field, start: Sequence[arb], h: arb) -> list[arb]:
    """A box B in which all motions from the box ``start`` stay for a time ``h``.

    Raises
    ------
    NotProved
        If F(B) lies in V for none of the V that are tried.
    """
    elapsed = arb(0).union(h)
    (speeds,) = field.rate(start)
    for _ in range(PICARD_ROUNDS):
        speeds = [v + arb(0, float(v.rad()) * WIDENING + LEAST_WIDENING) for v in speeds]
        (rates,) = field.rate([y + elapsed * v for y, v in zip(start, speeds, strict=True)])
        if not all(rate.is_finite() for rate in rates):
            break
        if all(v.contains(rate) for v, rate in zip(speeds, rates, strict=True)):
            return [y + elapsed * rate for y, rate in zip(start, rates, strict=True)]
        speeds = [v.union(rate) for v, rate in zip(speeds, rates, strict=True)]
    raise NotProved(f"{field.mode}: no box is shown to hold the motion for {h.str(5, radius=False)} s")


def taylor_coefficients(field: Field, start: Sequence[Any], count: int) -> list[list[Any]]:
    """F_0, ..., F_(count - 1) of each state, one after the other from y' = F(y)."""
    coefficients = [[y] for y in start]
    for k in range(count - 1):
        for c, rate in zip(coefficients, _compose(field.rate, coefficients), strict=True):
            c.append(rate[k] / (k + 1))
    return coefficients


def evaluate(coefficients: Sequence[Any], t: Any) -> Any:
    """A polynomial by Horner's rule."""
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * t + c
    return total


def _matrices(field: Field, motion: list[list[Any]]) -> list[Any]:
    """Series of the Jacobian DF along a motion."""
    n, entries = field.n, _compose(field.jacobian, motion)
    return [matrix(n, [entries[i + n * j][k] for i in range(n) for j in range(n)]) for k in range(len(entries[0]))]


def _variations(slopes: list[Any], order: int) -> list[Any]:
    """Taylor coefficients 0 to ``order`` of Phi' = A Phi, Phi(0) = 1, from those of A."""
    n = hull(slopes[0]).nrows()
    phi = [matrix(n, [int(i == j) for i in range(n) for j in range(n)])]
    for k in range(order):
        total = slopes[0] * phi[k]
        for j in range(1, k + 1):
            total += slopes[j] * phi[k - j]
        phi.append(total * (arb(1) / (k + 1)))
    return phi


def matrix(columns: int, entries: Sequence[Any]) -> Any:
    """A matrix from its entries, row by row."""
    return gathered(entries, lambda values: arb_mat(len(entries) // columns, columns, values))


def _compose(graph: Graph, motion: list[list[Any]]) -> list[list[Any]]:
    """Series of the outputs of a graph along a motion, to the order to which the motion is known."""
    count = ctx.cap = len(motion[0])
    outputs = graph([gathered(c, lambda values: arb_series(values, count)) for c in motion])
    return [scattered(value, lambda part: _coefficients(part, count)) for output in outputs for value in output]


def _coefficients(value: Any, length: int) -> list[arb]:
    if not isinstance(value, arb_series):
        return [arb(value), *[arb(0)] * (length - 1)]
    coefficients = value.coeffs()[:length]
    return [*coefficients, *[arb(0)] * (length - len(coefficients))]
