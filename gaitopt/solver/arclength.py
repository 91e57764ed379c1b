"""Curves of solutions by pseudo-arclength: the predictor and the corrector of everything that follows a family.

    F(w) = 0,      n' (y(w) - y_predicted) = 0,      y = w[indices] / scales

F are n equations in n + 1 unknowns, the last of which is the parameter. Arclength is measured in y alone, the unknowns
that describe a solution without its mesh. The prediction is the polynomial through the last solutions, with their
tangents if these are known. Newton's method corrects it perpendicular to a normal n, or with the parameter fixed. It
uses the matrix of the last solution as long as its steps contract (chord method).

At a branch point the Jacobian J has a plane of null vectors. The one perpendicular to the known tangent leads to the
other branch, next to which Newton's method is regular.

References
----------
H. B. Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.integration import bracketed_root
from gaitopt.solver.sparse import ScaledMatrix, SparseMatrix

UNDEFINED = (RuntimeError, np.linalg.LinAlgError)
"""Errors where a derivative is singular, or a condition has no value or derivative because the return map is not
finite."""
RESIDUAL = 1e-13
"""Largest violation of an equality on the curve, in natural units: about thirty times the rounding of a step.

One more chord then reaches rounding, also where the equations are so flat that a prediction already satisfies them.
Stiff torques have a larger rounding, in proportion to their gains: see ``LARGEST_ROUNDING``.
"""
LARGEST_LAST_STEP = 1e-11
"""Largest Newton step that may remain at a solution, in natural units: two digits below what the simulator confirms.

A small residual alone is not enough: the end of a slip that has just appeared is a root with a slope near zero.
"""
LARGEST_ROUNDING = 1e-10
"""If a full Newton step does not reduce a violation below this, in natural units, the violation is rounding. It is
1e-13 or less at a solution, unless its torques are stiff."""
ITERATIONS = 11
"""Largest number of Newton iterations."""
CONTRACTION = 0.5
"""Largest ratio of two Newton steps next to each other. At a solution, a larger ratio shows that only rounding is left;
elsewhere, that the solution does not belong to the prediction."""
SLOW = 0.2
"""If a chord leaves more than this fraction of the violation, it is replaced by a new Jacobian."""
LONGEST_FIRST_STEP = 0.2
"""Longest first step in natural units from a prediction, or a guess, next to its solution."""
LARGEST_WEIGHTS = 100.0
"""Largest sum of the absolute weights of an extrapolation; a larger one amplifies rounding too much."""
SMALLEST_COSINE = 0.5
"""If the cosine of the angle between two tangents is smaller, the curve has turned too far for extrapolation.

Predictions are cubics through two points with their tangents. Three points would save a third of the chords, but they
magnify rounding where a gait vanishes: its location would only be accurate to 1e-8.
"""
STRAIGHT = 0.98
"""Cosine of the largest angle between the tangents of neighbours on a straight step."""
ASIDE = 0.2
"""Largest distance of the end of a straight step from its prediction along the tangent, in step lengths."""
GROWTH = 2.0
"""Factor by which the length of a step grows or shrinks."""
FEW_ITERATIONS, MANY_ITERATIONS = 5, 8
"""The length grows if a step took no more than the first number of Newton iterations, and shrinks if it took more than
the second one."""
LARGEST_NULL_RESIDUAL = 1e-5
"""Largest violation of the linearised equalities by a unit null vector at a branch point that is known to eight
digits."""
INVERSE_ITERATIONS = 2
"""Number of inverse iterations. After one, the null vector of a matrix that is singular to nine digits is accurate to
nine digits."""
LENGTH_TOLERANCE = 1e-13
"""Tolerance of a zero in arclength; the parameter is then accurate to more than ten digits of its range."""


class Iterate(Protocol):
    """Unknowns with the values and the derivative of some equations, which are computed on first use."""

    @property
    def w(self) -> Array:
        """The unknowns."""

    @property
    def residual(self) -> Array:
        """Values of the n equations."""

    @property
    def jacobian(self) -> SparseMatrix:
        """Derivative of the equations by all unknowns."""


At = TypeVar("At", bound=Iterate)
At_co = TypeVar("At_co", bound=Iterate, covariant=True)
T = TypeVar("T")


class Equations(Protocol[At_co]):
    """Equations in at least as many unknowns; excess unknowns are parameters and come last."""

    @property
    def unknown_units(self) -> Array:
        """Natural units of the unknowns."""

    @property
    def equality_units(self) -> Array:
        """Natural units of the equations."""

    def violation(self, w: Array) -> Array:
        """Values of the equations."""

    def at(self, w: Array) -> At_co:
        """The unknowns with values and derivative."""


class Fixed(Generic[At]):
    """The equations with their parameters fixed: as many equations as unknowns."""

    def __init__(self, equations: Equations[At]) -> None:
        self.equations, self.rows = equations, equations.equality_units
        self.columns = equations.unknown_units[: self.rows.size]

    def violation(self, w: Array) -> Array:
        """Values of the equations."""
        return self.equations.violation(w)

    def residual(self, at: At) -> Array:
        """Values of the equations at an iterate, which knows most of them."""
        return at.residual

    def matrix(self, at: At) -> ScaledMatrix:
        """The derivative in natural units."""
        return ScaledMatrix(at.jacobian.leading(self.rows.size), self.rows, self.columns)


class Perpendicular(Generic[At]):
    """The equations and one more, by which the step from a prediction is perpendicular to a normal.

    Parameters
    ----------
    predicted : ndarray - the predicted unknowns.
    indices : indices of the unknowns in which the normal has entries.
    normal : ndarray - these entries: the new equation is normal' (w - predicted)[indices] = 0.
    """

    def __init__(self, equations: Equations[At], predicted: Array, indices: NDArray[np.intp], normal: Array) -> None:
        self.equations, self._indices, self._normal = equations, indices, normal
        self._predicted = predicted[indices]
        self.rows, self.columns = np.append(equations.equality_units, 1.0), equations.unknown_units

    def violation(self, w: Array) -> Array:
        """Values of the equations."""
        return np.append(self.equations.violation(w), self._offset(w))

    def residual(self, at: At) -> Array:
        """Values of the equations at an iterate, which knows most of them."""
        return np.append(at.residual, self._offset(at.w))

    def matrix(self, at: At) -> ScaledMatrix:
        """The derivative in natural units."""
        return ScaledMatrix(at.jacobian.with_row(self._indices, self._normal), self.rows, self.columns)

    def _offset(self, w: Array) -> float:
        return float(self._normal @ (w[self._indices] - self._predicted))


@dataclass(frozen=True, slots=True, kw_only=True)
class Correction(Generic[At]):
    """A solution next to a prediction.

    Attributes
    ----------
    at : the solution.
    matrix : the derivative there.
    iterations : number of Newton iterations.
    is_near : whether the first step was short and each later one at most half of the one before, so that the solution
        belongs to the prediction and not to another family.
    """

    at: At
    matrix: ScaledMatrix
    iterations: int
    is_near: bool


@overflow_allowed()
def corrected(
    system: Fixed[At] | Perpendicular[At], predicted: Array, chord: ScaledMatrix | None = None, *, slow: float = SLOW
) -> Correction[At] | None:
    """The solution by Newton's method from ``predicted``, refined to rounding; None if it does not converge.

    Parameters
    ----------
    chord : matrix for the first steps; None for the matrix at ``predicted``.
    slow : after a step that leaves more than this fraction of the violation, the matrix is computed anew; 0 stands
        for a new matrix in every step.
    """
    w, last, full = predicted, np.inf, False
    is_near, longest = True, LONGEST_FIRST_STEP
    try:
        for iterations in range(ITERATIONS + 1):
            violation = system.violation(w)
            size = float(np.abs(violation / system.rows).max())
            at_rounding = full and size > SLOW * last and size < LARGEST_ROUNDING
            solved = size < RESIDUAL or at_rounding
            if iterations and size > slow * last:
                chord = None
            if not solved:
                if iterations == ITERATIONS or not np.isfinite(size):
                    return None
                full = chord is None
                chord = chord or system.matrix(system.equations.at(w))
            if chord is not None:  # also at a solution, where one more chord leads to rounding
                step = chord.solve(violation)
                moved = float(np.abs(step / system.columns).max())
                is_near = is_near and (moved <= longest or moved < LARGEST_LAST_STEP)
                longest = CONTRACTION * moved
                w = w.copy()
                w[: step.size] -= step
            if solved:
                break
            last = size
        at, matrix = _polished(system, w)
    except UNDEFINED:
        return None
    return Correction(at=at, matrix=matrix, iterations=iterations, is_near=is_near)


def _polished(system: Fixed[At] | Perpendicular[At], w: Array) -> tuple[At, ScaledMatrix]:
    """The solution after full Newton steps, down to ``LARGEST_LAST_STEP`` or rounding, and its derivative.

    Raises
    ------
    RuntimeError, LinAlgError
        If the equations have no derivative at ``w``.
    """
    at = system.equations.at(w)
    matrix = system.matrix(at)
    best, last = (at, matrix), np.inf
    try:
        while True:
            step = matrix.solve(system.residual(at))
            size = float(np.abs(step / system.columns).max())
            if not size < CONTRACTION * last:
                return best
            if size < LARGEST_LAST_STEP:
                return at, matrix
            best, last = (at, matrix), size
            w = at.w.copy()
            w[: step.size] -= step
            at = system.equations.at(w)
            matrix = system.matrix(at)
    except UNDEFINED:
        return best


def predictions(
    positions: Sequence[float], solutions: Sequence[Array], position: float, slopes: Sequence[Array] = ()
) -> Iterator[Array]:
    """Predictions at another position on a curve, by polynomials through the last solutions.

    The first polynomial passes through all solutions, every further one through one solution less. Polynomials that
    would amplify rounding too much at ``position`` are left out. The last prediction is the last solution itself.

    Parameters
    ----------
    positions, solutions : positions on the curve and the solutions there, the last one first.
    slopes : derivatives of the solutions by the position, if they are known.
    """
    for count in range(len(positions), 0, -1):
        weights = extrapolation(positions[:count], position, slopes=bool(slopes))
        if weights is not None or count == 1:
            known = np.array([*solutions[:count], *slopes[:count]])
            yield known[0] if weights is None else np.asarray(weights @ known)


def extrapolation(positions: Sequence[float], position: float, *, slopes: bool = False) -> Array | None:
    """Weights of values (and derivatives, if ``slopes``) at some positions in a polynomial's value at another one.

    Returns
    -------
    weights : ndarray, shape (n,), or (2 n,) with those of the derivatives last; None if ``position`` is too far
        away.
    """
    unit = max(abs(s) for s in (*positions, position)) or 1.0
    x, powers = np.array(positions) / unit, np.arange(len(positions) * (2 if slopes else 1))
    rows = x[:, None] ** powers
    if slopes:
        rows = np.vstack([rows, powers * x[:, None] ** np.maximum(powers - 1, 0) / unit])
    try:
        weights = np.linalg.solve(rows.T, (position / unit) ** powers)
    except np.linalg.LinAlgError:  # two positions coincide
        return None
    return weights if np.abs(weights[: x.size]).sum() < LARGEST_WEIGHTS else None


def next_length(length: float, iterations: int) -> float:
    """The length of the next step after a step of this length, from the number of its Newton iterations."""
    if iterations > MANY_ITERATIONS:
        return length / GROWTH
    return length * (GROWTH if iterations <= FEW_ITERATIONS else 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Point(Generic[At]):
    """A point of a curve.

    Attributes
    ----------
    at : unknowns, values and Jacobian of the equations.
    tangent : ndarray, shape of w - direction of the curve, of unit length in y.
    bordered : the Jacobian with this tangent as its last row.
    iterations : number of Newton iterations that led here.
    earlier : unknowns and tangent of the point before this one, which serve to extrapolate the next one; None if none.
    """

    at: At
    tangent: Array
    bordered: ScaledMatrix
    iterations: int
    earlier: tuple[Array, Array] | None = None


class SolutionCurve(Generic[At]):
    """The solutions of n equations in n + 1 unknowns, the last of which is the parameter.

    Parameters
    ----------
    equations : n equations in n + 1 unknowns.
    indices : ascending indices of the unknowns in which arclength is measured; the last is that of the parameter.
    scales : scales of these unknowns.
    """

    def __init__(self, equations: Equations[At], indices: NDArray[np.intp], scales: Array) -> None:
        self.equations, self._indices, self._scales = equations, indices, scales

    def entries(self, w: Array) -> Array:
        """The unknowns in which arclength is measured."""
        return np.asarray(w[self._indices])

    def coordinates(self, w: Array) -> Array:
        """The unknowns y in which arclength is measured, divided by their scales."""
        return self.scaled(self.entries(w))

    def scaled(self, entries: Array) -> Array:
        """The ``entries`` of a w, divided by their scales."""
        return entries / self._scales

    def ahead(self, sign: float) -> Array:
        """The direction in which the parameter alone rises or falls, as ``sign`` says; shape of y."""
        direction = np.zeros(self._indices.size)
        direction[-1] = sign
        return self.scaled(direction)

    def nearest(self, w: Array, forward: Array) -> Point[At] | None:
        """The point next to ``w`` at the same parameter; its tangent points along ``forward`` (shape of y)."""
        end = corrected(Fixed(self.equations), w)
        return None if end is None else self.through(end.at, forward, end.iterations)

    def across(self, w: Array, normal: Array) -> Point[At] | None:
        """The point next to ``w`` perpendicular to ``normal`` (shape of y), along which its tangent points."""
        return self._corrected(w, normal)

    def beside(self, w: Array, direction: Array, length: float) -> Point[At] | None:
        """The point of another branch through ``w`` whose projection on ``direction`` (shape of w) is ``length``."""
        return self._corrected(w + length * direction, np.sign(length) * self.coordinates(direction))

    def step(self, here: Point[At], length: float) -> Point[At] | None:
        """The point at arclength ``length`` along the tangent; None if Newton's method does not converge."""
        normal, positions = self.coordinates(here.tangent), [0.0]
        solutions, slopes = [here.at.w], [here.tangent]
        if here.earlier is not None:
            w, tangent = here.earlier
            slope = float(normal @ self.coordinates(tangent))
            if slope >= SMALLEST_COSINE:
                positions.append(float(normal @ (self.coordinates(w) - self.coordinates(here.at.w))))
                solutions.append(w)
                slopes.append(tangent / slope)
        for predicted in predictions(positions, solutions, length, slopes):
            end = self._corrected(predicted, normal, here.bordered)
            if end is not None:
                return replace(end, earlier=(here.at.w, here.tangent))
        return None

    @overflow_allowed()
    def at_parameter(self, here: Point[At], value: float) -> Point[At] | None:
        """The point next to ``here`` at this value of the parameter; None if Newton's method fails."""
        slope = here.tangent[-1]
        predicted = here.at.w + here.tangent * ((value - here.at.w[-1]) / slope if slope else 0.0)
        predicted[-1] = value
        return self.nearest(predicted, self.coordinates(here.tangent))

    def is_straight(self, here: Point[At], there: Point[At], length: float) -> bool:
        """Whether a step of this length has ended near its prediction along the tangent, and in its direction."""
        tangent = self.coordinates(here.tangent)
        moved = self.coordinates(there.at.w) - self.coordinates(here.at.w)
        turn = tangent @ self.coordinates(there.tangent)
        return bool(turn > STRAIGHT and np.linalg.norm(moved - length * tangent) < ASIDE * length)

    @overflow_allowed()
    def crossing(self, w: Array, along: Array) -> Array | None:
        """Direction of another branch through ``w``, of unit length in y; None if there is none.

        It is the null vector of the Jacobian bordered by the tangent of the known branch, by inverse iteration.

        Parameters
        ----------
        along : ndarray, shape of y - tangent of the known branch in scaled coordinates.
        """
        at = self.equations.at(w)
        bordered = self._bordered(at, along)
        vector = np.random.default_rng(0).standard_normal(w.size) / self.equations.unknown_units
        for _ in range(INVERSE_ITERATIONS):
            try:
                vector = bordered.solve(bordered.solve_transposed(vector))
            except RuntimeError:  # singular
                return None
            vector /= np.linalg.norm(self.coordinates(vector))
        left = np.abs(at.jacobian @ vector / self.equations.equality_units).max()
        return vector if left < LARGEST_NULL_RESIDUAL else None

    def through(
        self, at: At, forward: Array, iterations: int = 0, bordered: ScaledMatrix | None = None
    ) -> Point[At] | None:
        """A solution as a point of the curve, with its tangent along ``forward`` (shape of y); None if it has none.

        Parameters
        ----------
        bordered : Jacobian with ``forward`` as the last row, if it is known.
        """
        right = np.zeros(at.w.size)
        right[-1] = 1.0
        try:
            tangent = (bordered or self._bordered(at, forward)).solve(right)
        except RuntimeError:  # singular
            return None
        return self.point(at, tangent / np.linalg.norm(self.coordinates(tangent)), iterations)

    def point(
        self,
        at: At,
        tangent: Array,
        iterations: int,
        earlier: tuple[Array, Array] | None = None,
    ) -> Point[At]:
        """A solution with a known tangent as a point of the curve."""
        bordered = self._bordered(at, self.coordinates(tangent))
        return Point(at=at, tangent=tangent, bordered=bordered, iterations=iterations, earlier=earlier)

    def _corrected(self, predicted: Array, normal: Array, chord: ScaledMatrix | None = None) -> Point[At] | None:
        """The point perpendicular to ``normal`` (shape of y), which becomes the direction of its tangent."""
        system = Perpendicular(self.equations, predicted, self._indices, normal / self._scales)
        end = corrected(system, predicted, chord)
        return None if end is None else self.through(end.at, normal, end.iterations, end.matrix)

    def _bordered(self, at: At, normal: Array) -> ScaledMatrix:
        return Perpendicular(self.equations, at.w, self._indices, normal / self._scales).matrix(at)


@dataclass(frozen=True, slots=True, kw_only=True)
class Location(Generic[T]):
    """A zero of a function on a step along a curve.

    Attributes
    ----------
    length : arclength from the start of the step.
    point : the point there.
    status : ``converged``, or ``guess`` for the last known point before the zero, if Newton's method failed on the way.
    """

    length: float
    point: T
    status: str


def located(
    start: T, end: T, length: float, step: Callable[[float], T | None], function: Callable[[T], float]
) -> Location[T]:
    """The zero of ``function`` on the step of arclength ``length`` from ``start`` to ``end``; if none, ``start``.

    Parameters
    ----------
    step : maps an arclength from ``start`` to the point there, or to None if there is none.
    """
    points: dict[float, T] = {0.0: start, length: end}
    if function(start) * function(end) > 0:
        return Location(length=0.0, point=start, status="converged")

    def value(at: float) -> float:
        if at not in points:
            point = step(at)
            if point is None:
                raise _LostError
            points[at] = point
        return function(points[at])

    try:
        root = bracketed_root(value, 0.0, length, LENGTH_TOLERANCE)
    except _LostError:
        last = max(at for at, point in points.items() if function(point) * function(start) >= 0)
        return Location(length=last, point=points[last], status="guess")
    value(root)
    return Location(length=root, point=points[root], status="converged")


class _LostError(Exception):
    """Newton's method did not converge at a trial length."""
