"""The NLP of a gait without unknown parameters: equalities and margins, nothing to minimise.

The parameters are parameters of the NLP too, so that one that is built can be solved for any of their values.
"""

import numpy as np
from casadi import sum1, vertcat

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.nlp.ipopt import Ipopt, IpoptResult, Progress
from gaitopt.nlp.transcription import Transcription

SHORTEST = 0.1
"""Shortest step, relative to the guess: feet that stay together solve all equations in no time at all."""


class Feasibility:
    """The NLP of one layout.

    Parameters
    ----------
    transcription : its equations, without freed parameters.
    progress, should_stop : see ``Ipopt``.
    relaxed : leaves the margins out.
    """

    def __init__(
        self,
        transcription: Transcription,
        *,
        progress: Progress | None = None,
        should_stop: Stop = None,
        relaxed: bool = False,
    ) -> None:
        equalities, margins = transcription.equalities, transcription.inequalities[0]
        self._transcription, self._relaxed = transcription, relaxed
        self._n_phases = transcription.n_phases
        self._n_nodes = transcription.w.numel() - self._n_phases
        self._n_equalities = equalities.numel()
        self._shortest_phase = -np.inf if relaxed else 0.0
        period = sum1(transcription.w[self._n_nodes :])
        g = vertcat(equalities, period) if relaxed else vertcat(equalities, period, margins)
        self._upper = np.where(np.arange(g.numel()) < self._n_equalities, 0.0, np.inf)
        self._solver = Ipopt(
            w=transcription.w, p=transcription.parameters, g=g, progress=progress, should_stop=should_stop
        )

    def solve(self, start: Array, p: Array) -> IpoptResult:
        """Solve from ``start``, shape (n_w,), at parameters ``p``, shape (n_p,)."""
        lower = np.zeros(self._upper.size)
        lower[self._n_equalities] = SHORTEST * start[self._n_nodes :].sum()
        floor = np.full(start.size, -np.inf)
        floor[self._n_nodes :] = self._shortest_phase
        units = self._transcription.units(p)
        rows = [
            units.equalities,
            units.unknowns[-1:],
            *([] if self._relaxed else [self._transcription.margin_units(p)]),
        ]
        sizes = (units.unknowns, np.concatenate(rows))
        return self._solver.solve(start, p, (floor, np.full(start.size, np.inf)), (lower, self._upper), sizes)
