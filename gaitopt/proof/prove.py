"""The prover: search for boxes that the checker accepts. Nothing in this module has to be right.

A gait in doubles gives the steps of the integration and approximate nodes; one Newton step in long precision puts the
centre of a box next to the orbit. For a family, boxes follow the orbit from one end of the interval to the other, each
tilted along the tangent, longer after a success and shorter after a failure. Every box is checked by ``check``.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import floor, log10
from typing import Any, TypeAlias

import numpy as np
from flint import arb

from gaitopt.errors import ProblemError, StorageError, UnknownNameError
from gaitopt.gait.gait import Gait
from gaitopt.model.curve import Curve
from gaitopt.model.cycle import BREAKPOINT
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.reference import CurveReference, GaitReference
from gaitopt.problem.problem import Problem
from gaitopt.problem.writing import passed_types, write_problem
from gaitopt.proof.arithmetic import INTERVAL, NotProved, ball, matrix, precision
from gaitopt.proof.certificate import MOST_UNKNOWNS, SCHEMA, BoxRecord, OrbitRecord, ProblemRecord, read_certificate
from gaitopt.proof.check import (
    EXISTENCE,
    STATEMENT,
    CheckedBox,
    Proof,
    check_box,
    conclude,
    sign_change_claim,
)
from gaitopt.proof.claims import ProofClaim
from gaitopt.proof.orbit import Orbit, OrbitArc, TiltedBox, deviations, exact_matrix, midpoint_jacobian
from gaitopt.proof.statement import Statement, refuse_uncovered_walkers, restore_statement
from gaitopt.proof.taylor import expand

ORDER, ORDER_OF_FAMILY = 20, 16
"""Order of the Taylor series for a single orbit or a bracket, and for a family."""
SMALLEST_REMAINDER = 1e-300
"""A remainder of zero counts as this, to avoid a division by zero."""
STEP_SAFETY, LARGEST_STEP_GROWTH, STEP_CUT = 0.9, 1.5, 0.6
"""Length of the next integration step relative to the one whose remainder would be 10^-order; the largest ratio of two
lengths; and the ratio below which a step is repeated, shortened by this factor."""
RADIUS = 1e-11
"""Half width of the box of a single orbit in every unknown, in natural units."""
TILT_SHARE, SMALLEST_RADIUS = 0.003, 1e-12
"""The first half widths of a long box are this fraction of its tilt plus this many natural units."""
INFLATION_FACTOR, MOST_INFLATIONS = 1.25, 4
"""Half widths of the next attempt relative to those of the last image under Krawczyk's operator, and the number of
attempts."""
BOX_GROWTH, BOX_CUT = 1.25, 0.6
"""Length of the next box relative to the last one, after a success and after a failure."""
SHORTEST_DOUBTFUL_BOX = 1 / 256
"""If a claim is not shown on a box, a shorter one is tried, unless it is already shorter than this fraction
of the interval: the claim is then taken for false."""
MOST_BOX_TRIES = 1000
"""Largest number of boxes that are tried along one family."""
Approximation = tuple[Orbit, Sequence[arb], Sequence[arb]]
"""The equations at one value of the parameter, an approximate solution u, and its derivative in the parameter."""
DIGITS = 30
"""Digits of the numbers in a certificate."""
BRACKET_WIDTHS = (1e-8, 1e-7, 1e-6, 1e-5)
"""Widths of brackets of special points, in the order in which they are tried. They are multiplied by the power of ten
of a parameter below 0.01 or above 100."""
Solve: TypeAlias = Callable[[Problem], Gait]


def silent(stage: str) -> None:
    """Show no progress."""


def prove(
    gait: Gait,
    intervals: Mapping[str, str] | None = None,
    *,
    solve: Solve | None = None,
    progress: Callable[[str], None] = silent,
) -> Proof:
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    ``gaitopt.prove`` calls this function and documents its arguments.

    Parameters
    ----------
    solve : returns the gait of a problem, for the proof of a gait that the control law follows; None to do without it.
    progress : called with a text at each stage.
    """
    proof = _prove(gait, intervals or {}, solve, progress)
    if intervals and len(intervals) == 1 and not proof.claims[0].proved:  # the orbit moves along the interval
        proof = _prove(gait, intervals, solve, progress, varied=next(iter(intervals)))
    return proof


def prove_special(
    gait: Gait,
    parameter: str,
    kind: str,
    width: float | None = None,
    *,
    solve: Solve | None = None,
    progress: Callable[[str], None] = silent,
) -> Proof:
    """Prove that a family of gaits has a special point next to a gait.

    Parameters
    ----------
    gait : a converged gait, as close to the special point as the latter is known.
    parameter : dotted key of the varying parameter.
    kind : one of ``BRACKETED``: a bifurcation, or a change of the mode sequence or of the impact.
    width : width of the bracket in the parameter; None for the narrowest one whose ends can be distinguished.
    solve, progress : see ``prove``.
    """
    value = gait.dynamics.parameter(parameter)
    size = 10.0 ** floor(log10(abs(value))) if value and not 1e-2 <= abs(value) <= 1e2 else 1.0
    for bracket_width in [size * each for each in BRACKET_WIDTHS] if width is None else (width,):
        places = 1 - floor(log10(bracket_width))
        lower, upper = (f"{end:.{places}f}" for end in (value - bracket_width / 2, value + bracket_width / 2))
        if float(lower) == float(upper):
            raise UnknownNameError(
                f"a bracket of width {bracket_width:g} around {value!r} has no length; use a wider one"
            )
        interval = {parameter: f"{lower}{INTERVAL}{upper}"}
        proof = _prove(gait, interval, solve, progress, varied=parameter, special=kind)
        if proof.proved:
            break
    return proof


def _prove(
    gait: Gait,
    intervals: Mapping[str, str],
    solve: Solve | None,
    progress: Callable[[str], None],
    *,
    varied: str | None = None,
    special: str | None = None,
) -> Proof:
    """Search for boxes and conclude from them; if none are found, the proof contains a failed claim."""
    for key in intervals:
        if key not in gait.dynamics.parameters:
            raise UnknownNameError(f"no parameter is called {key!r}; there are {', '.join(gait.dynamics.parameters)}")
    intervals = {key: INTERVAL.join(end.strip() for end in text.split(INTERVAL)) for key, text in intervals.items()}
    header: dict[str, Any] = {}
    try:
        refuse_uncovered_walkers(gait.problem, gait.system)
        header = certificate_header(gait, intervals, varied, special) | {"arcs": arc_records(arcs_of(gait))}
        statement = _statement(header, gait)
    except NotProved as failure:
        return Proof(gait.problem.name, (ProofClaim(STATEMENT, proved=False, finding=str(failure)),), header)
    except (ValueError, StorageError) as error:  # caused by an interval: everything else comes from a solved gait
        raise ProblemError(f"{gait.problem.name}: {error}") from error
    source = gait.problem.reference
    if header["law"] is not None and statement.own_duration is None and solve is not None and source is not None:
        progress(f"proving {source.name}, whose gait the control law follows")
        proof = _prove(solve(source), {}, solve, progress)
        if proof.proved:
            header["reference"] = {name: proof.certificate[name] for name in OrbitRecord.model_fields}
            statement = _statement(header, gait)
    with precision():
        try:
            search = _BoxSearch(statement, gait, progress)
            boxes = list(search.boxes())
        except NotProved as failure:
            claim = ProofClaim(EXISTENCE, proved=False, finding=f"no boxes can be verified: {failure}")
            return Proof(gait.problem.name, (claim,), header, statement.printed)
        certificate = {
            **header,
            "arcs": arc_records(search.statement.arcs),
            "boxes": [record.model_dump() for record, _ in boxes],
        }
        return conclude(search.statement, [box for _, box in boxes], certificate)


def _statement(certificate: Mapping[str, Any], gait: Gait) -> Statement:
    """The statement of a certificate; the walker and control law of the gait need not be registered."""
    walkers, controls = passed_types(gait.problem)
    with precision():
        return restore_statement(read_certificate(certificate), walkers, controls)


def certificate_header(
    gait: Gait, intervals: Mapping[str, str] | None = None, varied: str | None = None, special: str | None = None
) -> dict[str, Any]:
    """All fields of a certificate; arcs, boxes and the proof of another gait are still empty."""
    problem, intervals = stated_problem(gait), intervals or {}
    unknowns = (*problem.free, *(f"control.{key}" for key in problem.control.unknowns(type(problem.walker))))
    return {
        "schema": SCHEMA,
        "problem": ProblemRecord.of(write_problem(problem)).model_dump(),
        "intervals": dict(intervals),
        "designed": {key: repr(gait.dynamics.parameter(key)) for key in unknowns if key not in intervals},
        "law": law_record(gait),
        "reference": None,
        "varied": varied,
        "special": special,
        "order": ORDER if varied is None or special is not None else ORDER_OF_FAMILY,
        "arcs": [],
        "boxes": [],
    }


def stated_problem(gait: Gait) -> Problem:
    """The problem that a theorem is about; if a design found the open-loop torques, the problem of that design."""
    problem, origin = gait.problem, gait.problem.origin
    if origin is not None and isinstance(origin.control, OpenLoop) and origin.control.duration is None:
        return origin
    return replace(problem, origin=None)


def law_record(gait: Gait) -> dict[str, Any] | None:
    """The data of a control law that no text can hold; None if there are none."""
    problem = stated_problem(gait)
    if isinstance(problem.control, OpenLoop) and problem.control.duration is None:
        assert isinstance(gait.system.control, OpenLoop)
        return {"duration": gait.system.control.duration}
    for reference in gait.system.control.targets.values():
        if not isinstance(reference, GaitReference | CurveReference) or reference.over_phase:
            continue
        if isinstance(reference, GaitReference):
            return motion_record(reference.motion())
        if reference.curve.duration is None:
            return {"duration": reference.motion().breakpoints[0]}
    return None


def motion_record(motion: Curve) -> dict[str, Any]:
    """The pieces of a tracked motion, without one beyond its end, which the checker derives by the problem's rule."""
    ends = [*motion.breakpoints, *(() if motion.continues else (motion.horizon,))]
    return {
        "pieces": [
            {"start": piece.start, "end": end, "angles": [list(row) for row in piece.rows]}
            for piece, end in zip(motion.stated, ends, strict=True)
        ]
    }


def arc_records(arcs: Sequence[OrbitArc]) -> list[dict[str, Any]]:
    """The records of arcs in a certificate."""
    return [
        {"phase": arc.phase, "fractions": list(arc.fractions)}
        | ({"timed": True} if arc.ends_phase and arc.event == BREAKPOINT else {})
        for arc in arcs
    ]


def arcs_of(gait: Gait) -> list[OrbitArc]:
    """The arcs of a gait, not yet divided into steps of the integration."""
    table, cycle, arcs = gait.system.transitions, gait.cycle, list[OrbitArc]()
    phases = [phase for _, phase in gait.arcs_by_phase]
    for (arc, phase), after in zip(gait.arcs_by_phase, [*phases[1:], None], strict=True):
        row = table.ending(cycle, phase) if after != phase else table.at_breakpoint(arc.mode)
        arcs.append(OrbitArc(arc.mode, int(arc.segment), phase, row.guard, (), after != phase, ()))
    return arcs


class _BoxSearch:
    """The search for boxes of a gait or of a family.

    Attributes
    ----------
    statement : the statement, whose arcs are divided into steps of the integration.
    """

    def __init__(self, statement: Statement, gait: Gait, progress: Callable[[str], None]) -> None:
        self._progress, self._tries, self._curvature = progress, 0, list[float]()
        self.statement = statement
        self._value, self._unit = 0.0, ""
        if statement.varied is not None:
            self._unit = statement.interval[0].partition(" ")[2]
            self._value = float(arb(float(gait.p[statement.varied])) / ball(f"1 {self._unit}".strip()))
        here = (self._text(self._value),) * 2 if statement.varied is not None else ()
        arcs, centre = divide_into_steps(statement.orbit(here), gait)
        self.statement = replace(statement, arcs=arcs)
        orbit = self.statement.orbit(here)
        self._start: Approximation = (orbit, *newton_step(orbit, centre))

    def boxes(self) -> Iterator[tuple[BoxRecord, CheckedBox]]:
        """One box for a gait; boxes over the interval for a family. A bracket also has a point box at each end.

        Raises
        ------
        NotProved
            If the family cannot be followed, or the ends of a bracket cannot be distinguished.
        """
        statement = self.statement
        if statement.varied is None:
            yield self._box((), self._start)[0]
            return
        lower, upper = (float(end.partition(" ")[0]) for end in statement.interval)
        if statement.special is None:
            yield from reversed(list(self._walk(self._value, lower)))
            yield from self._walk(self._value, upper)
            return
        ends = [self._box((end, end), self._start, at_end=True)[0] for end in statement.interval]
        claim = sign_change_claim(statement.special, [box for _, box in ends])
        if not claim.proved:
            raise NotProved(claim.finding)
        yield ends[0]
        yield from self._walk(lower, upper)
        yield ends[1]

    def _walk(self, edge: float, end: float) -> Iterator[tuple[BoxRecord, CheckedBox]]:
        """Boxes from one value of the parameter to another, or to the first box on which a claim is false."""
        length, start = end - edge, self._start
        while edge != end:
            following = end if abs(length) >= abs(end - edge) else edge + length
            self._tries += 1
            if self._tries > MOST_BOX_TRIES:
                raise NotProved(f"the family is covered to {edge!r} with boxes {abs(length):.2g} long, not to {end!r}")
            try:
                box, start = self._box(tuple(map(self._text, sorted((edge, following)))), start)
            except NotProved as failure:
                self._progress(f"{abs(length):.2g} is too long for a box at {edge!r}: {failure}")
                length = (following - edge) * BOX_CUT
                continue
            yield box
            if not all(claim.proved for claim in box[1].claims):
                return
            edge, length = following, (following - edge) * BOX_GROWTH
            self._progress(f"covered to {edge!r}, towards {end!r}")

    def _box(
        self, interval: Sequence[str], start: Approximation, *, at_end: bool = False
    ) -> tuple[tuple[BoxRecord, CheckedBox], Approximation]:
        """A box over an interval of the parameter, what is proved on it, and the orbit in the middle of the interval.

        Raises
        ------
        NotProved
            If the interval is too long.
        """
        orbit = self.statement.orbit(interval)
        start_orbit, centre, rate = start
        # Newton's method from the last orbit, moved along its tangent to the middle of the interval
        if orbit.interval:
            move = orbit.interval[0] - start_orbit.interval[0]
            centre = [(u + v * move).mid() for u, v in zip(centre, rate, strict=True)]
        middle = (orbit.interval[0], arb(0)) if orbit.interval else ()
        middle_orbit = Orbit(
            orbit.system, orbit.law, orbit.p, orbit.varied, middle, orbit.sequence, orbit.arcs, orbit.order
        )
        centre, rate = newton_step(middle_orbit, centre)
        half = orbit.interval[1].mid() if orbit.interval else arb(0)
        tilt = [(v * half).mid() for v in rate]
        # the orbit deviates from its tangent quadratically in the length of the box; the last box gives the factor
        units = orbit.unit_of_unknowns.tolist()
        radii, smallest = [RADIUS * unit for unit in units], [SMALLEST_RADIUS * unit for unit in units]
        if half != 0 and self._curvature:
            radii = [max(c * float(half) ** 2, r) for c, r in zip(self._curvature, smallest, strict=True)]
        elif half != 0:
            radii = [TILT_SHARE * float(abs(v)) + r for v, r in zip(tilt, smallest, strict=True)]
        for _ in range(MOST_INFLATIONS):
            record = BoxRecord(
                interval=list(interval),
                centre=[_digits(u) for u in centre],
                tilt=[_digits(v) for v in tilt],
                radii=[f"{radius:.2e}" for radius in radii],
            )
            box = check_box(self.statement, record, at_end=at_end)
            if half == 0 or box.image is None or box.claims[0].proved:
                break
            moves = deviations(box.outer, box.image)
            centre = [(u + move.mid()).mid() for u, move in zip(centre, moves, strict=True)]
            radii = [INFLATION_FACTOR * float(move.rad()) + r for move, r in zip(moves, smallest, strict=True)]
        if half != 0 and box.inner is not None:
            self._curvature = [radius / float(half) ** 2 for radius in radii]
        doubtful = [claim.finding for claim in box.claims if not claim.proved and not claim.refuted]
        moduli = [abs(m) for m in box.multipliers]
        if (
            interval
            and self.statement.special is None
            and not (all(m < 1 for m in moduli) or any(m > 1 for m in moduli))
        ):
            doubtful.append("whether it is stable is not shown")
        can_be_shorter = False
        if interval:
            length, whole = (float(abs(ball(b) - ball(a))) for a, b in (interval, self.statement.interval))
            can_be_shorter = length > SHORTEST_DOUBTFUL_BOX * whole
        if doubtful and (box.inner is None or can_be_shorter):
            raise NotProved(doubtful[0])
        return (record, box), (middle_orbit, centre, rate)

    def _text(self, value: float) -> str:
        """The text of an end of a box. An end of the interval keeps its text (13, not 13.0), which is compared."""
        stated = {float(end.partition(" ")[0]): end for end in self.statement.interval}
        return stated.get(value, f"{value!r} {self._unit}".strip())


def _digits(value: arb) -> str:
    return str(value.str(DIGITS, radius=False, more=True))


def divide_into_steps(orbit: Orbit, gait: Gait) -> tuple[list[OrbitArc], list[arb]]:
    """Arcs with the steps of their integration, and approximate nodes and durations.

    Raises
    ------
    NotProved
        If there are more unknowns than a certificate may have.
    """
    arcs, nodes = [], list[arb]()
    for j, (arc, doubles) in enumerate(zip(orbit.arcs, gait.arcs, strict=True)):
        start = [*map(arb, map(float, doubles.states[0])), arb(float(doubles.start))]
        if arc.mode.fixes_x:
            start[-2] = arb(0)  # slip velocity
        field, y = orbit.field(arc.mode, j), orbit.centre_at_node(start, 0)
        duration = left = h = float(doubles.duration)
        lengths = list[float]()
        nodes += y[: orbit.n]
        while left > 0:
            h = left if h > left else min(h, left / 2) if 2 * h > left else h
            try:
                step = expand(field, y, arb(h), orbit.order)
            except NotProved:
                h *= STEP_CUT
                continue
            pairs = zip(step.remainder, orbit.units, strict=False)  # a varying parameter has no remainder
            remainder = max(float(c[-1].abs_upper()) / unit for c, unit in pairs)
            ratio = STEP_SAFETY * (10.0**-orbit.order / max(remainder, SMALLEST_REMAINDER)) ** (1 / orbit.order) / h
            if ratio < STEP_CUT:
                h *= STEP_CUT
                continue
            y, left = [value.mid() for value in step.end], left - h
            lengths.append(h)
            nodes += y[: orbit.n]
            if len(nodes) + len(orbit.arcs) > MOST_UNKNOWNS:
                raise NotProved(f"the orbit has more than {MOST_UNKNOWNS} unknowns: {left:.3g} s of arc {j + 1} remain")
            h *= min(ratio, LARGEST_STEP_GROWTH)
        arcs.append(replace(arc, fractions=tuple(length / duration for length in lengths[:-1])))
    return arcs, [*nodes, *(arb(float(arc.duration)) for arc in gait.arcs)]


def newton_step(orbit: Orbit, centre: Sequence[arb]) -> tuple[list[arb], list[arb]]:
    """One step of Newton's method for the unknowns u, and their derivative in the varying parameter."""
    zero = [arb(0)] * orbit.size
    cycle = orbit.enclose(TiltedBox(centre, zero, zero))
    jacobian = midpoint_jacobian(orbit, cycle)
    C = np.linalg.inv(jacobian[:, :-1])
    residual = [arb(0)] * orbit.size
    for row, values in cycle.residual.items():
        residual[row : row + len(values)] = values
    change = exact_matrix(C) * matrix(1, residual)
    rate = -C @ jacobian[:, -1]
    return [(u - d).mid() for u, d in zip(centre, change.entries(), strict=True)], [*map(arb, rate.tolist())]
