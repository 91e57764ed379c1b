"""Objective and constraints of a design as numbers with exact derivatives in the freed parameters.

Each constraint is a row that is not negative, or zero. An extremum is bounded by one row for each of the values whose
extremum it is; the radius of the multipliers by the inequalities of ``nlp.moduli``.

Scalars of the result as expressions of the NLP's unknowns, with exact derivatives.

Integrals are sums over the Lobatto points of every shooting interval; extrema are bounded by the values at those
points. |power| has kinks and is smoothed, sqrt(power^2 + width^2). What points and width miss is small; ``scalars``
has the same scalars without it.

All multipliers within a circle, as three inequalities that are polynomials of the return map's derivative.

    det(I - A) >= 0,     det(I + A) >= 0,     det(I - A ^ A) >= 0,          A = DPi / rho

with the second compound A ^ A, whose eigenvalues are the products of two: the boundary of the matrices whose
multipliers lie within rho consists of those with a multiplier at rho, at -rho, or with two whose product is rho^2, a
complex pair on the circle. Jury (1964). They are smooth where multipliers meet and turn complex, while the modulus
there is not even Lipschitz. They hold again where two leave the circle at once, so that they serve near a solution.

The scalars of a result with their exact derivatives in the freed parameters.

Extrema are taken where they are, between the nodes too; the derivative of an extremum is that of the curve at its
place, since there the place does not matter. |power| is integrated between its located zeros.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, combinations, islice

import numpy as np
from casadi import DM, MX, Function, horzcat, jacobian, repmat, reshape, sqrt, sum1, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.design.sensitivity import ArcCurves, Curve, Sensitivity
from gaitopt.design.spectral_radius import ResponseSlope
from gaitopt.gait import curves
from gaitopt.model.buffered import buffered
from gaitopt.model.margins import margin_scales
from gaitopt.model.modes import Mode
from gaitopt.nlp.newton import section_sensitivity
from gaitopt.nlp.shooting import (
    LOBATTO_POINTS,
    LOBATTO_WEIGHTS,
    MultipleShooting,
    impact_margins,
    is_zero_by_event,
    sampled_step,
)
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import Range

RADIUS = "spectral_radius"
EXTREMA = {
    RADIUS: 1,
    "peak_torque": 1,
    "required_friction": 1,
    "impulse_ratio": 1,
    "foot_clearance": 1,
    "min_normal_force": -1,
}
"""Scalars that are the largest (1) or smallest (-1) of some values: of a curve, or of a number and its negative."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Samples:
    """Quantities of one arc at its N Lobatto points; ``ahead`` is the swing foot's lead over the stance foot."""

    mode: Mode
    weights: MX
    force: MX
    torque: MX
    power: MX
    height: MX
    ahead: MX


class Outcome:
    """Scalars of one step.

    Parameters
    ----------
    transcription : of the step.
    width : MX - of the smoothing of |power| [W].
    """

    def __init__(self, transcription: MultipleShooting, width: MX) -> None:
        self._t, self._width = transcription, width
        self._plain = {
            "period": self._period,
            "step_length": self._step_length,
            "speed": lambda: self._step_length() / self._period(),
            "work": self._work,
            "cost_of_transport": lambda: self._work() / self._weighted_length(),
            "absolute_cost_of_transport": lambda: self._absolute_work() / self._weighted_length(),
            "torque_squared": lambda: self._integral(lambda s: sum1(s.torque**2)),
            "slip_distance": self._slip_distance,
        }

    def value(self, name: str) -> MX:
        """A scalar that is no extremum: a name of the result, ``state.NAME``, or a dotted key."""
        if name in self._t.system.parameters:
            return self._t.p[self._t.system.parameters.index(name)]
        if name.startswith("state."):
            return self._t.Z[self._t.system.state_names.index(name.removeprefix("state.")), 0]
        return self._plain[name]()

    def bounded(self, name: str, extremum: MX) -> MX:
        """Rows that are not negative where ``extremum`` bounds the curve; the least is zero where it is its value."""
        if name == "peak_torque":
            return vertcat(*(vec(extremum - sign * s.torque) for s in self._samples for sign in (1, -1)))
        if name == "min_normal_force":
            return vertcat(*(vec(s.force[1, :] - extremum) for s in self._samples))
        if name == "foot_clearance":
            return vertcat(*(vec(extremum - s.height) for s in self._samples))
        if name == "impulse_ratio":  # of a sticking impact, also where the impact slips
            impulse = self._t.system.impact(Mode.STICK)(z=self._t.Z[:, -1], p=self._t.p)["impulse"]
            return vertcat(*(extremum * impulse[1] - sign * impulse[0] for sign in (1, -1)))
        sticking = [s.force for s in self._samples if s.mode.sticks]
        return vertcat(*(vec(extremum * f[1, :] - sign * f[0, :]) for f in sticking for sign in (1, -1)))

    def active_rows(self, name: str, w: Array, p: Array) -> list[int]:
        """Which rows of ``bounded`` count: of the clearance only those after the legs have passed each other."""
        if name != "foot_clearance":
            return list(range(self.bounded(name, MX(0)).numel()))
        leads = Function("leads", [self._t.w, self._t.parameters], [horzcat(*(s.ahead for s in self._samples))])
        behind = np.flatnonzero(np.asarray(leads(w, p)).ravel() <= 0)
        return list(range(int(behind[-1]) + 1 if behind.size else 0, leads.size2_out(0)))

    @cached_property
    def _samples(self) -> list[_Samples]:
        """Quantities at the Lobatto points, arc by arc."""
        system, arcs = self._t.system, self._t.layout.arcs

        def columns(i: int) -> list[MX]:
            arc, Z, start, h = self._t.arc(i)
            times = start + h * MX(np.arange(arc.intervals)).T
            return [Z[:, :-1], times, repmat(h, 1, arc.intervals), *self._t.constants(arc, arc.intervals)]

        samples = []
        n = LOBATTO_POINTS.size
        for i, wide in enumerate(self._t.map_arcs(lambda mode: sampled_step(system, mode), columns)):
            arc, _, start, h = self._t.arc(i)
            states = reshape(wide, system.n_z, n * arc.intervals)
            fractions = (np.arange(arc.intervals)[:, None] + LOBATTO_POINTS).ravel()
            observe = system.observation(arc.mode).map(fractions.size)
            times = start + h * MX(DM(fractions)).T
            force, torque, power, foot, *_ = observe(times, states, *self._t.constants(arc, fractions.size))
            weights = h * MX(DM(np.tile(LOBATTO_WEIGHTS, arc.intervals))).T
            ahead = foot[0, :] - states[system.n_shape, :]
            samples.append(
                _Samples(
                    mode=arcs[i].mode,
                    weights=weights,
                    force=force,
                    torque=torque,
                    power=power,
                    height=foot[1, :],
                    ahead=ahead,
                )
            )
        return samples

    def _integral(self, integrand: Callable[[_Samples], MX]) -> MX:
        return sum((integrand(s) @ s.weights.T for s in self._samples), MX(0))

    def _period(self) -> MX:
        return sum1(self._t.durations)

    def _step_length(self) -> MX:
        t = self._t
        impact = t.system.impact(t.layout.cycle.impact)
        return impact(z=t.Z[:, -1], p=t.p)["z_plus"][t.system.n_shape]

    def _weighted_length(self) -> MX:
        return self._t.system.weight(self._t.p) * self._step_length()

    def _work(self) -> MX:
        return self._push_work() + self._integral(lambda s: sum1(s.power))

    def _absolute_work(self) -> MX:
        return self._push_work() + self._integral(lambda s: sum1(sqrt(s.power**2 + self._width**2)))

    def _push_work(self) -> MX:
        """Work of the push before the impact; that of a foot at rest is positive."""
        return self._t.system.push(z=self._t.Z[:, -1], p=self._t.p)["work"]

    def _slip_distance(self) -> MX:
        x = self._t.system.n_shape
        distance = MX(0)
        for i in range(len(self._t.layout.arcs)):
            arc, Z, _, _ = self._t.arc(i)
            distance += arc.mode.direction * (Z[x, -1] - Z[x, 0])
        return distance


@dataclass(frozen=True, slots=True, kw_only=True)
class CircleRow:
    """One of the inequalities: its value, and derivatives by the matrix, shape (n, n), and by the radius."""

    name: str
    value: float
    by_matrix: Array
    by_radius: float


def circle_rows(M: Array, radius: float) -> list[CircleRow]:
    """The inequalities for a matrix (n, n) and a radius; none of two where there is only one multiplier."""
    n = len(M)
    A = M / radius
    rows = []
    for name, sign in (("real", 1.0), ("negative", -1.0)):
        rows.append(_row(name, np.eye(n) - sign * A, -sign * _adjugate(np.eye(n) - sign * A).T, A, radius))
    if n > 1:
        pairs = list(combinations(range(n), 2))
        inside = np.eye(len(pairs)) - _compound(A, pairs)
        rows.append(_row("pair", inside, _through_compound(A, pairs, -_adjugate(inside).T), A, radius))
    return rows


def modulus_gradient(M: Array) -> tuple[float, Array]:
    """Largest modulus of a matrix's eigenvalues and its gradient, shape (n, n), where that eigenvalue is simple."""
    values, right = np.linalg.eig(M)
    k = int(np.argmax(np.abs(values)))
    left = np.linalg.inv(right)[k]
    slope = np.multiply.outer(left, right[:, k])
    return float(np.abs(values[k])), np.real(np.conj(values[k]) * slope / np.abs(values[k]))


def _row(name: str, inside: Array, by_A: Array, A: Array, radius: float) -> CircleRow:
    by_radius = -float(np.vdot(by_A, A)) / radius
    return CircleRow(name=name, value=float(np.linalg.det(inside)), by_matrix=by_A / radius, by_radius=by_radius)


def _adjugate(A: Array) -> Array:
    """det(A) A^-1, for singular matrices too; shape (n, n)."""
    U, s, Vt = np.linalg.svd(A)
    others = np.array([np.prod(np.delete(s, k)) for k in range(s.size)])
    return np.asarray(np.linalg.det(U) * np.linalg.det(Vt) * (Vt.T * others) @ U.T)


def _compound(A: Array, pairs: list[tuple[int, int]]) -> Array:
    """Minors of order two; shape (n_pairs, n_pairs)."""
    i, j = np.array(pairs).T
    return np.asarray(A[np.ix_(i, i)] * A[np.ix_(j, j)] - A[np.ix_(i, j)] * A[np.ix_(j, i)])


def _through_compound(A: Array, pairs: list[tuple[int, int]], weights: Array) -> Array:
    """Gradient in A of the minors weighted by ``weights``; shape (n, n)."""
    i, j = np.array(pairs).T
    by = np.zeros_like(A)
    np.add.at(by, np.ix_(i, i), weights * A[np.ix_(j, j)])
    np.add.at(by, np.ix_(j, j), weights * A[np.ix_(i, i)])
    np.add.at(by, np.ix_(i, j), -weights * A[np.ix_(j, i)])
    np.add.at(by, np.ix_(j, i), -weights * A[np.ix_(i, j)])
    return by


Valued = tuple[float, Array]
"""A number and its derivatives in the freed parameters, shape (n_free,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """One of the values whose largest (or smallest) is an extremum; ``key`` tells it from the others."""

    key: str
    value: float
    gradient: Array


class Scalars:
    """Scalars of one gait.

    Parameters
    ----------
    sensitivity : the gait's curves with their derivatives.
    """

    def __init__(self, sensitivity: Sensitivity) -> None:
        self._s, self._t = sensitivity, sensitivity.transcription
        self.n_free = len(self._t.free)
        values, by = buffered(at_impact(self._t))(sensitivity.at.w, sensitivity.at.p)
        at_end = zip(values.tolist(), by.reshape(-1, values.size).T @ sensitivity.slopes, strict=True)
        self._impact: dict[str, Valued] = dict(zip(AT_IMPACT, islice(at_end, len(AT_IMPACT)), strict=True))
        self._impact_margins: list[Valued] = list(at_end)
        self._smooth: dict[str, Callable[[], Valued]] = {
            "period": self._period,
            "step_length": self._step_length,
            "speed": lambda: _ratio(self._step_length(), self._period()),
            "work": lambda: self._plus_push(c.integral() for a in sensitivity.arcs for c in a.power),
            "torque_squared": lambda: _total(_squared(c).integral() for a in sensitivity.arcs for c in a.torque),
            "slip_distance": self._slip_distance,
            "cost_of_transport": lambda: _ratio(self._smooth["work"](), self._weighted_length()),
            "absolute_cost_of_transport": lambda: _ratio(
                self._plus_push(c.absolute_integral() for a in sensitivity.arcs for c in a.power),
                self._weighted_length(),
            ),
        }
        self._known: dict[str, Valued] = {}
        self._extrema: dict[str, Callable[[], Iterator[Piece]]] = {
            "peak_torque": self._torques,
            "required_friction": self._friction,
            "impulse_ratio": self._impulse,
            "foot_clearance": self._clearance,
            "min_normal_force": self._normal_force,
        }

    def smooth(self, name: str) -> Valued:
        """A scalar that is no extremum: a name of the result, ``state.NAME``, or a dotted key."""
        t, s = self._t, self._s
        if name in t.system.parameters:
            freed = np.array([float(name == other) for other in t.free])
            return s.dynamics.parameter(name), freed
        if name.startswith("state."):
            k = t.system.state_names.index(name.removeprefix("state."))
            return float(s.at.w[k]), s.slopes[k]
        if name not in self._known:
            self._known[name] = self._smooth[name]()
        return self._known[name]

    def by_work(self, name: str) -> float:
        """Derivative of a scalar in the absolute work of the motors [1/J]."""
        return 1 / self._weighted_length()[0] if name == "absolute_cost_of_transport" else 0.0

    def pieces(self, name: str) -> list[Piece]:
        """The values whose extremum a scalar is."""
        return list(self._extrema[name]())

    def margins(self) -> Iterator[tuple[str, float, Piece]]:
        """Name, natural unit and value of every margin: at its minima along the arcs, and of the impact."""
        t, scales = self._t, self._s.dynamics.scales
        for k, arc in enumerate(self._s.arcs):
            last, mode = t.layout.arcs[k].intervals, arc.arc.mode
            for (name, curve), unit in zip(arc.margins.items(), margin_scales(mode, scales), strict=True):
                if name in ("touchdown", "upright"):
                    continue
                ends = [s for s, node in ((-1.0, 0), (1.0, last)) if not is_zero_by_event(t, k, node, name)]
                for piece in _extremes(curve, f"{name} {k}", ends):
                    yield name, float(unit), piece
        for (value, slope), (_, label) in zip(self._impact_margins, impact_margins(t), strict=True):
            yield label.name, label.unit(scales), Piece(key=f"impact {label.name}", value=value, gradient=slope)

    def _period(self) -> Valued:
        t, s = self._t, self._s
        durations = slice(t.system.n_z * t.n_nodes, t.system.n_z * t.n_nodes + t.n_phases)
        return float(s.at.w[durations].sum()), s.slopes[durations].sum(axis=0)

    def _step_length(self) -> Valued:
        return self._impact["step_length"]

    def _weighted_length(self) -> Valued:
        (length, slope), (weight, weight_slope) = self._impact["step_length"], self._impact["weight"]
        return length * weight, slope * weight + length * weight_slope

    def _plus_push(self, terms: Iterator[Valued]) -> Valued:
        """The sum of works, with that of the push before the impact."""
        return _total(chain(terms, [self._impact["push_work"]]))

    def _slip_distance(self) -> Valued:
        t, s, x = self._t, self._s, self._t.system.n_shape
        value, slope = 0.0, np.zeros(len(t.free))
        for arc, first in zip(t.layout.arcs, t.layout.first_nodes, strict=True):
            start, end = (t.system.n_z * node + x for node in (first, first + arc.intervals))
            value += arc.mode.direction * float(s.at.w[end] - s.at.w[start])
            slope += arc.mode.direction * (s.slopes[end] - s.slopes[start])
        return value, slope

    def _torques(self) -> Iterator[Piece]:
        for k, arc in enumerate(self._s.arcs):
            for j, curve in enumerate(arc.torque):
                yield from _both_signs(_extremes(curve, f"torque {j} {k}"))

    def _friction(self) -> Iterator[Piece]:
        for k, arc in enumerate(self._s.arcs):
            if arc.arc.mode.sticks:
                yield from _both_signs(_extremes(_quotient(*arc.force), f"friction {k}"))

    def _impulse(self) -> Iterator[Piece]:
        value, slope = _ratio(self._impact["impulse_t"], self._impact["impulse_n"])
        yield from _both_signs(iter([Piece(key="impulse", value=value, gradient=slope)]))

    def _clearance(self) -> Iterator[Piece]:
        for k, arc in enumerate(self._s.arcs):
            if arc.ahead.values[-1] > 0:
                yield from _extremes(arc.height, f"height {k}", [1.0], after=_passing(arc))

    def _normal_force(self) -> Iterator[Piece]:
        for k, arc in enumerate(self._s.arcs):
            yield from _extremes(arc.force[1], f"normal force {k}")


AT_IMPACT = ("step_length", "weight", "impulse_t", "impulse_n", "push_work")
"""The impulse is that of a sticking impact, the work that of the push."""


@lru_cache(maxsize=8)
def at_impact(t: MultipleShooting) -> Function:
    """(w, p) -> what ``AT_IMPACT`` names and the margins of the impact; and their Jacobian in w."""
    landed = t.system.impact(t.layout.cycle.impact)(z=t.Z[:, -1], p=t.p)["z_plus"]
    impulse = t.system.impact(Mode.STICK)(z=t.Z[:, -1], p=t.p)["impulse"]
    margins = [expression for expression, _ in impact_margins(t)]
    work = t.system.push(z=t.Z[:, -1], p=t.p)["work"]
    values = vertcat(landed[t.system.n_shape], MX(t.system.weight(t.p)), impulse, work, *margins)
    return Function("at_impact", [t.w, t.parameters], [values, jacobian(values, t.w)])


def _passing(arc: ArcCurves) -> float:
    """Where in the arc the legs pass each other for the last time; -1 if they do not."""
    passing = curves.roots(arc.ahead.values)
    return float(passing[-1]) if passing.size else -1.0


def _extremes(curve: Curve, key: str, ends: list[float] | None = None, after: float = -1.0) -> Iterator[Piece]:
    """The curve at its extrema and at the given ends of the arc, both unless they are given."""
    inside = [s for s in curves.critical(curve.values) if s > after]
    places = [*([-1.0, 1.0] if ends is None else ends), *inside]
    names = [
        *(f"{key} end {s:+.0f}" for s in places[: len(places) - len(inside)]),
        *(f"{key} extremum {k}" for k in range(len(inside))),
    ]
    for name, value, slope in zip(names, *curve.at(np.array(places)), strict=True):
        yield Piece(key=name, value=float(value), gradient=slope)


def _both_signs(pieces: Iterator[Piece]) -> Iterator[Piece]:
    for piece in pieces:
        yield piece
        yield Piece(key=f"-{piece.key}", value=-piece.value, gradient=-piece.gradient)


def _total(terms: Iterator[Valued]) -> Valued:
    values, slopes = zip(*terms, strict=True)
    return float(sum(values)), np.sum(slopes, axis=0)


def _ratio(above: Valued, below: Valued) -> Valued:
    value = above[0] / below[0]
    return value, (above[1] - value * below[1]) / below[0]


def _squared(curve: Curve) -> Curve:
    return Curve(
        values=curve.values**2,
        slopes=2 * curve.values[:, None] * curve.slopes,
        duration=curve.duration,
        stretch=curve.stretch,
    )


def _quotient(above: Curve, below: Curve) -> Curve:
    values = above.values / below.values
    slopes = (above.slopes - values[:, None] * below.slopes) / below.values[:, None]
    return Curve(values=values, slopes=slopes, duration=above.duration, stretch=above.stretch)


CLEARANCE = 1e-10
"""Force or impulse, in natural units, that a design keeps from the edge of the friction cone, where optima like to lie:
more than the rounding that would decide there, and less than anyone could measure."""
SMALLEST_RADIUS = 1e-3
"""Multipliers below it are as good as zero: deviations vanish in a step."""
LEFT = 1e-3
"""Multipliers so far outside of a circle whose inequalities all hold have left it two at a time."""
FAR = 0.3
"""An inequality of the circle, a product of numbers of the order of one, that is not about to become zero."""
UNIT = 1e-3
"""A bound closer to zero than this is no unit of its scalar."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A constraint: ``value`` >= 0, or = 0.

    Attributes
    ----------
    about : the scalar, parameter or margin that it bounds; ``key`` tells it from the others.
    value : in its natural unit.
    gradient : ndarray, shape (n_u,).
    by_work : derivative in the absolute work of the motors.
    """

    about: str
    key: str
    value: float
    gradient: Array
    by_work: float = 0.0
    equality: bool = False

    @property
    def violation(self) -> float:
        """How far it is from being met."""
        return abs(self.value) if self.equality else max(0.0, -self.value)


class Radius:
    """The multipliers of a gait, and how they answer to the freed parameters."""

    def __init__(self, s: Sensitivity, slope: ResponseSlope) -> None:
        self._s, self._slope = s, slope
        self._V, self.M, self._adjoint = section_sensitivity(s.at)
        self.value = max(float(np.abs(np.linalg.eigvals(self.M)).max()), SMALLEST_RADIUS)

    def by_freed(self, weights: Array) -> Array:
        """Derivatives of the return map's derivative, weighted by a matrix; shape (n_free,)."""
        at = self._s.at
        return self._slope(at.w, at.p, self._V, self._adjoint(weights), weights) @ self._s.slopes


class Values:
    """Scalars with derivatives in u = (freed parameters, levels).

    Parameters
    ----------
    levels : names of the extrema that have a level.
    heights : the levels, shape (n_levels,); at their extrema unless given.
    """

    def __init__(
        self, scalars: Scalars, radius: Radius | None, levels: tuple[str, ...], heights: Array | None = None
    ) -> None:
        self.scalars, self._radius, self._levels = scalars, radius, levels
        self.heights = np.array([self._height(name) for name in levels]) if heights is None else heights

    def extended(self, gradient: Array, level: Array | float = 0.0) -> Array:
        """A derivative in the freed parameters with that in the levels; shape (n_u,)."""
        return np.append(gradient, np.zeros(len(self._levels)) + level)

    def single(self, name: str) -> Valued:
        """A scalar; of an extremum the one value that is it now."""
        if self._radius is not None and name == RADIUS:
            value, weights = modulus_gradient(self._radius.M)
            return value, self.extended(self._radius.by_freed(weights))
        if name not in EXTREMA:
            value, gradient = self.scalars.smooth(name)
            return value, self.extended(gradient)
        piece = self._extreme(name)
        return piece.value, self.extended(piece.gradient)

    def level(self, name: str) -> Valued:
        """A level, and its derivative as an unknown."""
        k = self._levels.index(name)
        return float(self.heights[k]), self.extended(np.zeros(self.scalars.n_free), np.eye(len(self._levels))[k])

    def beyond(self, name: str, bound: float, slope: Array, sense: int) -> Iterator[Row]:
        """No value of an extremum exceeds a bound, which is a level or a number; undercuts it where ``sense`` is -1."""
        if self._radius is not None and name == RADIUS:
            for row in circle_rows(self._radius.M, bound):
                if row.value > FAR:
                    continue
                gradient = self.extended(self._radius.by_freed(row.by_matrix)) + row.by_radius * slope
                yield Row(about=name, key=f"{name} {row.name}", value=row.value, gradient=gradient)
            return
        unit = max(abs(bound), UNIT)
        for piece in self.scalars.pieces(name):
            gradient = sense * (slope - self.extended(piece.gradient)) / unit
            value = sense * (bound - piece.value) / unit
            yield Row(about=name, key=f"{name} {piece.key}", value=value, gradient=gradient)

    def escaped(self, problem: Problem) -> bool:
        """Whether multipliers have left the circle of a bound two at a time."""
        bound = problem.constraints.get(RADIUS, Range(minimum=-np.inf, maximum=np.inf)).maximum
        if RADIUS in self._levels:
            bound = min(bound, self.level(RADIUS)[0])
        if self._radius is None or self._radius.value <= bound + LEFT:
            return False
        return all(row.value > 0 for row in circle_rows(self._radius.M, bound))

    def _height(self, name: str) -> float:
        return self._radius.value if self._radius is not None and name == RADIUS else self._extreme(name).value

    def _extreme(self, name: str) -> Piece:
        return max(self.scalars.pieces(name), key=lambda piece: EXTREMA[name] * piece.value)


def margin_rows(values: Values) -> Iterator[Row]:
    """The margins of the modes and of the impact."""
    for name, unit, piece in values.scalars.margins():
        least = CLEARANCE if "cone" in name else 0.0
        gradient = values.extended(piece.gradient) / unit
        yield Row(about=name, key=piece.key, value=piece.value / unit - least, gradient=gradient)


def span_rows(values: Values, name: str, span: Range) -> Iterator[Row]:
    """The range of one scalar."""
    fixed = values.extended(np.zeros(values.scalars.n_free))
    sense = EXTREMA.get(name, 0)
    for bound, side in ((span.minimum, -1), (span.maximum, 1)):
        if not np.isfinite(bound):
            continue
        if sense == side and span.minimum < span.maximum:
            yield from values.beyond(name, bound, fixed, sense)
            continue
        value, gradient = values.single(name)
        unit = max(abs(bound), UNIT)
        equality = span.minimum == span.maximum
        row = Row(
            about=name,
            key=f"{name} {side:+d}",
            value=side * (bound - value) / unit,
            gradient=-side * gradient / unit,
            by_work=-side * values.scalars.by_work(name) / unit,
            equality=equality,
        )
        yield row
        if equality:
            return
