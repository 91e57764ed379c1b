"""Normal forms of bifurcations: coefficients that say whether stability is lost softly or hard.

On the centre manifold of a fixed point of the return map, with critical eigenvectors A q = mu q, A' p = mu p, |q| = 1,
<p, q> = 1, and the derivatives B and C of second and third order,

    fold             x -> x + b x^2                 b = <p, B(q, q)> / 2
    period doubling  x -> -x + c x^3                c = <p, C(q, q, q) + 3 B(q, (1 - A)^-1 B(q, q))> / 6
    Neimark-Sacker   z -> e^(i theta) z (1 + d |z|^2)
        d = e^(-i theta) <p, C(q, q, q*) + 2 B(q, (1 - A)^-1 B(q, q*)) + B(q*, (e^(2 i theta) - A)^-1 B(q, q))> / 2

With c > 0 the doubled gait is stable, with Re d < 0 the torus, if all other multipliers lie inside the unit circle. B
and C follow from Taylor coefficients of the shooting equations along the eigenvectors, solved order by order with the
factors of one matrix. Lengths are those of section coordinates in natural units.

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, section 5.4.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.branches.conditions import eigenvalues, pair_nearest, singular_triple
from gaitopt.gait.gait import Gait
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.newton import Solution

RESONANT = 1e-4
"""Distance of cos theta from that of a resonance 1:1 to 1:4 below which a Neimark-Sacker point has no normal form."""
CRITICAL = 1e-6
"""A multiplier counts as critical if its distance from the unit circle is below this number."""
RESONANCES = {"resonance_1_1": 1.0, "resonance_1_2": -1.0, "resonance_1_3": -0.5, "resonance_1_4": 0.0}
"""cos theta at the strong resonances."""
Taylor = Callable[[Array, int], Array]
"""A function of directions a, shape (m, n), and an order. It returns A a, B(a, a) / 2 and C(a, a, a) / 6 up to this
order, shape (order, m, n)."""
KINDS: Mapping[str, float | None] = {"fold": 1.0, "period_doubling": -1.0, "neimark_sacker": None}
"""The critical multiplier of every bifurcation; None where it is a pair on the unit circle."""


@dataclass(frozen=True)
class LocalMap:
    """The first three derivatives A, B and C of a map at a fixed point.

    Attributes
    ----------
    A : ndarray, shape (n, n) - first derivative.
    taylor : Taylor coefficients along real directions.
    section : indices of the coordinates in which lengths are measured.
    """

    A: Array
    taylor: Taylor
    section: NDArray[np.intp]

    def B(self, a: Array, b: Any) -> Any:
        """B(a, b), where a is real and b may be complex."""
        parts = [b] if np.isrealobj(b) else [b.real, b.imag]
        halves = self.taylor(np.array([sign_a for part in parts for sign_a in (a + part, a - part)]), 2)[1]
        values = (halves[::2] - halves[1::2]) / 2
        return values[0] if len(values) == 1 else values[0] + 1j * values[1]

    def critical(self, kind: str, kappa: float = 0.0) -> tuple[Any, Any, complex]:
        """Left and right eigenvectors p, q of the critical multiplier with |q| = 1 on the section, and this multiplier.

        p is not scaled. ``kappa``, the approximate cos theta of a pair, selects one of several pairs.
        """
        critical = KINDS[kind]
        if critical is None:
            pair = pair_nearest(eigenvalues(self.A), kappa)
            multiplier = complex(max(pair, key=lambda value: float(value.imag)))
            U, _, Vh = np.linalg.svd(self.A - multiplier * np.eye(len(self.A)))
            p, q = U[:, -1], Vh[-1].conj()
        else:
            multiplier = complex(critical)
            _, p, q = singular_triple(self.A, critical)
        return p, q / np.linalg.norm(q[self.section]), multiplier


def fold_coefficient(local: LocalMap, p: Array, q: Array) -> float:
    """The coefficient b of a fold, times <p, q>."""
    return float(p @ local.taylor(q[None], 2)[1, 0])


def flip_coefficient(local: LocalMap, p: Array, q: Array) -> float:
    """The coefficient c of a period doubling, times <p, q>."""
    _, half_B, sixth_C = local.taylor(q[None], 3)[:, 0]
    along = np.linalg.solve(np.eye(len(q)) - local.A, 2 * half_B)
    return float(p @ (6 * sixth_C + 3 * local.B(q, along))) / 6


def torus_coefficient(local: LocalMap, p: Any, q: Any, multiplier: complex) -> complex:
    """The coefficient d of a Neimark-Sacker point, times <p, q>.

    B and C of q = a + i b follow from those along a, b, a + b and a - b.
    """
    a, b, identity = q.real, q.imag, np.eye(len(q))
    _, halves, sixths = local.taylor(np.array([a, b, a + b, a - b]), 3)
    aa, bb, ab = 2 * halves[0], 2 * halves[1], (halves[2] - halves[3]) / 2
    aaa, bbb, plus, minus = 6 * sixths
    aab, abb = ((plus - minus) / 2 - bbb) / 3, ((plus + minus) / 2 - aaa) / 3
    steady = np.linalg.solve(identity - local.A, aa + bb)
    double = np.linalg.solve(multiplier**2 * identity - local.A, aa - bb + 2j * ab)
    value = aaa + abb + 1j * (aab + bbb)
    value = value + 2 * (local.B(a, steady) + 1j * local.B(b, steady)) + local.B(a, double) - 1j * local.B(b, double)
    return complex(p.conj() @ value / multiplier / 2)


def coefficients(local: LocalMap, kind: str, kappa: float = 0.0) -> dict[str, float | None]:
    """The coefficients of the normal form of a bifurcation by name; None where a resonance leaves it undefined.

    Parameters
    ----------
    kind : ``fold``, ``period_doubling`` or ``neimark_sacker``.
    kappa : approximate cos theta of the critical pair.
    """
    p, q, multiplier = local.critical(kind, kappa)
    scale = p.conj() @ q
    if kind == "neimark_sacker":
        names = ("re_d", "im_d")
        if min(abs(multiplier.real - strong) for strong in RESONANCES.values()) < RESONANT:
            return dict.fromkeys(names)
        d = torus_coefficient(local, p, q, multiplier / abs(multiplier)) / complex(scale)
        return dict(zip(names, (d.real, d.imag), strict=True))
    if abs(scale) < RESONANT * np.linalg.norm(p) * np.linalg.norm(q):  # a double multiplier
        return {"b" if kind == "fold" else "c": None}
    if kind == "fold":
        return {"b": fold_coefficient(local, p, q) / float(scale)}
    return {"c": flip_coefficient(local, p, q) / float(scale)}


def local_map(at: Solution) -> LocalMap:
    """The return map of a solution, in natural units and in all coordinates of the state after the impact."""
    section = at.equations.system.section(at.equations.mesh.cycle)
    return LocalMap(at.return_map.scaled, at.return_map.taylor, section.indices)


def gait_coefficients(kind: str, gait: Gait) -> dict[str, float | None]:
    """The normal form at a special point of a branch; empty if the point is none of these bifurcations."""
    if kind not in KINDS or gait.shooting is None:
        return {}
    try:
        return coefficients(local_map(solution_of(gait)), kind, critical_kappa(gait))
    except RuntimeError:  # singular: a slip of no length
        return {}


def critical_kappa(gait: Gait) -> float:
    """Approximate cos theta of the pair of multipliers that is next to the unit circle; 0 if no pair is complex."""
    pair = min((m for m in gait.multipliers if m.imag > 0), key=lambda m: abs(abs(m) - 1), default=0.0)
    return float(np.real(pair))


def stability_loss(form: Mapping[str, float | None], multipliers: NDArray[np.complex128]) -> str:
    """A sentence on how the gait loses its stability at a bifurcation; empty for a fold or a resonance.

    Parameters
    ----------
    multipliers : all multipliers of the gait.
    """
    c, d = form.get("c"), form.get("re_d")
    if c is None and d is None:
        return ""
    if (np.abs(multipliers) > 1 + CRITICAL).any():
        return "the gait is unstable on both sides"
    born, soft = ("doubled gait", c > 0) if c is not None else ("torus", d is not None and d < 0)
    return f"a {'soft' if soft else 'hard'} loss of stability, the {born} is {'stable' if soft else 'unstable'}"
