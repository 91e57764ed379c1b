"""The table of transitions of a walker with several contacts.

Margins are those of a stance foot, of one contact each: ``normal_force.left``. ``gap.left`` falls to zero where a
contact that is off lands. Contacts that stick together and share their forces have margins of their group, such as
``cone_forward.left+right``, in place of those of each. Any event may change the forces of all contacts at once, so that
the candidates are all modes of the contacts that touch: one that slips goes on or lifts, one at rest may do anything.
The event between two given modes follows from what changes:

    a contact lands                     gap             else    a slip ends or turns        slip_velocity
    else    a contact leaves            normal_force    else    a contact begins to slip    its cone

A step ends where a contact of ``Walker.landing_contacts`` lands, where a margin of ``Walker.sections`` falls to zero,
or with a period of the control law.
"""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import product

from gaitopt.model.contacts import shares_of
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.modes import FOOT, OFF, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.transitions import CONE, GROUND_FORCES, Reset, Transition, Transitions
from gaitopt.model.walker import Walker

AT_REST = ("stick", "slip_forward", "slip_backward", OFF)
"""What a contact at rest on the ground may do; sticking comes first."""
PRIORITY = ("gap", "slip_velocity", "normal_force", "cone_forward", "cone_backward")
"""Kinds of margins in the order in which they explain a change of modes."""


class ContactTransitions(Transitions):
    """The table of one walker with named contacts; for attributes see ``Transitions``.

    Parameters
    ----------
    walker : the class of the walker.
    cycle_end : what ends a cycle: ``touchdown``, ``clock`` or the name of a margin.
    """

    def __init__(self, walker: type[Walker], cycle_end: str = TOUCHDOWN) -> None:
        self.walker, self.cycle_end = walker, cycle_end
        self.modes = walker.modes()
        self.landed = self.modes
        self.unloaded = ()
        self._phases: dict[Mode, Mapping[str, Transition]] = {}
        self._impacts: dict[tuple[Mode, Mode | None], Mapping[str, Transition]] = {}
        self._breakpoints: dict[Mode, Transition] = {}
        self._checked: set[Cycle] = set()

    @property
    def most_margins(self) -> int:
        """Three of each contact, and sums of those of contacts that share their forces."""
        n = len(self.walker.contacts)
        return 3 + 3 * n + n**2

    def struck(self, cycle: Cycle, phase: int) -> Mode | None:
        """See ``Transitions``."""
        impact = cycle.reset_after(phase)
        relabelled = impact is not None and cycle.after(phase) is None and self.cycle_end == TOUCHDOWN
        return self.walker.swapped(impact) if impact is not None and relabelled else impact

    def between(self, mode: Mode, after: Mode | None, struck: Mode | None = None) -> Transition:
        """See ``Transitions``."""
        reached = [m for m in (after, struck) if m is not None]
        landed = [name for m in reached for name in m.touching if name not in mode.touching]
        if after is None and self.cycle_end == CLOCK:
            return self._row(CLOCK, reset=Reset(of=CLOCK, ends_step=True), candidates=(mode,))
        if after is None and self.cycle_end != TOUCHDOWN:
            return self.of(mode)[self.cycle_end]
        rows = self.of(mode)
        gaps = [rows[f"gap.{name}"] for name in landed if rows[f"gap.{name}"].ends_step is (after is None)]
        if gaps:
            return gaps[0]
        changed = set[tuple[str, str]]()
        for name, word in after.contacts.items() if after is not None and not landed else ():
            direction = mode.directions[name]
            if name in mode.touching and word != mode.contacts[name]:
                what = "normal_force" if word == OFF else "slip_velocity" if direction else CONE[Mode(word)]
                changed.add((what, name))
        found = [
            row
            for row in rows.values()
            if after in row.candidates and row.reset is None and changed & _parts(row.guard)
        ]
        if not found:
            words = "the end of a step" if after is None else after.brief
            raise ValueError(f"no event of the {self.walker.model} leads from {mode.brief} to {words}")

        def rank(row: Transition) -> tuple[int, int]:
            parts = _parts(row.guard)
            return min(PRIORITY.index(what) for what, _ in changed & parts), -2 * len(changed & parts) + len(parts)

        return min(found, key=rank)

    def zeros_after(self, cycle: Cycle, phase: int) -> tuple[str, ...]:
        """See ``Transitions``: the forces of massless contacts that have just landed."""
        struck = self.struck(cycle, phase)
        if struck is None:
            return ()
        landed = [name for name in struck.touching if name not in cycle.phases[phase].touching]
        landed = [name for name in landed if name in self.walker.massless_contacts]
        if cycle.after(phase) is None and self.cycle_end == TOUCHDOWN:
            exchanged = self.walker.exchanged_contacts
            partner = {**exchanged, **{other: one for one, other in exchanged.items()}}
            landed = [partner.get(name, name) for name in landed]
        following = self.of(cycle.phases[(phase + 1) % len(cycle.phases)])
        forces = (f"{force}.{name}" for name in landed for force in GROUND_FORCES)
        return tuple(name for name in forces if name in following)

    def held(self, mode: Mode, contact: str) -> tuple[Mode, str]:
        """See ``Transitions``; the margin may be that of a group to which the contact then belongs."""
        sticking, part = mode.with_states({contact: "stick"}), (CONE[Mode(mode.contacts[contact])], contact)
        return sticking, next(guard for guard in self.of(sticking) if part in _parts(guard))

    def check(self, cycle: Cycle) -> None:
        """Check that events of the table lead through the phases of a cycle; raises as ``Transitions.check``."""
        if cycle in self._checked:
            return
        model, known, massless = self.walker.model, {*self.modes}, self.walker.massless_contacts
        for mode in (*cycle.phases, *(impact for _, impact in cycle.resets)):
            if mode not in known:
                words = f"{', '.join(massless)} cannot slip" if massless else "it is not a state of its contacts"
                raise ValueError(f"the {model} has no mode {mode.brief}: {words}")
        for phase, mode in enumerate(cycle.phases):
            after, struck = cycle.after(phase), self.struck(cycle, phase)
            self.between(mode, after, struck)
            reset = cycle.reset_after(phase)
            following = cycle.phases[(phase + 1) % len(cycle.phases)]
            touching = mode.touching if reset is None else reset.touching
            foreign = [name for name in following.touching if name not in touching]
            if foreign:
                words = "in the impact before it" if reset is not None else f"in {mode.brief}"
                raise ValueError(f"{foreign[0]} touches the ground in {following.brief}, but not {words}")
        self._checked.add(cycle)

    def at_rest(self, mode: Mode) -> tuple[Mode, ...]:
        """Candidates where the forces are decided anew and the contacts that stick are at rest."""
        return self._candidates(mode, at_rest=(name for name in mode.touching if not mode.directions[name]))

    def onset(self, mode: Mode, contact: str = FOOT) -> Transition:
        """See ``Transitions``."""
        rests = tuple(name for name in mode.touching if not mode.directions[name] or name == contact)
        return self._row(f"onset.{contact}", at_rest=rests, candidates=self._candidates(mode, at_rest=rests))

    def at_breakpoint(self, mode: Mode) -> Transition:
        """The transition at a breakpoint of the control law, see ``Transitions``; a slipping contact may lift off."""
        if mode not in self._breakpoints:
            rests = tuple(name for name in mode.touching if not mode.directions[name])
            self._breakpoints[mode] = self._row(BREAKPOINT, at_rest=rests, candidates=self.at_rest(mode))
        return self._breakpoints[mode]

    def _candidates(self, mode: Mode, *, at_rest: Iterable[str], landing: str | None = None) -> tuple[Mode, ...]:
        """Modes of the contacts that touch; an impact may change the motion of all of them."""
        rests, massless = {*at_rest}, {*self.walker.massless_contacts}
        states = dict[str, tuple[str, ...]]()
        for name, word in mode.contacts.items():
            if name in massless:
                states[name] = ("stick", OFF) if name in mode.touching or name == landing else (OFF,)
            elif (landing is not None and (name in mode.touching or name == landing)) or name in rests:
                states[name] = AT_REST
            else:
                states[name] = (word, OFF) if name in mode.touching else (OFF,)
        return tuple(
            mode.with_contact(Mode.of_contacts(dict(zip(states, words, strict=True))))
            for words in product(*states.values())
        )

    def _of_phase(self, mode: Mode) -> list[Transition]:
        rests = tuple(name for name in mode.touching if not mode.directions[name])
        again = self._candidates(mode, at_rest=rests)
        rows = [self._row("upright")]
        if self.cycle_end not in (TOUCHDOWN, CLOCK):
            ends = Reset(of=self.cycle_end, ends_step=True)
            rows.append(self._row(self.cycle_end, reset=ends, candidates=(mode,)))
        shared = {contact for share in shares_of(self.walker, mode) for _, contact in share}
        for name in mode.contacts:
            direction = mode.directions[name]
            if name not in mode.touching:
                ends_step = name in self.walker.landing_contacts and self.cycle_end == TOUCHDOWN
                landed = self._candidates(mode, at_rest=rests, landing=name)
                rows.append(self._row(f"gap.{name}", reset=Reset(of=name, ends_step=ends_step), candidates=landed))
                continue
            if name not in shared:  # the forces of a massless contact vanish together
                vanish = GROUND_FORCES if name in self.walker.massless_contacts else ()
                zeros = tuple(f"{force}.{name}" for force in vanish)
                rows.append(self._row(f"normal_force.{name}", at_rest=rests, candidates=again, zeros=zeros))
            if not direction and name not in shared:
                rows += [self._row(f"{cone}.{name}", at_rest=rests, candidates=again) for cone in CONE.values()]
            if direction:
                stopped = self._candidates(mode, at_rest=(*rests, name))
                rows.append(self._row(f"slip_velocity.{name}", at_rest=(*rests, name), candidates=stopped))
        rows += [
            self._row(share_name(share), at_rest=rests, candidates=again) for share in shares_of(self.walker, mode)
        ]
        if mode.slips:
            rows.append(self._row("regularity"))
        return rows

    def _of_impact(self, mode: Mode, before: Mode | None) -> list[Transition]:
        """Margins of an impact, ``mode`` and ``before`` with the contacts as they are called before it.

        None where no contact lands, because the state is continuous there.
        """
        assert before is not None
        landing = [name for name in mode.touching if name not in before.touching]
        if not landing:
            return []
        shares, massless = shares_of(self.walker, mode), {*self.walker.massless_contacts}
        shared = {contact for share in shares for _, contact in share}
        rows = [self._row(f"touchdown_rate.{name}") for name in landing]

        def other(name: str, *words: str) -> tuple[Mode, ...]:
            return tuple(mode.with_states({name: word}) for word in words)

        for name in (name for name in mode.contacts if name not in massless):
            if name in mode.touching and name not in shared:
                rows.append(self._row(f"impulse.{name}", candidates=other(name, OFF)))
            if name in mode.touching and mode.directions[name]:
                rows.append(self._row(f"impact_slip_velocity.{name}", at_rest=(name,), candidates=other(name, "stick")))
            elif name in mode.touching and name not in shared:
                rows += [
                    self._row(f"impulse_{cone}.{name}", candidates=other(name, slip)) for slip, cone in CONE.items()
                ]
            elif name in before.touching and name not in mode.touching:
                rows.append(self._row(f"lift_velocity.{name}", candidates=other(name, *AT_REST[:-1])))
        rows += [self._row(impulse_name(share_name(share)), candidates=(mode,)) for share in shares]
        if mode.slips:
            rows.append(self._row("impact_regularity"))
        return rows


@lru_cache(maxsize=64)
def contact_transitions(walker: type[Walker], cycle_end: str = TOUCHDOWN) -> ContactTransitions:
    """The table of a walker with named contacts."""
    return ContactTransitions(walker, cycle_end)


def share_name(parts: tuple[tuple[str, str], ...]) -> str:
    """Name of the margin of a group: its kind once, if all parts have the same, and its contacts."""
    kinds = "+".join(dict.fromkeys(kind for kind, _ in parts))
    return f"{kinds}.{'+'.join(dict.fromkeys(contact for _, contact in parts))}"


def impulse_name(name: str) -> str:
    """Name of the margin of an impact that has impulses in place of the forces of a margin of a mode."""
    what, _, contacts = name.partition(".")
    kinds = ("impulse" if part == "normal_force" else f"impulse_{part}" for part in what.split("+"))
    return f"{'+'.join(kinds)}.{contacts}"


def _parts(guard: str) -> set[tuple[str, str]]:
    """Kinds and contacts of a margin of one contact, or of a group; not all pairs need to be parts of a group's."""
    kinds, _, contacts = guard.partition(".")
    return {(what, name) for what in kinds.split("+") for name in contacts.split("+")}
