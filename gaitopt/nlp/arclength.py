"""The curve of gaits in one free parameter: Newton's method on the equations with the plane of pseudo-arclength.

    F(w) = 0,      n' (y(w) - y_predicted) = 0,      y = (section state after impact, durations, parameter) / scales

Arclength is measured in y only, so that the mesh does not affect it. The durations belong to it: where a slip velocity
or a cone margin grazes zero, only they move along the curve. The Jacobian of the previous point serves as a chord while
it contracts.

H. B. Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.iteration import NO_CONTRACTION, iterate, overflow_allowed
from gaitopt.nlp.newton import Solution, extrapolation
from gaitopt.nlp.shooting import MultipleShooting
from gaitopt.nlp.sparse import ScaledMatrix

RESIDUAL = 1e-13
"""Largest violation of an equality on the curve, in natural units; some thirty times the rounding of a step.

One chord more then leads to rounding, also where the equations are so flat that a prediction meets them.
"""
PRECISION = 1e-11
"""Largest Newton step that a solution may have left, in natural units: two digits below what the simulator confirms.

A small residual alone is not enough: the end of a slip that has just appeared is a root with a slope near zero.
"""
ITERATIONS = 11
SINGULAR = 1e-5
"""Violation of the linearised equalities by a unit null vector, where the branch point is known to eight digits."""
INVERSE_ITERATIONS = 2
"""The null vector of a matrix that is singular to nine digits is right to as many after one."""
REMEMBERED = 1
"""Points before the last one that are extrapolated from: with slopes a cubic polynomial, which adds little rounding.

With two of them a third of the chords is saved, but where a gait vanishes rounding is enlarged to 1e-8 of its place.
"""
FORWARD = 0.5
"""Cosine of the angle between tangents beyond which the curve has turned too far to be extrapolated."""
CONTRACTION = 0.5
"""Ratio of Newton steps above which only rounding is left."""
SLOW = 0.2
"""A chord that contracts by less than this is replaced by a new Jacobian."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint:
    """A point of the curve of gaits.

    Attributes
    ----------
    at : equalities and Jacobian.
    tangent : ndarray, shape of w - direction of the curve, of unit length in y.
    bordered : the Jacobian with this tangent.
    iterations : what Newton's method took to get here.
    earlier : solution and tangent of the last points on the way here, the latest first.
    """

    at: Solution
    tangent: Array
    bordered: ScaledMatrix
    iterations: int
    earlier: tuple[tuple[Array, Array], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Trial:
    """Equations and offset from the plane of pseudo-arclength at one iterate, and the chord that serves there."""

    w: Array
    residual: Array
    offset: float
    size: float
    chord: ScaledMatrix | None


class Curve:
    """The curve of solutions of one transcription in its one freed parameter.

    Parameters
    ----------
    transcription : with exactly one freed parameter.
    p : ndarray - values of the others.
    scales : ndarray, shape (n_xi + n_phases + 1,) - scales of the section coordinates, durations and parameter.
    """

    def __init__(self, transcription: MultipleShooting, p: Array, scales: Array) -> None:
        self.transcription, self.p = transcription, p
        section = transcription.system.section(transcription.layout.cycle.impact)
        n_w, n_phases = transcription.w.numel(), transcription.n_phases
        self._indices = np.concatenate([section, np.arange(n_w - 1 - n_phases, n_w)])
        self.scales = scales
        self._units = transcription.units(p)
        self._columns = np.append(self._units.unknowns[:-1], scales[-1])

    def coordinates(self, w: Array) -> Array:
        """The scaled coordinates y in which arclength is measured; shape (n_xi + n_phases + 1,)."""
        return self.entries(w) / self.scales

    def entries(self, w: Array) -> Array:
        """Section coordinates, durations and parameter, in SI; shape (n_xi + n_phases + 1,)."""
        return np.asarray(w[self._indices])

    def direction(self, y: Array) -> Array:
        """The change of w that belongs to a change of the scaled coordinates; other entries are zero."""
        w = np.zeros(self.transcription.w.numel())
        w[self._indices] = y * self.scales
        return w

    def start(self, w: Array, forward: Array) -> CurvePoint | None:
        """The point of the curve next to ``w`` at the same parameter, its tangent along ``forward`` (shape of w)."""
        upright = np.zeros(self._indices.size)
        upright[-1] = 1.0
        return self._correct(w, upright, None, self.coordinates(forward), at_parameter=True)

    def point(self, w: Array, tangent: Array, iterations: int, earlier: tuple[tuple[Array, Array], ...]) -> CurvePoint:
        """The point with these entries, see ``CurvePoint``; nothing is solved."""
        at = Solution(self.transcription, w, self.p)
        bordered = self._bordered(at, self.coordinates(tangent))
        return CurvePoint(at=at, tangent=tangent, bordered=bordered, iterations=iterations, earlier=earlier)

    def step(self, point: CurvePoint, length: float) -> CurvePoint | None:
        """The point at arclength ``length`` along the tangent; None if Newton's method does not converge."""
        normal, ahead = self.coordinates(point.tangent), point.at.w + length * point.tangent
        for predicted in (self._extrapolated(point, length), ahead) if point.earlier else (ahead,):
            end = self._correct(predicted, normal, point.bordered, normal)
            if end is not None:
                earlier = ((point.at.w, point.tangent), *point.earlier)
                return replace(end, earlier=earlier[:REMEMBERED])
        return None

    def _extrapolated(self, point: CurvePoint, length: float) -> Array:
        """The solution at arclength ``length`` on the polynomial through points and tangents up to here."""
        normal, here = self.coordinates(point.tangent), self.coordinates(point.at.w)
        places, weights = [0.0], np.array([1.0, length])
        known = [(point.at.w, point.tangent)]
        for w, tangent in point.earlier:
            place, slope = float(normal @ (self.coordinates(w) - here)), float(normal @ self.coordinates(tangent))
            following = None if slope < FORWARD else extrapolation([*places, place], length, slopes=True)
            if following is None:
                break
            places, known, weights = [*places, place], [*known, (w, tangent / slope)], following
        values, slopes = zip(*known, strict=True)
        return np.asarray(weights @ np.array([*values, *slopes]))

    @overflow_allowed()
    def at_parameter(self, point: CurvePoint, value: float) -> CurvePoint | None:
        """The point near ``point`` with the given value of the parameter."""
        slope = point.tangent[-1]
        predicted = point.at.w + point.tangent * ((value - point.at.w[-1]) / slope if slope else 0.0)
        predicted[-1] = value
        return self.start(predicted, point.tangent)

    @overflow_allowed()
    def crossing(self, w: Array, along: Array) -> Array | None:
        """Direction of another branch through ``w``: the null vector of the Jacobian bordered by the branch's own.

        At a branch point the null space of the Jacobian is a plane; the null vector, by inverse iteration, is the
        direction in it that is perpendicular to the tangent. None where there is no such plane.

        Parameters
        ----------
        along : ndarray, shape of y - tangent of the known branch in scaled coordinates.
        """
        at = Solution(self.transcription, w, self.p)
        bordered = self._bordered(at, along)
        vector = np.random.default_rng(0).standard_normal(w.size) / self._columns
        for _ in range(INVERSE_ITERATIONS):
            try:
                vector = bordered.solve(bordered.solve_transposed(vector))
            except RuntimeError:  # singular
                return None
            vector /= np.linalg.norm(self.coordinates(vector))
        left = np.abs(at.jacobian @ vector / self._units.equalities).max()
        return vector if left < SINGULAR else None

    def branch_off(self, w: Array, direction: Array, length: float) -> CurvePoint | None:
        """The point of another branch through ``w`` whose projection on ``direction`` (shape of w) is ``length``."""
        normal = self.coordinates(direction)
        return self._correct(w + length * direction, normal, None, np.sign(length) * normal)

    @overflow_allowed()
    def _correct(
        self,
        predicted: Array,
        normal: Array,
        chord: ScaledMatrix | None,
        forward: Array,
        *,
        at_parameter: bool = False,
    ) -> CurvePoint | None:
        """Newton's method from ``predicted`` perpendicular to ``normal``, or at exactly the predicted parameter."""

        def trial(w: Array, chord: ScaledMatrix | None, last: float) -> _Trial:
            """The equations at ``w``, with the Jacobian that is still good for the next step."""
            residual = self.transcription.violation(w, self.p)
            offset = float(normal @ (self.coordinates(w) - self.coordinates(predicted)))
            size = max(float(np.abs(residual / self._units.equalities).max()), abs(offset))
            return _Trial(w=w, residual=residual, offset=offset, size=size, chord=None if size > SLOW * last else chord)

        def moved(at: _Trial, chord: ScaledMatrix) -> Array:
            w = at.w - chord.solve(np.append(at.residual, at.offset))
            if at_parameter:
                w[-1] = predicted[-1]  # which rounding would move, perhaps out of its range
            return w

        def following(at: _Trial) -> _Trial:
            chord = at.chord or self._bordered(Solution(self.transcription, at.w, self.p), normal)
            return trial(moved(at, chord), chord, at.size)

        try:
            end = iterate(
                trial(predicted, chord, np.inf),
                following,
                size=lambda at: at.size,
                solved=lambda at: at.size < RESIDUAL,
                most=ITERATIONS,
                contraction=NO_CONTRACTION,
            )
            if not end.solved:
                return None
            last = end.at
            w = last.w if last.chord is None else moved(last, last.chord)
        except RuntimeError:  # singular
            return None
        at = self._precise(Solution(self.transcription, w, self.p), normal, at_parameter=at_parameter)
        return self.through(at, forward, end.count)

    def _precise(self, at: Solution, normal: Array, *, at_parameter: bool) -> Solution:
        """The solution after as many Newton steps perpendicular to ``normal`` as ``PRECISION`` and rounding ask for."""
        last, best = np.inf, at
        while True:
            try:
                step = self._bordered(at, normal).solve(np.append(at.residual, 0.0))
            except RuntimeError:  # singular
                return best
            if at_parameter:
                step[-1] = 0.0
            size = float(np.abs(step / self._columns).max())
            if not size < CONTRACTION * last:
                return best
            if size < PRECISION:
                return at
            last, best = size, at
            at = Solution(self.transcription, at.w - step, self.p)

    def through(self, at: Solution, forward: Array, iterations: int = 0) -> CurvePoint | None:
        """A solution as a point of the curve, its tangent along ``forward`` (shape of y); None where it has none."""
        right = np.zeros(at.w.size)
        right[-1] = 1.0
        try:
            tangent = self._bordered(at, forward).solve(right)
        except RuntimeError:  # singular
            return None
        tangent /= np.linalg.norm(self.coordinates(tangent))
        bordered = self._bordered(at, self.coordinates(tangent))
        return CurvePoint(at=at, tangent=tangent, bordered=bordered, iterations=iterations)

    def _bordered(self, at: Solution, normal: Array) -> ScaledMatrix:
        matrix = at.jacobian.with_row(self._indices, normal / self.scales)
        return ScaledMatrix(matrix, np.append(self._units.equalities, 1.0), self._columns)
