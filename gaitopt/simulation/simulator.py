"""The forward hybrid simulator: from a state after impact to any number of steps, without a given mode sequence.

On every arc one mode holds and dz/dt = flow_mode(t, z, p, r) is integrated to its first event. The next mode follows
from the contact forces at the event, or from the impulses at touchdown; see Gamus & Or (2013), section II. The table in
``gaitopt.model.transitions`` states guards, resets and candidates; ``ContactResolver`` chooses among the candidates.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from math import inf, isfinite

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.display import counted
from gaitopt.errors import ProblemError
from gaitopt.gait.trajectory import Arc, ImpactRecord, Step, Trajectory, impact_record
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.transitions import Ending, Transition
from gaitopt.problem.floor import Floor
from gaitopt.problem.statement import Until
from gaitopt.requests import Engine
from gaitopt.simulation.contact_resolver import ContactResolver, Termination
from gaitopt.simulation.engine import Arrival, Stepper, choose_engine
from gaitopt.simulation.ground import Ground, comes_down
from gaitopt.simulation.outcomes import StepOutcome
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.threads import cached_property

MAX_STEP_TIME = 50.0
"""Longest time between impacts, in units of sqrt(l / g): 20 s for legs of 1.6 m, longer than any step of a walk."""
MAX_SWITCHES = 50
"""Largest number of mode switches in a step; more are called chattering. A walking step has a handful."""
ACCUMULATED = 1e-4
"""Impacts accumulate if they follow each other within this time, in units of sqrt(l / g). Between impacts that are a
hundred times faster, a contact does not rise by more than rounding."""
INTERVALS = 5
"""Number of intervals between impacts from which their limit is extrapolated."""
MOST_SIMULATORS = 64
"""Number of simulators in the cache for pairs of tiles; each takes some 100 kB."""
LONGEST_ARC = 5.0
"""Longest arc of a motion that ends at a time or after events, in units of sqrt(l / g). A longer arc is divided so that
every piece is resolved."""


def stepper_class(engine: str, *, steps: int = 1) -> type[Stepper]:
    """The stepper of an engine; see ``choose_engine``.

    Raises
    ------
    UnknownNameError
        If there is no such engine, or it is not installed.
    """
    if choose_engine(engine, steps=steps) is Engine.SCIPY:
        return ScipyStepper
    from gaitopt.simulation.heyoka_stepper import HeyokaStepper  # heyoka is optional, and takes 0.2 s to import

    return HeyokaStepper


def segment_ends(dynamics: Dynamics, longest: float = inf, *, longest_step: float | None = None) -> tuple[float, ...]:
    """Times since the impact at which the segments of the control end [s].

    The last one is the time limit of a step; if the clock ends a cycle, it is the period of the control.

    Parameters
    ----------
    longest : time at which the motion ends; it may exceed the time limit of a walking step. Infinite if there is none.
    longest_step : time limit of a walking step [s]; ``MAX_STEP_TIME`` by default.
    """
    control = dynamics.system.control
    most = MAX_STEP_TIME * dynamics.scales.time if longest_step is None else longest_step
    limit = min(most if longest == inf else longest, control.horizon)
    if dynamics.system.cycle_end == CLOCK:
        assert control.period is not None  # problems without it are rejected when they are read
        limit = control.period
    return (*(t for t in control.breakpoints if t < limit), limit)


class Simulator:
    """Simulates one walker under one control law at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    stepper : creates the integrator of the arcs from ``dynamics``: a subclass of ``Stepper``.
    max_switches : largest number of mode switches within a step.
    longest_step : time limit of a step [s]; 50 sqrt(l / g) by default.
    floor : the tiles on which it walks; the nominal floor of ``dynamics`` by default.

    Attributes
    ----------
    dynamics, system : the dynamics, and its hybrid system.
    stepper : the integrator.

    Raises
    ------
    ValueError
        If the parameters do not have one finite value per parameter of the system.
    ProblemError
        If the walker cannot walk on a floor.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        stepper: Callable[[Dynamics], Stepper] = ScipyStepper,
        *,
        max_switches: int = MAX_SWITCHES,
        longest_step: float | None = None,
        floor: Floor | None = None,
    ) -> None:
        _finite_vector("parameters", dynamics.p, dynamics.system.parameters)
        self.dynamics, self.system = dynamics, dynamics.system
        self.stepper = stepper(dynamics)
        self._make_stepper, self._max_switches, self._longest_step = stepper, max_switches, longest_step
        self._ends = segment_ends(dynamics, longest_step=longest_step)
        self._resolver = ContactResolver(dynamics, self.stepper.natural)
        self._ground = None if floor is None else Ground(dynamics, floor)
        self._on_tiles: dict[bytes, Simulator] = {}

    @cached_property
    def per_step(self) -> tuple["Simulator", ...]:
        """The simulators of consecutive steps, one for each of ``dynamics.steps``; the first one is this simulator."""
        return (self, *map(self._like, self.dynamics.steps[1:]))

    def on(self, dynamics: Dynamics) -> "Simulator":
        """The simulator like this one of a walker on other tiles, or in another step."""
        for simulator in self.per_step:
            if dynamics is simulator.dynamics:
                return simulator
        key = dynamics.p.tobytes()
        if key not in self._on_tiles:
            if len(self._on_tiles) >= MOST_SIMULATORS:
                del self._on_tiles[next(iter(self._on_tiles))]
            self._on_tiles[key] = self._like(dynamics)
        return self._on_tiles[key]

    def _over(
        self,
        walk: tuple["Simulator", dict[str, int], Array] | None,
        n: int,
        before: Mode,
        after: Mode | Termination,
        z: Array,
    ) -> "Simulator":
        """The simulator with which step ``n`` of a walk on a floor continues after an event.

        If other contacts touch the ground than before it, they are on other tiles: the tiles of ``walk`` are updated,
        and another simulator continues. A foot at the base point stays on the tile of its step.

        Parameters
        ----------
        walk : see ``step``.
        before, after : mode before the event, and mode or ending after it.
        z : state just after the event.
        """
        if walk is None or not isinstance(after, Mode) or after.touching == before.touching:
            return self
        if self.system.walker.base_contact():
            return self
        (whole, tiles, first), ground = walk, walk[0]._ground
        assert ground is not None
        on_ground = ground.within(n, tiles, after)
        tiles.clear()
        tiles.update(on_ground)
        return whole.on(ground.dynamics(n, tiles, z).acting(first, n))

    def _like(self, dynamics: Dynamics) -> "Simulator":
        return Simulator(dynamics, self._make_stepper, max_switches=self._max_switches, longest_step=self._longest_step)

    def run(
        self,
        state: Array,
        steps: int = 1,
        *,
        until: Until | None = None,
        anywhere: bool = False,
        dense: bool = False,
        should_stop: Stop = None,
    ) -> Trajectory:
        """Simulate up to ``steps`` steps from a state just after an impact.

        Parameters
        ----------
        state : ndarray, shape (n_z,) - (shape [rad], x [m], rates [rad/s], dx [m/s]); x is counted from zero.
        steps : number of steps.
        until : when to end instead: at a time, or after a number of steps or events. After an event within a step, the
            last state is the one just before the event.
        anywhere : whether the state may be any state, and not only one just after an impact. The state then determines
            the contacts, and x is not reset to zero.
        dense : whether every arc is sampled at Chebyshev points, and not only at its two ends.
        should_stop : called before every step; True ends the trajectory with the steps completed so far.

        Raises
        ------
        ValueError
            If ``state`` does not have one finite value per state of the system, or ``steps`` is less than one.
        """
        if steps < 1:
            raise ValueError(f"steps = {steps}: at least one step is needed")
        start = self._after_impact(state, anywhere=anywhere)
        completed: list[Step] = []
        ending, message, time, events = Ending.COMPLETED, "", 0.0, 0
        limits = Until(steps=int(steps)) if until is None else until
        most, last, events_left = (inf if n is None else n for n in (limits.steps, limits.time, limits.events))

        def rest() -> tuple[float, float] | None:
            return None if until is None else (last - time, events_left - events)

        walk = self.each_step(start, dense=dense, anywhere=anywhere, rest=rest)
        while len(completed) < most and time < last and events < events_left:
            if should_stop is not None and should_stop():
                message = f"{len(completed)} of {steps} steps, then stopped on request"
                break
            outcome = next(walk)
            if outcome.step is not None:
                completed.append(outcome.step)
                time += outcome.step.period
            if outcome.step is None or outcome.step.impact is None:
                ending, message = outcome.ending, outcome.message
                break
            events += outcome.events
        if not message:
            message = (
                f"{steps} of {steps} steps" if until is None else f"{counted(len(completed), 'step')}, {time:.6g} s"
            )
        return Trajectory(
            names=self.system.state_names, start=start, steps=tuple(completed), ending=ending, message=message
        )

    def each_step(
        self,
        state: Array,
        *,
        dense: bool = False,
        anywhere: bool = False,
        rest: Callable[[], tuple[float, float] | None] = lambda: None,
    ) -> Iterator[StepOutcome]:
        """Simulate one step after the other, until one is not completed.

        Parameters
        ----------
        rest : called before every step, see ``step``.
        """
        z, ground = self._after_impact(state, anywhere=anywhere), self._ground
        tiles = dict[str, int]() if ground is None else ground.start(z)
        first, correction = z, self.system.correction
        for n in count():
            first = z if correction is None or n % correction.every == 0 else first
            if ground is not None:
                simulator = self.on(ground.dynamics(n, tiles, z).acting(first, n))
            elif correction is None:
                simulator = self.per_step[n % len(self.per_step)]
            else:
                acting = self.dynamics.acting(first).steps
                simulator = self.on(acting[n % len(acting)])
            walk = None if ground is None else (self, tiles, first)
            outcome = simulator.step(z, dense=dense, number=n + 1, anywhere=anywhere and not n, rest=rest(), walk=walk)
            yield outcome
            if outcome.step is None or outcome.step.impact is None:
                return
            z = outcome.step.impact.state
            if ground is not None:
                tiles = ground.following(n, tiles, outcome.step.impact.mode)

    def step(
        self,
        state: Array,
        *,
        dense: bool = False,
        number: int = 1,
        anywhere: bool = False,
        rest: tuple[float, float] | None = None,
        walk: tuple["Simulator", dict[str, int], Array] | None = None,
    ) -> StepOutcome:
        """Simulate one step from a state just after an impact.

        Parameters
        ----------
        number : number of the step in messages.
        anywhere : see ``run``.
        rest : time [s] and number of events after which to end within the step; None for a whole step.
        walk : the walk on a floor to which this step belongs: its simulator; the tiles of the contacts on the ground,
            which this function updates when named contacts leave the ground and land on other tiles; and the state in
            which the cycle began. None on the nominal floor.
        """
        table, time, segment = self.system.transitions, 0.0, 0
        z = self._after_impact(state, anywhere=anywhere)
        last_time, last_event = rest or (inf, inf)
        ends, longest, window = self._ends, inf, inf
        if rest is not None:  # the motion may end before the step does
            unit = self.dynamics.scales.time
            ends, longest, window = segment_ends(self.dynamics, last_time), LONGEST_ARC * unit, unit
        arcs: list[Arc] = []
        strikes: list[float] = []
        switches: list[float] = []
        mode: Mode | None = None
        origin = float(z[self.system.n_shape])
        here = self
        following, z, struck = self._first_mode(z, anywhere=anywhere)
        while isinstance(following, Mode):
            mode = following
            arrival = here._advance(mode, segment, time, z, min(ends[segment], last_time, time + longest))
            transition = None if arrival.event is None else table.of(mode)[arrival.event]
            comes_to_rest = transition is not None and bool(transition.at_rest)
            end = here._resolver.settled(arrival.state, stopped=mode if comes_to_rest else None)
            if arrival.time > time:
                arcs.append(here._arc(mode, segment, (time, arrival.time), (z, end), dense, struck))
                struck = None
            time, z = arrival.time, end
            if arrival.failure:
                following = Termination(Ending.NUMERICAL, arrival.failure)
                break
            limit = _limit_reached(transition, time >= last_time, len(switches) + 1 >= last_event)
            if limit:
                message = f"{counted(number - 1, 'step')} and {time:.6g} s, {limit}"
                return StepOutcome(
                    step=_partial(arcs), ending=Ending.COMPLETED, message=message, events=len(switches) + 1
                )
            if transition is None and time < ends[segment]:  # a piece of a long arc has ended
                following = mode
            elif transition is None:  # a segment of the control has ended
                if segment < len(ends) - 1:
                    segment += 1
                    following = here._continued(mode, time, z, segment)
                elif self.system.cycle_end == CLOCK:
                    record = impact_record(here.dynamics, mode.contact, z, mode)
                    return _completed(arcs, record, number, origin, len(switches))
                else:
                    where = ", where the control law ends" if time == self.system.control.horizon else ""
                    what = "touchdown" if rest is None else "event"
                    following = Termination(Ending.NO_TOUCHDOWN, f"no {what} within {time:g} s{where}")
            elif transition.ending is not None:
                following = Termination(transition.ending, transition.reason)
            elif transition.ends_step:
                landed = here._resolver.impact(mode, transition, z)
                if isinstance(landed, ImpactRecord):
                    return _completed(arcs, landed, number, origin, len(switches) + 1)
                following = landed
            else:
                strikes += [time] if transition.reset is not None else []
                recent = sum(1 for switch in switches[-self._max_switches :] if switch > time - window)
                is_last = recent == self._max_switches
                last = accumulation(strikes, time, is_last=is_last, unit=self.dynamics.scales.time)
                if last < inf:
                    following = Termination(Ending.IMPACTS_ACCUMULATE, f"impacts accumulate at {last:.6g} s")
                    break
                if is_last:
                    within = "one step" if rest is None else f"{window:.3g} s"
                    reason = f"more than {self._max_switches} mode switches in {within}"
                    following = Termination(Ending.CHATTERING, reason)
                    break
                switches.append(time)
                following, z, struck = here._switch(mode, transition, time, z, segment, struck)
            here = here._over(walk, number - 1, mode, following, z)
        values = ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.system.state_names, z, strict=True))
        where = "at the choice of the first mode" if mode is None else f"in mode {mode.brief}"
        return StepOutcome(
            step=_partial(arcs),
            ending=following.ending,
            message=f"{following.reason}: step {number}, {time:.6g} s after the impact, {where}, at {values}",
        )

    def _advance(self, mode: Mode, segment: int, time: float, z: Array, limit: float) -> Arrival:
        """The end of an arc; on a tile of another height a foot that has not yet passed mid-swing does not land."""
        arrival = self.stepper.advance(mode, segment, time, z, limit)
        while arrival.event == TOUCHDOWN and not comes_down(self.dynamics, arrival.state):
            arrival = self.stepper.advance(mode, segment, arrival.time, arrival.state, limit)
        return arrival

    def _after_impact(self, state: Array, *, anywhere: bool = False) -> Array:
        """A valid state; x is zero unless ``anywhere``, and slip velocities that are rounding errors are zero."""
        z = _finite_vector("state", state, self.system.state_names)
        if not anywhere:
            z[self.system.n_shape] = 0.0
        return self._resolver.settled(z)

    def _first_mode(self, z: Array, *, anywhere: bool = False) -> tuple[Mode | Termination, Array, Mode | None]:
        """The mode at the start of a step; named contacts that come down onto the ground first have their impact."""
        start = self._resolver.start(z, anywhere=anywhere)
        if isinstance(start, Termination):
            return start, z, None
        mode, landing = start
        if landing is not None:
            return self._switch(mode, landing, 0.0, z, 0, None)
        return self._continued(mode, 0.0, z, 0), z, None

    def check_start(self, state: Array) -> None:
        """Check that no named contact of a state is below the ground.

        Raises
        ------
        ProblemError
            If a contact is below the ground; the message says which one, and how far.
        """
        reason = self._resolver.below_ground(self._after_impact(state))
        if reason is not None:
            raise ProblemError(f"state: {reason}")

    def _continued(self, mode: Mode, time: float, z: Array, segment: int) -> Mode | Termination:
        """The mode after a jump of the torques."""
        return self._resolver.following(self.system.transitions.at_breakpoint(mode), time, z, segment)

    def _switch(
        self, mode: Mode, transition: Transition, time: float, z: Array, segment: int, struck: Mode | None
    ) -> tuple[Mode | Termination, Array, Mode | None]:
        """The mode after an event in ``mode`` within a step, the state at its start, and the last impact of a contact.

        Parameters
        ----------
        struck : the mode just after an earlier impact at the same instant; None if there was none.
        """
        if transition.reset is not None:
            landed = self._resolver.strike(mode, transition, z)
            if isinstance(landed, Termination):
                return landed, z, None
            after, z = landed
            struck = self.system.transitions.stated_impact(transition.reset.of, after)
            return self._continued(after, time, z, segment), z, struck
        return self._resolver.following(transition, time, z, segment), z, struck

    def _arc(
        self,
        mode: Mode,
        segment: int,
        ends: tuple[float, float],
        states: tuple[Array, Array],
        dense: bool,
        struck: Mode | None,
    ) -> Arc:
        times, sampled = np.array(ends), np.array(states)
        if dense:
            times, sampled = self.stepper.sample_arc(mode, segment, states[0], *ends)
            sampled[-1] = states[1]
        return Arc(dynamics=self.dynamics, mode=mode, segment=segment, times=times, states=sampled, struck=struck)


def _completed(arcs: list[Arc], impact: ImpactRecord, number: int, origin: float, events: int) -> StepOutcome:
    """The outcome of a step that has returned to the section; it began with the foot at ``origin``."""
    impact = replace(impact, step_length=impact.step_length - origin) if origin else impact
    step = Step(arcs=tuple(arcs), impact=impact)
    return StepOutcome(step=step, ending=Ending.COMPLETED, message=f"step {number} completed", events=events)


def _limit_reached(transition: Transition | None, at_end: bool, last_event: bool) -> str:
    """A text that says at which limit of time or events the simulation ends; empty if it continues."""
    if transition is None:
        return "to the time limit" if at_end else ""
    within = not transition.ends_step and transition.ending is None
    return f"to an event: {transition.reason or transition.guard}" if last_event and within else ""


def _partial(arcs: list[Arc]) -> Step | None:
    """The step with these arcs and without an impact; None if there are no arcs."""
    return Step(arcs=tuple(arcs), impact=None) if arcs else None


def accumulation(strikes: Sequence[float], time: float, *, is_last: bool, unit: float) -> float:
    """The time at which impacts accumulate, if the motion ends there; infinity if it continues.

    The intervals between accumulating impacts tend to a geometric series. Intervals are compared in pairs, because two
    contacts may strike alternately with different intervals.

    Parameters
    ----------
    strikes : times of the impacts in a step so far.
    time : time of the last event.
    is_last : whether no more events are allowed in the step.
    unit : unit of time [s].
    """
    if len(strikes) <= INTERVALS:
        return inf
    intervals = np.diff(strikes[-INTERVALS - 1 :])
    if intervals.min() <= 0 or np.any(intervals[2:] >= intervals[:-2]):
        return inf
    ratio = intervals[-1] / intervals[-3]
    limit = float(strikes[-1] + (intervals[-1] + intervals[-2]) * ratio / (1 - ratio))
    fast = time - strikes[-2] < ACCUMULATED * unit
    return limit if time <= limit and (is_last or fast) else inf


def _finite_vector(what: str, values: Array, names: tuple[str, ...]) -> Array:
    """A copy of ``values`` as a vector with one finite entry per name."""
    vector = np.array(values, dtype=float)
    if vector.shape != (len(names),):
        raise ValueError(f"{what} of shape {vector.shape}: one value is needed for each of {', '.join(names)}")
    if not all(map(isfinite, vector.tolist())):
        wrong = (f"{name} = {value}" for name, value in zip(names, vector, strict=True) if not isfinite(value))
        raise ValueError(f"{what} must be finite, not {', '.join(wrong)}")
    return vector
