"""Validated Taylor integration of one phase: the state at the end of a step, with a rigorous remainder.

A mode on one segment of the control law is an autonomous vector field

    dy/dt = F(y),   y = (z, t)      or  y = (z, t, mu),  dmu/dt = 0

The time t since the last impact is a state, so that a breakpoint of the control law is an event like the others. A
varying parameter mu is a state, so that derivatives in it are derivatives in the state.

If F(B) lies in V for the box B = y0 + [0, h] V, the motion from y0 stays in B (Picard), and even in y0 + [0, h] F(B).
With the Taylor coefficients F_k(y) of the motion that starts at y

    y(h) = sum_{k < N} F_k(y0) h^k + F_N(B) h^N                                  (Lagrange)

The same holds for any analytic g(y) along the motion, and for the first variation Phi, whose N-th coefficient at a
later time is Phi_N(B) Phi. All of it holds for every y0 in a box and every h in a ball.

References
----------
R. E. Moore (1966), Interval Analysis; W. Tucker (2011), Validated Numerics, chapter 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from casadi import SX, Function, cse, jacobian, sum1, vertcat
from flint import arb, arb_mat, arb_series, ctx

from gaitopt.building import built_once
from gaitopt.model.friction import Friction
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.proof.arithmetic import BallFunction, Matrix, NotProved, Number, assemble, entries_of, hull, matrix
from gaitopt.proof.identities import regularities
from gaitopt.threads import cached_property

PICARD_ROUNDS = 8
"""Number of attempts to find a box that the motion does not leave within a step."""
WIDENING, ADDED_WIDTH = 0.05, 1e-7
"""Each attempt widens the rates by this fraction of their half width, and by this much in natural units."""


@dataclass(frozen=True, slots=True)
class PhaseSpace:
    """The symbols of the state y and the parameters during one step.

    Attributes
    ----------
    varied : index of the varying parameter, which is a state; None if none varies.
    step : index of the step in ``Walker.step_parameters``.
    """

    system: HybridSystem
    varied: int | None
    step: int = 0

    @property
    def n(self) -> int:
        """Number of states."""
        return self.system.n_z + 1 + (self.varied is not None)

    def symbols(self) -> tuple[SX, SX, SX]:
        """y, p, and the parameters of this step; the varying one is taken from y."""
        y, p = SX.sym("y", self.n), SX.sym("p", len(self.system.parameters))
        return y, p, self.parameters(y, p)

    def parameters(self, y: SX, p: SX) -> SX:
        """The parameters of this step from those of the first one; the varying one is taken from y."""
        values = vertcat(*(y[-1] if k == self.varied else p[k] for k in range(p.numel())))
        return self.system.step_parameters(values)[self.step]


class VectorField:
    """The flow of a mode with its Jacobian, margins, contact force and power, as functions of balls.

    Parameters
    ----------
    space : the states y.
    p : balls of the parameters.
    r : balls of the data of the control law on its segment.
    units : natural units of the entries of z, and then of t. The unit of a varying parameter is 1.
    """

    def __init__(
        self, space: PhaseSpace, mode: Mode, p: Sequence[arb], r: Sequence[arb], units: Sequence[float]
    ) -> None:
        self.mode, self.n = mode, space.n
        self._space, self._constants = space, (p, r)
        self.units = [*map(float, units), 1.0][: space.n]
        self.added_widths = [ADDED_WIDTH * unit / float(units[-1]) for unit in self.units]
        for k in held_coordinates(space.system, mode):
            self.added_widths[k] = self.added_widths[k + space.system.n_z // 2] = 0.0

    @cached_property
    def rate(self) -> BallFunction:
        """y -> dy/dt."""
        return self._graph("rate")

    @cached_property
    def jacobian(self) -> BallFunction:
        """y -> d(dy/dt)/dy, column by column."""
        return self._graph("jacobian")

    @cached_property
    def margins(self) -> BallFunction:
        """y -> margins of the mode, in the order of ``margin_names``."""
        return self._graph("margins")

    @cached_property
    def apparent_masses(self) -> BallFunction:
        """y -> apparent masses [kg] of the foot, C_tt + mu C_nt and C_tt - mu C_nt with the static coefficient mu."""
        return self._graph("apparent_masses")

    @cached_property
    def regularities(self) -> BallFunction:
        """y -> a number with the sign of the regularity of each mode of the contacts on the ground; see ``Motion``."""
        return self._graph("regularities")

    @cached_property
    def observation(self) -> BallFunction:
        """y -> forces f_t, f_n of one contact after the other [N], and the power of all motors [W]."""
        return self._graph("observation")

    def _graph(self, name: str) -> BallFunction:
        return BallFunction(_function(self._space, self.mode, name), self._constants)


@built_once(maxsize=256)
def _function(space: PhaseSpace, mode: Mode, name: str) -> Function:
    """(y, p, r) -> one of the expressions of ``VectorField``."""
    system, r = space.system, SX.sym("r", space.system.n_r)
    y, p, values = space.symbols()
    inputs = (y[system.n_z], y[: system.n_z], values, r)
    if name in ("rate", "jacobian"):
        expression = vertcat(system.flow(mode)(*inputs), 1, SX.zeros(int(space.varied is not None)))
        for k in held_coordinates(system, mode):  # exactly, and not only up to the width of a ball
            expression[k] = expression[k + system.n_z // 2] = 0
    elif name == "margins":
        expression = system.margins(mode)(*inputs)
    elif name == "apparent_masses":
        slips = [mode.with_contact(slip) for slip in (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)]
        names, static = system.transitions.margin_names, SX(values)
        law = system.friction
        if isinstance(law, Friction) and law.may_drop:  # the margin of a slip has the kinetic coefficient
            static[system.parameters.index(law.kinetic)] = static[system.parameters.index(law.static)]
        with_static = (*inputs[:2], static, r)
        expression = vertcat(*(system.margins(slip)(*with_static)[names(slip).index("painleve")] for slip in slips))
    elif name == "regularities":
        expression = regularities(system, mode, y[: system.n_z], values)
    else:
        force, _, power, *_ = system.observation(mode)(*inputs)
        expression = vertcat(force, sum1(power))
    if name == "jacobian":
        expression = jacobian(expression, y)
    return Function(name, [y, p, r], cse([expression]))


def held_coordinates(system: HybridSystem, mode: Mode) -> list[int]:
    """Indices of the coordinates that a locked stop holds, because its gap depends on no other coordinate."""
    gaps, n = system.expressions.eom.gaps, len(system.walker.shape)
    rows = [[k for k in range(n) if not gaps[name][k].is_zero()] for name in mode.locked]
    return [row[0] for row in rows if len(row) == 1]


@dataclass(frozen=True, slots=True)
class TaylorStep:
    """The motions over one step from every point of a box.

    Attributes
    ----------
    h : length of the step [s].
    start : Taylor coefficients of the motions from the box, by state.
    remainder : Taylor coefficients of motions from anywhere in B, by state.
    """

    field: VectorField
    h: Number
    start: list[list[Number]]
    remainder: list[list[arb]]

    @property
    def order(self) -> int:
        """The order N of the remainder."""
        return len(self.remainder[0]) - 1

    @property
    def end(self) -> list[Number]:
        """A box in which the motions end."""
        return self.end_of(self.start, self.h)

    def end_of(self, start: list[list[Number]], h: Number) -> list[Number]:
        """End of the motion with the first N coefficients ``start``, after a time of at most the step's length."""
        return [evaluate([*c[: self.order], r[self.order]], h) for c, r in zip(start, self.remainder, strict=True)]

    def halves(self) -> tuple["TaylorStep", "TaylorStep"]:
        """The same motions in two steps, whose remainders are smaller."""
        first = expand(self.field, [c[0] for c in self.start], self.h / 2, self.order)
        return first, expand(self.field, first.end, self.h / 2, self.order)

    def variation(self) -> Matrix:
        """Derivative Phi(h) of the end in the start, shape (n, n).

        By Gronwall's inequality every entry of Phi(t) - 1 is at most exp(L h) - 1 in the units u of the states, with
        the largest row sum L of |u_j DF_ij / u_i| on B.
        """
        n = self.field.n
        start, later = _matrices(self.field, self.start), _matrices(self.field, self.remainder)
        u = [arb(unit) for unit in self.field.units]
        lipschitz = max(sum((abs(later[0][i, j]) * u[j] for j in range(n)), arb(0)).upper() / u[i] for i in range(n))
        deviation = arb(0, ((lipschitz * hull(self.h)).exp() - 1).upper())
        phi = arb_mat(n, n, [deviation * u[i] / u[j] + int(i == j) for i in range(n) for j in range(n)])
        terms = [*_variations(start, self.order - 1), _variations(later, self.order)[-1] * phi]
        return evaluate(terms, self.h)

    def along(self, function: BallFunction) -> list[list[arb]]:
        """The outputs of a function of the state along the motions, as polynomials in the time since the start.

        The last coefficient of each is a ball that covers the remainder.
        """
        start = [list(map(hull, c)) for c in self.start]
        pairs = zip(compose(function, start), compose(function, self.remainder), strict=True)
        return [[*known[: self.order], later[self.order]] for known, later in pairs]


def expand(field: VectorField, start: Sequence[Number], h: Number, order: int) -> TaylorStep:
    """One validated step of a given order from every point of the box ``start``.

    Raises
    ------
    NotProved
        If no box is found that the motion cannot leave, or the series are not finite on it.
    """
    if not hull(h) > 0:
        raise NotProved(f"{field.mode}: a step of {hull(h).str(5)} s")
    box = confine(field, list(map(hull, start)), hull(h))
    step = TaylorStep(
        field, h, taylor_coefficients(field, start, order + 1), taylor_coefficients(field, box, order + 1)
    )
    if not all(hull(y).is_finite() for y in step.end):
        raise NotProved(f"{field.mode}: the series of the motion are not finite")
    return step


def confine(field: VectorField, start: Sequence[arb], h: arb) -> list[arb]:
    """A box B in which all motions from the box ``start`` stay for a time ``h``.

    Raises
    ------
    NotProved
        If no attempted V contains F(B).
    """
    elapsed = arb(0).union(h)
    (speeds,) = field.rate(start)
    for _ in range(PICARD_ROUNDS):
        speeds = [
            v + arb(0, float(v.rad()) * WIDENING + added) for v, added in zip(speeds, field.added_widths, strict=True)
        ]
        (rates,) = field.rate([y + elapsed * v for y, v in zip(start, speeds, strict=True)])
        if not all(rate.is_finite() for rate in rates):
            break
        if all(v.contains(rate) for v, rate in zip(speeds, rates, strict=True)):
            return [y + elapsed * rate for y, rate in zip(start, rates, strict=True)]
        speeds = [v.union(rate) for v, rate in zip(speeds, rates, strict=True)]
    raise NotProved(f"{field.mode}: no box is shown to hold the motion for {h.str(5, radius=False)} s")


def taylor_coefficients(field: VectorField, start: Sequence[Number], count: int) -> list[list[Number]]:
    """F_0, ..., F_(count - 1) of each state, by the recursion (k + 1) F_(k+1) = (F o y)_k."""
    coefficients = [[y] for y in start]
    for k in range(count - 1):
        for c, rate in zip(coefficients, compose(field.rate, coefficients), strict=True):
            c.append(rate[k] / (k + 1))
    return coefficients


def evaluate(coefficients: Sequence[Number | Matrix], t: Number) -> Any:
    """A polynomial by Horner's rule."""
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * t + c
    return total


def derivative(coefficients: Sequence[Number]) -> list[Number]:
    """Coefficients of the derivative of a polynomial."""
    return [k * c for k, c in enumerate(coefficients)][1:]


def _matrices(field: VectorField, motion: list[list[Number]]) -> list[Matrix]:
    """Taylor coefficients of the Jacobian DF along a motion."""
    n, entries = field.n, compose(field.jacobian, motion)
    return [matrix(n, [entries[i + n * j][k] for i in range(n) for j in range(n)]) for k in range(len(entries[0]))]


def _variations(slopes: list[Matrix], order: int) -> list[Matrix]:
    """Taylor coefficients 0 to ``order`` of Phi' = A Phi, Phi(0) = 1, from those of A."""
    n = hull(slopes[0]).nrows()
    phi = [matrix(n, [int(i == j) for i in range(n) for j in range(n)])]
    for k in range(order):
        total = slopes[0] * phi[k]
        for j in range(1, k + 1):
            total += slopes[j] * phi[k - j]
        phi.append(total * (arb(1) / (k + 1)))
    return phi


def compose(function: BallFunction, motion: list[list[Number]]) -> list[list[Number]]:
    """Taylor coefficients of the outputs of a function along a motion, as many as the motion has.

    Raises
    ------
    NotProved
        If a series has fewer terms. A quotient whose divisor vanishes at the start, such as sin(t) / t, loses some.
    """
    count = ctx.cap = len(motion[0])

    def coefficients(value: Number) -> list[arb]:
        if isinstance(value, arb_series) and value.prec < count:
            raise NotProved(f"a series has {value.prec} terms instead of {count}: a divisor vanishes at its start")
        known = value.coeffs()[:count] if isinstance(value, arb_series) else [arb(value)]
        return [*known, *[arb(0)] * (count - len(known))]

    outputs = function([assemble(c, lambda values: arb_series(values, count)) for c in motion])
    return [entries_of(value, coefficients) for output in outputs for value in output]
