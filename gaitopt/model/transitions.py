"""The hybrid automaton of a walker as a table: what each mode assumes, the events that end it, and what may follow.

    mode  --  margin falls to zero  --  reset  -->  one of the candidates, or the motion ends

Every margin of a mode is positive while the mode holds and is the guard of one transition. The same holds for an
impact: each of its margins says which other impact, or which ending, replaces it. The table holds facts alone. The
expressions of the margins are in ``gaitopt.model.system``, and every method decides for itself which candidate is
consistent: the simulator from forces and impulses, the NLP by obeying a cycle, a branch by trying them in turn.
Drake's compass gait (``examples/compass_gait``) keeps a witness function beside its reset in the same way.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise

from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.friction import COULOMB, Friction
from gaitopt.model.modes import FOOT, NEXT_STATE, Mode
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """What is known of a margin, whatever the walker.

    Attributes
    ----------
    unit : its natural unit, a key of ``gaitopt.model.units.UNITS``.
    violated : words for a negative value, which replaces ``{value}``; empty where it is judged together with others.
    lost : words for its fall to zero, in a motion or along a branch.
    absent : words for a phase that it should end, but in which it does not fall.
    ending : how a motion ends where it falls; None where a mode or an impact follows.
    rises : whether it is zero at the start of a step, so that it may fall only after it has been positive.
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
    ends_step : whether the feet swap roles: the step ends, and time and x are counted anew.
    """

    of: str
    ends_step: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """One row of the table.

    Attributes
    ----------
    guard : name of the margin whose fall to zero triggers the transition.
    margin : unit and words of the guard.
    ending : how the motion ends; None where a mode follows.
    reason : the same in words.
    reset : the jump of the state; None where it is continuous.
    at_rest : contacts whose slip velocity is zero afterwards; forces then decide between the candidates.
    candidates : modes that may follow. A single one follows in any case; of several, impulses decide at a reset.
    zeros : margins of the ended mode that are zero at the event.
    zeros_after : margins of the mode that follows which are zero just after the event.
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


NO_SLIP = "sticking needs no more friction than there is before touchdown, so that no slip sets in"

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
        absent="the foot does not come to rest before touchdown",
    ),
    "painleve": Margin(
        unit="mass",
        violated="apparent mass of the slipping foot is {value:.4g} kg, must be positive (Painleve)",
        lost="the slip has no unique solution: the apparent mass of the foot falls to zero",
        ending=Ending.PAINLEVE,
    ),
    "onset": Margin(
        unit="force",
        violated="static friction holds the foot: the force misses the edge of its cone by {value:.4g} N",
        lost="static friction holds the foot where the slip should start",
    ),
}
"""Margins of phases. ``touchdown`` is minus the walker's guard; ``cone_forward`` is mu f_n + f_t, ``cone_backward``
mu f_n - f_t; ``slip_velocity`` is the speed in the mode's direction; ``onset`` the force beyond the static cone where a
slip starts from rest, needed only where friction has two coefficients."""

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
        lost="the slip after the impact fades",
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

MARGINS: Mapping[str, Margin] = {**PHASE_MARGINS, **IMPACT_MARGINS}
STOP = Margin(
    unit="one",
    lost="the stop locks, or the switch is thrown, earlier in the step",
    absent="the stop does not lock, or the switch is not thrown",
    rises=True,
)
"""The gap of a joint stop, or the margin of a switch, under any name."""
CONE: Mapping[Mode, str] = {Mode.SLIP_FORWARD: "cone_forward", Mode.SLIP_BACKWARD: "cone_backward"}
"""The margin of a sticking foot that falls where each slip begins; that of an impact has ``impulse_`` before it."""
GROUND_FORCES = ("normal_force", "cone_forward", "cone_backward")
"""Forces of the ground; on a foot without mass all are zero where it lands and where it leaves the ground."""
CANNOT_SLIP = "a foot without mass cannot slip, and friction does not hold it"


def margin(name: str) -> Margin:
    """What is known of a margin; any name that is not in the tables is that of a stop or a switch."""
    return MARGINS.get(name, STOP)


def grounded(candidates: tuple[Mode, ...]) -> tuple[Mode, ...]:
    """Those of some candidates in which the walker touches the ground."""
    return tuple(mode for mode in candidates if mode.touching)


def margin_unit(name: str, scales: Scales) -> float:
    """Natural unit of a margin in SI."""
    return UNITS[margin(name).unit][1](scales)


class Transitions:
    """The table of one walker; use ``transitions``, which keeps it.

    Parameters
    ----------
    walker : the class of the walker.
    friction : the friction law of its feet.

    Attributes
    ----------
    modes : all modes of the walker.
    landed : candidates after the impact of the foot that ends a step, with all stops free and all switches off.
    unloaded : margins that are zero where a foot lands and where it leaves the ground: those of a foot without mass.
    """

    def __init__(self, walker: type[Walker], friction: Friction) -> None:
        self.walker, self._friction = walker, friction
        self.modes = walker.modes()
        self._ground = tuple(contact for contact in walker.contacts() if contact.touching)
        self.landed = tuple(walker.released(contact) for contact in self._ground)
        self.unloaded = GROUND_FORCES if walker.massless_feet else ()
        self._phases: dict[Mode, Mapping[str, Transition]] = {}
        self._impacts: dict[Mode, Mapping[str, Transition]] = {}

    def of(self, mode: Mode) -> Mapping[str, Transition]:
        """Transitions by their guards, in the order of ``HybridSystem.margins``."""
        if mode not in self._phases:
            self._phases[mode] = {row.guard: row for row in self._of_phase(mode)}
        return self._phases[mode]

    def of_impact(self, mode: Mode) -> Mapping[str, Transition]:
        """What replaces an impact where one of its margins falls, in the order of ``HybridSystem.impact_margins``.

        Parameters
        ----------
        mode : the walker just after it: a contact for the impact of the foot, a mode with a locked stop for its impact.
        """
        if mode not in self._impacts:
            self._impacts[mode] = {row.guard: row for row in self._of_impact(mode)}
        return self._impacts[mode]

    def margin_names(self, mode: Mode) -> tuple[str, ...]:
        """Names of the margins of a mode, in the order of ``HybridSystem.margins``."""
        return tuple(self.of(mode))

    def impact_margin_names(self, mode: Mode) -> tuple[str, ...]:
        """Names of the margins of an impact, in the order of ``HybridSystem.impact_margins``."""
        return tuple(self.of_impact(mode))

    def between(self, mode: Mode, after: Mode | None) -> Transition:
        """The transition that ends a phase in ``mode`` which is followed by ``after`` (None: the end of the step).

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
        return min(leading, key=lambda row: len(row.candidates))  # the event that leads to little else

    def at_rest(self, mode: Mode) -> tuple[Mode, ...]:
        """Candidates where the foot is at rest on the ground, with stops and switches as in ``mode``; stick first."""
        return tuple(mode.with_contact(contact) for contact in self.walker.contacts())

    def onset(self, mode: Mode) -> Transition:
        """What follows where static friction holds the foot after all at the start of a slip from rest."""
        return self._row("onset", at_rest=(FOOT,), candidates=self.at_rest(mode))

    def check(self, cycle: Cycle) -> None:
        """Check that the walker can go through the phases of a cycle.

        Raises
        ------
        ValueError
            If not; the message says what the walker can do.
        """
        for step in cycle.steps:
            self._check_contacts(step)
            self._check_stops(step)

    def _of_phase(self, mode: Mode) -> list[Transition]:
        takes_off = (mode.with_contact(Mode.FLIGHT),) if self.walker.flies else ()
        lands = Reset(of=FOOT, ends_step=True)
        touchdown = self._row("touchdown", reset=lands, candidates=self.landed, zeros_after=self.unloaded)
        upright = self._row("upright")
        states = [*(self._locks(mode, stop) for stop in mode.free), *(self._switches(mode, name) for name in mode.off)]
        if not mode.touching:
            return [touchdown, upright, *states]
        force = self._row("normal_force", candidates=takes_off, zeros=self.unloaded)
        if mode.sticks:
            contact = [self._slips(name, mode.with_contact(slip)) for slip, name in CONE.items()]
        else:
            rest = self._row("slip_velocity", at_rest=(FOOT,), candidates=self.at_rest(mode))
            contact = [rest, self._row("painleve")]
        return [self._row("clearance") if mode.free else touchdown, upright, force, *contact, *states]

    def _of_impact(self, mode: Mode) -> list[Transition]:
        walker, of_stop = self.walker, bool(mode.locked)
        if not mode.touching:
            return [self._row("lift_velocity")]
        if walker.massless_feet:
            rows = [self._row("touchdown_rate")]
        else:
            lifts = () if walker.flies else (self._row("lift_velocity"),)
            rows = [self._row("impulse"), *(() if of_stop else (*lifts, self._row("touchdown_rate")))]
            if mode.sticks:
                rows += [self._slips(f"impulse_{name}", mode.with_contact(slip)) for slip, name in CONE.items()]
            else:
                stick = mode.with_contact(Mode.STICK)
                faded = [
                    self._row(name, at_rest=(FOOT,), candidates=(stick,))
                    for name in ("impact_slip_velocity", "impact_onset")
                ]
                rows += [faded[0], self._row("impact_painleve"), *(faded[1:] if self._friction.may_drop else [])]
        return [*rows, *(self._row(name) for name in PUSH if walker.pushes and not of_stop)]

    def _slips(self, name: str, slip: Mode) -> Transition:
        if self.walker.massless_feet:
            return self._row(name, ending=Ending.PAINLEVE, reason=CANNOT_SLIP)
        return self._row(name, candidates=(slip,), zeros_after=("slip_velocity",))

    def _locks(self, mode: Mode, stop: str) -> Transition:
        """A stop locks with an impact, which may also make the foot slip or lift it off the ground."""
        locked = mode.with_next(stop)
        candidates = self.at_rest(locked) if mode.touching else (locked,)
        return self._row(stop, reset=Reset(of=stop, ends_step=False), candidates=candidates)

    def _switches(self, mode: Mode, switch: str) -> Transition:
        """Forces may jump where a switch is thrown, so that the mode of a foot at rest is decided again."""
        on = mode.with_next(switch)
        if mode.sticks:
            return self._row(switch, at_rest=(FOOT,), candidates=self.at_rest(on))
        return self._row(switch, candidates=(on,))

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
        """A row with the ending and the words of its margin, unless a mode follows or others are given."""
        known = margin(guard)
        return Transition(
            guard=guard,
            margin=known,
            ending=ending if ending is not None or candidates else known.ending,
            reason=reason or known.lost,
            reset=reset,
            at_rest=at_rest,
            candidates=candidates,
            zeros=(guard, *(name for name in zeros if name != guard)),
            zeros_after=zeros_after,
        )

    def _check_contacts(self, step: ModeSequence) -> None:
        """Check what the foot does; the step of a walker that flies ends out of flight."""
        model, allowed = self.walker.model, self.walker.contacts()
        for mode in (*step.phases, step.impact):
            if mode.contact not in allowed:
                raise ValueError(f"the {model} has no {mode.contact}: its foot can {', '.join(allowed)}")
        if not step.impact.touching:
            raise ValueError("after an impact the foot is on the ground: stick, slip_forward or slip_backward")
        if self.walker.flies and step.phases[-1].touching:
            raise ValueError(f"the {model} lands out of flight: the last phase of a step must be flight")

    def _check_stops(self, step: ModeSequence) -> None:
        """Check that stops lock and switches are thrown one after the other, by events of the table."""
        start = self.walker.released(Mode.STICK).stops
        stops = tuple(start)
        for mode in step.phases:
            if tuple(mode.stops) != stops or any(mode.stops[k] not in (v, NEXT_STATE[v]) for k, v in start.items()):
                form = "{" + ", ".join([f"mode: {mode.contact}", *(f"{k}: {v}" for k, v in start.items())]) + "}"
                raise ValueError(
                    f"{mode} must be written {form if stops else mode.contact}, as the walker has its stops"
                )
        if step.phases[0].stops != start:
            raise ValueError(ONE_AT_A_TIME)
        for mode, after in pairwise(step.phases):
            changed = [name for name in stops if after.stops[name] != mode.stops[name]]
            if len(changed) > 1 or any(after.stops[name] == start[name] for name in changed):
                raise ValueError(ONE_AT_A_TIME)
            self.between(mode, after)
        if not any(row.ends_step for row in self.of(step.phases[-1]).values()):
            raise ValueError("all stops lock before the foot comes down")
        if step.impact.stops:
            raise ValueError(f"the impact is written {step.impact.contact}: that of the foot frees all stops")


ONE_AT_A_TIME = "a step begins with all stops free and all switches off, and they change one at a time"


@lru_cache(maxsize=64)
def transitions(walker: type[Walker], friction: Friction = COULOMB) -> Transitions:
    """The table of a walker under a friction law."""
    return Transitions(walker, friction)
