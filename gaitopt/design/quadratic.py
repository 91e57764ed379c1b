"""Strictly convex quadratic programs as problems of least distance: Lawson & Hanson (1974), chapter 23.

    min  g' d + d' H d / 2    s.t.  A d + b >= 0

With H = L L' and y = L' d + L^-1 g it is that of the shortest y in a polyhedron, solved by nonnegative least squares.

Where a design is searched: bounds that keep it near its start, and sizes in which IPOPT sees the unknowns.

In one search angles, rates and slip velocity at a node change by no more than their largest value in the step, so that
it keeps clear of motions that are no walk. The same values are their sizes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.nlp.shooting import MultipleShooting

LONGEST = 3.0
"""No phase grows longer in one search than so many periods."""
NEAR = 1e-6
"""Part of the reach within which a solution counts as kept by it."""
SMALL = 1e-3
"""Bounds, extrema and objectives closer to zero than this do not set a scale."""
SMALLEST_PART = 0.02
"""Typical size of a freed parameter is at least this part of the range of its bounds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Start, bounds and sizes of nodes, durations, freed parameters, extrema and slacks; all of shape (n,)."""

    start: Array
    lower: Array
    upper: Array
    sizes: Array
    n_nodes: int

    def hits_trust_region(self, x: Array) -> bool:
        """Whether a solution lies on the boundary of the trust region."""
        nodes = slice(0, self.n_nodes)
        room = np.minimum(x - self.lower, self.upper - x)[nodes]
        return bool(np.any(room < NEAR * (self.upper - self.lower)[nodes]))


def search(transcription: MultipleShooting, w: Array, p: Array, bounds: Array, extrema: Array, n_slack: int) -> Search:
    """The search from ``w``.

    Parameters
    ----------
    p : parameters.
    bounds : of the freed parameters; shape (2, n_free).
    extrema : their values at ``w``; unbounded.
    n_slack : number of slacks, which start at one.
    """
    nodes, durations, freed = transcription.unpack(w)
    states = _state_sizes(transcription, nodes, durations, p)
    reach = states.copy()
    reach[transcription.system.n_shape] = np.inf
    reach = np.tile(reach, transcription.n_nodes)
    longest, free = np.full(durations.size, LONGEST * durations.sum()), np.full(extrema.size, np.inf)
    least, most = np.zeros(n_slack), np.full(n_slack, np.inf)
    return Search(
        start=np.concatenate([w, extrema, np.ones(n_slack)]),
        lower=np.concatenate([w[: nodes.size] - reach, np.zeros(durations.size), bounds[0], -free, least]),
        upper=np.concatenate([w[: nodes.size] + reach, longest, bounds[1], free, most]),
        sizes=np.concatenate(
            [
                np.tile(states, transcription.n_nodes),
                np.full(durations.size, durations.sum()),
                freed_sizes(freed, bounds),
                np.maximum(np.abs(extrema), SMALL),
                np.ones(n_slack),
            ]
        ),
        n_nodes=nodes.size,
    )


def freed_sizes(freed: Array, bounds: Array) -> Array:
    """Typical sizes of the freed parameters, from their values and bounds (2, n_free); shape (n_free,)."""
    span = bounds[1] - bounds[0]
    return np.clip(np.abs(freed), SMALLEST_PART * span, span)


def _state_sizes(t: MultipleShooting, nodes: Array, durations: Array, p: Array) -> Array:
    """Largest angle, position, rate and slip velocity of the step; shape (n_z,)."""
    n = t.system.n_shape
    length = abs(float(t.system.impact(t.layout.cycle.impact)(z=nodes[:, -1], p=p)["z_plus"][n]))
    largest = np.abs(nodes).max(axis=1)
    slip = max(largest[-1], length / durations.sum())
    return np.concatenate([np.full(n, largest[:n].max()), [length], np.full(n, largest[n + 1 : -1].max()), [slip]])


CONTRADICTION = 1e-6
"""Distance in the problem of nonnegative least squares that means a polyhedron without points.

The solution is a multiple of its inverse square, which is known to four digits there, and to none at 1e-8.
"""
ROUNDING = 1e-15
"""Slope of a least squares problem that is zero, relative to its columns; with some to spare."""
MAX_CHANGES = 3
"""Changes of the active set for each unknown; more do not occur."""
SHORTEST_ROW = 1e-3
"""Shorter rows of the constraints are not scaled to length one, which would amplify rounding."""


def least_distance(H: Array, g: Array, A: Array, b: Array) -> tuple[Array, Array] | None:
    """min g'd + d'Hd/2 s.t. A d + b >= 0: solution and multipliers, or None where the constraints contradict."""
    L = np.linalg.cholesky(H)
    free = -np.linalg.solve(L, g)
    G = np.linalg.solve(L, A.T).T
    lengths = np.maximum(np.linalg.norm(G, axis=1), SHORTEST_ROW)
    G, h = G / lengths[:, None], (-b - G @ free) / lengths
    unit = max(1.0, float(h.max(initial=0.0)))  # of y: least squares distinguish no distances far from one
    h /= unit
    target = np.zeros(g.size + 1)
    target[-1] = 1.0
    weights = nonnegative(np.vstack([G.T, h]), target)
    residual = np.vstack([G.T, h]) @ weights - target
    if np.linalg.norm(residual) < CONTRADICTION:
        return None
    y, weights = -unit * residual[:-1] / residual[-1], -unit * weights / residual[-1] / lengths
    return _refined(H, g, A, b, np.asarray(np.linalg.solve(L.T, y + free)), weights)


def nonnegative(A: Array, b: Array) -> Array:
    """The x >= 0 for which |A x - b| is least, by active sets; SciPy, which has it, takes half a second to import."""
    x, passive = np.zeros(A.shape[1]), np.zeros(A.shape[1], dtype=bool)
    refused = passive.copy()  # of no use by rounding, until something else has changed
    tolerance = ROUNDING * float(np.abs(A).sum(axis=0).max(initial=0.0))
    for _ in range(MAX_CHANGES * x.size):
        slopes = np.where(passive | refused, -np.inf, A.T @ (b - A @ x))
        entering = int(np.argmax(slopes))
        if slopes[entering] <= tolerance:
            break
        passive[entering] = True
        while (z := _of_columns(A, b, passive))[passive].min(initial=0.0) < 0:
            parts = np.divide(x, x - z, out=np.full_like(x, np.inf), where=passive & (z < 0))
            x = x + parts.min() * (z - x)
            passive[parts == parts.min()] = False
            x[~passive] = 0.0
        refused &= not passive[entering]
        refused[entering] = not passive[entering]
        x = z
    return x


def _of_columns(A: Array, b: Array, columns: NDArray[np.bool_]) -> Array:
    """The x for which |A x - b| is least, zero but in these columns."""
    x = np.zeros(A.shape[1])
    x[columns] = np.linalg.lstsq(A[:, columns], b)[0]
    return x


def _refined(H: Array, g: Array, A: Array, b: Array, d: Array, weights: Array) -> tuple[Array, Array]:
    """The solution with its active constraints met to rounding, where they determine their multipliers."""
    active = weights > 0
    n, m = g.size, int(active.sum())
    system = np.block([[H, -A[active].T], [A[active], np.zeros((m, m))]])
    residual = np.concatenate([H @ d + g - A[active].T @ weights[active], A[active] @ d + b[active]])
    try:
        change = -np.linalg.solve(system, residual)
    except np.linalg.LinAlgError:  # constraints that are active twice
        return d, weights
    refined = weights.copy()
    refined[active] += change[n:]
    return (d + change[:n], refined) if (refined >= 0).all() else (d, weights)
