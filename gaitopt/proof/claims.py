"""What makes a periodic orbit a gait with the stated mode sequence: margins, modes at rest, and the impact.

Every claim holds for all orbits in the proved box. One that cannot be shown raises ``NotProved`` with where and by how
much.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from casadi import SX, simplify
from flint import arb

from gaitopt.mechanics import CONTACTS, ImpactLaw, Mode, margin_names
from gaitopt.proof.graph import NotProved, Refuted
from gaitopt.proof.orbit import Impact, Orbit, Passage
from gaitopt.proof.parametric import hull
from gaitopt.proof.signs import ENDS, POSITIVE, TOUCHDOWN, Part, check_pattern, parts, smallest
from gaitopt.proof.taylor import Series

SLIPS = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement of the theorem.

    Attributes
    ----------
    name : what it is about.
    words : the statement, or why it is not proved.
    margin : a proved bound of the quantity that has to be positive, if there is one.
    refuted : whether the contrary is proved.
    """

    name: str
    proved: bool
    words: str
    margin: arb | None = None
    refuted: bool = False


Check = tuple[str, Callable[[], tuple[str, arb | None]]]


def mode_sequence_claims(orbit: Orbit, passage: Passage) -> Iterator[Claim]:
    """The mode sequence: margins of every arc, modes of a foot at rest, touchdowns, impacts."""
    for name, check in _checks(orbit, passage):
        try:
            words, margin = check()
        except NotProved as failure:
            yield Claim(name, proved=False, words=str(failure), refuted=isinstance(failure, Refuted))
        else:
            yield Claim(name, proved=True, words=words, margin=margin)


def _checks(orbit: Orbit, passage: Passage) -> Iterator[Check]:
    sequence = orbit.sequence
    for step, impact in enumerate(sequence.impacts):
        prefix = f"step {step + 1}, " if len(sequence.steps) > 1 else ""
        touchdown: list[Part] = []
        for j in orbit.arcs_of(step):
            arc = orbit.arcs[j]
            begins = j == 0 or orbit.arcs[j - 1].phase != arc.phase
            at_end = orbit.field(arc.mode, arc.segment).margins(passage.ends[j])[0]
            for (name, steps), last in zip(_margins_along(orbit, passage, j).items(), map(hull, at_end), strict=True):
                order = _order_of_zero(orbit, j, name) if begins else 0
                found = list(parts(steps, order, monotone=name in ("touchdown", arc.event)))
                if name == "touchdown":
                    touchdown += found
                    continue
                pattern = ENDS if name == arc.event else POSITIVE
                yield f"arc {j + 1}, {arc.mode}: {name}", partial(_margin_claim, name, found, pattern, order, last)
            if begins and sequence.impact_before(arc.phase) in (None, Mode.STICK):
                yield f"arc {j + 1}, {arc.mode}: mode at rest", partial(_rest, orbit, j, passage.starts[j])
        yield f"{prefix}touchdown", partial(_margin_claim, "touchdown", touchdown, TOUCHDOWN, 0, arb(0))
        yield f"{prefix}impact", partial(_impact, orbit, impact, passage.ends[orbit.arcs_of(step)[-1]])


def _margins_along(orbit: Orbit, passage: Passage, j: int) -> dict[str, list[tuple[Series, arb]]]:
    """Every margin of an arc's mode on every step of the arc."""
    arc = orbit.arcs[j]
    graph = orbit.field(arc.mode, arc.segment).margins
    names = margin_names(arc.mode)
    steps: dict[str, list[tuple[Series, arb]]] = {name: [] for name in names}
    for expansion in passage.expansions[j]:
        for name, series in zip(names, expansion.along(graph), strict=True):
            steps[name].append((series, hull(expansion.h)))
    return steps


def _order_of_zero(orbit: Orbit, j: int, name: str) -> int:
    """Order of the zero with which a margin starts on the first arc of a phase because of what happened just before.

    A slip starts from rest; where it starts at the edge of the cone its acceleration is zero as well, because that
    is minus the cone's margin over the apparent mass. The landing foot is on the ground.
    """
    phase = orbit.arcs[j].phase
    if name == "slip_velocity":
        return orbit.sequence.onset_order(phase, jump=_friction_drops(orbit))
    after_impact = phase in orbit.sequence.first_phases and name in ("touchdown", "upright")
    return int(after_impact and _vanishes_after_impact(orbit, name))


def _friction_drops(orbit: Orbit) -> bool:
    static, kinetic = hull(orbit.system.static_friction(orbit.p)), hull(orbit.system.kinetic_friction(orbit.p))
    if not orbit.system.friction.two_coefficients:
        return False
    if bool(static > kinetic):
        return True
    raise NotProved("static friction is not above kinetic friction: state one coefficient")


def _vanishes_after_impact(orbit: Orbit, name: str) -> bool:
    """Whether a margin is identically zero just after an impact, as an expression in parameters or their inverses."""
    system = orbit.system
    xi, p = SX.sym("xi", system.lift.size1_in(0)), SX.sym("p", len(orbit.p))
    index = margin_names(Mode.STICK).index(name)
    return any(
        simplify(system.margins(Mode.STICK)(0, system.lift(xi, q), q, SX.zeros(system.n_r))[index]).is_zero()
        for q in (p, 1 / p)
    )


def _margin_claim(name: str, found: Sequence[Part], pattern: str, order: int, last: arb) -> tuple[str, arb | None]:
    if pattern == POSITIVE and last < 0:
        raise Refuted(f"{name} is {last.str(6)} at the end of the arc")
    kinds = check_pattern(name, found, pattern)
    zero = f", after a zero of order {order} at its start" if order else ""
    meaning = {
        POSITIVE: "is positive throughout",
        ENDS: "is positive and falls monotonically to its zero at the end",
        TOUCHDOWN: "falls to zero for the first time after having been positive at the end of the step",
    }
    return f"{name} {meaning[pattern]}{zero} ({kinds})", smallest(found)


def _rest(orbit: Orbit, j: int, y: list[arb]) -> tuple[str, arb | None]:
    """A foot at rest can only do what the arc says: stick, or slip because sticking would need too much friction."""
    arc = orbit.arcs[j]
    margins = {
        mode: dict(zip(margin_names(mode), map(hull, orbit.field(mode, arc.segment).margins(y)[0]), strict=True))
        for mode in CONTACTS
    }
    cones = dict(zip(SLIPS, (margins[Mode.STICK][name] for name in ("cone_forward", "cone_backward")), strict=True))
    needed = {f"no lift-off in {slip}": margins[slip]["normal_force"] * margins[slip]["painleve"] for slip in SLIPS}
    if arc.mode.sticks:
        needed |= {f"margin to {slip}": cones[slip] for slip in SLIPS}
        words = "the foot sticks: its force lies within the cone"
    else:
        needed[f"margin to {Mode.slip(-arc.mode.direction)}"] = cones[Mode.slip(-arc.mode.direction)]
        words = "the force that would hold the foot leaves the cone here, on the side of this slip alone"
        if orbit.sequence.starts_from_rest(arc.phase):
            needed["excess over the cone"] = -cones[arc.mode]
            words = "holding the foot would need a force beyond the cone, on the side of this slip alone"
    return words, _all_positive(needed)


def _impact(orbit: Orbit, mode: Mode, y: list[arb]) -> tuple[str, arb | None]:
    """The impact is consistent, no other one is, and the former stance foot lifts."""
    cone = hull(orbit.system.static_friction(orbit.p))
    own = orbit.impact(mode, y)
    smallest_margin = _all_positive({"lift velocity": hull(own.lift_velocity), **_impact_margins(own, mode, cone)})
    for other in CONTACTS:
        if other is not mode and not (mode.sticks and _stick_has_precedence(orbit)):
            margins = _impact_margins(orbit.impact(other, y), other, cone)
            if not any(margin < 0 for margin in margins.values()):
                shown = ", ".join(f"{name} {margin.str(6)}" for name, margin in margins.items())
                raise NotProved(f"an impact with {other} is not shown to be inconsistent: {shown}")
    return f"{mode} is the only consistent impact, and the former stance foot lifts", smallest_margin


def _stick_has_precedence(orbit: Orbit) -> bool:
    """Whether an impact sticks wherever it can, even where it could slip as well."""
    return orbit.system.law is ImpactLaw.FRICTIONLESS or _friction_drops(orbit)


def _impact_margins(impact: Impact, mode: Mode, cone: arb) -> dict[str, arb]:
    """What has to be positive for an impact to be consistent."""
    f_t, f_n = map(hull, impact.impulse)
    if mode.sticks:
        return {"normal impulse": f_n, "cone_forward": cone * f_n + f_t, "cone_backward": cone * f_n - f_t}
    slip = mode.direction * hull(impact.slip_velocity)
    return {"normal impulse": f_n, "painleve": hull(impact.painleve), "slip velocity": slip}


def _all_positive(needed: dict[str, arb]) -> arb:
    """The smallest lower bound.

    Raises
    ------
    NotProved
        If one is not shown to be above zero; ``Refuted`` if it is below.
    """
    for name, value in needed.items():
        if not value > 0:
            failure, shown = (Refuted, "not") if value < 0 else (NotProved, "not shown to be")
            raise failure(f"{name} is {value.str(6)}, {shown} positive")
    return min(value.lower() for value in needed.values())
