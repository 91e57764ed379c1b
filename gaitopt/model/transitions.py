"""The hybrid automaton of a walker as a table: the margins of each mode, the events that end it, and the next modes.

    mode  --  margin falls to zero  --  reset  -->  one of the candidates, or the motion ends

Every margin is positive while its mode holds and is the guard of one transition. A margin of an impact likewise leads
to the impact, or the ending, that replaces it where the margin falls. At a breakpoint of the control law, whose guard
is the time, torques and contact forces may jump. The table contains facts only: the expressions of
the margins are in ``gaitopt.model.system``, and each method decides by itself which candidate is consistent: the
simulator from forces and impulses, the NLP by following a cycle, a branch by trying the candidates in turn. In the
same way a witness function stands beside its reset in Drake's compass gait (``examples/compass_gait``).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise

from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.friction import COULOMB, Friction, ImpactLaw
from gaitopt.model.modes import FOOT, NEXT_STATE, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.units import UNITS, Scales
from gaitopt.model.walker import Walker


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
    """Unit and words of a margin, the same for all walkers.

    Attributes
    ----------
    unit : natural unit, a key of ``gaitopt.model.units.UNITS``.
    violated : message about a negative value, which replaces ``{value}``; empty if it is judged together with others.
    lost : message about its fall to zero, in a motion or along a branch.
    absent : message about a phase that it should end, but in which it does not fall to zero.
    ending : how a motion ends where it falls to zero; None if a mode or an impact follows.
    rises : whether it is zero at the start of a step, so that only a fall after it has been positive counts.
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
    ends_step : whether the feet swap roles: the step ends, and time and x start from zero.
    """

    of: str
    ends_step: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """One row of the table.

    Attributes
    ----------
    guard : name of the margin whose fall to zero triggers the transition; ``breakpoint`` for a fixed time.
    margin : unit and words of the guard.
    ending : how the motion ends; None where a mode follows.
    reason : message about that.
    reset : the jump of the state; None if it is continuous.
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
    def ends_step(self) -> bool:
        """Whether the feet swap roles."""
        return self.reset is not None and self.reset.ends_step


FOOT_WORDS = r"\bthe (?:stance foot|slipping foot|foot|contact)\b(?! that)"
"""Words for the contact of a margin, which its name replaces."""
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
}
"""Margins of impacts, with impulses in place of forces."""

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
    lost="a stop locks, a switch triggers or the section is reached earlier in the step",
    absent="the stop does not lock, the switch does not trigger, or the section is not reached",
    rises=True,
)
"""The gap of any joint stop, and the margin of any switch or section."""
CONE: Mapping[Mode, str] = {Mode.SLIP_FORWARD: "cone_forward", Mode.SLIP_BACKWARD: "cone_backward"}
"""The margin of a sticking foot that falls to zero where each slip begins; for impacts ``impulse_`` precedes it."""
GROUND_FORCES = ("normal_force", "cone_forward", "cone_backward")
"""Margins from the force of the ground; for a massless foot all are zero where it lands and where it takes off."""
ONE_AT_A_TIME = "a step begins with all stops free and all switches off, and they change one at a time"
CANNOT_SLIP = "a massless foot cannot slip, and friction does not hold it"


def kind(name: str) -> str:
    """The margin of which that of a named contact is one: ``cone_forward`` of ``cone_forward.left``.

    That of a group with different ones is of the kind of its first part.
    """
    return name.partition(".")[0].partition("+")[0]


def contact_of(name: str) -> str:
    """The contact of a margin; ``foot`` where contacts have no names."""
    return name.partition(".")[2] or FOOT


def named(what: str, name: str) -> str:
    """A margin of another kind, of the contact of ``name``."""
    contact = name.partition(".")[2]
    return f"{what}.{contact}" if contact else what


@lru_cache(maxsize=256)
def margin(name: str) -> Margin:
    """Unit and words of a margin, which name its contact; those that ``MARGINS`` lacks are of stops and switches."""
    facts, contact = MARGINS.get(kind(name), STOP), name.partition(".")[2]
    if not contact:
        return facts
    lost, absent = (re.sub(FOOT_WORDS, f"the contact {contact}", words) for words in (facts.lost, facts.absent))
    return replace(facts, lost=lost, absent=absent)


def grounded(candidates: tuple[Mode, ...]) -> tuple[Mode, ...]:
    """The candidates in which the walker touches the ground."""
    return tuple(mode for mode in candidates if mode.touching)


def margin_unit(name: str, scales: Scales) -> float:
    """Natural unit of a margin in SI."""
    return UNITS[margin(name).unit][1](scales)


class Transitions:
    """The table of one walker; ``transitions`` builds it once.

    Parameters
    ----------
    walker : the class of the walker.
    friction : the friction law of its feet.
    law : tangential law of its slipping impacts.

    Attributes
    ----------
    modes : all modes of the walker.
    cycle_end : what ends a cycle; other than ``touchdown`` only where the contacts have names.
    landed : candidates after the impact that ends a step, with all stops free and all switches off.
    unloaded : margins that are zero where a foot lands and where it takes off: ``GROUND_FORCES`` of massless feet.
    """

    def __init__(self, walker: type[Walker], friction: Friction, law: ImpactLaw) -> None:
        self.walker, self._friction, self._law = walker, friction, law
        self.cycle_end = TOUCHDOWN
        self.modes = walker.modes()
        self.landed = tuple(walker.released(contact) for contact in grounded(walker.foot_modes()))
        self.unloaded = GROUND_FORCES if walker.massless_feet else ()
        self._phases: dict[Mode, Mapping[str, Transition]] = {}
        self._impacts: dict[tuple[Mode, Mode | None], Mapping[str, Transition]] = {}
        self._breakpoints: dict[Mode, Transition] = {}
        self._checked: set[Cycle] = set()

    def of(self, mode: Mode) -> Mapping[str, Transition]:
        """Transitions by their guards, in the order of ``HybridSystem.margins``."""
        if mode not in self._phases:
            self._phases[mode] = {row.guard: row for row in self._of_phase(mode)}
        return self._phases[mode]

    def of_impact(self, mode: Mode, before: Mode | None = None) -> Mapping[str, Transition]:
        """Transitions to what replaces an impact, by its margins in the order of ``HybridSystem.impact_margins``.

        Parameters
        ----------
        mode : just after the impact; without stops for the impact of the foot, with a locked stop for that of a stop.
        before : just before it; needed where the contacts have names.
        """
        if (mode, before) not in self._impacts:
            self._impacts[mode, before] = {row.guard: row for row in self._of_impact(mode, before)}
        return self._impacts[mode, before]

    @property
    def most_margins(self) -> int:
        """A bound of the number of margins of a mode."""
        return max(len(self.of(mode)) for mode in self.modes)

    def margin_names(self, mode: Mode) -> tuple[str, ...]:
        """Names of the margins of a mode, in the order of ``HybridSystem.margins``."""
        return tuple(self.of(mode))

    def impact_margin_names(self, mode: Mode, before: Mode | None = None) -> tuple[str, ...]:
        """Names of the margins of an impact, in the order of ``HybridSystem.impact_margins``."""
        return tuple(self.of_impact(mode, before))

    def struck(self, cycle: Cycle, phase: int) -> Mode | None:
        """The impact that ends a phase, with the contacts as they are called before it; None without an impact."""
        return cycle.reset_after(phase)

    def between(self, mode: Mode, after: Mode | None, struck: Mode | None = None) -> Transition:
        """The transition from ``mode`` to the next mode ``after`` of the step; None stands for the end of the step.

        Parameters
        ----------
        struck : see ``struck``; needed where the contacts have names.

        Raises
        ------
        ValueError
            If no event leads from one to the other.
        """
        leading = [row for row in self.of(mode).values() if row.ends_step is (after is None)]
        if after is not None:
            leading = [row for row in leading if after in row.candidates]
        if not leading:
            raise ValueError(f"no event of the {self.walker.model} leads from {mode} to {after}")
        return min(leading, key=lambda row: len(row.candidates))  # the event that distinguishes ``after`` best

    def at_breakpoint(self, mode: Mode) -> Transition:
        """The transition at a breakpoint of the control law, where the torques and with them the forces may jump.

        Its time is fixed, so that deviations pass it unchanged although the flow jumps. A foot at rest does what its
        forces demand; a slipping foot goes on slipping, or is lifted off; in flight nothing changes.
        """
        if mode not in self._breakpoints:
            flight = (mode.with_contact(Mode.FLIGHT),) if self.walker.flies and mode.slips else ()
            rests = (FOOT,) if mode.sticks else ()
            candidates = self.at_rest(mode) if rests else (mode, *flight)
            self._breakpoints[mode] = self._row(BREAKPOINT, at_rest=rests, candidates=candidates)
        return self._breakpoints[mode]

    def ending(self, cycle: Cycle, phase: int) -> Transition:
        """The transition that ends a phase of a cycle."""
        if phase in cycle.timed:
            return self.at_breakpoint(cycle.phases[phase])
        return self.between(cycle.phases[phase], cycle.after(phase), self.struck(cycle, phase))

    def zeros_after(self, cycle: Cycle, phase: int) -> tuple[str, ...]:
        """Margins of the next phase that are zero just after the event that ends a phase."""
        following = self.of(cycle.phases[(phase + 1) % len(cycle.phases)])
        return tuple(name for name in self.ending(cycle, phase).zeros_after if name in following)

    def held(self, mode: Mode, contact: str) -> tuple[Mode, str]:
        """The mode in which a contact that slips sticks instead, and its margin beyond which it slips so."""
        return Mode.STICK, CONE[mode.contact]

    def at_rest(self, mode: Mode) -> tuple[Mode, ...]:
        """Candidates for a foot at rest on the ground, with stops and switches as in ``mode``; stick first."""
        return tuple(mode.with_contact(contact) for contact in self.walker.foot_modes())

    def onset(self, mode: Mode, contact: str = FOOT) -> Transition:
        """The transition where static friction holds a contact at the start of a slip from rest."""
        return self._row("onset", at_rest=(FOOT,), candidates=self.at_rest(mode))

    def pull(self, mode: Mode) -> Transition:
        """The transition where a jump of the torques no longer lifts the foot out of a mode."""
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
        model, contacts = self.walker.model, self.walker.foot_modes()
        start = self.walker.released(Mode.STICK).stops
        for step in cycle.steps:
            for mode in (*step.phases, step.impact):
                if mode.contact not in contacts:
                    raise ValueError(f"the {model} has no {mode.contact}; its foot can {', '.join(contacts)}")
            for mode in step.phases:
                if [*mode.stops] != [*start] or any(mode.stops[k] not in (v, NEXT_STATE[v]) for k, v in start.items()):
                    form = "{" + ", ".join([f"mode: {mode.contact}", *(f"{k}: {v}" for k, v in start.items())]) + "}"
                    raise ValueError(
                        f"{mode} does not fit the stops of the {model}: write {form if start else mode.contact}"
                    )
            if not step.impact.touching:
                raise ValueError("after an impact the foot is on the ground: stick, slip_forward or slip_backward")
            if step.impact.stops:
                raise ValueError(f"write the impact {step.impact.contact}: the impact of the foot frees all stops")
            if self.walker.flies and step.phases[-1].touching:
                raise ValueError(f"the {model} lands after a flight: the last phase of a step must be flight")
            if step.phases[0].stops != start:
                raise ValueError(ONE_AT_A_TIME)
            for mode, after in pairwise(step.phases):
                changed = [name for name in start if after.stops[name] != mode.stops[name]]
                if len(changed) > 1 or any(after.stops[name] == start[name] for name in changed):
                    raise ValueError(ONE_AT_A_TIME)
                self.between(mode, after)
            if not any(row.ends_step for row in self.of(step.phases[-1]).values()):
                raise ValueError("all stops must lock before the foot comes down")
        self._checked.add(cycle)  # a problem is read again at every ``replace``

    def _of_phase(self, mode: Mode) -> list[Transition]:
        flight = (mode.with_contact(Mode.FLIGHT),) if self.walker.flies else ()
        lands = Reset(of=FOOT, ends_step=True)
        touchdown = self._row("touchdown", reset=lands, candidates=self.landed, zeros_after=self.unloaded)
        rows = [self._row("clearance") if mode.touching and mode.free else touchdown, self._row("upright")]
        if mode.touching:
            rows.append(self._row("normal_force", candidates=flight, zeros=self.unloaded))
        if mode.sticks:
            rows += [self._slips(name, mode.with_contact(slip)) for slip, name in CONE.items()]
        if mode.slips:
            rows += [self._row("slip_velocity", at_rest=(FOOT,), candidates=self.at_rest(mode)), self._row("painleve")]
        for stop in mode.free:  # the foot may stick, slip or leave the ground after the impact of the stop
            locked = mode.with_next(stop)
            candidates = self.at_rest(locked) if mode.touching else (locked,)
            rows.append(self._row(stop, reset=Reset(of=stop, ends_step=False), candidates=candidates))
        for switch in mode.off:  # forces may jump, so that a foot at rest may change its mode
            on, rests = mode.with_next(switch), (FOOT,) if mode.sticks else ()
            rows.append(self._row(switch, at_rest=rests, candidates=self.at_rest(on) if rests else (on,)))
        return rows

    def _of_impact(self, mode: Mode, before: Mode | None) -> list[Transition]:
        walker, of_stop, stick = self.walker, bool(mode.locked), mode.with_contact(Mode.STICK)
        if not mode.touching:
            return [self._row("lift_velocity")]
        rows = []
        if not walker.massless_feet:
            rows.append(self._row("impulse"))
        if not (of_stop or walker.flies or walker.massless_feet):
            rows.append(self._row("lift_velocity"))
        if not of_stop:
            rows.append(self._row("touchdown_rate"))
        if mode.sticks and not walker.massless_feet:
            rows += [self._slips(f"impulse_{name}", mode.with_contact(slip)) for slip, name in CONE.items()]
        if mode.slips:
            rows += [
                self._row("impact_slip_velocity", at_rest=(FOOT,), candidates=(stick,)),
                self._row("impact_painleve"),
            ]
        # with one coefficient and one law for both, this margin has the sign of the slip velocity
        if mode.slips and (self._friction.may_drop or (self._law is ImpactLaw.FRICTIONLESS and not of_stop)):
            rows.append(self._row("impact_onset", at_rest=(FOOT,), candidates=(stick,)))
        if walker.pushes and not of_stop:
            rows += map(self._row, PUSH)
        return rows

    def _slips(self, name: str, slip: Mode) -> Transition:
        if self.walker.massless_feet:
            return self._row(name, ending=Ending.PAINLEVE, reason=CANNOT_SLIP)
        return self._row(name, candidates=(slip,), zeros_after=("slip_velocity",))

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
        """A row; by default the motion ends, as the margin states, unless there are candidates."""
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


@lru_cache(maxsize=64)
def transitions(walker: type[Walker], friction: Friction = COULOMB, law: ImpactLaw = ImpactLaw.COULOMB) -> Transitions:
    """The table of a walker under a friction law and a law of slipping impacts."""
    return Transitions(walker, friction, law)
