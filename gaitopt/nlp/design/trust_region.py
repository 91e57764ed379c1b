"""Where a design is searched: bounds that keep it near its start, and sizes in which IPOPT sees the unknowns.

In one search angles, rates and slip velocity at a node change by no more than their largest value in the step, so that
it keeps clear of motions that are no walk. The same values are their sizes.
"""

from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.nlp.multiple_shooting import MultipleShooting

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
