"""The scalars of a result with their exact derivatives in the freed parameters.

Extrema are taken where they are, between the nodes too; the derivative of an extremum is that of the curve at its
place, since there the place does not matter. |power| is integrated between its located zeros.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, islice

import numpy as np
from casadi import MX, Function, jacobian, vertcat

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.mechanics import Mode, margin_scales
from gaitopt.mechanics.buffered import buffered
from gaitopt.nlp.design.sensitivity import ArcCurves, Curve, Sensitivity
from gaitopt.nlp.inequalities import impact_margins, is_zero_by_event
from gaitopt.nlp.multiple_shooting import MultipleShooting

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
