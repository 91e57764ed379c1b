"""The NLP of a design: the equations of the step, the constraints on its scalars, and the objective.

    min   sum of weight x scalar
    s.t.  equalities = 0, margins >= 0                     nlp.transcription
          lo <= scalar <= hi                               outcome
          extremum >= the curve's values                   for peak torque and the like

over nodes, durations, freed parameters and extrema. The radius of the multipliers is a scalar (``spectral_radius``).
It and |power| are smoothed, and what lies between the nodes is not seen: the solution is where ``sqp`` starts.

Why a design is infeasible: which constraint cannot be met, how far one gets, and what stands in the way.

All constraints of the problem are given slack, and the sum of the slacks is minimised (elastic mode). Where slack is
left, the multipliers name the bounds and constraints against which the search was pressed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from casadi import MX, Function, sum1, vertcat

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.design.quadratic import SMALL, search
from gaitopt.design.rows import CLEARANCE, EXTREMA, RADIUS, Outcome
from gaitopt.design.spectral_radius import certified_radius
from gaitopt.gait.gait import Cause, Status
from gaitopt.model.dynamics import Dynamics
from gaitopt.nlp.ipopt import NEAR_OPTIMUM, Ipopt, IpoptResult, Progress
from gaitopt.nlp.shooting import MultipleShooting
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import Range

ROUGH = 0.2
"""KKT residual, in the sizes of objective and unknowns, from where ``sqp`` goes on: it takes one iteration where IPOPT,
which learns all curvature by secants, takes twenty."""
SMOOTHING = 3e-5
"""Width of the smoothed |power| [W], relative to the walker's weight times 1 m/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Constraints of one kind on the NLP's g, with their bounds; ``name`` is that of the scalar they are about."""

    name: str
    expression: MX
    lower: Array
    upper: Array


class Program:
    """The NLP of one design on one layout.

    Parameters
    ----------
    problem : objective and constraints.
    transcription : of the step, with the freed parameters.
    bounds : of the freed parameters; shape (2, n_free).
    w, p : ndarray - where the search starts, and the parameters.
    elastic : give the problem's constraints slack, and minimise that instead of the objective.
    """

    def __init__(
        self,
        problem: Problem,
        transcription: MultipleShooting,
        *,
        bounds: Array,
        w: Array,
        p: Array,
        elastic: bool = False,
        progress: Progress | None = None,
        should_stop: Stop = None,
    ) -> None:
        self._problem, self.transcription, self._p = problem, transcription, p
        self.names = tuple(dict.fromkeys((*problem.objective, *problem.constraints)))
        self._outcome = Outcome(transcription, SMOOTHING * transcription.system.weight(transcription.p))
        self._extrema = {name: MX.sym(name) for name in self.names if name in EXTREMA and name != RADIUS}
        self._slack = MX.sym("slack", len(problem.constraints) if elastic else 0)
        self._radius = certified_radius(transcription) if RADIUS in self.names else None
        extrema = np.array([self._extremum(name, w) for name in self._extrema])
        self._search = search(transcription, w, p, bounds, extrema, self._slack.numel())
        self.rows = [*self._physics(), *self._extremal(w), *self._stated()]
        unknowns = vertcat(transcription.w, *self._extrema.values(), self._slack)
        parameters = transcription.parameters
        self._values = Function("values", [unknowns, parameters], [vertcat(*map(self.scalar, self.names))])
        objective = self._objective()
        self._solver = Ipopt(
            w=unknowns,
            p=parameters,
            g=[rows.expression for rows in self.rows],
            scale=self._search.sizes,
            objective=objective,
            optimality=NEAR_OPTIMUM if elastic else ROUGH,
            objective_size=1.0 if objective is None else self._size_at_start(objective, unknowns, parameters),
            progress=progress,
            should_stop=should_stop,
        )

    def solve(self) -> IpoptResult:
        """Run IPOPT from the starting motion."""
        lower = np.concatenate([rows.lower for rows in self.rows])
        upper = np.concatenate([rows.upper for rows in self.rows])
        box = (self._search.lower, self._search.upper)
        return self._solver.solve(self._search.start, self._p, box, (lower, upper))

    def motion(self, x: Array) -> Array:
        """Nodes, durations and freed parameters among all unknowns."""
        return x[: self.transcription.w.numel()]

    def values(self, x: Array) -> Array:
        """The scalars in ``names`` at a solution; shape (n_names,)."""
        return np.asarray(self._values(x, self._p)).ravel()

    def scalar(self, name: str) -> MX:
        """One scalar of the result."""
        if self._radius is not None and name == RADIUS:
            return self._radius(self.transcription.w, self.transcription.parameters)
        return self._extrema[name] if name in self._extrema else self._outcome.value(name)

    def hits_trust_region(self, x: Array) -> bool:
        """Whether a solution lies on the boundary of the trust region."""
        return self._search.hits_trust_region(x)

    def active_bounds(self, result: IpoptResult) -> dict[str, tuple[float, float]]:
        """Multiplier of the bounds of every freed parameter, positive at the upper one, and the bound nearest."""
        n = self.transcription.w.numel()
        free = self.transcription.free
        pressed = {}
        for k, name in zip(range(n - len(free), n), free, strict=True):
            pressure = float(result.bound_multipliers[k])
            pressed[name] = pressure, float((self._search.upper if pressure > 0 else self._search.lower)[k])
        return pressed

    def by_rows(self, result: IpoptResult) -> list[tuple[Rows, Array]]:
        """The multipliers of every group of constraints."""
        ends = np.cumsum([rows.expression.numel() for rows in self.rows])
        return list(zip(self.rows, np.split(result.multipliers, ends[:-1]), strict=True))

    def margin_words(self, row: int) -> str:
        """What one row of the margins says."""
        label = self.transcription.inequalities[1][row]
        name = label.name.replace("_", " ")
        if label.phase is None:
            return f"the impact ({name})"
        return f"phase {label.phase + 1} ({self.transcription.layout.cycle.phases[label.phase]}: {name})"

    def _physics(self) -> list[Rows]:
        margins, labels = self.transcription.inequalities
        scales = Dynamics(self.transcription.system, self._p).scales
        least = np.array([CLEARANCE * label.unit(scales) if "cone" in label.name else 0.0 for label in labels])
        return [_zero("gait", self.transcription.equalities), _positive("margins", margins, least)]

    def _extremal(self, w: Array) -> list[Rows]:
        rows = []
        for name, extremum in self._extrema.items():
            bounding = self._outcome.bounded(name, extremum)[self._outcome.active_rows(name, w, self._p)]
            rows.append(_positive(name, bounding))
            if self._inflates(name):
                # only its own curve keeps the extremum from growing: it stays at its present sample
                rows.append(_zero(name, bounding[int(np.argmin(self._bounding(name, w, self._extremum(name, w))))]))
        return rows

    def _inflates(self, name: str) -> bool:
        """Whether objective or constraints would push an extremum away from its curve."""
        span = self._problem.constraints.get(name, Range(minimum=-np.inf, maximum=np.inf))
        bound = span.minimum if EXTREMA[name] > 0 else -span.maximum
        return bool(np.isfinite(bound)) or EXTREMA[name] * self._problem.objective.get(name, 0.0) < 0

    def _bounding(self, name: str, w: Array, extremum: float) -> Array:
        rows = self._outcome.bounded(name, MX(extremum))[self._outcome.active_rows(name, w, self._p)]
        function = Function("rows", [self.transcription.w, self.transcription.parameters], [rows])
        return np.asarray(function(w, self._p)).ravel()

    def _extremum(self, name: str, w: Array) -> float:
        """Where the rows, which are linear in the extremum, begin to hold."""
        constant, slope = self._bounding(name, w, 0.0), self._bounding(name, w, 1.0)
        crossings = -constant / (slope - constant)
        return float(crossings.max() if EXTREMA[name] > 0 else crossings.min())

    def _stated(self) -> list[Rows]:
        rows = []
        for k, (name, span) in enumerate(self._problem.constraints.items()):
            low, high = np.array([span.minimum]), np.array([span.maximum])
            scalar, open_end = self.scalar(name), np.array([np.inf])
            if self._slack.numel() == 0:
                rows.append(Rows(name=name, expression=scalar, lower=low, upper=high))
                continue
            slack = self._slack[k] * _size(span)
            rows.append(Rows(name=name, expression=scalar + slack, lower=low, upper=open_end))
            rows.append(Rows(name=name, expression=scalar - slack, lower=-open_end, upper=high))
        return rows

    def _size_at_start(self, objective: MX, unknowns: MX, parameters: MX) -> float:
        function = Function("objective", [unknowns, parameters], [objective])
        value = float(function(self._search.start, self._p))
        return max(abs(value), SMALL) if np.isfinite(value) else 1.0

    def _objective(self) -> MX | None:
        if self._slack.numel():
            return sum1(self._slack)
        if not self._problem.objective:
            return None
        return sum((weight * self.scalar(name) for name, weight in self._problem.objective.items()), MX(0))


def _size(span: Range) -> float:
    return max(abs(bound) for bound in (span.minimum, span.maximum, SMALL) if np.isfinite(bound))


def _zero(name: str, expression: MX) -> Rows:
    return Rows(
        name=name, expression=expression, lower=np.zeros(expression.numel()), upper=np.zeros(expression.numel())
    )


def _positive(name: str, expression: MX, least: Array | float = 0.0) -> Rows:
    n = expression.numel()
    return Rows(name=name, expression=expression, lower=least + np.zeros(n), upper=np.full(n, np.inf))


MISSED = 1e-6
"""Slack, relative to the bound or to one, beyond which a constraint is not met."""
PRESSING = 1e-4
"""Multiplier of a bound that stands in the way; the multipliers of the slack itself are of the order of one."""


def conflicts(problem: Problem, program: Program, result: IpoptResult) -> tuple[Cause, ...]:
    """The constraints that cannot be met; empty where all can be met or the search failed.

    Parameters
    ----------
    program, result : an elastic one, and its solution.
    """
    if result.status is not Status.CONVERGED:
        return ()
    reached = dict(zip(program.names, program.values(result.w), strict=True))
    obstacles = list(_obstacles(problem, program, result, reached))
    causes = []
    for name, span in problem.constraints.items():
        bound = _missed(span, reached[name])
        if bound is None:
            continue
        needed = span.minimum if reached[name] < span.minimum else span.maximum
        against = [words for other, words in obstacles if other != name]
        reason = f"conflicts with {', '.join(against)}" if against else "cannot be met by these phases near the start"
        _, place = problem.place.locate(("constraints", name))
        words = f"{place}: {name} {bound} {reason}: best reached {reached[name]:.4g}"
        causes.append(Cause(what=name, words=words, needed=needed, available=float(reached[name])))
    return tuple(causes)


def _missed(span: Range, value: float) -> str | None:
    """The bound that a value misses, in words."""
    if value < span.minimum - MISSED * max(1.0, abs(span.minimum)):
        return f">= {span.minimum:g}" if span.minimum < span.maximum else f"= {span.minimum:g}"
    if value > span.maximum + MISSED * max(1.0, abs(span.maximum)):
        return f"<= {span.maximum:g}" if span.minimum < span.maximum else f"= {span.maximum:g}"
    return None


def _obstacles(
    problem: Problem, program: Program, result: IpoptResult, reached: dict[str, float]
) -> Iterator[tuple[str, str]]:
    """Name and words of every freed bound, other constraint and kind of margin that presses against the search."""
    for name, (pressure, bound) in program.active_bounds(result).items():
        if abs(pressure) > PRESSING:
            yield name, f"{name} {'<=' if pressure > 0 else '>='} {bound:g}"
    for rows, multipliers in program.by_rows(result):
        worst = float(np.abs(multipliers).max(initial=0.0))
        if worst <= PRESSING or rows.name not in (*problem.constraints, "margins"):
            continue
        if rows.name == "margins":
            yield rows.name, program.margin_words(int(np.argmax(np.abs(multipliers))))
        elif _missed(problem.constraints[rows.name], reached[rows.name]) is None:
            yield rows.name, _held(rows, multipliers)


def _held(rows: Rows, multipliers: Array) -> str:
    return f"{rows.name} <= {rows.upper[0]:g}" if multipliers[0] > 0 else f"{rows.name} >= {rows.lower[0]:g}"
