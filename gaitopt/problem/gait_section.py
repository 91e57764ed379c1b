"""The section ``gait`` of a problem file: phases and impacts of a cycle, what ends it, and its first guess.

The guess of a gait is a state on the section just after the impact. The section determines the values that the file
leaves out (both feet on the ground, x = 0, and dx = 0 unless the impact slips), and values in the file must agree with
it. A problem without a gait states where its simulation starts.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gaitopt.errors import ProblemError
from gaitopt.model.checks import before_impact, section_posture, stepping_posture, swing_foot
from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.declaration import is_default, parameter_values
from gaitopt.model.modes import FEET, IMPACT, LEAVES, NAMED, OFF, STOP_STATES, SWAPPED, SWITCH_STATES, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN, has_stated_sections, section_of
from gaitopt.model.transitions import transitions
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key, SectionReader, near_miss, shown
from gaitopt.problem.schema import (
    OPEN,
    CycleSection,
    FirstGuessSection,
    GaitSection,
    GuessSection,
    OpenGaitSection,
    StepSection,
    state_section,
)
from gaitopt.problem.statement import Guess, OpenSequence

UNEVEN = "{} steps do not return to the first stance leg: where the legs differ, a cycle has 2, 4, ... steps"
GUESSED_SLIP = 0.1
"""Guessed velocity of a foot that slips just after the impact, relative to the speed of the walker."""
STATED_TOLERANCE = 1e-5
"""Relative tolerance within which values in a file must agree with the section; a state that is written with six digits
may be off by half of this."""
SOLVED_TOLERANCE = 1e-12
"""Rounding of coordinates that are solved from the section, relative, or in rad and SI units."""
SELECTING_TOLERANCE = 0.5
"""Largest difference between a coordinate in a file and its value on the section of a walker with several contacts,
relative, or in rad and SI units. The file's value only selects one of the solutions; a solution with exchanged legs, or
with a knee bent to the other side, is farther away."""


class GaitReader(SectionReader):
    """Reads the modes of a gait and the state from which it is sought; or where a simulation starts.

    Parameters
    ----------
    data, faults : see ``SectionReader``.
    model, walker, control : class of the walker, the walker and its control law; None if they have faults.
    laws : friction of the contacts by name; empty if all have the same, or if it has faults.
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        faults: list[Fault],
        model: type[Walker] | None,
        walker: Walker | None,
        control: Control | None,
        laws: Mapping[str, Any],
    ) -> None:
        super().__init__(data, faults)
        self._model, self._walker, self._control, self._laws = model, walker, control, laws
        self._cycle_end = TOUCHDOWN

    def read(self) -> tuple[Cycle | OpenSequence | None, Guess | None, str]:
        """The mode sequence, the guess, and what ends a cycle; None if they have faults."""
        if "gait" in self._data:
            return *self._read_gait(), self._cycle_end
        start = self._read_start()
        self._check_swapped(2)
        return OpenSequence(stated=False), start, self._cycle_end

    @property
    def _name(self) -> str:
        """The name of the walker in messages."""
        return "walker" if self._model is None else self._model.model

    def _check_swapped(self, steps: int) -> None:
        """Check that contacts that swap roles at the end of a step have the same friction, unless they swap back.

        So do two parameters of a control law that take each other's values.

        Parameters
        ----------
        steps : number of steps of the cycle.
        """
        model, within = self._model, self._cycle_end != TOUCHDOWN
        swapping = model.partners().items() if model is not None and model.step_ends() and self._laws else ()
        for name, other in swapping:
            ours, theirs = self._laws[name], self._laws[other]
            if isinstance(ours, float) != isinstance(theirs, float):
                remedy = "give both one number, or both static and kinetic friction"
            elif ours != theirs and (within or steps % 2):
                remedy = "give both the same" + ("" if within else ", or state the phases of 2, 4, ... steps")
            else:
                continue
            difference = f"differs from that of {other}, with which it swaps places after every step"
            self._fault(("friction", name), f"{difference}: {remedy}")
        if self._control is not None and self._control.exchanged and (within or steps % 2):
            key = next(iter(self._control.exchanged.values())).partition(".")[0]
            reason = "is not possible, since a cycle does not end with a landing: leave it out"
            if not within:
                reason = "applies in every second step: state the phases of 2, 4, ... steps"
            self._fault(("control", key), reason)

    @property
    def _legs_differ(self) -> bool:
        """Whether parameters of walker, friction or control take other values in every second step."""
        partners = {} if self._model is None else self._model.partners()
        of_contacts = any(self._laws[name] != self._laws[other] for name, other in partners.items() if self._laws)
        of_walker = self._model is not None and self._model.steps_per_cycle() > 1
        return of_walker or of_contacts or (self._control is not None and bool(self._control.exchanged))

    def _read_gait(self) -> tuple[Cycle | OpenSequence | None, Guess | None]:
        """The mode sequence and the guess of the section ``gait``."""
        data, landings, n_faults = self._data["gait"], list[tuple[tuple[int, Mode], ...]](), len(self._faults)
        kind: type[OpenGaitSection | CycleSection | GaitSection] = GaitSection
        if isinstance(data, Mapping):
            kind = OpenGaitSection if data.get("phases") == OPEN else CycleSection if "steps" in data else GaitSection
            data, landings = self._with_modes(self._model or Walker, data, is_open=kind is OpenGaitSection)
        has_modes = len(self._faults) == n_faults
        gait = self._section(kind, data, ("gait",))
        if gait is None or not has_modes:
            return None, None
        self._cycle_end = self._read_cycle_end(gait.section)
        if isinstance(gait, OpenGaitSection):
            return self._read_open_gait(gait)
        steps = gait.steps if isinstance(gait, CycleSection) else (gait,)
        cycle = self._read_cycle(steps, ("gait", "steps" if kind is CycleSection else "phases"), landings)
        self._check_swapped(len(steps))
        if {*FirstGuessSection.model_fields} & {*gait.guess}:
            return cycle, self._read_first_guess(gait.guess, steps)
        path, phases = ("gait", "guess"), [mode for step in steps for mode in step.phases]
        guess = self._section(GuessSection, gait.guess, path)
        if guess is None:
            return cycle, None
        if guess.durations is not None and len(guess.durations) != len(phases):
            needed = f"one duration per phase ({', '.join(phases)})"
            message = f"{len(guess.durations)} given, but the gait needs {needed}; or leave durations out"
            self._fault((*path, "durations"), message)
        if self._has_stated_section:
            state = self._read_state(guess.state, steps[-1].impact)
        else:
            state = self._read_nearby_state(guess.state, cycle)
        return cycle, None if state is None else Guess(state=state, durations=guess.durations)

    @property
    def _has_stated_section(self) -> bool:
        """Whether the class of the walker states the section with which the cycle ends."""
        return self._model is None or has_stated_sections(self._model, self._cycle_end)

    def _read_start(self) -> Guess | None:
        """The state from which a simulation starts.

        If the control law has a clock of its own, the clock ends a cycle.
        """
        if self._control is not None and not self._control.restarts and self._control.period:
            self._cycle_end = CLOCK
        model, path = self._model, ("state",)
        if "state" not in self._data or model is None:
            return None
        data = self._data["state"]
        stated_values = self._stated_state(model, data, path)
        if stated_values is None:
            return None
        given, missing = stated_values
        if not missing:
            return Guess(state=given, durations=None, whole=True)
        impact = Mode.slip(given["dx"]) if given.get("dx") else Mode.STICK
        section = model.section_names(slipping=impact.slips) if self._has_stated_section else ()
        if section and {*data} == {*section}:
            lifted = self._read_state(data, impact, path)
            return None if lifted is None else Guess(state=lifted, durations=None)
        choice = f" just after an impact give {', '.join(section)} alone; else" if section else ""
        names = ", ".join(name for name in model.state_names() if name != "x")
        self._fault((*path, missing[0]), f"is missing;{choice} a state needs {names}")
        return None

    def _read_first_guess(self, data: Mapping[str, Any], steps: Sequence[StepSection]) -> Guess | None:
        """A guess that follows from postures, between which the shape changes linearly, or from the step length."""
        path, model, walker = ("gait", "guess"), self._model, self._walker
        section = self._section(FirstGuessSection, data, path)
        if section is None or model is None or walker is None or not all(step.phases for step in steps):
            return None
        n_faults, impact = len(self._faults), steps[-1].impact
        self._faults += [Fault((*path, *keys), message) for keys, message in section.faults(model)]
        if len(self._faults) > n_faults:
            return None
        p = parameter_values(walker)
        try:
            if section.step_length is not None:
                first = stepping_posture(model, section.step_length, p)
                postures = [first, before_impact(model, first, p)]
            else:
                postures = [np.array([posture[name] for name in model.shape]) for posture in section.postures or ()]
        except ProblemError as error:
            self._fault((*path, "step_length"), str(error))
            return None
        lead = swing_foot(model, postures[0], p)[0]
        if lead >= 0:
            crossed = f"have crossed feet: the foot that swings first is {lead:.3g} m in front of the other one"
            self._fault((*path, "postures"), f"{crossed} just after the impact; it must be behind")
            return None
        rates = (postures[1] - postures[0]) * (len(postures) - 1) / section.duration
        values = dict(zip(model.shape, postures[0].tolist(), strict=True))
        values |= {f"d{name}": float(rate) for name, rate in zip(model.shape, rates, strict=True)}
        values["dx"] = GUESSED_SLIP * impact.direction * -lead / section.duration
        names = model.section_names(slipping=impact.slips)
        state = self._read_state({name: values[name] for name in names}, impact)
        durations = tuple(section.duration / len(step.phases) for step in steps for _ in step.phases)
        return None if state is None else Guess(state=state, durations=durations, first=section)

    def _with_modes(
        self, model: type[Walker], data: Mapping[str, Any], *, is_open: bool
    ) -> tuple[dict[str, Any], list[tuple[tuple[int, Mode], ...]]]:
        """The data of a gait with modes in place of their texts, and the impacts within every step.

        A phase that begins with the landing of a contact, or the lock of a stop, may state the mode just after that
        impact: ``{mode: stick, impact: stick}``. A landing after which the feet swap roles ends a step. If something
        else ends the cycle, such landings are stated within it, except those after a flight; of named contacts with
        the names that they have then, as in ``impact: {heel: stick, toe: leaves, feet: swapped}``.
        """
        is_step, alone = is_open or "steps" not in data, bool(model.base_contact())
        stated, step_ends = [data] if is_step else data["steps"], {*model.step_ends()}
        ends_in_landing = bool(step_ends) and data.get("section", TOUCHDOWN) == TOUCHDOWN
        if not isinstance(stated, list | tuple):
            return dict(data), []  # the section of the gait reports it, as it does wrong steps
        steps, landings = list[Any](), list[tuple[tuple[int, Mode], ...]]()
        for number, step in enumerate(stated):
            step_path: Key = ("gait",) if is_step else ("gait", "steps", number)
            final = step.get("impact") if isinstance(step, Mapping) else None
            if final is not None:
                final = self._mode(model, final, (*step_path, "impact"), after_impact=is_open or ends_in_landing)
                step = {**step, "impact": final}
            if not isinstance(step, Mapping) or not isinstance(step.get("phases"), list | tuple):
                steps.append(step)
                landings.append(())
                continue
            modes, struck = list[Mode](), list[tuple[int, Mode]]()
            for k, phase in enumerate(step["phases"]):
                entry, path = dict(phase) if isinstance(phase, Mapping) else phase, (*step_path, "phases", k)
                impact = entry.pop(IMPACT, None) if isinstance(entry, dict) else None
                modes.append(self._mode(model, entry, path))
                before, after, states_swap = modes[k - 1] if k else modes[k], modes[k], False
                if impact is not None:
                    if isinstance(impact, Mapping) and impact.get(FEET) == SWAPPED:
                        states_swap, impact = True, {name: word for name, word in impact.items() if name != FEET}
                    after = self._mode(model, impact, (*path, IMPACT), after_impact=True)
                locks, on_ground = {*modes[k].locked} - {*before.locked}, {*before.touching}
                landed = {*after.touching} - on_ground
                others = landed - step_ends - {model.base_contact()}
                may_swap = not locks and ({*model.swapped(after).touching} - on_ground) & step_ends
                swaps = states_swap or bool(k and may_swap and (landed or impact is not None) and not others)
                if states_swap and not (k and may_swap):
                    self._fault((*path, IMPACT, FEET), "no foot lands with which they would swap: leave it out")
                elif impact is not None and not (k and (landed or swaps or locks)):
                    reason = "no contact lands and no stop locks" if k else "the step begins there"
                    self._fault((*path, IMPACT), f"{reason}: leave it out")
                elif swaps and ends_in_landing and impact is not None:
                    self._fault((*path, IMPACT), f"the landing of the {self._name} ends its step: leave it out")
                if swaps and not ends_in_landing:
                    struck.append((k, after.swapping))
                elif k and not alone and (landed or locks):
                    struck.append((k, Mode.of(after, modes[k].stops)))
            if not ends_in_landing and modes:
                if final not in (None, modes[-1].contact):
                    self._fault((*step_path, "impact"), "the cycle ends without an impact: leave it out")
                final = modes[-1].contact
            steps.append({**step, "phases": modes} | ({} if final is None else {"impact": final}))
            landings.append(tuple(struck))
        return ({**data, **steps[0]} if is_step and steps else {**data, "steps": steps}), landings

    def _mode(self, model: type[Walker], entry: Any, path: Key, *, after_impact: bool = False) -> Mode:
        """The mode that an entry states.

        Parameters
        ----------
        entry : a word or a mapping of contacts; with stops or switches, a mapping that has one of these under ``mode``.
        path : path of the entry.
        after_impact : whether it is the mode just after an impact, in which contacts may leave the ground.
        """
        devices, nothing, contacts = dict[str, str](), model.foot_modes()[-1], model.landing_points()
        if isinstance(entry, Mode):
            return entry
        if isinstance(entry, Mapping) and "mode" in entry and "mode" not in contacts:
            devices = {name: state for name, state in entry.items() if name != "mode"}
            choices: Mapping[str, tuple[str, ...]] = dict.fromkeys(model.stops, STOP_STATES) | dict.fromkeys(
                model.switches, SWITCH_STATES
            )
            for name, state in devices.items():
                if state not in choices.get(name, ()):
                    allowed = " or ".join(choices.get(name, ())) or f"no stop or switch of the {self._name}"
                    self._fault((*path, name), f"{shown(state)} is not possible: {allowed}")
                    return nothing
            entry, path = entry["mode"], (*path, "mode")
        if not isinstance(entry, Mapping):
            modes = model.mode_words(after_impact=after_impact)
            if entry in modes:
                return Mode.of(entry, devices)
            remedy = near_miss(entry, modes) if modes else f" a mapping of contacts: {', '.join(contacts)}"
            self._fault(path, f"{shown(entry)} is not{' one of the choices' * bool(modes)}{remedy}")
            return nothing
        states = (*NAMED, LEAVES) if after_impact else (*NAMED,)
        for name, state in entry.items():
            if name not in contacts:
                self._fault((*path, name), f"is not a contact of the {self._name}{near_miss(name, contacts)}")
            elif state not in states:
                self._fault((*path, name), f"{shown(state)} is not what a contact does: {', '.join(states)}")
        known = {name: entry.get(name, OFF) for name in contacts}
        contact = model.contact_mode({n: s if isinstance(s, str) and s in NAMED else OFF for n, s in known.items()})
        return Mode.of(contact, devices)

    def _read_cycle_end(self, section: Any) -> str:
        """What ends a cycle: ``touchdown``, ``clock`` or the name of a margin."""
        model, path = self._model, ("gait", "section")
        end: str = section if isinstance(section, str) else section.margin
        if model is None or end == TOUCHDOWN:
            if model is not None and not model.step_ends():
                remedy = "write section: clock, or section: {margin: NAME}; to simulate it alone, leave gait out"
                self._fault(path, f"the {model.model} has no landing contacts: {remedy}")
            return TOUCHDOWN
        if model.exchanged:
            reason = f"the legs of the {model.model} differ, and would swap their roles within a cycle"
            self._fault(path, f"{shown(end)} is not possible: {reason}; leave it out")
            return TOUCHDOWN
        if end == CLOCK and (self._control is None or not self._control.period):
            self._fault(path, "clock needs a control law with a period of its own, such as oscillating")
        elif end != CLOCK and end not in model.sections:
            known = ", ".join(model.sections) or "none"
            self._fault((*path, "margin"), f"the {model.model} has no section {shown(end)}; there are: {known}")
            return CLOCK
        return end

    def _read_nearby_state(self, data: Mapping[str, Any], cycle: Cycle | None) -> dict[str, float] | None:
        """The state near the values that the file gives, on a section that the class does not state."""
        model, walker, path = self._model, self._walker, ("gait", "guess", "state")
        stated = None if model is None else self._section(state_section(model), data, path)
        if model is None or walker is None or stated is None or cycle is None:
            return None
        if any("phases" in fault.path or "impact" in fault.path for fault in self._faults):
            return None  # the section follows from the modes
        given = stated.model_dump(exclude_none=True)
        try:
            section = section_of(model, cycle.phases[-1], cycle.impact, self._cycle_end)
        except (ProblemError, KeyError) as error:
            self._fault(("gait",), str(error))
            return None
        missing = [name for name in section.names if name not in given]
        for name in missing:
            self._fault(
                (*path, name), f"is missing; at the end of this cycle the section is {', '.join(section.names)}"
            )
        if missing:
            return None
        names = model.state_names()
        near = np.array([given.get(name, model.posture.get(name, 0.0)) for name in names])
        p = parameter_values(walker)
        z = section.lift(near[section.indices], p, near)
        if not np.isfinite(z).all():
            values = {name: given[name] for name in section.names} | walker.model_dump(include={"energy"})
            stated_values = ", ".join(f"{name} = {value:g}" for name, value in values.items())
            others = ", ".join(name for name in names if name not in section.names)
            remedy = f"change these values, or give guesses of the others, {others}"
            self._fault(path, f"no state of the section has {stated_values}; {remedy}")
            return None
        state = dict(zip(names, z.tolist(), strict=True))
        for name, value in given.items():
            if math.isclose(value, state[name], rel_tol=SOLVED_TOLERANCE, abs_tol=SOLVED_TOLERANCE):
                state[name] = value  # so that a problem and its record are the same to the last bit
            is_coordinate = name in model.coordinates()
            if is_coordinate and not math.isclose(
                value, state[name], rel_tol=SELECTING_TOLERANCE, abs_tol=SELECTING_TOLERANCE
            ):
                conflict = f"{value:g} contradicts the section, where it is {state[name]:.9g} next to the given values"
                where = f"a cycle ends with {section.contacts_after}, with these contacts on the ground"
                remedy = "to simulate from any state leave gait out, and give state and until"
                self._fault((*path, name), f"{conflict}: {where}; {remedy}")
        return state

    def _read_open_gait(self, gait: OpenGaitSection) -> tuple[OpenSequence | None, Guess | None]:
        """The open mode sequence of a gait, and its guess, in which a slip velocity that is left out is zero."""
        path: Key = ("gait", "guess")
        if gait.impact is not None and self._cycle_end != TOUCHDOWN:
            self._fault(("gait", "impact"), "the cycle ends without an impact: leave it out")
            return None, None
        fewest_steps = 2 if self._legs_differ else 1
        sequence = OpenSequence(impact=gait.impact, steps=max(gait.steps, fewest_steps))
        self._check_swapped(fewest_steps)
        if "steps" in gait.model_fields_set and gait.steps < fewest_steps:
            self._fault(("gait", "steps"), UNEVEN.format(gait.steps))
        if gait.guess is not None and {*FirstGuessSection.model_fields} & {*gait.guess}:
            self._fault(path, "with phases: auto the guess is a state; state the phases, or leave the guess out")
            return sequence, None
        guess = None if gait.guess is None else self._section(GuessSection, gait.guess, path)
        if guess is None or self._model is None:
            return sequence, None
        if not self._has_stated_section:
            stated = self._stated_state(self._model, guess.state, (*path, "state"))
            for name in () if stated is None else stated[1][:1]:
                needed = ", ".join(self._model.state_names())
                self._fault((*path, "state", name), f"is missing; where the modes are open, the state needs {needed}")
            return sequence, None if stated is None or stated[1] else Guess(state=stated[0], durations=None)
        if guess.durations is not None:
            self._fault((*path, "durations"), "the phases are open: leave the durations out")
        slip = guess.state.get("dx", 0.0)
        impact = Mode.slip(slip) if isinstance(slip, int | float) and slip else Mode.STICK
        state = self._read_state(guess.state, impact)
        return sequence, None if state is None else Guess(state=state, durations=None)

    def _stated_state(self, model: type[Walker], data: Any, path: Key) -> tuple[dict[str, float], list[str]] | None:
        """The values of a state in the order of its names, in which x may be left out, and the names that it lacks."""
        state = self._section(state_section(model), data, path)
        if state is None:
            return None
        given, names = {"x": 0.0, **state.model_dump(exclude_none=True)}, model.state_names()
        known = {name: float(given[name]) for name in names if name in given}
        return known, [name for name in names if name not in known]

    def _read_cycle(
        self, steps: Sequence[StepSection], path: Key, landings: Sequence[tuple[tuple[int, Mode], ...]] = ()
    ) -> Cycle | None:
        struck = landings or [()] * len(steps)
        try:
            cycle = Cycle(
                tuple(
                    ModeSequence(phases=step.phases, impact=step.impact, landings=of_step)
                    for step, of_step in zip(steps, struck, strict=True)
                )
            )
            if self._model is not None:
                if self._cycle_end == TOUCHDOWN and len(steps) % self._model.steps_per_cycle():
                    raise ValueError(UNEVEN.format(len(steps)))
                if not any(fault.path[0] == "gait" for fault in self._faults):  # the end of the cycle may be at fault
                    transitions(self._model, cycle_end=self._cycle_end).check(cycle)
            return cycle
        except ValueError as error:
            self._fault(path, str(error))
            return None

    def _read_state(
        self, data: Mapping[str, Any], impact: Mode, path: Key = ("gait", "guess", "state")
    ) -> dict[str, float] | None:
        """The complete state, in the order of the walker's state names."""
        model, walker = self._model, self._walker
        section = None if model is None else self._section(state_section(model), data, path)
        if model is None or section is None:
            return None
        given = section.model_dump(exclude_none=True)
        needed = model.section_names(slipping=impact.slips)
        missing = [name for name in needed if name not in given]
        for name in missing:
            self._fault((*path, name), f"is missing; after this impact the section is {', '.join(needed)}")
        dx = given.get("dx", 0.0)
        if "dx" not in missing and math.copysign(1.0, dx) * (dx != 0) != impact.direction:
            sign = {0: "= 0 (leave it out)", 1: "> 0", -1: "< 0"}[impact.direction]
            self._fault((*path, "dx"), f"{shown(dx)} contradicts the impact: after {impact} it is {sign}")
        if missing or walker is None:
            return None
        p = parameter_values(walker)
        posture = map(float, np.concatenate(section_posture(model, given, p)))
        state = dict.fromkeys(walker.state_names(), 0.0)
        state |= dict(zip((*walker.shape, *(f"d{name}" for name in walker.shape)), posture, strict=True))
        state |= {name: given[name] for name in needed}
        undefined = [name for name, value in state.items() if not math.isfinite(value)]
        if undefined:
            values = ", ".join(f"{name} = {value:g}" for name, value in given.items())
            solved = [name for name in undefined if is_default(model, "after_impact") and name in model.shape]
            if solved:
                others = ", ".join(name for name in model.shape if name not in model.section)
                self._fault(path, f"with {values} the legs do not close: no {others} puts both feet on the ground")
                return None
            self._fault(path, f"with {values} the walker would start with {undefined[0]} = {state[undefined[0]]}")
            return None
        for name, value in given.items():
            if name not in (*needed, "x", "dx") and not math.isclose(value, state[name], rel_tol=STATED_TOLERANCE):
                section_value = f"just after the impact it is {state[name]:.9g}; leave it out"
                self._fault((*path, name), f"{value:g} contradicts the section: {section_value}")
        state |= {name: given[name] for name in ("x", "dx") if name in given}
        return {name: float(state[name]) for name in walker.state_names()}
