"""The Runge-Kutta pair DOP853 with one compiled call per step, and scipy's step size control.

    k_i = f(t + c_i h, y + h sum_j a_ij k_j),   y_new = y + h sum_i b_i k_i,   |error| <= atol + rtol max(|y|, |y_new|)

Hairer, Norsett & Wanner (1993), Solving Ordinary Differential Equations I, sections II.4 and II.5. Called from Python
stage by stage, as scipy does, a step takes ten times as long.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import inf, nextafter, sqrt

from casadi import DM, SX, Function, fabs, fmax, horzcat, sparsify, sumsqr, vertcat

from gaitopt.arrays import Array
from gaitopt.integration.tableau import E3, E5, A, B, C
from gaitopt.mechanics.buffered import Buffers

SAFETY, LEAST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0
"""Of the step size control, as in scipy."""
EXPONENT = -1 / 8
SHORTEST_STEP = 10
"""In units of the rounding of the time; below it the step size vanishes."""


class StepSizeError(ArithmeticError):
    """The step size vanishes: the motion is singular."""


class CompiledStep:
    """One step of dy/dt = f(t, y, p, r), and other functions of the point that it reaches.

    Parameters
    ----------
    rate : Function (t, y, p, r) -> dy/dt, for the stages.
    point : Function (t, y, p, r) -> dy/dt and whatever else is of interest at the end of the step.
    rtol, atol : tolerances; the absolute one may be an array, shape (n,).
    compare : Function (whatever else at the start, the same at the end, ...) -> one more output of the step.

    Attributes
    ----------
    compared : tuple of ndarray - inputs of ``compare`` besides those at the end, to be written in place.
    """

    def __init__(
        self, rate: Function, point: Function, *, rtol: float, atol: float | Array, compare: Function | None = None
    ) -> None:
        self._step = Buffers(_step(rate, point, compare))
        self._step.inputs[6][:] = rtol
        self._step.inputs[7][:] = atol
        self.compared = self._step.inputs[8:]
        self._n = rate.numel_in(1)

    def load(self, p: Array, r: Array) -> None:
        """Parameters for the steps to come."""
        self._step.inputs[4][:], self._step.inputs[5][:] = p, r

    def try_step(self, t: float, y: Array, f: Array, h: float) -> tuple[float, Sequence[Array]]:
        """The error of a step from ``t``, relative to the tolerance, and (y_new, f_new, ...), valid until the next."""
        time, state, rate, length, *_ = self._step.inputs
        time[0], state[:], rate[:], length[0] = t, y, f, h
        self._step.evaluate()
        squares, *outputs = self._step.outputs
        fifth, third = squares.tolist()
        size = fifth + 0.01 * third
        return (h * fifth / sqrt(size * self._n) if size else 0.0), outputs


class Integration:
    """An integration under way.

    Parameters
    ----------
    step : loaded with its parameters.
    t, y, f : where it starts: time, state and rate, shape (n,).
    bound : time at which it ends.
    first_step : length that is tried first.

    Attributes
    ----------
    t, y, f : where it is now.
    outputs : what else ``step`` says about this point, valid until the next step.
    length : of the last step.
    steps : how many.
    """

    __slots__ = ("_bound", "_next", "_step", "f", "length", "outputs", "steps", "t", "y")

    def __init__(self, step: CompiledStep, t: float, y: Array, f: Array, bound: float, first_step: float) -> None:
        self._step, self._bound, self._next = step, bound, first_step
        self.t, self.y, self.f = t, y, f
        self.outputs: Sequence[Array] = ()
        self.length, self.steps = 0.0, 0

    @property
    def finished(self) -> bool:
        """Whether the bound is reached."""
        return self.t >= self._bound

    def advance(self) -> None:
        """One step that meets the tolerance.

        Raises
        ------
        StepSizeError
            If there is none.
        """
        shortest = SHORTEST_STEP * (nextafter(self.t, inf) - self.t)
        h, largest = max(self._next, shortest), LARGEST_FACTOR
        while h >= shortest:
            end = min(self.t + h, self._bound)
            h = end - self.t
            error, (y, f, *others) = self._step.try_step(self.t, self.y, self.f, h)
            factor = SAFETY * error**EXPONENT if error else LARGEST_FACTOR
            if error < 1:
                self.t, self.y, self.f, self.outputs, self.length = end, y.copy(), f.copy(), others, h
                self._next = h * min(largest, factor)
                self.steps += 1
                return
            h, largest = h * max(LEAST_FACTOR, factor), 1.0
        raise StepSizeError("the step size of the integrator vanishes: the motion is singular")


def combined(weights: Array, stages: Sequence[SX]) -> SX:
    """The sum of the stages with their weights."""
    return horzcat(*stages) @ sparsify(DM(weights[: len(stages)]))


@lru_cache(maxsize=64)
def _step(rate: Function, point: Function, compare: Function | None) -> Function:
    """(t, y, f, h, p, r, rtol, atol) -> squared errors of order 5 and 3 in tolerances, y_new, and ``point`` there.

    What ``compare`` needs besides the new point are further inputs, and its value the last output.
    """
    n, n_p, n_r = (rate.numel_in(k) for k in (1, 2, 3))
    sizes = (1, n, n, 1, n_p, n_r, 1, n)
    inputs = [SX.sym(f"x{k}", size) for k, size in enumerate(sizes)]
    t, y, f, h, p, r, rtol, atol = inputs
    stages = [f]
    for a, c in zip(A[1:], C[1:], strict=True):
        stages.append(rate(t + float(c) * h, y + h * combined(a, stages), p, r))
    y_new = y + h * combined(B, stages)
    f_new, *others = point.call([t + h, y_new, p, r])
    scale = atol + rtol * fmax(fabs(y), fabs(y_new))
    squares = [sumsqr(combined(e, [*stages, f_new]) / scale) for e in (E5, E3)]
    outputs = [vertcat(*squares), y_new, f_new, *others]
    if compare is not None:
        further = [SX.sym(f"c{k}", compare.numel_in(k)) for k in range(compare.n_in())]
        inputs += further[: len(others)] + further[2 * len(others) :]
        outputs += compare.call([*further[: len(others)], *others, *further[2 * len(others) :]])
    return Function("dop853", inputs, outputs)
