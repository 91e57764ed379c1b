"""Newton's path to a gait: from a guess nearby to a solution of the equations that is right to rounding.

J(w) s = residual(w),    w <- w - s     from a guess, while the steps halve at least      ``solve_nearby``
                                        from a solution, down to rounding                 ``polish``
J dw = -halved defects                  its error, by a finer integration                 ``integration_error``
                                        more intervals until that is small                ``refine``
A dW = lift,  DPi = impact' dW_K        return map's derivative, A being J without the periodicity's z_K

Steps that halve at least keep the solution within twice the first one, so that it is that of the guess and not of
another family: a start from which they do not is left to IPOPT. P. Deuflhard (2004), Newton Methods for Nonlinear
Problems, ch. 2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Status
from gaitopt.iteration import iterate, overflow_allowed
from gaitopt.model.buffered import buffered
from gaitopt.model.modes import Mode
from gaitopt.nlp.interval import ORDER
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.shooting import MultipleShooting, NaturalUnits
from gaitopt.nlp.sparse import ScaledMatrix, SparseMatrix

REACH = 0.2
"""Longest first step in natural units: a guess farther off is none."""
CONTRACTION = 0.5
"""Largest ratio of a step to the one before."""
SETTLED = 1e-7
"""Step in natural units whose successor, by quadratic convergence, is at rounding."""
MOST_STEPS = 9
"""Steps that halve from ``REACH`` are near quadratic convergence long before."""
SHORTEST = 0.5
"""Part of the guessed period: feet that stay together solve all equations in no time at all."""
NEWTON_TOLERANCE = 3e-15
"""Rounding of the equalities in natural units; a polish that does not get there ends where it no longer improves."""
NEWTON_STEPS = 8
"""A polish starts at IPOPT's tolerance; more steps mean that it does not converge."""
CONSTANT = 1e-13
"""Residual in natural units of a point whose Jacobian is that of the solution up to rounding."""
ERROR_TOLERANCE = 1e-12
"""Integration error of states and durations in natural units that is aimed at: proofs find a gait within 3e-12."""
LARGEST_ERROR = 4e-11
"""The same beyond which a solution is no gait: more than a digit below the nine that are promised."""
SAFETY = 4.0
"""Factor by which a refinement aims below the tolerance."""
MAX_REFINEMENTS = 4
MAX_INTERVALS = 800
"""A step that is not accurate on so many is no walking step: its motion is singular."""
LARGEST_WEIGHTS = 100.0
"""Sum of the weights of the values; with larger ones the place lies too far beyond what is known."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A point that solves the equations of a gait, or is on the way there; what follows from it is computed when used.

    Attributes
    ----------
    transcription : the equations.
    w, p : ndarray - unknowns and parameters, in SI.
    status, words : whether the search for it got there, and how it ended.
    iterations : what the search took.
    start : where a search that says so began.
    chord : Jacobian that serves in place of the one at ``w``, from which it differs by rounding.
    """

    transcription: MultipleShooting
    w: Array
    p: Array
    status: Status = Status.CONVERGED
    words: str = "solved"
    iterations: int = 0
    start: Array | None = None
    chord: SparseMatrix | None = None

    @property
    def converged(self) -> bool:
        """Whether the search got there."""
        return self.status is Status.CONVERGED

    @cached_property
    @overflow_allowed()
    def _linearised(self) -> tuple[Array, SparseMatrix]:
        if self.chord is not None:
            return self.transcription.violation(self.w, self.p), self.chord
        return self.transcription.linearised(self.w, self.p)

    @property
    def residual(self) -> Array:
        """Values of the equalities; shape (n,)."""
        return self._linearised[0]

    @property
    def jacobian(self) -> SparseMatrix:
        """Their derivative in nodes, durations and freed parameters; shape (n, n + n_free)."""
        return self._linearised[1]

    @cached_property
    def units(self) -> NaturalUnits:
        """Natural units of unknowns and equalities."""
        return self.transcription.units(self.p)

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

    @cached_property
    def errors(self) -> Array:
        """Largest estimated integration error of each phase's states and duration, in natural units; (n_phases,)."""
        return phase_errors(self)

    @property
    def accurate(self) -> bool:
        """Whether the errors are small enough for a gait."""
        return bool(self.errors.max() < LARGEST_ERROR)


@overflow_allowed()
def solve_nearby(
    transcription: MultipleShooting,
    start: Array,
    p: Array,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Solution:
    """Newton's method from ``start``, shape (n_w,), at parameters ``p``, as long as its steps shrink.

    ``should_stop`` ends it at once. The margins are not checked. A search that fails has the status ``not_converged``.
    """
    shortest, at, last = SHORTEST * _period(transcription, start), Solution(transcription, start, p), np.inf
    lost = replace(at, status=Status.NOT_CONVERGED, words="no solution next to the guess")
    for number in range(MOST_STEPS + 1):
        if progress is not None:
            progress(number, at.size)
        if should_stop is not None and should_stop():
            return replace(lost, iterations=number)
        try:
            step = at.scaled.solve(at.residual)
        except RuntimeError:  # singular
            return replace(lost, iterations=number)
        end, size = at.w - step, float(np.abs(step / at.units.unknowns).max())
        allowed = size < CONTRACTION * last if number else size <= REACH
        if not allowed or _period(transcription, end) < shortest:
            return replace(lost, iterations=number)
        at, last = Solution(transcription, end, p, iterations=number), size
        if size < SETTLED:
            return at
    return replace(lost, iterations=MOST_STEPS)


@overflow_allowed()
def polish(transcription: MultipleShooting, w: Array, p: Array) -> Solution:
    """Bring a solution down to rounding; freed parameters stay where they are, as does all where J is singular."""

    def following(at: Solution) -> Solution:
        trial = at.w.copy()
        trial[: at.residual.size] -= at.scaled.solve(at.residual)
        return Solution(transcription, trial, p, chord=at.jacobian if at.size < CONSTANT else None)

    first = Solution(transcription, w, p)
    try:
        polished = iterate(
            first,
            following,
            size=lambda at: at.size,
            solved=lambda at: at.size < NEWTON_TOLERANCE,
            most=NEWTON_STEPS,
        )
    except RuntimeError:  # singular
        return first
    return polished.at


@overflow_allowed()
def refine(solution: Solution) -> Solution:
    """Cut phases with too large an error finer, and polish, until the errors are below the tolerance or at rounding.

    Freed parameters stay where they are.
    """
    current = solution
    for _ in range(MAX_REFINEMENTS):
        if current.errors.max() < ERROR_TOLERANCE:
            break
        growth = np.maximum((SAFETY * current.errors / ERROR_TOLERANCE) ** (1 / ORDER), 1.0)
        layout = current.transcription.layout
        if layout.intervals * growth.max() > MAX_INTERVALS:
            break
        counts = [int(np.ceil(arc.intervals * growth[arc.phase])) for arc in layout.arcs]
        refined = _on(current, current.transcription.on(layout.refined(counts)))
        if not refined.errors.max() < current.errors.max():
            break
        current = refined
    return current


@overflow_allowed()
def halved(solution: Solution) -> Solution:
    """The same solution with every interval cut in two, down to rounding; freed parameters stay where they are."""
    transcription, layout = solution.transcription, solution.transcription.layout
    return _on(solution, transcription.on(layout.refined([2 * arc.intervals for arc in layout.arcs])))


def _on(coarse: Solution, finer: MultipleShooting) -> Solution:
    """A solution on a finer layout."""
    return polish(finer, _resample(coarse.transcription, finer, coarse), coarse.p)


@overflow_allowed()
def phase_errors(at: Solution) -> Array:
    """Largest estimated error of the states in each phase, and of its duration, in natural units; shape (n_phases,).

    Infinite where the equations are singular.
    """
    transcription = at.transcription
    try:
        nodes, durations = integration_error(at)
    except RuntimeError:
        return np.full(transcription.n_phases, np.inf)
    node_units, duration_units, _ = transcription.unpack(at.units.unknowns)
    nodes, errors = nodes / node_units, np.abs(durations / duration_units)
    for arc, first in zip(transcription.layout.arcs, transcription.layout.first_nodes, strict=True):
        largest = np.abs(nodes[:, first : first + arc.intervals + 1]).max()
        errors[arc.phase] = max(errors[arc.phase], largest)
    return errors


def integration_error(at: Solution) -> tuple[Array, Array]:
    """Estimated error of a solution: by how much a finer integration would move it.

    Returns
    -------
    nodes : ndarray, shape (n_z, K + 1) - change of the node states.
    durations : ndarray, shape (n_phases,) - change of the durations [s].
    """
    problem = at.transcription
    halved, right = problem.halved_defects(at.w, at.p), np.zeros(at.residual.size)
    right[: halved.size] = at.residual[: halved.size] - halved
    nodes, durations, _ = problem.unpack(at.scaled.solve(right))
    return nodes, durations


def return_map_jacobian(at: Solution) -> Array:
    """Derivative of the return map on the section by implicit differentiation of the equalities; (n_xi, n_xi)."""
    return section_sensitivity(at)[1]


def section_sensitivity(at: Solution) -> tuple[Array, Array, Callable[[Array], Array]]:
    """How the step answers to a deviation on the section.

    Returns
    -------
    response : ndarray, shape (n, n_xi) - of nodes and durations.
    returned : ndarray, shape (n_xi, n_xi) - the deviation after the step.
    adjoint : from weights (n_xi, n_xi) of ``returned`` to those (n, n_xi) of the equations of ``response``.
    """
    problem = at.transcription
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


def extrapolation(places: Sequence[float], place: float, *, slopes: bool = False) -> Array | None:
    """Weights of the values at some places, and with ``slopes`` after them of the derivatives, in the value at another.

    Returns
    -------
    weights : ndarray, shape (n,) or (2 n,); None where the other place is too far away to say.
    """
    unit = max(abs(s) for s in (*places, place)) or 1.0
    x, powers = np.array(places) / unit, np.arange(len(places) * (2 if slopes else 1))
    rows = x[:, None] ** powers
    if slopes:
        rows = np.vstack([rows, powers * x[:, None] ** np.maximum(powers - 1, 0) / unit])
    try:
        weights = np.linalg.solve(rows.T, (place / unit) ** powers)
    except np.linalg.LinAlgError:  # two of the places are one
        return None
    return weights if np.abs(weights[: x.size]).sum() < LARGEST_WEIGHTS else None


def _resample(coarse: MultipleShooting, finer: MultipleShooting, at: Solution) -> Array:
    """The solution on a finer layout, each new node by one partial step from the node before it."""
    nodes, durations, freed = coarse.unpack(at.w)
    resampled = np.empty((nodes.shape[0], finer.n_nodes))
    for index, (arc, first) in enumerate(zip(finer.layout.arcs, finer.layout.first_nodes, strict=True)):
        fractions = np.linspace(0, 1, arc.intervals + 1)[:-1]
        resampled[:, first : first + arc.intervals] = coarse.states_at(at.w, at.p, index, fractions).T
    resampled[:, finer.layout.reset_nodes] = nodes[:, coarse.layout.reset_nodes]
    return finer.pack(resampled, durations, freed)


def _period(transcription: MultipleShooting, w: Array) -> float:
    return float(transcription.unpack(w).durations.sum())
