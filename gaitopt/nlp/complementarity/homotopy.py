"""An NLP with complementarity constraints, products <= sigma, solved by IPOPT for a falling sequence of sigma.

S. Scholtes, Convergence properties of a regularization scheme for mathematical programs with complementarity
constraints, SIAM J. Optim. 11 (2001).
"""

from typing import Any

import numpy as np
from casadi import MX, nlpsol, vertcat

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait import Status
from gaitopt.nlp.ipopt import ENDINGS, RUNNING, Progress, Watch

Bounds = tuple[Array, Array]

SIGMAS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9)
"""Bounds of the products, for factors of size one."""
TOLERANCE = 1e-8
"""A solution is a proposal, which another NLP polishes."""
MAX_ITERATIONS = 150
"""For one sigma; a solution that exists takes about twenty."""


class Homotopy:
    """One NLP, built once and solved as often as needed.

    Parameters
    ----------
    w, p, sigma, objective, g : CasADi expressions; bounds of g may not depend on sigma.
    bounds_w, bounds_g : lower and upper bounds.
    progress, should_stop : called at every iteration.
    """

    def __init__(
        self,
        *,
        w: MX,
        p: MX,
        sigma: MX,
        g: MX,
        objective: MX,
        bounds_w: Bounds,
        bounds_g: Bounds,
        progress: Progress | None = None,
        should_stop: Stop = None,
    ) -> None:
        self._bounds_w, self._bounds_g = bounds_w, bounds_g
        parameters = vertcat(p, sigma)
        self._watch = Watch(w.numel(), g.numel(), parameters.numel(), progress, should_stop)
        options: dict[str, Any] = {
            "expand": True,
            "print_time": False,
            "show_eval_warnings": False,
            "iteration_callback": self._watch,
            "error_on_fail": False,
            "calc_lam_p": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": TOLERANCE,
                "acceptable_iter": 0,
                "max_iter": MAX_ITERATIONS,
                "mu_strategy": "adaptive",
            },
        }
        problem: dict[str, Any] = {"x": w, "p": parameters, "f": objective, "g": g}
        self._solver = nlpsol("homotopy", "ipopt", problem, options)

    def solve(self, w: Array, p: Array) -> tuple[Array, Status]:
        """Solve from ``w`` at parameters ``p``, shape (n_p,); the last iterate, and how it ended.

        Raises
        ------
        RuntimeError
            If IPOPT ends in a way that only a broken installation or a bug can cause.
        """
        (lower, upper), status = self._bounds_w, Status.CONVERGED
        for sigma in SIGMAS:
            self._watch.begin(*self._bounds_g)
            with RUNNING:
                solution = self._solver(
                    x0=w, p=np.append(p, sigma), lbx=lower, ubx=upper, lbg=self._bounds_g[0], ubg=self._bounds_g[1]
                )
                ending = self._solver.stats()["return_status"]
            if ending not in ENDINGS:
                raise RuntimeError(f"IPOPT ended with {ending}")
            w, (status, _) = np.asarray(solution["x"]).ravel(), ENDINGS[ending]
            if status is not Status.CONVERGED:
                break
        return w, status
