"""Newton's method for the equations of a gait: from a nearby guess to a solution that is accurate to rounding.

    J(w) s = F(w),   w <- w - s     from a guess, while every step is at most half of the last    ``solve_nearby``
                                    from a solution, down to rounding                             ``polish``
    J dw = -halved defects          integration error of a solution, by a finer integration       ``integration_error``
                                    more intervals until it is small                              ``refine``
    A dW = lift,  DPi = R_z dW_K    derivative of the return map, with A = J opened at the last reset

Steps that halve keep the solution within twice the first step of the guess, so that it belongs to the guess and not to
another family; other starts are left to IPOPT. P. Deuflhard (2004), Newton Methods for Nonlinear Problems, ch. 2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Status
from gaitopt.requests import NEWTON_STEPS
from gaitopt.solver.arclength import CONTRACTION, LONGEST_FIRST_STEP
from gaitopt.solver.interval import ORDER
from gaitopt.solver.shooting import MultipleShooting, NaturalUnits, transcribe
from gaitopt.solver.sparse import ScaledMatrix, SparseMatrix
from gaitopt.threads import cached_property

SMALL_STEP = 1e-7
"""After a step below this, in natural units, the next one would be rounding, because convergence is quadratic."""
SHORTEST_NEARBY_PERIOD = 0.5
"""Shortest period of a solution relative to the guess. If both feet stay together, a period of zero solves all
equations."""
NEWTON_TOLERANCE = 3e-15
"""Rounding of the equalities in natural units. A polish that stays above it ends as soon as it no longer improves."""
POLISH_STEPS = 8
"""Largest number of steps of a polish. It starts at IPOPT's tolerance, so that one that needs more does not
converge."""
CHORD_RESIDUAL = 1e-13
"""With a residual below this, in natural units, the Jacobian is that of the solution up to rounding: chords suffice."""
ERROR_TOLERANCE = 1e-12
"""Refinement aims at this integration error of states and durations, in natural units: proofs find a gait within
3e-12."""
LARGEST_ERROR = 4e-11
"""Largest integration error of a gait in natural units: more than a digit below the nine that are promised."""
REFINEMENT_RESERVE = 4.0
"""Factor by which a refinement aims below the tolerance."""
GUARD_ERROR = 1e-9
"""A jump of the torques carries the guard of a timed phase through zero if neither value misses its sign by more than
this, in natural units."""
MAX_REFINEMENTS = 4
MAX_INTERVALS = 10_000
"""Largest number of intervals of a cycle; a motion that needs more is singular."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Unknowns that solve the equations of a gait, or an iterate of a search; derived quantities are computed on use.

    Attributes
    ----------
    equations : the equations of the gait.
    w, p : ndarray - unknowns and parameters, in SI.
    status, words : how the search ended, and that in words.
    iterations : number of iterations of the search.
    chord : the solution whose Jacobian is used instead of the one at ``w``.
    """

    equations: MultipleShooting
    w: Array
    p: Array
    status: Status = Status.CONVERGED
    words: str = "solved"
    iterations: int = 0
    chord: "Solution | None" = None

    @property
    def converged(self) -> bool:
        """Whether the search has converged."""
        return self.status is Status.CONVERGED

    @property
    def durations(self) -> Array:
        """Durations of the phases, shape (n_phases,) [s]."""
        return self.equations.unpack(self.w).durations

    @property
    def in_order(self) -> bool:
        """Whether every arc lies in its segment of the control, and the torques jump where timed phases end.

        False once a switch has passed a breakpoint, or has left it.
        """
        in_order = self.equations.mesh.in_order(self.durations, self.equations.system.control.breakpoints)
        return in_order and not self.misplaced

    @property
    def misplaced(self) -> tuple[int, ...]:
        """The timed phases that should not end at their breakpoint, because their margin is not carried below zero."""
        jumps = self.equations.jumps(self.w, self.p)
        return tuple(k for k, (before, after) in jumps.items() if not (before > -GUARD_ERROR and after < GUARD_ERROR))

    @cached_property
    @overflow_allowed()
    def _linearised(self) -> tuple[Array, SparseMatrix]:
        if self.chord is not None:
            return self.equations.violation(self.w, self.p), self.chord.jacobian
        return self.equations.linearised(self.w, self.p)

    @property
    def residual(self) -> Array:
        """Values of the equalities; shape (n,)."""
        return self._linearised[0]

    @property
    def jacobian(self) -> SparseMatrix:
        """Derivative of the equalities by nodes, durations and freed parameters; shape (n, n + n_free)."""
        return self._linearised[1]

    @cached_property
    def units(self) -> NaturalUnits:
        """Natural units of unknowns and equalities."""
        return self.equations.units(self.p)

    @cached_property
    def square(self) -> SparseMatrix:
        """Jacobian by nodes and durations only; shape (n, n)."""
        return self.jacobian.leading(self.residual.size)

    @property
    def size(self) -> float:
        """Largest violation of the equalities, in natural units."""
        return float(np.abs(self.residual / self.units.equalities).max())

    @cached_property
    def scaled(self) -> ScaledMatrix:
        """``square`` in natural units."""
        return self.scaled_as_square(self.square) if self.chord is None else self.chord.scaled

    def scaled_as_square(self, matrix: SparseMatrix) -> ScaledMatrix:
        """A matrix with the rows and columns of ``square`` in natural units."""
        return ScaledMatrix(matrix, self.units.equalities, self.units.unknowns[: self.residual.size])

    def stepped(self) -> "Solution":
        """The end of one Newton step, or of one chord, with free parameters fixed.

        Raises
        ------
        RuntimeError
            If the Jacobian is singular.
        """
        w, chord = self.w.copy(), self.chord or (self if self.size < CHORD_RESIDUAL else None)
        w[: self.residual.size] -= self.scaled.solve(self.residual)
        return Solution(self.equations, w, self.p, iterations=self.iterations + 1, chord=chord)

    @cached_property
    def full_sensitivity(self) -> tuple[Array, Array, Callable[[Array], Array]]:
        """``cycle_sensitivity`` to a deviation of every coordinate of the first state."""
        return cycle_sensitivity(self, np.eye(self.equations.system.n_z))

    @cached_property
    def errors(self) -> Array:
        """Largest estimated error of each phase's states and duration, in natural units; shape (n_phases,).

        Infinite where the equations are singular.
        """
        equations = self.equations
        with overflow_allowed():
            try:
                nodes, durations = integration_error(self)
            except RuntimeError:
                return np.full(equations.n_phases, np.inf)
            node_units, duration_units, _ = equations.unpack(self.units.unknowns)
            nodes, errors = nodes / node_units, np.abs(durations / duration_units)
            for arc, at in zip(equations.mesh.arcs, equations.mesh.arc_nodes, strict=True):
                errors[arc.phase] = max(errors[arc.phase], np.abs(nodes[:, at.start : at.stop]).max())
            return errors

    @property
    def caused_errors(self) -> Array:
        """The largest error, divided among the arcs in proportion to the defects of halved intervals; shape (n_arcs,).

        The largest share is the error itself: defects that add up may all be those of one arc.
        """
        mesh, n_z = self.equations.mesh, self.equations.system.n_z
        defects = np.abs(self.halving / self.units.equalities[: self.halving.size]).reshape(-1, n_z).max(axis=1)
        sums = np.array([defects[at].sum() for at in mesh.arc_intervals])
        return np.asarray(self.errors.max() * sums / (sums.max() or 1.0))

    @cached_property
    def halving(self) -> Array:
        """Change of the defects if every interval is integrated in two halves, shape (n_z intervals,)."""
        halved = self.equations.halved_defects(self.w, self.p)
        return np.asarray(self.residual[: halved.size] - halved)

    @property
    def accurate(self) -> bool:
        """Whether the errors are small enough for a gait."""
        return bool(self.errors.max() < LARGEST_ERROR)


@dataclass(frozen=True, eq=False)
class GaitEquations:
    """The equations of a gait at fixed values of all parameters that are not freed, in the form of ``arclength``.

    Attributes
    ----------
    equations : the equations of the gait.
    p : ndarray - values of all parameters.
    spans : the freed parameters are measured in these units.
    """

    equations: MultipleShooting
    p: Array
    spans: tuple[float, ...] = ()

    @cached_property
    def unknown_units(self) -> Array:
        """Natural units of the unknowns."""
        units = self.equations.units(self.p).unknowns
        return np.concatenate([units[: units.size - len(self.spans)], self.spans])

    @cached_property
    def equality_units(self) -> Array:
        """Natural units of the equalities."""
        return self.equations.units(self.p).equalities

    def violation(self, w: Array) -> Array:
        """Values of the equalities."""
        return self.equations.violation(w, self.p)

    def at(self, w: Array) -> Solution:
        """The unknowns as a solution."""
        return Solution(self.equations, w, self.p)


@overflow_allowed()
def solve_nearby(
    start: Solution, *, most_steps: int = NEWTON_STEPS, progress: Valued = None, should_stop: Stop = None
) -> Solution:
    """Newton's method from ``start``, while its steps halve.

    The margins are not checked. A failed search has the status ``not_converged``, and ``interrupted`` if
    ``should_stop`` ended it.
    """
    equations, at, last = start.equations, start, np.inf
    shortest = SHORTEST_NEARBY_PERIOD * start.durations.sum()
    lost = replace(start, status=Status.NOT_CONVERGED, words="Newton's method finds no solution next to the guess")
    for number in range(most_steps + 1):
        if progress is not None:
            progress(number, at.size)
        if should_stop is not None and should_stop():
            return replace(start, status=Status.INTERRUPTED, words="interrupted", iterations=number)
        try:
            step = at.scaled.solve(at.residual)
        except RuntimeError:  # singular
            break
        end, size = at.w - step, float(np.abs(step / at.units.unknowns).max())
        allowed = size < CONTRACTION * last if number else size <= LONGEST_FIRST_STEP
        if not allowed or equations.unpack(end).durations.sum() < shortest:
            break
        at, last = Solution(equations, end, start.p, iterations=number), size
        if size < SMALL_STEP:
            return at
    return replace(lost, iterations=number)


@overflow_allowed()
def polish(solution: Solution) -> Solution:
    """A solution refined to rounding by Newton's method, with free parameters fixed.

    The first step that does not reduce the residual is discarded and ends the polish. If the Jacobian is singular, the
    solution is returned unchanged.
    """
    at = solution
    for _ in range(POLISH_STEPS):
        if at.size < NEWTON_TOLERANCE:
            break
        try:
            trial = at.stepped()
        except RuntimeError:  # singular
            return solution
        if not trial.size < at.size:
            break
        at = trial
    return at


@overflow_allowed()
def refine(solution: Solution) -> Solution:
    """Divide arcs more finely until the integration error is below the tolerance or at rounding.

    Only arcs that cause too large an error are divided. Free parameters are fixed.
    """
    current = solution
    for _ in range(MAX_REFINEMENTS):
        if current.errors.max() < ERROR_TOLERANCE:
            break
        growth = np.maximum((REFINEMENT_RESERVE * current.caused_errors / ERROR_TOLERANCE) ** (1 / ORDER), 1.0)
        mesh = current.equations.mesh
        counts = np.ceil(growth * [arc.intervals for arc in mesh.arcs])
        if not counts.sum() <= MAX_INTERVALS:  # or not a number
            break
        refined = polish(_resampled(current, counts.astype(int).tolist()))
        if not refined.errors.max() < current.errors.max():
            break
        current = refined
    return current


@overflow_allowed()
def halved(solution: Solution) -> Solution:
    """The same solution with every interval halved, refined to rounding with the free parameters fixed."""
    return polish(_resampled(solution, [2 * arc.intervals for arc in solution.equations.mesh.arcs]))


def integration_error(at: Solution) -> tuple[Array, Array]:
    """Estimated integration error of a solution: the change that a finer integration would cause.

    Returns
    -------
    nodes : ndarray, shape (n_z, K + 1) - change of the node states.
    durations : ndarray, shape (n_phases,) - change of the durations [s].
    """
    right = np.zeros(at.residual.size)
    right[: at.halving.size] = at.halving
    nodes, durations, _ = at.equations.unpack(at.scaled.solve(right))
    return nodes, durations


def section_sensitivity(at: Solution) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Response of the cycle to a deviation on the section, by implicit differentiation of the equalities.

    Returns
    -------
    response : ndarray, shape (n, n_xi) - derivatives of nodes and durations.
    returned : ndarray, shape (n_xi, n_xi) - derivative of the return map: the deviation after the cycle.
    adjoint : function that maps weights (n_xi, k) of ``returned`` to weights (n, k) of the equations of ``response``.
    """
    section = at.equations.system.section(at.equations.mesh.cycle)
    full = at.equations.dynamics(at.p, at.equations.unpack(at.w).freed).p
    tangent = section.tangent(at.w[: at.equations.system.n_z], full)
    response, returned, adjoint = cycle_sensitivity(at, tangent)

    def of_section(weights: Array) -> Array:
        every = np.zeros((len(tangent), weights.shape[1]))
        every[section.indices] = weights
        return adjoint(every)

    return response, returned[section.indices], of_section


def cycle_sensitivity(at: Solution, deviations: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Response of the cycle to deviations (n_z, k) of its first state, which may leave the section.

    The results are those of ``section_sensitivity``. The last reset leads back to the section, so that the multipliers
    of deviations across it are zero.
    """
    equations, n_z = at.equations, at.equations.system.n_z
    opened, reset = opened_cycle(at)
    n, last = at.residual.size, slice((equations.n_nodes - 1) * n_z, equations.n_nodes * n_z)
    right = np.zeros((n, deviations.shape[1]))
    right[n - n_z :] = deviations
    response = opened.solve(right)

    def adjoint(weights: Array) -> Array:
        end = np.zeros((n, weights.shape[1]))
        end[last] = reset.T @ weights
        return opened.solve_transposed(end)

    return response, reset @ response[last], adjoint


def parameter_sensitivity(at: Solution) -> Array:
    """Derivative of the return map by the freed parameters at fixed section coordinates, shape (n_xi, n_free).

    The parameters act during the whole cycle: on the state that the section coordinates determine, along the motion,
    and in the last reset.
    """
    equations, n_z = at.equations, at.equations.system.n_z
    opened, reset = opened_cycle(at)
    n, last = at.residual.size, slice((equations.n_nodes - 1) * n_z, equations.n_nodes * n_z)
    section = equations.system.section(equations.mesh.cycle)
    full = equations.dynamics(at.p, equations.unpack(at.w).freed).p
    by_free = at.jacobian.dense(n, at.w.size)
    by_lift = section.by_parameters(at.w[:n_z], full)
    numbers = {name: k for k, name in enumerate(equations.system.parameters)}
    right = -by_free
    right[n - n_z :] = 0.0
    for column, name in enumerate(equations.free):
        if numbers[name] < by_lift.shape[1]:
            right[n - n_z :, column] = by_lift[:, numbers[name]]
    response = opened.solve(right)
    return np.asarray((reset @ response[last] - by_free[n - n_z :])[section.indices])


def opened_cycle(at: Solution) -> tuple[ScaledMatrix, Array]:
    """Derivatives of a cycle that starts from a given state instead of the last reset, and of that reset.

    Returns
    -------
    opened : the matrix ``square``, but the last rows do not depend on the last node.
    reset : ndarray, shape (n_z, n_z) - derivative of the state after the last reset by the last node.
    """
    equations = at.equations
    n_z, n = equations.system.n_z, at.residual.size
    last, pattern = slice((equations.n_nodes - 1) * n_z, equations.n_nodes * n_z), at.square.pattern
    reset = -at.square.dense(last.start, last.stop)[n - n_z :]
    columns, data = slice(*pattern.pointers[[last.start, last.stop]]), at.square.data.copy()
    data[columns][pattern.rows[columns] >= n - n_z] = 0.0
    return at.scaled_as_square(SparseMatrix(pattern=pattern, data=data)), reset


def _resampled(coarse: Solution, intervals: Sequence[int]) -> Solution:
    """The solution with more intervals per arc, each new node by one partial step from the node before it."""
    known, mesh = coarse.equations, coarse.equations.mesh.refined(intervals)
    nodes, durations, freed = known.unpack(coarse.w)
    resampled = np.empty((nodes.shape[0], mesh.n_nodes))
    for index, at in enumerate(mesh.arc_nodes):
        fractions = np.linspace(0, 1, len(at))[:-1]
        resampled[:, at[:-1]] = known.states_at(coarse.w, coarse.p, index, fractions).T
    resampled[:, mesh.reset_nodes] = nodes[:, known.mesh.reset_nodes]
    finer = transcribe(known.system, mesh, known.free)
    return Solution(finer, finer.pack(resampled, durations, freed), coarse.p)
