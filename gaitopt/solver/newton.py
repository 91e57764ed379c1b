"""Newton's method for the equations of a gait: from a nearby guess to a solution that is accurate to rounding.

    J(w) s = F(w),   w <- w - s     from a guess, while every step is at most half of the last    ``solve_nearby``
                                    from a solution, down to rounding                             ``polish``
    J dw = -halved defects          integration error of a solution, by a finer integration       ``integration_error``
                                    more intervals until it is small                              ``refine``

Steps that halve keep the solution within twice the first step of the guess, so that it belongs to the guess and not to
another family; other starts are left to IPOPT. P. Deuflhard (2004), Newton Methods for Nonlinear Problems, ch. 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Status
from gaitopt.requests import NEWTON_STEPS
from gaitopt.solver.arclength import CONTRACTION, LONGEST_FIRST_STEP
from gaitopt.solver.interval import ORDER
from gaitopt.solver.return_map import MapDerivatives
from gaitopt.solver.shooting import MultipleShooting, NaturalUnits, transcribe
from gaitopt.solver.sparse import ScaledMatrix, SparseMatrix
from gaitopt.threads import cached_property

SMALL_STEP = 1e-7
"""After a step below this, in natural units, the next one would be rounding, because convergence is quadratic."""
SHORTEST_NEARBY_PERIOD = 0.5
"""Shortest period of a solution relative to the guess. If both feet stay together, a period of zero solves all
equations."""
NEWTON_TOLERANCE = 3e-15
"""Size of the rounding errors of the equalities, in natural units: a polish ends below it, or where a step no longer
reduces the residual."""
POLISH_STEPS = 8
"""Largest number of steps of a polish. As it starts at IPOPT's tolerance, it does not converge if these do not
suffice."""
CHORD_RESIDUAL = 1e-13
"""Residual, in natural units, below which the Jacobian is that of the solution up to rounding: chords suffice."""
ERROR_TOLERANCE = 1e-12
"""Refinement aims at this integration error of states and durations, in natural units, because a proof finds the
periodic orbit only within 3e-12."""
LARGEST_ERROR = 4e-11
"""Largest integration error of a gait in natural units: more than a digit below the nine that are promised."""
REFINEMENT_RESERVE = 4.0
"""Factor by which a refinement aims below the tolerance."""
GUARD_ERROR = 1e-9
"""A jump of the torques carries the guard of a timed phase through zero if neither value misses its sign by more than
this, in natural units."""
MAX_REFINEMENTS = 4
"""Largest number of refinements of one mesh; each of them aims at the tolerance."""
MAX_INTERVALS = 10_000
"""Largest number of intervals of a cycle; a motion that needs more is singular."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Unknowns that solve the equations of a gait, or an iterate of a search; derived quantities are computed on use.

    Attributes
    ----------
    equations : the equations of the gait.
    w, p : ndarray - unknowns and parameters, in SI.
    status, message : how the search ended, and a sentence that says so.
    iterations : number of iterations of the search.
    chord : the solution whose Jacobian is used instead of the one at ``w``.
    """

    equations: MultipleShooting
    w: Array
    p: Array
    status: Status = Status.CONVERGED
    message: str = "solved"
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

        It is False after a switch has passed or left a breakpoint.
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
        """The matrix ``square`` in natural units, ready to be solved with."""
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
    def return_map(self) -> MapDerivatives:
        """The return map with its derivatives."""
        return MapDerivatives(self.equations, self.w, self.p, self.jacobian, self.scaled_as_square)

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
    lost = replace(start, status=Status.NOT_CONVERGED, message="Newton's method finds no solution next to the guess")
    for number in range(most_steps + 1):
        if progress is not None:
            progress(number, at.size)
        if should_stop is not None and should_stop():
            return replace(start, status=Status.INTERRUPTED, message="interrupted", iterations=number)
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
