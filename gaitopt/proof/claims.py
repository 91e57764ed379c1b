"""What makes a periodic orbit a gait with the stated mode sequence: margins, modes at rest, and the impact.

Every claim holds for all orbits in the proved box. One that cannot be shown raises ``NotProved`` with where and by how
much.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

from casadi import SX, simplify
from flint import arb

from gaitopt.mechanics import CONTACTS, HybridSystem, ImpactLaw, Mode, margin_names
from gaitopt.proof.graph import NotProved, Refuted
from gaitopt.proof.orbit import Orbit, Passage
from gaitopt.proof.signs import ENDS, POSITIVE, TOUCHDOWN, Part, check_pattern, parts, smallest
from gaitopt.proof.tilted import hull

SLIPS = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
WORDS = {
    POSITIVE: "is positive throughout",
    ENDS: "is positive and falls monotonically to its zero at the end",
    TOUCHDOWN: "falls to zero for the first time after having been positive at the end of the step",
}


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
    for step, mode in enumerate(orbit.sequence.impacts):
        arcs = orbit.arcs_of(step)
        prefix = f"step {step + 1}, " if len(orbit.sequence.steps) > 1 else ""
        along = {j: _margins_along(orbit, passage, j) for j in arcs}
        touchdown = [part for j in arcs for part in along[j]["touchdown"]]
        checks = [check for j in arcs for check in _arc_checks(orbit, passage, j, along[j])]
        checks.append((f"{prefix}touchdown", partial(_margin, "touchdown", touchdown, TOUCHDOWN, arb(0))))
        checks.append((f"{prefix}impact", partial(_impact, orbit, mode, arcs[-1], passage.ends[arcs[-1]])))
        yield from (claim_of(name, check) for name, check in checks)


def claim_of(name: str, check: Callable[[], tuple[str, arb | None]]) -> Claim:
    """The claim that a check shows, or does not show."""
    try:
        words, margin = check()
    except NotProved as failure:
        return Claim(name, proved=False, words=str(failure), refuted=isinstance(failure, Refuted))
    return Claim(name, proved=True, words=words, margin=margin)


def _arc_checks(orbit: Orbit, passage: Passage, j: int, along: Mapping[str, Sequence[Part]]) -> Iterator[Check]:
    """That every margin of an arc is positive, and that the mode of a foot at rest is the only one."""
    arc, title = orbit.arcs[j], f"arc {j + 1}, {orbit.arcs[j].mode}"
    for name, at_end in zip(margin_names(arc.mode), orbit.field(arc.mode, j).margins(passage.ends[j])[0], strict=True):
        if name != "touchdown":
            pattern = ENDS if name == arc.event else POSITIVE
            yield f"{title}: {name}", partial(_margin, name, along[name], pattern, at_end)
    if _begins(orbit, j) and orbit.sequence.impact_before(arc.phase) in (None, Mode.STICK):
        yield f"{title}: mode at rest", partial(_rest, orbit, j, passage.starts[j])


def _begins(orbit: Orbit, j: int) -> bool:
    """Whether an arc is the first one of its phase."""
    return j == 0 or orbit.arcs[j - 1].phase != orbit.arcs[j].phase


def _margins_along(orbit: Orbit, passage: Passage, j: int) -> dict[str, list[Part]]:
    """Every margin of an arc's mode along the arc."""
    arc, begins = orbit.arcs[j], _begins(orbit, j)
    graph, lengths = orbit.field(arc.mode, j).margins, [hull(step.h) for step in passage.steps[j]]
    series = zip(*(step.along(graph) for step in passage.steps[j]), strict=True)
    return {
        name: list(
            parts(
                zip(values, lengths, strict=True),
                _order_of_zero(orbit, arc.phase, name) if begins else 0,
                monotone=name in ("touchdown", arc.event),
            )
        )
        for name, values in zip(margin_names(arc.mode), series, strict=True)
    }


def _order_of_zero(orbit: Orbit, phase: int, name: str) -> int:
    """Order of the zero with which a margin starts because of what happened just before.

    A slip starts from rest; where it starts at the edge of the cone its acceleration is zero as well, because that
    is minus the cone's margin over the apparent mass. The landing foot is on the ground.
    """
    if name == "slip_velocity":
        return orbit.sequence.onset_order(phase, jump=_friction_drops(orbit))
    after_impact = phase in orbit.sequence.first_phases and name in ("touchdown", "upright")
    return int(after_impact and _vanishes_after_impact(orbit.system, name))


@lru_cache
def _vanishes_after_impact(system: HybridSystem, name: str) -> bool:
    """Whether a margin is identically zero just after an impact, as an expression in parameters or their inverses."""
    xi, p = SX.sym("xi", system.lift.size1_in(0)), SX.sym("p", len(system.parameters))
    index = margin_names(Mode.STICK).index(name)
    return any(
        simplify(system.margins(Mode.STICK)(0, system.lift(xi, q), q, SX.zeros(system.n_r))[index]).is_zero()
        for q in (p, 1 / p)
    )


def _friction_drops(orbit: Orbit) -> bool:
    if not orbit.system.friction.two_coefficients:
        return False
    if orbit.system.static_friction(orbit.p) > orbit.system.kinetic_friction(orbit.p):
        return True
    raise NotProved("static friction is not above kinetic friction: state one coefficient")


def _margin(name: str, along: Sequence[Part], pattern: str, at_end: arb) -> tuple[str, arb | None]:
    if pattern == POSITIVE and at_end < 0:
        raise Refuted(f"{name} is {at_end.str(6)} at the end of the arc")
    kinds = check_pattern(name, along, pattern)
    order = max(part.order for part in along)
    zero = f", after a zero of order {order} at its start" if order else ""
    return f"{name} {WORDS[pattern]}{zero} ({kinds})", smallest(along)


def _rest(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """A foot at rest can only do what the arc says: stick, or slip because sticking would need too much friction."""
    arc = orbit.arcs[j]
    margins = {
        mode: dict(zip(margin_names(mode), orbit.field(mode, j).margins(y)[0], strict=True)) for mode in CONTACTS
    }
    cones = dict(zip(SLIPS, (margins[Mode.STICK][name] for name in ("cone_forward", "cone_backward")), strict=True))
    needed = {f"no lift-off in {slip}": margins[slip]["normal_force"] * margins[slip]["painleve"] for slip in SLIPS}
    needed |= {f"margin to {slip}": cones[slip] for slip in SLIPS if slip is not arc.mode}
    words = "the foot sticks: its force lies within the cone"
    if arc.mode.slips:
        words = "the force that would hold the foot leaves the cone here, on the side of this slip alone"
    if orbit.sequence.starts_from_rest(arc.phase):
        needed["excess over the cone"] = -cones[arc.mode]
        words = "holding the foot would need a force beyond the cone, on the side of this slip alone"
    return words, _all_positive(needed)


def _impact(orbit: Orbit, mode: Mode, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """The impact is consistent, no other one is, and the former stance foot lifts."""
    smallest_margin = _all_positive(_impact_margins(orbit, mode, j, y))
    for other in CONTACTS:
        if other is not mode and not (mode.sticks and orbit.system.law is ImpactLaw.FRICTIONLESS):
            margins = _impact_margins(orbit, other, j, y)
            if not any(margin < 0 for margin in margins.values()):
                shown = ", ".join(f"{name} {margin.str(6)}" for name, margin in margins.items())
                raise NotProved(f"an impact with {other} is not shown to be inconsistent: {shown}")
    return f"{mode} is the only consistent impact, and the former stance foot lifts", smallest_margin


def _impact_margins(orbit: Orbit, mode: Mode, j: int, y: Sequence[arb]) -> dict[str, arb]:
    """What has to be positive for an impact to be consistent."""
    return dict(zip(orbit.system.impact_margin_names(mode), orbit.impact(mode, j)(y)[0], strict=True))


def _all_positive(needed: Mapping[str, arb]) -> arb:
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
