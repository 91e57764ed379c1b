"""The spectral radius of a gait's return map as an objective or a constraint, with exact gradients.

Two formulations bound it. Both need M = DPi, the derivative of the return map; see ``solver.return_map``.

**Smoothed radius**, for IPOPT. A radius rho with

    P = (M / rho)' P (M / rho) + eps I,      P > 0,      trace P = 1

exceeds the modulus of every multiplier, because xi' P xi falls by more than rho^2 with every step. It is smooth where
multipliers meet, cross, turn complex or vanish: Vanbiervliet, Vandereycken, Michiels, Vandewalle & Diehl (2009), here
in discrete time. Its gradient by M, with the adjoint X of P:

    X = (M / rho) X (M / rho)' + I,      G = P M X / trace(M' P M X) rho,      d rho = <G, dM>

**Circle inequalities**, for the exact problem. With C = M / rho and its second compound C ^ C, whose eigenvalues are
the products of two:

    det(I - C) >= 0,     det(I + C) >= 0,     det(I - C ^ C) >= 0

On the boundary of the matrices whose multipliers lie within rho, there is a multiplier at rho, one at -rho, or a
complex pair on the circle (Jury 1964). The inequalities are smooth where multipliers coalesce; the modulus there is not
even Lipschitz. They hold again after two multipliers have left the circle together, so that they serve only near a
solution.
"""

from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from casadi import DM, Function, Sparsity
from numpy.typing import NDArray

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.building import building
from gaitopt.gait.zero_dynamics import has_zero_dynamics, unactuated_direction
from gaitopt.integration import bracketed_root
from gaitopt.model.buffered import NumericFunction
from gaitopt.model.modes import Mode
from gaitopt.model.virtual_constraints import VirtualConstraints
from gaitopt.solver.newton import Solution
from gaitopt.solver.return_map import MapDerivatives
from gaitopt.solver.shooting import MultipleShooting

RADIUS = "spectral_radius"
EPSILON = 1e-6
"""The square of the certified radius of a matrix of norm N exceeds that of its spectral radius by about eps N^2; N is a
hundred where a slip sticks again."""
NARROWEST = 1e-8
"""The search for the radius starts at this relative distance above the largest modulus, where trace P > 1."""
INFINITE_LOG = 50.0
"""Number that replaces the logarithm of an infinite trace."""
SMALLEST_RADIUS = 1e-3
"""Modulus below which multipliers count as zero: deviations vanish within a step."""


def certified_radius(equations: MultipleShooting) -> Function:
    """(w, p) -> bound of the multipliers' moduli, with an exact gradient; NaN where the return map has none.

    It must be kept as long as a nonlinear program uses it.
    """
    known, n_w, n_p = _Certificates(equations), equations.w.numel(), equations.parameters.numel()

    def radius(w: Array, p: Array) -> tuple[float]:
        certificate = known.at(w, p)
        return (np.nan if certificate is None else certificate.radius,)

    def gradient(w: Array, p: Array, _: Array) -> tuple[Array, DM]:
        """d rho / dw, and zero for d rho / dp, which is never used."""
        certificate = known.at(w, p)
        if certificate is None:
            return np.full((1, w.size), np.nan), DM(1, p.size)
        G = radius_gradient(certificate.linear.by_section, certificate.radius, certificate.P)
        return certificate.linear.gradient(G)[None, :], DM(1, p.size)

    slopes = (Sparsity.dense(1, n_w), Sparsity(1, n_p)), gradient
    return NumericFunction("radius", (n_w, n_p), (Sparsity.dense(1, 1),), radius, derivatives=slopes)


@building
def zero_dynamics_radius(equations: MultipleShooting, w: Array, p: Array) -> Function | None:
    """(w, p) -> delta_zero^2, the multiplier of an invariant gait that sticks; None for any other gait.

    The other multipliers are those of the outputs, whose decay the gains determine. A certified radius takes ten times
    longer.

    Parameters
    ----------
    w, p : a motion, which determines the direction without a motor.
    """
    t, system, cycle = equations, equations.system, equations.mesh.cycle
    sticks = len(t.mesh.arcs) == 1 and {*cycle.phases, cycle.impact} == {Mode.STICK}
    law = system.control
    if not (sticks and has_zero_dynamics(system) and isinstance(law, VirtualConstraints) and law.is_invariant):
        return None
    momentum, data = system.momentum(Mode.STICK), system.data(0)
    E = np.asarray(momentum(t=0.0, z=t.unpack(w).nodes[:, 0], p=p, r=data)["E"]).T
    d = DM(unactuated_direction(system, E))
    sigma = [momentum(t=0.0, z=t.Z[:, k], p=t.p, r=data)["momentum"].T @ d for k in (0, -1)]
    return Function("zero_dynamics", [t.w, t.parameters], [(sigma[0] / sigma[1]) ** 2])


class _Certificate(NamedTuple):
    """The return map, the certified radius of its derivative M, and its P."""

    linear: MapDerivatives
    radius: float
    P: Array


class _Certificates:
    """The certificates of motions. The last one is kept, because IPOPT needs radius and gradient at the same point."""

    def __init__(self, equations: MultipleShooting) -> None:
        self._equations = equations
        self._key: tuple[bytes, bytes] | None = None
        self._certificate: _Certificate | None = None

    @overflow_allowed()
    def at(self, w: Array, p: Array) -> _Certificate | None:
        """The certificate of a motion; None if the derivative of the return map is not finite or too large."""
        key = (w.tobytes(), p.tobytes())
        if key == self._key:
            return self._certificate
        self._key, self._certificate = key, None
        if not np.isfinite(w).all():
            return None
        try:
            linear = Solution(self._equations, w, p).return_map
            M = linear.by_section
        except RuntimeError:  # singular
            return None
        if np.isfinite(M).all():
            with suppress(ValueError):  # rounding hides the radius of a matrix that is very large
                self._certificate = _Certificate(linear, *smoothed_radius(M))
        return self._certificate


def smoothed_radius(M: Array) -> tuple[float, Array]:
    """The smallest certified radius of a matrix (n, n), and its P; shape (n, n)."""
    n = len(M)
    largest = max(float(np.abs(np.linalg.eigvals(M)).max()), SMALLEST_RADIUS)

    def lyapunov(radius: float) -> Array:
        return _lyapunov(M.T / radius, EPSILON * np.eye(n))

    def excess(radius: float) -> float:
        with suppress(np.linalg.LinAlgError):
            trace = float(np.trace(lyapunov(radius)))
            if trace > (1 if radius == lowest else 0):  # otherwise rounding hides that it is infinite
                return float(np.log(trace))
        return INFINITE_LOG

    lowest, ceiling = largest * (1 + NARROWEST), 2 * max(largest, float(np.linalg.norm(M, 2)))
    radius = bracketed_root(excess, lowest, ceiling, 1e-14)
    return radius, lyapunov(radius)


def radius_gradient(M: Array, radius: float, P: Array) -> Array:
    """Derivative of the certified radius by the entries of the matrix; shape (n, n)."""
    weight = P @ M @ _lyapunov(M / radius, np.eye(len(M)))
    return np.asarray(weight * radius / np.trace(M.T @ weight))


def _lyapunov(A: Array, Q: Array) -> Array:
    """X = A X A' + Q by Kronecker's product, which suits small matrices; shape (n, n).

    SciPy solves it in the same way, but its import takes a fifth of the time of a design.
    """
    n = len(A)
    product = (A[:, None, :, None] * A[None, :, None, :]).reshape(n * n, n * n)  # np.kron takes five times as long
    return np.asarray(np.linalg.solve(np.eye(n * n) - product, Q.ravel()).reshape(n, n), dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class CircleInequality:
    """``value`` >= 0 with its derivatives by the matrix, shape (n, n), and by the radius."""

    name: str
    value: float
    by_matrix: Array
    by_radius: float


def circle_inequalities(M: Array, radius: float) -> list[CircleInequality]:
    """The inequalities for a matrix (n, n) and a radius; a single multiplier has none for pairs."""
    n = len(M)
    C, identity = M / radius, np.eye(n)
    rows = [
        ("real", identity - C, -_adjugate(identity - C).T),
        ("negative", identity + C, _adjugate(identity + C).T),
    ]
    if n > 1:
        i, j = np.array(list(combinations(range(n), 2))).T
        minors = C[np.ix_(i, i)] * C[np.ix_(j, j)] - C[np.ix_(i, j)] * C[np.ix_(j, i)]
        inside = np.eye(i.size) - minors
        by_minors, by_C = -_adjugate(inside).T, np.zeros_like(C)
        np.add.at(by_C, np.ix_(i, i), by_minors * C[np.ix_(j, j)])
        np.add.at(by_C, np.ix_(j, j), by_minors * C[np.ix_(i, i)])
        np.add.at(by_C, np.ix_(i, j), -by_minors * C[np.ix_(j, i)])
        np.add.at(by_C, np.ix_(j, i), -by_minors * C[np.ix_(i, j)])
        rows.append(("pair", inside, by_C))
    return [
        CircleInequality(
            name=name,
            value=float(np.linalg.det(inside)),
            by_matrix=by_C / radius,
            by_radius=-float(np.vdot(by_C, C)) / radius,
        )
        for name, inside, by_C in rows
    ]


def _adjugate(A: Array) -> Array:
    """det(A) A^-1, for singular matrices too; shape (n, n)."""
    U, s, Vt = np.linalg.svd(A)
    others = np.array([np.prod(np.delete(s, k)) for k in range(s.size)])
    return np.asarray(np.linalg.det(U) * np.linalg.det(Vt) * (Vt.T * others) @ U.T)


def modulus_gradient(M: Array) -> tuple[float, Array]:
    """Spectral radius of a matrix and its gradient, shape (n, n), where the dominant eigenvalue is simple."""
    (value, *_), (slope, *_) = eigenvalue_gradients(M)
    return float(np.abs(value)), np.real(np.conj(value) * slope / np.abs(value))


def eigenvalue_gradients(M: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Eigenvalues of a matrix (n, n), largest modulus first, and the gradient of each one that is simple, (n, n, n)."""
    values, right = np.linalg.eig(M)
    order = np.argsort(-np.abs(values), kind="stable")
    left = np.linalg.inv(right)
    return values[order].astype(complex), np.einsum("ki,jk->kij", left, right)[order].astype(complex)
