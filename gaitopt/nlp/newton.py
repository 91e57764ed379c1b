"""Newton's method on the square periodic problem, and what its Jacobian tells besides.

J dw = -residual                       polish of a solution
J dw = -halved defects                 error of the solution by the finer integration
A dW = lift,  DPi = impact' dW_K       return map's derivative, A being J without the periodicity's z_K
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from gaitopt.mechanics import Mode
from gaitopt.nlp.transcription import Transcription
from gaitopt.nlp.variation import variation

Array = NDArray[np.float64]

NEWTON_TOLERANCE = 1e-13
"""Rounding of a step of the integrator."""
NEWTON_STEPS = 8
"""A polish starts at IPOPT's tolerance; more steps mean that it does not converge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearisation:
    """The equalities at one point.

    Attributes
    ----------
    w, p : ndarray - unknowns and parameters.
    residual : ndarray, shape (n,) - equalities.
    jacobian : sparse, shape (n, n + n_free) - in nodes, durations and freed parameters.
    """

    w: Array
    p: Array
    residual: Array
    jacobian: csc_matrix

    @property
    def square(self) -> csc_matrix:
        """Jacobian in nodes and durations alone; shape (n, n)."""
        return self.jacobian[:, : self.residual.size]

    @property
    def size(self) -> float:
        """Largest violation of the equalities."""
        return float(np.abs(self.residual).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Polished:
    """Solution of the square problem; ``regular`` is False where the Jacobian is singular and nothing was changed."""

    at: Linearisation
    regular: bool


def linearise(problem: Transcription, w: Array, p: Array) -> Linearisation:
    """Equalities and their sparse Jacobian at ``w``."""
    residual = np.asarray(problem.violation(w, p)).ravel()
    return Linearisation(w=w, p=p, residual=residual, jacobian=variation(problem).jacobian(w, p))


def polish(problem: Transcription, w: Array, p: Array) -> Polished:
    """Bring a solution of IPOPT down to rounding; freed parameters stay where they are."""
    best = linearise(problem, w, p)
    for _ in range(NEWTON_STEPS):
        if best.size < NEWTON_TOLERANCE:
            break
        try:
            step = splu(best.square).solve(best.residual)
        except RuntimeError:  # singular
            return Polished(at=best, regular=False)
        trial = best.w.copy()
        trial[: step.size] -= step
        candidate = linearise(problem, trial, p)
        if not candidate.size < best.size:
            break
        best = candidate
    return Polished(at=best, regular=True)


def integration_error(problem: Transcription, at: Linearisation) -> tuple[Array, Array]:
    """Estimated error of a solution: by how much a finer integration would move it.

    Returns
    -------
    nodes : ndarray, shape (n_z, K + 1) - change of the node states.
    durations : ndarray, shape (n_phases,) - change of the durations [s].
    """
    difference = np.asarray(problem.halved_defects(at.w, at.p)).ravel()
    right = np.zeros(at.residual.size)
    right[: difference.size] = -difference
    nodes, durations, _ = problem.unpack(splu(at.square).solve(right))
    return nodes, durations


def return_map_jacobian(problem: Transcription, at: Linearisation) -> Array:
    """Derivative of the return map on the section by implicit differentiation of the equalities; (n_xi, n_xi)."""
    return section_response(problem, at)[1]


def section_response(problem: Transcription, at: Linearisation) -> tuple[Array, Array, Callable[[Array], Array]]:
    """How the step answers to a deviation on the section.

    Returns
    -------
    response : ndarray, shape (n, n_xi) - of nodes and durations.
    returned : ndarray, shape (n_xi, n_xi) - the deviation after the step.
    adjoint : from weights (n_xi, n_xi) of ``returned`` to those (n, n_xi) of the equations of ``response``.
    """
    system, n_z, n = problem.system, problem.system.n_z, at.residual.size
    last = slice((problem.n_nodes - 1) * n_z, problem.n_nodes * n_z)
    indices = system.section(problem.layout.cycle.impact)
    opened = at.square
    reset = -opened[n - n_z :, last].toarray()[indices]
    opened = opened.tolil()
    opened[n - n_z :, last] = 0.0
    factor = splu(opened.tocsc())
    full = problem.full_parameters(at.p, problem.unpack(at.w)[2])
    lift = np.asarray(system.lift_jacobian(at.w[system.section(Mode.SLIP_FORWARD)], full))
    right = np.zeros((n, indices.size))
    right[n - n_z :] = lift[:, : indices.size]
    response = factor.solve(right)

    def adjoint(weights: Array) -> Array:
        end = np.zeros((n, indices.size))
        end[last] = reset.T @ weights
        return np.asarray(factor.solve(end, trans="T"))

    return response, reset @ response[last], adjoint
