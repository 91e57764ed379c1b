"""The table of transitions of a walker with several contacts.

Margins are those of a stance foot, of one contact each: ``normal_force.left``. ``gap.left`` falls to zero where a
contact that is off lands. Contacts that stick together and share their forces have margins of their group, such as
``cone_forward.left+right``, in place of those of each. Any event may change the forces of all contacts at once, so that
the candidates are all modes of the contacts that touch: one that slips goes on or lifts, one at rest may do anything.
"""

from collections.abc import Iterable, Mapping
from itertools import product

from gaitopt.model.contact_set import shares_of
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.modes import OFF, Mode
from gaitopt.model.transitions import CONE, Reset, Transition, Transitions
from gaitopt.model.walker import Walker

AT_REST = ("stick", "slip_forward", "slip_backward", OFF)
"""What a contact at rest on the ground may do; sticking comes first."""


class ContactTransitions(Transitions):
    """The table of one walker with named contacts; attributes as of ``Transitions``."""

    def __init__(self, walker: type[Walker]) -> None:
        self.walker = walker
        self.modes = walker.modes()
        self.landed = self.modes
        self.unloaded = ()
        self._phases: dict[Mode, Mapping[str, Transition]] = {}
        self._impacts: dict[Mode, Mapping[str, Transition]] = {}

    @property
    def most_margins(self) -> int:
        """Three of each contact, and sums of those of contacts that share their forces."""
        n = len(self.walker.contacts)
        return 2 + 3 * n + n**2

    def at_rest(self, mode: Mode) -> tuple[Mode, ...]:
        """Candidates where the forces are decided anew and the contacts that stick are at rest."""
        return self._candidates(mode, at_rest=(name for name in mode.touching if not mode.directions[name]))

    def at_breakpoint(self, mode: Mode) -> Transition:
        """The transition at a breakpoint of the control law, as of ``Transitions``; a slipping contact may lift off."""
        rests = tuple(name for name in mode.touching if not mode.directions[name])
        return self._row(BREAKPOINT, at_rest=rests, candidates=self.at_rest(mode))

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
        shared = {contact for share in shares_of(self.walker, mode) for _, contact in share}
        for name in mode.contacts:
            direction = mode.directions[name]
            if name not in mode.touching:
                ends = name in self.walker.landing_contacts
                landed = self._candidates(mode, at_rest=rests, landing=name)
                rows.append(self._row(f"gap.{name}", reset=Reset(of=name, ends_step=ends), candidates=landed))
                continue
            if name not in shared:
                rows.append(self._row(f"normal_force.{name}", at_rest=rests, candidates=again))
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

    def _of_impact(self, mode: Mode) -> list[Transition]:
        return []

    def check(self, cycle: Cycle) -> None:
        """Check that events of the table lead through the phases of a cycle; raises as ``Transitions.check``."""
        raise NotImplementedError


def share_name(parts: tuple[tuple[str, str], ...]) -> str:
    """Name of the margin of a group: its kind once, if all parts have the same, and its contacts."""
    kinds = "+".join(dict.fromkeys(kind for kind, _ in parts))
    return f"{kinds}.{'+'.join(dict.fromkeys(contact for _, contact in parts))}"
