"""The multipliers' largest modulus as a smooth function of the NLP's unknowns, bounded from above, with its gradient.

The equalities F, differentiated along deviations V = (nodes, durations) that start on the section, give the return
map's derivative; the durations answer to the events, which is saltation without its formula:

    A V = B,      DPi = R V_K            A = dF/dw with the section in the place of periodicity, R that of the impact

A radius rho with

    P = (DPi / rho)' P (DPi / rho) + eps I,      P > 0,      trace P = 1

exceeds every multiplier's modulus, because xi' P xi falls by more than rho^2 with every step. It is smooth where
multipliers meet, cross, turn complex or vanish: the smoothed spectral radius of Vanbiervliet, Vandereycken, Michiels,
Vandewalle & Diehl (2009), in discrete time. Its gradient, with the adjoints X of P and Lambda of V:

    X = (DPi / rho) X (DPi / rho)' + I,      G = P DPi X / trace(DPi' P DPi X) rho,      A' Lambda = R' G
    d rho = <G, dR V_K> + <Lambda, dB - dA V>
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from casadi import DM, MX, Callback, Function, Sparsity, dot, gradient, jtimes, vertcat

from gaitopt.arrays import Array
from gaitopt.iteration import bracketed_root, overflow_allowed
from gaitopt.model.buffered import BufferedFunction
from gaitopt.model.modes import Mode
from gaitopt.nlp.newton import Solution, section_sensitivity
from gaitopt.nlp.shooting import MultipleShooting

EPSILON = 1e-6
"""A matrix of norm N is certified with a radius whose square exceeds that of its largest modulus by some eps N^2;
after a slip that sticks again N is a hundred."""
NARROWEST = 1e-8
"""Relative distance of radius and largest modulus, from where the radius is searched upwards: trace P > 1 there."""
FAR = 50.0
"""Stands for the logarithm of an infinite trace."""
SMALLEST = 1e-3
"""Multipliers below it are as good as zero: deviations vanish in a step."""


def certified_radius(transcription: MultipleShooting) -> Function:
    """(w, p) -> bound of the multipliers' moduli, with an exact gradient; keep it as long as an NLP uses it."""
    return _Radius(transcription)


class _Radius(Callback):
    """(w, p) -> rho."""

    def __init__(self, transcription: MultipleShooting) -> None:
        super().__init__()
        self._t, self._cache = transcription, _SensitivityCache(transcription)
        self._gradient: _Gradient | None = None
        self.construct("radius", {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Sparsity:
        return Sparsity.dense((self._t.w, self._t.parameters)[i].numel(), 1)

    def eval(self, arg: Sequence[DM]) -> list[DM]:
        answer = self._cache.at(*(np.asarray(value).ravel() for value in arg))
        return [DM(np.nan if answer is None else answer.radius)]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(
        self, name: str, inames: Sequence[str], onames: Sequence[str], opts: Mapping[str, Any]
    ) -> Function:
        self._gradient = _Gradient(self._t, self._cache, name, opts)
        return self._gradient


class ResponseSlope:
    """Derivative of <G, DPi> in the unknowns w, the return map's derivative DPi weighted by a matrix G."""

    def __init__(self, t: MultipleShooting) -> None:
        system, n_z = t.system, t.system.n_z
        section = [int(i) for i in system.section(t.layout.cycle.impact)]
        n = t.equalities.numel()
        V, adjoint = MX.sym("V", n, len(section)), MX.sym("Lambda", n, len(section))
        G = MX.sym("G", len(section), len(section))
        still = MX.zeros(len(t.free), len(section))
        moved = jtimes(t.equalities[:-n_z], t.w, vertcat(V, still))
        xi = t.Z[system.section(Mode.SLIP_FORWARD), 0]
        start = system.lift_jacobian(xi, t.p)[:, : len(section)]
        reset = system.impact_jacobian(t.layout.cycle.impact)(t.Z[:, -1], t.p)[section, :]
        last = V[(t.n_nodes - 1) * n_z : t.n_nodes * n_z, :]
        product = dot(G, reset @ last) + dot(adjoint[-n_z:, :], start) - dot(adjoint[:-n_z, :], moved)
        function = Function("product", [t.w, t.parameters, V, adjoint, G], [gradient(product, t.w)])
        self._product = BufferedFunction(function)

    def __call__(self, w: Array, p: Array, V: Array, adjoint: Array, G: Array) -> Array:
        """The derivative, shape (n_w,); V and adjoint as in ``newton.section_sensitivity``."""
        matrices = (matrix.ravel(order="F") for matrix in (V, adjoint, G))
        return self._product(w, p, *matrices)[0].copy()


class _Gradient(Callback):
    """(w, p, rho) -> d rho / dw and, never used, zero for d rho / dp."""

    def __init__(
        self, transcription: MultipleShooting, answers: "_SensitivityCache", name: str, options: Mapping[str, Any]
    ) -> None:
        super().__init__()
        self._t, self._cache = transcription, answers
        self._slope = ResponseSlope(transcription)
        self.construct(name, options)

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> Sparsity:
        return Sparsity.dense((self._t.w, self._t.parameters, MX(1, 1))[i].numel(), 1)

    def get_sparsity_out(self, i: int) -> Sparsity:
        return Sparsity.dense(1, self._t.w.numel()) if i == 0 else Sparsity(1, self._t.parameters.numel())

    def eval(self, arg: Sequence[DM]) -> list[DM]:
        w, p, _ = (np.asarray(value).ravel() for value in arg)
        answer = self._cache.at(w, p)
        if answer is None:
            return [DM(np.full((1, w.size), np.nan)), DM(1, p.size)]
        G = radius_gradient(answer.M, answer.radius, answer.P)
        return [DM(self._slope(w, p, answer.V, answer.adjoint(G), G)).T, DM(1, p.size)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sensitivity:
    """Deviations V of the step, M of the return map, M's certified radius with P, and the adjoint of V's equations."""

    V: Array
    M: Array
    adjoint: Callable[[Array], Array]
    radius: float
    P: Array


class _SensitivityCache:
    """How the step answers to deviations; the last answer is kept, for IPOPT evaluates value and slope in turn."""

    def __init__(self, transcription: MultipleShooting) -> None:
        self._t = transcription
        self._key: tuple[bytes, bytes] | None = None
        self._answer: _Sensitivity | None = None

    def at(self, w: Array, p: Array) -> _Sensitivity | None:
        """The answer, or None where it is not definite."""
        key = (w.tobytes(), p.tobytes())
        if key != self._key:
            self._key, self._answer = key, self._evaluated(w, p)
        return self._answer

    @overflow_allowed()
    def _evaluated(self, w: Array, p: Array) -> _Sensitivity | None:
        if not np.isfinite(w).all():
            return None
        try:
            V, M, adjoint = section_sensitivity(Solution(self._t, w, p))
        except RuntimeError:  # singular
            return None
        if not np.isfinite(M).all():
            return None
        radius, P = smoothed_radius(M)
        return _Sensitivity(V=V, M=M, adjoint=adjoint, radius=radius, P=P)


def smoothed_radius(M: Array) -> tuple[float, Array]:
    """The least certified radius of a matrix, and its P; shape (n, n)."""
    n = len(M)
    largest = max(float(np.abs(np.linalg.eigvals(M)).max()), SMALLEST)

    def lyapunov(radius: float) -> Array:
        return _lyapunov(M.T / radius, EPSILON * np.eye(n))

    def excess(radius: float) -> float:
        trace = float(np.trace(lyapunov(radius)))
        return float(np.log(trace)) if trace > 0 else FAR  # below the largest modulus, by rounding

    ceiling = 2 * max(largest, float(np.linalg.norm(M, 2)))
    radius = bracketed_root(excess, largest * (1 + NARROWEST), ceiling, 1e-14)
    return radius, lyapunov(radius)


def radius_gradient(M: Array, radius: float, P: Array) -> Array:
    """Derivative of the certified radius in the entries of the matrix; shape (n, n)."""
    weight = P @ M @ _lyapunov(M / radius, np.eye(len(M)))
    return np.asarray(weight * radius / np.trace(M.T @ weight))


def _lyapunov(A: Array, Q: Array) -> Array:
    """X = A X A' + Q for a matrix so small that Kronecker's product does; shape (n, n)."""
    n = len(A)
    return np.asarray(np.linalg.solve(np.eye(n * n) - np.kron(A, A), Q.ravel()).reshape(n, n), dtype=np.float64)
