"""The claim that law data taken from another gait fit a proved gait of the problem that the text names.

    duration    |duration - T| <= 1e-12 T, where T is the enclosed period of that gait. The duration of open-loop
                torques is compared with the period of the orbit itself, within 1e-9 T
    motion      |theta_r(t) - theta(t)| <= 1e-9 for every tracked angle, from the impact to the end of the step

On a short subinterval of a Taylor step both angles are polynomials in the time u from its middle. If d_k are the
coefficients of their difference, the sum of |d_k| r^k bounds it for |u| <= r.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil

from casadi import Function
from flint import arb, arb_poly

from gaitopt.building import building
from gaitopt.model.curve import Curve, Piece
from gaitopt.model.system import HybridSystem
from gaitopt.proof.arithmetic import BallFunction, NotProved, hull
from gaitopt.proof.claims import ProofClaim, seconds
from gaitopt.proof.law import exact_piece
from gaitopt.proof.orbit import CycleEnclosure, Orbit
from gaitopt.proof.statement import Statement, natural_length
from gaitopt.proof.taylor import PhaseSpace, TaylorStep, expand

LAW_DATA = "law data"
"""Name of the claim."""
DURATION_ERROR, OWN_DURATION_ERROR = 1e-12, 1e-9
"""Largest relative differences between a duration and the period of the gait that gives it, or of the orbit itself."""
ANGLE_ERROR = 1e-9
"""Largest difference between a tracked angle and that of the gait, in natural units."""
MOST_STEPS_BEYOND_END = 500
"""Largest number of steps of the integration beyond the end of a tracked gait."""
SUBINTERVAL_LENGTH = 1 / 64
"""Length of a subinterval relative to its piece. It is so short that polynomials of degree 32 that agree on the piece
also have nearly the same coefficients about the middle of the subinterval."""


def duration_claim(duration: float, period: arb, error: float, whose: str) -> ProofClaim:
    """The claim that a duration is the period of a gait."""
    difference = abs(arb(duration) - period)
    bound = f"{difference.upper().str(3, radius=False)} s"
    finding = f"the duration {seconds(arb(duration))} differs by at most {bound} from the period of {whose}"
    return ProofClaim(LAW_DATA, proved=bool(difference <= error * period), finding=finding)


def motion_claim(statement: Statement, orbit: Orbit, cycle: CycleEnclosure, period: arb, until: arb) -> ProofClaim:
    """The claim that the tracked curve is the motion of the gait in ``cycle``, up to the time ``until``.

    Parameters
    ----------
    statement : the statement about the gait whose law tracks the curve.
    orbit, cycle, period : equations and enclosures of the tracked gait.
    """
    (completed,), (stated,) = (law.targets.values() for law in (statement.system.control, statement.problem.control))
    motion = completed.motion()
    if motion.continues:  # a rule of the problem extends the curve beyond the period
        ends = duration_claim(motion.breakpoints[-1], period, DURATION_ERROR, f"a proved gait of {stated.source[0]}")
        if not ends.proved:
            return replace(ends, finding=f"the tracked curve does not end with a step: {ends.finding}")
    followed = stated.followed(type(statement.problem.walker))
    name = statement.problem.control.source[0]
    try:
        distances = _distances(motion, followed, orbit, cycle, until)
    except NotProved as failure:
        return ProofClaim(LAW_DATA, proved=False, finding=f"the motion of {name} cannot be enclosed: {failure}")
    worst = max(distances, key=lambda joint: float(distances[joint]))
    bound, proved = distances[worst].str(3, radius=False), all(each <= ANGLE_ERROR for each in distances.values())
    finding = f"the tracked curve differs by at most {bound} in {worst} from the motion of a proved gait of {name}"
    return ProofClaim(LAW_DATA, proved=proved, finding=finding)


def _distances(
    motion: Curve, followed: Mapping[str, str], orbit: Orbit, cycle: CycleEnclosure, until: arb
) -> dict[str, arb]:
    """Upper bounds of the difference of every tracked angle, in natural units."""
    system, largest = orbit.system, dict.fromkeys(motion.names, arb(0))
    length = natural_length(system, orbit.p)
    rows = [dict(zip(motion.names, exact_piece(piece).rows, strict=True)) for piece in motion.stated]
    angles = BallFunction(_angles(system), [orbit.p])
    for step in _steps(orbit, cycle, arb(0) if motion.continues else until):
        start, series = hull(step.start[system.n_z][0]), step.along(angles)
        for k, piece in enumerate(motion.stated):
            for middle, radius in _subintervals(piece, start, hull(step.h)):
                for joint in motion.names:
                    moved = arb_poly(series[system.angle_names.index(followed[joint])])(arb_poly([middle, 1]))
                    difference = moved - _chebyshev(rows[k][joint], piece, start + middle)
                    bound = sum((abs(c) * radius**n for n, c in enumerate(difference.coeffs())), arb(0)).upper()
                    unit = length if joint in system.walker.lengths else 1.0
                    largest[joint] = max(largest[joint], arb(bound) / unit)
    return largest


@building
def _angles(system: HybridSystem) -> Function:
    """(y, p) -> the angles of ``angle_names``."""
    y, p, values = PhaseSpace(system, None).symbols()
    return Function("angles", [y, p], [system.angles(y[: system.n_z], values)[0]])


def _steps(orbit: Orbit, cycle: CycleEnclosure, until: arb) -> Iterator[TaylorStep]:
    """The integration steps of a cycle with one impact; then those that continue its last arc, without the impact."""
    for steps in cycle.steps:
        yield from steps
    last, y = len(orbit.arcs) - 1, cycle.ends[-1]
    h = max(arb(hull(step.h).upper()) for step in cycle.steps[-1])
    for _ in range(MOST_STEPS_BEYOND_END):
        if not y[orbit.system.n_z] < until:
            return
        step = expand(orbit.field(orbit.arcs[last].mode, last), y, h, orbit.order)
        yield step
        y = [hull(value) for value in step.end]
    raise NotProved(f"the motion beyond its end needs more than {MOST_STEPS_BEYOND_END} steps")


def _subintervals(piece: Piece, start: arb, h: arb) -> Iterator[tuple[arb, arb]]:
    """Middles and half lengths of short subintervals that cover the time that a step has in common with a piece [s].

    The middles count from the start of the step, which is at the time ``start``.
    """
    lower, upper = (arb(piece.start) - start).lower(), (arb(piece.end) - start).upper()
    lower, upper = max(arb(lower), arb(0)), min(arb(upper), arb(h.upper()))
    if not lower < upper:
        return
    n = ceil(float((upper - lower).upper()) / (SUBINTERVAL_LENGTH * (piece.end - piece.start)))
    width = (upper - lower) / n
    for k in range(n):
        yield (lower + width * (2 * k + 1) / 2).mid(), arb((width * (1 + arb(2) ** -60) / 2).upper())


def _chebyshev(row: Sequence[arb], piece: Piece, time: arb) -> arb_poly:
    """A series of a piece as a polynomial in the time from ``time``, by Clenshaw's recurrence."""
    length = arb(piece.end) - arb(piece.start)
    s = arb_poly([2 * (time - arb(piece.start)) / length - 1, 2 / length])
    one, two = arb_poly([0]), arb_poly([0])
    for c in reversed(row[1:]):
        one, two = 2 * s * one - two + c, one
    return s * one - two + row[0]
