"""Claim by claim: does the forward simulator, which chooses the modes itself, confirm a gait of the NLP?"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.errors import SolveError
from gaitopt.gait import Ending, Gait, Step, Trajectory, curves, floquet_multipliers, multiplier_distance, observe
from gaitopt.mechanics import Mode
from gaitopt.orbit import FixedPoint, Return, ReturnMap
from gaitopt.simulation import Engine, Simulator, make_stepper

Array = NDArray[np.float64]

AGREEMENT = 1e-9
"""Period, switching times and states of the two roads."""
MULTIPLIER_AGREEMENT = 1e-7
INTERIOR_AGREEMENT = 1e-8
"""States inside an arc, where the simulator interpolates."""
FORCE_SLACK = 1e-8
"""Relative excess over the friction cone that rounding at its edge can cause."""
ENERGY_AGREEMENT = 1e-9
"""Relative to the largest change of energy or the weight times one metre, whichever is larger."""
PERTURBATION = 1e-6
LINEAR_RANGE = (1e-9, 1e-3)
"""Below it rounding rules, above it the curvature of the return map."""
PERTURBED_STEPS = 50
LINEARITY = 1e-3
"""Rounding of a step, 1e-12, over the smallest deviation; third-order terms, a thousand times (1e-3)^2, in the largest.

Opposite perturbations are followed together: the map's curvature drops out of half their difference, so that one
tolerance serves all walkers; what is found on the gaits of the paper is below 1e-5.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One statement about a gait, the figure that was found for it, and the tolerance it must keep."""

    name: str
    figure: float
    tolerance: float
    passed: bool
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """All claims about one gait."""

    claims: tuple[Claim, ...]

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
            "claims": [{**asdict(c), "figure": c.figure if np.isfinite(c.figure) else None} for c in self.claims],
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
    if gait.step is None:
        raise SolveError(f"{gait.problem.name} is {gait.status}, there is no gait to verify: {gait.message}")
    simulator = Simulator(gait.system, gait.p, stepper=make_stepper(gait.system, gait.p, engine))
    walked = simulator.run(gait.state, steps=1, dense=True)
    claims = [_sequence_claim(gait, walked), *_margin_claims(gait), _energy_claim(gait)]
    if claims[0].passed:
        claims += _comparison_claims(gait, walked.steps[0])
        claims += _return_map_claims(gait, ReturnMap(simulator, gait.problem.sequence.impact))
    return Verification(claims=tuple(claims))


def confirm(gait: Gait) -> Verification:
    """A short examination: the simulator walks one step through the same modes back to the same state."""
    walked = Simulator(gait.system, gait.p).run(gait.state, steps=1, dense=True)
    claims = [_sequence_claim(gait, walked)]
    if claims[0].passed:
        claims += _comparison_claims(gait, walked.steps[0])
    return Verification(claims=tuple(claims))


def _claim(name: str, figure: float, tolerance: float, note: str = "") -> Claim:
    return Claim(name=name, figure=float(figure), tolerance=tolerance, passed=bool(figure <= tolerance), note=note)


def _sequence_claim(gait: Gait, walked: Trajectory) -> Claim:
    """The simulator goes through the same modes and the same impact."""
    sequence = gait.problem.sequence
    step = walked.steps[0] if walked.steps else None
    if walked.ending is not Ending.COMPLETED or step is None or step.impact is None:
        return Claim(name="mode sequence", figure=np.inf, tolerance=0.0, passed=False, note=walked.message)
    modes = tuple(mode for mode, _ in step.phases)
    matches = modes == sequence.phases and step.impact.mode is sequence.impact
    note = f"simulator: {', '.join(modes)}; {step.impact.mode}"
    return Claim(name="mode sequence", figure=0.0 if matches else np.inf, tolerance=0.0, passed=matches, note=note)


def _comparison_claims(gait: Gait, walked: Step) -> Iterator[Claim]:
    """The simulated step against that of the NLP."""
    assert gait.step is not None
    assert walked.impact is not None
    growth = max(1.0, gait.spectral_radius or 0.0)  # an unstable step magnifies what the two roads differ by
    ours, theirs = (np.cumsum([duration for _, duration in step.phases]) for step in (gait.step, walked))
    yield _claim("period", abs(ours[-1] - theirs[-1]), growth * AGREEMENT, "s")
    yield _claim("switching times", np.abs(ours - theirs).max(), growth * AGREEMENT, "s")
    returned = np.abs(walked.impact.state - gait.state).max()
    yield _claim("periodicity", returned, growth * AGREEMENT, "state after one step")
    inside = max(np.abs(_states(walked, arc.times) - arc.states).max() for arc in gait.step.arcs)
    yield _claim("states inside", inside, growth * INTERIOR_AGREEMENT, "largest difference along the step")


def _states(step: Step, times: Array) -> Array:
    """States (m, n_z) of a step at times since impact (m,).

    Arcs are found by time: where a switch falls on a breakpoint of the control, rounding decides which comes first.
    """
    index = np.searchsorted([arc.end for arc in step.arcs[:-1]], times)
    states = np.empty((times.size, step.arcs[0].states.shape[1]))
    for k, arc in enumerate(step.arcs):
        fractions = np.clip(2 * (times[index == k] - arc.start) / arc.duration - 1, -1, 1)
        states[index == k] = chebyshev.chebval(fractions, curves.coefficients(arc.states)).T
    return states


def _margin_claims(gait: Gait) -> Iterator[Claim]:
    """What each mode takes for granted, between the nodes too."""
    assert gait.step is not None
    friction = float(gait.system.static_friction(gait.p))
    cone, backward, lowest = -np.inf, 0.0, np.inf
    for arc in gait.step.arcs:
        force = observe(gait.system, gait.p, arc).force
        lowest = min(lowest, -curves.maximum(-force[:, 1])[1])
        if arc.mode is Mode.STICK:
            ratio = force[:, 0] / force[:, 1]
            needed = max(curves.maximum(ratio)[1], curves.maximum(-ratio)[1])
            cone = max(cone, needed - friction)
        else:
            backward = max(backward, curves.maximum(-arc.mode.direction * arc.states[:, -1])[1])
    if np.isfinite(cone):
        yield _claim("friction cone", cone, FORCE_SLACK, "needed minus available friction while sticking")
    yield _claim("slip direction", backward, AGREEMENT, "m/s against the mode")
    yield _claim("normal force", -lowest, 0.0, f"at least {lowest:.4g} N")


def _energy_claim(gait: Gait) -> Claim:
    """Energy gained equals motor work plus work of the friction force, phase by phase."""
    assert gait.step is not None
    worst, scale = 0.0, float(gait.system.weight(gait.p))
    for arc in gait.step.arcs:
        o = observe(gait.system, gait.p, arc)
        power = o.power.sum(axis=1) + o.force[:, 0] * arc.states[:, -1]
        worst = max(worst, abs(o.energy[-1] - o.energy[0] - curves.integral(power, arc.duration)))
        scale = max(scale, abs(o.energy[-1] - o.energy[0]))
    return _claim("energy balance", worst / scale, ENERGY_AGREEMENT, "relative")


def _return_map_claims(gait: Gait, return_map: ReturnMap) -> Iterator[Claim]:
    """Fixed point, multipliers and a perturbation, all on the simulator's return map."""
    xi = gait.state[gait.system.section(gait.problem.sequence.impact)]
    point = return_map.fixed_point(xi)
    if not point.converged or point.jacobian is None:
        note = f"Newton's method on the simulated return map stalls at {point.residual:.2g}: {point.message}"
        yield Claim(name="state", figure=np.inf, tolerance=AGREEMENT, passed=False, note=note)
        return
    yield _claim("state", np.abs(point.xi - xi).max(), AGREEMENT, "distance to the fixed point of the simulator")
    distance = multiplier_distance(floquet_multipliers(point.jacobian), gait.multipliers)
    yield _claim("multipliers", distance, MULTIPLIER_AGREEMENT, "saltation against implicit differentiation")
    yield _perturbation_claim(return_map, point)


def _perturbation_claim(return_map: ReturnMap, point: FixedPoint) -> Claim:
    """Two small opposite perturbations go the way of the powers of the return map's derivative."""
    assert point.jacobian is not None
    predicted = np.full(point.xi.size, PERTURBATION / np.sqrt(point.xi.size))
    pair, worst, steps = [predicted, -predicted], 0.0, 0
    lowest, highest = LINEAR_RANGE
    for step in range(1, PERTURBED_STEPS + 1):
        predicted = point.jacobian @ predicted
        size = float(np.linalg.norm(predicted))
        if not lowest < size < highest:
            break
        pair, lost = _both_return(return_map, point.xi, pair)
        if lost is not None and steps == 0 and lost.ending is Ending.COMPLETED:
            return _edge_claim(return_map, point)
        if lost is not None and lost.ending is not Ending.COMPLETED:
            note = f"step {step} of a perturbed walk: {lost.message}"
            return Claim(name="perturbation", figure=np.inf, tolerance=LINEARITY, passed=False, note=note)
        if lost is not None:  # the gait lies so close to another kind of impact
            break
        worst = max(worst, float(np.linalg.norm((pair[0] - pair[1]) / 2 - predicted)) / size)
        steps = step
    return _claim("perturbation", worst, LINEARITY, f"relative to powers of the Jacobian, {steps} steps")


def _edge_claim(return_map: ReturnMap, point: FixedPoint) -> Claim:
    """At the edge of its kind of impact a gait has no linear neighbourhood; perturbed walks must still come back.

    A design whose optimum is limited by friction lies there.
    """
    simulator, system, worst = return_map.simulator, return_map.simulator.system, 0.0
    deviation = np.full(point.xi.size, PERTURBATION / np.sqrt(point.xi.size))
    target = system.lift_state(point.xi, simulator.p)
    for sign in (1, -1):
        start = system.lift_state(point.xi + sign * deviation, simulator.p)
        walk = simulator.run(start, steps=PERTURBED_STEPS)
        distance = float(np.linalg.norm(walk.section_states[-1] - target)) / PERTURBATION
        worst = max(worst, distance if walk.ending is Ending.COMPLETED else np.inf)
    return _claim("perturbation", worst, 1.0, f"left of it after {PERTURBED_STEPS} steps, at an edge")


def _both_return(return_map: ReturnMap, xi: Array, pair: list[Array]) -> tuple[list[Array], Return | None]:
    """Deviations of two walks from ``xi`` one step later, or the walk that did not return to the section."""
    deviations = []
    for deviation in pair:
        result = return_map(xi + deviation)
        if result.xi is None:
            return pair, result
        deviations.append(result.xi - xi)
    return deviations, None
