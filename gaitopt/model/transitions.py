"""The hybrid automaton of a walker as a table: the margins of each mode, the events that end it, and the next modes.

    mode  --  margin falls to zero  --  reset  -->  one of the candidates, or the motion ends

Every margin is positive while its mode holds and is the guard of one transition. A margin of an impact likewise leads
to the impact, or the ending, that replaces it when the margin falls. At a breakpoint of the control law, whose guard
is the time, torques and contact forces may jump. The table contains facts only. The expressions of the margins are in
``gaitopt.model.expressions``, and each method decides by itself which candidate is consistent: the simulator from
forces and impulses, the NLP by following a cycle, a branch by trying the candidates in turn. In the same way a witness
function stands beside its reset in Drake's compass gait (``examples/compass_gait``).

A walker that stands on one foot at a time has the contacts ``foot`` and ``swing_foot``. When the swing foot lands, the
former stance foot leaves the ground, and the two swap places.

A margin of a force or velocity belongs to one contact: ``normal_force.left``, or ``normal_force`` for the foot of a
walker that stands on one foot at a time. Contacts that stick together and share their forces have margins of their
group, such as ``cone_forward.left+right``. ``gap.left`` falls to zero when a contact that is off lands; that of the
swing foot is ``touchdown``. If several contacts touch, any event may change the forces of all of them, so that the
candidates are all modes of these contacts: a contact that slips continues or lifts, a contact at rest may stick, slip
or lift. A foot that stands alone does what the margin says: it slips, or leaves the ground. The event between two given
modes follows from what changes:

    a stop or switch                    its margin
    a contact lands                     gap             else    a slip ends or turns        slip_velocity
    else    a contact leaves            normal_force    else    a contact begins to slip    its cone

Several slips may begin or end at one instant, as they do in symmetric motions. The guard is the cone, or the velocity,
of the first contact; those of the others are zero at this instant too.

A step ends when the swing foot or a contact of ``Walker.landing_contacts`` lands, when a margin of ``Walker.sections``
falls to zero, or with a period of the control law.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import product

from gaitopt.model.contacts import TANGENTIAL, constraint_structure, shares_of
from gaitopt.model.cycle import BREAKPOINT, Cycle, ModeSequence, ended_slips
from gaitopt.model.friction import COULOMB, ContactFriction, Friction, ImpactLaw
from gaitopt.model.modes import FOOT, NEXT_STATE, OFF, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.units import UNITS, Scales
from gaitopt.model.walker import Walker
from gaitopt.threads import cached_method


class Ending(StrEnum):
    """Why a simulated motion ended."""

    COMPLETED = "completed"
    FALL = "fall"
    NO_TOUCHDOWN = "no_touchdown"
    LIFT_OFF = "lift_off"
    PAINLEVE = "painleve"
    CHATTERING = "chattering"
    IMPACT_INCONSISTENT = "impact_inconsistent"
    IMPACT_AMBIGUOUS = "impact_ambiguous"
    DOUBLE_SUPPORT = "double_support"
    NUMERICAL = "numerical"
    SCUFFING = "scuffing"
    PUSH_SLIPS = "push_slips"
    CONTACT_INCONSISTENT = "contact_inconsistent"
    CONTACT_AMBIGUOUS = "contact_ambiguous"
    UNDETERMINED = "undetermined"
    IMPACTS_ACCUMULATE = "impacts_accumulate"


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """Unit and messages of a margin, the same for all walkers.

    Attributes
    ----------
    unit : natural unit, a key of ``gaitopt.model.units.UNITS``.
    violated : message about a negative value, with ``{value}``; empty if the margin is judged together with others.
    lost : message about its fall to zero, in a motion or along a branch.
    absent : message about a phase that the margin should end, but in which it does not fall to zero.
    ending : how a motion ends when the margin falls to zero; None if a mode or an impact follows.
    rises : whether the margin is zero at the start of a step, so that a fall counts only after it has been positive.
    """

    unit: str
    violated: str = ""
    lost: str
    absent: str = ""
    ending: Ending | None = None
    rises: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Reset:
    """A jump of the state.

    Attributes
    ----------
    of : the contact that lands, or the stop that locks.
    ends_step : whether the step ends, and time and x start from zero.
    swaps : whether the feet swap roles, where a step ends or within it.
    """

    of: str
    ends_step: bool
    swaps: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """One row of the table.

    Attributes
    ----------
    guard : name of the margin whose fall to zero triggers the transition; ``breakpoint`` for a fixed time.
    margin : unit and messages of the guard.
    ending : how the motion ends; None if a mode follows.
    reason : message about the event.
    reset : the jump of the state; None if the state is continuous.
    at_rest : contacts whose slip velocity is zero afterwards; their forces select the candidate.
    candidates : the modes that may follow; at a reset with several candidates the impulses select one.
    zeros : margins of the ended mode that are zero at the event.
    zeros_after : margins of the next mode that are zero just after the event.
    """

    guard: str
    margin: Margin
    ending: Ending | None = None
    reason: str
    reset: Reset | None = None
    at_rest: tuple[str, ...] = ()
    candidates: tuple[Mode, ...] = ()
    zeros: tuple[str, ...]
    zeros_after: tuple[str, ...] = ()

    @property
    def is_decided(self) -> bool:
        """Whether one mode follows an event without a reset, whatever the forces."""
        return len(self.candidates) == 1

    @property
    def ends_step(self) -> bool:
        """Whether the feet swap roles."""
        return self.reset is not None and self.reset.ends_step


FOOT_PHRASES = r"\bthe (?:stance foot|slipping foot|foot|contact)\b(?! that)"
"""Phrases in the messages of margins that the name of a contact replaces."""
NO_SLIP = "sticking never needs more friction than is available, so that no slip begins"

PUSH_SLIPS = "the foot that pushes off slips: its push is {value:.4g} N s outside of the friction cone"
PUSH = ("push_cone_forward", "push_cone_backward", "push_landing")
"""Margins of the push before an impact."""

PHASE_MARGINS: Mapping[str, Margin] = {
    "touchdown": Margin(
        unit="one",
        lost="the swing foot touches the ground earlier in the step",
        absent="the swing foot does not come down",
        rises=True,
    ),
    "clearance": Margin(
        unit="length",
        lost="the swing foot scuffs the ground while a stop is still free",
        ending=Ending.SCUFFING,
        rises=True,
    ),
    "gap": Margin(
        unit="length",
        lost="the contact touches the ground",
        absent="the contact does not come down",
        rises=True,
    ),
    "upright": Margin(unit="one", lost="the walker is no longer upright", ending=Ending.FALL),
    "normal_force": Margin(
        unit="force",
        violated="normal force is {value:.4g} N, must be positive",
        lost="the stance foot lifts off: its normal force falls to zero",
        absent="the foot does not leave the ground",
        ending=Ending.LIFT_OFF,
    ),
    "cone_forward": Margin(
        unit="force",
        lost="the force reaches the edge of the friction cone, the foot slips forward",
        absent=NO_SLIP,
    ),
    "cone_backward": Margin(
        unit="force",
        lost="the force reaches the edge of the friction cone, the foot slips backward",
        absent=NO_SLIP,
    ),
    "slip_velocity": Margin(
        unit="speed",
        violated="slip velocity is {value:.4g} m/s in the direction of the mode, must not be negative",
        lost="the foot comes to rest",
        absent="the foot does not come to rest",
    ),
    "painleve": Margin(
        unit="mass",
        violated="apparent mass of the slipping foot is {value:.4g} kg, must be positive (Painleve)",
        lost="the slip has no unique solution: the apparent mass of the foot falls to zero",
        ending=Ending.PAINLEVE,
    ),
    "regularity": Margin(
        unit="one",
        violated="the contact forces have no unique solution: regularity is {value:.4g}, must be positive (Painleve)",
        lost="the contact forces have no unique solution",
        ending=Ending.PAINLEVE,
    ),
    "onset": Margin(
        unit="force",
        violated="static friction holds the foot: the force misses the edge of its cone by {value:.4g} N",
        lost="static friction holds the foot where the slip should begin",
    ),
    "pull": Margin(
        unit="force",
        violated="the ground carries the foot where it should lift off: its normal force is {value:.4g} N too large",
        lost="the ground carries the foot where it should lift off",
    ),
}
"""Margins of phases. ``touchdown`` is minus the walker's guard; ``cone_forward`` is mu f_n + f_t, ``cone_backward``
mu f_n - f_t; ``slip_velocity`` is the speed in the mode's direction; ``onset`` is the force beyond the static cone
where a slip starts from rest, needed only if friction has two coefficients or the torques jump; ``pull`` is minus the
normal force in the old mode where a flight starts because the torques jump."""

IMPACT_MARGINS: Mapping[str, Margin] = {
    "impulse": Margin(
        unit="impulse",
        violated="normal impulse is {value:.4g} N s, must be positive",
        lost="the normal impulse of the impact falls to zero",
        ending=Ending.LIFT_OFF,
    ),
    "lift_velocity": Margin(
        unit="speed",
        violated="the former stance foot does not lift: its normal velocity is {value:.4g} m/s",
        lost="the former stance foot no longer lifts at the impact",
        ending=Ending.DOUBLE_SUPPORT,
    ),
    "touchdown_rate": Margin(
        unit="rate",
        violated="the swing foot leaves the ground instead of landing (guard rate {value:.4g})",
        lost="the swing foot no longer comes down",
        ending=Ending.IMPACT_INCONSISTENT,
    ),
    "impulse_cone_forward": Margin(unit="impulse", lost="the impact can no longer stick, the foot slips forward"),
    "impulse_cone_backward": Margin(unit="impulse", lost="the impact can no longer stick, the foot slips backward"),
    "impact_slip_velocity": Margin(
        unit="speed",
        violated="slip velocity after impact is {value:.4g} m/s in the direction of the mode",
        lost="the slip velocity after the impact falls to zero",
    ),
    "impact_regularity": Margin(
        unit="one",
        violated="the impulses have no unique solution: regularity is {value:.4g}, must be positive (Painleve)",
        lost="the impulses of the impact have no unique solution any more",
        ending=Ending.PAINLEVE,
    ),
    "impact_painleve": Margin(
        unit="mass",
        violated="apparent mass of the colliding foot is {value:.4g} kg, must be positive",
        lost="the slipping impact has no unique solution any more",
        ending=Ending.PAINLEVE,
    ),
    "impact_onset": Margin(
        unit="impulse",
        violated="the impact sticks: its impulse misses the edge of the static cone by {value:.4g} N s",
        lost="static friction holds the impact: it can no longer slip",
    ),
    "push_cone_forward": Margin(
        unit="impulse", violated=PUSH_SLIPS, lost="the foot that pushes off slips", ending=Ending.PUSH_SLIPS
    ),
    "push_cone_backward": Margin(
        unit="impulse", violated=PUSH_SLIPS, lost="the foot that pushes off slips", ending=Ending.PUSH_SLIPS
    ),
    "push_landing": Margin(
        unit="speed",
        violated="the push lifts the swing foot: it leaves the ground at {value:.4g} m/s instead of landing",
        lost="the push lifts the swing foot before it lands",
        ending=Ending.IMPACT_INCONSISTENT,
    ),
}
"""Margins of impacts, with impulses instead of forces."""

AT_BREAKPOINT = Margin(
    unit="time",
    lost="a change of mode meets a breakpoint of the control law, where the torques jump",
    absent="no breakpoint of the control law ends it",
)
"""The time to a breakpoint at which a phase ends."""
AT_PERIOD = Margin(
    unit="time",
    lost="the period of the control law ends",
    absent="the period of the control law does not end in it",
)
"""The time to the end of the control law's period, which ends a cycle by the clock."""
MARGINS: Mapping[str, Margin] = {**PHASE_MARGINS, **IMPACT_MARGINS, BREAKPOINT: AT_BREAKPOINT, CLOCK: AT_PERIOD}
STOP = Margin(
    unit="one",
    lost="{name} falls to zero earlier in the step",
    absent="{name} does not fall to zero in it",
    rises=True,
)
"""Unit and messages, with ``{name}``, of the gap of any joint stop, and of the margin of any switch or section."""
CONE: Mapping[Mode, str] = {Mode.SLIP_FORWARD: "cone_forward", Mode.SLIP_BACKWARD: "cone_backward"}
"""The margin of a sticking foot that falls to zero when each slip begins; in impacts its name begins with
``impulse_``."""
GROUND_FORCES = ("normal_force", "cone_forward", "cone_backward")
"""Margins of the force of the ground. All are zero at the landing and at the take-off of a massless foot."""
LANDINGS = ("touchdown", "clearance")
"""Margins of the swing foot: the first in the order of a table."""
AT_REST = (str(Mode.STICK), str(Mode.SLIP_FORWARD), str(Mode.SLIP_BACKWARD), OFF)
"""The states that may follow for a contact at rest on the ground; sticking comes first."""
PRIORITY = ("gap", "slip_velocity", "normal_force", "cone_forward", "cone_backward")
"""Kinds of margins in the order in which they explain a change of modes."""
ONE_AT_A_TIME = "a step begins with all stops free and all switches off, and they change one at a time"
CANNOT_SLIP = "a massless foot cannot slip, and friction does not hold it"


def kind(name: str) -> str:
    """The kind of a margin, which is its name without the contact: ``cone_forward`` for ``cone_forward.left``.

    A margin of a group may be a sum of different kinds; its kind is then that of the first term.
    """
    return name.partition(".")[0].partition("+")[0]


def contact_of(name: str) -> str:
    """The contact of a margin; ``foot`` if contacts have no names."""
    return name.partition(".")[2] or FOOT


def named(what: str, name: str) -> str:
    """The margin of another kind of the same contact as the margin ``name``."""
    contact = name.partition(".")[2]
    return f"{what}.{contact}" if contact else what


@lru_cache(maxsize=256)
def margin(name: str) -> Margin:
    """Unit and messages of a margin, with the name of its contact; ``MARGINS`` lacks those of stops and switches."""
    facts, contact = MARGINS.get(kind(name)), name.partition(".")[2]
    if facts is None:
        return replace(STOP, lost=STOP.lost.format(name=name), absent=STOP.absent.format(name=name))
    if not contact:
        return facts
    lost, absent = (re.sub(FOOT_PHRASES, f"the contact {contact}", text) for text in (facts.lost, facts.absent))
    return replace(facts, lost=lost, absent=absent)


def is_held(name: str) -> bool:
    """Whether a margin must be positive throughout a mode of a gait.

    Other margins rise before they fall, and a gait is always upright.
    """
    return name != "upright" and not margin(name).rises


def grounded(candidates: tuple[Mode, ...]) -> tuple[Mode, ...]:
    """The candidates in which the walker touches the ground."""
    return tuple(mode for mode in candidates if mode.touching)


def share_name(parts: tuple[tuple[str, str], ...]) -> str:
    """Name of the margin of a group of contacts: its kinds and its contacts, each of them once."""
    kinds = "+".join(dict.fromkeys(kind for kind, _ in parts))
    return f"{kinds}.{'+'.join(dict.fromkeys(contact for _, contact in parts))}"


def impulse_name(name: str) -> str:
    """Name of the margin of an impact that has impulses where a margin of a mode has forces."""
    what, _, contacts = name.partition(".")
    kinds = ("impulse" if force == "normal_force" else f"impulse_{force}" for force in what.split("+"))
    return f"{'+'.join(kinds)}.{contacts}"


def _parts(guard: str) -> set[tuple[str, str]]:
    """All pairs of a kind and a contact in the name of a margin; a group's margin need not contain every pair."""
    kinds, _, contacts = guard.partition(".")
    return {(what, name) for what in kinds.split("+") for name in (contacts or FOOT).split("+")}


def margin_unit(name: str, scales: Scales) -> float:
    """Natural unit of a margin in SI."""
    return UNITS[margin(name).unit][1](scales)


class Transitions:
    """The table of one walker; ``transitions`` builds it once.

    Parameters
    ----------
    walker : the class of the walker.
    friction : the friction law of its contacts.
    law : tangential law of its slipping impacts.
    cycle_end : event that ends a cycle: ``touchdown``, ``clock`` or the name of a margin.

    Attributes
    ----------
    walker, cycle_end : see the parameters.
    modes : all modes of the walker.
    landed : modes with all stops free and all switches off in which the walker touches the ground.
    unique : name of the margin of a unique slip: ``painleve``, the apparent mass of a foot alone, or ``regularity``.
    """

    def __init__(
        self, walker: type[Walker], friction: Friction | ContactFriction, law: ImpactLaw, cycle_end: str = TOUCHDOWN
    ) -> None:
        self.walker, self._friction, self._law, self.cycle_end = walker, friction, law, cycle_end
        self.modes, self._states = walker.modes(), {*walker.foot_modes()}
        self._closing = walker.stops if walker.stands_on_one() else walker.closing_stops
        self.unique = "painleve" if walker.stands_on_one() else "regularity"
        self.landed = tuple(walker.released(contact) for contact in grounded(walker.foot_modes()))
        self._landings: dict[tuple[str, Mode], Mapping[Mode, Mode]] = {}
        self._checked: set[Cycle] = set()

    @cached_method
    def of(self, mode: Mode) -> Mapping[str, Transition]:
        """Transitions by their guards, in the order of ``HybridSystem.margins``."""
        return {row.guard: row for row in self._of_phase(mode)}

    @cached_method
    def of_impact(self, mode: Mode, before: Mode) -> Mapping[str, Transition]:
        """Transitions to what replaces an impact, by its margins in the order of ``HybridSystem.impact_margins``.

        Parameters
        ----------
        mode : mode just after the impact, with the names that the contacts have before it; see ``struck``.
        before : mode just before it.
        """
        return {row.guard: row for row in self._of_impact(mode, before)}

    def name(self, what: str, contact: str) -> str:
        """The name of a margin of a contact. The gap of a foot without a label is called ``touchdown``."""
        return "touchdown" if what == "gap" and not self.walker.label(contact) else self.walker.quantity(what, contact)

    @property
    def most_margins(self) -> int:
        """A bound of the number of margins of a mode: three per contact, and sums for those that share forces."""
        n = len(self.walker.contact_names())
        return 3 + 3 * n + n**2 + len(self.walker.stops) + len(self.walker.switches)

    def margin_names(self, mode: Mode) -> tuple[str, ...]:
        """Names of the margins of a mode, in the order of ``HybridSystem.margins``."""
        return tuple(self.of(mode))

    def impact_margin_names(self, mode: Mode, before: Mode) -> tuple[str, ...]:
        """Names of the margins of an impact, in the order of ``HybridSystem.impact_margins``."""
        return tuple(self.of_impact(mode, before))

    def struck(self, cycle: Cycle, phase: int) -> Mode | None:
        """The impact that ends a phase, with the names that the contacts have before it; None without an impact."""
        impact, within = cycle.reset_after(phase), cycle.after(phase) is not None
        if impact is None or (not within and self.cycle_end != TOUCHDOWN):
            return impact
        return self.struck_within(impact) if within else self.walker.swapped(impact)

    def struck_within(self, landed: Mode) -> Mode:
        """An impact within a step with the names that the contacts have before it."""
        return self.walker.swapped(landed.contact) if landed.swaps else landed

    def written_impact(self, struck: Mode) -> Mode:
        """An impact with the names of contacts in records, where the only foot on the ground is ``foot``."""
        base = self.walker.base_contact()
        return self.walker.swapped(struck) if base and struck.touching and base not in struck.touching else struck

    def stated_impact(self, of: str, after: Mode) -> Mode | None:
        """The impact of a contact or a stop within a step, as the next phase states it; None if the phase need not.

        If one foot stands alone, the modes already determine the impact of a stop.

        Parameters
        ----------
        after : mode just after the impact, with the names that the contacts have then.
        """
        if of in self.walker.step_ends():
            return after.swapping
        return None if self.walker.stands_on_one() else after

    def landings(self, row: Transition, mode: Mode) -> Mapping[Mode, Mode]:
        """The mode after each impact that may end a step in ``mode``, by the impact.

        The impact has the names that the contacts have before it, and the stops that it holds are locked.
        """
        if (row.guard, mode) not in self._landings:
            walker, landed = self.walker, [candidate.contact for candidate in row.candidates]
            known = {walker.held_in_impact(walker.swapped(contact), mode): contact for contact in landed}
            self._landings[row.guard, mode] = known
        return self._landings[row.guard, mode]

    @cached_method
    def between(self, mode: Mode, after: Mode | None, struck: Mode | None = None) -> Transition:
        """The transition from ``mode`` to the next mode ``after`` of the step; None stands for the end of the step.

        Parameters
        ----------
        struck : see ``struck``; it is needed if several contacts may land.

        Raises
        ------
        ValueError
            If no event leads from one to the other.
        """
        if after is None and self.cycle_end == CLOCK:
            return self._row(CLOCK, reset=Reset(of=CLOCK, ends_step=True), candidates=(mode,))
        if after is None and (struck is None or self.cycle_end != TOUCHDOWN):
            found = [row for row in self.of(mode).values() if row.ends_step]
        else:
            found = self._leading(mode, after, struck)
        if not found:
            goal = "the end of a step" if after is None else after.brief
            raise ValueError(f"no event of the {self.walker.model} leads from {mode.brief} to {goal}")
        return found[0]

    def _leading(self, mode: Mode, after: Mode | None, struck: Mode | None) -> list[Transition]:
        """The transitions that explain a change of modes, the best first."""
        rows = self.of(mode)
        landed = [name for name in (struck or after or mode).touching if name not in mode.touching]
        gaps = (rows.get(self.name("gap", name)) for name in landed)
        lands = [row for row in gaps if row is not None and row.ends_step is (after is None)]
        if any(row.reset is not None and row.reset.swaps for row in lands):
            return lands
        for name, state in () if after is None else after.stops.items():
            if state != mode.stops[name]:
                return [rows[name]] if name in rows and after in rows[name].candidates else []
        if lands:
            return lands
        changes = set[tuple[str, str]]()
        for name, state in after.contacts.items() if after is not None and not landed else ():
            direction = mode.directions[name]
            if name in mode.touching and state != mode.contacts[name]:
                leaves = name not in (after or mode).touching
                what = "normal_force" if leaves else "slip_velocity" if direction else CONE[Mode(state)]
                changes.add((what, name))

        def rank(row: Transition) -> tuple[int, int]:
            own = _parts(row.guard)
            return min(PRIORITY.index(what) for what, _ in changes & own), -2 * len(changes & own) + len(own)

        found = [r for r in rows.values() if after in r.candidates and r.reset is None and changes & _parts(r.guard)]
        if not found and after is not None:
            return self._stopping_together(mode, after)
        if self._friction.may_drop:  # the force of one contact jumps when another one begins to slip
            return sorted(found, key=rank)
        edges = [f"{what}.{name}" for what, name in sorted(changes) if what in CONE.values()]
        together = tuple(edge for edge in edges if edge in rows and len(edges) > 1)
        return [
            replace(row, zeros=tuple(dict.fromkeys((*row.zeros, *together)))) if row.guard in together else row
            for row in sorted(found, key=rank)
        ]

    def _stopping_together(self, mode: Mode, after: Mode) -> list[Transition]:
        """The transition at which several slips end at one instant, as in symmetric motions; the first is its guard."""
        stopped = ended_slips(mode, after)
        rests = (*_at_rest(mode), *stopped)
        if len(stopped) < 2 or after not in self._candidates(mode, rests):
            return []
        guards = [self.name("slip_velocity", name) for name in stopped]
        return [self._row(guards[0], at_rest=rests, candidates=(after,), zeros=tuple(guards))]

    def stops_in_turn(self, mode: Mode, after: Mode) -> tuple[tuple[str, Mode, Mode], ...]:
        """The slips that end at one instant after the first one, as if each ended just after the previous one.

        Contacts that a rigid body moves alike stop together. The order of two slips that end in friction does not
        matter, because the forces that end them are the same.

        Returns
        -------
        stops : for each slip its contact, and the modes just before and just after it stops.
        """
        ended = ended_slips(mode, after)
        if len(ended) < 2:
            return ()
        structure = constraint_structure(self.walker, mode.with_states(dict.fromkeys(ended, AT_REST[0])))
        alike = {structure.constraints[k] for k in structure.dropped}
        later = [name for name in ended[1:] if (name, TANGENTIAL) not in alike]
        stops = list[tuple[str, Mode, Mode]]()
        before = after.with_states({name: mode.contacts[name] for name in later})
        for name in later:
            stops.append((name, before, before.with_states({name: after.contacts[name]})))
            before = stops[-1][2]
        return tuple(stops)

    @cached_method
    def at_breakpoint(self, mode: Mode) -> Transition:
        """The transition at a breakpoint of the control law, where the torques and with them the forces may jump.

        Its time is fixed, so that deviations pass it unchanged although the flow jumps. The forces of a contact at rest
        determine its next state; a slipping contact continues to slip, or is lifted off; in flight nothing changes.
        """
        rests = _at_rest(mode)
        return self._row(BREAKPOINT, at_rest=rests, candidates=self._candidates(mode, rests))

    def ending(self, cycle: Cycle, phase: int) -> Transition:
        """The transition that ends a phase of a cycle."""
        if phase in cycle.timed:
            return self.at_breakpoint(cycle.phases[phase])
        return self.between(cycle.phases[phase], cycle.after(phase), self.struck(cycle, phase))

    def zeros_after(self, cycle: Cycle, phase: int) -> tuple[str, ...]:
        """Margins of the next phase that are zero just after the event that ends a phase.

        They are the forces of massless contacts that have just landed, and the velocity of a foot that stands alone and
        begins to slip.
        """
        following, partner = self.of(cycle.phases[(phase + 1) % len(cycle.phases)]), dict[str, str]()
        struck = self.struck(cycle, phase)
        landed = [] if struck is None else [n for n in struck.touching if n not in cycle.phases[phase].touching]
        reset = self.ending(cycle, phase).reset
        if reset is not None and reset.swaps:
            partner = self.walker.partners()
        landed = [partner.get(name, name) for name in landed if name in self.walker.weightless()]
        forces = [self.name(force, name) for name in landed for force in GROUND_FORCES]
        names = dict.fromkeys([*forces, *self.ending(cycle, phase).zeros_after])
        return tuple(name for name in names if name in following)

    def is_unloaded(self, cycle: Cycle, phase: int, name: str, *, starts: bool, ends: bool) -> bool:
        """Whether a margin is a force on a massless leg that lands at the start of a phase or takes off at its end."""
        if kind(name) not in GROUND_FORCES:
            return False
        if starts:
            return name in self.zeros_after(cycle, (phase - 1) % len(cycle.phases))
        zeros = {*self.ending(cycle, phase).zeros} if ends else set[str]()
        return name in zeros and {named(force, name) for force in GROUND_FORCES} <= zeros

    def is_zero_by_event(self, cycle: Cycle, phase: int, name: str, *, starts: bool, ends: bool) -> bool:
        """Whether an event makes a margin zero at the start or at the end of a phase."""
        if starts and kind(name) == "slip_velocity":
            return cycle.onset_order(phase, contact_of(name)) > 0
        if self.is_unloaded(cycle, phase, name, starts=starts, ends=ends):
            return True
        return ends and name in self.ending(cycle, phase).zeros

    def sticking(self, mode: Mode, contact: str) -> tuple[Mode, str]:
        """The mode in which a slipping contact sticks instead, and its margin there that is negative if it must slip.

        The margin may be that of a group to which the contact then belongs.
        """
        sticking, cone = mode.with_states({contact: Mode.STICK}), (CONE[Mode(mode.contacts[contact])], contact)
        return sticking, next(guard for guard in self.of(sticking) if cone in _parts(guard))

    def at_rest(self, mode: Mode) -> tuple[Mode, ...]:
        """Candidates if the forces are decided anew and the contacts that stick are at rest; stick comes first."""
        return self._candidates(mode, _at_rest(mode))

    def onset(self, mode: Mode, contact: str = FOOT) -> Transition:
        """The transition for a contact that static friction holds at the start of a slip from rest."""
        rests = tuple(name for name in mode.touching if not mode.directions[name] or name == contact)
        return self._row(self.name("onset", contact), at_rest=rests, candidates=self._candidates(mode, rests))

    def pull(self, mode: Mode) -> Transition:
        """The transition for a jump of the torques that no longer lifts the foot out of a mode."""
        return self._row("pull", candidates=(mode,))

    def check(self, cycle: Cycle) -> None:
        """Check that events of the table lead through the phases of a cycle.

        Raises
        ------
        ValueError
            If not; the message says what the walker can do.
        """
        if cycle in self._checked:
            return
        model, start = self.walker.model, self.landed[0].stops
        for step in cycle.steps:
            swaps = {k for k, landed in step.landings if landed.swaps}
            if self.cycle_end != TOUCHDOWN and step.phases[-1].stops != start:
                raise ValueError(f"nothing releases the stops of the {model}: only a landing that swaps the feet does")
            self._check_modes(step, start)
            for k, after in enumerate(step.phases):
                if k in swaps or not k:
                    changed = []
                    if after.stops != start:
                        raise ValueError(ONE_AT_A_TIME)
                else:
                    changed = [name for name in start if after.stops[name] != step.phases[k - 1].stops[name]]
                if len(changed) > 1 or any(after.stops[name] == start[name] for name in changed):
                    raise ValueError(ONE_AT_A_TIME)
            ends = {len(step.phases)} if self.cycle_end == TOUCHDOWN else set[int]()
            for last in (step.phases[k - 1] for k in sorted(swaps | ends)):
                if not self.may_land(last):
                    raise ValueError(f"the {model} lands after a flight: the last phase of a step must be flight")
                if any(kind(guard) == "clearance" for guard in self.of(last)):
                    stops = "all stops" if self.walker.stands_on_one() else ", ".join(self._closing)
                    raise ValueError(f"{stops} must lock before the foot comes down")
        for phase, mode in enumerate(cycle.phases):
            self.between(mode, cycle.after(phase), self.struck(cycle, phase))
            reset = cycle.reset_after(phase)
            following = cycle.phases[(phase + 1) % len(cycle.phases)]
            touching = mode.touching if reset is None else reset.touching
            foreign = [name for name in following.touching if name not in touching]
            if foreign:
                where = "in the impact before it" if reset is not None else f"in {mode.brief}"
                raise ValueError(f"{foreign[0]} touches the ground in {following.brief}, but not {where}")
        self._checked.add(cycle)  # a problem is read again at every ``replace``

    def may_land(self, mode: Mode) -> bool:
        """Whether contacts that are off can land in a mode; a foot that can fly lands only out of flight."""
        return not (self.walker.stands_on_one() and self.walker.flies and mode.touching)

    def _check_modes(self, step: ModeSequence, start: Mapping[str, str]) -> None:
        """Check that the walker has the modes of a step; ``start`` are the states of stops and switches there."""
        model, alone, massless = self.walker.model, self.walker.stands_on_one(), self.walker.placed_contacts()
        for mode in (*step.phases, step.impact, *(mode for _, mode in step.landings)):
            if mode.contact not in self._states:
                if alone:
                    allowed = ", ".join(self.walker.foot_modes())
                    raise ValueError(f"the {model} has no {mode.contact}; its foot can {allowed}")
                reason = f"{', '.join(massless)} cannot slip" if massless else "it is not a state of its contacts"
                raise ValueError(f"the {model} has no mode {mode.brief}: {reason}")
        for mode in step.phases:
            if [*mode.stops] != [*start] or any(mode.stops[k] not in (v, NEXT_STATE[v]) for k, v in start.items()):
                stated = "{" + ", ".join(f"{name}: {mode.contacts[name]}" for name in mode.touching) + "}"
                stated = stated if mode.is_named else str(mode.contact)
                form = "{" + ", ".join([f"mode: {stated}", *(f"{k}: {v}" for k, v in start.items())]) + "}"
                remedy = form if start else stated
                raise ValueError(f"{mode.brief} does not fit the stops of the {model}: write {remedy}")
        if alone and self.cycle_end == TOUCHDOWN and not step.impact.touching:
            raise ValueError("after an impact the foot is on the ground: stick, slip_forward or slip_backward")
        if step.impact.stops:
            raise ValueError(f"write the impact {step.impact.contact}: the impact of the foot frees all stops")

    def _candidates(self, mode: Mode, at_rest: Iterable[str], landing: str | None = None) -> tuple[Mode, ...]:
        """Modes of the contacts that touch, with the stops and switches of a mode.

        Parameters
        ----------
        at_rest : the contacts at rest.
        landing : the contact that lands; its impact may change the motion of all contacts on the ground. A walker that
            stands on one contact at a time then stands on this one.
        """
        walker, rests, massless = self.walker, {*at_rest}, self.walker.weightless()
        if landing is not None and walker.stands_on_one():
            return tuple(mode.with_contact(walker.swapped(landed.contact)) for landed in self.landed)
        choices = list[tuple[str, ...]]()
        for name, state in mode.contacts.items():
            touches = name in mode.touching
            if name in massless:
                choices.append((AT_REST[0], OFF) if touches or name == landing else (OFF,))
            elif (landing is not None and (touches or name == landing)) or name in rests:
                choices.append(AT_REST)
            else:
                choices.append((state, OFF) if touches else (OFF,))
        modes = (mode.with_states(dict(zip(mode.contacts, states, strict=True))) for states in product(*choices))
        return tuple(candidate for candidate in modes if candidate.contact in self._states)

    def _of_phase(self, mode: Mode) -> list[Transition]:
        rests, rows = _at_rest(mode), [self._row("upright")]
        if self.cycle_end not in (TOUCHDOWN, CLOCK):
            ends = Reset(of=self.cycle_end, ends_step=True)
            rows.append(self._row(self.cycle_end, reset=ends, candidates=(mode,)))
        shares = shares_of(self.walker, mode)
        shared = {contact for share in shares for _, contact in share}
        for name in self.walker.landing_points():
            if name in mode.touching:
                rows += self._of_contact(mode, name, is_shared=name in shared)
            elif name != FOOT or not self.walker.stands_on_one():  # a foot that has left lands as the swing foot
                rows.append(self._of_landing(mode, name))
        again = self._candidates(mode, rests)
        rows += [self._row(share_name(share), at_rest=rests, candidates=again) for share in shares]
        if mode.slips:
            rows.append(self._row(self.unique))
        for stop in mode.free:  # all contacts may stick, slip or leave the ground after the impact of the stop
            locked = mode.with_next(stop)
            struck = self._candidates(locked, mode.touching) if mode.touching else (locked,)
            rows.append(self._row(stop, reset=Reset(of=stop, ends_step=False), candidates=struck))
        for switch in mode.off:  # forces may jump, so that a contact at rest may change its mode
            on = mode.with_next(switch)
            rows.append(self._row(switch, at_rest=rests, candidates=self._candidates(on, rests)))
        return sorted(rows, key=lambda row: kind(row.guard) not in LANDINGS)

    def _of_landing(self, mode: Mode, name: str) -> Transition:
        """The row of a contact that is off: it lands, or may not land in this mode."""
        swaps = name in self.walker.step_ends()
        lands_on_ground = mode.touching or not self.walker.stands_on_one()
        if swaps and lands_on_ground and {*mode.free} & {*self._closing}:
            return self._row(self.name("clearance", name))
        landed = self._candidates(mode, _at_rest(mode), landing=name)
        if swaps:
            landed = tuple(self.walker.released(self.walker.swapped(after.contact)) for after in landed)
        reset = Reset(of=name, ends_step=swaps and self.cycle_end == TOUCHDOWN, swaps=swaps)
        return self._row(self.name("gap", name), reset=reset, candidates=landed)

    def _of_contact(self, mode: Mode, name: str, *, is_shared: bool) -> list[Transition]:
        """Rows of a contact on the ground; those of its forces are in the rows of its group if it shares them."""
        rows, forces = list[Transition](), [self.name(force, name) for force in GROUND_FORCES]
        if not is_shared:  # the forces of a massless contact vanish together
            zeros = tuple(forces) if name in self.walker.weightless() else ()
            rows.append(self._of_force(forces[0], mode, mode.with_states({name: OFF}), zeros=zeros))
        if not mode.directions[name] and not is_shared:
            for slip, cone in CONE.items():
                slips = self._of_force(self.name(cone, name), mode, mode.with_states({name: slip}), slips=True)
                rows.append(slips)
        if mode.directions[name]:
            resting = (*_at_rest(mode), name)
            stopped = self._candidates(mode, resting)
            rows.append(self._row(self.name("slip_velocity", name), at_rest=resting, candidates=stopped))
        return rows

    def _of_force(
        self, guard: str, mode: Mode, after: Mode, *, zeros: tuple[str, ...] = (), slips: bool = False
    ) -> Transition:
        """The row of a force of a contact that reaches the edge of what the ground can exert.

        Parameters
        ----------
        after : the mode in which this contact, and no other, slips or lifts, as a foot that stands alone does.
        slips : whether the contact then slips.
        """
        if not self.walker.stands_on_one():
            rests = _at_rest(mode)
            return self._row(guard, at_rest=rests, candidates=self._candidates(mode, rests), zeros=zeros)
        if after.contact in self._states:
            return self._row(guard, candidates=(after,), zeros=zeros, zeros_after=("slip_velocity",) if slips else ())
        if slips:
            return self._row(guard, ending=Ending.PAINLEVE, reason=CANNOT_SLIP)
        return self._row(guard, zeros=zeros)

    def _of_impact(self, mode: Mode, before: Mode) -> list[Transition]:
        """Rows of an impact of contacts, or of a stop; none if the state is continuous."""
        landing = [name for name in mode.touching if name not in before.touching]
        if not landing and (not mode.stops or mode.locked == before.locked):
            return []
        struck = self.walker.held_in_impact(mode, before)
        shares, massless = shares_of(self.walker, struck), self.walker.weightless()
        shared = {contact for share in shares for _, contact in share}
        rows = [self._row(self.name("touchdown_rate", name)) for name in landing]

        def other(name: str, *states: str) -> tuple[Mode, ...]:
            """Impacts that may replace this one: other states of a contact in which the walker can stand."""
            modes = (mode.with_states({name: state}) for state in states)
            return tuple(m for m in modes if len(m.touching) == 1 or not self.walker.stands_on_one())

        for name in (name for name in mode.contacts if name not in massless):
            if name in mode.touching and name not in shared:
                rows.append(self._row(self.name("impulse", name), candidates=other(name, OFF)))
            if name in mode.touching and mode.directions[name]:
                sticks, guards = other(name, AT_REST[0]), [self.name("impact_slip_velocity", name)]
                guards += [self.name("impact_onset", name)] if self._may_stick_too(mode, name, landing) else []
                rows += [self._row(guard, at_rest=(name,), candidates=sticks) for guard in guards]
            elif name in mode.touching and name not in shared:
                edges = ((self.name(f"impulse_{cone}", name), slip) for slip, cone in CONE.items())
                rows += [self._row(guard, candidates=other(name, slip)) for guard, slip in edges]
            elif name in before.touching and name not in mode.touching:
                rows.append(self._row(self.name("lift_velocity", name), candidates=other(name, *AT_REST[:-1])))
        rows += [self._row(impulse_name(share_name(share)), candidates=(mode,)) for share in shares]
        if mode.slips:
            rows.append(self._row(f"impact_{self.unique}"))
        if pushing := [name for name in self.walker.pushing() if landing and name in before.touching]:
            rows += [self._row(self.name(cone, name)) for name in pushing for cone in PUSH[:2]]
            rows += [self._row(self.name(PUSH[2], name)) for name in landing]
        order = [*IMPACT_MARGINS]
        return sorted(rows, key=lambda row: order.index(row.guard) if row.guard in order else -1)

    def _may_stick_too(self, mode: Mode, name: str, landing: Sequence[str]) -> bool:
        """Whether an impact may be consistent both with a slip of a contact and with sticking, which then comes first.

        If one coefficient and one law apply to both, an impact that slips cannot stick, and it needs no margin.
        """
        drops = self._friction.may_drop and len(mode.touching) == 1
        return drops or (self._law is ImpactLaw.FRICTIONLESS and name in landing)

    def _row(
        self,
        guard: str,
        *,
        ending: Ending | None = None,
        reason: str = "",
        reset: Reset | None = None,
        at_rest: tuple[str, ...] = (),
        candidates: tuple[Mode, ...] = (),
        zeros: tuple[str, ...] = (),
        zeros_after: tuple[str, ...] = (),
    ) -> Transition:
        """A row. If there are no candidates, the motion ends as the margin states by default."""
        facts = margin(guard)
        return Transition(
            guard=guard,
            margin=facts,
            ending=ending if ending is not None or candidates else facts.ending,
            reason=reason or facts.lost,
            reset=reset,
            at_rest=at_rest,
            candidates=candidates,
            zeros=() if guard == BREAKPOINT else (guard, *(name for name in zeros if name != guard)),
            zeros_after=zeros_after,
        )


def _at_rest(mode: Mode) -> tuple[str, ...]:
    """The contacts on the ground that stick."""
    return tuple(name for name in mode.touching if not mode.directions[name])


@lru_cache(maxsize=64)
def transitions(
    walker: type[Walker],
    friction: Friction | ContactFriction = COULOMB,
    law: ImpactLaw = ImpactLaw.COULOMB,
    cycle_end: str = TOUCHDOWN,
) -> Transitions:
    """The table of a walker under a friction law and a law of slipping impacts."""
    return Transitions(walker, friction, law, cycle_end)
