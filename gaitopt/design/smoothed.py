"""The smoothed problem of a design, which IPOPT solves over nodes, durations, freed parameters and extrema.

    min   sum of weight x scalar
    s.t.  equalities = 0, margins >= 0                     solver.shooting
          lo <= scalar <= hi
          extremum >= the curve's values                   for peak torque and the like

Integrals are sums over the Lobatto points of every shooting interval, extrema bound the values at those points.
Functions that are not smooth are replaced: |power| by sqrt(power^2 + width^2), the spectral radius by the certified
radius of ``spectral_radius``, or under invariant virtual constraints by the multiplier of the zero dynamics. Sequential
quadratic programming of the exact problem (``sqp``) starts from the solution.

The search has a trust region around its start: angles, rates and slip velocity at a node change by no more than their
largest value in the step, so that the motion remains a walk. The same values are the typical sizes of the unknowns.

In elastic mode all constraints of the problem have slack, and the sum of the slacks is minimised. The solution shows
which constraints cannot be met, and the multipliers show which others are in their way (``conflicts``).

Direct collocation does not replace this problem. With secants it finds the six optima of the compass in 0.5 to 2.3
times the time, but it only covers cycles of one step, without timed phases, slips from rest, unloaded massless feet and
static cones. The equations of shooting cover all of these.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from casadi import DM, MX, Function, horzcat, repmat, reshape, sqrt, sum1, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building
from gaitopt.callbacks import Stop, Valued
from gaitopt.design.exact import EXTREMA, SMALL, clearance, freed_sizes
from gaitopt.design.sensitivity import OF_STEP, OF_WALKER, impact_quantities, invariance, invariance_labels
from gaitopt.design.spectral_radius import RADIUS, certified_radius, zero_dynamics_radius
from gaitopt.gait.gait import Cause, Status
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.units import SI
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS, Instant, phase_of, unit_of
from gaitopt.problem.statement import Range
from gaitopt.solver.collocation_elements import SMOOTHING, GroundContact, ground_contacts
from gaitopt.solver.interval import LOBATTO_POINTS, LOBATTO_WEIGHTS, sampled_step
from gaitopt.solver.ipopt import MAX_ITERATIONS, TOLERANCE, Block, Ipopt, IpoptResult
from gaitopt.solver.newton import Solution
from gaitopt.solver.program import ShootingProgram, equation_slope
from gaitopt.solver.shooting import Label, MultipleShooting
from gaitopt.threads import cached_property

NEAR_OPTIMUM = 1e-4
"""The search for conflicts ends at this KKT residual, in the sizes of its objective and unknowns."""
MAX_CONFLICT_ITERATIONS = 600
"""Largest number of iterations of the search for conflicts. Its objective is flat near the optimum, so that it may take
more than a design, which takes up to 140."""
ROUGH_OPTIMUM = 0.2
"""The smoothed problem is solved to this KKT residual, in the sizes of objective and unknowns. Then ``sqp`` continues,
because one of its iterations replaces twenty of IPOPT, which approximates all curvature by secants."""
LONGEST_PHASE = 3.0
"""Upper bound of a phase's duration in one search, in periods."""
BOUNDARY = 1e-6
"""A solution closer to the boundary of the trust region, relative to its width, lies on it."""
LARGEST_VIOLATION = 1e-6
"""A constraint that is violated by more, relative to the bound or to one, is not met."""
SMALLEST_MULTIPLIER = 1e-4
"""A bound conflicts with the constraints if its multiplier is larger; those of the slacks are of the order of one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Samples:
    """Quantities of one arc at its N Lobatto points.

    ``ahead`` is the distance of the swing foot in front of the stance foot; ``nodes`` has the node before each point.
    """

    mode: Mode
    phase: int
    nodes: list[int]
    weights: MX
    contacts: list[GroundContact]
    torque: MX
    power: MX
    height: MX
    ahead: MX


class SmoothedScalars:
    """Scalars of a cycle, and the quantities in their formulas, as expressions of the program's unknowns.

    Parameters
    ----------
    equations : the equations of the cycle.
    width : MX - |power| is smoothed over this width [W].
    """

    def __init__(self, equations: MultipleShooting, width: MX) -> None:
        self._t, self._width, self._at_impacts = equations, width, impact_quantities(equations)

    def value(self, name: str) -> MX:
        """A scalar that is not an extremum: one of the result, ``state.NAME``, ``phases.K.duration``, a dotted key."""
        phase = phase_of(name)
        if phase is not None:
            return self._t.durations[phase]
        if name in self._t.system.parameters:
            return self._t.p[self._t.system.parameters.index(name)]
        if name.startswith("state."):
            return self._t.Z[self._t.system.state_names.index(name.removeprefix("state.")), 0]
        formula = SCALARS[name].formula
        assert formula is not None, f"{name} is an extremum"
        return formula(self)

    @property
    def duration(self) -> MX:
        """Period [s]."""
        return sum1(self._t.durations)

    @property
    def distance(self) -> MX:
        """Length of the cycle [m]."""
        return self._of_steps("step_length")

    @property
    def weight(self) -> MX:
        """m g [N]."""
        return self._at_impacts.of_walker[OF_WALKER.index("weight")]

    @property
    def transport(self) -> MX:
        """Weight times distance [J]."""
        return self.weight * self.distance

    @property
    def incline(self) -> MX:
        """sin(slope)."""
        return self._at_impacts.of_walker[OF_WALKER.index("incline")]

    @property
    def push_work(self) -> MX:
        """Work of the pushes before landings [J]."""
        return sum(self._at_impacts.of_landings, self._of_steps("push_work"))

    @property
    def slip(self) -> MX:
        """Path of the sliding contacts [m]."""
        sliding = ((s, contact) for s in self._samples for contact in s.contacts)
        return sum((contact.direction * contact.slip @ s.weights.T for s, contact in sliding), MX(0))

    def _of_steps(self, name: str) -> MX:
        return sum((step[OF_STEP.index(name)] for step in self._at_impacts.of_steps), MX(0))

    def integral(self, rate: str) -> MX:
        """Integral over time of ``power`` of all motors, ``absolute_power`` or ``squared_torque``."""
        rates: dict[str, Callable[[_Samples], MX]] = {
            "power": lambda s: sum1(s.power),
            "absolute_power": lambda s: sum1(sqrt(s.power**2 + self._width**2)),
            "squared_torque": lambda s: sum1(s.torque**2),
        }
        return sum((rates[rate](s) @ s.weights.T for s in self._samples), MX(0))

    def bounded(self, name: str, extremum: MX) -> tuple[MX, tuple[Label, ...]]:
        """Rows that are nonnegative if ``extremum`` bounds the curve, with their labels.

        The smallest row is zero if ``extremum`` is the extremum of the curve.
        """
        scalar, rows, labels = SCALARS[name], list[MX](), list[Label]()
        if name == "impulse_ratio":  # that of sticking impacts, even if an impact slips
            for k, (step, mode) in enumerate(zip(self._at_impacts.of_steps, self._t.mesh.cycle.impacts, strict=True)):
                impulse_t, impulse_n = (step[OF_STEP.index(component)] for component in ("impulse_t", "impulse_n"))
                added = scalar.bounded(extremum, Instant(impulse_t, impulse_n, None, None))
                rows += added
                labels += [Label(name=name, mode=mode, step=k, unit=SI["impulse"])] * len(added)
            return vertcat(*rows), tuple(labels)
        unit = SI["force"] if name == "required_friction" else unit_of(name, self._t.system)
        for s in self._samples:
            instants = [Instant(None, None, s.torque, s.height)]
            if name in ("required_friction", "min_normal_force"):
                known = (each for each in s.contacts if not (scalar.sticking and each.direction))
                instants = [Instant(each.force_t, each.force_n, None, None) for each in known]
            for curve in (curve for at in instants for curve in scalar.bounded(extremum, at)):  # a column per point
                rows.append(vec(curve))
                at_nodes = [self._t.label(name, s.phase, node, unit=unit) for node in s.nodes]
                labels += [label for label in at_nodes for _ in range(curve.size1())]
        return vertcat(*rows), tuple(labels)

    def active_rows(self, name: str, w: Array, p: Array) -> list[int]:
        """Indices of the rows of ``bounded`` that count. The clearance counts after the legs last pass each other."""
        if name != "foot_clearance":
            return list(range(len(self.bounded(name, MX(0))[1])))
        leads = Function("leads", [self._t.w, self._t.parameters], [horzcat(*(s.ahead for s in self._samples))])
        behind = np.flatnonzero(np.asarray(leads(w, p)).ravel() <= 0)
        return list(range(int(behind[-1]) + 1 if behind.size else 0, leads.size2_out(0)))

    @cached_property
    def _samples(self) -> list[_Samples]:
        """Quantities at the Lobatto points, arc by arc."""
        t, system, n = self._t, self._t.system, LOBATTO_POINTS.size

        def columns(i: int) -> list[MX]:
            arc, Z, start, h = t.arc(i)
            times = start + h * MX(np.arange(arc.intervals)).T
            return [Z[:, :-1], times, repmat(h, 1, arc.intervals), *t.constants(arc, arc.intervals)]

        samples = []
        for i, wide in enumerate(t.map_arcs(lambda mode: sampled_step(system.shared, mode), columns)):
            arc, _, start, h = t.arc(i)
            states = reshape(wide, system.n_z, n * arc.intervals)
            fractions = (np.arange(arc.intervals)[:, None] + LOBATTO_POINTS).ravel()
            observe = system.observation(arc.mode).map(fractions.size)
            times = start + h * MX(DM(fractions)).T
            force, torque, power, foot, _, _, _, slip = observe(times, states, *t.constants(arc, fractions.size))
            samples.append(
                _Samples(
                    mode=arc.mode,
                    phase=arc.phase,
                    nodes=np.repeat(t.mesh.arc_nodes[i][:-1], n).tolist(),
                    weights=h * MX(DM(np.tile(LOBATTO_WEIGHTS, arc.intervals))).T,
                    contacts=[*ground_contacts(system.walker, arc.mode, force, slip)],
                    torque=torque,
                    power=power,
                    height=foot[1, :],
                    ahead=foot[0, :] - states[system.n_shape, :],
                )
            )
        return samples


class SmoothedProblem:
    """The smoothed problem of one design on one mesh, as the nonlinear program ``program``.

    Parameters
    ----------
    problem : the problem, with its objective and constraints.
    start : motion at which the search starts, with the freed parameters among its unknowns.
    bounds : bounds of the freed parameters; shape (2, n_free).
    elastic : whether the problem's constraints have slack, which is minimised instead of the objective.
    """

    @building
    def __init__(
        self,
        problem: Problem,
        start: Solution,
        *,
        bounds: Array,
        elastic: bool = False,
        progress: Valued = None,
        should_stop: Stop = None,
    ) -> None:
        equations, p, w = start.equations, start.p, start.w.copy()
        self._progress, self._should_stop = progress, should_stop
        w[-len(equations.free) :] = np.clip(w[-len(equations.free) :], *bounds)
        self.equations = equations
        self.names = tuple(dict.fromkeys((*problem.objective, *problem.constraints)))
        self._scalars = SmoothedScalars(equations, SMOOTHING * equations.system.weight(equations.p))
        self._radius = None
        if RADIUS in self.names:
            self._radius = zero_dynamics_radius(equations, w, p) or certified_radius(equations)
        slack = MX.sym("slack", len(problem.constraints) if elastic else 0)

        # rows of the gait, then margins; a margin at whose zero rounding would decide must exceed a clearance
        margins, labels = equations.inequalities
        scales = Dynamics(equations.system, p).scales
        clearances = np.array([clearance(label.name) * label.size(scales) for label in labels])
        blocks = [
            Block(
                name="gait",
                expression=equations.equalities,
                lower=0.0,
                upper=0.0,
                labels=equations.equality_labels,
                slope=equation_slope(equations),
            ),
            Block(name="margins", expression=margins, lower=clearances, labels=labels),
        ]

        invariant, labels = invariance(equations), invariance_labels(equations)
        blocks.append(Block(name="invariance", expression=invariant, lower=0.0, upper=0.0, labels=labels))

        # extrema, each of which bounds the samples of a curve from one side
        self._extrema, extrema = dict[str, MX](), list[float]()
        for name in self.names:
            if name not in EXTREMA or name == RADIUS:
                continue
            extremum, sign = MX.sym(name), EXTREMA[name]
            rows, labels = self._scalars.bounded(name, extremum)
            active = self._scalars.active_rows(name, w, p)
            rows, labels = rows[active], tuple(labels[row] for row in active)
            function = Function("rows", [extremum, equations.w, equations.parameters], [rows])
            at_0, at_1 = (np.asarray(function(value, w, p)).ravel() for value in (0.0, 1.0))
            zeros = -at_0 / (at_1 - at_0)  # the rows are linear in the extremum
            extrema.append(float(zeros.max() if sign > 0 else zeros.min()))
            self._extrema[name] = extremum
            blocks.append(Block(name=name, expression=rows, lower=0.0, labels=labels))
            span = problem.constraints.get(name, Range(minimum=-np.inf, maximum=np.inf))
            bound = span.minimum if sign > 0 else -span.maximum
            if np.isfinite(bound) or sign * problem.objective.get(name, 0.0) < 0:
                # the problem would push the extremum away from its curve: it is tied to the sample that is extreme now
                sample = int(np.argmin(np.asarray(function(extrema[-1], w, p))))
                label = (labels[sample],)
                blocks.append(Block(name=name, expression=rows[sample], lower=0.0, upper=0.0, labels=label))

        # constraints of the problem
        for k, (name, span) in enumerate(problem.constraints.items()):
            scalar, label = self.scalar(name), (Label(name=name, unit=unit_of(name, problem) or SI["one"]),)
            if elastic:
                give = slack[k] * max(abs(bound) for bound in (span.minimum, span.maximum, SMALL) if np.isfinite(bound))
                blocks.append(Block(name=name, expression=scalar + give, lower=span.minimum, labels=label))
                blocks.append(Block(name=name, expression=scalar - give, upper=span.maximum, labels=label))
            else:
                lowest, highest = span.minimum, span.maximum
                blocks.append(Block(name=name, expression=scalar, lower=lowest, upper=highest, labels=label))

        unknowns, parameters = vertcat(equations.w, *self._extrema.values(), slack), equations.parameters
        self._values = Function("values", [unknowns, parameters], [vertcat(*map(self.scalar, self.names))])
        objective, lower, upper, start_point, sizes = (
            MX(0),
            *self._bounds(w, p, bounds, np.array(extrema), slack.numel()),
        )
        tolerance, scaling = TOLERANCE, 1.0
        limit = MAX_CONFLICT_ITERATIONS if elastic else MAX_ITERATIONS
        if elastic or problem.objective:
            weighted = (weight * self.scalar(name) for name, weight in problem.objective.items())
            objective = sum1(slack) if elastic else sum(weighted, MX(0))
            value = float(Function("objective", [unknowns, parameters], [objective])(start_point, p))
            size = max(abs(value), SMALL) if np.isfinite(value) else 1.0
            tolerance, scaling = NEAR_OPTIMUM if elastic else ROUGH_OPTIMUM, 1 / size
        self._options = {"tol": tolerance, "max_iter": limit, "obj_scaling_factor": scaling}
        extremum_labels = [Label(name=name, unit=unit_of(name, problem) or SI["one"]) for name in self._extrema]
        slack_labels = [Label(name="slack", coordinate=name) for name in problem.constraints if elastic]
        meaning = (*equations.unknown_labels, *extremum_labels, *slack_labels)
        self.program = ShootingProgram(
            unknowns=(
                Block(name="unknowns", expression=unknowns, lower=lower, upper=upper, size=sizes, labels=meaning),
            ),
            rows=tuple(blocks),
            p=parameters,
            f=objective,
            x0=start_point,
            p0=p,
            problem=problem,
            equations=equations,
            radius=self._radius,
        )
        BUILT.watch(vars(self))
        BUILT.watch(vars(self._scalars))

    def solve(self) -> IpoptResult:
        """Run IPOPT from the starting motion."""
        ipopt = Ipopt(self.program, options=self._options)
        return ipopt.solve(progress=self._progress, should_stop=self._should_stop)

    def motion(self, x: Array) -> Solution:
        """The motion of a point x, by its nodes, durations and freed parameters."""
        return Solution(self.equations, x[: self.equations.w.numel()], self.program.p0)

    def scalar(self, name: str) -> MX:
        """A scalar of the problem as an expression."""
        if name == RADIUS and self._radius is not None:
            return self._radius(self.equations.w, self.equations.parameters)
        return self._extrema[name] if name in self._extrema else self._scalars.value(name)

    def values(self, x: Array) -> Array:
        """Values of the problem's scalars, in the order of ``names``."""
        return np.asarray(self._values(x, self.program.p0)).ravel()

    def hits_trust_region(self, x: Array) -> bool:
        """Whether a node of a solution lies on the boundary of the trust region."""
        nodes = slice(0, self.equations.system.n_z * self.equations.n_nodes)
        lower, upper = self.program.lbx, self.program.ubx
        room = np.minimum(x - lower, upper - x)[nodes]
        return bool(np.any(room < BOUNDARY * (upper - lower)[nodes]))

    def active_bounds(self, result: IpoptResult) -> dict[str, tuple[float, float]]:
        """Multiplier and value of the bound on which each freed parameter lies, by dotted key."""
        first, active = self.equations.w.numel() - len(self.equations.free), {}
        for k, name in enumerate(self.equations.free, start=first):
            multiplier = float(result.bound_multipliers[k])
            active[name] = multiplier, float((self.program.ubx if multiplier > 0 else self.program.lbx)[k])
        return active

    def block_multipliers(self, result: IpoptResult) -> list[tuple[Block, Array]]:
        """Every block of constraints with its multipliers."""
        ends = np.cumsum([block.expression.numel() for block in self.program.rows])
        return list(zip(self.program.rows, np.split(result.multipliers, ends[:-1]), strict=True))

    def margin_text(self, row: int) -> str:
        """A text that names the phase or impact, and the margin, of one row of the margins."""
        label = self.equations.inequalities[1][row]
        name = label.name.replace("_", " ")
        if label.phase is None:
            return f"the impact ({name})"
        return f"phase {label.phase + 1} ({self.equations.mesh.cycle.phases[label.phase]}: {name})"

    def _bounds(
        self, w: Array, p: Array, bounds: Array, extrema: Array, n_slack: int
    ) -> tuple[Array, Array, Array, Array]:
        """Lower and upper bounds, start and typical sizes of all unknowns."""
        t = self.equations
        nodes, durations, freed = t.unpack(w)
        period, states = durations.sum(), self._state_sizes(w, p)
        reach = states.copy()
        reach[t.system.n_shape] = np.inf
        reach = np.tile(reach, t.n_nodes)
        longest, free = np.full(durations.size, LONGEST_PHASE * period), np.full(extrema.size, np.inf)
        start, none = np.concatenate([w, extrema, np.ones(n_slack)]), np.zeros(durations.size)
        lower = np.concatenate([w[: nodes.size] - reach, none, bounds[0], -free, np.zeros(n_slack)])
        upper = np.concatenate([w[: nodes.size] + reach, longest, bounds[1], free, np.full(n_slack, np.inf)])
        extremum_sizes = np.maximum(np.abs(extrema), SMALL)
        duration_sizes = np.full(durations.size, period)
        sizes = [np.tile(states, t.n_nodes), duration_sizes, freed_sizes(freed, bounds), extremum_sizes]
        return lower, upper, start, np.concatenate([*sizes, np.ones(n_slack)])

    def _state_sizes(self, w: Array, p: Array) -> Array:
        """Typical sizes of the states: the largest value of those with the same unit, shape (n_z,).

        The size of x is the length of the cycle. Sizes of other lengths are no smaller than this, and sizes of
        velocities no smaller than the speed of the walker.
        """
        t, scales = self.equations, Dynamics(self.equations.system, p).scales
        nodes, durations, _ = t.unpack(w)
        largest, x = np.abs(nodes).max(axis=1), t.system.n_shape
        units = np.array([label.unit for label in t.unknown_labels[: largest.size]])
        length = abs(float(Function("length", [t.w, t.parameters], [self._scalars.distance])(w, p)))
        length = max(length, SMALL * scales.length)
        smallest = {"m": length, "m/s": length / durations.sum()}
        sizes = np.empty(largest.size)
        for unit in dict.fromkeys(units.tolist()):
            alike = units == unit
            alike[x] = False
            sizes[units == unit] = max(largest[alike].max(initial=0.0), smallest.get(unit, SMALL))
        sizes[x] = length
        return sizes


def conflicts(problem: Problem, elastic: SmoothedProblem, result: IpoptResult) -> tuple[Cause, ...]:
    """The constraints that cannot be met; empty if all can be met or the search failed.

    Parameters
    ----------
    elastic, result : the problem in elastic mode, and its solution.
    """
    if result.status is not Status.CONVERGED:
        return ()
    values = dict(zip(elastic.names, elastic.values(result.w).tolist(), strict=True))
    obstacles = list(_obstacles(problem, elastic, result, values))
    causes = []
    for name, span in problem.constraints.items():
        value = values[name]
        bound = _violated_bound(span, value)
        if bound is None:
            continue
        needed = span.minimum if value < span.minimum else span.maximum
        against = dict.fromkeys(obstacle for other, obstacle in obstacles if other != name)
        reason = f"conflicts with {', '.join(against)}" if against else "cannot be met by these phases near the start"
        _, location = problem.place.locate(("constraints", name))
        conflict = f"{name} {bound} {reason}: best reached {value:.4g}"
        causes.append(Cause(what=name, description=f"{location}: {conflict}", needed=needed, available=value))
    return tuple(causes)


def _violated_bound(span: Range, value: float) -> str | None:
    """The bound that a value violates, as text; None if it is within both."""
    if value < span.minimum - LARGEST_VIOLATION * max(1.0, abs(span.minimum)):
        return f"{'=' if span.is_equality else '>='} {span.minimum:g}"
    if value > span.maximum + LARGEST_VIOLATION * max(1.0, abs(span.maximum)):
        return f"{'=' if span.is_equality else '<='} {span.maximum:g}"
    return None


def _obstacles(
    problem: Problem, elastic: SmoothedProblem, result: IpoptResult, values: dict[str, float]
) -> Iterator[tuple[str, str]]:
    """Name and text of all conditions in the way: bounds of freed parameters, constraints that are met, and margins."""
    for name, (multiplier, bound) in elastic.active_bounds(result).items():
        if abs(multiplier) > SMALLEST_MULTIPLIER:
            yield name, f"{name} {'<=' if multiplier > 0 else '>='} {bound:g}"
    for block, multipliers in elastic.block_multipliers(result):
        worst = float(np.abs(multipliers).max(initial=0.0))
        if worst <= SMALLEST_MULTIPLIER or block.name not in (*problem.constraints, "margins"):
            continue
        if block.name == "margins":
            yield block.name, elastic.margin_text(int(np.argmax(np.abs(multipliers))))
        elif _violated_bound(span := problem.constraints[block.name], values[block.name]) is None:
            side = f"<= {np.max(block.upper):g}" if multipliers[0] > 0 else f">= {np.min(block.lower):g}"
            side = f"= {span.minimum:g}" if span.is_equality else side
            yield block.name, f"{block.name} {side}"
