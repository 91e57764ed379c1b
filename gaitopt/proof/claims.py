"""What makes a periodic orbit a gait with the stated mode sequence: margins, modes at rest, and the impact.

Every claim holds for all orbits in the proved box. One that cannot be shown raises ``NotProved`` with where and by how
much.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from casadi import SX, simplify
from flint import arb

from gaitopt.mechanics import CONTACTS, Cycle, ImpactLaw, Mode, margin_names
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import Impact, Orbit, Passage
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
    """

    name: str
    proved: bool
    words: str
    margin: arb | None = None


Check = tuple[str, Callable[[], tuple[str, arb | None]]]


def mode_sequence_claims(orbit: Orbit, passage: Passage, sequence: Cycle) -> Iterator[Claim]:
    """The mode sequence: margins of every arc, modes of a foot at rest, the touchdown, the impact."""
    for name, check in _checks(orbit, passage, sequence):
        try:
            words, margin = check()
        except NotProved as failure:
            yield Claim(name, proved=False, words=str(failure))
        else:
            yield Claim(name, proved=True, words=words, margin=margin)


def _checks(orbit: Orbit, passage: Passage, sequence: Cycle) -> Iterator[Check]:
    touchdown: list[Part] = []
    for j, arc in enumerate(orbit.arcs):
        series = _margins_along(orbit, passage, j)
        first_of_phase = j == 0 or orbit.arcs[j - 1].phase != arc.phase
        for name, steps in series.items():
            order = _order_of_zero(orbit, sequence, j, name, first_of_phase=first_of_phase)
            found = list(parts(steps, order, monotone=name in ("touchdown", arc.event)))
            if name == "touchdown":
                touchdown += found
                continue
            pattern = ENDS if name == arc.event else POSITIVE
            yield f"arc {j + 1}, {arc.mode}: {name}", partial(_margin_claim, name, found, pattern, order)
        if first_of_phase and (j > 0 or sequence.impact.sticks):
            yield f"arc {j + 1}, {arc.mode}: mode at rest", partial(_rest, orbit, j, passage.starts[j], sequence)
    yield "touchdown", partial(_margin_claim, "touchdown", touchdown, TOUCHDOWN, 0)
    yield "impact", partial(_impact, orbit, passage.ends[-1][:-1])


def _margins_along(orbit: Orbit, passage: Passage, j: int) -> dict[str, list[tuple[Series, arb]]]:
    """Every margin of an arc's mode on every step of the arc."""
    arc = orbit.arcs[j]
    graph = orbit.field(arc.mode, arc.segment).margins
    names = margin_names(arc.mode)
    steps: dict[str, list[tuple[Series, arb]]] = {name: [] for name in names}
    for expansion in passage.expansions[j]:
        for name, series in zip(names, expansion.along(graph), strict=True):
            steps[name].append((series, expansion.h))
    return steps


def _order_of_zero(orbit: Orbit, sequence: Cycle, j: int, name: str, *, first_of_phase: bool) -> int:
    """Order of the zero with which a margin starts on an arc because of what happened just before.

    A slip starts from rest; where it starts at the edge of the cone its acceleration is zero as well, because that
    is minus the cone's margin over the apparent mass. The landing foot is on the ground.
    """
    arc = orbit.arcs[j]
    if name == "slip_velocity" and first_of_phase:
        return sequence.onset_order(arc.phase, jump=_friction_drops(orbit))
    if j == 0 and name in ("touchdown", "upright"):
        return int(_vanishes_after_impact(orbit, name))
    return 0


def _friction_drops(orbit: Orbit) -> bool:
    static, kinetic = orbit.system.static_friction(orbit.p), orbit.system.kinetic_friction(orbit.p)
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


def _margin_claim(name: str, found: Sequence[Part], pattern: str, order: int) -> tuple[str, arb | None]:
    kinds = check_pattern(name, found, pattern)
    zero = f", after a zero of order {order} at its start" if order else ""
    meaning = {
        POSITIVE: "is positive throughout",
        ENDS: "is positive and falls monotonically to its zero at the end",
        TOUCHDOWN: "falls to zero for the first time after having been positive at the end of the step",
    }
    return f"{name} {meaning[pattern]}{zero} ({kinds})", smallest(found)


def _rest(orbit: Orbit, j: int, y: list[arb], sequence: Cycle) -> tuple[str, arb | None]:
    """A foot at rest can only do what the arc says: stick, or slip because sticking would need too much friction."""
    arc = orbit.arcs[j]
    margins = {
        mode: dict(zip(margin_names(mode), map(arb, orbit.field(mode, arc.segment).margins(y)[0]), strict=True))
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
        if sequence.starts_from_rest(arc.phase):
            needed["excess over the cone"] = -cones[arc.mode]
            words = "holding the foot would need a force beyond the cone, on the side of this slip alone"
    return words, _all_positive(needed)


def _impact(orbit: Orbit, z: list[arb]) -> tuple[str, arb | None]:
    """The impact is consistent, no other one is, and the former stance foot lifts."""
    candidates = {mode: orbit.impact(mode, z) for mode in CONTACTS}
    own = candidates[orbit.impact_mode]
    cone = orbit.system.static_friction(orbit.p)
    needed = {"lift velocity": own.lift_velocity, **_impact_margins(own, orbit.impact_mode, cone)}
    for mode in CONTACTS:
        if mode is not orbit.impact_mode and not (orbit.impact_mode.sticks and _stick_has_precedence(orbit)):
            other = _impact_margins(candidates[mode], mode, cone)
            if not any(margin < 0 for margin in other.values()):
                shown = ", ".join(f"{name} {margin.str(6)}" for name, margin in other.items())
                raise NotProved(f"an impact with {mode} is not shown to be inconsistent: {shown}")
    return f"{orbit.impact_mode} is the only consistent impact, and the former stance foot lifts", _all_positive(needed)


def _stick_has_precedence(orbit: Orbit) -> bool:
    """Whether an impact sticks wherever it can, even where it could slip as well."""
    return orbit.system.law is ImpactLaw.FRICTIONLESS or _friction_drops(orbit)


def _impact_margins(impact: Impact, mode: Mode, cone: arb) -> dict[str, arb]:
    """What has to be positive for an impact to be consistent."""
    f_t, f_n = map(arb, impact.impulse)
    if mode.sticks:
        return {"normal impulse": f_n, "cone_forward": cone * f_n + f_t, "cone_backward": cone * f_n - f_t}
    return {"normal impulse": f_n, "painleve": impact.painleve, "slip velocity": mode.direction * impact.slip_velocity}


def _all_positive(needed: dict[str, arb]) -> arb:
    """The smallest lower bound.

    Raises
    ------
    NotProved
        If one is not above zero.
    """
    for name, value in needed.items():
        if not value > 0:
            raise NotProved(f"{name} is {value.str(6)}, not shown to be positive")
    return min(value.lower() for value in needed.values())
