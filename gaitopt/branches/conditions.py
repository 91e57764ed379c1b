"""Conditions that draw curves on the surface of gaits over two parameters, with exact derivatives.

    F(w) = 0,      g(w) = 0,      w = (nodes, durations, both parameters)

F has a surface of solutions. The derivative of g is needed along its tangent plane N alone, F' N = 0, and follows there
from directional derivatives of the equations, to second order for eigenvalues. With A the derivative of the return map,

    fold             g = signed smallest singular value of A - 1 = l' (A - 1) r,           dg = l' dA r
    period doubling  the same of A + 1
    Neimark-Sacker   g = det S - 1,  S = A on the plane of a pair of multipliers,          dg = det S tr(S^-1 W' dA V)
    margin           g = a monitor of the mode sequence, at its minimum over the phase

The plane is the kernel of A^2 - 2 kappa A + g + 1, with 2 kappa = tr S, and kappa = cos theta where g vanishes. All are
regular where multipliers meet: at kappa = 1 and -1 the curve of Neimark-Sacker points ends, in strong resonances.

A acts on all coordinates of the state after the impact, so that deviations across the section have multipliers of zero.

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 10; W. Govaerts (2000), Numerical Methods for Bifurcations
of Dynamical Equilibria, ch. 4.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.branches.monitors import deflated, zero_orders
from gaitopt.gait import curves
from gaitopt.gait.curves import SHORT_ARC, lowest_after_rise
from gaitopt.gait.trace import MonitorKey
from gaitopt.model.cycle import BREAKPOINT
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import contact_of, kind, margin_unit
from gaitopt.solver.jets import Jets
from gaitopt.solver.newton import GaitEquations, Solution
from gaitopt.solver.sparse import ScaledMatrix, SparseMatrix
from gaitopt.threads import cached_property


class Condition(Protocol):
    """A function on the surface of gaits, which vanishes along the traced curve.

    Attributes
    ----------
    kind : the bifurcation at which the function vanishes, or ``margin``.
    kappa : approximate cosine of the angle of the critical pair of multipliers; 0 if there is no pair.
    """

    @property
    def kind(self) -> str:
        """The bifurcation, or ``margin``."""

    @property
    def kappa(self) -> float:
        """The approximate cosine of the angle of the critical pair."""

    def value(self, at: Solution) -> float:
        """Value of the function at a solution, in natural units."""

    def slopes(self, at: Solution, directions: Array) -> Array:
        """Derivatives of the function along directions in the surface.

        Parameters
        ----------
        directions : ndarray, shape (m, n_w).

        Returns
        -------
        slopes : ndarray, shape (m,).
        """

    def followed(self, at: Solution) -> "Condition":
        """The condition for the next step of the curve, which selects the pair of multipliers at this solution."""


@dataclass(frozen=True)
class Eigenvalue:
    """A multiplier is ``critical``: 1 at a fold, -1 at a period doubling."""

    critical: float
    kappa: ClassVar[float] = 0.0

    @property
    def kind(self) -> str:
        """The bifurcation."""
        return "fold" if self.critical > 0 else "period_doubling"

    def value(self, at: Solution) -> float:
        """The smallest singular value of A - critical, with the sign of its determinant among the others."""
        return singular_triple(at.return_map.scaled, self.critical)[0]

    def slopes(self, at: Solution, directions: Array) -> Array:
        """See ``Condition``."""
        _, left, right = singular_triple(at.return_map.scaled, self.critical)
        return at.return_map.slopes(left[:, None], right[:, None], directions)

    def followed(self, at: Solution) -> "Eigenvalue":
        """The same condition: it selects no pair."""
        return self


@dataclass(frozen=True)
class Pair:
    """Two multipliers have the product one.

    Attributes
    ----------
    kappa : half the sum of the pair at the last solution, which selects it among all pairs.
    """

    kappa: float
    kind: ClassVar[str] = "neimark_sacker"

    def value(self, at: Solution) -> float:
        """The product of the pair minus one."""
        return float(np.prod(self.multipliers(at)).real) - 1

    def slopes(self, at: Solution, directions: Array) -> Array:
        """See ``Condition``."""
        left, right, S = invariant_plane(at.return_map.scaled, self.multipliers(at))
        determinant = float(np.linalg.det(S))
        return determinant * at.return_map.slopes(left, right @ np.linalg.inv(S), directions)

    def multipliers(self, at: Solution) -> NDArray[np.complex128]:
        """The two multipliers of the pair."""
        return pair_nearest(eigenvalues(at.return_map.scaled), self.kappa)

    def followed(self, at: Solution) -> "Pair":
        """The condition with ``kappa`` of this solution."""
        return replace(self, kappa=float(self.multipliers(at).sum().real) / 2)


@dataclass(frozen=True)
class MarginZero:
    """A monitor of the mode sequence vanishes: the minimum of a margin, or the duration of a phase."""

    key: MonitorKey
    kind: ClassVar[str] = "margin"
    kappa: ClassVar[float] = 0.0

    def followed(self, at: Solution) -> "MarginZero":
        """The same condition: it selects no pair."""
        return self

    def value(self, at: Solution) -> float:
        """Value of the monitor at a solution, in natural units."""
        return float(self._series(at, np.zeros((0, 1, at.w.size)))[0, 0])

    def slopes(self, at: Solution, directions: Array) -> Array:
        """See ``Condition``."""
        return self._series(at, directions[None])[1]

    def _series(self, at: Solution, coefficients: Array) -> Array:
        """Taylor coefficients of the monitor along curves of unknowns; shape (order + 1, m).

        Parameters
        ----------
        coefficients : ndarray, shape (order, m, n_w) - from the first one on.
        """
        start = np.broadcast_to(at.w, (1, *coefficients.shape[1:]))
        jets = Jets(at.equations, at.p, np.concatenate([start, coefficients]))
        return _MonitorSeries(at, jets).of(self.key).T


def eigenvalues(A: Array) -> NDArray[np.complex128]:
    """Eigenvalues of a matrix."""
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def singular_triple(A: Array, critical: float) -> tuple[float, Array, Array]:
    """Least singular value of A - critical, with the sign of its determinant, = l' (A - critical) r; then l and r."""
    U, sizes, Vt = np.linalg.svd(A - critical * np.eye(len(A)))
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    return float(sign * sizes[-1]), sign * U[:, -1], Vt[-1]


def invariant_plane(A: Array, pair: NDArray[np.complex128]) -> tuple[Array, Array, Array]:
    """Left and right bases W, V of the invariant plane of a pair of eigenvalues, with W' V = 1, and S = W' A V."""
    U, _, Vt = np.linalg.svd(A @ A - pair.sum().real * A + np.prod(pair).real * np.eye(len(A)))
    V = Vt[-2:].T
    W = np.linalg.solve(V.T @ U[:, -2:], U[:, -2:].T).T
    return W, V, W.T @ A @ V


def pair_nearest(multipliers: NDArray[np.complex128], kappa: float) -> NDArray[np.complex128]:
    """The pair, complex conjugates or real, whose product is next to one and half the sum next to ``kappa``."""
    if multipliers.size < 2:
        return np.array([multipliers[0], 0.0])

    def distance(pair: tuple[Any, Any]) -> float:
        product, total = pair[0] * pair[1], pair[0] + pair[1]
        return float(abs(product - 1) + abs(total / 2 - kappa))

    return np.array(min(_pairs(multipliers), key=distance))


def _pairs(multipliers: NDArray[np.complex128]) -> Iterator[tuple[Any, Any]]:
    """Pairs whose product and sum are real."""
    for a, b in combinations(multipliers, 2):
        if a.imag == -b.imag:
            yield a, b


class Conditioned:
    """Unknowns with the equations of a gait and a condition: values and derivative, computed on first use."""

    def __init__(self, equations: "ConditionedEquations", solution: Solution) -> None:
        self._equations, self.solution = equations, solution

    @property
    def w(self) -> Array:
        """The unknowns."""
        return self.solution.w

    @cached_property
    def residual(self) -> Array:
        """Values of the equations; the last one is the value of the condition."""
        return np.append(self.solution.residual, self._equations.condition.value(self.solution))

    @cached_property
    def jacobian(self) -> SparseMatrix:
        """Derivative of the equations by the unknowns.

        The row of the condition has entries only at the unknowns y that define the curve. Its product with every
        direction in the surface is the derivative of the condition along this direction.
        """
        plane = self.plane
        slopes = self._equations.condition.slopes(self.solution, plane)
        Y = (plane[:, self._equations.indices] / self._equations.scales).T
        row = Y @ np.linalg.solve(Y.T @ Y, slopes) / self._equations.scales
        return self.solution.jacobian.with_row(self._equations.indices, row)

    @cached_property
    def plane(self) -> Array:
        """Two directions that span the tangent plane of the surface, orthonormal in y; shape (2, n_w)."""
        equations, at = self._equations, self.solution
        indices, scales = equations.indices, equations.scales
        rows, n = np.random.default_rng(0).standard_normal((2, indices.size)), at.residual.size
        units = np.concatenate([equations.equality_units[:-1], [1.0, 1.0]])
        right = np.eye(n + 2)[:, n:]
        for _ in range(2):  # at first across random directions, then across the plane itself
            matrix = at.jacobian.with_row(indices, rows[0] / scales).with_row(indices, rows[1] / scales)
            plane = ScaledMatrix(matrix, units, equations.unknown_units).solve(right)
            rows, triangle = np.linalg.qr(plane[indices] / scales[:, None])
            plane, rows = np.linalg.solve(triangle.T, plane.T), rows.T
        return np.asarray(plane)


class ConditionedEquations:
    """The equations of a gait with two free parameters and a condition, as ``arclength`` takes them.

    Parameters
    ----------
    gaits : the equations of the gait.
    indices, scales : indices and scales of those unknowns y that define a curve of gaits.
    """

    def __init__(self, gaits: GaitEquations, condition: Condition, indices: NDArray[np.intp], scales: Array) -> None:
        self.gaits, self.condition, self.indices, self.scales = gaits, condition, indices, scales

    @property
    def unknown_units(self) -> Array:
        """Natural units of the unknowns."""
        return self.gaits.unknown_units

    @cached_property
    def equality_units(self) -> Array:
        """Natural units of the equations."""
        return np.append(self.gaits.equality_units, 1.0)

    def violation(self, w: Array) -> Array:
        """Values of the equations."""
        return self.at(w).residual

    def at(self, w: Array) -> Conditioned:
        """The unknowns with values and derivative."""
        return Conditioned(self, self.gaits.at(w))


class _MonitorSeries:
    """Taylor coefficients of monitors along curves of unknowns, as ``monitors`` defines their values.

    The time of a minimum does not move to first order, or is that of an end.
    """

    def __init__(self, at: Solution, jets: Jets) -> None:
        self.at, self.jets, self.cycle = at, jets, at.equations.mesh.cycle
        self.system, self.arcs = at.equations.system, at.equations.mesh.arcs
        self.table = self.system.transitions
        self.dynamics = at.equations.dynamics(at.p, at.equations.unpack(at.w).freed)
        self.period = jets.durations.sum(axis=2)

    def of(self, key: MonitorKey) -> Array:
        """Coefficients of one monitor; shape (m, order + 1)."""
        if key.kind == "duration":
            return _quotient(self.jets.durations[:, :, key.phase], self.period)
        if key.kind == BREAKPOINT:
            return self._to_breakpoint(key)
        phase, unit = key.phase, margin_unit(key.kind, self.dynamics.scales)
        if phase is not None and kind(key.kind) in ("onset", "pull"):
            return self._at_start(key.kind, phase) / unit
        if phase is not None and key.kind in (rows := self.table.of(self.cycle.phases[phase])):
            along = self._after_rise if rows[key.kind].margin.rises else self._lowest
            return along(key.kind, phase, unit)
        if phase is None:
            phase = (self.cycle.first_phases[(key.step + 1) % len(self.cycle.steps)] - 1) % len(self.cycle.phases)
        struck, mode = self.table.struck(self.cycle, phase), self.cycle.phases[phase]
        assert struck is not None
        states = self.jets.nodes[:, :, [self.at.equations.mesh.last_nodes[phase]]]
        margins = self.system.impact_margins(struck, mode)
        values = self.jets.at_phase(margins, phase, np.zeros(states.shape[:3]), states)
        return np.asarray(values[:, :, 0, self.table.impact_margin_names(struck, mode).index(key.kind)] / unit)

    def _to_breakpoint(self, key: MonitorKey) -> Array:
        """Time between the end of a phase and the breakpoint next to it, relative to the period."""
        assert key.phase is not None
        first, times = self.cycle.first_phases[self.cycle.step_of(key.phase)], self.system.control.breakpoints
        segment = next(arc.segment for arc in reversed(self.arcs) if arc.phase == key.phase)
        end = self.jets.durations[:, :, first : key.phase + 1].sum(axis=2)
        sides = [(sign, times[k]) for sign, k in ((-1.0, segment - 1), (1.0, segment)) if 0 <= k < len(times)]
        sign, time = min(sides, key=lambda side: abs(side[1] - end[0, 0]))
        end[:, 0] -= time
        return _quotient(-sign * end, self.period)

    def _at_start(self, name: str, phase: int) -> Array:
        """The excess that starts a slip or a flight: minus the margin of the mode before it, at its start."""
        index = next(k for k, arc in enumerate(self.arcs) if arc.phase == phase)
        if phase - 1 in self.cycle.timed:
            mode = self.cycle.phases[phase - 1]
            guard = self.table.between(mode, self.cycle.phases[phase]).guard
        else:
            mode, guard = self.table.sticking(self.cycle.phases[phase], contact_of(name))
        times, states = self.jets.samples(index, np.zeros(1))
        return -self._margin(mode, guard, index, times, states)[:, :, 0]

    def _lowest(self, name: str, phase: int, unit: float) -> Array:
        """The lowest value over a phase of a margin whose zeros at the ends are removed."""
        indices = [k for k, arc in enumerate(self.arcs) if arc.phase == phase]
        orders = zero_orders(self.table, self.cycle, phase, name, drops=self.dynamics.friction_drops)
        minima = []
        for k in indices:
            times, states = self._sampled(k)
            if len(indices) > 1 and times[0, 0, -1] - times[0, 0, 0] <= SHORT_ARC * self.period[0, 0]:
                continue
            along = self._margin(self.arcs[k].mode, name, k, times, states) / unit
            start, end = orders[0] * (k == indices[0]), orders[1] * (k == indices[-1])
            minima.append(_value_at(deflated(along, start, end)))
        return min(minima, key=lambda minimum: float(minimum[0, 0]))

    def _after_rise(self, name: str, phase: int, unit: float) -> Array:
        """The lowest value of a margin after it has risen in the swing of a phase."""
        swing = [k for k, arc in enumerate(self.arcs) if self.cycle.swings[arc.phase] == self.cycle.swings[phase]]
        indices = [k for k in swing if name in self.table.of(self.arcs[k].mode)]
        samples = [self._sampled(k) for k in indices]
        along = [
            self._margin(self.arcs[k].mode, name, k, *each) / unit for k, each in zip(indices, samples, strict=True)
        ]
        starts = [times[0, 0] for times, _ in samples]
        lowest, time = lowest_after_rise(starts, [each[0, 0] for each in along])
        if not lowest < np.inf:
            raise RuntimeError(f"{name} has no minimum any more")
        times, values = next(pair for pair in zip(starts, along, strict=True) if pair[0][0] <= time <= pair[0][-1])
        return _value_at(values, 2 * (time - times[0]) / (times[-1] - times[0]) - 1)

    def _sampled(self, index: int) -> tuple[Array, Array]:
        """Times and states of an arc, with their coefficients, at enough Chebyshev points."""
        at, units = self.at, self.dynamics.state_units
        for count in curves.COUNTS:
            times, states = at.equations.sample(at.w, at.p, index, count)
            if curves.tail(states / units) < curves.RESOLVED:
                break
        if self.jets.order == 0:  # these are the values; one curve will do
            return times[None, None], states[None, None]
        return self.jets.samples(index, (curves.points(count) + 1) / 2)

    def _margin(self, mode: Mode, name: str, index: int, times: Array, states: Array) -> Array:
        """A margin of a mode at times and states of an arc; shape (m, order + 1, count)."""
        arc = self.arcs[index]
        values = self.jets.at_phase(self.system.margins(mode), arc.phase, times, states, arc.segment)
        return np.asarray(values[..., self.table.margin_names(mode).index(name)])


def _quotient(a: Array, b: Array) -> Array:
    """The quotient of two series, by columns."""
    result = np.empty_like(a)
    for k in range(a.shape[1]):
        known = sum((result[:, j] * b[:, k - j] for j in range(k)), np.zeros(len(a)))
        result[:, k] = (a[:, k] - known) / b[:, 0]
    return result


def _value_at(values: Array, position: float | None = None) -> Array:
    """The curve through values (m, order + 1, count) at a position from -1 to 1, by default that of its minimum."""
    s = curves.maximum(-values[0, 0])[0] if position is None else position
    return np.asarray(
        curves.evaluate(curves.coefficients(np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1)), np.array(s))
    ).reshape(values.shape[:2])
