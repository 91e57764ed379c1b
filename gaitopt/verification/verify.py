"""Verification of a gait by the forward simulator, claim by claim.

The solver shoots through a given mode sequence; the simulator finds modes and events itself. They share only the
mechanics, and no equation of the solver is used here. The argument has four steps. Figures are dimensionless; errors
are in the natural units of the walker.

1. From the gait's state after impact, the simulator goes through the gait's modes and impacts (mode sequence). It walks
   the same motion (period, switching times, states inside) back to the same state (periodicity). Both methods are
   accurate to ``AGREEMENT``; an unstable cycle magnifies their errors by its spectral radius.
2. The gait obeys the laws of its modes, also between the nodes of the solver: friction cone, slip direction and normal
   force. Its energy changes by the work of motors and friction (energy balance).
3. The numbers of its record are those of the simulated cycle and, to rounding, those of its own motion (measures,
   impact).
4. Its state is a fixed point of the simulator's return map (state). Its multipliers are the eigenvalues of the map's
   derivative by saltation (multipliers), which in turn agrees with differences of perturbed walks (perturbation).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.display import Tabulated, counted
from gaitopt.errors import SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, floquet_multipliers, multiplier_distance, require_gait
from gaitopt.gait.measures import friction_ratio, measure, measure_scales, observe, touching_contacts
from gaitopt.gait.records import VerificationRecord
from gaitopt.gait.trajectory import Arc, Step, impact_record
from gaitopt.model.transitions import Ending
from gaitopt.requests import AGREEMENT, Engine, VerifyRequest, choice
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.verification.return_map import ROUNDING, FixedPoint, ReturnMap, directional_derivative

INTERIOR_AGREEMENT = 1e-8
"""Tolerance of states inside an arc, where the simulator interpolates, and of all scalars of arcs."""
RECOMPUTED = 1e-9
"""Relative tolerance of a stated scalar and its value along the gait's own motion, which differ by rounding only."""
SMALLEST_SCALAR = 1e-4
"""Smaller scalars are compared as if they were this large, in natural units, since rounding is 1e-15 of the unit."""
FORCE_SLACK = 1e-8
"""Excess over the friction coefficient that rounding at the edge of the cone can cause."""
ENERGY_AGREEMENT = 1e-9
"""Tolerance of the energy balance, relative to the larger one of two energies: the largest change along an arc, and
weight times leg length."""
MULTIPLIER_AGREEMENT = 1e-9
"""Tolerance of the multipliers, relative if they exceed one. An unstable cycle magnifies the errors of both methods by
its radius: among 900 random gaits the worst error is a tenth of this times the radius."""
LARGEST_MULTIPLIER_TOLERANCE = 2e-6
"""Largest tolerance of the multipliers: an error of 1e-5 must be detected, however unstable or sensitive they are."""
ZERO_DYNAMICS_AGREEMENT = 1e-8
"""Tolerance between delta_zero squared and the multiplier on the constraint surface."""
ROUNDING_SAMPLES = 4
"""Number of random changes of the derivative that show how sensitive the multipliers are to rounding."""
LINEARITY = 2e-6
"""Largest deviation from linearity, relative to the norm of the derivative. A derivative with a relative error of 1e-5
exceeds it along at least one of up to 25 directions; named gaits stay below 1e-8."""
DECISIVE_ERROR = LINEARITY / 4
"""Largest estimated error of an extrapolated difference that can decide the claim."""
SUFFICIENT_ERROR = DECISIVE_ERROR / 100
"""If the estimated error is below this, no smaller deviation is tried."""
SPARE_DIRECTIONS = 8
"""Number of random directions per coordinate that are tried if perturbations along a coordinate leave the gait's modes
on both sides, which happens next to two limits at once."""
SMALLEST_ORTHOGONAL_COMPONENT = 0.1
"""A further direction is used only if its unit vector has a longer component orthogonal to the directions before it."""


class Outcome(StrEnum):
    """Result of the examination of a claim; only ``holds`` is a pass."""

    HOLDS = "holds"
    FAILS = "fails"
    NOT_EXAMINED = "not_examined"
    NO_LINEAR_RANGE = "no_linear_range"


OUTCOMES: Mapping[str, str] = {
    Outcome.HOLDS: "holds",
    Outcome.FAILS: "fails",
    Outcome.NOT_EXAMINED: "not examined",
    Outcome.NO_LINEAR_RANGE: "no linear range",
}
"""How outcomes are printed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One statement about a gait, and the error that was measured for it.

    Attributes
    ----------
    name : name of the claim, such as ``period``.
    figure, tolerance : the measured error, and its limit. The error is infinite if it could not be measured.
    passed : whether the claim holds.
    note : what the figure measures, or why there is none.
    outcome : ``holds``, ``fails``, ``not_examined`` (there is no motion to examine) or ``no_linear_range`` (rounding or
        curvature is too large to judge a derivative, whatever the deviation).
    """

    name: str
    figure: float
    tolerance: float
    passed: bool
    note: str = ""
    outcome: Outcome = Outcome.HOLDS

    @property
    def summary(self) -> str:
        """Name, outcome, figure and note, as in ``period: fails (1.2e-07, limit 1e-09), relative error``."""
        figure = f" ({self.figure:.2g}, limit {self.tolerance:.2g})" if np.isfinite(self.figure) else ""
        return f"{self.name}: {OUTCOMES[self.outcome]}{figure}" + (f", {self.note}" if self.note else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification(Tabulated):
    """All claims about one gait."""

    claims: tuple[Claim, ...]

    def __repr__(self) -> str:
        failed = [claim.name for claim in self.claims if not claim.passed]
        verdict = f"FAILED: {', '.join(failed)}" if failed else "passed"
        return f"<Verification: {counted(len(self.claims), 'claim')}, {verdict}>"

    @property
    def passed(self) -> bool:
        """Whether every claim holds."""
        return all(claim.passed for claim in self.claims)

    def figure(self, name: str) -> float | None:
        """Figure of the claim with this name; None if it could not be examined."""
        return next((claim.figure for claim in self.claims if claim.name == name and np.isfinite(claim.figure)), None)

    def to_record(self) -> VerificationRecord:
        """One JSON object with the keys of the command line."""
        sequence = next(claim for claim in self.claims if claim.name == "mode sequence")
        return {
            "passed": self.passed,
            "period_error": self.figure("period"),
            "state_error": self.figure("state"),
            "multiplier_error": self.figure("multipliers"),
            "mode_sequence_matches": sequence.passed,
            "claims": [
                {
                    "name": claim.name,
                    "figure": claim.figure if np.isfinite(claim.figure) else None,
                    "tolerance": claim.tolerance,
                    "passed": claim.passed,
                    "note": claim.note,
                    "outcome": str(claim.outcome),
                }
                for claim in self.claims
            ],
        }


def recorded_claims(record: VerificationRecord) -> list[Claim]:
    """The claims in a record of ``Verification.to_record``; in records of early versions the outcome follows."""
    claims = []
    for entry in record["claims"]:
        name, figure, limit = entry["name"], entry["figure"], entry["tolerance"]
        outcome = Outcome(entry.get("outcome", Outcome.HOLDS if entry["passed"] else Outcome.FAILS))
        measured = np.inf if figure is None else figure
        claims.append(
            Claim(
                name=name, figure=measured, tolerance=limit, passed=entry["passed"], note=entry["note"], outcome=outcome
            )
        )
    return claims


def verify(gait: Gait, *, engine: str = Engine.AUTO, tolerance: float = AGREEMENT) -> Verification:
    """Verify a gait by forward simulation from its state after impact.

    Parameters
    ----------
    gait : a converged gait.
    engine : integrator of the simulation: ``auto``, ``scipy`` or ``heyoka``.
    tolerance : largest difference of period, switching times and states just after the impact between the two methods,
        in natural units. The tolerances of all other claims are scaled in proportion, except that of perturbations,
        because differences of walks are not more accurate. Each claim states its own tolerance.

    Raises
    ------
    ArgumentError
        If the tolerance is not a number from 1e-13 to 1e-4.
    SolveError
        If ``gait`` is a failed solve.
    UnknownNameError
        If the engine is unknown or not installed.
    """
    request = VerifyRequest(engine=choice(Engine, engine), tolerance=tolerance)
    require_gait(gait, "verify")
    simulator = Simulator(gait.dynamics, stepper_class(request.engine))
    sequence, walked = _simulated_cycle(gait, simulator)
    claims = [sequence, *law_claims(gait)]
    if sequence.passed:
        claims += motion_claims(gait, walked)
        claims += record_claims(gait, walked)
        claims += phase_claims(gait, walked)
        claims += return_map_claims(
            gait, ReturnMap(simulator, gait.system.section(gait.problem.cycle), len(walked), gait.state)
        )
    return Verification(claims=tuple(_with_tolerance(claim, request.tolerance / AGREEMENT) for claim in claims))


def _with_tolerance(known: Claim, factor: float) -> Claim:
    """A claim with its tolerance multiplied, unless it was not measured or depends on differences of walks."""
    if factor == 1 or known.outcome not in (Outcome.HOLDS, Outcome.FAILS) or known.name == "perturbation":
        return known
    return claim(known.name, known.figure, factor * known.tolerance, known.note)


def confirm(gait: Gait) -> Verification:
    """A short verification: the simulator walks one cycle through the same modes back to the same state.

    Raises
    ------
    SolveError
        If ``gait`` is a failed solve.
    """
    sequence, walked = _simulated_cycle(gait, Simulator(gait.dynamics))
    return Verification(claims=(sequence, *(motion_claims(gait, walked) if sequence.passed else ())))


def _simulated_cycle(gait: Gait, simulator: Simulator) -> tuple[Claim, tuple[Step, ...]]:
    """The claim that the simulator goes through the modes and impacts of the gait, and the simulated steps."""
    if not gait.steps:
        raise SolveError(f"{gait.problem.name} is {gait.status}, there is no gait to verify: {gait.message}")
    cycle = gait.problem.cycle
    walked = simulator.run(gait.state, steps=len(cycle.steps), dense=True)
    if walked.ending is not Ending.COMPLETED:
        return claim("mode sequence", np.inf, 0.0, walked.message, Outcome.NOT_EXAMINED), walked.steps
    sequences = tuple(step.sequence for step in walked.steps)
    note = f"simulator: {' | '.join(map(str, sequences))}"
    return claim("mode sequence", 0.0 if sequences == cycle.steps else np.inf, 0.0, note), walked.steps


def motion_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """The claims that times and states of the simulated steps ``walked`` equal those of the gait."""
    scales, unit, growth = gait.dynamics.scales, gait.dynamics.state_units, magnification(gait)
    durations = ([duration for step in steps for _, duration in step.phases] for steps in (gait.steps, walked))
    ours, theirs = (np.cumsum(phases) / scales.time for phases in durations)
    yield claim("period", abs(ours[-1] - theirs[-1]), growth * AGREEMENT, "in units of sqrt(l / g)")
    yield claim("switching times", np.abs(ours - theirs).max(), growth * AGREEMENT, "in units of sqrt(l / g)")
    returned = np.abs((walked[-1].final_impact.state - gait.state) / unit).max()
    yield claim("periodicity", returned, growth * AGREEMENT, "state after one cycle")
    inside = _state_error(gait, walked)
    yield claim("states inside", inside, growth * INTERIOR_AGREEMENT, "largest difference along the cycle")


def law_claims(gait: Gait) -> Iterator[Claim]:
    """The claims that the gait obeys the friction law of each mode and the energy balance, also between the nodes.

    The energy gained along an arc equals the work of motors and friction minus the loss in dampers.
    """
    scales = gait.dynamics.scales
    missing_friction, backward, lowest = -np.inf, 0.0, np.inf
    imbalance, largest_change = 0.0, scales.energy
    for arc in gait.arcs:
        o, friction = observe(arc), arc.dynamics.contact_friction
        power = o.power.sum(axis=1) + np.sum(o.force[:, ::2] * o.slip, axis=1) - o.loss
        change = o.energy[-1] - o.energy[0]
        imbalance = max(imbalance, abs(change - curves.integral(power, arc.duration)))
        largest_change = max(largest_change, abs(change))
        for contact in touching_contacts(arc, o):
            lowest = min(lowest, -curves.maximum(-contact.force[:, 1])[1])
            if contact.direction:
                backward = max(backward, curves.maximum(-contact.direction * contact.slip)[1])
                continue
            ratio = friction_ratio(contact.force)
            needed = max(curves.maximum(ratio)[1], curves.maximum(-ratio)[1])
            missing_friction = max(missing_friction, needed - min(friction[name] for name in contact.names))
    if np.isfinite(missing_friction):
        yield claim("friction cone", missing_friction, FORCE_SLACK, "needed minus available friction while sticking")
    yield claim("slip direction", backward / scales.speed, AGREEMENT, "against the mode, in units of sqrt(g l)")
    pull = FORCE_SLACK if _unloads(gait) else 0.0
    yield claim("normal force", -lowest / scales.force, pull, f"at least {lowest:.4g} N")
    yield claim("energy balance", imbalance / largest_change, ENERGY_AGREEMENT, "relative")


def record_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """The claims that scalars, parameters and impacts of the gait's record are those of its motion.

    Scalars and impacts are compared with the simulated steps ``walked``. If these confirm the gait's states, they are
    compared more closely with the values along the gait's own motion. Parameters are compared with those of the motion.
    A claim has the figure and the tolerance of its worse comparison.
    """
    units, tolerance = measure_scales(gait.dynamics.scales), magnification(gait) * INTERIOR_AGREEMENT
    errors = {k: _error(gait.measures.get(k), value, units[k]) for k, value in measure(walked).items()}
    given = {key: value for key, value in gait.problem.parameters.items() if key not in gait.problem.free}
    moving = gait.dynamics.parameters
    closely = {key: _relative_error(value, moving[key], 0.0) for key, value in {**given, **gait.freed}.items()}
    impact_errors = _impact_errors(gait, walked, _error)
    impacts_closely: dict[str, float] = {}
    if _state_error(gait, walked) <= tolerance:
        recomputed = [
            replace(step, impact=impact_record(last.dynamics, step.final_impact.mode, last.states[-1], last.mode))
            for step, last in ((step, step.arcs[-1]) for step in gait.steps)
        ]
        values = {k: _relative_error(gait.measures.get(k), v, units[k]) for k, v in measure(recomputed).items()}
        if _unloads(gait):
            del values["min_normal_force"]  # it is zero up to the rounding error of a length times the stiffness
        closely = values | closely
        impacts_closely = _impact_errors(gait, recomputed, _relative_error)
    yield _worst("measures", (errors, tolerance), (closely, RECOMPUTED))
    yield _worst("impact", (impact_errors, tolerance), (impacts_closely, RECOMPUTED))


def _unloads(gait: Gait) -> bool:
    """Whether the force on a foot falls to zero in every step, as it does if the leg has no mass."""
    return bool(gait.system.walker.weightless())


def phase_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """The claim that the control law's phase variable is monotone along the simulated steps, if the law has one."""
    name, slowest = gait.system.control.phase_variable, np.inf
    if not name:
        return
    rate = gait.system.phase_rate()
    for step in walked:
        direction = 0.0
        for arc in step.arcs:
            rates = np.array([float(rate(z, arc.dynamics.p)) for z in arc.states])
            direction = direction or np.sign(rates[rates.size // 2])
            slowest = min(slowest, -curves.maximum(-direction * rates)[1])
    note = f"{name} does not turn back: its rate is at least {slowest:.4g} per second in size"
    yield claim("phase variable", -slowest * gait.dynamics.scales.time, 0.0, note)


def return_map_claims(gait: Gait, return_map: ReturnMap) -> Iterator[Claim]:
    """The claims that state and multipliers are those of the simulator's return map, and its derivative is right."""
    xi = gait.state[gait.system.section(gait.problem.cycle).indices]
    point = return_map.fixed_point(xi)
    if point.jacobian is None:
        note = f"no fixed point of the simulated return map: {point.message}"
        yield claim("state", np.inf, AGREEMENT, note, Outcome.NOT_EXAMINED)
        return
    distance = np.abs((point.xi - xi) / return_map.unit).max()
    if not point.converged:  # rounding stops Newton's method before the fixed point; its next step estimates how far
        distance += np.abs(return_map.correction(point)).max()
    yield claim("state", distance, AGREEMENT, "distance to the fixed point of the simulator")
    distance = multiplier_distance(gait.multipliers, floquet_multipliers(point.jacobian), relative=True)
    sensitivity = _rounding_of_multipliers(return_map.scaled(point.jacobian))
    tolerance = min(max(magnification(gait) * MULTIPLIER_AGREEMENT, sensitivity), LARGEST_MULTIPLIER_TOLERANCE)
    yield claim("multipliers", distance, tolerance, "saltation against implicit differentiation")
    yield from zero_dynamics_claims(gait, return_map, point)
    yield perturbation_claim(return_map, point)


def zero_dynamics_claims(gait: Gait, return_map: ReturnMap, point: FixedPoint) -> Iterator[Claim]:
    """The claim that delta_zero squared is a multiplier, for a gait on its constraint surface only.

    The figure is the larger one of two errors. The first is that of D w = delta_zero^2 w, where D is the derivative of
    the simulator's return map. The direction w of the surface in the section has the rates after the impact. The second
    error is the distance to the gait's closest multiplier.
    """
    known = gait.constraints
    if known is None or known.delta_squared is None or point.jacobian is None:
        return
    n = gait.system.n_shape + 1
    rates = np.concatenate([np.zeros(n), gait.state[n:]])
    w = rates[gait.system.section(gait.problem.cycle).indices] / return_map.unit
    w /= np.linalg.norm(w)
    simulated = float(np.abs(return_map.scaled(point.jacobian) @ w - known.delta_squared * w).max())
    solved = float(np.abs(gait.multipliers - known.delta_squared).min())
    note = f"delta_zero^2 = {known.delta_squared:.9g} against the multiplier on the constraint surface"
    limit = magnification(gait) * ZERO_DYNAMICS_AGREEMENT
    yield claim("zero dynamics", max(simulated, solved), limit, note)


def perturbation_claim(return_map: ReturnMap, point: FixedPoint) -> Claim:
    """The claim that small perturbations along a basis of the section return as the derivative of the map predicts.

    The figure is the largest error along a direction, relative to the norm of the derivative. The basis consists of the
    coordinate directions. Random directions replace those along which no walk keeps the modes of the gait.

    Parameters
    ----------
    return_map : the simulator's return map over one cycle.
    point : its fixed point, with the derivative that the claim is about.
    """
    if point.jacobian is None:
        return claim("perturbation", np.inf, LINEARITY, point.message, Outcome.NOT_EXAMINED)
    jacobian, n = return_map.scaled(point.jacobian), point.xi.size
    size = float(np.linalg.norm(jacobian, 2)) or 1.0
    spare = np.random.default_rng(0).standard_normal((SPARE_DIRECTIONS * n if n > 1 else 0, n))
    judged: list[Array] = []
    figure, doubt, reason = 0.0, 0.0, ""
    for v in (*np.eye(n), *(w / np.linalg.norm(w) for w in spare)):
        basis = np.linalg.qr(np.array(judged).T)[0] if judged else np.zeros((n, 0))
        if np.linalg.norm(v - basis @ (basis.T @ v)) <= SMALLEST_ORTHOGONAL_COMPONENT:
            continue
        derivative, error, lost = directional_derivative(
            return_map, point, v, goal=SUFFICIENT_ERROR * size, enough=DECISIVE_ERROR * size
        )
        reason = lost or reason
        if derivative is None:
            continue
        if not error <= DECISIVE_ERROR * size:
            note = f"differences of the return map are uncertain by {error / size:.1g} at every size of deviation"
            return claim("perturbation", np.inf, LINEARITY, note, Outcome.NO_LINEAR_RANGE)
        figure = max(figure, float(np.linalg.norm(derivative - jacobian @ v)) / size)
        doubt, judged = max(doubt, error / size), [*judged, v]
        if len(judged) == n:
            note = f"extrapolated differences of the return map against the Jacobian, known to {doubt:.1g}"
            return claim("perturbation", figure, LINEARITY, note)
    note = f"{reason}: only {len(judged)} of {n} directions keep the modes of the gait"
    return claim("perturbation", np.inf, LINEARITY, note, Outcome.NO_LINEAR_RANGE)


def claim(name: str, figure: float, tolerance: float, note: str = "", outcome: Outcome | None = None) -> Claim:
    """The claim that ``figure`` does not exceed ``tolerance``, or one with the given outcome.

    If the figure is not a number, the claim fails.
    """
    outcome = outcome or (Outcome.HOLDS if figure <= tolerance else Outcome.FAILS)
    passed = outcome is Outcome.HOLDS
    return Claim(name=name, figure=float(figure), tolerance=tolerance, passed=passed, note=note, outcome=outcome)


def magnification(gait: Gait) -> float:
    """Factor by which an unstable cycle magnifies the difference between the two methods."""
    return max(1.0, gait.spectral_radius or 0.0)


def _state_error(gait: Gait, walked: Sequence[Step]) -> float:
    """Largest difference of the states at the times of the gait's arcs, in natural units.

    The simulated arc is found by its time, not by its number: if a switch falls on a breakpoint of the control,
    rounding decides which comes first. Only arcs with the same stops locked, the same contacts on the ground and the
    same number of swaps of the feet before them are compared.
    """

    def between_impacts(step: Step) -> Iterator[tuple[Arc, tuple[object, ...]]]:
        landed = 0
        for arc in step.arcs:
            landed += arc.struck is not None and arc.struck.swaps
            yield arc, (landed, arc.mode.locked, arc.mode.touching)

    def states_at(step: Step, ours: Arc, key: tuple[object, ...]) -> Array:
        arcs = [arc for arc, other in between_impacts(step) if other == key]
        outside = [np.maximum(np.maximum(arc.start - ours.times, ours.times - arc.end), 0.0) for arc in arcs]
        index = np.argmin(outside, axis=0)  # the first arc that contains the time, or the closest one
        states = np.empty(ours.states.shape)
        for k in np.unique(index).tolist():
            arc = arcs[k]
            fractions = np.clip(2 * (ours.times[index == k] - arc.start) / arc.duration - 1, -1, 1)
            states[index == k] = chebyshev.chebval(fractions, curves.coefficients(arc.states)).T
        return states

    return max(
        float(np.abs((states_at(step, arc, key) - arc.states) / gait.dynamics.state_units).max())
        for step, solved in zip(walked, gait.steps, strict=True)
        for arc, key in between_impacts(solved)
    )


def _impact_errors(
    gait: Gait, steps: Sequence[Step], error: Callable[[float, float, float], float]
) -> dict[str, float]:
    """Errors of the gait's impacts against those of ``steps``; ``error`` compares two numbers, given their unit."""
    scales, units = gait.dynamics.scales, gait.dynamics.state_units
    errors: dict[str, float] = {}

    def worst(one: Array, other: Array, unit: Array) -> float:
        return max(map(error, one.tolist(), other.tolist(), unit.tolist()))

    for number, (step, other) in enumerate(zip(gait.steps, steps, strict=True), start=1):
        ours, theirs = step.final_impact, other.final_impact
        of_step = {
            "impulse": worst(ours.impulse, theirs.impulse, np.full(ours.impulse.size, scales.impulse)),
            "stick impulse": worst(ours.stick_impulse, theirs.stick_impulse, np.full(2, scales.impulse)),
            "step length": error(ours.step_length, theirs.step_length, scales.length),
            "push work": error(ours.push_work, theirs.push_work, scales.energy),
            "state": worst(ours.state, theirs.state, units),
            "mode": 0.0 if ours.mode is theirs.mode else np.inf,
        }
        suffix = f" of step {number}" if len(gait.steps) > 1 else ""
        errors |= {f"{name}{suffix}": value for name, value in of_step.items()}
    return errors


def _error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference in units of ``unit``; infinite if only one of the two is defined."""
    if ours is None or theirs is None:
        return 0.0 if ours is theirs else np.inf
    return abs(ours - theirs) / unit


def _relative_error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference relative to ``theirs``, or to ``SMALLEST_SCALAR`` times the unit if that is larger."""
    if ours == theirs:
        return 0.0
    return _error(ours, theirs, max(abs(theirs or 0.0), SMALLEST_SCALAR * unit) or np.inf)


def _worst(name: str, *comparisons: tuple[dict[str, float], float]) -> Claim:
    """The claim about the error that is largest relative to its tolerance; the note names this error.

    An error that is not a number counts as the largest.
    """
    errors = [(error, key, tolerance) for values, tolerance in comparisons for key, error in values.items()]
    error, key, tolerance = max(errors, key=lambda row: row[0] / row[2] if np.isfinite(row[0]) else np.inf)
    return claim(name, error, tolerance, f"worst: {key}")


def _rounding_of_multipliers(jacobian: Array) -> float:
    """Change of the multipliers that rounding of the derivative causes; near a double multiplier it is large."""
    random = np.random.default_rng(0)
    multipliers, size = floquet_multipliers(jacobian), ROUNDING * np.linalg.norm(jacobian, 2)
    changes = (size * random.standard_normal(jacobian.shape) / len(jacobian) for _ in range(ROUNDING_SAMPLES))
    moved = (floquet_multipliers(jacobian + change) for change in changes)
    return max(multiplier_distance(changed, multipliers, relative=True) for changed in moved)
