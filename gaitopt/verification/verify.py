"""Verification of a gait, claim by claim, by the forward simulator, which chooses the modes itself.

The simulated cycle is compared with that of the gait: modes, times, states, impacts and scalars. Margins and the energy
balance are examined along the gait, also between the nodes. Fixed point and multipliers are compared with those of the
simulator's return map P, and its Jacobian J with differences of P along directions v, extrapolated to h = 0:

    (P(xi + h v) - P(xi - h v)) / 2h = J v + c_2 h^2 + c_4 h^4 + ...        Ridders (1982), Adv. Eng. Software 4, 75-76

Only walks with the gait's own modes are used. Where there are none on one side of the gait (a gait at the limit of
friction), the difference is one-sided and all powers of h are eliminated. Figures are dimensionless: errors are in the
natural units of the walker.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.display import Tabulated
from gaitopt.errors import SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, floquet_multipliers, multiplier_distance
from gaitopt.gait.measures import friction_ratio, measure, measure_scales, observe
from gaitopt.gait.trajectory import Arc, ImpactRecord, Step, Trajectory, impact_record
from gaitopt.model.cycle import ModeSequence
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import Ending
from gaitopt.simulation.engine import Engine
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.verification.return_map import ROUNDING, FixedPoint, ReturnMap

AGREEMENT = 1e-9
"""Period, switching times and states just after the impact."""
INTERIOR_AGREEMENT = 1e-8
"""States inside an arc, where the simulator interpolates, and all scalars of arcs."""
RECOMPUTED = 1e-9
"""Relative agreement of a stated scalar with its value along the gait's own motion; only rounding differs."""
SMALL = 1e-4
"""In natural units: smaller scalars are compared as if they were this large, since rounding is 1e-15 of the unit."""
FORCE_SLACK = 1e-8
"""Excess over the friction coefficient that rounding at the edge of the cone can cause."""
ENERGY_AGREEMENT = 1e-9
"""Relative to the largest change of energy or to weight times leg length, whichever is larger."""
MULTIPLIER_AGREEMENT = 1e-9
"""Relative where a multiplier exceeds one. An unstable cycle magnifies the errors of both methods by its radius: of 900
random gaits the worst is a tenth of this times the radius."""
DISCERNIBLE = 2e-6
"""Largest tolerance of the multipliers: an error of 1e-5 must stand out, however unstable or sensitive they are."""
ROUNDING_SAMPLES = 4
LARGEST, SIZES = 2.0**-12, 16
"""Largest deviation, in natural units, and number of sizes, each half of the one before; at the smallest, 7e-9, the
rounding of a step is 1e-6 to 1e-5 of the deviation."""
LINEARITY = 2e-6
"""Of the norm of the Jacobian: a Jacobian with a relative error of 1e-5 exceeds it along at least one of up to 25
directions. Named gaits stay below 1e-8."""
RESOLVED = LINEARITY / 4
"""Largest estimated error of an extrapolated difference that can decide the claim."""
SETTLED = RESOLVED / 100
"""Estimated error below which no smaller deviation is tried."""
SPARE_DIRECTIONS = 8
"""Random directions per coordinate that are tried where some coordinate direction leaves the gait's modes on both
sides, as next to two limits at once."""
INDEPENDENT = 0.1
"""Least part of a unit vector that must be orthogonal to the directions before it."""

Quotient = Callable[[float], Array | None]


class Outcome(StrEnum):
    """How the examination of a claim ended; only ``holds`` is a pass."""

    HOLDS = "holds"
    FAILS = "fails"
    NOT_EXAMINED = "not_examined"
    NO_LINEAR_RANGE = "no_linear_range"


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One statement about a gait, the figure that was measured for it, and the tolerance it must keep.

    Attributes
    ----------
    name : what was examined.
    figure, tolerance : the error that was measured, infinite if none could be, and its limit.
    passed : whether the claim holds.
    note : what the figure measures, or why there is none.
    outcome : ``holds``, ``fails``, ``not_examined`` (the motion to be examined does not exist) or ``no_linear_range``
        (rounding and curvature leave no size of deviation at which a derivative could be judged).
    """

    name: str
    figure: float
    tolerance: float
    passed: bool
    note: str = ""
    outcome: Outcome = Outcome.HOLDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification(Tabulated):
    """All claims about one gait."""

    claims: tuple[Claim, ...]

    def __repr__(self) -> str:
        failed = [claim.name for claim in self.claims if not claim.passed]
        words = f"FAILED: {', '.join(failed)}" if failed else "passed"
        return f"<Verification: {len(self.claims)} claims, {words}>"

    @property
    def passed(self) -> bool:
        """Whether every claim holds."""
        return all(claim.passed for claim in self.claims)

    def figure(self, name: str) -> float | None:
        """Figure of one claim, or None if it could not be examined."""
        return next((claim.figure for claim in self.claims if claim.name == name and np.isfinite(claim.figure)), None)

    def to_record(self) -> dict[str, Any]:
        """JSON-able record with the keys of the command line."""
        sequence = next(claim for claim in self.claims if claim.name == "mode sequence")
        return {
            "passed": self.passed,
            "period_error": self.figure("period"),
            "state_error": self.figure("state"),
            "multiplier_error": self.figure("multipliers"),
            "mode_sequence_matches": sequence.passed,
            "claims": [
                {**asdict(c), "figure": c.figure if np.isfinite(c.figure) else None, "outcome": str(c.outcome)}
                for c in self.claims
            ],
        }


def verify(gait: Gait, *, engine: str = Engine.AUTO) -> Verification:
    """Examine a gait by forward simulation from its state after impact.

    Parameters
    ----------
    gait : a converged gait.
    engine : integrator of the simulation: ``auto``, ``scipy`` or ``heyoka``.

    Raises
    ------
    SolveError
        If ``gait`` is a failed attempt.
    UnknownNameError
        If the engine is unknown or not installed.
    """
    check_gait(gait)
    simulator = Simulator(gait.dynamics, stepper_class(engine))
    cycle = gait.problem.cycle
    walked = simulator.run(gait.state, steps=len(cycle.steps), dense=True)
    claims = [_sequence_claim(gait, walked), *_margin_claims(gait), _energy_claim(gait)]
    if claims[0].passed:
        claims += motion_claims(gait, walked.steps)
        claims += record_claims(gait, walked.steps)
        claims += return_map_claims(gait, ReturnMap(simulator, cycle.impact, len(cycle.steps)))
    return Verification(claims=tuple(claims))


def confirm(gait: Gait) -> Verification:
    """A short verification: the simulator walks one cycle through the same modes back to the same state."""
    check_gait(gait)
    walked = Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True)
    claims = [_sequence_claim(gait, walked)]
    if claims[0].passed:
        claims += motion_claims(gait, walked.steps)
    return Verification(claims=tuple(claims))


def check_gait(gait: Gait) -> None:
    """Raise ``SolveError`` for a failed attempt."""
    if not gait.steps:
        raise SolveError(f"{gait.problem.name} is {gait.status}, there is no gait to verify: {gait.message}")


def motion_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """Times and states of the simulated steps ``walked`` against those of the gait."""
    scales, unit, growth = gait.dynamics.scales, gait.dynamics.state_units, magnification(gait)
    durations = ([duration for step in steps for _, duration in step.phases] for steps in (gait.steps, walked))
    ours, theirs = (np.cumsum(own) / scales.time for own in durations)
    yield claim("period", abs(ours[-1] - theirs[-1]), growth * AGREEMENT, "in units of sqrt(l / g)")
    yield claim("switching times", np.abs(ours - theirs).max(), growth * AGREEMENT, "in units of sqrt(l / g)")
    returned = np.abs((_impacts(walked)[-1].state - gait.state) / unit).max()
    yield claim("periodicity", returned, growth * AGREEMENT, "state after one cycle")
    inside = _state_error(gait, walked)
    yield claim("states inside", inside, growth * INTERIOR_AGREEMENT, "largest difference along the cycle")


def record_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """The scalars, parameters and impacts that the gait's record states.

    Scalars and impacts are compared with the simulated steps and, where these confirm the gait's states, more closely
    with their values along the gait's own motion; parameters with those of the motion. A claim has the figure and the
    tolerance of the comparison that is worse.
    """
    units, tolerance = measure_scales(gait.dynamics.scales), magnification(gait) * INTERIOR_AGREEMENT
    confirmed = _recomputed(gait) if _state_error(gait, walked) <= tolerance else ()
    errors = {k: _error(gait.measures.get(k), value, units[k]) for k, value in measure(walked).items()}
    given = {key: value for key, value in gait.problem.parameters.items() if key not in gait.problem.free}
    moving = gait.dynamics.parameters
    closely = {key: _relative_error(value, moving[key], 0.0) for key, value in {**given, **gait.freed}.items()}
    if confirmed:
        recomputed = measure(confirmed)
        closely = {k: _relative_error(gait.measures.get(k), v, units[k]) for k, v in recomputed.items()} | closely
    yield _worst("measures", (errors, tolerance), (closely, RECOMPUTED))
    errors = _impact_errors(gait, _impacts(walked), _error)
    closely = _impact_errors(gait, _impacts(confirmed), _relative_error) if confirmed else {}
    yield _worst("impact", (errors, tolerance), (closely, RECOMPUTED))


def return_map_claims(gait: Gait, return_map: ReturnMap) -> Iterator[Claim]:
    """Fixed point, multipliers and perturbations, all on the simulator's return map."""
    section = gait.system.section(gait.problem.cycle.impact)
    xi, unit = gait.state[section], gait.dynamics.state_units[section]
    point = return_map.fixed_point(xi)
    if point.jacobian is None:
        yield failed_claim("state", AGREEMENT, f"no fixed point of the simulated return map: {point.message}")
        return
    distance = np.abs((point.xi - xi) / unit).max() + _remaining(point, section, unit)
    yield claim("state", distance, AGREEMENT, "distance to the fixed point of the simulator")
    distance = multiplier_distance(gait.multipliers, floquet_multipliers(point.jacobian), relative=True)
    tolerance = min(max(magnification(gait) * MULTIPLIER_AGREEMENT, _sensitivity(point, unit)), DISCERNIBLE)
    yield claim("multipliers", distance, tolerance, "saltation against implicit differentiation")
    yield perturbation_claim(return_map, point, unit)


def perturbation_claim(return_map: ReturnMap, point: FixedPoint, unit: Array) -> Claim:
    """Small perturbations return as the derivative of the return map says, along a basis of the section.

    The figure is the largest error of a direction, relative to the norm of the derivative. Where rounding and
    curvature leave no size of deviation at which the returns can be judged, the outcome is ``no_linear_range``.

    Parameters
    ----------
    return_map : of the simulator, over one cycle.
    point : its fixed point, with the derivative to be judged.
    unit : ndarray, shape (n_xi,) - natural units of the section coordinates.
    """
    if point.jacobian is None:
        return failed_claim("perturbation", LINEARITY, point.message)
    jacobian = _scaled(point.jacobian, unit)
    size = float(np.linalg.norm(jacobian, 2)) or 1.0
    differenced = _Differenced(return_map, point, unit)
    judged: list[Array] = []
    figure, doubt = 0.0, 0.0
    for v in _directions(unit.size):
        if not _is_independent(v, judged):
            continue
        derivative, error = differenced.along(v, goal=SETTLED * size)
        if derivative is None:
            continue
        if not error <= RESOLVED * size:
            words = f"differences of the return map are uncertain by {error / size:.1g} at every size of deviation"
            return failed_claim("perturbation", LINEARITY, words, Outcome.NO_LINEAR_RANGE)
        figure = max(figure, float(np.linalg.norm(derivative - jacobian @ v)) / size)
        doubt, judged = max(doubt, error / size), [*judged, v]
        if len(judged) == unit.size:
            note = f"extrapolated differences of the return map against the Jacobian, known to {doubt:.1g}"
            return claim("perturbation", figure, LINEARITY, note)
    words = f"{differenced.lost}: only {len(judged)} of {unit.size} directions keep the modes of the gait"
    return failed_claim("perturbation", LINEARITY, words, Outcome.NO_LINEAR_RANGE)


def claim(name: str, figure: float, tolerance: float, note: str = "") -> Claim:
    """The claim that ``figure`` does not exceed ``tolerance``; it fails where the figure is no number."""
    passed = bool(figure <= tolerance)
    outcome = Outcome.HOLDS if passed else Outcome.FAILS
    return Claim(name=name, figure=float(figure), tolerance=tolerance, passed=passed, note=note, outcome=outcome)


def failed_claim(name: str, tolerance: float, note: str, outcome: Outcome = Outcome.NOT_EXAMINED) -> Claim:
    """A claim that could not be examined."""
    return Claim(name=name, figure=np.inf, tolerance=tolerance, passed=False, note=note, outcome=outcome)


def magnification(gait: Gait) -> float:
    """Factor by which an unstable cycle magnifies the difference between the two methods."""
    return max(1.0, gait.spectral_radius or 0.0)


def extrapolated(quotient: Quotient, *, power: int, goal: float) -> tuple[Array | None, float]:
    """The limit of a difference quotient at h = 0, from a tableau of halved sizes, and its estimated error.

    Parameters
    ----------
    quotient : of a size h; None where it is not defined.
    power : difference of the exponents of its error: 2 of central differences, 1 of one-sided ones.
    goal : estimated error at which to stop.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4, 75-76.
    """
    best, error = None, np.inf
    row: list[Array] = []
    for k in range(SIZES):
        value = quotient(LARGEST / 2**k)
        if value is None:
            row = []
            continue
        previous, row = row, [value]
        for j, above in enumerate(previous, start=1):
            row.append(row[-1] + (row[-1] - above) / (2 ** (power * j) - 1))
            estimate = max(float(np.abs(row[j] - row[j - 1]).max()), float(np.abs(row[j] - above).max()))
            if estimate < error:
                best, error = row[j], estimate
        if error <= goal:
            break
    return best, error


def _sequence_claim(gait: Gait, walked: Trajectory) -> Claim:
    """The simulator takes the same modes and the same impacts."""
    if walked.ending is not Ending.COMPLETED:
        return failed_claim("mode sequence", 0.0, walked.message)
    sequences = [
        ModeSequence(tuple(mode for mode, _ in step.phases), step.impact.mode)
        for step in walked.steps
        if step.impact is not None
    ]
    note = f"simulator: {' | '.join(map(str, sequences))}"
    return claim("mode sequence", 0.0 if tuple(sequences) == gait.problem.cycle.steps else np.inf, 0.0, note)


def _margin_claims(gait: Gait) -> Iterator[Claim]:
    """The margins of each mode, between the nodes too."""
    friction, scales = gait.dynamics.static_friction, gait.dynamics.scales
    cone, backward, lowest = -np.inf, 0.0, np.inf
    for arc in gait.arcs:
        if not arc.mode.touching:
            continue
        force = observe(arc).force
        lowest = min(lowest, -curves.maximum(-force[:, 1])[1])
        if arc.mode.sticks:
            ratio = friction_ratio(force)
            needed = max(curves.maximum(ratio)[1], curves.maximum(-ratio)[1])
            cone = max(cone, needed - friction)
        else:
            backward = max(backward, curves.maximum(-arc.mode.direction * arc.states[:, -1])[1])
    if np.isfinite(cone):
        yield claim("friction cone", cone, FORCE_SLACK, "needed minus available friction while sticking")
    yield claim("slip direction", backward / scales.speed, AGREEMENT, "against the mode, in units of sqrt(g l)")
    pull = (
        FORCE_SLACK if "normal_force" in gait.system.transitions.unloaded else 0.0
    )  # their force falls to zero in every step
    yield claim("normal force", -lowest / scales.force, pull, f"at least {lowest:.4g} N")


def _energy_claim(gait: Gait) -> Claim:
    """Energy gained equals the work of motors and friction less the loss in dampers, phase by phase."""
    worst, scale = 0.0, gait.dynamics.scales.energy
    for arc in gait.arcs:
        o = observe(arc)
        power = o.power.sum(axis=1) + o.force[:, 0] * arc.states[:, -1] - o.loss
        worst = max(worst, abs(o.energy[-1] - o.energy[0] - curves.integral(power, arc.duration)))
        scale = max(scale, abs(o.energy[-1] - o.energy[0]))
    return claim("energy balance", worst / scale, ENERGY_AGREEMENT, "relative")


def _state_error(gait: Gait, walked: Sequence[Step]) -> float:
    """Largest difference of the states along the cycle, in natural units."""
    pairs = [(step, arc) for step, own in zip(walked, gait.steps, strict=True) for arc in own.arcs]
    return max(
        float(np.abs((_states(step, arc) - arc.states) / gait.dynamics.state_units).max()) for step, arc in pairs
    )


def _states(step: Step, ours: Arc) -> Array:
    """States (m, n_z) of a step at the times of an arc (m,).

    Arcs are found by time, among those with the same stops locked: where a switch falls on a breakpoint of the control,
    rounding decides which comes first.
    """
    arcs = [arc for arc in step.arcs if arc.mode.locked == ours.mode.locked and arc.mode.touching == ours.mode.touching]
    times = ours.times
    index = np.searchsorted([arc.end for arc in arcs[:-1]], times)
    states = np.empty((times.size, ours.states.shape[1]))
    for k, arc in enumerate(arcs):
        fractions = np.clip(2 * (times[index == k] - arc.start) / arc.duration - 1, -1, 1)
        states[index == k] = chebyshev.chebval(fractions, curves.coefficients(arc.states)).T
    return states


def _recomputed(gait: Gait) -> tuple[Step, ...]:
    """The steps of the gait with impacts computed again from the states before them."""
    return tuple(
        replace(
            step,
            impact=impact_record(step.arcs[-1].dynamics, step.final_impact.mode, step.arcs[-1].states[-1]),
        )
        for step in gait.steps
    )


def _impacts(steps: Sequence[Step]) -> list[ImpactRecord]:
    return [step.impact for step in steps if step.impact is not None]


def _impact_errors(
    gait: Gait, others: Sequence[ImpactRecord], error: Callable[[float, float, float], float]
) -> dict[str, float]:
    """Errors of the gait's impact records; ``error`` compares two numbers, given their natural unit."""
    scales, units = gait.dynamics.scales, gait.dynamics.state_units
    errors: dict[str, float] = {}

    def worst(one: Array, other: Array, unit: Array) -> float:
        return max(map(error, one.tolist(), other.tolist(), unit.tolist()))

    impulse = np.full(2, scales.impulse)
    for number, (ours, theirs) in enumerate(zip(_impacts(gait.steps), others, strict=True), start=1):
        of_step = {
            "impulse": worst(ours.impulse, theirs.impulse, impulse),
            "stick impulse": worst(ours.stick_impulse, theirs.stick_impulse, impulse),
            "step length": error(ours.step_length, theirs.step_length, scales.length),
            "push work": error(ours.push_work, theirs.push_work, scales.energy),
            "state": worst(ours.state, theirs.state, units),
            "mode": 0.0 if ours.mode is theirs.mode else np.inf,
        }
        place = f" of step {number}" if len(gait.steps) > 1 else ""
        errors |= {f"{name}{place}": value for name, value in of_step.items()}
    return errors


def _error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference in units of ``unit``; infinite where only one of the two is defined."""
    if ours is None or theirs is None:
        return 0.0 if ours is theirs else np.inf
    return abs(ours - theirs) / unit


def _relative_error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference relative to ``theirs``, or to ``SMALL`` units where that is larger."""
    if ours == theirs:
        return 0.0
    return _error(ours, theirs, max(abs(theirs or 0.0), SMALL * unit) or np.inf)


def _worst(name: str, *comparisons: tuple[dict[str, float], float]) -> Claim:
    """The claim about the error that is largest relative to the tolerance of its comparison; its note names it.

    An error that is no number counts as the largest.
    """
    errors = [(error, key, tolerance) for own, tolerance in comparisons for key, error in own.items()]
    error, key, tolerance = max(errors, key=lambda row: row[0] / row[2] if np.isfinite(row[0]) else np.inf)
    return claim(name, error, tolerance, f"worst: {key}")


def _remaining(point: FixedPoint, section: NDArray[np.intp], unit: Array) -> float:
    """Distance to the fixed point where rounding stops Newton's method short of it: its next correction."""
    if point.converged:
        return 0.0
    impact = point.steps[-1].impact
    if point.jacobian is None or impact is None:
        return np.inf
    defect = impact.state[section] - point.xi
    correction = np.linalg.lstsq(_scaled(point.jacobian, unit) - np.eye(unit.size), defect / unit, rcond=None)[0]
    return float(np.abs(correction).max())


def _sensitivity(point: FixedPoint, unit: Array) -> float:
    """Change of the multipliers that rounding of the derivative causes: next to a double one, its square root."""
    if point.jacobian is None:
        return 0.0
    jacobian, random = _scaled(point.jacobian, unit), np.random.default_rng(0)
    multipliers, size = floquet_multipliers(jacobian), ROUNDING * np.linalg.norm(jacobian, 2)
    changes = (size * random.standard_normal(jacobian.shape) / unit.size for _ in range(ROUNDING_SAMPLES))
    moved = (floquet_multipliers(jacobian + change) for change in changes)
    return max(multiplier_distance(changed, multipliers, relative=True) for changed in moved)


def _scaled(jacobian: Array, unit: Array) -> Array:
    """The derivative of the return map between section coordinates in natural units."""
    return jacobian * unit / unit[:, None]


def _directions(n: int) -> Iterator[Array]:
    """The coordinate directions, then random ones; unit vectors of shape (n,)."""
    yield from np.eye(n)
    random = np.random.default_rng(0)
    for _ in range(SPARE_DIRECTIONS * n if n > 1 else 0):
        v = random.standard_normal(n)
        yield v / np.linalg.norm(v)


def _is_independent(v: Array, others: list[Array]) -> bool:
    if not others:
        return True
    basis = np.linalg.qr(np.array(others).T)[0]
    return float(np.linalg.norm(v - basis @ (basis.T @ v))) > INDEPENDENT


class _Differenced:
    """Directional derivatives of a return map at its fixed point, in natural units."""

    def __init__(self, return_map: ReturnMap, point: FixedPoint, unit: Array) -> None:
        self._map, self._point, self._unit = return_map, point, unit
        section = return_map.simulator.system.section(return_map.section_mode)
        self._returned = point.steps[-1].final_impact.state[section]
        self._modes = _modes(point.steps)
        self.lost = ""

    def along(self, v: Array, goal: float) -> tuple[Array | None, float]:
        """The derivative along ``v`` and its estimated error; None if no perturbed walk keeps the gait's modes.

        Central differences come first, then those of either side alone.
        """
        known: dict[float, Array | None] = {}

        def ahead(h: float) -> Array | None:
            """(P(xi + h v) - P(xi)) / h."""
            if h not in known:
                known[h] = self._return(h * v)
            returned = known[h]
            return None if returned is None else returned / h

        def behind(h: float) -> Array | None:
            return ahead(-h)

        def central(h: float) -> Array | None:
            one, other = ahead(h), ahead(-h)
            return None if one is None or other is None else (one + other) / 2

        best, error = extrapolated(central, power=2, goal=goal)
        for one_sided in (ahead, behind):
            if error > RESOLVED / SETTLED * goal:
                candidate = extrapolated(one_sided, power=1, goal=goal)
                best, error = min((best, error), candidate, key=itemgetter(1))
        return best, error

    def _return(self, deviation: Array) -> Array | None:
        """Difference between the returns of a deviation and of the gait; None if the modes differ."""
        result = self._map(self._point.xi + deviation * self._unit)
        if result.xi is None or _modes(result.steps) != self._modes:
            self.lost = result.message if result.xi is None else "a perturbed walk goes through other modes"
            return None
        return np.asarray((result.xi - self._returned) / self._unit)


def _modes(steps: tuple[Step, ...]) -> list[tuple[tuple[Mode, ...], Mode]]:
    return [(tuple(mode for mode, _ in step.phases), step.final_impact.mode) for step in steps]
