"""Newton's method on the square periodic problem, and what its Jacobian tells besides.

J dw = -residual                       polish of a solution
J dw = -halved defects                 error of the solution by the finer integration
A dW = lift,  DPi = impact' dW_K       return map's derivative, A being J without the periodicity's z_K
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaitopt.arrays import Array
from gaitopt.iteration import iterate
from gaitopt.mechanics import Mode
from gaitopt.mechanics.buffered import buffered
from gaitopt.nlp.sparse import ScaledMatrix, SparseMatrix
from gaitopt.nlp.transcription import Transcription
from gaitopt.nlp.trial import overflow_allowed
from gaitopt.nlp.units import Units

NEWTON_TOLERANCE = 3e-15
"""Rounding of the equalities in natural units; a polish that does not get there ends where it no longer improves."""
NEWTON_STEPS = 8
"""A polish starts at IPOPT's tolerance; more steps mean that it does not converge."""
CONSTANT = 1e-13
"""Residual in natural units of a point whose Jacobian is that of the solution up to rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearisation:
    """The equalities at one point, in SI.

    Attributes
    ----------
    w, p : ndarray - unknowns and parameters.
    residual : ndarray, shape (n,) - equalities.
    jacobian : sparse, shape (n, n + n_free) - in nodes, durations and freed parameters.
    units : natural units of rows and columns.
    """

    w: Array
    p: Array
    residual: Array
    jacobian: SparseMatrix
    units: Units

    @cached_property
    def square(self) -> SparseMatrix:
        """Jacobian in nodes and durations alone; shape (n, n)."""
        return self.jacobian.leading(self.residual.size)

    @property
    def size(self) -> float:
        """Largest violation of the equalities, in natural units."""
        return float(np.abs(self.residual / self.units.equalities).max())

    @cached_property
    def scaled(self) -> ScaledMatrix:
        """``square`` in natural units."""
        return self.scaled_as_square(self.square)

    def scaled_as_square(self, matrix: SparseMatrix) -> ScaledMatrix:
        """A matrix with the rows and columns of ``square`` in natural units."""
        return ScaledMatrix(matrix, self.units.equalities, self.units.unknowns[: self.residual.size])


@dataclass(frozen=True, slots=True, kw_only=True)
class Polished:
    """Solution of the square problem; ``regular`` is False where the Jacobian is singular and nothing was changed."""

    at: Linearisation
    regular: bool


@overflow_allowed()
def linearise(problem: Transcription, w: Array, p: Array) -> Linearisation:
    """Equalities and their sparse Jacobian at ``w``."""
    residual, jacobian = problem.linearised(w, p)
    return Linearisation(w=w, p=p, residual=residual, jacobian=jacobian, units=problem.units(p))


@overflow_allowed()
def polish(problem: Transcription, w: Array, p: Array) -> Polished:
    """Bring a solution of IPOPT down to rounding; freed parameters stay where they are."""

    def following(at: Linearisation) -> Linearisation:
        trial = at.w.copy()
        trial[: at.residual.size] -= at.scaled.solve(at.residual)
        if at.size < CONSTANT:
            return replace(at, w=trial, residual=problem.violation(trial, p))
        return linearise(problem, trial, p)

    first = linearise(problem, w, p)
    try:
        polished = iterate(
            first,
            following,
            size=lambda at: at.size,
            solved=lambda at: at.size < NEWTON_TOLERANCE,
            most=NEWTON_STEPS,
        )
    except RuntimeError:  # singular
        return Polished(at=first, regular=False)
    return Polished(at=polished.at, regular=True)


def integration_error(problem: Transcription, at: Linearisation) -> tuple[Array, Array]:
    """Estimated error of a solution: by how much a finer integration would move it.

    Returns
    -------
    nodes : ndarray, shape (n_z, K + 1) - change of the node states.
    durations : ndarray, shape (n_phases,) - change of the durations [s].
    """
    halved, right = problem.halved_defects(at.w, at.p), np.zeros(at.residual.size)
    right[: halved.size] = at.residual[: halved.size] - halved
    nodes, durations, _ = problem.unpack(at.scaled.solve(right))
    return nodes, durations


def return_map_jacobian(problem: Transcription, at: Linearisation) -> Array:
    """Derivative of the return map on the section by implicit differentiation of the equalities; (n_xi, n_xi)."""
    return section_sensitivity(problem, at)[1]


def section_sensitivity(problem: Transcription, at: Linearisation) -> tuple[Array, Array, Callable[[Array], Array]]:
    """How the step answers to a deviation on the section.

    Returns
    -------
    response : ndarray, shape (n, n_xi) - of nodes and durations.
    returned : ndarray, shape (n_xi, n_xi) - the deviation after the step.
    adjoint : from weights (n_xi, n_xi) of ``returned`` to those (n, n_xi) of the equations of ``response``.
    """
    system, n_z, n = problem.system, problem.system.n_z, at.residual.size
    last, pattern = slice((problem.n_nodes - 1) * n_z, problem.n_nodes * n_z), at.square.pattern
    indices = system.section(problem.layout.cycle.impact)
    reset = -at.square.dense(last.start, last.stop)[n - n_z :][indices]
    columns, data = slice(*pattern.pointers[[last.start, last.stop]]), at.square.data.copy()
    data[columns][pattern.rows[columns] >= n - n_z] = 0.0
    opened = at.scaled_as_square(SparseMatrix(pattern=pattern, data=data))
    full = problem.dynamics(at.p, problem.unpack(at.w).freed).p
    (flat,) = buffered(system.lift_jacobian)(at.w[system.section(Mode.SLIP_FORWARD)], full)
    lift = flat.reshape(n_z, -1, order="F")
    right = np.zeros((n, indices.size))
    right[n - n_z :] = lift[:, : indices.size]
    response = opened.solve(right)

    def adjoint(weights: Array) -> Array:
        end = np.zeros((n, indices.size))
        end[last] = reset.T @ weights
        return opened.solve_transposed(end)

    return response, reset @ response[last], adjoint
