"""A cycle of steps whose mode sequence is open: finite elements with switch detection, solved by a homotopy in IPOPT.

    f_t = -mu (2 a - 1) f_n                          a in [0, 1]
    v_t = v_forward - v_backward,                    0 <= a _|_ v_backward >= 0,    0 <= 1 - a _|_ v_forward >= 0

at the stages of Radau IIA collocation on elements of free length. The products are summed over an element and over the
velocities at its start, so that no mode can change inside an element: switches come to lie between elements. The
products stay below sigma, which falls to zero in a sequence of programs (Scholtes). Impacts obey the same law. Static
friction is that of a slip here, and a slipping impact has Coulomb's impulse; the NLP with fixed modes and the simulator
decide about anything else that a problem states.

The guess is a cycle in which all joints move at constant rates and the foot does not slip.

References
----------
A. Nurkanovic, M. Sperl, S. Albrecht, M. Diehl, Finite elements with switch detection for direct optimal control of
nonsmooth systems, Numerische Mathematik 156 (2024).
S. Scholtes, Convergence properties of a regularization scheme for mathematical programs with complementarity
constraints, SIAM J. Optim. 11 (2001).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter

import numpy as np
from casadi import MX, sum1, vertcat

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Status
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.solver.ipopt import Block, Ipopt, Program
from gaitopt.solver.shooting import substituted

Range = tuple[float, float]

SIGMAS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9)
"""Bounds of the products, whose factors are of the order of one."""
TOLERANCE = 1e-8
"""A solution is a proposal, which another NLP polishes."""
MAX_ITERATIONS = 150
"""For one sigma; a solution that exists takes about twenty."""
ELEMENTS = 14
"""A step of three phases then has about five elements per phase."""
STAGES = np.array([(4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0])
"""Nodes of Radau IIA of order 5."""
_POWERS = np.arange(STAGES.size)
RADAU = (STAGES[:, None] ** (_POWERS + 1) / (_POWERS + 1)) @ np.linalg.inv(np.vander(STAGES, increasing=True))
"""Coefficients of the collocation: integrals of the Lagrange polynomials on the stages."""
DECIDED = 1e-3
"""a this close to 0 or 1 throughout an element is a slip."""
SHORTEST_ELEMENT, LONGEST_ELEMENT = 0.1, 4.0
"""Length of an element relative to the mean."""
EVEN = 1e-2
"""Weight of the unevenness of the elements, the only objective of a walker without free parameters."""
TIME_RANGE = 5.0
"""The period is within this factor of the guess."""
LANDING_RATE = 0.05
"""Least rate of the guard at touchdown in natural units: feet that stay together are not a step."""


def swing(dynamics: Dynamics, shapes: Array, period: float) -> tuple[Array, Array]:
    """States at the two ends of each step of a cycle without slip in which all joints move at constant rates.

    Parameters
    ----------
    shapes : ndarray, shape (n_steps, n_section) - the coordinates that are free, at the start of each step.
    period : of a step [s].

    Returns
    -------
    starts, ends : ndarrays, shape (n_steps, n_z).
    """
    n = dynamics.system.n_shape
    starts = np.array([dynamics.lift(np.concatenate([shape, np.zeros(n)])) for shape in shapes])
    ends = starts.copy()
    ends[:, :n] = shapes_before(dynamics, np.roll(starts[:, :n], -1, axis=0))
    for states in (starts, ends):
        states[:, n + 1 : 2 * n + 1] = (ends[:, :n] - starts[:, :n]) / period
    return starts, ends


def shapes_before(dynamics: Dynamics, shapes: Array) -> Array:
    """The shapes just before an impact that it relabels to ``shapes``, shape (m, n_shape), as relabelling is affine."""
    n, zero = dynamics.system.n_shape, np.zeros(dynamics.system.n_z)
    struck = dynamics.system.walker.swapped(Mode.STICK)
    b = dynamics.after_impact(struck, zero, Mode.STICK)[:n]
    A = np.asarray(dynamics.system.reset_jacobian(struck, Mode.STICK)(zero, dynamics.p))[:n, :n]
    return np.asarray(np.linalg.solve(A, (shapes - b).T).T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """A cycle with a motion that is right to about five digits.

    Attributes
    ----------
    cycle : its mode sequences.
    durations : of the phases of every step [s].
    states : ndarray, shape (n_steps, n_z) - just after the impact before each step.
    freed : values of the free parameters by dotted key.
    """

    cycle: Cycle
    durations: tuple[tuple[float, ...], ...]
    states: Array
    freed: dict[str, float]


class Complementarity:
    """The NLP of a cycle of steps of a system with open modes.

    Parameters
    ----------
    dynamics : walker, control and ground; natural units follow from its parameters.
    period : typical one of a step [s]; breakpoints of the control before it are ends of elements.
    free : bounds of the parameters that are unknowns, by dotted key.
    within : bounds of the state just after the impact by name, if a design has any.
    n_steps : of the cycle.
    progress, should_stop : called at every iteration of IPOPT.
    """

    @building
    def __init__(
        self,
        dynamics: Dynamics,
        period: float,
        free: Mapping[str, Range] | None = None,
        within: Mapping[str, Range] | None = None,
        *,
        n_steps: int = 1,
        progress: Valued = None,
        should_stop: Stop = None,
    ) -> None:
        self._dynamics, self._system = dynamics, dynamics.system
        self._free, self._within = free or {}, within or {}
        self._n_steps = n_steps
        self._scales = dynamics.scales
        self._segments, self._fixed = _segments(self._system.control.breakpoints, period)
        self._unknowns: list[Block] = []
        self._rows: list[Block] = []
        self._products: list[MX] = []
        self._p, self._period, sigma = MX.sym("p", len(dynamics.p)), MX.sym("period"), MX.sym("sigma")
        objective = self._cycle()
        self._require("products", vertcat(*self._products) - sigma, -np.inf, 0.0)
        self._program = Program(
            unknowns=tuple(self._unknowns),
            rows=tuple(self._rows),
            p=vertcat(self._p, self._period, sigma),
            f=objective,
            x0=np.zeros(0),  # each solution has its own
            p0=np.zeros(0),
        )
        self._ipopt = Ipopt(
            self._program,
            options={"tol": TOLERANCE, "max_iter": MAX_ITERATIONS, "mu_strategy": "adaptive"},
            exact=True,
        )
        self._progress, self._should_stop = progress, should_stop
        BUILT.watch(vars(self))

    def solve(self, starts: Array, ends: Array, period: float) -> Proposal | Status:
        """The cycle near linear motions between states of shape (n_steps, n_z), each in a period [s].

        A status if IPOPT does not converge for one of the values of sigma.
        """
        w = self._guess(starts, ends, period)
        for sigma in SIGMAS:
            p0 = np.concatenate([self._dynamics.p, [period, sigma]])
            program = replace(self._program, x0=w, p0=p0)
            result = self._ipopt.solve(program, progress=self._progress, should_stop=self._should_stop)
            if result.status is not Status.CONVERGED:
                return result.status
            w = result.w
        return self._read(w)

    def _cycle(self) -> MX:
        """Unknowns, rows and products of all steps; the objective."""
        system, n, objective = self._system, self._n_steps, MX(0)
        freed = {key: self._unknown(key, 1, *bounds) for key, bounds in self._free.items()}
        p = substituted(system.parameters, self._p, freed)
        starts = [self._unknown(f"start{s}", system.n_z) for s in range(n)]
        for name, span in self._within.items():
            self._require(f"state.{name}", starts[0][system.state_names.index(name)], *span)
        feet = [self._foot(f"impact{s}", 1) for s in range(n)]
        for s, (z, (_, *slip)) in enumerate(zip(starts, feet, strict=True)):
            h, t = self._unknown(f"h{s}", ELEMENTS, 0.0), MX(0)
            for k, segment in enumerate(self._segments):
                z, t, slip = self._element(s, k, z, t, h[k], slip, p, segment)
                if k + 1 in self._fixed:
                    self._require("breakpoint", t / self._fixed[k + 1], 1.0, 1.0)
            self._require("period", t / self._period, 1 / TIME_RANGE, TIME_RANGE)
            latest = (*system.control.breakpoints, np.inf)[segment]
            self._require("segment", t, max(self._fixed.values(), default=0.0), latest)
            mean = t / ELEMENTS
            self._require("shortest element", h - SHORTEST_ELEMENT * mean, 0.0)
            self._require("longest element", LONGEST_ELEMENT * mean - h, 0.0)
            objective += EVEN * sum1((h / mean - 1) ** 2)
            self._impact(z, starts[(s + 1) % n], feet[(s + 1) % n], p)
        return objective

    def _impact(self, z: MX, start: MX, foot: tuple[MX, MX, MX], p: MX) -> None:
        """The impact that leads from state ``z`` to ``start``."""
        a, forward, backward = foot
        z_plus, impulse, slip, lift = self._system.open_impact(z, 2 * a - 1, p)
        n = self._system.n_shape
        self._require("reset", start - vertcat(z_plus[:n], 0, z_plus[n + 1 :]), 0.0, 0.0)
        self._require("slip after the impact", slip / self._scales.speed - forward + backward, 0.0, 0.0)
        self._require("impulse", vertcat(impulse[1], lift), 0.0)
        self._products += [a * backward, (1 - a) * forward]

    def _element(
        self, s: int, k: int, z: MX, t: MX, h: MX, before: list[MX], p: MX, segment: int
    ) -> tuple[MX, MX, list[MX]]:
        """Collocation on an element from state ``z`` at time ``t``; state, time and foot velocities at its end."""
        system, n = self._system, STAGES.size
        data = system.data(segment)
        states = [self._unknown(f"z{s}.{k}.{i}", system.n_z) for i in range(n)]
        a, forward, backward = self._foot(f"foot{s}.{k}", n)
        rates: list[MX] = []
        for i, (c, stage) in enumerate(zip(STAGES, states, strict=True)):
            rate, force, guard, guard_rate = system.open_flow(t + c * h, stage, 2 * a[i] - 1, p, data)
            rates.append(rate)
            self._require("normal force", force[1], 0.0)
            self._require("slip velocity", stage[-1] / self._scales.speed - forward[i] + backward[i], 0.0, 0.0)
        for stage, row in zip(states, RADAU, strict=True):
            step = sum((float(b) * rate for b, rate in zip(row, rates, strict=True)), MX(0))
            self._require("collocation", stage - z - h * step, 0.0, 0.0)
        if k == ELEMENTS - 1:
            self._require("touchdown", guard, 0.0, 0.0)
            self._require("rate of touchdown", guard_rate * self._scales.time, LANDING_RATE)
        self._products += [sum1(a) * (before[1] + sum1(backward)), (n - sum1(a)) * (before[0] + sum1(forward))]
        return states[-1], t + h, [forward[-1], backward[-1]]

    def _foot(self, name: str, n: int) -> tuple[MX, MX, MX]:
        """The friction multiplier a and the two parts of the slip velocity, at n stages."""
        return (
            self._unknown(f"{name}.a", n, 0.0, 1.0),
            self._unknown(f"{name}.forward", n, 0.0),
            self._unknown(f"{name}.backward", n, 0.0),
        )

    def _unknown(self, name: str, size: int, lower: float = -np.inf, upper: float = np.inf) -> MX:
        symbol = MX.sym(name, size)
        self._unknowns.append(Block(name=name, expression=symbol, lower=lower, upper=upper))
        return symbol

    def _require(self, name: str, row: MX, lower: float, upper: float = np.inf) -> None:
        self._rows.append(Block(name=name, expression=row, lower=lower, upper=upper))

    def _guess(self, starts: Array, ends: Array, period: float) -> Array:
        """Straight lines from ``starts`` to ``ends``, the foot at rest."""
        times = _times(self._fixed, period)
        h = np.diff(times)
        values = {key: np.array([self._dynamics.parameter(key)]) for key in self._free}
        for s, (start, end) in enumerate(zip(starts, ends, strict=True)):
            values |= {f"start{s}": start, f"h{s}": h, f"impact{s}.a": np.array([0.5])}
            for k in range(ELEMENTS):
                values[f"foot{s}.{k}.a"] = np.full(STAGES.size, 0.5)
                for i, c in enumerate(STAGES):
                    values[f"z{s}.{k}.{i}"] = start + (times[k] + c * h[k]) / period * (end - start)
        return np.concatenate([values.get(b.name, np.zeros(b.expression.numel())) for b in self._unknowns])

    def _read(self, w: Array) -> Proposal:
        """The cycle of a solution: one mode per element, with equal neighbours merged."""
        names, sizes = zip(*((block.name, block.expression.numel()) for block in self._unknowns), strict=True)
        values: dict[str, Array] = dict(zip(names, np.split(w, np.cumsum(sizes)[:-1]), strict=True))
        impacts = [_mode(values[f"impact{s}.a"]) for s in range(self._n_steps)]
        states = np.array([values[f"start{s}"] for s in range(self._n_steps)])
        states[[impact.sticks for impact in impacts], -1] = 0.0
        steps, durations = list[ModeSequence](), list[tuple[float, ...]]()
        for s, impact in enumerate(impacts):
            modes = [_mode(values[f"foot{s}.{k}.a"]) for k in range(ELEMENTS)]
            if impact.slips:  # even if the slip is too short for an element
                modes[0] = impact
            runs = groupby(zip(modes, values[f"h{s}"].tolist(), strict=True), itemgetter(0))
            phases, lengths = zip(*((mode, sum(h for _, h in run)) for mode, run in runs), strict=True)
            steps.append(ModeSequence(phases, impacts[(s + 1) % self._n_steps]))
            durations.append(lengths)
        return Proposal(
            cycle=Cycle(tuple(steps)),
            durations=tuple(durations),
            states=states,
            freed={key: float(values[key][0]) for key in self._free},
        )


def _segments(breakpoints: Sequence[float], period: float) -> tuple[list[int], dict[int, float]]:
    """The control's segment of every element, and the breakpoints at which elements end, by number of the next one."""
    inside = [b for b in breakpoints if 0 < b < period]
    counts = np.rint(np.array(inside) / period * ELEMENTS).astype(int)
    fixed = {int(k): b for k, b in zip(counts, inside, strict=True) if 0 < k < ELEMENTS}
    times = _times(fixed, period)
    return [int(k) for k in np.searchsorted(breakpoints, (times[1:] + times[:-1]) / 2)], fixed


def _times(fixed: dict[int, float], period: float) -> Array:
    """Ends of the elements, evenly spaced between breakpoints; shape (ELEMENTS + 1,) [s]."""
    ends = {0: 0.0, **fixed, ELEMENTS: period}
    return np.interp(np.arange(ELEMENTS + 1), list(ends), list(ends.values()))


def _mode(a: Array) -> Mode:
    if np.all(a > 1 - DECIDED):
        return Mode.SLIP_FORWARD
    return Mode.SLIP_BACKWARD if np.all(a < DECIDED) else Mode.STICK
