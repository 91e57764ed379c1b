"""Newton's method on the square periodic problem, and what its factored Jacobian tells besides.

J dw = -residual                       polish of a solution
J dw = -halved defects                 error of the solution by the finer integration
A dW = lift,  DPi = impact' dW_K       return map's derivative, A being J without the periodicity's z_K
"""

from dataclasses import dataclass

import numpy as np
from casadi import DM
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from gaitopt.mechanics import Mode
from gaitopt.nlp.transcription import Transcription

Array = NDArray[np.float64]

NEWTON_TOLERANCE = 1e-13
"""Rounding of a step of the integrator."""
NEWTON_STEPS = 8
"""A polish starts at IPOPT's tolerance; more steps mean that it does not converge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Polished:
    """Solution of the square problem.

    Attributes
    ----------
    w : ndarray - unknowns.
    residual : largest violation of the equalities.
    regular : False where the Jacobian is singular and nothing was changed.
    """

    w: Array
    residual: float
    regular: bool


def polish(problem: Transcription, w: Array, p: Array) -> Polished:
    """Bring a solution of IPOPT down to rounding; freed parameters stay where they are."""
    best, lowest = w, float(np.abs(_residual(problem, w, p)[0]).max())
    for _ in range(NEWTON_STEPS):
        residual, jacobian = _residual(problem, best, p)
        try:
            step = splu(jacobian).solve(residual)
        except RuntimeError:  # singular
            return Polished(w=best, residual=lowest, regular=False)
        trial = best.copy()
        trial[: step.size] -= step
        size = float(np.abs(_residual(problem, trial, p)[0]).max())
        if not size < lowest:
            break
        best, lowest = trial, size
        if lowest < NEWTON_TOLERANCE:
            break
    return Polished(w=best, residual=lowest, regular=True)


def integration_error(problem: Transcription, w: Array, p: Array) -> tuple[Array, Array]:
    """Estimated error of a solution: by how much a finer integration would move it.

    Returns
    -------
    nodes : ndarray, shape (n_z, K + 1) - change of the node states.
    durations : ndarray, shape (n_phases,) - change of the durations [s].
    """
    _, jacobian = _residual(problem, w, p)
    difference = np.asarray(problem.halved_defects(w, p)).ravel()
    right = np.zeros(jacobian.shape[0])
    right[: difference.size] = -difference
    nodes, durations, _ = problem.unpack(np.append(splu(jacobian).solve(right), problem.unpack(w)[2]))
    return nodes, durations


def return_map_jacobian(problem: Transcription, w: Array, p: Array) -> Array:
    """Derivative of the return map on the section by implicit differentiation of the equalities; (n_xi, n_xi)."""
    system, n_z = problem.system, problem.system.n_z
    _, jacobian = _residual(problem, w, p)
    last = slice((problem.n_nodes - 1) * n_z, problem.n_nodes * n_z)
    periodicity = slice(jacobian.shape[0] - n_z, jacobian.shape[0])
    reset = -jacobian[periodicity, last].toarray()
    opened = jacobian.tolil()
    opened[periodicity, last] = 0.0
    full = problem.full_parameters(p, problem.unpack(w)[2])
    indices = system.section(problem.layout.sequence.impact)
    right = np.zeros((jacobian.shape[0], indices.size))
    right[periodicity] = np.asarray(system.lift_jacobian(w[system.section(Mode.SLIP_FORWARD)], full))[:, : indices.size]
    response = splu(opened.tocsc()).solve(right)
    return (reset @ response[last])[indices]


def _residual(problem: Transcription, w: Array, p: Array) -> tuple[Array, csc_matrix]:
    """Equalities and their Jacobian in nodes and durations (freed parameters held)."""
    residual, jacobian = problem.residual(w, p)
    n = residual.numel()
    return np.asarray(residual).ravel(), _sparse(jacobian)[:, :n]


def _sparse(matrix: DM) -> csc_matrix:
    sparsity = matrix.sparsity()
    return csc_matrix((matrix.nonzeros(), sparsity.row(), sparsity.colind()), shape=matrix.shape)
