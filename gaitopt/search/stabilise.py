"""A feedback law that walks a known gait stably, as a problem with its solved gait.

    gait  --  curves of its joints  --  problem with the law  --  gait under the law, verified, and its radius

The law is one of three. Under **virtual constraints** the joints with motors follow curves over a phase of the posture,
which are invariant under the impact: what is left of the motion has one degree of freedom, and its multiplier is
delta^2 of the zero dynamics. The walker must have one motor less than shape coordinates. Under **PD control** the
joints track curves over the clock or over a phase; the gains are raised until the spectral radius is below its bound.
**Feedback from step to step** keeps the law of the gait and corrects its parameters once per cycle.

The curves come from a quadratic program along the motion of the gait, see ``gaitopt.search.joint_curves``. Their degree
is the smallest one at which they fit, or the requested one.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.display import Tabulated, counted
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.measures import exceeded_limits, peak_torques
from gaitopt.gait.records import GaitRecord
from gaitopt.gait.trajectory import Step
from gaitopt.model.buffered import buffered
from gaitopt.model.control import ConstantTorque, NoControl
from gaitopt.model.declaration import joint_limits
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.units import Free
from gaitopt.model.virtual_constraints import FootModel, VirtualConstraints
from gaitopt.model.walker import WalkerType
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import guessed_names
from gaitopt.requests import FeedbackLaw, StabiliseRequest
from gaitopt.search.joint_curves import (
    CLOCK,
    FORCE_MARGIN,
    SMALLEST_DEGREE,
    FittedCurves,
    Joints,
    invariant_curves,
    tracked_curves,
)
from gaitopt.systems import solve_sequence
from gaitopt.verification.verify import verify

CLOSE = 0.25
"""Curves repeat a gait closely if their additional torques are a smaller fraction of its own torques."""
VIOLATED = 1e-6
"""Largest violation of the cone, relative to the weight, that is attributed to rounding in the quadratic program."""
MOST_DEGREE = 12
"""Largest degree of an invariant curve: more control points would be as hard to read as a table."""
PD_DEGREES = (14, 18, 10)
"""Degrees of the curves of a PD law, tried in this order until the law has a gait. The errors of the curves times the
gains are torques, which may violate the friction cone."""
NO_TORQUE = 1e-9
"""A motor is idle if its torque stays below this number, relative to the weight times the length."""
MONOTONE = 0.02
"""A phase is monotone if its smallest rate, relative to the mean rate, exceeds this number."""
SETTLING = 5.0
"""Decay of the outputs during one step: errors shrink by exp(-5) (1 + 5) = 4 %."""
MULTIPLES = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Rates of the errors under PD control, in units of the slowest rate of the walker, sqrt(g / l)."""
MOST_FAILURES = 3
"""The search ends after this number of laws without a gait in a row: higher gains or degrees do not help then."""
STALLS = 0.99
"""The gains are raised only while each raise multiplies the spectral radius by this factor or a smaller one."""
AROUND = 0.5
"""Largest distance between the control points of a design and those at its start [rad, or m]."""
DESIGN_DEGREE = 6
"""Largest degree of the curves of a design, which has an unknown per control point."""
INSIDE = 0.95
"""A design keeps the spectral radius below this fraction of the requested bound, so that the solved gait meets it."""
REFERENCES = ("reference", "other_reference")
"""Keys of the curves of the first step and of the second one."""
COMPARED = 101
"""Number of instants at which two motions are compared."""
Candidate = tuple[dict[str, Any], FittedCurves | None, Joints | None, str, Gait]
"""A law in the form of a problem file, its curves, the joints along their phase, the phase, and a gait as the guess."""
LQR_WEIGHTS = (1.0, 1e-2, 1e-4)
"""Weights of the corrected parameters, tried in this order until the spectral radius is below its bound."""
MOST_GAINS = 40
"""Largest number of gains for which the smallest spectral radius is searched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stabilised(Tabulated):
    """A law that repeats a gait, and the gait under this law.

    Attributes
    ----------
    gait : the gait under the law, solved and verified; ``problem`` is its problem.
    given : the gait that the law repeats.
    law : kind of the law.
    phase : phase of the curves, ``clock`` or the name of a phase variable; empty under feedback from step to step.
    least_rate : smallest rate of the phase along the given gait, relative to its mean; None without a phase.
    fitted : the curves, and how closely they repeat the gait; None under feedback from step to step.
    distance : largest difference of a shape coordinate between both gaits, at equal fractions of the step [rad, or m].
    invariance : largest output [rad], or rate of an output [rad/s], just after the impact; None under PD control.
    bound : upper bound of the spectral radius that was asked for.
    attempts : the laws that were tried, in order, and why each was rejected.
    """

    gait: Gait
    given: Gait
    law: FeedbackLaw
    phase: str
    least_rate: float | None
    fitted: FittedCurves | None
    distance: float
    invariance: float | None
    bound: float
    attempts: tuple[str, ...] = ()

    @property
    def problem(self) -> Problem:
        """The problem with the law, and with its gait as the guess."""
        if self.law is FeedbackLaw.STEP:  # its guess is the given gait, to which the feedback leads back
            return self.gait.problem
        return self.gait.problem.with_guess(self.gait)

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the gait is not what was asked for; empty if it is."""
        gait, objections = self.gait, list[str]()
        if gait.verification is None or not gait.verification["passed"]:
            objections.append("the simulation does not confirm the gait")
        if gait.scalar("spectral_radius") >= self.bound:
            objections.append(f"spectral radius {gait.scalar('spectral_radius'):.4g}, must be below {self.bound:g}")
        return (*objections, *exceeded_limits(gait.steps))

    def to_record(self) -> dict[str, Any]:
        """The JSON object of the gait with ``stabilised``, as on the command line."""
        record, efforts = dict(self.gait.to_record()), _efforts(type(self.gait.problem.walker))
        given: Mapping[str, Any] = dict(self.given.to_record())
        compared = ("spectral_radius", "speed", "peak_torque", "torque_squared", "required_friction")
        return {
            **record,
            "stabilised": {
                "law": self.law.value,
                "phase": self.phase,
                "least_phase_rate": self.least_rate,
                "degree": None if self.fitted is None else self.fitted.degree,
                "torque_deviation": None if self.fitted is None else self.fitted.deviation,
                "distance": self.distance,
                "invariance": self.invariance,
                "torques": {
                    name: {"needed": peak, "available": efforts.get(name)}
                    for name, peak in peak_torques(self.gait.arcs).items()
                },
                "given": {"problem": self.given.problem.name, **{key: given[key] for key in compared}},
                "objections": list(self.objections),
                "attempts": list(self.attempts),
            },
        }


def stabilise(
    gait: Gait, request: StabiliseRequest, *, say: Callable[[str], None] | None = None, should_stop: Stop = None
) -> Stabilised:
    """Find a law under which a gait is stable; if none of the laws stabilises it, return the one that comes closest.

    Parameters
    ----------
    say : called with a line about each attempt.
    should_stop : polled while gaits are solved; True ends the search.

    Raises
    ------
    SolveError
        If the gait is a failed solve, or no law has a gait near it.
    ProblemError
        If the walker has no motors or too few of them for virtual constraints, if no phase is monotone along the gait,
        or if the law has no parameters to correct.
    KeyboardInterrupt
        If ``should_stop`` ends it.
    """
    _check(gait)
    law = request.law or _default_law(gait)
    return _Search(gait, request, law, say, should_stop).run()


class _Search:
    """The laws that are tried for one gait, and the best one."""

    def __init__(
        self,
        gait: Gait,
        request: StabiliseRequest,
        law: FeedbackLaw,
        say: Callable[[str], None] | None,
        should_stop: Stop,
    ) -> None:
        self._gait, self._request, self._law, self._should_stop = gait, request, law, should_stop
        self._say = say or (lambda message: None)
        self._attempts: list[str] = []
        self._best: Stabilised | None = None
        self._nearest: Candidate | None = None

    def run(self) -> Stabilised:
        """The first law without objections, or the best one."""
        failures, last = 0, np.inf
        for candidates in _laws(self._gait, self._law, self._request):
            for candidate in candidates:
                radius = self._examine(candidate, _described(candidate))
                if radius < np.inf:
                    break
            failures = failures + 1 if radius > STALLS * last or radius == np.inf else 0
            last = min(radius, last)
            given_by_ends = self._law is FeedbackLaw.CONSTRAINTS and self._request.radius <= radius < np.inf
            if self._is_done or failures == MOST_FAILURES or given_by_ends:
                break
        if self._nearest is not None and self._needs_design:
            self._say("a design of the curves with these limits as constraints")
            designed, description = _designed(self._nearest, self._gait, self._request.radius, self._should_stop)
            if designed is None:
                self._failed(description)
            else:
                self._examine(designed, description)
        if self._best is None:
            raise SolveError(
                f"{self._gait.problem.name}: no {self._law.value} law has a gait near it; "
                f"tried {'; '.join(self._attempts)}"
            )
        return replace(self._best, attempts=tuple(self._attempts))

    @property
    def _is_done(self) -> bool:
        return self._best is not None and not self._best.objections

    @property
    def _needs_design(self) -> bool:
        """Whether other curves may help: there is no gait, or the spectral radius or a torque is too large."""
        if self._law is not FeedbackLaw.CONSTRAINTS or len(self._gait.steps) > 1:  # a design has curves of one step
            return False
        if self._best is None:
            return True
        gait, efforts = self._best.gait, _efforts(type(self._best.gait.problem.walker))
        excess = any(peak > efforts.get(name, np.inf) for name, peak in peak_torques(gait.arcs).items())
        return excess or gait.scalar("spectral_radius") >= self._request.radius

    def _examine(self, candidate: Candidate, description: str) -> float:
        """Spectral radius of the gait under a law, infinite without one; the gait may become the best one."""
        control, fitted, joints, phase, near = candidate
        try:
            problem = _problem(self._gait, control, near)
        except ProblemError as error:  # curves with impossible angles: the gains are too small for the torques
            return self._failed(f"{description}: {error}")
        solved = solve_sequence(problem, should_stop=self._should_stop)
        if solved.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if not solved.converged:
            self._nearest = self._nearest or candidate
            return self._failed(f"{description}: {solved.message}")
        solved = solved.verified(verify(solved).to_record())
        made = Stabilised(
            gait=solved, given=self._gait, law=self._law, phase=phase, fitted=fitted,
            least_rate=None if joints is None else joints.smallest_rate,
            invariance=_invariance(solved), distance=_distance(self._gait, solved), bound=self._request.radius,
        )  # fmt: skip
        if self._best is None or _rank(made) < _rank(self._best):
            self._best, self._nearest = made, candidate
        if made.objections:
            self._failed(f"{description}: {'; '.join(made.objections)}")
        return solved.scalar("spectral_radius")

    def _failed(self, attempt: str) -> float:
        self._attempts.append(attempt)
        self._say(attempt)
        return np.inf


def _designed(candidate: "Candidate", gait: Gait, bound: float, should_stop: Stop) -> tuple["Candidate | None", str]:
    """Curves that a design finds next to those of a candidate, None if it finds none; and a description of the design.

    They are invariant and have the smallest squared torques at the speed of the gait, within the bound on the spectral
    radius, the efforts and, of a gait that sticks, the friction cone.
    """
    control, fitted, joints, phase, _ = candidate
    assert fitted is not None, "virtual constraints have curves"
    assert joints is not None
    efforts = _efforts(type(gait.problem.walker))
    fitted = invariant_curves(joints, min(fitted.degree, DESIGN_DEGREE), efforts)
    rows = fitted.rows(joints.names)
    free = {
        name: [Free[float](free=(c - AROUND, c + AROUND), guess=c).record for c in row] for name, row in rows.items()
    }
    plain = _problem(gait, {**control, "reference": {"bezier": rows}}, gait)
    constraints: dict[str, object] = {"speed": gait.scalar("speed"), "spectral_radius": {"max": INSIDE * bound}}
    if gait.scalar("slip_distance") == 0:
        constraints["required_friction"] = {"max": (1 - FORCE_MARGIN) * gait.dynamics.static_friction}
    constraints |= {"peak_torque": {"max": min(efforts.values())}} if efforts else {}
    problem = plain.replace(
        {
            "control": {**control, "reference": {"bezier": free, "invariant": True}},
            "objective": {"torque_squared": 1.0},
            "constraints": constraints,
        }
    ).from_guess()
    solved = solve_sequence(problem, should_stop=should_stop)
    description = f"a design of degree {fitted.degree} with spectral radius and efforts as constraints"
    if not solved.converged:
        return None, f"{description}: {solved.message}"
    points = np.array(
        [[solved.freed[f"control.reference.{name}.{k}"] for k in range(fitted.degree + 1)] for name in joints.names]
    )
    found = replace(fitted, points=points, violation=0.0)
    return ({**control, "reference": {"bezier": found.rows(joints.names)}}, found, joints, phase, solved), description


def _curves(fits: Sequence[FittedCurves], of_steps: Sequence[Joints]) -> dict[str, dict[str, list[float]]]:
    """Control points over the span of the first step by joint, for the reference and that of every second step."""
    spans = [joints.span for joints in of_steps]
    rows = [fit.over(span, spans[0]).rows(of_steps[0].names) for fit, span in zip(fits, spans, strict=True)]
    return dict(zip(REFERENCES, rows, strict=False))


def _check(gait: Gait) -> None:
    """Raise an error for a gait that no law can repeat."""
    name, walker = gait.problem.name, gait.system.walker
    if not gait.converged:
        raise SolveError(f"{name} is {gait.status}: there is no gait to stabilise")
    if not walker.actuators:
        raise ProblemError(f"{name}: the {walker.model} has no motors: no law acts on it")


def _default_law(gait: Gait) -> FeedbackLaw:
    if len(gait.steps) > 2 or gait.problem.cycle_end != TOUCHDOWN:
        return FeedbackLaw.STEP
    return FeedbackLaw.CONSTRAINTS if _driven(gait) and len(gait.steps) == 1 else FeedbackLaw.PD


def _driven(gait: Gait) -> tuple[str, ...]:
    """The motors of virtual constraints: one less than shape coordinates; empty if there are more or fewer.

    Of a walker with as many motors as coordinates, a motor that does nothing in the gait is left out.
    """
    walker = gait.system.walker
    names = walker.actuators
    if len(names) == len(walker.shape):
        smallest = NO_TORQUE * gait.dynamics.scales.energy
        names = tuple(name for name, torque in peak_torques(gait.arcs).items() if torque > smallest)
    return names if len(names) == len(walker.shape) - 1 else ()


def _efforts(walker: WalkerType) -> dict[str, float]:
    """The largest torque of each motor for which the robot's file states it [N m]."""
    limits = joint_limits(walker)
    efforts = {name: limits[name][1] for name in walker.actuators if name in limits}
    return {name: effort for name, effort in efforts.items() if effort is not None}


def check_phase(problem: Problem, phase: str | None, outputs: Sequence[str] | None = None) -> None:
    """Refuse a phase that the walker of a problem does not have.

    Parameters
    ----------
    outputs : joints that follow curves over the phase; by default those that motors track.

    Raises
    ------
    ProblemError
        If there is no such phase; the message lists those that are no outputs.
    """
    walker = type(problem.walker)
    phases = (*walker.phases, *walker.shape)
    if phase not in (None, CLOCK, *phases):
        known = [name for name in phases if name not in (walker.tracked if outputs is None else outputs)]
        raise ProblemError(
            f"{problem.name}: {phase!r} is no phase variable of the {walker.model}; it has {', '.join(known) or 'none'}"
        )


def _along_phase(
    gait: Gait, names: Sequence[str], motors: Sequence[str], stated: str | None, *, decoupled: bool = False
) -> tuple[list[Joints], str]:
    """Joints of each step along the stated phase, or along the first monotone one; those that the walker names first.

    Parameters
    ----------
    decoupled : whether the motors have to move the joints apart from the phase.

    Raises
    ------
    ProblemError
        If the walker has no such phase, if it is not monotone, or if the motors only move the joints along with it.
    """
    name, walker = gait.problem.name, gait.system.walker
    known = [phase for phase in (*walker.phases, *walker.shape) if phase not in names]
    if stated in names:
        raise ProblemError(f"{name}: {stated!r} is an output itself; it has {', '.join(known) or 'none'}")
    check_phase(gait.problem, stated, names)
    rates, singular = list[str](), list[str]()
    for phase in known if stated is None else [stated]:
        joints = _of_steps(gait, names, motors, phase)
        smallest = min(each.smallest_rate for each in joints)
        if smallest <= MONOTONE:
            rates.append(f"{phase} ({smallest:.2g})")
            continue
        times = [each.singular_at for each in joints if decoupled and each.singular_at is not None]
        if not times:
            return joints, phase
        singular.append(f"over {phase}, {times[0]:.4g} s after the impact")
    if singular:
        raise ProblemError(
            f"{name}: the motors cannot accelerate {', '.join(names)} apart from the phase ({'; '.join(singular)}), "
            "where the decoupling matrix is singular; use a PD law over the clock"
        )
    raise ProblemError(
        f"{name}: no phase is monotone along the gait (least rate relative to the mean: {', '.join(rates)}); "
        "use a PD law over the clock"
    )


def _of_steps(gait: Gait, names: Sequence[str], motors: Sequence[str], phase: str) -> list[Joints]:
    return [Joints.of(gait, names, motors, phase, step) for step in range(len(gait.steps))]


def _laws(gait: Gait, law: FeedbackLaw, request: StabiliseRequest) -> Iterator[Iterable[Candidate]]:
    """Groups of laws in the order in which they are tried, lowest degrees or gains first.

    The first law of a group that has a gait represents the group.
    """
    name, walker, efforts = gait.problem.name, gait.system.walker, _efforts(type(gait.problem.walker))
    if law is FeedbackLaw.STEP:
        yield from ([candidate] for candidate in _corrections(gait))
        return
    if gait.problem.cycle_end != TOUCHDOWN:
        end = gait.problem.cycle_end
        ending = "the clock of its law, which no other law has" if end == CLOCK else f"{end}, where no step begins"
        raise ProblemError(f"{name}: a cycle ends with {ending}; use step_feedback")
    if len(gait.steps) > 2:
        raise ProblemError(
            f"{name}: it has {len(gait.steps)} steps; the law has curves for the first one and for the other: "
            "use step_feedback"
        )
    if law is FeedbackLaw.CONSTRAINTS:
        motors = _driven(gait)
        if not motors:
            counts = f"the {walker.model} has {len(walker.shape)} and {counted(len(walker.actuators), 'motor')}"
            raise ProblemError(
                f"{name}: virtual constraints need one motor less than shape coordinates; {counts}: use a PD law, or a "
                "gait in which one motor less is used"
            )
        of_steps, phase = _along_phase(gait, motors, motors, request.phase, decoupled=True)
        degrees = range(SMALLEST_DEGREE, MOST_DEGREE + 1) if request.degree is None else [request.degree]
        fits = [[invariant_curves(joints, degree, efforts) for joints in of_steps] for degree in degrees]
        steps = [int(np.argmax([fit.violation + fit.deviation for fit in each])) for each in fits]
        worst = [each[step] for each, step in zip(fits, steps, strict=True)]
        close = [k for k, fit in enumerate(worst) if fit.deviation < CLOSE and fit.violation <= VIOLATED]
        rate = SETTLING * len(of_steps) / gait.scalar("period")
        slips = any(arc.mode.slips for arc in gait.arcs)
        for k in close or [min(range(len(worst)), key=lambda k: (worst[k].violation, worst[k].deviation))]:
            control: dict[str, Any] = {
                "type": VirtualConstraints.type,
                "outputs": list(motors),
                "phase": phase,
                "span": list(of_steps[0].span),
                **{key: {"bezier": rows} for key, rows in _curves(fits[k], of_steps).items()},
                "gains": {"kp": rate**2, "kd": 2 * rate},
                "model": FootModel.ACTUAL if slips else FootModel.STICK,
                **({} if motors == walker.actuators else {"motors": list(motors)}),
            }
            yield [(control, worst[k], of_steps[steps[k]], phase, gait)]
        return
    if len(walker.tracked) != len(walker.actuators):
        raise ProblemError(f"{name}: the {walker.model} does not define `tracked`, the joint of each motor")
    if request.phase in (None, CLOCK):
        of_steps, phase = _of_steps(gait, walker.tracked, walker.actuators, CLOCK), CLOCK
    else:
        of_steps, phase = _along_phase(gait, walker.tracked, walker.actuators, request.phase)
    tracked = PD_DEGREES if request.degree is None else (request.degree,)
    inertia = float(np.mean([each.inertia for each in of_steps]))
    for multiple in MULTIPLES:
        rate = multiple / gait.dynamics.scales.time
        gains = inertia * rate**2, 2 * inertia * rate
        yield (_tracking(gait, of_steps, phase, degree, gains) for degree in tracked)


def _corrections(gait: Gait) -> Iterator[Candidate]:
    """The law of the gait with feedback from step to step: regulators, then gains with a small spectral radius."""
    problem = gait.problem.with_fixed(gait.freed) if gait.problem.free else gait.problem
    law = problem.control
    if isinstance(law, NoControl):
        law = ConstantTorque.model_validate(dict.fromkeys(problem.walker.actuators, 0.0))
    keys = [f"control.{key}" for key in law.parameters if not key.startswith("limits.")]
    if not keys or law.unknowns(type(problem.walker)):
        reason = "has unknowns of a design: give their values" if keys else "has no parameters that could be corrected"
        raise ProblemError(f"{problem.name}: its control law {reason}")
    designs: list[dict[str, Any]] = [{"lqr": {"R": dict.fromkeys(keys, weight)}} for weight in LQR_WEIGHTS]
    n = len(gait.system.section(gait.cycle).names)
    designs += [{"minimum_radius": {}}] if n * len(keys) <= MOST_GAINS else []
    for design in designs:
        yield {**law.record, "step_feedback": {"design": design}}, None, None, "", gait


def _tracking(gait: Gait, of_steps: Sequence[Joints], phase: str, degree: int, gains: tuple[float, float]) -> Candidate:
    """PD control with gains (kp, kd), with a reference for each step."""
    ends, efforts = np.array([joints.span for joints in of_steps]), _efforts(type(gait.problem.walker))
    grows = ends[0, 1] > ends[0, 0]
    start, end = float((min if grows else max)(ends[:, 0])), float((max if grows else min)(ends[:, 1]))
    fits = [tracked_curves(joints, degree, gains, efforts, (start, end)) for joints in of_steps]
    argument = {"duration": end, "beyond_end": "linear"} if phase == CLOCK else {"phase": phase, "span": [start, end]}
    motions = [{"bezier": fit.rows(joints.names), **argument} for fit, joints in zip(fits, of_steps, strict=True)]
    references = dict(zip(REFERENCES, motions, strict=False))
    control = {"type": ProportionalDerivative.type, "kp": gains[0], "kd": gains[1], **references}
    worst = max(range(len(fits)), key=lambda k: fits[k].deviation)
    return control, fits[worst], of_steps[worst], phase, gait


def _problem(gait: Gait, control: Mapping[str, Any], near: Gait) -> Problem:
    """The problem of a gait with another law, and with the motion of a gait nearby as its guess."""
    given, record = gait.problem, cast(GaitRecord, near.to_record())
    plain = replace(given, free={}, objective={}, constraints={}, over=None, origin=None, file=None)
    names = guessed_names(type(given.walker), gait.cycle, given.cycle_end)
    state = {name: record["state"][name] for name in names}
    durations = [phase["duration"] for phase in record["phases"]]
    changes: dict[str, object] = {key: v for key, v in gait.freed.items() if not key.startswith("control.")}
    changes |= {"control": dict(control), "gait.guess": {"state": state, "durations": durations}}
    made = plain.replace(changes).from_guess()
    return replace(
        made, name=f"{given.name}-stabilised", about=f"A feedback law that walks {given.name}.", text="", path=None
    )


def _described(candidate: Candidate) -> str:
    """Degree of the curves and gains of a candidate, or the design of its step feedback."""
    control, fitted, *_ = candidate
    if fitted is None:
        (design, keys), *_ = control["step_feedback"]["design"].items()
        weight = next(iter(keys.get("R", {}).values()), None)
        return design if weight is None else f"{design} with weight {weight:g} of the parameters"
    gains = control.get("gains", control)
    return f"degree {fitted.degree}, kp {gains['kp']:.4g}, kd {gains['kd']:.4g}"


def _rank(made: Stabilised) -> tuple[int, float]:
    return len(made.objections), made.gait.scalar("spectral_radius")


def _distance(one: Gait, other: Gait) -> float:
    """Largest difference of a shape coordinate between two gaits, at equal fractions of each step [rad, or m]."""
    pairs = zip(one.steps, other.steps, strict=True)
    return max(float(np.abs(_postures(first) - _postures(second)).max()) for first, second in pairs)


def _postures(step: Step) -> Array:
    """Shape coordinates at equal fractions of a step, shape (COMPARED, n_shape)."""
    times, n = np.linspace(0, step.arcs[-1].end, COMPARED), len(step.arcs[0].dynamics.system.walker.shape)
    index = np.searchsorted([arc.end for arc in step.arcs[:-1]], times)
    rows = list[Array]()
    for k, arc in enumerate(step.arcs):
        s = np.clip(2 * (times[index == k] - arc.start) / arc.duration - 1, -1, 1)
        rows.append(curves.evaluate(curves.coefficients(arc.states[:, :n]), s))
    return np.concatenate(rows)


def _invariance(gait: Gait) -> float | None:
    """Largest output of virtual constraints, or rate of one, just after the impact; None under another law."""
    if not isinstance(gait.system.control, VirtualConstraints):
        return None
    largest = 0.0
    for step, following in zip(gait.steps, (*gait.steps[1:], gait.steps[0]), strict=True):
        arc = following.arcs[0]
        function = buffered(gait.system.quantities(arc.mode))
        y, rates, _ = function(0.0, step.final_impact.state, arc.dynamics.p, gait.system.data(arc.segment))
        largest = max(largest, float(np.abs(y).max()), float(np.abs(rates).max()))
    return largest
