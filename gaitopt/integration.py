"""Runge-Kutta method of order 8 by Dormand and Prince: its tableau, compiled adaptive steps, and roots of events.

    k_i = f(t + c_i h, y + h sum_j a_ij k_j),   y_new = y + h sum_i b_i k_i,   |error| <= atol + rtol max(|y|, |y_new|)

The method has 12 stages, error estimates of order 5 and 3, and 3 more stages for points inside a step. The coefficients
and the step size control are those of scipy's DOP853. The latter takes a third of a second to import, and ten times as
long for a step, because it calls Python for every stage.

E. Hairer, S. P. Norsett, G. Wanner (1993), Solving Ordinary Differential Equations I, sections II.4, II.5 and their
code.
"""

import sys
from collections.abc import Callable, Sequence
from math import inf, nextafter, sqrt

import numpy as np
from casadi import DM, SX, Function, densify, extract_parametric, fabs, fmax, horzcat, sparsify, sumsqr, vertcat

from gaitopt.arrays import Array, read_only
from gaitopt.building import built_once
from gaitopt.model.buffered import Buffers

N_STAGES = 12


def _dense(rows: tuple[dict[int, float], ...]) -> Array:
    """A read-only matrix from the nonzero entries of its rows."""
    matrix = np.zeros((len(rows), 16))  # 12 stages, the rate at the end of the step, 3 stages inside it
    for row, entries in zip(matrix, rows, strict=True):
        row[list(entries)] = list(entries.values())
    return read_only(matrix)


# fmt: off
_C = np.array([
    0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 0.3333333333333333,
    0.25, 0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0, 1.0, 0.1, 0.2,
    0.7777777777777778,
])
_A = _dense((
    {},
    {0: 0.05260015195876773},
    {0: 0.0197250569845379, 1: 0.0591751709536137},
    {0: 0.02958758547680685, 2: 0.08876275643042054},
    {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
    {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
    {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
    {
        0: 0.03709200011850479, 3: 0.17038392571223998, 4: 0.10726203044637328, 5: -0.015319437748624402,
        6: 0.008273789163814023,
    },
    {
        0: 0.6241109587160757, 3: -3.3608926294469414, 4: -0.868219346841726, 5: 27.59209969944671,
        6: 20.154067550477894, 7: -43.48988418106996,
    },
    {
        0: 0.47766253643826434, 3: -2.4881146199716677, 4: -0.590290826836843, 5: 21.230051448181193,
        6: 15.279233632882423, 7: -33.28821096898486, 8: -0.020331201708508627,
    },
    {
        0: -0.9371424300859873, 3: 5.186372428844064, 4: 1.0914373489967295, 5: -8.149787010746927,
        6: -18.52006565999696, 7: 22.739487099350505, 8: 2.4936055526796523, 9: -3.0467644718982196,
    },
    {
        0: 2.273310147516538, 3: -10.53449546673725, 4: -2.0008720582248625, 5: -17.9589318631188,
        6: 27.94888452941996, 7: -2.8589982771350235, 8: -8.87285693353063, 9: 12.360567175794303,
        10: 0.6433927460157636,
    },
    {
        0: 0.054293734116568765, 5: 4.450312892752409, 6: 1.8915178993145003, 7: -5.801203960010585,
        8: 0.3111643669578199, 9: -0.1521609496625161, 10: 0.20136540080403034, 11: 0.04471061572777259,
    },
    {
        0: 0.056167502283047954, 6: 0.25350021021662483, 7: -0.2462390374708025, 8: -0.12419142326381637,
        9: 0.15329179827876568, 10: 0.00820105229563469, 11: 0.007567897660545699, 12: -0.008298,
    },
    {
        0: 0.03183464816350214, 5: 0.028300909672366776, 6: 0.053541988307438566, 7: -0.05492374857139099,
        10: -0.00010834732869724932, 11: 0.0003825710908356584, 12: -0.00034046500868740456,
        13: 0.1413124436746325,
    },
    {
        0: -0.42889630158379194, 5: -4.697621415361164, 6: 7.683421196062599, 7: 4.06898981839711,
        8: 0.3567271874552811, 12: -0.0013990241651590145, 13: 2.9475147891527724, 14: -9.15095847217987,
    },
))
_ERRORS = _dense((
    {
        0: 0.01312004499419488, 5: -1.2251564463762044, 6: -0.4957589496572502, 7: 1.6643771824549864,
        8: -0.35032884874997366, 9: 0.3341791187130175, 10: 0.08192320648511571, 11: -0.022355307863886294,
    },
    {
        0: -0.18980075407240762, 5: 4.450312892752409, 6: 1.8915178993145003, 7: -5.801203960010585,
        8: -0.4226823213237919, 9: -0.1521609496625161, 10: 0.20136540080403034, 11: 0.02265179219836082,
    },
))
_INSIDE = _dense((
    {
        0: -8.428938276109013, 5: 0.5667149535193777, 6: -3.0689499459498917, 7: 2.38466765651207,
        8: 2.117034582445028, 9: -0.871391583777973, 10: 2.2404374302607883, 11: 0.6315787787694688,
        12: -0.08899033645133331, 13: 18.148505520854727, 14: -9.194632392478356, 15: -4.436036387594894,
    },
    {
        0: 10.427508642579134, 5: 242.28349177525817, 6: 165.20045171727028, 7: -374.5467547226902,
        8: -22.113666853125306, 9: 7.733432668472264, 10: -30.674084731089398, 11: -9.332130526430229,
        12: 15.697238121770845, 13: -31.139403219565178, 14: -9.35292435884448, 15: 35.81684148639408,
    },
    {
        0: 19.985053242002433, 5: -387.0373087493518, 6: -189.17813819516758, 7: 527.8081592054236,
        8: -11.57390253995963, 9: 6.8812326946963, 10: -1.0006050966910838, 11: 0.7777137798053443,
        12: -2.778205752353508, 13: -60.19669523126412, 14: 84.32040550667716, 15: 11.99229113618279,
    },
    {
        0: -25.69393346270375, 5: -154.18974869023643, 6: -231.5293791760455, 7: 357.6391179106141,
        8: 93.40532418362432, 9: -37.45832313645163, 10: 104.0996495089623, 11: 29.8402934266605,
        12: -43.53345659001114, 13: 96.32455395918828, 14: -39.17726167561544, 15: -149.72683625798564,
    },
))
# fmt: on
A, C = _A[:N_STAGES, :N_STAGES], read_only(_C[:N_STAGES])
B = _A[N_STAGES, :N_STAGES]
E5, E3 = _ERRORS[:, : N_STAGES + 1]
"""Weights of the stages and of the rate at the end of the step."""
A_INSIDE, C_INSIDE = _A[N_STAGES + 1 :], read_only(_C[N_STAGES + 1 :])
"""The stages inside the step, after the rate at its end."""
D = _INSIDE
"""Weights of all stages in the coefficients of the continuous extension."""


SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0
"""Factors of the step size control: safety of the predicted step, and bounds of its ratio to the last one, as in
scipy."""
EXPONENT = -1 / 8
"""The error of a step has order 8 in its length."""
SHORTEST_STEP_IN_ULPS = 10
"""Shortest step in units of the rounding error of the time."""


class StepSizeError(ArithmeticError):
    """The step size vanishes: the motion is singular."""


class CompiledStep:
    """One compiled step of dy/dt = f(t, y, p, r), with further functions of its end point.

    Parameters
    ----------
    rate : Function (t, y, p, r) -> dy/dt, for the stages.
    point : Function (t, y, p, r) -> (dy/dt, further outputs) at the end of the step.
    rtol, atol : tolerances; the absolute one may be an array, shape (n,).
    compare : Function (further outputs at the start, further outputs at the end, ...) -> one more output of the step.

    Attributes
    ----------
    compared : tuple of ndarray - all inputs of ``compare`` except those at the end; the caller writes them in place.
    """

    def __init__(
        self, rate: Function, point: Function, *, rtol: float, atol: float | Array, compare: Function | None = None
    ) -> None:
        constants, step = _step(rate, point, compare)
        self._constants, self._step = Buffers(constants), Buffers(step)
        self._step.inputs[5][:] = rtol
        self._step.inputs[6][:] = atol
        self.compared = self._step.inputs[7:]
        self._n = rate.numel_in(1)

    def load(self, p: Array, r: Array) -> None:
        """Set the parameters of the following steps."""
        (self._step.inputs[4][:],) = self._constants(p, r)

    def try_step(self, t: float, y: Array, f: Array, h: float) -> tuple[float, Sequence[Array]]:
        """Error of a step from ``t`` in units of the tolerance, and (y_new, f_new, ...), valid until the next call."""
        time, state, rate, length, *_ = self._step.inputs
        time[0], state[:], rate[:], length[0] = t, y, f, h
        self._step.evaluate()
        squares, *outputs = self._step.outputs
        fifth, third = squares.tolist()
        size = fifth + 0.01 * third
        return (h * fifth / sqrt(size * self._n) if size else 0.0), outputs


class Integration:
    """The state of an integration, which ``advance`` moves forward by one step.

    Parameters
    ----------
    step : the compiled step, loaded with its parameters.
    t, y, f : initial time, state and rate, shape (n,).
    bound : time at which the integration ends.
    first_step : length of the first trial step.

    Attributes
    ----------
    t, y, f : current time, state and rate.
    outputs : further outputs of ``step`` at this point, valid until the next step.
    length : length of the last step.
    steps : number of steps so far.
    """

    __slots__ = ("_bound", "_next", "_step", "f", "length", "outputs", "steps", "t", "y")

    def __init__(self, step: CompiledStep, t: float, y: Array, f: Array, bound: float, first_step: float) -> None:
        self._step, self._bound, self._next = step, bound, first_step
        self.t, self.y, self.f = t, y, f
        self.outputs: Sequence[Array] = ()
        self.length, self.steps = 0.0, 0

    @property
    def finished(self) -> bool:
        """Whether the integration has reached its bound."""
        return self.t >= self._bound

    def advance(self) -> None:
        """Take one step that meets the tolerance.

        Raises
        ------
        StepSizeError
            If even the shortest step does not meet it.
        """
        shortest = SHORTEST_STEP_IN_ULPS * (nextafter(self.t, inf) - self.t)
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
            h, largest = h * max(SMALLEST_FACTOR, factor), 1.0
        raise StepSizeError("the step size of the integrator vanishes: the motion is singular")


def combined(weights: Array, stages: Sequence[SX]) -> SX:
    """The weighted sum of the stages."""
    return horzcat(*stages) @ sparsify(DM(weights[: len(stages)]))


def bracketed_root(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """A root between two arguments at which ``function`` has opposite signs, by inverse quadratics or bisection.

    T. R. Chandrupatla (1997), Advances in Engineering Software 28, 145-149. Importing scipy.optimize for it would take
    a quarter of a second.

    Parameters
    ----------
    tolerance : largest error of the root, apart from rounding.

    Raises
    ------
    ValueError
        If the signs are equal.
    """
    a, b, f_a, f_b = low, high, function(low), function(high)
    if f_a * f_b > 0:
        raise ValueError(f"no change of sign between {low:g} and {high:g}: {f_a:g} and {f_b:g}")
    fraction = 0.5
    while True:
        best, f_best = (a, f_a) if abs(f_a) < abs(f_b) else (b, f_b)
        narrow = (tolerance / 2 + sys.float_info.epsilon * abs(best)) / (abs(b - a) or 1.0)
        if f_best == 0 or not narrow < 0.5:
            return best
        x = a + min(max(fraction, narrow), 1 - narrow) * (b - a)
        f_x = function(x)
        if (f_x > 0) == (f_a > 0):
            c, f_c = a, f_a
        else:
            b, f_b, c, f_c = a, f_a, b, f_b
        a, f_a = x, f_x
        xi, phi = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        fraction = 0.5  # bisection, unless the inverse quadratic through the three points is monotone
        if phi**2 < xi and (1 - phi) ** 2 < 1 - xi:
            fraction = f_a / (f_b - f_a) * f_c / (f_b - f_c)
            fraction += (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)


@built_once(maxsize=64)
def _step(rate: Function, point: Function, compare: Function | None) -> tuple[Function, Function]:
    """(p, r) -> c; and (t, y, f, h, c, rtol, atol) -> squared errors in units of the tolerance, y_new, and ``point``.

    All terms that depend on the parameters only are in c, so that a step does not compute them at every stage.
    ``point`` is taken at the end of the step. The inputs of ``compare``, except those at the end of the step, are
    further inputs; its value is the last output.
    """
    t, y, p, r = inputs = rate.sx_in()
    ends = [*rate.call(inputs), *point.call(inputs)]
    (slope, *outputs), symbols, terms = extract_parametric(ends, vertcat(p, r), {"extract_trivial": True})
    c = vertcat(SX(0, 1), *symbols)
    constants = Function("constants", [p, r], [vertcat(SX(0, 1), *terms)])
    rate, point = Function("rate", [t, y, c], [slope]), Function("point", [t, y, c], outputs)
    n = y.numel()
    t, y, f, h, rtol, atol = (SX.sym(f"x{k}", size) for k, size in enumerate((1, n, n, 1, 1, n)))
    stages = [f]
    for a, fraction in zip(A[1:], C[1:], strict=True):
        stages.append(rate(t + float(fraction) * h, y + h * combined(a, stages), c))
    y_new = y + h * combined(B, stages)
    f_new, *others = point.call([t + h, y_new, c])
    scale = atol + rtol * fmax(fabs(y), fabs(y_new))
    squares = [sumsqr(combined(e, [*stages, f_new]) / scale) for e in (E5, E3)]
    inputs, outputs = [t, y, f, h, c, rtol, atol], [vertcat(*squares), y_new, f_new, *others]
    if compare is not None:
        further = [SX.sym(f"c{k}", compare.numel_in(k)) for k in range(compare.n_in())]
        inputs += further[: len(others)] + further[2 * len(others) :]
        outputs += compare.call([*further[: len(others)], *others, *further[2 * len(others) :]])
    return constants, Function("dop853", inputs, [densify(output) for output in outputs])
