"""The mode sequences of a gait and its first guess: a state on the section just after the impact, and durations.

What the section determines is filled in (both feet on the ground, x = 0, and dx = 0 unless the impact slips); what a
file gives besides must agree with it.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from gaitopt.mechanics.cycle import Cycle, ModeSequence
from gaitopt.mechanics.modes import NEXT_STATE, Mode
from gaitopt.mechanics.posture import section_posture
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.faults import Fault, Key, read_section, shown
from gaitopt.problem.parts import Guess, OpenSequence
from gaitopt.problem.sections import (
    CycleSection,
    GaitSection,
    GuessSection,
    OpenGaitSection,
    StepSection,
    state_section,
)

OPEN = "auto"
UNEVEN = "{} is no number of steps after which the same leg stands again: where the legs differ, a cycle has 2, 4, ..."
SAME_STATE = 1e-5  # relative: a state written with six digits may be off by half of this


def read_gait(
    data: Mapping[str, Any], model: type[Walker] | None, walker: Walker | None, faults: list[Fault]
) -> tuple[Cycle | OpenSequence | None, Guess | None]:
    """The cycle and the guess, as far as they can be had without fault."""
    if "gait" not in data:
        return None, None
    if isinstance(data["gait"], Mapping) and data["gait"].get("phases") == OPEN:
        return _read_open(data["gait"], model, walker, faults)
    several = isinstance(data["gait"], Mapping) and "steps" in data["gait"]
    model_: type[CycleSection] | type[GaitSection] = CycleSection if several else GaitSection
    gait = read_section(model_, data["gait"], ("gait",), faults)
    if gait is None:
        return None, None
    steps = gait.steps if isinstance(gait, CycleSection) else (gait,)
    cycle = _read_cycle(steps, model, ("gait", "steps" if several else "phases"), faults)
    guess = read_section(GuessSection, gait.guess, ("gait", "guess"), faults)
    if guess is None:
        return cycle, None
    phases = [mode for step in steps for mode in step.phases]
    if guess.durations is not None and len(guess.durations) != len(phases):
        needed = f"one duration per phase ({', '.join(phases)})"
        message = f"{len(guess.durations)} given, but it takes {needed}; or leave durations out"
        faults.append(Fault(("gait", "guess", "durations"), message))
    state = None if model is None else _read_state(guess.state, model, walker, steps[-1].impact, faults)
    return cycle, None if state is None else Guess(state=state, durations=guess.durations)


def _read_open(
    data: Mapping[str, Any], model: type[Walker] | None, walker: Walker | None, faults: list[Fault]
) -> tuple[OpenSequence | None, Guess | None]:
    """A gait whose sequence is to be found; of a guess, the slip velocity is 0 if it is left out."""
    gait = read_section(OpenGaitSection, data, ("gait",), faults)
    if gait is None:
        return None, None
    sides = 1 if model is None else model.n_sides()
    sequence = OpenSequence(impact=gait.impact, steps=max(gait.steps, sides))
    if "steps" in gait.model_fields_set and gait.steps < sides:
        faults.append(Fault(("gait", "steps"), UNEVEN.format(gait.steps)))
    guess = None if gait.guess is None else read_section(GuessSection, gait.guess, ("gait", "guess"), faults)
    if guess is None or model is None:
        return sequence, None
    if guess.durations is not None:
        faults.append(Fault(("gait", "guess", "durations"), "belong to phases, which are open here: leave them out"))
    slip = guess.state.get("dx", 0.0)
    impact = Mode.slip(slip) if isinstance(slip, int | float) and slip else Mode.STICK
    state = _read_state(guess.state, model, walker, impact, faults)
    return sequence, None if state is None else Guess(state=state, durations=None)


def _read_cycle(
    steps: Sequence[StepSection], model: type[Walker] | None, path: Key, faults: list[Fault]
) -> Cycle | None:
    try:
        cycle = Cycle(tuple(ModeSequence(phases=step.phases, impact=step.impact) for step in steps))
        if model is not None:
            if len(steps) % model.n_sides():
                raise ValueError(UNEVEN.format(len(steps)))
            for step in steps:
                _check_contacts(step, model)
                _check_stops(step, model)
        return cycle
    except ValueError as error:
        faults.append(Fault(path, str(error)))
        return None


def _check_contacts(step: StepSection, model: type[Walker]) -> None:
    """Whether the foot can do what every phase says, and the step of a walker that flies ends out of flight.

    Raises
    ------
    ValueError
        If not; the message says what the walker can do.
    """
    allowed = model.contacts()
    for mode in (*step.phases, step.impact):
        if mode.contact not in allowed:
            raise ValueError(f"the {model.model} has no {mode.contact}: its foot can {', '.join(allowed)}")
    if step.impact.flies:
        raise ValueError("after an impact the foot is on the ground: stick, slip_forward or slip_backward")
    if model.flies and not step.phases[-1].flies:
        raise ValueError(f"the {model.model} lands out of flight: the last phase of a step must be flight")


def _check_stops(step: StepSection, model: type[Walker]) -> None:
    """Whether every phase states the stops and switches, which lock or are thrown one after the other.

    Those of a walker that stays on the ground are all locked when the foot comes down.

    Raises
    ------
    ValueError
        If not; the message says how to write it.
    """
    start = model.released(Mode.STICK).stops
    stops = tuple(start)
    for mode in step.phases:
        if tuple(mode.stops) != stops or any(mode.stops[k] not in (v, NEXT_STATE[v]) for k, v in start.items()):
            form = "{" + ", ".join([f"mode: {mode.contact}", *(f"{k}: {v}" for k, v in start.items())]) + "}"
            raise ValueError(f"{mode} must be written {form if stops else mode.contact}, as the walker has its stops")
    thrown = [{name for name in stops if mode.stops[name] != start[name]} for mode in step.phases]
    jumps = [len(later) - len(earlier) for earlier, later in pairwise(thrown) if earlier <= later]
    if len(jumps) < len(thrown) - 1 or max(jumps, default=0) > 1 or thrown[0]:
        raise ValueError("a step begins with all stops free and all switches off, and they change one at a time")
    if not model.flies and step.phases[-1].free:
        raise ValueError("all stops lock before the foot comes down")
    if step.impact.stops:
        raise ValueError(f"the impact is written {step.impact.contact}: that of the foot frees all stops")


def _read_state(
    data: Mapping[str, Any], model: type[Walker], walker: Walker | None, impact: Mode, faults: list[Fault]
) -> dict[str, float] | None:
    """The complete state, in the order of the walker's state names."""
    path: Key = ("gait", "guess", "state")
    section = read_section(state_section(model), data, path, faults)
    if section is None:
        return None
    given = section.model_dump(exclude_none=True)
    needed = model.section_names(slipping=impact.slips)
    missing = [name for name in needed if name not in given]
    faults += [
        Fault((*path, name), f"is missing; after this impact the section is {', '.join(needed)}") for name in missing
    ]
    faults += _slip_faults(given.get("dx", 0.0), impact, (*path, "dx")) if "dx" not in missing else []
    if missing or walker is None:
        return None
    state = (
        dict.fromkeys(walker.state_names(), 0.0)
        | _after_impact(given, walker)
        | {k: given[k] for k in needed if k in given}
    )
    undefined = [name for name, value in state.items() if not math.isfinite(value)]
    if undefined:
        words = ", ".join(f"{name} = {value:g}" for name, value in given.items())
        faults.append(Fault(path, f"with {words} the walker would start with {undefined[0]} = {state[undefined[0]]}"))
        return None
    for name, value in given.items():
        if name not in (*needed, "x", "dx") and not math.isclose(value, state[name], rel_tol=SAME_STATE):
            message = f"{value:g} contradicts the section, just after the impact it is {state[name]:.9g}: leave it out"
            faults.append(Fault((*path, name), message))
    state |= {name: given[name] for name in ("x", "dx") if name in given}
    return {name: float(state[name]) for name in walker.state_names()}


def _after_impact(given: Mapping[str, float], walker: Walker) -> dict[str, float]:
    """Shape coordinates and rates that follow from those of the section."""
    model = type(walker)
    p = np.array([float(getattr(walker, name)) for name in model.model_fields])
    shape, rates = section_posture(model, given, p)
    names = (*walker.shape, *(f"d{name}" for name in walker.shape))
    return dict(zip(names, map(float, (*shape, *rates)), strict=True))


def _slip_faults(dx: float, impact: Mode, path: Key) -> list[Fault]:
    """Whether the slip velocity has the sign that the impact says."""
    if math.copysign(1.0, dx) * (dx != 0) == impact.direction:
        return []
    sign = {0: "= 0 (leave it out)", 1: "> 0", -1: "< 0"}[impact.direction]
    return [Fault(path, f"{shown(dx)} contradicts the impact: after {impact} it is {sign}")]
